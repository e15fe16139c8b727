/* A C program with a Vulkan device of its own that shows Gaussian splats in its own image.
 *
 *     host SCENE.ply OUT.ppm [RUN]
 *
 * It asks the library what a device needs, makes its instance and device, draws (clears) its image, has a view of the
 * splats recorded into the same command buffer, submits that, reads the image back and writes it as a PPM file. Then it
 * does the same by letting the library submit between its semaphores, and compares. With a run whose materials were
 * trained it then shows that under changing light, see relight(). Validation is on and must be silent.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <vulkan/vulkan.h>

#include "sgs.h"

enum { WIDTH = 96, HEIGHT = 64 };

static unsigned complaints;

static VKAPI_ATTR VkBool32 VKAPI_CALL on_message(VkDebugUtilsMessageSeverityFlagBitsEXT severity,
                                           VkDebugUtilsMessageTypeFlagsEXT type,
                                           const VkDebugUtilsMessengerCallbackDataEXT *data, void *user) {
    (void)severity, (void)type, (void)user;
    ++complaints;
    fprintf(stderr, "validation: %s\n", data->pMessage);
    return VK_FALSE;
}

static void vk(VkResult result, const char *what) {
    if (result != VK_SUCCESS) {
        fprintf(stderr, "%s: VkResult %d\n", what, (int)result);
        exit(1);
    }
}

static void stop(const char *what, const char *why) {
    fprintf(stderr, "%s: %s\n", what, why);
    exit(1);
}

static SgsContext *context;

static void sgs(SgsResult result, const char *what) {
    char text[1024] = "";
    if (result == SGS_OK) return;
    sgs_last_error(context, text, sizeof text, NULL);
    fprintf(stderr, "%s: %s: %s\n", what, sgs_result_text(result), text);
    exit(1);
}

/* The queue's lock; a program with threads has a mutex here. */
static int held, used;

static void lock_queue(void *user) {
    if (user != &held || held) abort();
    held = 1, ++used;
}

static void unlock_queue(void *user) {
    if (user != &held || !held) abort();
    held = 0;
}

static VkInstance instance;
static VkPhysicalDevice physical;
static VkDevice device;
static VkQueue queue;
static uint32_t family;

static uint32_t memory_type(uint32_t bits, VkMemoryPropertyFlags flags) {
    VkPhysicalDeviceMemoryProperties all;
    vkGetPhysicalDeviceMemoryProperties(physical, &all);
    for (uint32_t i = 0; i < all.memoryTypeCount; ++i)
        if ((bits & (1u << i)) && (all.memoryTypes[i].propertyFlags & flags) == flags) return i;
    stop("memory", "there is none of the kind");
    return 0;
}

static VkDeviceMemory allocate(VkMemoryRequirements needs, VkMemoryPropertyFlags flags) {
    VkMemoryAllocateInfo info = {VK_STRUCTURE_TYPE_MEMORY_ALLOCATE_INFO};
    VkDeviceMemory memory;
    info.allocationSize = needs.size;
    info.memoryTypeIndex = memory_type(needs.memoryTypeBits, flags);
    vk(vkAllocateMemory(device, &info, NULL, &memory), "vkAllocateMemory");
    return memory;
}

static void transition(VkCommandBuffer commands, VkImage image, VkImageLayout from, VkImageLayout to) {
    VkImageMemoryBarrier2 barrier = {VK_STRUCTURE_TYPE_IMAGE_MEMORY_BARRIER_2};
    VkDependencyInfo info = {VK_STRUCTURE_TYPE_DEPENDENCY_INFO};
    barrier.srcStageMask = barrier.dstStageMask = VK_PIPELINE_STAGE_2_ALL_COMMANDS_BIT;
    barrier.srcAccessMask = VK_ACCESS_2_MEMORY_WRITE_BIT;
    barrier.dstAccessMask = VK_ACCESS_2_MEMORY_READ_BIT | VK_ACCESS_2_MEMORY_WRITE_BIT;
    barrier.oldLayout = from;
    barrier.newLayout = to;
    barrier.srcQueueFamilyIndex = barrier.dstQueueFamilyIndex = VK_QUEUE_FAMILY_IGNORED;
    barrier.image = image;
    barrier.subresourceRange = (VkImageSubresourceRange){VK_IMAGE_ASPECT_COLOR_BIT, 0, 1, 0, 1};
    info.imageMemoryBarrierCount = 1;
    info.pImageMemoryBarriers = &barrier;
    vkCmdPipelineBarrier2(commands, &info);
}

static void read_back(VkCommandBuffer commands, VkImage image, VkBuffer into) {
    VkBufferImageCopy region = {0};
    VkMemoryBarrier2 barrier = {VK_STRUCTURE_TYPE_MEMORY_BARRIER_2};
    VkDependencyInfo info = {VK_STRUCTURE_TYPE_DEPENDENCY_INFO};
    region.imageSubresource = (VkImageSubresourceLayers){VK_IMAGE_ASPECT_COLOR_BIT, 0, 0, 1};
    region.imageExtent = (VkExtent3D){WIDTH, HEIGHT, 1};
    vkCmdCopyImageToBuffer(commands, image, VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL, into, 1, &region);
    barrier.srcStageMask = VK_PIPELINE_STAGE_2_COPY_BIT;
    barrier.srcAccessMask = VK_ACCESS_2_TRANSFER_WRITE_BIT;
    barrier.dstStageMask = VK_PIPELINE_STAGE_2_HOST_BIT;
    barrier.dstAccessMask = VK_ACCESS_2_HOST_READ_BIT;
    info.memoryBarrierCount = 1;
    info.pMemoryBarriers = &barrier;
    vkCmdPipelineBarrier2(commands, &info);
}

static VkCommandPool pool;

static VkCommandBuffer begin(void) {
    VkCommandBufferAllocateInfo info = {VK_STRUCTURE_TYPE_COMMAND_BUFFER_ALLOCATE_INFO};
    VkCommandBufferBeginInfo start = {VK_STRUCTURE_TYPE_COMMAND_BUFFER_BEGIN_INFO};
    VkCommandBuffer commands;
    info.commandPool = pool;
    info.commandBufferCount = 1;
    vk(vkAllocateCommandBuffers(device, &info, &commands), "vkAllocateCommandBuffers");
    vk(vkBeginCommandBuffer(commands, &start), "vkBeginCommandBuffer");
    return commands;
}

/* Ends and submits; waits for one value of the timeline and signals another, 0 being none. */
static void submit(VkCommandBuffer commands, VkSemaphore timeline, uint64_t wait, uint64_t signal) {
    VkCommandBufferSubmitInfo buffer = {VK_STRUCTURE_TYPE_COMMAND_BUFFER_SUBMIT_INFO};
    VkSemaphoreSubmitInfo before = {VK_STRUCTURE_TYPE_SEMAPHORE_SUBMIT_INFO}, after = before;
    VkSubmitInfo2 info = {VK_STRUCTURE_TYPE_SUBMIT_INFO_2};
    vk(vkEndCommandBuffer(commands), "vkEndCommandBuffer");
    buffer.commandBuffer = commands;
    before.semaphore = after.semaphore = timeline;
    before.stageMask = after.stageMask = VK_PIPELINE_STAGE_2_ALL_COMMANDS_BIT;
    before.value = wait;
    after.value = signal;
    info.waitSemaphoreInfoCount = wait > 0;
    info.pWaitSemaphoreInfos = &before;
    info.signalSemaphoreInfoCount = signal > 0;
    info.pSignalSemaphoreInfos = &after;
    info.commandBufferInfoCount = 1;
    info.pCommandBufferInfos = &buffer;
    lock_queue(&held);
    vk(vkQueueSubmit2(queue, 1, &info, VK_NULL_HANDLE), "vkQueueSubmit2");
    unlock_queue(&held);
}

static void wait_for(VkSemaphore timeline, uint64_t value) {
    VkSemaphoreWaitInfo info = {VK_STRUCTURE_TYPE_SEMAPHORE_WAIT_INFO};
    info.semaphoreCount = 1;
    info.pSemaphores = &timeline;
    info.pValues = &value;
    vk(vkWaitSemaphores(device, &info, UINT64_MAX), "vkWaitSemaphores");
}

static VkImage make_image(VkFormat format, VkDeviceMemory *memory) {
    VkImageCreateInfo info = {VK_STRUCTURE_TYPE_IMAGE_CREATE_INFO};
    VkImage image;
    VkMemoryRequirements room;
    info.imageType = VK_IMAGE_TYPE_2D;
    info.format = format;
    info.extent = (VkExtent3D){WIDTH, HEIGHT, 1};
    info.mipLevels = info.arrayLayers = 1;
    info.samples = VK_SAMPLE_COUNT_1_BIT;
    info.usage = VK_IMAGE_USAGE_TRANSFER_SRC_BIT | VK_IMAGE_USAGE_TRANSFER_DST_BIT;
    vk(vkCreateImage(device, &info, NULL, &image), "vkCreateImage");
    vkGetImageMemoryRequirements(device, image, &room);
    *memory = allocate(room, 0);
    vk(vkBindImageMemory(device, image, *memory, 0), "vkBindImageMemory");
    return image;
}

static VkBuffer make_buffer(VkDeviceSize bytes, VkDeviceMemory *memory, void *mapped) {
    VkBufferCreateInfo info = {VK_STRUCTURE_TYPE_BUFFER_CREATE_INFO};
    VkBuffer buffer;
    VkMemoryRequirements room;
    info.size = bytes;
    info.usage = VK_BUFFER_USAGE_TRANSFER_DST_BIT;
    vk(vkCreateBuffer(device, &info, NULL, &buffer), "vkCreateBuffer");
    vkGetBufferMemoryRequirements(device, buffer, &room);
    *memory = allocate(room, VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | VK_MEMORY_PROPERTY_HOST_COHERENT_BIT);
    vk(vkBindBufferMemory(device, buffer, *memory, 0), "vkBindBufferMemory");
    vk(vkMapMemory(device, *memory, 0, VK_WHOLE_SIZE, 0, (void **)mapped), "vkMapMemory");
    return buffer;
}

/* What a run is shown with: a view into an image of floats, and the values of a timeline semaphore. */
typedef struct {
    SgsRelight relight;
    SgsView view;
    SgsFrame frame;
    VkBuffer buffer;
    const float *texels;
    VkSemaphore timeline;
    uint64_t value;
} Stage;

enum { PIXELS = WIDTH * HEIGHT };
typedef float Picture[3 * PIXELS];

/* A frame in the host's commands, again if the library found too little room; and whether it is that of `sgs relight`. */
static int show(Stage *s, Picture into) {
    static Picture wanted;
    SgsViewReport before = {sizeof before}, after = {sizeof after};
    SgsRelitInfo render = {sizeof render};
    float largest = 0.0f, apart = 0.0f;
    do {
        SgsRecording recording;
        VkCommandBuffer commands = begin();
        sgs(sgs_view_report(context, s->view, &before), "report");
        sgs(sgs_view_record(context, s->view, &s->frame, commands, &recording), "record lit");
        read_back(commands, s->frame.image, s->buffer);
        submit(commands, s->timeline, 0, ++s->value);
        sgs(sgs_recording_timeline(context, recording, s->timeline, s->value), "until");
        wait_for(s->timeline, s->value);
        sgs(sgs_view_report(context, s->view, &after), "report");
    } while (after.incomplete > before.incomplete);
    render.layer = SGS_LAYER_SHADED;
    sgs(sgs_relight_render(context, s->relight, s->frame.camera, &render, wanted, 3 * PIXELS), "render lit");
    for (int i = 0; i < 3 * PIXELS; ++i) {
        into[i] = s->texels[4 * (i / 3) + i % 3];
        largest = fmaxf(largest, wanted[i]);
        apart = fmaxf(apart, fabsf(into[i] - wanted[i]));
    }
    return largest > 0.0f && apart <= 1e-5f * largest;
}

/* Shows a run under all light, without one light, under that light alone, and with it elsewhere. Returns what is wrong. */
static const char *relight(const char *run, const SgsCamera *camera, VkSemaphore timeline, uint64_t value) {
    static Picture all, without, alone, moved;
    const float dark[3] = {0.0f, 0.0f, 0.0f};
    float largest = 0.0f, apart = 0.0f, change = 0.0f;
    int same = 1;
    uint32_t count;
    VkDeviceMemory memories[2];
    Stage s = {0};
    SgsViewInfo info = {sizeof info};
    SgsLight light = {sizeof light}, other = {sizeof other};
    s.timeline = timeline, s.value = value;
    s.frame.struct_size = sizeof s.frame;
    s.frame.camera = camera;
    s.frame.image = make_image(VK_FORMAT_R32G32B32A32_SFLOAT, &memories[0]);
    s.buffer = make_buffer(16 * PIXELS, &memories[1], &s.texels);
    sgs(sgs_relight_open(context, run, NULL, &s.relight), "relight");
    info.width = WIDTH, info.height = HEIGHT;
    info.format = VK_FORMAT_R32G32B32A32_SFLOAT;
    info.layer = SGS_LAYER_SHADED;
    info.encoding = SGS_ENCODING_LINEAR;
    info.final_layout = VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL;
    sgs(sgs_relight_view_create(context, s.relight, &info, &s.view), "lit view");
    same &= show(&s, all);
    sgs(sgs_relight_light_get(context, s.relight, 0, &light), "light");
    light.on = 0;
    sgs(sgs_relight_light_set(context, s.relight, 0, &light), "off");
    same &= show(&s, without);
    sgs(sgs_relight_edit(context, s.relight, "{\"lights\": {\"only\": [0]}}", NULL), "edit");
    sgs(sgs_relight_environment_gain(context, s.relight, dark), "surroundings");
    same &= show(&s, alone);
    light.on = 1;
    light.position[0] += 0.5f;
    sgs(sgs_relight_light_set(context, s.relight, 0, &light), "move");
    same &= show(&s, moved);
    sgs(sgs_relight_light_count(context, s.relight, &count), "count");
    sgs(sgs_relight_light_get(context, s.relight, count - 1, &other), "another light");
    for (int i = 0; i < 3 * PIXELS; ++i) {
        largest = fmaxf(largest, all[i]);
        apart = fmaxf(apart, fabsf(all[i] - without[i] - alone[i]));
        change = fmaxf(change, fabsf(moved[i] - alone[i]));
    }
    sgs(sgs_destroy(context, s.view), "destroy lit view");
    sgs(sgs_destroy(context, s.relight), "destroy relighting");
    vkDestroyImage(device, s.frame.image, NULL);
    vkDestroyBuffer(device, s.buffer, NULL);
    for (int i = 0; i < 2; ++i) vkFreeMemory(device, memories[i], NULL);
    printf("%u lights, one of them sends up to %.2g of %.2g; ", count, change, largest);
    if (!same) return "a lit frame differs from sgs_relight_render";
    if (apart > 1e-5f * largest) return "a light switched off and that light alone are not all light";
    if (change < 0.01f * largest) return "a moved light changes nothing";
    return other.on ? "an edit has left other lights on" : NULL;
}

static void write_ppm(const char *path, const unsigned char *texels) {
    FILE *file = fopen(path, "wb");
    if (!file) stop(path, "cannot be written");
    fprintf(file, "P6\n%d %d\n255\n", WIDTH, HEIGHT);
    for (int i = 0; i < WIDTH * HEIGHT; ++i) fwrite(texels + 4 * i, 1, 3, file);
    if (fclose(file)) stop(path, "cannot be written");
}

int main(int argc, char **argv) {
    char why[1024];
    if (argc != 3 && argc != 4) {
        fprintf(stderr, "usage: host SCENE.ply OUT.ppm [RUN]\n");
        return 2;
    }

    /* The host's instance. */
    const char *layer = "VK_LAYER_KHRONOS_validation", *debug = VK_EXT_DEBUG_UTILS_EXTENSION_NAME;
    VkApplicationInfo application = {VK_STRUCTURE_TYPE_APPLICATION_INFO};
    application.apiVersion = VK_API_VERSION_1_3;
    VkValidationFeatureEnableEXT enable = VK_VALIDATION_FEATURE_ENABLE_SYNCHRONIZATION_VALIDATION_EXT;
    VkValidationFeaturesEXT validation = {VK_STRUCTURE_TYPE_VALIDATION_FEATURES_EXT};
    validation.enabledValidationFeatureCount = 1;
    validation.pEnabledValidationFeatures = &enable;
    VkInstanceCreateInfo instance_info = {VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO};
    instance_info.pNext = &validation;
    instance_info.pApplicationInfo = &application;
    instance_info.enabledLayerCount = 1;
    instance_info.ppEnabledLayerNames = &layer;
    instance_info.enabledExtensionCount = 1;
    instance_info.ppEnabledExtensionNames = &debug;
    vk(vkCreateInstance(&instance_info, NULL, &instance), "vkCreateInstance");
    VkDebugUtilsMessengerCreateInfoEXT listener = {VK_STRUCTURE_TYPE_DEBUG_UTILS_MESSENGER_CREATE_INFO_EXT};
    listener.messageSeverity =
        VK_DEBUG_UTILS_MESSAGE_SEVERITY_ERROR_BIT_EXT | VK_DEBUG_UTILS_MESSAGE_SEVERITY_WARNING_BIT_EXT;
    listener.messageType = VK_DEBUG_UTILS_MESSAGE_TYPE_VALIDATION_BIT_EXT;
    listener.pfnUserCallback = on_message;
    VkDebugUtilsMessengerEXT messenger;
    PFN_vkCreateDebugUtilsMessengerEXT create_messenger =
        (PFN_vkCreateDebugUtilsMessengerEXT)vkGetInstanceProcAddr(instance, "vkCreateDebugUtilsMessengerEXT");
    PFN_vkDestroyDebugUtilsMessengerEXT destroy_messenger =
        (PFN_vkDestroyDebugUtilsMessengerEXT)vkGetInstanceProcAddr(instance, "vkDestroyDebugUtilsMessengerEXT");
    vk(create_messenger(instance, &listener, NULL, &messenger), "vkCreateDebugUtilsMessengerEXT");

    /* The first device that lacks nothing. */
    VkPhysicalDevice all[16];
    uint32_t count = 16;
    SgsRequirements *requirements = NULL;
    SgsRequirementsInfo needs = {sizeof needs};
    SgsInstance at = {sizeof at};
    vkEnumeratePhysicalDevices(instance, &count, all);
    at.api_version = VK_API_VERSION_1_3;
    at.get_instance_proc_addr = (SgsGetInstanceProcAddr)vkGetInstanceProcAddr;
    at.instance = instance;
    at.debug_utils = 1;
    for (uint32_t i = 0; i < count && !requirements; ++i) {
        at.physical_device = all[i];
        if (sgs_requirements_create(&at, &requirements, why, sizeof why) != SGS_OK ||
            sgs_requirements_get(requirements, &needs) != SGS_OK)
            stop("requirements", why);
        if (needs.missing_count > 0) sgs_requirements_destroy(&requirements);
    }
    if (!requirements) stop("devices", "none fits");
    physical = at.physical_device;
    family = needs.queue_family;

    /* The host's device, with what the library asks for. */
    float priority = 1.0f;
    VkDeviceQueueCreateInfo queues = {VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO};
    queues.queueFamilyIndex = family;
    queues.queueCount = 1;
    queues.pQueuePriorities = &priority;
    VkDeviceCreateInfo device_info = {VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO};
    device_info.pNext = needs.device_create_next;
    device_info.queueCreateInfoCount = 1;
    device_info.pQueueCreateInfos = &queues;
    device_info.enabledExtensionCount = needs.extension_count;
    device_info.ppEnabledExtensionNames = needs.extensions;
    vk(vkCreateDevice(physical, &device_info, NULL, &device), "vkCreateDevice");
    vkGetDeviceQueue(device, family, 0, &queue);

    /* The library moves in. */
    SgsHostDevice host = {sizeof host};
    host.queue_family = family;
    host.instance = &at;
    host.device = device;
    host.queue = queue;
    host.lock_queue = lock_queue;
    host.unlock_queue = unlock_queue;
    host.user = &held;
    host.features = needs.features;
    host.feature_count = needs.feature_count;
    host.extensions = needs.extensions;
    host.extension_count = needs.extension_count;
    if (sgs_context_adopt(&host, &context, why, sizeof why) != SGS_OK) stop("adopt", why);
    sgs_requirements_destroy(&requirements);

    SgsScene scene;
    SgsSceneInfo scene_info = {sizeof scene_info};
    sgs(sgs_scene_load(context, argv[1], &scene), "scene");
    sgs(sgs_scene_get(context, scene, &scene_info), "scene info");

    /* The host's image and what it reads it back with. */
    VkDeviceMemory image_memory, memories[2];
    VkImage image = make_image(VK_FORMAT_R8G8B8A8_UNORM, &image_memory);
    enum { BYTES = WIDTH * HEIGHT * 4 };
    VkBuffer buffers[2];
    unsigned char *texels[2];
    for (int i = 0; i < 2; ++i) buffers[i] = make_buffer(BYTES, &memories[i], &texels[i]);
    VkCommandPoolCreateInfo pool_info = {VK_STRUCTURE_TYPE_COMMAND_POOL_CREATE_INFO};
    pool_info.queueFamilyIndex = family;
    vk(vkCreateCommandPool(device, &pool_info, NULL, &pool), "vkCreateCommandPool");
    VkSemaphoreTypeCreateInfo kind = {VK_STRUCTURE_TYPE_SEMAPHORE_TYPE_CREATE_INFO};
    VkSemaphoreCreateInfo semaphore_info = {VK_STRUCTURE_TYPE_SEMAPHORE_CREATE_INFO};
    VkSemaphore timeline;
    kind.semaphoreType = VK_SEMAPHORE_TYPE_TIMELINE;
    semaphore_info.pNext = &kind;
    vk(vkCreateSemaphore(device, &semaphore_info, NULL, &timeline), "vkCreateSemaphore");

    /* A view of the splats in such images. */
    SgsViewInfo view_info = {sizeof view_info};
    view_info.width = WIDTH;
    view_info.height = HEIGHT;
    view_info.format = VK_FORMAT_R8G8B8A8_UNORM;
    view_info.layer = SGS_LAYER_COLOR;
    view_info.initial_layout = VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL;
    view_info.final_layout = VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL;
    SgsView view;
    sgs(sgs_view_create(context, scene, &view_info, &view), "view");
    SgsCamera camera = {sizeof camera};
    camera.width = WIDTH;
    camera.height = HEIGHT;
    camera.focal[0] = camera.focal[1] = 0.8f * WIDTH;
    camera.center[0] = 0.5f * WIDTH;
    camera.center[1] = 0.5f * HEIGHT;
    for (int i = 0; i < 3; ++i) camera.world_to_camera[5 * i] = 1.0f;
    SgsFrame frame = {sizeof frame};
    frame.image = image;
    frame.camera = &camera;
    frame.background[2] = 0.25f;

    /* First: recorded between the host's own commands. */
    VkClearColorValue red = {{1.0f, 0.0f, 0.0f, 1.0f}};
    VkImageSubresourceRange whole = {VK_IMAGE_ASPECT_COLOR_BIT, 0, 1, 0, 1};
    SgsRecording recording;
    VkCommandBuffer commands = begin();
    transition(commands, image, VK_IMAGE_LAYOUT_UNDEFINED, VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL);
    vkCmdClearColorImage(commands, image, VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL, &red, 1, &whole);
    sgs(sgs_view_record(context, view, &frame, commands, &recording), "record");
    read_back(commands, image, buffers[0]);
    submit(commands, timeline, 0, 1);
    sgs(sgs_recording_timeline(context, recording, timeline, 1), "until");
    wait_for(timeline, 1);

    /* Second: submitted by the library between the host's submissions. */
    SgsSemaphore before = {timeline, 2}, after = {timeline, 3};
    commands = begin();
    transition(commands, image, VK_IMAGE_LAYOUT_TRANSFER_SRC_OPTIMAL, VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL);
    vkCmdClearColorImage(commands, image, VK_IMAGE_LAYOUT_TRANSFER_DST_OPTIMAL, &red, 1, &whole);
    submit(commands, timeline, 0, 2);
    int submissions = used;
    sgs(sgs_view_submit(context, view, &frame, &before, 1, &after, 1), "submit");
    if (used != submissions + 1) stop("submit", "the library submitted otherwise than once");
    commands = begin();
    read_back(commands, image, buffers[1]);
    submit(commands, timeline, 3, 4);
    wait_for(timeline, 4);

    int differ = memcmp(texels[0], texels[1], BYTES) != 0, shown = 0;
    for (int i = 0; i < WIDTH * HEIGHT; ++i) shown += texels[0][4 * i + 3] > 0;
    write_ppm(argv[2], texels[0]);

    /* Third: into memory, for comparison. */
    static float pixels[WIDTH * HEIGHT * 3];
    SgsRenderInfo render = {sizeof render};
    render.background[2] = 0.25f;
    sgs(sgs_render(context, scene, &camera, &render, pixels, WIDTH * HEIGHT * 3), "render");
    int wrong = 0;
    for (int i = 0; i < WIDTH * HEIGHT; ++i)
        for (int k = 0; k < 3; ++k) {
            float value = fminf(fmaxf(pixels[3 * i + k], 0.0f), 1.0f) * 255.0f;
            wrong += fabsf(value - (float)texels[0][4 * i + k]) > 0.51f;
        }

    SgsViewReport report = {sizeof report};
    sgs(sgs_view_report(context, view, &report), "report");
    const char *lit = argc == 4 ? relight(argv[3], &camera, timeline, 4) : NULL;
    sgs(sgs_destroy(context, view), "destroy view");
    sgs(sgs_destroy(context, scene), "destroy scene");
    sgs(sgs_context_destroy(&context), "destroy context");

    vkQueueWaitIdle(queue);
    vkDestroySemaphore(device, timeline, NULL);
    vkDestroyCommandPool(device, pool, NULL);
    for (int i = 0; i < 2; ++i) vkDestroyBuffer(device, buffers[i], NULL), vkFreeMemory(device, memories[i], NULL);
    vkDestroyImage(device, image, NULL);
    vkFreeMemory(device, image_memory, NULL);
    vkDestroyDevice(device, NULL);
    destroy_messenger(instance, messenger, NULL);
    vkDestroyInstance(instance, NULL);

    printf("%u Gaussians, %d pixels shown, %u frames, %u incomplete; library %s\n", scene_info.gaussians, shown,
           report.frames, report.incomplete, sgs_version_text());
    if (differ) fprintf(stderr, "the recorded and the submitted frame differ\n");
    if (wrong) fprintf(stderr, "%d components differ from what is rendered into memory\n", wrong);
    if (lit) fprintf(stderr, "%s\n", lit);
    if (complaints) fprintf(stderr, "validation reported %u messages\n", complaints);
    return differ || wrong || lit || complaints || shown == 0 || report.frames != 2 || report.incomplete != 0;
}
