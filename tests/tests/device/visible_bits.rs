//! Visibility of splats is decided once. Projection follows the bits of the first pass, whatever they are.

use sgs_engine::graph::{Buffer, Graph};
use sgs_passes::kernel::stage;
use sgs_passes::pipeline::Step;
use sgs_passes::scene::{GaussianData, Model};
use sgs_passes::{Accuracy, Tuning};
use sgs_shaders::structs::{Splat, Work};
use sgs_shaders::{project, project_count};
use sgs_tests::{Gpu, scenes};

const COUNT: usize = 700;
const WORKGROUP: usize = 256;
const BLOCKS: usize = COUNT.div_ceil(WORKGROUP);
const MODEL: Model = Model { sh_degree: 0, normals: false, semantics: false, mip: false };

/// Results of the second pass, by visible splat.
#[derive(Debug, PartialEq)]
struct Projected {
    ids: Vec<u32>,
    depth_keys: Vec<u32>,
    splats: Vec<Splat>,
    features: Vec<u32>,
    tile_counts: Vec<u32>,
}

/// Contents of buffers.
type Inputs = Vec<(Buffer, Vec<u8>)>;

struct Case {
    gpu: Gpu,
    data: GaussianData,
    step: Step,
}

impl Case {
    /// Creates splats, some of them invisible. Every fifth is behind the camera and every seventh too faint.
    fn new() -> Case {
        let gpu = Gpu::new();
        let mut g = scenes::ordinary(COUNT, 0, false, 5);
        for i in 0..COUNT {
            if i % 5 == 0 {
                g.means[3 * i + 2] *= -1.0;
            }
            if i % 7 == 0 {
                g.opacity_logits[i] = -9.0;
            }
        }
        let mut camera = scenes::gpu_camera(&scenes::camera([64, 48]));
        let tile = gpu.tuning().tile;
        camera.tiles = [camera.size[0].div_ceil(tile[0]), camera.size[1].div_ceil(tile[1])];
        Case { data: scenes::data(&g), step: Step { camera, step: 1, ..Default::default() }, gpu }
    }

    fn tuning(&self) -> Tuning {
        Tuning { workgroup: WORKGROUP as u32, ..self.gpu.tuning() }.with(Accuracy::EXACT)
    }

    /// Declares the buffers that both passes read.
    fn declare(&self, g: &mut Graph) -> (Buffer, Buffer, Buffer, Inputs) {
        let step = g.uniform("step", size_of::<Step>() as u64);
        let work = g.input("gaussians", 16);
        let parameters = g.input("parameters", MODEL.column_bytes(COUNT as u32));
        let record = Work { x: BLOCKS as u32, y: 1, z: 1, count: COUNT as u32 };
        let inputs = vec![
            (step, bytemuck::bytes_of(&self.step).to_vec()),
            (work, bytemuck::bytes_of(&record).to_vec()),
            (parameters, bytemuck::cast_slice(&MODEL.to_columns(&self.data)).to_vec()),
        ];
        (step, work, parameters, inputs)
    }

    /// Returns the bits and counts of the first pass.
    fn count(&self) -> (Vec<u32>, Vec<u32>) {
        let t = self.tuning();
        let mut g = Graph::new("count");
        let (step, work, parameters, inputs) = self.declare(&mut g);
        let visible_bits = g.external("visible_bits", (BLOCKS * WORKGROUP / 8) as u64);
        let block_counts = g.external("block_counts", 4 * BLOCKS as u64);
        let bindings =
            project_count::Bindings { params: step, gaussians: work, parameters, visible_bits, block_counts };
        let specs = project_count::Specs {
            workgroup: t.workgroup,
            subgroup: t.subgroup_size,
            columns: MODEL.columns(),
            ..Default::default()
        };
        let bound = bindings.entries().map(|(name, buffer)| (name, buffer.into()));
        stage(&mut g, "project_count", &project_count::KERNEL, bound, specs.entries(), &[])
            .subgroup_size(Some(t.subgroup_size))
            .dispatch([BLOCKS as u32, 1, 1])
            .unwrap();
        let out = self.gpu.run(g, &inputs);
        (out.get(visible_bits), out.get(block_counts))
    }

    /// Runs the second pass with the given bits.
    fn project(&self, bits: &[u32]) -> Projected {
        let t = self.tuning();
        let mut g = Graph::new("project");
        let (step, work, parameters, mut inputs) = self.declare(&mut g);
        let visible_bits = g.input("visible_bits", 4 * bits.len() as u64);
        let block_offsets = g.input("block_offsets", 4 * BLOCKS as u64);
        let n = COUNT as u64;
        let [splat_ids, depth_keys, tile_counts] =
            ["splat_ids", "depth_keys", "tile_counts"].map(|name| g.external(name, 4 * n));
        let splats = g.external("splats", size_of::<Splat>() as u64 * n);
        let features = g.external("features", 12 * n);
        let bindings = project::Bindings {
            params: step,
            gaussians: work,
            parameters,
            visible_bits,
            block_offsets,
            splat_ids,
            depth_keys,
            splats,
            features,
            tile_counts,
        };
        let specs = project::Specs {
            workgroup: t.workgroup,
            columns: MODEL.columns(),
            subgroup: t.subgroup_size,
            large_tiles: t.large_tiles,
            sh_degree: 0,
            tile_width: t.tile[0],
            tile_height: t.tile[1],
            ..Default::default()
        };
        let bound = bindings.entries().map(|(name, buffer)| (name, buffer.into()));
        stage(&mut g, "project", &project::KERNEL, bound, specs.entries(), &[])
            .subgroup_size(Some(t.subgroup_size))
            .dispatch([BLOCKS as u32, 1, 1])
            .unwrap();
        let ones = bits.chunks(WORKGROUP / 32).map(|block| block.iter().map(|w| w.count_ones()).sum::<u32>());
        let offsets: Vec<u32> = ones.scan(0, |sum, count| Some(std::mem::replace(sum, *sum + count))).collect();
        inputs.push((visible_bits, bytemuck::cast_slice(bits).to_vec()));
        inputs.push((block_offsets, bytemuck::cast_slice(&offsets).to_vec()));
        let out = self.gpu.run(g, &inputs);
        Projected {
            ids: out.get(splat_ids),
            depth_keys: out.get(depth_keys),
            splats: out.get(splats),
            features: out.get(features),
            tile_counts: out.get(tile_counts),
        }
    }
}

/// Returns the Gaussians whose bits are set.
fn listed(bits: &[u32]) -> Vec<u32> {
    (0..32 * bits.len() as u32).filter(|i| bits[*i as usize / 32] >> (i % 32) & 1 == 1).collect()
}

/// Returns the largest opacity of a splat at any pixel's center. Computes in double precision.
fn largest_alpha(splat: &Splat, [width, height]: [u32; 2]) -> f64 {
    let [u11, u12, u22] = splat.factor.map(f64::from);
    let alpha = |x: u32, y: u32| {
        let [dx, dy] = [f64::from(x) + 0.5 - f64::from(splat.mean[0]), f64::from(y) + 0.5 - f64::from(splat.mean[1])];
        f64::from(splat.opacity) * (-(u11 * dx + u12 * dy).powi(2) - (u22 * dy).powi(2)).exp2()
    };
    (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| alpha(x, y)).fold(0.0, f64::max)
}

#[test]
fn projection_follows_the_bits_of_the_first_pass() {
    let case = Case::new();
    let (bits, counts) = case.count();
    let seen = listed(&bits);
    assert!(seen.len() > COUNT / 2 && seen.iter().all(|i| i % 5 != 0 && i % 7 != 0), "{seen:?}");
    let by_block = |block: usize| seen.iter().filter(|i| **i as usize / WORKGROUP == block).count() as u32;
    assert_eq!(counts, (0..BLOCKS).map(by_block).collect::<Vec<_>>());
    let own = case.project(&bits);
    assert_eq!(own.ids[..seen.len()], seen);
    // Near a corner of the image, a footprint's box may touch pixels that the footprint does not.
    for (v, splat) in own.splats[..seen.len()].iter().enumerate() {
        let brightest = largest_alpha(splat, case.step.camera.size);
        let touches = own.tile_counts[v] > 0;
        assert!(touches || brightest < 1.0001 / 255.0, "splat {v} shows with {brightest} in no tile");
    }
    assert_eq!(own.ids[seen.len()..], vec![u32::MAX; COUNT - seen.len()], "slots past the last are written");

    // Every third visible splat loses its bit and some culled ones gain one, as different rounding could do.
    let mut altered = bits.clone();
    seen.iter().step_by(3).for_each(|i| altered[*i as usize / 32] &= !(1 << (i % 32)));
    let added: Vec<u32> = (0..COUNT as u32).filter(|i| i % 35 == 0).collect();
    added.iter().for_each(|i| altered[*i as usize / 32] |= 1 << (i % 32));
    let expected = listed(&altered);
    assert!(expected.len() < seen.len());
    let other = case.project(&altered);
    assert_eq!(other.ids[..expected.len()], expected);
    assert_eq!(other.ids[expected.len()..], vec![u32::MAX; COUNT - expected.len()]);
    for (v, i) in expected.iter().enumerate() {
        let Some(before) = seen.iter().position(|other| other == i) else {
            assert_eq!(other.tile_counts[v], 0, "culled splat {i} touches tiles");
            assert!(other.splats[v].factor.iter().all(|f| f.is_finite()));
            assert!(f32::from_bits(other.depth_keys[v]).is_finite());
            continue;
        };
        assert_eq!(other.tile_counts[v], own.tile_counts[before], "{i}");
        assert_eq!(other.depth_keys[v], own.depth_keys[before], "{i}");
        assert_eq!(other.splats[v], own.splats[before], "{i}");
        assert_eq!(other.features[3 * v..3 * v + 3], own.features[3 * before..3 * before + 3], "{i}");
    }
}
