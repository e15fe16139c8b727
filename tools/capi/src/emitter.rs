//! Emitters of runs.

use crate::border::{Outcome, fail, optional_string, put_text, read, write};
use crate::context::{SgsContext, with};
use crate::relight::follow;
use crate::types::*;
use sgs_passes::transport::{AreaLight, AreaLightError, LightShape};
use sgs_relight::NewEmitter;
use sgs_run::EmitterRow;
use std::ffi::c_char;

/// Emitter: point that emits equally in all directions.
pub const SGS_EMITTER_POINT: u32 = 0;
/// Emitter: sphere.
pub const SGS_EMITTER_SPHERE: u32 = 1;
/// Emitter: rectangle, which emits on the side of axis x side.
pub const SGS_EMITTER_RECTANGLE: u32 = 2;
/// Emitter: disk, which emits on the side of its normal.
pub const SGS_EMITTER_DISK: u32 = 3;
/// Emitter: point with a cone of light.
pub const SGS_EMITTER_SPOT: u32 = 4;
/// Emitter: light from a distant disk.
pub const SGS_EMITTER_DIRECTIONAL: u32 = 5;
/// Emitter: point whose intensity is color * exp(sharpness * (c - 1)). c is the cosine between the axis and the direction in
/// which the light leaves.
pub const SGS_EMITTER_LOBE: u32 = 6;
/// Emitter: rectangle that shows the environment, on the side of axis x side. Its color is a factor on the environment,
/// which is white if the run has none and sgs_relight_environment_set sets none.
pub const SGS_EMITTER_WINDOW: u32 = 7;

/// Returns an emitter of a run, numbered from 0 as in emitters.json. Added emitters follow. Emitters are the lights of
/// such a run: sgs_relight_light_count counts them, sgs_relight_light_set switches, dims, recolors and moves them, and
/// sgs_relight_light_remove removes them. Shape and color are those without these changes. `name`, if not null, has space
/// for `size` bytes and receives as much of the name as fits.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_relight_emitter_get(
    context: *const SgsContext,
    relight: SgsRelight,
    index: u32,
    emitter: *mut SgsEmitter,
    name: *mut c_char,
    size: usize,
) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            let relight = inner.relight(relight)?.hold();
            let row = relight.emitter(index as usize)?;
            write(emitter, &emitter_of(row))?;
            put_text(name, size, &row.name);
            Ok(())
        })
    }
}

/// Adds an emitter after the others, switched on. `name` may be null; a name that another emitter has gets a number.
/// `index`, if not null, receives its number. If an emitter was removed, the new one takes its place on the device
/// without memory, waits or another plan; windows take those of windows, and others those of others. Else the call
/// solves the bounces of all emitters and waits for them, and views rebuild their plans at their next frames. An added
/// emitter lights the room, but has no surface that a camera sees. Directional light enters through openings only.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_relight_emitter_add(
    context: *const SgsContext,
    relight: SgsRelight,
    emitter: *const SgsEmitter,
    name: *const c_char,
    index: *mut u32,
) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            let mut relight = inner.relight(relight)?.hold();
            let AreaLight { shape, color } = light_of(&read(emitter)?)?;
            let name = optional_string(name, "name")?;
            let number = relight.add_emitter(&NewEmitter { name, shape, color })?;
            follow(&mut relight)?;
            if let Some(index) = index.as_mut() {
                *index = number as u32;
            }
            Ok(())
        })
    }
}

/// Replaces shape and color of an emitter: turns it, changes its size, or makes it another kind. Get an emitter, change
/// it, set it. What sgs_relight_light_set changed is discarded, except whether it is on. Allocates no memory, does not
/// wait, and submits the trace and the solve of its bounces to the queue. The surface of an emitter whose shape changes is
/// dark. Windows stay windows, and others do not become windows.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_relight_emitter_set(
    context: *const SgsContext,
    relight: SgsRelight,
    index: u32,
    emitter: *const SgsEmitter,
) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            let mut relight = inner.relight(relight)?.hold();
            let light = light_of(&read(emitter)?)?;
            relight.set_emitter(index as usize, light)?;
            follow(&mut relight)
        })
    }
}

/// Converts an emitter of a caller, and checks it.
fn light_of(emitter: &SgsEmitter) -> Outcome<AreaLight> {
    let SgsEmitter { shape, color, position, axis, side, radius, angles, sharpness, .. } = *emitter;
    let [inner_angle, outer_angle] = angles.map(radians);
    let shape = match shape {
        SGS_EMITTER_POINT => LightShape::Point { position },
        SGS_EMITTER_SPHERE => LightShape::Sphere { center: position, radius },
        SGS_EMITTER_RECTANGLE => LightShape::Rectangle { corner: position, edge_u: axis, edge_v: side },
        SGS_EMITTER_DISK => LightShape::Disk { center: position, normal: axis, radius },
        SGS_EMITTER_SPOT => LightShape::Spot { position, axis, inner_angle, outer_angle },
        SGS_EMITTER_DIRECTIONAL => LightShape::Directional { direction: axis, angular_radius: inner_angle },
        SGS_EMITTER_LOBE => LightShape::Lobe { position, axis, sharpness },
        SGS_EMITTER_WINDOW => LightShape::Window { corner: position, edge_u: axis, edge_v: side },
        other => {
            let text = format!("SgsEmitter.shape is {other}; use SGS_EMITTER_POINT (0) to SGS_EMITTER_WINDOW (7).");
            return fail(SgsResult::SGS_ERROR_ARGUMENT, text);
        }
    };
    let light = AreaLight { shape, color };
    match light.check() {
        Ok(()) => Ok(light),
        Err(error) => fail(SgsResult::SGS_ERROR_ARGUMENT, format!("SgsEmitter.{}.", reason(&error))),
    }
}

/// Returns why an emitter is invalid, with the names and units of the header.
fn reason(error: &AreaLightError) -> String {
    match *error {
        AreaLightError::Skewed { cosine } => {
            format!("side: the cosine of its angle to axis is {cosine}; use perpendicular edges")
        }
        AreaLightError::Angle { property, value, low, high } => {
            let [value, low, high] = [value, low, high].map(degrees);
            format!("{}: {value} degrees is outside of its range; use {low} to {high}", field(property))
        }
        AreaLightError::NotFinite { property, .. } | AreaLightError::Length { property, .. } => {
            error.to_string().replacen(property, field(property), 1)
        }
        AreaLightError::NegativeColor { .. } | AreaLightError::Sharpness { .. } => error.to_string(),
    }
}

/// Returns the field of `SgsEmitter` that holds a property of a light.
fn field(property: &'static str) -> &'static str {
    match property {
        "center" | "corner" => "position",
        "edge_u" | "normal" | "direction" => "axis",
        "edge_v" => "side",
        "inner_angle" | "angular_radius" => "angles[0]",
        "outer_angle" => "angles[1]",
        other => other,
    }
}

fn radians(degrees: f32) -> f32 {
    f64::from(degrees).to_radians() as f32
}

fn degrees(radians: f32) -> f32 {
    f64::from(radians).to_degrees() as f32
}

fn emitter_of(row: &EmitterRow) -> SgsEmitter {
    let none = SgsEmitter {
        struct_size: 0,
        shape: SGS_EMITTER_POINT,
        color: row.color,
        position: [0.0; 3],
        axis: [0.0; 3],
        side: [0.0; 3],
        radius: 0.0,
        angles: [0.0; 2],
        sharpness: 0.0,
    };
    match row.shape {
        LightShape::Point { position } => SgsEmitter { position, ..none },
        LightShape::Sphere { center, radius } => {
            SgsEmitter { shape: SGS_EMITTER_SPHERE, position: center, radius, ..none }
        }
        LightShape::Rectangle { corner, edge_u, edge_v } => {
            SgsEmitter { shape: SGS_EMITTER_RECTANGLE, position: corner, axis: edge_u, side: edge_v, ..none }
        }
        LightShape::Window { corner, edge_u, edge_v } => {
            SgsEmitter { shape: SGS_EMITTER_WINDOW, position: corner, axis: edge_u, side: edge_v, ..none }
        }
        LightShape::Disk { center, normal, radius } => {
            SgsEmitter { shape: SGS_EMITTER_DISK, position: center, axis: normal, radius, ..none }
        }
        LightShape::Spot { position, axis, inner_angle, outer_angle } => {
            let angles = [inner_angle, outer_angle].map(degrees);
            SgsEmitter { shape: SGS_EMITTER_SPOT, position, axis, angles, ..none }
        }
        LightShape::Directional { direction, angular_radius } => {
            let angles = [degrees(angular_radius), 0.0];
            SgsEmitter { shape: SGS_EMITTER_DIRECTIONAL, axis: direction, angles, ..none }
        }
        LightShape::Lobe { position, axis, sharpness } => {
            SgsEmitter { shape: SGS_EMITTER_LOBE, position, axis, sharpness, ..none }
        }
    }
}
