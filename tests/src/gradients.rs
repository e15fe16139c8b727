//! Gradients of the whole render: projection, spherical harmonics and blending.
//!
//! A [`Case`] runs on the kernels and on the reference.

use crate::Gpu;
use crate::scenes::{self, Rng};
use glam::{DMat3, DVec3};
use sgs_engine::graph::Graph;
use sgs_passes::optim::{CameraParts, camera_bwd, camera_part_bytes};
use sgs_passes::pipeline::Step;
use sgs_passes::reference::blend::{Blended as RenderedImage, blend_at};
use sgs_passes::reference::project::{Camera, Gaussians, project_at};
use sgs_passes::scene::{Gaussians as GpuGaussians, Group, Model, SEMANTIC_FEATURES};
use sgs_passes::splat::{
    BackwardKernel, Blended, Channels, Gradients, Screen, Wanted, blend_bwd, blend_debt, blend_features,
    blend_features_bwd, blend_for, features_bwd, intersect, project, project_bwd, wanted_words,
};
use sgs_passes::{Accuracy, Tuning};

/// Scene, view and loss weights; the loss is the dot product of weights and render.
#[derive(Clone, Debug)]
pub struct Case {
    /// Gaussians of the scene.
    pub gaussians: Gaussians,
    /// Camera of the view.
    pub camera: Camera,
    /// Whether depth and squared depth are blended.
    pub depth: bool,
    /// Weights of the image's channels, by pixel.
    pub image: Vec<f64>,
    /// Weights of the transmittances, by pixel.
    pub transmittance: Vec<f64>,
    /// Weights of semantic features, by pixel; zero at pixels that are not requested.
    pub features: Vec<f64>,
    /// Whether features contribute to the gradients of opacities and footprints.
    pub features_move: bool,
    /// Approximations for speed.
    pub accuracy: Accuracy,
}

/// Returns true if the features of a pixel are requested.
///
/// The pixels are scattered, so that tiles have a few, all or none of them.
fn wants(pixel: usize) -> bool {
    pixel % 7 < 3 || (100..230).contains(&pixel)
}

/// Numbers of a camera with gradients: the rotation's rows, the translation, the logarithm of the focal lengths, the
/// shift of the principal point in focal lengths, and radial distortion.
pub const CAMERA_NUMBERS: usize = 16;

/// Returns the camera whose number `i` of [`CAMERA_NUMBERS`] is larger by `change`.
pub fn changed_camera(camera: &Camera, i: usize, change: f64) -> Camera {
    let mut camera = *camera;
    match i {
        0..9 => {
            let mut m = camera.rotation.to_cols_array();
            m[i % 3 * 3 + i / 3] += change;
            camera.rotation = DMat3::from_cols_array(&m);
        }
        9..12 => camera.translation[i - 9] += change,
        12 => camera.focal *= change.exp(),
        13..15 => camera.center[i - 13] += change * camera.focal[i - 13],
        _ => camera.radial += change,
    }
    camera
}

/// Background color, linear RGB.
const BACKGROUND: [f64; 3] = [0.3, 0.1, 0.6];

impl Case {
    /// Creates a case with random weights and the default camera.
    pub fn new(gaussians: Gaussians, size: [u32; 2], depth: bool) -> Case {
        Case::seen(gaussians, scenes::camera(size), depth)
    }

    /// Creates a case with random weights and any camera.
    pub fn seen(gaussians: Gaussians, camera: Camera, depth: bool) -> Case {
        let size = camera.size;
        let channels = 3 + if gaussians.normals.is_empty() { 0 } else { 3 } + if depth { 2 } else { 0 };
        let pixels = (size[0] * size[1]) as usize;
        let mut r = Rng::new(99);
        let single = |v: f64| f64::from(v as f32);
        let image = (0..pixels * channels).map(|_| single(r.between(-1.0, 1.0))).collect();
        let transmittance = (0..pixels).map(|_| single(r.between(-1.0, 1.0))).collect();
        let wide = if gaussians.semantics.is_empty() { 0 } else { SEMANTIC_FEATURES as usize };
        let features = (0..pixels * wide).map(|i| if wants(i / wide) { single(r.between(-1.0, 1.0)) } else { 0.0 });
        let features = features.collect();
        Case {
            gaussians,
            camera,
            depth,
            image,
            transmittance,
            features,
            features_move: true,
            accuracy: Accuracy::EXACT,
        }
    }

    fn degree(&self) -> usize {
        (0..4).rev().find(|b| !self.gaussians.sh[*b].is_empty()).unwrap_or(0)
    }

    /// Renders the reference image, with semantic features after the other channels.
    ///
    /// The rounding error of stored numbers is measured at the parameters of the case and added as a constant.
    /// Gradients therefore ignore the rounding.
    pub fn reference(&self, g: &Gaussians, camera: &Camera) -> RenderedImage {
        let exact = Accuracy { color_bits: 32, ..self.accuracy };
        let seen = |g: &Gaussians, camera: &Camera, a: &Accuracy| project_at(g, camera, self.degree(), self.depth, a);
        let mut splats = seen(g, camera, &exact);
        if self.accuracy != exact {
            let mut rounding = vec![vec![]; g.len()];
            let here = |a: &Accuracy| seen(&self.gaussians, &self.camera, a);
            for (stored, plain) in here(&self.accuracy).iter().zip(&here(&exact)) {
                rounding[stored.id] = stored.features.iter().zip(&plain.features).map(|(a, b)| a - b).collect();
            }
            splats.iter_mut().for_each(|s| s.features.iter_mut().zip(&rounding[s.id]).for_each(|(f, r)| *f += r));
        }
        let wide = if g.semantics.is_empty() { 0 } else { SEMANTIC_FEATURES as usize };
        let channels = self.image.len() / self.transmittance.len() + wide;
        blend_at(&splats, camera.size, channels, BACKGROUND, &self.accuracy)
    }

    /// Returns the loss of the reference render.
    pub fn loss(&self, g: &Gaussians, camera: &Camera) -> f64 {
        let r = self.reference(g, camera);
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
        let weights: Vec<f64> = if self.features.is_empty() {
            self.image.clone()
        } else {
            // The reference image has the features of a pixel after its other channels.
            let base = self.image.len() / self.transmittance.len();
            let pixels = self.image.chunks_exact(base).zip(self.features.chunks_exact(SEMANTIC_FEATURES as usize));
            pixels.flat_map(|(a, b)| a.iter().chain(b).copied()).collect()
        };
        dot(&r.image, &weights) + dot(&r.transmittance, &self.transmittance)
    }

    /// Tests blended features against the reference; other pixels must stay unwritten.
    fn check_features(&self, found: &[f32]) {
        let r = self.reference(&self.gaussians, &self.camera);
        let (f, all) = (SEMANTIC_FEATURES as usize, r.image.len() / r.transmittance.len());
        for (p, pixel) in found.chunks_exact(f).enumerate() {
            if !wants(p) {
                assert!(pixel.iter().all(|x| x.to_bits() == u32::MAX), "pixel {p} is not wanted, but was written");
            } else if !r.doubtful[p] {
                let expected = &r.image[(p + 1) * all - f..(p + 1) * all];
                let worst = pixel.iter().zip(expected).map(|(x, y)| (f64::from(*x) - y).abs()).fold(0.0, f64::max);
                assert!(worst < 1e-4, "pixel {p}: features are off by {worst}");
            }
        }
    }

    /// Tests the gradient by turn and shift against that by the pose's numbers. Returns that by the lens.
    ///
    /// Parts of workgroups without visible splats must stay unwritten.
    fn check_camera(&self, pose: &[f32], parts: &[f32]) -> [f32; 4] {
        let written: Vec<&[f32]> =
            parts.chunks_exact(10).take_while(|part| part.iter().any(|x| x.to_bits() != u32::MAX)).collect();
        assert!(!written.is_empty() && parts[10 * written.len()..].iter().all(|x| x.to_bits() == u32::MAX));
        let lens = [6, 7, 8, 9].map(|i| written.iter().map(|part| part[i]).sum());
        if !pose.iter().all(|x| x.is_finite()) {
            return lens;
        }
        let found = |i: usize| written.iter().map(|part| f64::from(part[i])).sum::<f64>();
        let number = |i: usize| f64::from(pose[i]);
        let vector = |i: usize| DVec3::new(number(i), number(i + 1), number(i + 2));
        let (turn, by_translation) = (self.camera.rotation.transpose(), vector(9));
        let center = -(turn * self.camera.translation);
        // The camera turns with its axes, the rows; t = -row . center.
        let rows = (0..3).map(|i| (turn.col(i), vector(3 * i), by_translation[i]));
        let expected: DVec3 = rows.clone().map(|(row, by_row, by_t)| row.cross(by_row - by_t * center)).sum();
        let size: f64 = rows.map(|(_, by_row, by_t)| by_row.length() + (by_t * center).length()).sum();
        let shift = -(turn * by_translation);
        for (i, expected) in expected.to_array().into_iter().chain(shift.to_array()).enumerate() {
            let slack = 1e-4 * if i < 3 { size } else { by_translation.length() } + 1e-6;
            let found = found(i);
            assert!((found - expected).abs() <= slack, "camera[{i}] is {found} and not {expected}, to {slack}");
        }
        lens
    }

    /// Computes gradients on the GPU: every group, then the [`CAMERA_NUMBERS`].
    ///
    /// # Panics
    /// If the entries overflow, if features are wrong, or if pixels that are not requested are written.
    pub fn gpu_gradients(&self, gpu: &Gpu, which: BackwardKernel) -> (Vec<Vec<f32>>, Vec<f32>) {
        let n = self.gaussians.len() as u32;
        let model = Model {
            sh_degree: self.degree() as u32,
            normals: !self.gaussians.normals.is_empty(),
            semantics: !self.gaussians.semantics.is_empty(),
            mip: self.gaussians.mip,
        };
        let channels = Channels { colors: true, normals: model.normals, depth: self.depth };
        let t = Tuning { distorted: self.camera.radial != 0.0, ..gpu.tuning().with(self.accuracy) };
        let data = scenes::data(&self.gaussians);
        // Declared by hand, since the harness owns the memory of a single run.
        let gaussians = GpuGaussians::new(gpu.device(), model, n, false).unwrap();
        let mut g = Graph::new("gradients");
        let step = g.uniform("step", size_of::<Step>() as u64);
        let screen = Screen { step, largest: self.camera.size, tile: t.tile };
        let handles = gaussians.declare(&mut g, false);
        let flags = g.external("flags", 4);
        let visible = project(&mut g, &t, &screen, &handles, channels).unwrap();
        let entries = intersect(&mut g, &t, &screen, &visible, 1 << 14, flags).unwrap();
        let c = u64::from(channels.count());
        let blended = Blended {
            image: g.external("image", 4 * c * screen.pixels()),
            transmittance: g.external("transmittance", 4 * screen.pixels()),
        };
        let buckets = blend_for(&mut g, &t, &screen, &visible, &entries, &blended, which).unwrap();
        let gradient = Blended {
            image: g.input("grad_image", 4 * c * screen.pixels()),
            transmittance: g.input("grad_transmittance", 4 * screen.pixels()),
        };
        let mut owed = blend_debt(&mut g, &t, &screen, channels.count(), &blended, &gradient).unwrap();
        owed.buckets = buckets;
        let mut sums = blend_bwd(&mut g, &t, &screen, &visible, &entries, &owed, which, true).unwrap();
        let pixels = screen.pixels();
        let wide = model.semantics.then(|| {
            let requested = g.input("wanted", 4 * wanted_words(pixels));
            let image = g.external("features", 4 * u64::from(SEMANTIC_FEATURES) * pixels);
            let gradient = g.input("grad_features", 4 * u64::from(SEMANTIC_FEATURES) * pixels);
            let all = Wanted { pixels: requested, dense: true };
            blend_features(&mut g, &t, &screen, &handles, &visible, &entries, all, image).unwrap();
            let left = blend_features_bwd(&mut g, &t, &screen, &handles, &visible, &entries, all, image, gradient);
            (requested, gradient, left.unwrap(), image)
        });
        if self.features_move {
            sums.features = wide.map(|(_, _, left, _)| left);
        }
        let into_parameters = g.external("grad_parameters", model.column_bytes(n));
        let features = u64::from(SEMANTIC_FEATURES * if model.semantics { n } else { 1 });
        let into_features = g.external("grad_semantics", 4 * features);
        let pose = g.external("pose", 48);
        let means2d = g.external("means2d", 8 * u64::from(n));
        let into = Gradients { parameters: into_parameters, means2d, pose: Some(pose) };
        project_bwd(&mut g, &t, &screen, &handles, &visible, &sums, &into).unwrap();
        let moved = g.external("camera_parts", camera_part_bytes(&t, &visible, true));
        camera_bwd(&mut g, &t, &screen, &handles, &visible, &sums, CameraParts { parts: moved, lens: true }).unwrap();
        if let Some((_, _, left, _)) = &wide {
            features_bwd(&mut g, &t, &visible, left, into_features).unwrap();
        }

        let mut camera = scenes::gpu_camera(&self.camera);
        camera.tiles = [camera.size[0].div_ceil(t.tile[0]), camera.size[1].div_ceil(t.tile[1])];
        let uniform = Step {
            camera,
            background: BACKGROUND.map(|b| b as f32),
            step: 1,
            sh_degree: self.degree() as u32,
            ..Default::default()
        };
        let single = |v: &[f64]| bytemuck::cast_slice(&v.iter().map(|x| *x as f32).collect::<Vec<_>>()).to_vec();
        let mut inputs = vec![
            (step, bytemuck::bytes_of(&uniform).to_vec()),
            (flags, vec![0; 4]),
            (gradient.image, single(&self.image)),
            (gradient.transmittance, single(&self.transmittance)),
        ];
        if let Some((requested, gradient, ..)) = wide {
            let mut words = vec![0_u32; wanted_words(pixels) as usize];
            (0..pixels as usize).filter(|&p| wants(p)).for_each(|p| words[p / 32] |= 1 << (p % 32));
            inputs.push((requested, bytemuck::cast_slice(&words).to_vec()));
            // Weights of pixels that are not requested are NaN; no kernel may read them.
            let weights = self.features.iter().enumerate();
            let weights =
                weights.map(|(i, x)| if wants(i / SEMANTIC_FEATURES as usize) { *x as f32 } else { f32::NAN });
            inputs.push((gradient, bytemuck::cast_slice(&weights.collect::<Vec<_>>()).to_vec()));
        }
        inputs.extend(handles.contents(&data));
        // The kernels write gradients only for visible Gaussians, so the buffers start at zero.
        inputs.push((into_parameters, vec![0; model.column_bytes(n) as usize]));
        inputs.push((into_features, vec![0; 4 * features as usize]));
        let out = gpu.run(g, &inputs);
        assert_eq!(out.get::<u32>(flags), [0], "the entries overflowed");
        if let Some((.., image)) = wide {
            self.check_features(&out.get::<f32>(image));
        }
        let pose = out.get::<f32>(pose);
        let lens = self.check_camera(&pose, &out.get::<f32>(moved));
        let mut all = model.from_columns(&out.get::<f32>(into_parameters), n as usize);
        if model.semantics {
            all.groups[Group::Semantics as usize] = out.get(into_features);
        }
        (all.groups.to_vec(), [pose, lens.to_vec()].concat())
    }
}

/// Returns the parameters of a group.
pub fn parameters(g: &mut Gaussians, group: Group) -> &mut Vec<f64> {
    match group {
        Group::Means => &mut g.means,
        Group::LogScales => &mut g.log_scales,
        Group::Rotations => &mut g.rotations,
        Group::OpacityLogits => &mut g.opacity_logits,
        Group::Sh0 => &mut g.sh[0],
        Group::Sh1 => &mut g.sh[1],
        Group::Sh2 => &mut g.sh[2],
        Group::Sh3 => &mut g.sh[3],
        Group::Normals => &mut g.normals,
        Group::Semantics => &mut g.semantics,
    }
}
