//! Scenes from photographs or a video: upright images, cameras and points.
//!
//! [`capture()`] prepares the images, runs COLMAP over them, removes lens distortion, and writes a scene directory that
//! training accepts. The programs `colmap`, `ffmpeg` (videos) and `heif-convert` (HEIC) are started as child processes;
//! none outlives the call. The scene appears under its name when it is complete, and never before.

mod capture;
mod colmap;
mod error;
mod groups;
mod photographs;
mod pnm;
mod prepared;
mod process;
mod record;
mod sharpness;
mod video;

pub use capture::{CaptureOptions, Matcher, capture};
pub use error::{CaptureError, Result};
pub use record::{Captured, Unregistered};
