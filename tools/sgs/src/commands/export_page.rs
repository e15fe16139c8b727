//! Export of a page that shows a run in a browser: `sgs export --web`.

use crate::cameras::splats_of;
use crate::common::Common;
use crate::failure::{Kind, failure, refuse_usage};
use crate::scenes::open_scene_of_run;
use crate::ui::Bar;
use crate::viewpoints::up_of;
use anyhow::bail;
use glam::{DMat3, DVec3};
use sgs_config::Settings;
use sgs_relight::{Emitting, LightResponses, RESPONSE_DEGREE, bake_cameras, fit_responses};
use sgs_run::{Contents, RunDirectory};
use sgs_scene::{Camera, NEAR, Page, Scene, Splats, Unit, write_page};
use std::path::Path;

/// Source and target of a page.
pub struct PageExport<'a> {
    /// Run directory or file.
    pub source: &'a Path,
    /// Directory to write.
    pub folder: &'a Path,
    /// Scene directory; by default that of the training.
    pub scene: Option<&'a Path>,
    /// Transforms file with the cameras; by default those of the scene.
    pub cameras: Option<&'a Path>,
    /// Direction that points up; by default that of the cameras.
    pub up: Option<DVec3>,
}

pub fn run(common: &Common, export: &PageExport<'_>) -> anyhow::Result<()> {
    let &PageExport { source, folder, up, .. } = export;
    let shown = folder.display();
    match Contents::of(folder) {
        Contents::Nothing => {}
        Contents::File => refuse_usage!("\"{shown}\" is a file; name a new or an empty directory for the page."),
        _ => refuse_usage!("\"{shown}\" holds files; name a new or an empty directory for the page."),
    }
    let (splats, settings) = splats_of(source)?;
    if splats.is_empty() {
        bail!("\"{}\" holds no Gaussians; export a trained scene.", source.display());
    }
    let emitters = source.is_dir() && RunDirectory::open(source)?.emitters().is_file() && splats.albedo.is_some();
    let scene = match (&settings, export.scene) {
        (Some(settings), _) => scene_of(export, settings, emitters)?,
        (None, Some(path)) => Some(Scene::open(path, &Settings::default().scene_options())?),
        (None, None) => None,
    };
    let cameras = cameras_of(export, &splats, scene.as_ref())?;
    let responses = match (&scene, &settings, emitters) {
        (Some(scene), Some(settings), true) => responses_of(common, source, &splats, scene, settings)?,
        _ => None,
    };
    let lights = responses.as_ref().map_or(&[][..], |r| &r.lights);
    let title = source.file_stem().map(|s| s.to_string_lossy().into_owned()).filter(|s| !s.is_empty());
    let page = Page {
        title: title.as_deref().unwrap_or("SGS"),
        splats: &splats,
        cameras: &cameras,
        up: up.unwrap_or_else(|| up_of(&cameras)),
        background: [0.0; 3],
        lights,
        light_degree: RESPONSE_DEGREE,
    };
    let written = write_page(folder, &page)?;
    let fit = responses
        .as_ref()
        .map(|r| serde_json::json!({"views": r.views, "psnr": r.psnr, "psnr_one_off": r.psnr_one_off}));
    let answer = serde_json::json!({
        "gaussians": written.splats, "left_out": splats.len() - written.splats, "page": written.files[0],
        "files": written.files, "bytes": written.bytes, "views": cameras.len(), "lights": lights.len(), "fit": fit,
    });
    if !common.answer(&answer)? && !common.quiet {
        let (count, views, size) = (written.splats, cameras.len(), written.bytes as f64 / 1e6);
        eprintln!("wrote {count} Gaussians and {views} views to {}, {size:.1} MB in all", written.files[0].display());
        if let Some(LightResponses { lights, views, psnr, psnr_one_off }) = &responses {
            let off = psnr_one_off.map_or(String::new(), |off| format!(", {off:.2} dB or more with one off"));
            eprintln!(
                "{} lights: {psnr:.2} dB from the relit images at the {views} views of the fit{off}",
                lights.len()
            );
        }
    }
    Ok(())
}

/// Returns the scene of a run. Without it, a run without emitters has a camera of its own.
fn scene_of(export: &PageExport<'_>, settings: &Settings, emitters: bool) -> anyhow::Result<Option<Scene>> {
    let mut settings = settings.clone();
    if let Some(scene) = export.scene {
        settings.scene = scene.to_owned();
    }
    if !emitters && export.scene.is_none() && (export.cameras.is_some() || !settings.scene.exists()) {
        return Ok(None);
    }
    open_scene_of_run(export.source, &settings).map(Some)
}

/// Returns the views of the page: those of a file, those of the scene, or one that looks at the Gaussians.
fn cameras_of(export: &PageExport<'_>, splats: &Splats, scene: Option<&Scene>) -> anyhow::Result<Vec<Camera>> {
    let near = NEAR * Unit::of_splats(splats).length();
    if let Some(file) = export.cameras {
        let mut cameras = Camera::read_transforms(file)?;
        if cameras.is_empty() {
            return Err(failure(Kind::Input, format!("\"{}\" holds no cameras.", file.display())));
        }
        cameras.iter_mut().for_each(|camera| camera.near = near);
        return Ok(cameras);
    }
    if let Some(scene) = scene {
        return Ok(scene.views.iter().map(|view| view.camera.clone()).collect());
    }
    tracing::warn!(
        "the page starts in front of the Gaussians, because there are no cameras; give --cameras or --scene"
    );
    Ok(vec![overview(splats, near)])
}

/// Returns a camera in front of the middle of the Gaussians.
///
/// Its axes are those of the world.
fn overview(splats: &Splats, near: f64) -> Camera {
    let at = |k: usize, share: f64| {
        let mut all: Vec<f32> = splats.means.iter().map(|m| m[k]).filter(|v| v.is_finite()).collect();
        let n = ((all.len() as f64 * share) as usize).min(all.len().saturating_sub(1));
        if all.is_empty() { 0.0 } else { f64::from(*all.select_nth_unstable_by(n, f32::total_cmp).1) }
    };
    let [low, middle, high] = [0.05, 0.5, 0.95].map(|share| DVec3::from([0, 1, 2].map(|k| at(k, share))));
    let away = 0.75 * low.distance(high) + 2.0 * near;
    let position = middle - away * DVec3::Z;
    Camera {
        name: "overview".into(),
        width: 960,
        height: 640,
        fx: 800.0,
        fy: 800.0,
        cx: 480.0,
        cy: 320.0,
        rotation: DMat3::IDENTITY,
        translation: -position,
        near,
    }
}

/// Fits the responses to the emitters of a run. `None` if it has none.
fn responses_of(
    common: &Common,
    source: &Path,
    splats: &Splats,
    scene: &Scene,
    settings: &Settings,
) -> anyhow::Result<Option<LightResponses>> {
    let device = common.open_device()?;
    let run = RunDirectory::open(source)?;
    let Some(emitting) = Emitting::open(&device, &run, scene, splats, settings.seed)? else { return Ok(None) };
    if emitting.file.emitters.is_empty() {
        return Ok(None);
    }
    // Views between the photographs keep colors from fitting the photographs alone.
    let mut cameras: Vec<Camera> = scene.views.iter().map(|view| view.camera.clone()).collect();
    let between = bake_cameras(scene, &settings.geometry.pseudo)?;
    cameras.extend(between.into_iter().skip(scene.split.train.len()));
    let mut bar: Option<Bar> = None;
    let responses = fit_responses(&device, splats, &emitting, &cameras, |done, total| {
        let bar = bar.get_or_insert_with(|| Bar::new(common, "lights", total as u64, 0));
        bar.set(done as u64, String::new);
    })?;
    if let Some(bar) = bar {
        bar.finish();
    }
    super::train::validated(&device)?;
    Ok(Some(responses))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn overview_sees_the_middle_of_the_gaussians() {
        let means = (0..100).map(|i| [i as f32 * 0.1, 5.0, -3.0 + i as f32 * 0.02]).collect();
        let splats = Splats { means, ..Splats::default() };
        let camera = overview(&splats, 0.01);
        assert!(camera.problem().is_none());
        let at = camera.project(DVec3::new(5.0, 5.0, -2.0)).expect("in front");
        assert!(at.distance(glam::DVec2::new(480.0, 320.0)) < 1.0, "{at}");
    }
}
