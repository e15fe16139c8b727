//! Export of Gaussians and light for other programs: `sgs export`.

use super::export_page::{self, PageExport};
use crate::cameras::splats_of;
use crate::common::Common;
use crate::failure::refuse_usage;
use crate::viewpoints::up_of;
use glam::DVec3;
use sgs_config::Settings;
use sgs_run::{
    Export, ExportFormat, LightList, RunDirectory, read_emitters, read_exchange, read_light_list, write_export,
};
use sgs_scene::{Camera, GltfCoding, Placement, PlyDialect, Scene, SpzVersion};
use std::path::{Path, PathBuf};

#[derive(clap::Args)]
pub struct Args {
    /// Run directory, or a file of this or another program.
    source: PathBuf,
    /// File to write. Lights and an environment map that its format cannot hold are written beside it.
    #[arg(short, long, value_name = "FILE", required_unless_present = "web")]
    output: Option<PathBuf>,
    /// Directory to write a page for browsers into (docs/guide/page.md).
    #[arg(long, value_name = "DIR", conflicts_with_all = ["output", "format", "scale"])]
    web: Option<PathBuf>,
    /// Transforms file with the views of --web; by default those of the run's scene.
    #[arg(long, value_name = "FILE.json", requires = "web")]
    cameras: Option<PathBuf>,
    /// Scene directory of --web; by default that of the training.
    #[arg(long, value_name = "DIR", requires = "web")]
    scene: Option<PathBuf>,
    /// File format (docs/reference/exchange.md); by default from the file's extension.
    #[arg(long, value_enum)]
    format: Option<Format>,
    /// Direction of the scene that points up in the file; by default that of the cameras of a run for glTF, SPZ and USD.
    #[arg(long, value_enum, value_name = "AXIS", allow_hyphen_values = true)]
    up: Option<Up>,
    /// Factor of all lengths.
    #[arg(long, value_name = "F", default_value_t = 1.0)]
    scale: f64,
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Up {
    /// +x
    #[value(name = "x")]
    X,
    /// +y
    #[value(name = "y")]
    Y,
    /// +z
    #[value(name = "z")]
    Z,
    /// -x
    #[value(name = "-x")]
    MinusX,
    /// -y
    #[value(name = "-y")]
    MinusY,
    /// -z
    #[value(name = "-z")]
    MinusZ,
    /// The axes of the scene stay as they are.
    Keep,
}

impl Up {
    fn direction(self) -> Option<DVec3> {
        Some(match self {
            Up::X => DVec3::X,
            Up::Y => DVec3::Y,
            Up::Z => DVec3::Z,
            Up::MinusX => DVec3::NEG_X,
            Up::MinusY => DVec3::NEG_Y,
            Up::MinusZ => DVec3::NEG_Z,
            Up::Keep => return None,
        })
    }
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    /// PLY with materials, as scene.ply of a run; 3DGS viewers open it.
    Ply,
    /// PLY with the properties of 3DGS only.
    #[value(name = "3dgs")]
    ThreeDgs,
    /// PLY with materials, in the layout of GS-IR.
    GsIr,
    /// PLY with materials, in the layout of Relightable 3D Gaussians.
    R3dg,
    /// PLY with materials and features, in the layout of the published SGS.
    Sgs,
    /// PLY with albedo in place of colors, in the layout of mesh2splat.
    Mesh2splat,
    /// glTF with its data in a .bin file beside it.
    Gltf,
    /// glTF in a single file.
    Glb,
    /// glTF with its data in a .bin file beside it, Gaussians compressed as SPZ.
    GltfSpz,
    /// glTF in a single file, Gaussians compressed as SPZ.
    GlbSpz,
    /// SPZ of version 4.
    Spz,
    /// SPZ of version 3.
    Spz3,
    /// SPZ of version 2.
    Spz2,
    /// 32 bytes per splat, colors without harmonics.
    Splat,
    /// SOG: images in an archive, or in a directory if the file is meta.json.
    Sog,
    /// USD as text, with materials and lights.
    Usda,
    /// USD as a package with its environment map.
    Usdz,
}

/// File extensions, and the formats that they select.
const EXTENSIONS: &[(&str, Format)] = &[
    ("ply", Format::Ply),
    ("gltf", Format::Gltf),
    ("glb", Format::Glb),
    ("spz", Format::Spz),
    ("splat", Format::Splat),
    ("sog", Format::Sog),
    ("usda", Format::Usda),
    ("usdz", Format::Usdz),
];

impl Format {
    fn format(self) -> ExportFormat {
        match self {
            Format::Ply => ExportFormat::Ply(PlyDialect::Own),
            Format::ThreeDgs => ExportFormat::Ply(PlyDialect::ThreeDgs),
            Format::GsIr => ExportFormat::Ply(PlyDialect::GsIr),
            Format::R3dg => ExportFormat::Ply(PlyDialect::R3dg),
            Format::Sgs => ExportFormat::Ply(PlyDialect::Sgs),
            Format::Mesh2splat => ExportFormat::Ply(PlyDialect::Mesh2Splat),
            Format::Gltf | Format::Glb => ExportFormat::Gltf(GltfCoding::Floats),
            Format::GltfSpz | Format::GlbSpz => ExportFormat::Gltf(GltfCoding::Spz),
            Format::Spz => ExportFormat::Spz(SpzVersion::V4),
            Format::Spz3 => ExportFormat::Spz(SpzVersion::V3),
            Format::Spz2 => ExportFormat::Spz(SpzVersion::V2),
            Format::Splat => ExportFormat::Splat,
            Format::Sog => ExportFormat::Sog,
            Format::Usda | Format::Usdz => ExportFormat::Usd,
        }
    }

    fn extension(self) -> &'static str {
        match self {
            Format::Spz2 | Format::Spz3 => "spz",
            Format::GltfSpz => "gltf",
            Format::GlbSpz => "glb",
            _ => EXTENSIONS.iter().find(|(_, format)| *format == self).map_or("ply", |(end, _)| end),
        }
    }

    /// Returns the format of an output file.
    ///
    /// The requested format must fit the extension; by default the extension selects it.
    fn of(path: &Path, requested: Option<Format>) -> anyhow::Result<Format> {
        let end = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
        // The images of a SOG lie beside their text.
        let images = path.file_name().is_some_and(|name| name.eq_ignore_ascii_case("meta.json"));
        let end = if images { "sog".to_owned() } else { end };
        let Some((_, named)) = EXTENSIONS.iter().find(|(e, _)| *e == end) else {
            let ends: Vec<String> = EXTENSIONS.iter().map(|(end, _)| format!(".{end}")).collect();
            refuse_usage!("\"{}\" ends in none of {}, which are written.", path.display(), ends.join(", "))
        };
        match requested {
            Some(format) if format.extension() != end => {
                refuse_usage!(
                    "\"{}\" does not end in .{}, as files of that format do.",
                    path.display(),
                    format.extension()
                )
            }
            requested => Ok(requested.unwrap_or(*named)),
        }
    }
}

/// Returns the up direction of a run's cameras, or a close world axis.
///
/// An axis is close within six degrees.
fn up_of_run(settings: &Settings) -> Option<DVec3> {
    let scene = match Scene::open(&settings.scene, &settings.scene_options()) {
        Ok(scene) => scene,
        Err(error) => {
            tracing::warn!("the axes of the scene stay as they are, because its cameras are not there: {error}");
            return None;
        }
    };
    let cameras: Vec<Camera> = scene.views.into_iter().map(|view| view.camera).collect();
    let up = up_of(&cameras);
    let axes = [DVec3::X, DVec3::Y, DVec3::Z].map(|a| if a.dot(up) < 0.0 { -a } else { a });
    Some(axes.into_iter().find(|a| a.dot(up) > 0.995).unwrap_or(up))
}

pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    if let Some(folder) = &a.web {
        let (scene, cameras) = (a.scene.as_deref(), a.cameras.as_deref());
        let up = a.up.and_then(Up::direction);
        return export_page::run(common, &PageExport { source: &a.source, folder, scene, cameras, up });
    }
    let Some(output) = &a.output else { refuse_usage!("Nothing is exported; name a file with --output.") };
    let format = Format::of(output, a.format)?.format();
    if !(1e-6..=1e6).contains(&a.scale) {
        refuse_usage!("--scale is {}; use a number from 1e-6 to 1e6.", a.scale);
    }
    let (splats, lights, environment, settings) = if a.source.is_file() {
        let file = read_exchange(&a.source)?;
        (file.splats, file.lights, file.environment, None)
    } else {
        let (splats, settings) = splats_of(&a.source)?;
        let run = RunDirectory::open(&a.source)?;
        let [lights, environment] = ["lights.json", "environment.exr"].map(|name| run.path(name));
        let lights = match format {
            // The emitters of a run are its light.
            ExportFormat::Gltf(_) | ExportFormat::Usd if run.emitters().is_file() => {
                Some(LightList::of_emitters(&read_emitters(&run.emitters())?))
            }
            _ if lights.is_file() => Some(read_light_list(&lights)?),
            _ => None,
        };
        (splats, lights, Some(environment).filter(|file| file.is_file()), settings)
    };
    let up = match a.up {
        Some(up) => up.direction(),
        None if format.defines_up() => settings.as_ref().and_then(up_of_run),
        None => None,
    };
    let transform = Placement::upright(up.unwrap_or(format.up()), format.up(), a.scale);
    let transform = Some(transform).filter(|transform| *transform != Placement::NONE);
    let export = Export {
        splats: &splats,
        format,
        lights: lights.as_ref(),
        environment: environment.as_deref(),
        transform: transform.as_ref(),
    };
    let left_out = export.leaves_out();
    let files = write_export(output, &export)?;
    let answer = serde_json::json!({
        "gaussians": splats.len(), "file": output, "files": files, "left_out": left_out,
        "lights": lights.as_ref().map_or(0, |list| format.lights_held(list)), "transform": transform,
    });
    if !common.answer(&answer)? && !common.quiet {
        let files: Vec<String> = files.iter().map(|file| file.display().to_string()).collect();
        eprintln!("wrote {} Gaussians to {}", splats.len(), files.join(", "));
        if !left_out.is_empty() {
            eprintln!("the format does not hold: {}", left_out.join(", "));
        }
    }
    Ok(())
}
