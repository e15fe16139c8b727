/* sgs: Gaussian splats, trained and rendered with Vulkan, for C and C++. See docs/guide/embed.md.
 *
 * Every function returns SGS_OK or an error code; what went wrong is told by sgs_last_error, and by the error buffer of
 * functions that have no context yet. Structs begin with their size, so that programs keep working with later libraries.
 * Objects are numbers that a context hands out: one that is used after it was destroyed, or with a function that is not
 * for its kind, is answered with SGS_ERROR_HANDLE. A context may be used from several threads; its calls follow one
 * another. Strings are UTF-8 and end with a zero.
 *
 * Made by cbindgen from tools/capi; edit it there. */

#ifndef SGS_H
#define SGS_H

#include <stddef.h>
#include <stdint.h>
/* Vulkan's own types, in case its headers are not included. */
#if !defined(VULKAN_CORE_H_) && !defined(SGS_VULKAN_TYPES)
#define SGS_VULKAN_TYPES
typedef struct VkInstance_T *VkInstance;
typedef struct VkPhysicalDevice_T *VkPhysicalDevice;
typedef struct VkDevice_T *VkDevice;
typedef struct VkQueue_T *VkQueue;
typedef struct VkCommandBuffer_T *VkCommandBuffer;
#if defined(__LP64__) || defined(_WIN64) || defined(__x86_64__) || defined(__aarch64__)
typedef struct VkImage_T *VkImage;
typedef struct VkSemaphore_T *VkSemaphore;
typedef struct VkFence_T *VkFence;
#else
typedef uint64_t VkImage;
typedef uint64_t VkSemaphore;
typedef uint64_t VkFence;
#endif
#endif

/* Vulkan's calling convention. */
#if defined(_WIN32)
#define SGS_CALL __stdcall
#else
#define SGS_CALL
#endif

/* PFN_vkGetInstanceProcAddr. */
typedef void (SGS_CALL *SgsVoidFunction)(void);
typedef SgsVoidFunction (SGS_CALL *SgsGetInstanceProcAddr)(VkInstance instance, const char *name);


// Red, green and blue over the background, display-referred.
#define SGS_LAYER_COLOR 0

// Blended depth along the viewing axis, not divided by alpha.
#define SGS_LAYER_DEPTH 1

// Blended normals in world space.
#define SGS_LAYER_NORMAL 2

// One minus the transmittance.
#define SGS_LAYER_ALPHA 3

// Stage of training: Gaussians from photographs.
#define SGS_STAGE_GEOMETRY 1

// Stage of training: materials, lights and visibility on fixed geometry.
#define SGS_STAGE_INTRINSIC 2

// Stage of materials, emitters and bounced light.
#define SGS_STAGE_TRANSPORT 4

// Relighting: all light, over the background.
#define SGS_LAYER_SHADED 16

// Relighting: linear albedo.
#define SGS_LAYER_ALBEDO 17

// Relighting: roughness.
#define SGS_LAYER_ROUGHNESS 18

// Relighting: metallic.
#define SGS_LAYER_METALLIC 19

// Relighting: diffuse light, over black.
#define SGS_LAYER_DIFFUSE 20

// Relighting: specular light, over black.
#define SGS_LAYER_SPECULAR 21

// Relighting: visible share of the lights, mean over all lights.
#define SGS_LAYER_VISIBILITY 22

// Relighting: light of the environment map, over the environment map itself.
#define SGS_LAYER_ENVIRONMENT 23

// Relighting: light of the point lights or emitters, over black, without bounces and emission.
#define SGS_LAYER_DIRECT 24

// Colors as blended, which is sRGB-encoded.
#define SGS_ENCODING_DISPLAY 0

// Colors in linear light. Images whose format decodes sRGB hold encoded values with either encoding.
#define SGS_ENCODING_LINEAR 1

// Emitter: point that emits equally in all directions.
#define SGS_EMITTER_POINT 0

// Emitter: sphere.
#define SGS_EMITTER_SPHERE 1

// Emitter: rectangle, which emits on the side of axis x side.
#define SGS_EMITTER_RECTANGLE 2

// Emitter: disk, which emits on the side of its normal.
#define SGS_EMITTER_DISK 3

// Emitter: point with a cone of light.
#define SGS_EMITTER_SPOT 4

// Emitter: light from a distant disk.
#define SGS_EMITTER_DIRECTIONAL 5

// Emitter: point whose intensity is color * exp(sharpness * (c - 1)). c is the cosine between the axis and the direction in
// which the light leaves.
#define SGS_EMITTER_LOBE 6

// Emitter: rectangle that shows the environment, on the side of axis x side. Its color is a factor on the environment,
// which is white if the run has none and sgs_relight_environment_set sets none.
#define SGS_EMITTER_WINDOW 7

// Result of a call.
enum SgsResult
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  // Done.
  SGS_OK = 0,
  // A required pointer is null.
  SGS_ERROR_NULL = -1,
  // A value is outside its valid range.
  SGS_ERROR_ARGUMENT = -2,
  // The size of a struct is unknown to this library.
  SGS_ERROR_STRUCT_SIZE = -3,
  // The object does not exist, or belongs to another kind or context.
  SGS_ERROR_HANDLE = -4,
  // A file cannot be read or written.
  SGS_ERROR_FILE = -5,
  // No device matches, or the device lacks a requirement.
  SGS_ERROR_DEVICE = -6,
  // The device was lost.
  SGS_ERROR_LOST = -7,
  // Memory ran out.
  SGS_ERROR_MEMORY = -8,
  // Earlier recordings are not done, or work did not finish in time. Try again later.
  SGS_ERROR_BUSY = -9,
  // Training cannot continue.
  SGS_ERROR_TRAINING = -10,
  // A buffer of the caller is too small.
  SGS_ERROR_SPACE = -11,
  // The library has a defect. The context can only be destroyed.
  SGS_ERROR_INTERNAL = -12,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum SgsResult SgsResult;
#else
typedef int32_t SgsResult;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// Device, and everything made on it.
typedef struct SgsContext SgsContext;

// Requirements of one device.
typedef struct SgsRequirements SgsRequirements;

// Device that the library opens.
typedef struct {
  // sizeof(SgsDeviceInfo)
  uint32_t struct_size;
  // Not 0 enables validation. sgs_context_get counts its messages.
  uint32_t validation;
  // Index or part of the name; null selects the best device.
  const char *device;
  // Directory of compiled pipelines; null for none.
  const char *pipeline_cache;
  // Seconds after which a wait fails; 0 for 300.
  double timeout_seconds;
} SgsDeviceInfo;

// State of a context.
typedef struct {
  // sizeof(SgsContextInfo)
  uint32_t struct_size;
  // Not 0 if the device belongs to the host.
  uint32_t adopted;
  // Bytes of device memory in use.
  uint64_t bytes_used;
  // Highest number of bytes that were in use.
  uint64_t bytes_peak;
  // Validation messages since the last call. Only for a device that the library opened.
  uint32_t validation_messages;
  // Number of existing objects.
  uint32_t objects;
} SgsContextInfo;

// Handle of any object of a context; 0 is none.
typedef uint64_t SgsHandle;

// Instance of a host, and the physical device that it has chosen.
typedef struct {
  // sizeof(SgsInstance)
  uint32_t struct_size;
  // VkApplicationInfo::apiVersion of the instance.
  uint32_t api_version;
  // Loader of all other Vulkan functions.
  SgsGetInstanceProcAddr get_instance_proc_addr;
  // Vulkan instance.
  VkInstance instance;
  // Physical device.
  VkPhysicalDevice physical_device;
  // Not 0 if VK_EXT_debug_utils is enabled on the instance. Objects then get names, and passes get labels.
  uint32_t debug_utils;
} SgsInstance;

// Requirements of a device. Pointers live as long as the SgsRequirements.
typedef struct {
  // sizeof(SgsRequirementsInfo)
  uint32_t struct_size;
  // Lowest VkApplicationInfo::apiVersion.
  uint32_t api_version;
  // Name of the device.
  const char *device_name;
  // Requirements that the device lacks. A device that lacks any of them cannot be used.
  const char *const *missing;
  // Number of missing requirements.
  uint32_t missing_count;
  // Queue family with compute support; 0xffffffff if there is none.
  uint32_t queue_family;
  // Features to enable. The required ones come first, then those that are used if they are enabled.
  const char *const *features;
  // Number of features, including optional ones.
  uint32_t feature_count;
  // Number of required features.
  uint32_t required_feature_count;
  // Device extensions to enable, the required ones first.
  const char *const *extensions;
  // Number of extensions, including optional ones.
  uint32_t extension_count;
  // Number of required extensions.
  uint32_t required_extension_count;
  // VkPhysicalDeviceFeatures2 whose chain enables all of these features. For VkDeviceCreateInfo::pNext, with
  // pEnabledFeatures null. A host may set further features in it.
  void *device_create_next;
} SgsRequirementsInfo;

// Device of the host, and what is enabled on it.
typedef struct {
  // sizeof(SgsHostDevice)
  uint32_t struct_size;
  // Queue family of the queue and of the command buffers.
  uint32_t queue_family;
  // Instance that the device belongs to.
  const SgsInstance *instance;
  // Vulkan device.
  VkDevice device;
  // Queue of that family. Null if the host submits everything itself; only recording is possible then.
  VkQueue queue;
  // Function that is called before the queue is used. Null if no other thread uses the queue.
  void (*lock_queue)(void *user);
  // Function that is called right after the queue is used.
  void (*unlock_queue)(void *user);
  // Argument of both functions.
  void *user;
  // Enabled features, of those that the requirements name.
  const char *const *features;
  // Enabled device extensions. Optional extensions that are not named are not used.
  const char *const *extensions;
  // Number of features.
  uint32_t feature_count;
  // Number of extensions.
  uint32_t extension_count;
  // Directory of compiled pipelines; null for none.
  const char *pipeline_cache;
  // Seconds after which a wait for the library's own work fails; 0 for 300.
  double timeout_seconds;
} SgsHostDevice;

// Gaussians on the device.
typedef uint64_t SgsScene;

// Description of a scene.
typedef struct {
  // sizeof(SgsSceneInfo)
  uint32_t struct_size;
  // Number of Gaussians.
  uint32_t gaussians;
  // Highest band of spherical harmonics.
  uint32_t sh_degree;
  // Not 0 if the Gaussians have normals.
  uint32_t normals;
  // Bytes of device memory.
  uint64_t bytes;
} SgsSceneInfo;

// Cameras from a file.
typedef uint64_t SgsCameras;

// Pinhole camera. Axes: x right, y down, z forward. The center of the first pixel is at (0.5, 0.5).
typedef struct {
  // sizeof(SgsCamera)
  uint32_t struct_size;
  // Width in pixels.
  uint32_t width;
  // Height in pixels.
  uint32_t height;
  // Distance of the near plane; 0 for 0.01.
  float near_plane;
  // Focal lengths in pixels.
  float focal[2];
  // Principal point in pixels.
  float center[2];
  // Transform from world to camera, three rows of four: a rotation or a mirror, and a translation.
  float world_to_camera[12];
} SgsCamera;

// Parameters of rendering to memory.
typedef struct {
  // sizeof(SgsRenderInfo)
  uint32_t struct_size;
  // SGS_LAYER_...; three floats per pixel for colors and normals, one for depth and alpha.
  uint32_t layer;
  // Display-referred background of colors.
  float background[3];
  // Highest band of spherical harmonics to use, plus one; 0 for all.
  uint32_t sh_bands;
} SgsRenderInfo;

// Parameters of a view.
typedef struct {
  // sizeof(SgsViewInfo)
  uint32_t struct_size;
  // Width of the images in pixels.
  uint32_t width;
  // Height of the images in pixels.
  uint32_t height;
  // VkFormat: R8G8B8A8 or B8G8R8A8, UNORM or SRGB; R16G16B16A16 or R32G32B32A32, SFLOAT.
  uint32_t format;
  // SGS_LAYER_...; the fourth component is alpha.
  uint32_t layer;
  // SGS_ENCODING_...
  uint32_t encoding;
  // Factor on depths; 0 for 1.
  float depth_scale;
  // VkImageLayout of an image before rendering. VK_IMAGE_LAYOUT_UNDEFINED is allowed.
  uint32_t initial_layout;
  // VkImageLayout of the image after rendering.
  uint32_t final_layout;
  // Number of frames that may be in flight together; 0 for 2.
  uint32_t frames_in_flight;
} SgsViewInfo;

// Renderer into images of one size and format.
typedef uint64_t SgsView;

// Frame of a view.
typedef struct {
  // sizeof(SgsFrame)
  uint32_t struct_size;
  // Highest band of spherical harmonics to use, plus one; 0 for all.
  uint32_t sh_bands;
  // Image of the host. It has the view's size and format, two dimensions, one sample, and transfer-destination
  // usage.
  VkImage image;
  // Camera, of the view's size.
  const SgsCamera *camera;
  // Display-referred background of colors.
  float background[3];
} SgsFrame;

// Frame in a command buffer of the host.
typedef uint64_t SgsRecording;

// Semaphore to wait for or to signal.
typedef struct {
  // Vulkan semaphore.
  VkSemaphore semaphore;
  // Value of a timeline semaphore. Ignored for a binary semaphore.
  uint64_t value;
} SgsSemaphore;

// Device report on the frames of a view, some frames late.
typedef struct {
  // sizeof(SgsViewReport)
  uint32_t struct_size;
  // Number of frames that are done.
  uint32_t frames;
  // Of these, frames that lacked memory and show the background alone. Later frames have the memory.
  uint32_t incomplete;
  // Number of recordings that are not done yet.
  uint32_t recordings;
} SgsViewReport;

// Options for opening a run for relighting.
typedef struct {
  // sizeof(SgsRelightInfo)
  uint32_t struct_size;
  // Capacity for lights. Views rebuild their plans when it is exceeded. 0 for 16 more than the run has.
  uint32_t light_capacity;
} SgsRelightInfo;

// Run whose light can be changed.
typedef uint64_t SgsRelight;

// State of a relighting.
typedef struct {
  // sizeof(SgsRelightState)
  uint32_t struct_size;
  // Number of Gaussians, including inserted ones.
  uint32_t gaussians;
  // Number of lights.
  uint32_t lights;
  // Capacity for lights.
  uint32_t light_capacity;
  // Not 0 if the run has metallic.
  uint32_t metallic;
  // Not 0 if the run models the occlusion of lights.
  uint32_t visibility;
  // Not 0 if the relighting has an environment map, or windows show one.
  uint32_t environment;
  // Texels along an edge of the environment map's cube.
  uint32_t environment_size;
  // Not 0 if emitters with bounces light the scene. They are its lights.
  uint32_t emitters;
} SgsRelightState;

// Light. sgs_relight_light_set applies every field: get a light, change it, set it.
typedef struct {
  // sizeof(SgsLight)
  uint32_t struct_size;
  // Not 0 if the light is on.
  uint32_t on;
  // Position of the light.
  float position[3];
  // Factor of the intensity.
  float gain;
  // Factors of red, green and blue; 1 for the loaded color.
  float color[3];
} SgsLight;

// Light to add.
typedef struct {
  // sizeof(SgsNewLight)
  uint32_t struct_size;
  // Sharpness of the lobe around the axis; 0 for the same intensity in all directions.
  float sharpness;
  // Position of the light.
  float position[3];
  // Radiant intensity along the axis, in the units of the images.
  float intensity[3];
  // Direction from the lit point to the light. Ignored if the sharpness is 0.
  float axis[3];
} SgsNewLight;

// Parameters of rendering a relighting to memory.
typedef struct {
  // sizeof(SgsRelitInfo)
  uint32_t struct_size;
  // SGS_LAYER_SHADED and the layers after it. One float per pixel for roughness, metallic and visibility, else
  // three, linear.
  uint32_t layer;
  // Display-referred background of SGS_LAYER_SHADED.
  float background[3];
  // Exposure in stops. Light is multiplied by two to the power of this.
  float exposure;
} SgsRelitInfo;

// Emitter of a run, in world units. Fields that its shape does not have are ignored, and 0 if the library fills them.
typedef struct {
  // sizeof(SgsEmitter)
  uint32_t struct_size;
  // SGS_EMITTER_...
  uint32_t shape;
  // Linear red, green and blue. Radiance of spheres, rectangles and disks, radiant intensity of points, spots and
  // lobes, irradiance of directional light, factor on the environment of windows.
  float color[3];
  // Center; the corner of a rectangle or window where both edges begin. 0 for directional light.
  float position[3];
  // First edge of a rectangle or window; else normal of a disk, axis of a spot or lobe, direction of directional light.
  float axis[3];
  // Second edge of a rectangle or window, perpendicular to the first.
  float side[3];
  // Radius of a sphere or a disk.
  float radius;
  // Inner and outer angle of a spot in degrees; angular radius of directional light, and 0.
  float angles[2];
  // Sharpness of a lobe.
  float sharpness;
} SgsEmitter;

// Options for opening a trainer.
typedef struct {
  // sizeof(SgsTrainerInfo)
  uint32_t struct_size;
  // Not 0: continue the run in `run` with its settings.
  uint32_t resume;
  // Scene directory.
  const char *dataset;
  // Settings as TOML text, as in config.toml of a run. Null for the settings of the run that is resumed or gets
  // materials, else for the defaults.
  const char *settings;
  // Run directory that receives checkpoints, log and results, as in `sgs train`. The trainer rolls back after
  // divergence. Null trains in memory, where divergence is an error. Steps since the last checkpoint are lost unless
  // they are saved.
  const char *run;
  // Geometry for the intrinsic stage without a geometry stage. A PLY or glTF file. Null for scene.ply of the run.
  const char *start;
  // Sum of SGS_STAGE_GEOMETRY, SGS_STAGE_INTRINSIC and SGS_STAGE_TRANSPORT; 0 is SGS_STAGE_GEOMETRY.
  uint32_t stages;
} SgsTrainerInfo;

// Training in progress.
typedef uint64_t SgsTrainer;

// Progress of a training.
typedef struct {
  // sizeof(SgsTrainStatus)
  uint32_t struct_size;
  // Finished steps of the stage.
  uint32_t step;
  // Steps of the stage in all.
  uint32_t steps;
  // Not 0 once all stages are finished.
  uint32_t finished;
  // Number of Gaussians after the last step.
  uint32_t gaussians;
  // Loss of the last step, or 0 before the first.
  float loss;
  // Stage: SGS_STAGE_GEOMETRY, SGS_STAGE_INTRINSIC or SGS_STAGE_TRANSPORT.
  uint32_t stage;
  // Rollbacks of the stage after divergence.
  uint32_t roll_backs;
} SgsTrainStatus;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// Returns the version of the library. Encoded as major * 1000000 + minor * 1000 + patch.
uint32_t sgs_version(void);

// Returns the version as text.
const char *sgs_version_text(void);

// Returns the meaning of a result, in a few words.
const char *sgs_result_text(int32_t result);

// Opens a device for the library alone. `info` may be null. On failure `error`, if not null, holds the reason.
SgsResult sgs_context_open(const SgsDeviceInfo *info, SgsContext **context, char *error, size_t error_size);

// Destroys a context with all its objects and sets the pointer to null. The host has waited for its submissions of
// recordings. No other call on the context is in progress, and none follows.
SgsResult sgs_context_destroy(SgsContext **context);

// Copies the text of the context's last error, as much as fits. `needed`, if not null, receives the number of bytes of
// the whole text, including the terminating zero.
SgsResult sgs_last_error(const SgsContext *context,
                         char *text,
                         size_t size,
                         size_t *needed);

// Returns the state of the context.
SgsResult sgs_context_get(const SgsContext *context, SgsContextInfo *info);

// Destroys an object of any kind. A recording can only be ended by sgs_recording_timeline, sgs_recording_fence or
// sgs_recording_done.
SgsResult sgs_destroy(const SgsContext *context, SgsHandle object);

// Queries the requirements of a physical device. A device that lacks a requirement is no error: see
// SgsRequirementsInfo.missing. On failure `error`, if not null, holds the reason.
SgsResult sgs_requirements_create(const SgsInstance *info,
                                  SgsRequirements **requirements,
                                  char *error,
                                  size_t error_size);

// Returns the requirements. Its pointers live as long as the requirements.
SgsResult sgs_requirements_get(SgsRequirements *requirements, SgsRequirementsInfo *info);

// Destroys the requirements and sets the pointer to null.
SgsResult sgs_requirements_destroy(SgsRequirements **requirements);

// Adopts a device of the host. Instance, device and queue stay alive until the context is destroyed. The named
// features and extensions are enabled. The host uses the queue only under the lock that it passes. On failure `error`,
// if not null, holds the reason.
SgsResult sgs_context_adopt(const SgsHostDevice *info,
                            SgsContext **context,
                            char *error,
                            size_t error_size);

// Loads Gaussians from a PLY file or a run directory.
SgsResult sgs_scene_load(const SgsContext *context, const char *path, SgsScene *scene);

// Returns the description of a scene.
SgsResult sgs_scene_get(const SgsContext *context, SgsScene scene, SgsSceneInfo *info);

// Writes the Gaussians as a PLY file for viewers.
SgsResult sgs_scene_export(const SgsContext *context, SgsScene scene, const char *path);

// Loads the cameras of a transforms file.
SgsResult sgs_cameras_load(const SgsContext *context, const char *path, SgsCameras *cameras);

// Returns the number of cameras.
SgsResult sgs_cameras_count(const SgsContext *context, SgsCameras cameras, uint32_t *count);

// Returns one of the cameras.
SgsResult sgs_cameras_get(const SgsContext *context, SgsCameras cameras, uint32_t index, SgsCamera *camera);

// Renders one layer into the caller's memory and waits. Rows start at the top. The layer determines the number of
// floats per pixel. `count`: capacity of `pixels` in floats.
SgsResult sgs_render(const SgsContext *context,
                     SgsScene scene,
                     const SgsCamera *camera,
                     const SgsRenderInfo *info,
                     float *pixels,
                     size_t count);

// Creates a view of a scene for images of one size and format. The scene may be destroyed before the view.
SgsResult sgs_view_create(const SgsContext *context, SgsScene scene, const SgsViewInfo *info, SgsView *view);

// Records a frame into a command buffer of the host.
//
// The frame runs after everything recorded before it and before everything recorded after it. The command buffer is in
// the recording state, outside a render pass, used by this thread, and from a pool of the context's queue family. It
// is submitted at most once at a time: to the context's queue, or ordered by the host against all other work of the
// context. The call changes the bound compute pipeline, its descriptor set 0 and push constants. After an error the
// command buffer must be recorded again.
//
// The recording is held until sgs_recording_timeline, sgs_recording_fence or sgs_recording_done is called for it.
// Returns SGS_ERROR_BUSY if as many recordings are held as frames may be in flight.
SgsResult sgs_view_record(const SgsContext *context,
                          SgsView view,
                          const SgsFrame *frame,
                          VkCommandBuffer commands,
                          SgsRecording *recording);

// Ends a recording whose submission signals a timeline semaphore. The submission is done when the semaphore reaches
// `value`. The semaphore belongs to the device and lives until sgs_view_report shows the recording done, or the view
// is destroyed. The handle becomes invalid.
SgsResult sgs_recording_timeline(const SgsContext *context,
                                 SgsRecording recording,
                                 VkSemaphore semaphore,
                                 uint64_t value);

// Ends a recording whose submission is done when a fence is signaled. The fence is neither reset nor destroyed before
// that. The handle becomes invalid.
SgsResult sgs_recording_fence(const SgsContext *context,
                              SgsRecording recording,
                              VkFence fence);

// Ends a recording whose submission is done or will never be made. The handle becomes invalid.
SgsResult sgs_recording_done(const SgsContext *context, SgsRecording recording);

// Submits a frame to the context's queue. The frame waits for some semaphores and signals others. The semaphores
// belong to the device. Each signal to wait for has been submitted, and each value to signal is new.
SgsResult sgs_view_submit(const SgsContext *context,
                          SgsView view,
                          const SgsFrame *frame,
                          const SgsSemaphore *waits,
                          uint32_t wait_count,
                          const SgsSemaphore *signals,
                          uint32_t signal_count);

// Waits for the frames that sgs_view_submit has submitted.
SgsResult sgs_view_wait(const SgsContext *context, SgsView view);

// Returns the report on frames that are done. Does not wait.
SgsResult sgs_view_report(const SgsContext *context, SgsView view, SgsViewReport *report);

// Opens a run directory with trained materials, or a PLY file with materials. A run directory has scene.ply,
// lights.json, environment.exr and visibility.safetensors. A PLY file has no light of its own. A run with emitters.json
// is lit by its emitters with bounces if its scene is there; opening it waits for their solve. `info` may be null.
SgsResult sgs_relight_open(const SgsContext *context,
                           const char *run,
                           const SgsRelightInfo *info,
                           SgsRelight *relight);

// Returns the state of a relighting.
SgsResult sgs_relight_get(const SgsContext *context, SgsRelight relight, SgsRelightState *state);

// Applies an edit to the run as it is on disk. Earlier changes are discarded. `json`: text as for `sgs relight --edit`
// (docs/guide/relight.md). Paths in it are relative to `folder`, or to the working directory if `folder` is null.
// After an error the state is unchanged.
SgsResult sgs_relight_edit(const SgsContext *context,
                           SgsRelight relight,
                           const char *json,
                           const char *folder);

// Restores the run as it is on disk.
SgsResult sgs_relight_reset(const SgsContext *context, SgsRelight relight);

// Returns the number of lights.
SgsResult sgs_relight_light_count(const SgsContext *context, SgsRelight relight, uint32_t *count);

// Returns one of the lights, numbered from 0 as in lights.json.
// If emitters light the scene, their numbers are those of emitters.json.
SgsResult sgs_relight_light_get(const SgsContext *context, SgsRelight relight, uint32_t index, SgsLight *light);

// Changes a light. Takes effect in frames that are recorded or submitted from now on. Neither allocates nor waits.
// A moved emitter also submits the trace and the solve of its bounces to the queue; later frames show them.
SgsResult sgs_relight_light_set(const SgsContext *context,
                                SgsRelight relight,
                                uint32_t index,
                                const SgsLight *light);

// Adds a light after the others. `index`, if not null, receives its number. Beyond the capacity, the capacity doubles
// and views rebuild their plans at their next frames. In a run with emitters the light is an emitter, as if
// sgs_relight_emitter_add had added a point or a lobe.
SgsResult sgs_relight_light_add(const SgsContext *context,
                                SgsRelight relight,
                                const SgsNewLight *light,
                                uint32_t *index);

// Removes a light or an emitter. The numbers of those after it decrease by one. The surface of a removed emitter is
// dark. Neither allocates nor waits.
SgsResult sgs_relight_light_remove(const SgsContext *context, SgsRelight relight, uint32_t index);

// Replaces the environment map. `rgb`: a latitude-longitude map, twice as wide as high, rows from the top, three
// floats per pixel, linear. In a run with emitters, windows show it. Allocates memory and waits for the device, unlike
// sgs_relight_environment_gain.
SgsResult sgs_relight_environment_set(const SgsContext *context,
                                      SgsRelight relight,
                                      const float *rgb,
                                      uint32_t width,
                                      uint32_t height);

// Sets the factors of red, green and blue of the environment map. In a run with emitters they are those of the
// environment that windows show. They are 1 after loading, an edit and a reset. Neither allocates nor waits.
SgsResult sgs_relight_environment_gain(const SgsContext *context, SgsRelight relight, const float *rgb);

// Creates a view of a relighting for images of one size and format. Layers: SGS_LAYER_SHADED and those after it.
// Frames are recorded and submitted as those of other views. The relighting may be destroyed before the view.
SgsResult sgs_relight_view_create(const SgsContext *context,
                                  SgsRelight relight,
                                  const SgsViewInfo *info,
                                  SgsView *view);

// Sets the exposure of a view of a relighting. From the next frame on, light is multiplied by two to the power of
// `stops`.
SgsResult sgs_view_exposure(const SgsContext *context, SgsView view, float stops);

// Renders one layer into the caller's memory and waits. Rows start at the top; values are linear. Matches `sgs
// relight`, with a renderer and memory of its own: for images and comparisons, not for frames of an application.
SgsResult sgs_relight_render(const SgsContext *context,
                             SgsRelight relight,
                             const SgsCamera *camera,
                             const SgsRelitInfo *info,
                             float *pixels,
                             size_t count);

// Returns an emitter of a run, numbered from 0 as in emitters.json. Added emitters follow. Emitters are the lights of
// such a run: sgs_relight_light_count counts them, sgs_relight_light_set switches, dims, recolors and moves them, and
// sgs_relight_light_remove removes them. Shape and color are those without these changes. `name`, if not null, has space
// for `size` bytes and receives as much of the name as fits.
SgsResult sgs_relight_emitter_get(const SgsContext *context,
                                  SgsRelight relight,
                                  uint32_t index,
                                  SgsEmitter *emitter,
                                  char *name,
                                  size_t size);

// Adds an emitter after the others, switched on. `name` may be null; a name that another emitter has gets a number.
// `index`, if not null, receives its number. If an emitter was removed, the new one takes its place on the device
// without memory, waits or another plan; windows take those of windows, and others those of others. Else the call
// solves the bounces of all emitters and waits for them, and views rebuild their plans at their next frames. An added
// emitter lights the room, but has no surface that a camera sees. Directional light enters through openings only.
SgsResult sgs_relight_emitter_add(const SgsContext *context,
                                  SgsRelight relight,
                                  const SgsEmitter *emitter,
                                  const char *name,
                                  uint32_t *index);

// Replaces shape and color of an emitter: turns it, changes its size, or makes it another kind. Get an emitter, change
// it, set it. What sgs_relight_light_set changed is discarded, except whether it is on. Allocates no memory, does not
// wait, and submits the trace and the solve of its bounces to the queue. The surface of an emitter whose shape changes is
// dark. Windows stay windows, and others do not become windows.
SgsResult sgs_relight_emitter_set(const SgsContext *context,
                                  SgsRelight relight,
                                  uint32_t index,
                                  const SgsEmitter *emitter);

// Opens a dataset for training. Locks the run directory, if any, until the trainer is destroyed. Unless it resumes,
// removes the files of an unfinished training in that directory.
SgsResult sgs_trainer_open(const SgsContext *context, const SgsTrainerInfo *info, SgsTrainer *trainer);

// Trains for a time, and at least one step unless all are finished. Returns with no work left on the device. `status`
// may be null.
SgsResult sgs_train_step(const SgsContext *context,
                         SgsTrainer trainer,
                         double budget_seconds,
                         SgsTrainStatus *status);

// Writes settings, a checkpoint and the results of the stage into a run directory. Training can be resumed from it.
SgsResult sgs_trainer_save(const SgsContext *context, SgsTrainer trainer, const char *run);

// Writes the current Gaussians as a PLY file.
SgsResult sgs_trainer_export(const SgsContext *context, SgsTrainer trainer, const char *path);

// Returns a copy of the current Gaussians as a scene.
SgsResult sgs_trainer_scene(const SgsContext *context, SgsTrainer trainer, SgsScene *scene);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* SGS_H */
