//! Results of trainings: means and deviations over seeds, as JSON and as Markdown.

use super::state::{MEASURES, Measures};
use serde::Serialize;
use sgs_evaluate::metrics::LpipsAbout;

/// Description of a row.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    /// Position in the table.
    pub order: usize,
    /// Name of the row.
    pub name: &'static str,
    /// Components that the row uses.
    pub about: String,
    /// Row that names the run directories: this row, or one with the same settings.
    pub run: &'static str,
}

impl Entry {
    /// Returns the directory name of the run for a seed.
    pub fn folder(&self, seed: u64) -> String {
        format!("{}_seed{seed}", self.run)
    }
}

/// Run of a variant.
#[derive(Clone, Debug, Serialize)]
pub struct AblationRun {
    /// Seed of the run.
    pub seed: u64,
    /// Directory of the run, relative to the table.
    pub folder: String,
    /// Device that trained the run.
    pub device: String,
    /// Results of the run.
    #[serde(flatten)]
    pub measures: Measures,
}

/// Results of a variant.
#[derive(Clone, Debug, Serialize)]
pub struct AblationRow {
    /// Name of the variant.
    pub name: &'static str,
    /// Components that the variant uses.
    pub about: String,
    #[serde(skip)]
    order: usize,
    /// Means over the runs.
    pub mean: Measures,
    /// Standard deviations over the runs (divided by n - 1). Absent with a single run.
    pub deviation: Measures,
    /// Runs of the variant.
    pub runs: Vec<AblationRun>,
}

/// Table of variants.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Ablation {
    /// Scene directory.
    pub scene: String,
    /// Steps of the geometry stage, where it is trained.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub steps: Option<u32>,
    /// Common start of all runs, where the geometry stage is not trained.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub start: Option<String>,
    /// Steps of the intrinsic stage, where it is trained.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub intrinsic_steps: Option<u32>,
    /// LPIPS that was measured, if any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lpips: Option<LpipsAbout>,
    /// Rows of the variants, in order.
    pub variants: Vec<AblationRow>,
}

impl Ablation {
    /// Adds a run to its variant. Updates the means and deviations.
    pub fn add(&mut self, variant: &Entry, seed: u64, device: String, measures: Measures) {
        let at = self.variants.iter().position(|row| row.name == variant.name).unwrap_or_else(|| {
            let at = self.variants.iter().take_while(|row| row.order < variant.order).count();
            let Entry { order, name, about, .. } = variant.clone();
            let (mean, deviation) = Default::default();
            self.variants.insert(at, AblationRow { name, about, order, mean, deviation, runs: Vec::new() });
            at
        });
        let row = &mut self.variants[at];
        row.runs.push(AblationRun { seed, folder: variant.folder(seed), device, measures });
        for i in 0..MEASURES.len() {
            let values: Vec<f64> = row.runs.iter().filter_map(|r| r.measures.0[i]).collect();
            (row.mean.0[i], row.deviation.0[i]) = spread(&values);
        }
    }

    /// Formats the table as Markdown. A measure that no variant has gets no column.
    pub fn markdown(&self) -> String {
        let known = |i: &usize| self.variants.iter().any(|row| row.mean.0[*i].is_some());
        let columns: Vec<usize> = (0..MEASURES.len()).filter(known).collect();
        let line = |cells: Vec<String>| format!("| {} |\n", cells.join(" | "));
        let head = columns.iter().map(|i| MEASURES[*i].heading.to_owned());
        let mut devices: Vec<&str> = self.variants.iter().flat_map(|v| &v.runs).map(|r| r.device.as_str()).collect();
        devices.sort_unstable();
        devices.dedup();
        let mut after: Vec<String> = self.steps.map(|n| format!("{n} steps")).into_iter().collect();
        after.extend(self.intrinsic_steps.map(|n| format!("{n} of materials")));
        let after = if after.is_empty() { String::new() } else { format!(" after {}", after.join(" and ")) };
        let start = self.start.as_ref().map_or_else(String::new, |start| format!(" on {start}"));
        let lpips = match &self.lpips {
            None => String::new(),
            Some(l) => format!(" LPIPS {}: {}, images from {} to {}.", l.version, l.net, l.range[0], l.range[1]),
        };
        let mut text = format!(
            "Test views of {}{after}{start}, on {}; means and standard deviations over seeds.{lpips}\n\n",
            self.scene,
            devices.join(", ")
        );
        text += &line(["variant".to_owned(), "seeds".to_owned()].into_iter().chain(head).collect());
        text += &format!("|---|---|{}\n", "---|".repeat(columns.len()));
        for row in &self.variants {
            let cell = |i: &usize| {
                let digits = MEASURES[*i].digits;
                match (row.mean.0[*i], row.deviation.0[*i]) {
                    (Some(mean), Some(deviation)) => format!("{mean:.digits$} ± {deviation:.digits$}"),
                    (Some(mean), None) => format!("{mean:.digits$}"),
                    (None, _) => "–".to_owned(),
                }
            };
            let name = format!("{}: {}", row.name, row.about);
            text += &line([name, row.runs.len().to_string()].into_iter().chain(columns.iter().map(cell)).collect());
        }
        text
    }
}

/// Returns the mean and the standard deviation.
fn spread(values: &[f64]) -> (Option<f64>, Option<f64>) {
    let n = values.len() as f64;
    let mean = (n > 0.0).then(|| values.iter().sum::<f64>() / n);
    let square = |mean: f64| values.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
    (mean, mean.filter(|_| n > 1.0).map(|mean| (square(mean) / (n - 1.0)).sqrt()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Scope, Variant};
    use serde_json::json;

    #[test]
    fn means_and_deviations_ignore_absent_values() {
        assert_eq!(spread(&[]), (None, None));
        assert_eq!(spread(&[3.0]), (Some(3.0), None));
        assert_eq!(spread(&[1.0, 2.0, 3.0, 6.0]), (Some(3.0), Some((14.0_f64 / 3.0).sqrt())));
        let variants = Scope::Geometry.variants().iter().map(Variant::entry).collect::<Vec<_>>();
        let mut table = Ablation { scene: "room".into(), steps: Some(9), ..Default::default() };
        let measures = |psnr: f64, normal: Option<f64>| {
            let mut m = Measures::default();
            let at = |key: &str| MEASURES.iter().position(|m| m.key == key).unwrap();
            (m.0[at("psnr")], m.0[at("normal_mae_deg")]) = (Some(psnr), normal);
            m
        };
        table.add(&variants[2], 4, "gpu".into(), measures(31.0, Some(8.25)));
        table.add(&variants[0], 4, "another".into(), measures(30.0, None));
        table.add(&variants[2], 5, "gpu".into(), measures(33.0, None));
        let text = table.markdown();
        assert!(text.starts_with("Test views of room after 9 steps, on another, gpu;"), "{text}");
        let (steps, start) = (None, Some("scene.ply".to_owned()));
        let text_of_start = Ablation { steps, start, ..table.clone() }.markdown();
        assert!(text_of_start.starts_with("Test views of room on scene.ply, on another, gpu;"), "{text_of_start}");
        let lines: Vec<&str> = text.lines().skip(2).collect();
        assert_eq!(lines[0], "| variant | seeds | PSNR, dB ↑ | normals, ° ↓ |");
        assert_eq!(lines[1], "|---|---|---|---|");
        assert_eq!(lines[2], "| rgb: photographs alone | 1 | 30.00 | – |");
        assert_eq!(lines[3], "| normal: and priors of normals | 2 | 32.00 ± 1.41 | 8.25 |");
        let all = serde_json::to_value(&table).unwrap();
        assert_eq!(all["variants"][1]["mean"], json!({"psnr": 32.0, "normal_mae_deg": 8.25}));
        assert_eq!(all["variants"][1]["deviation"], json!({"psnr": 2.0_f64.sqrt()}));
        let run = json!({"seed": 5, "folder": "normal_seed5", "device": "gpu", "psnr": 33.0});
        assert_eq!(all["variants"][1]["runs"][1], run);
    }
}
