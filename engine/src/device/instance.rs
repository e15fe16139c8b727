//! Vulkan instance and its validation messages.

use super::fault::Gate;
use super::objects::{ObjectKind, Objects};
use crate::error::{Error, Result};
use ash::{ext, khr, vk};
use std::ffi::{CStr, c_void};
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread::{self, ThreadId};

const LAYER: &CStr = c"VK_LAYER_KHRONOS_validation";

/// Collects validation messages of one instance.
#[derive(Debug, Default)]
pub struct Messages {
    reports: Mutex<Vec<String>>,
    /// Labels that each thread is recording, outermost first. Messages arrive on the thread that caused them.
    labels: Mutex<Vec<(ThreadId, String)>>,
}

impl Messages {
    /// Returns and clears all collected messages.
    pub fn take(&self) -> Vec<String> {
        std::mem::take(&mut *lock(&self.reports))
    }

    /// Opens a label for the commands that this thread records.
    pub(crate) fn open(&self, label: &str) {
        lock(&self.labels).push((thread::current().id(), label.to_owned()));
    }

    /// Closes the innermost label of this thread.
    pub(crate) fn close(&self) {
        let mut labels = lock(&self.labels);
        if let Some(last) = labels.iter().rposition(|(owner, _)| *owner == thread::current().id()) {
            labels.remove(last);
        }
    }

    /// Closes all labels that this thread left open after an error.
    pub(crate) fn close_all(&self) {
        lock(&self.labels).retain(|(owner, _)| *owner != thread::current().id());
    }

    fn open_labels(&self) -> Vec<String> {
        let here = thread::current().id();
        lock(&self.labels).iter().filter(|(owner, _)| *owner == here).map(|(_, label)| label.clone()).collect()
    }

    fn push(&self, message: String) {
        lock(&self.reports).push(message);
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(|e| e.into_inner())
}

/// Instance with its loader and, with validation, its messenger; or a borrowed instance of a host.
pub(crate) struct Instance {
    pub raw: ash::Instance,
    /// Keeps the loader in memory; absent for a host's instance.
    pub(super) entry: Option<ash::Entry>,
    get_instance_proc_addr: vk::PFN_vkGetInstanceProcAddr,
    pub messages: Arc<Messages>,
    pub validation: bool,
    /// Version of the validation layer, if enabled.
    pub layer_version: Option<(u32, u32, u32)>,
    messenger: Option<(ext::debug_utils::Instance, vk::DebugUtilsMessengerEXT)>,
    pub debug_utils: bool,
    objects: Objects,
}

impl Instance {
    /// Creates an instance. Fails if an extension in `required` is missing.
    pub fn new(validation: bool, required: &[&'static CStr], gate: &Gate) -> Result<Arc<Instance>> {
        // SAFETY: loading the system's Vulkan loader runs its initializers, which are sound by the platform's contract.
        let entry = unsafe { ash::Entry::load() }.map_err(|e| Error::Loader(e.to_string()))?;
        // SAFETY: the entry is loaded; the call only enumerates.
        let layers = gate.call("vkEnumerateInstanceLayerProperties", "instance", || unsafe {
            entry.enumerate_instance_layer_properties()
        })?;
        // SAFETY: as above.
        let extensions = gate.call("vkEnumerateInstanceExtensionProperties", "instance", || unsafe {
            entry.enumerate_instance_extension_properties(None)
        })?;
        let layer = layers.iter().find(|l| l.layer_name_as_c_str() == Ok(LAYER)).filter(|_| validation);
        let layer_version = layer
            .map(|l| l.spec_version)
            .map(|v| (vk::api_version_major(v), vk::api_version_minor(v), vk::api_version_patch(v)));
        if validation && layer.is_none() {
            return Err(Error::NoValidation);
        }
        let debug_utils =
            validation || extensions.iter().any(|e| e.extension_name_as_c_str() == Ok(ext::debug_utils::NAME));
        let known = |name: &CStr| extensions.iter().any(|e| e.extension_name_as_c_str() == Ok(name));
        if let Some(absent) = required.iter().find(|name| !known(name)) {
            return Err(Error::Window(format!("the Vulkan drivers here have no {}", absent.to_string_lossy())));
        }
        let messages = Arc::new(Messages::default());
        let application = vk::ApplicationInfo::default()
            .application_name(c"sgs")
            .engine_name(c"sgs-engine")
            .api_version(vk::API_VERSION_1_3);
        let layer_names = [LAYER.as_ptr()];
        let mut extension_names: Vec<_> = required.iter().map(|name| name.as_ptr()).collect();
        if debug_utils {
            extension_names.push(ext::debug_utils::NAME.as_ptr());
        }
        let enables = [vk::ValidationFeatureEnableEXT::SYNCHRONIZATION_VALIDATION];
        let mut features = vk::ValidationFeaturesEXT::default().enabled_validation_features(&enables);
        let mut debug = messenger_info(&messages);
        let mut info =
            vk::InstanceCreateInfo::default().application_info(&application).enabled_extension_names(&extension_names);
        if validation {
            info = info.enabled_layer_names(&layer_names).push_next(&mut features).push_next(&mut debug);
        }
        // SAFETY: every pointer in `info` outlives the call; layers and extensions were found above.
        let raw = gate
            .make(ObjectKind::Instance, "vkCreateInstance", "sgs", || unsafe { entry.create_instance(&info, None) })?;
        let messenger = if validation {
            let api = ext::debug_utils::Instance::new(&entry, &raw);
            // SAFETY: the instance is alive and has the extension; the messages outlive the messenger, which is
            // destroyed before this struct drops its last reference to them.
            let made = gate.make(ObjectKind::Messenger, "vkCreateDebugUtilsMessengerEXT", "validation", || unsafe {
                api.create_debug_utils_messenger(&messenger_info(&messages), None)
            });
            match made {
                Ok(m) => Some((api, m)),
                Err(error) => {
                    // SAFETY: nothing was created from the instance yet.
                    unsafe { raw.destroy_instance(None) };
                    gate.count_destroyed(ObjectKind::Instance);
                    return Err(error);
                }
            }
        } else {
            None
        };
        Ok(Arc::new(Instance {
            raw,
            get_instance_proc_addr: entry.static_fn().get_instance_proc_addr,
            entry: Some(entry),
            messages,
            validation,
            layer_version,
            messenger,
            debug_utils,
            objects: gate.objects.clone(),
        }))
    }

    /// Wraps a host's instance, which is never destroyed here.
    ///
    /// # Safety
    /// The entry point behaves as `vkGetInstanceProcAddr`. The instance was created through it and outlives the
    /// returned value.
    pub unsafe fn borrow(
        get_instance_proc_addr: vk::PFN_vkGetInstanceProcAddr,
        instance: vk::Instance,
        debug_utils: bool,
    ) -> Arc<Instance> {
        let functions = ash::StaticFn { get_instance_proc_addr };
        // SAFETY: as the caller promises.
        let raw = unsafe { ash::Instance::load(&functions, instance) };
        Arc::new(Instance {
            raw,
            entry: None,
            get_instance_proc_addr,
            messages: Arc::default(),
            validation: false,
            layer_version: None,
            messenger: None,
            debug_utils,
            objects: Objects::default(),
        })
    }
}

impl Instance {
    /// Loads the cooperative-matrix query, if the loader or its replacement has it.
    pub fn cooperative_matrices(&self) -> Option<khr::cooperative_matrix::Instance> {
        let name = c"vkGetPhysicalDeviceCooperativeMatrixPropertiesKHR";
        // SAFETY: the instance was created through the entry point and is alive.
        unsafe { (self.get_instance_proc_addr)(self.raw.handle(), name.as_ptr()) }?;
        let functions = ash::StaticFn { get_instance_proc_addr: self.get_instance_proc_addr };
        // SAFETY: as above; the loader outlives this instance.
        let entry = unsafe { ash::Entry::from_static_fn(functions) };
        Some(khr::cooperative_matrix::Instance::new(&entry, &self.raw))
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        if self.entry.is_none() {
            return;
        }
        // SAFETY: devices hold an `Arc` of this, so no device is left; the messenger belongs to this instance.
        unsafe {
            if let Some((api, messenger)) = self.messenger.take() {
                api.destroy_debug_utils_messenger(messenger, None);
                self.objects.remove(ObjectKind::Messenger);
            }
            self.raw.destroy_instance(None);
        }
        self.objects.remove(ObjectKind::Instance);
    }
}

fn messenger_info(messages: &Arc<Messages>) -> vk::DebugUtilsMessengerCreateInfoEXT<'static> {
    vk::DebugUtilsMessengerCreateInfoEXT::default()
        .message_severity(vk::DebugUtilsMessageSeverityFlagsEXT::ERROR | vk::DebugUtilsMessageSeverityFlagsEXT::WARNING)
        .message_type(
            vk::DebugUtilsMessageTypeFlagsEXT::VALIDATION
                | vk::DebugUtilsMessageTypeFlagsEXT::PERFORMANCE
                | vk::DebugUtilsMessageTypeFlagsEXT::GENERAL,
        )
        .pfn_user_callback(Some(on_message))
        .user_data(Arc::as_ptr(messages).cast_mut().cast())
}

/// Records a message of the validation layer.
///
/// # Safety
/// Called by the layer with its own data and the `Messages` that `messenger_info` registered.
unsafe extern "system" fn on_message(
    _: vk::DebugUtilsMessageSeverityFlagsEXT,
    kind: vk::DebugUtilsMessageTypeFlagsEXT,
    data: *const vk::DebugUtilsMessengerCallbackDataEXT<'_>,
    user: *mut c_void,
) -> vk::Bool32 {
    if data.is_null() || user.is_null() {
        return vk::FALSE;
    }
    // SAFETY: the layer passes valid data for the duration of the call; `user` is the registered `Messages`, which
    // outlives the messenger.
    let (data, messages) = unsafe { (&*data, &*user.cast::<Messages>()) };
    // SAFETY: as above; the text is zero-terminated.
    let text = unsafe { data.message_as_c_str() };
    let mut text = text.map_or_else(String::new, |t| t.to_string_lossy().into_owned());
    // SAFETY: as above.
    let id = unsafe { data.message_id_name_as_c_str() };
    if let Some(id) = id.map(CStr::to_string_lossy).filter(|id| !text.contains(id.as_ref())) {
        // Newer layers leave it out of the text.
        text = format!("{id}: {text}");
    }
    // SAFETY: as above; the layer passes as many labels as it counts.
    let labels = unsafe { labels(data) };
    // Layers pass labels only with messages about the command buffer itself.
    let (place, labels) =
        if labels.is_empty() { ("Recording", messages.open_labels()) } else { ("In the command buffer", labels) };
    if !labels.is_empty() {
        text = format!("{text} {place}: {}.", labels.join(", "));
    }
    // Images stay in the general layout by design (docs/adr/0010-images-and-layouts.md).
    let layout_advice =
        kind.contains(vk::DebugUtilsMessageTypeFlagsEXT::PERFORMANCE) && text.contains("InvalidImageLayout");
    // GENERAL messages report absent drivers and layers, not errors in Vulkan usage.
    if layout_advice || kind.contains(vk::DebugUtilsMessageTypeFlagsEXT::GENERAL) {
        tracing::debug!("{text}");
    } else {
        messages.push(text);
    }
    vk::FALSE
}

/// Returns the open labels of the command buffer of a message, outermost first.
///
/// # Safety
/// The data must be as passed by a layer.
unsafe fn labels(data: &vk::DebugUtilsMessengerCallbackDataEXT<'_>) -> Vec<String> {
    if data.p_cmd_buf_labels.is_null() {
        return Vec::new();
    }
    // SAFETY: by the caller's promise, `cmd_buf_label_count` labels are present.
    let labels = unsafe { std::slice::from_raw_parts(data.p_cmd_buf_labels, data.cmd_buf_label_count as usize) };
    // Layers pass the innermost first.
    let names = labels.iter().rev().filter_map(|label| {
        // SAFETY: by the caller's promise, names are zero-terminated.
        unsafe { label.label_name_as_c_str() }
    });
    let mut names: Vec<String> = names.map(|name| name.to_string_lossy().into_owned()).collect();
    // Version 1.3.239 passes each label twice.
    names.dedup();
    names
}
