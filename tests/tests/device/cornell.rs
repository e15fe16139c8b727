//! Bounced light in a Cornell box against images of Mitsuba 3.
//!
//! `tests/data/cornell` holds the images.
//!
//! The box is closed, all its surfaces are diffuse, and a rectangle below its ceiling shines. Discs cover walls and blocks.
//! They are small at the edges of blocks, beyond which they reach. Primary hits are analytic. Pixels that show the light, or
//! are next to one that does, are not compared.
//!
//! Measured on llvmpipe with 9869 surfels, in percent. The means of red, green and blue differ by -0.06, -0.02 and -0.01 under direct
//! light, -0.05, 0.03 and 0.01 with one bounce, and -0.08, -0.03 and -0.03 with all bounces. Other seeds change them by up to 0.07.
//! A pixel differs by 2 of the mean (root mean square): noise of shadow rays and of edges, 0.5 by the reference. Cells
//! of 0.04 at the edges of blocks make direct light 0.1 darker: their discs' shadows are too wide.

use glam::{DMat3, DVec3};
use sgs_passes::pipeline::{TransportOptions, TransportScene};
use sgs_passes::reference::rng::Pcg;
use sgs_passes::transport::{
    AreaLight, Enclosure, LightShape, NEIGHBORS, Nearest, NearestOptions, SolveOptions, SurfelTree, Surfels,
    nearest_surfels,
};
use sgs_scene::{ExrImage, read_exr};
use sgs_tests::Gpu;
use std::f64::consts::PI;
use std::path::Path;

/// Width and height of the images.
const SIZE: usize = 96;
/// Samples of a pixel along each axis.
const SAMPLES: usize = 4;
const CAMERA: DVec3 = DVec3::new(0.0, 0.0, 0.98);
const WHITE: [f64; 3] = [0.75; 3];
const RED: [f64; 3] = [0.6, 0.1, 0.05];
const GREEN: [f64; 3] = [0.15, 0.5, 0.1];
const RADIANCE: [f32; 3] = [12.0, 10.0, 8.0];
/// Bound of the relative error of the mean of each channel.
const MEAN: f64 = 0.003;
/// Bound of the root mean square error of a pixel, as a share of the mean.
const OF_PIXEL: f64 = 0.03;
/// Distance of ray origins above surfaces.
const OFFSET: f32 = 5e-4;

/// Rectangle that reflects on one side.
#[derive(Clone, Copy)]
struct Face {
    center: DVec3,
    /// Half edges. The normal is that of `u` x `v`.
    u: DVec3,
    v: DVec3,
    albedo: [f64; 3],
    /// Largest edge of the cells into which it is cut for discs.
    largest: f64,
    /// Largest edge of such cells at the edges of the face.
    smallest: f64,
}

impl Face {
    fn normal(&self) -> DVec3 {
        self.u.cross(self.v).normalize()
    }

    /// Returns the distance at which a ray meets the front.
    fn distance(&self, from: DVec3, along: DVec3) -> Option<f64> {
        let (normal, to) = (self.normal(), self.center - from);
        let (facing, at) = (normal.dot(along), normal.dot(to) / normal.dot(along));
        let beside = at * along - to;
        let within = |edge: DVec3| beside.dot(edge).abs() <= edge.length_squared();
        (facing < 0.0 && at > 0.0 && within(self.u) && within(self.v)).then_some(at)
    }
}

/// Returns the five faces of a block that can be seen. It stands on the floor.
fn block(x: f64, z: f64, degrees: f64, half: [f64; 3]) -> Vec<Face> {
    let turn = DMat3::from_rotation_y(degrees.to_radians());
    let center = DVec3::new(x, half[1] - 1.0, z);
    let edges = [0, 1, 2].map(|k| half[k] * turn.col(k));
    let side = |k: usize, sign: f64| {
        let (u, v) = (edges[(k + 1) % 3], sign * edges[(k + 2) % 3]);
        Face { center: center + sign * edges[k], u, v, albedo: WHITE, largest: 0.15, smallest: 0.02 }
    };
    vec![side(0, -1.0), side(0, 1.0), side(1, 1.0), side(2, -1.0), side(2, 1.0)]
}

/// Returns walls, floor, ceiling and two blocks.
fn faces() -> Vec<Face> {
    let wall = |axis: usize, sign: f64, albedo| {
        let (u, v) = (DVec3::AXES[(axis + 1) % 3], -sign * DVec3::AXES[(axis + 2) % 3]);
        Face { center: sign * DVec3::AXES[axis], u, v, albedo, largest: 0.0625, smallest: 0.0625 }
    };
    let mut all = vec![wall(0, -1.0, RED), wall(0, 1.0, GREEN)];
    all.extend([(1, -1.0), (1, 1.0), (2, -1.0), (2, 1.0)].map(|(axis, sign)| wall(axis, sign, WHITE)));
    all.extend(block(-0.35, -0.35, 18.0, [0.3, 0.6, 0.3]));
    all.extend(block(0.38, 0.25, -15.0, [0.28; 3]));
    all
}

/// Returns whether a point is in a block: behind all its faces.
fn in_a_block(faces: &[Face], point: DVec3) -> bool {
    faces[6..].chunks(5).any(|block| block.iter().all(|f| f.normal().dot(point - f.center) < 0.0))
}

fn light() -> AreaLight {
    let shape =
        LightShape::Rectangle { corner: [-0.3, 0.998, -0.25], edge_u: [0.6, 0.0, 0.0], edge_v: [0.0, 0.0, 0.5] };
    AreaLight { shape, color: RADIANCE }
}

/// Discs on the faces, and the face of each.
#[derive(Default)]
struct Covered {
    surfels: Surfels,
    faces: Vec<usize>,
}

impl Covered {
    fn new(faces: &[Face]) -> Covered {
        let mut covered = Covered::default();
        (0..faces.len()).for_each(|i| covered.cut(faces, i, [[-1.0, 1.0]; 2]));
        covered
    }

    /// Adds a disc around a part of a face, or cuts the part in two.
    ///
    /// `part` is a range of multiples of each half edge. Parts are at most as large as their distance to the nearest edge.
    fn cut(&mut self, faces: &[Face], face: usize, part: [[f64; 2]; 2]) {
        let f = &faces[face];
        let lengths = [f.u.length(), f.v.length()];
        let sides = [0, 1].map(|k| (part[k][1] - part[k][0]) * lengths[k]);
        let middles = part.map(|[low, high]| 0.5 * (low + high));
        let edge = |k: usize| (1.0 - middles[k].abs()) * lengths[k] - 0.5 * sides[k];
        let point = f.center + middles[0] * f.u + middles[1] * f.v;
        let longest = usize::from(sides[1] > sides[0]);
        let most = edge(0).min(edge(1)).clamp(f.smallest, f.largest);
        if sides[longest] > most * 1.001 {
            let [low, high] = part[longest];
            for half in [[low, middles[longest]], [middles[longest], high]] {
                let mut part = part;
                part[longest] = half;
                self.cut(faces, face, part);
            }
        } else if !in_a_block(faces, point + 1e-9 * f.normal()) {
            self.surfels.points.push(point.as_vec3().to_array());
            self.surfels.normals.push(f.normal().as_vec3().to_array());
            self.surfels.radii.push(0.5 * sides[0].hypot(sides[1]) as f32);
            self.faces.push(face);
        }
    }
}

/// Samples of all pixels, `SAMPLES` by `SAMPLES` each.
#[derive(Default)]
struct Hits {
    points: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
    faces: Vec<usize>,
}

/// Returns the first face that a place in the image shows, and the point.
///
/// The place is in pixels.
fn hit(faces: &[Face], x: f64, y: f64) -> (usize, DVec3) {
    let across = |v: f64| 2.0 * v / SIZE as f64 - 1.0;
    let along = DVec3::new(across(x), -across(y), -1.0);
    let met = faces.iter().enumerate().filter_map(|(i, f)| Some((f.distance(CAMERA, along)?, i)));
    let (distance, face) = met.min_by(|a, b| a.0.total_cmp(&b.0)).expect("the box is closed");
    (face, CAMERA + distance * along)
}

/// Returns whether a pixel or one next to it shows the light.
fn near_light(x: usize, y: usize) -> bool {
    let shows = |x: f64, y: f64| {
        let across = |v: f64| 2.0 * v / SIZE as f64 - 1.0;
        let at = 0.998 / -across(y);
        let [px, pz] = [CAMERA.x + at * across(x), CAMERA.z - at];
        at > 0.0 && px.abs() <= 0.3 && pz.abs() <= 0.25
    };
    (0..9).any(|i| shows(x as f64 + (i % 3) as f64 - 0.5, y as f64 + (i / 3) as f64 - 0.5))
}

fn hits(faces: &[Face]) -> Hits {
    let (mut all, mut rng) = (Hits::default(), Pcg::new(3));
    for sample in 0..SIZE * SIZE * SAMPLES * SAMPLES {
        let (pixel, k) = (sample / (SAMPLES * SAMPLES), sample % (SAMPLES * SAMPLES));
        let mut within = |k: usize| (k as f64 + rng.uniform()) / SAMPLES as f64;
        let (x, y) = ((pixel % SIZE) as f64 + within(k % SAMPLES), (pixel / SIZE) as f64 + within(k / SAMPLES));
        let (face, point) = hit(faces, x, y);
        all.points.push(point.as_vec3().to_array());
        all.normals.push(faces[face].normal().as_vec3().to_array());
        all.faces.push(face);
    }
    all
}

/// Difference of an image from the reference.
#[derive(Debug)]
struct Difference {
    /// Relative error of the mean over all compared pixels, per channel.
    mean: [f64; 3],
    /// Root of the mean square error of a pixel, as a share of the mean.
    of_pixel: f64,
}

fn compare(image: &[[f64; 3]], name: &str) -> Difference {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("data/cornell").join(name);
    let ExrImage { image: truth, .. } = read_exr(&path).unwrap();
    assert_eq!([truth.width as usize, truth.height as usize, truth.channels as usize], [SIZE, SIZE, 3]);
    let (mut found, mut right, mut square, mut count) = ([0.0; 3], [0.0; 3], 0.0, 0);
    for pixel in (0..SIZE * SIZE).filter(|p| !near_light(p % SIZE, p / SIZE)) {
        for c in 0..3 {
            let expected = f64::from(truth.data[3 * pixel + c]);
            found[c] += image[pixel][c];
            right[c] += expected;
            square += (image[pixel][c] - expected).powi(2);
        }
        count += 3;
    }
    let mean = right.iter().sum::<f64>() / f64::from(count);
    let of_pixel = (square / f64::from(count)).sqrt() / mean;
    Difference { mean: [0, 1, 2].map(|c| found[c] / right[c] - 1.0), of_pixel }
}

/// Surfels of the box on the device, and the samples of its image.
struct Cornell {
    faces: Vec<Face>,
    surfels: usize,
    scene: TransportScene,
    /// Reflectance of surfels and patches, `[receivers * 3]`.
    reflectance: Vec<f32>,
    hits: Hits,
    /// Direct irradiance of each sample by light of color 1.
    direct: Vec<f32>,
    nearest: Nearest,
}

impl Cornell {
    fn new(gpu: &Gpu) -> Cornell {
        let faces = faces();
        let Covered { surfels, faces: of_surfels } = Covered::new(&faces);
        let tree = SurfelTree::new(&surfels).unwrap();
        let enclosure = Enclosure::new([-1.005; 3], [1.005; 3], 0.4).unwrap();
        let options = TransportOptions { rays: 128, samples: 16, seed: 1, offset: OFFSET, clearance: 1e-3 };
        let scene = TransportScene::new(gpu.device(), gpu.tuning(), (&surfels, &tree), &enclosure, options).unwrap();
        // The faces of the enclosure are in the order of the walls.
        let of_patches = enclosure.patches().into_iter().map(|p| p.face as usize);
        let of_receivers = of_surfels.into_iter().chain(of_patches);
        let reflectance = of_receivers.flat_map(|f| faces[f].albedo.map(|a| a as f32)).collect();
        let hits = hits(&faces);
        let direct = scene.unit_light_at(&[light()], &hits.points, &hits.normals).unwrap();
        let near = NearestOptions { normal_length: 0.25, least_distance: 0.002 };
        let nearest = nearest_surfels(&hits.points, &hits.normals, &surfels, &near);
        Cornell { faces, surfels: surfels.len(), scene, reflectance, hits, direct, nearest }
    }

    /// Returns the share of the surfels' rays that leave between discs.
    fn leaks(&self) -> f64 {
        let rays = self.surfels * self.scene.options().rays as usize;
        let targets = self.scene.targets().unwrap();
        targets[..rays].iter().filter(|t| **t as usize >= self.surfels).count() as f64 / rays as f64
    }

    /// Returns the irradiance that bounces, per receiver.
    fn bounced(&self, reflectance: &[f32], options: &SolveOptions) -> Vec<f32> {
        let unit = self.scene.unit_light(&[light()]).unwrap();
        let source = |(at, r): (usize, &f32)| RADIANCE[at % 3] * unit[at / 3] * r / PI as f32;
        let source: Vec<f32> = reflectance.iter().enumerate().map(source).collect();
        self.scene.solve(reflectance, &source, options).unwrap()
    }

    /// Returns the radiance of each pixel under direct and bounced light.
    fn image(&self, bounced: &[f32]) -> Vec<[f64; 3]> {
        let mut image = vec![[0.0; 3]; SIZE * SIZE];
        let share = 1.0 / (SAMPLES * SAMPLES) as f64;
        let neighbors = self.nearest.neighbors.chunks(NEIGHBORS).zip(self.nearest.weights.chunks(NEIGHBORS));
        for (sample, (neighbors, weights)) in neighbors.enumerate() {
            let albedo = self.faces[self.hits.faces[sample]].albedo;
            for c in 0..3 {
                let from = |(i, w): (&u32, &f32)| f64::from(w * bounced[3 * *i as usize + c]);
                let indirect: f64 = neighbors.iter().zip(weights).map(from).sum();
                let irradiance = f64::from(RADIANCE[c] * self.direct[sample]) + indirect;
                image[sample / (SAMPLES * SAMPLES)][c] += share * albedo[c] * irradiance / PI;
            }
        }
        image
    }
}

#[test]
fn cornell_box_matches_mitsuba() {
    let gpu = Gpu::new();
    let cornell = Cornell::new(&gpu);
    let leaks = cornell.leaks();
    println!("{} surfels, {leaks:.5} of their rays leave", cornell.surfels);
    assert!(leaks < 0.003, "{leaks}");
    let once = SolveOptions { iterations: 1, accelerated: false, ..Default::default() };
    let all = SolveOptions::default();
    let images = [
        ("direct.exr", vec![0.0; cornell.reflectance.len()]),
        ("one_bounce.exr", cornell.bounced(&cornell.reflectance, &once)),
        ("all.exr", cornell.bounced(&cornell.reflectance, &all)),
    ];
    for (name, bounced) in &images {
        let image = cornell.image(bounced);
        let found = compare(&image, name);
        println!("{name}: {found:.5?}");
        let within = |d: &Difference| d.mean.iter().all(|m| m.abs() < MEAN) && d.of_pixel < OF_PIXEL;
        assert!(within(&found), "{name}: {found:?}");
        // Another number of bounces, or a brightness that is 1 % off, is found.
        assert!(images.iter().all(|(other, _)| other == name || !within(&compare(&image, other))));
        let brighter: Vec<[f64; 3]> = image.iter().map(|p| p.map(|v| 1.01 * v)).collect();
        assert!(!within(&compare(&brighter, name)));
    }
    // So is light that bounces between walls that are 1 % darker.
    let darker: Vec<f32> = cornell.reflectance.iter().map(|r| 0.99 * r).collect();
    let found = compare(&cornell.image(&cornell.bounced(&darker, &all)), "all.exr");
    assert!(found.mean.iter().any(|m| m.abs() > MEAN), "{found:?}");
}
