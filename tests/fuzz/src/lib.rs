//! Damaged files for every reader: what a reader takes from outside may be anything, and must come to a value or a sentence.
//!
//! A [`Target`] is a function of bytes that brings them to one reader, in the middle of a scene or run that is otherwise whole.
//! [`Campaign`] feeds it files of a kept corpus (`corpus/TARGET`) and changes of them, and finds panics, memory out of proportion
//! to the input, and inputs that take too long. What changes are made depends on a seed alone, and on the branches that inputs take where
//! the program counts them (`coverage.toml`). The same targets run under libFuzzer (`libfuzzer/`). Leaves it to the readers' own tests
//! whether what is read is right.

mod campaign;
mod count;
mod coverage;
mod distill;
mod fix;
mod mutate;
mod place;
mod seeds;
mod target;
mod targets;
mod words;

pub use campaign::{Campaign, Finding, Tally, hash, quietly, taken};
pub use count::Counting;
pub use coverage::enlist;
pub use distill::distill;
pub use mutate::{Generator, Rng};
pub use place::Place;
pub use seeds::write_seeds;
pub use target::{TARGETS, Target, corpus, files, find, folder, fuzz};
pub use words::Words;
