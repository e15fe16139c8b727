//! Several subgroups per tile in the forward pass of blending.
//!
//! They leave marks and checkpoints for the backward pass over buckets. Images and gradients have the bits of one subgroup
//! per tile, which other tests compare with the reference.

use super::buckets::{Both, both_from};
use sgs_passes::reference::project::Gaussians;
use sgs_passes::splat::Statistic;
use sgs_passes::{Accuracy, Tuning};
use sgs_tests::{Gpu, scenes};

/// Mark of a part that had stopped before a bucket.
const UNREACHED: u32 = 1 << 31;

/// Returns whether parts of a tile stop at different buckets.
fn parts_stop_apart(b: &Both) -> bool {
    let used = b.marks.chunks_exact(b.parts).filter(|marks| marks[0] != u32::MAX);
    used.into_iter().any(|marks| marks.iter().any(|m| m & UNREACHED == 0) && marks.iter().any(|m| m & UNREACHED != 0))
}

fn bits(rows: &[f32]) -> Vec<u32> {
    rows.iter().map(|x| x.to_bits()).collect()
}

/// Returns splats that are opaque at the top of the view.
///
/// Its pixels stop early.
fn uneven(count: usize, normals: bool) -> Gaussians {
    let mut g = scenes::ordinary(count, 0, normals, 11);
    for i in 0..count {
        let top = g.means[3 * i + 1] < 0.0;
        g.opacity_logits[i] = if top { 4.0 } else { -4.0 };
    }
    g
}

/// Name, tuning, scene, size and statistic.
type Case = (&'static str, Tuning, Gaussians, [u32; 2], Option<Statistic>);

fn cases(own: Tuning) -> Vec<Case> {
    let kept = own.with(Accuracy { keep_last: true, transmittance_min: 0.05, ..Accuracy::EXACT });
    let slots = Tuning { sub_tiles: true, slot_width: 4, ..own };
    let few = Tuning { sub_tiles: false, ..own };
    vec![
        ("colors", own, uneven(1500, false), [33, 21], None),
        ("eight channels", slots, uneven(1200, true), [21, 33], Some(Statistic::Photometric)),
        ("all slots tried", few, uneven(1500, false), [19, 16], None),
        ("last splat kept", kept, uneven(3000, false), [16, 31], None),
        ("extreme splats", slots, scenes::hard(2), [40, 30], None),
        ("one pixel", own, uneven(300, false), [1, 1], None),
    ]
}

fn compare(gpu: &Gpu, cases: Vec<Case>) {
    for (name, t, scene, size, statistic) in cases {
        let with = |parts: u32| {
            let t = Tuning { tile_parts: Some(parts), ..t };
            both_from(gpu, &t, &scene, size, statistic, 1 << 14, None)
        };
        let one = with(1);
        assert!(one.flags == 0 && one.parts == 1, "{name}: the entries overflowed");
        assert!(one.bucket.rows.iter().any(|x| x.is_finite() && *x != 0.0), "{name}: all gradients are zero");
        let mut apart = false;
        for parts in [2, 4, 8] {
            let found = with(parts);
            for (what, a, b) in [("pixel", &one.pixel, &found.pixel), ("bucket", &one.bucket, &found.bucket)] {
                assert!(a.image == b.image, "{name}: {parts} parts change the image of {what}");
                assert!(a.transmittance == b.transmittance, "{name}: {parts} parts change transmittance of {what}");
                assert!(bits(&a.rows) == bits(&b.rows), "{name}: {parts} parts change gradients of {what}");
            }
            apart |= parts_stop_apart(&found);
        }
        assert!(apart || ["extreme splats", "one pixel"].contains(&name), "{name}: parts stop at the same bucket");
    }
}

#[test]
fn parts_keep_the_bits_of_images_and_gradients() {
    let gpu = Gpu::new();
    compare(&gpu, cases(gpu.tuning()));
}

/// Tests buckets of more entries than the lanes own at a time.
#[test]
fn parts_keep_the_bits_of_large_buckets() {
    let gpu = Gpu::new();
    let large = Tuning { workers: 0, ..gpu.tuning() };
    compare(&gpu, vec![("large buckets", large, uneven(6000, false), [16, 16], None)]);
}

/// Replaces the transmittances of stopped parts by 0.5, and returns their number.
///
/// Each is of a bucket that another part of the tile reached.
fn replace_stopped(b: &Both, tile: [u32; 2], checkpoints: &mut [u32]) -> usize {
    let pixels = (tile[0] * tile[1]) as usize;
    let (mut count, mut previous) = (0, u32::MAX);
    for (slot, marks) in b.marks.chunks_exact(b.parts).enumerate().filter(|(_, marks)| marks[0] != u32::MAX) {
        let index = marks[0] & !UNREACHED;
        // The first bucket of a tile has no checkpoint.
        let first = std::mem::replace(&mut previous, index) != index;
        if first || marks.iter().all(|m| m & UNREACHED != 0) {
            continue;
        }
        let before = (slot - index as usize - 1) * 4 * pixels;
        for pixel in 0..pixels {
            let [x, y] = [pixel as u32 % tile[0], pixel as u32 / tile[0]];
            let part = y / b.part[1] * (tile[0] / b.part[0]) + x / b.part[0];
            if marks[part as usize] & UNREACHED != 0 {
                checkpoints[before + pixel] = 0.5_f32.to_bits();
                count += 1;
            }
        }
    }
    count
}

/// Tests that the backward pass uses no checkpoint of a stopped part.
///
/// None is written, so it may hold anything.
#[test]
fn stopped_parts_need_no_checkpoints() {
    let gpu = Gpu::new();
    let t = Tuning { tile_parts: Some(4), ..gpu.tuning() };
    // Whole tiles: parts outside of the view would have stopped, too.
    let scene = uneven(6000, false);
    let run = |checkpoints: Option<&[u32]>| both_from(&gpu, &t, &scene, [16, 16], None, 1 << 14, checkpoints);
    let found = run(None);
    assert!(parts_stop_apart(&found));
    // Unwritten memory may hold results of earlier passes, so the marks tell what was not written.
    let mut stale = found.checkpoints.clone();
    let count = replace_stopped(&found, t.tile, &mut stale);
    assert!(count > 100, "only {count} checkpoints of stopped parts");
    assert!(
        bits(&run(Some(&stale)).bucket.rows) == bits(&found.bucket.rows),
        "a checkpoint of a stopped part was used"
    );
    // Written checkpoints are used.
    let wrong: Vec<u32> = found.checkpoints.iter().map(|x| (0.5 * f32::from_bits(*x)).to_bits()).collect();
    assert!(bits(&run(Some(&wrong)).bucket.rows) != bits(&found.bucket.rows));
}
