//! Materials and shaded pictures against ground truth, measured at the views of a split.

use crate::error::Result;
use crate::evaluate::{Evaluation, Nvs, known};
use crate::metrics::{self, Lpips};
use crate::shaded::{ShadedView, Shading, displayed};
use serde::Serialize;
use sgs_scene::{GroundTruth, GroundTruthKind, Image, Scene};
use std::collections::BTreeMap;

/// Metrics of a shaded view, or their means; what has no ground truth is absent.
#[derive(Clone, Debug, Default, Serialize)]
pub struct ShadedMetrics {
    /// The shaded picture, display-referred, as a novel view.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pbr: Option<Nvs>,
    /// Albedo.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub albedo: Option<AlbedoMetrics>,
    /// Mean squared error of roughness.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub roughness_mse: Option<f64>,
    /// Mean squared error of metallic.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub metallic_mse: Option<f64>,
    /// Under other lights, by name.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub relit: BTreeMap<String, RelitMetrics>,
}

/// Metrics of albedo, compared as it is displayed (sRGB).
#[derive(Clone, Copy, Debug, Serialize)]
pub struct AlbedoMetrics {
    /// dB.
    pub psnr: f64,
    /// Structural similarity.
    pub ssim: f64,
    /// dB after one gain a channel.
    pub psnr_scaled: f64,
    /// LPIPS, where there are weights.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lpips: Option<f64>,
}

/// Metrics of a picture under other lights, display-referred.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct RelitMetrics {
    /// dB.
    pub psnr: f64,
    /// Structural similarity.
    pub ssim: f64,
    /// dB after one gain for all channels of all linear pixels.
    pub psnr_scaled: f64,
}

/// Measures what shading comes to, and puts it into an evaluation of the same views.
///
/// # Errors
/// If the device fails or ground truth is damaged.
pub fn evaluate_shaded(
    shading: &mut Shading,
    scene: &Scene,
    views: &[usize],
    background: [f32; 3],
    lpips: Option<&Lpips>,
    into: &mut Evaluation,
    mut look: impl FnMut(&str, &ShadedView) -> Result<()>,
) -> Result<()> {
    let truth = GroundTruth::of(scene);
    for (&i, metrics) in views.iter().zip(&mut into.views) {
        let view = &scene.views[i];
        let shaded = shading.shade(&view.camera)?;
        let mut found = measure_materials(&shaded, &truth, i, lpips)?;
        let picture = displayed(&shaded.radiance(background));
        let (photo, counts) = (scene.load_image(i)?, scene.load_mask(i)?);
        found.pbr = Some(Nvs::of(&picture, &photo, counts.as_ref(), lpips)?);
        look(&view.camera.name, &shaded)?;
        metrics.shaded = Some(found);
    }
    let all: Vec<&ShadedMetrics> = into.views.iter().filter_map(|v| v.shaded.as_ref()).collect();
    into.mean.shaded = Some(mean(&all));
    Ok(())
}

fn measure_materials(
    shaded: &ShadedView,
    truth: &GroundTruth<'_>,
    view: usize,
    lpips: Option<&Lpips>,
) -> Result<ShadedMetrics> {
    let mask = truth.load(GroundTruthKind::Mask, view)?;
    let mask = mask.as_ref();
    let mut found = ShadedMetrics::default();
    if let Some(albedo) = truth.load(GroundTruthKind::Albedo, view)? {
        let (ours, theirs) = (displayed(&shaded.albedo()), displayed(&albedo));
        if let Some(psnr) = known(metrics::psnr(&ours, &theirs, mask))? {
            found.albedo = Some(AlbedoMetrics {
                psnr,
                ssim: metrics::ssim(&ours, &theirs, mask)?,
                psnr_scaled: metrics::psnr_scaled(&ours, &theirs, mask)?,
                lpips: lpips.map(|l| l.distance(&ours, &theirs, mask)).transpose()?,
            });
        }
    }
    if let Some(t) = truth.load(GroundTruthKind::Roughness, view)? {
        found.roughness_mse = known(metrics::mse(&shaded.roughness(), &t, mask))?;
    }
    if let Some(t) = truth.load(GroundTruthKind::Metallic, view)? {
        found.metallic_mse = known(metrics::mse(&shaded.metallic(), &t, mask))?;
    }
    Ok(found)
}

/// A relit picture against ground truth; both linear.
///
/// # Errors
/// If their sizes differ.
pub fn measure_relit(ours: &Image, theirs: &Image) -> Result<RelitMetrics> {
    let (mut ab, mut aa) = (0.0_f64, 0.0_f64);
    for (a, b) in ours.data.iter().zip(&theirs.data) {
        // What is beyond white in either says nothing about the other.
        if *b < 1.0 && *a < 1.0 {
            ab += f64::from(*a) * f64::from(*b);
            aa += f64::from(*a) * f64::from(*a);
        }
    }
    let gain = if aa > 0.0 { (ab / aa) as f32 } else { 1.0 };
    let gained = Image { data: ours.data.iter().map(|v| v * gain).collect(), ..ours.clone() };
    let shown = displayed(theirs);
    let first = displayed(ours);
    Ok(RelitMetrics {
        psnr: metrics::psnr(&first, &shown, None)?,
        ssim: metrics::ssim(&first, &shown, None)?,
        psnr_scaled: metrics::psnr(&displayed(&gained), &shown, None)?,
    })
}

/// Means of what is known.
pub fn mean(all: &[&ShadedMetrics]) -> ShadedMetrics {
    let some = |f: &dyn Fn(&ShadedMetrics) -> Option<f64>| {
        let values: Vec<f64> = all.iter().filter_map(|m| f(m)).collect();
        (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
    };
    let pbr =
        some(&|m| m.pbr.map(|v| v.psnr)).zip(some(&|m| m.pbr.map(|v| v.ssim))).zip(some(&|m| m.pbr.map(|v| v.flip)));
    let albedo = some(&|m| m.albedo.map(|v| v.psnr))
        .zip(some(&|m| m.albedo.map(|v| v.ssim)))
        .zip(some(&|m| m.albedo.map(|v| v.psnr_scaled)));
    let mut names: Vec<&String> = all.iter().flat_map(|m| m.relit.keys()).collect();
    names.sort();
    names.dedup();
    let relit = names.into_iter().filter_map(|name| {
        let of = |f: fn(&RelitMetrics) -> f64| some(&|m| m.relit.get(name).map(f));
        let (psnr, ssim, psnr_scaled) = (of(|r| r.psnr)?, of(|r| r.ssim)?, of(|r| r.psnr_scaled)?);
        Some((name.clone(), RelitMetrics { psnr, ssim, psnr_scaled }))
    });
    ShadedMetrics {
        pbr: pbr.map(|((psnr, ssim), flip)| Nvs { psnr, ssim, flip, lpips: some(&|m| m.pbr?.lpips) }),
        albedo: albedo.map(|((psnr, ssim), psnr_scaled)| AlbedoMetrics {
            psnr,
            ssim,
            psnr_scaled,
            lpips: some(&|m| m.albedo?.lpips),
        }),
        roughness_mse: some(&|m| m.roughness_mse),
        metallic_mse: some(&|m| m.metallic_mse),
        relit: relit.collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(data: &[f32]) -> Image {
        Image { width: data.len() as u32 / 3, height: 1, channels: 3, data: data.to_vec() }
    }

    #[test]
    fn one_gain_makes_a_dimmer_picture_equal() {
        let truth: Vec<f32> = (0..48).map(|i| 0.02 * i as f32).collect();
        let half: Vec<f32> = truth.iter().map(|v| 0.5 * v).collect();
        let wide = |v: &[f32]| Image { width: 4, height: 4, channels: 3, data: v.to_vec() };
        let m = measure_relit(&wide(&half), &wide(&truth)).unwrap();
        assert!(m.psnr < 20.0 && m.psnr_scaled > 60.0, "{m:?}");
        assert!(measure_relit(&image(&truth), &wide(&truth)).is_err());
    }

    #[test]
    fn means_are_of_what_is_known() {
        let one = |rough: Option<f64>| ShadedMetrics { roughness_mse: rough, ..Default::default() };
        let m = mean(&[&one(Some(0.5)), &one(None), &one(Some(1.5))]);
        assert_eq!((m.roughness_mse, m.metallic_mse), (Some(1.0), None));
        assert!(m.pbr.is_none() && m.relit.is_empty());
    }
}
