//! Writer of files for other programs.

use crate::error::{Result, RunError};
use crate::exchange::beside;
use crate::gltf_lights::{gltf_leaves_out, punctual};
use crate::light_list::{LightList, write_light_list};
use crate::placement::transformed;
use crate::usd_lights::{usd_lights, usd_lights_left_out};
use glam::DVec3;
use sgs_scene::{
    GltfCoding, Placement, PlyDialect, Splats, SpzVersion, usd_leaves_out, write_gltf, write_sog, write_splat,
    write_spz, write_usd,
};
use std::borrow::Cow;
use std::path::{Path, PathBuf};

/// Format of a file for other programs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExportFormat {
    /// PLY of a dialect.
    Ply(PlyDialect),
    /// glTF, text or binary by its name.
    Gltf(GltfCoding),
    /// SPZ of a version.
    Spz(SpzVersion),
    /// `.splat`.
    Splat,
    /// SOG, archive or directory by its name.
    Sog,
    /// USD, text or package by its name.
    Usd,
}

/// Content of a file for other programs.
#[derive(Clone, Copy, Debug)]
pub struct Export<'a> {
    /// Gaussians, in the coordinates of the scene.
    pub splats: &'a Splats,
    /// Format of the file.
    pub format: ExportFormat,
    /// Lights, in the coordinates of the scene.
    pub lights: Option<&'a LightList>,
    /// File of the environment map.
    pub environment: Option<&'a Path>,
    /// Transform from the scene to the file.
    pub transform: Option<&'a Placement>,
}

impl ExportFormat {
    /// Returns the direction that points up in files of the format.
    ///
    /// Viewers turn PLY, `.splat` and SOG, because most of them come from COLMAP, whose y axis mostly points down.
    pub fn up(self) -> DVec3 {
        match self {
            ExportFormat::Ply(_) | ExportFormat::Splat | ExportFormat::Sog => DVec3::NEG_Y,
            ExportFormat::Gltf(_) | ExportFormat::Spz(_) | ExportFormat::Usd => DVec3::Y,
        }
    }

    /// Returns whether the format itself defines which direction is up.
    pub fn defines_up(self) -> bool {
        matches!(self, ExportFormat::Gltf(_) | ExportFormat::Spz(_) | ExportFormat::Usd)
    }

    /// Returns whether lights and environment map are written in the file or beside it.
    ///
    /// Light needs materials, which the others lack.
    pub fn holds_light(self) -> bool {
        matches!(self, ExportFormat::Gltf(_) | ExportFormat::Usd)
            || matches!(self, ExportFormat::Ply(dialect) if dialect != PlyDialect::ThreeDgs)
    }

    /// Returns whether files record the transform from the scene.
    fn records_transform(self) -> bool {
        !matches!(self, ExportFormat::Splat | ExportFormat::Spz(SpzVersion::V2 | SpzVersion::V3))
    }

    /// Returns whether files record that splats are for the 2D Mip filter.
    fn records_filter(self) -> bool {
        matches!(self, ExportFormat::Ply(_) | ExportFormat::Spz(_) | ExportFormat::Sog)
    }

    /// Returns the number of lights that a file holds.
    pub fn lights_held(self, list: &LightList) -> usize {
        match self {
            ExportFormat::Gltf(_) => list.lights.len() - gltf_leaves_out(list).len(),
            ExportFormat::Usd => list.lights.len() - usd_lights_left_out(list).len(),
            _ if self.holds_light() => list.lights.len(),
            _ => 0,
        }
    }
}

impl Export<'_> {
    /// Names what the format does not hold.
    pub fn leaves_out(&self) -> Vec<String> {
        let s = self.splats;
        let mut left_out: Vec<String> = match self.format {
            ExportFormat::Ply(dialect) => dialect.leaves_out(s).into_iter().map(str::to_owned).collect(),
            ExportFormat::Gltf(_) => {
                let emitters = s.emitters.iter().map(|_| "emitters of Gaussians".to_owned());
                emitters.chain(self.lights.map(gltf_leaves_out).unwrap_or_default()).collect()
            }
            ExportFormat::Usd => {
                let splats = usd_leaves_out(s).into_iter().map(str::to_owned);
                splats.chain(self.lights.map(usd_lights_left_out).unwrap_or_default()).collect()
            }
            ExportFormat::Spz(_) | ExportFormat::Splat | ExportFormat::Sog => {
                let harmonics = self.format == ExportFormat::Splat && s.sh_degree() > 0;
                let all = [
                    (harmonics, "harmonics above band 0"),
                    (s.normals.is_some(), "normals"),
                    (s.albedo.is_some() || s.roughness.is_some() || s.metallic.is_some(), "materials"),
                    (s.semantic.is_some(), "semantic features"),
                    (s.emitters.is_some(), "emitters"),
                    (s.light_gains.is_some(), "light gains"),
                ];
                all.into_iter().filter(|(has, _)| *has).map(|(_, name)| name.to_owned()).collect()
            }
        };
        if s.antialiased && !self.format.records_filter() {
            left_out.push("the filter against aliasing".to_owned());
        }
        if !self.format.holds_light() && (self.lights.is_some() || self.environment.is_some()) {
            left_out.push("light".to_owned());
        }
        if self.transform.is_some() && !self.format.records_transform() {
            left_out.push("the transform from the scene".to_owned());
        }
        left_out
    }
}

/// Writes Gaussians and light. Returns all files written.
///
/// Light that the format does not hold is omitted ([`Export::leaves_out`]). Lights and environment map beside a file keep
/// the coordinates of the scene.
///
/// # Errors
/// If the format cannot represent the Gaussians, or a file cannot be written.
pub fn write_export(path: &Path, export: &Export<'_>) -> Result<Vec<PathBuf>> {
    let Export { format, transform, .. } = *export;
    let lights = export.lights.filter(|_| format.holds_light());
    let environment = export.environment.filter(|_| format.holds_light());
    let splats = match transform {
        // A node above the splats holds the transform.
        Some(transform) if !matches!(format, ExportFormat::Gltf(_) | ExportFormat::Usd) => {
            Cow::Owned(transformed(export.splats.clone(), transform))
        }
        _ => Cow::Borrowed(export.splats),
    };
    let mut written = vec![path.to_owned()];
    let ends = |end: &str| path.extension().is_some_and(|e| e.eq_ignore_ascii_case(end));
    // A package holds its environment map; others have it beside them.
    let map = environment.filter(|_| !ends("usdz")).map(|from| (from, beside(path, "environment.exr")));
    if let Some((from, file)) = &map {
        let fail = |e: std::io::Error| RunError::File { path: from.to_path_buf(), reason: e.to_string() };
        let bytes = std::fs::read(from).map_err(fail)?;
        sgs_scene::atomic_write(file, |out| std::io::Write::write_all(out, &bytes))?;
    }
    match format {
        ExportFormat::Ply(dialect) => splats.write_ply_placed(path, dialect, transform)?,
        ExportFormat::Gltf(coding) => {
            let (lights, extras) = lights.map(punctual).unzip();
            write_gltf(path, &splats, coding, &lights.unwrap_or_default(), extras.as_ref(), transform)?;
            if ends("gltf") {
                written.push(beside(path, "bin"));
            }
        }
        ExportFormat::Spz(version) => write_spz(path, &splats, version, transform)?,
        ExportFormat::Splat => write_splat(path, &splats)?,
        ExportFormat::Sog => write_sog(path, &splats, transform)?,
        ExportFormat::Usd => {
            let lights = lights.map(usd_lights).unwrap_or_default();
            let map = map.as_ref().map(|(_, file)| file.as_path()).or(environment);
            write_usd(path, &splats, &lights, map, transform)?;
        }
    }
    if let (ExportFormat::Ply(_), Some(lights)) = (format, lights) {
        let file = beside(path, "lights.json");
        write_light_list(&file, lights)?;
        written.push(file);
    }
    written.extend(map.map(|(_, file)| file));
    Ok(written)
}

/// Writes Gaussians and light as PLY, or as glTF if `dialect` is `None`. Returns all files written.
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
    let format = dialect.map_or(ExportFormat::Gltf(GltfCoding::Floats), ExportFormat::Ply);
    write_export(path, &Export { splats, format, lights, environment, transform: None })
}
