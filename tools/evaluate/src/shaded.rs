//! Metrics of materials and shaded images at the views of a split.

use crate::error::Result;
use crate::measures::{AlbedoMetrics, Evaluation, Nvs, RELIT_MEAN, RelitMetrics, RelitSet, ShadedMetrics, known};
use crate::metrics::{self, GainFit, Lpips};
use crate::valid::{blackened, truth_mask};
use sgs_run::{ShadedView, Shading, displayed};
use sgs_scene::{GroundTruth, GroundTruthKind, Image, Scene};
use std::collections::BTreeMap;

/// Measures shaded images and materials. Adds the metrics to an evaluation of the same views.
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
    mut on_view: impl FnMut(&str, &ShadedView) -> Result<()>,
) -> Result<()> {
    let truth = GroundTruth::of(scene);
    let mut fit = GainFit::new(3);
    let mut albedos = Vec::with_capacity(views.len());
    for (&i, metrics) in views.iter().zip(&mut into.views) {
        let view = &scene.views[i];
        let shaded = shading.shade(&view.camera)?;
        let counts = scene.load_mask(i)?;
        let counts = counts.as_ref();
        let mut found = measure_materials(&shaded, &truth, (i, counts), lpips, &mut fit)?;
        let image = displayed(&shaded.radiance(background));
        let photo = blackened(scene.load_image(i)?, counts);
        found.pbr = Some(Nvs::of(&image, &photo, counts, lpips)?);
        on_view(&view.camera.name, &shaded)?;
        albedos.push(found.albedo.map(|_| shaded.albedo()));
        metrics.shaded = Some(found);
    }
    // The gain is common to all views, so it is known only after the last one.
    let gains = fit.per_channel();
    for ((&i, metrics), ours) in views.iter().zip(&mut into.views).zip(&albedos) {
        let found = metrics.shaded.as_mut().and_then(|s| s.albedo.as_mut());
        let (Some(found), Some(ours), Some(theirs)) = (found, ours, truth.load(GroundTruthKind::Albedo, i)?) else {
            continue;
        };
        let mask = truth_mask(&truth, i, scene.load_mask(i)?.as_ref())?;
        let ours = displayed(&metrics::scaled(ours, &gains));
        found.psnr_scaled = metrics::psnr(&ours, &displayed(&theirs), mask.as_ref())?;
    }
    let all: Vec<&ShadedMetrics> = into.views.iter().filter_map(|v| v.shaded.as_ref()).collect();
    into.mean.shaded = Some(mean(&all));
    Ok(())
}

/// Measures the materials of a view, with the mask of its photograph. Adds its albedo to the fit of the common gain.
/// `psnr_scaled` is preliminary until that gain is known.
fn measure_materials(
    shaded: &ShadedView,
    truth: &GroundTruth<'_>,
    (view, counts): (usize, Option<&Image>),
    lpips: Option<&Lpips>,
    fit: &mut GainFit,
) -> Result<ShadedMetrics> {
    let mask = truth_mask(truth, view, counts)?;
    let mask = mask.as_ref();
    let mut found = ShadedMetrics::default();
    if let Some(albedo) = truth.load(GroundTruthKind::Albedo, view)? {
        let (linear, albedo) = (shaded.albedo(), blackened(albedo, counts));
        let (ours, theirs) = (displayed(&linear), displayed(&albedo));
        if let Some(psnr) = known(metrics::psnr(&ours, &theirs, mask))? {
            fit.add_images(&linear, &albedo, mask)?;
            found.albedo = Some(AlbedoMetrics {
                psnr,
                ssim: metrics::ssim(&ours, &theirs, mask)?,
                psnr_scaled: psnr,
                psnr_scaled_per_view: metrics::psnr_scaled(&ours, &theirs, mask)?,
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

/// Rendered and true view of a relit set, and the mask of the view's photograph.
pub type RelitPair<'a> = (&'a Image, &'a Image, Option<&'a Image>);

/// Compares rendered and true views of a relit set where their masks count. All images are linear.
///
/// # Errors
/// If sizes differ, or a mask excludes all pixels.
pub fn measure_relit(pairs: &[RelitPair<'_>]) -> Result<Vec<RelitMetrics>> {
    let fit_of = |pairs: &[RelitPair<'_>]| {
        let mut fit = GainFit::new(1);
        let pixels = pairs.iter().flat_map(|&(ours, theirs, mask)| metrics::pairs(ours, theirs, mask));
        for (a, b) in pixels.flat_map(|(ours, theirs)| ours.iter().zip(theirs)) {
            // Values of 1 and above are clipped in display and have no information about the gain.
            if *b < 1.0 && *a < 1.0 {
                fit.add(0, *a, *b);
            }
        }
        fit.common()
    };
    let common = fit_of(pairs);
    let measure = |&(ours, theirs, mask): &RelitPair<'_>| {
        let (first, shown) = (displayed(ours), blackened(displayed(theirs), mask));
        let after = |gain: f64| {
            let gains = vec![gain; ours.channels as usize];
            metrics::psnr(&displayed(&metrics::scaled(ours, &gains)), &shown, mask)
        };
        Ok(RelitMetrics {
            psnr: metrics::psnr(&first, &shown, mask)?,
            ssim: metrics::ssim(&first, &shown, mask)?,
            psnr_gain: after(common)?,
            psnr_gain_per_view: after(fit_of(&[(ours, theirs, mask)]))?,
        })
    };
    pairs.iter().map(measure).collect()
}

/// Returns the mean of relit metrics; none without metrics.
fn mean_relit<'a>(all: impl Iterator<Item = &'a RelitMetrics>) -> Option<RelitMetrics> {
    let all: Vec<&RelitMetrics> = all.collect();
    let of = |f: fn(&RelitMetrics) -> f64| all.iter().map(|m| f(m)).sum::<f64>() / all.len() as f64;
    (!all.is_empty()).then(|| RelitMetrics {
        psnr: of(|m| m.psnr),
        ssim: of(|m| m.ssim),
        psnr_gain: of(|m| m.psnr_gain),
        psnr_gain_per_view: of(|m| m.psnr_gain_per_view),
    })
}

/// Returns the means of the metrics that are present. Each relit set has the mean over its views. [`RELIT_MEAN`] has
/// the mean over all sets.
pub fn mean(all: &[&ShadedMetrics]) -> ShadedMetrics {
    let some = |f: &dyn Fn(&ShadedMetrics) -> Option<f64>| {
        let values: Vec<f64> = all.iter().filter_map(|m| f(m)).collect();
        (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
    };
    let pbr = || {
        let of = |f: fn(&Nvs) -> f64| some(&|m| m.pbr.as_ref().map(f));
        let lpips = some(&|m| m.pbr?.lpips);
        let (psnr_aligned, ssim_aligned) = (None, None);
        Some(Nvs {
            psnr: of(|v| v.psnr)?,
            ssim: of(|v| v.ssim)?,
            flip: of(|v| v.flip)?,
            lpips,
            psnr_aligned,
            ssim_aligned,
        })
    };
    let albedo = || {
        let of = |f: fn(&AlbedoMetrics) -> f64| some(&|m| m.albedo.as_ref().map(f));
        Some(AlbedoMetrics {
            psnr: of(|v| v.psnr)?,
            ssim: of(|v| v.ssim)?,
            psnr_scaled: of(|v| v.psnr_scaled)?,
            psnr_scaled_per_view: of(|v| v.psnr_scaled_per_view)?,
            lpips: some(&|m| m.albedo?.lpips),
        })
    };
    let mut names: Vec<&String> = all.iter().flat_map(|m| m.relit.keys()).collect();
    names.sort();
    names.dedup();
    let of_views = |name: &String| mean_relit(all.iter().filter_map(|m| m.relit.get(name)?.metrics()));
    let mut relit: BTreeMap<String, RelitSet> = BTreeMap::new();
    relit.extend(names.into_iter().filter_map(|n| Some((n.clone(), RelitSet::Measured(of_views(n)?)))));
    let over_sets = mean_relit(relit.values().filter_map(RelitSet::metrics));
    relit.extend(over_sets.map(|m| (RELIT_MEAN.to_owned(), RelitSet::Measured(m))));
    ShadedMetrics {
        pbr: pbr(),
        albedo: albedo(),
        roughness_mse: some(&|m| m.roughness_mse),
        metallic_mse: some(&|m| m.metallic_mse),
        relit,
        relit_bounces: BTreeMap::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wide(v: &[f32]) -> Image {
        Image { width: 4, height: 4, channels: 3, data: v.to_vec() }
    }

    #[test]
    fn one_gain_matches_a_dimmer_image() {
        let truth: Vec<f32> = (0..48).map(|i| 0.02 * i as f32).collect();
        let half: Vec<f32> = truth.iter().map(|v| 0.5 * v).collect();
        let m = measure_relit(&[(&wide(&half), &wide(&truth), None)]).unwrap()[0];
        assert!(m.psnr < 20.0 && m.psnr_gain > 60.0 && m.psnr_gain_per_view > 60.0, "{m:?}");
        assert!(measure_relit(&[(&Image::new(16, 1, 3), &wide(&truth), None)]).is_err());
    }

    /// Two gray views: 0.2 and 0.4 where the truth is 0.4 and 0.2. Separately, the gains 2 and 1/2 make them equal.
    /// Together, the gain is (0.2·0.4 + 0.4·0.2) / (0.2² + 0.4²) = 0.8, which yields 0.16 and 0.32 instead of 0.4 and
    /// 0.2.
    #[test]
    fn relit_gain_is_common_to_all_views() {
        let gray = |v: f32| wide(&[v; 48]);
        let (dark, bright) = (gray(0.2), gray(0.4));
        let found = measure_relit(&[(&dark, &bright, None), (&bright, &dark, None)]).unwrap();
        let shown = |v: f64| 1.055 * v.powf(1.0 / 2.4) - 0.055;
        let decibels = |a: f64, b: f64| -20.0 * (shown(a) - shown(b)).abs().log10();
        for (m, expected) in found.iter().zip([decibels(0.16, 0.4), decibels(0.32, 0.2)]) {
            assert!((m.psnr_gain - expected).abs() < 1e-3 && m.psnr_gain_per_view > 100.0, "{m:?}, not {expected}");
            assert!((m.psnr - decibels(0.2, 0.4)).abs() < 1e-3, "{m:?}");
        }
    }

    #[test]
    fn masked_pixels_change_no_relit_metric() {
        let (ours, theirs) = (wide(&[0.2; 48]), (0..48).map(|i| 0.02 * i as f32).collect::<Vec<f32>>());
        let mask = Image { width: 4, height: 4, channels: 1, data: (0..16).map(|p| f32::from(p % 5 != 2)).collect() };
        let poisoned = |v: f32| {
            let values = theirs.iter().enumerate().map(|(i, old)| if i / 3 % 5 == 2 { v } else { *old });
            wide(&values.collect::<Vec<f32>>())
        };
        let measured = |v: f32, mask: Option<&Image>| {
            let m = measure_relit(&[(&ours, &poisoned(v), mask)]).unwrap()[0];
            [m.psnr, m.ssim, m.psnr_gain, m.psnr_gain_per_view]
        };
        let (gray, counted) = (measured(0.5, Some(&mask)), measured(0.5, None));
        assert!(gray.iter().zip(counted).all(|(a, b)| *a != b), "{gray:?} {counted:?}");
        for v in [0.0, 0.9, 1e9, f32::NAN] {
            assert_eq!(measured(v, Some(&mask)), gray, "{v}");
        }
    }

    #[test]
    fn means_ignore_absent_metrics() {
        let one = |rough: Option<f64>| ShadedMetrics { roughness_mse: rough, ..Default::default() };
        let m = mean(&[&one(Some(0.5)), &one(None), &one(Some(1.5))]);
        assert_eq!((m.roughness_mse, m.metallic_mse), (Some(1.0), None));
        assert!(m.pbr.is_none() && m.albedo.is_none() && m.relit.is_empty());
    }

    /// Views of a set are averaged before sets are.
    #[test]
    fn relit_mean_is_over_sets() {
        let of =
            |v: f64| RelitSet::Measured(RelitMetrics { psnr: v, ssim: v, psnr_gain: v + 1.0, psnr_gain_per_view: v });
        let view = |sets: &[(&str, f64)]| ShadedMetrics {
            relit: sets.iter().map(|(name, v)| ((*name).to_owned(), of(*v))).collect(),
            ..Default::default()
        };
        let m = mean(&[&view(&[("day", 10.0), ("night", 30.0)]), &view(&[("day", 20.0)])]);
        let psnr = |name: &str| m.relit[name].metrics().map(|m| (m.psnr, m.psnr_gain));
        assert_eq!(
            (psnr("day"), psnr("night"), psnr("mean")),
            (Some((15.0, 16.0)), Some((30.0, 31.0)), Some((22.5, 23.5)))
        );
    }

    #[test]
    fn skipped_set_serializes_its_reason() {
        let set = RelitSet::Skipped { reason: "No light.".into() };
        assert_eq!(serde_json::to_value(&set).unwrap(), serde_json::json!({"reason": "No light."}));
        assert!(set.metrics().is_none());
    }
}
