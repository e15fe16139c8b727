//! Blended channels of a view.

use anyhow::bail;
use sgs_api::cameras::upload;
use sgs_api::{head_of, usage};
use sgs_engine::Device;
use sgs_evaluate::Rendered;
use sgs_passes::Tuning;
use sgs_passes::pipeline::Renderer;
use sgs_passes::scene::Gaussians;
use sgs_passes::splat::Channels;
use sgs_run::Classifier;
use sgs_scene::{Camera, Image, Splats};
use std::path::Path;

/// Image of each channel, and the classes of all pixels with columns and rows; -1 for none.
type Blended = (Vec<(&'static str, Image)>, Option<([u32; 2], Vec<i32>)>);

/// Renderer of a set of channels.
pub struct Images {
    device: Device,
    channels: Channels,
    gaussians: Gaussians,
    renderer: Renderer,
    classifier: Option<Classifier>,
}

impl Images {
    /// Returns the renderer of the channels: the last one if it fits.
    pub fn of(
        last: Option<Images>,
        device: &Device,
        path: &Path,
        splats: &Splats,
        names: &[String],
    ) -> anyhow::Result<Images> {
        let has = |name: &str| names.iter().any(|n| n == name);
        if has("normal") && splats.normals.is_none() {
            let path = path.display();
            return Err(usage(format!("\"{path}\" holds no normals; leave \"normal\" out of the channels.")));
        }
        let channels = Channels { colors: true, normals: has("normal"), depth: has("depth") };
        let classes = has("semantic");
        let fits = |images: &Images| {
            let same = images.device.address() == device.address();
            same && images.channels == channels && images.classifier.is_some() == classes
        };
        if let Some(images) = last.filter(fits) {
            return Ok(images);
        }
        let gaussians = upload(device, splats, classes)?;
        let make = if classes { Renderer::with_features } else { Renderer::new };
        let renderer = make(device, Tuning::for_device(device.info()), &gaussians, [1, 1], channels)?;
        let classifier = match classes {
            true => Some(Classifier::new(device, &head_of(path, splats)?, &[])?),
            false => None,
        };
        Ok(Images { device: device.clone(), channels, gaussians, renderer, classifier })
    }

    /// Renders the channels of a view.
    pub fn render(&mut self, view: &Camera, names: &[String], background: [f32; 3]) -> anyhow::Result<Blended> {
        let degree = self.gaussians.model.sh_degree;
        let image = self.renderer.render(&self.gaussians, &sgs_run::camera(view), degree, background)?;
        let labels = match &mut self.classifier {
            Some(classifier) => {
                let labels = classifier.classify(&self.renderer, &image)?.labels;
                Some((image.size, labels.iter().map(|l| l.map_or(-1, |l| l as i32)).collect()))
            }
            None => None,
        };
        let rendered = Rendered::from_image(&image, self.channels);
        let mut all = Vec::new();
        for name in names {
            match name.as_str() {
                "rgb" => all.push(("rgb", rendered.rgb.clone())),
                "alpha" => all.push(("alpha", rendered.alpha.clone())),
                "depth" => all.push(("depth", rendered.depth.clone())),
                "normal" => all.extend(rendered.normal.clone().map(|normal| ("normal", normal))),
                "semantic" => {}
                other => bail!("\"{other}\" is not blended."),
            }
        }
        Ok((all, labels))
    }
}
