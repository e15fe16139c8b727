//! Checkpoints and results of the intrinsic stage.

use super::Intrinsic;
use super::automatic::Remembered;
use super::saved::{
    BEFORE, DECISIONS, ESTIMATES, FIELD, FORMAT, GAINS, GATHERED, LAST, LEVELS, LOBES, RECENT, REQUESTED_AT, Saved,
    TEXELS, UPDATE_INTERVAL, UpdateInterval,
};
use crate::course::Course;
use crate::divergence::RollBack;
use crate::error::Result;
use crate::error::error;
use sgs_config::VisibilityKind;
use sgs_passes::pipeline::{IntrinsicStatus, LightTrainables};
use sgs_passes::shade::ALBEDO_RANGE;
use sgs_passes::shade::environment::latlong;
use sgs_run::floats::Floats;
use sgs_run::floats::Numbers;
use sgs_run::materials::in_range;
use sgs_run::{LightFile, Rays, RunDirectory, RunLight, Texels, Visibility, VisibilityFile, remove, write_lights};
use sgs_scene::{Image, Splats};
use sgs_transport::TrainingRoom;
use std::collections::HashMap;
use std::path::Path;

/// Tensors of the visibility field.
struct FieldValues {
    tables: Vec<f32>,
    layers: Vec<f32>,
    table_moments: Vec<f32>,
    layer_moments: Vec<f32>,
}

/// Trained light of a room.
pub(crate) struct RoomLight {
    /// Color of each light.
    pub colors: Vec<[f32; 3]>,
    /// Albedo of the faces of the enclosure.
    pub albedo: [[f32; 3]; 6],
}

/// Contents of a checkpoint, in the sizes of the stage that continues from it.
struct Values {
    /// Values and moments of the parameters.
    /// The order is that of [`sgs_passes::pipeline::IntrinsicParameters::all`].
    parameters: Vec<[Vec<f32>; 2]>,
    gains: Vec<f32>,
    field: Option<FieldValues>,
    gathered: Option<Vec<f32>>,
    before: Vec<Remembered>,
    estimates: Option<(Vec<Vec<u32>>, Vec<u32>)>,
    recent: [f32; 4],
}

impl Intrinsic {
    /// Writes a checkpoint with everything that resuming needs.
    ///
    /// # Errors
    /// If the file cannot be written; an existing file then stays intact.
    pub fn save(&self, path: &Path) -> Result<()> {
        let bytes = self.checkpoint(path)?;
        sgs_scene::atomic_write(path, |f| std::io::Write::write_all(f, &bytes))?;
        Ok(())
    }

    /// Returns the contents of a checkpoint. An error names `path`.
    ///
    /// # Errors
    /// If the device fails.
    pub(crate) fn checkpoint(&self, path: &Path) -> Result<Vec<u8>> {
        let mut values = Vec::new();
        for p in self.parameters.all() {
            values.push((p.name().to_owned(), p.download(&self.device)?));
            values.push((format!("{}_moments", p.name()), p.download_moments(&self.device)?));
        }
        let gains = self.device.download_as(&self.gains, self.light_model.lights as usize)?;
        values.push((GAINS.to_owned(), gains));
        let smoothness = self.status.smoothness(&self.device)?;
        values.push((RECENT.to_owned(), [&self.recent[..], &[smoothness]].concat()));
        if let Some(field) = &self.parameters.visibility {
            let [tables, mlp] = field.download(&self.device)?;
            let [table_moments, mlp_moments] = field.download_moments(&self.device)?;
            for (name, v) in FIELD.iter().zip([tables, mlp, table_moments, mlp_moments]) {
                values.push(((*name).to_owned(), v));
            }
        }
        if let Some(s) = &self.environment_updates {
            values.push((GATHERED.to_owned(), s.stored().download(&self.device)?));
        }
        for (step, texels) in self.remembered().iter().filter(|(step, _)| *step <= self.done) {
            values.push((format!("{BEFORE}{step}"), texels.clone()));
        }
        // Stores the answers of the provider and their steps: a new request would see other parameters.
        let mut words = Vec::new();
        if let Some(relit) = &self.relit {
            for kind in 0..relit.kinds() {
                words.push((format!("{ESTIMATES}{kind}"), relit.download(&self.device, kind)?));
            }
            words.push((REQUESTED_AT.to_owned(), relit.requested_at.clone()));
        }
        let tensors = values.iter().map(|(name, v)| (name.clone(), Numbers::Floats(Floats(v, vec![v.len()]))));
        let words = words.iter().map(|(name, v)| (name.clone(), Numbers::Words(v, vec![v.len()])));
        let tensors: Vec<_> = tensors.chain(words).collect();
        let mut meta = HashMap::from([
            ("format".to_owned(), FORMAT.to_owned()),
            ("step".to_owned(), self.done.to_string()),
            ("splats".to_owned(), self.splats.len().to_string()),
        ]);
        Course { watch: self.watch.save(), roll_backs: self.roll_backs.clone() }.write(&mut meta);
        if let Some(a) = &self.automatic {
            if let Some(last) = a.last.filter(|last| last.is_finite()) {
                // Rust writes as many digits as reading the same number requires.
                meta.insert(LAST.to_owned(), last.to_string());
            }
            meta.insert(LOBES.to_owned(), self.lobes().to_string());
            if let Some(levels) = self.levels() {
                meta.insert(LEVELS.to_owned(), levels.to_string());
            }
            if let Some(size) = self.environment_size() {
                meta.insert(TEXELS.to_owned(), size.to_string());
            }
            let [step, moves] = self.update_intervals;
            meta.insert(UPDATE_INTERVAL.to_owned(), format!("{} {step} {moves}", self.options.environment_every));
        }
        meta.insert(DECISIONS.to_owned(), serde_json::to_string(self.decisions()).unwrap_or_default());
        sgs_run::floats::serialize(tensors, meta).map_err(|e| error(path, e.to_string()))
    }

    /// Continues from a checkpoint of [`Intrinsic::save`].
    ///
    /// # Errors
    /// If the file is damaged or belongs to other settings or splats.
    pub fn restore(&mut self, path: &Path) -> Result<()> {
        let bytes = std::fs::read(path).map_err(|e| error(path, e.to_string()))?;
        self.restore_from(path, &bytes)
    }

    /// Continues from the contents of a checkpoint. An error names `path`.
    ///
    /// # Errors
    /// As [`Intrinsic::restore`].
    pub(crate) fn restore_from(&mut self, path: &Path, bytes: &[u8]) -> Result<()> {
        let saved = Saved::read(path, bytes)?;
        if saved.splats as usize != self.splats.len() {
            let (has, are) = (saved.splats, self.splats.len());
            return Err(saved.refused(format!("it is of {has} splats, but there are {are}")));
        }
        if self.automatic.is_some() {
            self.take_over(&saved)?;
        } else if !saved.decisions.is_empty() {
            self.decisions.clone_from(&saved.decisions);
        }
        // Apart from the decisions, everything is read before anything changes.
        let values = self.values_of(&saved)?;
        let [cross_view, relight, own_prior, smoothness] = values.recent;
        self.recent = [cross_view, relight, own_prior];
        self.put(values)?;
        if let Some(a) = &mut self.automatic {
            a.last = saved.last;
        }
        self.submitted = saved.step;
        self.done = saved.step;
        self.reported = self.decisions.len();
        self.watch.restore(&saved.course.watch);
        // Device counters restart from zero; graphs are built on first use.
        self.status = IntrinsicStatus::new(&self.device)?;
        self.status.set_smoothness(&self.device, smoothness)?;
        self.set_rates(RollBack::rates_after(saved.course.roll_backs.len()));
        self.roll_backs = saved.course.roll_backs;
        self.keep_environment()
    }

    /// Applies the model decisions of a checkpoint.
    fn take_over(&mut self, saved: &Saved) -> Result<()> {
        if !self.take_decisions(saved.decisions.clone())? {
            return Err(saved.refused("it has parts that have been left out since".into()));
        }
        if let Some(lobes) = saved.lobes.filter(|lobes| self.options.lights.is_some() && *lobes != self.lobes()) {
            let floats = self.light_model.lights * lobes * self.light_model.row();
            self.set_lobes(lobes, &vec![0.0; floats as usize])?;
        }
        let most = self.parameters.visibility.as_ref().map(|f| f.config().of);
        if let (Some(levels), Some(most)) = (saved.levels, most) {
            if levels > most {
                return Err(saved.refused(format!("damaged: there are {levels} levels, of {most}")));
            }
            if Some(levels) != self.levels() {
                self.set_levels(levels)?;
            }
        }
        if let Some(size) = saved.texels {
            if size > self.settings.intrinsic.environment.resolution {
                return Err(saved.no_texels(size));
            }
            self.set_texels(size)?;
        }
        match saved.update_interval {
            Some(UpdateInterval { every, since, moves }) => self.set_update_interval(every, since, moves),
            None => Ok(()),
        }
    }

    /// Reads the contents of a checkpoint for the current model.
    fn values_of(&self, saved: &Saved) -> Result<Values> {
        let mut parameters = Vec::new();
        for p in self.parameters.all() {
            let count = p.floats() as usize;
            parameters.push([saved.floats(p.name(), count)?, saved.moments(&format!("{}_moments", p.name()), count)?]);
        }
        let field = match &self.parameters.visibility {
            Some(f) => {
                let (table, mlp) = (2 * f.config().entries() as usize, f.config().weights());
                let [tables, layers, table_moments, layer_moments] = FIELD;
                Some(FieldValues {
                    tables: saved.floats(tables, table)?,
                    layers: saved.floats(layers, mlp)?,
                    table_moments: saved.moments(table_moments, table)?,
                    layer_moments: saved.moments(layer_moments, mlp)?,
                })
            }
            None => None,
        };
        // With an update of the texels in every step, no gradient is accumulated.
        let gathered = match &self.environment_updates {
            Some(s) if saved.has(GATHERED) => Some(saved.floats(GATHERED, s.stored().floats())?),
            Some(s) => Some(vec![0.0; s.stored().floats()]),
            None => None,
        };
        let before = match &self.parameters.environment {
            Some(texels) if self.automatic.is_some() => saved.before(texels.floats() as usize)?,
            _ => Vec::new(),
        };
        // A checkpoint of a run without a provider has no estimates; all are requested again.
        let estimates = match &self.relit {
            Some(relit) if saved.has(REQUESTED_AT) => {
                let words = |kind| saved.words(&format!("{ESTIMATES}{kind}"), relit.all_pixels());
                let all = (0..relit.kinds()).map(words).collect::<Result<Vec<_>>>()?;
                Some((all, saved.requested_at(relit.requested_at.len())?))
            }
            _ => None,
        };
        let gains = saved.floats(GAINS, self.light_model.lights as usize)?;
        let recent = match saved.has(RECENT) {
            true => <[f32; 4]>::try_from(saved.floats(RECENT, 4)?).unwrap_or([-1.0; 4]),
            false => [-1.0, -1.0, -1.0, 0.0],
        };
        Ok(Values { parameters, gains, field, gathered, before, estimates, recent })
    }

    /// Uploads the contents of a checkpoint.
    fn put(&mut self, values: Values) -> Result<()> {
        if let (Some(field), Some(v)) = (&self.parameters.visibility, &values.field) {
            field.upload(&self.device, &v.tables, &v.layers)?;
            field.upload_moments(&self.device, [&v.table_moments, &v.layer_moments])?;
        }
        for (p, [values, moments]) in self.parameters.all().into_iter().zip(&values.parameters) {
            p.upload(&self.device, values)?;
            p.upload_moments(&self.device, moments)?;
        }
        self.device.upload(&self.gains, 0, bytemuck::cast_slice(&values.gains))?;
        if let (Some(relit), Some((all, requested_at))) = (&mut self.relit, values.estimates) {
            for (kind, words) in all.iter().enumerate() {
                relit.upload(&self.device, kind, words)?;
            }
            relit.requested_at = requested_at;
        }
        if let (Some(s), Some(gathered)) = (&self.environment_updates, &values.gathered) {
            s.stored().upload(&self.device, gathered)?;
        }
        if let Some(a) = &mut self.automatic {
            a.before = values.before;
        }
        Ok(())
    }

    /// Returns the splats with their materials.
    ///
    /// # Errors
    /// If the device fails.
    pub fn splats(&self) -> Result<Splats> {
        Ok(self.scaled_splats()?.in_unit(self.unit.inverse()))
    }

    /// Returns the splats with their materials, in the device's unit.
    pub(super) fn scaled_splats(&self) -> Result<Splats> {
        let mut splats = self.splats.clone();
        let albedo = self.parameters.albedo.download(&self.device)?;
        let albedo = in_range(albedo, self.options.albedo_range, ALBEDO_RANGE);
        splats.albedo = Some(albedo.as_chunks::<3>().0.to_vec());
        splats.roughness = Some(self.parameters.roughness.download(&self.device)?);
        splats.metallic = match &self.parameters.metallic {
            Some(m) => Some(m.download(&self.device)?),
            None => None,
        };
        let trains_gains = self.options.transport.is_some_and(|t| t.gain_pull.is_some());
        if let Some(transport) = self.parameters.transport.as_ref().filter(|_| trains_gains) {
            let gains = transport.log_gains.download(&self.device)?;
            splats.light_gains = Some(gains.into_iter().map(f32::exp).collect());
        }
        if let Some(n) = &self.parameters.normals {
            splats.normals = Some(n.download(&self.device)?.as_chunks::<3>().0.to_vec());
        }
        Ok(splats)
    }

    /// Returns the colors of a room's lights and the albedo of its enclosure.
    ///
    /// # Errors
    /// If the device fails.
    pub(crate) fn room_light(&self) -> Result<Option<RoomLight>> {
        let Some(t) = &self.parameters.transport else { return Ok(None) };
        let colors = TrainingRoom::colors(&t.log_colors.download(&self.device)?);
        let faces = TrainingRoom::albedo(&t.enclosure.download(&self.device)?);
        let albedo = std::array::from_fn(|i| faces.get(i).copied().unwrap_or([0.5; 3]));
        Ok(Some(RoomLight { colors, albedo }))
    }

    /// Returns the lights, if there are any.
    ///
    /// # Errors
    /// If the device fails.
    pub fn lights(&self) -> Result<Option<LightFile>> {
        Ok(self.scaled_lights()?.map(|lights| lights.in_unit(self.unit.inverse())))
    }

    /// Returns the lights in the device's unit.
    pub(super) fn scaled_lights(&self) -> Result<Option<LightFile>> {
        let Some(LightTrainables { positions, lobes }) = &self.parameters.lights else { return Ok(None) };
        let normalizer = self.options.lights.map_or(0.0, |l| l.1);
        let gains: Vec<f32> = self.device.download_as(&self.gains, self.light_model.lights as usize)?;
        let (positions, lobes) = (positions.download(&self.device)?, lobes.download(&self.device)?);
        Ok(Some(LightFile::of(&self.light_model, normalizer, &positions, &lobes, &gains)))
    }

    /// Returns all current light, for shading.
    ///
    /// # Errors
    /// If the device fails.
    pub fn light(&self) -> Result<RunLight> {
        let mut light = self.scaled_light()?;
        let back = self.unit.inverse();
        light.lights = light.lights.map(|lights| lights.in_unit(back));
        if let Visibility::Learned(field) = &mut light.visibility {
            (field.low, field.high) = (back.place(field.low), back.place(field.high));
        }
        Ok(light)
    }

    /// Returns all current light in the device's unit.
    pub(super) fn scaled_light(&self) -> Result<RunLight> {
        let lights = self.scaled_lights()?;
        let environment = match (&self.parameters.environment, &self.environment) {
            (Some(texels), Some((e, _))) => Some(Texels { size: e.size(), data: texels.download(&self.device)? }),
            _ => None,
        };
        let v = &self.required.intrinsic.visibility;
        let visibility = match &self.parameters.visibility {
            Some(field) => {
                let [tables, mlp] = field.download(&self.device)?;
                let [low, high] = self.bounds;
                Visibility::Learned(Box::new(VisibilityFile { config: *field.config(), low, high, tables, mlp }))
            }
            None if v.kind == VisibilityKind::Traced && lights.is_some() => Visibility::Traced(Rays::of(v)),
            None => Visibility::None,
        };
        Ok(RunLight { lights, environment, visibility })
    }

    /// Writes the result files of the stage into a run directory.
    /// The files are `scene.ply`, `lights.json`, `environment.exr` and `visibility.safetensors`. Removes the files of
    /// components that are not modeled.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn write(&self, run: &RunDirectory) -> Result<()> {
        self.splats()?.write_ply(&run.path("scene.ply"))?;
        let lights = run.path("lights.json");
        match self.lights()? {
            Some(file) => write_lights(&lights, &file)?,
            None => remove(&lights)?,
        }
        let visibility = run.path("visibility.safetensors");
        match &self.parameters.visibility {
            Some(field) => {
                let [tables, mlp] = field.download(&self.device)?;
                let [low, high] = self.bounds();
                VisibilityFile { config: *field.config(), low, high, tables, mlp }.save(&visibility)?;
            }
            None => remove(&visibility)?,
        }
        let exr = run.path("environment.exr");
        match (&self.parameters.environment, &self.environment) {
            (Some(texels), Some((e, _))) => {
                let [width, height] = latlong::SIZE;
                let data = latlong::from_cube(&texels.download(&self.device)?, e.size(), latlong::SIZE);
                let image = Image { width, height, channels: 3, data };
                sgs_scene::write_environment(&exr, &image)?;
            }
            _ => remove(&exr)?,
        }
        Ok(())
    }
}
