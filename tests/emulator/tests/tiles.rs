//! Cooperative matrices on the emulator, in a module written here. Few GLSL compilers know them.

use sgs_emulator::{Binding, Dispatch, Fault, Kernel, Schedule, Store};
use spirv::Op;

const ROWS: u32 = 16;
const COLUMNS: u32 = 8;
const DEPTH: u32 = 32;

/// Numbers between the beginnings of rows, or columns, in shared memory.
const STRIDES: [u32; 3] = [DEPTH + 2, DEPTH + 6, COLUMNS + 4];

/// Module that grows by instructions. Ids count from one.
#[derive(Default)]
struct Module {
    words: Vec<u32>,
    ids: u32,
}

impl Module {
    fn id(&mut self) -> u32 {
        self.ids += 1;
        self.ids
    }

    fn op(&mut self, op: Op, args: &[u32]) {
        self.words.push((args.len() as u32 + 1) << 16 | op as u32);
        self.words.extend(args);
    }

    /// Adds a type, whose id comes first.
    fn ty(&mut self, op: Op, args: &[u32]) -> u32 {
        let id = self.id();
        self.op(op, &[&[id], args].concat());
        id
    }

    /// Adds an instruction with a result.
    fn value(&mut self, op: Op, ty: u32, args: &[u32]) -> u32 {
        let id = self.id();
        self.op(op, &[&[ty, id], args].concat());
        id
    }
}

/// Returns a module that computes (left * right + 2) / 2. The right operand lies column by column.
///
/// Without `ordered`, no barrier lies between the writes of the operands and the loads of the matrices.
fn module(lanes: u32, ordered: bool) -> Vec<u32> {
    let mut m = Module::default();
    let (main, lane) = (m.id(), m.id());
    let buffers = [0; 3].map(|_| m.id());
    let name = u32::from_le_bytes(*b"main");
    m.op(Op::EntryPoint, &[5, main, name, 0, lane]);
    m.op(Op::ExecutionMode, &[main, 17, lanes, 1, 1]);
    m.op(Op::Decorate, &[lane, 11, 41]);
    buffers.iter().enumerate().for_each(|(k, b)| m.op(Op::Decorate, &[*b, 33, k as u32]));
    let [list, block] = [0; 2].map(|_| m.id());
    m.op(Op::Decorate, &[list, 6, 4]);
    m.op(Op::MemberDecorate, &[block, 0, 35, 0]);
    let void = m.ty(Op::TypeVoid, &[]);
    let function = m.ty(Op::TypeFunction, &[void]);
    let [float, half] = [32, 16].map(|bits| m.ty(Op::TypeFloat, &[bits]));
    let uint = m.ty(Op::TypeInt, &[32, 0]);
    m.op(Op::TypeRuntimeArray, &[list, float]);
    m.op(Op::TypeStruct, &[block, list]);
    let uints: Vec<u32> = (0..=1024).map(|n| m.value(Op::Constant, uint, &[n])).collect();
    let number = |m: &mut Module, x: f32| m.value(Op::Constant, float, &[x.to_bits()]);
    let (two, factor) = (number(&mut m, 2.0), number(&mut m, 0.5));
    // Pointers to buffers, to shared memory and to the built-in variable.
    let pointer = |m: &mut Module, class: u32, ty: u32| m.ty(Op::TypePointer, &[class, ty]);
    let (to_block, to_item, to_lane) =
        (pointer(&mut m, 12, block), pointer(&mut m, 12, float), pointer(&mut m, 1, uint));
    m.op(Op::Variable, &[to_lane, lane, 1]);
    buffers.iter().for_each(|b| m.op(Op::Variable, &[to_block, *b, 12]));
    let operand = |m: &mut Module, element: u32| {
        let array = m.ty(Op::TypeArray, &[element, uints[1024]]);
        let to_array = pointer(m, 4, array);
        (m.value(Op::Variable, to_array, &[4]), pointer(m, 4, element), element)
    };
    let memory = [half, half, float].map(|element| operand(&mut m, element));
    let sizes = [[ROWS, DEPTH], [DEPTH, COLUMNS], [ROWS, COLUMNS]];
    let tiles: Vec<u32> = (0..3)
        .map(|k| {
            let [rows, columns] = sizes[k].map(|n| uints[n as usize]);
            m.ty(Op::TypeCooperativeMatrixKHR, &[memory[k].2, uints[3], rows, columns, uints[k]])
        })
        .collect();
    let addend = m.value(Op::ConstantComposite, tiles[2], &[two]);

    m.op(Op::Function, &[void, main, 0, function]);
    m.ty(Op::Label, &[]);
    let own = m.value(Op::Load, uint, &[lane]);
    // Lines of each operand: rows, columns and rows.
    let lines = [[ROWS, DEPTH], [COLUMNS, DEPTH], [ROWS, COLUMNS]];
    let places = |m: &mut Module, k: usize, j: u32| {
        let index = m.value(Op::IAdd, uint, &[own, uints[(j * lanes) as usize]]);
        let from = m.value(Op::AccessChain, to_item, &[buffers[k], uints[0], index]);
        let [line, along] = [Op::UDiv, Op::UMod].map(|op| m.value(op, uint, &[index, uints[lines[k][1] as usize]]));
        let before = m.value(Op::IMul, uint, &[line, uints[STRIDES[k] as usize]]);
        let at = m.value(Op::IAdd, uint, &[before, along]);
        (from, m.value(Op::AccessChain, memory[k].1, &[memory[k].0, at]))
    };
    for k in 0..2 {
        for j in 0..lines[k].iter().product::<u32>() / lanes {
            let (from, to) = places(&mut m, k, j);
            let read = m.value(Op::Load, float, &[from]);
            let rounded = m.value(Op::FConvert, half, &[read]);
            m.op(Op::Store, &[to, rounded]);
        }
    }
    let barrier = |m: &mut Module| m.op(Op::ControlBarrier, &[uints[3], uints[3], uints[0x108]]);
    if ordered {
        barrier(&mut m);
    }
    let begin = |m: &mut Module, k: usize| m.value(Op::AccessChain, memory[k].1, &[memory[k].0, uints[0]]);
    let [left, right] = [0, 1].map(|k| {
        let from = begin(&mut m, k);
        m.value(Op::CooperativeMatrixLoadKHR, tiles[k], &[from, uints[k], uints[STRIDES[k] as usize]])
    });
    let sum = m.value(Op::CooperativeMatrixMulAddKHR, tiles[2], &[left, right, addend]);
    let scaled = m.value(Op::MatrixTimesScalar, tiles[2], &[sum, factor]);
    let to = begin(&mut m, 2);
    m.op(Op::CooperativeMatrixStoreKHR, &[to, scaled, uints[0], uints[STRIDES[2] as usize]]);
    barrier(&mut m);
    for j in 0..ROWS * COLUMNS / lanes {
        let (to, from) = places(&mut m, 2, j);
        let read = m.value(Op::Load, float, &[from]);
        m.op(Op::Store, &[to, read]);
    }
    m.op(Op::Return, &[]);
    m.op(Op::FunctionEnd, &[]);
    [vec![0x0723_0203, 0x0001_0500, 0, m.ids + 1, 0], m.words].concat()
}

/// Runs the module. Returns the product.
fn run(lanes: u32, ordered: bool, operands: &[Vec<f32>; 2]) -> Result<Vec<f32>, Fault> {
    let kernel = Kernel::for_lanes(&module(lanes, ordered), &[], lanes)?;
    let words = |v: &[f32]| Store::new(v.iter().map(|x| x.to_bits()).collect());
    let mut stores = [words(&operands[0]), words(&operands[1]), words(&[f32::NAN; (ROWS * COLUMNS) as usize])];
    let bytes = [ROWS * DEPTH, DEPTH * COLUMNS, ROWS * COLUMNS].map(|n| 4 * u64::from(n));
    let bindings: Vec<Binding> =
        (0..3).map(|k| Binding { number: k as u32, store: k, offset: 0, bytes: bytes[k], image: None }).collect();
    let dispatch = Dispatch {
        lanes,
        groups: [1; 3],
        bindings: &bindings,
        push: &[],
        schedule: Schedule::Ascending,
        tolerated: &[],
        limit: 1_000_000,
    };
    kernel.run(&mut stores, &dispatch, 1)?;
    Ok(stores[2].words().iter().map(|bits| f32::from_bits(*bits)).collect())
}

/// Returns operands of small multiples of 1/8, whose products are exact. The right one lies column by column.
fn operands() -> [Vec<f32>; 2] {
    [ROWS, COLUMNS].map(|n| (0..n * DEPTH).map(|i| ((i * i * 7 + n) % 61) as f32 / 8.0 - 3.0).collect())
}

#[test]
fn products_match_at_every_width() {
    let all = operands();
    let at = |k: usize, line: u32, along: u32| all[k][(line * DEPTH + along) as usize];
    let expected: Vec<f32> = (0..ROWS * COLUMNS)
        .map(|i| {
            let products = (0..DEPTH).map(|k| at(0, i / COLUMNS, k) * at(1, i % COLUMNS, k));
            (products.sum::<f32>() + 2.0) / 2.0
        })
        .collect();
    for lanes in [4, 8, 16, 32, 64] {
        assert_eq!(run(lanes, true, &all).unwrap(), expected, "{lanes} lanes");
    }
}

#[test]
fn operands_are_rounded_to_16_bits() {
    let mut all = operands();
    let exact = run(32, true, &all).unwrap();
    // Less than half a unit in the last place of 16 bits, then more.
    all[0].iter_mut().for_each(|x| *x *= 1.0 + 1.0 / 8192.0);
    assert_eq!(run(32, true, &all).unwrap(), exact);
    all[0].iter_mut().for_each(|x| *x *= 1.0 + 1.0 / 512.0);
    assert_ne!(run(32, true, &all).unwrap(), exact);
}

#[test]
fn loads_without_a_barrier_are_races() {
    for lanes in [8, 64] {
        assert!(matches!(run(lanes, false, &operands()), Err(Fault::Race { .. })), "{lanes} lanes");
    }
}

#[test]
fn matrices_need_the_number_of_lanes() {
    assert!(matches!(Kernel::new(&module(32, true), &[]), Err(Fault::Missing(_))));
    // 512 elements do not spread over 24 lanes.
    assert!(matches!(Kernel::for_lanes(&module(32, true), &[], 24), Err(Fault::Missing(_))));
}
