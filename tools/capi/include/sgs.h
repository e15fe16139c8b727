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

// Of relightings: all light, over the background.
#define SGS_LAYER_SHADED 16

// Of relightings: linear albedo.
#define SGS_LAYER_ALBEDO 17

// Of relightings: roughness.
#define SGS_LAYER_ROUGHNESS 18

// Of relightings: metallic.
#define SGS_LAYER_METALLIC 19

// Of relightings: diffuse light, over black.
#define SGS_LAYER_DIFFUSE 20

// Of relightings: specular light, over black.
#define SGS_LAYER_SPECULAR 21

// Of relightings: how much of the lights is seen, mean over all of them.
#define SGS_LAYER_VISIBILITY 22

// Of relightings: light of the surroundings, over the surroundings themselves.
#define SGS_LAYER_ENVIRONMENT 23

// Of relightings: light of lamps, over black.
#define SGS_LAYER_DIRECT 24

// Colors as blended, that is sRGB-encoded.
#define SGS_ENCODING_DISPLAY 0

// Colors in linear light. Images whose format decodes sRGB hold encoded values either way.
#define SGS_ENCODING_LINEAR 1

// How a call ended.
enum SgsResult
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
  // Done.
  SGS_OK = 0,
  // A pointer that is needed is null.
  SGS_ERROR_NULL = -1,
  // A value is not one of those that are possible.
  SGS_ERROR_ARGUMENT = -2,
  // A struct's size is none that this library knows.
  SGS_ERROR_STRUCT_SIZE = -3,
  // No such object, or not any more, or an object of another kind or context.
  SGS_ERROR_HANDLE = -4,
  // A file cannot be read or written.
  SGS_ERROR_FILE = -5,
  // There is no such device, or it lacks something.
  SGS_ERROR_DEVICE = -6,
  // The device was lost.
  SGS_ERROR_LOST = -7,
  // Memory ran out.
  SGS_ERROR_MEMORY = -8,
  // Earlier recordings are not done, or work did not finish in time; try again later.
  SGS_ERROR_BUSY = -9,
  // Training cannot go on.
  SGS_ERROR_TRAINING = -10,
  // A buffer of the caller's is too small.
  SGS_ERROR_SPACE = -11,
  // A defect of this library. The context can only be destroyed.
  SGS_ERROR_INTERNAL = -12,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum SgsResult SgsResult;
#else
typedef int32_t SgsResult;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// A device, and everything made on it.
typedef struct SgsContext SgsContext;

// What one device needs to have enabled.
typedef struct SgsRequirements SgsRequirements;

// A device of the library's own.
typedef struct {
  // sizeof(SgsDeviceInfo)
  uint32_t struct_size;
  // Not 0: with validation, whose messages sgs_context_get counts.
  uint32_t validation;
  // Index or part of the name; null for the best one.
  const char *device;
  // A folder for compiled pipelines; null for none.
  const char *pipeline_cache;
  // After how long a wait gives up; 0 for five minutes.
  double timeout_seconds;
} SgsDeviceInfo;

// What is known of a context.
typedef struct {
  // sizeof(SgsContextInfo)
  uint32_t struct_size;
  // Not 0 if the device is the host's.
  uint32_t adopted;
  // Bytes of device memory in use.
  uint64_t bytes_used;
  // The most there were.
  uint64_t bytes_peak;
  // Messages of the validation layer since the last call; only for a device of the library's own.
  uint32_t validation_messages;
  // Objects that exist.
  uint32_t objects;
} SgsContextInfo;

// Any object of a context; 0 is none.
typedef uint64_t SgsHandle;

// A host's instance, and the physical device that it has chosen.
typedef struct {
  // sizeof(SgsInstance)
  uint32_t struct_size;
  // VkApplicationInfo::apiVersion of the instance.
  uint32_t api_version;
  // Every other function is found through it.
  SgsGetInstanceProcAddr get_instance_proc_addr;
  // The instance.
  VkInstance instance;
  // The physical device.
  VkPhysicalDevice physical_device;
  // Not 0 if VK_EXT_debug_utils is enabled on the instance: objects then get names, passes labels.
  uint32_t debug_utils;
} SgsInstance;

// What a device needs to have enabled. Pointers live as long as the SgsRequirements.
typedef struct {
  // sizeof(SgsRequirementsInfo)
  uint32_t struct_size;
  // Lowest VkApplicationInfo::apiVersion.
  uint32_t api_version;
  // The device's name.
  const char *device_name;
  // What the device lacks; with any of these it cannot be used.
  const char *const *missing;
  // How many.
  uint32_t missing_count;
  // A queue family that can compute.
  uint32_t queue_family;
  // Features to enable: first the required ones, then those that are used where they are enabled.
  const char *const *features;
  // How many, all together.
  uint32_t feature_count;
  // How many of them are required.
  uint32_t required_feature_count;
  // Device extensions to enable, the required ones first.
  const char *const *extensions;
  // How many, all together.
  uint32_t extension_count;
  // How many of them are required.
  uint32_t required_extension_count;
  // VkPhysicalDeviceFeatures2 with everything behind it that enables all of these features: for
  // VkDeviceCreateInfo::pNext, with pEnabledFeatures null. A host may set further features in it.
  void *device_create_next;
} SgsRequirementsInfo;

// A device of the host's, and what is enabled on it.
typedef struct {
  // sizeof(SgsHostDevice)
  uint32_t struct_size;
  // The queue family of the queue and of the command buffers.
  uint32_t queue_family;
  // Where the device comes from.
  const SgsInstance *instance;
  // The device.
  VkDevice device;
  // A queue of that family; null if the host submits everything itself, which leaves only recording.
  VkQueue queue;
  // Called before the queue is used; null if nobody else uses it.
  void (*lock_queue)(void *user);
  // Called right after.
  void (*unlock_queue)(void *user);
  // Passed to both.
  void *user;
  // Features that are enabled, of those that the requirements name.
  const char *const *features;
  // Device extensions that are enabled; optional ones that are not named are not used.
  const char *const *extensions;
  // How many features.
  uint32_t feature_count;
  // How many extensions.
  uint32_t extension_count;
  // A folder for compiled pipelines; null for none.
  const char *pipeline_cache;
  // After how long a wait for the library's own work gives up; 0 for five minutes.
  double timeout_seconds;
} SgsHostDevice;

// Gaussians on the device.
typedef uint64_t SgsScene;

// What is known of a scene.
typedef struct {
  // sizeof(SgsSceneInfo)
  uint32_t struct_size;
  // How many Gaussians.
  uint32_t gaussians;
  // Highest band of spherical harmonics.
  uint32_t sh_degree;
  // Not 0 if there are normals.
  uint32_t normals;
  // Bytes of device memory.
  uint64_t bytes;
} SgsSceneInfo;

// Cameras from a file.
typedef uint64_t SgsCameras;

// A pinhole camera: x right, y down, z forward; the middle of the first pixel is at (0.5, 0.5).
typedef struct {
  // sizeof(SgsCamera)
  uint32_t struct_size;
  // Columns.
  uint32_t width;
  // Rows.
  uint32_t height;
  // Nothing nearer is seen; 0 for 0.01.
  float near_plane;
  // Focal lengths in pixels.
  float focal[2];
  // The principal point in pixels.
  float center[2];
  // From the world to the camera, three rows of four: a rotation or a mirror, and a translation.
  float world_to_camera[12];
} SgsCamera;

// What is rendered to memory.
typedef struct {
  // sizeof(SgsRenderInfo)
  uint32_t struct_size;
  // SGS_LAYER_...; three floats a pixel for colors and normals, one for depth and alpha.
  uint32_t layer;
  // What lies behind colors, display-referred.
  float background[3];
  // Highest band of spherical harmonics to use, plus one; 0 for all.
  uint32_t sh_bands;
} SgsRenderInfo;

// What a view renders into.
typedef struct {
  // sizeof(SgsViewInfo)
  uint32_t struct_size;
  // Columns of the images.
  uint32_t width;
  // Rows.
  uint32_t height;
  // VkFormat: R8G8B8A8 or B8G8R8A8, UNORM or SRGB; R16G16B16A16 or R32G32B32A32, SFLOAT.
  uint32_t format;
  // SGS_LAYER_...; the fourth component is alpha.
  uint32_t layer;
  // SGS_ENCODING_...
  uint32_t encoding;
  // Factor on depths; 0 for 1.
  float depth_scale;
  // VkImageLayout in which the library finds an image; VK_IMAGE_LAYOUT_UNDEFINED will do.
  uint32_t initial_layout;
  // VkImageLayout in which the library leaves it.
  uint32_t final_layout;
  // Frames that may be in flight together; 0 for 2.
  uint32_t frames_in_flight;
} SgsViewInfo;

// A way of rendering into images.
typedef uint64_t SgsView;

// One frame of a view.
typedef struct {
  // sizeof(SgsFrame)
  uint32_t struct_size;
  // Highest band of spherical harmonics to use, plus one; 0 for all.
  uint32_t sh_bands;
  // The host's image: of the view's size and format, two-dimensional, one sample, with transfer-destination usage.
  VkImage image;
  // From where, of the view's size.
  const SgsCamera *camera;
  // What lies behind colors, display-referred.
  float background[3];
} SgsFrame;

// A frame in a host's command buffer.
typedef uint64_t SgsRecording;

// A semaphore to wait for or to signal.
typedef struct {
  // The semaphore.
  VkSemaphore semaphore;
  // The value of a timeline semaphore; of no meaning for a binary one.
  uint64_t value;
} SgsSemaphore;

// What the device has said of a view's frames, some frames late.
typedef struct {
  // sizeof(SgsViewReport)
  uint32_t struct_size;
  // Frames that are done.
  uint32_t frames;
  // Of these, the ones that lacked room and show the background alone; later ones have it.
  uint32_t incomplete;
  // Recordings that are not done yet.
  uint32_t recordings;
} SgsViewReport;

// How a run is opened to be relit.
typedef struct {
  // sizeof(SgsRelightInfo)
  uint32_t struct_size;
  // Lights that there is room for before views make their plans anew; 0 for 16 more than the run has.
  uint32_t light_capacity;
} SgsRelightInfo;

// A run whose light changes.
typedef uint64_t SgsRelight;

// What is known of a relighting.
typedef struct {
  // sizeof(SgsRelightState)
  uint32_t struct_size;
  // How many Gaussians, with those put in.
  uint32_t gaussians;
  // How many lights.
  uint32_t lights;
  // How many there is room for.
  uint32_t light_capacity;
  // Not 0 if there is metallic.
  uint32_t metallic;
  // Not 0 if something is in the way of lights.
  uint32_t visibility;
  // Not 0 if there are surroundings.
  uint32_t environment;
  // Texels along an edge of the cube that surroundings become.
  uint32_t environment_size;
} SgsRelightState;

// A light. sgs_relight_light_set takes every field as it is: get it, change it, set it.
typedef struct {
  // sizeof(SgsLight)
  uint32_t struct_size;
  // Not 0 if it shines.
  uint32_t on;
  // Where it is.
  float position[3];
  // Factor of its light.
  float gain;
  // Factors of red, green and blue; 1 for as it was loaded.
  float color[3];
} SgsLight;

// A new light.
typedef struct {
  // sizeof(SgsNewLight)
  uint32_t struct_size;
  // How narrow it shines around the axis; 0 for the same in all directions.
  float sharpness;
  // Where it is.
  float position[3];
  // Radiant intensity along the axis, in the units of the pictures.
  float intensity[3];
  // From what is lit to the light; of no meaning without sharpness.
  float axis[3];
} SgsNewLight;

// What of a relighting is rendered to memory.
typedef struct {
  // sizeof(SgsRelitInfo)
  uint32_t struct_size;
  // SGS_LAYER_SHADED and its like; one float a pixel for roughness, metallic and visibility, else three, linear.
  uint32_t layer;
  // What lies behind SGS_LAYER_SHADED, display-referred.
  float background[3];
  // Light is multiplied by two to the power of this.
  float exposure;
} SgsRelitInfo;

// What is trained on.
typedef struct {
  // sizeof(SgsTrainerInfo)
  uint32_t struct_size;
  // Not 0: continue the run in `run` with its settings.
  uint32_t resume;
  // The scene directory.
  const char *dataset;
  // Settings as TOML text, as in config.toml of a run. Null for those of the run that is resumed or gets materials, else for the
  // defaults.
  const char *settings;
  // Run directory to train into, as `sgs train` does: checkpoints, log, rollback after divergence, results. Null trains in memory;
  // divergence is then an error. Steps since the last checkpoint are lost unless they are saved.
  const char *run;
  // Geometry for the intrinsic stage where the geometry stage is not trained: a PLY or glTF file. Null for scene.ply of the run.
  const char *start;
  // Sum of SGS_STAGE_GEOMETRY and SGS_STAGE_INTRINSIC; 0 is SGS_STAGE_GEOMETRY.
  uint32_t stages;
} SgsTrainerInfo;

// A training under way.
typedef uint64_t SgsTrainer;

// How far a training is.
typedef struct {
  // sizeof(SgsTrainStatus)
  uint32_t struct_size;
  // Finished steps of the stage.
  uint32_t step;
  // Steps of the stage in all.
  uint32_t steps;
  // Not 0 once all stages are finished.
  uint32_t finished;
  // Gaussians after the last step.
  uint32_t gaussians;
  // The loss of the last step, or 0 before the first.
  float loss;
  // The stage: SGS_STAGE_GEOMETRY or SGS_STAGE_INTRINSIC.
  uint32_t stage;
  // Rollbacks of the stage after divergence.
  uint32_t roll_backs;
} SgsTrainStatus;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// The library's version: major * 1000000 + minor * 1000 + patch.
uint32_t sgs_version(void);

// The version as text.
const char *sgs_version_text(void);

// What a result means, in a few words.
const char *sgs_result_text(int32_t result);

// Opens a device of the library's own. `info` may be null. On failure `error`, if not null, holds why.
SgsResult sgs_context_open(const SgsDeviceInfo *info, SgsContext **context, char *error, size_t error_size);

// Destroys a context with everything on it, and sets the pointer to null. The host has waited for its submissions that
// hold recordings; no other call on the context is under way, and none comes after.
SgsResult sgs_context_destroy(SgsContext **context);

// Copies the text of the context's last error, as much as fits. `needed`, if not null, gets the bytes that all of it
// takes, with the zero at its end.
SgsResult sgs_last_error(const SgsContext *context,
                         char *text,
                         size_t size,
                         size_t *needed);

// What is known of the context.
SgsResult sgs_context_get(const SgsContext *context, SgsContextInfo *info);

// Destroys an object of any kind. A recording can be destroyed only by sgs_recording_done and its like.
SgsResult sgs_destroy(const SgsContext *context, SgsHandle object);

// Asks what a physical device needs to have enabled. A device that lacks something is no error: see
// SgsRequirementsInfo.missing. On failure `error`, if not null, holds why.
SgsResult sgs_requirements_create(const SgsInstance *info,
                                  SgsRequirements **requirements,
                                  char *error,
                                  size_t error_size);

// The answer. Its pointers live as long as the requirements.
SgsResult sgs_requirements_get(SgsRequirements *requirements, SgsRequirementsInfo *info);

// Destroys the requirements and sets the pointer to null.
SgsResult sgs_requirements_destroy(SgsRequirements **requirements);

// Moves into a host's device. Instance, device and queue stay alive until the context is destroyed; the features and
// extensions that are named are enabled; the host uses the queue only under the lock that it passes. On failure `error`,
// if not null, holds why.
SgsResult sgs_context_adopt(const SgsHostDevice *info,
                            SgsContext **context,
                            char *error,
                            size_t error_size);

// Loads Gaussians: a PLY file, or the directory of a run.
SgsResult sgs_scene_load(const SgsContext *context, const char *path, SgsScene *scene);

// What is known of a scene.
SgsResult sgs_scene_get(const SgsContext *context, SgsScene scene, SgsSceneInfo *info);

// Writes the Gaussians as a PLY file that viewers understand.
SgsResult sgs_scene_export(const SgsContext *context, SgsScene scene, const char *path);

// Loads the cameras of a transforms file.
SgsResult sgs_cameras_load(const SgsContext *context, const char *path, SgsCameras *cameras);

// How many cameras there are.
SgsResult sgs_cameras_count(const SgsContext *context, SgsCameras cameras, uint32_t *count);

// One of the cameras.
SgsResult sgs_cameras_get(const SgsContext *context, SgsCameras cameras, uint32_t index, SgsCamera *camera);

// Renders one layer into the caller's memory and waits: rows from the top, as many floats a pixel as the layer has.
// `count` is how many floats there is room for.
SgsResult sgs_render(const SgsContext *context,
                     SgsScene scene,
                     const SgsCamera *camera,
                     const SgsRenderInfo *info,
                     float *pixels,
                     size_t count);

// Prepares rendering of a scene into images of one size and format. The scene may be destroyed before the view.
SgsResult sgs_view_create(const SgsContext *context, SgsScene scene, const SgsViewInfo *info, SgsView *view);

// Records a frame into a host's command buffer, behind everything recorded before and before everything after. The
// command buffer is being recorded outside a render pass, by this thread, from a pool of the context's queue family. It
// is submitted at most once at a time, to the context's queue or ordered by the host against everything else that the
// context does. The bound compute pipeline, its descriptor set 0 and push constants are changed. After an error the
// command buffer must be recorded anew.
//
// The recording is held until one of sgs_recording_timeline, sgs_recording_fence and sgs_recording_done is called for
// it. With as many held as there are frames in flight, SGS_ERROR_BUSY is returned.
SgsResult sgs_view_record(const SgsContext *context,
                          SgsView view,
                          const SgsFrame *frame,
                          VkCommandBuffer commands,
                          SgsRecording *recording);

// The submission with this recording is done when a timeline semaphore of the device reaches a value. The semaphore lives
// until sgs_view_report shows the recording done, or the view is destroyed. The handle ends.
SgsResult sgs_recording_timeline(const SgsContext *context,
                                 SgsRecording recording,
                                 VkSemaphore semaphore,
                                 uint64_t value);

// Likewise, when a fence is signaled; it is neither reset nor destroyed before.
SgsResult sgs_recording_fence(const SgsContext *context, SgsRecording recording, VkFence fence);

// The submission with this recording is done, or will never be made. The handle ends.
SgsResult sgs_recording_done(const SgsContext *context, SgsRecording recording);

// Submits a frame to the context's queue, after some semaphores and before others. The semaphores are the device's; each
// signal to be waited for has been submitted, and each value to be signaled is new.
SgsResult sgs_view_submit(const SgsContext *context,
                          SgsView view,
                          const SgsFrame *frame,
                          const SgsSemaphore *waits,
                          uint32_t wait_count,
                          const SgsSemaphore *signals,
                          uint32_t signal_count);

// Waits for the frames that sgs_view_submit has submitted.
SgsResult sgs_view_wait(const SgsContext *context, SgsView view);

// What is known of the frames that are done. Waits for nothing.
SgsResult sgs_view_report(const SgsContext *context, SgsView view, SgsViewReport *report);

// Opens a run directory whose materials were trained (scene.ply, lights.json, environment.exr, visibility.safetensors), or
// a PLY file with materials, which has no light of its own. `info` may be null.
SgsResult sgs_relight_open(const SgsContext *context,
                           const char *run,
                           const SgsRelightInfo *info,
                           SgsRelight *relight);

// What is known of a relighting.
SgsResult sgs_relight_get(const SgsContext *context, SgsRelight relight, SgsRelightState *state);

// Applies an edit, JSON text as `sgs relight --edit` takes it (docs/guide/relight.md), to the run as it is on disk: whatever was
// changed before is gone. Paths in it are meant beside `folder`, or, if that is null, where the program runs. After an
// error everything is as it was.
SgsResult sgs_relight_edit(const SgsContext *context,
                           SgsRelight relight,
                           const char *json,
                           const char *folder);

// Back to the run as it is on disk.
SgsResult sgs_relight_reset(const SgsContext *context, SgsRelight relight);

// How many lights there are.
SgsResult sgs_relight_light_count(const SgsContext *context, SgsRelight relight, uint32_t *count);

// One of the lights, numbered from 0 as in lights.json.
SgsResult sgs_relight_light_get(const SgsContext *context, SgsRelight relight, uint32_t index, SgsLight *light);

// Changes a light. Frames that are recorded or submitted from now on have it; nothing is made or waited for.
SgsResult sgs_relight_light_set(const SgsContext *context,
                                SgsRelight relight,
                                uint32_t index,
                                const SgsLight *light);

// Adds a light behind the others. `index`, if not null, gets its number. Past the capacity there will be twice as much, and
// views make their plans anew at their next frames.
SgsResult sgs_relight_light_add(const SgsContext *context,
                                SgsRelight relight,
                                const SgsNewLight *light,
                                uint32_t *index);

// Removes a light; the numbers of those behind it become one less.
SgsResult sgs_relight_light_remove(const SgsContext *context, SgsRelight relight, uint32_t index);

// Puts other surroundings there: a latitude-longitude map, twice as wide as high, rows from the top, three floats a pixel,
// linear. Takes memory and waits for the device, unlike sgs_relight_environment_gain.
SgsResult sgs_relight_environment_set(const SgsContext *context,
                                      SgsRelight relight,
                                      const float *rgb,
                                      uint32_t width,
                                      uint32_t height);

// Sets the factors of red, green and blue of the surroundings' light; 1 after loading, an edit and a reset. Nothing is made
// or waited for.
SgsResult sgs_relight_environment_gain(const SgsContext *context,
                                       SgsRelight relight,
                                       const float *rgb);

// Prepares rendering of a relighting into images of one size and format: SGS_LAYER_SHADED and its like. Frames are then
// recorded and submitted as those of other views. The relighting may be destroyed before the view.
SgsResult sgs_relight_view_create(const SgsContext *context,
                                  SgsRelight relight,
                                  const SgsViewInfo *info,
                                  SgsView *view);

// Sets the exposure of a relighting's view: light is multiplied by two to the power of `stops` from the next frame on.
SgsResult sgs_view_exposure(const SgsContext *context,
                            SgsView view,
                            float stops);

// Renders one layer into the caller's memory and waits: rows from the top, linear. Does what `sgs relight` does, by a way of
// its own, and takes memory for it: for pictures and comparisons, not for frames.
SgsResult sgs_relight_render(const SgsContext *context,
                             SgsRelight relight,
                             const SgsCamera *camera,
                             const SgsRelitInfo *info,
                             float *pixels,
                             size_t count);

// Opens a dataset for training. With a run directory it locks the directory until the trainer is destroyed and, unless it resumes, removes
// what an unfinished training left there.
SgsResult sgs_trainer_open(const SgsContext *context,
                           const SgsTrainerInfo *info,
                           SgsTrainer *trainer);

// Trains for a time, and at least one step unless all are done; returns with no work left on the device. `status` may be
// null.
SgsResult sgs_train_step(const SgsContext *context,
                         SgsTrainer trainer,
                         double budget_seconds,
                         SgsTrainStatus *status);

// Writes settings, a checkpoint and the current state of the stage into a run directory, from which training can continue.
SgsResult sgs_trainer_save(const SgsContext *context,
                           SgsTrainer trainer,
                           const char *run);

// Writes the Gaussians as they are as a PLY file.
SgsResult sgs_trainer_export(const SgsContext *context, SgsTrainer trainer, const char *path);

// The Gaussians as they are, as a scene of its own.
SgsResult sgs_trainer_scene(const SgsContext *context, SgsTrainer trainer, SgsScene *scene);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* SGS_H */
