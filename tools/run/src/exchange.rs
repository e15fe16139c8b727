//! Files of Gaussians and light of this or another program, in any known format.
//!
//! Gaussians are in the file itself. glTF contains its lights; a PLY has them beside it in `NAME.lights.json`. The
//! environment map is always beside the file in `NAME.environment.exr`. docs/reference/exchange.md lists what each
//! format keeps and loses. A transform that a file records is undone, so Gaussians and lights are in the coordinates of
//! their scene.

use crate::error::{Result, RunError};
use crate::gltf_lights::lights_of;
use crate::light_list::{LightList, ListedLight, read_light_list};
use crate::placement::{join, placed, transformed};
use crate::published::read_lights;
use crate::shaded::{RunLight, Texels, Visibility};
use crate::shadows::Rays;
use sgs_passes::transport::LightShape;
use sgs_scene::{GltfScene, Placement, SplatFile, SplatKind, Splats};
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
    /// Kind of the file: a name of a [`PlyDialect`](sgs_scene::PlyDialect) or of a [`SplatKind`].
    pub format: &'static str,
}

/// Returns `NAME.WHAT` beside `NAME.ply` or another file.
pub(crate) fn beside(path: &Path, what: &str) -> PathBuf {
    path.with_extension(what)
}

/// Returns whether a file is glTF, by its content.
///
/// # Errors
/// If the file cannot be read.
pub fn is_gltf(path: &Path) -> Result<bool> {
    Ok(SplatKind::of(path)? == SplatKind::Gltf)
}

/// Reads Gaussians from a file of any known kind, recognized by its content.
///
/// Logs a warning for each element of a file that is left out.
///
/// # Errors
/// If the file is of no known kind or damaged.
pub fn read_splats(path: &Path) -> Result<Splats> {
    match SplatKind::of(path)? {
        SplatKind::Gltf => Ok(joined(gltf(path)?.parts)),
        kind => Ok(in_scene(path, SplatFile::read(path, kind)?.0)),
    }
}

fn warn(path: &Path, left_out: &[String]) {
    for what in left_out {
        tracing::warn!("{}: left out: {what}", path.display());
    }
}

/// Undoes the transform that the file records, and logs what is left out.
fn in_scene(path: &Path, file: SplatFile) -> Splats {
    warn(path, &file.left_out);
    match &file.transform {
        Some(transform) => transformed(file.splats, &transform.inverse()),
        None => file.splats,
    }
}

fn gltf(path: &Path) -> Result<GltfScene> {
    let scene = GltfScene::read(path)?;
    warn(path, &scene.left_out);
    Ok(scene)
}

/// Reads Gaussians and light from a file of any known kind.
///
/// # Errors
/// If the file or its lights are of no known kind or damaged.
pub fn read_exchange(path: &Path) -> Result<Exchange> {
    let environment = Some(beside(path, "environment.exr")).filter(|file| file.is_file());
    let kind = SplatKind::of(path)?;
    if kind == SplatKind::Gltf {
        let scene = gltf(path)?;
        let lights = lights_of(path, &scene)?;
        return Ok(Exchange { splats: joined(scene.parts), lights, environment, format: kind.name() });
    }
    let (file, format) = SplatFile::read(path, kind)?;
    let lights = beside(path, "lights.json");
    let lights = if lights.is_file() { Some(read_light_list(&lights)?) } else { None };
    Ok(Exchange { splats: in_scene(path, file), lights, environment, format })
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
