//! Shading of pixels by point lights, with gradients of surfaces and lights.

use super::{Replay, vectors};
use crate::device::Device;
use crate::error::computed;
use numpy::{IntoPyArray, PyArray1, PyReadonlyArrayDyn};
use pyo3::prelude::*;
use sgs_api::usage;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_passes::Tuning;
use sgs_passes::pipeline::Step;
use sgs_passes::shade::lights::{
    Axes, LightModel, LightParameterGradients, LightParameters, Lights, Shape, lights_bwd, lights_materials_bwd,
    lights_normals_bwd, lights_prepare, lights_prepare_bwd, lights_train,
};
use sgs_passes::shade::{PixelMaterials, Pixels, Surfaces};
use sgs_passes::splat::Screen;
use std::sync::Mutex;

/// Arrays of the functions, in their order. Metallic may be empty.
const NAMES: [&str; 7] = ["points", "normals", "materials", "metallic", "positions", "lobes", "gains"];

/// Positions in [`NAMES`] of the arrays that have gradients.
const WITH_GRADIENTS: [usize; 5] = [1, 2, 3, 4, 5];

/// Floats of a lobe: axis, log sharpness, log amplitudes.
const LOBE: usize = 7;

/// Pixels, lights, whether metallic exists, and whether gradients are computed.
type Key = (u32, LightModel, bool, bool);

/// Inputs of both directions.
struct Inputs {
    arrays: Vec<Vec<f32>>,
    camera: [f32; 3],
    normalizer: f32,
    key: Key,
}

impl Inputs {
    fn new(arrays: Vec<Vec<f32>>, camera: [f32; 3], normalizer: f32, backward: bool) -> anyhow::Result<Inputs> {
        let [points, _, _, metallic, _, lobes, gains] = &arrays[..] else {
            return Err(usage(format!("{} arrays were given, but shading takes 7.", arrays.len())));
        };
        let (pixels, lights) = (points.len() / 3, gains.len());
        let each = lobes.len() / (LOBE * lights.max(1));
        if pixels == 0 || lights == 0 || !(1..=32).contains(&each) {
            return Err(usage(format!(
                "There are {pixels} pixels and {lights} lights of {each} lobes; shading needs pixels, lights, and 1 to 32 \
                 lobes."
            )));
        }
        let with_metal = !metallic.is_empty();
        let metal = if with_metal { pixels } else { 0 };
        let sizes = [3 * pixels, 3 * pixels, 4 * pixels, metal, 3 * lights, LOBE * lights * each, lights];
        for ((name, array), expected) in NAMES.into_iter().zip(&arrays).zip(sizes) {
            let found = array.len();
            if found != expected {
                return Err(usage(format!("{name} has {found} numbers, but must have {expected}.")));
            }
        }
        let model = LightModel { lights: lights as u32, lobes: each as u32, axes: Axes::Free };
        let key = (pixels as u32, model, with_metal, backward);
        Ok(Inputs { arrays, camera, normalizer, key })
    }
}

/// Buffers of shading.
struct ShadeHandles {
    step: Buffer,
    inputs: [Option<Buffer>; 7],
    coverage: Buffer,
    radiance: Buffer,
    gradient: Buffer,
    /// Gradients of [`WITH_GRADIENTS`]; empty without a backward pass.
    pulled: Vec<Buffer>,
}

fn declare(g: &mut Graph, tuning: Tuning, key: Key, normalizer: f32) -> Result<ShadeHandles, GraphError> {
    let (pixels, model, metallic, backward) = key;
    let p = u64::from(pixels);
    let step = g.uniform("step", size_of::<Step>() as u64);
    let (points, normals) = (g.input("points", 12 * p), g.input("normals", 12 * p));
    let (coverage, materials) = (g.input("coverage", 4 * p), g.input("materials", 16 * p));
    let metal = metallic.then(|| g.input("metallic", 4 * p));
    let parameters = LightParameters {
        positions: g.input("positions", model.position_bytes()),
        lobes: g.input("lobes", model.lobe_bytes()),
        gains: g.input("gains", model.gain_bytes()),
    };
    let gradient = g.input("radiance_gradient", 12 * p);
    let radiance = g.external("radiance", 12 * p);
    let prepared = lights_prepare(g, tuning, "lights_prepare", step, model, &parameters, None)?;
    let what = Lights {
        pixels: Pixels {
            screen: Screen { step, largest: [pixels, 1], tile: [8, 8] },
            surfaces: Surfaces { points, normals, coverage },
            materials: PixelMaterials { materials, metallic: metal },
        },
        prepared,
        normalizer,
        shape: Shape::for_device(tuning),
    };
    let sums = lights_train(g, &what, radiance)?;
    let mut pulled = Vec::new();
    if backward {
        let of_normals = g.external("normals_gradient", 12 * p);
        let of_materials = g.external("materials_gradient", 16 * p);
        let of_metallic = g.external("metallic_gradient", 4 * p);
        let positions = g.external("positions_gradient", model.position_bytes());
        let lobes = g.external("lobes_gradient", model.lobe_bytes());
        // The pass adds to these two.
        g.fill("clear_materials", of_materials, 0)?;
        g.fill("clear_metallic", of_metallic, 0)?;
        let requested = metallic.then_some(of_metallic);
        lights_materials_bwd(g, tuning, &what.pixels, &sums, gradient, of_materials, requested)?;
        let sums = lights_bwd(g, tuning, &what, gradient)?;
        let into = LightParameterGradients { positions, lobes };
        lights_prepare_bwd(g, &prepared, &parameters, &sums, None, &into)?;
        lights_normals_bwd(g, &what, gradient, of_normals)?;
        pulled = vec![of_normals, of_materials, of_metallic, positions, lobes];
    }
    let LightParameters { positions, lobes, gains } = parameters;
    let inputs = [Some(points), Some(normals), Some(materials), metal, Some(positions), Some(lobes), Some(gains)];
    Ok(ShadeHandles { step, inputs, coverage, radiance, gradient, pulled })
}

struct State {
    replay: Replay,
    key: Key,
    normalizer: f32,
    handles: ShadeHandles,
}

impl State {
    fn new(device: &sgs_engine::Device, inputs: &Inputs) -> anyhow::Result<State> {
        let tuning = Tuning::for_device(device.info());
        let mut g = Graph::new("shade_lights");
        let handles = declare(&mut g, tuning, inputs.key, inputs.normalizer).map_err(sgs_engine::Error::from)?;
        let others = [handles.coverage, handles.radiance, handles.gradient];
        let external: Vec<Buffer> =
            handles.inputs.iter().flatten().chain(&handles.pulled).copied().chain(others).collect();
        let replay = Replay::new(device, g, &external)?;
        replay.upload(handles.coverage, &vec![1.0; inputs.key.0 as usize])?;
        Ok(State { replay, key: inputs.key, normalizer: inputs.normalizer, handles })
    }

    fn run(&mut self, inputs: &Inputs, gradient: Option<&[f32]>) -> anyhow::Result<()> {
        for (buffer, values) in self.handles.inputs.iter().zip(&inputs.arrays) {
            buffer.map(|buffer| self.replay.upload(buffer, values)).transpose()?;
        }
        gradient.map(|gradient| self.replay.upload(self.handles.gradient, gradient)).transpose()?;
        let mut step = Step::default();
        step.camera.size = [inputs.key.0, 1];
        step.camera.position = inputs.camera;
        Ok(self.replay.run((self.handles.step, bytemuck::bytes_of(&step)))?)
    }
}

/// Shader of pixels under point lights, with a backward pass.
#[pyclass(frozen, module = "sgs._sgs")]
pub struct LightShader {
    device: sgs_engine::Device,
    state: Mutex<Option<State>>,
}

impl LightShader {
    fn with<T>(&self, inputs: &Inputs, run: impl FnOnce(&mut State) -> anyhow::Result<T>) -> anyhow::Result<T> {
        let mut state = self.state.lock().unwrap_or_else(|e| e.into_inner());
        let fits = |s: &State| s.key == inputs.key && s.normalizer.to_bits() == inputs.normalizer.to_bits();
        let kept = match state.take().filter(fits) {
            Some(kept) => kept,
            None => State::new(&self.device, inputs)?,
        };
        run(state.insert(kept))
    }
}

#[pymethods]
impl LightShader {
    #[new]
    fn new(device: &Bound<'_, Device>) -> LightShader {
        LightShader { device: device.get().0.clone(), state: Mutex::new(None) }
    }

    /// Returns the linear radiance of each pixel towards the camera, 3 floats each.
    fn forward<'py>(
        &self,
        py: Python<'py>,
        arrays: Vec<PyReadonlyArrayDyn<'py, f32>>,
        camera: [f32; 3],
        normalizer: f32,
    ) -> PyResult<Bound<'py, PyArray1<f32>>> {
        let arrays = vectors(&arrays);
        let radiance = computed(py, || {
            let inputs = Inputs::new(arrays, camera, normalizer, false)?;
            self.with(&inputs, |state| {
                state.run(&inputs, None)?;
                Ok(state.replay.download(state.handles.radiance, 3 * inputs.key.0 as usize)?)
            })
        })?;
        Ok(radiance.into_pyarray(py))
    }

    /// Returns the gradients of normals, materials, metallic, positions and lobes.
    fn backward<'py>(
        &self,
        py: Python<'py>,
        arrays: Vec<PyReadonlyArrayDyn<'py, f32>>,
        camera: [f32; 3],
        normalizer: f32,
        gradient: PyReadonlyArrayDyn<'py, f32>,
    ) -> PyResult<Vec<Bound<'py, PyArray1<f32>>>> {
        let (arrays, gradient) = (vectors(&arrays), vectors(&[gradient]).remove(0));
        let pulled = computed(py, || {
            let inputs = Inputs::new(arrays, camera, normalizer, true)?;
            if gradient.len() != 3 * inputs.key.0 as usize {
                return Err(usage("The gradient must have 3 numbers for each pixel."));
            }
            self.with(&inputs, |state| {
                state.run(&inputs, Some(&gradient))?;
                let mut all = Vec::new();
                for (buffer, array) in state.handles.pulled.iter().zip(WITH_GRADIENTS) {
                    all.push(state.replay.download(*buffer, inputs.arrays[array].len())?);
                }
                Ok(all)
            })
        })?;
        Ok(pulled.into_iter().map(|values| values.into_pyarray(py)).collect())
    }
}
