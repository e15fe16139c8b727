//! Light from outside of a room: openings, and the environment behind them.
//!
//! Light from outside is directional light, and that of windows. It reaches a point only along rays that meet no surfel and
//! leave the room through an opening. Without openings, directional light is dark.

use super::{AreaLight, AreaLightError, LightShape};
use glam::{DQuat, DVec3, Vec3};
use sgs_engine::exec::Executor;
use sgs_engine::graph::{Buffer, Graph};
use sgs_engine::{Device, DeviceBuffer, Location, Result};
use sgs_shaders::structs::LightRecord;
use std::f64::consts::{PI, TAU};

/// Maximum number of columns and rows of the environment on the device.
pub const SKY_SIZE: [u32; 2] = [64, 32];
/// Sample points along each side of a texel of a rotated map.
const TURNED_SAMPLES: u32 = 4;
/// Sample points along each side of an opening's hemisphere in [`Sky::mean`].
const MEAN_SAMPLES: u32 = 64;

/// Rectangle through which light from outside enters a room.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Opening {
    /// Corner where both edges begin.
    pub corner: [f32; 3],
    /// First edge.
    pub edge_u: [f32; 3],
    /// Second edge, perpendicular to the first. `edge_u` x `edge_v` points into the room.
    pub edge_v: [f32; 3],
}

impl Opening {
    /// Returns the rectangle as a light that shines into the room.
    fn rectangle(&self) -> AreaLight {
        let Opening { corner, edge_u, edge_v } = *self;
        AreaLight { shape: LightShape::Rectangle { corner, edge_u, edge_v }, color: [1.0; 3] }
    }

    /// Returns the six faces of a cube around the origin, of this half edge: light from outside enters on all sides.
    pub fn around(half: f32) -> [Opening; 6] {
        std::array::from_fn(|face| {
            let (axis, inward) = (face / 2, if face % 2 == 0 { 1.0 } else { -1.0 });
            let edge = |k: usize, length: f32| std::array::from_fn(|i| if i == (axis + k) % 3 { length } else { 0.0 });
            let mut corner = [-half; 3];
            corner[axis] = -inward * half;
            // Of a right-handed pair, the first edge is turned where the normal is.
            corner[(axis + 1) % 3] = -inward * half;
            Opening { corner, edge_u: edge(1, 2.0 * inward * half), edge_v: edge(2, 2.0 * half) }
        })
    }

    /// Checks that the opening is valid.
    ///
    /// # Errors
    /// If a number is not finite, an edge has no length, or the edges are not perpendicular.
    pub fn check(&self) -> std::result::Result<(), AreaLightError> {
        self.rectangle().check()
    }

    /// Returns the opening in another unit of length: lengths are multiplied by `factor`.
    #[must_use]
    pub fn scaled(&self, factor: f32) -> Opening {
        let by = |v: [f32; 3]| v.map(|x| factor * x);
        Opening { corner: by(self.corner), edge_u: by(self.edge_u), edge_v: by(self.edge_v) }
    }

    /// Returns the unit normal, which points into the room; zero without an area.
    pub fn normal(&self) -> [f32; 3] {
        self.record().normal
    }

    /// Returns the record of the device.
    pub fn record(&self) -> LightRecord {
        self.rectangle().record()
    }
}

/// Latitude-longitude map of the radiance from outside, linear red, green, blue. The layout is that of files
/// ([`crate::shade::environment::latlong`]).
#[derive(Clone, Debug, PartialEq)]
pub struct Sky {
    size: [u32; 2],
    data: Vec<f32>,
}

impl Sky {
    /// Prefilters a map by a box to [`SKY_SIZE`] at most. `map` holds three floats per pixel.
    ///
    /// Returns `None` if the map is empty, has another length, or a number is negative or not finite.
    pub fn new(map: &[f32], size: [u32; 2]) -> Option<Sky> {
        let pixels = u64::from(size[0]) * u64::from(size[1]);
        if pixels == 0 || map.len() as u64 != 3 * pixels || map.iter().any(|v| !(v.is_finite() && *v >= 0.0)) {
            return None;
        }
        let small = [size[0].min(SKY_SIZE[0]), size[1].min(SKY_SIZE[1])];
        if small == size {
            return Some(Sky { size, data: map.to_vec() });
        }
        let [columns, rows] = [0, 1].map(|k| shares(size[k], small[k]));
        let mut data = Vec::with_capacity(3 * (small[0] * small[1]) as usize);
        for down in &rows {
            for across in &columns {
                let mut sum = [0.0; 3];
                for (row, a) in down {
                    for (column, b) in across {
                        let at = 3 * (row * size[0] as usize + column);
                        (0..3).for_each(|c| sum[c] += a * b * f64::from(map[at + c]));
                    }
                }
                data.extend(sum.map(|v| v as f32));
            }
        }
        Some(Sky { size: small, data })
    }

    /// Returns a map that is the same in all directions.
    pub fn uniform(color: [f32; 3]) -> Sky {
        Sky { size: [1, 1], data: color.to_vec() }
    }

    /// Returns columns and rows.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Returns the radiances, `[rows * columns * 3]` floats.
    pub fn data(&self) -> &[f32] {
        &self.data
    }

    /// Returns the map with factors on red, green and blue.
    #[must_use]
    pub fn tinted(mut self, factors: [f32; 3]) -> Sky {
        self.data.chunks_exact_mut(3).for_each(|t| t.iter_mut().zip(factors).for_each(|(v, f)| *v *= f));
        self
    }

    /// Rotates the map: radiance from direction d then arrives from the rotated direction.
    #[must_use]
    pub fn turned(&self, by: DQuat) -> Sky {
        let (back, fine) = (by.inverse(), self.size.map(|n| n * TURNED_SAMPLES));
        let mut data = Vec::with_capacity(self.data.len());
        for row in 0..self.size[1] {
            for column in 0..self.size[0] {
                let mut sum = [0.0; 3];
                for s in 0..TURNED_SAMPLES * TURNED_SAMPLES {
                    let at = [column * TURNED_SAMPLES + s % TURNED_SAMPLES, row * TURNED_SAMPLES + s / TURNED_SAMPLES];
                    let d = crate::shade::environment::latlong::direction(fine, at[0], at[1]);
                    let value = self.radiance((back * DVec3::from(d)).to_array());
                    (0..3).for_each(|c| sum[c] += value[c]);
                }
                data.extend(sum.map(|v| (v / f64::from(TURNED_SAMPLES * TURNED_SAMPLES)) as f32));
            }
        }
        Sky { size: self.size, data }
    }

    /// Returns the radiance that arrives from a direction of any length.
    ///
    /// In double precision: the reference of `sky_radiance` in `outside.glsl`.
    pub fn radiance(&self, d: [f64; 3]) -> [f64; 3] {
        let [w, h] = self.size.map(f64::from);
        let (theta, phi) = (d[0].hypot(d[2]).atan2(d[1]), d[0].atan2(-d[2]));
        let (x, y) = ((phi / TAU + 0.5) * w - 0.5, (theta / PI * h - 0.5).clamp(0.0, h - 1.0));
        let (left, top) = (x.floor(), y.floor());
        let columns = [0, 1].map(|k| (left as i64 + k).rem_euclid(i64::from(self.size[0])) as usize);
        let rows = [top as usize, (top as usize + 1).min(self.size[1] as usize - 1)];
        let (tx, ty) = (x - left, y - top);
        std::array::from_fn(|c| {
            let at = |k: usize, l: usize| f64::from(self.data[3 * (rows[l] * self.size[0] as usize + columns[k]) + c]);
            (1.0 - ty) * ((1.0 - tx) * at(0, 0) + tx * at(1, 0)) + ty * ((1.0 - tx) * at(0, 1) + tx * at(1, 1))
        })
    }

    /// Returns the mean radiance of a window, weighted by the cosine.
    ///
    /// `normal` is its unit normal. It emits what arrives from the other side.
    pub fn mean(&self, normal: [f32; 3]) -> [f32; 3] {
        let axis = -Vec3::from(normal).as_dvec3().normalize_or_zero();
        let (u, v) = axis.any_orthonormal_pair();
        let mut sum = [0.0; 3];
        for i in 0..MEAN_SAMPLES * MEAN_SAMPLES {
            let [a, b] = [i % MEAN_SAMPLES, i / MEAN_SAMPLES].map(|k| (f64::from(k) + 0.5) / f64::from(MEAN_SAMPLES));
            let ((sin, cos), r) = ((TAU * b).sin_cos(), a.sqrt());
            let d = u * (r * cos) + v * (r * sin) + axis * (1.0 - a).sqrt();
            let value = self.radiance(d.to_array());
            (0..3).for_each(|c| sum[c] += value[c]);
        }
        sum.map(|v| (v / f64::from(MEAN_SAMPLES * MEAN_SAMPLES)) as f32)
    }
}

/// Returns the cells of `from` in each of `to` boxes, and their shares of it.
fn shares(from: u32, to: u32) -> Vec<Vec<(usize, f64)>> {
    let width = f64::from(from) / f64::from(to);
    let of = |i: u32| {
        let (low, high) = (f64::from(i) * width, f64::from(i + 1) * width);
        let cells = low.floor() as u32..(high.ceil() as u32).min(from);
        let share = |k: u32| (f64::from(k + 1).min(high) - f64::from(k).max(low)).max(0.0) / width;
        cells.map(|k| (k as usize, share(k))).collect()
    };
    (0..to).map(of).collect()
}

/// Openings of a room, and the environment behind them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Outside {
    /// Openings.
    pub openings: Vec<Opening>,
    /// Environment; without one, windows emit their color in all directions.
    pub sky: Option<Sky>,
}

/// Properties of an [`Outside`] that graphs need.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutsideShape {
    /// Number of openings.
    pub openings: u32,
    /// Columns and rows of the environment.
    pub sky: [u32; 2],
}

/// Openings and environment as inputs of a graph.
#[derive(Clone, Copy, Debug)]
pub struct OutsideHandles {
    /// Records of the openings, those of rectangles.
    pub openings: Buffer,
    /// Radiances, `[rows * columns * 3]` floats.
    pub sky: Buffer,
    /// Sizes.
    pub shape: OutsideShape,
}

impl Outside {
    /// Returns the properties that graphs need.
    pub fn shape(&self) -> OutsideShape {
        OutsideShape { openings: self.openings.len() as u32, sky: self.sky.as_ref().map_or([1, 1], Sky::size) }
    }

    /// Declares the inputs of a graph.
    pub fn declare(&self, g: &mut Graph) -> OutsideHandles {
        OutsideHandles::declare(g, self.shape())
    }

    /// Returns the contents that the host uploads once.
    ///
    /// Without openings, the first buffer has one zeroed record, as a buffer cannot be empty.
    pub fn contents(&self, handles: &OutsideHandles) -> [(Buffer, Vec<u8>); 2] {
        let mut records: Vec<LightRecord> = self.openings.iter().map(Opening::record).collect();
        records.resize(records.len().max(1), bytemuck::Zeroable::zeroed());
        let white = Sky::uniform([1.0; 3]);
        let sky = self.sky.as_ref().unwrap_or(&white);
        let records = bytemuck::cast_slice(&records).to_vec();
        [(handles.openings, records), (handles.sky, bytemuck::cast_slice(&sky.data).to_vec())]
    }
}

impl OutsideHandles {
    /// Declares the inputs of a graph.
    pub fn declare(g: &mut Graph, shape: OutsideShape) -> OutsideHandles {
        let records = size_of::<LightRecord>() as u64 * u64::from(shape.openings.max(1));
        let texels = u64::from(shape.sky[0]) * u64::from(shape.sky[1]);
        OutsideHandles { openings: g.input("openings", records), sky: g.input("sky", 12 * texels), shape }
    }
}

/// Openings and environment in device memory.
#[derive(Clone, Debug)]
pub struct OutsideMemory {
    buffers: [DeviceBuffer; 2],
    shape: OutsideShape,
}

impl OutsideMemory {
    /// Uploads openings and environment.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(device: &Device, outside: &Outside) -> Result<OutsideMemory> {
        // This graph never runs. Its handles only label the contents.
        let handles = outside.declare(&mut Graph::new("outside"));
        let [(_, records), (_, texels)] = outside.contents(&handles);
        let put = |name: &str, bytes: &[u8]| -> Result<DeviceBuffer> {
            let buffer = device.buffer(name, bytes.len() as u64, Location::Device)?;
            device.upload(&buffer, 0, bytes)?;
            Ok(buffer)
        };
        Ok(OutsideMemory { buffers: [put("openings", &records)?, put("sky", &texels)?], shape: outside.shape() })
    }

    /// Returns the sizes.
    pub fn shape(&self) -> OutsideShape {
        self.shape
    }

    /// Binds the buffers to their handles.
    ///
    /// # Errors
    /// If the plan was built for other sizes.
    pub fn bind(&self, exec: &mut Executor, handles: &OutsideHandles) -> Result<()> {
        exec.bind(handles.openings, &self.buffers[0])?;
        exec.bind(handles.sky, &self.buffers[1])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shade::environment::latlong::direction;

    fn map(size: [u32; 2], of: impl Fn([f64; 3]) -> f64) -> Vec<f32> {
        let pixels = (0..size[1]).flat_map(|row| (0..size[0]).map(move |column| (column, row)));
        pixels.flat_map(|(x, y)| [0, 1, 2].map(|c| (of(direction(size, x, y)) * f64::from(c + 1)) as f32)).collect()
    }

    #[test]
    fn box_filter_keeps_means_and_constants() {
        for size in [[512, 256], [100, 50], [64, 33], [7, 3]] {
            let values: Vec<f32> = (0..3 * size[0] * size[1]).map(|i| (i * 7919 % 1009) as f32).collect();
            let sky = Sky::new(&values, size).unwrap();
            assert_eq!(sky.size(), [size[0].min(64), size[1].min(32)]);
            let mean = |v: &[f32]| v.iter().map(|x| f64::from(*x)).sum::<f64>() / v.len() as f64;
            assert!((mean(&values) - mean(sky.data())).abs() < 1e-3, "{size:?}");
            let constant = Sky::new(&vec![0.3; values.len()], size).unwrap();
            assert!(constant.data().iter().all(|v| (v - 0.3).abs() < 1e-6));
        }
        assert_eq!(Sky::new(&[], [0, 0]), None);
        assert_eq!(Sky::new(&[1.0; 3], [2, 1]), None);
        assert_eq!(Sky::new(&[1.0, -1.0, 0.0], [1, 1]), None);
        assert_eq!(Sky::new(&[1.0, f32::NAN, 0.0], [1, 1]), None);
    }

    #[test]
    fn lookup_rotation_and_mean_match_the_function() {
        let of = |d: [f64; 3]| 1.0 + 0.5 * d[0] + 0.3 * d[1] - 0.1 * d[2];
        let sky = Sky::new(&map([256, 128], of), [256, 128]).unwrap();
        let turned = sky.turned(DQuat::from_axis_angle(DVec3::Y, 90_f64.to_radians()));
        for d in [[1.0, 0.0, 0.0], [0.0, 0.6, 0.8], [-0.6, 0.0, -0.8], [0.0, -1.0, 0.0], [0.6, 0.8, 0.0]] {
            let right = of(d);
            let found = sky.radiance(d.map(|x| 3.0 * x));
            assert!((0..3).all(|c| (found[c] - right * (c + 1) as f64).abs() < 0.02 * right), "{d:?}: {found:?}");
            // A quarter turn about +y maps +x to -z, so that direction d sees what [-z, y, x] saw.
            let right = of([-d[2], d[1], d[0]]);
            assert!((turned.radiance(d)[0] - right).abs() < 0.04, "{d:?}");
        }
        // Of a linear function, the cosine-weighted mean is that at two thirds of the axis.
        let found = sky.mean([0.0, 0.0, 1.0]);
        assert!((f64::from(found[0]) - of([0.0, 0.0, -2.0 / 3.0])).abs() < 0.01, "{found:?}");
        assert_eq!(Sky::uniform([1.0, 2.0, 3.0]).tinted([2.0, 0.0, 1.0]).mean([0.0, 1.0, 0.0]), [2.0, 0.0, 3.0]);
    }

    #[test]
    fn faces_of_a_cube_point_inward() {
        for (face, opening) in Opening::around(2.0).iter().enumerate() {
            let normal = Vec3::from(opening.normal());
            let (u, v) = (Vec3::from(opening.edge_u), Vec3::from(opening.edge_v));
            let center = Vec3::from(opening.corner) + 0.5 * (u + v);
            assert!(center.distance(-2.0 * normal) < 1e-6 && u.length() == 4.0 && v.length() == 4.0, "{face}");
            assert_eq!(normal[face / 2], if face % 2 == 0 { 1.0 } else { -1.0 });
        }
    }

    #[test]
    fn openings_are_checked_as_rectangles() {
        let opening = |edge_v| Opening { corner: [0.0; 3], edge_u: [1.0, 0.0, 0.0], edge_v };
        assert_eq!(opening([0.0, 2.0, 0.0]).check(), Ok(()));
        assert_eq!(opening([0.0, 2.0, 0.0]).normal(), [0.0, 0.0, 1.0]);
        assert!(opening([0.0; 3]).check().is_err() && opening([1.0, 1.0, 0.0]).check().is_err());
        assert_eq!(opening([0.0; 3]).normal(), [0.0; 3]);
    }
}
