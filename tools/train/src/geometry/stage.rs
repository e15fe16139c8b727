//! Implementation of [`Stage`] for geometry.

use super::log::Figures;
use super::{Geometry, Progress};
use crate::decision::Decision;
use crate::divergence::RollBack;
use crate::error::Result;
use crate::idle::IdleLoss;
use crate::stage::{Stage, StageEvent};
use sgs_config::Settings;
use sgs_engine::exec::PassTime;
use sgs_engine::graph::Plan;
use sgs_passes::Tuning;
use sgs_passes::pipeline::Renderer;
use sgs_passes::splat::Channels;
use sgs_run::{LearnedCameras, RunDirectory, RunLight, StageKind, render_view};
use sgs_scene::{Camera, Image, Splats};
use std::path::Path;

impl Stage for Geometry {
    fn kind(&self) -> StageKind {
        StageKind::Geometry
    }

    fn step(&self) -> u32 {
        self.done
    }

    fn steps(&self) -> u32 {
        self.settings.geometry.steps
    }

    fn checkpoint_interval(&self) -> u32 {
        self.settings.train.checkpoint_interval
    }

    fn settings(&self) -> &Settings {
        &self.settings
    }

    fn train(
        &mut self,
        last: u32,
        events: &mut dyn FnMut(&StageEvent<'_>),
        proceed: &mut dyn FnMut() -> bool,
    ) -> Result<()> {
        let report = |progress: &Progress| match progress {
            Progress::Step(report) => events(&StageEvent::Step(&Figures(report))),
            Progress::Densified { step, stats } => events(&StageEvent::Densified { step: *step, stats }),
            Progress::Decided(decision) => events(&StageEvent::Decision(decision)),
        };
        Geometry::train(self, last, report, proceed)
    }

    fn save(&self, path: &Path) -> Result<()> {
        Geometry::save(self, path)
    }

    fn restore(&mut self, path: &Path) -> Result<()> {
        Geometry::restore(self, path)
    }

    fn set_candidate(&mut self) -> bool {
        self.watch.set_candidate(self.done)
    }

    fn is_candidate(&self) -> bool {
        self.watch.is_candidate(self.done)
    }

    fn validate_candidate(&mut self) -> bool {
        self.watch.validate_candidate()
    }

    fn roll_backs(&self) -> &[RollBack] {
        &self.roll_backs
    }

    fn roll_back(&mut self, before: &[RollBack], step: u32) {
        Geometry::roll_back(self, before, step);
    }

    fn lower_rates(&self) -> String {
        format!("--set geometry.rates.factor={:.3}", self.settings.geometry.rate_factor() * 0.1)
    }

    fn decisions(&self) -> &[Decision] {
        &self.decisions
    }

    fn idle_losses(&self) -> &[IdleLoss] {
        &self.idle
    }

    fn count(&self) -> Result<u32> {
        Ok(self.gaussians.count(&self.device)?)
    }

    fn sh_degree(&self) -> Option<u32> {
        Some(self.gaussians.model.sh_degree)
    }

    fn splats(&self) -> Result<Splats> {
        Geometry::splats(self)
    }

    fn learned_views(&self) -> Result<Option<LearnedCameras>> {
        Geometry::learned_views(self)
    }

    fn light(&self) -> Result<Option<RunLight>> {
        Ok(None)
    }

    fn preview(&self, cameras: &[&Camera]) -> Result<Vec<Image>> {
        let background = self.settings.geometry.background;
        let tuning = Tuning::for_device(self.device.info());
        let mut renderer = Renderer::new(&self.device, tuning, &self.gaussians, [1, 1], Channels::default())?;
        let mut images = Vec::new();
        for camera in cameras {
            let image = render_view(&mut renderer, &self.gaussians, &camera.in_unit(self.unit), background)?;
            let colors = image.image.chunks_exact(image.channels as usize).flat_map(|p| [p[0], p[1], p[2]]);
            let data = colors.map(|v| v.clamp(0.0, 1.0)).collect();
            images.push(Image { width: image.size[0], height: image.size[1], channels: 3, data });
        }
        Ok(images)
    }

    fn write_results(&self, run: &RunDirectory) -> Result<()> {
        Geometry::splats(self)?.write_ply(&run.path("scene.ply"))?;
        run.write_learned_views(Geometry::learned_views(self)?.as_ref())?;
        if let Some(head) = self.head()? {
            head.save(&run.semantics())?;
        }
        Ok(())
    }

    fn set_timestamps(&mut self, on: bool) -> Result<()> {
        Geometry::set_timestamps(self, on)
    }

    fn take_times(&mut self) -> Vec<PassTime> {
        Geometry::take_times(self)
    }

    fn plan(&mut self) -> Result<Option<&Plan>> {
        Ok(Some(self.executor()?.plan()))
    }
}
