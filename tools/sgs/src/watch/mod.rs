//! `sgs train --watch`: the page of a training that goes on.
//!
//! Promises: nothing is listened on unless it is asked for; the training does the same steps as without, and is stopped for
//! pictures no longer than [`pace::SHARE`] of its time; what goes wrong with a picture ends the pictures and not the training.

mod board;
mod pace;
mod server;

pub use server::Port;

use board::{Board, Shot, WIDTH};
use pace::Pace;
use sgs_engine::Device;
use sgs_report::serve::Serving;
use sgs_scene::{Camera, Image, Scene, resize};
use sgs_train::{Stage, StepFigures};
use std::fmt::Write;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Views that are shown.
const VIEWS: usize = 3;

/// A page that has not asked for so long is gone; one that is there asks every two seconds.
const ASKS_WITHIN: Duration = Duration::from_secs(6);

/// A training that is watched.
pub struct Watch {
    board: Arc<Board>,
    views: Vec<(Camera, Image)>,
    pace: Pace,
    begun: Instant,
    /// Nothing goes wrong twice.
    pictures: bool,
    ended: bool,
    _serving: Serving,
}

impl Drop for Watch {
    fn drop(&mut self) {
        self.end("ended by an error");
    }
}

impl Watch {
    /// Opens the page of a training into `run`.
    pub fn begin(port: Port, scene: &Scene, run: &Path, device: &Device) -> anyhow::Result<Watch> {
        let held = if scene.split.test.is_empty() { &scene.split.train } else { &scene.split.test };
        let mut views = Vec::new();
        let count = held.len().min(VIEWS);
        for k in 0..count {
            let view = held[(2 * k + 1) * held.len() / (2 * count)];
            let camera = &scene.views[view].camera;
            let photo = scene.load_image(view)?;
            let width = camera.width.min(WIDTH);
            let height = (u64::from(camera.height) * u64::from(width) / u64::from(camera.width)).max(1) as u32;
            let truth = if width < camera.width { resize(&photo, width, height) } else { photo };
            views.push((camera.scaled(width, height), truth));
        }
        let split = &scene.split;
        let facts = vec![
            ("scene".to_owned(), scene.root.display().to_string()),
            ("views".to_owned(), format!("{} to train on, {} to test", split.train.len(), split.test.len())),
            ("device".to_owned(), device.info().name.clone()),
        ];
        let run = std::path::absolute(run).unwrap_or_else(|_| run.to_owned());
        let name = run.file_name().unwrap_or(run.as_os_str()).to_string_lossy().into_owned();
        let board = Arc::new(Board::new(format!("SGS: {name}, in training"), run, facts));
        let serving = port.serve(board.clone())?;
        Ok(Watch {
            board,
            views,
            pace: Pace::new(),
            begun: Instant::now(),
            pictures: true,
            ended: false,
            _serving: serving,
        })
    }

    /// Whether the training is to be stopped for pictures.
    pub fn is_due(&self) -> bool {
        self.pictures && !self.views.is_empty() && self.pace.is_due(Instant::now())
    }

    /// Whether there are pictures to be made of a stage that has just ended.
    pub fn shows_end(&self) -> bool {
        self.pictures && !self.views.is_empty()
    }

    /// Says how the training has ended. Waits a moment for a page that is open, so that it shows the end and stops asking.
    pub fn end(&mut self, how: &str) {
        if std::mem::replace(&mut self.ended, true) {
            return;
        }
        self.board.end(how);
        while self.board.is_awaited(ASKS_WITHIN) {
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Shows the state of a stage in the held-back views.
    pub fn show(&mut self, stage: &dyn Stage) {
        let begun = Instant::now();
        let (name, step) = (stage.kind().name(), stage.step());
        let cameras: Vec<&Camera> = self.views.iter().map(|(camera, _)| camera).collect();
        match stage.preview(&cameras) {
            Ok(images) => {
                let shot = |((camera, truth), render): (&(Camera, Image), Image)| Shot {
                    name: camera.name.clone(),
                    truth: truth.clone(),
                    render,
                };
                let shots = self.views.iter().zip(images).map(shot).collect();
                self.pace.made(begun, Instant::now());
                let share = 100.0 * self.pace.spent.as_secs_f64() / self.begun.elapsed().as_secs_f64().max(1e-9);
                let text = format!("After step {step} of {name}. Images took {share:.1} % of the time.");
                self.board.show(name, step, shots, text);
            }
            Err(error) => {
                tracing::warn!("--watch shows no more images: {error}");
                self.pictures = false;
            }
        }
    }

    /// Reports a step to the page.
    pub fn step(&self, stage: &str, step: u32, steps: u32, figures: &dyn StepFigures) {
        self.board.step(stage, step, steps, |text| {
            // Writing into memory does not fail.
            let _ = write!(text, "{figures}");
        });
    }
}
