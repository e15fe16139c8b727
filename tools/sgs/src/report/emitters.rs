//! Emitters of a run in a report: a table, and a view with each emitter alone and without each.

use super::lights::{self as light_marks, color, luminance};
use crate::lit::only;
use glam::{DVec3, Vec3};
use sgs_engine::Device;
use sgs_relight::Emitting;
use sgs_report::figure::{data_uri, rendered};
use sgs_report::room::{self, LightMark};
use sgs_report::{escape, number};
use sgs_run::{EmitterRow, Shading, ShapeRow, displayed};
use sgs_scene::{Camera, Image, Scene, Splats};

/// Maximum number of emitters with images of their own.
const MOST: usize = 32;

/// View that shows the emitters.
pub struct EmitterView<'a> {
    /// Scene of the run.
    pub scene: &'a Scene,
    /// Gaussians of the run.
    pub splats: &'a Splats,
    /// Camera.
    pub camera: &'a Camera,
    /// Largest width of an image.
    pub width: u32,
}

/// Image under one emitter, and its mean linear RGB.
struct Alone {
    shown: String,
    mean: [f64; 3],
}

/// Returns the section of emitters.
pub fn html(device: &Device, emitting: &Emitting, at: &EmitterView<'_>) -> anyhow::Result<String> {
    let rows = &emitting.file.emitters;
    if rows.is_empty() {
        return Ok("<p>The transport stage found no emitters.</p>\n".to_owned());
    }
    let frame = emitting.frame();
    let mut shading = Shading::new(device, emitting.live(device, at.splats)?)?.without_visibility();
    let mut seen = |on: &dyn Fn(usize) -> bool| -> anyhow::Result<Image> {
        shading.set_emitters(&only(&frame, on));
        Ok(shading.shade_again(at.camera)?.radiance([0.0; 3]))
    };
    let one = |name: &str, image: &Image| -> anyhow::Result<String> {
        let uri = data_uri(&displayed(image), at.width)?;
        Ok(rendered(name, &uri, [image.width, image.height], ""))
    };
    let all = one("all emitters", &seen(&|_| true)?)?;
    let (mut alone, mut without) = (Vec::new(), String::new());
    for (i, row) in rows.iter().enumerate().take(MOST) {
        let image = seen(&|k| k == i)?;
        alone.push(Alone { mean: mean(&image), shown: one(&format!("{} alone", row.name), &image)? });
        without.push_str(&one(&format!("without {}", row.name), &seen(&|k| k != i)?)?);
    }
    let total: f64 = alone.iter().map(|a| luminance(a.mean)).sum();
    let share = |a: &Alone| luminance(a.mean) / total.max(1e-30);
    let marks: Vec<LightMark> = rows
        .iter()
        .zip(&alone)
        .filter_map(|(row, a)| {
            let position = center(&row.shape)?;
            Some(LightMark { name: row.name.clone(), position, share: share(a), color: color(a.mean) })
        })
        .collect();
    let eyes: Vec<room::Eye> =
        at.scene.split.train.iter().map(|v| light_marks::eye(&at.scene.views[*v].camera)).collect();
    let left_out = match rows.len().saturating_sub(MOST) {
        0 => String::new(),
        more => format!(" {more} more emitters have no images."),
    };
    let mut out = format!(
        "<p>View {}. Direct light, bounces and emission of the surfaces.{left_out} Circles: emitters, as large as their share \
         of the light in this view.</p>\n",
        escape(&at.camera.name)
    );
    out.push_str(&table(rows, &alone.iter().map(share).collect::<Vec<_>>()));
    out.push_str(&format!("<div class=\"grid small\">\n{all}</div>\n"));
    let images: String = alone.into_iter().map(|a| a.shown).collect();
    for (title, figures) in [("Each emitter alone", images), ("Without each emitter", without)] {
        out.push_str(&format!("<h3>{title}</h3>\n<div class=\"grid small\">\n{figures}</div>\n"));
    }
    out.push_str(&room::drawing(&light_marks::opaque(at.splats), &eyes, &marks));
    Ok(out)
}

/// Returns the table of emitters: name, shape, share of the light, color and position.
fn table(rows: &[EmitterRow], shares: &[f64]) -> String {
    let mut out = String::from(
        "<div class=\"wide\"><table>\n<thead><tr><th>emitter</th><th>shape</th><th>share</th><th>color</th><th>red</th>\
         <th>green</th><th>blue</th><th>x</th><th>y</th><th>z</th></tr></thead>\n<tbody>\n",
    );
    for (i, row) in rows.iter().enumerate() {
        let off = if row.on { "" } else { " (off)" };
        let share = shares.get(i).map_or(String::new(), |share| format!("{:.1} %", 100.0 * share));
        let [r, g, b] = row.color.map(|v| number(f64::from(v)));
        let [x, y, z] = center(&row.shape).map_or([const { String::new() }; 3], |c| c.to_array().map(number));
        out.push_str(&format!(
            "<tr><th>{}{off}</th><td>{}</td><td>{share}</td><td><span class=\"swatch\" style=\"background:{}\"></span></td>\
             <td>{r}</td><td>{g}</td><td>{b}</td><td>{x}</td><td>{y}</td><td>{z}</td></tr>\n",
            escape(&row.name),
            kind(&row.shape),
            escape(&color(row.color.map(f64::from))),
        ));
    }
    out.push_str("</tbody></table></div>\n");
    out
}

/// Returns the name of a shape, as in `emitters.json`.
fn kind(shape: &ShapeRow) -> &'static str {
    match shape {
        ShapeRow::Point { .. } => "point",
        ShapeRow::Sphere { .. } => "sphere",
        ShapeRow::Rectangle { .. } => "rectangle",
        ShapeRow::Disk { .. } => "disk",
        ShapeRow::Spot { .. } => "spot",
        ShapeRow::Directional { .. } => "directional",
        ShapeRow::Window { .. } => "window",
    }
}

/// Returns the center of a shape; `None` for directional light.
fn center(shape: &ShapeRow) -> Option<DVec3> {
    let center = match *shape {
        ShapeRow::Point { position } | ShapeRow::Spot { position, .. } => Vec3::from(position),
        ShapeRow::Sphere { center, .. } | ShapeRow::Disk { center, .. } => Vec3::from(center),
        ShapeRow::Rectangle { corner, edge_u, edge_v } | ShapeRow::Window { corner, edge_u, edge_v } => {
            Vec3::from(corner) + 0.5 * (Vec3::from(edge_u) + Vec3::from(edge_v))
        }
        ShapeRow::Directional { .. } => return None,
    };
    Some(center.as_dvec3())
}

/// Returns the mean linear RGB.
fn mean(image: &Image) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for pixel in image.data.chunks_exact(3) {
        sum.iter_mut().zip(pixel).for_each(|(s, v)| *s += f64::from(*v));
    }
    sum.map(|s| s / image.pixels().max(1) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn table_names_shape_center_and_switch() {
        let shape = ShapeRow::Rectangle { corner: [1.0, 0.0, 0.0], edge_u: [0.0, 2.0, 0.0], edge_v: [0.0, 0.0, 4.0] };
        let window = EmitterRow { name: "window <1>".into(), on: false, color: [1.0, 0.5, 0.0], shape };
        let sun = ShapeRow::Directional { direction: [0.0, -1.0, 0.0], angular_radius: 0.27 };
        let sun = EmitterRow { name: "sun".into(), on: true, color: [1.0; 3], shape: sun };
        assert_eq!((center(&shape), center(&sun.shape)), (Some(DVec3::new(1.0, 1.0, 2.0)), None));
        let html = table(&[window, sun], &[0.25]);
        for text in
            ["window &lt;1&gt; (off)", "rectangle", "25.0 %", "#ffbc00", "<th>sun</th><td>directional</td><td></td>"]
        {
            assert!(html.contains(text), "{text}: {html}");
        }
    }
}
