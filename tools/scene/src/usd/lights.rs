//! Lights as prims of UsdLux.

use super::{UsdLight, UsdShape};
use glam::{DMat3, DQuat, DVec3};
use std::io::{self, Write};

/// Writes the prim of light `index`.
pub(super) fn write(out: &mut dyn Write, index: usize, light: &UsdLight) -> io::Result<()> {
    let name: String = light.name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    let name = format!("Light_{index}_{name}");
    let api = if matches!(light.shape, UsdShape::Spot { .. }) {
        " (\n            prepend apiSchemas = [\"ShapingAPI\"]\n        )"
    } else {
        ""
    };
    let vector = |v: [f32; 3]| DVec3::from(v.map(f64::from));
    let along = |axis: [f32; 3]| DQuat::from_rotation_arc(DVec3::NEG_Z, vector(axis).normalize_or(DVec3::NEG_Z));
    let (kind, at, turn) = match light.shape {
        UsdShape::Sphere { center, .. } => ("SphereLight", vector(center), DQuat::IDENTITY),
        UsdShape::Spot { position, axis, .. } => ("SphereLight", vector(position), along(axis)),
        UsdShape::Directional { direction, .. } => ("DistantLight", DVec3::ZERO, along(direction)),
        UsdShape::Disk { center, normal, .. } => ("DiskLight", vector(center), along(normal)),
        UsdShape::Rectangle { corner, edge_u, edge_v } => {
            let (u, v) = (vector(edge_u), vector(edge_v));
            // The light shines along -Z, so that X x Y points away from it.
            let (x, z) = (u.normalize_or(DVec3::X), -u.cross(v).normalize_or(DVec3::NEG_Z));
            let turn = DQuat::from_mat3(&DMat3::from_cols(x, z.cross(x), z));
            ("RectLight", vector(corner) + 0.5 * (u + v), turn)
        }
    };
    writeln!(out, "        def {kind} \"{name}\"{api}\n        {{")?;
    match light.shape {
        UsdShape::Sphere { radius, point, .. } => {
            writeln!(out, "            float inputs:radius = {radius:?}")?;
            if point {
                writeln!(out, "            bool treatAsPoint = true")?;
            }
        }
        UsdShape::Spot { radius, inner_angle, outer_angle, .. } => {
            let softness = if outer_angle > 0.0 { (1.0 - inner_angle / outer_angle).clamp(0.0, 1.0) } else { 0.0 };
            writeln!(out, "            float inputs:radius = {radius:?}")?;
            writeln!(out, "            bool treatAsPoint = true")?;
            writeln!(out, "            float inputs:shaping:cone:angle = {:?}", outer_angle.to_degrees())?;
            writeln!(out, "            float inputs:shaping:cone:softness = {softness:?}")?;
        }
        UsdShape::Directional { angular_radius, .. } => {
            // Normalized, the intensity is the irradiance at normal incidence.
            writeln!(out, "            float inputs:angle = {:?}", 2.0 * angular_radius.to_degrees())?;
            writeln!(out, "            bool inputs:normalize = true")?;
        }
        UsdShape::Rectangle { edge_u, edge_v, .. } => {
            writeln!(out, "            float inputs:width = {:?}", vector(edge_u).length() as f32)?;
            writeln!(out, "            float inputs:height = {:?}", vector(edge_v).length() as f32)?;
        }
        UsdShape::Disk { radius, .. } => writeln!(out, "            float inputs:radius = {radius:?}")?,
    }
    // Colors have the maximum 1, as editors expect.
    let most = light.color.iter().fold(0.0_f32, |a, b| a.max(*b));
    let [r, g, b] = light.color.map(|c| if most > 0.0 { c / most } else { 1.0 });
    writeln!(out, "            color3f inputs:color = ({r:?}, {g:?}, {b:?})")?;
    writeln!(out, "            float inputs:intensity = {most:?}")?;
    place(out, at, turn)?;
    writeln!(out, "        }}")
}

/// Writes a rotation and a translation.
pub(super) fn place(out: &mut dyn Write, at: DVec3, turn: DQuat) -> io::Result<()> {
    let DQuat { x, y, z, w } = turn;
    writeln!(out, "            double3 xformOp:translate = ({:?}, {:?}, {:?})", at.x, at.y, at.z)?;
    writeln!(out, "            quatd xformOp:orient = ({w:?}, {x:?}, {y:?}, {z:?})")?;
    writeln!(out, "            uniform token[] xformOpOrder = [\"xformOp:translate\", \"xformOp:orient\"]")
}
