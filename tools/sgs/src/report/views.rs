//! Images of a report.
//!
//! The head shows photograph, render, albedo and relit image side by side. Every channel of every view follows.
//! Channels with ground truth have a slider.

use super::evening;
use super::lights::LightTable;
use crate::cameras::upload;
use crate::classes::head_of;
use crate::common::Common;
use crate::palette::colors;
use crate::ui::Bar;
use serde_json::Value;
use sgs_config::Settings;
use sgs_engine::Device;
use sgs_evaluate::{EvaluateError, EvaluateOptions, Rendered, evaluate_classes, evaluate_shaded};
use sgs_report::depth;
use sgs_report::escape;
use sgs_report::figure::{data_uri, rendered, slider};
use sgs_run::{RunDirectory, RunLight, ShadedView, Shading, displayed, shaded_scene};
use sgs_scene::{GroundTruth, GroundTruthKind as Kind, Image, Scene, Splats};
use std::collections::BTreeMap;

/// Display options of the images.
pub struct Shown<'a> {
    /// Maximum width in pixels.
    pub width: u32,
    /// Lights of the run.
    pub light_table: &'a LightTable,
    /// Number of lights that are shown one by one.
    pub most: usize,
}

/// Number of views that are shown side by side at the head of a report.
const FIRST: usize = 3;

/// Images as HTML.
pub struct Html {
    /// Images at the head.
    pub first: String,
    /// All channels of all views.
    pub views: String,
}

/// Figures of a view: side by side, geometry, materials, lighting and single lights.
#[derive(Default)]
struct Figures {
    strip: String,
    main: String,
    materials: String,
    light: String,
    light_table: String,
    /// Mean radiance of the shaded image.
    mean: f32,
}

/// Run whose views are shown.
pub struct ShownRun<'a> {
    pub scene: &'a Scene,
    pub run: &'a RunDirectory,
    pub splats: &'a Splats,
    pub settings: &'a Settings,
    pub light: &'a RunLight,
    /// Indices of the shown views.
    pub views: &'a [usize],
    /// Measures of the run, as in `metrics.json`.
    pub metrics: &'a Value,
}

/// Renders the views as HTML.
pub fn html(common: &Common, device: &Device, run: &ShownRun<'_>, shown: &Shown) -> anyhow::Result<Html> {
    let &ShownRun { scene, run, splats, settings, light, views, metrics } = run;
    let truth = GroundTruth::of(scene);
    let classified = splats.semantic.is_some() && run.semantics().exists();
    let head = if classified { Some(head_of(run.root(), splats)?) } else { None };
    let palette = head.as_ref().map(|h| colors(h.text.labels.len())).unwrap_or_default();
    let gaussians = upload(device, splats, head.is_some())?;
    let background = settings.geometry.background;
    let materials = splats.albedo.is_some() && splats.roughness.is_some() && splats.normals.is_some();
    let mut bar = Bar::new(common, "images", views.len() as u64 * if materials { 2 } else { 1 }, 0);
    let mut done = 0;
    let mut all: BTreeMap<String, Figures> = BTreeMap::new();
    let mut next = views.iter();
    let options = EvaluateOptions { views, background, head: head.as_ref(), lpips: None, align: None };
    let mut result = evaluate_classes(device, scene, &gaussians, &options, |name, r| {
        let Some(&view) = next.next() else { return Ok(()) };
        let psnr = noted(metrics, name, "nvs");
        let photo = scene.load_image(view)?;
        let figures = all.entry(name.to_owned()).or_default();
        figures.main = geometry(&truth, view, &photo, r, &palette, &psnr, shown)?;
        figures.strip = strip(&photo, r, materials, shown)?;
        done += 1;
        bar.set(done, || name.to_owned());
        Ok(())
    })?;
    if materials {
        let (lights, environment) = (light.lights.as_ref(), light.environment.as_ref());
        let shaded = shaded_scene(device, splats, lights, environment, &light.visibility)?;
        let mut shading = Shading::new(device, shaded)?;
        let mut next = views.iter();
        let lit = lights.is_some() || environment.is_some();
        evaluate_shaded(&mut shading, scene, views, background, None, &mut result, |name, s| {
            let Some(&view) = next.next() else { return Ok(()) };
            let figures = all.entry(name.to_owned()).or_default();
            let has = Has {
                metallic: splats.metallic.is_some(),
                lit,
                light_table: lights.is_some(),
                sky: environment.is_some(),
            };
            let albedo = displayed(&s.albedo());
            figures.strip.push_str(&one("albedo", &albedo, "", shown)?);
            if lit {
                let photo = scene.load_image(view)?;
                let radiance = s.radiance(background);
                figures.mean = evening::mean(&radiance);
                let note = noted(metrics, name, "pbr");
                figures.main.push_str(&pair("shaded", &photo, &displayed(&radiance), &note, shown)?);
            }
            figures.materials = material_parts(&truth, view, s, &has, &noted(metrics, name, "albedo"), shown)?;
            figures.light = light_parts(s, &has, shown)?;
            done += 1;
            bar.set(done, || name.to_owned());
            Ok(())
        })?;
        for (name, gains) in shown.light_table.brightest(shown.most) {
            shading.set_gains(device, &gains)?;
            for &view in views {
                let camera = &scene.views[view].camera;
                let image = displayed(&shading.shade(camera)?.direct());
                all.entry(camera.name.clone()).or_default().light_table.push_str(&one(&name, &image, "", shown)?);
            }
        }
        // The device may lack memory for both renderers.
        drop(shading);
        if let Some(evening) = evening::light(light) {
            let (lights, environment) = (evening.lights.as_ref(), evening.environment.as_ref());
            let mut shading =
                Shading::new(device, shaded_scene(device, splats, lights, environment, &evening.visibility)?)?;
            for &view in views.iter().take(FIRST) {
                let camera = &scene.views[view].camera;
                let figures = all.entry(camera.name.clone()).or_default();
                let mut image = shading.shade(camera)?.radiance(background);
                let exposure = evening::exposure(&image, figures.mean);
                image.data.iter_mut().for_each(|v| *v *= exposure);
                let note = format!("warm lights at dusk, exposure ×{exposure:.1}");
                figures.strip.push_str(&one("relit", &displayed(&image), &note, shown)?);
            }
        }
    }
    bar.finish();
    let mut html = Html { first: String::new(), views: String::new() };
    for (i, &view) in views.iter().enumerate() {
        let name = &scene.views[view].camera.name;
        let Some(f) = all.get(name) else { continue };
        if i < FIRST {
            html.first.push_str(&format!("<div class=\"grid strip\">\n{}</div>\n", f.strip));
        }
        html.views.push_str(&format!("<h3>{}</h3>\n", escape(name)));
        for (class, figures) in [("grid", &f.main), ("grid", &f.materials), ("grid small", &f.light)] {
            if !figures.is_empty() {
                html.views.push_str(&format!("<div class=\"{class}\">\n{figures}</div>\n"));
            }
        }
        if !f.light_table.is_empty() {
            html.views.push_str(&format!(
                "<details><summary>Light by light</summary><div class=\"grid small\">\n{}</div></details>\n",
                f.light_table
            ));
        }
    }
    Ok(html)
}

/// Channels that a run has besides albedo and roughness.
struct Has {
    metallic: bool,
    lit: bool,
    light_table: bool,
    sky: bool,
}

type Figured = Result<String, EvaluateError>;

fn one(name: &str, image: &Image, note: &str, shown: &Shown) -> Figured {
    Ok(rendered(name, &data_uri(image, shown.width)?, [image.width, image.height], note))
}

/// Returns photograph and render; without materials also normal and depth.
fn strip(photo: &Image, r: &Rendered, materials: bool, shown: &Shown) -> Figured {
    let mut out = one("photograph", photo, "", shown)?;
    out.push_str(&one("render", &r.rgb, "", shown)?);
    if !materials {
        if let Some(normal) = &r.normal {
            out.push_str(&one("normal", &colored(normal), "", shown)?);
        }
        let range = depth::range(&r.depth);
        out.push_str(&one("depth", &depth::colored(&r.depth, range), &depth::scale(range), shown)?);
    }
    Ok(out)
}

fn pair(name: &str, truth: &Image, ours: &Image, note: &str, shown: &Shown) -> Figured {
    let [t, o] = [data_uri(truth, shown.width)?, data_uri(ours, shown.width)?];
    Ok(slider(name, &t, &o, [ours.width, ours.height], note))
}

/// Returns a slider if ground truth exists, else a single image.
fn maybe(name: &str, truth: Option<Image>, ours: &Image, note: &str, shown: &Shown) -> Figured {
    match truth {
        Some(truth) => pair(name, &truth, ours, note, shown),
        None => one(name, ours, note, shown),
    }
}

/// Returns the figures of color, normals, depth and classes.
fn geometry(
    truth: &GroundTruth,
    view: usize,
    photo: &Image,
    r: &Rendered,
    palette: &[[u8; 3]],
    note: &str,
    shown: &Shown,
) -> Figured {
    let mut out = pair("color", photo, &r.rgb, note, shown)?;
    if let Some(normal) = &r.normal {
        let theirs = truth.load(Kind::Normal, view)?.map(|n| colored(&n));
        out.push_str(&maybe("normal", theirs, &colored(normal), "", shown)?);
    }
    let theirs = truth.load(Kind::Depth, view)?;
    let range = depth::range(theirs.as_ref().unwrap_or(&r.depth));
    let shown_truth = theirs.as_ref().map(|d| depth::colored(d, range));
    out.push_str(&maybe("depth", shown_truth, &depth::colored(&r.depth, range), &depth::scale(range), shown)?);
    if let Some(labels) = &r.labels {
        let color = |l: &Option<u32>| {
            l.and_then(|l| palette.get(l as usize)).map_or([0.0; 3], |c| c.map(|v| f32::from(v) / 255.0))
        };
        let data = labels.iter().flat_map(color).collect();
        out.push_str(&one("classes", &Image { channels: 3, data, ..r.rgb.clone() }, "", shown)?);
    }
    Ok(out)
}

/// Returns the figures of materials.
fn material_parts(truth: &GroundTruth, view: usize, s: &ShadedView, has: &Has, note: &str, shown: &Shown) -> Figured {
    let albedo = truth.load(Kind::Albedo, view)?.map(|t| displayed(&t));
    let mut out = maybe("albedo", albedo, &displayed(&s.albedo()), note, shown)?;
    out.push_str(&maybe("roughness", truth.load(Kind::Roughness, view)?, &s.roughness(), "", shown)?);
    if has.metallic {
        out.push_str(&maybe("metallic", truth.load(Kind::Metallic, view)?, &s.metallic(), "", shown)?);
    }
    Ok(out)
}

/// Returns the figures of the lighting terms.
fn light_parts(s: &ShadedView, has: &Has, shown: &Shown) -> Figured {
    let mut parts = Vec::new();
    if has.light_table {
        parts.push(("direct", displayed(&s.direct())));
    }
    if has.sky {
        parts.push(("environment", displayed(&s.environment_map())));
    }
    if has.lit {
        parts.extend([("diffuse", displayed(&s.diffuse())), ("specular", displayed(&s.specular()))]);
    }
    if let Some(visibility) = s.visibility().filter(|_| has.light_table) {
        parts.push(("visibility", visibility));
    }
    parts.iter().map(|(name, image)| one(name, image, "", shown)).collect()
}

/// Maps unit vectors to colors.
fn colored(normal: &Image) -> Image {
    Image { data: normal.data.iter().map(|v| v * 0.5 + 0.5).collect(), ..normal.clone() }
}

/// Returns the PSNR of a view as text, also after alignment; empty if `metrics` does not contain it.
fn noted(metrics: &Value, view: &str, what: &str) -> String {
    let views = metrics["views"].as_array();
    let Some(found) = views.and_then(|all| all.iter().find(|v| v["name"] == view)) else { return String::new() };
    let psnr = |key: &str, after: &str| found[what][key].as_f64().map(|v| format!("{v:.2} dB{after}"));
    let all = [psnr("psnr", ""), psnr("psnr_aligned", " aligned")];
    all.into_iter().flatten().collect::<Vec<_>>().join(", ")
}
