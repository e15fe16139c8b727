//! Twin of the environment's stages: cubes, mips, lobes, lookups, smoothness, each written out as defined.
//!
//! Sums go over everything, neighbors past an edge are found by their directions, and adjoints follow from the weights of
//! the forward operators. What is a choice and not mathematics (levels, tables) it takes from
//! [`crate::shade::environment`].

use crate::shade::environment::latlong;
use crate::shade::environment::levels::Level;

/// Three numbers: a direction or a color.
pub type V3 = [f64; 3];

fn dot(a: V3, b: V3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn unit(a: V3) -> V3 {
    let length = dot(a, a).sqrt();
    a.map(|x| x / length)
}

/// A cube of colors, `6 size^2` of them: faces +x -x +y -y +z -z, rows downwards.
#[derive(Clone, Debug, PartialEq)]
pub struct Cube {
    /// Texels along a side.
    pub size: usize,
    /// Colors.
    pub texels: Vec<V3>,
}

impl Cube {
    /// From interleaved floats.
    pub fn from_floats(size: usize, floats: &[f32]) -> Cube {
        let texels = floats.chunks(3).map(|c| [c[0], c[1], c[2]].map(f64::from)).collect();
        Cube { size, texels }
    }

    /// Black.
    pub fn black(size: usize) -> Cube {
        Cube { size, texels: vec![[0.0; 3]; 6 * size * size] }
    }

    /// The numbers one after the other.
    pub fn flat(&self) -> Vec<f64> {
        self.texels.as_flattened().to_vec()
    }
}

/// A direction on a face at u, v in [-1, 1].
fn on_face(face: usize, u: f64, v: f64) -> V3 {
    match face {
        0 => [1.0, -v, -u],
        1 => [-1.0, -v, u],
        2 => [u, 1.0, v],
        3 => [u, -1.0, -v],
        4 => [u, -v, 1.0],
        _ => [-u, -v, -1.0],
    }
}

/// The face that a direction goes through, with u and v: the one of which `on_face` gives it back.
fn face_of(d: V3) -> (usize, f64, f64) {
    let m = d.iter().fold(0.0_f64, |a, x| a.max(x.abs()));
    let e = d.map(|x| x / m);
    for face in 0..6 {
        // u and v are what the direction has along the face's edges.
        let center = on_face(face, 0.0, 0.0);
        let along = |p: V3| dot(e, std::array::from_fn(|k| p[k] - center[k]));
        if dot(e, center) > 1.0 - 1e-12 {
            return (face, along(on_face(face, 1.0, 0.0)), along(on_face(face, 0.0, 1.0)));
        }
    }
    (0, 0.0, 0.0)
}

/// Unit direction of a texel's center.
pub fn direction(size: usize, texel: usize) -> V3 {
    let place = |i: usize| (2 * i + 1) as f64 / size as f64 - 1.0;
    let (x, y, face) = (texel % size, texel / size % size, texel / (size * size));
    unit(on_face(face, place(x), place(y)))
}

/// Solid angle of a texel, by subdividing it: an independent way to the closed form.
fn solid_angle(size: usize, texel: usize) -> f64 {
    let (x, y) = (texel % size, texel / size % size);
    // Gauss-Legendre with four points along each side.
    let nodes =
        [(0.861_136_311_594_052_6, 0.347_854_845_137_453_9), (0.339_981_043_584_856_3, 0.652_145_154_862_546_1)];
    let points =
        [(-nodes[0].0, nodes[0].1), (-nodes[1].0, nodes[1].1), (nodes[1].0, nodes[1].1), (nodes[0].0, nodes[0].1)];
    let half = 1.0 / size as f64;
    let center = |i: usize| (2 * i + 1) as f64 / size as f64 - 1.0;
    let mut sum = 0.0;
    for (p, wp) in points {
        for (q, wq) in points {
            let (u, v) = (center(x) + half * p, center(y) + half * q);
            sum += wp * wq * half * half * (1.0 + u * u + v * v).powf(-1.5);
        }
    }
    sum
}

/// Texels and weights of a lookup.
pub fn footprint(d: V3, size: usize) -> Vec<(usize, f64)> {
    let (face, u, v) = face_of(d);
    let n = size as f64;
    let (x, y) = ((0.5 * u + 0.5) * n - 0.5, (0.5 * v + 0.5) * n - 0.5);
    let (x0, y0) = (x.floor(), y.floor());
    let mut found = Vec::new();
    let mut lost = 0.0;
    for (dx, dy) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
        let weight = (1.0 - (x - x0 - dx).abs()) * (1.0 - (y - y0 - dy).abs());
        let (px, py) = ((2.0 * (x0 + dx) + 1.0) / n - 1.0, (2.0 * (y0 + dy) + 1.0) / n - 1.0);
        if px.abs() > 1.0 && py.abs() > 1.0 {
            lost = weight;
            continue;
        }
        // Past an edge the direction says which face and texel.
        let (f, u, v) = face_of(on_face(face, px, py));
        let index = |u: f64| (((0.5 * u + 0.5) * n).floor() as usize).min(size - 1);
        found.push(((f * size + index(v)) * size + index(u), weight));
    }
    let share = lost / found.len() as f64;
    found.iter_mut().for_each(|(_, w)| *w += share);
    found
}

/// Bilinear lookup.
pub fn lookup(cube: &Cube, d: V3) -> V3 {
    let mut sum = [0.0; 3];
    for (texel, w) in footprint(d, cube.size) {
        (0..3).for_each(|c| sum[c] += w * cube.texels[texel][c]);
    }
    sum
}

/// The mip of a size: means of square blocks.
pub fn mip(cube: &Cube, size: usize) -> Cube {
    let k = cube.size / size;
    let mut made = Cube::black(size);
    for (i, color) in cube.texels.iter().enumerate() {
        let (x, y, face) = (i % cube.size, i / cube.size % cube.size, i / (cube.size * cube.size));
        let to = &mut made.texels[(face * size + y / k) * size + x / k];
        (0..3).for_each(|c| to[c] += color[c] / (k * k) as f64);
    }
    made
}

/// Adjoint of [`mip`]: gradients of a cube of `size` from those of its mip.
pub fn mip_bwd(gradient: &Cube, size: usize) -> Cube {
    let k = size / gradient.size;
    let mut made = Cube::black(size);
    for (i, color) in made.texels.iter_mut().enumerate() {
        let (x, y, face) = (i % size, i / size % size, i / (size * size));
        let from = gradient.texels[(face * gradient.size + y / k) * gradient.size + x / k];
        *color = from.map(|g| g / (k * k) as f64);
    }
    made
}

/// The filter of a level, row by row.
pub struct Filter<'l> {
    level: &'l Level,
    directions: Vec<V3>,
    areas: Vec<f64>,
}

impl<'l> Filter<'l> {
    /// Of a level.
    pub fn new(level: &'l Level) -> Filter<'l> {
        let size = level.size as usize;
        let directions = (0..6 * size * size).map(|t| direction(size, t)).collect();
        Filter { level, directions, areas: (0..size * size).map(|t| solid_angle(size, t)).collect() }
    }

    /// Givers and weights, adding up to one, of a texel of the level.
    pub fn row(&self, texel: usize) -> Vec<(usize, f64)> {
        let to = self.directions[texel];
        let mut row = Vec::new();
        for (l, from) in self.directions.iter().enumerate() {
            let e: f64 = (0..3).map(|k| (from[k] - to[k]).powi(2)).sum();
            if e < self.level.cutoff {
                row.push((l, self.level.weight(e) * self.areas[l % self.areas.len()]));
            }
        }
        let sum: f64 = row.iter().map(|(_, w)| w).sum();
        row.iter_mut().for_each(|(_, w)| *w /= sum);
        row
    }
}

/// One texel of a level, from the mip of its size.
pub fn prefilter_texel(mip: &Cube, filter: &Filter<'_>, texel: usize) -> V3 {
    let mut sum = [0.0; 3];
    for (l, w) in filter.row(texel) {
        (0..3).for_each(|c| sum[c] += w * mip.texels[l][c]);
    }
    sum
}

/// A level from the environment.
pub fn prefilter(environment: &Cube, level: &Level) -> Cube {
    let source = mip(environment, level.size as usize);
    let filter = Filter::new(level);
    let texels = (0..source.texels.len()).map(|t| prefilter_texel(&source, &filter, t)).collect();
    Cube { size: source.size, texels }
}

/// Adjoint of [`prefilter`]: what a level's gradient is for the environment.
pub fn prefilter_bwd(gradient: &Cube, level: &Level, size: usize) -> Cube {
    let filter = Filter::new(level);
    let mut made = Cube::black(gradient.size);
    for (r, g) in gradient.texels.iter().enumerate() {
        for (l, w) in filter.row(r) {
            (0..3).for_each(|c| made.texels[l][c] += w * g[c]);
        }
    }
    mip_bwd(&made, size)
}

/// The integral that a level stands for, at one direction: the whole lobe over the texels of the environment itself, each
/// texel cut into `cuts` by `cuts`.
pub fn integral(environment: &Cube, roughness: f64, to: V3, cuts: usize) -> V3 {
    let square = roughness.powi(4);
    let size = environment.size * cuts;
    let (mut sum, mut weights) = ([0.0; 3], 0.0);
    for t in 0..6 * size * size {
        let l = direction(size, t);
        let c = dot(l, to);
        if c <= 0.0 {
            continue;
        }
        let sin2 = (0..3).map(|k| (l[k] - to[k]).powi(2)).sum::<f64>() / 4.0;
        let (x, y, face) = (t % size, t / size % size, t / (size * size));
        let place = |i: usize| (2 * i + 1) as f64 / size as f64 - 1.0;
        let area = (1.0 + place(x).powi(2) + place(y).powi(2)).powf(-1.5);
        let w = c * area / (square * (1.0 - sin2) + sin2).powi(2);
        let color = environment.texels[(face * environment.size + y / cuts) * environment.size + x / cuts];
        weights += w;
        (0..3).for_each(|k| sum[k] += w * color[k]);
    }
    sum.map(|s| s / weights)
}

/// A pixel's surface.
#[derive(Clone, Copy, Debug)]
pub struct Pixel {
    /// From the camera's place.
    pub point: V3,
    /// Unit or zero.
    pub normal: V3,
    /// Blended opacity.
    pub coverage: f64,
    /// Linear.
    pub albedo: V3,
    /// Square root of GGX's alpha.
    pub roughness: f64,
    /// 0 to 1.
    pub metallic: f64,
}

/// Where a roughness lies among levels.
pub fn level_of(roughness: f64, levels: usize) -> f64 {
    let last = levels as f64 - 2.0;
    if roughness < 0.5 { (roughness.max(0.08) - 0.08) / 0.42 * last } else { (roughness.min(1.0) - 0.5) / 0.5 + last }
}

/// Bilinear in the split-sum table, whose nodes lie at the ends.
pub fn split_sum(table: &[[f32; 2]], roughness: f64, nv: f64) -> [f64; 2] {
    let nodes = (table.len() as f64).sqrt() as usize;
    let last = (nodes - 1) as f64;
    let (x, y) = (nv.clamp(0.0, 1.0) * last, roughness.clamp(0.0, 1.0) * last);
    let mut sum = [0.0; 2];
    for (k, entry) in table.iter().enumerate() {
        let w = (1.0 - (x - (k % nodes) as f64).abs()).max(0.0) * (1.0 - (y - (k / nodes) as f64).abs()).max(0.0);
        (0..2).for_each(|c| sum[c] += w * f64::from(entry[c]));
    }
    sum
}

/// The filtered environment on a surface that a camera sees.
pub fn shade(levels: &[Cube], table: &[[f32; 2]], camera: V3, p: &Pixel) -> V3 {
    if p.coverage < 1e-3 || p.normal == [0.0; 3] {
        return [0.0; 3];
    }
    let view = unit(std::array::from_fn(|k| camera[k] - p.point[k]));
    let facing = dot(p.normal, view);
    let mirrored = std::array::from_fn(|k| 2.0 * facing.max(0.0) * p.normal[k] - view[k]);
    let level = level_of(p.roughness, levels.len());
    let first = (level.floor() as usize).min(levels.len() - 2);
    let part = level - first as f64;
    let (sharp, blurred) = (lookup(&levels[first], mirrored), lookup(&levels[first + 1], mirrored));
    let irradiance = lookup(&levels[levels.len() - 1], p.normal);
    let [a, b] = split_sum(table, p.roughness, facing.clamp(1e-4, 1.0));
    std::array::from_fn(|c| {
        let f0 = 0.04 * (1.0 - p.metallic) + p.metallic * p.albedo[c];
        let reflected = (1.0 - part) * sharp[c] + part * blurred[c];
        (1.0 - p.metallic) * p.albedo[c] * irradiance[c] + reflected * (f0 * a + b)
    })
}

/// The part of [`shade`] that is diffuse.
pub fn shade_diffuse(levels: &[Cube], p: &Pixel) -> V3 {
    if p.coverage < 1e-3 || p.normal == [0.0; 3] {
        return [0.0; 3];
    }
    let irradiance = lookup(&levels[levels.len() - 1], p.normal);
    std::array::from_fn(|c| (1.0 - p.metallic) * p.albedo[c] * irradiance[c])
}

/// Adjoint of [`shade`] by the levels: adds what a pixel's gradient gives to each.
pub fn shade_bwd(levels: &mut [Cube], table: &[[f32; 2]], camera: V3, p: &Pixel, gradient: V3) {
    // Shading is linear in the levels: its coefficients are what it makes of single colors.
    if p.coverage < 1e-3 || p.normal == [0.0; 3] {
        return;
    }
    let view = unit(std::array::from_fn(|k| camera[k] - p.point[k]));
    let facing = dot(p.normal, view);
    let mirrored = std::array::from_fn(|k| 2.0 * facing.max(0.0) * p.normal[k] - view[k]);
    let level = level_of(p.roughness, levels.len());
    let first = (level.floor() as usize).min(levels.len() - 2);
    let part = level - first as f64;
    let [a, b] = split_sum(table, p.roughness, facing.clamp(1e-4, 1.0));
    let last = levels.len() - 1;
    let f0 = p.albedo.map(|x| 0.04 * (1.0 - p.metallic) + p.metallic * x);
    let mut give = |level: usize, d: V3, by: V3| {
        for (texel, w) in footprint(d, levels[level].size) {
            (0..3).for_each(|c| levels[level].texels[texel][c] += w * by[c]);
        }
    };
    let by_reflected: V3 = std::array::from_fn(|c| gradient[c] * (f0[c] * a + b));
    give(first, mirrored, by_reflected.map(|x| (1.0 - part) * x));
    give(first + 1, mirrored, by_reflected.map(|x| part * x));
    give(last, p.normal, std::array::from_fn(|c| gradient[c] * (1.0 - p.metallic) * p.albedo[c]));
}

/// Mean squared difference of neighbors, down and to the right (which closes around), of the map of a cube.
pub fn smoothness(cube: &Cube, size: [u32; 2]) -> f64 {
    let [w, h] = size;
    let at = |x: u32, y: u32| lookup(cube, latlong::direction(size, x % w, y));
    let square = |a: V3, b: V3| (0..3).map(|c| (a[c] - b[c]).powi(2)).sum::<f64>();
    let map: Vec<V3> = (0..w * h).map(|i| at(i % w, i / w)).collect();
    let (mut across, mut down) = (0.0, 0.0);
    for y in 0..h {
        for x in 0..w {
            let here = map[(y * w + x) as usize];
            across += square(here, map[(y * w + (x + 1) % w) as usize]);
            if y + 1 < h {
                down += square(here, map[((y + 1) * w + x) as usize]);
            }
        }
    }
    across / (3.0 * f64::from(w * h)) + down / (3.0 * f64::from(w * (h - 1)))
}

/// Direction that a pixel of a camera looks along. `pose`: rows of the world-to-camera matrix.
pub fn ray(pose: &[[f32; 4]; 3], focal: [f32; 2], center: [f32; 2], pixel: [u32; 2]) -> V3 {
    let in_camera: V3 = [
        (f64::from(pixel[0]) + 0.5 - f64::from(center[0])) / f64::from(focal[0]),
        (f64::from(pixel[1]) + 0.5 - f64::from(center[1])) / f64::from(focal[1]),
        1.0,
    ];
    std::array::from_fn(|k| (0..3).map(|r| f64::from(pose[r][k]) * in_camera[r]).sum())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::rng::Pcg;
    use crate::shade::environment::levels::{PRODUCTS, levels};
    use crate::shade::environment::{cube, form};

    #[test]
    fn lookups_of_both_kinds_are_the_same() {
        let mut rng = Pcg::new(9);
        for size in [16, 64, 512] {
            for _ in 0..500 {
                let mut d = [rng.normal(), rng.normal(), rng.normal()];
                // Near corners and edges as well.
                match rng.next_u32() % 3 {
                    0 => d = d.map(|x| x.signum() * (1.0 + 0.01 * rng.normal())),
                    1 => d[0] = d[1] * (1.0 + 0.005 * rng.normal()),
                    _ => {}
                }
                let other = cube::Footprint::of(d, size);
                for (texel, w) in footprint(d, size as usize) {
                    let of = |t: &u32| *t as usize == texel;
                    let theirs: f64 = (0..4).filter(|k| of(&other.texels[*k])).map(|k| other.weights[k]).sum();
                    assert!((theirs - w).abs() < 1e-9, "{size} {d:?}: {theirs} {w}");
                }
            }
        }
        for texel in [0, 7, 133, 255] {
            let closed = cube::solid_angle(16, texel as u32 % 16, texel as u32 / 16);
            assert!((solid_angle(16, texel) / closed - 1.0).abs() < 1e-8);
        }
    }

    #[test]
    fn the_quadratic_form_is_the_mean_over_the_map() {
        let mut rng = Pcg::new(4);
        for map in [[64, 32], [128, 64]] {
            let cube = Cube { size: 16, texels: (0..1536).map(|_| [rng.uniform(), rng.normal(), 7.0]).collect() };
            let f = form::form(16, map);
            let mut value = 0.0;
            for i in 0..1536 {
                for [j, q] in &f.entries[f.starts[i] as usize..f.starts[i + 1] as usize] {
                    let difference: f64 =
                        (0..3).map(|c| (cube.texels[i][c] - cube.texels[*j as usize][c]).powi(2)).sum();
                    value -= 0.5 * f64::from(f32::from_bits(*q)) * difference;
                }
            }
            let expected = smoothness(&cube, map);
            assert!((value / expected - 1.0).abs() < 1e-6, "{value} {expected}");
        }
    }

    #[test]
    fn levels_are_near_the_integrals_that_they_stand_for() {
        // An environment as rooms have it: a window, a lamp, a gradient.
        let size = 64;
        let color = |d: V3| {
            let window = if d[0] > 0.8 && d[1].abs() < 0.4 { 12.0 } else { 0.0 };
            let lamp = 40.0 * (30.0 * (d[1] - 1.0)).exp();
            [0.3 + 0.2 * d[1] + window, 0.3 + lamp, 0.4 + 0.1 * d[2] + window]
        };
        let cube = Cube { size, texels: (0..6 * size * size).map(|t| color(direction(size, t))).collect() };
        let mean = cube.texels.iter().map(|c| c[0]).sum::<f64>() / cube.texels.len() as f64;
        for level in levels(size as u32, PRODUCTS).iter().skip(1) {
            let made = prefilter(&cube, level);
            let (mut worst, mut squares) = (0.0_f64, 0.0);
            let mut rng = Pcg::new(5);
            let samples = 40;
            for _ in 0..samples {
                // Anywhere, so that the resolution counts as well.
                let d = unit([rng.normal(), rng.normal(), rng.normal()]);
                let exact = integral(&cube, level.roughness, d, 1);
                let error = (lookup(&made, d)[0] - exact[0]).abs() / (mean + exact[0]);
                worst = worst.max(error);
                squares += error * error;
            }
            let rms = (squares / f64::from(samples)).sqrt();
            println!(
                "roughness {:.2}: {}, share {:.4}, rms {rms:.4}, worst {worst:.4}",
                level.roughness, level.size, level.share
            );
            assert!(rms < 0.08 && worst < 0.25, "{level:?}: {rms} {worst}");
        }
    }
}
