//! Evaluation of a run against its scene.

use crate::cameras::upload;
use crate::classes::head_of;
use anyhow::bail;
use sgs_config::Settings;
use sgs_engine::Device;
use sgs_evaluate::metrics::Lpips;
use sgs_evaluate::{
    EvaluateOptions, Evaluation, Fps, Rendered, evaluate_classes, evaluate_shaded, render_fps, shade_fps,
};
use sgs_passes::scene::ViewKinds;
use sgs_relight::{Emitting, LightOfRun, evaluate_relit, skip_relit};
use sgs_run::{RunDirectory, ShadedView, Shading, light_of, shaded_scene};
use sgs_scene::{Scene, Splats};

/// Views of a scene that are evaluated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Split {
    /// Held-out views.
    #[default]
    Test,
    /// Training views.
    Train,
}

/// Receiver of the images of an evaluation.
pub trait EvaluatedImages {
    /// Receives the names of the classes before the first image.
    ///
    /// `None` if pixels are not classified.
    ///
    /// # Errors
    /// If a file cannot be written.
    fn begin(&mut self, classes: Option<&[String]>) -> anyhow::Result<()>;

    /// Receives a rendered view.
    ///
    /// # Errors
    /// If a file cannot be written.
    fn rendered(&mut self, scene: &Scene, name: &str, rendered: &Rendered) -> sgs_evaluate::Result<()>;

    /// Receives a shaded view.
    ///
    /// # Errors
    /// If a file cannot be written.
    fn shaded(
        &mut self,
        scene: &Scene,
        name: &str,
        shaded: &ShadedView,
        background: [f32; 3],
    ) -> sgs_evaluate::Result<()>;
}

/// Views and measures of [`measure`].
#[derive(Default)]
pub struct MeasureOptions<'a> {
    /// Views that are measured.
    pub split: Split,
    /// Network of LPIPS, if it is measured.
    pub lpips: Option<&'a Lpips>,
    /// Receiver of images, if any.
    pub images: Option<&'a mut dyn EvaluatedImages>,
    /// Aligns views before a second comparison. Runs with learned views always do.
    pub align: bool,
}

/// Measures a run and records the result in `metrics.json`.
///
/// # Errors
/// If the split has no views, a file is damaged, or the device fails.
pub fn measure(
    device: &Device,
    scene: &Scene,
    run: &RunDirectory,
    splats: &Splats,
    settings: &Settings,
    options: MeasureOptions<'_>,
) -> anyhow::Result<Evaluation> {
    let MeasureOptions { split, lpips, mut images, align } = options;
    let views = if split == Split::Test { &scene.split.test } else { &scene.split.train };
    if views.is_empty() {
        bail!("The scene has no views in that split.");
    }
    let classified = splats.semantic.is_some() && run.semantics().exists();
    let head = if classified { Some(head_of(run.root(), splats)?) } else { None };
    let gaussians = upload(device, splats, head.is_some())?;
    if let Some(images) = &mut images {
        images.begin(head.as_ref().map(|head| head.text.labels.as_slice()))?;
    }
    let background = settings.geometry.background;
    let [cameras, gains] = match settings.geometry.rates.views.fixed() {
        Some([cameras, gains, ..]) => [cameras > 0.0, gains > 0.0],
        // All or nothing was learned.
        None => [run.learned_views()?.is_some(); 2],
    };
    let align = (align || cameras || gains).then_some(ViewKinds { cameras: true, gains, lens: false });
    let options = EvaluateOptions { views, background, head: head.as_ref(), lpips, align };
    let mut result = evaluate_classes(device, scene, &gaussians, &options, |name, rendered| match &mut images {
        Some(images) => images.rendered(scene, name, rendered),
        None => Ok(()),
    })?;
    let mut pbr = None;
    if splats.albedo.is_some() && splats.roughness.is_some() {
        let light = light_of(run, settings)?;
        let (lights, environment) = (light.lights.as_ref(), light.environment.as_ref());
        let emitting = Emitting::open(device, run, scene, splats, settings.seed)?;
        let shaded = match &emitting {
            Some(emitting) => emitting.own(device, splats)?,
            None => shaded_scene(device, splats, lights, environment, &light.visibility)?,
        };
        // Mean visibility doubles the cost of shading and appears in images only.
        let shading = Shading::new(device, shaded)?;
        let mut shading = if images.is_some() { shading } else { shading.without_visibility() };
        evaluate_shaded(
            &mut shading,
            scene,
            views,
            background,
            lpips,
            &mut result,
            |name, shaded| match &mut images {
                Some(images) => images.shaded(scene, name, shaded, background),
                None => Ok(()),
            },
        )?;
        pbr = Some(shade_fps(&mut shading.without_visibility(), scene, views)?);
        let of_run = match &emitting {
            Some(emitting) => LightOfRun::Emitting(emitting, settings.seed),
            None => LightOfRun::Published(&light),
        };
        evaluate_relit(device, scene, splats, &of_run, views, &mut result)?;
    } else {
        let reason = "The run has no materials; train its intrinsic stage to render the set.";
        skip_relit(scene, reason, &mut result);
    }
    result.mean.fps = Some(Fps { nvs: render_fps(device, scene, &gaussians, views, background)?, pbr });
    record(run, if split == Split::Test { "test" } else { "train" }, &result, splats.len())?;
    Ok(result)
}

/// Inserts the result into `metrics.json` and keeps its other entries.
fn record(run: &RunDirectory, split: &str, result: &Evaluation, gaussians: usize) -> anyhow::Result<()> {
    let old = std::fs::read_to_string(run.path("metrics.json")).unwrap_or_default();
    let mut all: serde_json::Map<String, serde_json::Value> = serde_json::from_str(&old).unwrap_or_default();
    all.insert(split.to_owned(), serde_json::to_value(result)?);
    all.insert("gaussians".to_owned(), gaussians.into());
    if let Some(fps) = &result.mean.fps {
        all.insert("fps".to_owned(), serde_json::to_value(fps)?);
    }
    let training = std::fs::read_to_string(run.path("training.json")).unwrap_or_default();
    if let Ok(serde_json::Value::Object(t)) = serde_json::from_str(&training) {
        for key in ["seconds", "steps_per_second", "peak_device_bytes"] {
            if let Some(v) = t.get(key) {
                all.insert(key.to_owned(), v.clone());
            }
        }
    }
    Ok(run.write_json("metrics.json", &all)?)
}
