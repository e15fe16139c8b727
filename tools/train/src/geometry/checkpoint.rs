//! Checkpoint of the geometry stage in one safetensors file. Parameters, moments, statistics, and the step.
//!
//! Guarantees: the file is written under another name and renamed, so that a full disk or a killed process loses no
//! earlier checkpoint.

use super::{Bands, Growth};
use crate::course::{Course, json, wrong_moments};
use crate::decision::Decision;
use crate::error::{Result, error};
use safetensors::{Dtype, SafeTensors};
use sgs_config::Backward;
use sgs_passes::pipeline::LearnedView;
use sgs_passes::scene::{AUGMENTED, EMBEDDING, GaussianData, Group, Model, STATISTICS};
use sgs_run::floats::Floats;
use std::collections::HashMap;
use std::path::Path;

/// State that resuming starts from.
pub(crate) struct State {
    pub step: u32,
    /// Capacity for Gaussians. Part of the state, because densification stops at the capacity.
    pub capacity: u32,
    pub parameters: GaussianData,
    pub moments: GaussianData,
    pub statistics: Vec<f32>,
    /// Semantic decoder, where the Gaussians have features.
    pub decoder: Option<DecoderValues>,
    /// What was learned of each training view; empty if nothing is.
    pub views: Vec<LearnedView>,
    /// Progress of the training besides its tensors.
    pub course: Course,
    /// State of the search for the number of spherical-harmonics bands.
    pub bands: Option<Bands>,
    /// Decisions about the model.
    pub decisions: Vec<Decision>,
    /// State of growth.
    pub growth: Growth,
    /// Backward kernel of the next step; absent while `auto` has not chosen one. Older checkpoints lack it.
    pub backward: Option<Backward>,
    /// Groups of parameters.
    pub model: Model,
}

/// Semantic decoder and the state of its optimizer.
pub(crate) struct DecoderValues {
    pub parameters: Vec<f32>,
    pub moments: Vec<f32>,
}

impl State {
    fn tensors(&self, model: Model) -> Vec<(String, Floats<'_>)> {
        let count = self.parameters.len();
        let mut tensors = Vec::new();
        for group in model.groups() {
            let width = group.width() as usize;
            let (name, parameters, moments) = (group.name(), &self.parameters, &self.moments);
            tensors.push((name.to_owned(), Floats(parameters.group(group), vec![count, width])));
            tensors.push((format!("{name}_moments"), Floats(moments.group(group), vec![count, width, 2])));
        }
        let statistics = &self.statistics;
        tensors.push(("statistics".to_owned(), Floats(statistics, vec![count, statistics.len() / count.max(1)])));
        if let Some(DecoderValues { parameters, moments }) = &self.decoder {
            tensors.push(("decoder".to_owned(), Floats(parameters, vec![EMBEDDING, AUGMENTED])));
            tensors.push(("decoder_moments".to_owned(), Floats(moments, vec![EMBEDDING, AUGMENTED, 2])));
        }
        if !self.views.is_empty() {
            let width = size_of::<LearnedView>() / 4;
            tensors
                .push(("views".to_owned(), Floats(bytemuck::cast_slice(&self.views), vec![self.views.len(), width])));
        }
        tensors
    }
}

pub(crate) fn save(path: &Path, state: &State) -> Result<()> {
    let mut meta = HashMap::from([
        ("format".to_owned(), "sgs-geometry-1".to_owned()),
        ("step".to_owned(), state.step.to_string()),
        ("capacity".to_owned(), state.capacity.to_string()),
    ]);
    state.course.write(&mut meta);
    if let Some(bands) = &state.bands {
        meta.insert("bands".to_owned(), serde_json::to_string(bands).unwrap_or_default());
    }
    if !state.decisions.is_empty() {
        meta.insert("decisions".to_owned(), serde_json::to_string(&state.decisions).unwrap_or_default());
    }
    meta.insert("growth".to_owned(), serde_json::to_string(&state.growth).unwrap_or_default());
    if let Some(backward) = state.backward {
        meta.insert("backward".to_owned(), serde_json::to_string(&backward).unwrap_or_default());
    }
    let tensors = state.tensors(state.model);
    let bytes = sgs_run::floats::serialize(tensors, meta).map_err(|e| error(path, e.to_string()))?;
    sgs_scene::atomic_write(path, |f| std::io::Write::write_all(f, &bytes))?;
    Ok(())
}

/// Reads a checkpoint of a model. With `any_degree`, accepts any number of spherical-harmonics bands. `views` is the number of
/// views of which something is learned; the lens follows them.
pub(crate) fn load(path: &Path, mut model: Model, any_degree: bool, views: Option<u32>) -> Result<State> {
    let bytes = std::fs::read(path).map_err(|e| error(path, e.to_string()))?;
    let (_, header) = SafeTensors::read_metadata(&bytes).map_err(|e| error(path, format!("not a checkpoint: {e}")))?;
    let meta = header.metadata().clone().unwrap_or_default();
    if meta.get("format").map(String::as_str) != Some("sgs-geometry-1") {
        return Err(error(path, "not a checkpoint of the geometry stage".into()));
    }
    let number = |name: &str| -> Result<u32> {
        let value = meta.get(name).and_then(|s| s.parse().ok());
        value.ok_or_else(|| error(path, format!("the checkpoint does not say its {name}")))
    };
    let (step, capacity) = (number("step")?, number("capacity")?);
    let tensors = SafeTensors::deserialize(&bytes).map_err(|e| error(path, format!("damaged: {e}")))?;
    let floats = |name: &str| -> Result<Vec<f32>> {
        let t = tensors.tensor(name).map_err(|_| error(path, format!("the checkpoint has no \"{name}\"")))?;
        if t.dtype() != Dtype::F32 {
            return Err(error(path, format!("\"{name}\" does not hold 32-bit floats")));
        }
        Ok(t.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect())
    };
    if any_degree {
        let bands = [Group::Sh1, Group::Sh2, Group::Sh3];
        model.sh_degree = bands.iter().take_while(|g| tensors.tensor(g.name()).is_ok()).count() as u32;
    }
    let mut parameters = GaussianData::default();
    let mut moments = GaussianData::default();
    for group in Group::ALL {
        let present = tensors.tensor(group.name()).is_ok();
        if present != model.has(group) {
            let reason = format!(
                "the checkpoint {} \"{}\", unlike these settings",
                if present { "has" } else { "lacks" },
                group.name()
            );
            return Err(error(path, reason));
        }
        if present {
            parameters.groups[group as usize] = floats(group.name())?;
            moments.groups[group as usize] = floats(&format!("{}_moments", group.name()))?;
        }
    }
    let count = parameters.len();
    for group in model.groups() {
        let scalars = count * group.width() as usize;
        if parameters.group(group).len() != scalars || moments.group(group).len() != 2 * scalars {
            return Err(error(path, format!("\"{}\" does not fit {count} Gaussians", group.name())));
        }
    }
    for group in model.groups() {
        if parameters.group(group).iter().any(|v| !v.is_finite()) {
            return Err(error(path, format!("damaged: \"{}\" holds values that are not finite", group.name())));
        }
        if let Some(wrong) = wrong_moments(moments.group(group)) {
            return Err(error(path, format!("damaged: \"{}_moments\" holds {wrong}", group.name())));
        }
    }
    let statistics = floats("statistics")?;
    // Without densification the tensor is empty.
    if !statistics.is_empty() && statistics.len() != count * STATISTICS as usize {
        return Err(error(path, format!("damaged: \"statistics\" does not fit {count} Gaussians")));
    }
    let decoder = match model.semantics {
        true => Some(DecoderValues { parameters: floats("decoder")?, moments: floats("decoder_moments")? }),
        false => None,
    };
    if let Some(DecoderValues { parameters, moments }) = &decoder {
        let scalars = EMBEDDING * AUGMENTED;
        let whole = parameters.len() == scalars && moments.len() == 2 * scalars;
        if !whole || parameters.iter().any(|v| !v.is_finite()) || wrong_moments(moments).is_some() {
            return Err(error(
                path,
                "damaged: \"decoder\" has another size or holds values that are not finite".into(),
            ));
        }
    }
    let views = match views {
        None => Vec::new(),
        Some(count) => {
            let numbers = floats("views")?;
            let wrong = || error(path, format!("damaged: \"views\" does not fit {count} training views"));
            let views: &[LearnedView] = bytemuck::try_cast_slice(&numbers).map_err(|_| wrong())?;
            if views.len() != count as usize + 1 || views.iter().any(|v| v.values.iter().any(|x| !x.is_finite())) {
                return Err(wrong());
            }
            let moments: Vec<f32> = views.iter().flat_map(|v| v.moments).flatten().collect();
            if let Some(wrong) = wrong_moments(&moments) {
                return Err(error(path, format!("damaged: \"views\" holds {wrong}")));
            }
            views.to_vec()
        }
    };
    let course = Course::read(path, &meta)?;
    let bands = json(path, &meta, "bands")?;
    let decisions = json(path, &meta, "decisions")?.unwrap_or_default();
    let growth = json(path, &meta, "growth")?.unwrap_or_default();
    let backward = json(path, &meta, "backward")?;
    Ok(State {
        step,
        capacity,
        parameters,
        moments,
        statistics,
        decoder,
        views,
        course,
        bands,
        decisions,
        growth,
        backward,
        model,
    })
}
