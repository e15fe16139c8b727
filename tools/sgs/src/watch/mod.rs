//! Live page of a training: `sgs train --watch`.
//!
//! Guarantees:
//! - No port is opened unless requested.
//! - The training performs the same steps as without `--watch`.
//! - Rendering images pauses the training for at most [`page_rate::SHARE`] of its time.
//! - An error while rendering ends the images, not the training.

mod board;
mod rate;
mod server;

pub use server::Port;

use board::{Board, Shot, WIDTH};
use rate::PageRate;
use sgs_engine::Device;
use sgs_report::serve::Serving;
use sgs_scene::{Camera, Image, Scene, resize};
use sgs_train::{Stage, StepFigures};
use std::fmt::Write;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Maximum number of views shown.
const VIEWS: usize = 3;

/// Time without a request after which a page counts as closed. An open page polls every two seconds.
const AWAITED_WITHIN: Duration = Duration::from_secs(6);

/// Training that is shown on a live page.
pub struct Watch {
    board: Arc<Board>,
    views: Vec<(Camera, Image)>,
    page_rate: PageRate,
    begun: Instant,
    /// Whether images are still rendered. The first error disables them.
    renderings: bool,
    ended: bool,
    _serving: Serving,
}

impl Drop for Watch {
    fn drop(&mut self) {
        self.end("ended by an error");
    }
}

impl Watch {
    /// Opens the page of a training that writes into `run`.
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
            page_rate: PageRate::new(),
            begun: Instant::now(),
            renderings: true,
            ended: false,
            _serving: serving,
        })
    }

    /// Returns whether the training should pause to render images.
    pub fn is_due(&self) -> bool {
        self.renderings && !self.views.is_empty() && self.page_rate.is_due(Instant::now())
    }

    /// Returns whether images of a stage that has just ended should be rendered.
    pub fn shows_end(&self) -> bool {
        self.renderings && !self.views.is_empty()
    }

    /// Reports how the training ended. Waits briefly until an open page has received the end and stops polling.
    pub fn end(&mut self, how: &str) {
        if std::mem::replace(&mut self.ended, true) {
            return;
        }
        self.board.end(how);
        while self.board.is_awaited(AWAITED_WITHIN) {
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Renders the held-back views from the current state of a stage and shows them.
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
                self.page_rate.made(begun, Instant::now());
                let share = 100.0 * self.page_rate.spent.as_secs_f64() / self.begun.elapsed().as_secs_f64().max(1e-9);
                let text = format!("After step {step} of {name}. Images took {share:.1} % of the time.");
                self.board.show(name, step, shots, text);
            }
            Err(error) => {
                tracing::warn!("--watch shows no more images: {error}");
                self.renderings = false;
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
