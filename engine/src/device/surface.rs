//! Window surfaces, and devices that can present to them.
//!
//! Promises: the window outlives its surface, and the surface everything created from it. Selects a device only if
//! one of its queues both computes and presents. The caller owns the window, its events and its size.

use super::fault::Gate;
use super::identity::Environment;
use super::instance::Instance;
use super::objects::ObjectKind;
use super::{Device, DeviceOptions, describe, select};
use crate::error::{Error, Result};
use ash::{khr, vk};
use raw_window_handle::{HasDisplayHandle, HasWindowHandle};
use std::ffi::CStr;
use std::sync::Arc;

/// Window. Implementations promise that the handles stay valid while the value is borrowed.
pub trait Window: HasDisplayHandle + HasWindowHandle + Send + Sync + 'static {}

impl<W: HasDisplayHandle + HasWindowHandle + Send + Sync + 'static> Window for W {}

/// Vulkan surface of a window; keeps the window alive.
pub struct Surface {
    pub(crate) raw: vk::SurfaceKHR,
    pub(crate) api: khr::surface::Instance,
    instance: Arc<Instance>,
    objects: super::Objects,
    _window: Arc<dyn Window>,
}

fn window_error(error: impl std::fmt::Display) -> Error {
    Error::Window(error.to_string())
}

/// Returns the instance extensions for windows of this kind.
fn extensions(window: &dyn Window) -> Result<Vec<&'static CStr>> {
    let display = window.display_handle().map_err(window_error)?;
    let names = ash_window::enumerate_required_extensions(display.as_raw()).map_err(window_error)?;
    // SAFETY: ash provides these extension names; they are static and zero-terminated.
    Ok(names.iter().map(|name| unsafe { CStr::from_ptr(*name) }).collect())
}

impl Surface {
    fn new(instance: &Arc<Instance>, gate: &Gate, window: Arc<dyn Window>) -> Result<Surface> {
        let display = window.display_handle().map_err(window_error)?.as_raw();
        let handle = window.window_handle().map_err(window_error)?.as_raw();
        let Some(entry) = &instance.entry else {
            return Err(Error::Window("its instance belongs to a host".into()));
        };
        // SAFETY: the instance has the extensions of this display; window and display are alive, and the surface
        // keeps the window alive.
        let raw = gate.make(ObjectKind::Surface, "vkCreateSurfaceKHR", "window", || unsafe {
            ash_window::create_surface(entry, &instance.raw, display, handle, None)
        })?;
        let api = khr::surface::Instance::new(entry, &instance.raw);
        Ok(Surface { raw, api, instance: instance.clone(), objects: gate.objects.clone(), _window: window })
    }

    /// Selects a queue family of the candidate that can present. Records a missing feature if none can.
    fn select_queue_family(&self, candidate: &mut describe::Candidate, gate: &Gate) -> Result<()> {
        let api = &self.instance.raw;
        // SAFETY: the physical device comes from this instance.
        let families = unsafe { api.get_physical_device_queue_family_properties(candidate.physical) };
        // SAFETY: as above.
        let known = gate.call("vkEnumerateDeviceExtensionProperties", &candidate.info.name, || unsafe {
            api.enumerate_device_extension_properties(candidate.physical)
        })?;
        if !known.iter().any(|e| e.extension_name_as_c_str() == Ok(khr::swapchain::NAME)) {
            candidate.info.missing.push(khr::swapchain::NAME.to_string_lossy().into_owned());
            return Ok(());
        }
        for (index, family) in (0..).zip(&families) {
            // SAFETY: the surface belongs to this instance, and the family exists.
            let can_present = gate.call("vkGetPhysicalDeviceSurfaceSupportKHR", &candidate.info.name, || unsafe {
                self.api.get_physical_device_surface_support(candidate.physical, index, self.raw)
            })?;
            if can_present && family.queue_flags.contains(vk::QueueFlags::COMPUTE) {
                if family.timestamp_valid_bits == 0 {
                    candidate.info.timestamp_period = 0.0;
                }
                candidate.queue_family = Some(index);
                return Ok(());
            }
        }
        candidate.info.missing.push("a compute queue that can present to this window".to_owned());
        Ok(())
    }
}

impl Device {
    /// Opens a device that can present to a window.
    ///
    /// # Errors
    /// As [`Device::open`]; if no driver supports windows of this kind.
    pub fn open_for(options: &DeviceOptions, window: Arc<dyn Window>) -> Result<(Device, Arc<Surface>)> {
        let gate = Gate::new(options.faults.clone(), options.objects.clone());
        let instance = Instance::new(options.validation, &extensions(&*window)?, &gate)?;
        let surface = Surface::new(&instance, &gate, window)?;
        let mut candidates = describe::candidates(&instance, &gate)?;
        for candidate in &mut candidates {
            surface.select_queue_family(candidate, &gate)?;
        }
        let selected = select::choose(candidates, options.select.as_deref(), &Environment::current())?;
        let device = Device::make(instance, selected, &[khr::swapchain::NAME], gate, options)?;
        Ok((device, Arc::new(surface)))
    }
}

impl Drop for Surface {
    fn drop(&mut self) {
        // SAFETY: swapchains hold an `Arc` of this, so none is left; the instance is alive.
        unsafe { self.api.destroy_surface(self.raw, None) };
        self.objects.remove(ObjectKind::Surface);
    }
}
