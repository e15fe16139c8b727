//! Summary of a batch, rebuilt from its results: `summary.jsonl`, `summary.md`, `summary.html`.

use crate::batch::{Batch, Run, write_if_changed};
use crate::error::Result;
use crate::result::{RunResult, State};
use crate::store::Store;
use sgs_report::escape;
use std::collections::HashMap;
use std::fmt::Write as _;

/// Column of the tables.
struct Column {
    heading: &'static str,
    digits: usize,
    value: fn(&RunResult) -> Option<f64>,
}

/// Columns, in order. A column that no run has is left out.
const COLUMNS: [Column; 9] = [
    Column { heading: "PSNR, dB ↑", digits: 2, value: |r| measure(r, "nvs.psnr") },
    Column { heading: "SSIM ↑", digits: 4, value: |r| measure(r, "nvs.ssim") },
    Column { heading: "shaded PSNR, dB ↑", digits: 2, value: |r| measure(r, "pbr.psnr") },
    Column { heading: "albedo PSNR, dB ↑", digits: 2, value: |r| measure(r, "albedo.psnr") },
    Column { heading: "relit PSNR, dB ↑", digits: 2, value: |r| measure(r, "relit.mean.psnr") },
    Column { heading: "Gaussians", digits: 0, value: |r| r.gaussians.map(|n| n as f64) },
    Column { heading: "steps/s", digits: 2, value: |r| r.steps_per_second },
    Column { heading: "peak, MiB", digits: 0, value: |r| r.peak_device_bytes.map(|n| n as f64 / 1_048_576.0) },
    Column { heading: "seconds", digits: 1, value: |r| Some(r.seconds) },
];

fn measure(result: &RunResult, name: &str) -> Option<f64> {
    result.measures.get(name).copied()
}

/// Results of a batch, in the order of the manifest.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// Results; runs without one are left out.
    pub results: Vec<RunResult>,
    /// Number of runs.
    pub total: usize,
}

/// Table: headings and rows of cells.
struct Table {
    title: &'static str,
    head: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Summary {
    /// Reads the results of a batch.
    ///
    /// Lists the results and reads those that the store has not read before.
    ///
    /// # Errors
    /// If the results cannot be listed.
    pub fn read(store: &Store, batch: &Batch) -> Result<Summary> {
        let there = store.result_keys()?;
        let of = |run: &Run| there.contains(&run.key()).then(|| store.answer(run, batch.evaluate)).flatten();
        Ok(Summary { results: batch.runs.iter().filter_map(of).collect(), total: batch.runs.len() })
    }

    /// Writes the summary of all results. Leaves equal files as they are.
    ///
    /// `last`: whether the worker writes no further summary. Only then the files are complete for certain.
    ///
    /// # Errors
    /// If the results cannot be listed, or a file cannot be written.
    pub fn update(store: &Store, batch: &Batch, last: bool) -> Result<()> {
        let mut summary = Summary::read(store, batch)?;
        // Another worker may have written a result meanwhile, and its summary before this one.
        loop {
            summary.write(store)?;
            if !last {
                return Ok(());
            }
            let now = Summary::read(store, batch)?;
            if now == summary {
                return Ok(());
            }
            summary = now;
        }
    }

    fn write(&self, store: &Store) -> Result<()> {
        for (name, text) in [("jsonl", self.jsonl()), ("md", self.markdown()), ("html", self.html())] {
            write_if_changed(&store.root().join(format!("summary.{name}")), &text)?;
        }
        Ok(())
    }

    /// Formats one line of JSON per run.
    pub fn jsonl(&self) -> String {
        self.results.iter().map(|r| serde_json::to_string(r).unwrap_or_default() + "\n").collect()
    }

    fn headline(&self) -> String {
        let failed = self.results.iter().filter(|r| r.state == State::Failed).count();
        let done = self.results.len() - failed;
        format!("{} runs: {done} done, {failed} failed, {} open", self.total, self.total - self.results.len())
    }

    fn failures(&self) -> Vec<String> {
        let failed = self.results.iter().filter(|r| r.state == State::Failed);
        failed
            .map(|r| {
                let (kind, error) = (r.kind.as_deref().unwrap_or("failed"), r.error.as_deref().unwrap_or_default());
                format!("{} ({kind}): {}", r.name(), error.split_whitespace().collect::<Vec<_>>().join(" "))
            })
            .collect()
    }

    fn tables(&self) -> [Table; 2] {
        let done: Vec<&RunResult> = self.results.iter().filter(|r| r.state == State::Done).collect();
        let columns: Vec<&Column> = COLUMNS.iter().filter(|c| done.iter().any(|r| (c.value)(r).is_some())).collect();
        let headings = || columns.iter().map(|c| c.heading.to_owned());
        let words = |words: &[&str]| words.iter().map(|w| (*w).to_owned()).collect::<Vec<_>>();
        let cell = |value: Option<f64>, digits: usize| value.map_or("–".to_owned(), |v| format!("{v:.digits$}"));
        let rows = self.results.iter().map(|r| {
            let own = columns.iter().map(|c| match r.state {
                State::Done => cell((c.value)(r), c.digits),
                State::Failed => "–".to_owned(),
            });
            let state = if r.state == State::Done { "done" } else { "failed" };
            let start = [r.scene.clone(), r.variant.clone(), r.seed.to_string(), state.to_owned()];
            start.into_iter().chain(own).collect()
        });
        let runs = Table {
            title: "Runs",
            head: words(&["scene", "variant", "seed", "state"]).into_iter().chain(headings()).collect(),
            rows: rows.collect(),
        };
        let mut groups: Vec<Vec<&RunResult>> = Vec::new();
        let mut places: HashMap<(&str, &str), usize> = HashMap::new();
        for result in &done {
            let place = *places.entry((&result.scene, &result.variant)).or_insert(groups.len());
            if place == groups.len() {
                groups.push(Vec::new());
            }
            groups[place].push(result);
        }
        let spread = |of: Vec<&RunResult>| {
            let cells = columns.iter().map(|c| {
                let values = sorted(of.iter().filter_map(|r| (c.value)(r)).collect());
                let digits = c.digits;
                match (values.first(), values.last()) {
                    (Some(least), Some(most)) if values.len() > 1 => {
                        let range = format!("({least:.digits$}..{most:.digits$})");
                        format!("{} {range}", cell(median(&values), digits))
                    }
                    _ => cell(median(&values), digits),
                }
            });
            let start = [of[0].scene.clone(), of[0].variant.clone(), of.len().to_string()];
            start.into_iter().chain(cells).collect()
        };
        let medians = Table {
            title: "Medians over seeds (least..most)",
            head: words(&["scene", "variant", "seeds"]).into_iter().chain(headings()).collect(),
            rows: groups.into_iter().map(spread).collect(),
        };
        [runs, medians]
    }

    /// Formats the summary as Markdown.
    pub fn markdown(&self) -> String {
        let cell = |text: &String| text.replace('|', "\\|");
        let line = |cells: &[String]| format!("| {} |\n", cells.iter().map(cell).collect::<Vec<_>>().join(" | "));
        let mut text = format!("# Summary\n\n{}\n", self.headline());
        for table in self.tables().iter().filter(|t| !t.rows.is_empty()) {
            let _ = write!(text, "\n## {}\n\n{}|{}\n", table.title, line(&table.head), "---|".repeat(table.head.len()));
            table.rows.iter().for_each(|row| text += &line(row));
        }
        let failures = self.failures();
        if !failures.is_empty() {
            text += "\n## Failures\n\n";
            failures.iter().for_each(|f| text += &format!("- {f}\n"));
        }
        text
    }

    /// Formats the summary as one page without references to other files.
    pub fn html(&self) -> String {
        let mut text = format!("{HEAD}<h1>Summary</h1>\n<p>{}</p>\n", escape(&self.headline()));
        let row = |cells: &[String], tag: &str| {
            let cells: String = cells.iter().map(|c| format!("<{tag}>{}</{tag}>", escape(c))).collect();
            format!("<tr>{cells}</tr>\n")
        };
        for table in self.tables().iter().filter(|t| !t.rows.is_empty()) {
            let rows: String = table.rows.iter().map(|r| row(r, "td")).collect();
            let _ =
                write!(text, "<h2>{}</h2>\n<table>\n{}{rows}</table>\n", escape(table.title), row(&table.head, "th"));
        }
        let failures = self.failures();
        if !failures.is_empty() {
            let items: String = failures.iter().map(|f| format!("<li>{}</li>\n", escape(f))).collect();
            let _ = write!(text, "<h2>Failures</h2>\n<ul>\n{items}</ul>\n");
        }
        text + "</body></html>\n"
    }
}

const HEAD: &str = "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>Summary of a batch</title>\n\
    <style>body{font:15px/1.5 system-ui,sans-serif;margin:2rem auto;max-width:80rem;padding:0 1rem}\
    table{border-collapse:collapse}th,td{border:1px solid #ccc;padding:.2rem .6rem;text-align:left}\
    td{font-variant-numeric:tabular-nums}</style></head><body>\n";

fn sorted(mut values: Vec<f64>) -> Vec<f64> {
    values.sort_by(f64::total_cmp);
    values
}

/// Returns the median of sorted values.
fn median(values: &[f64]) -> Option<f64> {
    let middle = values.get(values.len() / 2)?;
    Some(if values.len().is_multiple_of(2) { 0.5 * (values[values.len() / 2 - 1] + middle) } else { *middle })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::batch::tests::run;

    fn summary() -> Summary {
        let done = |seed: u64, psnr: f64| {
            let mut result = RunResult { state: State::Done, seconds: 4.0, ..RunResult::of(&run("a&b|c", seed)) };
            result.measures.insert("nvs.psnr".into(), psnr);
            result
        };
        let mut failed = RunResult::of(&run("d", 0));
        (failed.kind, failed.error) = (Some("input".into()), Some("no <image>\nhere".into()));
        Summary { results: vec![done(0, 30.0), done(1, 33.0), done(2, 31.0), failed], total: 6 }
    }

    #[test]
    fn tables_have_medians_and_spreads() {
        let text = summary().markdown();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[2], "6 runs: 3 done, 1 failed, 2 open");
        assert!(lines.contains(&"| scene | variant | seed | state | PSNR, dB ↑ | seconds |"), "{text}");
        assert!(lines.contains(&"| a&b\\|c | fast | 1 | done | 33.00 | 4.0 |"), "{text}");
        assert!(lines.contains(&"| d | fast | 0 | failed | – | – |"), "{text}");
        assert!(lines.contains(&"| a&b\\|c | fast | 3 | 31.00 (30.00..33.00) | 4.0 (4.0..4.0) |"), "{text}");
        assert_eq!(lines.last(), Some(&"- d/fast/seed0 (input): no <image> here"));
        assert_eq!(median(&[1.0, 2.0, 4.0, 9.0]), Some(3.0));
        assert_eq!(median(&[]), None);
    }

    #[test]
    fn page_escapes_names_and_sentences() {
        let page = summary().html();
        assert!(page.contains("<td>a&amp;b|c</td>") && page.contains("no &lt;image&gt; here"), "{page}");
        assert!(!page.contains("<image>") && !page.contains("http") && page.ends_with("</html>\n"));
    }

    #[test]
    fn lines_are_results_in_order() {
        let summary = summary();
        let lines: Vec<RunResult> = summary.jsonl().lines().map(|l| serde_json::from_str(l).unwrap()).collect();
        assert_eq!(lines, summary.results);
    }
}
