//! Splats of many tiles: the lanes of a subgroup find their tiles together. Tiles and their order must not depend on it.

use sgs_engine::graph::{Buffer, Graph, Slice};
use sgs_passes::Tuning;
use sgs_passes::pipeline::Step;
use sgs_passes::reference::intersect::tiles;
use sgs_passes::reference::project::{Camera, Gaussians, Projected, project as reference};
use sgs_passes::scene::{Layout, Model, Storage};
use sgs_passes::splat::{Channels, Screen, intersect, project};
use sgs_shaders::structs::Work;
use sgs_tests::{Gpu, scenes};

/// Entries of a view.
#[derive(Debug, PartialEq)]
pub(super) struct Found {
    /// Gaussian of each visible splat.
    ids: Vec<u32>,
    tile_counts: Vec<u32>,
    /// First entry of each visible splat.
    starts: Vec<u32>,
    /// Visible splat of each entry.
    owners: Vec<u32>,
    /// Tile of each entry.
    tiles: Vec<u32>,
    /// Entries by tile, and by depth within a tile.
    pub order: Vec<u32>,
}

/// Finds the entries of a view.
fn find(gpu: &Gpu, scene: &Gaussians, camera: &Camera) -> Found {
    find_with(gpu, &gpu.tuning(), scene, camera)
}

/// Finds the entries of a view with other kernel sizes. Every buffer holds ones before.
pub(super) fn find_with(gpu: &Gpu, t: &Tuning, scene: &Gaussians, camera: &Camera) -> Found {
    let n = scene.len() as u32;
    let capacity = 1 << 16;
    let mut g = Graph::new("large_splats");
    let model = Model::default();
    let layout = Layout { model, capacity: n, training: false, statistics: false, storage: Storage::Exact };
    let handles = layout.declare(&mut g, false);
    let step = g.uniform("step", size_of::<Step>() as u64);
    let screen = Screen { step, largest: camera.size, tile: t.tile };
    let flags = g.external("flags", 4);
    let visible = project(&mut g, t, &screen, &handles, Channels::default()).unwrap();
    let entries = intersect(&mut g, t, &screen, &visible, capacity, flags).unwrap();
    let mut keep = |name: &str, what: Slice, words: u32| {
        let output = g.external(name, 4 * u64::from(words));
        g.copy(format!("out.{name}"), Slice { bytes: 4 * u64::from(words), ..what }, output).unwrap();
        output
    };
    let [ids, counts, starts] = [("ids", visible.ids), ("counts", visible.tile_counts), ("starts", entries.starts)]
        .map(|(name, buffer): (_, Buffer)| keep(name, buffer.into(), n));
    let owners = keep("owners", entries.splats.into(), capacity);
    let sorted = keep("order", entries.sorted, capacity);
    let ranges = keep("ranges", entries.tile_ranges.into(), 2 * screen.tiles());
    let seen = keep("seen", visible.work.slice, 4);
    let total = keep("total", entries.wanted.into(), 1);
    let mut uniform = Step { camera: scenes::gpu_camera(camera), ..Default::default() };
    uniform.camera.tiles = [0, 1].map(|k| camera.size[k].div_ceil(t.tile[k]));
    let data = scenes::data(scene);
    let mut inputs = handles.contents(&data);
    inputs.extend([(step, bytemuck::bytes_of(&uniform).to_vec()), (flags, vec![0; 4])]);
    let out = gpu.run(g, &inputs);
    assert_eq!(out.get::<u32>(flags), [0], "the entries overflowed");
    let seen = out.get::<Work>(seen)[0].count as usize;
    let total = out.get::<u32>(total)[0] as usize;
    let sorted = out.get::<u32>(sorted);
    let mut tiles = vec![u32::MAX; total];
    for (tile, range) in out.get::<[u32; 2]>(ranges).iter().enumerate() {
        sorted[range[0] as usize..range[1] as usize].iter().for_each(|e| tiles[*e as usize] = tile as u32);
    }
    let of = |buffer: Buffer, count: usize| out.get::<u32>(buffer)[..count].to_vec();
    Found {
        ids: of(ids, seen),
        tile_counts: of(counts, seen),
        starts: of(starts, seen),
        owners: of(owners, total),
        tiles,
        order: sorted[..total].to_vec(),
    }
}

/// Compares the tiles of every splat with the reference. Returns the largest number of tiles.
fn compare(found: &Found, truth: &[Projected], size: [u32; 2], tile: [u32; 2]) -> u32 {
    let mut compared = 0;
    for (v, id) in found.ids.iter().enumerate() {
        let first = found.starts[v] as usize;
        let own = first..first + found.tile_counts[v] as usize;
        assert!(found.owners[own.clone()].iter().all(|o| *o as usize == v), "splat {v} lacks an entry");
        let own = &found.tiles[own];
        assert!(own.is_sorted_by(|a, b| a < b), "splat {v}: {own:?}");
        let Some(splat) = truth.iter().find(|s| s.id == *id as usize) else { continue };
        // Rounding may decide at pixels near the threshold.
        let [least, most] = [0.98, 1.02].map(|factor| tiles(splat, size, tile, factor));
        assert!(own.iter().all(|t| most.contains(t)), "splat {v} has a tile too many: {own:?}, {most:?}");
        assert!(least.iter().all(|t| own.contains(t)), "splat {v} lacks a tile: {own:?}, {least:?}");
        compared += 1;
    }
    assert!(compared * 10 > 9 * truth.len(), "{compared} of {} splats are compared", truth.len());
    found.tile_counts.iter().copied().max().unwrap_or(0)
}

fn views() -> Vec<(Gaussians, [u32; 2])> {
    // Fewer and more tiles than lanes, across and down; more large splats than lanes.
    let mut views = vec![(scenes::large(70, 0, 1), [331, 90]), (scenes::large(90, 0, 2), [150, 300])];
    views.push((scenes::large(3, 0, 3), [1300, 5]));
    views.push((scenes::large(3, 0, 4), [5, 1300]));
    // More tiles than four times the widest subgroup.
    views.extend(
        [([700, 400], 6), ([400, 700], 7), ([1400, 200], 8)].map(|(size, seed)| (scenes::large(12, 0, seed), size)),
    );
    views.extend((1..4).map(|seed| (scenes::hard(seed), [160, 120])));
    views.push((scenes::ordinary(300, 0, false, 5), [64, 48]));
    views
}

#[test]
fn tiles_of_large_splats_match_reference() {
    let gpu = Gpu::new();
    let (t, mut large) = (gpu.tuning(), 0);
    for (scene, size) in views() {
        let camera = scenes::camera(size);
        let truth = reference(&scene, &camera, 0, false);
        let found = find(&gpu, &scene, &camera);
        assert_eq!(found.owners.len() as u32, found.tile_counts.iter().sum::<u32>());
        large += u32::from(compare(&found, &truth, size, t.tile) > t.large_tiles);
    }
    assert!(large > 3, "{large} views have a large splat");
}

#[test]
fn tiles_do_not_depend_on_who_finds_them() {
    for (scene, size) in views() {
        let camera = scenes::camera(size);
        let alone = find(&Gpu::new().with_large_tiles(u32::MAX), &scene, &camera);
        for tiles in [0, 5, 32] {
            let together = find(&Gpu::new().with_large_tiles(tiles), &scene, &camera);
            assert!(alone == together, "{size:?}, beyond {tiles} tiles: {alone:?}\n{together:?}");
        }
    }
}

#[test]
#[should_panic(expected = "has a tile too many")]
fn a_tile_too_many_is_detected() {
    let gpu = Gpu::new();
    let (scene, camera) = (scenes::ordinary(20, 0, false, 5), scenes::camera([64, 48]));
    let mut found = find(&gpu, &scene, &camera);
    let last = (0..found.ids.len()).rfind(|v| found.tile_counts[*v] > 0).unwrap();
    let at = (found.starts[last] + found.tile_counts[last] - 1) as usize;
    found.tiles[at] = 1000;
    compare(&found, &reference(&scene, &camera, 0, false), camera.size, gpu.tuning().tile);
}
