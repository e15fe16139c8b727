//! Rendering of Gaussians with gradients of every parameter and of the pose.

use super::{Replay, vectors};
use crate::device::Device;
use crate::error::computed;
use numpy::{IntoPyArray, PyArray1, PyReadonlyArrayDyn};
use pyo3::prelude::*;
use sgs_api::usage;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_passes::pipeline::{Camera, RenderedImage, Renderer, Step};
use sgs_passes::scene::{GaussianData, Gaussians, Group, Handles, Model};
use sgs_passes::splat::{
    BackwardKernel, Blended, Channels, Gradients, Screen, blend, blend_bwd, blend_debt, intersect, project, project_bwd,
};
use sgs_passes::{Accuracy, Tuning};
use std::sync::Mutex;

/// Columns and rows; focal lengths and principal point in pixels; world-to-camera by rows, 3 x 4; near plane.
type View = ([u32; 2], [f32; 4], [f32; 12], f32);

/// Gradients of the groups, and of the pose: nine numbers of the rotation by rows, three of the translation.
type Pulled = (Vec<Vec<f32>>, Vec<f32>);

/// Array of one dimension.
type Flat<'py> = Bound<'py, PyArray1<f32>>;

/// Groups that the functions take, in their order. Absent groups are empty.
const GROUPS: [Group; 9] = [
    Group::Means,
    Group::LogScales,
    Group::Rotations,
    Group::OpacityLogits,
    Group::Sh0,
    Group::Sh1,
    Group::Sh2,
    Group::Sh3,
    Group::Normals,
];

/// Inputs of both directions.
struct Inputs {
    data: GaussianData,
    model: Model,
    channels: Channels,
    camera: Camera,
    background: [f32; 3],
}

impl Inputs {
    fn new(parameters: Vec<Vec<f32>>, view: View, background: [f32; 3], depth: bool) -> anyhow::Result<Inputs> {
        let mut data = GaussianData::default();
        for (group, values) in GROUPS.into_iter().zip(parameters) {
            data.groups[group as usize] = values;
        }
        let count = data.len();
        let band = |d: usize| data.groups[Group::Sh0 as usize + d].len();
        let model = Model {
            sh_degree: (1..4).rev().find(|d| band(*d) > 0).unwrap_or(0) as u32,
            normals: !data.group(Group::Normals).is_empty(),
            semantics: false,
            mip: false,
        };
        if count == 0 {
            return Err(usage("There are no Gaussians to render."));
        }
        for group in model.groups() {
            let (found, expected) = (data.group(group).len(), count * group.width() as usize);
            if found != expected {
                return Err(usage(format!("{} has {found} numbers, but must have {expected}.", group.name())));
            }
        }
        let (size, [fx, fy, cx, cy], w, near) = view;
        if size.iter().any(|side| !(1..=16384).contains(side)) {
            return Err(usage(format!("The image is {} x {}, but its sides must be 1 to 16384.", size[0], size[1])));
        }
        if ![fx, fy, cx, cy, near].iter().chain(&w).all(|v| v.is_finite()) || fx <= 0.0 || fy <= 0.0 || near <= 0.0 {
            return Err(usage("The camera has a value that is not finite, or a length that is not above 0."));
        }
        // The camera stands at -Rᵀt.
        let position = [0, 1, 2].map(|k| -(0..3).map(|row| w[4 * row + k] * w[4 * row + 3]).sum::<f32>());
        let row = |i: usize| [w[4 * i], w[4 * i + 1], w[4 * i + 2], w[4 * i + 3]];
        let camera = Camera {
            world_to_camera: [row(0), row(1), row(2)],
            position,
            near,
            focal: [fx, fy],
            center: [cx, cy],
            size,
            tiles: [0, 0],
            radial: 0.0,
        };
        let channels = Channels { colors: true, normals: model.normals, depth };
        Ok(Inputs { data, model, channels, camera, background })
    }
}

/// Graph of the backward pass, for one number of Gaussians and one size.
struct Backward {
    replay: Replay,
    key: (Model, Channels, u32, [u32; 2]),
    tile: [u32; 2],
    capacity: u32,
    gaussians: Gaussians,
    handles: BackwardHandles,
}

/// Buffers of the backward pass.
struct BackwardHandles {
    step: Buffer,
    gaussians: Handles,
    flags: Buffer,
    wanted: Buffer,
    gradient: Blended,
    /// Gradients of the parameters, and in screen space.
    gradients: [Buffer; 2],
    pose: Buffer,
}

/// Declares the backward pass. It renders again, so that it keeps nothing from the forward pass.
fn declare(
    g: &mut Graph,
    t: &Tuning,
    gaussians: &Gaussians,
    channels: Channels,
    size: [u32; 2],
    capacity: u32,
) -> Result<BackwardHandles, GraphError> {
    let step = g.uniform("step", size_of::<Step>() as u64);
    let screen = Screen { step, largest: size, tile: t.tile };
    let handles = gaussians.declare(g, false);
    let (flags, wanted) = (g.external("flags", 4), g.external("wanted", 4));
    let c = u64::from(channels.count());
    g.fill("clear_flags", flags, 0)?;
    let visible = project(g, t, &screen, &handles, channels)?;
    let entries = intersect(g, t, &screen, &visible, capacity, flags)?;
    let blended = Blended {
        image: g.transient("image", 4 * c * screen.pixels()),
        transmittance: g.transient("transmittance", 4 * screen.pixels()),
    };
    blend(g, t, &screen, &visible, &entries, &blended)?;
    let gradient = Blended {
        image: g.input("grad_image", 4 * c * screen.pixels()),
        transmittance: g.input("grad_transmittance", 4 * screen.pixels()),
    };
    let owed = blend_debt(g, t, &screen, channels.count(), &blended, &gradient)?;
    let sums = blend_bwd(g, t, &screen, &visible, &entries, &owed, BackwardKernel::Pixel, false)?;
    let parameters = g.external("grad_parameters", gaussians.model.column_bytes(gaussians.capacity));
    // The pass writes gradients of visible Gaussians only.
    g.fill("clear_gradients", parameters, 0)?;
    let pose = g.external("pose", 48);
    let into =
        Gradients { parameters, means2d: g.external("means2d", 8 * u64::from(gaussians.capacity)), pose: Some(pose) };
    project_bwd(g, t, &screen, &handles, &visible, &sums, &into)?;
    g.copy("copy_wanted", entries.wanted, wanted)?;
    // The screen-space gradients are bound like the others, and read by nobody.
    let gradients = [parameters, into.means2d];
    Ok(BackwardHandles { step, gaussians: handles, flags, wanted, gradient, gradients, pose })
}

impl Backward {
    fn new(device: &sgs_engine::Device, inputs: &Inputs, capacity: u32) -> anyhow::Result<Backward> {
        let tuning = exact(device);
        let (count, size, channels) = (inputs.data.len() as u32, inputs.camera.size, inputs.channels);
        let gaussians = Gaussians::new(device, inputs.model, count, false)?;
        let mut g = Graph::new("render_gradients");
        let handles =
            declare(&mut g, &tuning, &gaussians, channels, size, capacity).map_err(sgs_engine::Error::from)?;
        let BackwardHandles { flags, wanted, gradient, gradients, pose, .. } = &handles;
        let mut external = vec![*flags, *wanted, gradient.image, gradient.transmittance, *pose];
        external.extend(gradients);
        let mut replay = Replay::new(device, g, &external)?;
        gaussians.bind(&mut replay.exec, &handles.gaussians)?;
        let key = (inputs.model, channels, count, size);
        Ok(Backward { replay, key, tile: tuning.tile, capacity, gaussians, handles })
    }

    /// Returns the gradients, or the capacity of tile entries that they need.
    fn run(&mut self, inputs: &Inputs, image: &[f32], transmittance: &[f32]) -> anyhow::Result<Result<Pulled, u32>> {
        let device = self.replay.device.clone();
        self.gaussians.upload(&device, &inputs.data)?;
        self.replay.upload(self.handles.gradient.image, image)?;
        self.replay.upload(self.handles.gradient.transmittance, transmittance)?;
        let mut camera = inputs.camera;
        camera.tiles = [0, 1].map(|axis| camera.size[axis].div_ceil(self.tile[axis]));
        let (background, sh_degree) = (inputs.background, inputs.model.sh_degree);
        let step = Step { camera, background, step: 1, sh_degree, ..Default::default() };
        self.replay.run((self.handles.step, bytemuck::bytes_of(&step)))?;
        let word = |buffer: Buffer| device.download_as::<u32>(self.replay.memory(buffer), 1);
        if word(self.handles.flags)?[0] != 0 {
            return Ok(Err(word(self.handles.wanted)?[0]));
        }
        let floats = inputs.model.column_bytes(inputs.data.len() as u32) as usize / 4;
        let columns: Vec<f32> = self.replay.download(self.handles.gradients[0], floats)?;
        let found = inputs.model.from_columns(&columns, inputs.data.len());
        let all = GROUPS.iter().map(|group| found.group(*group).to_vec()).collect();
        Ok(Ok((all, self.replay.download(self.handles.pose, 12)?)))
    }
}

/// Returns the tuning without approximations: gradients are those of the image.
fn exact(device: &sgs_engine::Device) -> Tuning {
    Tuning::for_device(device.info()).with(Accuracy::EXACT)
}

/// Renderer of Gaussians with a backward pass.
#[pyclass(frozen, module = "sgs._sgs")]
pub struct Splatter {
    device: sgs_engine::Device,
    forward: Mutex<Option<(Renderer, Channels, Gaussians)>>,
    backward: Mutex<Option<Backward>>,
}

#[pymethods]
impl Splatter {
    #[new]
    fn new(device: &Bound<'_, Device>) -> Splatter {
        Splatter { device: device.get().0.clone(), forward: Mutex::new(None), backward: Mutex::new(None) }
    }

    /// Renders. Returns the blended channels by pixel, and the transmittances.
    fn forward<'py>(
        &self,
        py: Python<'py>,
        parameters: Vec<PyReadonlyArrayDyn<'py, f32>>,
        view: View,
        background: [f32; 3],
        depth: bool,
    ) -> PyResult<(Flat<'py>, Flat<'py>)> {
        let parameters = vectors(&parameters);
        let RenderedImage { image, transmittance, .. } = computed(py, || {
            let inputs = Inputs::new(parameters, view, background, depth)?;
            let mut state = self.forward.lock().unwrap_or_else(|e| e.into_inner());
            let count = inputs.data.len() as u32;
            let kept = state
                .take()
                .filter(|(_, channels, g)| (*channels, g.model, g.capacity) == (inputs.channels, inputs.model, count));
            let (renderer, _, gaussians) = match kept {
                Some(kept) => state.insert(kept),
                None => {
                    let gaussians = Gaussians::new(&self.device, inputs.model, count, false)?;
                    let tuning = exact(&self.device);
                    let renderer = Renderer::new(&self.device, tuning, &gaussians, [1, 1], inputs.channels)?;
                    state.insert((renderer, inputs.channels, gaussians))
                }
            };
            gaussians.upload(&self.device, &inputs.data)?;
            Ok(renderer.render(gaussians, &inputs.camera, inputs.model.sh_degree, background)?)
        })?;
        Ok((image.into_pyarray(py), transmittance.into_pyarray(py)))
    }

    /// Returns the gradients of all parameters and of the pose.
    ///
    /// `gradients`: those of image and transmittances.
    fn backward<'py>(
        &self,
        py: Python<'py>,
        parameters: Vec<PyReadonlyArrayDyn<'py, f32>>,
        view: View,
        background: [f32; 3],
        depth: bool,
        gradients: Vec<PyReadonlyArrayDyn<'py, f32>>,
    ) -> PyResult<(Vec<Flat<'py>>, Flat<'py>)> {
        let (parameters, gradients) = (vectors(&parameters), vectors(&gradients));
        let (groups, pose) = computed(py, || {
            let inputs = Inputs::new(parameters, view, background, depth)?;
            let [image, transmittance] = &gradients[..] else {
                return Err(usage("The gradients are those of image and transmittances."));
            };
            let pixels = inputs.camera.size[0] as usize * inputs.camera.size[1] as usize;
            if image.len() != pixels * inputs.channels.count() as usize || transmittance.len() != pixels {
                return Err(usage("The gradients must have the shapes of image and transmittances."));
            }
            let mut state = self.backward.lock().unwrap_or_else(|e| e.into_inner());
            let key = (inputs.model, inputs.channels, inputs.data.len() as u32, inputs.camera.size);
            let mut backward = match state.take().filter(|b| b.key == key) {
                Some(kept) => kept,
                None => Backward::new(&self.device, &inputs, 2 * inputs.data.len().max(4096) as u32)?,
            };
            loop {
                match backward.run(&inputs, image, transmittance)? {
                    Ok(pulled) => {
                        *state = Some(backward);
                        return Ok(pulled);
                    }
                    Err(wanted) => {
                        let capacity = wanted.max(backward.capacity).saturating_add(wanted / 8 + 1);
                        backward = Backward::new(&self.device, &inputs, capacity)?;
                    }
                }
            }
        })?;
        Ok((groups.into_iter().map(|values| values.into_pyarray(py)).collect(), pose.into_pyarray(py)))
    }
}
