//! Runs: Gaussians, images, relighting and evaluation.

use crate::arrays::{array, shared};
use crate::camera::{CameraTuple, camera};
use crate::device::Device;
use crate::error::{computed, raised};
use crate::relit::Relit;
use crate::render::Images;
use numpy::PyArrayMethods;
use numpy::ndarray::{ArrayView1, ArrayView2, ArrayView3};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use sgs_api::cameras::splats_of;
use sgs_api::scenes::open_scene_of_run;
use sgs_api::{MeasureOptions, Relighting, Shadows, Split, measure, usage};
use sgs_config::Settings;
use sgs_evaluate::metrics::{Lpips, LpipsRange};
use sgs_relight::Edit;
use sgs_run::RunDirectory;
use sgs_scene::Splats;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

/// Trained run, or Gaussians of a PLY or glTF file.
#[pyclass(frozen, module = "sgs._sgs")]
pub struct Run {
    path: PathBuf,
    splats: Arc<Splats>,
    settings: Option<Settings>,
    /// Renderer of the last request.
    images: Mutex<Option<Images>>,
}

impl Run {
    /// Returns the settings, with another scene directory if one is given.
    fn settings_at(&self, scene: Option<PathBuf>) -> anyhow::Result<Settings> {
        let Some(mut settings) = self.settings.clone() else {
            return Err(usage(format!("\"{}\" is not a run directory.", self.path.display())));
        };
        if let Some(scene) = scene {
            settings.scene = scene;
        }
        Ok(settings)
    }
}

#[pymethods]
impl Run {
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Run> {
        computed(py, || {
            let (splats, settings) = splats_of(&path)?;
            splats.check()?;
            Ok(Run { path, splats: Arc::new(splats), settings, images: Mutex::new(None) })
        })
    }

    /// Returns the settings as JSON; `None` for a file.
    fn settings(&self) -> PyResult<Option<String>> {
        let text = |s: &Settings| Ok(serde_json::to_string(&s.to_table()?)?);
        self.settings.as_ref().map(text).transpose().map_err(|e: anyhow::Error| raised(&e))
    }

    /// Returns the scene directory of the run; `None` for a file.
    fn scene(&self) -> Option<PathBuf> {
        self.settings.as_ref().map(|s| s.scene.clone())
    }

    /// Returns the number of Gaussians.
    fn count(&self) -> usize {
        self.splats.len()
    }

    /// Returns the Gaussians as read-only arrays over the memory of this object.
    fn gaussians<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>> {
        let (py, s) = (this.py(), &this.get().splats);
        let all = PyDict::new(py);
        let owner = || this.clone().into_any();
        let wrong = |e: numpy::ndarray::ShapeError| raised(&e.into());
        let one = |name: &str, values: &[f32]| {
            // SAFETY: this object keeps the Gaussians, which nothing changes.
            all.set_item(name, unsafe { shared(&ArrayView1::from(values), owner()) })
        };
        let rows = |name: &str, values: &[f32], width: usize| {
            let view = ArrayView2::from_shape((values.len() / width, width), values).map_err(wrong)?;
            // SAFETY: as above.
            all.set_item(name, unsafe { shared(&view, owner()) })
        };
        rows("means", s.means.as_flattened(), 3)?;
        rows("log_scales", s.log_scales.as_flattened(), 3)?;
        rows("rotations", s.rotations.as_flattened(), 4)?;
        one("opacity_logits", &s.opacity_logits)?;
        for (band, values) in s.sh.iter().enumerate().filter(|(_, values)| !values.is_empty()) {
            let terms = 2 * band + 1;
            let view = ArrayView3::from_shape((values.len() / (3 * terms), terms, 3), values).map_err(wrong)?;
            // SAFETY: as above.
            all.set_item(format!("sh{band}"), unsafe { shared(&view, owner()) })?;
        }
        for (name, values) in [("normals", &s.normals), ("albedo", &s.albedo)] {
            values.as_ref().map(|v| rows(name, v.as_flattened(), 3)).transpose()?;
        }
        for (name, values) in [("roughness", &s.roughness), ("metallic", &s.metallic), ("light_gains", &s.light_gains)]
        {
            values.as_ref().map(|v| one(name, v)).transpose()?;
        }
        if let Some((width, values)) = &s.semantic {
            rows("semantic", values, *width)?;
        }
        if let Some(emitters) = &s.emitters {
            // SAFETY: as above.
            all.set_item("emitters", unsafe { shared(&ArrayView1::from(emitters.as_slice()), owner()) })?;
        }
        Ok(all)
    }

    /// Renders blended channels of one view.
    fn render<'py>(
        &self,
        py: Python<'py>,
        device: &Bound<'py, Device>,
        view: CameraTuple,
        channels: Vec<String>,
        background: [f32; 3],
    ) -> PyResult<Bound<'py, PyDict>> {
        let device = device.get().0.clone();
        let (rendered, labels) = computed(py, || {
            let view = camera(view, Some(&self.splats))?;
            let mut images = self.images.lock().unwrap_or_else(|e| e.into_inner());
            let made = Images::of(images.take(), &device, &self.path, &self.splats, &channels)?;
            images.insert(made).render(&view, &channels, background)
        })?;
        let all = PyDict::new(py);
        for (name, image) in rendered {
            all.set_item(name, array(py, image)?)?;
        }
        if let Some((size, labels)) = labels {
            let shape = [size[1] as usize, size[0] as usize, 1];
            let labels = numpy::IntoPyArray::into_pyarray(labels, py).reshape(shape)?;
            all.set_item("semantic", labels)?;
        }
        Ok(all)
    }

    /// Returns the names of the semantic classes.
    fn classes(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        computed(py, || Ok(sgs_api::head_of(&self.path, &self.splats)?.text.labels))
    }

    /// Applies an edit: JSON of `sgs relight`, and the directory that its paths start at.
    fn relight(
        &self,
        py: Python<'_>,
        device: &Bound<'_, Device>,
        edit: (String, PathBuf),
        shadows: Option<String>,
        scene: Option<PathBuf>,
        visibility: bool,
    ) -> PyResult<Relit> {
        let device = device.get().0.clone();
        computed(py, || {
            let (edit, beside) = edit;
            let edit = Edit::parse(&edit, &beside).map_err(|e| usage(format!("The edit is wrong: {e}.")))?;
            let shadows = match shadows.as_deref() {
                None => None,
                Some("learned") => Some(Shadows::Learned),
                Some("traced") => Some(Shadows::Traced),
                Some("none") => Some(Shadows::None),
                Some(other) => {
                    let allowed = "\"learned\", \"traced\" or \"none\"";
                    return Err(usage(format!("shadows is \"{other}\", but must be {allowed}.")));
                }
            };
            let settings = self.settings.as_ref();
            let relighting = Relighting::new(&self.path, &self.splats, settings, &edit, shadows)?;
            let scene = match relighting.needs_scene() {
                true => Some(open_scene_of_run(&self.path, &self.settings_at(scene)?)?),
                false => None,
            };
            let relit = relighting.apply(&device, (*self.splats).clone(), scene.as_ref())?;
            Ok(Relit::new(&self.path, relit, visibility))
        })
    }

    /// Evaluates the run at its test or training views. Returns the measures as JSON.
    fn evaluate(
        &self,
        py: Python<'_>,
        device: &Bound<'_, Device>,
        split: String,
        scene: Option<PathBuf>,
        lpips: Option<PathBuf>,
        align: bool,
    ) -> PyResult<String> {
        let device = device.get().0.clone();
        computed(py, || {
            let split = match split.as_str() {
                "test" => Split::Test,
                "train" => Split::Train,
                other => return Err(usage(format!("split is \"{other}\", but must be \"test\" or \"train\"."))),
            };
            let settings = self.settings_at(scene)?;
            let run = RunDirectory::open(&self.path)?;
            let load = |file: &Path| Lpips::load(file, LpipsRange::Plain);
            let lpips = lpips.as_deref().map(load).transpose()?;
            let scene = open_scene_of_run(&self.path, &settings)?;
            let options = MeasureOptions { split, lpips: lpips.as_ref(), images: None, align };
            let result = measure(&device, &scene, &run, &self.splats, &settings, options)?;
            Ok(serde_json::to_string(&result)?)
        })
    }
}
