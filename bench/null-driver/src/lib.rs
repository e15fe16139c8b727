//! Vulkan driver that runs no kernels, for `engine-bench host` and tests.
//!
//! All memory is host memory. Command buffers of one submission execute their copies and fills when they are submitted, so
//! that uploads and downloads work. All other command buffers do nothing. Submissions signal their semaphores at once, so
//! that waits return at once, and the time of a step is the host's own. The driver counts calls ([`Counter`]).
//!
//! The device describes itself as a GPU with 32 lanes, and a second queue family that only transfers. It has what the
//! engine requires, and nothing optional. Timestamps are absent.
//!
//! A manifest ([`manifest`]) makes the Vulkan loader load the library; `VK_DRIVER_FILES` names the manifest.

mod commands;
mod counters;
mod describe;
mod handles;
mod memory;
mod objects;
mod table;

pub use counters::{BYTES, Counter, FILE_VARIABLE, read};

use ash::vk;
use std::ffi::{CStr, c_char};
use std::path::Path;

/// Returns the manifest of the driver's library, as JSON.
pub fn manifest(library: &Path) -> String {
    let path = library.display().to_string().replace('\\', "\\\\").replace('"', "\\\"");
    format!(r#"{{"file_format_version": "1.0.0", "ICD": {{"library_path": "{path}", "api_version": "1.3.250"}}}}"#)
}

/// Highest known version of the interface between loader and driver.
const INTERFACE: u32 = 5;

/// Agrees with the loader on the version of their interface.
///
/// # Safety
/// The pointer is valid, as the loader promises.
// SAFETY: no other library of the process defines the symbol for the linker; the loader finds it in this library.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn vk_icdNegotiateLoaderICDInterfaceVersion(version: *mut u32) -> vk::Result {
    // SAFETY: as the caller promises.
    let version = unsafe { &mut *version };
    *version = INTERFACE.min(*version);
    vk::Result::SUCCESS
}

/// Returns the address of a function of the driver.
///
/// # Safety
/// The name is a valid C string, as the loader promises.
// SAFETY: as above.
#[unsafe(no_mangle)]
pub unsafe extern "system" fn vk_icdGetInstanceProcAddr(
    _instance: vk::Instance,
    name: *const c_char,
) -> vk::PFN_vkVoidFunction {
    // SAFETY: as the caller promises.
    table::address(unsafe { CStr::from_ptr(name) })
}
