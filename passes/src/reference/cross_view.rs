//! Reference of `cross_view`: mean albedo of a region in training and pseudo-views.

use super::correspondence::LEAST_PIXELS;

/// Albedo of an image and the mask of the region.
#[derive(Clone, Debug)]
pub struct MaskedAlbedo {
    /// Albedo, `[P * 3]`.
    pub albedo: Vec<f64>,
    /// Mask, `[P]`.
    pub mask: Vec<bool>,
}

impl MaskedAlbedo {
    fn members(&self) -> Vec<usize> {
        (0..self.mask.len()).filter(|&p| self.mask[p]).collect()
    }

    fn mean(&self) -> [f64; 3] {
        let members = self.members();
        [0, 1, 2].map(|c| members.iter().map(|&p| self.albedo[3 * p + c]).sum::<f64>() / members.len().max(1) as f64)
    }
}

/// Returns the summed distances of means over valid pseudo-views, and their number. The training view comes first.
pub fn cross_view(images: &[MaskedAlbedo]) -> (f64, usize) {
    let (mut sum, mut pairs) = (0.0, 0);
    for (_, distance) in distances(images).into_iter().flatten() {
        sum += distance.iter().map(|d| d * d).sum::<f64>().sqrt();
        pairs += 1;
    }
    (sum, pairs)
}

/// Returns each pseudo-view's index and difference of means from the training view. The entry is `None` unless both
/// regions are large enough.
fn distances(images: &[MaskedAlbedo]) -> Vec<Option<(usize, [f64; 3])>> {
    let large = |p: &MaskedAlbedo| p.members().len() >= LEAST_PIXELS;
    let of = |k: usize| {
        let (mine, trained) = (images[k].mean(), images[0].mean());
        let counts = large(&images[k]) && large(&images[0]);
        counts.then(|| (k, [0, 1, 2].map(|c| mine[c] - trained[c])))
    };
    (1..images.len()).map(of).collect()
}

/// Returns the gradients of [`cross_view`] by image, zero where means are equal.
pub fn cross_view_bwd(images: &[MaskedAlbedo]) -> Vec<Vec<f64>> {
    let mut gradients: Vec<Vec<f64>> = images.iter().map(|p| vec![0.0; p.albedo.len()]).collect();
    for (k, distance) in distances(images).into_iter().flatten() {
        let size = distance.iter().map(|d| d * d).sum::<f64>().sqrt();
        for (image, sign) in [(k, 1.0), (0, -1.0)] {
            let members = images[image].members();
            for &p in &members {
                for c in 0..3 {
                    let direction = if size > 0.0 { distance[c] / size } else { 0.0 };
                    gradients[image][3 * p + c] += sign * direction / members.len() as f64;
                }
            }
        }
    }
    gradients
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Pcg;

    #[test]
    fn gradients_match_finite_differences() {
        let mut rng = Pcg::new(6);
        let mut images: Vec<MaskedAlbedo> = (0..3)
            .map(|_| MaskedAlbedo {
                albedo: (0..90).map(|_| rng.uniform()).collect(),
                mask: (0..30).map(|_| rng.uniform() < 0.8).collect(),
            })
            .collect();
        let gradients = cross_view_bwd(&images);
        for k in 0..3 {
            for i in 0..90 {
                let old = images[k].albedo[i];
                let mut at = |x: f64| {
                    images[k].albedo[i] = x;
                    cross_view(&images).0
                };
                let fd = (at(old + 1e-5) - at(old - 1e-5)) / 2e-5;
                at(old);
                assert!((fd - gradients[k][i]).abs() < 1e-8, "{k} {i}");
            }
        }
        assert_eq!(cross_view(&images).1, 2);
        images[2].mask[..20].fill(false);
        assert_eq!(cross_view(&images).1, 1);
    }
}
