//! Random graphs: the verifier accepts every compiled plan, and running the plan gives the same results as running
//! the declaration.

use proptest::prelude::*;

use super::kernels::{bind, kind_of, pass, with_kinds};
use super::*;
use crate::format::ImageFormat;
use crate::shader::Access;

/// Size and alignment unit of all ranges in bytes.
const CELL: u64 = 16;

/// Random buffers and passes. Values are reduced to valid ranges when the graph is built.
#[derive(Clone, Debug)]
pub(super) struct Recipe {
    buffers: Vec<(u8, u64, bool)>,
    passes: Vec<(u8, Vec<Touch>)>,
    pub(super) options: CompileOptions,
}

#[derive(Clone, Debug)]
struct Touch {
    buffer: usize,
    access: u8,
    start: u64,
    length: u64,
    discard: bool,
}

pub(super) fn recipes(passes: usize) -> impl Strategy<Value = Recipe> {
    let touch = (0usize..64, 0u8..8, 0u64..6, 1u64..7, proptest::bool::weighted(0.2))
        .prop_map(|(buffer, access, start, length, discard)| Touch { buffer, access, start, length, discard });
    let buffers = proptest::collection::vec((0u8..18, 1u64..7, proptest::bool::weighted(0.1)), 4..16);
    let passes = proptest::collection::vec((0u8..8, proptest::collection::vec(touch, 1..5)), passes / 4..passes);
    (buffers, passes, any::<(bool, bool)>()).prop_map(|(buffers, passes, (alias, reorder))| Recipe {
        buffers,
        passes,
        options: CompileOptions { alignment: CELL, alias, reorder, verify: false },
    })
}

impl Recipe {
    /// Builds the graph. Omits passes that would be errors.
    pub(super) fn build(&self) -> Graph {
        let mut graph = Graph::new("random");
        // At least one output, so that some passes are live.
        graph.external("e", 8 * CELL);
        for (index, &(kind, cells, keep)) in self.buffers.iter().enumerate() {
            let (name, bytes) = (format!("b{index}"), cells * CELL);
            match kind {
                0 => graph.input(name, bytes),
                1 => graph.uniform(name, bytes),
                2 | 3 => graph.external(name, bytes),
                4 | 5 => {
                    let buffer = graph.external(name, bytes);
                    let state = |queue| if queue { BufferState::Queue } else { BufferState::Ready };
                    graph.shared(buffer, state(keep || cells > 2), state(keep || cells < 4));
                    buffer
                }
                12..=17 => self.image(&mut graph, name, kind, cells, keep).0,
                _ => {
                    let buffer = graph.transient(name, bytes);
                    if keep {
                        graph.keep(buffer);
                    }
                    buffer
                }
            };
        }
        for (index, (kind, touches)) in self.passes.iter().enumerate() {
            let before = graph.clone();
            if self.declare(&mut graph, format!("p{index}"), *kind, touches).is_err() {
                graph = before;
            }
        }
        // Reads some of the transients at the end.
        let made = (0..graph.buffers.len())
            .filter(|index| index % 3 == 0)
            .map(|index| Slice { bytes: graph.buffers[index].bytes, ..Slice::from(Buffer(index as u32)) });
        let mut touched: Vec<_> = made
            .filter(|slice| graph.buffers[slice.buffer.index()].kind == BufferKind::Transient)
            .filter(|slice| graph.check_written("", slice).is_ok())
            .map(|slice| (slice, Access::Read))
            .collect();
        touched.push((Buffer(0).slice(0, 8 * CELL), Access::ReadWrite));
        pass(&mut graph, "end", &touched);
        graph
    }

    /// Declares an image of a kind, in varying states.
    fn image(&self, graph: &mut Graph, name: String, kind: u8, cells: u64, keep: bool) -> Image {
        const STATES: [ImageState; 6] = [
            ImageState::General,
            ImageState::TransferSource,
            ImageState::TransferTarget,
            ImageState::ShaderRead,
            ImageState::Present,
            ImageState::Undefined,
        ];
        // One texel per cell.
        let (size, format) = ([cells as u32, 1], ImageFormat::Rgba32Float);
        match kind {
            12 => {
                let entry = STATES[(cells as usize + usize::from(keep) * 3) % 6];
                graph.external_image(name, size, format, entry, STATES[self.passes.len() % 5])
            }
            13 => graph.input_image(name, size, format, STATES[self.passes.len() % 5]),
            _ => {
                let image = graph.transient_image(name, [size[0].div_ceil(4), 1], format);
                if keep {
                    graph.keep_image(image);
                }
                image
            }
        }
    }

    fn declare(&self, graph: &mut Graph, name: String, kind: u8, touches: &[Touch]) -> Result<(), GraphError> {
        let slice = |touch: &Touch| {
            let index = touch.buffer % graph.buffers.len();
            if graph.buffers[index].image.is_some() {
                return Buffer(index as u32).slice(0, graph.buffers[index].bytes);
            }
            let cells = graph.buffers[index].bytes / CELL;
            let start = touch.start % cells;
            Buffer(index as u32).slice(start * CELL, touch.length.min(cells - start) * CELL)
        };
        let slices: Vec<_> = touches.iter().map(slice).collect();
        match (kind, slices.as_slice()) {
            (0, [target, ..]) if is_image(graph, target) => graph.clear_image(name, Image(target.buffer), [1.0; 4]),
            (0, [target, ..]) => graph.fill(name, *target, 1),
            (1, [source, target, ..]) if is_image(graph, source) || is_image(graph, target) => {
                match (is_image(graph, source), is_image(graph, target)) {
                    (true, false) => {
                        graph.copy_from_image(name, Image(source.buffer), target.buffer.slice(0, source.bytes))
                    }
                    (false, true) => {
                        graph.copy_to_image(name, source.buffer.slice(0, target.bytes), Image(target.buffer))
                    }
                    _ => graph.clear_image(name, Image(target.buffer), [0.0; 4]),
                }
            }
            (1, [source, target, ..]) => {
                let bytes = source.bytes.min(target.bytes);
                graph.copy(name, Slice { bytes, ..*source }, Slice { bytes, ..*target })
            }
            _ => {
                // Invalid choices are corrected, so that most passes remain: of overlapping slices the first stays,
                // inputs are read, and unwritten transients are written.
                let keep = |at: &usize| !slices[..*at].iter().any(|slice| slice.overlaps(&slices[*at]));
                let (touches, slices): (Vec<_>, Vec<_>) =
                    (0..slices.len()).filter(keep).map(|at| (&touches[at], slices[at])).unzip();
                let access = |(touch, slice): (&&Touch, &Slice)| {
                    let written = graph.check_written("", slice).is_ok();
                    match touch.access {
                        _ if !graph.buffers[slice.buffer.index()].writable() => Access::Read,
                        0..=3 if written && !touch.discard => Access::Read,
                        4 if written => Access::ReadWrite,
                        5 | 6 if written => Access::Accumulate,
                        _ => Access::Write,
                    }
                };
                let accesses: Vec<_> = touches.iter().zip(&slices).map(access).collect();
                let kinds: Vec<_> =
                    slices.iter().zip(&accesses).map(|(s, access)| (kind_of(graph, s), *access)).collect();
                let indirect = slices.first().copied().filter(|first| kind == 2 && !is_image(graph, first));
                let kernel = with_kinds("k", &kinds);
                let mut pass = graph.pass(name, &kernel);
                for (index, (touch, slice)) in touches.iter().zip(&slices).enumerate() {
                    let discards = touch.discard && matches!(accesses[index], Access::Write | Access::ReadWrite);
                    pass = bind(pass, index, *slice, discards);
                }
                match indirect {
                    Some(slice) => pass.dispatch_indirect(slice.buffer, slice.offset),
                    None => pass.dispatch([1, 1, 1]),
                }
            }
        }
    }
}

/// Simulated memory after some replays, one number per cell: each pass mixes its inputs into its outputs.
struct Machine<'p> {
    plan: &'p Plan,
    /// By space (buffers, then the arena and image slots) and cell: owner and value.
    cells: Vec<Vec<(usize, u64)>>,
    /// Whether transients use the arena.
    arena: bool,
}

/// Returns whether a slice belongs to an image.
fn is_image(graph: &Graph, slice: &Slice) -> bool {
    graph.buffers[slice.buffer.index()].image.is_some()
}

/// Owner of an unwritten cell.
const NOBODY: usize = usize::MAX;

impl<'p> Machine<'p> {
    fn new(plan: &'p Plan, arena: bool) -> Self {
        let mut cells: Vec<Vec<_>> = Vec::new();
        for (index, info) in plan.buffers.iter().enumerate() {
            let owner = if info.kind == BufferKind::Transient { NOBODY } else { index };
            cells.push((0..info.bytes / CELL).map(|cell| (owner, mix(index as u64, cell))).collect());
        }
        cells.push(vec![(NOBODY, 0); (plan.arena_bytes / CELL) as usize]);
        cells.extend(plan.image_slots.iter().map(|slot| vec![(NOBODY, 0); (slot.bytes() / CELL) as usize]));
        Machine { plan, cells, arena }
    }

    fn cell(&mut self, buffer: usize, cell: u64) -> &mut (usize, u64) {
        let in_arena = self.arena && self.plan.buffers[buffer].kind == BufferKind::Transient;
        let (space, first) = if in_arena && self.plan.buffers[buffer].image.is_some() {
            (self.plan.buffers.len() + 1 + self.plan.placements[buffer].unwrap() as usize, 0)
        } else if in_arena {
            (self.plan.buffers.len(), self.plan.placements[buffer].unwrap() / CELL)
        } else {
            (buffer, 0)
        };
        &mut self.cells[space][(first + cell) as usize]
    }

    /// Returns the value of a cell; a fixed value if another buffer owns it.
    fn load(&mut self, buffer: usize, cell: u64) -> u64 {
        let (owner, value) = *self.cell(buffer, cell);
        if owner == buffer { value } else { 0xdead }
    }

    /// Simulates the beginning of a replay: invalidates transients and images with undefined
    /// contents.
    fn begin(&mut self) {
        for (index, info) in self.plan.buffers.iter().enumerate() {
            let undefined = info.image.is_some_and(|image| image.entry == ImageState::Undefined);
            if undefined || info.kind == BufferKind::Transient {
                self.cells[index].fill((NOBODY, 0));
            }
        }
        self.cells[self.plan.buffers.len()..].iter_mut().for_each(|space| space.fill((NOBODY, 0)));
    }

    fn run(&mut self, index: usize) {
        let pass = &self.plan.passes[index];
        let cells = |slice: &Slice| slice.offset / CELL..(slice.offset + slice.bytes).div_ceil(CELL);
        let mut read = index as u64;
        for (slice, access, _) in &pass.accesses {
            if *access == Access::Read || (*access == Access::ReadWrite && !pass.discards(slice)) {
                for cell in cells(slice) {
                    read = mix(read, self.load(slice.buffer.index(), cell));
                }
            }
        }
        for (slice, access, _) in pass.accesses.iter().filter(|(_, access, _)| *access != Access::Read) {
            let buffer = slice.buffer.index();
            for cell in cells(slice) {
                let value = mix(read, cell);
                // A kernel that only writes may preserve cells, unless it discards.
                let leaves = *access == Access::Write && !pass.discards(slice) && value.is_multiple_of(3);
                let old = self.load(buffer, cell);
                let new = match access {
                    Access::Accumulate => old.wrapping_add(value),
                    _ if leaves => continue,
                    _ => value,
                };
                *self.cell(buffer, cell) = (buffer, new);
            }
        }
    }

    fn outputs(&mut self) -> Vec<u64> {
        let plan = self.plan;
        // An unused kept transient has neither memory nor contents.
        let retained = plan.buffers().filter(|(buffer, info)| {
            info.keep && (info.kind != BufferKind::Transient || plan.placements[buffer.index()].is_some())
        });
        retained
            .flat_map(|(buffer, info)| (0..info.bytes / CELL).map(move |cell| (buffer.index(), cell)))
            .map(|(index, cell)| self.load(index, cell))
            .collect()
    }
}

fn mix(a: u64, b: u64) -> u64 {
    (a ^ b.wrapping_mul(0x9e37_79b9_7f4a_7c15)).rotate_left(29).wrapping_mul(0xbf58_476d_1ce4_e5b9)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1500, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn verifier_accepts_every_plan(recipe in recipes(40)) {
        let plan = recipe.build().compile(&recipe.options).unwrap();
        if let Err(error) = verify(&plan) {
            return Err(TestCaseError::fail(format!("{error}\n{plan}")));
        }
    }

    #[test]
    fn equal_declarations_give_equal_plans(recipe in recipes(40)) {
        let [first, second] = [(); 2].map(|()| recipe.build().compile(&recipe.options).unwrap());
        prop_assert_eq!(format!("{first:?}"), format!("{second:?}"));
        prop_assert_eq!(dump::json(&first), dump::json(&second));
    }

    #[test]
    fn plan_matches_declared_order(recipe in recipes(40)) {
        let plan = recipe.build().compile(&recipe.options).unwrap();
        let mut declared = Machine::new(&plan, false);
        let mut planned = Machine::new(&plan, true);
        for _ in 0..3 {
            declared.begin();
            planned.begin();
            (0..plan.passes.len()).for_each(|pass| declared.run(pass));
            // Passes of a group may run in any order, here in reverse.
            plan.groups.iter().for_each(|group| group.passes.iter().rev().for_each(|&pass| planned.run(pass)));
            prop_assert_eq!(declared.outputs(), planned.outputs(), "{}", plan);
        }
    }
}

/// Guards the comparison above: an order that violates the data flow changes the outputs.
#[test]
fn machine_detects_wrong_order() {
    let mut graph = Graph::new("order");
    let out = graph.external("out", 4 * CELL);
    graph.fill("fill", out, 1).unwrap();
    pass(&mut graph, "change", &[(out.slice(0, 4 * CELL), Access::ReadWrite)]);
    let plan = graph.compile(&CompileOptions { alignment: CELL, ..Default::default() }).unwrap();
    let outputs = |order: [usize; 2]| {
        let mut machine = Machine::new(&plan, true);
        order.iter().for_each(|&pass| machine.run(pass));
        machine.outputs()
    };
    assert_ne!(outputs([0, 1]), outputs([1, 0]));
}

/// Guards the properties above: random graphs must cover every feature.
#[test]
fn random_graphs_are_not_trivial() {
    use proptest::strategy::{Strategy, ValueTree};
    let mut runner = proptest::test_runner::TestRunner::deterministic();
    let count = 300;
    let [mut running, mut dropped, mut groups, mut shared, mut wide, mut layouts, mut slots] = [0; 7];
    for _ in 0..count {
        let recipe = recipes(40).new_tree(&mut runner).unwrap().current();
        let plan = recipe.build().compile(&recipe.options).unwrap();
        running += plan.passes.len() - plan.culled.len();
        dropped += plan.culled.len();
        groups += plan.groups.len();
        wide += plan.groups.iter().filter(|group| group.passes.len() > 1).count();
        shared += usize::from(plan.arena_bytes < plan.arena_unaliased_bytes);
        layouts += plan.entry.len() + plan.exit.len();
        let images = plan.buffers().filter(|(b, i)| i.image.is_some() && plan.placements[b.index()].is_some());
        slots += images.count() - plan.image_slots.len();
    }
    println!("{running} running, {dropped} dropped, {groups} groups, {wide} wide, {shared} with shared memory");
    println!("{layouts} changes of layout, {slots} slots shared");
    assert!(layouts > count && slots > 3);
    assert!(running > 8 * count && dropped > count && groups > 4 * count && wide > count && shared > count / 20);
}
