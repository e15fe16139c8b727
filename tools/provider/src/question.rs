//! Images of questions and typed answers.

use crate::array::Array;
use crate::error::Nonsense;
use crate::offer::{Encoding, Offer};
use half::f16;
use serde_json::{Value, json};
use sgs_scene::{Camera, DepthMeaning, Image, NormalFrame, linear_to_srgb, resize, srgb_to_linear};

/// Image of a question, with its encoding and hints.
#[derive(Clone, Debug)]
pub struct ProviderImage<'a> {
    /// RGB image.
    pub image: &'a Image,
    /// Encoding of the values: sRGB-encoded in `[0, 1]`, or linear.
    pub encoding: Encoding,
    /// Name of the view, for a photograph of a scene. A hint that networks may ignore.
    pub view: Option<&'a str>,
    /// Camera of the photograph or rendering. A hint that networks may ignore.
    pub camera: Option<&'a Camera>,
}

impl<'a> ProviderImage<'a> {
    /// Creates a question image from an sRGB-encoded image that belongs to no view.
    pub fn srgb(image: &'a Image) -> ProviderImage<'a> {
        ProviderImage { image, encoding: Encoding::Srgb, view: None, camera: None }
    }

    /// Returns the problem of the image, if any.
    pub(crate) fn problem(&self) -> Option<String> {
        if self.image.channels != 3 {
            return Some(format!("an image has {} channels instead of 3", self.image.channels));
        }
        self.image.check().err().map(|e| e.to_string())
    }

    /// Returns width and height for an offer.
    pub(crate) fn sent_size(&self, offer: &Offer) -> [u32; 2] {
        let (w, h) = (self.image.width, self.image.height);
        match offer.max_side {
            Some(most) if w.max(h) > most => {
                let factor = f64::from(most) / f64::from(w.max(h));
                [w, h].map(|n| ((f64::from(n) * factor).round() as u32).clamp(1, most))
            }
            _ => [w, h],
        }
    }

    /// Returns the array for an offer. Resizing happens in linear light.
    pub(crate) fn array(&self, offer: &Offer) -> Array {
        let [width, height] = self.sent_size(offer);
        let same_size = [width, height] == [self.image.width, self.image.height];
        let shape = [height as usize, width as usize, 3];
        let mut image = self.image.clone();
        let mut encoding = self.encoding;
        if encoding == Encoding::Srgb && (offer.image == Encoding::Linear || !same_size) {
            image.data.iter_mut().for_each(|v| *v = srgb_to_linear(*v));
            encoding = Encoding::Linear;
        }
        if !same_size {
            image = resize(&image, width, height);
        }
        if offer.image == Encoding::Linear {
            return Array::f32(&shape, &image.data);
        }
        let code = |v: f32| if encoding == Encoding::Linear { linear_to_srgb(v.clamp(0.0, 1.0)) } else { v };
        // A cast of NaN gives 0.
        let bytes = image.data.iter().map(|v| (code(*v).clamp(0.0, 1.0) * 255.0 + 0.5) as u8).collect();
        Array::u8(&shape, bytes)
    }

    /// Returns the hints of the array: the view's name and the camera of the image as sent.
    pub(crate) fn hints(&self, offer: &Offer) -> Value {
        let mut hints = json!({});
        if let Some(view) = self.view {
            hints["name"] = view.into();
        }
        if let Some(camera) = self.camera {
            let [width, height] = self.sent_size(offer);
            let c = camera.scaled(width, height);
            let rows: Vec<[f64; 4]> = (0..3)
                .map(|i| {
                    let r = c.rotation.row(i);
                    [r.x, r.y, r.z, c.translation[i]]
                })
                .collect();
            hints["camera"] = json!({
                "width": width, "height": height, "fx": c.fx, "fy": c.fy, "cx": c.cx, "cy": c.cy, "world_to_camera": rows,
            });
        }
        hints
    }
}

/// Masks of one object in three frames.
#[derive(Clone, Debug, PartialEq)]
pub struct Masks {
    /// Width and height, those of the caller's images.
    pub size: [u32; 2],
    /// Mask of each frame, row by row.
    pub frames: [Vec<bool>; 3],
}

/// Region numbers of an image; 0 means no region.
#[derive(Clone, Debug, PartialEq)]
pub struct Regions {
    /// Width and height of the image as sent.
    pub size: [u32; 2],
    /// Region numbers, row by row.
    pub ids: Vec<u16>,
}

/// Normals of an image.
#[derive(Clone, Debug, PartialEq)]
pub struct Normals {
    /// Coordinate frame of the normals.
    pub frame: NormalFrame,
    /// Unit vectors in three channels, zero where unknown.
    ///
    /// The size is that of the image as sent.
    pub image: Image,
}

/// Depth of an image.
#[derive(Clone, Debug, PartialEq)]
pub struct Depth {
    /// Meaning of the values.
    pub meaning: DepthMeaning,
    /// Depth in one channel; NaN where unknown. The size is that of the image as sent.
    pub image: Image,
    /// Confidence from 0 to 1 in one channel of the same size.
    pub confidence: Option<Image>,
}

/// Features comparable with text embeddings.
#[derive(Clone, Debug, PartialEq)]
pub struct Features {
    /// Rows, columns and channels. The map covers the whole image.
    pub shape: [usize; 3],
    /// Features cell by cell, row by row.
    pub data: Vec<f16>,
}

/// Material maps of an image.
///
/// NaN marks unknown pixels. The size is that of the image as sent.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Materials {
    /// RGB.
    pub albedo: Option<Image>,
    /// True for linear albedo, false for sRGB-encoded albedo.
    pub albedo_is_linear: bool,
    /// Roughness, one channel.
    pub roughness: Option<Image>,
    /// Metallic, one channel.
    pub metallic: Option<Image>,
}

/// Scales normals to unit length. Vectors that are too short or NaN become zero.
pub(crate) fn unit(array: &Array, size: [u32; 2]) -> Result<Image, Nonsense> {
    array.check("normals", "numbers that are not infinite", |v| !v.is_infinite())?;
    let mut image = Image { width: size[0], height: size[1], channels: 3, data: array.floats() };
    for n in image.data.chunks_exact_mut(3) {
        let length = n.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
        // NaN compares as false.
        let known = length > 0.1;
        n.iter_mut().for_each(|v| *v = if known { (f64::from(*v) / length) as f32 } else { 0.0 });
    }
    Ok(image)
}

/// Resizes a mask. Each pixel takes the value at its center.
pub(crate) fn stretch(mask: &[u8], from: [u32; 2], to: [u32; 2]) -> Vec<bool> {
    let at = |i: u32, axis: usize| {
        let place = (f64::from(i) + 0.5) * f64::from(from[axis]) / f64::from(to[axis]);
        ((place + 1e-9) as usize).min(from[axis] as usize - 1)
    };
    let pixels = (0..to[1]).flat_map(|y| (0..to[0]).map(move |x| (x, y)));
    pixels.map(|(x, y)| mask[at(y, 1) * from[0] as usize + at(x, 0)] != 0).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_are_converted_to_the_offered_encoding() {
        let image = Image::from_data(2, 1, 3, vec![0.0, 0.2, 1.0, 1.0, 0.2, f32::NAN]).unwrap();
        let srgb = ProviderImage::srgb(&image);
        let offer = |image, max_side| Offer { image, max_side, ..Offer::default() };
        assert_eq!(srgb.array(&offer(Encoding::Srgb, None)), Array::u8(&[1, 2, 3], vec![0, 51, 255, 255, 51, 0]));
        let linear = srgb.array(&offer(Encoding::Linear, Some(8))).floats();
        assert_eq!(linear[..3], [0.0, srgb_to_linear(0.2), 1.0]);
        let light = Image::from_data(2, 1, 3, vec![0.0, 0.0, 3.0, 1.0, 0.0, 3.0]).unwrap();
        let light = ProviderImage { encoding: Encoding::Linear, ..ProviderImage::srgb(&light) };
        assert_eq!(light.array(&offer(Encoding::Linear, None)).floats()[2], 3.0);
        // The mean of 0 and 1 in linear light is code 188, not 128.
        let small = light.array(&offer(Encoding::Srgb, Some(1)));
        assert_eq!((small.shape, small.bytes), (vec![1, 1, 3], vec![188, 0, 255]));
    }

    #[test]
    fn large_images_are_downscaled_to_max_side() {
        let image = Image::new(300, 200, 3);
        let size = |max_side| ProviderImage::srgb(&image).sent_size(&Offer { max_side, ..Offer::default() });
        assert_eq!((size(None), size(Some(300)), size(Some(100))), ([300, 200], [300, 200], [100, 67]));
        let wide = Image::new(300, 1, 3);
        assert_eq!(ProviderImage::srgb(&wide).sent_size(&Offer { max_side: Some(10), ..Offer::default() }), [10, 1]);
        assert!(ProviderImage::srgb(&Image::new(2, 2, 1)).problem().unwrap().contains("1 channels"));
    }

    #[test]
    fn mask_resize_samples_pixel_centers() {
        assert_eq!(stretch(&[1, 0], [2, 1], [4, 1]), [true, true, false, false]);
        assert_eq!(stretch(&[1, 0, 0, 1], [2, 2], [1, 1]), [true]);
        assert_eq!(stretch(&[1, 0, 1], [3, 1], [3, 1]), [true, false, true]);
    }

    #[test]
    fn normals_become_unit_or_zero() {
        let of = |v: &[f32]| unit(&Array::f32(&[1, v.len() / 3, 3], v), [v.len() as u32 / 3, 1]);
        let image = of(&[0.0, 3.0, 4.0, f32::NAN, 0.0, 1.0, 0.0, 0.01, 0.0]).unwrap();
        assert_eq!(image.data, [0.0, 0.6, 0.8, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        assert!(of(&[0.0, f32::INFINITY, 0.0]).is_err());
    }
}
