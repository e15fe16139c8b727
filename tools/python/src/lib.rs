//! Native part of the Python package `sgs`.
//!
//! The classes and functions here are private to the package, which wraps them (`tools/python/sgs`). Every function that computes
//! releases the interpreter's lock. Failures become `sgs.Error`, with the kinds and sentences of the command line.

mod arrays;
mod camera;
mod device;
mod differentiable;
mod error;
mod log;
mod relit;
mod render;
mod run;
mod scene;
mod settings;
mod synth;
mod training;

use pyo3::prelude::*;

/// Native module of the package `sgs`.
#[pymodule]
fn _sgs(module: &Bound<'_, PyModule>) -> PyResult<()> {
    log::start();
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<device::Device>()?;
    module.add_class::<scene::Scene>()?;
    module.add_class::<run::Run>()?;
    module.add_class::<relit::Relit>()?;
    module.add_class::<differentiable::Splatter>()?;
    module.add_class::<differentiable::LightShader>()?;
    module.add_function(wrap_pyfunction!(device::devices, module)?)?;
    module.add_function(wrap_pyfunction!(settings::check_settings, module)?)?;
    module.add_function(wrap_pyfunction!(synth::synthesize, module)?)?;
    module.add_function(wrap_pyfunction!(training::train, module)?)?;
    module.add_function(wrap_pyfunction!(scene::read_cameras, module)?)?;
    module.add_function(wrap_pyfunction!(arrays::write_image, module)?)?;
    Ok(())
}
