//! Scenes: views, photographs and points.

use crate::arrays::{array, shared};
use crate::camera::{CameraTuple, tuple};
use crate::error::computed;
use crate::settings::{ConfigTuple, overrides};
use numpy::ndarray::ArrayView2;
use numpy::{PyArray2, PyArray3};
use pyo3::prelude::*;
use sgs_api::scenes::open_scene;
use std::path::PathBuf;
use std::sync::Arc;

/// Open scene.
#[pyclass(frozen, module = "sgs._sgs")]
pub struct Scene(pub Arc<sgs_scene::Scene>);

#[pymethods]
impl Scene {
    #[new]
    fn new(py: Python<'_>, path: PathBuf, config: ConfigTuple) -> PyResult<Scene> {
        computed(py, || {
            let settings = sgs_api::settings(&path, &overrides(config)?)?;
            Ok(Scene(Arc::new(open_scene(&settings)?)))
        })
    }

    /// Returns the camera and the photograph's path of each view.
    fn views(&self) -> Vec<(CameraTuple, PathBuf)> {
        self.0.views.iter().map(|view| (tuple(&view.camera), view.image_path.clone())).collect()
    }

    /// Returns the indices of the training views and of the test views.
    fn split(&self) -> (Vec<usize>, Vec<usize>) {
        (self.0.split.train.clone(), self.0.split.test.clone())
    }

    /// Returns the warnings of opening the scene.
    fn warnings(&self) -> Vec<String> {
        self.0.warnings.clone()
    }

    /// Returns the factor on linear photographs.
    fn exposure(&self) -> f32 {
        self.0.exposure()
    }

    /// Loads the photograph of a view.
    fn photograph<'py>(&self, py: Python<'py>, view: usize) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let image = computed(py, || {
            self.0.view(view)?;
            Ok(self.0.load_image(view)?)
        })?;
        array(py, image)
    }

    /// Returns the initial points.
    fn points(this: Bound<'_, Self>) -> PyResult<Bound<'_, PyArray2<f32>>> {
        let scene = this.get().0.clone();
        let points = scene.points.positions.as_flattened();
        let view =
            ArrayView2::from_shape((points.len() / 3, 3), points).map_err(|e| crate::error::raised(&e.into()))?;
        // SAFETY: the object keeps the scene, which nothing changes.
        Ok(unsafe { shared(&view, this.into_any()) })
    }
}

/// Reads the cameras of a transforms file.
#[pyfunction]
pub fn read_cameras(py: Python<'_>, path: PathBuf) -> PyResult<Vec<CameraTuple>> {
    let cameras = computed(py, || Ok(sgs_scene::Camera::read_transforms(&path)?))?;
    // A file has no near plane; that of the run applies.
    let without_near = |camera| {
        let (name, size, lens, rotation, translation, _) = tuple(camera);
        (name, size, lens, rotation, translation, None)
    };
    Ok(cameras.iter().map(without_near).collect())
}
