//! Types of `sgs.h`: results, constants, and structs that begin with their size.
//!
//! Guarantees: every struct is valid with all bits zero. New fields are only added at the end. The module `border`
//! reads and writes structs of callers.

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

/// Result of a call.
#[repr(i32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(non_camel_case_types, clippy::upper_case_acronyms)]
pub enum SgsResult {
    /// Done.
    SGS_OK = 0,
    /// A required pointer is null.
    SGS_ERROR_NULL = -1,
    /// A value is outside its valid range.
    SGS_ERROR_ARGUMENT = -2,
    /// The size of a struct is unknown to this library.
    SGS_ERROR_STRUCT_SIZE = -3,
    /// The object does not exist, or belongs to another kind or context.
    SGS_ERROR_HANDLE = -4,
    /// A file cannot be read or written.
    SGS_ERROR_FILE = -5,
    /// No device matches, or the device lacks a requirement.
    SGS_ERROR_DEVICE = -6,
    /// The device was lost.
    SGS_ERROR_LOST = -7,
    /// Memory ran out.
    SGS_ERROR_MEMORY = -8,
    /// Earlier recordings are not done, or work did not finish in time. Try again later.
    SGS_ERROR_BUSY = -9,
    /// Training cannot continue.
    SGS_ERROR_TRAINING = -10,
    /// A buffer of the caller is too small.
    SGS_ERROR_SPACE = -11,
    /// The library has a defect. The context can only be destroyed.
    SGS_ERROR_INTERNAL = -12,
}

/// Handle of any object of a context; 0 is none.
pub type SgsHandle = u64;
/// Gaussians on the device.
pub type SgsScene = u64;
/// Cameras from a file.
pub type SgsCameras = u64;
/// Renderer into images of one size and format.
pub type SgsView = u64;
/// Frame in a command buffer of the host.
pub type SgsRecording = u64;
/// Training in progress.
pub type SgsTrainer = u64;
/// Run whose light can be changed.
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
/// Stage of materials, emitters and bounced light.
pub const SGS_STAGE_TRANSPORT: u32 = 4;

/// Relighting: all light, over the background.
pub const SGS_LAYER_SHADED: u32 = 16;
/// Relighting: linear albedo.
pub const SGS_LAYER_ALBEDO: u32 = 17;
/// Relighting: roughness.
pub const SGS_LAYER_ROUGHNESS: u32 = 18;
/// Relighting: metallic.
pub const SGS_LAYER_METALLIC: u32 = 19;
/// Relighting: diffuse light, over black.
pub const SGS_LAYER_DIFFUSE: u32 = 20;
/// Relighting: specular light, over black.
pub const SGS_LAYER_SPECULAR: u32 = 21;
/// Relighting: visible share of the lights, mean over all lights.
pub const SGS_LAYER_VISIBILITY: u32 = 22;
/// Relighting: light of the environment map, over the environment map itself.
pub const SGS_LAYER_ENVIRONMENT: u32 = 23;
/// Relighting: light of the point lights or emitters, over black, without bounces and emission.
pub const SGS_LAYER_DIRECT: u32 = 24;

/// Colors as blended, which is sRGB-encoded.
pub const SGS_ENCODING_DISPLAY: u32 = 0;
/// Colors in linear light. Images whose format decodes sRGB hold encoded values with either encoding.
pub const SGS_ENCODING_LINEAR: u32 = 1;

/// Instance of a host, and the physical device that it has chosen.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsInstance {
    /// sizeof(SgsInstance)
    pub struct_size: u32,
    /// VkApplicationInfo::apiVersion of the instance.
    pub api_version: u32,
    /// Loader of all other Vulkan functions.
    pub get_instance_proc_addr: SgsGetInstanceProcAddr,
    /// Vulkan instance.
    pub instance: VkInstance,
    /// Physical device.
    pub physical_device: VkPhysicalDevice,
    /// Not 0 if VK_EXT_debug_utils is enabled on the instance. Objects then get names, and passes get labels.
    pub debug_utils: u32,
}

/// Requirements of a device. Pointers live as long as the SgsRequirements.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsRequirementsInfo {
    /// sizeof(SgsRequirementsInfo)
    pub struct_size: u32,
    /// Lowest VkApplicationInfo::apiVersion.
    pub api_version: u32,
    /// Name of the device.
    pub device_name: *const c_char,
    /// Requirements that the device lacks. A device that lacks any of them cannot be used.
    pub missing: *const *const c_char,
    /// Number of missing requirements.
    pub missing_count: u32,
    /// Queue family with compute support; 0xffffffff if there is none.
    pub queue_family: u32,
    /// Features to enable. The required ones come first, then those that are used if they are enabled.
    pub features: *const *const c_char,
    /// Number of features, including optional ones.
    pub feature_count: u32,
    /// Number of required features.
    pub required_feature_count: u32,
    /// Device extensions to enable, the required ones first.
    pub extensions: *const *const c_char,
    /// Number of extensions, including optional ones.
    pub extension_count: u32,
    /// Number of required extensions.
    pub required_extension_count: u32,
    /// VkPhysicalDeviceFeatures2 whose chain enables all of these features. For VkDeviceCreateInfo::pNext, with
    /// pEnabledFeatures null. A host may set further features in it.
    pub device_create_next: *mut c_void,
}

/// Device that the library opens.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsDeviceInfo {
    /// sizeof(SgsDeviceInfo)
    pub struct_size: u32,
    /// Not 0 enables validation. sgs_context_get counts its messages.
    pub validation: u32,
    /// Index or part of the name; null selects the best device.
    pub device: *const c_char,
    /// Directory of compiled pipelines; null for none.
    pub pipeline_cache: *const c_char,
    /// Seconds after which a wait fails; 0 for 300.
    pub timeout_seconds: f64,
}

/// Device of the host, and what is enabled on it.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsHostDevice {
    /// sizeof(SgsHostDevice)
    pub struct_size: u32,
    /// Queue family of the queue and of the command buffers.
    pub queue_family: u32,
    /// Instance that the device belongs to.
    pub instance: *const SgsInstance,
    /// Vulkan device.
    pub device: VkDevice,
    /// Queue of that family. Null if the host submits everything itself; only recording is possible then.
    pub queue: VkQueue,
    /// Function that is called before the queue is used. Null if no other thread uses the queue.
    pub lock_queue: Option<unsafe extern "C" fn(user: *mut c_void)>,
    /// Function that is called right after the queue is used.
    pub unlock_queue: Option<unsafe extern "C" fn(user: *mut c_void)>,
    /// Argument of both functions.
    pub user: *mut c_void,
    /// Enabled features, of those that the requirements name.
    pub features: *const *const c_char,
    /// Enabled device extensions. Optional extensions that are not named are not used.
    pub extensions: *const *const c_char,
    /// Number of features.
    pub feature_count: u32,
    /// Number of extensions.
    pub extension_count: u32,
    /// Directory of compiled pipelines; null for none.
    pub pipeline_cache: *const c_char,
    /// Seconds after which a wait for the library's own work fails; 0 for 300.
    pub timeout_seconds: f64,
}

/// State of a context.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsContextInfo {
    /// sizeof(SgsContextInfo)
    pub struct_size: u32,
    /// Not 0 if the device belongs to the host.
    pub adopted: u32,
    /// Bytes of device memory in use.
    pub bytes_used: u64,
    /// Highest number of bytes that were in use.
    pub bytes_peak: u64,
    /// Validation messages since the last call. Only for a device that the library opened.
    pub validation_messages: u32,
    /// Number of existing objects.
    pub objects: u32,
}

/// Description of a scene.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsSceneInfo {
    /// sizeof(SgsSceneInfo)
    pub struct_size: u32,
    /// Number of Gaussians.
    pub gaussians: u32,
    /// Highest band of spherical harmonics.
    pub sh_degree: u32,
    /// Not 0 if the Gaussians have normals.
    pub normals: u32,
    /// Bytes of device memory.
    pub bytes: u64,
}

/// Pinhole camera. Axes: x right, y down, z forward. The center of the first pixel is at (0.5, 0.5).
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsCamera {
    /// sizeof(SgsCamera)
    pub struct_size: u32,
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Distance of the near plane; 0 for 0.01.
    pub near_plane: f32,
    /// Focal lengths in pixels.
    pub focal: [f32; 2],
    /// Principal point in pixels.
    pub center: [f32; 2],
    /// Transform from world to camera, three rows of four: a rotation or a mirror, and a translation.
    pub world_to_camera: [f32; 12],
}

/// Parameters of rendering to memory.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsRenderInfo {
    /// sizeof(SgsRenderInfo)
    pub struct_size: u32,
    /// SGS_LAYER_...; three floats per pixel for colors and normals, one for depth and alpha.
    pub layer: u32,
    /// Display-referred background of colors.
    pub background: [f32; 3],
    /// Highest band of spherical harmonics to use, plus one; 0 for all.
    pub sh_bands: u32,
}

/// Parameters of a view.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsViewInfo {
    /// sizeof(SgsViewInfo)
    pub struct_size: u32,
    /// Width of the images in pixels.
    pub width: u32,
    /// Height of the images in pixels.
    pub height: u32,
    /// VkFormat: R8G8B8A8 or B8G8R8A8, UNORM or SRGB; R16G16B16A16 or R32G32B32A32, SFLOAT.
    pub format: u32,
    /// SGS_LAYER_...; the fourth component is alpha.
    pub layer: u32,
    /// SGS_ENCODING_...
    pub encoding: u32,
    /// Factor on depths; 0 for 1.
    pub depth_scale: f32,
    /// VkImageLayout of an image before rendering. VK_IMAGE_LAYOUT_UNDEFINED is allowed.
    pub initial_layout: u32,
    /// VkImageLayout of the image after rendering.
    pub final_layout: u32,
    /// Number of frames that may be in flight together; 0 for 2.
    pub frames_in_flight: u32,
}

/// Frame of a view.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsFrame {
    /// sizeof(SgsFrame)
    pub struct_size: u32,
    /// Highest band of spherical harmonics to use, plus one; 0 for all.
    pub sh_bands: u32,
    /// Image of the host. It has the view's size and format, two dimensions, one sample, and transfer-destination
    /// usage.
    pub image: VkImage,
    /// Camera, of the view's size.
    pub camera: *const SgsCamera,
    /// Display-referred background of colors.
    pub background: [f32; 3],
}

/// Semaphore to wait for or to signal.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsSemaphore {
    /// Vulkan semaphore.
    pub semaphore: VkSemaphore,
    /// Value of a timeline semaphore. Ignored for a binary semaphore.
    pub value: u64,
}

/// Device report on the frames of a view, some frames late.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsViewReport {
    /// sizeof(SgsViewReport)
    pub struct_size: u32,
    /// Number of frames that are done.
    pub frames: u32,
    /// Of these, frames that lacked memory and show the background alone. Later frames have the memory.
    pub incomplete: u32,
    /// Number of recordings that are not done yet.
    pub recordings: u32,
}

/// Options for opening a run for relighting.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsRelightInfo {
    /// sizeof(SgsRelightInfo)
    pub struct_size: u32,
    /// Capacity for lights. Views rebuild their plans when it is exceeded. 0 for 16 more than the run has.
    pub light_capacity: u32,
}

/// State of a relighting.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsRelightState {
    /// sizeof(SgsRelightState)
    pub struct_size: u32,
    /// Number of Gaussians, including inserted ones.
    pub gaussians: u32,
    /// Number of lights.
    pub lights: u32,
    /// Capacity for lights.
    pub light_capacity: u32,
    /// Not 0 if the run has metallic.
    pub metallic: u32,
    /// Not 0 if the run models the occlusion of lights.
    pub visibility: u32,
    /// Not 0 if the relighting has an environment map, or windows show one.
    pub environment: u32,
    /// Texels along an edge of the environment map's cube.
    pub environment_size: u32,
    /// Not 0 if emitters with bounces light the scene. They are its lights.
    pub emitters: u32,
}

/// Emitter of a run, in world units. Fields that its shape does not have are ignored, and 0 if the library fills them.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsEmitter {
    /// sizeof(SgsEmitter)
    pub struct_size: u32,
    /// SGS_EMITTER_...
    pub shape: u32,
    /// Linear red, green and blue. Radiance of spheres, rectangles and disks, radiant intensity of points, spots and
    /// lobes, irradiance of directional light, factor on the environment of windows.
    pub color: [f32; 3],
    /// Center; the corner of a rectangle or window where both edges begin. 0 for directional light.
    pub position: [f32; 3],
    /// First edge of a rectangle or window; else normal of a disk, axis of a spot or lobe, direction of directional light.
    pub axis: [f32; 3],
    /// Second edge of a rectangle or window, perpendicular to the first.
    pub side: [f32; 3],
    /// Radius of a sphere or a disk.
    pub radius: f32,
    /// Inner and outer angle of a spot in degrees; angular radius of directional light, and 0.
    pub angles: [f32; 2],
    /// Sharpness of a lobe.
    pub sharpness: f32,
}

/// Light. sgs_relight_light_set applies every field: get a light, change it, set it.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsLight {
    /// sizeof(SgsLight)
    pub struct_size: u32,
    /// Not 0 if the light is on.
    pub on: u32,
    /// Position of the light.
    pub position: [f32; 3],
    /// Factor of the intensity.
    pub gain: f32,
    /// Factors of red, green and blue; 1 for the loaded color.
    pub color: [f32; 3],
}

/// Light to add.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsNewLight {
    /// sizeof(SgsNewLight)
    pub struct_size: u32,
    /// Sharpness of the lobe around the axis; 0 for the same intensity in all directions.
    pub sharpness: f32,
    /// Position of the light.
    pub position: [f32; 3],
    /// Radiant intensity along the axis, in the units of the images.
    pub intensity: [f32; 3],
    /// Direction from the lit point to the light. Ignored if the sharpness is 0.
    pub axis: [f32; 3],
}

/// Parameters of rendering a relighting to memory.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsRelitInfo {
    /// sizeof(SgsRelitInfo)
    pub struct_size: u32,
    /// SGS_LAYER_SHADED and the layers after it. One float per pixel for roughness, metallic and visibility, else
    /// three, linear.
    pub layer: u32,
    /// Display-referred background of SGS_LAYER_SHADED.
    pub background: [f32; 3],
    /// Exposure in stops. Light is multiplied by two to the power of this.
    pub exposure: f32,
}

/// Options for opening a trainer.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SgsTrainerInfo {
    /// sizeof(SgsTrainerInfo)
    pub struct_size: u32,
    /// Not 0: continue the run in `run` with its settings.
    pub resume: u32,
    /// Scene directory.
    pub dataset: *const c_char,
    /// Settings as TOML text, as in config.toml of a run. Null for the settings of the run that is resumed or gets
    /// materials, else for the defaults.
    pub settings: *const c_char,
    /// Run directory that receives checkpoints, log and results, as in `sgs train`. The trainer rolls back after
    /// divergence. Null trains in memory, where divergence is an error. Steps since the last checkpoint are lost unless
    /// they are saved.
    pub run: *const c_char,
    /// Geometry for the intrinsic stage without a geometry stage. A PLY or glTF file. Null for scene.ply of the run.
    pub start: *const c_char,
    /// Sum of SGS_STAGE_GEOMETRY, SGS_STAGE_INTRINSIC and SGS_STAGE_TRANSPORT; 0 is SGS_STAGE_GEOMETRY.
    pub stages: u32,
}

/// Progress of a training.
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
    /// Number of Gaussians after the last step.
    pub gaussians: u32,
    /// Loss of the last step, or 0 before the first.
    pub loss: f32,
    /// Stage: SGS_STAGE_GEOMETRY, SGS_STAGE_INTRINSIC or SGS_STAGE_TRANSPORT.
    pub stage: u32,
    /// Rollbacks of the stage after divergence.
    pub roll_backs: u32,
}
