//! Export of Gaussians and light for other programs: `sgs export`.

use crate::cameras::splats_of;
use crate::common::Common;
use crate::failure::refuse_usage;
use sgs_run::{
    LightList, RunDirectory, gltf_leaves_out, read_emitters, read_exchange, read_light_list, write_exchange,
};
use sgs_scene::PlyDialect;
use std::path::{Path, PathBuf};

#[derive(clap::Args)]
pub struct Args {
    /// Run directory, or a PLY or glTF file of this or another program.
    source: PathBuf,
    /// File to write. Lights and an environment map that its format cannot hold are written beside it.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// File format (docs/reference/exchange.md); by default from the file's extension.
    #[arg(long, value_enum)]
    format: Option<Format>,
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
}

impl Format {
    /// Returns the PLY dialect; `None` for glTF.
    fn dialect(self) -> Option<PlyDialect> {
        Some(match self {
            Format::Ply => PlyDialect::Own,
            Format::ThreeDgs => PlyDialect::ThreeDgs,
            Format::GsIr => PlyDialect::GsIr,
            Format::R3dg => PlyDialect::R3dg,
            Format::Sgs => PlyDialect::Sgs,
            Format::Mesh2splat => PlyDialect::Mesh2Splat,
            Format::Gltf | Format::Glb => return None,
        })
    }

    fn extension(self) -> &'static str {
        match self {
            Format::Gltf => "gltf",
            Format::Glb => "glb",
            _ => "ply",
        }
    }

    /// Returns the format of an output file.
    ///
    /// The requested format must fit the extension; by default the extension selects it.
    fn of(path: &Path, requested: Option<Format>) -> anyhow::Result<Format> {
        let end = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
        let named = match end.as_str() {
            "ply" => Format::Ply,
            "gltf" => Format::Gltf,
            "glb" => Format::Glb,
            _ => refuse_usage!("\"{}\" ends in none of .ply, .gltf and .glb, which are written.", path.display()),
        };
        match requested {
            Some(format) if format.extension() != end => {
                refuse_usage!(
                    "\"{}\" does not end in .{}, as files of that format do.",
                    path.display(),
                    format.extension()
                )
            }
            requested => Ok(requested.unwrap_or(named)),
        }
    }
}

pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    let format = Format::of(&a.output, a.format)?;
    let (splats, lights, environment) = if a.source.is_file() {
        let file = read_exchange(&a.source)?;
        (file.splats, file.lights, file.environment)
    } else {
        let (splats, _) = splats_of(&a.source)?;
        let run = RunDirectory::open(&a.source)?;
        let [lights, environment] = ["lights.json", "environment.exr"].map(|name| run.path(name));
        let lights = match format.dialect() {
            // The emitters of a run are its light.
            None if run.emitters().is_file() => Some(LightList::of_emitters(&read_emitters(&run.emitters())?)),
            _ if lights.is_file() => Some(read_light_list(&lights)?),
            _ => None,
        };
        (splats, lights, Some(environment).filter(|file| file.is_file()))
    };
    let dialect = format.dialect();
    let names = |names: Vec<&str>| names.into_iter().map(str::to_owned).collect();
    let mut left_out: Vec<String> = dialect.map_or(Vec::new(), |dialect| names(dialect.leaves_out(&splats)));
    if dialect.is_none() {
        if splats.emitters.is_some() {
            left_out.push("emitters of Gaussians".to_owned());
        }
        left_out.extend(lights.as_ref().map(gltf_leaves_out).unwrap_or_default());
    }
    let held = |list: &LightList| match dialect {
        Some(_) => list.lights.len(),
        None => list.lights.len() - gltf_leaves_out(list).len(),
    };
    // Light needs materials, which plain 3DGS files lack.
    let lit = dialect != Some(PlyDialect::ThreeDgs);
    if !lit && (lights.is_some() || environment.is_some()) {
        left_out.push("light".to_owned());
    }
    let lights = lights.filter(|_| lit);
    let environment = environment.filter(|_| lit);
    let files = write_exchange(&a.output, &splats, dialect, lights.as_ref(), environment.as_deref())?;
    let answer = serde_json::json!({
        "gaussians": splats.len(), "file": a.output, "files": files, "left_out": left_out,
        "lights": lights.as_ref().map_or(0, held),
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
