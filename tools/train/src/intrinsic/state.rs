//! Checkpoints of the intrinsic stage, and what it leaves.

use super::{Intrinsic, LightFile, write_lights};
use crate::checkpoint::Course;
use crate::divergence::HALF;
use crate::error::{Result, TrainError};
use crate::floats::{Floats, Numbers};
use crate::run::RunDirectory;
use crate::settings::VisibilityKind;
use crate::shaded::{RunLight, Texels, Visibility};
use crate::shadows::Rays;
use crate::visibility::VisibilityFile;
use safetensors::{Dtype, SafeTensors};
use sgs_engine::DeviceBuffer;
use sgs_passes::pipeline::IntrinsicStatus;
use sgs_passes::shade::environment::latlong;
use sgs_scene::{Image, Splats};
use std::collections::HashMap;
use std::path::Path;

/// What steps have asked of the surroundings since these moved.
const GATHERED: &str = "environment_gathered";

const FORMAT: &str = "sgs-intrinsic-1";

/// Tensors of what is said of views under other lights, and of the steps at which that was.
const ESTIMATES: &str = "relit_estimates";
const ASKED_AT: &str = "relit_asked_at";

/// What was decided about the model.
const DECISIONS: &str = "decisions";

/// How many levels the visibility field has, where that may be decided.
const LEVELS: &str = "levels";

/// How many texels surroundings have along an edge, where that may be decided.
const TEXELS: &str = "texels";

/// Surroundings as they were after some step, which follows.
const BEFORE: &str = "environment_after_";

/// How often surroundings move, where that may be decided: once in how many steps, since which step, and how often before.
const PACE: &str = "pace";

/// The error of shaded pictures when they were last looked at.
const LAST: &str = "last_look";

/// How many lobes lights have, where that may be decided.
const LOBES: &str = "lobes";

/// Tensors of the visibility field.
const FIELD: [&str; 4] = ["visibility_tables", "visibility_mlp", "visibility_tables_moments", "visibility_mlp_moments"];

impl Intrinsic {
    /// Writes everything that resuming needs.
    ///
    /// # Errors
    /// If the file cannot be written; an earlier one stays whole.
    pub fn save(&self, path: &Path) -> Result<()> {
        let mut values = Vec::new();
        for p in self.parameters.all() {
            values.push((p.name().to_owned(), p.download(&self.device)?));
            values.push((format!("{}_moments", p.name()), p.download_moments(&self.device)?));
        }
        let gains = self.device.download_as(&self.gains, self.light_model.lights as usize)?;
        values.push(("light_gains".to_owned(), gains));
        if let Some(field) = &self.parameters.visibility {
            let [tables, mlp] = field.download(&self.device)?;
            let [table_moments, mlp_moments] = field.download_moments(&self.device)?;
            for (name, v) in FIELD.iter().zip([tables, mlp, table_moments, mlp_moments]) {
                values.push(((*name).to_owned(), v));
            }
        }
        if let Some(s) = &self.seldom {
            values.push((GATHERED.to_owned(), s.kept().download(&self.device)?));
        }
        for (step, texels) in self.remembered() {
            values.push((format!("{BEFORE}{step}"), texels.clone()));
        }
        // What has been said of views, and when: asking again would be about other parameters.
        let mut words = Vec::new();
        if let Some(relit) = &self.relit {
            for (i, buffer) in relit.estimates.iter().enumerate() {
                words.push((format!("{ESTIMATES}{i}"), self.device.download_as(buffer, buffer.bytes() as usize / 4)?));
            }
            words.push((ASKED_AT.to_owned(), relit.asked_at.clone()));
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
            if let Some(last) = a.last {
                // Rust writes as many digits as it takes to read the same number.
                meta.insert(LAST.to_owned(), last.to_string());
            }
            meta.insert(LOBES.to_owned(), self.lobes().to_string());
            if let Some(levels) = self.levels() {
                meta.insert(LEVELS.to_owned(), levels.to_string());
            }
            if let Some(size) = self.environment_size() {
                meta.insert(TEXELS.to_owned(), size.to_string());
            }
            let [step, moves] = self.paced;
            meta.insert(PACE.to_owned(), format!("{} {step} {moves}", self.options.environment_every));
            meta.insert(DECISIONS.to_owned(), serde_json::to_string(self.decisions()).unwrap_or_default());
        }
        let bytes = crate::floats::serialize(tensors, meta).map_err(|e| file(path, e.to_string()))?;
        sgs_scene::atomic_write(path, |f| std::io::Write::write_all(f, &bytes))?;
        Ok(())
    }

    /// Goes on from what [`Intrinsic::save`] wrote.
    ///
    /// # Errors
    /// If the file is damaged or belongs to other settings or splats.
    pub fn restore(&mut self, path: &Path) -> Result<()> {
        let bytes = std::fs::read(path).map_err(|e| file(path, e.to_string()))?;
        let (_, header) =
            SafeTensors::read_metadata(&bytes).map_err(|e| file(path, format!("not a checkpoint: {e}")))?;
        let meta = header.metadata().clone().unwrap_or_default();
        if meta.get("format").map(String::as_str) != Some(FORMAT) {
            return Err(file(path, "not a checkpoint of the intrinsic stage".into()));
        }
        let number = |name: &str| -> Result<u32> {
            let value = meta.get(name).and_then(|s| s.parse().ok());
            value.ok_or_else(|| file(path, format!("the checkpoint does not say its {name}")))
        };
        let (step, splats) = (number("step")?, number("splats")?);
        if splats as usize != self.splats.len() {
            return Err(file(path, format!("it is of {splats} splats, but there are {}", self.splats.len())));
        }
        let tensors = SafeTensors::deserialize(&bytes).map_err(|e| file(path, format!("damaged: {e}")))?;
        let floats = |name: &str, count: usize| -> Result<Vec<f32>> {
            let t = tensors.tensor(name).map_err(|_| file(path, format!("the checkpoint has no \"{name}\"")))?;
            if t.dtype() != Dtype::F32 || t.data().len() != 4 * count {
                return Err(file(path, format!("\"{name}\" does not hold {count} 32-bit floats")));
            }
            let values: Vec<f32> =
                t.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
            if values.iter().any(|v| !v.is_finite()) {
                return Err(file(path, format!("damaged: \"{name}\" holds values that are not finite")));
            }
            Ok(values)
        };
        if self.automatic.is_some() {
            let text = meta.get(DECISIONS).map_or("[]", String::as_str);
            let wrong = |e: serde_json::Error| file(path, format!("damaged: \"{DECISIONS}\": {e}"));
            if !self.take_decisions(serde_json::from_str(text).map_err(wrong)?)? {
                return Err(file(path, "it has parts that have been left out since".into()));
            }
        }
        if let Some(lobes) = meta.get(LOBES).filter(|_| self.automatic.is_some() && self.options.lights.is_some()) {
            let lobes: u32 = lobes
                .parse()
                .ok()
                .filter(|n| (1..=32).contains(n))
                .ok_or_else(|| file(path, format!("damaged: \"{lobes}\" is no number of lobes")))?;
            if lobes != self.lobes() {
                let floats = self.light_model.lights * lobes * self.light_model.row();
                self.set_lobes(lobes, &vec![0.0; floats as usize])?;
            }
        }
        let most = self.parameters.visibility.as_ref().map(|f| f.config().of);
        if let (Some(text), Some(most), true) = (meta.get(LEVELS), most, self.automatic.is_some()) {
            let levels: u32 = text
                .parse()
                .ok()
                .filter(|n| (1..=most).contains(n))
                .ok_or_else(|| file(path, format!("damaged: \"{text}\" is no number of levels")))?;
            if Some(levels) != self.levels() {
                self.set_levels(levels)?;
            }
        }
        if let Some(text) = meta.get(TEXELS).filter(|_| self.automatic.is_some()) {
            let most = self.settings.intrinsic.environment.resolution;
            let size = text.parse().ok().filter(|n: &u32| n.is_power_of_two() && (16..=most).contains(n));
            let damaged = || file(path, format!("damaged: surroundings cannot have \"{text}\" texels along an edge"));
            self.set_texels(size.ok_or_else(damaged)?)?;
        }
        if let Some(text) = meta.get(PACE).filter(|_| self.automatic.is_some()) {
            let numbers: Option<Vec<u32>> = text.split(' ').map(|n| n.parse().ok()).collect();
            let Some(&[every @ 1..=64, since, moves]) = numbers.as_deref() else {
                return Err(file(path, format!("damaged: \"{text}\" does not say how often surroundings move")));
            };
            if since > step || moves > since {
                return Err(file(path, format!("damaged: surroundings cannot move as in \"{text}\"")));
            }
            self.set_pace(every, since, moves)?;
        }
        // But for what has been decided, everything is read before anything is changed.
        let course = Course::read(path, &meta)?;
        let mut read = Vec::new();
        for p in self.parameters.all() {
            let count = p.floats() as usize;
            read.push((floats(p.name(), count)?, floats(&format!("{}_moments", p.name()), 2 * count)?));
        }
        let gains = floats("light_gains", self.light_model.lights as usize)?;
        // Where texels moved with every step, nothing is left over.
        let gathered = match &self.seldom {
            Some(s) if tensors.tensor(GATHERED).is_ok() => Some(floats(GATHERED, s.kept().floats())?),
            Some(s) => Some(vec![0.0; s.kept().floats()]),
            None => None,
        };
        let last = meta.get(LAST).and_then(|text| text.parse::<f64>().ok()).filter(|last| *last >= 0.0);
        let mut before = Vec::new();
        if let (Some(texels), true) = (&self.parameters.environment, self.automatic.is_some()) {
            for name in tensors.names() {
                if let Some(taken) = name.strip_prefix(BEFORE).and_then(|n| n.parse().ok()) {
                    before.push((taken, floats(name, texels.floats() as usize)?));
                }
            }
        }
        // Of a run without a provider there is nothing, and everything is asked anew.
        let mut estimates = None;
        if let (Some(relit), true) = (&self.relit, tensors.tensor(ASKED_AT).is_ok()) {
            let words = |name: &str, count: usize| -> Result<Vec<u32>> {
                let t = tensors.tensor(name).map_err(|_| file(path, format!("the checkpoint has no \"{name}\"")))?;
                if t.dtype() != Dtype::U32 || t.data().len() != 4 * count {
                    return Err(file(path, format!("\"{name}\" does not hold {count} 32-bit words")));
                }
                Ok(t.data().chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect())
            };
            let of = |(i, b): (usize, &DeviceBuffer)| words(&format!("{ESTIMATES}{i}"), b.bytes() as usize / 4);
            let all = relit.estimates.iter().enumerate().map(of).collect::<Result<Vec<_>>>()?;
            estimates = Some((all, words(ASKED_AT, relit.asked_at.len())?));
        }
        let field = match &self.parameters.visibility {
            Some(f) => {
                let (table, mlp) = (2 * f.config().entries() as usize, f.config().weights());
                let sizes = [table, mlp, 2 * table, 2 * mlp];
                let read =
                    FIELD.iter().zip(sizes).map(|(name, size)| floats(name, size)).collect::<Result<Vec<_>>>()?;
                Some((f, read))
            }
            None => None,
        };
        if let Some((f, read)) = &field {
            f.upload(&self.device, &read[0], &read[1])?;
            f.upload_moments(&self.device, [&read[2], &read[3]])?;
        }
        for (p, (values, moments)) in self.parameters.all().into_iter().zip(&read) {
            p.upload(&self.device, values)?;
            p.upload_moments(&self.device, moments)?;
        }
        self.device.upload(&self.gains, 0, bytemuck::cast_slice(&gains))?;
        if let (Some(relit), Some((all, asked_at))) = (&mut self.relit, estimates) {
            for (buffer, words) in relit.estimates.iter().zip(&all) {
                self.device.upload(buffer, 0, bytemuck::cast_slice(words))?;
            }
            relit.asked_at = asked_at;
        }
        if let (Some(s), Some(gathered)) = (&self.seldom, &gathered) {
            s.kept().upload(&self.device, gathered)?;
        }
        if let Some(a) = &mut self.automatic {
            before.sort_by_key(|b| b.0);
            a.before = before;
            a.last = last;
        }
        self.submitted = step;
        self.done = step;
        self.watch.restore(&course.watch);
        // What is counted on the device counts from the start again; graphs are made when they are due.
        self.status = IntrinsicStatus::new(&self.device)?;
        self.set_rates(HALF.powi(course.roll_backs.len() as i32));
        self.roll_backs = course.roll_backs;
        self.keep_environment()
    }

    /// The splats with their materials.
    ///
    /// # Errors
    /// If the device fails.
    pub fn splats(&self) -> Result<Splats> {
        let mut splats = self.splats.clone();
        let albedo = self.parameters.albedo.download(&self.device)?;
        splats.albedo = Some(albedo.as_chunks::<3>().0.to_vec());
        splats.roughness = Some(self.parameters.roughness.download(&self.device)?);
        splats.metallic = match &self.parameters.metallic {
            Some(m) => Some(m.download(&self.device)?),
            None => None,
        };
        if let Some(n) = &self.parameters.normals {
            splats.normals = Some(n.download(&self.device)?.as_chunks::<3>().0.to_vec());
        }
        Ok(splats)
    }

    /// The lights, if there are any.
    ///
    /// # Errors
    /// If the device fails.
    pub fn lights(&self) -> Result<Option<LightFile>> {
        let Some([positions, lobes]) = &self.parameters.lights else { return Ok(None) };
        let normalizer = self.options.lights.map_or(0.0, |l| l.1);
        let gains: Vec<f32> = self.device.download_as(&self.gains, self.light_model.lights as usize)?;
        let (positions, lobes) = (positions.download(&self.device)?, lobes.download(&self.device)?);
        Ok(Some(LightFile::of(&self.light_model, normalizer, &positions, &lobes, &gains)))
    }

    /// All light as it is by now, to shade with.
    ///
    /// # Errors
    /// If the device fails.
    pub fn light(&self) -> Result<RunLight> {
        let lights = self.lights()?;
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

    /// Writes `scene.ply`, `lights.json`, `environment.exr` and `visibility.safetensors` of a run; what is not modeled is removed.
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
                let [low, high] = self.bounds;
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

/// What an earlier run may have left.
fn remove(path: &Path) -> Result<()> {
    match std::fs::remove_file(path) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(file(path, format!("cannot be removed: {e}"))),
        _ => Ok(()),
    }
}

fn file(path: &Path, reason: String) -> TrainError {
    TrainError::File { path: path.to_owned(), reason }
}
