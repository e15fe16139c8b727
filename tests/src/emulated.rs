//! Graphs of tests on the emulator, at subgroup sizes that no device here has.
//!
//! With `SGS_TEST_EMULATE=32`, [`crate::Gpu`] plans for a GPU with 32 lanes, and the emulator runs the plan. A test
//! that only calls [`crate::Gpu::run`] therefore compares the kernels at that size with the same references.

use crate::pool::emulated_lanes;
use sgs_emulator::{Emulator, Run, Schedule};
use sgs_engine::graph::{Buffer, Plan};
use std::io::Write;

/// Races on buffers that change no result: kernel and buffer.
///
/// * `blend_features_bwd`: lanes past the end of a list read the flag of its last entry, which another lane of the
///   subgroup writes later. They do not use it.
/// * `semantic_samples`: lanes past the last sample read its row, which other lanes of the subgroup write later. They
///   do not use it.
/// * `visibility_encode_bwd`: a lane that reads an old word sets a bit that is set already.
const TOLERATED: &[(&str, &str)] =
    &[("blend_features_bwd", "entry_flags"), ("semantic_samples", "products"), ("visibility_encode_bwd", "touched")];

/// Emulator behind a device of tests.
pub(crate) struct Emulated {
    emulator: Emulator,
    run: Run,
}

impl Emulated {
    /// Returns an emulator if `SGS_TEST_EMULATE` asks for it.
    ///
    /// `SGS_TEST_ORDER` is the order of execution: `ascending`, `descending` or the seed of a shuffled one.
    pub fn wanted() -> Option<Emulated> {
        let lanes = emulated_lanes()?;
        let schedule = match std::env::var("SGS_TEST_ORDER").as_deref() {
            Err(_) | Ok("ascending") => Schedule::Ascending,
            Ok("descending") => Schedule::Descending,
            Ok(seed) => Schedule::Shuffled(
                seed.parse()
                    .unwrap_or_else(|_| panic!("SGS_TEST_ORDER is \"{seed}\"; use ascending, descending or a seed")),
            ),
        };
        Some(Emulated::new(lanes, schedule))
    }

    /// Returns an emulator of subgroups with this many lanes.
    pub fn new(lanes: u32, schedule: Schedule) -> Emulated {
        Emulated { emulator: Emulator::default(), run: Run { lanes, schedule, replays: 1, tolerated: TOLERATED } }
    }

    /// Returns the lanes of a subgroup.
    pub fn lanes(&self) -> u32 {
        self.run.lanes
    }

    /// Runs a plan and returns the contents of its external buffers.
    pub fn run(&self, plan: &Plan, inputs: &[(Buffer, Vec<u8>)], replays: usize) -> Vec<Vec<u8>> {
        let inputs: Vec<(usize, &[u8])> = inputs.iter().map(|(b, bytes)| (b.index(), bytes.as_slice())).collect();
        let run = Run { replays, ..self.run };
        self.emulator.run(plan, &inputs, run).unwrap_or_else(|fault| panic!("{fault}"))
    }
}

impl Drop for Emulated {
    /// Lists the kernels that ran, with their lanes.
    ///
    /// Appends them to the file that `SGS_TEST_EMULATED_KERNELS` names.
    fn drop(&mut self) {
        let Some(path) = std::env::var_os("SGS_TEST_EMULATED_KERNELS") else { return };
        let lines: String = self.emulator.ran().iter().map(|(kernel, lanes)| format!("{kernel} {lanes}\n")).collect();
        let file = std::fs::OpenOptions::new().append(true).create(true).open(path);
        if let Err(error) = file.and_then(|mut file| file.write_all(lines.as_bytes())) {
            eprintln!("the kernels could not be listed: {error}");
        }
    }
}
