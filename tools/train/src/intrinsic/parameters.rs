//! Initial values of the trained parameters.

use super::start::Start;
use super::values::light_scale;
use crate::error::Result;
use sgs_config::IntrinsicSettings;
use sgs_engine::Device;
use sgs_passes::pipeline::{IntrinsicOptions, IntrinsicParameters, LightTrainables};
use sgs_passes::scene::Trainable;
use sgs_passes::shade::ALBEDO_RANGE;
use sgs_passes::shade::environment::Environment;
use sgs_passes::shade::lights::LightModel;
use sgs_passes::shade::visibility::VisibilityField;
use sgs_run::materials::in_range;
use sgs_scene::Splats;

/// Number of lobes of a light for which the initial amplitudes are meant.
const LOBES: f32 = 12.0;

/// Inputs of the initial values.
pub(super) struct Initial<'a> {
    pub splats: &'a Splats,
    /// Materials of splats that have none.
    pub start: Start,
    pub settings: &'a IntrinsicSettings,
    pub options: &'a IntrinsicOptions,
    pub light_model: &'a LightModel,
    /// Box that the lights start in.
    pub bounds: &'a [[f32; 3]; 2],
    pub environment: Option<&'a Environment>,
    /// Bits of an entry of the visibility field.
    pub table_bits: u32,
    pub seed: u32,
}

impl Initial<'_> {
    /// Allocates the parameters, without those of a room.
    pub fn allocate(self, device: &Device) -> Result<IntrinsicParameters> {
        let Initial { splats, start: begin, settings: s, options, light_model, bounds, .. } = self;
        let n = splats.len();
        let start = |initial: Option<Vec<f32>>, width: usize, otherwise: f32| {
            initial.filter(|v| v.len() == n * width).unwrap_or_else(|| vec![otherwise; n * width])
        };
        let flat = splats.albedo.as_ref().map(|a| a.as_flattened().to_vec());
        let trained = |raw: Vec<f32>| in_range(raw, ALBEDO_RANGE, options.albedo_range);
        Ok(IntrinsicParameters {
            albedo: Trainable::new(device, "albedo", &start(flat.or(begin.albedo).map(trained), 3, 0.0), true)?,
            roughness: {
                let rough = start(splats.roughness.clone().or(begin.roughness), 1, 0.0);
                Trainable::new(device, "roughness", &rough, true)?
            },
            metallic: match options.metallic {
                true => {
                    let metal = start(splats.metallic.clone().or(begin.metallic), 1, -2.0);
                    Some(Trainable::new(device, "metallic", &metal, true)?)
                }
                false => None,
            },
            lights: match s.lights.enabled() {
                true => {
                    let positions = light_model.start_positions(bounds[0], bounds[1]);
                    let row = light_model.row() as usize;
                    let mut lobes = light_model.start_lobes();
                    let scale = light_scale(bounds) * s.lights.start.max(1e-30) * LOBES / s.lights.lobes as f32;
                    lobes.chunks_mut(row).flat_map(|l| &mut l[row - 3..]).for_each(|w| *w += scale.ln());
                    Some(LightTrainables {
                        positions: Trainable::new(device, "light_positions", positions.as_flattened(), true)?,
                        lobes: Trainable::new(device, "light_lobes", &lobes, true)?,
                    })
                }
                false => None,
            },
            environment: match self.environment {
                Some(e) => {
                    let texels: Vec<f32> = e.start(self.seed).iter().map(|v| v * s.environment.start).collect();
                    Some(Trainable::new(device, "environment", &texels, true)?)
                }
                None => None,
            },
            visibility: match s.visibility.config().filter(|_| s.lights.enabled()) {
                Some(config) => Some(VisibilityField::new(device, config, self.seed, true, self.table_bits)?),
                None => None,
            },
            normals: match splats.normals.as_ref().filter(|_| options.learns_normals()) {
                Some(normals) => Some(Trainable::new(device, "gaussian_normals", normals.as_flattened(), true)?),
                None => None,
            },
            transport: None,
        })
    }
}
