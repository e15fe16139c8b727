//! The images of a report: first photograph, render, albedo and relit side by side, then every channel view by view. Channels
//! with truth have a slider.

use super::evening;
use super::lamps::Lamps;
use crate::cameras::upload;
use crate::classes::head_of;
use crate::common::Common;
use crate::palette::colors;
use crate::ui::Bar;
use serde_json::Value;
use sgs_config::Settings;
use sgs_engine::Device;
use sgs_evaluate::{EvaluateError, Rendered, evaluate_classes, evaluate_shaded};
use sgs_report::depth;
use sgs_report::escape;
use sgs_report::figure::{data_uri, picture, slider};
use sgs_run::{RunDirectory, RunLight, ShadedView, Shading, displayed, shaded_scene};
use sgs_scene::{GroundTruth, GroundTruthKind as Kind, Image, Scene, Splats};
use std::collections::BTreeMap;

/// How they are shown.
pub struct Shown<'a> {
    /// Pixels across at most.
    pub width: u32,
    /// The lights.
    pub lamps: &'a Lamps,
    /// How many of them are shown alone.
    pub most: usize,
}

/// Views that stand side by side at the head of a report.
const FIRST: usize = 3;

/// The images as HTML.
pub struct Html {
    /// Those at the head.
    pub first: String,
    /// All channels of all views.
    pub views: String,
}

/// Figures of a view: side by side, of what is trained, of materials, of light, of single lights.
#[derive(Default)]
struct Figures {
    strip: String,
    main: String,
    materials: String,
    light: String,
    lamps: String,
    /// Mean radiance of the shaded image.
    mean: f32,
}

/// Renders the views.
pub fn html(
    common: &Common,
    device: &Device,
    scene: &Scene,
    run: &RunDirectory,
    splats: &Splats,
    settings: &Settings,
    light: &RunLight,
    views: &[usize],
    metrics: &Value,
    shown: &Shown,
) -> anyhow::Result<Html> {
    let truth = GroundTruth::of(scene);
    let classified = splats.semantic.is_some() && run.semantics().exists();
    let head = if classified { Some(head_of(run.root(), splats)?) } else { None };
    let palette = head.as_ref().map(|h| colors(h.text.labels.len())).unwrap_or_default();
    let gaussians = upload(device, splats, head.is_some())?;
    let background = settings.geometry.background;
    let materials = splats.albedo.is_some() && splats.roughness.is_some() && splats.normals.is_some();
    let mut bar = Bar::new(common, "pictures", views.len() as u64 * if materials { 2 } else { 1 }, 0);
    let mut done = 0;
    let mut all: BTreeMap<String, Figures> = BTreeMap::new();
    let mut next = views.iter();
    let mut result = evaluate_classes(device, scene, &gaussians, views, background, head.as_ref(), None, |name, r| {
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
            let has =
                Has { metallic: splats.metallic.is_some(), lit, lamps: lights.is_some(), sky: environment.is_some() };
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
        for (name, gains) in shown.lamps.brightest(shown.most) {
            shading.set_gains(device, &gains)?;
            for &view in views {
                let camera = &scene.views[view].camera;
                let image = displayed(&shading.shade(camera)?.direct());
                all.entry(camera.name.clone()).or_default().lamps.push_str(&one(&name, &image, "", shown)?);
            }
        }
        // There may be no memory for both.
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
        if !f.lamps.is_empty() {
            html.views.push_str(&format!(
                "<details><summary>Light by light</summary><div class=\"grid small\">\n{}</div></details>\n",
                f.lamps
            ));
        }
    }
    Ok(html)
}

/// What a run has beside albedo and roughness.
struct Has {
    metallic: bool,
    lit: bool,
    lamps: bool,
    sky: bool,
}

type Figured = Result<String, EvaluateError>;

fn one(name: &str, image: &Image, note: &str, shown: &Shown) -> Figured {
    Ok(picture(name, &data_uri(image, shown.width)?, [image.width, image.height], note))
}

/// Photograph and render; without materials also normal and depth.
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

/// A slider where there is truth.
fn maybe(name: &str, truth: Option<Image>, ours: &Image, note: &str, shown: &Shown) -> Figured {
    match truth {
        Some(truth) => pair(name, &truth, ours, note, shown),
        None => one(name, ours, note, shown),
    }
}

/// Color, normals, depth and classes.
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

/// Materials.
fn material_parts(truth: &GroundTruth, view: usize, s: &ShadedView, has: &Has, note: &str, shown: &Shown) -> Figured {
    let albedo = truth.load(Kind::Albedo, view)?.map(|t| displayed(&t));
    let mut out = maybe("albedo", albedo, &displayed(&s.albedo()), note, shown)?;
    out.push_str(&maybe("roughness", truth.load(Kind::Roughness, view)?, &s.roughness(), "", shown)?);
    if has.metallic {
        out.push_str(&maybe("metallic", truth.load(Kind::Metallic, view)?, &s.metallic(), "", shown)?);
    }
    Ok(out)
}

/// Parts of light.
fn light_parts(s: &ShadedView, has: &Has, shown: &Shown) -> Figured {
    let mut parts = Vec::new();
    if has.lamps {
        parts.push(("direct", displayed(&s.direct())));
    }
    if has.sky {
        parts.push(("environment", displayed(&s.surroundings())));
    }
    if has.lit {
        parts.extend([("diffuse", displayed(&s.diffuse())), ("specular", displayed(&s.specular()))]);
    }
    if let Some(visibility) = s.visibility().filter(|_| has.lamps) {
        parts.push(("visibility", visibility));
    }
    parts.iter().map(|(name, image)| one(name, image, "", shown)).collect()
}

/// Unit vectors as colors.
fn colored(normal: &Image) -> Image {
    Image { data: normal.data.iter().map(|v| v * 0.5 + 0.5).collect(), ..normal.clone() }
}

/// The decibels of a view, if they are known.
fn noted(metrics: &Value, view: &str, what: &str) -> String {
    let views = metrics["views"].as_array();
    let found = views.and_then(|all| all.iter().find(|v| v["name"] == view));
    found.and_then(|v| v[what]["psnr"].as_f64()).map_or(String::new(), |v| format!("{v:.2} dB"))
}
