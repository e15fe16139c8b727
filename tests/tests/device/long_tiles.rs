//! Tiles with more entries than usual, of which none may be lost.
//!
//! Drivers have limits of their own. Llvmpipe silently leaves loops after 65535 iterations, summed over all loops of an
//! invocation.

use glam::{DMat3, DVec2, DVec3};
use sgs_engine::graph::{Graph, Slice};
use sgs_passes::pipeline::Step;
use sgs_passes::reference::project::{Camera, Gaussians};
use sgs_passes::scene::{Layout, Model, SEMANTIC_FEATURES, Storage};
use sgs_passes::splat::{
    BackwardKernel, Blended, Channels, Screen, Wanted, blend_bwd, blend_debt, blend_features, blend_features_bwd,
    blend_for, features_bwd, intersect, project, wanted_words,
};
use sgs_shaders::structs::Work;
use sgs_tests::scenes::{self, Rng};
use sgs_tests::{Gpu, Tolerance, assert_close};

const WIDE: u64 = SEMANTIC_FEATURES as u64;

fn bytes<T: bytemuck::NoUninit>(data: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(data).to_vec()
}

/// Builds faint splats all over one small image.
///
/// Without `wall`, no pixel saturates, so every entry contributes. With `wall`, no entry behind the wall contributes.
fn specks(count: usize, wall: bool) -> Gaussians {
    let mut r = Rng::new(1);
    let mut g = Gaussians::default();
    for i in 0..count {
        let in_wall = wall && i < 20;
        let z = 2.0 + i as f64 / count as f64;
        g.means.extend([z * r.between(-0.5, 0.5), z * r.between(-1.0, 1.0), z]);
        g.log_scales.extend([if in_wall { 2.0 } else { -9.0 }; 3]);
        g.rotations.extend([1.0, 0.0, 0.0, 0.0]);
        g.opacity_logits.push(if in_wall { 6.0 } else { -5.0 });
        g.sh[0].extend([0.0; 3]);
        g.semantics.extend([1.0; SEMANTIC_FEATURES as usize]);
    }
    g
}

fn check(gpu: &Gpu, size: [u32; 2], count: usize, wall: bool, which: BackwardKernel) {
    let dense = which == BackwardKernel::Pixel;
    let t = gpu.tuning();
    let scene = specks(count, wall);
    let n = count as u32;
    let camera = Camera {
        rotation: DMat3::IDENTITY,
        translation: DVec3::ZERO,
        focal: DVec2::splat(8.0),
        center: DVec2::new(0.5 * f64::from(size[0]), 0.5 * f64::from(size[1])),
        size,
        near: 0.01,
        radial: 0.0,
    };
    let mut g = Graph::new("long_tiles");
    let model = Model { semantics: true, ..Default::default() };
    let handles = Layout { model, capacity: n, training: false, statistics: false, storage: Storage::Exact }
        .declare(&mut g, false);
    let step = g.uniform("step", size_of::<Step>() as u64);
    let screen = Screen { step, largest: camera.size, tile: t.tile };
    let pixels = screen.pixels();
    let flags = g.external("flags", 4);
    let capacity = 4 * n;
    let visible = project(&mut g, &t, &screen, &handles, Channels::default()).unwrap();
    let entries = intersect(&mut g, &t, &screen, &visible, capacity, flags).unwrap();
    let image = g.external("image", 12 * pixels);
    let blended = Blended { image, transmittance: g.external("transmittance", 4 * pixels) };
    let buckets = blend_for(&mut g, &t, &screen, &visible, &entries, &blended, which).unwrap();
    let gradient =
        Blended { image: g.input("grad_image", 12 * pixels), transmittance: g.input("grad_transmittance", 4 * pixels) };
    let mut owed = blend_debt(&mut g, &t, &screen, 3, &blended, &gradient).unwrap();
    owed.buckets = buckets;
    let sums = blend_bwd(&mut g, &t, &screen, &visible, &entries, &owed, which, true).unwrap();
    let left = g.external("entry_gradients", 40 * u64::from(capacity));
    g.copy("keep", sums.gradients, left).unwrap();
    let wanted = g.input("wanted", 4 * wanted_words(pixels));
    let features = g.external("features", 4 * WIDE * pixels);
    let grad_features = g.input("grad_features", 4 * WIDE * pixels);
    let all = Wanted { pixels: wanted, dense };
    blend_features(&mut g, &t, &screen, &handles, &visible, &entries, all, features).unwrap();
    let wide =
        blend_features_bwd(&mut g, &t, &screen, &handles, &visible, &entries, all, features, grad_features).unwrap();
    let semantics = g.external("grad_semantics", 4 * WIDE * u64::from(n));
    features_bwd(&mut g, &t, &visible, &wide, semantics).unwrap();
    let total = g.external("total", 4);
    g.copy("count", Slice { bytes: 4, ..entries.wanted.into() }, total).unwrap();

    let mut uniform = Step { camera: scenes::gpu_camera(&camera), ..Default::default() };
    uniform.camera.tiles = [size[0].div_ceil(t.tile[0]), size[1].div_ceil(t.tile[1])];
    let data = scenes::data(&scene);
    let mut inputs = handles.contents(&data);
    inputs.push((handles.work, bytes(&[Work { x: n.div_ceil(256), y: 1, z: 1, count: n }])));
    inputs.push((step, bytes(&[uniform])));
    inputs.push((flags, vec![0; 4]));
    inputs.push((gradient.image, bytes(&vec![1.0_f32; 3 * pixels as usize])));
    inputs.push((gradient.transmittance, vec![0; 4 * pixels as usize]));
    inputs.push((wanted, vec![255; 4 * wanted_words(pixels) as usize]));
    inputs.push((grad_features, bytes(&vec![1.0_f32; (WIDE * pixels) as usize])));
    inputs.push((semantics, vec![0; 4 * (WIDE * u64::from(n)) as usize]));
    let out = gpu.run(g, &inputs);

    assert_eq!(out.get::<u32>(flags), [0], "the entries overflowed");
    let found = out.get::<u32>(total)[0] as usize;
    assert!(found > count / 4, "{found} entries");
    // All colors are gray and all features are one, so image, features and gradient sums are sums of weights.
    let transmittance = out.get::<f32>(blended.transmittance);
    let range = if wall { 1e-4..0.011 } else { 2e-4..0.99 };
    assert!(transmittance.iter().all(|t| range.contains(t)), "{transmittance:?}");
    let covered: Vec<f64> = transmittance.iter().map(|t| 1.0 - f64::from(*t)).collect();
    let gray: Vec<f64> = covered.iter().flat_map(|c| [c / 2.0; 3]).collect();
    assert_close("image", &gray, &out.get::<f32>(image), Tolerance::new(1e-4, 1e-3));
    let wide: Vec<f64> = covered.iter().flat_map(|c| [*c; WIDE as usize]).collect();
    assert_close("features", &wide, &out.get::<f32>(features), Tolerance::new(1e-4, 1e-3));
    let weight: f64 = covered.iter().sum();
    let left = &out.get::<f32>(left)[..10 * found];
    if let Some(at) = left.iter().position(|x| !x.is_finite()) {
        panic!("{which:?}: entry {} of {found} was not written", at / 10);
    }
    let column = |j: usize| left.chunks_exact(10).map(|e| f64::from(e[j])).sum::<f64>();
    for j in 6..10 {
        assert!((column(j) - weight).abs() < 1e-3 * weight, "{which:?}: {j} sums up to {} of {weight}", column(j));
    }
    let semantics = out.get::<f32>(semantics);
    for j in 0..WIDE as usize {
        let sum = semantics.chunks_exact(WIDE as usize).map(|g| f64::from(g[j])).sum::<f64>();
        assert!((sum - weight).abs() < 1e-3 * weight, "feature {j} sums up to {sum} of {weight}");
    }
}

/// Kernels that write rows of entries.
const KERNELS: [BackwardKernel; 3] = [BackwardKernel::Pixel, BackwardKernel::Splat, BackwardKernel::Bucket];

#[test]
fn no_entry_of_a_long_tile_is_lost() {
    let gpu = Gpu::new();
    for which in KERNELS {
        check(&gpu, [8, 16], 2001, false, which);
        check(&gpu, [8, 16], 20_000, false, which);
        check(&gpu, [5, 11], 2000, false, which);
    }
    drop(gpu);
    check(&Gpu::new().with_tile_parts(2), [8, 16], 20_000, false, BackwardKernel::Bucket);
}

/// Entries behind a saturated wall are still written.
#[test]
fn entries_behind_a_wall_are_written() {
    let gpu = Gpu::new();
    for which in KERNELS {
        check(&gpu, [8, 16], 2003, true, which);
        check(&gpu, [20, 19], 2001, true, which);
    }
    drop(gpu);
    check(&Gpu::new().with_tile_parts(4), [20, 19], 2001, true, BackwardKernel::Bucket);
}
