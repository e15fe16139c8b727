//! Synthesized scenes.

use crate::error::computed;
use pyo3::prelude::*;
use sgs_synth::SynthOptions;
use std::path::PathBuf;

/// Generates a room, as `sgs synth` does. `views`: numbers of training and test views.
#[pyfunction]
pub fn synthesize(
    py: Python<'_>,
    out: PathBuf,
    scene: Option<String>,
    views: (Option<usize>, Option<usize>),
    size: Option<(usize, usize)>,
    seed: u64,
    replace: bool,
) -> PyResult<()> {
    computed(py, || {
        let mut options = SynthOptions { seed, replace, ..SynthOptions::default() };
        if let Some(name) = scene {
            options.scene = name.parse()?;
        }
        options.views = views.0.unwrap_or(options.views);
        options.test_views = views.1.unwrap_or(options.test_views);
        if let Some((width, height)) = size {
            (options.width, options.height) = (width, height);
        }
        sgs_synth::generate(&out, &options, &|_, _| {})?;
        Ok(())
    })
}
