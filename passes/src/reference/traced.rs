//! Reference of traced visibility: every Gaussian in double precision, without a tree.

use super::project::rotation;

/// Three numbers.
pub type V3 = [f64; 3];

/// Gaussian as stored.
#[derive(Clone, Copy, Debug)]
pub struct Splat {
    /// World-space center.
    pub mean: V3,
    /// Natural logarithms of the scales.
    pub log_scale: V3,
    /// Quaternion (w, x, y, z) of any length.
    pub rotation: [f64; 4],
    /// Opacity before the sigmoid.
    pub opacity_logit: f64,
}

/// Intersection of a Gaussian and a ray.
#[derive(Clone, Copy, Debug)]
pub struct Met {
    /// Alpha at the start of the ray; 0 if below 1/255.
    pub before: f64,
    /// Alpha at the peak; 0 if below 1/255.
    pub alpha: f64,
    /// Distance of the peak.
    pub at: f64,
}

/// Intersects a ray with a Gaussian; `along` is a unit vector.
pub fn meet(s: &Splat, from: V3, along: V3) -> Met {
    let turn = rotation(&s.rotation);
    // Transforms to the Gaussian's own axes, where the Gaussian is a unit sphere.
    let white = |v: V3| -> V3 {
        std::array::from_fn(|k| {
            let axis = turn.col(k);
            (axis.x * v[0] + axis.y * v[1] + axis.z * v[2]) / s.log_scale[k].clamp(-16.0, 8.0).exp()
        })
    };
    let dot = |a: V3, b: V3| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let (o, d) = (white(std::array::from_fn(|k| from[k] - s.mean[k])), white(along));
    let t = -dot(o, d) / dot(d, d);
    let r = std::array::from_fn(|k| o[k] + t * d[k]);
    // A Gaussian that is not finite is neither drawn nor an occluder.
    let there = s.mean.iter().chain(&s.log_scale).all(|x| x.is_finite()) && s.opacity_logit.is_finite();
    let opacity = if there { 1.0 / (1.0 + (-s.opacity_logit).exp()) } else { 0.0 };
    let alpha = |r: V3| (opacity * (-0.5 * dot(r, r)).exp()).min(0.99);
    let shown = |alpha: f64| if alpha >= 1.0 / 255.0 { alpha } else { 0.0 };
    Met { before: shown(alpha(o)), alpha: shown(alpha(r)), at: t }
}

/// Returns the transmittance of all Gaussians whose peaks lie between two points. Each Gaussian occludes by its
/// increase in density from the first point.
pub fn transmittance(splats: &[Splat], from: V3, to: V3) -> f64 {
    let v: V3 = std::array::from_fn(|k| to[k] - from[k]);
    let reach = v.iter().map(|x| x * x).sum::<f64>().sqrt();
    if reach == 0.0 {
        return 1.0;
    }
    let along = v.map(|x| x / reach);
    let through = |s: &Splat| {
        let m = meet(s, from, along);
        if m.alpha > 0.0 && m.at > 0.0 && m.at < reach { ((1.0 - m.alpha) / (1.0 - m.before)).min(1.0) } else { 1.0 }
    };
    splats.iter().map(through).product()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn occlusion_follows_the_distance_of_the_ray_from_the_center() {
        let s =
            Splat { mean: [0.0, 0.0, 5.0], log_scale: [0.0; 3], rotation: [1.0, 0.0, 0.0, 0.0], opacity_logit: 0.0 };
        let at = |from: V3, to: V3| transmittance(&[s], from, to);
        assert!((at([0.0; 3], [0.0, 0.0, 10.0]) - 0.5).abs() < 1e-12);
        assert!((at([1.0, 0.0, 0.0], [1.0, 0.0, 10.0]) - (1.0 - 0.5 * (-0.5_f64).exp())).abs() < 1e-12);
        // Behind the light, behind the point, and a ray of length zero.
        assert_eq!(at([0.0; 3], [0.0, 0.0, 4.0]), 1.0);
        assert_eq!(at([0.0, 0.0, 6.0], [0.0, 0.0, 10.0]), 1.0);
        assert_eq!(at([1.0; 3], [1.0; 3]), 1.0);
        // The point is inside: only the remaining density occludes.
        let inside = 1.0 - 0.5 * (-0.125_f64).exp();
        assert!((at([0.0, 0.0, 4.5], [0.0, 0.0, 10.0]) - 0.5 / inside).abs() < 1e-12);
    }
}
