//! Scan, sort and work records against their references. Cases are sizes around every boundary, counts from the host
//! and from the GPU, memory after the last element, overflow, and difficult keys.

use sgs_engine::Location;
use sgs_engine::exec::{ExecOptions, Executor};
use sgs_engine::graph::{Buffer, CompileOptions, Graph, GraphError, Slice};
use sgs_passes::Tuning;
use sgs_passes::prim::{Count, Overflow, Records, ScanShape, SortShape, exclusive_scan, radix_sort, work};
use sgs_passes::reference::{radix_sort as sort_reference, rng::Pcg, scan as scan_reference};
use sgs_shaders::structs::Work;
use sgs_tests::Gpu;
use std::ops::Range;
use std::sync::Arc;

const POISON: u32 = u32::MAX;

/// Source of a stage's count.
#[derive(Clone, Copy, Debug, PartialEq)]
enum From {
    Host,
    /// Record for the stage's own group size.
    Record,
    /// Record for another group size, with arguments that must not be used.
    OtherRecord,
}

const SOURCES: [From; 3] = [From::Host, From::Record, From::OtherRecord];

/// Returns the expected arguments of a record. They cover all groups, and no axis exceeds 65535, which every device
/// supports.
fn record_of(count: u32, group_size: u32) -> Work {
    let n = count.div_ceil(group_size).max(1);
    let x = n.min(65535);
    Work { x, y: n.div_ceil(x), z: 1, count }
}

/// Declares a count in a graph and returns it with its input.
fn count_in(g: &mut Graph, from: From, count: u32, max: u32, block: u32) -> (Count, Vec<(Buffer, Vec<u8>)>) {
    if from == From::Host {
        return (Count::Host(count), Vec::new());
    }
    let buffer = g.input("work", 16);
    let (work, group_size) = match from {
        From::Record => (record_of(count, block), block),
        _ => (Work { x: POISON, y: POISON, z: POISON, count }, block + 1),
    };
    (Count::Gpu(Records::one(buffer, group_size, max)), vec![(buffer, bytemuck::bytes_of(&work).to_vec())])
}

fn bytes(words: &[u32]) -> Vec<u8> {
    bytemuck::cast_slice(words).to_vec()
}

/// Returns the bytes of a buffer for `n` words; at least one word.
fn room(n: usize) -> u64 {
    4 * n.max(1) as u64
}

/// Returns the first difference from the expected words and the poison after them.
fn difference(expected: &[u32], found: &[u32]) -> Option<String> {
    let expected = expected.iter().chain(std::iter::repeat(&POISON));
    let mut differing = expected.zip(found).enumerate().filter(|(_, (e, f))| e != f);
    let (i, (e, f)) = differing.next()?;
    Some(format!("element {i} should be {e:#x}, is {f:#x}, and {} more differ", differing.count()))
}

#[track_caller]
fn assert_same(what: &str, expected: &[u32], found: &[u32]) {
    assert!(expected.len() <= found.len(), "{what}: {} of {} elements", found.len(), expected.len());
    if let Some(difference) = difference(expected, found) {
        panic!("{what}: {difference}");
    }
}

#[test]
fn planted_errors_are_caught() {
    assert_eq!(difference(&[1, 2, 3], &[1, 2, 3, POISON]), None);
    assert!(difference(&[1, 2, 3], &[1, 3, 3, POISON]).is_some());
    assert!(difference(&[1, 2, 3], &[1, 2, 3, 0]).is_some());
    assert!(difference(&[1, 2, 3], &[1, 2, POISON]).is_some());
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum How {
    InPlace,
    Copied,
    Gathered,
}

/// Scans the first `count` of `values` and compares everything with the reference.
fn check_scan(gpu: &Gpu, shape: ScanShape, how: How, from: From, values: &[u32], count: usize) {
    let what = format!("{shape:?} {how:?} {from:?} {count} of {}", values.len());
    let mut g = Graph::new("scan");
    let max = if from == From::Host { count } else { values.len() };
    let (counted, mut inputs) = count_in(&mut g, from, count as u32, max as u32, shape.block());
    let target = g.external("target", room(values.len()));
    let total = g.external("total", 8);
    let source = if how == How::InPlace { target } else { g.input("source", room(values.len())) };
    inputs.push((source, bytes(values)));
    // The permutation is no involution.
    let permutation: Vec<u32> = (0..values.len()).map(|i| ((i * 7 + 3) % values.len()) as u32).collect();
    let permutes = !values.len().is_multiple_of(7);
    let index = (how == How::Gathered).then(|| {
        let index = g.input("index", room(values.len()));
        inputs.push((index, bytes(&permutation)));
        Slice::from(index)
    });
    exclusive_scan(&mut g, shape, "scan", source, index, target, total, counted).unwrap();
    let out = gpu.run(g, &inputs);
    let (mut expected, sum) = match how {
        How::Gathered => scan_reference::exclusive_scan(values, Some(&permutation[..count])),
        _ => scan_reference::exclusive_scan(&values[..count], None),
    };
    assert!(how != How::Gathered || permutes || values.len() < 7, "the index of the test visits elements twice");
    if how == How::InPlace {
        expected.extend(&values[count..]);
    }
    assert_same(&what, &expected, &out.get(target));
    assert_same(&what, &[sum], &out.get(total));
}

fn random_words(n: usize, seed: u32, below: u32) -> Vec<u32> {
    let mut rng = Pcg::new(seed);
    (0..n).map(|_| ((u64::from(rng.next_u32()) * u64::from(below)) >> 32) as u32).collect()
}

/// Returns the device's shape, one with several subgroups, and a tiny one.
fn scan_shapes(gpu: &Gpu) -> [ScanShape; 3] {
    let subgroup_size = gpu.subgroup_size();
    [
        gpu.tuning().into(),
        ScanShape { subgroup_size, workgroup: (8 * subgroup_size).min(256), items: 4 },
        ScanShape { subgroup_size, workgroup: 2 * subgroup_size, items: 1 },
    ]
}

#[test]
fn scan_of_sizes_around_every_boundary() {
    let gpu = Gpu::new();
    for shape in scan_shapes(&gpu) {
        let (group, block) = (shape.workgroup as usize, shape.block() as usize);
        // With the tiny shape, the spine takes more than one round.
        let spine = 16 * group * block;
        let mut sizes = vec![0, 1, group - 1, group, group + 1, 997, block - 1, block, block + 1, 3 * block + 5];
        if spine < 20_000 {
            sizes.extend([spine - 1, spine, spine + 1, 2 * spine + block + 1]);
        }
        for (i, size) in sizes.into_iter().enumerate() {
            check_scan(&gpu, shape, How::InPlace, From::Host, &random_words(size, i as u32, 1 << 12), size);
        }
    }
}

#[test]
fn scan_copies_gathers_and_counts_on_the_gpu() {
    let gpu = Gpu::new();
    for shape in scan_shapes(&gpu) {
        let capacity = 3 * shape.block() as usize + 11;
        let capacity = capacity + usize::from(capacity.is_multiple_of(7));
        let values = random_words(capacity, 9, 1 << 12);
        for how in [How::InPlace, How::Copied, How::Gathered] {
            for from in SOURCES {
                for count in [0, 1, capacity / 2, capacity] {
                    check_scan(&gpu, shape, how, from, &values, count);
                }
            }
        }
    }
}

#[test]
fn scan_of_a_million_and_folded_grids() {
    let gpu = Gpu::new();
    check_scan(&gpu, gpu.tuning().into(), How::InPlace, From::Host, &random_words(1 << 20, 1, 1 << 12), 1 << 20);
    // The grid has more than 65535 workgroups.
    let subgroup_size = gpu.subgroup_size();
    let shape = ScanShape { subgroup_size, workgroup: subgroup_size, items: 1 };
    let size = 65536 * subgroup_size as usize + 3;
    check_scan(&gpu, shape, How::Copied, From::Record, &random_words(size, 2, 1 << 10), size - 1);
}

#[test]
fn scan_saturates_and_never_wraps() {
    let gpu = Gpu::new();
    let most = (1 << 19) - 1;
    for shape in scan_shapes(&gpu) {
        // The sum exceeds 2^32 after 8193 elements, and 2^33 before the end.
        let size = 20_000;
        check_scan(&gpu, shape, How::InPlace, From::Host, &vec![most; size], size);
        let mut late = vec![0; size];
        late[size - 8200..].fill(most);
        check_scan(&gpu, shape, How::Copied, From::Record, &late, size);
    }
    // The first sum is just below saturation, the second just saturates.
    let shape = scan_shapes(&gpu)[2];
    let mut edge = vec![1 << 18; 1 << 14];
    edge[77] -= 1;
    check_scan(&gpu, shape, How::InPlace, From::Host, &edge, edge.len());
    edge[78] += 1;
    check_scan(&gpu, shape, How::InPlace, From::Host, &edge, edge.len());
}

/// Sorts the first `count` of `keys` and compares everything with the reference. `values` are the second halves of the
/// pairs; without them the sort returns positions.
fn check_sort(
    gpu: &Gpu,
    shape: SortShape,
    (from, count): (From, usize),
    bits: Range<u32>,
    (keys, values): (&[u32], Option<&[u32]>),
    want_keys: bool,
) {
    let what = format!("{shape:?} {from:?} bits {bits:?} {count} of {}", keys.len());
    let mut g = Graph::new("sort");
    let max = if from == From::Host { count } else { keys.len() };
    let (counted, mut inputs) = count_in(&mut g, from, count as u32, max as u32, shape.block());
    let source = g.input("keys", room(keys.len()));
    inputs.push((source, bytes(keys)));
    let value_slice = values.map(|values| {
        let buffer = g.input("values", room(keys.len()));
        inputs.push((buffer, bytes(values)));
        Slice::from(buffer)
    });
    let sorted = radix_sort(&mut g, shape, "sort", source, value_slice, bits.clone(), want_keys, counted).unwrap();
    assert_eq!(sorted.keys.is_some(), want_keys);
    let mut read = |name: &str, slice: Slice| {
        let buffer = g.external(name, room(max));
        g.copy(name, slice, buffer).unwrap();
        buffer
    };
    let sorted_values = read("sorted_values", sorted.values);
    let sorted_keys = sorted.keys.map(|keys| read("sorted_keys", keys));
    let out = gpu.run(g, &inputs);
    let (expected_keys, expected_values) =
        sort_reference::radix_sort(&keys[..count], values.map(|v| &v[..count]), bits);
    // Memory after the last element holds data of other transients.
    if let Some(sorted_keys) = sorted_keys {
        assert_same(&format!("{what}, keys"), &expected_keys, &out.get(sorted_keys)[..count]);
    }
    assert_same(&format!("{what}, values"), &expected_values, &out.get(sorted_values)[..count]);
}

/// Returns the device's shape and ones with and without sorting in shared memory.
fn sort_shapes(gpu: &Gpu) -> Vec<SortShape> {
    let subgroup_size = gpu.subgroup_size();
    let device = SortShape::from(gpu.tuning());
    let small = SortShape {
        subgroup_size,
        workgroup: 8 * subgroup_size.min(32),
        items: 4,
        digit_bits: 8,
        copies: 4,
        direct: false,
    };
    // More counters exceed shared memory at 64 lanes.
    let copies = subgroup_size.min(32);
    let straight = SortShape { workgroup: subgroup_size, items: 5, copies, direct: true, ..small };
    vec![device, small, straight, SortShape { digit_bits: 4, copies: 1, ..small }]
}

#[test]
fn sort_of_sizes_around_every_boundary() {
    let gpu = Gpu::new();
    for shape in sort_shapes(&gpu) {
        let (group, block) = (shape.workgroup as usize, shape.block() as usize);
        for size in [0, 1, 2, group - 1, group, group + 1, 997, block - 1, block, block + 1, 3 * block + 5] {
            let keys = random_words(size, size as u32, POISON);
            check_sort(&gpu, shape, (From::Host, size), 8..24, (&keys, None), true);
        }
    }
}

#[test]
fn sort_of_difficult_keys_by_bit_ranges() {
    let gpu = Gpu::new();
    let size = 1500;
    let random = random_words(size, 4, POISON);
    let few: Vec<u32> = random.iter().map(|k| k % 3 * 0x0101_0101).collect();
    let ascending: Vec<u32> = (0..size as u32).map(|i| i * 2_863_311).collect();
    let extremes: Vec<u32> = random.iter().map(|k| if k & 1 == 0 { 0 } else { u32::MAX }).collect();
    let all = [
        vec![0; size],
        vec![u32::MAX; size],
        ascending.iter().rev().copied().collect(),
        ascending,
        extremes,
        few,
        random.clone(),
    ];
    // Values distinguish equal keys and differ from their positions.
    let values: Vec<u32> = (0..size as u32).map(|i| i.wrapping_mul(0x9E37_79B1)).collect();
    for shape in sort_shapes(&gpu) {
        for keys in &all {
            check_sort(&gpu, shape, (From::Host, size), 0..32, (keys, Some(&values)), true);
        }
        for bits in [0..9, 3..16, 31..32, 24..40, 7..7, 0..1] {
            check_sort(&gpu, shape, (From::Host, size), bits, (&random, Some(&values)), true);
        }
    }
}

#[test]
fn sort_counts_on_the_gpu() {
    let gpu = Gpu::new();
    for shape in sort_shapes(&gpu) {
        let capacity = 2 * shape.block() as usize + 17;
        let keys = random_words(capacity, 6, POISON);
        let values = random_words(capacity, 7, POISON);
        for from in SOURCES {
            for count in [0, 1, capacity / 2, capacity] {
                let payload = (count % 2 == 1).then_some(values.as_slice());
                check_sort(&gpu, shape, (from, count), 0..13, (&keys, payload), payload.is_some());
            }
        }
    }
}

/// Tests that memory after the last element keeps its poison. Memory is not aliased here.
#[test]
fn sort_writes_nothing_after_the_last_element() {
    let gpu = Gpu::new();
    let (count, max) = (1000, 1500);
    let keys = random_words(max, 17, POISON);
    for shape in sort_shapes(&gpu) {
        let mut g = Graph::new("sort");
        let (counted, inputs) = count_in(&mut g, From::Record, count as u32, max as u32, shape.block());
        let source = g.input("keys", room(max));
        let sorted = radix_sort(&mut g, shape, "sort", source, None, 0..11, true, counted).unwrap();
        let (out_keys, out_values) = (g.external("out_keys", room(max)), g.external("out_values", room(max)));
        g.copy("keys", sorted.keys.unwrap(), out_keys).unwrap();
        g.copy("values", sorted.values, out_values).unwrap();
        let plan = Arc::new(g.compile(&CompileOptions { alias: false, ..Default::default() }).unwrap());
        let mut exec = Executor::new(gpu.device(), plan, ExecOptions { poison: true, ..Default::default() }).unwrap();
        let device = gpu.device();
        let mut bind = |buffer: Buffer, content: &[u8]| {
            let memory = device.buffer("memory", content.len() as u64, Location::Device).unwrap();
            device.upload(&memory, 0, content).unwrap();
            exec.bind(buffer, &memory).unwrap();
            memory
        };
        bind(source, &bytes(&keys));
        bind(inputs[0].0, &inputs[0].1);
        let found = [out_keys, out_values].map(|buffer| bind(buffer, &bytes(&vec![0; max])));
        exec.submit(&[]).unwrap();
        exec.finish().unwrap();
        let (expected_keys, expected_values) = sort_reference::radix_sort(&keys[..count], None, 0..11);
        for (expected, found) in [expected_keys, expected_values].iter().zip(found) {
            assert_same(&format!("{shape:?}"), expected, &device.download_as(&found, max).unwrap());
        }
    }
}

#[test]
fn sort_of_a_million() {
    let gpu = Gpu::new();
    let keys = random_words(1 << 20, 8, POISON);
    check_sort(&gpu, gpu.tuning().into(), (From::Record, (1 << 20) - 1), 0..32, (&keys, None), true);
}

/// Tests the kernel that sorts in shared memory at its largest number of subgroups. Devices with subgroups of
/// 32 run this kernel.
#[test]
fn sort_with_32_subgroups_in_shared_memory() {
    let gpu = Gpu::new();
    let subgroup_size = gpu.subgroup_size();
    let workgroup = (32 * subgroup_size).min(256);
    let shape =
        SortShape { subgroup_size, workgroup, items: 4096 / workgroup, digit_bits: 8, copies: 8, direct: false };
    let keys = random_words(30_000, 10, POISON);
    check_sort(&gpu, shape, (From::Record, 29_999), 0..32, (&keys, None), true);
}

/// Tests the subgroup sizes that can be requested of the device.
#[test]
fn scan_and_sort_match_reference_at_every_subgroup_size() {
    let gpu = Gpu::new();
    let (low, high) = gpu.device().info().subgroup_sizes;
    let mut subgroup_size = low.max(8);
    while subgroup_size <= high.min(128) {
        let tuning = Tuning { subgroup_size, workgroup: 256, ..gpu.tuning() };
        let values = random_words(9_001, 11, 1 << 12);
        check_scan(&gpu, tuning.into(), How::Copied, From::Record, &values, 9_000);
        let staged = SortShape { copies: 8, direct: false, items: 16, workgroup: 256, ..SortShape::from(tuning) };
        let keys = random_words(9_001, 12, POISON);
        for shape in [tuning.into(), staged] {
            check_sort(&gpu, shape, (From::Record, 9_000), 0..32, (&keys, None), true);
        }
        subgroup_size *= 2;
    }
}

#[test]
fn work_writes_records_and_flags_overflow() {
    let gpu = Gpu::new();
    for (count, capacity) in [(0, 10), (1, 10), (10, 10), (11, 10), (1 << 25, 1 << 25), (POISON, 1 << 25)] {
        let mut g = Graph::new("work");
        let source = g.input("source", 16);
        let records = g.external("records", 64);
        let flags = g.external("flags", 8);
        let wanted = g.external("wanted", 8);
        let overflow = Overflow { capacity, flags: flags.into(), flag: 4, wanted: wanted.into() };
        let made = work(&mut g, "work", source, overflow, records, [256, 1, 4096, 0]).unwrap();
        assert_eq!((made.max, made.offset(1), made.offset(4096), made.offset(7)), (capacity, Some(16), Some(32), None));
        let out = gpu.run(g, &[(source, bytes(&[count])), (flags, bytes(&[1, 2]))]);
        let valid = if count <= capacity { count } else { 0 };
        let expected = [256, 1, 4096].map(|group_size| record_of(valid, group_size));
        assert_eq!(out.get::<Work>(records)[..3], expected, "{count} of {capacity}");
        assert_eq!(out.get::<u32>(flags), [if count <= capacity { 1 } else { 5 }, 2]);
        assert_eq!(out.get::<u32>(wanted), [count, POISON]);
    }
}

/// Tests a scan, a record and a sort in one graph, as in a frame. The scan's sum decides how many elements are sorted,
/// without a readback.
#[test]
fn a_scan_drives_a_sort_and_its_overflow_stops_it() {
    let gpu = Gpu::new();
    let counts = random_words(700, 13, 9);
    let (_, sum) = scan_reference::exclusive_scan(&counts, None);
    for capacity in [4000, sum - 1] {
        let mut g = Graph::new("frame");
        let source = g.input("counts", room(counts.len()));
        let keys = g.input("keys", room(4000));
        let offsets = g.transient("offsets", room(counts.len()));
        let total = g.transient("total", 4);
        let records = g.transient("records", 512);
        let flags = g.external("flags", 4);
        let wanted = g.external("wanted", 4);
        let target = g.external("target", 4 * u64::from(capacity));
        let shape = SortShape::from(gpu.tuning());
        exclusive_scan(&mut g, gpu.tuning(), "offsets", source, None, offsets, total, Count::Host(700)).unwrap();
        let overflow = Overflow { capacity, flags: flags.into(), flag: 2, wanted: wanted.into() };
        let count = work(&mut g, "work", total, overflow, records.slice(256, 64), [256, shape.block(), 0, 0]).unwrap();
        let sorted = radix_sort(&mut g, shape, "sort", keys, None, 0..11, false, Count::Gpu(count)).unwrap();
        g.copy("out", sorted.values, target).unwrap();
        let words = random_words(4000, 14, POISON);
        let out = gpu.run_times(g, &[(source, bytes(&counts)), (keys, bytes(&words)), (flags, bytes(&[0]))], 3);
        let fits = sum <= capacity;
        let valid = if fits { sum as usize } else { 0 };
        assert_same("order", &sort_reference::radix_sort(&words[..valid], None, 0..11).1, &out.get(target)[..valid]);
        assert_eq!((out.get::<u32>(flags)[0], out.get::<u32>(wanted)[0]), (if fits { 0 } else { 2 }, sum));
    }
}

#[test]
fn slices_that_are_too_small_are_refused() {
    let shape = ScanShape { subgroup_size: 8, workgroup: 64, items: 4 };
    let scan = |input: u64, output: u64| {
        let mut g = Graph::new("refused");
        let (a, b, total) = (g.input("a", input), g.external("b", output), g.external("total", 4));
        exclusive_scan(&mut g, shape, "scan", a, None, b.slice(0, output), total, Count::Host(100)).unwrap_err()
    };
    assert!(matches!(scan(400, 396), GraphError::SliceRange { bytes: 400, .. }));
    assert!(matches!(scan(396, 400), GraphError::SliceRange { bytes: 400, size: 396, .. }));
    let mut g = Graph::new("refused");
    let (a, total) = (g.external("a", 800), g.external("total", 4));
    let overlapping = a.slice(256, 400);
    let error = exclusive_scan(&mut g, shape, "scan", a, None, overlapping, total, Count::Host(100)).unwrap_err();
    assert!(matches!(error, GraphError::Overlap { .. }), "{error}");
}

/// Tests the counts of the largest scenes. It takes about a minute on a CPU: set SGS_TEST_LARGE=1.
#[test]
fn scan_and_sort_match_reference_at_the_largest_counts() {
    if std::env::var_os("SGS_TEST_LARGE").is_none() {
        return;
    }
    let gpu = Gpu::new();
    let size = 1 << 25;
    let values = random_words(size, 15, 1 << 7);
    check_scan(&gpu, gpu.tuning().into(), How::InPlace, From::Host, &values, size);
    check_scan(&gpu, gpu.tuning().into(), How::InPlace, From::Record, &vec![(1 << 19) - 1; size], size);
    drop(values);
    let keys = random_words(size, 16, POISON);
    check_sort(&gpu, gpu.tuning().into(), (From::Record, size), 0..32, (&keys, None), true);
    // The grid has more than 65535 workgroups, and the spine as many columns.
    let subgroup_size = gpu.subgroup_size();
    let direct = SortShape::from(gpu.tuning()).direct;
    let workgroup = if direct { subgroup_size } else { 4 * subgroup_size };
    let folded = SortShape { subgroup_size, workgroup, items: 4, digit_bits: 4, copies: 4, direct };
    let size = 65_600 * folded.block() as usize;
    check_sort(&gpu, folded, (From::Record, size - 1), 0..8, (&keys[..size], None), true);
}
