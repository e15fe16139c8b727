//! Contexts: a device, the objects made on it, and the last error.

use crate::border::{Failure, Outcome, fail, guarded, optional_string, put_text, read, write};
use crate::object::{RelightObject, SceneObject, Thing, TrainerObject, ViewObject};
use crate::table::Table;
use crate::types::*;
use sgs_engine::{Device, DeviceOptions};
use sgs_passes::Tuning;
use std::ffi::{CStr, c_char};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

/// Device, and everything made on it.
pub struct SgsContext {
    inner: Mutex<Inner>,
    error: Mutex<String>,
}

/// State that a context guards.
pub(crate) struct Inner {
    pub device: Device,
    pub tuning: Tuning,
    pub table: Table<Thing>,
    /// Whether a call has panicked. The state cannot be trusted any more.
    broken: bool,
}

macro_rules! getters {
    ($($get:ident $variant:ident $kind:literal $type:ty;)*) => {
        impl Inner {
            $(pub fn $get(&mut self, handle: SgsHandle) -> Outcome<&mut $type> {
                match self.table.get(handle, $kind)? {
                    Thing::$variant(object) => Ok(object),
                    _ => fail(SgsResult::SGS_ERROR_HANDLE, "The object is of another kind."),
                }
            })*
        }
    };
}

getters! {
    scene Scene 1 Arc<SceneObject>;
    cameras Cameras 2 Vec<sgs_scene::Camera>;
    view View 3 Box<ViewObject>;
    trainer Trainer 5 Box<TrainerObject>;
    relight Relight 6 RelightObject;
}

fn unpoisoned<T>(lock: &Mutex<T>) -> MutexGuard<'_, T> {
    lock.lock().unwrap_or_else(|e| e.into_inner())
}

/// Runs a call on a context, one at a time. A failure becomes the context's last error.
///
/// # Safety
/// `context` is null or a context that is not destroyed before the call ends.
pub(crate) unsafe fn with(context: *const SgsContext, run: impl FnOnce(&mut Inner) -> Outcome<()>) -> SgsResult {
    // SAFETY: by the caller's contract.
    let Some(context) = (unsafe { context.as_ref() }) else { return SgsResult::SGS_ERROR_NULL };
    let mut inner = unpoisoned(&context.inner);
    let outcome = if inner.broken {
        fail(SgsResult::SGS_ERROR_INTERNAL, "An earlier call met a defect of the library; destroy the context.")
    } else {
        guarded(|| run(&mut inner))
    };
    let Err(failure) = outcome else { return SgsResult::SGS_OK };
    inner.broken |= failure.code == SgsResult::SGS_ERROR_INTERNAL;
    *unpoisoned(&context.error) = failure.text;
    failure.code
}

/// Runs a function that makes an object without a context. The error text is written to the caller's buffer.
///
/// # Safety
/// `out` is null or can be written; `error` is null or has space for `size` bytes.
pub(crate) unsafe fn make<T>(
    out: *mut *mut T,
    error: *mut c_char,
    size: usize,
    run: impl FnOnce() -> Outcome<T>,
) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe { put_text(error, size, "") };
    let made = if out.is_null() {
        fail(SgsResult::SGS_ERROR_NULL, "The place for the new object is null.")
    } else {
        // SAFETY: by the caller's contract.
        unsafe { out.write(std::ptr::null_mut()) };
        guarded(run)
    };
    match made {
        Ok(object) => {
            // SAFETY: by the caller's contract.
            unsafe { out.write(Box::into_raw(Box::new(object))) };
            SgsResult::SGS_OK
        }
        Err(failure) => {
            // SAFETY: by the caller's contract.
            unsafe { put_text(error, size, &failure.text) };
            failure.code
        }
    }
}

/// Writes the handle of a new object.
///
/// # Safety
/// `out` can be written, if it is not null.
pub(crate) unsafe fn hand_over(inner: &mut Inner, out: *mut SgsHandle, thing: Thing) -> Outcome<()> {
    let handle = inner.table.add(thing)?;
    // SAFETY: by the caller's contract; `claim` has found it not to be null.
    unsafe { out.write(handle) };
    Ok(())
}

/// Checks the destination of a handle and writes 0 to it.
///
/// # Safety
/// `out` can be written, if it is not null.
pub(crate) unsafe fn claim(out: *mut SgsHandle) -> Outcome<()> {
    if out.is_null() {
        return fail(SgsResult::SGS_ERROR_NULL, "The place for the handle is null.");
    }
    // SAFETY: by the caller's contract.
    unsafe { out.write(0) };
    Ok(())
}

impl SgsContext {
    pub(crate) fn new(device: Device) -> SgsContext {
        let tuning = Tuning::for_device(device.info());
        // The device's address distinguishes contexts: handles of one are no handles of another.
        let address = device.address() as u64;
        let salt = address >> 4 ^ address >> 24;
        let inner = Inner { device, tuning, table: Table::new(salt), broken: false };
        SgsContext { inner: Mutex::new(inner), error: Mutex::new(String::new()) }
    }
}

/// Returns the version of the library. Encoded as major * 1000000 + minor * 1000 + patch.
#[unsafe(no_mangle)]
pub extern "C" fn sgs_version() -> u32 {
    let number = |text: &str| text.parse::<u32>().unwrap_or(0);
    number(env!("CARGO_PKG_VERSION_MAJOR")) * 1_000_000
        + number(env!("CARGO_PKG_VERSION_MINOR")) * 1000
        + number(env!("CARGO_PKG_VERSION_PATCH"))
}

/// Returns the version as text.
#[unsafe(no_mangle)]
pub extern "C" fn sgs_version_text() -> *const c_char {
    const TEXT: &str = concat!(env!("CARGO_PKG_VERSION"), "\0");
    TEXT.as_ptr().cast()
}

/// Returns the meaning of a result, in a few words.
#[unsafe(no_mangle)]
pub extern "C" fn sgs_result_text(result: i32) -> *const c_char {
    let text: &CStr = match result {
        0 => c"done",
        -1 => c"a pointer is null",
        -2 => c"a value is not possible",
        -3 => c"a struct has an unknown size",
        -4 => c"no such object",
        -5 => c"a file cannot be read or written",
        -6 => c"no fitting device",
        -7 => c"the device was lost",
        -8 => c"memory ran out",
        -9 => c"not done yet",
        -10 => c"training cannot go on",
        -11 => c"a buffer is too small",
        -12 => c"a defect of the library",
        _ => c"no result of this library",
    };
    text.as_ptr()
}

/// Opens a device for the library alone. `info` may be null. On failure `error`, if not null, holds the reason.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_context_open(
    info: *const SgsDeviceInfo,
    context: *mut *mut SgsContext,
    error: *mut c_char,
    error_size: usize,
) -> SgsResult {
    let run = || {
        let mut options = DeviceOptions::default();
        if !info.is_null() {
            // SAFETY: not null, and a struct by the caller's contract.
            let info = unsafe { read(info) }?;
            // SAFETY: strings by the caller's contract.
            unsafe {
                options.select = optional_string(info.device, "SgsDeviceInfo.device")?;
                options.pipeline_cache =
                    optional_string(info.pipeline_cache, "SgsDeviceInfo.pipeline_cache")?.map(Into::into);
            }
            options.validation = info.validation != 0;
            options.timeout = timeout(info.timeout_seconds, options.timeout)?;
        }
        Ok(SgsContext::new(Device::open(&options)?))
    };
    // SAFETY: by the caller's contract.
    unsafe { make(context, error, error_size, run) }
}

pub(crate) fn timeout(seconds: f64, default: Duration) -> Outcome<Duration> {
    if seconds == 0.0 {
        return Ok(default);
    }
    let limit = Duration::try_from_secs_f64(seconds).ok().filter(|d| !d.is_zero());
    limit.ok_or_else(|| Failure {
        code: SgsResult::SGS_ERROR_ARGUMENT,
        text: format!("timeout_seconds is {seconds}, but must be a positive number."),
    })
}

/// Destroys a context with all its objects and sets the pointer to null. The host has waited for its submissions of
/// recordings. No other call on the context is in progress, and none follows.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_context_destroy(context: *mut *mut SgsContext) -> SgsResult {
    // SAFETY: null or a place for a pointer by the caller's contract.
    let Some(place) = (unsafe { context.as_mut() }) else { return SgsResult::SGS_ERROR_NULL };
    let raw = std::mem::replace(place, std::ptr::null_mut());
    if raw.is_null() {
        return SgsResult::SGS_ERROR_NULL;
    }
    // SAFETY: made by `make` and not destroyed before, since destroying makes the pointer null.
    let context = unsafe { Box::from_raw(raw) };
    let outcome = guarded(|| {
        let mut inner = context.inner.into_inner().unwrap_or_else(|e| e.into_inner());
        for thing in inner.table.drain() {
            if let Thing::Recording(recorded) = thing {
                // SAFETY: the host has waited, by the contract of this call.
                unsafe { recorded.release() };
            }
        }
        Ok(())
    });
    outcome.map_or_else(|failure| failure.code, |()| SgsResult::SGS_OK)
}

/// Copies the text of the context's last error, as much as fits. `needed`, if not null, receives the number of bytes of
/// the whole text, including the terminating zero.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_last_error(
    context: *const SgsContext,
    text: *mut c_char,
    size: usize,
    needed: *mut usize,
) -> SgsResult {
    // SAFETY: by the caller's contract.
    let Some(context) = (unsafe { context.as_ref() }) else { return SgsResult::SGS_ERROR_NULL };
    let last = unpoisoned(&context.error).clone();
    // SAFETY: by the caller's contract.
    unsafe {
        put_text(text, size, &last);
        if let Some(needed) = needed.as_mut() {
            *needed = last.len() + 1;
        }
    }
    if !text.is_null() && size <= last.len() { SgsResult::SGS_ERROR_SPACE } else { SgsResult::SGS_OK }
}

/// Returns the state of the context.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_context_get(context: *const SgsContext, info: *mut SgsContextInfo) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            let (used, peak) = inner.device.memory_use();
            let value = SgsContextInfo {
                struct_size: 0,
                adopted: u32::from(inner.device.adopted()),
                bytes_used: used,
                bytes_peak: peak,
                validation_messages: 0,
                objects: inner.table.len() as u32,
            };
            // The size of the struct is checked before the messages are removed.
            write(info, &value)?;
            let validation_messages = inner.device.messages().take().len() as u32;
            write(info, &SgsContextInfo { validation_messages, ..value })
        })
    }
}

/// Destroys an object of any kind. A recording can only be ended by sgs_recording_timeline, sgs_recording_fence or
/// sgs_recording_done.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_destroy(context: *const SgsContext, object: SgsHandle) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            if inner.table.get(object, 4).is_ok() {
                let text = "A recording ends with sgs_recording_done, sgs_recording_timeline or sgs_recording_fence.";
                return fail(SgsResult::SGS_ERROR_HANDLE, text);
            }
            if let Ok(Thing::View(view)) = inner.table.get(object, 3)
                && view.open()? > 0
            {
                return fail(SgsResult::SGS_ERROR_BUSY, "The view still has recordings that are not done.");
            }
            inner.table.take(object, None).map(drop)
        })
    }
}
