//! Reference of the environment map's stages, written out as defined. The stages are cubes, mips, lobes, lookups and
//! smoothness.
//!
//! Sums run over everything, neighbors past an edge are found by their directions, and adjoints follow from the weights
//! of the forward operators. Design choices (levels, tables) come from [`crate::shade::environment`].

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

/// Cube of `6 size^2` colors: faces +x -x +y -y +z -z, rows downwards.
#[derive(Clone, Debug, PartialEq)]
pub struct Cube {
    /// Texels along a side.
    pub size: usize,
    /// Colors.
    pub texels: Vec<V3>,
}

impl Cube {
    /// Converts interleaved floats to a cube.
    pub fn from_floats(size: usize, floats: &[f32]) -> Cube {
        let texels = floats.chunks(3).map(|c| [c[0], c[1], c[2]].map(f64::from)).collect();
        Cube { size, texels }
    }

    /// Returns a black cube.
    pub fn black(size: usize) -> Cube {
        Cube { size, texels: vec![[0.0; 3]; 6 * size * size] }
    }

    /// Returns the interleaved numbers.
    pub fn flat(&self) -> Vec<f64> {
        self.texels.as_flattened().to_vec()
    }
}

/// Returns a direction on a face at u, v in [-1, 1].
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

/// Returns the face that a direction intersects, with u and v. Inverse of `on_face`.
fn face_of(d: V3) -> (usize, f64, f64) {
    let m = d.iter().fold(0.0_f64, |a, x| a.max(x.abs()));
    let e = d.map(|x| x / m);
    for face in 0..6 {
        // u and v are the components of the direction along the face's edges.
        let center = on_face(face, 0.0, 0.0);
        let along = |p: V3| dot(e, std::array::from_fn(|k| p[k] - center[k]));
        if dot(e, center) > 1.0 - 1e-12 {
            return (face, along(on_face(face, 1.0, 0.0)), along(on_face(face, 0.0, 1.0)));
        }
    }
    (0, 0.0, 0.0)
}

/// Returns the unit direction of a texel's center.
pub fn direction(size: usize, texel: usize) -> V3 {
    let place = |i: usize| (2 * i + 1) as f64 / size as f64 - 1.0;
    let (x, y, face) = (texel % size, texel / size % size, texel / (size * size));
    unit(on_face(face, place(x), place(y)))
}

/// Returns the solid angle of a texel by quadrature. An independent check of the closed form.
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

/// Returns the texels and weights of a lookup.
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
        // Past an edge, the direction determines the face and texel.
        let (f, u, v) = face_of(on_face(face, px, py));
        let index = |u: f64| (((0.5 * u + 0.5) * n).floor() as usize).min(size - 1);
        found.push(((f * size + index(v)) * size + index(u), weight));
    }
    let share = lost / found.len() as f64;
    found.iter_mut().for_each(|(_, w)| *w += share);
    found
}

/// Looks up a cube bilinearly.
pub fn lookup(cube: &Cube, d: V3) -> V3 {
    let mut sum = [0.0; 3];
    for (texel, w) in footprint(d, cube.size) {
        (0..3).for_each(|c| sum[c] += w * cube.texels[texel][c]);
    }
    sum
}

/// Returns the mip of a size: means of square blocks.
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

/// Computes the adjoint of [`mip`]. Returns the gradients of a cube of `size` from those of its mip.
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

/// Filter of a level, evaluated row by row.
pub struct Filter<'l> {
    level: &'l Level,
    directions: Vec<V3>,
    areas: Vec<f64>,
}

impl<'l> Filter<'l> {
    /// Creates the filter of a level.
    pub fn new(level: &'l Level) -> Filter<'l> {
        let size = level.size as usize;
        let directions = (0..6 * size * size).map(|t| direction(size, t)).collect();
        Filter { level, directions, areas: (0..size * size).map(|t| solid_angle(size, t)).collect() }
    }

    /// Returns the source texels and weights of a texel of the level. The weights add up to one.
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

/// Returns one texel of a level, from the mip of its size.
pub fn prefilter_texel(mip: &Cube, filter: &Filter<'_>, texel: usize) -> V3 {
    let mut sum = [0.0; 3];
    for (l, w) in filter.row(texel) {
        (0..3).for_each(|c| sum[c] += w * mip.texels[l][c]);
    }
    sum
}

/// Filters an environment map to a level.
pub fn prefilter(environment: &Cube, level: &Level) -> Cube {
    let source = mip(environment, level.size as usize);
    let filter = Filter::new(level);
    let texels = (0..source.texels.len()).map(|t| prefilter_texel(&source, &filter, t)).collect();
    Cube { size: source.size, texels }
}

/// Computes the adjoint of [`prefilter`]. Returns the gradient of the environment map from that of a level.
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

/// Returns the exact integral that a level approximates, at one direction. The integral covers the whole lobe over the
/// texels of the environment map itself, each split into `cuts` by `cuts`.
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

/// Surface of a pixel.
#[derive(Clone, Copy, Debug)]
pub struct Pixel {
    /// Point, in the coordinates of the camera's position.
    pub point: V3,
    /// Unit normal or zero.
    pub normal: V3,
    /// Blended opacity.
    pub coverage: f64,
    /// Linear albedo.
    pub albedo: V3,
    /// Square root of GGX's alpha.
    pub roughness: f64,
    /// Metallic, 0 to 1.
    pub metallic: f64,
}

/// Returns the fractional level of a roughness.
pub fn level_of(roughness: f64, levels: usize) -> f64 {
    let last = levels as f64 - 2.0;
    if roughness < 0.5 { (roughness.max(0.08) - 0.08) / 0.42 * last } else { (roughness.min(1.0) - 0.5) / 0.5 + last }
}

/// Looks up the split-sum table bilinearly; nodes include both ends of each axis.
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

/// Shades a surface by the filtered environment map.
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

/// Returns the diffuse term of [`shade`].
pub fn shade_diffuse(levels: &[Cube], p: &Pixel) -> V3 {
    if p.coverage < 1e-3 || p.normal == [0.0; 3] {
        return [0.0; 3];
    }
    let irradiance = lookup(&levels[levels.len() - 1], p.normal);
    std::array::from_fn(|c| (1.0 - p.metallic) * p.albedo[c] * irradiance[c])
}

/// Computes the adjoint of [`shade`] by the levels. Adds a pixel's gradient to each level.
pub fn shade_bwd(levels: &mut [Cube], table: &[[f32; 2]], camera: V3, p: &Pixel, gradient: V3) {
    // Shading is linear in the levels: its coefficients are the responses to single colors.
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

/// Returns the mean squared difference of neighbors in the map of a cube. Neighbors are those below and to the right.
/// The map wraps around to the right.
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

/// Returns the direction of a camera's pixel. `pose` holds the rows of the world-to-camera matrix.
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
    use crate::rng::Pcg;
    use crate::shade::environment::levels::{PRODUCTS, levels};
    use crate::shade::environment::{cube, form};

    #[test]
    fn lookups_match_the_tables() {
        let mut rng = Pcg::new(9);
        for size in [16, 64, 512] {
            for _ in 0..500 {
                let mut d = [rng.normal(), rng.normal(), rng.normal()];
                // Includes directions near corners and edges.
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
    fn quadratic_form_matches_mean_over_map() {
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
    fn levels_approximate_their_integrals() {
        // An environment map like a room: a window, a light, a gradient.
        let size = 64;
        let color = |d: V3| {
            let window = if d[0] > 0.8 && d[1].abs() < 0.4 { 12.0 } else { 0.0 };
            let light = 40.0 * (30.0 * (d[1] - 1.0)).exp();
            [0.3 + 0.2 * d[1] + window, 0.3 + light, 0.4 + 0.1 * d[2] + window]
        };
        let cube = Cube { size, texels: (0..6 * size * size).map(|t| color(direction(size, t))).collect() };
        let mean = cube.texels.iter().map(|c| c[0]).sum::<f64>() / cube.texels.len() as f64;
        for level in levels(size as u32, PRODUCTS).iter().skip(1) {
            let made = prefilter(&cube, level);
            let (mut worst, mut squares) = (0.0_f64, 0.0);
            let mut rng = Pcg::new(5);
            let samples = 40;
            for _ in 0..samples {
                // Arbitrary directions, so that the resolution matters as well.
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
