//! Implementation of [`Stage`] for the transport stage.

use super::saved::{Saved, check, invalid};
use super::{Figures, Transport};
use crate::decision::Decision;
use crate::divergence::RollBack;
use crate::error::Result;
use crate::idle::IdleLoss;
use crate::stage::{RoomFit, Stage, StageEvent};
use sgs_config::Settings;
use sgs_engine::exec::PassTime;
use sgs_engine::graph::Plan;
use sgs_passes::Tuning;
use sgs_passes::pipeline::Renderer;
use sgs_passes::scene::{Gaussians, Model};
use sgs_passes::splat::Channels;
use sgs_run::{RunDirectory, RunLight, StageKind, gaussian_data, render_view, write_emitters};
use sgs_scene::{Camera, Image, Splats};
use std::path::Path;

impl Stage for Transport {
    fn kind(&self) -> StageKind {
        StageKind::Transport
    }

    fn step(&self) -> u32 {
        u32::from(self.fitted.is_some())
    }

    fn steps(&self) -> u32 {
        1
    }

    fn checkpoint_interval(&self) -> u32 {
        0
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
        if last == 0 || self.fitted.is_some() || !proceed() {
            return Ok(());
        }
        let fitted = self.fit()?;
        check(&fitted, self.splats.len()).map_err(invalid)?;
        let (psnr, emitters) = (fitted.psnr, fitted.emitters.emitters.len() as u32);
        self.fitted = Some(fitted);
        events(&StageEvent::Step(&Figures { psnr, emitters, gaussians: self.splats.len() as u32 }));
        Ok(())
    }

    fn save(&self, path: &Path) -> Result<()> {
        Saved::write(path, self.fitted.as_ref())
    }

    fn restore(&mut self, path: &Path) -> Result<()> {
        self.fitted = Saved::read(path, self.splats.len())?.fitted;
        Ok(())
    }

    fn set_candidate(&mut self) -> bool {
        false
    }

    fn is_candidate(&self) -> bool {
        false
    }

    fn validate_candidate(&mut self) -> bool {
        false
    }

    fn roll_backs(&self) -> &[RollBack] {
        &[]
    }

    fn roll_back(&mut self, _before: &[RollBack], _step: u32) {}

    fn lower_rates(&self) -> String {
        String::new()
    }

    fn decisions(&self) -> &[Decision] {
        &[]
    }

    fn idle_losses(&self) -> &[IdleLoss] {
        &[]
    }

    fn count(&self) -> Result<u32> {
        Ok(self.splats.len() as u32)
    }

    fn sh_degree(&self) -> Option<u32> {
        None
    }

    fn splats(&self) -> Result<Splats> {
        let emitters = self.fitted.as_ref().map(|room| room.of_gaussians.clone());
        Ok(Splats { emitters, ..self.splats.clone() })
    }

    fn light(&self) -> Result<Option<RunLight>> {
        Ok(None)
    }

    fn room(&self) -> Option<RoomFit> {
        let of = |room: &sgs_transport::FittedRoom| RoomFit {
            psnr: room.psnr,
            emitters: room.emitters.emitters.len() as u32,
        };
        self.fitted.as_ref().map(of)
    }

    fn preview(&self, cameras: &[&Camera]) -> Result<Vec<Image>> {
        let background = self.settings.geometry.background;
        let (unit, tuning) = (self.scene.unit(), Tuning::for_device(self.device.info()));
        let splats = self.splats.clone().in_unit(unit);
        let model = Model { sh_degree: splats.sh_degree() as u32, ..Model::default() };
        let gaussians = Gaussians::with(&self.device, model, splats.len() as u32, false, false)?;
        gaussians.upload(&self.device, &gaussian_data(&splats, model))?;
        let mut renderer = Renderer::new(&self.device, tuning, &gaussians, [1, 1], Channels::default())?;
        let mut images = Vec::new();
        for camera in cameras {
            let image = render_view(&mut renderer, &gaussians, &camera.in_unit(unit), background)?;
            let colors = image.image.chunks_exact(image.channels as usize).flat_map(|p| [p[0], p[1], p[2]]);
            let data = colors.map(|v| v.clamp(0.0, 1.0)).collect();
            images.push(Image { width: image.size[0], height: image.size[1], channels: 3, data });
        }
        Ok(images)
    }

    fn write_results(&self, run: &RunDirectory) -> Result<()> {
        let Some(room) = &self.fitted else { return Ok(()) };
        Stage::splats(self)?.write_ply(&run.path("scene.ply"))?;
        Ok(write_emitters(&run.emitters(), &room.emitters)?)
    }

    fn set_timestamps(&mut self, _on: bool) -> Result<()> {
        Ok(())
    }

    fn take_times(&mut self) -> Vec<PassTime> {
        Vec::new()
    }

    fn plan(&mut self) -> Result<Option<&Plan>> {
        Ok(None)
    }
}
