//! Gradients of blending over buckets of tile entries.
//!
//! They are compared with those of the kernel of pixels on the same entries. The kernel of pixels is tested against the
//! reference in `splat_bwd.rs`. Here tiles have many buckets.

use sgs_engine::graph::{Graph, Slice};
use sgs_passes::pipeline::Step;
use sgs_passes::reference::project::Gaussians;
use sgs_passes::scene::{Layout, Model, Storage};
use sgs_passes::splat::{
    BackwardKernel, Blended, Channels, Screen, Statistic, blend_bwd, blend_debt, blend_for, intersect, project,
    statistic_debt,
};
use sgs_passes::{Accuracy, Tuning};
use sgs_tests::scenes::{self, Rng};
use sgs_tests::{Gpu, gradients};

fn bytes<T: bytemuck::NoUninit>(data: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(data).to_vec()
}

/// Results of a kernel of blending.
pub(super) struct Side {
    pub image: Vec<u32>,
    pub transmittance: Vec<u32>,
    /// Row of gradients of each entry; entries after the last stay poisoned.
    pub rows: Vec<f32>,
}

/// Results of the kernels of pixels and of buckets.
pub(super) struct Both {
    pub pixel: Side,
    pub bucket: Side,
    /// Floats of a row.
    row: usize,
    /// Required entries.
    pub wanted: usize,
    pub flags: u32,
    /// Entries of a bucket.
    size: u32,
    /// Parts of a tile.
    pub parts: usize,
    /// Columns and rows of a part.
    pub part: [u32; 2],
    /// Marks of the buckets, part by part.
    pub marks: Vec<u32>,
    /// Checkpoints of the forward pass.
    pub checkpoints: Vec<u32>,
}

/// Blends a scene forward and backward by both kernels.
fn both(gpu: &Gpu, t: &Tuning, scene: &Gaussians, size: [u32; 2], statistic: Option<Statistic>, capacity: u32) -> Both {
    both_from(gpu, t, scene, size, statistic, capacity, None)
}

/// Blends a scene as [`both`] does. The backward pass reads other checkpoints than the forward pass wrote, if given.
pub(super) fn both_from(
    gpu: &Gpu,
    t: &Tuning,
    scene: &Gaussians,
    size: [u32; 2],
    statistic: Option<Statistic>,
    capacity: u32,
    checkpoints: Option<&[u32]>,
) -> Both {
    let mut g = Graph::new("buckets");
    let model = Model { normals: !scene.normals.is_empty(), ..Model::default() };
    let channels = Channels { colors: true, normals: model.normals, depth: model.normals };
    let n = scene.len() as u32;
    let handles = Layout { model, capacity: n, training: false, statistics: false, storage: Storage::Exact }
        .declare(&mut g, false);
    let step = g.uniform("step", size_of::<Step>() as u64);
    let screen = Screen { step, largest: size, tile: t.tile };
    let flags = g.external("flags", 4);
    let visible = project(&mut g, t, &screen, &handles, channels).unwrap();
    let entries = intersect(&mut g, t, &screen, &visible, capacity, flags).unwrap();
    let (pixels, c) = (screen.pixels(), channels.count());
    let gradient = Blended {
        image: g.input("grad_image", 4 * u64::from(c) * pixels),
        transmittance: g.input("grad_transmittance", 4 * pixels),
    };
    let row = 7 + c as usize + if statistic.is_some() { 2 } else { 0 };
    let mut kept = None;
    let mut replaced = Vec::new();
    let outputs = [(BackwardKernel::Pixel, "pixel."), (BackwardKernel::Bucket, "bucket.")].map(|(which, prefix)| {
        g.set_prefix(prefix);
        let into = Blended {
            image: g.external("image", 4 * u64::from(c) * pixels),
            transmittance: g.external("transmittance", 4 * pixels),
        };
        let mut buckets = blend_for(&mut g, t, &screen, &visible, &entries, &into, which).unwrap();
        if let Some(b) = &mut buckets {
            let parts = t.tile[0] / b.part[0] * (t.tile[1] / b.part[1]);
            let marks = g.external("marks", 4 * u64::from(b.slots * parts));
            g.copy("keep_marks", b.tiles, marks).unwrap();
            let tile = u64::from(t.tile[0] * t.tile[1]);
            let length = 4 * u64::from(1 + c) * tile * u64::from((capacity / b.entries).max(1));
            let states = g.external("states", length);
            g.copy("keep_states", b.checkpoints, states).unwrap();
            kept = Some((b.entries, parts as usize, b.part, marks, states));
            if let Some(other) = checkpoints {
                b.checkpoints = g.input("other_states", length);
                replaced.push((b.checkpoints, bytes(other)));
            }
        }
        let mut owed = blend_debt(&mut g, t, &screen, c, &into, &gradient).unwrap();
        owed.buckets = buckets;
        owed.statistic =
            statistic.map(|which| (which, statistic_debt(&mut g, t, &screen, c, &into, &gradient, which).unwrap()));
        let sums = blend_bwd(&mut g, t, &screen, &visible, &entries, &owed, which, true).unwrap();
        let rows = g.external("rows", 4 * row as u64 * u64::from(capacity));
        g.copy("keep", sums.gradients, rows).unwrap();
        (into, rows)
    });
    let total = g.external("total", 4);
    g.copy("count", Slice { bytes: 4, ..entries.wanted.into() }, total).unwrap();

    let camera = scenes::camera(size);
    let mut uniform = Step { camera: scenes::gpu_camera(&camera), background: [0.3, 0.1, 0.6], ..Step::default() };
    uniform.camera.tiles = [size[0].div_ceil(t.tile[0]), size[1].div_ceil(t.tile[1])];
    let data = scenes::data(scene);
    let mut inputs = handles.contents(&data);
    inputs.extend(replaced);
    inputs.push((step, bytes(&[uniform])));
    inputs.push((flags, vec![0; 4]));
    let mut rng = Rng::new(5);
    let mut random = |count: u64| bytes(&(0..count).map(|_| rng.between(-1.0, 1.0) as f32).collect::<Vec<_>>());
    inputs.push((gradient.image, random(u64::from(c) * pixels)));
    inputs.push((gradient.transmittance, random(pixels)));
    let out = gpu.run(g, &inputs);
    let [pixel, bucket] = outputs.map(|(into, rows)| Side {
        image: out.get(into.image),
        transmittance: out.get(into.transmittance),
        rows: out.get(rows),
    });
    let (wanted, flags) = (out.get::<u32>(total)[0] as usize, out.get::<u32>(flags)[0]);
    let (size, parts, part, marks, states) = kept.unwrap();
    let (marks, checkpoints) = (out.get(marks), out.get(states));
    Both { pixel, bucket, row, wanted, flags, size, parts, part, marks, checkpoints }
}

/// Returns the largest difference of two sets of gradients.
///
/// Each column is relative to its largest value.
fn disagreement(a: &[f32], b: &[f32], row: usize) -> f32 {
    let column = |j: usize| {
        let scale = a.iter().skip(j).step_by(row).fold(1e-30_f32, |m, x| m.max(x.abs()));
        let apart = a.iter().zip(b).skip(j).step_by(row).map(|(x, y)| (x - y).abs());
        apart.fold(0.0_f32, |m, d| if d.is_nan() { f32::INFINITY } else { m.max(d / scale) })
    };
    (0..row).map(column).fold(0.0, f32::max)
}

#[test]
fn gradients_over_many_buckets_match_those_by_pixels() {
    let gpu = Gpu::new();
    let own = gpu.tuning();
    // Without workers, every view has many tiles by comparison.
    let large = Tuning { workers: 0, ..own };
    let kept = own.with(Accuracy { keep_last: true, transmittance_min: 0.05, ..Accuracy::EXACT });
    let tall = Tuning { tile: [own.tile[0], 32], ..own };
    let short = Tuning { tile: [own.tile[0], 8], ..large };
    let scene = |count, normals| scenes::ordinary(count, 0, normals, 9);
    for (name, t, g, size, statistic) in [
        ("small buckets", own, scene(4000, false), [33, 21], None),
        ("large buckets", large, scene(4000, false), [33, 21], None),
        ("eight channels", own, scene(2000, true), [21, 40], None),
        ("photometric statistic", own, scene(2000, true), [21, 18], Some(Statistic::Photometric)),
        ("geometric statistic", large, scene(2000, true), [21, 18], Some(Statistic::Geometric)),
        ("last splat kept", kept, scene(3000, false), [40, 18], None),
        ("tall tiles", tall, scene(3000, true), [21, 40], None),
        ("short tiles", short, scene(6000, true), [21, 40], Some(Statistic::Photometric)),
    ] {
        let found = both(&gpu, &t, &g, size, statistic, 1 << 16);
        let [a, b] = [&found.pixel, &found.bucket];
        assert_eq!(found.flags, 0, "{name}: the entries overflowed");
        let tiles = size[0].div_ceil(t.tile[0]) * size[1].div_ceil(t.tile[1]);
        let full = found.wanted as u32 / tiles / found.size;
        assert!(full >= 2, "{name}: {} entries in {tiles} tiles, buckets of {}", found.wanted, found.size);
        assert!(a.image == b.image && a.transmittance == b.transmittance, "{name}: checkpoints change the image");
        let stopped = a.transmittance.iter().filter(|x| f32::from_bits(**x) < 2.0 * t.accuracy.transmittance_min);
        let stopped = stopped.count();
        assert!(stopped > 10 && stopped < a.transmittance.len(), "{name}: {stopped} pixels have stopped");
        let count = found.row * found.wanted;
        if let Some(at) = b.rows[..count].iter().position(|x| !x.is_finite()) {
            panic!("{name}: entry {} of {} was not written", at / found.row, found.wanted);
        }
        assert!(b.rows[count..].iter().all(|x| x.to_bits() == u32::MAX), "{name}: a row after the last was written");
        let zeros = b.rows[..count].chunks_exact(found.row).filter(|r| r.iter().all(|x| *x == 0.0)).count();
        assert!(zeros > 0 && zeros < found.wanted, "{name}: {zeros} of {} rows are zero", found.wanted);
        let apart = disagreement(&a.rows[..count], &b.rows[..count], found.row);
        assert!(apart < 2e-5, "{name}: gradients differ by {apart:.1e} of the largest");
        // The comparison finds one wrong number among all.
        let most = (0..count).max_by(|i, j| b.rows[*i].abs().total_cmp(&b.rows[*j].abs())).unwrap();
        let mut wrong = b.rows[..count].to_vec();
        wrong[most] *= 1.001;
        assert!(disagreement(&a.rows[..count], &wrong, found.row) > 2e-5);
        // The same bits again.
        let again = both(&gpu, &t, &g, size, statistic, 1 << 16).bucket.rows;
        assert!(again.iter().zip(&b.rows).all(|(x, y)| x.to_bits() == y.to_bits()), "{name}: not repeated");
    }
}

/// Tests gradients against differences of the reference.
///
/// One tile has several buckets.
#[test]
fn gradients_over_many_buckets_match_reference() {
    let gpu = Gpu::new();
    let case = gradients::Case::new(scenes::ordinary(260, 0, false, 3), [7, 6], false);
    let entries = both(&gpu, &gpu.tuning(), &case.gaussians, case.camera.size, None, 1 << 12).wanted;
    assert!(entries > 128, "{entries} entries in one tile");
    super::splat_bwd::check(&gpu, &case, BackwardKernel::Bucket);
}

/// Tests capacities that the entries fill or exceed.
#[test]
fn buckets_fit_the_capacity_of_entries() {
    let gpu = Gpu::new();
    let g = scenes::ordinary(900, 0, false, 4);
    for workers in [0, 512] {
        let t = Tuning { workers, ..gpu.tuning() };
        let of = |capacity: u32| both(&gpu, &t, &g, [37, 35], None, capacity);
        let roomy = of(1 << 15);
        let count = roomy.row * roomy.wanted;
        let exact = of(roomy.wanted as u32);
        assert_eq!(exact.flags, 0);
        assert!(exact.bucket.rows.iter().zip(&roomy.bucket.rows[..count]).all(|(a, b)| a.to_bits() == b.to_bits()));
        let short = of(roomy.wanted as u32 - 1);
        assert_eq!((short.flags, short.wanted), (1, roomy.wanted));
        assert!(short.bucket.rows.iter().all(|x| x.to_bits() == u32::MAX), "a row was written after the overflow");
        assert!(short.bucket.image == short.pixel.image);
    }
}
