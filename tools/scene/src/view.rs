//! Photograph with its camera.

use std::path::PathBuf;

use crate::beside::{Beside, check_size};
use crate::camera::{Camera, Distortion};
use crate::error::{Result, SceneError};
use crate::image::{
    Encoding, Image, linear_to_srgb, read_raster, resized, srgb_to_linear, undistort, undistort_coverage,
};
use crate::map_file::{self, Meaning};
use crate::reader::Frame;

/// Largest finite half-precision value. Half-float files store infinity for pixels that exceed their range. Clamping to
/// this value keeps averages finite.
const BRIGHTEST: f32 = 65_504.0;

/// View of a scene: its camera, and the location and format of its photograph.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// Camera of the loaded image: undistorted, at the scene's scale. Training may have learned its numbers.
    pub camera: Camera,
    /// Path of the photograph.
    pub image_path: PathBuf,
    /// Lens distortion of the stored photograph.
    pub distortion: Distortion,
    /// Camera at the size of the stored photograph.
    pub stored_camera: Camera,
    /// Factors on red, green and blue that gave this photograph its exposure; loading divides by them. 1 if unknown.
    pub gains: [f32; 3],
    /// Vignetting: logarithm of the factor on colors at the corners of the image.
    ///
    /// It grows with the square of the distance from the center of the image. Loading removes it. 0 if unknown.
    pub vignetting: f32,
    /// Whether training learned the pose. Noise does not move it again.
    pub learned_pose: bool,
    declared_in: PathBuf,
    pub(crate) beside: Beside,
}

/// Photograph as stored: at its own size and with its lens distortion. Priors have the same distortion.
#[derive(Clone, Debug, PartialEq)]
pub struct Photograph {
    /// RGB values.
    pub image: Image,
    /// Whether the values are linear (exposed, not clipped) or sRGB-encoded.
    pub linear: bool,
}

/// Options for loading photographs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoadOptions {
    /// Factor on linear (EXR) values before clipping and encoding.
    pub exposure: f32,
    /// Background color of PNG images with alpha, display-referred.
    pub background: [f32; 3],
}

impl Default for LoadOptions {
    fn default() -> Self {
        Self { exposure: 1.0, background: [0.0; 3] }
    }
}

impl View {
    /// Creates the view of a frame at `scale` times its size.
    pub(crate) fn new(frame: Frame, scale: f64) -> Self {
        let Frame { camera: stored_camera, lens, image, declared_in, beside } = frame;
        let camera = stored_camera.clone();
        Self {
            camera,
            image_path: image,
            distortion: lens,
            stored_camera,
            gains: [1.0; 3],
            vignetting: 0.0,
            learned_pose: false,
            declared_in,
            beside,
        }
        .at_scale(scale)
    }

    /// Returns the camera with the intrinsics that the scene gives.
    ///
    /// Training may have learned others.
    pub(crate) fn given_camera(&self) -> Camera {
        let Camera { width, height, rotation, translation, .. } = self.camera;
        Camera { rotation, translation, ..self.stored_camera.scaled(width, height) }
    }

    /// Returns the view at `scale` times its stored size; the pose and a learned lens are unchanged.
    pub(crate) fn at_scale(mut self, scale: f64) -> Self {
        let side = |n: u32| ((f64::from(n) * scale).round() as u32).max(1);
        let scaled = self.stored_camera.scaled(side(self.stored_camera.width), side(self.stored_camera.height));
        let given = self.given_camera();
        let Camera { rotation, translation, fx, fy, cx, cy, .. } = self.camera;
        self.camera = Camera {
            rotation,
            translation,
            fx: fx / given.fx * scaled.fx,
            fy: fy / given.fy * scaled.fy,
            cx: scaled.cx + (cx - given.cx) / given.fx * scaled.fx,
            cy: scaled.cy + (cy - given.cy) / given.fy * scaled.fy,
            ..scaled
        };
        self
    }

    /// Loads the photograph as the target of training. The image is sRGB-encoded RGB in `[0, 1]`, undistorted, at the
    /// size of [`View::camera`].
    ///
    /// Straight PNG alpha is composited on the background in encoded values, as in viewers. EXR colors are
    /// premultiplied and remain on black. Linear values are exposed, resized, and then clipped, as in a camera. NaN is
    /// an error, except where the mask excludes it. PNG and JPEG images that need neither undistortion nor scaling keep
    /// their exact values.
    pub fn load_image(&self, options: &LoadOptions) -> Result<Image> {
        let (raster, encoding) = self.read(options.background)?;
        if encoding == Encoding::Srgb && self.distortion.is_none() && self.is_stored_size() {
            return Ok(self.evenly_exposed(raster));
        }
        let mut image = self.bring(self.linear(raster, encoding, options)?);
        image.data.iter_mut().for_each(|v| *v = linear_to_srgb(v.clamp(0.0, 1.0)));
        Ok(self.evenly_exposed(image))
    }

    /// Divides by the view's factors and those of the lens.
    fn evenly_exposed(&self, mut image: Image) -> Image {
        if self.gains == [1.0; 3] && self.vignetting == 0.0 {
            return image;
        }
        let middle = [0.5 * image.width as f32, 0.5 * image.height as f32];
        let corner = middle[0] * middle[0] + middle[1] * middle[1];
        for (at, pixel) in image.data.chunks_exact_mut(3).enumerate() {
            let [x, y] = [at % image.width as usize, at / image.width as usize].map(|n| n as f32 + 0.5);
            let share = ((x - middle[0]).powi(2) + (y - middle[1]).powi(2)) / corner;
            let shade = (self.vignetting * share).exp();
            // Clipped once: a corner may exceed 1 before the view's factors make it darker.
            pixel.iter_mut().zip(self.gains).for_each(|(v, gain)| *v = (*v / shade / gain).min(1.0));
        }
        image
    }

    /// Loads the photograph as linear light. The image is exposed, undistorted, and at the size of [`View::camera`].
    /// Values above 1 are not clipped.
    pub fn load_linear(&self, options: &LoadOptions) -> Result<Image> {
        let (raster, encoding) = self.read(options.background)?;
        Ok(self.bring(self.linear(raster, encoding, options)?))
    }

    /// Loads the photograph as stored, as input for priors. Alpha is composited on the background.
    pub fn load_stored(&self, options: &LoadOptions) -> Result<Photograph> {
        let (raster, encoding) = self.read(options.background)?;
        Ok(match encoding {
            Encoding::Srgb => Photograph { image: raster, linear: false },
            Encoding::Linear => Photograph { image: self.linear(raster, encoding, options)?, linear: true },
        })
    }

    /// Returns the coverage of undistortion in one channel. The value is 1 where the lens captured the pixel, and 0
    /// where undistortion repeats the border. Returns `None` for images without distortion, which cover all pixels.
    pub fn coverage(&self) -> Option<Image> {
        if self.distortion.is_none() {
            return None;
        }
        let stored = undistort_coverage(&self.stored_camera, &self.distortion);
        let mut scaled = resized(stored, self.camera.width, self.camera.height);
        scaled.data.iter_mut().for_each(|v| *v = f32::from(u8::from(*v > 0.999)));
        Some(scaled)
    }

    /// Loads the data set's mask of valid pixels; `None` if it does not exist. The mask has one channel and the size of
    /// [`View::camera`]. The value is 1 where the whole pixel is valid, else 0.
    pub fn load_mask(&self) -> Result<Option<Image>> {
        let Some(stored) = self.stored_mask()? else {
            return Ok(None);
        };
        let mut mask = self.bring(stored);
        mask.data.iter_mut().for_each(|v| *v = f32::from(u8::from(*v > 0.999)));
        Ok(Some(mask))
    }

    /// Loads the data set's mask at the size of the photograph. The value is 1 where the pixel is valid, else 0.
    pub(crate) fn stored_mask(&self) -> Result<Option<Image>> {
        let Some(path) = &self.beside.mask else {
            return Ok(None);
        };
        let (mut mask, _) = map_file::read(path, Meaning::Scalar)?;
        mask.data.iter_mut().for_each(|v| *v = f32::from(u8::from((*v > 0.5) != self.beside.inverted)));
        let (width, height) = (self.stored_camera.width, self.stored_camera.height);
        if is_copy((width, height), (mask.width, mask.height)) {
            // The photograph is a smaller copy. A pixel is valid if all that it covers are.
            mask = resized(mask, width, height);
            mask.data.iter_mut().for_each(|v| *v = f32::from(u8::from(*v > 0.999)));
        }
        check_size(path, (mask.width, mask.height), &self.image_path, (width, height))?;
        Ok(Some(mask))
    }

    /// Returns whether the photograph stores linear light.
    pub(crate) fn is_linear(&self) -> bool {
        self.image_path.extension().is_some_and(|e| e.eq_ignore_ascii_case("exr"))
    }

    /// Returns luminances (Rec. 709) of valid pixels of a linear photograph. At most `count` pixels are sampled at
    /// regular intervals.
    pub(crate) fn luminances(&self, count: usize) -> Result<Vec<f32>> {
        let (image, _) = self.read([0.0; 3])?;
        let mask = self.stored_mask()?;
        let step = image.pixels().div_ceil(count.max(1)).max(1);
        let counts = |i: &usize| mask.as_ref().is_none_or(|m| m.data[*i] > 0.5);
        let luminance = |i: usize| {
            let p = &image.data[3 * i..3 * i + 3];
            (0.2126 * p[0] + 0.7152 * p[1] + 0.0722 * p[2]).clamp(0.0, BRIGHTEST)
        };
        Ok((0..image.pixels()).step_by(step).filter(counts).map(luminance).collect())
    }

    fn is_stored_size(&self) -> bool {
        (self.camera.width, self.camera.height) == (self.stored_camera.width, self.stored_camera.height)
    }

    /// Reads the file's values as RGB on the background.
    fn read(&self, background: [f32; 3]) -> Result<(Image, Encoding)> {
        let (mut raster, encoding) = read_raster(&self.image_path)?;
        let (image, camera) = ((raster.width, raster.height), (self.stored_camera.width, self.stored_camera.height));
        if image != camera {
            let declared_in = self.declared_in.clone();
            return Err(SceneError::ImageSize { path: self.image_path.clone(), image, camera, declared_in });
        }
        if raster.data.iter().any(|v| v.is_nan())
            && let Some(mask) = self.stored_mask()?
        {
            for (pixel, m) in raster.data.chunks_exact_mut(raster.channels as usize).zip(&mask.data) {
                if *m == 0.0 {
                    pixel.fill(0.0);
                }
            }
        }
        if let Some(at) = raster.data.iter().position(|v| v.is_nan()) {
            let pixel = at / raster.channels as usize;
            let (x, y) = (pixel as u32 % raster.width, pixel as u32 / raster.width);
            let problem = format!("the pixel in column {x}, row {y} is not a number; repair the image");
            return Err(SceneError::image(&self.image_path, problem));
        }
        if raster.channels == 3 {
            return Ok((raster, encoding));
        }
        let straight_alpha = encoding == Encoding::Srgb;
        let rgb = raster.map_pixels(3, |old, new| {
            let alpha = match *old {
                [_, a] | [_, _, _, a] if straight_alpha => a,
                _ => 1.0,
            };
            match *old {
                [r, g, b, ..] => new.copy_from_slice(&[r * alpha, g * alpha, b * alpha]),
                [v, ..] => new.fill(v * alpha),
                [] => {}
            }
            if alpha < 1.0 {
                new.iter_mut().zip(background).for_each(|(v, behind)| *v += (1.0 - alpha) * behind);
            }
        });
        Ok((rgb, encoding))
    }

    /// Returns the fraction of the photograph's pixels that are not opaque. Returns `None` for opaque photographs and
    /// for formats with premultiplied alpha.
    pub(crate) fn transparent_share(&self) -> Result<Option<f64>> {
        let is_png = self.image_path.extension().is_some_and(|e| e.eq_ignore_ascii_case("png"));
        if !is_png {
            return Ok(None);
        }
        let (raster, _) = read_raster(&self.image_path)?;
        if !matches!(raster.channels, 2 | 4) {
            return Ok(None);
        }
        let alphas = raster.data.chunks_exact(raster.channels as usize).filter_map(|pixel| pixel.last());
        let through = alphas.filter(|a| **a < 1.0).count();
        let pixels = f64::from(raster.width) * f64::from(raster.height);
        Ok((through > 0).then(|| through as f64 / pixels))
    }

    /// Converts the file's values to exposed linear light.
    fn linear(&self, mut image: Image, encoding: Encoding, options: &LoadOptions) -> Result<Image> {
        match encoding {
            Encoding::Srgb => image.data.iter_mut().for_each(|v| *v = srgb_to_linear(*v)),
            Encoding::Linear => {
                let exposure = options.exposure;
                if !(exposure.is_finite() && exposure > 0.0) {
                    let value = exposure.to_string();
                    let expected = "the exposure must be a positive number";
                    return Err(SceneError::Option { option: "exposure", value, expected });
                }
                image.data.iter_mut().for_each(|v| *v = (v.clamp(-BRIGHTEST, BRIGHTEST)) * exposure);
            }
        }
        Ok(image)
    }

    /// Undistorts and resizes linear values.
    fn bring(&self, image: Image) -> Image {
        let straight = match self.distortion.is_none() {
            true => image,
            false => undistort(&image, &self.stored_camera, &self.distortion),
        };
        resized(straight, self.camera.width, self.camera.height)
    }
}

/// Returns whether a size is that of a smaller copy: divided by a whole number of 2 or more and rounded.
fn is_copy(small: (u32, u32), large: (u32, u32)) -> bool {
    let factor = (f64::from(large.0) / f64::from(small.0)).round();
    let near = |small: u32, large: u32| (f64::from(large) / factor - f64::from(small)).abs() < 1.0;
    factor >= 2.0 && near(small.0, large.0) && near(small.1, large.1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::tests::camera;
    use crate::image::{write_exr, write_png};

    /// Writes an image to `name` and returns its view at `scale`.
    fn view(name: &str, image: &Image, scale: f64) -> (tempfile::TempDir, View) {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join(name);
        if name.ends_with("exr") {
            let names = ["R", "G", "B", "A"];
            let names = if image.channels == 1 { &["Y"][..] } else { &names[..image.channels as usize] };
            write_exr(&path, image, names).unwrap();
        } else {
            write_png(&path, image).unwrap();
        }
        let camera = camera().scaled(image.width, image.height);
        let frame = Frame::new(camera, Distortion::default(), path, "cameras.json".into());
        (directory, View::new(frame, scale))
    }

    fn load(name: &str, image: &Image, scale: f64) -> Image {
        let (_keep, view) = view(name, image, scale);
        view.load_image(&LoadOptions::default()).unwrap()
    }

    fn image(channels: u32, data: &[f32]) -> Image {
        Image::from_data(data.len() as u32 / channels, 1, channels, data.to_vec()).unwrap()
    }

    #[test]
    fn stored_values_are_preserved_exactly() {
        let photograph = image(3, &[0.0, 1.0, 51.0 / 255.0, 7.0 / 255.0, 0.2, 0.4]);
        assert_eq!(load("a.png", &photograph, 1.0), photograph);
    }

    #[test]
    fn gray_and_alpha_become_rgb_on_black() {
        assert_eq!(load("a.png", &image(1, &[0.2, 1.0]), 1.0).data, [0.2, 0.2, 0.2, 1.0, 1.0, 1.0]);
        let alpha = 51.0 / 255.0;
        let straight = load("a.png", &image(4, &[1.0, 0.0, 0.4, alpha]), 1.0);
        assert_eq!(straight.data, [alpha, 0.0, 0.4 * alpha]);
        assert_eq!(load("a.png", &image(2, &[1.0, alpha]), 1.0).data, [alpha; 3]);
        // EXR colors are premultiplied.
        let premultiplied = load("a.exr", &image(4, &[1.0, 0.0, 1.0, 0.5]), 1.0);
        assert!((premultiplied.data[0] - 1.0).abs() < 1e-6 && premultiplied.data[1] == 0.0);
    }

    #[test]
    fn exr_is_exposed_clipped_and_encoded() {
        let hdr = image(3, &[0.18, 4.0, -0.5, f32::INFINITY, 0.0, 0.05]);
        let (_keep, view) = view("a.exr", &hdr, 1.0);
        let one = view.load_image(&LoadOptions::default()).unwrap();
        let expected = [0.461_356, 1.0, 0.0, 1.0, 0.0, linear_to_srgb(0.05)];
        assert!(one.data.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5), "{:?}", one.data);
        let half = view.load_image(&LoadOptions { exposure: 0.125, ..Default::default() }).unwrap();
        assert!((half.data[1] - linear_to_srgb(0.5)).abs() < 1e-6);
        let half = LoadOptions { exposure: 0.5, ..Default::default() };
        assert_eq!(view.load_linear(&half).unwrap().data[..3], [0.09, 2.0, -0.25]);
        let stored = view.load_stored(&half).unwrap();
        assert!(stored.linear && stored.image.data[..3] == [0.09, 2.0, -0.25]);
        let nan = LoadOptions { exposure: f32::NAN, ..Default::default() };
        let error = view.load_image(&nan).unwrap_err().to_string();
        assert_eq!(error, "exposure is NaN, but the exposure must be a positive number");
    }

    #[test]
    fn scaling_averages_linear_light() {
        let stripes = load("a.png", &image(3, &[0.0, 0.0, 0.0, 1.0, 1.0, 1.0]), 0.5);
        assert_eq!((stripes.width, stripes.height), (1, 1));
        // Half of linear white is encoded as 0.735, far from the mean of the encoded values.
        assert!(stripes.data.iter().all(|v| (v - 0.735_357).abs() < 1e-4), "{:?}", stripes.data);
        // Bright values are averaged before they are clipped.
        let light = load("a.exr", &image(3, &[0.0, 0.0, 0.0, 10.0, 1.0, 0.5]), 0.5);
        let expected = [1.0, linear_to_srgb(0.5), linear_to_srgb(0.25)];
        assert!(light.data.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6));
    }

    /// Fails unless every pixel is `shown`, divided by the view's factors and clipped.
    fn assert_evenly_exposed(view: &View, shown: &[f32]) {
        let loaded = view.load_image(&LoadOptions::default()).unwrap();
        let (middle_x, middle_y) = (0.5 * f64::from(loaded.width), 0.5 * f64::from(loaded.height));
        assert_eq!(loaded.data.len(), shown.len());
        for (at, (found, shown)) in loaded.data.iter().zip(shown).enumerate() {
            let (column, row) = (at / 3 % loaded.width as usize, at / 3 / loaded.width as usize);
            let (x, y) = (column as f64 + 0.5 - middle_x, row as f64 + 0.5 - middle_y);
            let share = (x * x + y * y) / (middle_x * middle_x + middle_y * middle_y);
            let gain = f64::from(view.gains[at % 3]) * (f64::from(view.vignetting) * share).exp();
            let (found, expected) = (f64::from(*found), (f64::from(*shown) / gain).min(1.0));
            assert!((found - expected).abs() <= 1e-6 * expected, "value {at} of {view:?}: {found} and not {expected}");
        }
    }

    #[test]
    fn photographs_are_divided_by_gains_and_vignetting() {
        let mut photograph = Image::new(7, 5, 3);
        // Black and white are among the values.
        photograph.data.iter_mut().enumerate().for_each(|(i, v)| *v = (i * 37 % 256) as f32 / 255.0);
        assert!(photograph.data.contains(&0.0) && photograph.data.contains(&1.0));
        let (_keep, mut view) = view("a.png", &photograph, 1.0);
        for gains in [[1.0; 3], [0.5, 1.0, 1.7], [1e-3, 1.0, 1e3], [1.2, 3.0, 0.9]] {
            for vignetting in [0.0, -0.6, 0.4] {
                (view.gains, view.vignetting) = (gains, vignetting);
                assert_evenly_exposed(&view, &photograph.data);
            }
        }
        // Linear values are clipped as in the camera, and pixels that the mask excludes stay black.
        let (keep, mut view) = self::view("a.exr", &image(3, &[f32::NAN, 0.5, 0.5, 4.0, 0.18, f32::INFINITY]), 1.0);
        let mask = keep.path().join("mask.png");
        write_png(&mask, &image(1, &[0.0, 1.0])).unwrap();
        view.beside.mask = Some(mask);
        (view.gains, view.vignetting) = ([2.0, 0.25, 1e3], -0.3);
        assert_evenly_exposed(&view, &[0.0, 0.0, 0.0, 1.0, linear_to_srgb(0.18), 1.0]);
        assert_eq!(view.load_mask().unwrap().unwrap().data, [0.0, 1.0]);
    }

    #[test]
    fn camera_scales_to_the_rounded_image_size() {
        let (_keep, view) = view("a.png", &Image::new(5, 3, 3), 0.5);
        let Camera { width, height, fx, fy, cx, cy, .. } = view.camera;
        assert_eq!((width, height), (3, 2));
        let stored = &view.stored_camera;
        assert!((fx - stored.fx * 0.6).abs() < 1e-12 && (fy - stored.fy * 2.0 / 3.0).abs() < 1e-12);
        assert!((cx - stored.cx * 0.6).abs() < 1e-12 && (cy - stored.cy * 2.0 / 3.0).abs() < 1e-12);
        let loaded = view.load_image(&LoadOptions::default()).unwrap();
        assert_eq!((loaded.width, loaded.height, loaded.channels), (3, 2, 3));
        // A learned lens stays: a factor on focal lengths, and a shift of the center in given focal lengths.
        let mut learned = view.clone();
        (learned.camera.fx, learned.camera.fy) = (0.9 * fx, 0.9 * fy);
        (learned.camera.cx, learned.camera.cy) = (cx + 0.1 * fx, cy - 0.2 * fy);
        let (small, given) = (learned.at_scale(0.25).camera, view.stored_camera.scaled(1, 1));
        let expected = [0.9 * given.fx, 0.9 * given.fy, given.cx + 0.1 * given.fx, given.cy - 0.2 * given.fy];
        let found = [small.fx, small.fy, small.cx, small.cy];
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{found:?} {expected:?}");
    }

    #[test]
    fn distortion_is_removed_and_coverage_is_returned() {
        let mut photograph = Image::new(160, 120, 3);
        photograph.data.iter_mut().enumerate().for_each(|(i, v)| *v = (i % 480) as f32 / 480.0);
        let (_keep, mut view) = view("a.png", &photograph, 0.5);
        assert!(view.coverage().is_none());
        let straight = view.load_image(&LoadOptions::default()).unwrap();
        view.distortion = Distortion { k1: 0.2, ..Default::default() };
        let bent = view.load_image(&LoadOptions::default()).unwrap();
        assert_ne!(straight, bent);
        assert_eq!((bent.width, bent.height), (80, 60));
        let stored = view.load_stored(&LoadOptions::default()).unwrap();
        assert!(!stored.linear && (stored.image.width, stored.image.height) == (160, 120));
        let coverage = view.coverage().unwrap();
        assert_eq!((coverage.width, coverage.pixel(0, 0)[0], coverage.pixel(40, 30)[0]), (80, 0.0, 1.0));
    }

    #[test]
    fn each_error_has_its_message() {
        let (_keep, mut view) = view("a.exr", &image(3, &[0.0, 0.0, 0.0, 0.0, f32::NAN, 0.0]), 1.0);
        let fail = |view: &View| view.load_image(&LoadOptions::default()).unwrap_err().to_string();
        assert!(fail(&view).contains("a.exr: the pixel in column 1, row 0 is not a number"));
        view.stored_camera.width = 7;
        let error = fail(&view);
        assert!(error.contains("a.exr is 2×1 pixels, but cameras.json gives 7×1 for its camera"), "{error}");
        view.image_path.set_extension("tiff");
        assert!(fail(&view).contains("the extension \"tiff\" is none of png, jpg, jpeg, exr"));
        view.image_path.set_extension("png");
        assert!(fail(&view).starts_with("cannot read "));
    }
}
