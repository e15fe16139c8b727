//! Shaded views in a host's image, under lights that change between frames.

use ash::vk;
use sgs_config::VisibilityKind;
use sgs_embedding::{Host, Owned};
use sgs_engine::exec::Recording;
use sgs_engine::graph::ImageState;
use sgs_engine::{Device, DeviceImage, ImageFormat};
use sgs_passes::Tuning;
use sgs_passes::pipeline::{Camera, LitFrame, LitLayer, LitOptions, LitView, ShadedScene, ViewError};
use sgs_passes::splat::{Encoding, TexelFormat};
use sgs_relight::{Edit, LightParameters, NewEmitter, NewLight, Relighter, Relit};
use sgs_run::{ShadedView, Shading};
use sgs_tests::emitting::{EMITTERS, fabricate_emitting};
use sgs_tests::rooms::Room;
use sgs_tests::runs::{self, Parts};
use sgs_tests::scenes;
use std::path::Path;
use vk::ImageLayout as L;

const SIZE: [u32; 2] = [48, 36];
const PIXELS: usize = 48 * 36;
const BEHIND: [f32; 3] = [0.3, 0.1, 0.6];

/// Host with one image, and the contents of that image.
struct Stage {
    // Dropped before the host, even if a test fails.
    target: Option<DeviceImage>,
    device: Device,
    host: Host,
    image: Owned<vk::Image>,
    back: Owned<vk::Buffer>,
    bytes: u64,
    camera: Camera,
}

impl Stage {
    fn new() -> Stage {
        Stage::of(vk::Format::R32G32B32A32_SFLOAT, ImageFormat::Rgba32Float, 16)
    }

    fn of(raw: vk::Format, format: ImageFormat, texel: u64) -> Stage {
        let host = Host::new();
        let device = host.adopt();
        let (image, bytes) = (host.image(SIZE, raw), texel * PIXELS as u64);
        let back = host.buffer(bytes);
        // SAFETY: the host made the image with this size and format, and destroys it after the engine.
        let target = unsafe { device.wrap_image("window", image.raw, SIZE, format, false) }.unwrap();
        let camera = scenes::gpu_camera(&scenes::camera(SIZE));
        Stage { host, device, image, back, target: Some(target), bytes, camera }
    }

    fn view(&self, relighter: &Relighter, options: LitOptions) -> Result<LitView, ViewError> {
        let tuning = Tuning::for_device(self.device.info());
        LitView::new(&self.device, tuning, relighter.scene(), relighter.lighting(), options)
    }

    fn record(&self, view: &mut LitView, r: &Relighter, exposure: f32) -> (vk::CommandBuffer, Recording) {
        let commands = self.host.begin();
        self.host.transition(commands, self.image.raw, L::UNDEFINED, L::TRANSFER_DST_OPTIMAL);
        self.host.clear(commands, self.image.raw, [9.0, 0.0, 9.0, 1.0]);
        let frame = LitFrame { camera: self.camera, background: BEHIND, exposure };
        let target = self.target.as_ref().unwrap();
        let recorded = view.frame(r.scene(), r.lighting(), target, &frame, |exec, uniforms| {
            // SAFETY: the commands are being recorded here and submitted once; the image is in the entry's layout.
            unsafe { exec.record_into(commands, uniforms) }
        });
        self.host.read_image(commands, self.image.raw, SIZE, self.back.raw);
        (commands, recorded.unwrap())
    }

    fn finish(&self, frame: (vk::CommandBuffer, Recording)) -> Vec<[f32; 4]> {
        bytemuck::pod_collect_to_vec::<u8, [f32; 4]>(&self.raw(frame))
    }

    fn raw(&self, (commands, recorded): (vk::CommandBuffer, Recording)) -> Vec<u8> {
        let fence = self.host.fence();
        self.host.submit(commands, &[], &[], fence);
        // SAFETY: the fence is alive, covers the submission and is waited for before it is destroyed.
        unsafe {
            self.host.device.wait_for_fences(&[fence], true, u64::MAX).unwrap();
            recorded.release();
            self.host.device.destroy_fence(fence, None);
        }
        self.host.read(&self.back, self.bytes)
    }

    /// Records frames in the host's commands until a frame has enough capacity.
    fn show(&self, view: &mut LitView, r: &Relighter, exposure: f32) -> Vec<[f32; 4]> {
        loop {
            let before = view.report().unwrap().incomplete;
            let texels = self.finish(self.record(view, r, exposure));
            if view.report().unwrap().incomplete == before {
                return texels;
            }
        }
    }

    fn relighter(&self, folder: &Path, parts: Parts) -> Relighter {
        runs::fabricate(folder, parts);
        Relighter::open(&self.device, folder, 0).unwrap()
    }

    fn done(mut self) {
        self.target = None;
        drop(self.device);
        self.host.destroy_buffer(self.back);
        self.host.destroy_image(self.image);
    }
}

fn options(layer: LitLayer) -> LitOptions {
    LitOptions {
        size: SIZE,
        layer,
        format: TexelFormat::Rgba32Float,
        encoding: Encoding::Linear,
        entry: ImageState::TransferTarget,
        exit: ImageState::TransferSource,
        frames_in_flight: 2,
        capacity: [0, 0],
    }
}

/// Renders the layer as `sgs relight` does.
fn expected(device: &Device, r: &Relighter, layer: LitLayer) -> Vec<[f32; 3]> {
    of_relit(device, &r.relit(), layer)
}

fn of_relit(device: &Device, relit: &Relit, layer: LitLayer) -> Vec<[f32; 3]> {
    of_scene(device, relit.upload(device).unwrap(), &scenes::gpu_camera(&scenes::camera(SIZE)), layer)
}

fn of_scene(device: &Device, scene: ShadedScene, camera: &Camera, layer: LitLayer) -> Vec<[f32; 3]> {
    let view: ShadedView = Shading::new(device, scene).unwrap().shade_from(camera).unwrap();
    let behind = BEHIND.map(sgs_scene::linear_to_srgb);
    let image = match layer {
        LitLayer::Shaded => view.radiance(behind),
        LitLayer::Albedo => view.albedo(),
        LitLayer::Roughness => view.roughness(),
        LitLayer::Metallic => view.metallic(),
        LitLayer::Diffuse => view.diffuse(),
        LitLayer::Specular => view.specular(),
        LitLayer::Visibility => view.visibility().unwrap(),
        LitLayer::Environment => view.environment_map(),
        LitLayer::Direct => view.direct(),
    };
    let c = image.channels as usize;
    image.data.chunks(c).map(|p| [0, 1, 2].map(|k| p[k % c])).collect()
}

/// Returns the largest difference, relative to the largest value.
fn apart(a: &[[f32; 4]], b: &[[f32; 3]]) -> f32 {
    assert_eq!((a.len(), b.len()), (PIXELS, PIXELS));
    let largest = b.iter().flatten().fold(0.0f32, |m, v| m.max(v.abs()));
    assert!(largest > 0.0, "the image is black");
    let off = a.iter().zip(b).flat_map(|(x, y)| (0..3).map(|k| (x[k] - y[k]).abs()));
    off.fold(0.0f32, |m, v| if v > m || v.is_nan() { v } else { m }) / largest
}

fn thirds(a: &[[f32; 4]]) -> Vec<[f32; 3]> {
    a.iter().map(|t| [t[0], t[1], t[2]]).collect()
}

fn changed_light(r: &Relighter, light: usize, change: impl FnOnce(&mut LightParameters)) -> LightParameters {
    let mut changed = r.light(light).unwrap();
    change(&mut changed);
    changed
}

#[test]
fn every_layer_matches_sgs_relight() {
    let folder = tempfile::tempdir().unwrap();
    let stage = Stage::new();
    let shadows = |visibility| Parts { visibility, ..Parts::ALL };
    let all = [Parts::ALL, Parts::NONE, shadows(VisibilityKind::None), shadows(VisibilityKind::Traced)];
    for (i, parts) in all.into_iter().enumerate() {
        let mut r = stage.relighter(&folder.path().join(i.to_string()), parts);
        for layer in LitLayer::ALL {
            let has = match layer {
                LitLayer::Metallic => parts.metallic,
                LitLayer::Visibility => parts.visibility != VisibilityKind::None,
                LitLayer::Environment => parts.environment,
                _ => true,
            };
            let made = stage.view(&r, options(layer));
            if !has && layer != LitLayer::Environment {
                assert!(made.is_err_and(|e| e.to_string().contains(layer.name())));
                continue;
            }
            let mut view = made.unwrap();
            if !has {
                assert!(stage.show(&mut view, &r, 1.0).iter().all(|t| t[..3] == [0.0; 3]));
                continue;
            }
            let off = apart(&stage.show(&mut view, &r, 1.0), &expected(&stage.device, &r, layer));
            assert!(off < 1e-5, "{parts:?} {layer:?}: {off}");
        }
        // The layers must also match after changes of every kind.
        let changed = changed_light(&r, 0, |l| (l.position, l.color) = ([0.1, -0.6, 0.3], [0.2, 1.0, 3.0]));
        r.set_light(0, changed).unwrap();
        r.set_light(2, changed_light(&r, 2, |l| l.on = true)).unwrap();
        r.remove_light(1).unwrap();
        let new = NewLight { position: Some([0.3, 0.4, 0.2]), intensity: Some([0.5, 1.0, 0.2]), ..Default::default() };
        assert_eq!(r.add_light(&new).unwrap(), runs::LIGHTS - 1);
        r.set_environment(&runs::map(64, 9), [64, 32]).unwrap();
        r.set_environment_gain([0.5, 1.0, 2.0]).unwrap();
        for layer in [LitLayer::Shaded, LitLayer::Specular, LitLayer::Environment] {
            let mut view = stage.view(&r, options(layer)).unwrap();
            let off = apart(&stage.show(&mut view, &r, 1.0), &expected(&stage.device, &r, layer));
            assert!(off < 1e-5, "changed {parts:?} {layer:?}: {off}");
        }
    }
    stage.done();
}

#[test]
fn light_changes_need_no_new_plan_and_no_memory() {
    let folder = tempfile::tempdir().unwrap();
    let stage = Stage::new();
    let mut r = stage.relighter(folder.path(), Parts::ALL);
    let mut view = stage.view(&r, options(LitLayer::Shaded)).unwrap();
    let all = stage.show(&mut view, &r, 1.0);
    let (plans, memory, activity) = (view.plans(), stage.device.memory_use(), stage.device.activity());
    // Light is additive: the image without a light plus the image of that light alone is the whole image.
    r.set_light(3, changed_light(&r, 3, |l| l.on = false)).unwrap();
    let without = stage.show(&mut view, &r, 1.0);
    for light in [0, 1] {
        r.set_light(light, changed_light(&r, light, |l| l.on = false)).unwrap();
    }
    r.set_light(3, changed_light(&r, 3, |l| l.on = true)).unwrap();
    r.set_environment_gain([0.0; 3]).unwrap();
    let alone = stage.show(&mut view, &r, 1.0);
    // Both images contain the background.
    let behind: Vec<[f32; 3]> = alone.iter().map(|t| BEHIND.map(|b| b * (1.0 - t[3]))).collect();
    let sum: Vec<[f32; 3]> =
        (0..PIXELS).map(|p| [0, 1, 2].map(|k| without[p][k] + alone[p][k] - behind[p][k])).collect();
    let off = apart(&all, &sum);
    assert!(off < 1e-3, "{off}"); // Pixels of low coverage have no surface and show all of the background.
    let lit: f32 = (0..PIXELS).map(|p| alone[p][1] - behind[p][1]).sum();
    assert!(lit > 1.0 && apart(&all, &thirds(&without)) > 0.01, "light 3 does nothing: {lit}");
    // Gain and exposure scale the light; a move changes it in another way.
    r.set_light(3, changed_light(&r, 3, |l| l.gain *= 3.0)).unwrap();
    let (tripled, exposed) = (stage.show(&mut view, &r, 1.0), stage.show(&mut view, &r, 2.0));
    let of = |a: &[[f32; 4]]| -> f32 { (0..PIXELS).map(|p| a[p][1] - behind[p][1]).sum() };
    assert!((of(&tripled) / lit - 3.0).abs() < 1e-2 && (of(&exposed) / lit - 6.0).abs() < 1e-2);
    r.set_light(3, changed_light(&r, 3, |l| l.position[0] += 0.7)).unwrap();
    assert!(apart(&stage.show(&mut view, &r, 1.0), &thirds(&tripled)) > 0.01);
    // Additions and removals within the capacity, and an edit of lights.
    let new = NewLight { position: Some([0.0; 3]), intensity: Some([1.0; 3]), ..Default::default() };
    r.add_light(&new).unwrap();
    stage.show(&mut view, &r, 1.0);
    r.remove_light(0).unwrap();
    stage.show(&mut view, &r, 1.0);
    r.edit(
        &Edit::parse(r#"{"lights": {"only": [1], "change": [{"light": 1, "by": [0, 1, 0]}]}}"#, Path::new("")).unwrap(),
    )
    .unwrap();
    let edited = stage.show(&mut view, &r, 1.0);
    let as_edited = r.relit();
    r.reset().unwrap();
    assert!(apart(&stage.show(&mut view, &r, 1.0), &thirds(&all)) == 0.0);
    let now = stage.device.activity();
    assert_eq!((now.made, now.uploads), (activity.made, activity.uploads));
    assert_eq!((view.plans(), stage.device.memory_use()), (plans, memory));
    assert!(apart(&edited, &of_relit(&stage.device, &as_edited, LitLayer::Shaded)) < 1e-5);
    // Beyond the capacity, the view compiles a new plan and shows the correct image.
    for _ in 0..17 {
        r.add_light(&new).unwrap();
    }
    let off = apart(&stage.show(&mut view, &r, 1.0), &expected(&stage.device, &r, LitLayer::Shaded));
    assert!(off < 1e-5 && view.plans() == plans + 1, "{off} {}", view.plans());
    drop((view, r));
    stage.done();
}

#[test]
fn recorded_frames_keep_their_lights_and_capacity_grows() {
    let folder = tempfile::tempdir().unwrap();
    let stage = Stage::new();
    let mut r = stage.relighter(folder.path(), Parts { visibility: VisibilityKind::None, ..Parts::ALL });
    for capacity in [[300, 0], [0, 300]] {
        let mut view = stage.view(&r, LitOptions { capacity, ..options(LitLayer::Shaded) }).unwrap();
        let first = stage.finish(stage.record(&mut view, &r, 1.0));
        assert!(first.iter().all(|t| *t == [BEHIND[0], BEHIND[1], BEHIND[2], 0.0]), "{:?}", first[500]);
        let off = apart(&stage.show(&mut view, &r, 1.0), &expected(&stage.device, &r, LitLayer::Shaded));
        assert!(off < 1e-5, "{off}");
        let report = view.report().unwrap();
        assert!(report.incomplete >= 1 && view.plans() >= 2, "{report:?}");
    }
    let mut view = stage.view(&r, options(LitLayer::Shaded)).unwrap();
    let before = stage.show(&mut view, &r, 1.0);
    let recorded = stage.record(&mut view, &r, 1.0);
    r.set_light(0, changed_light(&r, 0, |l| l.on = false)).unwrap();
    r.set_environment(&runs::map(32, 77), [32, 16]).unwrap();
    assert!(apart(&stage.finish(recorded), &thirds(&before)) == 0.0);
    assert!(apart(&stage.show(&mut view, &r, 1.0), &thirds(&before)) > 0.01);
    // Materials and insertions replace memory and Gaussians.
    let guest = folder.path().join("guest.ply");
    runs::with_materials(30, false, 4).write_ply(&guest).unwrap();
    for edit in [
        r#"{"materials": [{"where": {"box": [[-9, -9, -9], [9, 9, 9]]}, "set": {"albedo": [0.1, 0.9, 0.1]}}]}"#,
        r#"{"insert": [{"source": "guest.ply", "translation": [0, 0, -0.4]}], "environment": {"off": true}}"#,
    ] {
        let recorded = stage.record(&mut view, &r, 1.0);
        let earlier = stage.show(&mut view, &r, 1.0);
        r.edit(&Edit::parse(edit, folder.path()).unwrap()).unwrap();
        assert!(apart(&stage.finish(recorded), &thirds(&earlier)) == 0.0);
        let displayed = stage.show(&mut view, &r, 1.0);
        let off = apart(&displayed, &expected(&stage.device, &r, LitLayer::Shaded));
        assert!(off < 1e-5 && apart(&displayed, &thirds(&earlier)) > 0.01, "{off}");
    }
    drop((view, r));
    stage.done();
}

#[test]
fn radiance_is_encoded_for_the_format_of_the_image() {
    let folder = tempfile::tempdir().unwrap();
    let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as i32;
    let encoded = |v: f32| byte(sgs_scene::linear_to_srgb(v.clamp(0.0, 1.0)));
    for (raw, format, encoding, encode) in [
        (vk::Format::R8G8B8A8_UNORM, TexelFormat::Rgba8Unorm, Encoding::Display, &encoded as &dyn Fn(f32) -> i32),
        (vk::Format::R8G8B8A8_UNORM, TexelFormat::Rgba8Unorm, Encoding::Linear, &byte),
        (vk::Format::B8G8R8A8_SRGB, TexelFormat::Bgra8Srgb, Encoding::Linear, &encoded),
    ] {
        let stage = Stage::of(raw, format.into(), 4);
        let r = stage.relighter(folder.path(), Parts::ALL);
        for layer in [LitLayer::Shaded, LitLayer::Albedo, LitLayer::Roughness] {
            let made = stage.view(&r, LitOptions { format, encoding, ..options(layer) });
            if format.srgb() && layer.is_value() {
                assert!(matches!(made, Err(ViewError::SrgbValues { what: "roughness", .. })));
                continue;
            }
            let mut view = made.unwrap();
            stage.raw(stage.record(&mut view, &r, 1.0)); // Measures the capacity that the view needs.
            let texels = stage.raw(stage.record(&mut view, &r, 1.0));
            let swapped = format == TexelFormat::Bgra8Srgb;
            for (texel, light) in texels.chunks(4).zip(expected(&stage.device, &r, layer)) {
                for k in 0..3 {
                    let want = if layer.is_value() { byte(light[k]) } else { encode(light[k]) };
                    let got = i32::from(texel[if swapped { 2 - k } else { k }]);
                    assert!((got - want).abs() <= 1, "{format:?} {layer:?}: {got} {want}");
                }
            }
        }
        drop(r);
        stage.done();
    }
}

#[test]
fn submitted_frames_match_sgs_relight() {
    let folder = tempfile::tempdir().unwrap();
    let stage = Stage::new();
    let mut r = stage.relighter(folder.path(), Parts::ALL);
    let mut view = stage.view(&r, LitOptions { entry: ImageState::Undefined, ..options(LitLayer::Shaded) }).unwrap();
    for on in [true, false, true] {
        r.set_light(1, changed_light(&r, 1, |l| l.on = on)).unwrap();
        let camera = scenes::gpu_camera(&scenes::camera(SIZE));
        let frame = LitFrame { camera, background: BEHIND, exposure: 1.0 };
        let target = stage.target.as_ref().unwrap();
        // The first frame measures the capacity that it needs.
        for _ in 0..2 {
            view.frame(r.scene(), r.lighting(), target, &frame, |exec, uniforms| exec.submit(uniforms)).unwrap();
            view.finish().unwrap();
        }
        let commands = stage.host.begin();
        stage.host.read_image(commands, stage.image.raw, SIZE, stage.back.raw);
        let fence = stage.host.fence();
        stage.host.submit(commands, &[], &[], fence);
        stage.host.wait(fence);
        let texels = bytemuck::pod_collect_to_vec::<u8, [f32; 4]>(&stage.host.read(&stage.back, stage.bytes));
        let off = apart(&texels, &expected(&stage.device, &r, LitLayer::Shaded));
        assert!(off < 1e-5, "{off}");
    }
    drop((view, r));
    stage.done();
}

#[test]
fn emitters_match_shading_and_need_no_plan() {
    let folder = tempfile::tempdir().unwrap();
    fabricate_emitting(folder.path());
    let mut stage = Stage::new();
    stage.camera = sgs_run::camera(&Room::default().cameras()[1].scaled(SIZE[0], SIZE[1]));
    let mut r = Relighter::open(&stage.device, &folder.path().join("run"), 0).unwrap();
    assert!(r.has_emitters());
    let names: Vec<&str> = (0..r.lights()).map(|i| r.emitter(i).unwrap().name.as_str()).collect();
    assert_eq!(names, EMITTERS);
    for layer in [LitLayer::Shaded, LitLayer::Albedo, LitLayer::Diffuse, LitLayer::Specular, LitLayer::Direct] {
        let mut view = stage.view(&r, options(layer)).unwrap();
        let expected = |r: &Relighter| of_scene(&stage.device, r.shaded().unwrap(), &stage.camera, layer);
        let all = stage.show(&mut view, &r, 1.0);
        let (plans, memory, activity) = (view.plans(), stage.device.memory_use(), stage.device.activity());
        r.set_light(0, changed_light(&r, 0, |l| (l.gain, l.color) = (0.5, [1.0, 0.5, 0.0]))).unwrap();
        r.set_light(1, changed_light(&r, 1, |l| l.on = false)).unwrap();
        r.set_light(2, changed_light(&r, 2, |l| l.on = true)).unwrap();
        let changed = stage.show(&mut view, &r, 1.0);
        let now = stage.device.activity();
        assert_eq!((now.made, now.uploads), (activity.made, activity.uploads));
        assert_eq!((view.plans(), stage.device.memory_use()), (plans, memory));
        let off = apart(&changed, &expected(&r));
        assert!(off < 1e-5, "changed {layer:?}: {off}");
        r.reset().unwrap();
        let off = apart(&all, &expected(&r));
        assert!(off < 1e-5, "{layer:?}: {off}");
        assert!(apart(&all, &thirds(&changed)) > 0.01 || layer == LitLayer::Albedo);
        drop(view);
    }
    // The image without each emitter plus the image of that emitter alone is the whole image.
    let mut view = stage.view(&r, LitOptions { capacity: [1 << 14; 2], ..options(LitLayer::Shaded) }).unwrap();
    let all = stage.show(&mut view, &r, 1.0);
    let mut sum = vec![[0.0; 3]; PIXELS];
    for lit in [0, 1] {
        for light in [0, 1] {
            r.set_light(light, changed_light(&r, light, |l| l.on = light == lit)).unwrap();
        }
        let alone = stage.show(&mut view, &r, 1.0);
        // The second image brings the background, too.
        let behind = |t: &[f32; 4], k: usize| if lit == 0 { BEHIND[k] * (1.0 - t[3]) } else { 0.0 };
        sum.iter_mut().zip(&alone).for_each(|(s, t)| (0..3).for_each(|k| s[k] += t[k] - behind(t, k)));
    }
    let off = apart(&all, &sum);
    assert!(off < 1e-5, "{off}");
    let parse = |text: &str| Edit::parse(text, Path::new("")).unwrap();
    // A moved emitter needs neither memory nor a plan. Its bounces are those of an edit.
    r.reset().unwrap();
    stage.show(&mut view, &r, 1.0);
    let (plans, memory, activity) = (view.plans(), stage.device.memory_use(), stage.device.activity());
    assert!(!r.update().unwrap());
    r.set_light(1, changed_light(&r, 1, |l| l.position[1] += 0.2)).unwrap();
    let direct = stage.show(&mut view, &r, 1.0);
    assert!(r.update().unwrap() && !r.update().unwrap());
    let dragged = stage.show(&mut view, &r, 1.0);
    assert_eq!((view.plans(), stage.device.memory_use()), (plans, memory));
    assert_eq!(stage.device.activity().made, activity.made);
    assert!(apart(&all, &thirds(&direct)) > 0.01 && apart(&direct, &thirds(&dragged)) > 1e-4);
    let shaded = of_scene(&stage.device, r.shaded().unwrap(), &stage.camera, LitLayer::Shaded);
    assert!(apart(&dragged, &shaded) < 1e-5);
    r.reset().unwrap();
    assert!(r.update().unwrap());
    let off = apart(&stage.show(&mut view, &r, 1.0), &thirds(&all));
    assert!(off < 1e-5, "{off}");
    r.edit(&parse(r#"{"emitters": {"change": [{"emitter": "light 1", "by": [0, 0.2, 0]}]}}"#)).unwrap();
    let off = apart(&stage.show(&mut view, &r, 1.0), &thirds(&dragged));
    assert!(off < 1e-5, "{off}");
    // An edit that moves an emitter computes all responses again.
    r.edit(&parse(r#"{"emitters": {"only": ["light 1"], "change": [{"emitter": "light 1", "by": [0, 0.2, 0]}]}}"#))
        .unwrap();
    let moved = stage.show(&mut view, &r, 1.0);
    assert!(apart(&all, &thirds(&moved)) > 0.01);
    // Lights of the published model replace the emitters, and the other way round.
    r.edit(&parse(r#"{"lights": {"add": [{"position": [0, 0, 0], "intensity": [1, 1, 1]}]}}"#)).unwrap();
    assert!(!r.has_emitters() && r.lights() == 1);
    let published = stage.show(&mut view, &r, 1.0);
    let shaded = |r: &Relighter| of_scene(&stage.device, r.shaded().unwrap(), &stage.camera, LitLayer::Shaded);
    assert!(apart(&published, &thirds(&all)) > 0.01 && apart(&published, &shaded(&r)) < 1e-5);
    r.reset().unwrap();
    assert!(apart(&stage.show(&mut view, &r, 1.0), &thirds(&all)) == 0.0);
    // A removed emitter and one in its place need neither memory nor a plan. One more needs both.
    let (plans, memory) = (view.plans(), stage.device.memory_use());
    let bulb = r.emitter(1).unwrap().clone();
    r.remove_light(1).unwrap();
    assert!(apart(&all, &thirds(&stage.show(&mut view, &r, 1.0))) > 0.01);
    let new = NewEmitter { name: None, shape: bulb.shape, color: bulb.color };
    assert_eq!(r.add_emitter(&new).unwrap(), 2);
    assert!(r.update().unwrap() && !r.update().unwrap());
    assert!(apart(&stage.show(&mut view, &r, 1.0), &thirds(&all)) < 1e-5);
    assert_eq!((view.plans(), stage.device.memory_use()), (plans, memory));
    assert_eq!((r.add_emitter(&new).unwrap(), r.update().unwrap()), (3, false));
    assert!(apart(&stage.show(&mut view, &r, 1.0), &shaded(&r)) < 1e-5 && view.plans() == plans + 1);
    r.reset().unwrap();
    for refused in [
        r.add_light(&NewLight::default()).map(drop),
        r.remove_light(3),
        r.set_environment_gain([1.0; 3]),
        r.set_light(0, changed_light(&r, 0, |l| l.position[0] = f32::NAN)),
        r.set_light(3, changed_light(&r, 0, |_| {})),
        r.edit(&parse(r#"{"emitters": {"off": true}, "lights": {"off": true}}"#)),
    ] {
        assert!(refused.is_err());
    }
    drop((view, r));
    stage.done();
}
