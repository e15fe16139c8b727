//! Lights of USD files (UsdLux).
//!
//! UsdLux has radiance, so points and lights with lobes are small spheres of their mean intensity.

use crate::light_list::{LightList, ListedLight, PhysicalRow};
use crate::lights::LightRow;
use crate::published::mean;
use sgs_passes::transport::LightShape;
use sgs_scene::{UsdLight, UsdShape};
use std::f64::consts::PI;

/// Radius of the sphere that stands for a point.
const RADIUS: f32 = 0.01;

/// Returns the lights that USD holds.
pub(crate) fn usd_lights(list: &LightList) -> Vec<UsdLight> {
    let light = |(i, light): (usize, &ListedLight)| match light {
        ListedLight::Lobes(row) => Some(lobes(list.normalizer, i, row)),
        ListedLight::Physical(row) if row.is_on() => physical(i, row),
        ListedLight::Physical(_) => None,
    };
    list.lights.iter().enumerate().filter_map(light).collect()
}

/// Names the lights that USD does not hold: windows, and physical lights that are off.
pub(crate) fn usd_lights_left_out(list: &LightList) -> Vec<String> {
    list.left_out(|i, row| physical(i, row).is_some())
}

/// Returns the radiance of a sphere of [`RADIUS`] with this intensity.
fn radiance(intensity: [f64; 3]) -> [f32; 3] {
    intensity.map(|c| (c / (PI * f64::from(RADIUS).powi(2))) as f32)
}

fn lobes(normalizer: f32, i: usize, light: &LightRow) -> UsdLight {
    let factor = f64::from(normalizer) * f64::from(light.gain);
    let of = |c: usize| -> f64 {
        light.lobes.iter().map(|l| f64::from(l.amplitude[c]) * mean(f64::from(l.sharpness))).sum()
    };
    UsdLight {
        name: format!("light {i}"),
        shape: UsdShape::Sphere { center: light.position, radius: RADIUS, point: true },
        color: radiance([0, 1, 2].map(|c| factor * of(c))),
    }
}

/// Converts a physical light; `None` if it has no counterpart.
fn physical(i: usize, row: &PhysicalRow) -> Option<UsdLight> {
    let color = row.light().color;
    let point = |factor: f64| radiance(color.map(|c| factor * f64::from(c)));
    let (shape, color) = match row.shape {
        LightShape::Point { position } => {
            (UsdShape::Sphere { center: position, radius: RADIUS, point: true }, point(1.0))
        }
        LightShape::Lobe { position, sharpness, .. } => {
            (UsdShape::Sphere { center: position, radius: RADIUS, point: true }, point(mean(f64::from(sharpness))))
        }
        LightShape::Sphere { center, radius } => (UsdShape::Sphere { center, radius, point: false }, color),
        LightShape::Spot { position, axis, inner_angle, outer_angle } => {
            (UsdShape::Spot { position, axis, radius: RADIUS, inner_angle, outer_angle }, point(1.0))
        }
        LightShape::Directional { direction, angular_radius } => {
            (UsdShape::Directional { direction, angular_radius }, color)
        }
        LightShape::Rectangle { corner, edge_u, edge_v } => (UsdShape::Rectangle { corner, edge_u, edge_v }, color),
        LightShape::Disk { center, normal, radius } => (UsdShape::Disk { center, normal, radius }, color),
        LightShape::Window { .. } => return None,
    };
    Some(UsdLight { name: row.name_or(i), shape, color })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lights_have_the_radiance_that_gives_their_intensity() {
        let row = |shape: LightShape, gain: f32| {
            ListedLight::Physical(PhysicalRow { name: None, shape, color: [2.0, 1.0, 0.0], gain })
        };
        let rectangle = LightShape::Rectangle { corner: [0.0; 3], edge_u: [0.0, 0.4, 0.0], edge_v: [0.7, 0.0, 0.0] };
        let window = LightShape::Window { corner: [0.0; 3], edge_u: [0.0, 0.4, 0.0], edge_v: [0.7, 0.0, 0.0] };
        let point = LightShape::Point { position: [1.0, 2.0, 3.0] };
        let list = LightList {
            normalizer: 1.0,
            lights: vec![row(point, 0.5), row(rectangle, 1.0), row(window, 1.0), row(point, 0.0)],
        };
        let lights = usd_lights(&list);
        assert_eq!(lights.len(), 2);
        let UsdShape::Sphere { radius, point: true, .. } = lights[0].shape else { panic!("a point") };
        assert!((lights[0].color[0] * std::f32::consts::PI * radius * radius - 1.0).abs() < 1e-6);
        assert_eq!(lights[1].color, [2.0, 1.0, 0.0]);
        assert_eq!(usd_lights_left_out(&list), ["window \"light 2\"", "point \"light 3\", which is off"]);
    }
}
