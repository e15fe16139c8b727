//! Views for tests of features: cameras, weights, reference loss and graph passes.

use crate::Gpu;
use crate::scenes::{self, Rng};
use glam::DMat3;
use sgs_engine::graph::{Buffer, Graph};
use sgs_passes::Accuracy;
use sgs_passes::pipeline::Step;
use sgs_passes::reference::blend::render;
use sgs_passes::reference::project::{Camera, Gaussians};
use sgs_passes::scene::{Handles, SEMANTIC_FEATURES};
use sgs_passes::splat::{
    Channels, Entries, EntryFeatures, Screen, Visible, Wanted, blend_features, blend_features_bwd, intersect, project,
    wanted_words,
};

const WIDE: usize = SEMANTIC_FEATURES as usize;

/// Returns true if the features of a pixel are requested.
///
/// The pixels are scattered, so that tiles have a few, all or none of them.
pub fn wants(pixel: usize) -> bool {
    pixel % 5 < 3 || (60..150).contains(&pixel)
}

fn bytes<T: bytemuck::NoUninit>(data: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(data).to_vec()
}

/// View whose loss is the dot product of its features and the weights.
pub struct View {
    /// Camera of the view.
    pub camera: Camera,
    /// `[pixels * features]` weights; zero at pixels that are not requested.
    pub weights: Vec<f64>,
    /// Value of [`Wanted::dense`]; affects only the run time.
    pub dense: bool,
}

impl View {
    /// Creates a view whose camera turns to the right by `angle` radians.
    pub fn new(size: [u32; 2], angle: f64, seed: u64) -> View {
        let mut camera = scenes::camera(size);
        let turned = DMat3::from_rotation_y(-angle);
        camera.rotation = turned * camera.rotation;
        camera.translation = turned * camera.translation;
        let mut r = Rng::new(seed);
        let pixels = (size[0] * size[1]) as usize;
        let weight = |i: usize| if wants(i / WIDE) { f64::from(r.between(-1.0, 1.0) as f32) } else { 0.0 };
        View { camera, weights: (0..pixels * WIDE).map(weight).collect(), dense: seed.is_multiple_of(2) }
    }

    /// Returns the loss of the reference, for Gaussians without normals.
    pub fn loss(&self, g: &Gaussians) -> f64 {
        let all = render(g, &self.camera, 0, false, [0.0; 3]).image;
        let features = all.chunks_exact(3 + WIDE).flat_map(|pixel| &pixel[3..]);
        features.zip(&self.weights).map(|(a, b)| a * b).sum()
    }
}

/// Buffers of one view in a graph.
pub struct Declared {
    /// Screen of the view.
    pub screen: Screen,
    /// Visible splats.
    pub visible: Visible,
    /// Tile entries.
    pub entries: Entries,
    /// Image of the features.
    pub image: Buffer,
    /// Gradients that came through features, by entry.
    pub features: EntryFeatures,
    /// Contents of its uniforms and buffers.
    pub inputs: Vec<(Buffer, Vec<u8>)>,
}

/// Declares a view up to the gradients of its entries.
///
/// Weights of pixels that are not requested are NaN; no kernel may read them.
pub fn declare(gpu: &Gpu, g: &mut Graph, view: &View, handles: &Handles, flags: Buffer, values: Step) -> Declared {
    let t = gpu.tuning().with(Accuracy::EXACT);
    let step = g.uniform("step", size_of::<Step>() as u64);
    let screen = Screen { step, largest: view.camera.size, tile: t.tile };
    let visible = project(g, &t, &screen, handles, Channels::default()).unwrap();
    let entries = intersect(g, &t, &screen, &visible, 1 << 13, flags).unwrap();
    let pixels = screen.pixels();
    let requested = g.input("wanted", 4 * wanted_words(pixels));
    let image = g.external("features", 4 * u64::from(SEMANTIC_FEATURES) * pixels);
    let gradient = g.input("grad_features", 4 * u64::from(SEMANTIC_FEATURES) * pixels);
    let shown = Wanted { pixels: requested, dense: view.dense };
    blend_features(g, &t, &screen, handles, &visible, &entries, shown, image).unwrap();
    let features = blend_features_bwd(g, &t, &screen, handles, &visible, &entries, shown, image, gradient).unwrap();
    let mut camera = scenes::gpu_camera(&view.camera);
    camera.tiles = [camera.size[0].div_ceil(t.tile[0]), camera.size[1].div_ceil(t.tile[1])];
    let mut words = vec![0_u32; wanted_words(pixels) as usize];
    (0..pixels as usize).filter(|&p| wants(p)).for_each(|p| words[p / 32] |= 1 << (p % 32));
    let weights = view.weights.iter().enumerate();
    let weights: Vec<f32> = weights.map(|(i, x)| if wants(i / WIDE) { *x as f32 } else { f32::NAN }).collect();
    let inputs =
        vec![(step, bytes(&[Step { camera, ..values }])), (requested, bytes(&words)), (gradient, bytes(&weights))];
    Declared { screen, visible, entries, image, features, inputs }
}

/// Returns the contents of the buffers of Gaussians.
pub fn gaussian_inputs(g: &Gaussians, handles: &Handles) -> Vec<(Buffer, Vec<u8>)> {
    handles.contents(&scenes::data(g))
}
