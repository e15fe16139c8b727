//! Synthetic room, written in the layouts of data sets.
//!
//! The room is a box whose six walls differ in color, material and emission. The test cameras share no code with this
//! crate: they cast rays from three vectors, and files are written with the `exr` and `image` crates alone. An error in
//! a reader therefore cannot be repeated here.

use std::path::Path;

use glam::{DVec2, DVec3};
use sgs_scene::{Camera, Image};

/// Half extents of the box.
const HALF: DVec3 = DVec3::new(2.0, 1.5, 2.5);

/// Camera defined by its axis vectors.
#[derive(Clone, Copy, Debug)]
pub struct Seat {
    pub origin: DVec3,
    pub target: DVec3,
    pub right: DVec3,
    pub up: DVec3,
    pub ahead: DVec3,
    pub focal: DVec2,
    pub center: DVec2,
    pub size: (u32, u32),
}

/// Intersection of a ray with the box.
#[derive(Clone, Copy, Debug)]
pub struct Hit {
    pub point: DVec3,
    pub normal: DVec3,
    pub z: f64,
    pub distance: f64,
    /// Index of the wall, from 0 to 5.
    pub wall: usize,
}

impl Seat {
    pub fn new(origin: DVec3, target: DVec3) -> Self {
        let ahead = (target - origin).normalize();
        let right = ahead.cross(DVec3::Y).normalize();
        let up = right.cross(ahead);
        let (focal, center) = (DVec2::new(30.0, 32.0), DVec2::new(19.0, 17.5));
        Self { origin, target, right, up, ahead, focal, center, size: (48, 40) }
    }

    /// Returns the ray direction through an image position. The component along the optical axis is 1.
    fn ray(&self, pixel: DVec2) -> DVec3 {
        let at = (pixel - self.center) / self.focal;
        self.ahead + self.right * at.x - self.up * at.y
    }

    pub fn hit(&self, pixel: DVec2) -> Hit {
        let ray = self.ray(pixel);
        let time = |k: usize| (HALF[k] * ray[k].signum() - self.origin[k]) / ray[k];
        let axis = (0..3).min_by(|&a, &b| time(a).total_cmp(&time(b))).unwrap();
        let mut normal = DVec3::ZERO;
        normal[axis] = -ray[axis].signum();
        let z = time(axis);
        let wall = 2 * axis + usize::from(ray[axis] > 0.0);
        Hit { point: self.origin + ray * z, normal, z, distance: z * ray.length(), wall }
    }

    /// Returns the hits of all pixel centers, row by row.
    pub fn hits(&self) -> Vec<Hit> {
        let (w, h) = self.size;
        (0..w * h).map(|i| self.hit(DVec2::new(f64::from(i % w) + 0.5, f64::from(i / w) + 0.5))).collect()
    }

    /// Returns a camera-to-world matrix as JSON, from its axes and the origin. The axes are the first three columns.
    pub fn matrix(&self, [x, y, z]: [DVec3; 3]) -> String {
        let o = self.origin;
        let row = |k: usize| format!("[{}, {}, {}, {}]", x[k], y[k], z[k], o[k]);
        format!("[{}, {}, {}, [0, 0, 0, 1]]", row(0), row(1), row(2))
    }

    /// Returns the camera-to-world matrix with OpenGL axes.
    pub fn opengl(&self) -> String {
        self.matrix([self.right, self.up, -self.ahead])
    }
}

/// Returns cameras in a row through the room.
pub fn seats(count: usize) -> Vec<Seat> {
    let place = |i: usize| i as f64 / count.max(2) as f64 * 2.0 - 1.0;
    let origin = |i: usize| DVec3::new(0.9 * place(i), 0.3 - 0.2 * place(i), 1.2);
    (0..count).map(|i| Seat::new(origin(i), DVec3::new(0.4 * place(i), -0.1, -1.0))).collect()
}

impl Hit {
    pub fn albedo(&self) -> [f32; 3] {
        let w = self.wall as f32;
        [0.2 + 0.1 * w, 0.7 - 0.08 * w, 0.3]
    }

    pub fn roughness(&self) -> f32 {
        0.3 + 0.1 * self.wall as f32
    }

    pub fn metallic(&self) -> f32 {
        if self.wall == 4 { 1.0 } else { 0.0 }
    }

    /// Returns linear light; about a fifth of the values exceed 0.7.
    pub fn light(&self) -> [f32; 3] {
        let glow = (0.5 + 0.5 * (1.7 * self.point.x + 0.9 * self.point.y - self.point.z).sin()) as f32;
        self.albedo().map(|a| a * (0.3 + 1.3 * glow))
    }
}

/// Writes an EXR file with three channels.
pub fn exr(path: &Path, size: (u32, u32), pixels: &[[f32; 3]]) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let (w, h) = (size.0 as usize, size.1 as usize);
    exr::prelude::write_rgb_file(path, w, h, |x, y| {
        let [r, g, b] = pixels[y * w + x];
        (r, g, b)
    })
    .unwrap();
}

/// Writes a PNG file with alpha from values between 0 and 1.
pub fn rgba(path: &Path, size: (u32, u32), pixels: &[[f32; 4]]) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let bytes = pixels.iter().flatten().map(|v| (v * 255.0).round() as u8).collect();
    image::RgbaImage::from_raw(size.0, size.1, bytes).unwrap().save(path).unwrap();
}

/// Writes a gray PNG file.
pub fn gray(path: &Path, size: (u32, u32), pixels: &[u8]) {
    image::GrayImage::from_raw(size.0, size.1, pixels.to_vec()).unwrap().save(path).unwrap();
}

/// Encodes linear light as sRGB.
pub fn encoded(v: f32) -> f32 {
    let v = v.clamp(0.0, 1.0);
    if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
}

/// Asserts that a camera projects every visible point to its pixel. This verifies pose, focal lengths and principal
/// point at once.
pub fn assert_sees(camera: &Camera, seat: &Seat) {
    assert_eq!((camera.width, camera.height), seat.size);
    assert!((camera.position() - seat.origin).length() < 1e-6, "{} {}", camera.position(), seat.origin);
    for (i, hit) in seat.hits().iter().enumerate().step_by(7) {
        let pixel = DVec2::new((i as u32 % seat.size.0) as f64 + 0.5, (i as u32 / seat.size.0) as f64 + 0.5);
        let seen = camera.project(hit.point).expect("the point is in front of the camera");
        assert!((seen - pixel).length() < 1e-4, "{}: {seen} instead of {pixel}", camera.name);
    }
}

/// Returns the largest error of an image over pixels for which `counts` is true.
pub fn worst(image: &Image, expected: impl Fn(usize) -> Vec<f32>, counts: impl Fn(usize) -> bool) -> f32 {
    let channels = image.channels as usize;
    let mut worst = 0.0_f32;
    let mut counted = 0;
    for (i, pixel) in image.data.chunks(channels).enumerate().filter(|(i, _)| counts(*i)) {
        let expected = expected(i);
        assert_eq!(expected.len(), channels);
        counted += 1;
        for (a, b) in pixel.iter().zip(&expected) {
            let difference = (a - b).abs();
            worst = if difference.is_nan() { f32::INFINITY } else { worst.max(difference) };
        }
    }
    assert!(counted > 0, "no pixel counts");
    worst
}

/// Returns the largest angle in degrees between image vectors and wall normals.
pub fn worst_angle(image: &Image, hits: &[Hit], counts: impl Fn(usize) -> bool) -> f64 {
    let pairs = image.data.chunks(3).zip(hits).enumerate().filter(|(i, _)| counts(*i));
    pairs.fold(0.0, |worst, (_, (n, hit))| {
        let n = DVec3::new(f64::from(n[0]), f64::from(n[1]), f64::from(n[2]));
        let angle = n.cross(hit.normal).length().atan2(n.dot(hit.normal)).to_degrees();
        assert!((n.length() - 1.0).abs() < 1e-3, "a normal of length {}", n.length());
        f64::max(worst, angle)
    })
}

/// Returns `cam.txt` and `K_list.txt` of cameras, with irregular white space.
pub fn look_at_lists(seats: &[Seat]) -> (String, String) {
    let mut poses = format!("\u{feff}{}\r\n", seats.len());
    let mut matrices = format!(" {}\n", seats.len());
    for s in seats {
        // The target may be any point on the optical axis, and up need not be perpendicular.
        for v in [s.origin, s.target, s.up * 3.0 + s.ahead * 0.1] {
            poses.push_str(&format!("{} {}\t{} \r\n", v.x, v.y, v.z));
        }
        matrices.push_str(&format!("{} 0 {}\n0.0 {} {}\n0 0 1.0\n\n", s.focal.x, s.center.x, s.focal.y, s.center.y));
    }
    (poses, matrices)
}
