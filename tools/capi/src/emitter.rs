//! Emitters of runs.

use crate::border::{put_text, write};
use crate::context::{SgsContext, with};
use crate::types::*;
use sgs_passes::transport::LightShape;
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
/// Emitter: rectangle that shows the environment, on the side of axis x side. Its color is a factor on the environment.
pub const SGS_EMITTER_WINDOW: u32 = 7;

/// Returns an emitter of a run, numbered from 0 as in emitters.json. Emitters are the lights of such a run:
/// sgs_relight_light_count counts them, sgs_relight_light_set switches, dims and recolors them. `name`, if not null, has
/// space for `size` bytes and receives as much of the name as fits.
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
