//! Surfaces and the sparse matrix of a view against the twin; materials through it, and their gradients.

use sgs_engine::graph::{Buffer, Graph};
use sgs_passes::pipeline::Step;
use sgs_passes::reference::blend::{Blended as TwinBlended, render};
use sgs_passes::reference::gbuffer::{Materials, gbuffer as twin_gbuffer, stored_rows, weights as twin_weights};
use sgs_passes::reference::project::{Camera, Gaussians, project as twin_project};
use sgs_passes::scene::{Gaussians as GpuGaussians, Model};
use sgs_passes::shade::{
    GBUFFER_CHANNELS, PixelMaterials, RawMaterials, Room, Surfaces, Weights, gbuffer, materials, materials_bwd,
    unpacked_weights, values, weight_words, weights,
};
use sgs_passes::splat::{Blended, Screen, blend, intersect, project};
use sgs_tests::{Gpu, scenes};

const ROOM: u32 = 1 << 17;

struct Found {
    points: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
    coverage: Vec<f32>,
    row_starts: Vec<u32>,
    columns: Vec<u32>,
    weights: Vec<f32>,
    column_starts: Vec<u32>,
    rows: Vec<u32>,
    row_weights: Vec<f32>,
    flags: u32,
    wanted: u32,
    materials: Vec<[f32; 4]>,
    metallic: Vec<f32>,
    grad_albedo: Vec<f32>,
    grad_roughness: Vec<f32>,
    grad_metallic: Vec<f32>,
}

fn bytes<T: bytemuck::Pod>(values: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(values).to_vec()
}

fn single(values: &[f64]) -> Vec<u8> {
    bytes(&values.iter().map(|v| *v as f32).collect::<Vec<f32>>())
}

/// Everything at once: `gradient` is of the five materials of every pixel.
fn run(
    gpu: &Gpu,
    scene: &Gaussians,
    camera: &Camera,
    raw: &Materials,
    gradient: &[[f64; 5]],
    room: u32,
    bits: u32,
) -> Found {
    let (t, pixels) = (gpu.tuning(), u64::from(camera.size[0]) * u64::from(camera.size[1]));
    let n = scene.len() as u32;
    let mut g = Graph::new("gbuffer");
    let step = g.uniform("step", size_of::<Step>() as u64);
    let screen = Screen { step, largest: camera.size, tile: t.tile };
    let model = Model { sh_degree: 0, normals: true, semantics: false };
    let gaussians = GpuGaussians::new(gpu.device(), model, n, false).unwrap();
    let handles = gaussians.declare(&mut g, false);
    let visible = project(&mut g, &t, &screen, &handles, GBUFFER_CHANNELS).unwrap();
    let flags = g.external("flags", 4);
    let wanted = g.external("wanted", 4);
    let entries = intersect(&mut g, &t, &screen, &visible, ROOM, flags).unwrap();
    let blended =
        Blended { image: g.transient("image", 20 * pixels), transmittance: g.transient("transmittance", 4 * pixels) };
    blend(&mut g, &t, &screen, &visible, &entries, &blended).unwrap();
    let surfaces = Surfaces {
        points: g.external("points", 12 * pixels),
        normals: g.external("normals_seen", 12 * pixels),
        coverage: g.external("coverage", 4 * pixels),
    };
    gbuffer(&mut g, &t, &screen, &blended, &surfaces).unwrap();
    let mut words = |name: &str, count: u64| g.external(name, 4 * count);
    let matrix = Weights {
        row_starts: words("row_starts", pixels + 1),
        columns: words("columns", room.into()),
        weights: words("weights", weight_words(room, bits)),
        column_starts: words("column_starts", u64::from(n) + 1),
        rows: words("rows", room.into()),
        row_weights: words("row_weights", weight_words(room, bits)),
        bits,
    };
    let space = Room { capacity: room, gaussians: n, flags, wanted };
    weights(&mut g, &t, &screen, &visible, &entries, surfaces.coverage, &space, &matrix).unwrap();
    let metals = !raw.metallic.is_empty();
    let floats = |g: &mut Graph, name: &str, width: u64| g.external(name, 4 * width * u64::from(n));
    let given = RawMaterials {
        albedo: floats(&mut g, "albedo", 3),
        roughness: floats(&mut g, "roughness", 1),
        metallic: metals.then(|| floats(&mut g, "metallic", 1)),
    };
    let picture = PixelMaterials {
        materials: g.external("materials", 16 * pixels),
        metallic: metals.then(|| g.external("metallic_seen", 4 * pixels)),
    };
    let active = values(&mut g, &t, &given, n).unwrap();
    materials(&mut g, &t, &screen, &active, &matrix, &picture).unwrap();
    let asked = PixelMaterials {
        materials: g.external("materials_gradient", 16 * pixels),
        metallic: metals.then(|| g.external("metallic_gradient", 4 * pixels)),
    };
    let grads = RawMaterials {
        albedo: floats(&mut g, "grad_albedo", 3),
        roughness: floats(&mut g, "grad_roughness", 1),
        metallic: metals.then(|| floats(&mut g, "grad_metallic", 1)),
    };
    materials_bwd(&mut g, &t, &given, &matrix, n, &asked, false, &grads).unwrap();
    let mut values = Step { camera: scenes::gpu_camera(camera), ..Default::default() };
    values.camera.tiles = [camera.size[0].div_ceil(t.tile[0]), camera.size[1].div_ceil(t.tile[1])];
    let data = scenes::data(scene);
    let four: Vec<f32> = gradient.iter().flat_map(|v| [v[0], v[1], v[2], v[3]].map(|v| v as f32)).collect();
    let one: Vec<f32> = gradient.iter().map(|v| v[4] as f32).collect();
    let mut inputs: Vec<(Buffer, Vec<u8>)> = vec![
        (step, bytes(&[values])),
        (flags, bytes(&[0u32])),
        (given.albedo, single(&raw.albedo)),
        (given.roughness, single(&raw.roughness)),
        (asked.materials, bytes(&four)),
        (handles.work, bytes(&[n.div_ceil(256).max(1), 1, 1, n])),
    ];
    for group in model.groups() {
        inputs.push((handles.group(group), bytes(data.group(group))));
    }
    if let (Some(metallic), Some(gradient)) = (given.metallic, asked.metallic) {
        inputs.push((metallic, single(&raw.metallic)));
        inputs.push((gradient, bytes(&one)));
    }
    let out = gpu.run(g, &inputs);
    let of_words = |words: Vec<u32>| match bits {
        16 => unpacked_weights(&words, room as usize),
        _ => words.into_iter().map(f32::from_bits).collect(),
    };
    Found {
        points: out.get(surfaces.points),
        normals: out.get(surfaces.normals),
        coverage: out.get(surfaces.coverage),
        row_starts: out.get(matrix.row_starts),
        columns: out.get(matrix.columns),
        weights: of_words(out.get(matrix.weights)),
        column_starts: out.get(matrix.column_starts),
        rows: out.get(matrix.rows),
        row_weights: of_words(out.get(matrix.row_weights)),
        flags: out.get::<u32>(flags)[0],
        wanted: out.get::<u32>(wanted)[0],
        materials: out.get(picture.materials),
        metallic: picture.metallic.map(|b| out.get(b)).unwrap_or_default(),
        grad_albedo: out.get(grads.albedo),
        grad_roughness: out.get(grads.roughness),
        grad_metallic: grads.metallic.map(|b| out.get(b)).unwrap_or_default(),
    }
}

fn random_materials(n: usize, metals: bool, reach: f64, seed: u64) -> Materials {
    let mut r = scenes::Rng::new(seed);
    let mut many = |count: usize| (0..count).map(|_| f64::from(r.between(-reach, reach) as f32)).collect::<Vec<_>>();
    Materials { albedo: many(3 * n), roughness: many(n), metallic: if metals { many(n) } else { Vec::new() } }
}

fn random_gradient(pixels: usize, seed: u64) -> Vec<[f64; 5]> {
    let mut r = scenes::Rng::new(seed);
    (0..pixels).map(|_| [(); 5].map(|()| f64::from(r.between(-1.0, 1.0) as f32))).collect()
}

/// Checks everything that `run` found against the twin; `metals` and how far raw materials reach.
fn check(gpu: &Gpu, scene: &Gaussians, camera: &Camera, metals: bool, reach: f64, most_doubtful: f64) {
    for bits in [32, 16] {
        check_in(gpu, scene, camera, metals, reach, most_doubtful, bits);
    }
}

/// With weights in so many bits.
fn check_in(gpu: &Gpu, scene: &Gaussians, camera: &Camera, metals: bool, reach: f64, most_doubtful: f64, bits: u32) {
    let n = scene.len();
    let pixels = (camera.size[0] * camera.size[1]) as usize;
    let raw = random_materials(n, metals, reach, 3);
    let gradient = random_gradient(pixels, 5);
    let found = run(gpu, scene, camera, &raw, &gradient, ROOM, bits);
    assert_eq!(found.flags, 0);
    let truth: TwinBlended = render(scene, camera, 0, true, [0.0; 3]);
    let surfaces = twin_gbuffer(camera, &truth, 8);
    let mut rows = twin_weights(&twin_project(scene, camera, 0, true), camera.size);
    if bits == 16 {
        rows = stored_rows(&rows);
    }
    let blended = raw.blend(&rows);
    let total = *found.row_starts.last().unwrap();
    assert_eq!(total, found.wanted);
    let mut doubtful = 0;
    for p in 0..pixels {
        let (begin, end) = (found.row_starts[p] as usize, found.row_starts[p + 1] as usize);
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
            // Opposing normals may nearly cancel; then the direction is anybody's guess.
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
    // The transpose holds the same entries, column by column and by ascending pixels.
    let mut by_column: Vec<Vec<(u32, f32)>> = vec![Vec::new(); n];
    for p in 0..pixels {
        for e in found.row_starts[p] as usize..found.row_starts[p + 1] as usize {
            by_column[found.columns[e] as usize].push((p as u32, found.weights[e]));
        }
    }
    assert_eq!((found.column_starts[0], found.column_starts[n]), (0, total));
    for (i, column) in by_column.iter().enumerate() {
        let range = found.column_starts[i] as usize..found.column_starts[i + 1] as usize;
        let mut transposed: Vec<(u32, f32)> = range.clone().map(|e| (found.rows[e], found.row_weights[e])).collect();
        // Rows of a tile come before those of the next pixel row: sorting is stable, so entries keep their order.
        transposed.sort_by_key(|e| e.0);
        assert_eq!(&transposed, column, "column {i}");
    }
    // Gradients: exact sums over the columns that the device itself found, and slopes by differences of the activation.
    let slope = |raw: f64, of: fn(&Materials) -> f64, set: fn(f64) -> Materials| {
        let h = 1e-5 * raw.abs().max(1.0);
        (of(&set(raw + h)) - of(&set(raw - h))) / (2.0 * h)
    };
    let ranged = |raw: f64| {
        slope(raw, |m| m.values(0)[3], |r| Materials { albedo: vec![0.0; 3], roughness: vec![r], metallic: vec![] })
    };
    let colored = |raw: f64| {
        slope(raw, |m| m.values(0)[0], |r| Materials { albedo: vec![r; 3], roughness: vec![0.0], metallic: vec![] })
    };
    let free = |raw: f64| {
        slope(raw, |m| m.values(0)[4], |r| Materials { albedo: vec![0.0; 3], roughness: vec![0.0], metallic: vec![r] })
    };
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
fn surfaces_weights_and_materials_agree_with_the_twin() {
    let gpu = Gpu::new();
    for (size, count, metals, reach) in
        [([64, 48], 200, false, 2.0), ([61, 37], 500, true, 4.0), ([17, 3], 40, true, 8.0)]
    {
        let scene = scenes::ordinary(count, 0, true, u64::from(size[0]));
        check(&gpu, &scene, &scenes::camera(size), metals, reach, 0.6);
    }
}

/// Weights in 16 bits are those of 32, rounded along their row: each within one part of 65535, rows adding up as they did to
/// half a part; and the columns hold the same.
#[test]
fn weights_in_16_bits_are_rounded_along_their_rows() {
    let gpu = Gpu::new();
    let scene = scenes::ordinary(900, 0, true, 61);
    let camera = scenes::camera([61, 37]);
    let raw = random_materials(scene.len(), false, 1.0, 3);
    let gradient = random_gradient(61 * 37, 5);
    let [wide, narrow] = [32, 16].map(|bits| run(&gpu, &scene, &camera, &raw, &gradient, ROOM, bits));
    assert!(wide.row_starts == narrow.row_starts && wide.rows == narrow.rows);
    let count = wide.wanted as usize;
    assert!(count % 2 == 1 || count > 10_000, "{count}");
    assert!(wide.columns[..count] == narrow.columns[..count] && wide.column_starts == narrow.column_starts);
    let (mut largest, mut longest, mut lost) = (0.0_f64, 0, 0);
    for row in wide.row_starts.windows(2).map(|w| w[0] as usize..w[1] as usize) {
        let mut carried = 0.0_f32;
        let (mut sum, mut kept) = (0.0, 0.0);
        longest = longest.max(row.len());
        for e in row {
            let wanted = wide.weights[e] * 65535.0 + carried;
            let parts = (narrow.weights[e] * 65535.0).round();
            assert_eq!(narrow.weights[e], parts * (1.0 / 65535.0), "entry {e}");
            // A device may work out what is halfway between two a little differently.
            assert!((wanted - parts).abs() < 0.51, "entry {e}: {wanted} became {parts}");
            carried = wanted - parts;
            largest = largest.max(f64::from((wide.weights[e] - narrow.weights[e]).abs()));
            (sum, kept) = (sum + f64::from(wide.weights[e]), kept + f64::from(narrow.weights[e]));
            lost += usize::from(parts == 0.0);
        }
        assert!((sum - kept).abs() < 0.51 / 65535.0 + 1e-6, "{sum} and {kept}");
    }
    println!("{count} weights, rows of up to {longest}: off by {largest:.1e}; {lost} are none");
    assert!(
        largest > 0.5 / 65535.0 && largest < 1.01 / 65535.0 && longest > 20 && lost > 0,
        "{largest} {longest} {lost}"
    );
    // What `Accuracy` promises of materials, which lie between 0 and 1.
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
fn one_pixel_and_nothing_to_see() {
    let gpu = Gpu::new();
    check(&gpu, &scenes::ordinary(20, 0, true, 1), &scenes::camera([1, 1]), true, 1.0, 1.0);
    let mut away = scenes::ordinary(20, 0, true, 1);
    away.means.chunks_mut(3).for_each(|m| m[2] -= 1e3);
    check(&gpu, &away, &scenes::camera([9, 5]), false, 1.0, 0.0);
}

#[test]
fn what_does_not_fit_is_counted_and_nothing_is_written_past_the_end() {
    let gpu = Gpu::new();
    let scene = scenes::ordinary(200, 0, true, 64);
    let camera = scenes::camera([64, 48]);
    let raw = random_materials(scene.len(), false, 1.0, 3);
    let gradient = random_gradient(64 * 48, 5);
    let all = run(&gpu, &scene, &camera, &raw, &gradient, ROOM, 32);
    let short = run(&gpu, &scene, &camera, &raw, &gradient, all.wanted - 1, 32);
    assert_eq!((short.flags, short.wanted), (1, all.wanted));
    let exact = run(&gpu, &scene, &camera, &raw, &gradient, all.wanted, 32);
    assert_eq!((exact.flags, exact.wanted), (0, all.wanted));
    assert_eq!(exact.grad_albedo, all.grad_albedo, "room changes nothing");
}

#[test]
fn saturated_materials_have_finite_gradients_that_do_not_vanish_early() {
    let gpu = Gpu::new();
    let scene = scenes::ordinary(40, 0, true, 2);
    check(&gpu, &scene, &scenes::camera([20, 16]), true, 30.0, 1.0);
}
