//! A window that shows a run: from where one wants, channel by channel, its lights as handles.
//!
//! Promises: what is seen is what `sgs render` and `sgs relight` write, drawn by the same plans; while nothing changes nothing
//! is drawn, and from frame to frame nothing is made. Leaves opening files, shading and showing to the crates below; no file
//! but pictures, their cameras and edits is written.

mod app;
mod canvas;
mod channel;
mod error;
mod eye;
mod font;
mod input;
mod lamps;
mod save;
mod source;
mod stage;

pub use app::{Options, Outcome, run};
pub use channel::Channel;
pub use error::{Result, ViewerError};
pub use input::KEYS;
