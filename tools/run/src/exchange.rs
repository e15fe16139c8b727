//! Exchange of Gaussians and light with other programs: PLY dialects and glTF.
//!
//! Gaussians are in the file itself. glTF contains its lights; a PLY has them beside it in `NAME.lights.json`. The
//! environment map is always beside the file in `NAME.environment.exr`. docs/reference/exchange.md lists what each
//! format keeps and loses.

use crate::error::{Result, RunError};
use crate::gltf_lights::{lights_of, punctual};
use crate::light_list::{LightList, ListedLight, read_light_list, write_light_list};
use crate::placement::{join, placed};
use crate::published::read_lights;
use crate::shaded::{RunLight, Texels, Visibility};
use crate::shadows::Rays;
use sgs_passes::transport::LightShape;
use sgs_scene::{GltfScene, Placement, PlyDialect, Splats, write_gltf};
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

/// Returns whether a file is glTF, by its content.
///
/// # Errors
/// If the file cannot be read.
pub fn is_gltf(path: &Path) -> Result<bool> {
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

/// Leaves out directional lights, which the published model does not shade. Logs their number.
fn without_directional(path: &Path, mut list: LightList) -> LightList {
    let all = list.lights.len();
    let directional = |light: &ListedLight| matches!(light, ListedLight::Physical(row) if matches!(row.shape, LightShape::Directional { .. }));
    list.lights.retain(|light| !directional(light));
    let left_out = all - list.lights.len();
    if left_out > 0 {
        let path = path.display();
        tracing::warn!("{path}: left out: {left_out} directional lights, which the published model does not shade");
    }
    list
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
        true => {
            let list = lights_of(path, &GltfScene::read(path)?)?.map(|list| without_directional(path, list));
            let list = list.filter(|list| !list.lights.is_empty());
            list.map(|list| list.published()).transpose().map_err(|reason| RunError::file(path, reason))?
        }
        false if light_table.is_file() => Some(read_lights(&light_table)?),
        false => None,
    };
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
        (None, Some(list)) => {
            let (lights, extras) = punctual(list);
            write_gltf(path, splats, &lights, Some(&extras))?;
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
