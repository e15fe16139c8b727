//! Least-squares gains that bring images closest to others.

use sgs_scene::Image;

use super::{MetricError, check, pairs};

/// Sums of a least-squares fit of one gain per channel. The fit may cover any number of image pairs.
#[derive(Clone, Debug)]
pub struct GainFit {
    /// Σ a·b and Σ a², by channel.
    sums: Vec<[f64; 2]>,
}

impl GainFit {
    /// Starts a fit for images of `channels` channels.
    pub fn new(channels: usize) -> GainFit {
        GainFit { sums: vec![[0.0; 2]; channels] }
    }

    /// Adds a value `a` and its target `b`. Ignores channels beyond those of the fit.
    pub fn add(&mut self, channel: usize, a: f32, b: f32) {
        if let Some([ab, aa]) = self.sums.get_mut(channel) {
            *ab += f64::from(a) * f64::from(b);
            *aa += f64::from(a) * f64::from(a);
        }
    }

    /// Adds the pixels that count of a pair of images.
    ///
    /// # Errors
    /// If the sizes differ.
    pub fn add_images(&mut self, a: &Image, b: &Image, mask: Option<&Image>) -> Result<(), MetricError> {
        check("gain", a, b, mask)?;
        for (a, b) in pairs(a, b, mask) {
            for (c, (&a, &b)) in a.iter().zip(b).enumerate() {
                self.add(c, a, b);
            }
        }
        Ok(())
    }

    /// Returns one gain per channel. A channel that is zero everywhere has the gain 1.
    pub fn per_channel(&self) -> Vec<f64> {
        self.sums.iter().map(|sums| gain(*sums)).collect()
    }

    /// Returns one gain for all channels; 1 where all values are zero.
    pub fn common(&self) -> f64 {
        gain(self.sums.iter().fold([0.0; 2], |all, one| [all[0] + one[0], all[1] + one[1]]))
    }
}

fn gain([ab, aa]: [f64; 2]) -> f64 {
    if aa > 0.0 { ab / aa } else { 1.0 }
}

/// Multiplies each channel of an image by its gain. Channels without a gain do not change.
pub fn scaled(image: &Image, gains: &[f64]) -> Image {
    let channels = image.channels.max(1) as usize;
    let value = |(i, v): (usize, &f32)| (f64::from(*v) * gains.get(i % channels).copied().unwrap_or(1.0)) as f32;
    Image { data: image.data.iter().enumerate().map(value).collect(), ..image.clone() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(channels: u32, data: &[f32]) -> Image {
        Image::from_data(data.len() as u32 / channels, 1, channels, data.to_vec()).unwrap()
    }

    /// Two images of one pixel each. Red (1→2) and (3→2) gives 8/10, green (2→1) and (0→5) gives 2/4, blue is black.
    #[test]
    fn gain_covers_pixels_of_all_images() {
        let mut fit = GainFit::new(3);
        fit.add_images(&image(3, &[1.0, 2.0, 0.0]), &image(3, &[2.0, 1.0, 7.0]), None).unwrap();
        fit.add_images(&image(3, &[3.0, 0.0, 0.0]), &image(3, &[2.0, 5.0, 7.0]), None).unwrap();
        let gains = fit.per_channel();
        assert!((gains[0] - 0.8).abs() < 1e-12 && (gains[1] - 0.5).abs() < 1e-12 && gains[2] == 1.0, "{gains:?}");
        assert!((fit.common() - 10.0 / 14.0).abs() < 1e-12);
        assert_eq!(scaled(&image(3, &[1.0, 2.0, 3.0]), &[2.0, 0.5, 1.0]).data, [2.0, 1.0, 3.0]);
        assert_eq!(scaled(&image(3, &[1.0, 2.0, 3.0]), &[2.0]).data, [2.0, 2.0, 3.0]);
    }

    #[test]
    fn masked_pixels_do_not_affect_the_gain() {
        let mut fit = GainFit::new(1);
        let mask = image(1, &[1.0, 0.0]);
        fit.add_images(&image(1, &[1.0, 9.0]), &image(1, &[3.0, 0.0]), Some(&mask)).unwrap();
        assert_eq!((fit.per_channel(), fit.common()), (vec![3.0], 3.0));
        assert!(fit.add_images(&image(1, &[1.0]), &image(1, &[1.0, 2.0]), None).is_err());
        assert_eq!(GainFit::new(2).common(), 1.0);
    }
}
