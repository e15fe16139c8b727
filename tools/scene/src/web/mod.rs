//! Static page that shows splats in a browser, from files or from a server.
//!
//! Browsers refuse requests and modules in pages from files. Data are therefore scripts that call a function of the viewer with
//! text: `scene.js` describes the scene, and each `data-NNNN.js` holds a chunk of splats ([`pack`]).

mod pack;

use crate::activation::logistic;
use crate::atomic::atomic_write;
use crate::camera::Camera;
use crate::error::{Result, SceneError, io_error};
use crate::splats::Splats;
use base64::prelude::{BASE64_STANDARD, Engine as _};
use glam::DVec3;
use serde_json::json;
use std::io::Write;
use std::path::{Path, PathBuf};

pub use pack::{CHUNK, PageChunk};

/// Files of the viewer, as they are in every page except for the title.
const VIEWER: [(&str, &str); 4] = [
    ("index.html", include_str!("index.html")),
    ("viewer.js", include_str!("viewer.js")),
    ("controls.js", include_str!("controls.js")),
    ("license.txt", include_str!("license.txt")),
];

/// Opacity below which a splat shows at no pixel.
const OPACITY_MIN: f64 = 1.0 / 255.0;

/// Light of a page that visitors switch, dim and recolor.
#[derive(Clone, Debug, PartialEq)]
pub struct PageLight {
    /// Name in the panel.
    pub name: String,
    /// Whether the light is on at first.
    pub on: bool,
    /// Linear color at first, 1 at most.
    pub color: [f32; 3],
    /// Harmonics of the linear light of each splat under this light in white.
    ///
    /// `3 (degree + 1)²` numbers per splat: by function, then by channel.
    pub response: Vec<f32>,
}

/// Content of a page.
#[derive(Clone, Copy, Debug)]
pub struct Page<'a> {
    /// Title of the page.
    pub title: &'a str,
    /// Splats with display-referred colors.
    pub splats: &'a Splats,
    /// Views that visitors step through; the first is shown first.
    pub cameras: &'a [Camera],
    /// Direction that points up.
    pub up: DVec3,
    /// Display-referred background.
    pub background: [f32; 3],
    /// Lights.
    pub lights: &'a [PageLight],
    /// Degree of the harmonics of all responses.
    pub light_degree: usize,
}

/// Page on disk.
#[derive(Clone, Debug, PartialEq)]
pub struct WrittenPage {
    /// Files, `index.html` first.
    pub files: Vec<PathBuf>,
    /// Bytes of all files.
    pub bytes: u64,
    /// Number of splats; others show at no pixel and are left out.
    pub splats: usize,
}

/// Writes a page into a new or an empty folder.
///
/// The folder appears with all its files, or not at all.
///
/// # Errors
/// If no splat can show, there is no camera, a response has another length, the folder holds files, or writing fails.
pub fn write_page(folder: &Path, page: &Page<'_>) -> Result<WrittenPage> {
    page.splats.check()?;
    check(page)?;
    let kept: Vec<usize> = (0..page.splats.len()).filter(|i| shows(page.splats, *i)).collect();
    if kept.is_empty() {
        return Err(refused("it has no splat that shows; export a trained scene".into()));
    }
    if std::fs::read_dir(folder).is_ok_and(|mut d| d.next().is_some()) || folder.is_file() {
        return Err(refused(format!("{} holds files; name a new or an empty directory", folder.display())));
    }
    let Some(name) = folder.file_name() else {
        return Err(refused(format!("{} is no name of a directory; name a new one", folder.display())));
    };
    let parent = folder.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    std::fs::create_dir_all(parent).map_err(io_error("create", parent))?;
    // Beside the target, so that it can be renamed.
    let temporary = parent.join(format!(".{}.{}.tmp", name.to_string_lossy(), std::process::id()));
    std::fs::create_dir(&temporary).map_err(io_error("create", folder))?;
    let mut cleaner = Cleaner(Some(temporary.clone()));
    let (names, bytes) = write_files(&temporary, page, &kept)?;
    std::fs::rename(&temporary, folder).map_err(io_error("write", folder))?;
    cleaner.0 = None;
    Ok(WrittenPage { files: names.iter().map(|name| folder.join(name)).collect(), bytes, splats: kept.len() })
}

/// Folder that is deleted with its files, unless it was renamed.
struct Cleaner(Option<PathBuf>);

impl Drop for Cleaner {
    fn drop(&mut self) {
        if let Some(path) = &self.0 {
            let _ = std::fs::remove_dir_all(path);
        }
    }
}

fn refused(problem: String) -> SceneError {
    SceneError::Data { what: "the page", problem }
}

fn check(page: &Page<'_>) -> Result<()> {
    if page.cameras.is_empty() {
        return Err(refused("it has no camera; give at least one view".into()));
    }
    let numbers = 3 * (page.light_degree + 1).pow(2) * page.splats.len();
    match page.lights.iter().find(|light| light.response.len() != numbers) {
        Some(PageLight { name, response, .. }) => {
            let problem = format!("the light \"{name}\" has {} numbers, but {numbers} are needed", response.len());
            Err(refused(problem))
        }
        None => Ok(()),
    }
}

/// Returns whether a splat can show: finite, and as opaque as a pixel requires.
fn shows(s: &Splats, i: usize) -> bool {
    let finite = s.means[i].iter().chain(&s.log_scales[i]).all(|v| v.is_finite());
    finite && logistic(s.opacity_logits[i]) >= OPACITY_MIN
}

/// Writes all files; returns their names and bytes.
fn write_files(folder: &Path, page: &Page<'_>, kept: &[usize]) -> Result<(Vec<String>, u64)> {
    let (mut names, mut bytes) = (Vec::new(), 0);
    let mut put = |name: &str, text: &str| {
        names.push(name.to_owned());
        bytes += text.len() as u64;
        atomic_write(&folder.join(name), |f| f.write_all(text.as_bytes())).map(|()| bytes)
    };
    for (name, text) in VIEWER {
        put(name, &text.replace("{{title}}", &escaped(page.title)))?;
    }
    let mut total = 0;
    for (number, chunk) in kept.chunks(CHUNK).enumerate() {
        let text = BASE64_STANDARD.encode(pack::chunk(page, chunk));
        total = put(&format!("data-{number:04}.js"), &format!("sgs_chunk({number}, \"{text}\");\n"))?;
    }
    put("scene.js", &format!("sgs_scene({});\n", described(page, kept, total)))?;
    Ok((names, bytes))
}

/// Returns the description of the scene.
fn described(page: &Page<'_>, kept: &[usize], bytes: u64) -> serde_json::Value {
    let view = |camera: &Camera| {
        let rows = [0, 1, 2].map(|i| camera.rotation.row(i).to_array());
        json!({
            "name": camera.name, "size": [camera.width, camera.height], "focal": [camera.fx, camera.fy],
            "center": [camera.cx, camera.cy], "near": camera.near, "rotation": rows,
            "position": camera.position().to_array(),
        })
    };
    let light = |l: &PageLight| json!({"name": l.name, "on": l.on, "color": l.color});
    json!({
        "count": kept.len(), "chunk": CHUNK, "bytes": bytes,
        "degree": page.splats.sh_degree(), "antialiased": page.splats.antialiased, "light_degree": page.light_degree,
        "background": page.background, "up": page.up.to_array(), "radius": radius(page.splats, kept),
        "views": page.cameras.iter().map(view).collect::<Vec<_>>(),
        "lights": page.lights.iter().map(light).collect::<Vec<_>>(),
    })
}

/// Returns the median distance of the splats from their center.
///
/// It sets the speed of flight.
fn radius(s: &Splats, kept: &[usize]) -> f64 {
    let median = |mut values: Vec<f64>| {
        let middle = values.len() / 2;
        *values.select_nth_unstable_by(middle, f64::total_cmp).1
    };
    let center: [f64; 3] = std::array::from_fn(|k| median(kept.iter().map(|i| f64::from(s.means[*i][k])).collect()));
    let away = |i: &usize| DVec3::from(s.means[*i].map(f64::from)).distance(DVec3::from(center));
    median(kept.iter().map(away).collect()).max(1e-6)
}

/// Returns text as HTML.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests;
