//! HTML reports of a run: one self-contained file.
//!
//! Functions convert data to HTML: images and sliders ([`figure`]), depth maps ([`depth`]), tables ([`table`]), curves
//! and bars ([`chart`]), the scene with its lights ([`room`]), and the page around them ([`Page`]). A server shows such
//! pages on this machine ([`serve`]).
//!
//! Guarantees: a page fetches nothing from other hosts, and its policy forbids the browser to do so. All text from
//! files is escaped. The page is readable without its script, except sliders. The caller chooses the content and its
//! source.

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
