//! Viewer window for a run: free viewpoint, channels, lights as handles.
//!
//! Guarantees: the window shows the images that `sgs render` and `sgs relight` write, drawn by the same pipelines.
//! Without a change it draws no frame, and repeated frames create no buffers or images. Crates below open files, shade
//! and present. The viewer writes only images, their cameras and edits.

mod app;
mod canvas;
mod channel;
mod error;
mod eye;
mod font;
mod input;
mod lights;
mod save;
mod source;
mod stage;

pub use app::{Options, Outcome, run};
pub use channel::Channel;
pub use error::{Result, ViewerError};
pub use input::KEYS;
