//! Content of the live page of a training, and its sections as HTML.

use serde_json::json;
use sgs_evaluate::metrics::psnr;
use sgs_report::figure::{data_uri, slider};
use sgs_report::{Page, chart, escape, number, table};
use sgs_scene::Image;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard};
use std::time::{Duration, Instant};

/// Maximum width of the images in pixels.
pub const WIDTH: u32 = 480;

/// Held-back view: the photograph and its render.
#[derive(Clone, Debug)]
pub struct Shot {
    pub name: String,
    pub truth: Image,
    pub render: Image,
}

/// State of a training, written by the trainer and read by the server.
pub struct Board {
    title: String,
    /// Directory of the run.
    run: PathBuf,
    /// Rows of the summary that do not change.
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
    /// Text above the images: their step, and the fraction of the training time spent on images.
    made: String,
    /// Number of times that images were rendered.
    images: u64,
    /// Images as HTML, encoded at the first request.
    html: Option<String>,
    /// PSNR of the held-back views, as lines of a JSON log.
    quality: String,
    /// How the training ended.
    ended: Option<String>,
    /// Time of the last request of a page. `end_seen`: a page has received the end of the training.
    requested: Option<Instant>,
    end_seen: bool,
}

impl Board {
    pub fn new(title: String, run: PathBuf, facts: Vec<(String, String)>) -> Board {
        Board { title, run, facts, now: Mutex::default() }
    }

    fn now(&self) -> MutexGuard<'_, Now> {
        self.now.lock().unwrap_or_else(|e| e.into_inner())
    }

    /// Reports that `step` of `steps` steps of a stage are done. `text` writes the figures into a reused buffer.
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

    /// Sets how the training ended.
    pub fn end(&self, how: &str) {
        self.now().ended = Some(how.to_owned());
    }

    /// Returns whether an open page has not yet received the end of the training.
    ///
    /// A page is open if its last request is less than `within` ago.
    pub fn is_awaited(&self, within: Duration) -> bool {
        let now = self.now();
        !now.end_seen && now.requested.is_some_and(|at| at.elapsed() < within)
    }

    /// Replaces the images and appends the mean PSNR of their renders to its curve.
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
        now.images += 1;
        now.html = None;
    }

    /// Returns the whole page.
    pub fn page(&self) -> String {
        let mut page = Page::new(&self.title);
        page.live_section("summary", "Summary", &self.summary());
        page.live_section("views", "Views", "<p>There are no images yet.</p>");
        page.live_section("curves", "Curves", "<p>There are no curves yet.</p>");
        page.live()
    }

    /// Returns the changed sections for a page that has received `seen` sets of images.
    pub fn changes(&self, seen: u64) -> String {
        let mut parts = json!({"summary": self.summary()});
        let mut log = std::fs::read_to_string(self.run.join("log.jsonl")).unwrap_or_default();
        // The trainer may still be writing the last line.
        log.push('\n');
        let ended = {
            let mut now = self.now();
            log.push_str(&now.quality);
            now.requested = Some(Instant::now());
            now.end_seen = now.ended.is_some();
            now.end_seen
        };
        let curves = chart::log(&log);
        if !curves.is_empty() {
            parts["curves"] = curves.into();
        }
        let (images, views) = self.views(seen);
        if let Some(html) = views {
            parts["views"] = html.into();
        }
        json!({"parts": parts, "images": images, "ended": ended}).to_string()
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

    /// Returns the number of image sets, and the images as HTML unless already seen.
    fn views(&self, seen: u64) -> (u64, Option<String>) {
        // Encodes outside the lock, so that the training does not wait.
        let (images, shots, made, html) = {
            let now = self.now();
            if now.images == seen {
                return (seen, None);
            }
            let shots = if now.html.is_some() { Vec::new() } else { now.shots.clone() };
            (now.images, shots, now.made.clone(), now.html.clone())
        };
        if html.is_some() {
            return (images, html);
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
        if now.images == images {
            now.html = Some(out.clone());
        }
        (images, Some(out))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_set_of_images_is_sent_once() {
        let folder = std::env::temp_dir().join(format!("sgs-board-{}", std::process::id()));
        let board = Board::new("a <run>".into(), folder, vec![("scene".into(), "<x>".into())]);
        let changes = |seen| serde_json::from_str::<serde_json::Value>(&board.changes(seen)).expect("JSON");
        assert!(board.page().contains("a &lt;run&gt;") && changes(0)["parts"]["views"].is_null());
        let image = Image::new(4, 2, 3);
        board.step("geometry", 3, 10, |text| text.push_str("loss 0.5"));
        let shot = |render: Image| vec![Shot { name: "<a>".into(), truth: image.clone(), render }];
        board.show("geometry", 3, shot(image.clone()), "At step 3".into());
        let first = changes(0);
        assert_eq!(first["images"], 1);
        let html = first["parts"]["views"].as_str().expect("images");
        assert!(
            html.contains("<p>At step 3. Truth") && html.contains("&lt;a&gt;") && html.contains("slider"),
            "{html}"
        );
        assert_eq!(changes(0)["parts"]["views"], first["parts"]["views"]);
        let later = changes(1);
        assert!(later["parts"]["views"].is_null() && later["images"] == 1);
        let summary = later["parts"]["summary"].as_str().expect("a summary");
        assert!(summary.contains("step 3 of 10") && summary.contains("loss 0.5") && summary.contains("&lt;x&gt;"));
        assert!(later["parts"]["curves"].is_null());
        // A curve needs two measurements.
        let gray = |v: f32| Image { data: vec![v; 24], ..image.clone() };
        board.show("geometry", 5, shot(gray(0.1)), "At step 5".into());
        board.show("geometry", 9, shot(gray(0.01)), "At step 9".into());
        let curves = changes(3)["parts"]["curves"].as_str().expect("a curve").to_owned();
        assert!(curves.contains("PSNR of held-back views (dB)") && curves.contains("40 at the end"), "{curves}");
    }

    #[test]
    fn end_of_training_reaches_an_open_page() {
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
