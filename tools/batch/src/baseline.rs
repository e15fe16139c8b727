//! Comparison with the summary of an earlier batch.

use crate::error::{Result, wrong};
use crate::result::{RunResult, State};
use std::path::Path;

/// Results of an earlier batch.
#[derive(Clone, Debug)]
pub struct Baseline(Vec<RunResult>);

/// Answer of a comparison.
#[derive(Clone, Debug, PartialEq)]
pub enum Verdict {
    /// Number of compared values, none of which is lower by more than the tolerance.
    Passed(usize),
    /// Sentence that names the worst run.
    Worse(String),
}

impl Baseline {
    /// Reads a `summary.jsonl`.
    ///
    /// # Errors
    /// If the file cannot be read, or a line is no result.
    pub fn read(path: &Path) -> Result<Baseline> {
        let text = std::fs::read_to_string(path).map_err(|e| wrong(path, format!("it cannot be read: {e}")))?;
        let mut results = Vec::new();
        for (i, line) in text.lines().enumerate().filter(|(_, l)| !l.trim().is_empty()) {
            let problem = |e| wrong(path, format!("line {} is no result of a run: {e}", i + 1));
            results.push(serde_json::from_str(line).map_err(problem)?);
        }
        if results.is_empty() {
            return Err(wrong(path, "it has no results; name a summary.jsonl"));
        }
        Ok(Baseline(results))
    }

    /// Compares each PSNR of the baseline's done runs with that of the results.
    ///
    /// `tolerance`: largest loss in dB.
    pub fn compare(&self, results: &[RunResult], tolerance: f64) -> Verdict {
        let (mut compared, mut worst): (usize, Option<(f64, String)>) = (0, None);
        for before in self.0.iter().filter(|r| r.state == State::Done) {
            let name = before.name();
            let Some(now) = results.iter().find(|r| r.name() == name) else {
                return Verdict::Worse(format!("{name} of the baseline is missing"));
            };
            if now.state == State::Failed {
                let error = now.error.as_deref().unwrap_or("it has no reason");
                return Verdict::Worse(format!("{name} of the baseline failed: {error}"));
            }
            for (key, was) in before.measures.iter().filter(|(key, _)| key.rsplit('.').next() == Some("psnr")) {
                let Some(is) = now.measures.get(key) else {
                    return Verdict::Worse(format!("{name} has no {key}, which the baseline has"));
                };
                compared += 1;
                let loss = was - is;
                if loss > tolerance && worst.as_ref().is_none_or(|(most, _)| loss > *most) {
                    let text = format!("{name} has {key} {is:.2} dB, {loss:.2} dB below the baseline's {was:.2} dB");
                    worst = Some((loss, format!("{text}; the tolerance is {tolerance} dB")));
                }
            }
        }
        worst.map_or(Verdict::Passed(compared), |(_, text)| Verdict::Worse(text))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::batch::tests::run;

    fn result(scene: &str, psnr: f64) -> RunResult {
        let mut result = RunResult { state: State::Done, ..RunResult::of(&run(scene, 0)) };
        result.measures.insert("nvs.psnr".into(), psnr);
        result.measures.insert("nvs.ssim".into(), psnr / 100.0);
        result
    }

    #[test]
    fn worst_loss_beyond_the_tolerance_is_named() {
        let baseline = Baseline(vec![result("a", 30.0), result("b", 30.0), RunResult::of(&run("c", 0))]);
        let compare = |a: f64, b: f64| baseline.compare(&[result("a", a), result("b", b)], 0.1);
        assert_eq!(compare(29.95, 35.0), Verdict::Passed(2));
        let Verdict::Worse(text) = compare(29.8, 29.0) else { panic!("it passed") };
        assert!(text.contains("b/fast/seed0") && text.contains("1.00 dB below"), "{text}");
        let worse = |results: &[RunResult], word: &str| match baseline.compare(results, 0.1) {
            Verdict::Worse(text) => assert!(text.contains(word), "{text}"),
            passed => panic!("{passed:?}"),
        };
        worse(&[result("a", 30.0)], "b/fast/seed0 of the baseline is missing");
        worse(&[result("a", 30.0), RunResult::of(&run("b", 0))], "failed");
        let mut without = result("b", 30.0);
        without.measures.clear();
        worse(&[result("a", 30.0), without], "has no nvs.psnr");
    }

    #[test]
    fn damaged_baselines_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("summary.jsonl");
        assert!(Baseline::read(&path).is_err());
        for text in ["", "{}\n", "not json"] {
            std::fs::write(&path, text).unwrap();
            assert!(Baseline::read(&path).is_err(), "{text}");
        }
        let lines = format!("{}\n\n", serde_json::to_string(&result("a", 30.0)).unwrap());
        std::fs::write(&path, lines).unwrap();
        assert_eq!(Baseline::read(&path).unwrap().compare(&[result("a", 31.0)], 0.1), Verdict::Passed(1));
    }
}
