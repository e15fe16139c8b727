//! Twin of `cross_view`: the mean albedo of a region in a training view and in pseudo-views.

use super::correspondence::LEAST_PIXELS;

/// Albedo of a picture, three numbers a pixel, and the region.
#[derive(Clone, Debug)]
pub struct Picture {
    /// `[P * 3]`.
    pub albedo: Vec<f64>,
    /// `[P]`.
    pub mask: Vec<bool>,
}

impl Picture {
    fn members(&self) -> Vec<usize> {
        (0..self.mask.len()).filter(|&p| self.mask[p]).collect()
    }

    fn mean(&self) -> [f64; 3] {
        let members = self.members();
        [0, 1, 2].map(|c| members.iter().map(|&p| self.albedo[3 * p + c]).sum::<f64>() / members.len().max(1) as f64)
    }
}

/// Distances of means, summed over the pseudo-views that count, and how many do; the training view comes first.
pub fn cross_view(pictures: &[Picture]) -> (f64, usize) {
    let (mut sum, mut pairs) = (0.0, 0);
    for (_, distance) in distances(pictures).into_iter().flatten() {
        sum += distance.iter().map(|d| d * d).sum::<f64>().sqrt();
        pairs += 1;
    }
    (sum, pairs)
}

/// Number of a pseudo-view, and the difference of its mean from the training view's, if both are large enough.
fn distances(pictures: &[Picture]) -> Vec<Option<(usize, [f64; 3])>> {
    let large = |p: &Picture| p.members().len() >= LEAST_PIXELS;
    let of = |k: usize| {
        let (mine, trained) = (pictures[k].mean(), pictures[0].mean());
        let counts = large(&pictures[k]) && large(&pictures[0]);
        counts.then(|| (k, [0, 1, 2].map(|c| mine[c] - trained[c])))
    };
    (1..pictures.len()).map(of).collect()
}

/// Its gradients, picture by picture; none where means are equal.
pub fn cross_view_bwd(pictures: &[Picture]) -> Vec<Vec<f64>> {
    let mut gradients: Vec<Vec<f64>> = pictures.iter().map(|p| vec![0.0; p.albedo.len()]).collect();
    for (k, distance) in distances(pictures).into_iter().flatten() {
        let size = distance.iter().map(|d| d * d).sum::<f64>().sqrt();
        for (picture, sign) in [(k, 1.0), (0, -1.0)] {
            let members = pictures[picture].members();
            for &p in &members {
                for c in 0..3 {
                    let direction = if size > 0.0 { distance[c] / size } else { 0.0 };
                    gradients[picture][3 * p + c] += sign * direction / members.len() as f64;
                }
            }
        }
    }
    gradients
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::rng::Pcg;

    #[test]
    fn gradients_are_finite_differences() {
        let mut rng = Pcg::new(6);
        let mut pictures: Vec<Picture> = (0..3)
            .map(|_| Picture {
                albedo: (0..90).map(|_| rng.uniform()).collect(),
                mask: (0..30).map(|_| rng.uniform() < 0.8).collect(),
            })
            .collect();
        let gradients = cross_view_bwd(&pictures);
        for k in 0..3 {
            for i in 0..90 {
                let old = pictures[k].albedo[i];
                let mut at = |x: f64| {
                    pictures[k].albedo[i] = x;
                    cross_view(&pictures).0
                };
                let fd = (at(old + 1e-5) - at(old - 1e-5)) / 2e-5;
                at(old);
                assert!((fd - gradients[k][i]).abs() < 1e-8, "{k} {i}");
            }
        }
        assert_eq!(cross_view(&pictures).1, 2);
        pictures[2].mask[..20].fill(false);
        assert_eq!(cross_view(&pictures).1, 1);
    }
}
