//! Emulator of kernels: agreement with the device, independence of the order, and planted faults.

use sgs_emulator::{Binding, Dispatch, Emulator, Fault, Kernel, Run, Schedule, Store};
use sgs_engine::graph::{CompileOptions, Graph, PassKind, Plan};
use sgs_engine::shader::Shader;
use sgs_passes::Tuning;
use sgs_passes::kernel::{groups, stage};
use sgs_passes::prim::{Count, ScanShape, SortShape, exclusive_scan, radix_sort};
use sgs_passes::reference::blend::Blended;
use sgs_passes::reference::photometric::{Shape, photometric, photometric_bwd, unpack};
use sgs_passes::reference::rng::Pcg;
use sgs_passes::reference::scan;
use sgs_passes::scene::Group;
use sgs_passes::splat::BackwardKernel;
use sgs_tests::gradients::{CAMERA_NUMBERS, Case, changed_camera, parameters};
use sgs_tests::kernels::kernel;
use sgs_tests::photographs::{WEIGHTS, run_photometric};
use sgs_tests::{Gpu, Tolerance, assert_close, finite_difference, scenes};
use std::borrow::Cow;
use std::collections::BTreeSet;
use std::sync::Arc;

const LANES: [u32; 4] = [8, 16, 32, 64];
const SCHEDULES: [Schedule; 4] =
    [Schedule::Ascending, Schedule::Descending, Schedule::Shuffled(1), Schedule::Shuffled(2)];
/// Workgroups of the kernel with faults.
const GROUPS: u32 = 3;

/// Runs the kernel with a planted fault. Returns what it wrote.
fn planted(fault: u32, lanes: u32, schedule: Schedule) -> Result<Vec<u32>, Fault> {
    let shader = kernel("faults");
    let kernel = Kernel::new(&shader.spirv, &[(0, fault)])?;
    let words = 128 * GROUPS;
    let mut stores = [Store::new((0..words).map(|i| i * i % 97).collect()), Store::new(vec![u32::MAX; words as usize])];
    let bind = |name: &str, store: usize| {
        let number = shader.binding(name).unwrap().number;
        Binding { number, store, offset: 0, bytes: 4 * u64::from(words), image: None }
    };
    let bindings = [bind("source", 0), bind("target", 1)];
    let groups = [GROUPS, 1, 1];
    let dispatch =
        Dispatch { lanes, groups, bindings: &bindings, push: &[], schedule, tolerated: &[], limit: 1_000_000 };
    kernel.run(&mut stores, &dispatch, 1)?;
    Ok(stores[1].words().to_vec())
}

/// Returns the expected sums.
fn sums() -> Vec<u32> {
    let of = |group: u32| (128 * group..128 * (group + 1)).map(|i| i * i % 97).sum::<u32>();
    (0..GROUPS).flat_map(|group| [of(group); 128]).collect()
}

#[test]
fn sums_are_right_at_every_width_and_order() {
    for lanes in LANES {
        for schedule in SCHEDULES {
            assert_eq!(planted(0, lanes, schedule).unwrap(), sums(), "{lanes} lanes, {schedule:?}");
        }
    }
}

#[test]
fn planted_faults_are_detected_at_every_width() {
    for lanes in LANES {
        for schedule in SCHEDULES {
            let what = format!("{lanes} lanes, {schedule:?}");
            assert_ne!(planted(1, lanes, schedule).unwrap(), sums(), "{what}");
            for fault in 2..=16 {
                let found = planted(fault, lanes, schedule).expect_err(&format!("fault {fault} at {what}"));
                let expected = match fault {
                    2 => matches!(found, Fault::Uninitialized { .. }),
                    // The subgroup that reads first may meet words that are not yet written.
                    3 => matches!(found, Fault::Race { .. } | Fault::Uninitialized { .. }),
                    4 | 5 => matches!(found, Fault::Barrier(_)),
                    6 | 15 => matches!(found, Fault::Shuffle { .. }),
                    7 => matches!(found, Fault::OutOfBounds { .. }),
                    8 => matches!(found, Fault::Index { .. } | Fault::Uninitialized { .. }),
                    9 | 12..=14 => matches!(found, Fault::Race { .. }),
                    10 => matches!(found, Fault::Arithmetic(_)),
                    11 => matches!(found, Fault::Endless),
                    _ => matches!(found, Fault::Conversion(_)),
                };
                assert!(expected, "fault {fault} at {what}: {found}");
            }
        }
    }
}

/// Removes all barriers of a kernel.
fn without_barriers(shader: &Shader) -> Shader {
    const BARRIER: u32 = 4 << 16 | 224;
    const NOTHING: u32 = 1 << 16;
    let mut words = shader.spirv.to_vec();
    let mut at = 5;
    while at < words.len() {
        let length = (words[at] >> 16) as usize;
        if words[at] == BARRIER {
            words[at..at + length].fill(NOTHING);
        }
        at += length;
    }
    Shader { spirv: Cow::Owned(words), ..shader.clone() }
}

#[test]
fn removed_barriers_of_scans_and_sorts_are_detected() {
    for subgroup_size in [32, 64] {
        // Sums of 79 blocks need several subgroups in the kernel that adds them.
        let count = 20_000;
        let mut g = Graph::new("barriers");
        let bytes = 4 * u64::from(count);
        let source = g.input("source", bytes);
        let [sums, total, keys] = [("sums", bytes), ("total", 4), ("keys", bytes)].map(|(name, n)| g.external(name, n));
        let scan = ScanShape { subgroup_size, workgroup: 256, items: 1 };
        exclusive_scan(&mut g, scan, "scan", source, None, sums, total, Count::Host(count)).unwrap();
        let sort = SortShape { subgroup_size, workgroup: 256, items: 1, digit_bits: 8, copies: 4, direct: false };
        let sorted = radix_sort(&mut g, sort, "sort", source, None, 0..8, true, Count::Host(count)).unwrap();
        g.copy("keys", sorted.keys.unwrap(), keys).unwrap();
        let plan = g.compile(&CompileOptions::default()).unwrap();
        let words: Vec<u8> = (0..count).flat_map(|i: u32| (i.wrapping_mul(0x9e37_79b9) >> 13).to_le_bytes()).collect();
        let emulator = Emulator::default();
        let run = |plan: &Plan| {
            let run = Run { lanes: subgroup_size, schedule: Schedule::Shuffled(3), replays: 1, tolerated: &[] };
            emulator.run(plan, &[(source.index(), &words)], run)
        };
        run(&plan).unwrap();
        let mut kernels = BTreeSet::new();
        for index in 0..plan.passes.len() {
            let mut damaged = plan.clone();
            let PassKind::Compute { shader, .. } = &mut damaged.passes[index].kind else { continue };
            let fewer = without_barriers(shader);
            if fewer == **shader {
                continue;
            }
            kernels.insert(shader.name.to_string());
            *shader = Arc::new(fewer);
            let pass = plan.passes[index].name.clone();
            let fault = run(&damaged).map(|_| ()).expect_err(&pass);
            assert!(matches!(fault.cause(), Fault::Race { .. } | Fault::Uninitialized { .. }), "{fault}");
        }
        let expected = ["radix_histogram", "radix_scatter", "scan_down", "scan_reduce", "scan_spine"];
        for kernel in expected {
            assert!(kernels.iter().any(|k| k.starts_with(kernel)), "{kernel} is not among {kernels:?}");
        }
    }
}

#[test]
fn missing_instructions_are_named() {
    // A header, then `OpTypeForwardPointer` and an unknown opcode.
    let header = [0x0723_0203, 0x0001_0500, 0, 8, 0];
    let damaged = |words: &[u32]| Kernel::new(&[&header, words].concat(), &[]).unwrap_err();
    assert_eq!(damaged(&[1 << 16 | 0xfff0]), Fault::Missing("opcode 65520".to_owned()));
    assert!(matches!(damaged(&[9 << 16 | 17, 1]), Fault::Damaged(_)));
}

/// Tests a kernel on a small map.
///
/// Its pass has a map of 512 by 1024 pixels, which takes long on the emulator.
#[test]
fn differences_of_a_small_map_match_reference() {
    use sgs_shaders::environment_map_smoothness::{Bindings, KERNEL, Push, Specs};
    let gpu = Gpu::new();
    let [w, h] = [37_u32, 23];
    let mut rng = Pcg::new(3);
    let map: Vec<f32> = (0..3 * w * h).map(|_| rng.normal() as f32).collect();
    let workgroup = gpu.tuning().workgroup;
    let count = (w * h).div_ceil(workgroup);
    let mut g = Graph::new("differences");
    let bytes = 4 * map.len() as u64;
    let source = g.input("map", bytes);
    let (slopes, sums) = (g.external("slopes", bytes + 4), g.external("sums", 4 * u64::from(count)));
    let bindings = Bindings { map: source.into(), slopes: slopes.into(), sums: sums.into() };
    let push = Push { size: [w, h], across: 0.5, down: 0.25 };
    let specs = Specs { workgroup };
    stage(&mut g, "differences", &KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch(groups(u64::from(w * h), workgroup))
        .unwrap();
    let out = gpu.run(g, &[(source, bytemuck::cast_slice(&map).to_vec())]);
    let value = |x: &[f64]| {
        let at = |i: u32, j: u32, c: u32| x[(3 * (j * w + i % w) + c) as usize];
        let mut sum = 0.0;
        for (j, i, c) in (0..h).flat_map(|j| (0..w).flat_map(move |i| (0..3).map(move |c| (j, i, c)))) {
            sum += 0.5 * (at(i, j, c) - at(i + 1, j, c)).powi(2);
            sum += if j + 1 < h { 0.25 * (at(i, j, c) - at(i, j + 1, c)).powi(2) } else { 0.0 };
        }
        sum
    };
    let mut wide: Vec<f64> = map.iter().map(|x| f64::from(*x)).collect();
    let expected: Vec<f64> = (0..wide.len()).map(|i| finite_difference(&mut wide, i, 0.5, value)).collect();
    let found: Vec<f32> = out.get(slopes);
    assert_close("slopes", &expected, &found[..expected.len()], Tolerance::new(1e-5, 1e-5));
    assert_eq!(found[expected.len()].to_bits(), u32::MAX, "a float after the last one was written");
    let total: f64 = out.get::<f32>(sums).iter().map(|x| f64::from(*x)).sum();
    assert!((total / value(&wide) - 1.0).abs() < 1e-5, "{total}");
}

/// Returns unsorted words of 19 bits.
fn unsorted() -> Vec<u32> {
    (0..5000).map(|i: u32| i.wrapping_mul(0x9e37_79b9) >> 13).collect()
}

/// Returns prefix sums and sorted keys of a device.
fn integers(gpu: &Gpu) -> [Vec<u32>; 3] {
    let words = unsorted();
    let count = words.len() as u32;
    let mut g = Graph::new("integers");
    let bytes = 4 * u64::from(count);
    let source = g.input("source", bytes);
    let [sums, total, keys] = [("sums", bytes), ("total", 4), ("keys", bytes)].map(|(name, n)| g.external(name, n));
    exclusive_scan(&mut g, gpu.tuning(), "scan", source, None, sums, total, Count::Host(count)).unwrap();
    let shape = SortShape::from(gpu.tuning());
    let sorted = radix_sort(&mut g, shape, "sort", source, None, 0..19, true, Count::Host(count)).unwrap();
    g.copy("keys", sorted.keys.unwrap(), keys).unwrap();
    let out = gpu.run(g, &[(source, bytemuck::cast_slice(&words).to_vec())]);
    [out.get(sums), out.get(total), out.get(keys)]
}

#[test]
fn integer_kernels_agree_with_the_device_bit_for_bit() {
    let mut gpu = Gpu::new();
    let found = integers(&gpu);
    for schedule in SCHEDULES {
        assert_eq!(gpu.emulating(schedule, integers), found, "{schedule:?}");
    }
}

#[test]
fn float_kernels_agree_with_the_device_to_rounding() {
    let mut gpu = Gpu::new();
    let case = Case::new(scenes::ordinary(40, 2, true, 5), [40, 30], true);
    let run = |gpu: &Gpu| case.gpu_gradients(gpu, BackwardKernel::Pixel);
    let (groups, pose) = run(&gpu);
    let emulated = SCHEDULES.map(|schedule| gpu.emulating(schedule, run));
    for (groups, pose) in &emulated[1..] {
        assert_eq!((groups, pose), (&emulated[0].0, &emulated[0].1), "the order changes bits");
    }
    let all = |groups: &[Vec<f32>], pose: &[f32]| [groups.concat(), pose.to_vec()].concat();
    let (expected, found) = (all(&groups, &pose), all(&emulated[0].0, &emulated[0].1));
    let largest = expected.iter().fold(0.0_f32, |m, x| m.max(x.abs()));
    for (k, (e, f)) in expected.iter().zip(&found).enumerate() {
        assert!(
            (e - f).abs() <= 1e-4 * e.abs() + 1e-5 * largest,
            "gradient {k}: {f} on the emulator, {e} on the device"
        );
    }
    assert!(largest > 0.0 && expected.len() == found.len());
}

/// Runs `f` at every width on the emulator, each in an order of its own.
fn at_widths<T>(f: impl Fn(&Gpu) -> T) -> Vec<(u32, T)> {
    let mut gpu = Gpu::new();
    LANES.into_iter().zip(SCHEDULES).map(|(lanes, order)| (lanes, gpu.emulating_lanes(lanes, order, &f))).collect()
}

#[test]
fn integer_kernels_agree_at_every_width_bit_for_bit() {
    let words = unsorted();
    let (sums, total) = scan::exclusive_scan(&words, None);
    let mut keys = words;
    keys.sort_unstable();
    let expected = [sums, vec![total], keys];
    for (lanes, found) in at_widths(integers) {
        assert!(found == expected, "{lanes} lanes");
    }
}

/// Tests tiles of splats that some widths process alone and others together.
#[test]
fn tile_lists_agree_at_every_width_bit_for_bit() {
    for (scene, size) in [(scenes::large(30, 0, 1), [331, 90]), (scenes::ordinary(300, 0, false, 5), [64, 48])] {
        let all = at_widths(|gpu| {
            let t = Tuning { tile: [16, 16], ..gpu.tuning() };
            super::large_splats::find_with(gpu, &t, &scene, &scenes::camera(size))
        });
        assert!(all[0].1.order.len() > 200, "{} entries", all[0].1.order.len());
        for (lanes, found) in &all[1..] {
            assert!(*found == all[0].1, "{size:?} at {lanes} lanes: {found:?}\n{:?}", all[0].1);
        }
    }
}

/// Returns the sum of the magnitudes of a gradient's terms.
///
/// Terms are those of each channel of each pixel. `render` is the reference with one number changed.
fn magnitude(case: &Case, render: impl Fn(f64) -> Blended) -> f64 {
    // Short, so that no splat appears at a pixel or leaves it.
    let step = 1e-8;
    let [low, high] = [-step, step].map(render);
    let sum = |low: &[f64], high: &[f64], weights: &[f64]| {
        let slopes = low.iter().zip(high).map(|(low, high)| (high - low) / (2.0 * step));
        slopes.zip(weights).map(|(slope, weight)| (slope * weight).abs()).sum::<f64>()
    };
    sum(&low.image, &high.image, &case.image) + sum(&low.transmittance, &high.transmittance, &case.transmittance)
}

/// Returns the largest sum of magnitudes of each group, and of the camera.
fn magnitudes(case: &Case) -> Vec<f64> {
    let of_group = |group: Group| {
        let count = parameters(&mut case.gaussians.clone(), group).len();
        let one = |i: usize| {
            magnitude(case, |change| {
                let mut changed = case.gaussians.clone();
                parameters(&mut changed, group)[i] += change;
                case.reference(&changed, &case.camera)
            })
        };
        (0..count).map(one).fold(0.0, f64::max)
    };
    let of_camera =
        |i: usize| magnitude(case, |change| case.reference(&case.gaussians, &changed_camera(&case.camera, i, change)));
    let camera = (0..CAMERA_NUMBERS).map(of_camera).fold(0.0, f64::max);
    Group::ALL.into_iter().map(of_group).chain([camera]).collect()
}

/// Returns the first number of two results that differs by more than a bound.
fn first_apart(a: &[f32], b: &[f32], bound: f64) -> Option<usize> {
    assert_eq!(a.len(), b.len());
    let apart = |(a, b): (&f32, &f32)| f64::from(*a) - f64::from(*b);
    a.iter().zip(b).map(apart).position(|d| d.is_nan() || d.abs() > bound)
}

/// Tests sums of blending over lanes, projection, and the sums of the camera.
///
/// A sum over a tile adds up to 256 pixels. Added one by one in any order, its error is at most 256 roundings of the sum of
/// magnitudes. Two widths differ by at most twice as much.
#[test]
fn gradients_agree_at_every_width_to_rounding() {
    let bound = 2.0 * 256.0 * 0.5_f64.powi(24);
    let case = Case::new(scenes::ordinary(12, 1, true, 5), [24, 19], true);
    let sizes = magnitudes(&case);
    for which in [BackwardKernel::Pixel, BackwardKernel::Splat, BackwardKernel::Bucket] {
        let all = at_widths(|gpu| {
            let (mut groups, camera) = case.gpu_gradients(gpu, which);
            groups.push(camera);
            groups
        });
        let first = &all[0].1;
        assert_eq!(first.len(), sizes.len());
        for (lanes, found) in &all[1..] {
            for (k, size) in sizes.iter().enumerate() {
                let apart = first_apart(&first[k], &found[k], bound * size);
                let at = |i: usize| format!("{i}: {} and {}", first[k][i], found[k][i]);
                assert!(apart.is_none(), "{which:?}, {lanes} lanes, group {k}, gradient {:?}", apart.map(at));
            }
        }
        assert!(all[1..].iter().any(|(_, found)| found != first), "{which:?}: no width adds in another order");
        // An error of a hundredth of the largest gradient of a group is beyond the bound.
        for (group, size) in first.iter().zip(&sizes).filter(|(group, _)| !group.is_empty()) {
            let largest = (0..group.len()).max_by(|i, j| group[*i].abs().total_cmp(&group[*j].abs())).unwrap();
            let mut wrong = group.clone();
            wrong[largest] *= 1.01;
            assert_eq!(first_apart(group, &wrong, bound * size), Some(largest), "{which:?}");
        }
    }
}

/// Tests sums and gradient of the photometric loss against double precision.
///
/// The relative bounds of L1 and SSIM are 34 and 168 roundings, and the sums have 4455 terms.
#[test]
fn losses_at_every_width_match_reference() {
    let shape = Shape { width: 45, height: 33, channels: 3 };
    let mut rng = Pcg::new(7);
    let targets: Vec<u32> = (0..shape.pixels()).map(|_| rng.next_u32() | 0xff00_0000).collect();
    let near = |i: usize| unpack(targets[i / 3], i % 3);
    let image: Vec<f32> = (0..3 * shape.pixels()).map(|i| (0.7 * near(i) + 0.3 * rng.uniform()) as f32).collect();
    let wide: Vec<f64> = image.iter().map(|x| f64::from(*x)).collect();
    let loss = photometric(&wide, &targets, shape);
    let weights = WEIGHTS.map(f64::from);
    let expected = photometric_bwd(&wide, &targets, shape, weights[0], weights[1]);
    let count = expected.len() as f64;
    let largest = [shape.width as u32, shape.height as u32];
    for (lanes, (gradient, stats)) in
        at_widths(|gpu| run_photometric(gpu, gpu.tuning(), shape, largest, &image, &targets))
    {
        let what = |name: &str| format!("{name} at {lanes} lanes");
        assert_close(&what("L1"), &[loss.l1], &[stats.l1], Tolerance::new(1e-7, 2e-6));
        assert_close(&what("SSIM"), &[loss.ssim], &[stats.ssim], Tolerance::new(3e-6, 1e-5));
        let tolerance = Tolerance::new(2e-4 / count, 2e-4);
        assert_close(&what("gradient"), &expected, &gradient[..expected.len()], tolerance);
    }
}
