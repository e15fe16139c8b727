//! Edited light, materials and contents of a run, ready for shading.

use crate::cameras::splats_of;
use crate::channels::{check_materials, light_of_source};
use crate::classes::head_of;
use crate::refuse_usage;
use sgs_config::Settings;
use sgs_engine::Device;
use sgs_relight::{Edit, EmitterEdit, Emitting, Insert, RelightError, Relit, Selector};
use sgs_run::{Rays, RunDirectory, RunLight, SemanticHead, Shading, Visibility};
use sgs_scene::{Scene, Splats};
use std::path::Path;

/// Shadows of lights.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shadows {
    /// Visibility field of the run.
    Learned,
    /// Rays through the Gaussians.
    Traced,
    /// No shadows.
    None,
}

/// Checked edit of a run or file.
pub struct Relighting<'a> {
    source: &'a Path,
    edit: &'a Edit,
    settings: Option<&'a Settings>,
    shadows: Option<Shadows>,
    light: RunLight,
    head: Option<SemanticHead>,
    bounces: bool,
}

/// Edited run on the device.
pub struct RelitScene {
    /// Gaussians and light after the edit.
    pub relit: Relit,
    /// Emitters after the edit, if these light the scene.
    pub emitting: Option<Emitting>,
    /// Shading of its views.
    pub shading: Shading,
}

impl<'a> Relighting<'a> {
    /// Checks an edit. `shadows`: by default those of the run.
    ///
    /// # Errors
    /// If the source has no materials, or the edit cannot be applied to it.
    pub fn new(
        source: &'a Path,
        splats: &Splats,
        settings: Option<&'a Settings>,
        edit: &'a Edit,
        shadows: Option<Shadows>,
    ) -> anyhow::Result<Relighting<'a>> {
        check_materials(source, splats, false)?;
        let light = light_of_source(source, settings)?;
        let by_class = edit.materials.iter().any(|m| m.place.class.is_some());
        let head = match by_class && splats.semantic.is_some() {
            true => Some(head_of(source, splats)?),
            false => None,
        };
        let bounces = bounces(source, edit, shadows)?;
        Ok(Relighting { source, edit, settings, shadows, light, head, bounces })
    }

    /// Returns whether the edit needs the views of the scene.
    pub fn needs_scene(&self) -> bool {
        self.bounces || self.edit.materials.iter().any(|m| m.place.region.is_some())
    }

    /// Applies the edit and uploads the result.
    ///
    /// # Errors
    /// If the edit names something that does not exist, or the device fails.
    pub fn apply(self, device: &Device, splats: Splats, scene: Option<&Scene>) -> anyhow::Result<RelitScene> {
        let Relighting { source, edit, settings, shadows, light, head, bounces } = self;
        let mut selector = Selector { device, head, scene };
        let size = settings.map_or(64, |s| s.intrinsic.environment.edge());
        let original = light.visibility.clone();
        let mut relit = Relit { splats, light }.edited(edit, size, &mut selector, loaded)?;
        match shadows {
            Some(Shadows::Learned) if !matches!(original, Visibility::Learned(_)) => {
                refuse_usage!("\"{}\" has no learned visibility; use --visibility traced or none.", source.display())
            }
            Some(Shadows::Learned) => relit.light.visibility = original,
            Some(Shadows::Traced) => {
                let rays = settings.map_or_else(Rays::default, |s| Rays::of(&s.intrinsic.visibility));
                relit.light.visibility = Visibility::Traced(rays);
            }
            Some(Shadows::None) => relit.light.visibility = Visibility::None,
            None => {}
        }
        let emitting = match (scene, settings, bounces) {
            (Some(scene), Some(settings), true) => {
                let run = RunDirectory::open(source)?;
                let emitting = Emitting::open(device, &run, scene, &relit.splats, settings.seed)?;
                let emitters = edit.all_emitters()?;
                emitting.map(|emitting| emitting.edited(&emitters)).transpose()?
            }
            _ => None,
        };
        let shaded = match &emitting {
            Some(emitting) => emitting.own(device, &relit.splats)?,
            None => relit.upload(device)?,
        };
        let shading = Shading::new(device, shaded)?;
        Ok(RelitScene { relit, emitting, shading })
    }
}

/// Returns whether the emitters of the run light the images, with bounces.
///
/// Refuses edits that mix them with the light of the published model.
fn bounces(source: &Path, edit: &Edit, shadows: Option<Shadows>) -> anyhow::Result<bool> {
    let published = edit.changes_published_light() || shadows.is_some();
    let has = source.is_dir() && RunDirectory::open(source)?.emitters().is_file();
    if edit.emitters == EmitterEdit::default() {
        return Ok(has && !published);
    }
    if !has {
        refuse_usage!("\"{}\" has no emitters; train them with --stage transport.", source.display());
    }
    if published {
        refuse_usage!("An edit of \"emitters\" takes no \"lights\", \"environment\" or --visibility; leave these out.");
    }
    Ok(true)
}

/// Loads the splats of an insertion.
fn loaded(insert: &Insert) -> sgs_relight::Result<Splats> {
    let (splats, _) = splats_of(&insert.source).map_err(|e| RelightError::Edit(e.to_string()))?;
    Ok(splats)
}
