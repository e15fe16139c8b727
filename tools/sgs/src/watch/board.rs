//! What a page of a training that goes on shows, and the parts of that page.

use serde_json::json;
use sgs_evaluate::metrics::psnr;
use sgs_report::figure::{data_uri, slider};
use sgs_report::{Page, chart, escape, number, table};
use sgs_scene::Image;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard};
use std::time::{Duration, Instant};

/// Pixels across that pictures have at most.
pub const WIDTH: u32 = 480;

/// A view that is held back: what is to be seen, and what is.
#[derive(Clone, Debug)]
pub struct Shot {
    pub name: String,
    pub truth: Image,
    pub render: Image,
}

/// What the training says and the server tells.
pub struct Board {
    title: String,
    /// The run's directory.
    run: PathBuf,
    /// What does not change.
    facts: Vec<(String, String)>,
    now: Mutex<Now>,
}

#[derive(Default)]
struct Now {
    stage: String,
    step: u32,
    steps: u32,
    text: String,
    since: Option<(Instant, u32)>,
    shots: Vec<Shot>,
    /// At which step they were made, and what share of the time that takes.
    made: String,
    /// How often there were pictures so far.
    pictures: u64,
    /// The pictures as HTML, once somebody has asked for them.
    html: Option<String>,
    /// PSNR of the held-back views, as lines of a log.
    quality: String,
    /// How the training has ended.
    ended: Option<String>,
    /// When a page has asked last, and whether a page knows that the training has ended.
    asked: Option<Instant>,
    end_seen: bool,
}

impl Board {
    pub fn new(title: String, run: PathBuf, facts: Vec<(String, String)>) -> Board {
        Board { title, run, facts, now: Mutex::default() }
    }

    fn now(&self) -> MutexGuard<'_, Now> {
        self.now.lock().unwrap_or_else(|e| e.into_inner())
    }

    /// So many steps of a stage are done. `text` writes what else there is to be said, into memory that is there.
    pub fn step(&self, stage: &str, step: u32, steps: u32, text: impl FnOnce(&mut String)) {
        let mut now = self.now();
        if now.stage != stage {
            now.stage = stage.to_owned();
            now.since = None;
        }
        if now.since.is_none() {
            now.since = Some((Instant::now(), step));
        }
        (now.step, now.steps) = (step, steps);
        now.text.clear();
        text(&mut now.text);
    }

    /// Says how the training has ended.
    pub fn end(&self, how: &str) {
        self.now().ended = Some(how.to_owned());
    }

    /// Whether a page that still asks does not know yet that the training has ended.
    pub fn is_awaited(&self, within: Duration) -> bool {
        let now = self.now();
        !now.end_seen && now.asked.is_some_and(|at| at.elapsed() < within)
    }

    /// Shows other images, and adds the PSNR of their renders to its curve.
    pub fn show(&self, stage: &str, step: u32, shots: Vec<Shot>, made: String) {
        let all: Vec<f64> =
            shots.iter().filter_map(|s| psnr(&s.render, &s.truth, None).ok()).filter(|v| v.is_finite()).collect();
        let mut now = self.now();
        if !all.is_empty() {
            let mean = all.iter().sum::<f64>() / all.len() as f64;
            let line = json!({"stage": stage, "step": step, "PSNR of held-back views (dB)": mean});
            let _ = writeln!(now.quality, "{line}");
        }
        now.shots = shots;
        now.made = made;
        now.pictures += 1;
        now.html = None;
    }

    /// The whole page.
    pub fn page(&self) -> String {
        let mut page = Page::new(&self.title);
        page.live_section("summary", "Summary", &self.summary());
        page.live_section("views", "Views", "<p>There are no pictures yet.</p>");
        page.live_section("curves", "Curves", "<p>There are no curves yet.</p>");
        page.live()
    }

    /// What has changed for somebody who has seen so many pictures.
    pub fn changes(&self, seen: u64) -> String {
        let mut parts = json!({"summary": self.summary()});
        let mut log = std::fs::read_to_string(self.run.join("log.jsonl")).unwrap_or_default();
        // The last line may be in the making.
        log.push('\n');
        let ended = {
            let mut now = self.now();
            log.push_str(&now.quality);
            now.asked = Some(Instant::now());
            now.end_seen = now.ended.is_some();
            now.end_seen
        };
        let curves = chart::log(&log);
        if !curves.is_empty() {
            parts["curves"] = curves.into();
        }
        let (pictures, views) = self.views(seen);
        if let Some(html) = views {
            parts["views"] = html.into();
        }
        json!({"parts": parts, "pictures": pictures, "ended": ended}).to_string()
    }

    fn summary(&self) -> String {
        let now = self.now();
        let mut rows = self.facts.clone();
        if now.steps > 0 {
            let mut text = format!("step {} of {}", now.step, now.steps);
            if let Some((begun, first)) = now.since
                && now.step > first
                && now.ended.is_none()
            {
                let rate = f64::from(now.step - first) / begun.elapsed().as_secs_f64().max(1e-9);
                let left = f64::from(now.steps.saturating_sub(now.step)) / rate;
                let _ = write!(text, ", {} a second, {} s to go", number(rate), number(left.ceil()));
            }
            rows.push((now.stage.clone(), text));
            rows.push((if now.ended.is_some() { "at the end" } else { "now" }.into(), now.text.clone()));
        }
        rows.extend(now.ended.iter().map(|how| ("state".to_owned(), how.clone())));
        table::facts(&rows)
    }

    /// The pictures, unless they were seen; and how often there were any.
    fn views(&self, seen: u64) -> (u64, Option<String>) {
        // Encoding takes a while, in which the training is not to be kept waiting.
        let (pictures, shots, made, html) = {
            let now = self.now();
            if now.pictures == seen {
                return (seen, None);
            }
            let shots = if now.html.is_some() { Vec::new() } else { now.shots.clone() };
            (now.pictures, shots, now.made.clone(), now.html.clone())
        };
        if html.is_some() {
            return (pictures, html);
        }
        let mut out =
            format!("<p>{}. Truth is left, the render right.</p>\n<div class=\"grid large\">\n", escape(&made));
        for shot in &shots {
            let uris = (data_uri(&shot.truth, WIDTH), data_uri(&shot.render, WIDTH));
            if let (Ok(truth), Ok(render)) = uris {
                let size = [shot.render.width, shot.render.height];
                out.push_str(&slider(&shot.name, &truth, &render, size, ""));
            }
        }
        out.push_str("</div>\n");
        let mut now = self.now();
        if now.pictures == pictures {
            now.html = Some(out.clone());
        }
        (pictures, Some(out))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_are_told_once() {
        let folder = std::env::temp_dir().join(format!("sgs-board-{}", std::process::id()));
        let board = Board::new("a <run>".into(), folder, vec![("scene".into(), "<x>".into())]);
        let changes = |seen| serde_json::from_str::<serde_json::Value>(&board.changes(seen)).expect("JSON");
        assert!(board.page().contains("a &lt;run&gt;") && changes(0)["parts"]["views"].is_null());
        let image = Image::new(4, 2, 3);
        board.step("geometry", 3, 10, |text| text.push_str("loss 0.5"));
        let shot = |render: Image| vec![Shot { name: "<a>".into(), truth: image.clone(), render }];
        board.show("geometry", 3, shot(image.clone()), "At step 3".into());
        let first = changes(0);
        assert_eq!(first["pictures"], 1);
        let html = first["parts"]["views"].as_str().expect("pictures");
        assert!(
            html.contains("<p>At step 3. Truth") && html.contains("&lt;a&gt;") && html.contains("slider"),
            "{html}"
        );
        assert_eq!(changes(0)["parts"]["views"], first["parts"]["views"]);
        let later = changes(1);
        assert!(later["parts"]["views"].is_null() && later["pictures"] == 1);
        let summary = later["parts"]["summary"].as_str().expect("a summary");
        assert!(summary.contains("step 3 of 10") && summary.contains("loss 0.5") && summary.contains("&lt;x&gt;"));
        assert!(later["parts"]["curves"].is_null());
        // Two measurements make a curve.
        let gray = |v: f32| Image { data: vec![v; 24], ..image.clone() };
        board.show("geometry", 5, shot(gray(0.1)), "At step 5".into());
        board.show("geometry", 9, shot(gray(0.01)), "At step 9".into());
        let curves = changes(3)["parts"]["curves"].as_str().expect("a curve").to_owned();
        assert!(curves.contains("PSNR of held-back views (dB)") && curves.contains("40 at the end"), "{curves}");
    }

    #[test]
    fn the_end_reaches_a_page_that_asks() {
        let board = Board::new("run".into(), PathBuf::from("none"), Vec::new());
        board.step("geometry", 9, 10, |text| text.push_str("loss 0.5"));
        let soon = Duration::from_secs(60);
        assert!(!board.is_awaited(soon), "nobody has asked");
        let ended = || serde_json::from_str::<serde_json::Value>(&board.changes(0)).expect("JSON");
        assert_eq!(ended()["ended"], false);
        board.end("finished");
        assert!(board.is_awaited(soon) && !board.is_awaited(Duration::ZERO));
        let last = ended();
        let summary = last["parts"]["summary"].as_str().expect("a summary");
        assert!(last["ended"] == true && summary.contains("finished") && summary.contains("loss 0.5"), "{last}");
        assert!(!summary.contains("to go") && !board.is_awaited(soon));
    }
}
