//! Surfaces and the sparse weight matrix of a view against the reference.
//!
//! The matrix also blends materials and propagates their gradients.

use sgs_passes::reference::blend::{Blended as ReferenceBlended, render};
use sgs_passes::reference::gbuffer::{
    Materials, gbuffer as reference_gbuffer, stored_rows, weights as reference_weights,
};
use sgs_passes::reference::project::{Camera, Gaussians, project as reference_project};
use sgs_tests::gbuffer::{Case, run};
use sgs_tests::{Gpu, scenes};

/// Checks all results of `run` against the reference.
///
/// `metals` enables metallic. `reach` bounds raw materials. `most_doubtful` bounds the share of doubtful pixels.
fn check(gpu: &Gpu, scene: &Gaussians, camera: &Camera, metals: bool, reach: f64, most_doubtful: f64) {
    for bits in [32, 16] {
        let case = Case::new(scene.clone(), *camera, metals, reach);
        check_in(gpu, &Case { bits, ..case }, most_doubtful);
    }
}

/// Checks a case at its number of weight bits.
fn check_in(gpu: &Gpu, case: &Case, most_doubtful: f64) {
    let found = run(gpu, case);
    assert_eq!(found.flags, 0);
    let Case { scene, camera, raw, gradient, bits, .. } = case;
    let (n, pixels, metals) = (scene.len(), gradient.len(), !raw.metallic.is_empty());
    let truth: ReferenceBlended = render(scene, camera, 0, true, [0.0; 3]);
    let surfaces = reference_gbuffer(camera, &truth, 8);
    let mut rows = reference_weights(&reference_project(scene, camera, 0, true), camera.size);
    if *bits == 16 {
        rows = stored_rows(&rows);
    }
    let blended = raw.blend(&rows);
    let total = *found.row_starts.last().unwrap();
    assert_eq!(total, found.wanted);
    let mut doubtful = 0;
    for p in 0..pixels {
        let std::ops::Range { start: begin, end } = found.row(p);
        let sum: f64 = found.weights[begin..end].iter().map(|w| f64::from(*w)).sum();
        let covered = found.coverage[p] >= 1e-3;
        assert!(!covered || (sum - 1.0).abs() < 1e-4, "pixel {p}: weights add up to {sum}");
        assert!(found.materials[p].iter().all(|v| v.is_finite()));
        if truth.doubtful[p] {
            doubtful += 1;
            continue;
        }
        let seen: Vec<usize> = found.columns[begin..end].iter().map(|c| *c as usize).collect();
        assert_eq!(seen, rows[p].iter().map(|r| r.0).collect::<Vec<_>>(), "pixel {p}");
        assert!((f64::from(found.coverage[p]) - surfaces.coverage[p]).abs() < 1e-5);
        if !covered {
            assert_eq!((found.points[p], found.normals[p], found.materials[p]), ([0.0; 3], [0.0; 3], [0.0; 4]));
            continue;
        }
        for (w, r) in found.weights[begin..end].iter().zip(&rows[p]) {
            assert!((f64::from(*w) - r.1).abs() < 1e-4 / surfaces.coverage[p].min(1.0), "{w} and {}", r.1);
        }
        let point = surfaces.points[p].to_array();
        let scale = surfaces.points[p].length().max(1.0) / surfaces.coverage[p];
        for c in 0..3 {
            assert!((f64::from(found.points[p][c]) - point[c]).abs() < 2e-4 * scale, "point of pixel {p}");
            let normal = surfaces.normals[p].to_array();
            // Opposing normals may nearly cancel. Their direction is then mostly rounding.
            let at = &truth.image[p * 8 + 3..p * 8 + 6];
            let length = at.iter().map(|v| v * v).sum::<f64>().sqrt() / surfaces.coverage[p];
            assert!(
                (f64::from(found.normals[p][c]) - normal[c]).abs() < 1e-4 / length.max(1e-4) / surfaces.coverage[p]
            );
        }
        for c in 0..4 {
            assert!((f64::from(found.materials[p][c]) - blended[p][c]).abs() < 1e-4 / surfaces.coverage[p]);
        }
        if metals {
            assert!((f64::from(found.metallic[p]) - blended[p][4]).abs() < 1e-4 / surfaces.coverage[p]);
        }
    }
    assert!((doubtful as f64) <= most_doubtful * pixels as f64, "{doubtful} of {pixels} pixels are doubtful");
    // The transpose holds the same entries, column by column.
    let mut by_column: Vec<Vec<(u32, f32)>> = vec![Vec::new(); n];
    for p in 0..pixels {
        for e in found.row(p) {
            by_column[found.columns[e] as usize].push((p as u32, found.weights[e]));
        }
    }
    assert_eq!((found.column_starts[0], found.column_starts[n]), (0, total));
    for (i, column) in by_column.iter().enumerate() {
        let range = found.column_starts[i] as usize..found.column_starts[i + 1] as usize;
        let mut transposed: Vec<(u32, f32)> = range.clone().map(|e| (found.rows[e], found.row_weights[e])).collect();
        // Entries of a column come tile by tile, so sort them by pixel.
        transposed.sort_by_key(|e| e.0);
        assert_eq!(&transposed, column, "column {i}");
    }
    // Expected gradients are exact sums over the device's columns. Slopes are finite differences of the activation.
    let albedo_range = raw.albedo_range;
    let slope = |raw: f64, which: usize| {
        let h = 1e-5 * raw.abs().max(1.0);
        let of = |raw: f64| {
            let (albedo, roughness, metallic) = (vec![raw; 3], vec![raw], vec![raw]);
            Materials { albedo, roughness, metallic, albedo_range }.values(0)[which]
        };
        (of(raw + h) - of(raw - h)) / (2.0 * h)
    };
    let (colored, ranged, free) = (|raw| slope(raw, 0), |raw| slope(raw, 3), |raw| slope(raw, 4));
    for (i, column) in by_column.iter().enumerate() {
        let sums: Vec<(f64, f64)> = (0..5)
            .map(|c| {
                let terms = column.iter().map(|(p, w)| f64::from(*w) * gradient[*p as usize][c]);
                terms.fold((0.0, 0.0), |(s, a), t| (s + t, a + t.abs()))
            })
            .collect();
        let close = |found: f32, (sum, size): (f64, f64), slope: f64, what: &str| {
            let expected = sum * slope;
            let room = 1e-3 * expected.abs() + 1e-5 * size * slope + 1e-12;
            assert!((f64::from(found) - expected).abs() <= room, "{what} of {i}: {found} and {expected}");
        };
        for c in 0..3 {
            close(found.grad_albedo[3 * i + c], sums[c], colored(raw.albedo[3 * i + c]), "albedo");
        }
        close(found.grad_roughness[i], sums[3], ranged(raw.roughness[i]), "roughness");
        if metals {
            close(found.grad_metallic[i], sums[4], free(raw.metallic[i]), "metallic");
        }
    }
}

#[test]
fn gbuffer_and_materials_match_reference() {
    let gpu = Gpu::new();
    for (size, count, metals, reach) in
        [([64, 48], 200, false, 2.0), ([61, 37], 500, true, 4.0), ([17, 3], 40, true, 8.0)]
    {
        let scene = scenes::ordinary(count, 0, true, u64::from(size[0]));
        check(&gpu, &scene, &scenes::camera(size), metals, reach, 0.6);
    }
}

/// Weights in 16 bits are the 32-bit weights, rounded with error diffusion.
///
/// Each weight passes its rounding error to the next of its row. Weights are within 1/65535, and sums of rows within
/// half of that. The columns hold the same weights.
#[test]
fn weights_in_16_bits_are_rounded_along_their_rows() {
    let gpu = Gpu::new();
    let scene = scenes::ordinary(900, 0, true, 61);
    let camera = scenes::camera([61, 37]);
    let case = Case::new(scene, camera, false, 1.0);
    let [wide, narrow] = [32, 16].map(|bits| run(&gpu, &Case { bits, ..case.clone() }));
    assert!(wide.row_starts == narrow.row_starts && wide.rows == narrow.rows);
    let count = wide.wanted as usize;
    assert!(count % 2 == 1 || count > 10_000, "{count}");
    assert!(wide.columns[..count] == narrow.columns[..count] && wide.column_starts == narrow.column_starts);
    let (mut largest, mut longest, mut lost) = (0.0_f64, 0, 0);
    for row in wide.row_starts.windows(2).map(|w| w[0] as usize..w[1] as usize) {
        let mut carried = 0.0_f32;
        let (mut sum, mut stored) = (0.0, 0.0);
        longest = longest.max(row.len());
        for e in row {
            let wanted = wide.weights[e] * 65535.0 + carried;
            let parts = (narrow.weights[e] * 65535.0).round();
            assert_eq!(narrow.weights[e], parts * (1.0 / 65535.0), "entry {e}");
            // Rounding of midpoints may differ between devices.
            assert!((wanted - parts).abs() < 0.51, "entry {e}: {wanted} became {parts}");
            carried = wanted - parts;
            largest = largest.max(f64::from((wide.weights[e] - narrow.weights[e]).abs()));
            (sum, stored) = (sum + f64::from(wide.weights[e]), stored + f64::from(narrow.weights[e]));
            lost += usize::from(parts == 0.0);
        }
        assert!((sum - stored).abs() < 0.51 / 65535.0 + 1e-6, "{sum} and {stored}");
    }
    println!("{count} weights, rows of up to {longest}: off by {largest:.1e}; {lost} are none");
    assert!(
        largest > 0.5 / 65535.0 && largest < 1.01 / 65535.0 && longest > 20 && lost > 0,
        "{largest} {longest} {lost}"
    );
    // The bound of `Accuracy` for materials, which lie between 0 and 1.
    let bound = (longest + 1) as f64 * 0.5 / 65535.0;
    let apart = wide.materials.iter().flatten().zip(narrow.materials.iter().flatten());
    let apart = apart.map(|(a, b)| f64::from((a - b).abs())).fold(0.0, f64::max);
    println!("materials are off by {apart:.1e} of {bound:.1e}");
    assert!(apart > 0.0 && apart < bound, "{apart}");
    // Past the last entry nothing is written.
    let past = narrow.weights[count.next_multiple_of(2)..].iter().all(|w| *w == 1.0);
    assert!(past, "something is written past the last entry");
}

#[test]
fn single_pixel_and_empty_views_are_handled() {
    let gpu = Gpu::new();
    check(&gpu, &scenes::ordinary(20, 0, true, 1), &scenes::camera([1, 1]), true, 1.0, 1.0);
    let mut away = scenes::ordinary(20, 0, true, 1);
    away.means.chunks_mut(3).for_each(|m| m[2] -= 1e3);
    check(&gpu, &away, &scenes::camera([9, 5]), false, 1.0, 0.0);
}

#[test]
fn overflow_is_counted_and_not_written() {
    let gpu = Gpu::new();
    let scene = scenes::ordinary(200, 0, true, 64);
    let camera = scenes::camera([64, 48]);
    let case = Case::new(scene, camera, false, 1.0);
    let all = run(&gpu, &case);
    let short = run(&gpu, &Case { room: all.wanted - 1, ..case.clone() });
    assert_eq!((short.flags, short.wanted), (1, all.wanted));
    let exact = run(&gpu, &Case { room: all.wanted, ..case });
    assert_eq!((exact.flags, exact.wanted), (0, all.wanted));
    assert_eq!(exact.grad_albedo, all.grad_albedo, "room changes nothing");
}

#[test]
fn saturated_materials_have_finite_gradients_that_do_not_vanish_early() {
    let gpu = Gpu::new();
    let scene = scenes::ordinary(40, 0, true, 2);
    check(&gpu, &scene, &scenes::camera([20, 16]), true, 30.0, 1.0);
}
