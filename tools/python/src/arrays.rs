//! Arrays of NumPy.

use crate::error::computed;
use numpy::ndarray::{ArrayView, Dimension};
use numpy::{Element, IntoPyArray, PyArray, PyArray3, PyArrayMethods, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;
use sgs_api::usage;
use sgs_scene::{Image, write_exr, write_png};
use std::path::PathBuf;

/// Moves an image into an array of height, width and channels. Copies nothing.
pub fn array<'py>(py: Python<'py>, image: Image) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let shape = [image.height, image.width, image.channels].map(|side| side as usize);
    image.data.into_pyarray(py).reshape(shape)
}

/// Returns a read-only array over memory that `owner` keeps. Copies nothing.
///
/// # Safety
/// `owner` keeps the memory of `view` alive and unchanged as long as it lives itself.
pub unsafe fn shared<'py, T: Element, D: Dimension>(
    view: &ArrayView<'_, T, D>,
    owner: Bound<'py, PyAny>,
) -> Bound<'py, PyArray<T, D>> {
    // SAFETY: by the caller's contract.
    let array = unsafe { PyArray::borrow_from_array(view, owner) };
    let _ = array.readwrite().make_nonwriteable();
    array
}

/// Writes an image of 1 or 3 channels; the extension selects the format.
#[pyfunction]
pub fn write_image(py: Python<'_>, path: PathBuf, image: PyReadonlyArray3<'_, f32>) -> PyResult<()> {
    let [height, width, channels] = [0, 1, 2].map(|axis| image.shape()[axis]);
    let data = image.as_array().iter().copied().collect();
    computed(py, move || {
        let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
        let names: &[&str] = match channels {
            1 => &["Y"],
            3 => &["R", "G", "B"],
            other => return Err(usage(format!("the image has {other} channels, but must have 1 or 3."))),
        };
        let side = |side: usize| u32::try_from(side).map_err(|_| usage("the image is too large."));
        let image = Image::from_data(side(width)?, side(height)?, channels as u32, data)?;
        match extension.as_str() {
            "png" => write_png(&path, &image)?,
            "exr" => write_exr(&path, &image, names)?,
            _ => return Err(usage(format!("\"{}\" must end in .png or .exr.", path.display()))),
        }
        Ok(())
    })
}
