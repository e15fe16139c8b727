//! Implementation of [`Stage`] for the intrinsic stage.

use super::Intrinsic;
use super::log::Figures;
use crate::decision::Decision;
use crate::divergence::RollBack;
use crate::error::Result;
use crate::idle::IdleLoss;
use crate::stage::{Stage, StageEvent};
use sgs_config::Settings;
use sgs_engine::exec::PassTime;
use sgs_engine::graph::Plan;
use sgs_run::{RunDirectory, RunLight, Shading, StageKind, displayed, shaded_scene};
use sgs_scene::{Camera, Image, Splats};
use std::path::Path;

impl Intrinsic {
    /// Trains until `last` steps are finished, and reports them as steps of a stage.
    ///
    /// `of`: the stage, and the number of its steps before these.
    pub(crate) fn train_as(
        &mut self,
        of: (StageKind, u32),
        last: u32,
        events: &mut dyn FnMut(&StageEvent<'_>),
        proceed: &mut dyn FnMut() -> bool,
    ) -> Result<()> {
        let (losses, gaussians) = (self.logged_losses(), self.splats.len() as u32);
        let result = Intrinsic::train(
            self,
            last,
            |report| events(&StageEvent::Step(&Figures { of, report, losses: &losses, gaussians })),
            proceed,
        );
        for decision in &self.decisions[self.reported.min(self.decisions.len())..] {
            events(&StageEvent::Decision(decision));
        }
        self.reported = self.decisions.len();
        result
    }
}

impl Stage for Intrinsic {
    fn kind(&self) -> StageKind {
        StageKind::Intrinsic
    }

    fn step(&self) -> u32 {
        self.done
    }

    fn steps(&self) -> u32 {
        self.settings.intrinsic.steps
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
        self.train_as((StageKind::Intrinsic, 0), last, events, proceed)
    }

    fn save(&self, path: &Path) -> Result<()> {
        Intrinsic::save(self, path)
    }

    fn restore(&mut self, path: &Path) -> Result<()> {
        Intrinsic::restore(self, path)
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
        Intrinsic::roll_back(self, before, step);
        // The log retains the lines of decisions up to this state; later decisions are made again.
        self.reported = self.decisions.len();
    }

    fn lower_rates(&self) -> String {
        format!("--set intrinsic.rates.lights={:.5}", self.settings.intrinsic.rates.lights * 0.1)
    }

    fn decisions(&self) -> &[Decision] {
        &self.decisions
    }

    fn idle_losses(&self) -> &[IdleLoss] {
        &self.idle
    }

    fn count(&self) -> Result<u32> {
        Ok(self.splats.len() as u32)
    }

    fn sh_degree(&self) -> Option<u32> {
        None
    }

    fn splats(&self) -> Result<Splats> {
        Intrinsic::splats(self)
    }

    fn light(&self) -> Result<Option<RunLight>> {
        Intrinsic::light(self).map(Some)
    }

    fn preview(&self, cameras: &[&Camera]) -> Result<Vec<Image>> {
        let background = self.settings.geometry.background;
        let light = Intrinsic::light(self)?;
        let (lights, environment) = (light.lights.as_ref(), light.environment.as_ref());
        let splats = Intrinsic::splats(self)?;
        let scene = shaded_scene(&self.device, &splats, lights, environment, &light.visibility)?;
        let mut shading = Shading::new(&self.device, scene)?;
        cameras.iter().map(|camera| Ok(displayed(&shading.shade(camera)?.radiance(background)))).collect()
    }

    fn write_results(&self, run: &RunDirectory) -> Result<()> {
        self.write(run)
    }

    fn set_timestamps(&mut self, on: bool) -> Result<()> {
        Intrinsic::set_timestamps(self, on)
    }

    fn take_times(&mut self) -> Vec<PassTime> {
        Intrinsic::take_times(self)
    }

    fn plan(&mut self) -> Result<Option<&Plan>> {
        Ok(Some(self.executor()?.executor().plan()))
    }
}
