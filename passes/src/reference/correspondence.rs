//! Twin of the correspondence loss of a region between a training view and pseudo-views.

use super::semantic::{Head, Rounding as PlaceRounding, dot};

/// A picture's features, pixel by pixel, and where the region is in it.
#[derive(Clone, Debug)]
pub struct Picture {
    /// `[P * features]`.
    pub image: Vec<f64>,
    /// Whether a pixel belongs.
    pub mask: Vec<bool>,
}

/// Regions of fewer pixels are no evidence.
pub const LEAST_PIXELS: usize = 16;

/// The two means over the pseudo-views, and how many of these counted.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Terms {
    /// Distance of mean features.
    pub distance: f64,
    /// Cross-entropy to the training view's class.
    pub class: f64,
    /// Pseudo-views whose regions are large enough.
    pub pairs: usize,
}

/// Gradients: of the training view, of each pseudo-view, of the decoder.
#[derive(Clone, Debug)]
pub struct Gradient {
    /// By the training view's features.
    pub train: Vec<f64>,
    /// By each pseudo-view's.
    pub pseudo: Vec<Vec<f64>>,
    /// By the decoder.
    pub decoder: Vec<f64>,
}

/// What single precision rounds numbers by, in units of the last place: the size of what they are sums of.
#[derive(Clone, Debug)]
pub struct Rounding {
    /// Of the means.
    pub terms: Terms,
    /// Of gradients.
    pub gradient: Gradient,
    /// Whether rounding cannot change which class most pixels of the training view have, or whether something decoded is
    /// nothing.
    pub sure: bool,
}

impl Picture {
    fn members(&self, features: usize) -> Vec<usize> {
        let finite = |p: usize| self.image[p * features..][..features].iter().all(|x| x.is_finite());
        (0..self.mask.len()).filter(|&p| self.mask[p] && finite(p)).collect()
    }

    fn mean(&self, features: usize) -> Vec<f64> {
        let members = self.members(features);
        let n = members.len().max(1) as f64;
        (0..features).map(|k| members.iter().map(|&p| self.image[p * features + k]).sum::<f64>() / n).collect()
    }

    /// Means of the sizes.
    fn size(&self, features: usize) -> Vec<f64> {
        Picture { image: self.image.iter().map(|x| x.abs()).collect(), mask: self.mask.clone() }.mean(features)
    }

    /// The class of most of its pixels, the first of equals.
    pub fn majority(&self, head: &Head) -> usize {
        self.majority_surely(head).0
    }

    /// The same, and whether single precision says so too.
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

/// The loss and its gradient times `weight`.
pub fn correspondence(
    head: &Head,
    train: &Picture,
    pseudo: &[Picture],
    weight: f64,
    temperature: f64,
) -> (Terms, Gradient) {
    let (terms, gradient, _) = correspondence_rounding(head, train, pseudo, weight, temperature);
    (terms, gradient)
}

/// The same, and what single precision rounds it by.
pub fn correspondence_rounding(
    head: &Head,
    train: &Picture,
    pseudo: &[Picture],
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
    for (i, picture) in pseudo.iter().enumerate() {
        let theirs = picture.members(n);
        if mine.len() < LEAST_PIXELS || theirs.len() < LEAST_PIXELS {
            continue;
        }
        terms.pairs += 1;
        let apart: Vec<f64> = picture.mean(n).iter().zip(train.mean(n)).map(|(a, b)| a - b).collect();
        let distance = dot(&apart, &apart).sqrt();
        terms.distance += share * distance;
        let toward = |k: usize| if distance > 0.0 { weight * share * apart[k] / distance } else { 0.0 };
        // A difference of means is off by these, each and all of it.
        let sizes: Vec<f64> = picture.size(n).iter().zip(train.size(n)).map(|(a, b)| a + b).collect();
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
            let f = &picture.image[p * n..][..n];
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
    use crate::reference::rng::Pcg;
    use crate::reference::semantic::tests::head;

    fn picture(pixels: usize, share: f64, rng: &mut Pcg) -> Picture {
        let image = (0..3 * pixels).map(|_| rng.normal()).collect();
        Picture { image, mask: (0..pixels).map(|_| rng.uniform() < share).collect() }
    }

    #[test]
    fn gradient_is_the_finite_difference() {
        let mut rng = Pcg::new(9);
        let h = head(3, 7, 4, &mut rng);
        let train = picture(60, 0.7, &mut rng);
        // The last region is too small.
        let pseudo = [picture(40, 0.9, &mut rng), picture(50, 0.6, &mut rng), picture(50, 0.1, &mut rng)];
        let (weight, temperature) = (0.6, 0.5);
        let (terms, gradient) = correspondence(&h, &train, &pseudo, weight, temperature);
        assert_eq!(terms.pairs, 2);
        let label = train.majority(&h);
        let total = |h: &Head, train: &Picture, pseudo: &[Picture]| {
            // The class has no gradient, and must not change while others are taken.
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
        check(&train.image, &gradient.train, &|x| total(&h, &Picture { image: x.to_vec(), ..train.clone() }, &pseudo));
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
    fn regions_that_agree_have_no_distance_and_no_gradient_of_it() {
        let mut rng = Pcg::new(2);
        let h = head(3, 5, 2, &mut rng);
        let train = picture(64, 1.0, &mut rng);
        let (terms, gradient) = correspondence(&h, &train, std::slice::from_ref(&train), 1.0, 1.0);
        assert_eq!((terms.distance, terms.pairs), (0.0, 1));
        assert!(gradient.train.iter().all(|&g| g == 0.0));
    }
}
