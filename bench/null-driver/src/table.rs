//! Addresses of the driver's functions by name.

use crate::{commands, describe, memory, objects};
use ash::vk;
use std::ffi::CStr;

/// Selects a function by name, after a check of its type.
macro_rules! table {
    ($name:expr; $($kind:ident $text:literal $function:path;)*) => {
        match $name.to_str() {
            $(Ok($text) => {
                let function: vk::$kind = $function;
                // SAFETY: callers of Vulkan cast the address back to the type of the name before they call it.
                Some(unsafe { std::mem::transmute::<vk::$kind, unsafe extern "system" fn()>(function) })
            })*
            _ => None,
        }
    };
}

/// Returns the address of a function, or none if the driver does not have it.
pub(crate) fn address(name: &CStr) -> vk::PFN_vkVoidFunction {
    table! { name;
        PFN_vkGetInstanceProcAddr "vkGetInstanceProcAddr" objects::address_in_instance;
        PFN_vkEnumerateInstanceExtensionProperties "vkEnumerateInstanceExtensionProperties" objects::instance_extensions;
        PFN_vkEnumerateInstanceVersion "vkEnumerateInstanceVersion" objects::instance_version;
        PFN_vkCreateInstance "vkCreateInstance" objects::create_instance;
        PFN_vkDestroyInstance "vkDestroyInstance" objects::destroy_instance;
        PFN_vkEnumeratePhysicalDevices "vkEnumeratePhysicalDevices" objects::physical_devices;
        PFN_vkEnumerateDeviceExtensionProperties "vkEnumerateDeviceExtensionProperties" objects::device_extensions;
        PFN_vkEnumerateDeviceLayerProperties "vkEnumerateDeviceLayerProperties" objects::device_layers;
        PFN_vkGetPhysicalDeviceProperties "vkGetPhysicalDeviceProperties" describe::properties;
        PFN_vkGetPhysicalDeviceProperties2 "vkGetPhysicalDeviceProperties2" describe::properties2;
        PFN_vkGetPhysicalDeviceFeatures "vkGetPhysicalDeviceFeatures" describe::features;
        PFN_vkGetPhysicalDeviceFeatures2 "vkGetPhysicalDeviceFeatures2" describe::features2;
        PFN_vkGetPhysicalDeviceFormatProperties "vkGetPhysicalDeviceFormatProperties" describe::format_properties;
        PFN_vkGetPhysicalDeviceImageFormatProperties "vkGetPhysicalDeviceImageFormatProperties" describe::image_format_properties;
        PFN_vkGetPhysicalDeviceSparseImageFormatProperties "vkGetPhysicalDeviceSparseImageFormatProperties" describe::sparse_properties;
        PFN_vkGetPhysicalDeviceQueueFamilyProperties "vkGetPhysicalDeviceQueueFamilyProperties" describe::families;
        PFN_vkGetPhysicalDeviceQueueFamilyProperties2 "vkGetPhysicalDeviceQueueFamilyProperties2" describe::families2;
        PFN_vkGetPhysicalDeviceMemoryProperties "vkGetPhysicalDeviceMemoryProperties" describe::memory_properties;
        PFN_vkGetPhysicalDeviceMemoryProperties2 "vkGetPhysicalDeviceMemoryProperties2" describe::memory_properties2;
        PFN_vkCreateDevice "vkCreateDevice" objects::create_device;
        PFN_vkDestroyDevice "vkDestroyDevice" objects::destroy_device;
        PFN_vkGetDeviceProcAddr "vkGetDeviceProcAddr" objects::address_in_device;
        PFN_vkGetDeviceQueue "vkGetDeviceQueue" objects::queue;
        PFN_vkGetDeviceQueue2 "vkGetDeviceQueue2" objects::queue2;
        PFN_vkQueueSubmit2 "vkQueueSubmit2" commands::submit;
        PFN_vkQueueWaitIdle "vkQueueWaitIdle" commands::queue_idle;
        PFN_vkDeviceWaitIdle "vkDeviceWaitIdle" commands::device_idle;
        PFN_vkAllocateMemory "vkAllocateMemory" memory::allocate_memory;
        PFN_vkFreeMemory "vkFreeMemory" memory::free_memory;
        PFN_vkMapMemory "vkMapMemory" memory::map_memory;
        PFN_vkUnmapMemory "vkUnmapMemory" memory::unmap_memory;
        PFN_vkFlushMappedMemoryRanges "vkFlushMappedMemoryRanges" memory::flush;
        PFN_vkInvalidateMappedMemoryRanges "vkInvalidateMappedMemoryRanges" memory::flush;
        PFN_vkCreateBuffer "vkCreateBuffer" memory::create_buffer;
        PFN_vkDestroyBuffer "vkDestroyBuffer" memory::destroy_buffer;
        PFN_vkGetBufferMemoryRequirements "vkGetBufferMemoryRequirements" memory::buffer_requirements;
        PFN_vkBindBufferMemory "vkBindBufferMemory" memory::bind_buffer;
        PFN_vkCreateImage "vkCreateImage" memory::create_image;
        PFN_vkDestroyImage "vkDestroyImage" memory::destroy_image;
        PFN_vkGetImageMemoryRequirements "vkGetImageMemoryRequirements" memory::image_requirements;
        PFN_vkBindImageMemory "vkBindImageMemory" memory::bind_image;
        PFN_vkCreateImageView "vkCreateImageView" objects::create_view;
        PFN_vkDestroyImageView "vkDestroyImageView" objects::destroy_view;
        PFN_vkCreateSemaphore "vkCreateSemaphore" commands::create_semaphore;
        PFN_vkDestroySemaphore "vkDestroySemaphore" commands::destroy_semaphore;
        PFN_vkGetSemaphoreCounterValue "vkGetSemaphoreCounterValue" commands::semaphore_value;
        PFN_vkWaitSemaphores "vkWaitSemaphores" commands::wait;
        PFN_vkSignalSemaphore "vkSignalSemaphore" commands::signal;
        PFN_vkCreateFence "vkCreateFence" objects::create_fence;
        PFN_vkDestroyFence "vkDestroyFence" objects::destroy_fence;
        PFN_vkResetFences "vkResetFences" objects::fences_done;
        PFN_vkWaitForFences "vkWaitForFences" objects::wait_fences;
        PFN_vkCreateQueryPool "vkCreateQueryPool" objects::create_query_pool;
        PFN_vkDestroyQueryPool "vkDestroyQueryPool" objects::destroy_query_pool;
        PFN_vkGetQueryPoolResults "vkGetQueryPoolResults" objects::query_results;
        PFN_vkResetQueryPool "vkResetQueryPool" objects::reset_query_pool;
        PFN_vkCreateShaderModule "vkCreateShaderModule" objects::create_shader;
        PFN_vkDestroyShaderModule "vkDestroyShaderModule" objects::destroy_shader;
        PFN_vkCreatePipelineCache "vkCreatePipelineCache" objects::create_cache;
        PFN_vkDestroyPipelineCache "vkDestroyPipelineCache" objects::destroy_cache;
        PFN_vkGetPipelineCacheData "vkGetPipelineCacheData" objects::cache_data;
        PFN_vkCreateComputePipelines "vkCreateComputePipelines" objects::create_pipelines;
        PFN_vkDestroyPipeline "vkDestroyPipeline" objects::destroy_pipeline;
        PFN_vkCreatePipelineLayout "vkCreatePipelineLayout" objects::create_layout;
        PFN_vkDestroyPipelineLayout "vkDestroyPipelineLayout" objects::destroy_layout;
        PFN_vkCreateDescriptorSetLayout "vkCreateDescriptorSetLayout" objects::create_set_layout;
        PFN_vkDestroyDescriptorSetLayout "vkDestroyDescriptorSetLayout" objects::destroy_set_layout;
        PFN_vkCreateDescriptorPool "vkCreateDescriptorPool" objects::create_sets;
        PFN_vkDestroyDescriptorPool "vkDestroyDescriptorPool" objects::destroy_sets;
        PFN_vkResetDescriptorPool "vkResetDescriptorPool" objects::reset_sets;
        PFN_vkAllocateDescriptorSets "vkAllocateDescriptorSets" objects::allocate_sets;
        PFN_vkUpdateDescriptorSets "vkUpdateDescriptorSets" objects::update_sets;
        PFN_vkCreateCommandPool "vkCreateCommandPool" commands::create_pool;
        PFN_vkDestroyCommandPool "vkDestroyCommandPool" commands::destroy_pool;
        PFN_vkResetCommandPool "vkResetCommandPool" commands::reset_pool;
        PFN_vkAllocateCommandBuffers "vkAllocateCommandBuffers" commands::allocate;
        PFN_vkFreeCommandBuffers "vkFreeCommandBuffers" commands::free;
        PFN_vkBeginCommandBuffer "vkBeginCommandBuffer" commands::begin;
        PFN_vkEndCommandBuffer "vkEndCommandBuffer" commands::end;
        PFN_vkCmdCopyBuffer "vkCmdCopyBuffer" commands::copy_buffer;
        PFN_vkCmdFillBuffer "vkCmdFillBuffer" commands::fill_buffer;
        PFN_vkCmdCopyImage "vkCmdCopyImage" commands::copy_image;
        PFN_vkCmdCopyImageToBuffer "vkCmdCopyImageToBuffer" commands::copy_image_to_buffer;
        PFN_vkCmdCopyBufferToImage "vkCmdCopyBufferToImage" commands::copy_buffer_to_image;
        PFN_vkCmdClearColorImage "vkCmdClearColorImage" commands::clear_color_image;
        PFN_vkCmdBindPipeline "vkCmdBindPipeline" commands::bind_pipeline;
        PFN_vkCmdBindDescriptorSets "vkCmdBindDescriptorSets" commands::bind_sets;
        PFN_vkCmdPushConstants "vkCmdPushConstants" commands::push_constants;
        PFN_vkCmdDispatch "vkCmdDispatch" commands::dispatch;
        PFN_vkCmdDispatchIndirect "vkCmdDispatchIndirect" commands::dispatch_indirect;
        PFN_vkCmdPipelineBarrier2 "vkCmdPipelineBarrier2" commands::barrier;
        PFN_vkCmdWriteTimestamp2 "vkCmdWriteTimestamp2" commands::write_timestamp;
        PFN_vkCmdResetQueryPool "vkCmdResetQueryPool" commands::reset_queries;
        PFN_vkSetDebugUtilsObjectNameEXT "vkSetDebugUtilsObjectNameEXT" objects::set_name;
        PFN_vkCmdBeginDebugUtilsLabelEXT "vkCmdBeginDebugUtilsLabelEXT" commands::begin_label;
        PFN_vkCmdEndDebugUtilsLabelEXT "vkCmdEndDebugUtilsLabelEXT" commands::end_label;
    }
}
