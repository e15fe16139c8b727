//! Triangulated shapes: boxes, rounded boxes, surfaces of revolution, balls, rods, sheets.
//!
//! All positions are meters in the frame of the open object. Texture coordinates are meters on the surface, so a
//! pattern has the same size on every shape.

use std::f32::consts::{FRAC_PI_4, PI, TAU};

use glam::{Vec2, Vec3};

use crate::scene::builder::{Builder, Vertex};

impl Builder {
    /// Adds a flat parallelogram whose normal is `u × v`. Texture coordinates start at the corner.
    pub(crate) fn quad(&mut self, corner: Vec3, u: Vec3, v: Vec3) {
        let (lu, lv) = (u.length(), v.length());
        self.quad_uv(corner, u, v, Vec2::ZERO, Vec2::new(lu, lv));
    }

    /// Adds a [`Builder::quad`] with texture coordinates from `uv0` to `uv1`.
    pub(crate) fn quad_uv(&mut self, corner: Vec3, u: Vec3, v: Vec3, uv0: Vec2, uv1: Vec2) {
        let normal = u.cross(v).normalize();
        let vertex = |a: f32, b: f32| Vertex {
            position: corner + a * u + b * v,
            normal,
            uv: uv0 + Vec2::new(a, b) * (uv1 - uv0),
        };
        let (p, q, r, s) = (vertex(0.0, 0.0), vertex(1.0, 0.0), vertex(1.0, 1.0), vertex(0.0, 1.0));
        self.triangle([p, q, r]);
        self.triangle([p, r, s]);
    }

    /// Adds a box with sharp edges.
    pub(crate) fn cuboid(&mut self, center: Vec3, half: Vec3) {
        for (axis, sign) in FACES {
            let (n, u, v) = face(axis, sign);
            let corner = center + half * (n - u - v);
            let (du, dv) = (2.0 * half * u, 2.0 * half * v);
            let uv = |p: Vec3| Vec2::new((p - center).dot(u.abs()), (p - center).dot(v.abs()));
            self.quad_uv(corner, du, dv, uv(corner), uv(corner + du + dv));
        }
    }

    /// Adds a box with sharp edges between two corners.
    pub(crate) fn block(&mut self, min: Vec3, max: Vec3) {
        self.cuboid(0.5 * (min + max), 0.5 * (max - min));
    }

    /// Adds a smoothly shaded box with rounded edges, for cushions and upholstery.
    pub(crate) fn soft_box(&mut self, center: Vec3, half: Vec3, radius: f32) {
        let radius = radius.min(0.98 * half.min_element()).max(1e-4);
        let inner = half - Vec3::splat(radius);
        const STEPS: i32 = 3;
        // Offsets of the bevel beyond the inner box, at equal angles of the normal.
        let bevel = |i: i32| radius * (FRAC_PI_4 * i as f32 / STEPS as f32).tan();
        let line = |h: f32| -> Vec<f32> {
            let inner = h - radius;
            let low = (0..=STEPS).rev().map(|i| -inner - bevel(i));
            low.chain((0..=STEPS).map(|i| inner + bevel(i))).collect()
        };
        for (axis, sign) in FACES {
            let (n, u, v) = face(axis, sign);
            let (lu, lv) = (line((half * u).dot(u)), line((half * v).dot(v)));
            let vertex = |a: f32, b: f32| {
                let on_cube = half * n + a * u + b * v;
                let core = on_cube.clamp(-inner, inner);
                let normal = (on_cube - core).normalize();
                let position = core + radius * normal;
                Vertex {
                    position: center + position,
                    normal,
                    uv: Vec2::new(position.dot(u.abs()), position.dot(v.abs())),
                }
            };
            for j in 0..lv.len() - 1 {
                for i in 0..lu.len() - 1 {
                    let (p, q) = (vertex(lu[i], lv[j]), vertex(lu[i + 1], lv[j]));
                    let (r, s) = (vertex(lu[i + 1], lv[j + 1]), vertex(lu[i], lv[j + 1]));
                    self.triangle([p, q, r]);
                    self.triangle([p, r, s]);
                }
            }
        }
    }

    /// Adds a surface of revolution around the vertical axis through `base`.
    ///
    /// `profile` lists radius and height from bottom to top. `smooth` interpolates normals along the height; otherwise
    /// the profile has hard edges.
    pub(crate) fn lathe(&mut self, base: Vec3, profile: &[(f32, f32)], sides: usize, smooth: bool) {
        let slope = |i: usize| {
            let (a, b) = (profile[i], profile[i + 1]);
            Vec2::new(b.1 - a.1, a.0 - b.0).normalize_or(Vec2::X)
        };
        let segments = profile.len() - 1;
        let mut along = 0.0;
        for i in 0..segments {
            let (low, high) = (profile[i], profile[i + 1]);
            let own = slope(i);
            let (mut n0, mut n1) = (own, own);
            if smooth {
                if i > 0 {
                    n0 = (own + slope(i - 1)).normalize_or(own);
                }
                if i + 1 < segments {
                    n1 = (own + slope(i + 1)).normalize_or(own);
                }
            }
            let step = Vec2::new(high.0 - low.0, high.1 - low.1).length();
            let widest = profile.iter().fold(0.0f32, |w, p| w.max(p.0));
            for k in 0..sides {
                let vertex = |side: usize, ring: (f32, f32), n: Vec2, v: f32| {
                    let turn = side as f32 / sides as f32;
                    let (s, c) = (TAU * turn).sin_cos();
                    Vertex {
                        position: base + Vec3::new(ring.0 * c, ring.1, ring.0 * s),
                        normal: Vec3::new(n.x * c, n.y, n.x * s),
                        uv: Vec2::new(TAU * widest * turn, v),
                    }
                };
                let p = vertex(k, low, n0, along);
                let q = vertex(k, high, n1, along + step);
                let r = vertex(k + 1, high, n1, along + step);
                let s = vertex(k + 1, low, n0, along);
                self.triangle([p, q, r]);
                self.triangle([p, r, s]);
            }
            along += step;
        }
    }

    /// Adds a ball.
    pub(crate) fn ball(&mut self, center: Vec3, radius: f32) {
        const RINGS: usize = 16;
        const SIDES: usize = 28;
        let vertex = |i: usize, k: usize| {
            let (st, ct) = (PI * i as f32 / RINGS as f32).sin_cos();
            let (sp, cp) = (TAU * k as f32 / SIDES as f32).sin_cos();
            let normal = Vec3::new(st * cp, ct, st * sp);
            Vertex {
                position: center + radius * normal,
                normal,
                uv: Vec2::new(TAU * radius * k as f32 / SIDES as f32, PI * radius * i as f32 / RINGS as f32),
            }
        };
        for i in 0..RINGS {
            for k in 0..SIDES {
                let (p, q) = (vertex(i, k), vertex(i, k + 1));
                let (r, s) = (vertex(i + 1, k + 1), vertex(i + 1, k));
                self.triangle([p, q, r]);
                self.triangle([p, r, s]);
            }
        }
    }

    /// Adds a round rod between two points, with flat ends.
    pub(crate) fn rod(&mut self, from: Vec3, to: Vec3, radius: f32) {
        const SIDES: usize = 12;
        let axis = (to - from).normalize();
        let (side, up) = axis.any_orthonormal_pair();
        let length = (to - from).length();
        let ring = |k: usize| {
            let turn = TAU * k as f32 / SIDES as f32;
            (side * turn.cos() + up * turn.sin(), turn * radius)
        };
        for k in 0..SIDES {
            let ((n0, u0), (n1, u1)) = (ring(k), ring(k + 1));
            let vertex = |end: Vec3, n: Vec3, uv: Vec2| Vertex { position: end + radius * n, normal: n, uv };
            let p = vertex(from, n0, Vec2::new(u0, 0.0));
            let q = vertex(from, n1, Vec2::new(u1, 0.0));
            let r = vertex(to, n1, Vec2::new(u1, length));
            let s = vertex(to, n0, Vec2::new(u0, length));
            self.triangle([p, q, r]);
            self.triangle([p, r, s]);
            for (end, normal) in [(from, -axis), (to, axis)] {
                let flat = |position: Vec3| Vertex { position, normal, uv: Vec2::ZERO };
                self.triangle([flat(end), flat(end + radius * n0), flat(end + radius * n1)]);
            }
        }
    }

    /// Adds a curved, smoothly shaded sheet over the unit square. `uv` is the extent of the texture.
    pub(crate) fn sheet(&mut self, nu: usize, nv: usize, uv: Vec2, surface: impl Fn(f32, f32) -> Vec3) {
        const STEP: f32 = 1e-3;
        let vertex = |i: usize, j: usize| {
            let (a, b) = (i as f32 / nu as f32, j as f32 / nv as f32);
            let du = surface(a + STEP, b) - surface(a - STEP, b);
            let dv = surface(a, b + STEP) - surface(a, b - STEP);
            Vertex { position: surface(a, b), normal: du.cross(dv).normalize_or(Vec3::Y), uv: Vec2::new(a, b) * uv }
        };
        for j in 0..nv {
            for i in 0..nu {
                let (p, q) = (vertex(i, j), vertex(i + 1, j));
                let (r, s) = (vertex(i + 1, j + 1), vertex(i, j + 1));
                self.triangle([p, q, r]);
                self.triangle([p, r, s]);
            }
        }
    }
}

const FACES: [(usize, f32); 6] = [(0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0), (2, 1.0), (2, -1.0)];

/// Returns the normal and two tangents of a face of a box, with `u × v = n`.
fn face(axis: usize, sign: f32) -> (Vec3, Vec3, Vec3) {
    let (n, u, v) = match axis {
        0 => (Vec3::X, Vec3::NEG_Z, Vec3::Y),
        1 => (Vec3::Y, Vec3::X, Vec3::NEG_Z),
        _ => (Vec3::Z, Vec3::X, Vec3::Y),
    };
    (n * sign, u * sign, v)
}
