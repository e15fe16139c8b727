//! Progress of a training: a bar, log messages, and the page of `--watch`.

use crate::common::Common;
use crate::message::say;
use crate::ui::Bar;
use crate::watch::Watch;
use sgs_run::StageKind;
use sgs_train::{Event, IdleLoss, Observer, RollBack, RoomFit, Stage, TrainError};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

/// Observer that shows the progress of a training.
///
/// Stops the training when the flag is raised.
pub struct Progress<'a> {
    common: &'a Common,
    stop: &'a AtomicBool,
    /// Output directory, printed at the end of a stage; `None` in a series.
    output: Option<PathBuf>,
    watch: Option<&'a mut Watch>,
    bar: Option<Bar>,
}

impl<'a> Progress<'a> {
    /// Creates the progress of one run into `output`.
    pub fn of_run(
        common: &'a Common,
        stop: &'a AtomicBool,
        output: PathBuf,
        watch: Option<&'a mut Watch>,
    ) -> Progress<'a> {
        Progress { common, stop, output: Some(output), watch, bar: None }
    }

    /// Creates the progress of one run of a series.
    pub fn of_series(common: &'a Common, stop: &'a AtomicBool) -> Progress<'a> {
        Progress { common, stop, output: None, watch: None, bar: None }
    }

    fn finish_bar(&mut self) {
        if let Some(bar) = self.bar.take() {
            bar.finish();
        }
    }
}

impl Drop for Progress<'_> {
    fn drop(&mut self) {
        self.finish_bar();
    }
}

impl Observer for Progress<'_> {
    fn notify(&mut self, event: &Event<'_>) {
        match event {
            Event::Started { stage, step, steps, idle } => {
                IdleLoss::warnings(idle).iter().for_each(|warning| tracing::warn!("{warning}"));
                self.finish_bar();
                self.bar = Some(Bar::new(self.common, &stage.to_string(), u64::from(*steps), u64::from(*step)));
            }
            Event::Step { stage, steps, figures } => {
                if let Some(bar) = &mut self.bar {
                    bar.set(u64::from(figures.step()), || figures.to_string());
                }
                if let Some(watch) = &self.watch {
                    watch.step(stage.name(), figures.step(), *steps, *figures);
                }
            }
            Event::Decision { decision, .. } => {
                if let Some(bar) = &self.bar {
                    bar.say(&decision.to_string());
                }
            }
            Event::RolledBack { error, roll_back, .. } => {
                let RollBack { to, rates, .. } = roll_back;
                if let TrainError::Diverged { step, reason, .. } = error {
                    tracing::warn!(
                        "At step {step} {reason}; it goes on from step {to} with learning rates times {rates}."
                    );
                }
            }
            Event::Finished { stage, summary } => {
                self.finish_bar();
                if let Some(output) = self.output.as_ref().filter(|_| !self.common.quiet) {
                    let (steps, seconds, to) = (summary.steps, summary.seconds, output.display());
                    match (stage, summary.gaussians, summary.room) {
                        (StageKind::Geometry, Some(count), _) => {
                            say(format_args!("{count} Gaussians after {steps} steps in {seconds:.0} s; wrote {to}"));
                        }
                        (StageKind::Transport, _, Some(RoomFit { psnr, emitters })) => {
                            say(format_args!("{emitters} emitters, PSNR {psnr:.2} dB, in {seconds:.0} s; wrote {to}"));
                        }
                        _ => {
                            say(format_args!("materials and lights after {steps} steps in {seconds:.0} s; wrote {to}"))
                        }
                    }
                }
            }
            Event::Densified { .. } => {}
        }
    }

    fn should_stop(&mut self) -> bool {
        self.stop.load(Ordering::SeqCst)
    }

    fn should_pause(&mut self) -> bool {
        self.watch.as_ref().is_some_and(|watch| watch.is_due())
    }

    fn paused(&mut self, stage: &dyn Stage, ended: bool) {
        if let Some(watch) = self.watch.as_deref_mut()
            && (watch.is_due() || ended && watch.shows_end())
        {
            watch.show(stage);
        }
    }
}
