//! Irradiance from physical lights on a device against its reference.
//!
//! The reference integrates polygons, casts rays at all discs, and sums by brute force.

use sgs_engine::graph::{Buffer, Graph};
use sgs_passes::reference::area_lights::{self as reference, Light, Receiver, Sampling};
use sgs_passes::reference::brdf::unit;
use sgs_passes::reference::rng::Pcg;
use sgs_passes::shade::Surfaces;
use sgs_passes::splat::Screen;
use sgs_passes::transport::{
    AreaLight, AreaLights, LightReceivers, LightShape, Opening, Outside, ShadowRays, SurfelTree, Surfels, parts_of,
    transport_lights,
};
use sgs_shaders::structs::Step;
use sgs_tests::Gpu;
use sgs_tests::area_lights::{discs, hits, light, one_of_each, receivers, scale};

/// Distance of ray origins above surfaces, and of their ends before lights; exact in 32 bits.
const OFFSET: f32 = 0.0078125;
const SEED: u32 = 5;
/// Number of pixels of the buffers after the view's.
const SPARE: usize = 7;

fn bytes(values: impl IntoIterator<Item = f64>) -> Vec<u8> {
    values.into_iter().flat_map(|x| (x as f32).to_le_bytes()).collect()
}

/// Returns a room that is open on all sides.
fn open() -> Outside {
    Outside { openings: Opening::around(2e4).to_vec(), sky: None }
}

#[derive(Clone, Copy)]
pub(super) struct Case<'c> {
    pub lights: &'c [AreaLight],
    pub receivers: &'c [Receiver],
    pub surfels: &'c Surfels,
    pub outside: &'c Outside,
    pub samples: u32,
    pub list: Option<&'c [u32]>,
}

impl Case<'_> {
    pub fn sampling(&self) -> Sampling<'_> {
        Sampling {
            outside: self.outside,
            offset: OFFSET.into(),
            clearance: OFFSET.into(),
            samples: self.samples,
            seed: SEED,
        }
    }

    /// Runs the kernel of surfels. Returns the irradiance, light by light.
    pub fn surfels(&self, gpu: &Gpu) -> Vec<f32> {
        let mut g = Graph::new("transport_lights");
        let count = self.receivers.len();
        let buffer = g.input("receivers", 32 * count as u64);
        let row = |r: &Receiver| [r.point, [0.3, r.normal[0], r.normal[1]], [r.normal[2], 0.0, 0.0]].concat();
        let data = bytes(self.receivers.iter().flat_map(|r| row(r)[..8].to_vec()));
        let receivers = LightReceivers::Surfels { receivers: buffer, count: count as u32 };
        self.run(gpu, g, &receivers, vec![(buffer, data)])
    }

    /// Runs the kernel of pixels, in a view with a row to spare. Pixels after the view's must stay unwritten.
    fn pixels(&self, gpu: &Gpu) -> Vec<f32> {
        let mut g = Graph::new("transport_lights_pixels");
        let (count, all) = (self.receivers.len(), (self.receivers.len() + SPARE) as u64);
        let step = g.uniform("step", size_of::<Step>() as u64);
        let mut values = Step::default();
        values.camera.size = [count as u32, 1];
        let [points, normals] = ["points", "normals"].map(|name| g.input(name, 12 * all));
        let coverage = g.input("coverage", 4 * all);
        let screen = Screen { step, largest: [all as u32, 1], tile: [8, 8] };
        let receivers = LightReceivers::Pixels { screen, surfaces: Surfaces { points, normals, coverage } };
        let spare = |width: usize| bytes(vec![f64::NAN; width * SPARE]);
        let inputs = vec![
            (step, bytemuck::bytes_of(&values).to_vec()),
            (points, [bytes(self.receivers.iter().flat_map(|r| r.point)), spare(3)].concat()),
            (normals, [bytes(self.receivers.iter().flat_map(|r| r.normal)), spare(3)].concat()),
            (coverage, [bytes(vec![1.0; count]), spare(1)].concat()),
        ];
        let found = self.run(gpu, g, &receivers, inputs);
        let rows = found.chunks(count + SPARE);
        rows.flat_map(|row| {
            assert!(row[count..].iter().all(|x| x.to_bits() == u32::MAX), "a pixel outside of the view was written");
            row[..count].to_vec()
        })
        .collect()
    }

    fn run(&self, gpu: &Gpu, mut g: Graph, receivers: &LightReceivers, mut inputs: Vec<(Buffer, Vec<u8>)>) -> Vec<f32> {
        let lights = AreaLights::declare(&mut g, parts_of(self.lights).len() as u32);
        if !self.lights.is_empty() {
            inputs.extend(lights.contents(self.lights));
        }
        let tree = SurfelTree::new(self.surfels).unwrap();
        let handles = tree.declare(&mut g);
        inputs.extend(tree.contents(&handles));
        let outside = self.outside.declare(&mut g);
        inputs.extend(self.outside.contents(&outside));
        let rays =
            ShadowRays { tree: handles, outside, offset: OFFSET, clearance: OFFSET, samples: self.samples, seed: SEED };
        let list = self.list.map(|list| {
            let words: Vec<u32> = [list.len() as u32].into_iter().chain(list.iter().copied()).collect();
            let buffer = g.input("light_list", 4 * words.len() as u64);
            inputs.push((buffer, bytemuck::cast_slice(&words).to_vec()));
            buffer
        });
        let unit = g.external("unit", 4 * u64::from(receivers.count()) * u64::from(lights.count.max(1)));
        transport_lights(&mut g, gpu.tuning(), receivers, &lights, &rays, list, unit).unwrap();
        if self.lights.is_empty() {
            assert!(g.compile(&Default::default()).unwrap().passes.is_empty());
            return vec![];
        }
        gpu.run(g, &inputs).get(unit)
    }

    /// Returns the first element outside of the reference's interval.
    ///
    /// Also returns the number of pairs whose interval is wide. `gpu` has computed the elements.
    pub fn compare(&self, gpu: &Gpu, found: &[f32]) -> (Option<String>, usize) {
        let parts = parts_of(self.lights);
        assert_eq!(found.len(), parts.len() * self.receivers.len());
        // Rays at the edge of an opening are in doubt.
        let [narrow, wider] = [-1.0, 1.0].map(|sign| grown(self.outside, sign));
        let mut wide = 0;
        for (l, part) in parts.iter().enumerate() {
            let light = Light::new(&part.record);
            for (i, r) in self.receivers.iter().enumerate() {
                let of = |possible: bool| {
                    let visible = |ray: &reference::Ray| {
                        let (sure, may) = hits(self.surfels, ray);
                        f64::from(u8::from(!(if possible { may } else { sure })))
                    };
                    let s = Sampling { outside: if possible { &narrow } else { &wider }, ..self.sampling() };
                    reference::shadowed(&light, r, (i as u32, l as u32), &s, visible)
                };
                let (low, high, is) = (of(true), of(false), f64::from(found[l * self.receivers.len() + i]));
                let most = self.outside.sky.iter().flat_map(|s| s.data()).fold(1.0_f32, |a, b| a.max(*b));
                let slack = 2e-5 * gpu.division_error() * f64::from(most) * scale(&light, r) + 1e-4 * high;
                wide += usize::from(high - low > slack);
                if !(is >= low - slack && is <= high + slack) {
                    return (
                        Some(format!("{light:?} at {r:?} ({i}): {is} outside of {low} to {high} ({slack})")),
                        wide,
                    );
                }
            }
        }
        (None, wide)
    }

    #[track_caller]
    pub fn check(&self, gpu: &Gpu) -> usize {
        let (surfels, pixels) = (self.surfels(gpu), self.pixels(gpu));
        assert_eq!(surfels, pixels, "surfels and pixels differ");
        let (fault, wide) = self.compare(gpu, &surfels);
        assert_eq!(fault, None);
        wide
    }
}

#[test]
fn unoccluded_irradiance_matches_polygons() {
    let gpu = Gpu::new();
    let mut rng = Pcg::new(1);
    let surfels = Surfels::default();
    // From lights that fill half of the view to lights that are points.
    for (distance, size) in
        [(2.0, 1.0), (1.2, 3.0), (0.5, 30.0), (8.0, 1.0), (40.0, 1.0), (1e3, 1.0), (1e5, 1.0), (1e6, 1e6), (0.02, 0.01)]
    {
        let lights = one_of_each(&mut rng, distance, size);
        let receivers = receivers(&mut rng, 90, 0.7_f64.min(distance));
        Case { lights: &lights, receivers: &receivers, surfels: &surfels, outside: &open(), samples: 4, list: None }
            .check(&gpu);
    }
}

/// Tests receivers in the light, on its rim, in its plane and behind it.
///
/// Some are inside of a sphere or on its surface, some have no normal.
#[test]
fn degenerate_receivers_match_reference() {
    let gpu = Gpu::new();
    let lights = [
        LightShape::Point { position: [0.0; 3] },
        LightShape::Sphere { center: [0.0; 3], radius: 1.0 },
        LightShape::Rectangle { corner: [-1.0, -1.0, 0.0], edge_u: [2.0, 0.0, 0.0], edge_v: [0.0, 2.0, 0.0] },
        LightShape::Disk { center: [0.0; 3], normal: [0.0, 0.0, 1.0], radius: 1.0 },
        LightShape::Spot { position: [0.0; 3], axis: [0.0, 0.0, 1.0], inner_angle: 0.0, outer_angle: 0.0 },
        LightShape::Directional { direction: [0.0, 0.0, 1.0], angular_radius: 1.57 },
        LightShape::Lobe { position: [0.0; 3], axis: [0.0, 0.0, 1.0], sharpness: 0.0 },
        LightShape::Lobe { position: [0.0; 3], axis: [0.6, 0.0, 0.8], sharpness: 1e4 },
        LightShape::Lobe { position: [0.0; 3], axis: [0.0, 0.0, -1.0], sharpness: 1e8 },
    ]
    .map(light);
    let mut receivers = Vec::new();
    for point in [
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [1.0, 1.0, 0.0],
        [0.5, 0.25, 0.0],
        [3.0, 0.0, 0.0],
        [0.0, 0.0, 1.0],
        [0.0, 0.0, -1.0],
        [0.25, 0.0, 1e-6],
        [1.0, 0.0, 0.0078125],
        [0.0, 0.0, 1e4],
        [1e4, 0.0, 1.0],
        [0.5, 0.5, 0.5],
    ] {
        for normal in
            [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.6, -0.8], [0.0, 0.0, 0.0]]
        {
            let narrow = |v: [f64; 3]| v.map(|x| f64::from(x as f32));
            receivers.push(Receiver { point: narrow(point), normal: narrow(normal) });
        }
    }
    let surfels = Surfels::default();
    Case { lights: &lights, receivers: &receivers, surfels: &surfels, outside: &open(), samples: 16, list: None }
        .check(&gpu);
}

/// A lobe of sharpness 0 is a point; a lobe of sharpness 1e4 lights half a degree.
#[test]
fn lobes_are_points_at_zero_and_narrow_at_1e4() {
    let gpu = Gpu::new();
    let mut rng = Pcg::new(17);
    let receivers = receivers(&mut rng, 64, 1.0);
    let surfels = discs(&mut rng, 40);
    let position = [0.3, -0.2, 2.0];
    let lobe = |sharpness| light(LightShape::Lobe { position, axis: [0.1, 0.2, -3.0], sharpness });
    let lights = [light(LightShape::Point { position }), lobe(0.0)];
    let case =
        Case { lights: &lights, receivers: &receivers, surfels: &surfels, outside: &open(), samples: 4, list: None };
    let found = case.surfels(&gpu);
    assert_eq!(found[..64], found[64..]);
    assert!(found.iter().any(|x| *x > 0.0));
    // Sharper than directions are exact: any share, but a finite one.
    let sharpest = [lobe(3e38)];
    let found = Case { lights: &sharpest, ..case }.surfels(&gpu);
    assert!(found.iter().all(|x| (0.0..=1e3).contains(x)), "{found:?}");
    // Around the axis, where 1 - cos is far below the rounding of cos.
    let beside = |i: i32| {
        let angle = 5e-3 * f64::from(i);
        let point = [0.3 + 8.0 * angle.sin(), -0.2, 2.0 - 8.0 * angle.cos()].map(|x| f64::from(x as f32));
        Receiver { point, normal: [0.0, 0.0, 1.0] }
    };
    let receivers: Vec<Receiver> = (-20..20).map(beside).collect();
    let narrow = [1e4, 1e8].map(|sharpness| light(LightShape::Lobe { position, axis: [0.0, 0.0, -1.0], sharpness }));
    let case = Case {
        lights: &narrow,
        receivers: &receivers,
        surfels: &Surfels::default(),
        outside: &open(),
        samples: 1,
        list: None,
    };
    let found = case.surfels(&gpu);
    case.check(&gpu);
    for (found, light) in found.chunks(receivers.len()).zip(&narrow) {
        for (is, r) in found.iter().zip(&receivers) {
            let right = reference::irradiance(&Light::new(&light.record()), r);
            assert!((f64::from(*is) - right).abs() <= 1e-3 * right + 1e-9, "{r:?}: {is} {right}");
        }
    }
}

#[test]
fn shadows_match_rays_against_all_discs() {
    let gpu = Gpu::new();
    let mut rng = Pcg::new(7);
    for (count, samples, distance, size) in
        [(1, 1, 3.0, 1.0), (40, 16, 3.0, 1.0), (300, 4, 2.5, 2.0), (2000, 2, 20.0, 0.3), (60, 8, 1e4, 100.0)]
    {
        let lights = one_of_each(&mut rng, distance, size);
        let receivers = receivers(&mut rng, 70, 0.6);
        let surfels = discs(&mut rng, count);
        let outside = open();
        let case =
            Case { lights: &lights, receivers: &receivers, surfels: &surfels, outside: &outside, samples, list: None };
        let wide = case.check(&gpu);
        assert!(wide < 60, "{wide} of {} pairs are doubtful", lights.len() * receivers.len());
        if count == 40 {
            // A comparison without the occluders, or with other sample points, fails.
            let found = case.surfels(&gpu);
            assert!(Case { surfels: &Surfels::default(), ..case }.compare(&gpu, &found).0.is_some());
            let mut reversed = found.clone();
            reversed.chunks_mut(receivers.len()).for_each(<[f32]>::reverse);
            assert!(case.compare(&gpu, &reversed).0.is_some());
        }
    }
}

/// Returns openings whose edges are a little longer or shorter.
fn grown(outside: &Outside, sign: f32) -> Outside {
    let grow = |o: &Opening| {
        let [corner, u, v] = [o.corner, o.edge_u, o.edge_v].map(glam::Vec3::from);
        let by = sign * 2e-5 * (1.0 + corner.length() + u.length() + v.length());
        let [a, b] = [u, v].map(|e| by * e.normalize_or_zero());
        let [corner, edge_u, edge_v] = [corner - a - b, u + 2.0 * a, v + 2.0 * b].map(|v| v.to_array());
        Opening { corner, edge_u, edge_v }
    };
    Outside { openings: outside.openings.iter().map(grow).collect(), sky: outside.sky.clone() }
}

/// Returns the root mean square error, relative to the irradiance's.
fn error(gpu: &Gpu, case: &Case<'_>, truth: &[f64]) -> f64 {
    let found = case.surfels(gpu);
    let square = |v: &mut dyn Iterator<Item = f64>| v.map(|x| x * x).sum::<f64>().sqrt();
    square(&mut found.iter().zip(truth).map(|(f, t)| f64::from(*f) - t)) / square(&mut truth.iter().copied())
}

#[test]
fn samples_converge_to_the_integral() {
    let gpu = Gpu::new();
    let mut rng = Pcg::new(11);
    let lights = one_of_each(&mut rng, 2.5, 1.5);
    let receivers = receivers(&mut rng, 150, 0.5);
    let surfels = discs(&mut rng, 50);
    for l in &lights {
        let lights = [*l];
        let outside = open();
        let case = |samples| Case {
            lights: &lights,
            receivers: &receivers,
            surfels: &surfels,
            outside: &outside,
            samples,
            list: None,
        };
        let light = Light::new(&l.record());
        if !light.has_extent() {
            continue;
        }
        let visible = |ray: &reference::Ray| f64::from(u8::from(!hits(&surfels, ray).0));
        let truth: Vec<f64> =
            receivers.iter().map(|r| reference::integrate(&light, r, &case(1).sampling(), 64, visible)).collect();
        let errors = [1, 4, 16].map(|samples| error(&gpu, &case(samples), &truth));
        assert!(errors[2] < 0.1 && errors[2] < 0.4 * errors[0] && errors[1] < errors[0], "{:?}: {errors:?}", l.shape);
    }
}

#[test]
fn only_listed_lights_are_updated() {
    let gpu = Gpu::new();
    let mut rng = Pcg::new(13);
    let lights = one_of_each(&mut rng, 2.0, 1.0);
    let receivers = receivers(&mut rng, 33, 0.5);
    let surfels = discs(&mut rng, 20);
    let outside = open();
    let all =
        Case { lights: &lights, receivers: &receivers, surfels: &surfels, outside: &outside, samples: 4, list: None };
    let whole = all.surfels(&gpu);
    for list in [&[][..], &[3], &[6, 0, 2]] {
        let found = Case { list: Some(list), ..all }.surfels(&gpu);
        for (l, (row, right)) in found.chunks(33).zip(whole.chunks(33)).enumerate() {
            if list.contains(&(l as u32)) {
                assert_eq!(row, right);
            } else {
                assert!(row.iter().all(|x| x.to_bits() == u32::MAX), "light {l} was written");
            }
        }
    }
    // Without lights, the graph has no pass.
    assert_eq!(Case { lights: &[], ..all }.surfels(&gpu), Vec::<f32>::new());
}

/// A rectangle under a ceiling that faces down: the frame around it does not shadow it, a table below does.
#[test]
fn fixtures_do_not_occlude_but_tables_do() {
    let gpu = Gpu::new();
    let lights =
        [light(LightShape::Rectangle { corner: [-0.5, -0.5, 2.0], edge_u: [0.0, 1.0, 0.0], edge_v: [1.0, 0.0, 0.0] })];
    let floor = |x: f64, y: f64| Receiver { point: [x, y, 0.0], normal: [0.0, 0.0, 1.0] };
    let receivers = [floor(0.0, 0.0), floor(3.0, 0.0), Receiver { normal: unit([0.0, 0.0, -1.0]), ..floor(0.0, 0.0) }];
    // The ceiling faces down and is in the plane of the light; the table faces down, its top faces up.
    let surfels = Surfels {
        points: vec![[0.0, 0.0, 2.0], [0.0, 0.0, 0.5], [0.0, 0.0, 0.5]],
        normals: vec![[0.0, 0.0, -1.0], [0.0, 0.0, -1.0], [0.0, 0.0, 1.0]],
        radii: vec![4.0, 1.0, 1.0],
    };
    let outside = open();
    let case =
        Case { lights: &lights, receivers: &receivers, surfels: &surfels, outside: &outside, samples: 16, list: None };
    let found = case.surfels(&gpu);
    assert!(found[0] == 0.0 && found[2] == 0.0, "{found:?}");
    let right = reference::irradiance(&Light::new(&lights[0].record()), &receivers[1]);
    assert!((f64::from(found[1]) - right).abs() < 1e-5, "{found:?} {right}");
}
