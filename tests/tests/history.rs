//! Histories on a real device: each replay reads the previous replay's output.

use sgs_engine::graph::exec::{ExecOptions, Executor};
use sgs_engine::graph::{CompileOptions, Graph, History};
use sgs_tests::Gpu;
use std::sync::Arc;

const WORDS: u64 = 64;

/// Moves every word one place up and puts a one in front: after `n` replays `n` ones stand in front.
fn shift() -> (Graph, History) {
    let mut g = Graph::new("shift");
    let state = g.history("state", 4 * WORDS, 7);
    g.copy("move", state.previous.slice(0, 4 * (WORDS - 1)), state.current.slice(4, 4 * (WORDS - 1))).unwrap();
    g.fill("one", state.current.slice(0, 4), 1).unwrap();
    (g, state)
}

fn expected(replays: usize) -> Vec<u32> {
    (0..WORDS as usize).map(|word| if word < replays { 1 } else { 7 }).collect()
}

#[test]
fn each_replay_reads_what_the_last_one_wrote() {
    let gpu = Gpu::new();
    for frames_in_flight in [1, 2, 3] {
        let (g, state) = shift();
        let plan = Arc::new(g.compile(&CompileOptions::default()).unwrap());
        let mut exec =
            Executor::new(gpu.device(), plan, ExecOptions { frames_in_flight, ..Default::default() }).unwrap();
        let read = |exec: &Executor, half| {
            gpu.device().download_as::<u32>(exec.history(half).unwrap(), WORDS as usize).unwrap()
        };
        for replays in 1..=9 {
            exec.submit(&[]).unwrap();
            // Reading after every replay would hide a missing wait between them.
            if replays % 3 == 0 {
                exec.finish().unwrap();
                assert_eq!(read(&exec, state.current), expected(replays), "{frames_in_flight} in flight");
                assert_eq!(read(&exec, state.previous), expected(replays - 1));
            }
        }
        let slots = frames_in_flight.next_multiple_of(2) as u64;
        assert_eq!(exec.host_times().recordings, slots, "nothing is recorded again");

        exec.reset_histories().unwrap();
        assert_eq!(read(&exec, state.current), expected(0));
        exec.submit(&[]).unwrap();
        exec.submit(&[]).unwrap();
        exec.finish().unwrap();
        assert_eq!(read(&exec, state.current), expected(2));
        assert_eq!(exec.host_times().recordings, slots);
        let none = shift().0.external("none", 4);
        assert!(exec.history(none).is_err());
    }
}
