//! Fuzzing of every reader: any input must yield a value or an error.
//!
//! A [`Target`] is a function that gives bytes to one reader, within a scene or run that is otherwise valid.
//! [`Campaign`] runs the files of a corpus (`corpus/TARGET.safetensors`) and mutations of them. It finds panics, memory
//! out of proportion to the input, and inputs that take too long. The mutations depend only on a seed, and on the branches
//! that inputs take if the program counts them (`coverage.toml`). The same targets run under libFuzzer (`libfuzzer/`).
//! The readers' own tests check the values.

mod campaign;
pub mod corpus;
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
pub use target::{TARGETS, Target, files, find, fuzz};
pub use words::Words;
