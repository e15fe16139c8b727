//! Emitters through the C interface: added, changed and removed one by one, and windows onto an environment.

#[macro_use]
mod support;

use SgsResult::{SGS_ERROR_ARGUMENT as ARGUMENT, SGS_ERROR_NULL as NULL, SGS_ERROR_STRUCT_SIZE as SIZE};
use sgs::*;
use sgs_tests::emitting;
use std::ffi::{CStr, CString, c_char};
use std::path::Path;
use std::ptr::{null, null_mut};
use support::{Context, camera, text};

const PIXELS: usize = 40 * 30;

struct Lit<'a> {
    context: &'a Context,
    relight: SgsRelight,
}

impl Lit<'_> {
    fn open<'a>(context: &'a Context, run: &Path) -> Lit<'a> {
        let (run, mut relight) = (text(run), 0);
        // SAFETY: all pointers are valid.
        context.ok(unsafe { sgs_relight_open(context.0, run.as_ptr(), null(), &mut relight) });
        Lit { context, relight }
    }

    /// Renders a layer of the room, seen from within.
    fn layer(&self, layer: u32) -> Vec<f32> {
        let info = sized!(SgsRelitInfo { layer: layer });
        let mut camera = camera([40, 30]);
        camera.world_to_camera = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.8];
        let mut pixels = vec![f32::NAN; 3 * PIXELS];
        let (c, into) = (self.context.0, pixels.as_mut_ptr());
        // SAFETY: all pointers are valid.
        self.context.ok(unsafe { sgs_relight_render(c, self.relight, &camera, &info, into, 3 * PIXELS) });
        assert!(pixels.iter().all(|v| v.is_finite()));
        pixels
    }

    fn image(&self) -> Vec<f32> {
        self.layer(SGS_LAYER_SHADED)
    }

    fn edit(&self, json: &str, folder: &Path) -> Vec<f32> {
        let (json, folder) = (CString::new(json).unwrap(), text(folder));
        // SAFETY: all pointers are valid.
        self.context.ok(unsafe { sgs_relight_edit(self.context.0, self.relight, json.as_ptr(), folder.as_ptr()) });
        self.image()
    }

    fn count(&self) -> u32 {
        let mut count = 0;
        // SAFETY: all pointers are valid.
        self.context.ok(unsafe { sgs_relight_light_count(self.context.0, self.relight, &mut count) });
        count
    }

    fn emitter(&self, index: u32) -> (SgsEmitter, String) {
        let (mut emitter, mut name) = (sized!(SgsEmitter {}), [0 as c_char; 40]);
        let (c, into) = (self.context.0, name.as_mut_ptr());
        // SAFETY: all pointers are valid; the name ends with a zero.
        unsafe {
            self.context.ok(sgs_relight_emitter_get(c, self.relight, index, &mut emitter, into, 40));
            (emitter, CStr::from_ptr(name.as_ptr()).to_str().unwrap().to_owned())
        }
    }

    fn add(&self, emitter: &SgsEmitter, name: Option<&CStr>) -> u32 {
        let (name, mut index) = (name.map_or(null(), CStr::as_ptr), u32::MAX);
        // SAFETY: all pointers are valid or null.
        self.context.ok(unsafe { sgs_relight_emitter_add(self.context.0, self.relight, emitter, name, &mut index) });
        index
    }

    fn replace(&self, index: u32, emitter: &SgsEmitter) {
        // SAFETY: all pointers are valid.
        self.context.ok(unsafe { sgs_relight_emitter_set(self.context.0, self.relight, index, emitter) });
    }

    fn set(&self, index: u32, change: impl Fn(&mut SgsLight)) {
        let mut light = sized!(SgsLight {});
        // SAFETY: all pointers are valid.
        unsafe {
            self.context.ok(sgs_relight_light_get(self.context.0, self.relight, index, &mut light));
            change(&mut light);
            self.context.ok(sgs_relight_light_set(self.context.0, self.relight, index, &light));
        }
    }

    fn remove(&self, index: u32) {
        // SAFETY: the context is valid.
        self.context.ok(unsafe { sgs_relight_light_remove(self.context.0, self.relight, index) });
    }
}

#[track_caller]
fn apart(a: &[f32], b: &[f32]) -> f32 {
    let largest = a.iter().fold(1e-6f32, |m, v| m.max(v.abs()));
    a.iter().zip(b).fold(0.0f32, |m, (x, y)| m.max((x - y).abs())) / largest
}

/// Returns an emitter of each kind, its JSON, and the same at another place.
fn kinds() -> [(SgsEmitter, &'static str, &'static str); 8] {
    let of = |shape: u32, color: [f32; 3]| sized!(SgsEmitter { shape: shape, color: color });
    let at = [-0.5, 0.2, 0.6];
    let (down, across) = ([0.0, 1.0, 0.0], [0.3, 0.0, 0.0]);
    [
        (
            SgsEmitter { position: at, ..of(SGS_EMITTER_POINT, [1.0, 2.0, 0.5]) },
            r#""type": "point", "position": [-0.5, 0.2, 0.6]"#,
            "[1, 2, 0.5]",
        ),
        (
            SgsEmitter { position: at, radius: 0.2, ..of(SGS_EMITTER_SPHERE, [3.0, 2.0, 5.0]) },
            r#""type": "sphere", "center": [-0.5, 0.2, 0.6], "radius": 0.2"#,
            "[3, 2, 5]",
        ),
        (
            SgsEmitter { position: at, axis: across, side: [0.0, 0.0, 0.4], ..of(SGS_EMITTER_RECTANGLE, [9.0; 3]) },
            r#""type": "rectangle", "corner": [-0.5, 0.2, 0.6], "edge_u": [0.3, 0, 0], "edge_v": [0, 0, 0.4]"#,
            "[9, 9, 9]",
        ),
        (
            SgsEmitter { position: at, axis: down, radius: 0.2, ..of(SGS_EMITTER_DISK, [9.0, 5.0, 1.0]) },
            r#""type": "disk", "center": [-0.5, 0.2, 0.6], "normal": [0, 1, 0], "radius": 0.2"#,
            "[9, 5, 1]",
        ),
        (
            SgsEmitter { position: at, axis: down, angles: [10.0, 40.0], ..of(SGS_EMITTER_SPOT, [5.0; 3]) },
            r#""type": "spot", "position": [-0.5, 0.2, 0.6], "axis": [0, 1, 0], "inner_angle": 10, "outer_angle": 40"#,
            "[5, 5, 5]",
        ),
        (
            SgsEmitter { axis: [0.2, 0.3, -1.0], angles: [2.0, 0.0], ..of(SGS_EMITTER_DIRECTIONAL, [8.0, 7.0, 5.0]) },
            r#""type": "directional", "direction": [0.2, 0.3, -1], "angular_radius": 2"#,
            "[8, 7, 5]",
        ),
        (
            SgsEmitter { position: at, axis: down, sharpness: 4.0, ..of(SGS_EMITTER_LOBE, [3.0; 3]) },
            r#""type": "lobe", "position": [-0.5, 0.2, 0.6], "axis": [0, 1, 0], "sharpness": 4"#,
            "[3, 3, 3]",
        ),
        (
            SgsEmitter { position: at, axis: across, side: [0.0, 0.0, 0.4], ..of(SGS_EMITTER_WINDOW, [2.0, 3.0, 4.0]) },
            r#""type": "window", "corner": [-0.5, 0.2, 0.6], "edge_u": [0.3, 0, 0], "edge_v": [0, 0, 0.4]"#,
            "[2, 3, 4]",
        ),
    ]
}

#[test]
fn emitters_of_every_kind_match_edits() {
    let folder = tempfile::tempdir().unwrap();
    emitting::fabricate_windowed(folder.path());
    let context = Context::new();
    let [lit, edited] = [(); 2].map(|()| Lit::open(&context, &folder.path().join("run")));
    let before = lit.image();
    let others = (0..3).map(|i| lit.emitter(i).1).collect::<Vec<_>>();
    for (emitter, shape, color) in kinds() {
        let kind = emitter.shape;
        let edit = |color: &str, by: f32| {
            let add = format!(r#"{{"name": "own", "shape": {{{shape}}}, "color": {color}}}"#);
            // A new emitter is dimmed and moved by a second edit of one name: only the emitters of a run can be changed.
            assert!(by == 0.0 || kind != SGS_EMITTER_DIRECTIONAL);
            let add = add.replace("[-0.5, 0.2, 0.6]", &format!("[{}, 0.2, 0.6]", -0.5 + by));
            edited.edit(&format!(r#"{{"emitters": {{"add": [{add}]}}}}"#), folder.path())
        };
        let index = lit.add(&emitter, Some(c"own"));
        assert_eq!((index, lit.count()), (3, 4));
        let (found, name) = lit.emitter(index);
        assert_eq!((found.shape, found.color, &*name), (kind, emitter.color, "own"));
        assert_eq!((found.position, found.axis, found.side), (emitter.position, emitter.axis, emitter.side));
        assert_eq!((found.radius, found.sharpness), (emitter.radius, emitter.sharpness));
        assert!((0..2).all(|k| (found.angles[k] - emitter.angles[k]).abs() < 1e-4));
        let added = lit.image();
        let off = apart(&added, &edit(color, 0.0));
        // Edges of its shadows depend on the sample points, which are others where a light takes the place of another.
        let close = if kind == SGS_EMITTER_DIRECTIONAL { 2e-3 } else { 1e-5 };
        assert!(off < close, "{kind}: {off}");
        assert!(apart(&added, &before) > 0.01, "{kind} is dark");
        // It is dimmed by half, and light is linear.
        lit.set(index, |l| l.gain = 0.5);
        let half: Vec<f32> = added.iter().zip(&before).map(|(a, b)| 0.5 * (a + b)).collect();
        assert!(apart(&lit.image(), &half) < 1e-5, "{kind}");
        lit.set(index, |l| l.on = 0);
        assert_eq!(apart(&lit.image(), &before), 0.0, "{kind}");
        if kind != SGS_EMITTER_DIRECTIONAL {
            lit.set(index, |l| (l.on, l.gain, l.position[0]) = (1, 1.0, l.position[0] + 0.25));
            let moved = lit.image();
            let off = apart(&moved, &edit(color, 0.25));
            assert!(off < 1e-5 && apart(&moved, &added) > 1e-3, "{kind}: {off}");
        }
        // Set to the same shape, it is at its place again, with another color.
        lit.set(index, |l| l.on = 1);
        lit.replace(index, &SgsEmitter { color: [0.5, 0.0, 1.0], ..emitter });
        assert!(apart(&lit.image(), &edit("[0.5, 0, 1]", 0.0)) < close, "{kind}");
        lit.remove(index);
        assert_eq!((apart(&lit.image(), &before), lit.count()), (0.0, 3), "{kind}");
    }
    assert_eq!((0..3).map(|i| lit.emitter(i).1).collect::<Vec<_>>(), others);
}

#[test]
fn emitters_of_the_run_are_removed_and_others_named() {
    let folder = tempfile::tempdir().unwrap();
    emitting::fabricate_emitting(folder.path());
    let context = Context::new();
    let [lit, edited] = [(); 2].map(|()| Lit::open(&context, &folder.path().join("run")));
    let before = lit.image();
    let [(bulb, _, _), (ball, shape, color), ..] = kinds();
    // The window has a surface, which is dark when it is removed.
    lit.remove(0);
    let without = edited.edit(r#"{"emitters": {"change": [{"emitter": "window 1", "on": false}]}}"#, folder.path());
    assert!(apart(&lit.image(), &without) < 1e-5 && apart(&before, &without) > 0.01);
    assert_eq!((lit.emitter(0).1, lit.emitter(1).1), ("light 1".to_owned(), "light 2".to_owned()));
    // Emitters that take its place do not make that surface shine.
    assert_eq!((lit.add(&ball, Some(c"light 1")), lit.add(&bulb, None), lit.add(&bulb, None)), (2, 3, 4));
    let names: Vec<String> = (0..5).map(|i| lit.emitter(i).1).collect();
    assert_eq!(names, ["light 1", "light 2", "light 1 (2)", "new 1", "new 2"]);
    lit.remove(4);
    lit.remove(3);
    let same = format!(
        r#"{{"emitters": {{"change": [{{"emitter": "window 1", "on": false}}], "add": [{{"shape": {{{shape}}}, "color": {color}}}]}}}}"#
    );
    let off = apart(&lit.image(), &edited.edit(&same, folder.path()));
    assert!(off < 1e-5, "{off}");
    // Points and lobes of the other struct are emitters, too.
    let new = sized!(SgsNewLight { position: [0.1, 0.2, 0.3], intensity: [1.0, 2.0, 3.0] });
    let narrow = sized!(SgsNewLight { sharpness: 3.0, axis: [0.0, -1.0, 0.0], intensity: [1.0; 3] });
    // SAFETY: all pointers are valid or null.
    unsafe {
        context.ok(sgs_relight_light_add(context.0, lit.relight, &new, null_mut()));
        context.ok(sgs_relight_light_add(context.0, lit.relight, &narrow, null_mut()));
    }
    assert_eq!((lit.emitter(3).0.shape, lit.emitter(4).0.shape), (SGS_EMITTER_POINT, SGS_EMITTER_LOBE));
    assert_eq!((lit.emitter(4).0.axis, lit.emitter(4).0.sharpness), ([0.0, 1.0, 0.0], 3.0));
    // An edit starts from the run on disk.
    assert!(apart(&lit.edit("{}", folder.path()), &before) < 1e-5 && lit.count() == 3);
}

#[test]
fn windows_show_the_environment_and_are_linear_in_it() {
    let folder = tempfile::tempdir().unwrap();
    emitting::fabricate_windowed(folder.path());
    let context = Context::new();
    let lit = Lit::open(&context, &folder.path().join("run"));
    let mut state = sized!(SgsRelightState {});
    // SAFETY: all pointers are valid.
    context.ok(unsafe { sgs_relight_get(context.0, lit.relight, &mut state) });
    assert_eq!((state.environment, state.emitters, lit.emitter(0).0.shape), (1, 1, SGS_EMITTER_WINDOW));
    lit.set(1, |l| l.on = 0);
    let all = lit.image();
    assert!(all.iter().any(|v| *v > 0.05), "the window is dark");
    let scaled = |by: [f32; 3]| all.iter().enumerate().map(|(i, v)| by[i % 3] * v).collect::<Vec<f32>>();
    // Dimming, recoloring and the gain of the environment scale the image, with its bounces and the window itself.
    lit.set(0, |l| (l.gain, l.color) = (0.25, [1.0, 0.0, 2.0]));
    assert!(apart(&lit.image(), &scaled([0.25, 0.0, 0.5])) < 1e-5);
    lit.set(0, |l| (l.gain, l.color) = (1.0, [1.0; 3]));
    let gain = |rgb: [f32; 3]| {
        // SAFETY: the pointer is valid.
        context.ok(unsafe { sgs_relight_environment_gain(context.0, lit.relight, rgb.as_ptr()) });
        lit.image()
    };
    assert!(apart(&gain([0.5, 2.0, 0.0]), &scaled([0.5, 2.0, 0.0])) < 1e-5);
    let off = r#"{"emitters": {"only": ["window 1"], "environment": {"color": [0.5, 2, 0]}}}"#;
    assert!(apart(&lit.edit(off, folder.path()), &scaled([0.5, 2.0, 0.0])) < 1e-5);
    // Another environment lights the room in another way, as if an edit had named its file.
    let other = emitting::sky(9);
    let set = |map: &[f32], size: [u32; 2]| {
        // SAFETY: the map has this size.
        context.ok(unsafe { sgs_relight_environment_set(context.0, lit.relight, map.as_ptr(), size[0], size[1]) });
        lit.image()
    };
    lit.edit(r#"{"emitters": {"only": ["window 1"]}}"#, folder.path());
    let shown = set(&other.data, [32, 16]);
    sgs_scene::write_environment(&folder.path().join("other.exr"), &other).unwrap();
    let same = r#"{"emitters": {"only": ["window 1"], "environment": {"file": "other.exr"}}}"#;
    let off = apart(&shown, &lit.edit(same, folder.path()));
    assert!(off < 1e-5 && apart(&shown, &all) > 0.02, "{off}");
    // Light from one side of the sky alone lights another part of the room: the direction is sampled.
    let half = |from: usize| -> Vec<f32> {
        let lit = |i: usize| if (i / 3 % 32 / 16 == from) && i / 96 < 12 { 3.0 } else { 0.0 };
        (0..3 * 32 * 16).map(lit).collect()
    };
    let [left, right] = [set(&half(0), [32, 16]), set(&half(1), [32, 16])];
    assert!(apart(&left, &right) > 0.05);
    let both: Vec<f32> = half(0).iter().zip(half(1)).map(|(a, b)| a + b).collect();
    let sum: Vec<f32> = left.iter().zip(&right).map(|(a, b)| a + b).collect();
    assert!(apart(&set(&both, [32, 16]), &sum) < 1e-5);
    // Before an environment is set, windows of a room without one are white.
    emitting::fabricate_emitting(&folder.path().join("plain"));
    let plain = Lit::open(&context, &folder.path().join("plain/run"));
    plain.remove(1);
    let mut pane = lit.emitter(0).0;
    pane.color = [1.0, 2.0, 3.0];
    plain.add(&pane, None);
    let white = plain.image();
    // SAFETY: all pointers are valid.
    unsafe {
        let (c, gain) = (context.0, [1.0f32; 3]);
        context.refused(sgs_relight_environment_gain(c, plain.relight, gain.as_ptr()), ARGUMENT, "no environment");
        context.ok(sgs_relight_environment_set(c, plain.relight, [1.0f32; 6].as_ptr(), 2, 1));
        assert!(apart(&white, &plain.image()) < 1e-5);
        context.ok(sgs_relight_environment_gain(c, plain.relight, gain.as_ptr()));
    }
}

#[test]
fn invalid_emitters_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    emitting::fabricate_emitting(folder.path());
    let context = Context::new();
    let (c, lit) = (context.0, Lit::open(&context, &folder.path().join("run")));
    let before = lit.image();
    let all = kinds().map(|(emitter, ..)| emitter);
    let [point, sphere, rectangle, disk, spot, sun, lobe, window] = all;
    let nan = f32::NAN;
    // SAFETY: all pointers are valid or null.
    unsafe {
        for (emitter, words) in [
            (SgsEmitter { shape: 8, ..point }, "SgsEmitter.shape is 8; use SGS_EMITTER_POINT"),
            (SgsEmitter { shape: u32::MAX, ..point }, "SgsEmitter.shape is 4294967295"),
            (SgsEmitter { color: [1.0, nan, 0.0], ..point }, "SgsEmitter.color: NaN is not finite"),
            (SgsEmitter { color: [1.0, -2.0, 0.0], ..window }, "SgsEmitter.color: -2 is negative"),
            (SgsEmitter { position: [f32::INFINITY; 3], ..sphere }, "SgsEmitter.position: inf is not finite"),
            (SgsEmitter { radius: -1.0, ..sphere }, "SgsEmitter.radius: length -1 is outside"),
            (SgsEmitter { radius: nan, ..disk }, "SgsEmitter.radius"),
            (SgsEmitter { axis: [0.0; 3], ..disk }, "SgsEmitter.axis: length 0"),
            (SgsEmitter { axis: [0.0; 3], ..rectangle }, "SgsEmitter.axis: length 0"),
            (SgsEmitter { side: [0.0; 3], ..window }, "SgsEmitter.side: length 0"),
            (SgsEmitter { side: [1.0, 0.0, 1.0], ..rectangle }, "SgsEmitter.side: the cosine"),
            (SgsEmitter { angles: [50.0, 40.0], ..spot }, "SgsEmitter.angles[0]: 50 degrees is outside"),
            (SgsEmitter { angles: [0.0, 120.0], ..spot }, "SgsEmitter.angles[1]: 120 degrees"),
            (SgsEmitter { angles: [nan, 40.0], ..spot }, "SgsEmitter.angles[0]"),
            (SgsEmitter { angles: [90.0, 0.0], ..sun }, "SgsEmitter.angles[0]: 90 degrees"),
            (SgsEmitter { axis: [nan; 3], ..sun }, "SgsEmitter.axis: NaN"),
            (SgsEmitter { sharpness: -1.0, ..lobe }, "SgsEmitter.sharpness: -1 is negative"),
        ] {
            let add = sgs_relight_emitter_add(c, lit.relight, &emitter, null(), null_mut());
            context.refused(add, ARGUMENT, words);
            context.refused(sgs_relight_emitter_set(c, lit.relight, 1, &emitter), ARGUMENT, words);
        }
        let small = SgsEmitter { struct_size: 3, ..point };
        let add = |emitter: *const SgsEmitter, name: *const c_char| {
            sgs_relight_emitter_add(c, lit.relight, emitter, name, null_mut())
        };
        context.refused(add(&small, null()), SIZE, "SgsEmitter.struct_size");
        assert_eq!(add(null(), null()), NULL);
        assert_eq!(sgs_relight_emitter_set(c, lit.relight, 0, null()), NULL);
        assert_eq!(sgs_relight_emitter_add(null(), 0, &point, null(), null_mut()), NULL);
        context.refused(add(&point, c" ".as_ptr()), ARGUMENT, "its name is empty");
        context.refused(add(&point, [b'\xff' as c_char, 0].as_ptr()), ARGUMENT, "name is not UTF-8");
        let set = |index: u32, emitter: &SgsEmitter| sgs_relight_emitter_set(c, lit.relight, index, emitter);
        context.refused(set(3, &point), ARGUMENT, "there are emitters 0 to 2");
        context.refused(set(1, &window), ARGUMENT, "\"light 1\" cannot become a window; remove it");
        context.refused(sgs_relight_light_remove(c, lit.relight, 3), ARGUMENT, "there are emitters 0 to 2");
        assert_eq!((lit.count(), apart(&lit.image(), &before)), (3, 0.0));
        // Lights of the published model have no such shapes.
        let json = cr#"{"lights": {"add": [{"position": [0, 0, 0], "intensity": [1, 1, 1]}]}}"#;
        context.ok(sgs_relight_edit(c, lit.relight, json.as_ptr(), null()));
        context.refused(add(&point, null()), ARGUMENT, "No emitters light the scene");
        context.refused(set(0, &point), ARGUMENT, "No emitters light the scene");
    }
}
