//! Files of runs, settings, and sizes on the command line.

use super::text_of;
use crate::place::Place;
use crate::seeds;
use sgs_config::{Settings, overlay, parse_bytes};
use sgs_report::{chart, serve, table};
use sgs_run::{RunDirectory, RunError, StageKind, use_learned_views};
use sgs_scene::{Scene, SceneOptions};
use sgs_study::{Goal, Measures, State};
use std::io::Write;

/// Parses settings as the command line and programs pass them.
pub(crate) fn settings(bytes: &[u8]) -> String {
    let text = String::from_utf8_lossy(bytes);
    let table = match text.parse::<toml::Table>() {
        Ok(table) => table,
        Err(error) => return error.message().to_owned(),
    };
    // An overlay on other settings is first a table of any content.
    let mut over = Settings::default().to_table().expect("settings are a table");
    overlay(&mut over, table.clone());
    let over = text_of(Settings::from_table(over).and_then(|s| s.check()), |()| "over".into());
    let own = Settings::from_table(table).and_then(|settings| settings.check().map(|()| settings));
    over + &text_of(own, |settings| {
        let again = settings.to_table().and_then(Settings::from_table);
        assert_eq!(again.ok(), Some(settings), "settings come back");
        "read".into()
    })
}

fn place(name: &'static str) -> (std::rc::Rc<Place>, RunDirectory) {
    let place = Place::of(name, |place| {
        place.put("config.toml", seeds::SETTINGS.as_bytes());
        place.put("scene.ply", seeds::SPLATS_ASCII.as_bytes());
    });
    let run = RunDirectory::open(&place.path("")).expect("it is a run");
    (place, run)
}

pub(crate) fn settings_of_run(bytes: &[u8]) -> String {
    let (place, run) = place("run_settings");
    place.put("config.toml", bytes);
    text_of(run.settings(), |settings| {
        assert!(settings.check().is_ok(), "a run has settings that can be");
        "read".into()
    })
}

/// Returns the progress of a run, as its files show.
fn state(run: &RunDirectory) -> String {
    let requested = run.settings().expect("the seed settings are valid");
    let of = |materials| {
        State::of(
            run.root(),
            &requested,
            &Goal { materials: bool::then_some(materials, StageKind::Intrinsic), ..Goal::default() },
        )
    };
    let measures = Measures::read(run).and_then(|m| serde_json::to_string(&m).ok()).unwrap_or_default();
    format!("{:?} {:?} {measures}", of(false), of(true))
}

pub(crate) fn metrics(bytes: &[u8]) -> String {
    let (place, run) = place("metrics");
    place.put("training.json", br#"{"resumed_from": 0}"#);
    place.put("metrics.json", bytes);
    let mut words = state(&run);
    if let Ok(value) = serde_json::from_slice::<serde_json::Value>(bytes) {
        for split in [&value, &value["test"]] {
            words += &format!("{} {}", table::views(split).len().min(200), table::relit(split).len().min(200));
        }
    }
    words
}

pub(crate) fn training(bytes: &[u8]) -> String {
    let (place, run) = place("training");
    place.put("training.json", bytes);
    let mut words = state(&run);
    words += &text_of(run.training_summary(), |value| format!("{}", value.is_object()));
    words += &text_of(run.write_summary(StageKind::Intrinsic, &serde_json::json!({"steps": 1})), |()| "added".into());
    words
}

/// Reads the learned cameras of a run and the photographs of its scene with them.
pub(crate) fn cameras(bytes: &[u8]) -> String {
    let place = Place::of("run_cameras", |place| {
        seeds::scene(place);
        place.put("config.toml", seeds::SETTINGS.as_bytes());
    });
    place.put("cameras.json", bytes);
    let run = RunDirectory::open(&place.path("")).expect("it is a run");
    text_of(run.learned_views(), |learned| {
        let learned = learned.expect("the file exists");
        run.write_learned_views(Some(&learned)).expect("cameras are written");
        assert_eq!(run.learned_views().ok(), Some(Some(learned.clone())), "cameras come back");
        let options = SceneOptions { random_points: 100, ..SceneOptions::default() };
        let mut scene = Scene::open(&place.path(""), &options).expect("the seed scene is valid");
        use_learned_views(&mut scene, &learned);
        let image = text_of(scene.load_image(0), |_| "photograph".into());
        let problem = scene.views[0].camera.problem().unwrap_or_default();
        format!("{} views {image} {problem}", learned.views.len().min(3))
    })
}

pub(crate) fn profile(bytes: &[u8]) -> String {
    let Ok(value) = serde_json::from_slice(bytes) else { return "no JSON".into() };
    let (times, total) = chart::times(&value);
    let bars = chart::bars(&times, 12, "ms");
    format!("{} {} {}", times.len().min(4), total.is_finite(), bars.len().min(300))
}

pub(crate) fn log(bytes: &[u8]) -> String {
    let (place, run) = place("run_log");
    place.put("log.jsonl", bytes);
    let curves = chart::log(&String::from_utf8_lossy(bytes));
    assert!(!curves.contains('\u{1b}'), "what files say is escaped");
    let retained =
        |log: Result<std::fs::File, RunError>| text_of(log, |mut f| text_of(writeln!(f, "{{}}"), |()| "kept".into()));
    let words = retained(run.open_log(StageKind::Geometry, 3));
    place.put("log.jsonl", bytes);
    words + &retained(run.open_log(StageKind::Intrinsic, 3)) + &curves.matches("<svg").count().min(5).to_string()
}

/// Parses a memory size of the command line.
pub(crate) fn bytes(bytes: &[u8]) -> String {
    text_of(parse_bytes(&String::from_utf8_lossy(bytes)), |n| {
        assert!((1..=i64::MAX as u64).contains(&n), "sizes are sizes");
        "read".into()
    })
}

/// Responds to requests for the page of a training.
pub(crate) fn request(bytes: &[u8]) -> String {
    let pages = |path: &str, query: &str| {
        (path == "/live").then(|| serve::Content { kind: "text/plain", body: format!("{} bytes", query.len()) })
    };
    let Some(answer) = serve::respond(bytes, pages) else {
        assert_eq!(serve::respond(&bytes[..bytes.len() / 2], pages), None, "half of what is not whole is none");
        return "more".into();
    };
    let text = String::from_utf8(answer).expect("answers are text");
    let (head, body) = text.split_once("\r\n\r\n").expect("answers have an end");
    let length: Option<usize> = head.lines().find_map(|l| l.strip_prefix("Content-Length: ")?.parse().ok());
    assert!(head.starts_with("HTTP/1.1 ") && length.is_some(), "it is an answer");
    assert!(body.is_empty() || length == Some(body.len()), "the length is said");
    let lines = bytes.split(|b| *b == b'\n').map(|line| line.trim_ascii().to_ascii_lowercase());
    let hosts: Vec<_> = lines.filter_map(|l| l.strip_prefix(b"host:").map(|h| h.trim_ascii().to_vec())).collect();
    let ours = hosts.first().is_some_and(|h| h.starts_with(b"127.0.0.1:") || h.starts_with(b"localhost:"));
    assert!(ours || !head.contains("200 OK"), "nobody is answered who asked for another host");
    format!("{} {}", head.lines().next().unwrap_or_default(), body.len().min(30))
}
