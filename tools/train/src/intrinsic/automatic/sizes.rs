//! Sizes of model components, limited to what the cameras can resolve.
//! They are chosen before the first step.

use crate::decision::Decision;
use glam::DVec3;
use sgs_config::{IntrinsicSettings, Metallic, VisibilityKind};
use sgs_scene::{Camera, Splats};

/// Least share of metallic pixels with which metallic is modeled.
const METALLIC_SHARE: f64 = 1e-3;

/// Least value, of 255, of a prior's metallic pixel.
const METALLIC_FROM: u32 = 77;

/// Maximum number of splats whose distance is measured, per view.
const SPLATS: usize = 4096;

/// Knowledge of a scene before the first step.
pub(in super::super) struct Found<'a> {
    pub splats: &'a Splats,
    pub cameras: &'a [&'a Camera],
    /// Bounding box of lights and visibility field.
    pub bounds: &'a [[f32; 3]; 2],
    /// Priors of roughness and metallic by view, packed like photographs.
    pub roughness: Option<&'a [Vec<u32>]>,
    pub metallic: Option<&'a [Vec<u32>]>,
}

/// Returns the settings with sufficient sizes, and the decisions.
pub(in super::super) fn required(found: &Found<'_>, s: &IntrinsicSettings) -> (IntrinsicSettings, Vec<Decision>) {
    let (mut of, mut decisions) = (s.clone(), Vec::new());
    let a = &s.automatic;
    let mut decided = |what: &str, on: bool, reason: String, figures: Option<[f64; 2]>| {
        let (what, setting) = (what.to_owned(), "intrinsic.automatic.parts".to_owned());
        let [measured, requested] = [0, 1].map(|i| figures.map(|f| f[i]));
        decisions.push(Decision { step: 0, what, on, reason, measured, requested, setting });
    };
    if let (true, Metallic::Auto, Some(maps)) = (a.parts.metallic, s.metallic, found.metallic) {
        let share = share_above(maps, METALLIC_FROM);
        let on = share >= METALLIC_SHARE;
        of.metallic = if on { Metallic::Auto } else { Metallic::Off };
        let reason = format!("priors call {:.3} % of the pixels metallic", 100.0 * share);
        decided("metallic", on, reason, Some([share, METALLIC_SHARE]));
    }
    if a.parts.sizes && s.environment.enabled() {
        let most = s.environment.resolution;
        let (reason, figures) = match found.roughness {
            Some(maps) => {
                let (size, least) = environment_size(maps, most);
                of.environment.resolution = size;
                let reason = format!(
                    "{size} texels along an edge: of the pixels one in a hundred has a roughness below {least:.2}, and nothing \
                     sharper mirrors the environment map"
                );
                (reason, Some([least, 0.01]))
            }
            None => (format!("{most} texels along an edge: no priors say how sharply surfaces mirror"), None),
        };
        decided("environment size", true, reason, figures);
    }
    let v = &s.visibility;
    if a.parts.sizes && s.lights.enabled() && v.kind == VisibilityKind::Field && v.levels > 1 {
        let side = (0..3).map(|i| f64::from(found.bounds[1][i] - found.bounds[0][i])).fold(0.0, f64::max);
        if let Some(pixel) = footprint(found.splats, found.cameras).filter(|p| *p > 0.0 && side > 0.0) {
            let wanted = (side / pixel).ceil().min(f64::from(u32::MAX)) as u32;
            let finest = wanted.clamp((2 * v.coarsest).min(v.finest), v.finest);
            let growth = (f64::from(v.finest) / f64::from(v.coarsest)).ln() / f64::from(v.levels - 1);
            let above = (f64::from(finest) / f64::from(v.coarsest)).ln();
            // Without growth all levels are equal, and one suffices.
            let levels = if growth > 0.0 { 1 + (above / growth).round() as u32 } else { 1 };
            (of.visibility.finest, of.visibility.levels) = (finest, levels.clamp(1, v.levels));
            let reason = format!(
                "{} levels up to {finest}: nine in ten surfaces have pixels wider than a {wanted}th of the room",
                of.visibility.levels
            );
            decided("visibility size", true, reason, Some([pixel, side]));
        }
    }
    (of, decisions)
}

/// Returns the share of valid pixels whose value is at least `least`.
fn share_above(maps: &[Vec<u32>], least: u32) -> f64 {
    let known = maps.iter().flatten().filter(|w| *w >> 24 != 0);
    let (all, above) = known.fold((0_u64, 0_u64), |(all, above), w| (all + 1, above + u64::from(w & 0xff >= least)));
    above as f64 / all.max(1) as f64
}

/// Returns the edge length of the smallest sufficient cube, and a roughness.
/// The roughness is the one that all but a hundredth of the pixels reach. The cube's texels are no wider than the
/// specular lobe of this roughness (GGX: alpha, the square of roughness, in radians).
fn environment_size(maps: &[Vec<u32>], most: u32) -> (u32, f64) {
    let mut counts = [0_u64; 256];
    maps.iter().flatten().filter(|w| *w >> 24 != 0).for_each(|w| counts[(w & 0xff) as usize] += 1);
    let all: u64 = counts.iter().sum();
    let mut below = 0;
    let least = counts.iter().position(|n| {
        below += n;
        100 * below > all
    });
    let least = least.unwrap_or(0) as f64 / 255.0;
    let texels = std::f64::consts::FRAC_PI_2 / (least * least).max(1e-6);
    let size = texels.min(f64::from(most)).ceil() as u32;
    (size.next_power_of_two().clamp(16, most), least)
}

/// Returns the tenth percentile of pixel widths at splats within the images.
fn footprint(splats: &Splats, cameras: &[&Camera]) -> Option<f64> {
    let stride = splats.len().div_ceil(SPLATS).max(1);
    let mut widths = Vec::new();
    for c in cameras {
        for mean in splats.means.iter().step_by(stride) {
            let p = c.rotation * DVec3::from_array(mean.map(f64::from)) + c.translation;
            let (x, y) = (c.fx * p.x / p.z + c.cx, c.fy * p.y / p.z + c.cy);
            let inside = x >= 0.0 && y >= 0.0 && x < f64::from(c.width) && y < f64::from(c.height);
            if p.z > 0.01 && p.is_finite() && inside {
                widths.push(p.z / c.fx);
            }
        }
    }
    if widths.is_empty() {
        return None;
    }
    let tenth = widths.len() / 10;
    Some(*widths.select_nth_unstable_by(tenth, f64::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;
    use sgs_config::Parts;

    fn pixels(values: &[(u32, usize)]) -> Vec<Vec<u32>> {
        vec![values.iter().flat_map(|(v, n)| std::iter::repeat_n(0xff00_0000 | v, *n)).chain([9]).collect()]
    }

    fn camera() -> Camera {
        let (width, height) = (100, 100);
        let [fx, fy, cx, cy] = [100.0, 100.0, 50.0, 50.0];
        let (rotation, translation) = (DMat3::IDENTITY, DVec3::ZERO);
        Camera { name: "a".into(), width, height, fx, fy, cx, cy, rotation, translation, near: sgs_scene::NEAR }
    }

    #[test]
    fn sizes_follow_camera_resolution_and_priors() {
        let mut s = IntrinsicSettings::default();
        s.automatic.enabled = true;
        // All splats lie at depth 2, where a pixel is 0.02 wide; a box of side 8 spans 400 pixels.
        let splats = Splats { means: vec![[0.0, 0.0, 2.0]; 20], ..Splats::default() };
        let camera = camera();
        let (rough, dull) = (pixels(&[(255, 60), (64, 40)]), pixels(&[(0, 5000), (200, 1)]));
        let found = Found {
            splats: &splats,
            cameras: &[&camera],
            bounds: &[[0.0; 3], [8.0, 4.0, 3.0]],
            roughness: Some(&rough),
            metallic: Some(&dull),
        };
        let (of, decisions) = required(&found, &s);
        assert_eq!((of.visibility.finest, of.visibility.levels), (400, 9));
        // Roughness 0.25: lobes of 0.063 radians, 25 per face.
        assert_eq!((of.environment.resolution, of.metallic), (32, Metallic::Off));
        let whats: Vec<_> = decisions.iter().map(|d| (d.what.as_str(), d.on)).collect();
        assert_eq!(whats, [("metallic", false), ("environment size", true), ("visibility size", true)]);
        assert!(decisions[2].reason.starts_with("9 levels up to 400:"), "{}", decisions[2].reason);

        // Settings are upper bounds and can be forced.
        let mirror = pixels(&[(0, 50), (255, 50)]);
        let metal = Found { metallic: Some(&mirror), roughness: Some(&mirror), ..found };
        (s.visibility.finest, s.visibility.levels) = (256, 8);
        let (of, _) = required(&metal, &s);
        assert_eq!((of.visibility, of.environment, of.metallic), (s.visibility, s.environment, Metallic::Auto));
        let forced = |s: &IntrinsicSettings| required(&found, s).0 == *s;
        s.automatic.parts = Parts::NONE;
        assert!(forced(&s));
        (s.automatic.parts.metallic, s.metallic) = (true, Metallic::On);
        assert!(forced(&s));
    }

    #[test]
    fn sizes_are_unchanged_without_splats_and_priors() {
        let s = IntrinsicSettings::default();
        let camera = camera();
        let (none, splats) = (vec![vec![0; 9]], Splats::default());
        let bounds = [[0.0; 3], [1.0; 3]];
        let (cameras, roughness) = ([&camera], Some(&none[..]));
        let found = Found { splats: &splats, cameras: &cameras, bounds: &bounds, roughness, metallic: None };
        assert_eq!(required(&found, &s).0, s);
    }
}
