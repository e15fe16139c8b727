//! Checks of gradients of the visibility field with 16-bit operands.

use crate::field::{Case, Found, LossGradients, jittered};
use sgs_passes::reference::visibility as reference;

/// Gradients of a case by the reference.
pub struct Rounded {
    /// In double precision.
    pub exact: reference::Gradients,
    /// With the operands of matrices rounded to 16 bits.
    pub half: reference::Gradients,
    /// Bounds of the rounding error.
    pub bound: reference::Gradients,
}

impl Case {
    /// Computes gradients with and without rounding.
    pub fn rounded_gradients(&self, regularized: bool, by_visibility: impl Fn(usize, usize) -> f64) -> Rounded {
        let field = self.reference();
        let lights: Vec<[f64; 3]> = self.lights.iter().map(|l| Case::wide(*l)).collect();
        let [exact, half, bound] = [0; 3].map(|_| field.zeros(lights.len()));
        let mut into = Rounded { exact, half, bound };
        for i in (0..self.points.len()).filter(|i| self.coverage[*i] >= 1e-3) {
            let point = Case::wide(self.points[i]);
            for j in 0..lights.len() {
                let gradient = by_visibility(i, j);
                let (mut exact, mut half, mut uncertain) = (gradient, gradient, 0.0);
                if regularized {
                    let weight = f64::from(self.step.regularizer);
                    let by = reference::jitter(self.step.seed, 1, j as u32, f64::from(self.step.jitter));
                    let pair = (point, lights[j]);
                    let other = (jittered(self, i), [0, 1, 2].map(|k| lights[j][k] + by[k]));
                    let [own, moved] = [pair, other].map(|(p, l)| field.logit_half_bound(p, l));
                    exact += weight * (own[0] - moved[0]).signum();
                    let [own_half, moved_half] = [pair, other].map(|(p, l)| field.visibility_half(p, l));
                    half += weight * (own_half - moved_half).signum();
                    uncertain = if (own[0] - moved[0]).abs() <= own[1] + moved[1] { 2.0 * weight } else { 0.0 };
                }
                field.visibility_bwd(point, &lights, j, exact, &mut into.exact);
                field.visibility_bwd_half(point, &lights, j, half, &mut into.half);
                field.visibility_bwd_half_bound(point, &lights, j, [exact, uncertain], &mut into.bound);
            }
        }
        into
    }

    /// Fails unless gradients are within the bound and round like the reference.
    ///
    /// `share`: tolerance of single precision as a fraction of the largest gradient of each kind.
    pub fn check_rounded_gradients(&self, found: &Found, requested: &LossGradients, share: f64) {
        let by_visibility = |i, j| requested.by_visibility(i, j);
        self.rounded_gradients(requested.options.regularized, by_visibility).check(found, share);
    }
}

impl Rounded {
    /// Fails unless gradients are within the bound and round like the reference.
    ///
    /// In the mean they must be ten times closer to the rounded gradients than these to the exact ones.
    pub fn check(&self, found: &Found, share: f64) {
        let lights = |g: &reference::Gradients| g.lights.as_flattened().to_vec();
        let of =
            |g: &reference::Gradients| [("layers", g.mlp.clone()), ("tables", g.tables.clone()), ("lights", lights(g))];
        let found = [&found.mlp, &found.tables, &found.lights];
        let all = of(&self.exact).into_iter().zip(of(&self.half)).zip(of(&self.bound)).zip(found);
        for ((((kind, exact), (_, half)), (_, bound)), found) in all {
            let largest = exact.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
            let (mut alike, mut rounding, mut worst) = (0.0, 0.0, 0.0_f64);
            for i in 0..exact.len() {
                let is = f64::from(found[i]);
                let most = bound[i] + share * largest;
                let off = (is - exact[i]).abs();
                assert!(off <= most, "{kind} {i}: {is} is not {} to {most}", exact[i]);
                alike += (is - half[i]).abs();
                rounding += (half[i] - exact[i]).abs();
                worst = worst.max(off / most);
            }
            println!(
                "{kind}: {alike:.2e} from the rounded reference, {rounding:.2e} from exact, {worst:.2} of the bound"
            );
            assert!(largest > 0.0 && alike < 0.1 * rounding, "{kind}: {alike} {rounding}");
        }
    }
}
