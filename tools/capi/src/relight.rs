//! Relighting of runs: lights and environment map per frame, edits, and views.

use crate::border::{Failure, Outcome, fail, optional_string, read, string, write};
use crate::context::{SgsContext, claim, hand_over, with};
use crate::object::{RelightObject, Shows, Thing, ViewObject};
use crate::scene::camera;
use crate::types::*;
use crate::view::{Target, target};
use sgs_passes::pipeline::{LitLayer, LitOptions, LitView};
use sgs_relight::{Edit, LightParameters, NewLight, Relighter};
use sgs_run::{LobeRow, ShadedView, Shading};
use std::ffi::c_char;
use std::path::Path;

fn layer(number: u32) -> Outcome<LitLayer> {
    Ok(match number {
        SGS_LAYER_SHADED => LitLayer::Shaded,
        SGS_LAYER_ALBEDO => LitLayer::Albedo,
        SGS_LAYER_ROUGHNESS => LitLayer::Roughness,
        SGS_LAYER_METALLIC => LitLayer::Metallic,
        SGS_LAYER_DIFFUSE => LitLayer::Diffuse,
        SGS_LAYER_SPECULAR => LitLayer::Specular,
        SGS_LAYER_VISIBILITY => LitLayer::Visibility,
        SGS_LAYER_ENVIRONMENT => LitLayer::Environment,
        SGS_LAYER_DIRECT => LitLayer::Direct,
        other => return fail(SgsResult::SGS_ERROR_ARGUMENT, format!("Relightings have no layer {other}.")),
    })
}

/// Refuses a layer that the relighting lacks the inputs of.
fn check_layer(relight: &Relighter, layer: LitLayer) -> Outcome<()> {
    let scene = &relight.scene().scene;
    let lacks = match layer {
        LitLayer::Metallic => scene.metallic.is_none(),
        LitLayer::Visibility => scene.visibility.is_none(),
        _ => false,
    };
    if lacks {
        let text = format!("The run has no {}, so that it cannot be shown.", layer.name());
        return fail(SgsResult::SGS_ERROR_ARGUMENT, text);
    }
    Ok(())
}

/// Submits the bounces of moved emitters.
pub(crate) fn follow(relight: &mut Relighter) -> Outcome<()> {
    while relight.update()? {}
    Ok(())
}

fn exposure(stops: f32) -> Outcome<f32> {
    let factor = stops.exp2();
    if !(stops.is_finite() && factor.is_finite()) {
        return fail(
            SgsResult::SGS_ERROR_ARGUMENT,
            format!("The exposure is {stops}, but must be a number below 128."),
        );
    }
    Ok(factor)
}

/// Opens a run directory with trained materials, or a PLY file with materials. A run directory has scene.ply,
/// lights.json, environment.exr and visibility.safetensors. A PLY file has no light of its own. A run with emitters.json
/// is lit by its emitters with bounces if its scene is there; opening it waits for their solve. `info` may be null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_relight_open(
    context: *const SgsContext,
    run: *const c_char,
    info: *const SgsRelightInfo,
    relight: *mut SgsRelight,
) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            claim(relight)?;
            let run = string(run, "run")?;
            let capacity = if info.is_null() { 0 } else { read(info)?.light_capacity };
            if capacity > 1 << 16 {
                let text = format!("SgsRelightInfo.light_capacity is {capacity}, but at most 65536.");
                return fail(SgsResult::SGS_ERROR_ARGUMENT, text);
            }
            let opened = Relighter::open(&inner.device, Path::new(&run), capacity)?;
            hand_over(inner, relight, Thing::Relight(RelightObject::new(opened)))
        })
    }
}

/// Returns the state of a relighting.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_relight_get(
    context: *const SgsContext,
    relight: SgsRelight,
    state: *mut SgsRelightState,
) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            let relight = inner.relight(relight)?.hold();
            let scene = relight.scene();
            let value = SgsRelightState {
                struct_size: 0,
                gaussians: scene.scene.gaussians.capacity,
                lights: relight.lights() as u32,
                light_capacity: relight.lighting().model.lights,
                metallic: u32::from(scene.scene.metallic.is_some()),
                visibility: u32::from(scene.scene.visibility.is_some()),
                environment: u32::from(relight.has_environment()),
                environment_size: relight.environment_size(),
                emitters: u32::from(relight.has_emitters()),
            };
            write(state, &value)
        })
    }
}

/// Applies an edit to the run as it is on disk. Earlier changes are discarded. `json`: text as for `sgs relight --edit`
/// (docs/guide/relight.md). Paths in it are relative to `folder`, or to the working directory if `folder` is null.
/// After an error the state is unchanged.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_relight_edit(
    context: *const SgsContext,
    relight: SgsRelight,
    json: *const c_char,
    folder: *const c_char,
) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            let mut relight = inner.relight(relight)?.hold();
            let (json, folder) = (string(json, "json")?, optional_string(folder, "folder")?);
            let folder = folder.unwrap_or_default();
            let edit = Edit::parse(&json, Path::new(&folder)).map_err(|reason| Failure {
                code: SgsResult::SGS_ERROR_ARGUMENT,
                text: format!("The edit cannot be applied: {reason}."),
            })?;
            relight.edit(&edit)?;
            follow(&mut relight)
        })
    }
}

/// Restores the run as it is on disk.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_relight_reset(context: *const SgsContext, relight: SgsRelight) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            let mut relight = inner.relight(relight)?.hold();
            relight.reset()?;
            follow(&mut relight)
        })
    }
}

/// Returns the number of lights.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_relight_light_count(
    context: *const SgsContext,
    relight: SgsRelight,
    count: *mut u32,
) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            let all = inner.relight(relight)?.hold().lights() as u32;
            let Some(count) = count.as_mut() else {
                return fail(SgsResult::SGS_ERROR_NULL, "The place for the count is null.");
            };
            *count = all;
            Ok(())
        })
    }
}

/// Returns one of the lights, numbered from 0 as in lights.json.
/// If emitters light the scene, their numbers are those of emitters.json.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_relight_light_get(
    context: *const SgsContext,
    relight: SgsRelight,
    index: u32,
    light: *mut SgsLight,
) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            let LightParameters { on, position, gain, color } = inner.relight(relight)?.hold().light(index as usize)?;
            write(light, &SgsLight { struct_size: 0, on: on.into(), position, gain, color })
        })
    }
}

/// Changes a light. Takes effect in frames that are recorded or submitted from now on. Neither allocates nor waits.
/// A moved emitter also submits the trace and the solve of its bounces to the queue; later frames show them.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_relight_light_set(
    context: *const SgsContext,
    relight: SgsRelight,
    index: u32,
    light: *const SgsLight,
) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            let mut relight = inner.relight(relight)?.hold();
            let SgsLight { on, position, gain, color, .. } = read(light)?;
            relight.set_light(index as usize, LightParameters { on: on != 0, position, gain, color })?;
            follow(&mut relight)
        })
    }
}

/// Adds a light after the others. `index`, if not null, receives its number. Beyond the capacity, the capacity doubles
/// and views rebuild their plans at their next frames. In a run with emitters the light is an emitter, as if
/// sgs_relight_emitter_add had added a point or a lobe.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_relight_light_add(
    context: *const SgsContext,
    relight: SgsRelight,
    light: *const SgsNewLight,
    index: *mut u32,
) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            let mut relight = inner.relight(relight)?.hold();
            let SgsNewLight { sharpness, position, intensity, axis, .. } = read(light)?;
            let narrow = sharpness != 0.0;
            let lobe = LobeRow { axis, sharpness, amplitude: intensity };
            let new = NewLight {
                position: Some(position),
                intensity: (!narrow).then_some(intensity),
                lobes: narrow.then(|| vec![lobe]),
                ..Default::default()
            };
            let number = relight.add_light(&new)?;
            follow(&mut relight)?;
            if let Some(index) = index.as_mut() {
                *index = number as u32;
            }
            Ok(())
        })
    }
}

/// Removes a light or an emitter. The numbers of those after it decrease by one. The surface of a removed emitter is
/// dark. Neither allocates nor waits.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_relight_light_remove(
    context: *const SgsContext,
    relight: SgsRelight,
    index: u32,
) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe { with(context, |inner| Ok(inner.relight(relight)?.hold().remove_light(index as usize)?)) }
}

/// Replaces the environment map. `rgb`: a latitude-longitude map, twice as wide as high, rows from the top, three
/// floats per pixel, linear. In a run with emitters, windows show it. Allocates memory and waits for the device, unlike
/// sgs_relight_environment_gain.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_relight_environment_set(
    context: *const SgsContext,
    relight: SgsRelight,
    rgb: *const f32,
    width: u32,
    height: u32,
) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            let mut relight = inner.relight(relight)?.hold();
            if rgb.is_null() {
                return fail(SgsResult::SGS_ERROR_NULL, "The environment is null.");
            }
            // The size is checked before the map is read.
            if width > 1 << 14 || height == 0 || width != height.saturating_mul(2) {
                let text = format!(
                    "An environment must be twice as wide as high, up to 16384, but this is {width} x {height}."
                );
                return fail(SgsResult::SGS_ERROR_ARGUMENT, text);
            }
            let map = std::slice::from_raw_parts(rgb, 3 * width as usize * height as usize);
            Ok(relight.set_environment(map, [width, height])?)
        })
    }
}

/// Sets the factors of red, green and blue of the environment map. In a run with emitters they are those of the
/// environment that windows show. They are 1 after loading, an edit and a reset. Neither allocates nor waits.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_relight_environment_gain(
    context: *const SgsContext,
    relight: SgsRelight,
    rgb: *const f32,
) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            let mut relight = inner.relight(relight)?.hold();
            if rgb.is_null() {
                return fail(SgsResult::SGS_ERROR_NULL, "The gain is null.");
            }
            Ok(relight.set_environment_gain([0, 1, 2].map(|c| rgb.add(c).read_unaligned()))?)
        })
    }
}

/// Creates a view of a relighting for images of one size and format. Layers: SGS_LAYER_SHADED and those after it.
/// Frames are recorded and submitted as those of other views. The relighting may be destroyed before the view.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_relight_view_create(
    context: *const SgsContext,
    relight: SgsRelight,
    info: *const SgsViewInfo,
    view: *mut SgsView,
) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            claim(view)?;
            let object = inner.relight(relight)?.clone();
            let info = read(info)?;
            let Target { format, encoding, entry, exit, frames_in_flight } = target(&info)?;
            let layer = layer(info.layer)?;
            let size = [info.width, info.height];
            let options = LitOptions { size, layer, format, encoding, entry, exit, frames_in_flight, capacity: [0; 2] };
            let made = {
                let held = object.hold();
                check_layer(&held, layer)?;
                LitView::new(&inner.device, inner.tuning, held.scene(), held.lighting(), options)?
            };
            hand_over(inner, view, Thing::View(Box::new(ViewObject::new(Shows::Relight(object, made, 1.0)))))
        })
    }
}

/// Sets the exposure of a view of a relighting. From the next frame on, light is multiplied by two to the power of
/// `stops`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_view_exposure(context: *const SgsContext, view: SgsView, stops: f32) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            let Shows::Relight(_, _, factor) = &mut inner.view(view)?.shows else {
                return fail(
                    SgsResult::SGS_ERROR_ARGUMENT,
                    "The view shows no relighting, so that it has no exposure.",
                );
            };
            *factor = exposure(stops)?;
            Ok(())
        })
    }
}

/// Renders one layer into the caller's memory and waits. Rows start at the top; values are linear. Matches `sgs
/// relight`, with a renderer and memory of its own: for images and comparisons, not for frames of an application.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_relight_render(
    context: *const SgsContext,
    relight: SgsRelight,
    camera: *const SgsCamera,
    info: *const SgsRelitInfo,
    pixels: *mut f32,
    count: usize,
) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            let relight = inner.relight(relight)?.clone();
            let view = self::camera(&read(camera)?)?;
            let info = read(info)?;
            if pixels.is_null() {
                return fail(SgsResult::SGS_ERROR_NULL, "The place for the pixels is null.");
            }
            if info.background.iter().any(|v| !v.is_finite()) {
                return fail(SgsResult::SGS_ERROR_ARGUMENT, "SgsRelitInfo.background is not finite.");
            }
            let (layer, factor) = (layer(info.layer)?, exposure(info.exposure)?);
            let held = relight.hold();
            check_layer(&held, layer)?;
            let floats = if layer.is_value() { 1 } else { 3 };
            let needed = view.size[0] as usize * view.size[1] as usize * floats;
            if count < needed {
                let text = format!("The image takes {needed} floats, but there is room for {count}.");
                return fail(SgsResult::SGS_ERROR_SPACE, text);
            }
            let scene = held.shaded()?;
            let shaded = Shading::new(&inner.device, scene)?.shade_from(&view)?;
            let rendered = rendered(&shaded, layer, info.background, factor);
            std::ptr::copy_nonoverlapping(rendered.as_ptr(), pixels, needed);
            Ok(())
        })
    }
}

fn rendered(view: &ShadedView, layer: LitLayer, background: [f32; 3], factor: f32) -> Vec<f32> {
    let light = |image: sgs_scene::Image| image.data.iter().map(|v| v * factor).collect();
    match layer {
        LitLayer::Shaded => {
            let lit: Vec<f32> = light(view.radiance([0.0; 3]));
            let behind = background.map(sgs_scene::srgb_to_linear);
            let coverage = view.covered();
            lit.iter().enumerate().map(|(i, v)| v + (1.0 - coverage[i / 3]) * behind[i % 3]).collect()
        }
        LitLayer::Albedo => view.albedo().data,
        LitLayer::Roughness => view.roughness().data,
        LitLayer::Metallic => view.metallic().data,
        LitLayer::Diffuse => light(view.diffuse()),
        LitLayer::Specular => light(view.specular()),
        LitLayer::Visibility => view.visibility().map(|v| v.data).unwrap_or_default(),
        LitLayer::Environment => light(view.environment_map()),
        LitLayer::Direct => light(view.direct()),
    }
}
