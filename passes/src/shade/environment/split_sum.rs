//! Split-sum table: the reflectance of a surface under uniform light.
//!
//! The integral of D V n.l over the hemisphere, split by Schlick's term: reflectance is F0 a + b (Karis 2013), with
//! GGX, height-correlated Smith, and alpha = roughness^2. The table does not depend on the environment map. Nodes
//! include both ends of each axis: row j is roughness j / 63, column i is n.v = i / 63, clamped to 1e-4. In the first
//! row, a mirror, a = 1 - (1 - n.v)^5 exactly.

/// Nodes along a side.
pub const NODES: usize = 64;
/// Minimum n.v, as in the kernels.
const NV_MIN: f64 = 1e-4;

/// Returns the factor of F0 and the offset of each node, row by row.
pub fn table() -> Vec<[f32; 2]> {
    let node = |i: usize| i as f64 / (NODES - 1) as f64;
    (0..NODES * NODES)
        .map(|k| split_sum(node(k / NODES), node(k % NODES).max(NV_MIN)).map(|x| x.clamp(0.0, 1.0) as f32))
        .collect()
}

/// Computes one entry by quadrature over half vectors distributed as D (n.h).
fn split_sum(roughness: f64, nv: f64) -> [f64; 2] {
    let alpha = roughness * roughness;
    if alpha < 1e-6 {
        let fresnel = (1.0 - nv).powi(5);
        return [1.0 - fresnel, fresnel];
    }
    let square = alpha * alpha;
    let sin_v = (1.0 - nv * nv).max(0.0).sqrt();
    let root_v = (square + nv * nv * (1.0 - square)).sqrt();
    let (rings, around) = (64, 24);
    let mut sum = [0.0; 2];
    for i in 0..rings {
        // Samples are denser towards grazing half vectors, which reflect light that arrives edge-on.
        let s = 1.0 - (f64::from(i) + 0.5) / f64::from(rings);
        let (u, stretch) = (1.0 - s.powi(4), 4.0 * s.powi(3));
        let cos2 = (1.0 - u) / (1.0 + (square - 1.0) * u);
        let (nh, sin_h) = (cos2.sqrt(), (1.0 - cos2).max(0.0).sqrt());
        // Light comes from above the horizon where cos phi exceeds this; the integrand changes fastest there.
        let horizon = (nv / (2.0 * nh) - nv * nh) / (sin_v * sin_h).max(1e-300);
        let end = horizon.clamp(-1.0, 1.0).acos();
        for j in 0..around {
            let r = 1.0 - (f64::from(j) + 0.5) / f64::from(around);
            let (phi, width) = (end * (1.0 - r * r), 2.0 * r * end / std::f64::consts::PI);
            let vh = sin_v * sin_h * phi.cos() + nv * nh;
            let nl = 2.0 * vh * nh - nv;
            if nl <= 0.0 || vh <= 0.0 {
                continue;
            }
            let root_l = (square + nl * nl * (1.0 - square)).sqrt();
            let v = 0.5 / (nv * root_l + nl * root_v);
            // The density of l is D n.h / (4 v.h).
            let weight = width * stretch * v * nl * 4.0 * vh / nh;
            let fresnel = (1.0 - vh).powi(5);
            sum[0] += weight * (1.0 - fresnel);
            sum[1] += weight * fresnel;
        }
    }
    sum.map(|x| x / f64::from(rings * around))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Integrates over light directions: an independent check for lobes that are not narrow.
    fn by_light(roughness: f64, nv: f64) -> [f64; 2] {
        let square = roughness.powi(4);
        let v = [(1.0 - nv * nv).sqrt(), 0.0, nv];
        let (n, m) = (600, 600);
        let mut sum = [0.0; 2];
        for i in 0..n {
            // Samples are denser at the horizon, and around the mirrored view below.
            let x = (f64::from(i) + 0.5) / f64::from(n);
            let nl = x * x;
            let s = (1.0 - nl * nl).sqrt();
            for j in 0..m {
                let y = (f64::from(j) + 0.5) / f64::from(m);
                let phi = std::f64::consts::PI * (1.0 - y * y);
                let l = [s * phi.cos(), s * phi.sin(), nl];
                let h: Vec<f64> = (0..3).map(|k| l[k] + v[k]).collect();
                let length = h.iter().map(|x| x * x).sum::<f64>().sqrt();
                let (nh, lh) = (h[2] / length, (0..3).map(|k| l[k] * h[k] / length).sum::<f64>());
                let d = square / (std::f64::consts::PI * ((square - 1.0) * nh * nh + 1.0).powi(2));
                let g =
                    nv * (square + nl * nl * (1.0 - square)).sqrt() + nl * (square + nv * nv * (1.0 - square)).sqrt();
                let f = (1.0 - lh).powi(5);
                let w = d * 0.5 / g * nl * 2.0 * x * 2.0 * y * 2.0 * std::f64::consts::PI / f64::from(n * m);
                sum[0] += w * (1.0 - f);
                sum[1] += w * f;
            }
        }
        sum
    }

    #[test]
    fn entries_match_an_independent_quadrature() {
        for roughness in [0.35, 0.5, 0.75, 1.0] {
            for nv in [0.02, 0.1, 0.4, 0.8, 1.0] {
                let (a, b) = (split_sum(roughness, nv), by_light(roughness, nv));
                assert!((0..2).all(|k| (a[k] - b[k]).abs() < 1.5e-3), "{roughness} {nv}: {a:?} {b:?}");
            }
        }
    }

    #[test]
    fn energy_is_not_created_and_mirrors_preserve_it() {
        let t = table();
        let most = t.iter().map(|[a, b]| a + b).fold(0.0, f32::max);
        assert!(most <= 1.0005, "{most}");
        assert!(t[..NODES].iter().all(|[a, b]| (a + b - 1.0).abs() < 1e-6));
        // Rougher surfaces lose energy, since light that bounces between facets is not followed.
        assert!(t[NODES * NODES - 1].iter().sum::<f32>() < 0.32);
    }

    #[test]
    fn entries_match_published_values() {
        // Texel centers (i + 1/2) / 256 of the table that GGX implementations share.
        let at = |row: f64, column: f64| split_sum((row + 0.5) / 256.0, (column + 0.5) / 256.0);
        for (row, column, a, b) in
            [(0.0, 0.0, 0.0097, 0.9902), (128.0, 128.0, 0.8343, 0.0219), (255.0, 255.0, 0.3093, 0.0)]
        {
            let found = at(row, column);
            assert!((found[0] - a).abs() < 3e-3 && (found[1] - b).abs() < 3e-3, "{row} {column}: {found:?}");
        }
    }
}
