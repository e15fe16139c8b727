//! Relights and edits trained scenes without training them again.
//!
//! An [`Edit`] changes the lights, materials and contents of a run and yields the input of shading. Other crates shade
//! and write files.

mod bake;
mod bounced;
mod edit;
mod emitter_table;
mod emitters;
mod emitting;
mod environment;
mod error;
#[doc(hidden)]
pub mod fuzzed;
mod joined_lights;
mod light_table;
mod lights;
mod lit_emitters;
mod live;
mod materials;
mod new_light;
mod numbers;
mod painted;
mod responses;
mod select;
mod true_light;
mod truth;

pub use bake::{BakeOptions, Baked, bake, bake_cameras, baked_psnr};
pub use bounced::{RelitView, relit_views};
pub use edit::{Edit, Insert, LightChange, LightEdit, MaterialEdit, MaterialValues, NewLight, Region, Where};
pub use emitters::{EmitterChange, EmitterEdit, NewEmitter};
pub use emitting::Emitting;
pub use environment::{EnvironmentEdit, Turn};
pub use error::{RelightError, Result};
pub use light_table::LightParameters;
pub use live::{Relighter, source_of};
pub use responses::{LightResponses, RESPONSE_DEGREE, fit_responses};
pub use select::Selector;
pub use truth::{LightOfRun, evaluate_relit, skip_relit};

use sgs_engine::Device;
use sgs_passes::pipeline::ShadedScene;
use sgs_run::{LightFile, Rays, RunLight, Texels, Visibility, join, placed, shaded_scene};
use sgs_scene::Splats;

/// Shading inputs on the host.
#[derive(Clone, Debug)]
pub struct Relit {
    /// Gaussians with materials.
    pub splats: Splats,
    /// Lights, environment map and visibility.
    pub light: RunLight,
}

impl Relit {
    /// Applies an edit: materials first, then insertions, then light.
    ///
    /// Material edits thus refer to the run's own Gaussians. If no light of the run remains at its position, learned
    /// visibility is replaced by traced visibility. A new environment map has `size` texels along an edge. `load`
    /// returns the splats of an insertion.
    ///
    /// # Errors
    /// If the edit names something that does not exist.
    pub fn edited(
        mut self,
        edit: &Edit,
        size: u32,
        select: &mut Selector<'_>,
        mut load: impl FnMut(&Insert) -> Result<Splats>,
    ) -> Result<Relit> {
        edit.check().map_err(|reason| RelightError::Edit(format!("The edit cannot be applied: {reason}.")))?;
        for change in &edit.materials {
            let chosen = select.choose(&change.place, &self.splats)?;
            materials::edit_materials(change, &chosen, &mut self.splats);
        }
        for one in &edit.insert {
            join(&mut self.splats, placed(load(one)?, &one.placement()));
        }
        let RunLight { lights, environment, visibility } = self.light;
        let own = lights.clone();
        let lights = lights::edit_lights(&edit.lights, lights)?;
        let visibility = match visibility {
            // The learned field is valid only for the run's lights at their positions.
            Visibility::Learned(_) if !lights::any_left(own.as_ref(), lights.as_ref()) => {
                Visibility::Traced(Rays::default())
            }
            as_it_is => as_it_is,
        };
        let size = environment.as_ref().map_or(size, |e| e.size);
        let environment = environment::edit_environment(&edit.environment, environment, size)?;
        self.light = RunLight { lights, environment, visibility };
        Ok(self)
    }

    /// Uploads the scene to a device.
    ///
    /// # Errors
    /// If materials or normals are missing, or memory runs out.
    pub fn upload(&self, device: &Device) -> Result<ShadedScene> {
        let RunLight { lights, environment, visibility } = &self.light;
        Ok(shaded_scene(device, &self.splats, lights.as_ref(), environment.as_ref(), visibility)?)
    }
}

/// Applies the light and environment map parts of an edit; ignores edits of Gaussians.
///
/// # Errors
/// If the edit names something that does not exist.
pub(crate) fn edited_light_of(
    edit: &Edit,
    lights: LightFile,
    environment: Texels,
) -> Result<(Option<LightFile>, Option<Texels>)> {
    let lights = lights::edit_lights(&edit.lights, Some(lights))?;
    let size = environment.size;
    Ok((lights, environment::edit_environment(&edit.environment, Some(environment), size)?))
}
