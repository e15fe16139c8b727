//! Pages that show a run: one HTML file with everything in it.
//!
//! Functions from data to HTML: pictures and sliders ([`figure`]), depth maps ([`depth`]), tables ([`table`]), curves and bars ([`chart`]), the room
//! with its lights ([`room`]), and the page around them ([`Page`]); and a server of such pages for
//! this machine ([`serve`]). Promises: nothing is fetched from anywhere, which the page
//! also forbids the browser; whatever comes from files is escaped; the page reads without its script, sliders apart. What is
//! shown, and where it comes from, is the caller's business.

pub mod chart;
pub mod depth;
pub mod figure;
mod page;
pub mod room;
pub mod serve;
pub mod table;
mod text;

pub use page::Page;
pub use text::{escape, number};
