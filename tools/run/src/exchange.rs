//! Exchange of Gaussians and light with other programs: PLY dialects and glTF.
//!
//! Gaussians are in the file itself. glTF contains its lights; a PLY has them beside it in `NAME.lights.json`. The
//! environment map is always beside the file in `NAME.environment.exr`. docs/reference/exchange.md lists what each
//! format keeps and loses.

use crate::error::{Result, RunError};
use crate::light_list::{LightList, ListedLight, read_light_list, write_light_list};
use crate::lights::{FORMAT, LightRow, LobeRow};
use crate::placement::{join, placed};
use crate::published::mean;
use crate::shaded::{RunLight, Texels, Visibility};
use crate::shadows::Rays;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use sgs_scene::{GltfScene, Placement, PlyDialect, PointLight, Splats, write_gltf};
use std::io::Read;
use std::path::{Path, PathBuf};

/// Contents of an exchange file.
#[derive(Clone, Debug)]
pub struct Exchange {
    /// Gaussians of the file.
    pub splats: Splats,
    /// Lights in the file or beside it.
    pub lights: Option<LightList>,
    /// Path of the environment map beside the file, a latitude-longitude image.
    pub environment: Option<PathBuf>,
    /// Kind of the file: a name of [`PlyDialect`], or `gltf`.
    pub format: &'static str,
}

/// Returns `NAME.WHAT` beside `NAME.ply` or another file.
fn beside(path: &Path, what: &str) -> PathBuf {
    path.with_extension(what)
}

fn is_gltf(path: &Path) -> Result<bool> {
    let fail = |e: std::io::Error| RunError::File { path: path.to_owned(), reason: e.to_string() };
    let mut first = [0; 4];
    let mut file = std::fs::File::open(path).map_err(fail)?;
    let have = file.read(&mut first).map_err(fail)?;
    let text = first[..have].trim_ascii_start();
    Ok(&first[..have] == b"glTF" || text.first() == Some(&b'{'))
}

/// Reads Gaussians from a file of any known kind, recognized by its content.
///
/// Logs a warning for each element of a glTF file that is left out.
///
/// # Errors
/// If the file is of no known kind or damaged.
pub fn read_splats(path: &Path) -> Result<Splats> {
    if !is_gltf(path)? {
        return Ok(Splats::read_ply(path)?);
    }
    Ok(joined(gltf(path)?.parts))
}

fn gltf(path: &Path) -> Result<GltfScene> {
    let scene = GltfScene::read(path)?;
    for what in &scene.left_out {
        tracing::warn!("{}: left out: {what}", path.display());
    }
    Ok(scene)
}

/// Reads Gaussians and light from a file of any known kind.
///
/// # Errors
/// If the file or its lights are of no known kind or damaged.
pub fn read_exchange(path: &Path) -> Result<Exchange> {
    let environment = Some(beside(path, "environment.exr")).filter(|file| file.is_file());
    if is_gltf(path)? {
        let scene = gltf(path)?;
        let lights = lights_of(path, &scene)?;
        return Ok(Exchange { splats: joined(scene.parts), lights, environment, format: "gltf" });
    }
    let (splats, dialect) = Splats::read_ply_dialect(path)?;
    let lights = beside(path, "lights.json");
    let lights = if lights.is_file() { Some(read_light_list(&lights)?) } else { None };
    Ok(Exchange { splats, lights, environment, format: dialect.name() })
}

/// Reads the light of a file: lights and environment map in it or beside it.
///
/// Shadows of the lights are traced. The environment map has `size` texels per edge of a cube face.
///
/// # Errors
/// If one of the files is damaged.
pub fn read_light(path: &Path, size: u32) -> Result<RunLight> {
    let (light_table, environment_map) = (beside(path, "lights.json"), beside(path, "environment.exr"));
    let lights = match is_gltf(path)? {
        true => lights_of(path, &GltfScene::read(path)?)?,
        false if light_table.is_file() => Some(read_light_list(&light_table)?),
        false => None,
    };
    let fail = |reason| RunError::File { path: path.to_owned(), reason };
    let lights = lights.map(|list| list.published()).transpose().map_err(fail)?;
    let environment = if environment_map.is_file() { Some(Texels::read(&environment_map, size)?) } else { None };
    let visibility = if lights.is_some() { Visibility::Traced(Rays::default()) } else { Visibility::None };
    Ok(RunLight { lights, environment, visibility })
}

/// Writes Gaussians and light as PLY or glTF. Returns all files written.
///
/// Writes glTF if `dialect` is `None`.
///
/// # Errors
/// If the dialect cannot represent the Gaussians, or a file cannot be written.
pub fn write_exchange(
    path: &Path,
    splats: &Splats,
    dialect: Option<PlyDialect>,
    lights: Option<&LightList>,
    environment: Option<&Path>,
) -> Result<Vec<PathBuf>> {
    let mut written = vec![path.to_owned()];
    match (dialect, lights) {
        (Some(dialect), _) => splats.write_ply_as(path, dialect)?,
        (None, Some(file)) => {
            let extras = json!({"sgs": Together { format: FORMAT.to_owned(), normalizer: file.normalizer }});
            write_gltf(path, splats, &points(file), Some(&extras))?;
        }
        (None, None) => write_gltf(path, splats, &[], None)?,
    }
    if dialect.is_none() && path.extension().is_some_and(|e| e.eq_ignore_ascii_case("gltf")) {
        written.push(beside(path, "bin"));
    }
    if let (Some(_), Some(lights)) = (dialect, lights) {
        let file = beside(path, "lights.json");
        write_light_list(&file, lights)?;
        written.push(file);
    }
    if let Some(from) = environment {
        let file = beside(path, "environment.exr");
        let fail = |e: std::io::Error| RunError::File { path: from.to_owned(), reason: e.to_string() };
        let bytes = std::fs::read(from).map_err(fail)?;
        sgs_scene::atomic_write(&file, |out| std::io::Write::write_all(out, &bytes))?;
        written.push(file);
    }
    Ok(written)
}

/// Transforms and joins all sets of Gaussians.
fn joined(parts: Vec<(Splats, Placement)>) -> Splats {
    let stand = |(splats, place): (Splats, Placement)| match place == Placement::NONE {
        true => splats,
        false => placed(splats, &place),
    };
    let all = parts.into_iter().map(stand);
    all.reduce(|mut host, guest| {
        join(&mut host, guest);
        host
    })
    .unwrap_or_default()
}

/// SGS extension data of all lights together.
#[derive(Serialize, Deserialize)]
struct Together {
    format: String,
    normalizer: f32,
}

/// SGS extension data of a light.
#[derive(Serialize, Deserialize)]
struct Beyond {
    gain: f32,
    lobes: Vec<LobeRow>,
}

fn points(file: &LightList) -> Vec<PointLight> {
    let lobes = file.lights.iter().filter_map(|light| match light {
        ListedLight::Lobes(row) => Some(point(file, row)),
        ListedLight::Physical(_) => None,
    });
    lobes.collect()
}

/// Converts a light to a point light of its mean intensity.
fn point(file: &LightList, light: &LightRow) -> PointLight {
    let factor = f64::from(file.normalizer) * f64::from(light.gain);
    let of = |l: &LobeRow, c: usize| f64::from(l.amplitude[c]) * mean(f64::from(l.sharpness));
    let sent = [0, 1, 2].map(|c| factor * light.lobes.iter().map(|l| of(l, c)).sum::<f64>());
    let most = sent.iter().fold(0.0_f64, |a, b| a.max(*b));
    let color = sent.map(|v| if most > 0.0 { (v / most) as f32 } else { 1.0 });
    let beyond = Beyond { gain: light.gain, lobes: light.lobes.clone() };
    PointLight { position: light.position, color, intensity: most as f32, extras: Some(json!({"sgs": beyond})) }
}

/// Returns the lights of a glTF file.
///
/// Lights written by SGS have all their lobes. Other lights have one isotropic lobe.
fn lights_of(path: &Path, scene: &GltfScene) -> Result<Option<LightList>> {
    if scene.lights.is_empty() {
        return Ok(None);
    }
    let fail = |reason: String| RunError::File { path: path.to_owned(), reason };
    let own = |value: &Option<Value>| value.as_ref().and_then(|v| v.get("sgs")).cloned();
    let together: Option<Together> = own(&scene.light_extras)
        .map(|v| serde_json::from_value(v).map_err(|e| fail(format!("its lights are not as SGS writes them: {e}"))))
        .transpose()?;
    let normalizer = together.as_ref().map_or(1.0, |t| t.normalizer);
    let mut rows = Vec::new();
    for (i, light) in scene.lights.iter().enumerate() {
        let row = match own(&light.extras).filter(|_| together.is_some()) {
            Some(v) => {
                let b: Beyond = serde_json::from_value(v)
                    .map_err(|e| fail(format!("its light {i} is not as SGS writes them: {e}")))?;
                LightRow { position: light.position, gain: b.gain, lobes: b.lobes }
            }
            None => {
                let factor = light.intensity / if normalizer > 0.0 { normalizer } else { 1.0 };
                let lobe =
                    LobeRow { axis: [0.0, 0.0, 1.0], sharpness: 0.0, amplitude: light.color.map(|c| c * factor) };
                LightRow { position: light.position, gain: 1.0, lobes: vec![lobe] }
            }
        };
        rows.push(ListedLight::Lobes(row));
    }
    if let Some(Together { format, .. }) = together.filter(|t| t.format != FORMAT) {
        return Err(fail(format!("the format of its lights is \"{format}\", not \"{FORMAT}\"")));
    }
    let list = LightList { normalizer, lights: rows };
    list.check().map_err(fail)?;
    Ok(Some(list))
}
