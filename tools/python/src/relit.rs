//! Shading of a run under its own or edited light.

use crate::arrays::array;
use crate::camera::{CameraTuple, camera};
use crate::error::computed;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use sgs_api::{Part, RelitScene, usage};
use sgs_run::Shading;
use sgs_scene::{Image, Splats};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// Run under light, ready for views.
#[pyclass(frozen, module = "sgs._sgs")]
pub struct Relit {
    path: PathBuf,
    splats: Splats,
    lights: usize,
    shading: Mutex<Shading>,
}

impl Relit {
    /// Keeps an edited run. `visibility`: whether the mean visibility of the lights is computed.
    pub fn new(path: &Path, scene: RelitScene, visibility: bool) -> Relit {
        let RelitScene { relit, emitting, shading } = scene;
        let lights = match &emitting {
            Some(emitting) => emitting.file.emitters.iter().filter(|e| e.on).count(),
            None => relit.light.lights.as_ref().map_or(0, |l| l.lights.iter().filter(|l| l.gain > 0.0).count()),
        };
        let shading = if visibility { shading } else { shading.without_visibility() };
        Relit { path: path.to_owned(), splats: relit.splats, lights, shading: Mutex::new(shading) }
    }
}

/// Returns the channel of a name.
fn part(name: &str) -> anyhow::Result<Part> {
    Ok(match name {
        "albedo" => Part::Albedo,
        "roughness" => Part::Roughness,
        "metallic" => Part::Metallic,
        "relit" | "pbr" => Part::Pbr,
        "diffuse" => Part::Diffuse,
        "specular" => Part::Specular,
        "visibility" => Part::Visibility,
        "env" => Part::Env,
        "direct" => Part::Direct,
        other => return Err(usage(format!("\"{other}\" is not a channel."))),
    })
}

#[pymethods]
impl Relit {
    /// Returns the number of lights that are on.
    fn lights(&self) -> usize {
        self.lights
    }

    /// Returns the number of Gaussians, inserted ones included.
    fn count(&self) -> usize {
        self.splats.len()
    }

    /// Shades one view.
    fn render<'py>(
        &self,
        py: Python<'py>,
        view: CameraTuple,
        channels: Vec<String>,
        background: [f32; 3],
    ) -> PyResult<Bound<'py, PyDict>> {
        let images: Vec<Image> = computed(py, || {
            let view = camera(view, Some(&self.splats))?;
            let parts = channels.iter().map(|name| part(name)).collect::<anyhow::Result<Vec<Part>>>()?;
            let source = self.path.display();
            if parts.contains(&Part::Metallic) && self.splats.metallic.is_none() {
                return Err(usage(format!("\"{source}\" has no metallic; leave \"metallic\" out of the channels.")));
            }
            let mut shading = self.shading.lock().unwrap_or_else(|e| e.into_inner());
            let shaded = shading.shade(&view)?;
            if parts.contains(&Part::Visibility) && shaded.visibility().is_none() {
                let text =
                    format!("\"{source}\" has no visibility of lights; leave \"visibility\" out of the channels.");
                return Err(usage(text));
            }
            Ok(parts.iter().map(|part| part.of(&shaded, background)).collect())
        })?;
        let all = PyDict::new(py);
        for (name, image) in channels.iter().zip(images) {
            all.set_item(name, array(py, image)?)?;
        }
        Ok(all)
    }
}
