//! Text of a USD file.

use super::{UsdLight, lights};
use crate::activation::{METALLIC_RANGE, logistic, material, unit};
use crate::placement::Placement;
use crate::splats::{ALBEDO_RANGE, ROUGHNESS_RANGE, Splats};
use glam::{DQuat, DVec3};
use std::io::{self, Write};

/// Metadata of a primvar with a value for every splat.
const VERTEX: &str = " (\n            interpolation = \"vertex\"\n        )";

/// Content of a file.
pub(super) struct Stage<'a> {
    pub(super) splats: &'a Splats,
    pub(super) lights: &'a [UsdLight],
    /// File name of the environment map.
    pub(super) environment: Option<&'a str>,
    pub(super) transform: Option<&'a Placement>,
}

/// Writes the text. Numbers are the shortest that give the same 32 bits.
pub(super) fn write(out: &mut dyn Write, stage: &Stage<'_>) -> io::Result<()> {
    let Placement { scale, rotation: [w, x, y, z], translation: [a, b, c] } =
        *stage.transform.unwrap_or(&Placement::NONE);
    let version = env!("CARGO_PKG_VERSION");
    writeln!(
        out,
        "#usda 1.0\n(\n    customLayerData = {{\n        dictionary sgs = {{\n            string generator = \"SGS {version}\"\n            \
         double scale = {scale:?}\n            double4 rotation = ({w:?}, {x:?}, {y:?}, {z:?})\n            \
         double3 translation = ({a:?}, {b:?}, {c:?})\n        }}\n    }}\n    defaultPrim = \"Scene\"\n    \
         metersPerUnit = 1\n    upAxis = \"Y\"\n)\n\ndef Xform \"Scene\"\n{{\n    \
         double3 xformOp:translate = ({a:?}, {b:?}, {c:?})\n    quatd xformOp:orient = ({w:?}, {x:?}, {y:?}, {z:?})\n    \
         double3 xformOp:scale = ({scale:?}, {scale:?}, {scale:?})\n    \
         uniform token[] xformOpOrder = [\"xformOp:translate\", \"xformOp:orient\", \"xformOp:scale\"]\n"
    )?;
    splats(out, stage.splats)?;
    if !stage.lights.is_empty() || stage.environment.is_some() {
        writeln!(out, "    def Scope \"Lights\"\n    {{")?;
        stage.lights.iter().enumerate().try_for_each(|(i, light)| lights::write(out, i, light))?;
        if let Some(file) = stage.environment {
            writeln!(out, "        def DomeLight \"Environment\"\n        {{")?;
            writeln!(out, "            asset inputs:texture:file = @./{file}@")?;
            writeln!(out, "            token inputs:texture:format = \"latlong\"")?;
            // The map's center is -z; that of a dome light is +z.
            lights::place(out, DVec3::ZERO, DQuat::from_xyzw(0.0, 1.0, 0.0, 0.0))?;
            writeln!(out, "        }}")?;
        }
        writeln!(out, "    }}")?;
    }
    writeln!(out, "}}")
}

fn splats(out: &mut dyn Write, s: &Splats) -> io::Result<()> {
    let n = s.len();
    writeln!(out, "    def ParticleField3DGaussianSplat \"Splats\"\n    {{")?;
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for (mean, scales) in s.means.iter().zip(&s.log_scales) {
        let reach = 3.0 * scales.iter().fold(f32::NEG_INFINITY, |a, b| a.max(*b)).exp();
        (0..3).for_each(|k| {
            low[k] = low[k].min(mean[k] - reach);
            high[k] = high[k].max(mean[k] + reach);
        });
    }
    if n > 0 {
        rows(out, "float3[] extent", 2, "", |i| if i == 0 { low } else { high })?;
    }
    rows(out, "point3f[] positions", n, "", |i| s.means[i])?;
    rows(out, "quatf[] orientations", n, "", |i| unit(s.rotations[i]).map(|v| v as f32))?;
    rows(out, "float3[] scales", n, "", |i| s.log_scales[i].map(|v| f64::from(v).exp() as f32))?;
    numbers(out, "float[] opacities", n, "", |i| logistic(s.opacity_logits[i]) as f32)?;
    let degree = s.sh_degree();
    writeln!(out, "        uniform int radiance:sphericalHarmonicsDegree = {degree}")?;
    let wide = (degree + 1) * (degree + 1);
    rows(out, "float3[] radiance:sphericalHarmonicsCoefficients", n * wide, "", |at| {
        let (i, coefficient) = (at / wide, at % wide);
        let band = coefficient.isqrt();
        let first = 3 * (i * (2 * band + 1) + coefficient - band * band);
        [s.sh[band][first], s.sh[band][first + 1], s.sh[band][first + 2]]
    })?;
    writeln!(out, "        uniform token projectionModeHint = \"perspective\"")?;
    writeln!(out, "        uniform token sortingModeHint = \"zDepth\"")?;
    if let Some(normals) = &s.normals {
        rows(out, "normal3f[] primvars:normal", n, VERTEX, |i| normals[i])?;
    }
    if let Some(albedo) = &s.albedo {
        let value = |i: usize| albedo[i].map(|v| material(v, ALBEDO_RANGE) as f32);
        rows(out, "color3f[] primvars:albedo", n, VERTEX, value)?;
    }
    let scalars = [("roughness", &s.roughness, ROUGHNESS_RANGE), ("metallic", &s.metallic, METALLIC_RANGE)];
    for (name, values, range) in scalars {
        if let Some(values) = values {
            let value = |i: usize| material(values[i], range) as f32;
            numbers(out, &format!("float[] primvars:{name}"), n, VERTEX, value)?;
        }
    }
    writeln!(out, "    }}")
}

/// Writes an array of tuples, and `end` after it.
fn rows<const N: usize>(
    out: &mut dyn Write,
    name: &str,
    count: usize,
    end: &str,
    row: impl Fn(usize) -> [f32; N],
) -> io::Result<()> {
    write!(out, "        {name} = [")?;
    for i in 0..count {
        let separator = if i == 0 { "(" } else { ", (" };
        out.write_all(separator.as_bytes())?;
        for (k, v) in row(i).into_iter().enumerate() {
            let separator = if k == 0 { "" } else { ", " };
            write!(out, "{separator}{v:?}")?;
        }
        out.write_all(b")")?;
    }
    writeln!(out, "]{end}")
}

/// Writes an array of numbers, and `end` after it.
fn numbers(out: &mut dyn Write, name: &str, count: usize, end: &str, number: impl Fn(usize) -> f32) -> io::Result<()> {
    write!(out, "        {name} = [")?;
    for i in 0..count {
        let separator = if i == 0 { "" } else { ", " };
        write!(out, "{separator}{:?}", number(i))?;
    }
    writeln!(out, "]{end}")
}
