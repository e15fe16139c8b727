//! C interface as a C program calls it: results and error codes.

#[macro_use]
mod support;

use sgs::*;
use sgs_passes::pipeline::Renderer;
use sgs_passes::scene::Model;
use sgs_passes::splat::Channels;
use sgs_tests::rooms::Room;
use sgs_tests::scenes::{self, Rng};
use std::ffi::{CStr, c_char};
use std::ptr::{null, null_mut};
use support::{Context, camera, text, zeroed};
use tempfile::TempDir;

fn scene(folder: &TempDir) -> std::path::PathBuf {
    let data = scenes::data(&scenes::ordinary(150, 1, true, 8));
    let path = folder.path().join("scene.ply");
    sgs_run::splats(&data, Model { sh_degree: 1, normals: true, ..Default::default() }).write_ply(&path).unwrap();
    path
}

#[test]
fn layers_in_memory_match_the_renderer() {
    let folder = tempfile::tempdir().unwrap();
    let context = Context::new();
    let scene = context.load(&scene(&folder));
    let size = [40, 30];
    let gpu = sgs_tests::Gpu::fresh();
    let model = Model { sh_degree: 1, normals: true, ..Default::default() };
    let gaussians = sgs_passes::scene::Gaussians::new(gpu.device(), model, 150, false).unwrap();
    gaussians.upload(gpu.device(), &scenes::data(&scenes::ordinary(150, 1, true, 8))).unwrap();
    let channels = Channels { colors: true, normals: true, depth: true };
    let mut renderer = Renderer::new(gpu.device(), gpu.tuning(), &gaussians, size, channels).unwrap();
    let view = scenes::gpu_camera(&scenes::camera(size));
    let rendered = renderer.render(&gaussians, &view, 1, [0.3, 0.2, 0.1]).unwrap();
    let pixels = 40 * 30;
    for (layer, from, floats) in [
        (SGS_LAYER_COLOR, 0, 3),
        (SGS_LAYER_NORMAL, 3, 3),
        (SGS_LAYER_DEPTH, 6, 1),
        (SGS_LAYER_ALPHA, 0, 1),
        (SGS_LAYER_COLOR, 0, 3),
    ] {
        let info = sized!(SgsRenderInfo { layer: layer, background: [0.3, 0.2, 0.1] });
        let mut into = vec![f32::NAN; pixels * floats];
        let camera = camera(size);
        // SAFETY: all pointers are valid.
        context.ok(unsafe { sgs_render(context.0, scene, &camera, &info, into.as_mut_ptr(), into.len()) });
        for (i, got) in into.chunks(floats).enumerate() {
            let want: Vec<f32> = if layer == SGS_LAYER_ALPHA {
                vec![1.0 - rendered.transmittance[i]]
            } else {
                rendered.image[8 * i + from..8 * i + from + floats].to_vec()
            };
            // The interface computes the camera's position from the matrix, which rounds differently.
            assert!(got.iter().zip(&want).all(|(g, w)| (g - w).abs() < 1e-4 * (1.0 + w.abs())), "{got:?} {want:?}");
        }
    }
}

#[test]
fn training_runs_in_single_steps_and_resumes() {
    let folder = tempfile::tempdir().unwrap();
    let context = Context::new();
    let dataset = folder.path().join("room");
    std::fs::create_dir(&dataset).unwrap();
    Room { views: 4, size: [24, 16], ..Room::default() }.write(&dataset);
    let (dataset, run) = (text(&dataset), text(&folder.path().join("run")));
    let settings = c"[geometry]\nsteps = 12\nsh_degree = 1\nbackward = \"pixel\"\ndensify = { until = 0 }\n";
    let mut info = sized!(SgsTrainerInfo { dataset: dataset.as_ptr(), settings: settings.as_ptr() });
    let (mut trainer, mut status) = (0, sized!(SgsTrainStatus {}));
    // SAFETY: all pointers are valid.
    unsafe {
        context.ok(sgs_trainer_open(context.0, &info, &mut trainer));
        // A budget of zero runs one step.
        context.ok(sgs_train_step(context.0, trainer, 0.0, &mut status));
        assert_eq!((status.step, status.steps, status.finished), (1, 12, 0));
        assert!(status.loss > 0.0 && status.gaussians > 0);
        context.ok(sgs_train_step(context.0, trainer, 0.0, null_mut()));
        let mut scene = 0;
        context.ok(sgs_trainer_scene(context.0, trainer, &mut scene));
        let mut about = sized!(SgsSceneInfo {});
        context.ok(sgs_scene_get(context.0, scene, &mut about));
        assert_eq!((about.gaussians, about.sh_degree), (status.gaussians, 1));
        context.ok(sgs_trainer_save(context.0, trainer, run.as_ptr()));
        context.ok(sgs_destroy(context.0, trainer));
        context.refused(
            sgs_train_step(context.0, trainer, 0.0, &mut status),
            SgsResult::SGS_ERROR_HANDLE,
            "belongs to no trainer",
        );
        (info.settings, info.run, info.resume) = (null(), run.as_ptr(), 1);
        context.ok(sgs_trainer_open(context.0, &info, &mut trainer));
        context.ok(sgs_train_step(context.0, trainer, 0.0, &mut status));
        assert_eq!(status.step, 3);
        context.ok(sgs_train_step(context.0, trainer, 1e6, &mut status));
        assert_eq!((status.step, status.finished), (12, 1));
        context.ok(sgs_train_step(context.0, trainer, 1e6, &mut status));
        assert_eq!(status.step, 12);
        let out = text(&folder.path().join("out.ply"));
        context.ok(sgs_trainer_export(context.0, trainer, out.as_ptr()));
        let again = context.load(&folder.path().join("out.ply"));
        // A run directory loads as a scene.
        context.ok(sgs_trainer_save(context.0, trainer, run.as_ptr()));
        let of_run = context.load(&folder.path().join("run"));
        assert_ne!(again, of_run);
        for budget in [-1.0, f64::NAN, f64::INFINITY] {
            let result = sgs_train_step(context.0, trainer, budget, &mut status);
            context.refused(result, SgsResult::SGS_ERROR_ARGUMENT, "budget");
        }
        (info.settings, info.resume) = (c"geometry = 3".as_ptr(), 0);
        let result = sgs_trainer_open(context.0, &info, &mut trainer);
        context.refused(result, SgsResult::SGS_ERROR_ARGUMENT, "geometry");
        assert_eq!(trainer, 0);
        (info.settings, info.dataset) = (null(), c"/nowhere".as_ptr());
        let result = sgs_trainer_open(context.0, &info, &mut trainer);
        context.refused(result, SgsResult::SGS_ERROR_FILE, "/nowhere");
    }
}

#[test]
fn cameras_load_from_transforms_files() {
    let folder = tempfile::tempdir().unwrap();
    let context = Context::new();
    let room = Room { views: 5, size: [20, 12], ..Room::default() };
    room.write(folder.path());
    let path = text(&folder.path().join("transforms.json"));
    let (mut cameras, mut count, mut camera) = (0, 0, sized!(SgsCamera {}));
    // SAFETY: all pointers are valid.
    unsafe {
        context.ok(sgs_cameras_load(context.0, path.as_ptr(), &mut cameras));
        context.ok(sgs_cameras_count(context.0, cameras, &mut count));
        assert_eq!(count, 5);
        context.ok(sgs_cameras_get(context.0, cameras, 3, &mut camera));
        assert_eq!((camera.width, camera.height, camera.struct_size as usize), (20, 12, size_of::<SgsCamera>()));
        let real = sgs_run::camera(&room.cameras()[3]);
        for (a, b) in camera.world_to_camera.iter().zip(real.world_to_camera.as_flattened()) {
            assert!((a - b).abs() < 1e-5);
        }
        let result = sgs_cameras_get(context.0, cameras, 5, &mut camera);
        context.refused(result, SgsResult::SGS_ERROR_ARGUMENT, "Camera 5 does not exist");
        context.ok(sgs_destroy(context.0, cameras));
    }
}

#[test]
fn null_pointers_return_an_error() {
    use SgsResult::SGS_ERROR_NULL as NULL;
    let context = Context::new();
    let none = null::<SgsContext>();
    // SAFETY: the null pointers are under test; all other pointers are valid.
    unsafe {
        let mut why = [1 as c_char; 8];
        assert_eq!(sgs_context_open(null(), null_mut(), why.as_mut_ptr(), why.len()), NULL);
        assert_eq!(CStr::from_ptr(why.as_ptr()).to_bytes(), b"The pla");
        assert_eq!(sgs_context_adopt(null(), null_mut(), null_mut(), 0), NULL);
        let mut made = std::ptr::dangling_mut();
        assert_eq!(sgs_context_adopt(null(), &mut made, null_mut(), 0), NULL);
        assert!(made.is_null());
        let mut needs = std::ptr::dangling_mut();
        assert_eq!(sgs_requirements_create(null(), &mut needs, null_mut(), 0), NULL);
        assert!(needs.is_null());
        let empty = sized!(SgsInstance {});
        assert_eq!(sgs_requirements_create(&empty, &mut needs, null_mut(), 0), NULL);
        assert_eq!(sgs_requirements_get(null_mut(), null_mut()), NULL);
        assert_eq!(sgs_requirements_destroy(null_mut()), NULL);
        assert_eq!(sgs_requirements_destroy(&mut needs), NULL);
        assert_eq!(sgs_context_destroy(null_mut()), NULL);
        assert_eq!(sgs_last_error(none, null_mut(), 0, null_mut()), NULL);
        for c in [none, context.0.cast_const()] {
            assert_eq!(sgs_context_get(c, null_mut()), NULL);
            assert_eq!(sgs_scene_load(c, null(), null_mut()), NULL);
            assert_eq!(sgs_cameras_load(c, null(), null_mut()), NULL);
            assert_eq!(sgs_trainer_open(c, null(), null_mut()), NULL);
            assert_eq!(sgs_view_create(c, 0, null(), null_mut()), NULL);
            assert_eq!(sgs_view_record(c, 0, null(), null_mut(), null_mut()), NULL);
            assert_eq!(sgs_recording_timeline(c, 0, 0, 0), NULL);
            assert_eq!(sgs_recording_fence(c, 0, 0), NULL);
            let mut handle = 9;
            assert_eq!(sgs_scene_load(c, null(), &mut handle), NULL);
            assert_eq!(sgs_view_record(c, 0, null(), null_mut(), &mut handle), NULL);
        }
        assert_eq!(sgs_destroy(none, 0), NULL);
        assert_eq!(sgs_render(none, 0, null(), null(), null_mut(), 0), NULL);
        assert_eq!(sgs_train_step(none, 0, 0.0, null_mut()), NULL);
        assert_eq!(sgs_view_submit(none, 0, null(), null(), 0, null(), 0), NULL);
        assert_eq!(sgs_view_submit(context.0, 0, null(), null(), 1, null(), 0), NULL);
        assert_eq!(sgs_last_error(context.0, null_mut(), 0, null_mut()), SgsResult::SGS_OK);
    }
}

#[test]
fn struct_sizes_are_checked_on_input_and_output() {
    use SgsResult::SGS_ERROR_STRUCT_SIZE as SIZE;
    let folder = tempfile::tempdir().unwrap();
    let context = Context::new();
    let scene = context.load(&scene(&folder));
    let info = sized!(SgsRenderInfo {});
    let mut pixels = [0.0; 4 * 4 * 3];
    let mut draw = |camera: *const SgsCamera| {
        // SAFETY: all pointers are valid, and as long as they say.
        unsafe { sgs_render(context.0, scene, camera, &info, pixels.as_mut_ptr(), pixels.len()) }
    };
    let good = camera([4, 4]);
    context.ok(draw(&good));
    for size in [0, 1, 4, size_of::<SgsCamera>() as u32 - 1, u32::MAX] {
        let mut wrong = good;
        wrong.struct_size = size;
        context.refused(draw(&wrong), SIZE, "SgsCamera.struct_size");
    }
    // A program of a later version may pass unknown fields if they are zero.
    #[repr(C)]
    struct Later {
        camera: SgsCamera,
        more: [u32; 4],
    }
    let mut later = Later { camera: good, more: [0; 4] };
    later.camera.struct_size = size_of::<Later>() as u32;
    context.ok(draw(&raw const later.camera));
    later.more[3] = 1;
    context.refused(draw(&raw const later.camera), SIZE, "does not know");
    // The call writes nothing beyond the struct that it knows.
    let mut out = Later { camera: zeroed(), more: [7; 4] };
    let (mut cameras, room) = (0, Room { views: 2, ..Room::default() });
    room.write(folder.path());
    let path = text(&folder.path().join("transforms.json"));
    out.camera.struct_size = size_of::<Later>() as u32;
    // SAFETY: all pointers are valid, and as long as they say.
    unsafe {
        context.ok(sgs_cameras_load(context.0, path.as_ptr(), &mut cameras));
        context.ok(sgs_cameras_get(context.0, cameras, 0, &raw mut out.camera));
    }
    assert_eq!((out.more, out.camera.struct_size as usize), ([7; 4], size_of::<Later>()));
}

#[test]
fn stale_and_foreign_handles_are_refused() {
    use SgsResult::SGS_ERROR_HANDLE as HANDLE;
    let folder = tempfile::tempdir().unwrap();
    let (one, two) = (Context::new(), Context::new());
    let path = scene(&folder);
    let (a, b) = (one.load(&path), two.load(&path));
    assert_ne!(a, b);
    let mut info = sized!(SgsSceneInfo {});
    // SAFETY: all pointers are valid.
    unsafe {
        one.refused(sgs_scene_get(one.0, b, &mut info), HANDLE, "of this context");
        one.refused(sgs_view_wait(one.0, a), HANDLE, "is that of a scene, not of a view");
        one.refused(sgs_recording_done(one.0, a), HANDLE, "not of a recording");
        assert_eq!(one.info().objects, 1);
        one.ok(sgs_destroy(one.0, a));
        one.refused(sgs_destroy(one.0, a), HANDLE, "belongs to no scene");
        assert_eq!(one.info().objects, 0);
        let again = one.load(&path);
        assert_ne!(again, a);
        one.refused(sgs_scene_get(one.0, a, &mut info), HANDLE, "belongs to no scene");
        two.ok(sgs_scene_get(two.0, b, &mut info));
        // A buffer that is too small returns the required length.
        let (mut needed, mut small) = (0, [0 as c_char; 4]);
        let result = sgs_last_error(one.0, small.as_mut_ptr(), small.len(), &mut needed);
        assert_eq!((result, needed), (SgsResult::SGS_ERROR_SPACE, one.error().len() + 1));
        assert_eq!(CStr::from_ptr(small.as_ptr()).to_bytes(), b"The");
    }
}

#[test]
fn invalid_values_are_refused() {
    use SgsResult::{SGS_ERROR_ARGUMENT as ARGUMENT, SGS_ERROR_FILE as FILE, SGS_ERROR_SPACE as SPACE};
    let folder = tempfile::tempdir().unwrap();
    let context = Context::new();
    let scene = context.load(&scene(&folder));
    let good = camera([4, 4]);
    let mut pixels = [0.0; 48];
    // SAFETY: all pointers are valid.
    unsafe {
        let mut draw = |change: &dyn Fn(&mut SgsCamera, &mut SgsRenderInfo), count: usize| {
            let (mut camera, mut info) = (good, sized!(SgsRenderInfo {}));
            change(&mut camera, &mut info);
            sgs_render(context.0, scene, &camera, &info, pixels.as_mut_ptr(), count)
        };
        context.ok(draw(&|_, _| {}, 48));
        context.refused(draw(&|_, _| {}, 47), SPACE, "takes 48 floats");
        context.refused(draw(&|_, i| i.layer = 4, 48), ARGUMENT, "no layer 4");
        context.refused(draw(&|c, _| c.width = 0, 48), ARGUMENT, "width");
        context.refused(draw(&|c, _| c.focal[1] = -1.0, 48), ARGUMENT, "focal");
        context.refused(draw(&|c, _| c.world_to_camera[7] = f32::NAN, 48), ARGUMENT, "not finite");
        context.refused(draw(&|c, _| c.world_to_camera = [0.0; 12], 48), ARGUMENT, "no rotation");
        let sheared = [1.0, 0.0, 0.0, 0.0, 0.6, 0.8, 0.0, 0.0, 0.0, 0.0, 1.0, 4.0];
        context.refused(draw(&|c, _| c.world_to_camera = sheared, 48), ARGUMENT, "no rotation");
        context.refused(draw(&|c, _| c.world_to_camera[3] = 3e38, 48), ARGUMENT, "beyond 1e15");
        context.refused(draw(&|c, _| c.center[0] = -1e16, 48), ARGUMENT, "beyond 1e15");
        context.refused(draw(&|c, _| c.focal[0] = 1e-40, 48), ARGUMENT, "below 1e-15");
        let mirror = [-1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 4.0];
        context.ok(draw(&|c, _| c.world_to_camera = mirror, 48));
        let mut view = 5;
        let shape = sized!(SgsViewInfo { width: 4, height: 4, format: 37, final_layout: 1 });
        let mut make = |change: &dyn Fn(&mut SgsViewInfo)| {
            let mut info = shape;
            change(&mut info);
            sgs_view_create(context.0, scene, &info, &mut view)
        };
        context.ok(make(&|_| {}));
        context.refused(make(&|i| i.format = 9), ARGUMENT, "format is 9");
        context.refused(make(&|i| i.layer = 77), ARGUMENT, "no layer 77");
        context.refused(make(&|i| i.encoding = 2), ARGUMENT, "no encoding 2");
        context.refused(make(&|i| i.final_layout = 0), ARGUMENT, "undefined");
        context.refused(make(&|i| i.initial_layout = 3), ARGUMENT, "initial_layout is 3");
        context.refused(make(&|i| (i.format, i.layer) = (43, 1)), ARGUMENT, "Depth cannot be shown");
        context.refused(make(&|i| i.width = 0), ARGUMENT, "0 x 4");
        context.refused(make(&|i| i.frames_in_flight = 1000), ARGUMENT, "at most 16");
        assert_eq!(view, 0);
        let mut handle = 0;
        let result = sgs_scene_load(context.0, c"/nowhere/x.ply".as_ptr(), &mut handle);
        context.refused(result, FILE, "/nowhere/x.ply");
        let result = sgs_scene_load(context.0, c"\xff\xfe".as_ptr(), &mut handle);
        context.refused(result, ARGUMENT, "UTF-8");
        let (mut made, info) = (null_mut(), sized!(SgsDeviceInfo { device: c"no such device".as_ptr() }));
        let mut why = [0 as c_char; 300];
        let result = sgs_context_open(&info, &mut made, why.as_mut_ptr(), why.len());
        assert_eq!(result, SgsResult::SGS_ERROR_DEVICE);
        assert!(CStr::from_ptr(why.as_ptr()).to_str().unwrap().contains("no such device"));
    }
}

#[test]
fn random_calls_return_error_codes() {
    let folder = tempfile::tempdir().unwrap();
    let context = Context::new();
    let path = scene(&folder);
    let good = text(&path);
    let mut r = Rng::new(77);
    let mut handles: Vec<u64> = vec![0, u64::MAX, 1, 1 << 24, context.load(&path)];
    let lit = folder.path().join("run");
    sgs_tests::runs::fabricate(&lit, sgs_tests::runs::Parts::NONE);
    let (mut relight, lit) = (0, text(&lit));
    // SAFETY: all pointers are valid.
    context.ok(unsafe { sgs_relight_open(context.0, lit.as_ptr(), null(), &mut relight) });
    handles.push(relight);
    let mut codes = std::collections::BTreeMap::<i32, u32>::new();
    let mut pixels = vec![0.0f32; 8 * 6 * 3];
    for _ in 0..1500 {
        let mut pick = |n: usize| (r.unit() * n as f64) as usize;
        let which = pick(24);
        let mut handle = handles[pick(handles.len())];
        if pick(8) == 0 {
            handle ^= 1 << pick(64);
        }
        let layer = [0, 1, 2, 3, 4, SGS_LAYER_SHADED, SGS_LAYER_METALLIC][pick(7)];
        let mut camera = camera([8, 6]);
        let mut render = sized!(SgsRenderInfo { layer: layer, sh_bands: pick(6) as u32 });
        let format = [37, 44, 97, 109, 43, 0][pick(6)];
        let mut view =
            sized!(SgsViewInfo { width: 8, height: 6, format: format, layer: layer, final_layout: pick(4) as u32 });
        match pick(12) {
            0 => camera.struct_size = pick(200) as u32,
            1 => render.struct_size = pick(100) as u32,
            2 => view.struct_size = pick(100) as u32,
            3 => camera.focal[0] = f32::NAN,
            4 => view.width = u32::MAX,
            5 => camera.width = 9,
            _ => {}
        }
        let path = [good.as_ptr(), lit.as_ptr(), c"/nowhere".as_ptr(), null(), c"".as_ptr()][pick(5)];
        let mut made = 0;
        let (mut count, mut status, mut report) = (0, sized!(SgsTrainStatus {}), sized!(SgsViewReport {}));
        let frame = sized!(SgsFrame { camera: if pick(3) == 0 { null() } else { &camera } });
        let mut light = sized!(SgsLight { on: 1, gain: pick(3) as f32 - 1.0 });
        let room = pick(2 * pixels.len());
        let c = context.0;
        // SAFETY: pointers are null or valid; numbers stand for invalid handles. Frames have no image, so no object of
        // a host is used.
        let result = unsafe {
            match which {
                0 => sgs_scene_load(c, path, &mut made),
                1 | 2 => sgs_render(c, handle, &camera, &render, pixels.as_mut_ptr(), room.min(pixels.len())),
                3 => sgs_cameras_load(c, path, &mut made),
                4 => sgs_cameras_count(c, handle, &mut count),
                5 => sgs_cameras_get(c, handle, 0, &mut camera),
                6 => sgs_view_create(c, handle, &view, &mut made),
                7 => sgs_view_record(c, handle, &frame, null_mut(), &mut made),
                8 => sgs_view_submit(c, handle, &frame, null(), 0, null(), 0),
                9 => sgs_view_wait(c, handle),
                10 => sgs_view_report(c, handle, &mut report),
                11 => sgs_recording_done(c, handle),
                12 => sgs_recording_timeline(c, handle, 0, 1),
                13 => sgs_train_step(c, handle, 0.0, &mut status),
                14 => sgs_trainer_save(c, handle, path),
                15 => sgs_trainer_scene(c, handle, &mut made),
                16 => sgs_scene_export(c, handle, c"/nowhere/out.ply".as_ptr()),
                17 => sgs_relight_open(c, path, null(), &mut made),
                18 => sgs_relight_view_create(c, handle, &view, &mut made),
                19 => sgs_relight_light_get(c, handle, layer, &mut light),
                20 => sgs_relight_light_set(c, handle, layer, &light),
                21 => sgs_relight_light_remove(c, handle, layer),
                22 => sgs_relight_edit(c, handle, c"{}".as_ptr(), path),
                _ => sgs_destroy(c, handle),
            }
        };
        *codes.entry(result as i32).or_default() += 1;
        assert_ne!(result, SgsResult::SGS_ERROR_INTERNAL, "{}", context.error());
        assert!(result == SgsResult::SGS_OK || made == 0, "a failure has made {made:#x}");
        if made != 0 {
            handles.push(made);
        }
        if handles.len() > 40 {
            // The oldest handles may be stale already.
            let old = handles.remove(5);
            // SAFETY: the handle is only a number.
            unsafe { sgs_destroy(c, old) };
            handles[2] = old;
        }
    }
    // The random calls must cover results of every kind.
    for code in [0, -1, -2, -3, -4, -5] {
        assert!(codes.contains_key(&code), "{code} never came: {codes:?}");
    }
    context.load(&path);
}
