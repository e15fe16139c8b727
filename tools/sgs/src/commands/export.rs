//! `sgs export`: the Gaussians and the light of a run, or of a file, for other programs.

use crate::cameras::splats_of;
use crate::common::Common;
use crate::failure::refuse_usage;
use sgs_run::{RunDirectory, read_exchange, read_lights, write_exchange};
use sgs_scene::PlyDialect;
use std::path::{Path, PathBuf};

#[derive(clap::Args)]
pub struct Args {
    /// Run directory, or a PLY or glTF file of this or another program.
    source: PathBuf,
    /// File to write. Lights and an environment map that its format cannot hold go beside it.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Format; by default by the file's extension (docs/reference/exchange.md).
    #[arg(long, value_enum)]
    format: Option<Format>,
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    /// PLY as scene.ply of a run, with materials; viewers of 3DGS open it.
    Ply,
    /// PLY of 3DGS and nothing else.
    #[value(name = "3dgs")]
    ThreeDgs,
    /// PLY with materials as GS-IR has them.
    GsIr,
    /// PLY with materials as Relightable 3D Gaussians has them.
    R3dg,
    /// PLY with materials and features as the published SGS has them.
    Sgs,
    /// PLY with albedo in place of colors, as mesh2splat has it.
    Mesh2splat,
    /// glTF with its numbers in a .bin beside it.
    Gltf,
    /// glTF in one file.
    Glb,
}

impl Format {
    /// The dialect of a PLY; none for glTF.
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

    /// Of a file to write.
    fn of(path: &Path, asked: Option<Format>) -> anyhow::Result<Format> {
        let end = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
        let named = match end.as_str() {
            "ply" => Format::Ply,
            "gltf" => Format::Gltf,
            "glb" => Format::Glb,
            _ => refuse_usage!("\"{}\" ends in none of .ply, .gltf and .glb, which are written.", path.display()),
        };
        match asked {
            Some(format) if format.extension() != end => {
                refuse_usage!(
                    "\"{}\" does not end in .{}, as files of that format do.",
                    path.display(),
                    format.extension()
                )
            }
            asked => Ok(asked.unwrap_or(named)),
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
        let lights = if lights.is_file() { Some(read_lights(&lights)?) } else { None };
        (splats, lights, Some(environment).filter(|file| file.is_file()))
    };
    let dialect = format.dialect();
    let mut left_out = dialect.map_or(Vec::new(), |dialect| dialect.leaves_out(&splats));
    // Without materials light is of no use.
    let lit = dialect != Some(PlyDialect::ThreeDgs);
    if !lit && (lights.is_some() || environment.is_some()) {
        left_out.push("light");
    }
    let lights = lights.filter(|_| lit);
    let environment = environment.filter(|_| lit);
    let files = write_exchange(&a.output, &splats, dialect, lights.as_ref(), environment.as_deref())?;
    let answer = serde_json::json!({
        "gaussians": splats.len(), "file": a.output, "files": files, "left_out": left_out,
        "lights": lights.map_or(0, |l| l.lights.len()),
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
