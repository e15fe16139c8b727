//! Relit sets of a run with emitters in a report: a view relit, beside its photograph and the truth.

use serde_json::Value;
use sgs_engine::Device;
use sgs_evaluate::measure_relit;
use sgs_relight::{Emitting, relit_views};
use sgs_report::escape;
use sgs_report::figure::{data_uri, rendered};
use sgs_run::displayed;
use sgs_scene::{Image, Scene, Splats};

/// View that is relit.
pub struct RelitPage<'a> {
    /// Scene of the run.
    pub scene: &'a Scene,
    /// Gaussians of the run.
    pub splats: &'a Splats,
    /// Index of the view.
    pub view: usize,
    /// Largest width of an image.
    pub width: u32,
    /// Measures of the run, as in `metrics.json`.
    pub metrics: &'a Value,
}

/// Returns the section of relit sets: a row per set. Empty if the scene has no set whose lights are known.
pub fn html(device: &Device, emitting: &Emitting, page: &RelitPage<'_>) -> anyhow::Result<String> {
    let sets = relit_views(device, page.scene, page.splats, emitting, page.view)?;
    if sets.is_empty() {
        return Ok(String::new());
    }
    let figure = |name: &str, image: &Image, note: &str| -> anyhow::Result<String> {
        Ok(rendered(name, &data_uri(image, page.width)?, [image.width, image.height], note))
    };
    let photograph = figure("photograph", &page.scene.load_image(page.view)?, "")?;
    let mask = page.scene.load_mask(page.view)?;
    let name = &page.scene.views[page.view].camera.name;
    let mut out = format!(
        "<p>View {} under lights that training never saw. Relit: the learned emitters, changed as the true lights change, and \
         lights that the photographs lack, with all bounces. The surface of such a light is not rendered.</p>\n",
        escape(name)
    );
    for set in &sets {
        let measured = measure_relit(&[(&set.ours, &set.truth, mask.as_ref())])?;
        let note = note(measured.first().map(|m| m.psnr), mean(page.metrics, &set.name));
        let relit = figure("relit", &displayed(&set.ours), &note)?;
        let truth = figure("truth", &displayed(&set.truth), "")?;
        out.push_str(&format!(
            "<h3>{}</h3>\n<div class=\"grid strip\">\n{photograph}{relit}{truth}</div>\n",
            escape(&set.name)
        ));
    }
    Ok(out)
}

/// Returns the mean PSNR of a set over the measured views, in dB.
fn mean(metrics: &Value, set: &str) -> Option<f64> {
    metrics["mean"]["relit_bounces"][set]["learned_emitters"].as_f64()
}

/// Returns the PSNR of a view and of all views as text.
fn note(view: Option<f64>, mean: Option<f64>) -> String {
    let parts = [view.map(|v| format!("{v:.2} dB")), mean.map(|v| format!("{v:.2} dB in the mean over the views"))];
    parts.into_iter().flatten().collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn note_has_the_view_and_the_mean() {
        let metrics = json!({"mean": {"relit_bounces": {"night": {"learned_emitters": 21.257}}}});
        assert_eq!((mean(&metrics, "night"), mean(&metrics, "day")), (Some(21.257), None));
        assert_eq!(note(Some(20.0), mean(&metrics, "night")), "20.00 dB, 21.26 dB in the mean over the views");
        assert_eq!(note(Some(20.0), None), "20.00 dB");
    }
}
