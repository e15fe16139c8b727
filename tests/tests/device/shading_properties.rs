//! One pixel under a few random lights: radiance and all gradients against the reference. The reference is in double
//! precision. Every number is drawn log-uniformly, and failures are shrunk. Draws are the same in every run;
//! `SGS_TEST_CASES` sets their number.
//!
//! The tolerance for single precision is measured. Normals, positions and the camera are perturbed by a few units in
//! the last place, and the change of the reference is the tolerance.

use proptest::prelude::*;
use sgs_passes::reference::brdf::{Material, V3, along, cross, dot, unit};
use sgs_passes::reference::lights::{self as reference, Pixel, Raw};
use sgs_passes::shade::lights::{Axes, LightModel, Shape};
use sgs_tests::Gpu;
use sgs_tests::drawn::{Compared, runner, signed, spread};
use sgs_tests::lit::{Lit, narrow, run};

/// Relative tolerance of a value, in addition to the effect of input rounding.
const RELATIVE: f64 = 3e-4;

/// Perturbation of inputs, relative to unit vectors and to distances.
const MOVE: f64 = 1e-6;

/// Draws a share: near zero, near one, or in between.
fn share() -> impl Strategy<Value = f64> {
    prop_oneof![spread(-6.0, 0.0), spread(-6.0, 0.0).prop_map(|x| 1.0 - x), Just(0.0), Just(1.0)]
}

/// Direction by its cosine to the normal and the angle around the normal.
#[derive(Clone, Copy, Debug)]
struct Way {
    cosine: f64,
    turn: f64,
}

impl Way {
    fn about(self, normal: V3) -> V3 {
        let other = if normal[0].abs() < 0.6 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
        let x = unit(cross(normal, other));
        let y = cross(normal, x);
        let sine = (1.0 - self.cosine * self.cosine).max(0.0).sqrt();
        unit(along(along(normal.map(|n| n * self.cosine), sine * self.turn.cos(), x), sine * self.turn.sin(), y))
    }
}

prop_compose! {
    fn way()(cosine in signed(-4.0, 0.0), turn in 0.0..std::f64::consts::TAU) -> Way {
        Way { cosine, turn }
    }
}

/// Lobe: its axis, relative to the direction between pixel and light, and its parameters.
#[derive(Clone, Debug)]
struct Lobe {
    /// Offset of the axis from that direction.
    off: [f64; 3],
    length: f64,
    sharpness: f64,
    amplitude: [f64; 3],
}

prop_compose! {
    fn lobe()(
        off in [signed(-4.0, 0.3), signed(-4.0, 0.3), signed(-4.0, 0.3)],
        length in spread(-3.0, 3.0),
        sharpness in -9.0..12.0_f64,
        amplitude in [-18.0..16.0_f64, -18.0..16.0_f64, -18.0..16.0_f64],
    ) -> Lobe {
        Lobe { off, length, sharpness, amplitude }
    }
}

#[derive(Clone, Debug)]
struct Light {
    way: Way,
    distance: f64,
    gain: f64,
    lobes: [Lobe; 2],
}

prop_compose! {
    fn light()(way in way(), distance in spread(-4.0, 3.0), gain in spread(-3.0, 2.0), lobes in [lobe(), lobe()]) -> Light {
        Light { way, distance, gain, lobes }
    }
}

prop_compose! {
    fn case()(
        normal in way(),
        view in way(),
        away in spread(-3.0, 3.0),
        center in [signed(-3.0, 3.0), signed(-3.0, 3.0), signed(-3.0, 3.0)],
        coverage in prop_oneof![4 => spread(-2.9, 0.0), 1 => spread(-6.0, -3.1)],
        albedo in [share(), share(), share()],
        roughness in spread(-2.5, 0.0),
        // At metallic 0, the Fresnel term has a kink at grazing incidence and no gradient to compare.
        metallic in prop::option::of(prop_oneof![spread(-4.0, 0.0), Just(1.0)]),
        gradient in [signed(-8.0, 8.0), signed(-8.0, 8.0), signed(-8.0, 8.0)],
        lights in prop::collection::vec(light(), 1..4),
    ) -> Lit {
        let normal = normal.about([0.0, 0.0, 1.0]).map(narrow);
        let point = center.map(narrow);
        let n = unit(normal);
        let camera = along(point, away, view.about(n)).map(narrow);
        let model = LightModel { lights: lights.len() as u32, lobes: 2, axes: Axes::Free };
        let (mut positions, mut lobes) = (Vec::new(), Vec::new());
        for light in &lights {
            let l = light.way.about(n);
            positions.extend(along(point, light.distance, l).map(narrow));
            for lobe in &light.lobes {
                // Lobes are evaluated in the direction from the pixel to the light.
                lobes.extend(unit(along(l, 1.0, lobe.off)).map(|x| narrow(lobe.length * x)));
                lobes.push(narrow(lobe.sharpness));
                lobes.extend(lobe.amplitude.map(narrow));
            }
        }
        let material = Material {
            albedo: albedo.map(narrow),
            roughness: narrow(roughness),
            metallic: metallic.map_or(0.0, narrow),
        };
        Lit {
            size: [1, 1],
            pixels: vec![Pixel { point, normal, coverage: narrow(coverage), material }],
            metallic: metallic.is_some(),
            raw: Raw { model, positions, lobes, gains: lights.iter().map(|l| narrow(l.gain)).collect() },
            camera,
            gradient: gradient.map(narrow).to_vec(),
            seed: 77,
            before: 0.0,
        }
    }
}

/// Results of the kernels, in one list.
struct Answer {
    names: Vec<String>,
    values: Vec<f64>,
}

const NAMES: [&str; 7] = ["radiance", "diffuse radiance", "normal", "materials", "metallic", "places", "lobes"];

fn answer(case: &Lit, parts: [&[f64]; 7]) -> Answer {
    let (mut all, [.., metallic, _, _]) = (Answer { names: vec![], values: vec![] }, parts);
    assert!(case.metallic || metallic == [0.0]);
    for (name, part) in NAMES.iter().zip(parts) {
        all.names.extend((0..part.len()).map(|i| format!("{name} {i}")));
        all.values.extend(part);
    }
    all
}

/// Returns the reference's radiance, its diffuse part, and the gradients.
fn truth(case: &Lit) -> Answer {
    let (camera, normalizer, lights) = (case.camera, case.normalizer(), case.lights());
    let [diffuse, specular] = reference::lights(&case.pixels, &lights, camera, normalizer);
    let whole: Vec<f64> = diffuse.iter().zip(&specular).map(|(d, s)| d + s).collect();
    let normal = reference::lights_normals_bwd(&case.pixels, &lights, camera, normalizer, &case.gradient).concat();
    let [m] = reference::lights_materials_bwd(&case.pixels, &lights, camera, normalizer, &case.gradient)[..] else {
        panic!("one pixel")
    };
    let metallic = if case.metallic { m[4] } else { 0.0 };
    let raw = reference::lights_bwd(&case.raw, &case.pixels, camera, normalizer, &case.gradient);
    answer(case, [&whole, &diffuse, &normal, &m[..4], &[metallic], &raw.positions, &raw.lobes])
}

/// Returns the device's results.
fn found(gpu: &Gpu, case: &Lit) -> Answer {
    let own = Shape::for_device(gpu.tuning());
    let found = run(gpu, Shape { per_lane: 1, ..own }, case, [1, 1], None);
    let wide = |x: &[f32]| x.iter().map(|x| f64::from(*x)).collect::<Vec<_>>();
    let [whole, diffuse, normal] = [&found.direct, &found.split[1], &found.normals].map(|x| wide(x));
    let [materials, metallic] = [&found.materials, &found.metallic].map(|x| wide(x));
    answer(case, [&whole, &diffuse, &normal, &materials, &metallic, &wide(&found.positions), &wide(&found.lobes)])
}

/// Returns magnitudes summed over lights and colors taken separately. The second number is the magnitude of the loss.
fn alone(case: &Lit) -> (Vec<f64>, f64) {
    let (mut terms, mut loss) = (vec![0.0; truth(case).values.len()], 0.0);
    for light in 0..case.raw.gains.len() {
        for color in 0..3 {
            let mut one = case.clone();
            one.raw.gains.iter_mut().enumerate().filter(|(i, _)| *i != light).for_each(|(_, g)| *g = 0.0);
            one.gradient.iter_mut().enumerate().filter(|(i, _)| *i != color).for_each(|(_, g)| *g = 0.0);
            let part = truth(&one);
            terms.iter_mut().zip(&part.values).for_each(|(sum, x)| *sum += x.abs());
            loss += part.values[color] * case.gradient[color].abs();
        }
    }
    (terms, loss)
}

/// Returns the tolerance of each number.
fn slack(case: &Lit, truth_: &Answer) -> Vec<f64> {
    let mut slack: Vec<f64> = truth_.values.iter().map(|x| RELATIVE * x.abs()).collect();
    // Results may cancel, so lights and colors are taken separately. 1e-20 of a lobe's peak underflows in 32 bits after
    // multiplication with other small numbers.
    let row = case.raw.model.row() as usize;
    let mut blunt = case.clone();
    blunt.raw.lobes.chunks_mut(row).for_each(|r| r[3] = -40.0);
    let ((terms, loss), (peaks, peak)) = (alone(case), alone(&blunt));
    // Rounding of the kernels' inputs is simulated by perturbations.
    let point = case.pixels[0].point;
    let mut moved = |change: &dyn Fn(&mut Lit, f64)| {
        let by = [MOVE, -MOVE].map(|by| {
            let mut other = case.clone();
            change(&mut other, by);
            truth(&other).values
        });
        for (i, slack) in slack.iter_mut().enumerate() {
            *slack += by.iter().map(|other| (other[i] - truth_.values[i]).abs()).fold(0.0, f64::max);
        }
    };
    let size = |place: V3| {
        let d = along(place, -1.0, point);
        dot(d, d).sqrt()
    };
    let (mut nearest, mut grazing) = (1.0_f64, 1.0_f64);
    for axis in 0..3 {
        moved(&|c, by| c.pixels[0].normal[axis] += by);
        let away = size(case.camera);
        moved(&|c, by| c.camera[axis] += by * away);
        for light in 0..case.raw.gains.len() {
            let p = &case.raw.positions[3 * light..][..3];
            let away = size([p[0], p[1], p[2]]);
            let cosine = dot(case.pixels[0].normal, along([p[0], p[1], p[2]], -1.0, point)) / away;
            (nearest, grazing) = (nearest.min(away), grazing.min(cosine.abs()));
            moved(&|c, by| c.raw.positions[3 * light + axis] += by * away);
        }
    }
    for (((slack, term), peak_), name) in slack.iter_mut().zip(terms).zip(peaks).zip(&truth_.names) {
        // A light's position acts through its distance, and a normal through its cosine. Each is a difference of terms
        // of that size.
        let length = match name.split(' ').next() {
            Some("places") => nearest,
            Some("normal") => 0.1 * grazing,
            _ => 1.0,
        };
        *slack += 1e-5 * term + 1e-20 * peak_ + (1e-7 * loss + 1e-20 * peak) / length + 1e-30;
    }
    slack
}

/// Compares the device's results with the reference. Numbers whose name starts with `planted` are first increased by 1
/// %.
fn check(gpu: &Gpu, case: &Lit, planted: Option<&str>, compared: &Compared) -> Result<(), TestCaseError> {
    let (expected, found) = (truth(case), found(gpu, case));
    let slack = slack(case, &expected);
    for (i, name) in found.names.iter().enumerate() {
        let factor = if planted.is_some_and(|p| name.starts_with(p)) { 1.01 } else { 1.0 };
        let (e, f, slack) = (expected.values[i], factor * found.values[i], slack[i]);
        compared.see(e, slack);
        prop_assert!((f - e).abs() <= slack, "{} is {} and not {}, to {}", name, f, e, slack);
    }
    Ok(())
}

#[test]
fn shaded_lights_match_reference() {
    let gpu = Gpu::new();
    let compared = Compared::default();
    runner(96).run(&case(), |case| check(&gpu, &case, None, &compared)).unwrap_or_else(|e| panic!("{e}"));
    compared.check(1000, 0.6);
}

/// Tests that an error of 1 % in each kind of number is detected.
#[test]
fn checks_of_lights_can_fail() {
    let gpu = Gpu::new();
    let mut case = Lit::random([1, 1], LightModel { lights: 3, lobes: 2, axes: Axes::Free }, true, 6);
    case.before = 0.0;
    let light = case.raw.positions[..3].to_vec();
    case.pixels[0].normal = unit(along([light[0], light[1], light[2]], -1.0, case.pixels[0].point)).map(narrow);
    let compared = Compared::default();
    check(&gpu, &case, None, &compared).unwrap_or_else(|e| panic!("{e}"));
    for name in NAMES {
        assert!(check(&gpu, &case, Some(name), &compared).is_err(), "{name}");
    }
}
