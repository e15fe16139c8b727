//! Reference of a region's correspondence loss between training and pseudo-views.

use super::semantic::{Head, Rounding as PlaceRounding, dot};

/// Features of an image by pixel, and the mask of the region.
#[derive(Clone, Debug)]
pub struct MaskedImage {
    /// Features, `[P * features]`.
    pub image: Vec<f64>,
    /// Whether a pixel belongs to the region.
    pub mask: Vec<bool>,
}

/// Minimum number of pixels of a region that counts.
pub const LEAST_PIXELS: usize = 16;

/// Means of the two terms over the pseudo-views, and the number of valid views.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Terms {
    /// Distance of mean features.
    pub distance: f64,
    /// Cross-entropy to the training view's class.
    pub class: f64,
    /// Number of pseudo-views whose regions are large enough.
    pub pairs: usize,
}

/// Gradients of the training view, the pseudo-views and the decoder.
#[derive(Clone, Debug)]
pub struct Gradient {
    /// Gradient of the training view's features.
    pub train: Vec<f64>,
    /// Gradient of each pseudo-view's features.
    pub pseudo: Vec<Vec<f64>>,
    /// Gradient of the decoder.
    pub decoder: Vec<f64>,
}

/// Bounds of single-precision rounding errors, in units of the last place. A bound is the magnitude of a sum's terms.
#[derive(Clone, Debug)]
pub struct Rounding {
    /// Bounds of the means.
    pub terms: Terms,
    /// Bounds of the gradients.
    pub gradient: Gradient,
    /// Whether rounding cannot change the result's discrete decisions. These are the class of most pixels of the
    /// training view, and whether a decoded vector counts as zero.
    pub sure: bool,
}

impl MaskedImage {
    fn members(&self, features: usize) -> Vec<usize> {
        let finite = |p: usize| self.image[p * features..][..features].iter().all(|x| x.is_finite());
        (0..self.mask.len()).filter(|&p| self.mask[p] && finite(p)).collect()
    }

    fn mean(&self, features: usize) -> Vec<f64> {
        let members = self.members(features);
        let n = members.len().max(1) as f64;
        (0..features).map(|k| members.iter().map(|&p| self.image[p * features + k]).sum::<f64>() / n).collect()
    }

    /// Returns the means of the magnitudes.
    fn size(&self, features: usize) -> Vec<f64> {
        MaskedImage { image: self.image.iter().map(|x| x.abs()).collect(), mask: self.mask.clone() }.mean(features)
    }

    /// Returns the class of most pixels of the region, the first among equals.
    pub fn majority(&self, head: &Head) -> usize {
        self.majority_surely(head).0
    }

    /// Returns the majority class, and whether single precision is certain to agree.
    fn majority_surely(&self, head: &Head) -> (usize, bool) {
        let (mut counts, mut near) = (vec![0_usize; head.classes()], 0);
        for p in self.members(head.features) {
            let d = head.decode(&self.image[p * head.features..][..head.features]);
            let products: Vec<f64> = head.text.chunks(head.embedding).map(|t| dot(t, &d.vector)).collect();
            let best = (0..products.len()).fold(0, |best, c| if products[c] > products[best] { c } else { best });
            let others = products.iter().enumerate().filter(|(c, _)| *c != best);
            let second = others.fold(f64::NEG_INFINITY, |m, (_, &p)| m.max(p));
            counts[best] += 1;
            near += usize::from(products[best] - second <= 1e-6 * d.products.sqrt());
        }
        let most = counts.iter().max().copied().unwrap_or(0);
        let label = counts.iter().position(|&n| n == most).unwrap_or(0);
        let second = (0..counts.len()).filter(|&c| c != label).map(|c| counts[c]).max().unwrap_or(0);
        (label, near == 0 || counts.len() == 1 || most > second + 2 * near)
    }
}

/// Returns the loss and its gradient times `weight`.
pub fn correspondence(
    head: &Head,
    train: &MaskedImage,
    pseudo: &[MaskedImage],
    weight: f64,
    temperature: f64,
) -> (Terms, Gradient) {
    let (terms, gradient, _) = correspondence_rounding(head, train, pseudo, weight, temperature);
    (terms, gradient)
}

/// Returns the loss, its gradient, and bounds of single-precision rounding errors.
pub fn correspondence_rounding(
    head: &Head,
    train: &MaskedImage,
    pseudo: &[MaskedImage],
    weight: f64,
    temperature: f64,
) -> (Terms, Gradient, Rounding) {
    let n = head.features;
    let mut terms = Terms::default();
    let mut gradient = Gradient {
        train: vec![0.0; train.image.len()],
        pseudo: pseudo.iter().map(|p| vec![0.0; p.image.len()]).collect(),
        decoder: vec![0.0; head.decoder.len()],
    };
    let mut rounding = Rounding { terms, gradient: gradient.clone(), sure: true };
    let mut places = PlaceRounding::new(head, 0);
    let mine = train.members(n);
    let (label, sure) = train.majority_surely(head);
    let share = 1.0 / pseudo.len().max(1) as f64;
    for (i, rendered) in pseudo.iter().enumerate() {
        let theirs = rendered.members(n);
        if mine.len() < LEAST_PIXELS || theirs.len() < LEAST_PIXELS {
            continue;
        }
        terms.pairs += 1;
        let apart: Vec<f64> = rendered.mean(n).iter().zip(train.mean(n)).map(|(a, b)| a - b).collect();
        let distance = dot(&apart, &apart).sqrt();
        terms.distance += share * distance;
        let toward = |k: usize| if distance > 0.0 { weight * share * apart[k] / distance } else { 0.0 };
        // Rounding bounds of a difference of means: of each component, and of the norm.
        let sizes: Vec<f64> = rendered.size(n).iter().zip(train.size(n)).map(|(a, b)| a + b).collect();
        let size = dot(&sizes, &sizes).sqrt();
        rounding.terms.distance += share * size;
        let off = |k: usize| {
            let each = (sizes[k] + size * (toward(k) / weight / share).abs()) / distance.max(f64::MIN_POSITIVE);
            if distance > 0.0 { weight * share * each } else { 0.0 }
        };
        for &p in &mine {
            (0..n).for_each(|k| gradient.train[p * n + k] -= toward(k) / mine.len() as f64);
            (0..n).for_each(|k| rounding.gradient.train[p * n + k] += off(k) / mine.len() as f64);
        }
        let count = theirs.len() as f64;
        for &p in &theirs {
            let f = &rendered.image[p * n..][..n];
            let d = head.decode(f);
            let (entropy, by_unit) = head.cross_entropy(&d, label, temperature);
            terms.class += share * entropy / count;
            let by_unit: Vec<f64> = by_unit.iter().map(|g| weight * share / count * g).collect();
            let by_features = head.back(&d, f, &by_unit, &mut gradient.decoder);
            (0..n).for_each(|k| gradient.pseudo[i][p * n + k] = by_features[k] + toward(k) / count);
            let before = places.terms.class;
            let sizes = places.add(head, &d, f, (&[], 0.0), (weight * share / count, temperature));
            rounding.terms.class += share / count * (places.terms.class - before);
            (0..n).for_each(|k| rounding.gradient.pseudo[i][p * n + k] = sizes[k] + off(k) / count);
        }
    }
    rounding.gradient.decoder = places.gradient.decoder;
    rounding.sure = terms.pairs == 0 || sure && places.sure;
    (terms, gradient, rounding)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::semantic::tests::head;
    use crate::rng::Pcg;

    fn rendered(pixels: usize, share: f64, rng: &mut Pcg) -> MaskedImage {
        let image = (0..3 * pixels).map(|_| rng.normal()).collect();
        MaskedImage { image, mask: (0..pixels).map(|_| rng.uniform() < share).collect() }
    }

    #[test]
    fn gradient_matches_finite_differences() {
        let mut rng = Pcg::new(9);
        let h = head(3, 7, 4, &mut rng);
        let train = rendered(60, 0.7, &mut rng);
        // The last region is too small.
        let pseudo = [rendered(40, 0.9, &mut rng), rendered(50, 0.6, &mut rng), rendered(50, 0.1, &mut rng)];
        let (weight, temperature) = (0.6, 0.5);
        let (terms, gradient) = correspondence(&h, &train, &pseudo, weight, temperature);
        assert_eq!(terms.pairs, 2);
        let label = train.majority(&h);
        let total = |h: &Head, train: &MaskedImage, pseudo: &[MaskedImage]| {
            // The class has no gradient, and must not change during differencing.
            assert_eq!(train.majority(h), label);
            let t = correspondence(h, train, pseudo, weight, temperature).0;
            weight * (t.distance + t.class)
        };
        let check = |of: &[f64], expected: &[f64], f: &dyn Fn(&[f64]) -> f64| {
            let mut x = of.to_vec();
            for i in 0..x.len() {
                let fd = crate::reference::difference(&mut x, i, f);
                assert!((fd - expected[i]).abs() < 1e-7, "{i}: {fd} {}", expected[i]);
            }
        };
        check(&train.image, &gradient.train, &|x| {
            total(&h, &MaskedImage { image: x.to_vec(), ..train.clone() }, &pseudo)
        });
        for i in 0..3 {
            check(&pseudo[i].image, &gradient.pseudo[i], &|x| {
                let mut moved = pseudo.clone();
                moved[i].image = x.to_vec();
                total(&h, &train, &moved)
            });
        }
        check(&h.decoder, &gradient.decoder, &|x| total(&Head { decoder: x.to_vec(), ..h.clone() }, &train, &pseudo));
    }

    #[test]
    fn equal_regions_have_no_distance_and_no_distance_gradient() {
        let mut rng = Pcg::new(2);
        let h = head(3, 5, 2, &mut rng);
        let train = rendered(64, 1.0, &mut rng);
        let (terms, gradient) = correspondence(&h, &train, std::slice::from_ref(&train), 1.0, 1.0);
        assert_eq!((terms.distance, terms.pairs), (0.0, 1));
        assert!(gradient.train.iter().all(|&g| g == 0.0));
    }
}
