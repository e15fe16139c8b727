//! Training with a callback.

use crate::device::Device;
use crate::error::raised;
use crate::settings::{ConfigTuple, overrides};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use sgs_api::{Stages, TrainRequest, prepare_training};
use sgs_train::{Event, IdleLoss, Observer, Outcome, TrainError};
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Longest time between two checks for Ctrl-C.
const SIGNAL_INTERVAL: Duration = Duration::from_millis(50);

/// Trains a scene. Returns whether all stages are finished, the last stage, and its step.
///
/// `paths`: scene, run, and geometry of the intrinsic stage. `permission`: whether to resume, and to replace a run.
/// `callback` receives each event as a dictionary; a result of `False` stops the training after a checkpoint.
#[pyfunction]
pub fn train(
    py: Python<'_>,
    paths: (PathBuf, PathBuf, Option<PathBuf>),
    stage: String,
    config: ConfigTuple,
    device: &Bound<'_, Device>,
    permission: (bool, bool),
    callback: Option<Py<PyAny>>,
) -> PyResult<(bool, Option<&'static str>, u32)> {
    let device = device.get().0.clone();
    let ((scene, output, start), (resume, force)) = (paths, permission);
    let mut observer = Callback { callback, error: None, stop: false, checked: Instant::now() };
    let outcome = py.detach(|| -> anyhow::Result<Option<Outcome>> {
        let overrides = overrides(config)?;
        let request = TrainRequest { scene, output, stages: Stages::named(&stage)?, start, overrides, resume, force };
        let Some(training) = prepare_training(&request, |text| tracing::info!("{text}"))? else { return Ok(None) };
        Ok(Some(training.trainer(&device)?.run(&mut observer)?))
    });
    // An exception of the callback, or Ctrl-C, stopped the training.
    if let Some(error) = observer.error {
        return Err(error);
    }
    match outcome.map_err(|error| raised(&error))? {
        None | Some(Outcome::Finished) => Ok((true, None, 0)),
        Some(Outcome::Stopped { stage, step }) => Ok((false, Some(stage.name()), step)),
    }
}

struct Callback {
    callback: Option<Py<PyAny>>,
    error: Option<PyErr>,
    stop: bool,
    /// Time of the last check for Ctrl-C.
    checked: Instant,
}

impl Callback {
    /// Calls the callback with an event of this kind.
    fn call(&mut self, kind: &str, fill: impl FnOnce(&Bound<'_, PyDict>) -> PyResult<()>) {
        let Some(callback) = self.callback.as_ref().filter(|_| !self.stop) else { return };
        let answer = Python::attach(|py| {
            let event = PyDict::new(py);
            event.set_item("kind", kind)?;
            fill(&event)?;
            let answer = callback.bind(py).call1((event,))?;
            Ok(answer.extract::<bool>().is_ok_and(|answer| !answer) && !answer.is_none())
        });
        match answer {
            Ok(stop) => self.stop |= stop,
            Err(error) => self.fail(error),
        }
    }

    fn fail(&mut self, error: PyErr) {
        self.stop = true;
        self.error.get_or_insert(error);
    }

    /// Lets Python handle signals, such as Ctrl-C.
    fn check_signals(&mut self) {
        if self.stop || self.checked.elapsed() < SIGNAL_INTERVAL {
            return;
        }
        self.checked = Instant::now();
        if let Err(error) = Python::attach(|py| py.check_signals()) {
            self.fail(error);
        }
    }
}

impl Observer for Callback {
    fn notify(&mut self, event: &Event<'_>) {
        match event {
            Event::Started { stage, step, steps, idle } => {
                IdleLoss::warnings(idle).iter().for_each(|warning| tracing::warn!("{warning}"));
                self.call("started", |e| {
                    e.set_item("stage", stage.name())?;
                    e.set_item("step", step)?;
                    e.set_item("steps", steps)
                });
            }
            Event::Step { stage, steps, figures } => self.call("step", |e| {
                e.set_item("stage", stage.name())?;
                e.set_item("step", figures.step())?;
                e.set_item("steps", steps)?;
                e.set_item("loss", figures.loss())?;
                e.set_item("gaussians", figures.gaussians())?;
                e.set_item("text", figures.to_string())?;
                e.set_item("log", figures.log_line(1.0).map_err(|e| raised(&e.into()))?)
            }),
            Event::Densified { step, stats } => self.call("densified", |e| {
                e.set_item("stage", "geometry")?;
                e.set_item("step", step)?;
                e.set_item("gaussians", stats.after)
            }),
            Event::Decision { stage, decision } => self.call("decision", |e| {
                e.set_item("stage", stage.name())?;
                e.set_item("text", decision.to_string())
            }),
            Event::RolledBack { stage, error, roll_back } => {
                if let TrainError::Diverged { step, reason, .. } = error {
                    let (to, rates) = (roll_back.to, roll_back.rates);
                    tracing::warn!(
                        "At step {step} {reason}; it goes on from step {to} with learning rates times {rates}."
                    );
                }
                self.call("rolled_back", |e| {
                    e.set_item("stage", stage.name())?;
                    e.set_item("step", roll_back.to)?;
                    e.set_item("text", error.to_string())
                });
            }
            Event::Finished { stage, summary } => self.call("finished", |e| {
                e.set_item("stage", stage.name())?;
                e.set_item("step", summary.steps)?;
                e.set_item("steps", summary.steps)?;
                e.set_item("gaussians", summary.gaussians)?;
                e.set_item("log", serde_json::to_string(summary).map_err(|e| raised(&e.into()))?)
            }),
        }
    }

    fn should_stop(&mut self) -> bool {
        self.check_signals();
        self.stop
    }
}
