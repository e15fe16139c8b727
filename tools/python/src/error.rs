//! Failures as exceptions of the package.

use pyo3::prelude::*;
use sgs_api::Kind;

/// Converts a failure to `sgs.Error`, with kind, exit status and sentence.
pub fn raised(error: &anyhow::Error) -> PyErr {
    let kind = Kind::of(error);
    let sentence = format!("{error:#}").trim_end().to_owned();
    Python::attach(|py| {
        let class = py.import("sgs._errors").and_then(|module| module.getattr("Error"));
        match class.and_then(|class| class.call1((sentence, kind.name(), kind.status()))) {
            Ok(exception) => PyErr::from_value(exception),
            Err(error) => error,
        }
    })
}

/// Runs a function without the interpreter's lock. A failure becomes an exception.
pub fn computed<T: Send>(py: Python<'_>, run: impl FnOnce() -> anyhow::Result<T> + Send) -> PyResult<T> {
    py.detach(run).map_err(|error| raised(&error))
}
