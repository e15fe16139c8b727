//! Start of a stage: its Gaussians, its checkpoint and its files in the run directory.

use super::observer::{Event, Observer};
use super::record::Record;
use super::{Active, Next, StartGeometry, Trainer};
use crate::error::{Requirement, Result, TrainError};
use crate::geometry::Geometry;
use crate::intrinsic::Intrinsic;
use crate::stage::Stage;
use crate::transport::Transport;
use sgs_config::Settings;
use sgs_run::{RunDirectory, StageKind, read_splats, use_learned_views};
use sgs_scene::{Scene, Splats};
use std::path::Path;
use std::sync::Arc;

impl Trainer {
    /// Creates the next stage. Returns false if the observer stopped it before anything was written.
    pub(super) fn start(&mut self, next: Next, observer: &mut dyn Observer) -> Result<bool> {
        let Next { kind, resume, complete } = next;
        self.learned = self.learned_scene(kind)?;
        // Whether the Gaussians in the run directory differ from those that the stage starts from.
        let mut changed = self.options.start.is_some() && !resume;
        let mut stage: Box<dyn Stage> = match kind {
            StageKind::Geometry => self.build(kind, &self.settings)?,
            StageKind::Intrinsic => {
                let both = self.trains_both();
                let mut splats = self.take_splats(resume)?;
                // The stage initializes the materials or restores its checkpoint. Emitters and light gains belong to other materials.
                (splats.albedo, splats.roughness, splats.metallic) = (None, None, None);
                changed |= splats.emitters.take().is_some() | splats.light_gains.take().is_some();
                let all = splats.len();
                let (device, scene, settings) = (&self.device, self.scene_of(kind), &self.settings);
                // Only a training that made the geometry itself may remove Gaussians.
                let stage = match both && !resume {
                    true => Intrinsic::within(device, scene, settings, &mut splats),
                    false => Intrinsic::new(device, scene, settings, &splats),
                };
                changed |= splats.len() < all;
                // Geometry that was trained in memory stays even if the stage cannot start.
                self.splats = Some(splats);
                Box::new(stage?)
            }
            StageKind::Transport => {
                let splats = self.take_splats(resume)?;
                let stage = self.transport(&self.settings, &splats);
                self.splats = Some(splats);
                Box::new(stage?)
            }
        };
        if observer.should_stop() {
            return Ok(false);
        }
        // A training that was refused or stopped before this point writes no file.
        let record = match &self.options.run {
            None => None,
            Some(root) if complete => {
                stage.restore(&RunDirectory::open(root)?.checkpoint(kind))?;
                None
            }
            Some(root) => {
                let run = RunDirectory::create(root)?;
                let checkpoint = run.checkpoint(kind);
                match (kind, resume) {
                    (StageKind::Geometry, false) => run.forget()?,
                    (StageKind::Geometry, true) if !checkpoint.is_file() => {}
                    (_, true) => stage.restore(&checkpoint)?,
                    (StageKind::Intrinsic, false) => run.forget_intrinsic()?,
                    (StageKind::Transport, false) => run.forget_transport()?,
                }
                if kind == StageKind::Intrinsic {
                    // The materials change under the emitters.
                    run.forget_transport()?;
                    // The run has to be sufficient for resuming.
                    if let Some(splats) = self.splats.as_ref().filter(|_| changed) {
                        splats.write_ply(&run.path("scene.ply"))?;
                    }
                }
                check_steps(&*stage, &checkpoint)?;
                Some(Record::open(run, &*stage, self.rolls_back())?)
            }
        };
        self.next.pop_front();
        let (step, steps) = (stage.step(), stage.steps());
        if !complete {
            observer.notify(&Event::Started { stage: kind, step, steps, idle: stage.idle_losses() });
        }
        self.active = Some(Active { stage, record, first: step, seconds: 0.0, timed: false, finished: complete });
        Ok(true)
    }

    /// Returns the scene with learned cameras and exposures, for a later stage.
    ///
    /// None for Gaussians from another file: these were not trained with this scene's views.
    fn learned_scene(&self, kind: StageKind) -> Result<Option<Arc<Scene>>> {
        if kind == StageKind::Geometry || self.options.start.is_some() || self.learned.is_some() {
            if kind != StageKind::Geometry
                && let Some(StartGeometry::File(path)) = &self.options.start
                && let Some(run) = path.parent().and_then(|root| RunDirectory::open(root).ok())
                && run.learned_views()?.is_some()
            {
                tracing::warn!(
                    "{} was trained with learned cameras, which the file does not hold; train this stage into its run to use them.",
                    path.display()
                );
            }
            return Ok(self.learned.clone());
        }
        let learned = match (&self.active, &self.options.run) {
            (Some(before), _) => before.stage.learned_views()?,
            (None, Some(root)) if root.join("config.toml").is_file() => RunDirectory::open(root)?.learned_views()?,
            _ => None,
        };
        Ok(learned.map(|learned| {
            let mut scene = (*self.scene).clone();
            use_learned_views(&mut scene, &learned);
            Arc::new(scene)
        }))
    }

    /// Returns the scene as a stage sees it.
    fn scene_of(&self, kind: StageKind) -> &Arc<Scene> {
        match (&self.learned, kind) {
            (Some(learned), StageKind::Intrinsic | StageKind::Transport) => learned,
            _ => &self.scene,
        }
    }

    /// Returns the Gaussians that a stage after the geometry stage starts from.
    fn take_splats(&mut self, resume: bool) -> Result<Splats> {
        let before = self.active.take();
        let file = |path: &Path| if path.is_file() { Ok(read_splats(path)?) } else { Err(no_geometry(path)) };
        // A stage before this one has used the given Gaussians.
        let start = self.options.start.as_ref().filter(|_| !resume && before.is_none());
        match (start, &self.options.run, before) {
            (Some(StartGeometry::File(path)), ..) => file(path),
            (Some(StartGeometry::Splats(splats)), ..) => Ok((**splats).clone()),
            (_, Some(root), _) => file(&root.join("scene.ply")),
            (_, None, Some(before)) => before.stage.splats(),
            (_, None, None) => self.splats.take().ok_or_else(|| Requirement::Geometry.into()),
        }
    }

    /// Creates the transport stage. Beside the intrinsic stage it is left out where it brings nothing.
    fn transport(&self, settings: &Settings, splats: &Splats) -> Result<Transport> {
        let scene = Arc::clone(self.scene_of(StageKind::Transport));
        let stage = Transport::new(&self.device, scene, settings, splats)?;
        let beside = self.options.stages.contains(&StageKind::Intrinsic);
        Ok(if beside { stage.automatic() } else { stage })
    }

    pub(super) fn build(&self, kind: StageKind, settings: &Settings) -> Result<Box<dyn Stage>> {
        let (device, scene) = (&self.device, self.scene_of(kind));
        Ok(match (kind, &self.splats) {
            (StageKind::Intrinsic, Some(splats)) => Box::new(Intrinsic::new(device, scene, settings, splats)?),
            (StageKind::Transport, Some(splats)) => Box::new(self.transport(settings, splats)?),
            _ => Box::new(Geometry::new(device, scene, settings, None)?),
        })
    }
}

/// Refuses a checkpoint that is beyond the last step of the settings.
fn check_steps(stage: &dyn Stage, checkpoint: &Path) -> Result<()> {
    let (step, steps, kind) = (stage.step(), stage.steps(), stage.kind());
    if step > steps {
        return Err(Requirement::MoreSteps { path: checkpoint.to_owned(), kind, step, steps }.into());
    }
    Ok(())
}

fn no_geometry(path: &Path) -> TrainError {
    Requirement::GeometryIn(path.to_owned()).into()
}
