//! Implementation of [`Stage`] for the transport stage.

use super::saved::{Saved, check, invalid};
use super::{Figures, Transport};
use crate::decision::Decision;
use crate::divergence::RollBack;
use crate::error::{Result, error};
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
        if self.is_left_out() {
            return self.steps();
        }
        u32::from(self.fitted.is_some()) + self.training.as_ref().map_or(0, |t| t.step())
    }

    fn steps(&self) -> u32 {
        1 + self.training_steps()
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
        if last == 0 || !proceed() {
            return Ok(());
        }
        if self.fitted.is_none() {
            let fitted = self.fit()?;
            check(&fitted, self.splats.len()).map_err(invalid)?;
            let (psnr, emitters) = (fitted.psnr, fitted.emitters.emitters.len() as u32);
            self.set_fitted(Some(fitted));
            events(&StageEvent::Step(&Figures { psnr, emitters, gaussians: self.splats.len() as u32 }));
            self.decisions.iter().for_each(|decision| events(&StageEvent::Decision(decision)));
        }
        if last == 1 || self.is_left_out() {
            return Ok(());
        }
        self.prepare_training()?;
        match &mut self.training {
            Some(training) => training.train_as((StageKind::Transport, 1), last - 1, events, proceed),
            None => Ok(()),
        }
    }

    fn save(&self, path: &Path) -> Result<()> {
        let training = match self.training.as_ref().filter(|t| t.step() > 0) {
            Some(training) => Some((training.step(), training.checkpoint(path)?)),
            None => None,
        };
        Saved::write(path, self.fitted.as_ref(), training)
    }

    fn restore(&mut self, path: &Path) -> Result<()> {
        let saved = Saved::read(path, self.splats.len())?;
        self.training = None;
        self.set_fitted(saved.fitted);
        if let Some(bytes) = &saved.training {
            self.prepare_training()?;
            if let Some(training) = &mut self.training {
                training.restore_from(path, bytes)?;
                if training.step() + 1 != saved.step {
                    let (found, step) = (training.step() + 1, saved.step);
                    return Err(error(
                        path,
                        format!("damaged: it is of step {step}, but its parameters are of step {found}"),
                    ));
                }
            }
        }
        Ok(())
    }

    fn set_candidate(&mut self) -> bool {
        self.training.as_mut().is_some_and(Stage::set_candidate)
    }

    fn is_candidate(&self) -> bool {
        self.training.as_ref().is_some_and(Stage::is_candidate)
    }

    fn validate_candidate(&mut self) -> bool {
        self.training.as_mut().is_some_and(Stage::validate_candidate)
    }

    fn roll_backs(&self) -> &[RollBack] {
        self.training.as_ref().map_or(&[], |t| t.roll_backs())
    }

    fn roll_back(&mut self, before: &[RollBack], step: u32) {
        if let Some(training) = &mut self.training {
            Stage::roll_back(training, before, step - 1);
        }
    }

    fn lower_rates(&self) -> String {
        "--set transport.steps=0".to_owned()
    }

    fn decisions(&self) -> &[Decision] {
        &self.decisions
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
        let Some(room) = self.fitted.as_ref().filter(|_| !self.is_left_out()) else { return Ok(self.splats.clone()) };
        let emitters = Some(room.of_gaussians.clone());
        let trained = match &self.training {
            Some(training) => training.splats()?,
            None => self.start.clone(),
        };
        // Only materials and gains are trained; the rest stays bit by bit. Geometry may lack normals.
        let Splats { normals, albedo, roughness, metallic, light_gains, .. } = trained;
        let normals = self.splats.normals.clone().or(normals);
        Ok(Splats { normals, albedo, roughness, metallic, light_gains, emitters, ..self.splats.clone() })
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
        let model = Model { sh_degree: splats.sh_degree() as u32, mip: splats.antialiased, ..Model::default() };
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
        let Some(room) = self.fitted.as_ref().filter(|_| !self.is_left_out()) else { return Ok(()) };
        Stage::splats(self)?.write_ply(&run.path("scene.ply"))?;
        let mut file = room.emitters.clone();
        if let Some(light) = self.training.as_ref().map(|t| t.room_light()).transpose()?.flatten() {
            file.emitters.iter_mut().zip(&light.colors).for_each(|(emitter, color)| emitter.color = *color);
            file.enclosure.albedo = light.albedo;
        }
        Ok(write_emitters(&run.emitters(), &file)?)
    }

    fn set_timestamps(&mut self, on: bool) -> Result<()> {
        self.training.as_mut().map_or(Ok(()), |t| Stage::set_timestamps(t, on))
    }

    fn take_times(&mut self) -> Vec<PassTime> {
        self.training.as_mut().map_or_else(Vec::new, Stage::take_times)
    }

    fn plan(&mut self) -> Result<Option<&Plan>> {
        self.training.as_mut().map_or(Ok(None), Stage::plan)
    }
}
