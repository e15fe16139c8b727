//! Random graphs on the device, bit for bit against their declaration. A CPU runs the declaration pass by pass.
//!
//! `SGS_RANDOM_SEED` runs a single graph. `SGS_RANDOM_GRAPHS` sets the number of graphs, and `SGS_RANDOM_FIRST` the
//! first seed.

use sgs_engine::exec::{ExecOptions, Executor};
use sgs_engine::graph::{BufferKind, PassKind, Plan};
use sgs_engine::{Device, DeviceBuffer, Location};
use sgs_tests::Gpu;
use sgs_tests::random::{Kind, Machine, Op, Recipe, draw};
use std::sync::Arc;

/// Device with memory that all graphs share.
struct Bench {
    /// Memory by buffer of a recipe.
    memory: Vec<DeviceBuffer>,
    arena: DeviceBuffer,
    // Last field, because the buffers must not outlive it.
    gpu: Gpu,
}

impl Bench {
    fn new() -> Bench {
        let gpu = Gpu::new();
        // Host-visible memory needs no staging.
        let buffer = |name: &str, bytes| gpu.device().buffer(name, bytes, Location::Readback).unwrap();
        let memory = (0..24).map(|index| buffer(&format!("pool {index}"), 1 << 14)).collect();
        let arena = buffer("arena", 1 << 18);
        Bench { memory, arena, gpu }
    }

    fn device(&self) -> &Device {
        self.gpu.device()
    }

    fn recipe(&self, seed: u32) -> Recipe {
        draw(seed, self.device().info().storage_alignment)
    }

    /// Runs a recipe; returns an error that names the first wrong word.
    fn run(&self, recipe: &Recipe, damage: impl FnOnce(&mut Plan)) -> Result<Arc<Plan>, String> {
        let (graph, buffers) = recipe.declare().map_err(|e| e.to_string())?;
        let mut plan = graph.compile(&recipe.options).map_err(|e| e.to_string())?;
        damage(&mut plan);
        let plan = Arc::new(plan);
        assert!(plan.arena_bytes <= self.arena.bytes(), "the arena of seed {} is too large", recipe.seed);
        let options = ExecOptions {
            frames_in_flight: recipe.frames,
            poison: recipe.poison,
            arena: Some(self.arena.clone()),
            ..Default::default()
        };
        let mut exec = Executor::new(self.device(), plan.clone(), options).map_err(|e| e.to_string())?;
        for (index, info) in plan.buffers.iter().enumerate().filter(|(_, info)| info.kind == BufferKind::External) {
            let words: Vec<u32> =
                (0..info.bytes as usize / 4).map(|word| Machine::initial(recipe, index, word)).collect();
            self.memory[index].write(0, bytemuck::cast_slice(&words)).map_err(|e| e.to_string())?;
            exec.bind(buffers[index], &self.memory[index]).map_err(|e| e.to_string())?;
        }
        let uniform = buffers[2];
        let mut machine = Machine::new(recipe);
        for replay in 0..recipe.replays {
            let words = Machine::uniform(recipe, replay);
            exec.submit(&[(uniform, bytemuck::cast_slice(&words))]).map_err(|e| e.to_string())?;
            machine.replay(replay);
        }
        exec.finish().map_err(|e| e.to_string())?;
        for (index, &(kind, words)) in recipe.buffers.iter().enumerate() {
            let mut found = vec![0u32; words];
            let (memory, offset) = match (kind, plan.placements[index]) {
                (Kind::External | Kind::Input, _) => (&self.memory[index], 0),
                (Kind::Retained, Some(offset)) => (&self.arena, offset),
                _ => continue,
            };
            memory.read(offset, bytemuck::cast_slice_mut(&mut found)).map_err(|e| e.to_string())?;
            for (word, (expected, found)) in machine.words[index].iter().zip(found).enumerate() {
                if expected.is_some_and(|expected| expected != found) {
                    let name = &plan.buffers[index].name;
                    return Err(format!("word {word} of {name} is {found:#x} and should be {expected:x?}"));
                }
            }
        }
        Ok(plan)
    }

    /// Runs an undamaged recipe. Messages of the validation layer count as failures.
    fn run_clean(&self, recipe: &Recipe) -> Result<Arc<Plan>, String> {
        let outcome = self.run(recipe, |_| {});
        match self.device().messages().take().into_iter().next() {
            Some(message) => Err(message),
            None => outcome,
        }
    }

    /// Runs an undamaged recipe; a failure reports the shortest prefix of passes that fails.
    fn check(&self, seed: u32) -> Arc<Plan> {
        let recipe = self.recipe(seed);
        let failure = match self.run_clean(&recipe) {
            Ok(plan) => return plan,
            Err(failure) => failure,
        };
        let shortest = (1..=recipe.ops.len()).map(|passes| recipe.prefix(passes));
        let failing = shortest.map(|less| (self.run_clean(&less), less)).find(|(outcome, _)| outcome.is_err());
        let (outcome, less) = failing.unwrap_or((Err(failure), recipe));
        let plan = less.declare().and_then(|(graph, _)| graph.compile(&less.options));
        panic!(
            "seed {seed}, its first {} passes: {}\nSGS_RANDOM_SEED={seed} runs it alone.\n{less:#?}\n{}",
            less.ops.len(),
            outcome.err().unwrap_or_default(),
            plan.map_or_else(|e| e.to_string(), |plan| plan.to_string()),
        );
    }
}

fn variable(name: &str) -> Option<u32> {
    std::env::var(name).ok().map(|text| text.parse().unwrap_or_else(|_| panic!("{name} is \"{text}\", not a number")))
}

#[test]
fn random_graphs_compute_what_they_declare() {
    let bench = Bench::new();
    if let Some(seed) = variable("SGS_RANDOM_SEED") {
        bench.check(seed);
        return;
    }
    let count = variable("SGS_RANDOM_GRAPHS").unwrap_or(2000);
    let first = variable("SGS_RANDOM_FIRST").unwrap_or(0);
    let [mut running, mut dropped, mut wide, mut shared, mut indirect, mut transfers] = [0; 6];
    for seed in first..first + count {
        let plan = bench.check(seed);
        running += plan.groups.iter().map(|group| group.passes.len()).sum::<usize>();
        wide += plan.groups.iter().filter(|group| group.passes.len() > 1).count();
        dropped += plan.culled.len();
        shared += usize::from(plan.arena_bytes < plan.arena_unaliased_bytes);
        for &pass in plan.groups.iter().flat_map(|group| &group.passes) {
            let pass = &plan.passes[pass];
            transfers += usize::from(pass.is_transfer());
            indirect += usize::from(pass.accesses.iter().any(|a| a.2 == sgs_engine::graph::Use::Indirect));
        }
    }
    println!(
        "{count} graphs: {running} passes, {transfers} of them transfers, {indirect} indirect; {dropped} dropped; \
         {wide} groups of several; {shared} arenas shared"
    );
    // The test is meaningful only if the graphs are varied.
    let n = count as usize;
    assert!(running > 6 * n && wide > n / 2 && dropped > n && shared > n / 10, "the graphs are trivial");
    assert!(transfers > n / 2 && indirect > n / 4, "the graphs are all alike");
}

/// Changes the seed of the last pass that has one.
fn reseed(plan: &mut Plan) -> bool {
    for pass in plan.groups.iter().rev().flat_map(|group| group.passes.clone()).collect::<Vec<_>>() {
        if let PassKind::Compute { push, shader, .. } = &mut plan.passes[pass].kind
            && shader.name != "counts"
        {
            push[1] ^= 0x5a;
            return true;
        }
    }
    false
}

/// Swaps the first two consecutive groups that depend on each other.
fn swap(plan: &mut Plan) -> bool {
    let follows = plan.dependencies();
    for at in 1..plan.groups.len() {
        let (before, after) = (&plan.groups[at - 1].passes, &plan.groups[at].passes);
        if after.iter().any(|&pass| follows[pass].iter().any(|b| before.contains(&(*b as usize)))) {
            let passes = std::mem::take(&mut plan.groups[at].passes);
            plan.groups[at].passes = std::mem::replace(&mut plan.groups[at - 1].passes, passes);
            return true;
        }
    }
    false
}

/// Places two transients with overlapping lifetimes at the same offset.
fn overlap(plan: &mut Plan) -> bool {
    let lives = plan.lifetimes();
    for first in 0..lives.len() {
        for second in 0..first {
            if let (Some((a, b)), Some((c, d))) = (lives[first], lives[second])
                && a <= d
                && c <= b
            {
                plan.placements[first] = plan.placements[second];
                return true;
            }
        }
    }
    false
}

#[test]
fn wrong_plans_are_detected() {
    let bench = Bench::new();
    type Damage = fn(&mut Plan) -> bool;
    let damages: [(&str, Damage); 3] = [("reseed", reseed), ("swap", swap), ("overlap", overlap)];
    for (what, damage) in damages {
        let [mut damaged, mut noticed] = [0; 2];
        for seed in 0..800 {
            let recipe = bench.recipe(seed);
            // A wrong plan may produce arbitrary group counts.
            if recipe.ops.iter().any(|op| matches!(op, Op::Run { kernel: "counts", .. })) {
                continue;
            }
            let mut done = false;
            let outcome = bench.run(&recipe, |plan| done = damage(plan));
            damaged += usize::from(done);
            noticed += usize::from(done && outcome.is_err());
        }
        println!("{what}: {noticed} of {damaged} noticed");
        assert!(damaged >= 10 && 10 * noticed >= 5 * damaged, "{what}: only {noticed} of {damaged} are noticed");
    }
    // Messages of the layers about wrong plans are not tested here.
    bench.device().messages().take();
}
