//! The pictures of a report, view by view: truth under a slider where there is truth, else the picture alone.

use super::lamps::Lamps;
use crate::cameras::upload;
use crate::classes::head_of;
use crate::common::Common;
use crate::palette::colors;
use crate::ui::Bar;
use serde_json::Value;
use sgs_engine::Device;
use sgs_report::figure::{data_uri, picture, slider};
use sgs_report::{escape, number};
use sgs_scene::{GroundTruth, GroundTruthKind as Kind, Image, Scene, Splats};
use sgs_train::{
    Rendered, RunDirectory, RunLight, Settings, ShadedView, Shading, TrainError, displayed, evaluate_classes,
    evaluate_shaded, shaded_scene,
};
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

/// Figures of a view: those of what is seen, and those of single lights.
#[derive(Default)]
struct Figures {
    main: String,
    lamps: String,
}

/// All views, one below the other.
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
) -> anyhow::Result<String> {
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
            if lit {
                let photo = scene.load_image(view)?;
                let note = noted(metrics, name, "pbr");
                let ours = displayed(&s.radiance(background));
                figures.main.push_str(&pair("shaded", &photo, &ours, &note, shown)?);
            }
            figures.main.push_str(&shaded_parts(&truth, view, s, &has, &noted(metrics, name, "albedo"), shown)?);
            done += 1;
            bar.set(done, || name.to_owned());
            Ok(())
        })?;
        for (name, gains) in shown.lamps.brightest(shown.most) {
            shading.set_gains(device, &gains)?;
            for &view in views {
                let camera = &scene.views[view].camera;
                let image = displayed(&shading.shade(camera)?.direct());
                all.entry(camera.name.clone()).or_default().lamps.push_str(&one(&name, &image, shown)?);
            }
        }
        if lights.is_some() {
            shading.set_gains(device, &shown.lamps.gains())?;
        }
    }
    bar.finish();
    let mut out = String::new();
    for &view in views {
        let name = &scene.views[view].camera.name;
        let Some(f) = all.get(name) else { continue };
        out.push_str(&format!("<h3>{}</h3>\n<div class=\"grid\">\n{}</div>\n", escape(name), f.main));
        if !f.lamps.is_empty() {
            out.push_str(&format!(
                "<details><summary>Light by light</summary><div class=\"grid small\">\n{}</div></details>\n",
                f.lamps
            ));
        }
    }
    Ok(out)
}

/// What a run has beside albedo and roughness.
struct Has {
    metallic: bool,
    lit: bool,
    lamps: bool,
    sky: bool,
}

type Figured = Result<String, TrainError>;

fn one(name: &str, image: &Image, shown: &Shown) -> Figured {
    Ok(picture(name, &data_uri(image, shown.width)?, [image.width, image.height]))
}

fn pair(name: &str, truth: &Image, ours: &Image, note: &str, shown: &Shown) -> Figured {
    let [t, o] = [data_uri(truth, shown.width)?, data_uri(ours, shown.width)?];
    Ok(slider(name, &t, &o, [ours.width, ours.height], note))
}

/// A slider where there is truth.
fn maybe(name: &str, truth: Option<Image>, ours: &Image, note: &str, shown: &Shown) -> Figured {
    match truth {
        Some(truth) => pair(name, &truth, ours, note, shown),
        None => one(name, ours, shown),
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
    let far = theirs.as_ref().unwrap_or(&r.depth).data.iter().fold(1e-6_f32, |m, v| m.max(*v));
    let scaled = |d: &Image| Image { data: d.data.iter().map(|v| v / far).collect(), ..d.clone() };
    out.push_str(&maybe("depth", theirs.as_ref().map(scaled), &scaled(&r.depth), "", shown)?);
    if let Some(labels) = &r.labels {
        let color = |l: &Option<u32>| {
            l.and_then(|l| palette.get(l as usize)).map_or([0.0; 3], |c| c.map(|v| f32::from(v) / 255.0))
        };
        let data = labels.iter().flat_map(color).collect();
        out.push_str(&one("classes", &Image { channels: 3, data, ..r.rgb.clone() }, shown)?);
    }
    Ok(out)
}

/// Materials and parts of light.
fn shaded_parts(truth: &GroundTruth, view: usize, s: &ShadedView, has: &Has, note: &str, shown: &Shown) -> Figured {
    let mut out = String::new();
    let mut add = |html: String| out.push_str(&html);
    let albedo = truth.load(Kind::Albedo, view)?.map(|t| displayed(&t));
    add(maybe("albedo", albedo, &displayed(&s.albedo()), note, shown)?);
    add(maybe("roughness", truth.load(Kind::Roughness, view)?, &s.roughness(), "", shown)?);
    if has.metallic {
        add(maybe("metallic", truth.load(Kind::Metallic, view)?, &s.metallic(), "", shown)?);
    }
    if let Some(visibility) = s.visibility().filter(|_| has.lamps) {
        add(one("visibility", &visibility, shown)?);
    }
    if has.sky {
        add(one("environment", &displayed(&s.surroundings()), shown)?);
    }
    if has.lamps {
        add(one("direct", &displayed(&s.direct()), shown)?);
    }
    if has.lit {
        add(one("diffuse", &displayed(&s.diffuse()), shown)?);
        add(one("specular", &displayed(&s.specular()), shown)?);
    }
    Ok(out)
}

/// Unit vectors as colors.
fn colored(normal: &Image) -> Image {
    Image { data: normal.data.iter().map(|v| v * 0.5 + 0.5).collect(), ..normal.clone() }
}

/// The decibels of a view, if they are known.
fn noted(metrics: &Value, view: &str, what: &str) -> String {
    let views = metrics["views"].as_array();
    let found = views.and_then(|all| all.iter().find(|v| v["name"] == view));
    found.and_then(|v| v[what]["psnr"].as_f64()).map_or(String::new(), |v| format!("{} dB", number(v)))
}
