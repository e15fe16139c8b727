//! Trainer as a library: stops, pauses and checkpoints change no result.

use sgs_config::Settings;
use sgs_scene::{Scene, SceneOptions};
use sgs_tests::rooms::Room;
use sgs_tests::{Gpu, Place};
use sgs_train::{Event, Observer, Outcome, Stage, Trainer, TrainerOptions};
use std::sync::Arc;

/// Observer that stops before the first step and from the third on. It pauses after every step and counts events.
#[derive(Default)]
struct Fickle {
    requested: u32,
    steps: Vec<u32>,
    pauses: u32,
    finished: u32,
}

impl Observer for Fickle {
    fn notify(&mut self, event: &Event<'_>) {
        match event {
            Event::Step { figures, .. } => self.steps.push(figures.step()),
            Event::Finished { .. } => self.finished += 1,
            _ => {}
        }
    }

    fn should_stop(&mut self) -> bool {
        self.requested += 1;
        self.requested == 1 || self.steps.last().is_some_and(|step| *step >= 3)
    }

    fn should_pause(&mut self) -> bool {
        self.steps.len() as u32 > self.pauses
    }

    fn paused(&mut self, stage: &dyn Stage, _ended: bool) {
        self.pauses = self.steps.len() as u32;
        assert!(self.steps.last().is_none_or(|last| *last == stage.step()));
    }
}

fn settings(place: &Place, steps: u32) -> Settings {
    let mut settings = Settings { scene: place.path("scene"), ..Settings::default() };
    settings.train.checkpoint_interval = 2;
    let g = &mut settings.geometry;
    (g.steps, g.sh_degree, g.densify.until) = (steps, 1.into(), 0.0);
    settings
}

fn trainer(gpu: &Gpu, place: &Place, steps: u32, options: TrainerOptions) -> sgs_train::Result<Trainer> {
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    Trainer::new(gpu.device(), Arc::new(scene), &settings(place, steps), options)
}

#[test]
fn stops_and_pauses_change_no_result() {
    let gpu = Gpu::new();
    let place = Place::new(Room { views: 4, size: [24, 16], ..Room::default() });
    let mut plain = trainer(&gpu, &place, 8, TrainerOptions::default()).unwrap();
    assert_eq!(plain.run(&mut ()).unwrap(), Outcome::Finished);
    let expected = plain.splats().unwrap();
    let run = Some(place.path("run"));
    let mut fickle = Fickle::default();
    let mut disturbed = trainer(&gpu, &place, 8, TrainerOptions { run, ..Default::default() }).unwrap();
    let stage = sgs_run::StageKind::Geometry;
    // A stop before the stage writes no files and changes no result.
    assert_eq!(disturbed.run(&mut fickle).unwrap(), Outcome::Stopped { stage, step: 0 });
    assert!(!disturbed.is_finished() && !place.path("run").exists());
    let stopped = disturbed.run(&mut fickle).unwrap();
    let Outcome::Stopped { step, .. } = stopped else { panic!("{stopped:?}") };
    assert!((3..8).contains(&step), "stopped after step {step}");
    assert!(fickle.pauses > 0 && place.path("run/checkpoint/geometry.safetensors").is_file());
    // The same trainer continues, and so does another trainer from the checkpoint.
    assert_eq!(disturbed.run(&mut ()).unwrap(), Outcome::Finished);
    assert!(disturbed.is_finished() && disturbed.splats().unwrap() == expected);
    assert_eq!(disturbed.run(&mut ()).unwrap(), Outcome::Finished);
    drop(disturbed);
    std::fs::remove_file(place.path("run/training.json")).unwrap();
    let options = TrainerOptions { run: Some(place.path("run")), resume: true, ..Default::default() };
    let mut resumed = trainer(&gpu, &place, 8, options).unwrap();
    let mut counted = Fickle { requested: 1, ..Default::default() };
    assert_eq!(resumed.run(&mut counted).unwrap(), Outcome::Finished);
    assert_eq!((counted.steps.len(), counted.finished), (0, 1));
    assert!(resumed.splats().unwrap() == expected);
}

#[test]
fn a_checkpoint_beyond_the_last_step_is_refused() {
    let gpu = Gpu::new();
    let place = Place::new(Room { views: 4, size: [24, 16], ..Room::default() });
    let run = Some(place.path("run"));
    let mut first = trainer(&gpu, &place, 4, TrainerOptions { run: run.clone(), ..Default::default() }).unwrap();
    first.run(&mut ()).unwrap();
    let options = TrainerOptions { run, resume: true, ..Default::default() };
    let mut shorter = trainer(&gpu, &place, 3, options).unwrap();
    let error = shorter.run(&mut ()).unwrap_err().to_string();
    assert!(error.contains("after step 4") && error.contains("geometry.steps is 3"), "{error}");
    // A trainer cannot run again after an error.
    assert!(!shorter.is_finished());
    assert!(shorter.run(&mut ()).unwrap_err().to_string().contains("ended with an error"));
}
