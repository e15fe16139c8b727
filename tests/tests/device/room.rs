//! Bounced light of a room of Gaussians: bounds, linearity, and lights that are found again.

use glam::{DMat3, DVec3, Vec3};
use sgs_engine::Device;
use sgs_passes::pipeline::{FrameEmitter, ShadedTransport};
use sgs_passes::transport::{AreaLight, LightShape, Sky, SolveOptions};
use sgs_run::{OpeningRow, Shading, Visibility, shaded_scene};
use sgs_scene::{Camera, Image, NEAR, Splats, linear_to_srgb};
use sgs_tests::Gpu;
use sgs_transport::{Bounces, Explained, Room, RoomOptions, SeenViews};

/// Half the side lengths of the room.
const HALF: Vec3 = Vec3::new(2.0, 1.5, 2.5);
/// Columns and rows of a view.
const SIZE: [u32; 2] = [48, 36];
/// Linear albedo of the walls: low x, high x, low y, high y, low z, high z.
const ALBEDO: [[f32; 3]; 6] = [[0.6, 0.2, 0.2], [0.2, 0.6, 0.2], [0.5; 3], [0.7; 3], [0.3, 0.4, 0.6], [0.6, 0.5, 0.3]];
/// Bulb under the ceiling. No Gaussian stands for it.
const BULB: AreaLight =
    AreaLight { shape: LightShape::Sphere { center: [0.5, 1.0, 0.25], radius: 0.1 }, color: [40.0, 30.0, 20.0] };

/// Returns the inside of a box as flat Gaussians with materials.
fn walls() -> Splats {
    sgs_tests::emitting::walls(HALF, &ALBEDO)
}

/// Returns cameras in the room, all around.
fn cameras() -> Vec<Camera> {
    let views = 10;
    let camera = |i: usize| {
        let turn = std::f64::consts::TAU * i as f64 / views as f64;
        let place = DVec3::new(-0.9 * turn.cos(), 0.3 * (3.0 * turn).sin(), -1.2 * turn.sin());
        let tilt = if i.is_multiple_of(2) { 0.45 } else { -0.45 };
        let forward = DVec3::new(turn.cos(), tilt, turn.sin()).normalize();
        let right = DVec3::Y.cross(forward).normalize();
        let rotation = DMat3::from_cols(right, forward.cross(right), forward).transpose();
        let [width, height] = SIZE;
        Camera {
            name: format!("{i:03}"),
            width,
            height,
            fx: 0.5 * f64::from(width),
            fy: 0.5 * f64::from(width),
            cx: 0.5 * f64::from(width),
            cy: 0.5 * f64::from(height),
            rotation,
            translation: -(rotation * place),
            near: NEAR,
        }
    };
    (0..views).map(camera).collect()
}

/// Room with the Gaussians and views of which it was built.
struct Lit {
    device: Device,
    splats: Splats,
    cameras: Vec<Camera>,
    room: Room,
    views: SeenViews,
}

impl Lit {
    fn new(gpu: &Gpu) -> Lit {
        Lit::of(gpu, walls())
    }

    fn of(gpu: &Gpu, splats: Splats) -> Lit {
        let (device, cameras) = (gpu.device().clone(), cameras());
        let options = RoomOptions { surfels: 512, ..RoomOptions::default() };
        let (room, views) = Room::new(&device, &splats, &cameras, options).unwrap();
        Lit { device, splats, cameras, room, views }
    }

    /// Returns the direct, the bounced and the emitted radiance of all views.
    fn radiance(&self, lights: &[AreaLight], bounces: Bounces) -> [Vec<f32>; 3] {
        let dark = vec![[0.0; 3]; self.splats.len()];
        self.radiance_of(self.room.light(lights, &dark, bounces).unwrap())
    }

    fn radiance_of(&self, transport: ShadedTransport) -> [Vec<f32>; 3] {
        let mut scene = shaded_scene(&self.device, &self.splats, None, None, &Visibility::None).unwrap();
        scene.transport = Some(transport);
        let mut shading = Shading::new(&self.device, scene).unwrap().without_visibility();
        let mut terms = [Vec::new(), Vec::new(), Vec::new()];
        for camera in &self.cameras {
            let view = shading.shade(camera).unwrap().0;
            terms.iter_mut().zip([view.direct, view.indirect, view.emission]).for_each(|(all, term)| all.extend(term));
        }
        terms
    }

    /// Finds the emitters in photographs of the room under lights.
    fn explain(&self, lights: &[AreaLight]) -> Explained {
        let photographs = self.photographs(lights);
        self.room.explain(&self.views, &photographs, &self.splats, None).unwrap()
    }

    /// Fits emitters of known shapes to photographs of the room under lights.
    fn fit(&self, lights: &[AreaLight], known: &[LightShape]) -> Explained {
        let photographs = self.photographs(lights);
        self.room.explain(&self.views, &photographs, &self.splats, Some(known)).unwrap()
    }

    /// Returns photographs of the room under lights.
    fn photographs(&self, lights: &[AreaLight]) -> Vec<Image> {
        let [direct, indirect, _] = self.radiance(lights, Bounces::All);
        let value = |i: usize| linear_to_srgb((direct[i] + indirect[i]).clamp(0.0, 1.0));
        let values: Vec<f32> = (0..direct.len()).map(value).collect();
        let [width, height] = SIZE;
        let image = |data: &[f32]| Image { width, height, channels: 3, data: data.to_vec() };
        values.chunks_exact(3 * (width * height) as usize).map(image).collect()
    }
}

fn center(light: &AreaLight) -> Vec3 {
    let LightShape::Sphere { center, .. } = light.shape else { panic!("{light:?} is no sphere") };
    center.into()
}

fn sum(values: &[f32]) -> f64 {
    values.iter().copied().map(f64::from).sum()
}

#[test]
fn bounces_add_light_and_light_is_linear() {
    let gpu = Gpu::new();
    let lit = Lit::new(&gpu);
    let surfels = lit.room.surfels();
    assert!((100..=512).contains(&surfels), "{surfels}");
    let [none, one, all] = [Bounces::None, Bounces::One, Bounces::All].map(|b| lit.radiance(&[BULB], b));
    for terms in [&none, &one, &all] {
        assert!(terms.iter().flatten().all(|v| v.is_finite() && *v >= 0.0));
        assert!(terms[0] == none[0], "bounces leave direct light as it is");
        assert!(terms[2].iter().all(|v| *v == 0.0), "the walls emit nothing");
    }
    assert!(sum(&none[0]) > 0.0, "the bulb lights the walls");
    assert!(none[1].iter().all(|v| *v == 0.0));
    // Each bounce adds light to each pixel.
    assert!(one[1].iter().zip(&all[1]).all(|(one, all)| *all >= *one * (1.0 - 1e-5)));
    assert!(sum(&one[1]) > 0.1 * sum(&none[0]) && sum(&all[1]) > 1.2 * sum(&one[1]));
    let twice = lit.radiance(&[AreaLight { color: BULB.color.map(|v| 2.0 * v), ..BULB }], Bounces::All);
    let close = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| (a - 2.0 * b).abs() <= 1e-4 * a.abs() + 1e-7);
    assert!(close(&twice[0], &all[0]) && close(&twice[1], &all[1]));
    let unlit = lit.radiance(&[], Bounces::All);
    assert!(unlit.iter().flatten().all(|v| *v == 0.0));
}

/// More emitters than one solve takes, some of them off.
#[test]
fn responses_of_emitters_add_up_to_one_solve() {
    let gpu = Gpu::new();
    let lit = Lit::new(&gpu);
    let light = |i: usize| {
        let center = [0.15 * i as f32 - 1.4, 0.9, 0.1 * (i % 7) as f32];
        let color = if i % 4 == 1 { [0.0; 3] } else { [10.0, i as f32, 20.0 - i as f32] };
        AreaLight { shape: LightShape::Sphere { center, radius: 0.1 }, color }
    };
    let lights: Vec<AreaLight> = (0..19).map(light).collect();
    let expected = lit.radiance(&lights, Bounces::All);
    let frame: Vec<FrameEmitter> = lights.iter().map(|light| FrameEmitter::of(*light)).collect();
    let mut scene = shaded_scene(&lit.device, &lit.splats, None, None, &Visibility::None).unwrap();
    // The Gaussians of one wall emit what the third emitter does.
    let numbers: Vec<u32> = lit.splats.means.iter().map(|m| if m[0] == HALF.x { 3 } else { 0 }).collect();
    scene.transport = Some(lit.room.respond(&frame, &numbers).unwrap());
    let mut shading = Shading::new(&lit.device, scene).unwrap().without_visibility();
    let close = |a: &[f32], b: &[f32], by: f32| a.iter().zip(b).all(|(a, b)| (a - b).abs() <= by * a.abs() + 1e-6);
    let mut emitted = 0.0;
    for (i, camera) in lit.cameras.iter().enumerate() {
        let view = shading.shade(camera).unwrap().0;
        let part = |term: &[f32]| term[i * view.direct.len()..][..view.direct.len()].to_vec();
        assert!(close(&view.direct, &part(&expected[0]), 1e-5));
        assert!(close(&view.indirect, &part(&expected[1]), 5e-3));
        emitted += sum(&view.emission);
        // Without light it is dark, also when the same view is shaded again.
        let off: Vec<FrameEmitter> =
            lights.iter().map(|light| FrameEmitter::of(AreaLight { color: [0.0; 3], ..*light })).collect();
        shading.set_emitters(&off);
        let dark = shading.shade_again(camera).unwrap().0;
        assert!([&dark.direct, &dark.indirect, &dark.emission].into_iter().flatten().all(|v| *v == 0.0));
        shading.set_emitters(&frame);
        assert!(shading.shade_again(camera).unwrap().0.indirect == view.indirect);
    }
    assert!(emitted > 0.0);
}

/// Tests two walls of metal under emitters of which one has moved and one is off.
#[test]
fn reflections_follow_emitters_that_change_and_move() {
    let gpu = Gpu::new();
    let mut splats = walls();
    let on = |mirror: f32, glossy: f32, other: f32| -> Vec<f32> {
        let of = |m: &[f32; 3]| {
            if m[0] == HALF.x {
                mirror
            } else if m[2] == HALF.z {
                glossy
            } else {
                other
            }
        };
        splats.means.iter().map(of).collect()
    };
    let (roughness, metallic) = (on(-20.0, -2.2, 1.4), on(20.0, 20.0, -20.0));
    (splats.roughness, splats.metallic) = (Some(roughness), Some(metallic));
    let lit = Lit::of(&gpu, splats);
    let light = |x: f32, color: [f32; 3]| AreaLight {
        shape: LightShape::Sphere { center: [x, 0.6, -0.5], radius: 0.1 },
        color,
    };
    let lights = [light(-1.0, [30.0, 10.0, 5.0]), light(1.2, [5.0, 20.0, 30.0]), light(0.0, [0.0; 3])];
    let expected = lit.radiance(&lights, Bounces::All);
    // Without reflections these walls show the mean of the room.
    let dark = vec![[0.0; 3]; lit.splats.len()];
    let gathered = lit.room.light_by(&lights, &dark, |room| {
        Ok(room.scene.solve(&room.reflectance, &room.source, &SolveOptions::default())?)
    });
    let gathered = lit.radiance_of(gathered.unwrap());
    assert!(gathered[0] == expected[0]);
    let apart = expected[1].iter().zip(&gathered[1]).filter(|(a, b)| (*a - *b).abs() > 0.2 * b.abs()).count();
    assert!(apart > expected[1].len() / 20 && apart < expected[1].len() / 2, "{apart} of {}", expected[1].len());
    // The second emitter begins elsewhere.
    let begin = [lights[0], light(-0.3, [1.0; 3]), lights[2]].map(FrameEmitter::of);
    let transport = lit.room.respond(&begin, &vec![0; lit.splats.len()]).unwrap();
    let mut responder = lit.room.responder(&transport).unwrap();
    responder.update(1, &lit.room.in_unit(&lights[1])).unwrap();
    let mut scene = shaded_scene(&lit.device, &lit.splats, None, None, &Visibility::None).unwrap();
    scene.transport = Some(transport);
    let mut shading = Shading::new(&lit.device, scene).unwrap().without_visibility();
    shading.set_emitters(&lights.map(FrameEmitter::of));
    for (i, camera) in lit.cameras.iter().enumerate() {
        let found = shading.shade(camera).unwrap().0.indirect;
        let right = &expected[1][i * found.len()..][..found.len()];
        assert!(found.iter().zip(right).all(|(a, b)| (a - b).abs() <= 5e-3 * b.abs() + 1e-6), "view {i}");
    }
}

/// Tests windows and a sun, of which some move, against one solve.
#[test]
fn windows_and_suns_respond_as_one_solve_does() {
    let gpu = Gpu::new();
    let mut lit = Lit::new(&gpu);
    let pane = |x: f32| OpeningRow { corner: [x, -0.5, 2.4], edge_u: [0.0, 1.0, 0.0], edge_v: [1.0, 0.0, 0.0] };
    // Blue above, orange below.
    let map: Vec<f32> = [[0.2, 0.4, 2.0], [1.5, 0.6, 0.1]].iter().flat_map(|c| c.repeat(8)).collect();
    let sky = Sky::new(&map, [8, 2]).unwrap();
    lit.room = lit.room.with_outside(&[pane(-1.5), pane(0.5)], Some(&sky)).unwrap();
    let window = |x: f32, color| AreaLight { shape: pane(x).window(), color };
    let sun = |x: f32, color| AreaLight {
        shape: LightShape::Directional { direction: [x, -0.4, -1.0], angular_radius: 0.01 },
        color,
    };
    let lights = [window(-1.5, [3.0, 2.0, 1.0]), sun(0.2, [4.0, 3.0, 2.0]), window(0.5, [1.0, 2.0, 4.0])];
    let [direct, bounced, _] = lit.radiance(&lights, Bounces::All);
    let each = lights.map(|light| lit.radiance(&[light], Bounces::All));
    for [direct, bounced, _] in &each {
        assert!(sum(direct) > 1.0 && sum(bounced) > 1.0, "an emitter is dark");
    }
    // Sample points differ from light to light, and so does their noise.
    for (term, all) in [&direct, &bounced].into_iter().enumerate() {
        let parts = each.iter().map(|terms| sum(&terms[term])).sum::<f64>();
        assert!((sum(all) / parts - 1.0).abs() < 0.02, "term {term}: {} and {parts}", sum(all));
    }
    // Walls let no sun in: without openings it is dark.
    let closed = Lit::new(&gpu);
    assert_eq!(sum(&closed.radiance(&lights[1..2], Bounces::All)[0]), 0.0);
    // The sun and the last window begin elsewhere, with other colors.
    let begin = [lights[0], sun(-0.3, [1.0; 3]), window(-0.2, [1.0; 3])].map(FrameEmitter::of);
    let transport = lit.room.respond(&begin, &vec![0; lit.splats.len()]).unwrap();
    let mut responder = lit.room.responder(&transport).unwrap();
    for i in [1, 2] {
        responder.update(i, &lit.room.in_unit(&lights[i as usize])).unwrap();
    }
    let mut scene = shaded_scene(&lit.device, &lit.splats, None, None, &Visibility::None).unwrap();
    scene.transport = Some(transport);
    let mut shading = Shading::new(&lit.device, scene).unwrap().without_visibility();
    shading.set_emitters(&lights.map(FrameEmitter::of));
    for (i, camera) in lit.cameras.iter().enumerate() {
        let view = shading.shade(camera).unwrap().0;
        let right = &direct[i * view.direct.len()..][..view.direct.len()];
        assert!(view.direct.iter().zip(right).all(|(a, b)| (a - b).abs() <= 1e-4 * b.abs() + 1e-5), "view {i}");
        // A light that is solved alone has other sample points.
        let (found, right) = (sum(&view.indirect), sum(&bounced[i * view.indirect.len()..][..view.indirect.len()]));
        assert!((found / right - 1.0).abs() < 0.02, "view {i}: {found} and {right}");
    }
}

/// The fit takes a sphere for a point, and compares diffuse direct light only.
#[test]
fn hidden_light_is_found_with_its_color() {
    let gpu = Gpu::new();
    let lit = Lit::new(&gpu);
    let found = lit.explain(&[BULB]);
    assert!(found.psnr > 40.0, "{found:?}");
    assert!(found.of_gaussians.iter().all(|emitter| *emitter == 0), "no wall emits");
    // Two lights side by side may stand for one between them.
    let powers: Vec<Vec3> = found.emitters.iter().map(|e| Vec3::from(e.power().unwrap())).collect();
    let (power, truth) = (powers.iter().sum::<Vec3>(), Vec3::from(BULB.power().unwrap()));
    assert!(((power - truth) / truth).abs().max_element() < 0.1, "{power} {truth} {found:?}");
    let places = found.emitters.iter().zip(&powers).map(|(e, power)| center(e) * power.element_sum());
    let place = places.sum::<Vec3>() / power.element_sum();
    assert!(place.distance(center(&BULB)) < 0.2, "{place} {found:?}");
}

/// A band of each photograph is invalid. It clips there after the first fit.
#[test]
fn emitters_do_not_depend_on_invalid_pixels() {
    let gpu = Gpu::new();
    let (mut lit, open) = (Lit::new(&gpu), Lit::new(&gpu));
    let [width, height] = SIZE;
    let columns = |p: u32| !(14..24).contains(&(p % width));
    let data = (0..width * height).map(|p| f32::from(columns(p))).collect();
    let mask = Image { width, height, channels: 1, data };
    for view in 0..lit.cameras.len() {
        lit.views.exclude(view, &mask);
    }
    let mut photographs = lit.photographs(&[BULB]);
    let explained = |lit: &Lit, photographs: &[Image], known: Option<&[LightShape]>| {
        lit.room.explain(&lit.views, photographs, &lit.splats, known).unwrap()
    };
    let bulb: &[LightShape] = &[BULB.shape];
    let expected = explained(&lit, &photographs, None);
    let known = explained(&lit, &photographs, Some(bulb));
    for image in &mut photographs {
        let pixels = image.data.chunks_exact_mut(3).zip(&mask.data);
        pixels.filter(|(_, valid)| **valid == 0.0).for_each(|(pixel, _)| pixel.fill(1.0));
    }
    assert_eq!(explained(&lit, &photographs, None), expected);
    assert_eq!(explained(&lit, &photographs, Some(bulb)), known);
    // Without masks the clipped band changes both.
    assert!(explained(&open, &photographs, None) != expected);
    assert!(explained(&open, &photographs, Some(bulb)) != known);
}

/// The photographs are those of seven lights of different types; an eighth is off.
#[test]
fn emitters_of_known_shapes_get_their_colors() {
    let gpu = Gpu::new();
    let mut lit = Lit::new(&gpu);
    let pane = OpeningRow { corner: [0.5, -0.5, 2.4], edge_u: [0.0, 1.0, 0.0], edge_v: [1.0, 0.0, 0.0] };
    lit.room = lit.room.with_outside(&[pane], None).unwrap();
    let shapes = [
        LightShape::Point { position: [-1.2, 0.8, 1.5] },
        BULB.shape,
        LightShape::Rectangle { corner: [-1.6, 1.4, -2.0], edge_u: [0.8, 0.0, 0.0], edge_v: [0.0, 0.0, 0.8] },
        LightShape::Disk { center: [1.9, 0.0, -1.0], normal: [-2.0, 0.0, 0.0], radius: 0.3 },
        LightShape::Spot { position: [-1.5, 0.5, 0.0], axis: [1.0, -1.0, 0.0], inner_angle: 0.3, outer_angle: 0.7 },
        LightShape::Directional { direction: [-0.3, -0.4, -1.0], angular_radius: 0.01 },
        LightShape::Lobe { position: [0.8, -1.0, -2.0], axis: [0.0, 0.2, 1.0], sharpness: 6.0 },
        LightShape::Point { position: [1.5, -0.8, 1.8] },
    ];
    let strengths = [0.5, 12.0, 1.0, 1.5, 1.2, 1.0, 0.8, 0.0];
    let lights: Vec<AreaLight> = shapes
        .into_iter()
        .zip(strengths)
        .enumerate()
        .map(|(i, (shape, by))| AreaLight { shape, color: [0, 1, 2].map(|c| by * (1.0 + 0.5 * ((i + c) % 3) as f32)) })
        .collect();
    let found = lit.fit(&lights, &shapes);
    assert!(found.psnr > 40.0, "{found:?}");
    assert_eq!(found.emitters.len(), lights.len(), "an emitter that is off was dropped");
    for (found, light) in found.emitters.iter().zip(&lights) {
        assert_eq!(found.shape, light.shape, "a known emitter moved");
        let name = light.shape.name();
        for (a, b) in found.color.iter().zip(&light.color) {
            assert!((a - b).abs() <= 0.15 * b + 0.02, "{name}: {:?}, not {:?}", found.color, light.color);
        }
    }
    assert!(found.of_gaussians.iter().all(|emitter| *emitter == 0), "no wall emits");
    // Without the sun the photographs are explained worse.
    let others = [&shapes[..5], &shapes[6..]].concat();
    assert!(lit.fit(&lights, &others).psnr < found.psnr - 3.0);
}
