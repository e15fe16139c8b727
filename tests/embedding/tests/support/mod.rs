//! C interface in tests: sized structs, checked contexts, expected results.

#![allow(dead_code, reason = "not every test needs all of it")]

use sgs::*;
use sgs_tests::{Turn, scenes, turn};
use std::ffi::{CStr, CString, c_char};
use std::path::Path;
use std::ptr::{null, null_mut};

pub fn zeroed<T: Copy>() -> T {
    // SAFETY: every struct of the header is valid with all bits zero, as the header documents.
    unsafe { std::mem::zeroed() }
}

macro_rules! sized {
    ($name:ident { $($field:ident: $value:expr),* $(,)? }) => {{
        let mut value: $name = $crate::support::zeroed();
        value.struct_size = size_of::<$name>() as u32;
        $(value.$field = $value;)*
        value
    }};
}

/// Context on a device with validation. The second field is dropped last, when the device is closed.
pub struct Context(pub *mut SgsContext, Turn);

impl Context {
    pub fn new() -> Context {
        let turn = turn();
        let device = std::env::var("SGS_TEST_DEVICE").ok().map(|d| CString::new(d).unwrap());
        let info = sized!(SgsDeviceInfo { validation: 1, device: device.as_ref().map_or(null(), |d| d.as_ptr()) });
        let (mut context, mut why) = (null_mut(), [0; 500]);
        // SAFETY: all pointers are valid.
        let result = unsafe { sgs_context_open(&info, &mut context, why.as_mut_ptr(), why.len()) };
        // SAFETY: the text ends with a zero.
        assert_eq!(result, SgsResult::SGS_OK, "{:?}", unsafe { CStr::from_ptr(why.as_ptr()) });
        Context(context, turn)
    }

    pub fn error(&self) -> String {
        let mut text = [0 as c_char; 2000];
        // SAFETY: all pointers are valid.
        unsafe {
            assert_eq!(sgs_last_error(self.0, text.as_mut_ptr(), text.len(), null_mut()), SgsResult::SGS_OK);
            CStr::from_ptr(text.as_ptr()).to_str().unwrap().to_owned()
        }
    }

    #[track_caller]
    pub fn ok(&self, result: SgsResult) {
        assert_eq!(result, SgsResult::SGS_OK, "{}", self.error());
    }

    /// Checks that the call failed with the expected result and message.
    #[track_caller]
    pub fn refused(&self, result: SgsResult, code: SgsResult, words: &str) {
        assert_eq!(result, code, "{}", self.error());
        assert!(self.error().contains(words), "\"{words}\" is missing: {}", self.error());
    }

    pub fn info(&self) -> SgsContextInfo {
        let mut info = sized!(SgsContextInfo {});
        // SAFETY: all pointers are valid.
        self.ok(unsafe { sgs_context_get(self.0, &mut info) });
        info
    }

    pub fn load(&self, path: &Path) -> SgsScene {
        let (path, mut scene) = (text(path), 0);
        // SAFETY: all pointers are valid.
        self.ok(unsafe { sgs_scene_load(self.0, path.as_ptr(), &mut scene) });
        assert_ne!(scene, 0);
        scene
    }
}

impl Drop for Context {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            assert_eq!(self.info().validation_messages, 0);
        }
        // SAFETY: the test owns the context; at the second call it is null.
        unsafe {
            assert_eq!(sgs_context_destroy(&mut self.0), SgsResult::SGS_OK);
            assert!(self.0.is_null());
            assert_eq!(sgs_context_destroy(&mut self.0), SgsResult::SGS_ERROR_NULL);
        }
    }
}

pub fn text(path: &Path) -> CString {
    CString::new(path.to_str().unwrap()).unwrap()
}

pub fn camera(size: [u32; 2]) -> SgsCamera {
    let c = scenes::gpu_camera(&scenes::camera(size));
    let mut world_to_camera = [0.0; 12];
    world_to_camera.copy_from_slice(c.world_to_camera.as_flattened());
    sized!(SgsCamera {
        width: size[0],
        height: size[1],
        focal: c.focal,
        center: c.center,
        world_to_camera: world_to_camera,
    })
}
