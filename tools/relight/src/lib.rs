//! Scenes under other light, of other materials, with other things in them; nothing is trained again.
//!
//! An [`Edit`] is applied to what a run has left, and gives what shades. Leaves shading and files to others.

mod bake;
mod edit;
mod environment;
mod error;
#[doc(hidden)]
pub mod fuzzed;
mod lamps;
mod lights;
mod live;
mod materials;
mod select;
mod truth;

pub use bake::{BakeOptions, Baked, bake, bake_cameras, baked_psnr};
pub use edit::{
    Edit, EnvironmentEdit, Insert, LightChange, LightEdit, MaterialEdit, MaterialValues, NewLight, Region, Turn, Where,
};
pub use error::{RelightError, Result};
pub use lamps::Lamp;
pub use live::{Relighter, source_of};
pub use select::Selector;
pub use truth::{evaluate_relit, skip_relit};

use sgs_engine::Device;
use sgs_passes::pipeline::ShadedScene;
use sgs_run::{LightFile, Rays, RunLight, Texels, Visibility, join, placed, shaded_scene};
use sgs_scene::Splats;

/// Everything that shades, on the host.
#[derive(Clone, Debug)]
pub struct Relit {
    /// Gaussians with materials.
    pub splats: Splats,
    /// Lamps, surroundings, what lamps see.
    pub light: RunLight,
}

impl Relit {
    /// Applies an edit: materials first, so that they speak of the run's own Gaussians, then what is put in, then light.
    /// Where none of the run's lights is left at its place, visibility that was learned is traced instead.
    /// Surroundings that are new have `size` texels along an edge; `load` gives what an insertion names.
    ///
    /// # Errors
    /// If the edit names what is not there.
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
            // What was learned is of the run's lights where they were.
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

    /// On a device.
    ///
    /// # Errors
    /// If materials or normals are missing, or memory runs out.
    pub fn upload(&self, device: &Device) -> Result<ShadedScene> {
        let RunLight { lights, environment, visibility } = &self.light;
        Ok(shaded_scene(device, &self.splats, lights.as_ref(), environment.as_ref(), visibility)?)
    }
}

/// Lights and surroundings after an edit, without what it says of Gaussians.
///
/// # Errors
/// If it names what is not there.
pub(crate) fn edited_light_of(
    edit: &Edit,
    lights: LightFile,
    environment: Texels,
) -> Result<(Option<LightFile>, Option<Texels>)> {
    let lights = lights::edit_lights(&edit.lights, Some(lights))?;
    let size = environment.size;
    Ok((lights, environment::edit_environment(&edit.environment, Some(environment), size)?))
}
