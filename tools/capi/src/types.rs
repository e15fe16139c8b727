//! The types of `sgs.h`: results, constants, structs that begin with their size.
//!
//! Promises that every struct is valid with all bits zero, and that fields are only ever added at the end. Leaves reading
//! and writing them across the border to `border`.

use std::ffi::{c_char, c_void};

/// `VkInstance`
pub type VkInstance = *mut c_void;
/// `VkPhysicalDevice`
pub type VkPhysicalDevice = *mut c_void;
/// `VkDevice`
pub type VkDevice = *mut c_void;
/// `VkQueue`
pub type VkQueue = *mut c_void;
/// `VkCommandBuffer`
pub type VkCommandBuffer = *mut c_void;
/// `VkImage`
pub type VkImage = u64;
/// `VkSemaphore`
pub type VkSemaphore = u64;
/// `VkFence`
pub type VkFence = u64;
/// `PFN_vkGetInstanceProcAddr`
pub type SgsGetInstanceProcAddr = Option<sgs_engine::vk::PFN_vkGetInstanceProcAddr>;

/// How a call ended.
#[repr(i32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(non_camel_case_types, clippy::upper_case_acronyms)]
pub enum SgsResult {
    /// Done.
    SGS_OK = 0,
    /// A pointer that is needed is null.
    SGS_ERROR_NULL = -1,
    /// A value is not one of those that are possible.
    SGS_ERROR_ARGUMENT = -2,
    /// A struct's size is none that this library knows.
    SGS_ERROR_STRUCT_SIZE = -3,
    /// No such object, or not any more, or an object of another kind or context.
    SGS_ERROR_HANDLE = -4,
    /// A file cannot be read or written.
    SGS_ERROR_FILE = -5,
    /// There is no such device, or it lacks something.
    SGS_ERROR_DEVICE = -6,
    /// The device was lost.
    SGS_ERROR_LOST = -7,
    /// Memory ran out.
    SGS_ERROR_MEMORY = -8,
    /// Earlier recordings are not done, or work did not finish in time; try again later.
    SGS_ERROR_BUSY = -9,
    /// Training cannot go on.
    SGS_ERROR_TRAINING = -10,
    /// A buffer of the caller's is too small.
    SGS_ERROR_SPACE = -11,
    /// A defect of this library. The context can only be destroyed.
    SGS_ERROR_INTERNAL = -12,
}

/// Any object of a context; 0 is none.
pub type SgsHandle = u64;
/// Gaussians on the device.
pub type SgsScene = u64;
/// Cameras from a file.
pub type SgsCameras = u64;
/// A way of rendering into images.
pub type SgsView = u64;
/// A frame in a host's command buffer.
pub type SgsRecording = u64;
/// A training under way.
pub type SgsTrainer = u64;
/// A run whose light changes.
pub type SgsRelight = u64;

/// Red, green and blue over the background, display-referred.
pub const SGS_LAYER_COLOR: u32 = 0;
/// Blended depth along the viewing axis, not divided by alpha.
pub const SGS_LAYER_DEPTH: u32 = 1;
/// Blended normals in world space.
pub const SGS_LAYER_NORMAL: u32 = 2;
/// One minus the transmittance.
pub const SGS_LAYER_ALPHA: u32 = 3;

/// Stage of training: Gaussians from photographs.
pub const SGS_STAGE_GEOMETRY: u32 = 1;
/// Stage of training: materials, lights and visibility on fixed geometry.
pub const SGS_STAGE_INTRINSIC: u32 = 2;

/// Of relightings: all light, over the background.
pub const SGS_LAYER_SHADED: u32 = 16;
/// Of relightings: linear albedo.
pub const SGS_LAYER_ALBEDO: u32 = 17;
/// Of relightings: roughness.
pub const SGS_LAYER_ROUGHNESS: u32 = 18;
/// Of relightings: metallic.
pub const SGS_LAYER_METALLIC: u32 = 19;
/// Of relightings: diffuse light, over black.
pub const SGS_LAYER_DIFFUSE: u32 = 20;
/// Of relightings: specular light, over black.
pub const SGS_LAYER_SPECULAR: u32 = 21;
/// Of relightings: how much of the lights is seen, mean over all of them.
pub const SGS_LAYER_VISIBILITY: u32 = 22;
/// Of relightings: light of the surroundings, over the surroundings themselves.
pub const SGS_LAYER_ENVIRONMENT: u32 = 23;
/// Of relightings: light of lamps, over black.
pub const SGS_LAYER_DIRECT: u32 = 24;

/// Colors as blended, that is sRGB-encoded.
pub const SGS_ENCODING_DISPLAY: u32 = 0;
/// Colors in linear light. Images whose format decodes sRGB hold encoded values either way.
pub const SGS_ENCODING_LINEAR: u32 = 1;

/// A host's instance, and the physical device that it has chosen.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsInstance {
    /// sizeof(SgsInstance)
    pub struct_size: u32,
    /// VkApplicationInfo::apiVersion of the instance.
    pub api_version: u32,
    /// Every other function is found through it.
    pub get_instance_proc_addr: SgsGetInstanceProcAddr,
    /// The instance.
    pub instance: VkInstance,
    /// The physical device.
    pub physical_device: VkPhysicalDevice,
    /// Not 0 if VK_EXT_debug_utils is enabled on the instance: objects then get names, passes labels.
    pub debug_utils: u32,
}

/// What a device needs to have enabled. Pointers live as long as the SgsRequirements.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsRequirementsInfo {
    /// sizeof(SgsRequirementsInfo)
    pub struct_size: u32,
    /// Lowest VkApplicationInfo::apiVersion.
    pub api_version: u32,
    /// The device's name.
    pub device_name: *const c_char,
    /// What the device lacks; with any of these it cannot be used.
    pub missing: *const *const c_char,
    /// How many.
    pub missing_count: u32,
    /// A queue family that can compute.
    pub queue_family: u32,
    /// Features to enable: first the required ones, then those that are used where they are enabled.
    pub features: *const *const c_char,
    /// How many, all together.
    pub feature_count: u32,
    /// How many of them are required.
    pub required_feature_count: u32,
    /// Device extensions to enable, the required ones first.
    pub extensions: *const *const c_char,
    /// How many, all together.
    pub extension_count: u32,
    /// How many of them are required.
    pub required_extension_count: u32,
    /// VkPhysicalDeviceFeatures2 with everything behind it that enables all of these features: for
    /// VkDeviceCreateInfo::pNext, with pEnabledFeatures null. A host may set further features in it.
    pub device_create_next: *mut c_void,
}

/// A device of the library's own.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsDeviceInfo {
    /// sizeof(SgsDeviceInfo)
    pub struct_size: u32,
    /// Not 0: with validation, whose messages sgs_context_get counts.
    pub validation: u32,
    /// Index or part of the name; null for the best one.
    pub device: *const c_char,
    /// A folder for compiled pipelines; null for none.
    pub pipeline_cache: *const c_char,
    /// After how long a wait gives up; 0 for five minutes.
    pub timeout_seconds: f64,
}

/// A device of the host's, and what is enabled on it.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsHostDevice {
    /// sizeof(SgsHostDevice)
    pub struct_size: u32,
    /// The queue family of the queue and of the command buffers.
    pub queue_family: u32,
    /// Where the device comes from.
    pub instance: *const SgsInstance,
    /// The device.
    pub device: VkDevice,
    /// A queue of that family; null if the host submits everything itself, which leaves only recording.
    pub queue: VkQueue,
    /// Called before the queue is used; null if nobody else uses it.
    pub lock_queue: Option<unsafe extern "C" fn(user: *mut c_void)>,
    /// Called right after.
    pub unlock_queue: Option<unsafe extern "C" fn(user: *mut c_void)>,
    /// Passed to both.
    pub user: *mut c_void,
    /// Features that are enabled, of those that the requirements name.
    pub features: *const *const c_char,
    /// Device extensions that are enabled; optional ones that are not named are not used.
    pub extensions: *const *const c_char,
    /// How many features.
    pub feature_count: u32,
    /// How many extensions.
    pub extension_count: u32,
    /// A folder for compiled pipelines; null for none.
    pub pipeline_cache: *const c_char,
    /// After how long a wait for the library's own work gives up; 0 for five minutes.
    pub timeout_seconds: f64,
}

/// What is known of a context.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsContextInfo {
    /// sizeof(SgsContextInfo)
    pub struct_size: u32,
    /// Not 0 if the device is the host's.
    pub adopted: u32,
    /// Bytes of device memory in use.
    pub bytes_used: u64,
    /// The most there were.
    pub bytes_peak: u64,
    /// Messages of the validation layer since the last call; only for a device of the library's own.
    pub validation_messages: u32,
    /// Objects that exist.
    pub objects: u32,
}

/// What is known of a scene.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsSceneInfo {
    /// sizeof(SgsSceneInfo)
    pub struct_size: u32,
    /// How many Gaussians.
    pub gaussians: u32,
    /// Highest band of spherical harmonics.
    pub sh_degree: u32,
    /// Not 0 if there are normals.
    pub normals: u32,
    /// Bytes of device memory.
    pub bytes: u64,
}

/// A pinhole camera: x right, y down, z forward; the middle of the first pixel is at (0.5, 0.5).
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsCamera {
    /// sizeof(SgsCamera)
    pub struct_size: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Nothing nearer is seen; 0 for 0.01.
    pub near_plane: f32,
    /// Focal lengths in pixels.
    pub focal: [f32; 2],
    /// The principal point in pixels.
    pub center: [f32; 2],
    /// From the world to the camera, three rows of four: a rotation or a mirror, and a translation.
    pub world_to_camera: [f32; 12],
}

/// What is rendered to memory.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsRenderInfo {
    /// sizeof(SgsRenderInfo)
    pub struct_size: u32,
    /// SGS_LAYER_...; three floats a pixel for colors and normals, one for depth and alpha.
    pub layer: u32,
    /// What lies behind colors, display-referred.
    pub background: [f32; 3],
    /// Highest band of spherical harmonics to use, plus one; 0 for all.
    pub sh_bands: u32,
}

/// What a view renders into.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsViewInfo {
    /// sizeof(SgsViewInfo)
    pub struct_size: u32,
    /// Columns of the images.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// VkFormat: R8G8B8A8 or B8G8R8A8, UNORM or SRGB; R16G16B16A16 or R32G32B32A32, SFLOAT.
    pub format: u32,
    /// SGS_LAYER_...; the fourth component is alpha.
    pub layer: u32,
    /// SGS_ENCODING_...
    pub encoding: u32,
    /// Factor on depths; 0 for 1.
    pub depth_scale: f32,
    /// VkImageLayout in which the library finds an image; VK_IMAGE_LAYOUT_UNDEFINED will do.
    pub initial_layout: u32,
    /// VkImageLayout in which the library leaves it.
    pub final_layout: u32,
    /// Frames that may be in flight together; 0 for 2.
    pub frames_in_flight: u32,
}

/// One frame of a view.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsFrame {
    /// sizeof(SgsFrame)
    pub struct_size: u32,
    /// Highest band of spherical harmonics to use, plus one; 0 for all.
    pub sh_bands: u32,
    /// The host's image: of the view's size and format, two-dimensional, one sample, with transfer-destination usage.
    pub image: VkImage,
    /// From where, of the view's size.
    pub camera: *const SgsCamera,
    /// What lies behind colors, display-referred.
    pub background: [f32; 3],
}

/// A semaphore to wait for or to signal.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsSemaphore {
    /// The semaphore.
    pub semaphore: VkSemaphore,
    /// The value of a timeline semaphore; of no meaning for a binary one.
    pub value: u64,
}

/// What the device has said of a view's frames, some frames late.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsViewReport {
    /// sizeof(SgsViewReport)
    pub struct_size: u32,
    /// Frames that are done.
    pub frames: u32,
    /// Of these, the ones that lacked room and show the background alone; later ones have it.
    pub incomplete: u32,
    /// Recordings that are not done yet.
    pub recordings: u32,
}

/// How a run is opened to be relit.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsRelightInfo {
    /// sizeof(SgsRelightInfo)
    pub struct_size: u32,
    /// Lights that there is room for before views make their plans anew; 0 for 16 more than the run has.
    pub light_capacity: u32,
}

/// What is known of a relighting.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsRelightState {
    /// sizeof(SgsRelightState)
    pub struct_size: u32,
    /// How many Gaussians, with those put in.
    pub gaussians: u32,
    /// How many lights.
    pub lights: u32,
    /// How many there is room for.
    pub light_capacity: u32,
    /// Not 0 if there is metallic.
    pub metallic: u32,
    /// Not 0 if something is in the way of lights.
    pub visibility: u32,
    /// Not 0 if there are surroundings.
    pub environment: u32,
    /// Texels along an edge of the cube that surroundings become.
    pub environment_size: u32,
}

/// A light. sgs_relight_light_set takes every field as it is: get it, change it, set it.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsLight {
    /// sizeof(SgsLight)
    pub struct_size: u32,
    /// Not 0 if it shines.
    pub on: u32,
    /// Where it is.
    pub position: [f32; 3],
    /// Factor of its light.
    pub gain: f32,
    /// Factors of red, green and blue; 1 for as it was loaded.
    pub color: [f32; 3],
}

/// A new light.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsNewLight {
    /// sizeof(SgsNewLight)
    pub struct_size: u32,
    /// How narrow it shines around the axis; 0 for the same in all directions.
    pub sharpness: f32,
    /// Where it is.
    pub position: [f32; 3],
    /// Radiant intensity along the axis, in the units of the pictures.
    pub intensity: [f32; 3],
    /// From what is lit to the light; of no meaning without sharpness.
    pub axis: [f32; 3],
}

/// What of a relighting is rendered to memory.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsRelitInfo {
    /// sizeof(SgsRelitInfo)
    pub struct_size: u32,
    /// SGS_LAYER_SHADED and its like; one float a pixel for roughness, metallic and visibility, else three, linear.
    pub layer: u32,
    /// What lies behind SGS_LAYER_SHADED, display-referred.
    pub background: [f32; 3],
    /// Light is multiplied by two to the power of this.
    pub exposure: f32,
}

/// What is trained on.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsTrainerInfo {
    /// sizeof(SgsTrainerInfo)
    pub struct_size: u32,
    /// Not 0: continue the run in `run` with its settings.
    pub resume: u32,
    /// The scene directory.
    pub dataset: *const c_char,
    /// Settings as TOML text, as in config.toml of a run. Null for those of the run that is resumed or gets materials, else for the
    /// defaults.
    pub settings: *const c_char,
    /// Run directory to train into, as `sgs train` does: checkpoints, log, rollback after divergence, results. Null trains in memory;
    /// divergence is then an error. Steps since the last checkpoint are lost unless they are saved.
    pub run: *const c_char,
    /// Geometry for the intrinsic stage where the geometry stage is not trained: a PLY or glTF file. Null for scene.ply of the run.
    pub start: *const c_char,
    /// Sum of SGS_STAGE_GEOMETRY and SGS_STAGE_INTRINSIC; 0 is SGS_STAGE_GEOMETRY.
    pub stages: u32,
}

/// How far a training is.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsTrainStatus {
    /// sizeof(SgsTrainStatus)
    pub struct_size: u32,
    /// Finished steps of the stage.
    pub step: u32,
    /// Steps of the stage in all.
    pub steps: u32,
    /// Not 0 once all stages are finished.
    pub finished: u32,
    /// Gaussians after the last step.
    pub gaussians: u32,
    /// The loss of the last step, or 0 before the first.
    pub loss: f32,
    /// The stage: SGS_STAGE_GEOMETRY or SGS_STAGE_INTRINSIC.
    pub stage: u32,
    /// Rollbacks of the stage after divergence.
    pub roll_backs: u32,
}
