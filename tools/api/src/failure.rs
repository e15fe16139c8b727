//! Kinds of failures, with their exit statuses.

use sgs_batch::BatchError;
use sgs_capture::CaptureError;
use sgs_config::ConfigError;
use sgs_evaluate::EvaluateError;
use sgs_relight::RelightError;
use sgs_run::RunError;
use sgs_scene::SceneError;
use sgs_study::StudyError;
use sgs_synth::SynthError;
use sgs_train::TrainError;
use std::fmt;

/// Kind of a failure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Any other failure.
    Failed,
    /// Wrong usage: an option, a setting, a preset, a value, an unknown device.
    Usage,
    /// Input that can never work.
    Input,
    /// Training diverged.
    Diverged,
    /// Another process writes into the directory.
    Locked,
    /// The device was lost or did not respond in time.
    DeviceLost,
    /// Device memory or the memory budget was too small.
    OutOfMemory,
    /// The disk is full or read-only.
    Storage,
    /// SIGTERM or SIGHUP stopped the command.
    Terminated,
    /// The user stopped the command, for example with Ctrl-C.
    Interrupted,
}

impl Kind {
    /// Returns the exit status.
    pub fn status(self) -> i32 {
        match self {
            Kind::Failed | Kind::Diverged | Kind::Locked | Kind::Storage => 1,
            Kind::Usage => 2,
            Kind::Input => 42,
            Kind::DeviceLost | Kind::OutOfMemory | Kind::Terminated => 75,
            Kind::Interrupted => 130,
        }
    }

    /// Returns the name that the output of `--json` uses.
    pub fn name(self) -> &'static str {
        match self {
            Kind::Failed => "failed",
            Kind::Usage => "usage",
            Kind::Input => "input",
            Kind::Diverged => "diverged",
            Kind::Locked => "locked",
            Kind::DeviceLost => "device_lost",
            Kind::OutOfMemory => "out_of_memory",
            Kind::Storage => "storage",
            Kind::Terminated => "terminated",
            Kind::Interrupted => "interrupted",
        }
    }

    /// Returns the kind of the first cause in the chain whose kind is known.
    pub fn of(error: &anyhow::Error) -> Kind {
        let known = |cause: &(dyn std::error::Error + 'static)| {
            if let Some(failure) = cause.downcast_ref::<Failure>() {
                return Some(failure.kind);
            }
            fn known<'a, E: std::error::Error + 'static>(
                cause: &'a (dyn std::error::Error + 'static),
                kind: fn(&'a E) -> Option<Kind>,
            ) -> Option<Kind> {
                cause.downcast_ref::<E>().and_then(kind)
            }
            known(cause, of_train)
                .or_else(|| known(cause, of_run))
                .or_else(|| known(cause, of_relight))
                .or_else(|| known(cause, of_evaluate))
                .or_else(|| known(cause, of_study))
                .or_else(|| known(cause, of_batch))
                .or_else(|| known(cause, of_capture))
                .or_else(|| cause.is::<ConfigError>().then_some(Kind::Usage))
                .or_else(|| known(cause, of_scene))
                .or_else(|| known(cause, of_engine))
                .or_else(|| known(cause, of_synth))
        };
        error.chain().find_map(known).unwrap_or(Kind::Failed)
    }
}

fn of_train(error: &TrainError) -> Option<Kind> {
    match error {
        TrainError::Engine(error) => of_engine(error),
        TrainError::Scene(error) => of_scene(error),
        TrainError::Run(error) => of_run(error),
        TrainError::Config(_) | TrainError::Requirement(_) => Some(Kind::Usage),
        TrainError::Memory(_) => Some(Kind::OutOfMemory),
        // Retrying cannot change the limits of the device.
        TrainError::Limit(_) => Some(Kind::Input),
        TrainError::Diverged { .. } => Some(Kind::Diverged),
        _ => None,
    }
}

fn of_run(error: &RunError) -> Option<Kind> {
    match error {
        RunError::Engine(error) => of_engine(error),
        RunError::Scene(error) => of_scene(error),
        RunError::Config(_) | RunError::Refused(_) => Some(Kind::Usage),
        RunError::Locked { .. } => Some(Kind::Locked),
        RunError::File { .. } => None,
        RunError::Io { .. } => error.is_storage_error().then_some(Kind::Storage),
    }
}

fn of_evaluate(error: &EvaluateError) -> Option<Kind> {
    match error {
        EvaluateError::Engine(error) => of_engine(error),
        EvaluateError::Scene(error) => of_scene(error),
        EvaluateError::Run(error) => of_run(error),
        EvaluateError::Metric(_) => None,
    }
}

fn of_relight(error: &RelightError) -> Option<Kind> {
    match error {
        RelightError::Engine(error) => of_engine(error),
        RelightError::Scene(error) => of_scene(error),
        RelightError::Run(error) => of_run(error),
        RelightError::Evaluate(error) => of_evaluate(error),
        RelightError::Train(error) => of_train(error),
        RelightError::Config(_) | RelightError::Edit(_) => Some(Kind::Usage),
        RelightError::Transport(_) | RelightError::Metric(_) | RelightError::File { .. } => None,
    }
}

fn of_study(error: &StudyError) -> Option<Kind> {
    match error {
        StudyError::Scene(error) => of_scene(error),
        StudyError::Run(error) => of_run(error),
        StudyError::Config(_) | StudyError::UnknownRow { .. } => Some(Kind::Usage),
    }
}

fn of_batch(error: &BatchError) -> Option<Kind> {
    match error {
        BatchError::Wrong { .. } | BatchError::Config(_) => Some(Kind::Usage),
        BatchError::Scene(error) => of_scene(error),
        BatchError::Run(error) => of_run(error),
        BatchError::File { storage, .. } => storage.then_some(Kind::Storage),
    }
}

fn of_capture(error: &CaptureError) -> Option<Kind> {
    match error {
        CaptureError::Input(_) => Some(Kind::Input),
        CaptureError::Scene(error) => of_scene(error),
        CaptureError::Io { cause, .. } => sgs_scene::is_storage_error(cause).then_some(Kind::Storage),
        _ => None,
    }
}

fn of_scene(error: &SceneError) -> Option<Kind> {
    match error {
        SceneError::Io { .. } => error.is_storage_error().then_some(Kind::Storage),
        SceneError::Data { .. } => None,
        SceneError::Option { .. } => Some(Kind::Usage),
        _ => Some(Kind::Input),
    }
}

fn of_engine(error: &sgs_engine::Error) -> Option<Kind> {
    use sgs_engine::Error as E;
    match error {
        error if error.is_out_of_memory() => Some(Kind::OutOfMemory),
        E::DeviceLost(_) | E::Timeout { .. } => Some(Kind::DeviceLost),
        E::UnclearDevice { .. } => Some(Kind::Usage),
        E::NoDevice { requested, found } if found != "none" && requested != "any device" => Some(Kind::Usage),
        _ => None,
    }
}

fn of_synth(error: &SynthError) -> Option<Kind> {
    match error {
        SynthError::Io { .. } | SynthError::Encode { .. } => None,
        _ => Some(Kind::Usage),
    }
}

/// Failure of a known kind, described by one sentence.
#[derive(Debug)]
pub struct Failure {
    /// Kind that determines the exit status.
    pub kind: Kind,
    /// What failed, why, and what to do.
    pub text: String,
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl std::error::Error for Failure {}

/// Creates an error of a kind.
pub fn failure(kind: Kind, text: impl Into<String>) -> anyhow::Error {
    Failure { kind, text: text.into() }.into()
}

/// Creates an error of wrong usage.
pub fn usage(text: impl Into<String>) -> anyhow::Error {
    failure(Kind::Usage, text)
}

/// Returns an error of wrong usage from the calling function; takes the arguments of `format!`.
#[macro_export]
macro_rules! refuse_usage {
    ($($text:tt)*) => {
        return Err($crate::usage(format!($($text)*)))
    };
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::Context;
    use sgs_train::Requirement;

    #[test]
    fn kind_is_found_below_context() {
        let setting = || TrainError::from(Requirement::NotEmpty);
        let kinds = [
            (anyhow::anyhow!("anything"), 1),
            (setting().into(), 2),
            (usage("no"), 2),
            (SceneError::NotAScene { path: "a".into(), problem: "is empty".into() }.into(), 42),
            (TrainError::from(sgs_engine::Error::DeviceLost("a call".into())).into(), 75),
            (TrainError::Memory("too much".into()).into(), 75),
            (TrainError::Limit("too large".into()).into(), 42),
            (failure(Kind::Interrupted, "stopped"), 130),
        ];
        for (error, status) in kinds {
            assert_eq!(Kind::of(&error).status(), status, "{error}");
        }
        let below = Err::<(), _>(setting()).context("while reading").unwrap_err();
        assert_eq!(Kind::of(&below), Kind::Usage);
    }
}
