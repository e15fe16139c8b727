//! Physical lights in the published model, which shades points with lobes.
//!
//! Every light keeps its power. A sphere is a point; a spot and a lobe are one lobe; a rectangle and a disk are patches with
//! the lobe of a cosine.

use crate::error::{Result as Loaded, RunError};
use crate::light_list::{LightList, ListedLight, PhysicalRow, read_light_list};
use crate::lights::{LightFile, LightRow, LobeRow, MOST};
use glam::{DVec3, Vec3};
use sgs_passes::transport::{AreaLight, LightShape};
use std::f64::consts::PI;
use std::path::Path;

/// Sharpness of the lobe that approximates a cosine.
const COSINE_SHARPNESS: f64 = 2.133;

/// Sharpest lobe that shading supports.
const MOST_SHARPNESS: f64 = 13_359.0;

/// Patches along each side of a rectangle.
pub const PATCHES: u32 = 4;

/// Largest amplitude that shading supports.
pub const MOST_AMPLITUDE: f32 = 3.2e6;

impl LightList {
    /// Returns the lights as points with lobes.
    ///
    /// # Errors
    /// If a light is directional or too bright.
    pub fn published(&self) -> Result<LightFile, String> {
        let mut file = LightFile::new(self.normalizer, Vec::new());
        // Under a normalizer of 0, lights with lobes are dark. Physical lights are not.
        let dark = self.normalizer <= 0.0 && self.lights.iter().any(|l| matches!(l, ListedLight::Physical(_)));
        if dark {
            file.normalizer = 1.0;
        }
        for (i, light) in self.lights.iter().enumerate() {
            let rows = match light {
                ListedLight::Lobes(row) if dark => vec![LightRow { gain: 0.0, ..row.clone() }],
                ListedLight::Lobes(row) => vec![row.clone()],
                ListedLight::Physical(row) => {
                    published_light(row, file.normalizer).map_err(|e| format!("light {i} is {e}"))?
                }
            };
            file.push(rows);
            if file.lights.len() > MOST {
                return Err(format!(
                    "its lights have more than {MOST} points; a rectangle and a disk have {}",
                    PATCHES * PATCHES
                ));
            }
        }
        Ok(file)
    }
}

/// Reads `lights.json` of any version as points with lobes.
///
/// # Errors
/// If the file is missing or damaged, or a light is directional.
pub fn read_lights(path: &Path) -> Loaded<LightFile> {
    read_light_list(path)?.published().map_err(|reason| RunError::file(path, reason))
}

/// Converts a physical light to points with lobes.
///
/// # Errors
/// The cause, as part of a sentence: the light is directional or too bright.
pub fn published_light(light: &PhysicalRow, normalizer: f32) -> Result<Vec<LightRow>, String> {
    let PhysicalRow { shape, color, gain, .. } = *light;
    let power = (AreaLight { shape, color }).power().filter(|_| !matches!(shape, LightShape::Window { .. }));
    let Some(power) = power else {
        return Err(format!(
            "{}, which the published model does not shade; use an emitter of a run that the transport stage trained \
             (sgs train --stage transport)",
            if matches!(shape, LightShape::Window { .. }) { "a window" } else { "directional" }
        ));
    };
    let power = power.map(|p| f64::from(p) / f64::from(normalizer.max(1e-30)));
    let lobe = |axis: [f32; 3], sharpness: f64| {
        let sharpness = sharpness.min(MOST_SHARPNESS);
        // Axes of shapes follow the light; those of lobes point to it.
        let axis = (-Vec3::from(axis).as_dvec3().normalize_or_zero()).as_vec3().to_array();
        let amplitude = power.map(|p| (p / (4.0 * PI * mean(sharpness))) as f32);
        LobeRow { axis, sharpness: sharpness as f32, amplitude }
    };
    let one = |position, lobe| vec![LightRow { position, gain, lobes: vec![lobe] }];
    let patches = |corners: [Vec3; 4]| {
        let amplitude = color.map(|c| c / normalizer.max(1e-30));
        let rows = rectangle_patches(corners.map(|c| c.to_array()), amplitude, PATCHES).into_iter();
        rows.map(|row| LightRow { gain, ..row }).collect()
    };
    let rows: Vec<LightRow> = match shape {
        LightShape::Point { position } | LightShape::Sphere { center: position, .. } => {
            one(position, lobe([0.0, 0.0, -1.0], 0.0))
        }
        LightShape::Lobe { position, axis, sharpness } => one(position, lobe(axis, f64::from(sharpness))),
        LightShape::Spot { position, axis, inner_angle, outer_angle } => {
            one(position, lobe(axis, spot_sharpness(inner_angle, outer_angle)))
        }
        LightShape::Rectangle { corner, edge_u, edge_v } => {
            let [a, u, v] = [corner, edge_u, edge_v].map(Vec3::from);
            patches([a, a + u, a + u + v, a + v])
        }
        LightShape::Disk { center, normal, radius } => {
            // A square of the same area.
            let (u, v) = Vec3::from(normal).as_dvec3().normalize_or_zero().as_vec3().any_orthonormal_pair();
            let half = 0.5 * radius * (PI as f32).sqrt();
            let at = |s: f32, t: f32| Vec3::from(center) + half * (s * u + t * v);
            patches([at(-1.0, -1.0), at(1.0, -1.0), at(1.0, 1.0), at(-1.0, 1.0)])
        }
        LightShape::Directional { .. } | LightShape::Window { .. } => Vec::new(),
    };
    let brightest = rows.iter().flat_map(|l| &l.lobes).flat_map(|l| l.amplitude).fold(0.0, f32::max);
    if brightest > MOST_AMPLITUDE {
        return Err(format!("too bright: intensities end at {}", MOST_AMPLITUDE * normalizer));
    }
    Ok(rows)
}

/// Splits a rectangle into patches of one lobe each.
///
/// A lobe emits the total flux of a cosine emitter. The rectangle shines to the side from which its corners run
/// counterclockwise.
pub fn rectangle_patches(corners: [[f32; 3]; 4], radiance: [f32; 3], patches: u32) -> Vec<LightRow> {
    let [a, b, c, d] = corners.map(|p| DVec3::from(p.map(f64::from)));
    let across = (b - a).cross(d - a);
    let area = 0.5 * (across.length() + (b - c).cross(d - c).length()) / f64::from(patches * patches);
    let flux = 1.0 / (4.0 * mean(COSINE_SHARPNESS));
    // The axis points from the lit surface to the light, opposite to the emitting side.
    let axis = (-across.normalize_or_zero()).as_vec3().to_array();
    let amplitude = radiance.map(|l| (f64::from(l) * area * flux) as f32);
    let lobe = LobeRow { axis, sharpness: COSINE_SHARPNESS as f32, amplitude };
    let middle = |i: u32| (f64::from(i) + 0.5) / f64::from(patches);
    (0..patches * patches)
        .map(|i| {
            let (s, t) = (middle(i % patches), middle(i / patches));
            let place = a.lerp(b, s).lerp(d.lerp(c, s), t);
            LightRow { position: place.as_vec3().to_array(), gain: 1.0, lobes: vec![lobe] }
        })
        .collect()
}

/// Returns the mean of `exp(sharpness * (cos - 1))` over the sphere.
pub(crate) fn mean(sharpness: f64) -> f64 {
    if sharpness < 1e-6 { 1.0 } else { -(-2.0 * sharpness).exp_m1() / (2.0 * sharpness) }
}

/// Returns the sharpness of the lobe that fits a spot best.
///
/// It has the smallest mean square difference over the sphere.
fn spot_sharpness(inner_angle: f32, outer_angle: f32) -> f64 {
    const STEPS: u32 = 400;
    let low = f64::from(outer_angle).cos();
    let width = (f64::from(inner_angle).cos() - low).max(1e-3);
    let range = 1.0 - low;
    // Square of the correlation of spot and lobe, up to a factor.
    let similarity = |log: f64| {
        let s = log.exp();
        let product: f64 = (0..STEPS)
            .map(|i| {
                // Dense at the axis.
                let t = (f64::from(i) + 0.5) / f64::from(STEPS);
                let apart = range * t * t;
                let ramp = ((range - apart) / width).min(1.0);
                ramp * ramp * (-s * apart).exp() * t
            })
            .sum();
        product * product / mean(2.0 * s)
    };
    let step = 0.25;
    let grid = (-28..=38).map(|i| step * f64::from(i));
    let best = grid.max_by(|a, b| similarity(*a).total_cmp(&similarity(*b))).unwrap_or_default();
    let (mut below, mut above) = (best - step, best + step);
    for _ in 0..40 {
        let [a, b] = [below + (above - below) / 3.0, above - (above - below) / 3.0];
        if similarity(a) < similarity(b) { below = a } else { above = b }
    }
    (0.5 * (below + above)).exp().min(MOST_SHARPNESS)
}

#[cfg(test)]
mod tests {
    use super::*;
    use sgs_passes::reference::area_lights::{Light, Receiver, irradiance};

    const NORMALIZER: f32 = 0.25;

    fn row(shape: LightShape) -> PhysicalRow {
        PhysicalRow { name: None, shape, color: [4.0, 2.0, 0.0], gain: 0.5 }
    }

    /// Returns the irradiance of a receiver from the points, in red.
    fn arriving(rows: &[LightRow], r: &Receiver) -> f64 {
        let at = |l: &LightRow| {
            let d = DVec3::from(l.position.map(f64::from)) - DVec3::from(r.point);
            let lobe = l.lobes[0];
            let cosine = d.normalize().dot(DVec3::from(lobe.axis.map(f64::from)));
            let facing = d.normalize().dot(DVec3::from(r.normal)).max(0.0);
            let amplitude = f64::from(NORMALIZER * l.gain * lobe.amplitude[0]);
            facing * amplitude * (f64::from(lobe.sharpness) * (cosine - 1.0)).exp() / d.length_squared()
        };
        rows.iter().map(at).sum()
    }

    #[test]
    fn published_lights_match_the_irradiance_of_shapes() {
        let center = [0.5, 0.0, 3.0];
        let down = [0.0, 0.0, -2.0];
        for (shape, ahead, beside) in [
            (LightShape::Point { position: center }, 1e-6, 1e-6),
            (LightShape::Sphere { center, radius: 0.2 }, 1e-6, 1e-6),
            (LightShape::Lobe { position: center, axis: down, sharpness: 3.0 }, 1e-6, 1e-6),
            (LightShape::Disk { center, normal: down, radius: 0.3 }, 0.1, 0.1),
            (
                LightShape::Rectangle { corner: [0.3, -0.2, 3.0], edge_u: [0.0, 0.4, 0.0], edge_v: [0.4, 0.0, 0.0] },
                0.1,
                0.1,
            ),
            (LightShape::Spot { position: center, axis: down, inner_angle: 0.3, outer_angle: 0.9 }, 0.35, 0.35),
        ] {
            let rows = published_light(&row(shape), NORMALIZER).unwrap();
            let light = Light::new(&AreaLight { shape, color: [1.0; 3] }.record());
            for (point, bound) in [([0.5, 0.0, 0.0], ahead), ([1.5, 0.5, 0.0], beside)] {
                let r = Receiver { point, normal: [0.0, 0.0, 1.0] };
                // Color 4, gain 0.5.
                let (is, right) = (arriving(&rows, &r), 2.0 * irradiance(&light, &r));
                assert!((is / right - 1.0).abs() < bound, "{shape:?}: {is} {right}");
            }
        }
    }

    #[test]
    fn published_lights_keep_their_power() {
        for shape in [
            LightShape::Sphere { center: [0.0; 3], radius: 0.2 },
            LightShape::Disk { center: [0.0; 3], normal: [1.0, 1.0, 0.0], radius: 0.3 },
            LightShape::Rectangle { corner: [0.0; 3], edge_u: [0.0, 0.4, 0.0], edge_v: [0.7, 0.0, 0.0] },
            LightShape::Spot { position: [0.0; 3], axis: [0.0, 1.0, 0.0], inner_angle: 0.0, outer_angle: 0.02 },
            LightShape::Spot { position: [0.0; 3], axis: [0.0, 1.0, 0.0], inner_angle: 1.2, outer_angle: 1.57 },
            LightShape::Lobe { position: [0.0; 3], axis: [0.0, 1.0, 0.0], sharpness: 1e6 },
        ] {
            let row = row(shape);
            let rows = published_light(&row, NORMALIZER).unwrap();
            let lobe = |l: &LobeRow| 4.0 * PI * mean(f64::from(l.sharpness)) * f64::from(l.amplitude[1]);
            let sent: f64 = rows.iter().map(|r| f64::from(r.gain * NORMALIZER) * lobe(&r.lobes[0])).sum();
            let right = f64::from(row.light().power().unwrap()[1]);
            assert!((sent / right - 1.0).abs() < 1e-5, "{shape:?}: {sent} {right}");
            assert!(rows[0].lobes[0].sharpness <= 13_360.0);
        }
    }

    /// Compares with a search over all lobes; a hemispherical cosine has a known result.
    #[test]
    fn sharpness_of_spots_is_that_of_least_squares() {
        let error = |inner: f64, outer: f64, s: f64| {
            let (low, n) = (outer.cos(), 40_000);
            let width = (inner.cos() - low).max(1e-3);
            let values: Vec<[f64; 2]> = (0..n)
                .map(|i| -1.0 + 2.0 * (f64::from(i) + 0.5) / f64::from(n))
                .map(|c| [((c - low) / width).clamp(0.0, 1.0).powi(2), (s * (c - 1.0)).exp()])
                .collect();
            let sum = |f: &dyn Fn(&[f64; 2]) -> f64| values.iter().map(f).sum::<f64>();
            let amplitude = sum(&|[f, g]| f * g) / sum(&|[_, g]| g * g);
            sum(&|[f, g]| (f - amplitude * g).powi(2))
        };
        for (inner, outer) in [(0.0, 0.5), (0.4, 0.5), (0.3, 1.2), (0.0, 1.5), (1.3, 1.5)] {
            let s = spot_sharpness(inner, outer);
            let [inner, outer] = [inner, outer].map(f64::from);
            let here = error(inner, outer, s);
            assert!([0.95, 1.05].iter().all(|f| error(inner, outer, f * s) > here), "{inner} {outer}: {s}");
        }
    }

    #[test]
    fn directional_and_bright_lights_are_refused() {
        let sun = row(LightShape::Directional { direction: [0.0, -1.0, 0.0], angular_radius: 0.0 });
        let point = row(LightShape::Point { position: [0.0; 3] });
        let list = |row| LightList { normalizer: 0.25, lights: vec![ListedLight::Physical(row); 2] };
        let error = list(sun).published().unwrap_err();
        assert!(error.starts_with("light 0 is directional") && error.contains("transport stage"), "{error}");
        let bright = PhysicalRow { color: [1e9; 3], ..point.clone() };
        assert_eq!(list(bright).published().unwrap_err(), "light 0 is too bright: intensities end at 800000");
        let dark = LightList { normalizer: 0.0, ..list(point) }.published().unwrap();
        assert_eq!((dark.normalizer, dark.lights[0].lobes[0].amplitude), (1.0, [4.0, 2.0, 0.0]));
    }

    #[test]
    fn patches_belong_to_their_light() {
        let pane = LightShape::Rectangle { corner: [0.0; 3], edge_u: [0.0, 0.4, 0.0], edge_v: [0.7, 0.0, 0.0] };
        let point = LightShape::Point { position: [0.0; 3] };
        let lights = [point, pane, point].map(|shape| ListedLight::Physical(row(shape))).to_vec();
        let file = LightList { normalizer: 1.0, lights }.published().unwrap();
        assert_eq!(file.lights.len(), 18);
        assert_eq!(file.groups(), [0..1, 1..17, 17..18]);
    }
}
