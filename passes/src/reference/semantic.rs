//! Reference of the semantic loss. Everything is decoded to its full width, sample by sample, as defined.

/// Decoder and classes, of any width.
#[derive(Clone, Debug)]
pub struct Head {
    /// Number of features.
    pub features: usize,
    /// Width of the decoded embedding.
    pub embedding: usize,
    /// Rows of weights and a bias, `[embedding * (features + 1)]`.
    pub decoder: Vec<f64>,
    /// Unit rows of the classes, `[classes * embedding]`.
    pub text: Vec<f64>,
}

/// Features of a view and its target map.
#[derive(Clone, Debug)]
pub struct View {
    /// Columns and rows of the image.
    pub size: [usize; 2],
    /// Features, `[P * features]`.
    pub image: Vec<f64>,
    /// Columns and rows of the map.
    pub map: [usize; 2],
    /// Target embeddings, `[samples * embedding]`.
    pub targets: Vec<f64>,
    /// Class of each sample, if any.
    pub labels: Vec<Option<usize>>,
}

/// Weights and temperature.
#[derive(Clone, Copy, Debug)]
pub struct Weights {
    /// Weight of 1 - cos.
    pub cosine: f64,
    /// Weight of the cross-entropy.
    pub class: f64,
    /// Divisor of the logits.
    pub temperature: f64,
}

/// Means of the two terms.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Terms {
    /// Mean of 1 - cos.
    pub cosine: f64,
    /// Mean cross-entropy.
    pub class: f64,
}

/// Gradients of features and decoder.
#[derive(Clone, Debug)]
pub struct Gradient {
    /// Gradient of [`View::image`].
    pub image: Vec<f64>,
    /// Gradient of [`Head::decoder`].
    pub decoder: Vec<f64>,
}

/// Decoded embedding at one sample.
pub(super) struct Decoded {
    /// Embedding W f + b.
    pub vector: Vec<f64>,
    /// Inverse length of the embedding; 0 if it counts as zero.
    pub inverse: f64,
    /// Whether single precision is certain to agree on `inverse` being 0.
    pub sure: bool,
    /// Squared sum of the lengths of all contributions. Bounds the rounding error of the squared length in single
    /// precision, in units of the last place.
    pub products: f64,
}

/// Bounds of single-precision rounding errors, in units of the last place. A bound is the magnitude of the summands in
/// the kernels, which use inner products of the decoder's columns.
#[derive(Clone, Debug)]
pub struct Rounding {
    /// Bounds of the means.
    pub terms: Terms,
    /// Bounds of the gradients.
    pub gradient: Gradient,
    /// Whether rounding cannot decide that a decoded embedding counts as zero.
    pub sure: bool,
    /// Lengths of the decoder's columns, the bias last.
    columns: Vec<f64>,
    /// Largest magnitude of every column of the class embeddings.
    widest: Vec<f64>,
}

impl Rounding {
    pub(super) fn new(head: &Head, image: usize) -> Rounding {
        let mut columns = vec![0.0; head.features + 1];
        for row in head.decoder.chunks(head.features + 1) {
            columns.iter_mut().zip(row).for_each(|(c, x)| *c += x * x);
        }
        let mut widest = vec![0.0_f64; head.embedding];
        for text in head.text.chunks(head.embedding) {
            widest.iter_mut().zip(text).for_each(|(w, t)| *w = w.max(t.abs()));
        }
        Rounding {
            terms: Terms::default(),
            gradient: Gradient { image: vec![0.0; image], decoder: vec![0.0; head.decoder.len()] },
            sure: true,
            columns: columns.into_iter().map(f64::sqrt).collect(),
            widest,
        }
    }

    /// Adds the bounds of one decoded sample. `target` and its weight are those of the cosine, `class` and the
    /// temperature those of the cross-entropy; both weights may be zero. Returns the bounds of the gradient of the
    /// sample's features.
    pub(super) fn add(
        &mut self,
        head: &Head,
        d: &Decoded,
        f: &[f64],
        (target, cosine): (&[f64], f64),
        (class, temperature): (f64, f64),
    ) -> Vec<f64> {
        self.sure &= d.sure;
        let all = || f.iter().copied().chain([1.0]);
        let condition = (d.products * d.inverse * d.inverse).max(1.0);
        // A logit's error is its magnitude in units of the last place; a probability has the same relative error.
        let class = 2.0 * class / temperature * (1.0 + 1.0 / temperature);
        let length = dot(target, target).sqrt().max(f64::MIN_POSITIVE);
        self.terms.cosine += if cosine > 0.0 { condition } else { 0.0 };
        self.terms.class += if class > 0.0 { condition * (1.0 + 1.0 / temperature) } else { 0.0 };
        for j in 0..head.embedding {
            let row = &head.decoder[j * (head.features + 1)..][..=head.features];
            let decoded = row.iter().zip(all()).map(|(w, f)| (w * f).powi(2)).sum::<f64>().sqrt() * d.inverse;
            let pull = cosine * (target.get(j).map_or(0.0, |t| t.abs() / length) + decoded)
                + class * (self.widest[j] + decoded);
            let to = &mut self.gradient.decoder[j * (head.features + 1)..][..=head.features];
            to.iter_mut().zip(all()).for_each(|(to, f)| *to += d.inverse * condition * pull * f.abs());
        }
        let pull = d.inverse * condition * (cosine + class);
        self.columns[..head.features].iter().map(|c| pull * c).collect()
    }
}

pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

impl Head {
    /// Returns the number of classes.
    pub fn classes(&self) -> usize {
        self.text.len() / self.embedding
    }

    fn row(&self, j: usize) -> (&[f64], f64) {
        let row = &self.decoder[j * (self.features + 1)..][..=self.features];
        (&row[..self.features], row[self.features])
    }

    pub(super) fn decode(&self, f: &[f64]) -> Decoded {
        // Squared contributions of every feature and of the bias.
        let mut parts = vec![0.0; self.features + 1];
        let decoded = |j: usize| {
            let (row, bias) = self.row(j);
            let products = row.iter().zip(f).map(|(w, f)| w * f).chain([bias]);
            parts.iter_mut().zip(products).fold(0.0, |sum, (part, x)| {
                *part += x * x;
                sum + x
            })
        };
        let vector: Vec<f64> = (0..self.embedding).map(decoded).collect();
        let square = dot(&vector, &vector);
        // As in the kernel, an embedding shorter than 1e-3 of its contributions, or than 1e-8, counts as zero.
        let least = (1e-6 * parts.iter().sum::<f64>()).max(1e-16);
        let inverse = if square > least { 1.0 / square.sqrt() } else { 0.0 };
        // The kernel's square is a sum of products of the contributions, with an error of some units of their last
        // place.
        let products = parts.iter().map(|p| p.sqrt()).sum::<f64>().powi(2);
        let sure = (square - least).abs() > 3e-7 * products;
        Decoded { vector, inverse, sure, products }
    }

    /// Returns the logits of all classes.
    pub(super) fn logits(&self, d: &Decoded, temperature: f64) -> Vec<f64> {
        self.text.chunks(self.embedding).map(|t| dot(t, &d.vector) * d.inverse / temperature).collect()
    }

    /// Returns the cross-entropy to a class, and its gradient by the unit embedding.
    pub(super) fn cross_entropy(&self, d: &Decoded, label: usize, temperature: f64) -> (f64, Vec<f64>) {
        let logits = self.logits(d, temperature);
        let top = logits.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let total: f64 = logits.iter().map(|l| (l - top).exp()).sum();
        let mut by_unit = vec![0.0; self.embedding];
        for (c, l) in logits.iter().enumerate() {
            let g = ((l - top).exp() / total - f64::from(u8::from(c == label))) / temperature;
            let text = &self.text[c * self.embedding..][..self.embedding];
            by_unit.iter_mut().zip(text).for_each(|(b, t)| *b += g * t);
        }
        (total.ln() + top - logits[label], by_unit)
    }

    /// Propagates the gradient of the unit embedding to the features and the decoder. Returns the gradient of the
    /// features, and adds to that of the decoder.
    pub(super) fn back(&self, d: &Decoded, f: &[f64], by_unit: &[f64], by_decoder: &mut [f64]) -> Vec<f64> {
        let along = dot(by_unit, &d.vector) * d.inverse * d.inverse;
        let mut by_features = vec![0.0; self.features];
        for j in 0..self.embedding {
            let g = d.inverse * (by_unit[j] - along * d.vector[j]);
            let row = &mut by_decoder[j * (self.features + 1)..][..=self.features];
            for k in 0..self.features {
                row[k] += g * f[k];
                by_features[k] += g * self.row(j).0[k];
            }
            row[self.features] += g;
        }
        by_features
    }
}

/// Returns the two pixels and weights of sample `i` of `samples`. The first and last samples lie on the first and last
/// of `pixels`.
fn taps(i: usize, samples: usize, pixels: usize) -> [(usize, f64); 2] {
    let at = if samples > 1 { i as f64 * (pixels - 1) as f64 / (samples - 1) as f64 } else { 0.0 };
    // A position on a pixel must not be rounded to just before the pixel.
    let first = (at + 1e-9).floor();
    let rest = (at - first).max(0.0);
    [(first as usize, 1.0 - rest), ((first as usize + 1).min(pixels - 1), rest)]
}

impl View {
    fn taps(&self, i: usize) -> Vec<(usize, f64)> {
        let (x, y) =
            (taps(i % self.map[0], self.map[0], self.size[0]), taps(i / self.map[0], self.map[1], self.size[1]));
        let both = |&(y, wy): &(usize, f64)| x.map(|(x, wx)| (y * self.size[0] + x, wx * wy));
        y.iter().flat_map(both).filter(|t| t.1 > 0.0).collect()
    }

    fn sample(&self, features: usize, i: usize) -> Vec<f64> {
        let taps = self.taps(i);
        (0..features).map(|k| taps.iter().map(|&(p, w)| w * self.image[p * features + k]).sum()).collect()
    }

    fn target(&self, embedding: usize, i: usize) -> Option<&[f64]> {
        let t = &self.targets[i * embedding..][..embedding];
        (t.iter().all(|x| x.is_finite()) && t.iter().any(|&x| x != 0.0)).then_some(t)
    }

    /// Returns the number of valid samples, and of those that have a class.
    pub fn counts(&self, head: &Head) -> [usize; 2] {
        let valid = (0..self.labels.len()).filter(|&i| self.target(head.embedding, i).is_some());
        let valid: Vec<usize> = valid.collect();
        [valid.len(), valid.iter().filter(|&&i| self.labels[i].is_some_and(|l| l < head.classes())).count()]
    }

    /// Returns the class of every target: the one with the largest cosine.
    pub fn own_labels(&self, head: &Head) -> Vec<Option<usize>> {
        let label = |i: usize| {
            let t = self.target(head.embedding, i)?;
            let products = head.text.chunks(head.embedding).map(|row| dot(row, t));
            Some(products.enumerate().fold((0, f64::NEG_INFINITY), |b, (c, p)| if p > b.1 { (c, p) } else { b }).0)
        };
        (0..self.map[0] * self.map[1]).map(label).collect()
    }
}

/// Returns the loss and its gradient; samples with non-finite features add nothing.
pub fn semantic_loss(head: &Head, view: &View, weights: &Weights) -> (Terms, Gradient) {
    semantic_loss_into(head, view, weights, None)
}

/// Returns the loss, its gradient, and bounds of single-precision rounding errors.
pub fn semantic_loss_rounding(head: &Head, view: &View, weights: &Weights) -> (Terms, Gradient, Rounding) {
    let mut rounding = Rounding::new(head, view.image.len());
    let (terms, gradient) = semantic_loss_into(head, view, weights, Some(&mut rounding));
    (terms, gradient, rounding)
}

fn semantic_loss_into(
    head: &Head,
    view: &View,
    weights: &Weights,
    mut rounding: Option<&mut Rounding>,
) -> (Terms, Gradient) {
    let mut terms = Terms::default();
    let mut gradient = Gradient { image: vec![0.0; view.image.len()], decoder: vec![0.0; head.decoder.len()] };
    let [valid, labeled] = view.counts(head).map(|n| n.max(1) as f64);
    for i in 0..view.labels.len() {
        let Some(target) = view.target(head.embedding, i) else { continue };
        let f = view.sample(head.features, i);
        if f.iter().any(|x| !x.is_finite()) {
            continue;
        }
        let d = head.decode(&f);
        let length = dot(target, target).sqrt();
        terms.cosine += (1.0 - dot(target, &d.vector) * d.inverse / length) / valid;
        let mut by_unit: Vec<f64> = target.iter().map(|t| -weights.cosine / valid * t / length).collect();
        let label = view.labels[i].filter(|&l| l < head.classes());
        if let Some(label) = label {
            let (entropy, by) = head.cross_entropy(&d, label, weights.temperature);
            terms.class += entropy / labeled;
            by_unit.iter_mut().zip(by).for_each(|(b, g)| *b += weights.class / labeled * g);
        }
        let by_features = head.back(&d, &f, &by_unit, &mut gradient.decoder);
        for (p, w) in view.taps(i) {
            for k in 0..head.features {
                gradient.image[p * head.features + k] += w * by_features[k];
            }
        }
        if let Some(rounding) = rounding.as_deref_mut() {
            let class = if label.is_some() { weights.class / labeled } else { 0.0 };
            let sizes = rounding.add(head, &d, &f, (target, weights.cosine / valid), (class, weights.temperature));
            for (p, w) in view.taps(i) {
                let to = &mut rounding.gradient.image[p * head.features..][..head.features];
                to.iter_mut().zip(&sizes).for_each(|(to, s)| *to += w * s);
            }
        }
    }
    if let Some(rounding) = rounding {
        rounding.terms.cosine /= valid;
        rounding.terms.class /= labeled;
    }
    (terms, gradient)
}

/// Returns the class of the largest cosine, and the logits at a temperature.
pub fn classify(head: &Head, f: &[f64], temperature: f64) -> (usize, Vec<f64>) {
    let logits = head.logits(&head.decode(f), temperature);
    let products: Vec<f64> = head.text.chunks(head.embedding).map(|t| dot(t, &head.decode(f).vector)).collect();
    let best = products.iter().enumerate().fold((0, f64::NEG_INFINITY), |b, (c, &p)| if p > b.1 { (c, p) } else { b });
    (best.0, logits)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::rng::Pcg;

    pub(in crate::reference) fn head(features: usize, embedding: usize, classes: usize, rng: &mut Pcg) -> Head {
        let mut text: Vec<f64> = (0..classes * embedding).map(|_| rng.normal()).collect();
        for row in text.chunks_mut(embedding) {
            let length = dot(row, row).sqrt();
            row.iter_mut().for_each(|x| *x /= length);
        }
        let decoder = (0..embedding * (features + 1)).map(|_| rng.range(-0.5, 0.5)).collect();
        Head { features, embedding, decoder, text }
    }

    fn view(size: [usize; 2], map: [usize; 2], head: &Head, rng: &mut Pcg) -> View {
        let samples = map[0] * map[1];
        let mut normal = |n: usize| (0..n).map(|_| rng.normal()).collect::<Vec<f64>>();
        let (image, mut targets) = (normal(size[0] * size[1] * head.features), normal(samples * head.embedding));
        if samples > 3 {
            targets[head.embedding] = f64::NAN;
            targets[..head.embedding].fill(0.0);
        }
        let mut view = View { size, image, map, targets, labels: vec![] };
        view.labels = view.own_labels(head);
        if let Some(last) = view.labels.iter_mut().skip(4).last() {
            *last = Some(99);
        }
        view
    }

    #[test]
    fn gradient_matches_finite_differences() {
        let weights = Weights { cosine: 0.7, class: 1.3, temperature: 0.4 };
        let sizes = [([1, 1], [1, 1]), ([4, 3], [1, 1]), ([3, 4], [5, 2]), ([1, 3], [2, 7]), ([5, 4], [5, 4])];
        for (i, (size, map)) in sizes.into_iter().enumerate() {
            let mut rng = Pcg::new(i as u32);
            let mut h = head(3, 7, 1 + i, &mut rng);
            let mut v = view(size, map, &h, &mut rng);
            let total = |h: &Head, v: &View| {
                let t = semantic_loss(h, v, &weights).0;
                weights.cosine * t.cosine + weights.class * t.class
            };
            let gradient = semantic_loss(&h, &v, &weights).1;
            for k in 0..v.image.len() {
                let mut x = v.image.clone();
                let fd =
                    crate::reference::difference(&mut x, k, |x| total(&h, &View { image: x.to_vec(), ..v.clone() }));
                assert!((fd - gradient.image[k]).abs() < 1e-7, "{size:?} {map:?} {k}: {fd} {}", gradient.image[k]);
            }
            for k in 0..h.decoder.len() {
                let mut x = h.decoder.clone();
                let fd =
                    crate::reference::difference(&mut x, k, |x| total(&Head { decoder: x.to_vec(), ..h.clone() }, &v));
                assert!((fd - gradient.decoder[k]).abs() < 1e-7, "{size:?} {map:?} {k}: {fd}");
            }
            // Features that are NaN invalidate only their own samples.
            v.image[0] = f64::NAN;
            let (terms, gradient) = semantic_loss(&h, &v, &weights);
            let all = gradient.image.iter().chain(&gradient.decoder);
            assert!(terms.cosine.is_finite() && all.into_iter().all(|g| g.is_finite()));
            h.decoder.fill(0.0);
            assert!(semantic_loss(&h, &v, &weights).1.decoder.iter().all(|&g| g == 0.0));
        }
    }

    #[test]
    fn correctly_decoded_targets_have_no_cosine_loss() {
        let mut rng = Pcg::new(4);
        let h = head(3, 6, 4, &mut rng);
        let mut v = view([2, 2], [2, 2], &h, &mut rng);
        v.targets = v.image.chunks(3).flat_map(|f| h.decode(f).vector.into_iter().map(|x| 3.0 * x)).collect();
        v.labels = vec![None; 4];
        let (terms, gradient) = semantic_loss(&h, &v, &Weights { cosine: 1.0, class: 1.0, temperature: 1.0 });
        assert!(terms.cosine.abs() < 1e-12 && terms.class == 0.0, "{terms:?}");
        assert!(gradient.image.iter().chain(&gradient.decoder).all(|g| g.abs() < 1e-12));
    }
}
