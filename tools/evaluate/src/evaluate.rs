//! Metrics of a trained run at the views of a split.

use crate::align::Alignments;
use crate::error::Result;
use crate::measures::{Evaluation, Means, Nvs, Semantic, ViewMetrics, known};
use crate::metrics::{self, Lpips, NormalError};
use crate::valid::{blackened, truth_mask};
use sgs_engine::Device;
use sgs_passes::Tuning;
use sgs_passes::loss::NO_LABEL;
use sgs_passes::pipeline::{RenderedImage, Renderer};
use sgs_passes::scene::{Gaussians, ViewKinds};
use sgs_passes::splat::Channels;
use sgs_run::{Classifier, SemanticHead, render_view};
use sgs_scene::{GroundTruth, GroundTruthKind, Image, Scene};

/// Evaluates the Gaussians at some views. `on_view` receives every rendered view.
///
/// # Errors
/// If the device fails or ground truth is damaged.
pub fn evaluate(
    device: &Device,
    scene: &Scene,
    gaussians: &Gaussians,
    views: &[usize],
    background: [f32; 3],
    on_view: impl FnMut(&str, &Rendered) -> Result<()>,
) -> Result<Evaluation> {
    evaluate_classes(
        device,
        scene,
        gaussians,
        &EvaluateOptions { views, background, head: None, lpips: None, align: None },
        on_view,
    )
}

/// Views and measures of an evaluation.
pub struct EvaluateOptions<'a> {
    /// Indices of the evaluated views.
    pub views: &'a [usize],
    /// Background color, display-referred.
    pub background: [f32; 3],
    /// Head that classifies pixels, if the Gaussians have features.
    pub head: Option<&'a SemanticHead>,
    /// Network of LPIPS, if it is measured.
    pub lpips: Option<&'a Lpips>,
    /// What is aligned with each photograph before a second comparison, if anything.
    pub align: Option<ViewKinds>,
}

/// Evaluates as [`evaluate`] does, with classes and LPIPS. Classifies every pixel with the head if the Gaussians have
/// features.
///
/// # Errors
/// If the device fails or ground truth is damaged.
pub fn evaluate_classes(
    device: &Device,
    scene: &Scene,
    gaussians: &Gaussians,
    options: &EvaluateOptions<'_>,
    mut on_view: impl FnMut(&str, &Rendered) -> Result<()>,
) -> Result<Evaluation> {
    let &EvaluateOptions { views, background, head, lpips, align } = options;
    let mut alignments = match align.filter(|kinds| kinds.any()) {
        Some(kinds) => Some(Alignments::new(device, gaussians, scene, kinds)?),
        None => None,
    };
    let truth = GroundTruth::of(scene);
    let channels = Channels { colors: true, normals: gaussians.model.normals, depth: true };
    let head = head.filter(|_| gaussians.model.semantics);
    let make = if head.is_some() { Renderer::with_features } else { Renderer::new };
    let mut renderer = make(device, Tuning::for_device(device.info()), gaussians, [1, 1], channels)?;
    let mut classifier = head.map(|head| Classifier::new(device, head, &[])).transpose()?;
    let known_as = match head {
        Some(head) => ids_of(&head.text.labels, truth.semantic_labels()?.as_deref()),
        None => Vec::new(),
    };
    let mut out = Vec::new();
    for &i in views {
        let view = &scene.views[i];
        let rendering = render_view(&mut renderer, gaussians, &view.camera, background)?;
        let mut rendered = Rendered::from_image(&rendering, channels);
        if let Some(classifier) = &mut classifier {
            rendered.labels = Some(classifier.classify(&renderer, &rendering)?.labels);
        }
        // Pixels that training ignores are not measured. Ground truth also has its own mask, which excludes lights and
        // windows where only materials are undefined.
        let counts = scene.load_mask(i)?;
        let photo = blackened(scene.load_image(i)?, counts.as_ref());
        let mask = truth_mask(&truth, i, counts.as_ref())?;
        let mask = mask.as_ref();
        let mut aligned = None;
        let mut nvs = Nvs::of(&rendered.rgb, &photo, counts.as_ref(), lpips)?;
        if let Some(alignments) = &mut alignments {
            let found = alignments.find(gaussians, &view.camera, &photo, counts.as_ref(), background)?;
            let rendering = render_view(&mut renderer, gaussians, &found.camera, background)?;
            let mut shown = Rendered::from_image(&rendering, channels);
            for pixel in shown.rgb.data.chunks_exact_mut(3) {
                pixel.iter_mut().zip(found.gains).for_each(|(v, gain)| *v = (*v * gain).min(1.0));
            }
            nvs.psnr_aligned = Some(metrics::psnr(&shown.rgb, &photo, counts.as_ref())?);
            nvs.ssim_aligned = Some(metrics::ssim(&shown.rgb, &photo, counts.as_ref())?);
            aligned = Some(shown.depth);
        }
        // Gaussians without normals still have a surface. Its normals are derived from depth.
        let surface;
        let shown = match &rendered.normal {
            Some(n) => n,
            None => {
                surface = normals_from_depth(&rendered.depth, &view.camera);
                &surface
            }
        };
        let normal = match (Some(shown), truth.load(GroundTruthKind::Normal, i)?) {
            (Some(n), Some(t)) => known(metrics::normal_error(n, &t, mask))?,
            _ => None,
        };
        let depth = match truth.load(GroundTruthKind::Depth, i)? {
            Some(t) => known(metrics::depth_rel(&rendered.depth, &t, mask))?,
            None => None,
        };
        let sensor_depth_rel = match scene.sensor_depth(i)? {
            Some(t) => {
                known(metrics::depth_rel(aligned.as_ref().unwrap_or(&rendered.depth), &t.image, counts.as_ref()))?
            }
            None => None,
        };
        let semantic = match (&rendered.labels, truth.semantic(i)?) {
            (Some(labels), Some(t)) => {
                let id = |label: &Option<u32>| label.map_or(NO_LABEL, |l| known_as[l as usize]);
                let ids: Vec<u32> = labels.iter().map(id).collect();
                known(metrics::label_accuracy(&ids, rendering.size, &t, mask))?
            }
            _ => None,
        };
        let semantic = semantic.map(|accuracy| Semantic { accuracy });
        on_view(&view.camera.name, &rendered)?;
        let name = view.camera.name.clone();
        let (normal_mae_deg, normal_coverage) =
            normal.map(|NormalError { mae_deg, coverage }| (mae_deg, coverage)).unzip();
        out.push(ViewMetrics {
            name,
            nvs,
            normal_mae_deg,
            normal_coverage,
            depth_rel: depth,
            sensor_depth_rel,
            semantic,
            shaded: None,
        });
    }
    let n = out.len().max(1) as f64;
    let mean = |f: &dyn Fn(&ViewMetrics) -> f64| out.iter().map(f).sum::<f64>() / n;
    let some = |f: &dyn Fn(&ViewMetrics) -> Option<f64>| {
        let values: Vec<f64> = out.iter().filter_map(f).collect();
        (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
    };
    let mean = Means {
        nvs: Nvs {
            psnr: mean(&|v| v.nvs.psnr),
            ssim: mean(&|v| v.nvs.ssim),
            flip: mean(&|v| v.nvs.flip),
            lpips: some(&|v| v.nvs.lpips),
            psnr_aligned: some(&|v| v.nvs.psnr_aligned),
            ssim_aligned: some(&|v| v.nvs.ssim_aligned),
        },
        normal_mae_deg: some(&|v| v.normal_mae_deg),
        normal_coverage: some(&|v| v.normal_coverage),
        depth_rel: some(&|v| v.depth_rel),
        sensor_depth_rel: some(&|v| v.sensor_depth_rel),
        semantic: some(&|v| v.semantic.map(|s| s.accuracy)).map(|accuracy| Semantic { accuracy }),
        shaded: None,
        fps: None,
    };
    Ok(Evaluation { mean, lpips: lpips.map(Lpips::about), views: out })
}

/// Maps each class to its id in ground truth. That id is the position in the list of ground truth, or in `classes`
/// without such a list. A class that ground truth lacks counts as wrong everywhere.
fn ids_of(classes: &[String], truth: Option<&[String]>) -> Vec<u32> {
    let id = |(i, class): (usize, &String)| match truth {
        Some(names) => names.iter().position(|n| n == class).map_or(NO_LABEL, |at| at as u32),
        None => i as u32,
    };
    classes.iter().enumerate().map(id).collect()
}

/// Returns the world-space unit normals of a depth image, facing the camera. A normal is the cross product of central
/// differences of the points. Zero where there is no depth.
pub fn normals_from_depth(depth: &Image, camera: &sgs_scene::Camera) -> Image {
    let (w, h) = (depth.width as usize, depth.height as usize);
    let point = |x: usize, y: usize| {
        let z = f64::from(depth.data[y * w + x]);
        camera.unproject(glam::DVec2::new(x as f64 + 0.5, y as f64 + 0.5), z)
    };
    let mut data = Vec::with_capacity(3 * w * h);
    for y in 0..h {
        for x in 0..w {
            let across = point((x + 1).min(w - 1), y) - point(x.saturating_sub(1), y);
            let down = point(x, (y + 1).min(h - 1)) - point(x, y.saturating_sub(1));
            let mut n = across.cross(down).normalize_or_zero();
            if n.dot(point(x, y) - camera.position()) > 0.0 {
                n = -n;
            }
            let known = depth.data[y * w + x] > 0.0 && n.is_finite();
            data.extend(if known { n.as_vec3().to_array() } else { [0.0; 3] });
        }
    }
    Image { width: depth.width, height: depth.height, channels: 3, data }
}

/// Images of a rendered view.
#[derive(Clone, Debug)]
pub struct Rendered {
    /// Display-referred color over the background, clipped to [0, 1].
    pub rgb: Image,
    /// One minus transmittance.
    pub alpha: Image,
    /// Unit normals in world space; zero where no Gaussian is visible.
    pub normal: Option<Image>,
    /// Blended depth divided by alpha.
    pub depth: Image,
    /// Class of each pixel as an index into the head's list; none where nothing is visible. Absent without a head.
    pub labels: Option<Vec<Option<u32>>>,
}

impl Rendered {
    /// Extracts the images from a render with colors. Depth is zero if not selected.
    pub fn from_image(p: &RenderedImage, channels: Channels) -> Rendered {
        let [w, h] = p.size;
        let c = p.channels as usize;
        let pixel = |i: usize| &p.image[i * c..(i + 1) * c];
        let pixels = (w * h) as usize;
        let image = |channels: u32, data: Vec<f32>| Image { width: w, height: h, channels, data };
        let rgb = (0..pixels).flat_map(|i| [0, 1, 2].map(|k| pixel(i)[k].clamp(0.0, 1.0))).collect();
        let alpha: Vec<f32> = p.transmittance.iter().map(|t| 1.0 - t).collect();
        let normal = channels.normals.then(|| {
            let unit = |n: &[f32]| {
                let l = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
                if l > 1e-6 { [n[0] / l, n[1] / l, n[2] / l] } else { [0.0; 3] }
            };
            image(3, (0..pixels).flat_map(|i| unit(&pixel(i)[3..6])).collect())
        });
        let depth = |i: usize| if channels.depth && alpha[i] > 1e-4 { pixel(i)[c - 2] / alpha[i] } else { 0.0 };
        let depth = (0..pixels).map(depth).collect();
        Rendered { rgb: image(3, rgb), alpha: image(1, alpha), normal, depth: image(1, depth), labels: None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classes_match_ground_truth_by_name() {
        let names = |n: &[&str]| n.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>();
        let classes = names(&["sofa", "wall", "lamp"]);
        assert_eq!(ids_of(&classes, None), [0, 1, 2]);
        assert_eq!(ids_of(&classes, Some(&names(&["none", "wall", "floor", "sofa"]))), [3, 1, NO_LABEL]);
    }
}
