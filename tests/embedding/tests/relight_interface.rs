//! Relighting through the C interface: results and error codes.

#[macro_use]
mod support;

use SgsResult::{SGS_ERROR_ARGUMENT as ARGUMENT, SGS_ERROR_FILE as FILE, SGS_ERROR_HANDLE as HANDLE};
use SgsResult::{SGS_ERROR_NULL as NULL, SGS_ERROR_SPACE as SPACE, SGS_ERROR_STRUCT_SIZE as SIZE};
use sgs::*;
use sgs_tests::runs::{self, Parts};
use std::ffi::{CStr, c_char};
use std::path::Path;
use std::ptr::{null, null_mut};
use support::{Context, camera, text};

const PIXELS: usize = 40 * 30;

fn opened(context: &Context, run: &Path) -> SgsRelight {
    let (run, mut relight) = (text(run), 0);
    // SAFETY: all pointers are valid.
    context.ok(unsafe { sgs_relight_open(context.0, run.as_ptr(), null(), &mut relight) });
    relight
}

/// Renders a layer over black.
fn render_layer(context: &Context, relight: SgsRelight, layer: u32, exposure: f32) -> Vec<f32> {
    let info = sized!(SgsRelitInfo { layer: layer, exposure: exposure });
    let mut pixels = vec![f32::NAN; 3 * PIXELS];
    let camera = camera([40, 30]);
    // SAFETY: all pointers are valid.
    context.ok(unsafe { sgs_relight_render(context.0, relight, &camera, &info, pixels.as_mut_ptr(), pixels.len()) });
    assert!(pixels[..PIXELS].iter().all(|v| v.is_finite()));
    pixels
}

fn apart(a: &[f32], b: impl Iterator<Item = f32>) -> f32 {
    let largest = a.iter().fold(1e-6f32, |m, v| m.max(v.abs()));
    a.iter().zip(b).fold(0.0f32, |m, (x, y)| m.max((x - y).abs())) / largest
}

fn light(context: &Context, relight: SgsRelight, index: u32) -> SgsLight {
    let mut light = sized!(SgsLight {});
    // SAFETY: all pointers are valid.
    context.ok(unsafe { sgs_relight_light_get(context.0, relight, index, &mut light) });
    light
}

fn state(context: &Context, relight: SgsRelight) -> SgsRelightState {
    let mut state = sized!(SgsRelightState {});
    // SAFETY: all pointers are valid.
    context.ok(unsafe { sgs_relight_get(context.0, relight, &mut state) });
    state
}

#[test]
fn light_calls_match_edits() {
    let folder = tempfile::tempdir().unwrap();
    runs::fabricate(folder.path(), Parts::ALL);
    let context = Context::new();
    let (c, relight) = (context.0, opened(&context, folder.path()));
    let about = state(&context, relight);
    let lights = runs::LIGHTS as u32;
    assert_eq!((about.lights, about.light_capacity, about.gaussians), (lights, lights + 16, 220));
    assert_eq!((about.metallic, about.visibility, about.environment, about.environment_size), (1, 1, 1, 16));
    assert_eq!((light(&context, relight, 2).on, light(&context, relight, 2).gain), (0, 1.0));
    let all = render_layer(&context, relight, SGS_LAYER_SHADED, 0.0);
    let edit = |json: &std::ffi::CStr| {
        // SAFETY: all pointers are valid.
        context.ok(unsafe { sgs_relight_edit(c, relight, json.as_ptr(), null()) });
        render_layer(&context, relight, SGS_LAYER_SHADED, 0.0)
    };
    // SAFETY: all pointers are valid.
    unsafe {
        let first = light(&context, relight, 0);
        let set = |change: &dyn Fn(&mut SgsLight)| {
            context.ok(sgs_relight_reset(c, relight));
            let mut one = first;
            change(&mut one);
            context.ok(sgs_relight_light_set(c, relight, 0, &one));
            render_layer(&context, relight, SGS_LAYER_SHADED, 0.0)
        };
        let off = set(&|l| l.on = 0);
        assert_eq!(apart(&off, edit(cr#"{"lights": {"change": [{"light": 0, "on": false}]}}"#).into_iter()), 0.0);
        // The image without the light plus the image of that light alone is the whole image.
        let alone = edit(cr#"{"lights": {"only": [0]}, "environment": {"off": true}}"#);
        assert!(apart(&all, off.iter().zip(&alone).map(|(a, b)| a + b)) < 1e-5);
        assert!(apart(&all, off.iter().copied()) > 0.01);
        let moved = set(&|l| (l.position[1], l.gain, l.color) = (l.position[1] + 0.5, 2.0 * l.gain, [1.0, 0.5, 0.0]));
        let same =
            cr#"{"lights": {"change": [{"light": 0, "by": [0, 0.5, 0], "intensity": 2, "color": [1, 0.5, 0]}]}}"#;
        assert!(apart(&moved, edit(same).into_iter()) < 1e-5);
        // Changes that add a light and scale the environment map.
        context.ok(sgs_relight_reset(c, relight));
        let new = sized!(SgsNewLight { position: [0.1, 0.2, 0.3], intensity: [1.0, 2.0, 3.0] });
        let mut index = 9;
        context.ok(sgs_relight_light_add(c, relight, &new, &mut index));
        assert_eq!((index, state(&context, relight).lights), (lights, lights + 1));
        context.ok(sgs_relight_environment_gain(c, relight, [0.5f32, 1.0, 2.0].as_ptr()));
        let added = render_layer(&context, relight, SGS_LAYER_SHADED, 0.0);
        let same = cr#"{"lights": {"add": [{"position": [0.1, 0.2, 0.3], "intensity": [1, 2, 3]}]},
            "environment": {"color": [0.5, 1, 2]}}"#;
        assert!(apart(&added, edit(same).into_iter()) < 1e-5);
        // Edits and resets start from the run again.
        context.ok(sgs_relight_light_remove(c, relight, lights));
        assert!(apart(&added, render_layer(&context, relight, SGS_LAYER_SHADED, 0.0).into_iter()) > 0.01);
        context.ok(sgs_relight_reset(c, relight));
        let narrow = sized!(SgsNewLight { sharpness: 3.0, axis: [0.0, 0.0, -2.0], intensity: [1.0; 3] });
        context.ok(sgs_relight_light_add(c, relight, &narrow, null_mut()));
        let lobes = render_layer(&context, relight, SGS_LAYER_SHADED, 0.0);
        let same = cr#"{"lights": {"add": [{"position": [0, 0, 0], "lobes":
            [{"axis": [0, 0, -2], "sharpness": 3, "amplitude": [1, 1, 1]}]}]}}"#;
        assert!(apart(&lobes, edit(same).into_iter()) < 1e-5);
        // The map from a pointer and the same map from the run's file.
        context.ok(sgs_relight_environment_set(c, relight, runs::map(32, 6).as_ptr(), 32, 16));
        let other = render_layer(&context, relight, SGS_LAYER_ENVIRONMENT, 0.0);
        context.ok(sgs_relight_environment_set(c, relight, runs::map(32, 5).as_ptr(), 32, 16));
        let own = render_layer(&context, relight, SGS_LAYER_ENVIRONMENT, 0.0);
        context.ok(sgs_relight_reset(c, relight));
        assert!(apart(&own, render_layer(&context, relight, SGS_LAYER_ENVIRONMENT, 0.0).into_iter()) < 1e-5);
        assert!(apart(&own, other.into_iter()) > 0.01);
    }
    assert_eq!(apart(&all, render_layer(&context, relight, SGS_LAYER_SHADED, 0.0).into_iter()), 0.0);
    let brighter = render_layer(&context, relight, SGS_LAYER_SHADED, 1.0);
    assert!(apart(&brighter, all.iter().map(|v| 2.0 * v)) < 1e-6);
    for layer in SGS_LAYER_SHADED..=SGS_LAYER_DIRECT {
        assert!(render_layer(&context, relight, layer, 0.0).iter().any(|v| *v > 0.0), "{layer} is black");
    }
}

#[test]
fn invalid_calls_return_error_codes() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    runs::fabricate(&at("run"), Parts::NONE);
    let context = Context::new();
    let (c, relight) = (context.0, opened(&context, &at("run")));
    let mut made = 7;
    let mut open = |path: &Path, info: *const SgsRelightInfo| {
        let path = text(path);
        // SAFETY: all pointers are valid or null.
        let result = unsafe { sgs_relight_open(c, path.as_ptr(), info, &mut made) };
        assert!(result == SgsResult::SGS_OK || made == 0);
        result
    };
    context.refused(open(&at("nothing"), null()), FILE, "no such run directory");
    context.refused(open(folder.path(), null()), FILE, "no config.toml");
    let bare = runs::with_materials(5, false, 1);
    sgs_scene::Splats { albedo: None, roughness: None, ..bare.clone() }.write_ply(&at("bare.ply")).unwrap();
    sgs_scene::Splats { normals: None, ..bare }.write_ply(&at("flat.ply")).unwrap();
    context.refused(open(&at("bare.ply"), null()), ARGUMENT, "has no materials; train its materials with --stage");
    context.refused(open(&at("flat.ply"), null()), ARGUMENT, "has no normals");
    runs::fabricate(&at("broken"), Parts::NONE);
    std::fs::write(at("broken/lights.json"), "{").unwrap();
    context.refused(open(&at("broken"), null()), FILE, "lights.json");
    let mut info = sized!(SgsRelightInfo { light_capacity: 100 });
    context.ok(open(&at("run"), &info));
    info.light_capacity = 1 << 17;
    context.refused(open(&at("run"), &info), ARGUMENT, "at most 65536");
    info.struct_size = 4;
    context.refused(open(&at("run"), &info), SIZE, "SgsRelightInfo.struct_size");
    // SAFETY: all pointers are valid or null, and null is refused.
    unsafe {
        assert_eq!(sgs_relight_open(c, null(), null(), &mut made), NULL);
        assert_eq!(sgs_relight_open(c, c"x".as_ptr(), null(), null_mut()), NULL);
        for context in [null::<SgsContext>(), c] {
            let handle = if context.is_null() { 0 } else { relight };
            assert_eq!(sgs_relight_get(context, handle, null_mut()), NULL);
            assert_eq!(sgs_relight_edit(context, handle, null(), null()), NULL);
            assert_eq!(sgs_relight_light_count(context, handle, null_mut()), NULL);
            assert_eq!(sgs_relight_light_get(context, handle, 0, null_mut()), NULL);
            assert_eq!(sgs_relight_light_set(context, handle, 0, null()), NULL);
            assert_eq!(sgs_relight_light_add(context, handle, null(), null_mut()), NULL);
            assert_eq!(sgs_relight_environment_set(context, handle, null(), 2, 1), NULL);
            assert_eq!(sgs_relight_environment_gain(context, handle, null()), NULL);
            assert_eq!(sgs_relight_view_create(context, handle, null(), &mut made), NULL);
            assert_eq!(sgs_relight_render(context, handle, null(), null(), null_mut(), 0), NULL);
        }
        assert_eq!(sgs_relight_reset(null(), 0), NULL);
        assert_eq!(sgs_relight_light_remove(null(), 0, 0), NULL);
        assert_eq!(sgs_view_exposure(null(), 0, 0.0), NULL);
        // Invalid values.
        let one = light(&context, relight, 0);
        let set = |change: &dyn Fn(&mut SgsLight)| {
            let mut light = one;
            change(&mut light);
            sgs_relight_light_set(c, relight, 0, &light)
        };
        context.refused(sgs_relight_light_set(c, relight, 4, &one), ARGUMENT, "there are lights 0 to 3");
        context.refused(sgs_relight_light_remove(c, relight, 4), ARGUMENT, "there are lights 0 to 3");
        context.refused(set(&|l| l.position[0] = f32::NAN), ARGUMENT, "position of light 0 is not finite");
        context.refused(set(&|l| l.gain = -1.0), ARGUMENT, "Gain and color of light 0");
        context.refused(set(&|l| l.color[2] = f32::INFINITY), ARGUMENT, "Gain and color of light 0");
        context.refused(set(&|l| l.color = [1e9; 3]), ARGUMENT, "too bright");
        context.refused(set(&|l| l.struct_size = 3), SIZE, "SgsLight.struct_size");
        let mut new = sized!(SgsNewLight { intensity: [1e9; 3] });
        context.refused(sgs_relight_light_add(c, relight, &new, null_mut()), ARGUMENT, "too bright");
        (new.intensity, new.sharpness) = ([1.0; 3], 1.0);
        context.refused(sgs_relight_light_add(c, relight, &new, null_mut()), ARGUMENT, "no direction");
        let gain = [1.0, -1.0, 1.0f32];
        context.refused(sgs_relight_environment_gain(c, relight, gain.as_ptr()), ARGUMENT, "at least 0");
        let map = [f32::NAN; 6];
        for (width, height) in [(1, 1), (0, 0), (1 << 15, 1 << 14), (2, u32::MAX)] {
            let result = sgs_relight_environment_set(c, relight, map.as_ptr(), width, height);
            context.refused(result, ARGUMENT, "twice as wide");
        }
        context.refused(sgs_relight_environment_set(c, relight, map.as_ptr(), 2, 1), ARGUMENT, "not finite");
        for (json, words) in [
            (c"{", "not an edit"),
            (cr#"{"lamps": 1}"#, "unknown field `lamps`"), // language: quoted
            (cr#"{"lights": {"only": [9]}}"#, "names light 9"),
            (cr#"{"environment": {"scale": 2}}"#, "has none"),
            (cr#"{"insert": [{"source": "nowhere.ply"}]}"#, "nowhere.ply"),
            (cr#"{"materials": [{"where": {"class": "sofa"}, "set": {"roughness": 1}}]}"#, "no classes"),
        ] {
            let result = sgs_relight_edit(c, relight, json.as_ptr(), null());
            let code = if words == "nowhere.ply" { FILE } else { ARGUMENT };
            context.refused(result, code, words);
        }
        assert_eq!(state(&context, relight).lights, 4, "something has changed");
        // Invalid views and images.
        let shape = sized!(SgsViewInfo { width: 8, height: 6, format: 109, layer: SGS_LAYER_SHADED, final_layout: 1 });
        let mut make = |change: &dyn Fn(&mut SgsViewInfo)| {
            let mut info = shape;
            change(&mut info);
            sgs_relight_view_create(c, relight, &info, &mut made)
        };
        context.refused(make(&|i| i.layer = SGS_LAYER_COLOR), ARGUMENT, "no layer 0");
        context.refused(make(&|i| i.layer = SGS_LAYER_METALLIC), ARGUMENT, "no metallic");
        context.refused(make(&|i| i.layer = SGS_LAYER_VISIBILITY), ARGUMENT, "no visibility");
        context.refused(make(&|i| (i.layer, i.format) = (SGS_LAYER_ROUGHNESS, 43)), ARGUMENT, "decodes colors");
        context.refused(make(&|i| i.height = 0), ARGUMENT, "8 x 0");
        context.refused(make(&|i| i.format = 1), ARGUMENT, "format is 1");
        context.ok(make(&|_| {}));
        let view = made;
        context.ok(sgs_view_exposure(c, view, -3.0));
        context.refused(sgs_view_exposure(c, view, f32::NAN), ARGUMENT, "exposure");
        context.refused(sgs_view_exposure(c, view, 1000.0), ARGUMENT, "exposure");
        let plain = context.load(&at("run/scene.ply"));
        context.refused(sgs_view_create(c, plain, &shape, &mut made), ARGUMENT, "no layer 16");
        let color = sized!(SgsViewInfo { width: 8, height: 6, format: 109, final_layout: 1 });
        context.ok(sgs_view_create(c, plain, &color, &mut made));
        context.refused(sgs_view_exposure(c, made, 0.0), ARGUMENT, "shows no relighting");
        let camera = camera([8, 6]);
        let mut pixels = [0.0f32; 144];
        let mut draw = |layer: u32, count: usize| {
            let info = sized!(SgsRelitInfo { layer: layer });
            sgs_relight_render(c, relight, &camera, &info, pixels.as_mut_ptr(), count)
        };
        context.ok(draw(SGS_LAYER_SHADED, 144));
        context.ok(draw(SGS_LAYER_ROUGHNESS, 48));
        context.refused(draw(SGS_LAYER_SHADED, 143), SPACE, "takes 144 floats");
        context.refused(draw(SGS_LAYER_COLOR, 144), ARGUMENT, "no layer 0");
        context.refused(draw(SGS_LAYER_VISIBILITY, 144), ARGUMENT, "no visibility");
        // Handles of another kind, of another context, and stale handles.
        let other = Context::new();
        let elsewhere = opened(&other, &at("run"));
        assert_ne!(elsewhere, relight);
        let mut count = 0;
        context.refused(sgs_relight_light_count(c, elsewhere, &mut count), HANDLE, "of this context");
        other.ok(sgs_relight_light_count(other.0, elsewhere, &mut count));
        assert_eq!(count, 4);
        context.refused(sgs_relight_reset(c, plain), HANDLE, "is that of a scene, not of a relighting");
        context.refused(sgs_view_create(c, relight, &shape, &mut made), HANDLE, "not of a scene");
        // The view outlives the relighting that it shows.
        context.ok(sgs_destroy(c, relight));
        context.refused(sgs_relight_reset(c, relight), HANDLE, "belongs to no relighting");
        context.ok(sgs_view_wait(c, view));
        context.ok(sgs_destroy(c, view));
    }
}

/// Renders all light of a room, seen from within.
fn render_layer_of_room(context: &Context, relight: SgsRelight) -> Vec<f32> {
    let info = sized!(SgsRelitInfo { layer: SGS_LAYER_SHADED });
    let mut camera = camera([40, 30]);
    camera.world_to_camera = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.8];
    let mut pixels = vec![f32::NAN; 3 * PIXELS];
    // SAFETY: all pointers are valid.
    context.ok(unsafe { sgs_relight_render(context.0, relight, &camera, &info, pixels.as_mut_ptr(), pixels.len()) });
    pixels
}

#[test]
fn emitters_are_listed_and_edited() {
    let folder = tempfile::tempdir().unwrap();
    sgs_tests::emitting::fabricate_emitting(folder.path());
    let context = Context::new();
    let (c, relight) = (context.0, opened(&context, &folder.path().join("run")));
    let about = state(&context, relight);
    assert_eq!((about.lights, about.emitters, about.environment, about.visibility), (3, 1, 0, 0));
    let mut emitter = sized!(SgsEmitter {});
    let mut name = [b'x' as c_char; 9];
    // SAFETY: all pointers are valid or null.
    unsafe {
        context.ok(sgs_relight_emitter_get(c, relight, 0, &mut emitter, null_mut(), 0));
        assert_eq!((emitter.shape, emitter.color, emitter.radius), (SGS_EMITTER_RECTANGLE, [0.5, 0.6, 1.0], 0.0));
        assert_eq!((emitter.axis, emitter.side), ([0.0, -1.0, 0.0], [1.0, 0.0, 0.0]));
        context.ok(sgs_relight_emitter_get(c, relight, 1, &mut emitter, name.as_mut_ptr(), 9));
        assert_eq!((emitter.shape, emitter.position, emitter.radius), (SGS_EMITTER_SPHERE, [0.4, -0.3, 0.4], 0.1));
        assert_eq!(CStr::from_ptr(name.as_ptr()), c"light 1");
        context.ok(sgs_relight_emitter_get(c, relight, 1, &mut emitter, name.as_mut_ptr(), 4));
        assert_eq!(CStr::from_ptr(name.as_ptr()), c"lig");
        let get = |index: u32, into: *mut SgsEmitter| sgs_relight_emitter_get(c, relight, index, into, null_mut(), 0);
        context.refused(get(3, &mut emitter), ARGUMENT, "there are emitters 0 to 2");
        assert_eq!(get(0, null_mut()), NULL);
        emitter.struct_size = 3;
        context.refused(get(0, &mut emitter), SIZE, "SgsEmitter.struct_size");
        let mut light = light(&context, relight, 1);
        let before = render_layer_of_room(&context, relight);
        light.position[0] -= 0.5;
        context.ok(sgs_relight_light_set(c, relight, 1, &light));
        let moved = render_layer_of_room(&context, relight);
        assert!(apart(&before, moved.iter().copied()) > 0.01);
        let same = cr#"{"emitters": {"change": [{"emitter": "light 1", "by": [-0.5, 0, 0]}]}}"#;
        context.ok(sgs_relight_edit(c, relight, same.as_ptr(), null()));
        assert!(apart(&moved, render_layer_of_room(&context, relight).into_iter()) < 1e-5);
        context.ok(sgs_relight_reset(c, relight));
        assert!(apart(&before, render_layer_of_room(&context, relight).into_iter()) < 1e-5);
        light.position[0] = f32::NAN;
        context.refused(sgs_relight_light_set(c, relight, 1, &light), ARGUMENT, "\"light 1\" is not finite");
        context.refused(sgs_relight_environment_gain(c, relight, [1.0f32; 3].as_ptr()), ARGUMENT, "no environment");
        // Edits of emitters, and of the lights that they replace.
        let edit = |json: &CStr| sgs_relight_edit(c, relight, json.as_ptr(), null());
        context.ok(edit(cr#"{"emitters": {"only": ["light 2"]}}"#));
        context.refused(edit(cr#"{"emitters": {"only": ["sun"]}}"#), ARGUMENT, "the emitter \"sun\"");
        context.ok(edit(cr#"{"lights": {"add": [{"position": [0, 0, 0], "intensity": [1, 1, 1]}]}}"#));
        context.refused(
            sgs_relight_emitter_get(c, relight, 0, &mut sized!(SgsEmitter {}), null_mut(), 0),
            ARGUMENT,
            "no emitters light",
        );
        assert_eq!((state(&context, relight).emitters, state(&context, relight).lights), (0, 1));
    }
}
