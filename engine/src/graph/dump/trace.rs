//! Measured times of replays as a Chrome trace (`chrome://tracing`, Perfetto): one process per plan, one row per
//! concurrent pass.

use crate::graph::dump::PassTime;
use serde_json::{Value, json};

/// One replay of one plan.
#[derive(Clone, Copy, Debug)]
pub struct Track<'t> {
    /// Name of the process.
    pub name: &'t str,
    /// Result of [`Executor::take_times`](crate::exec::Executor::take_times).
    pub times: &'t [PassTime],
    /// Index of the replay in `times`.
    pub replay: usize,
}

/// Returns the tracks as a trace file, each starting at time 0. Passes without times are omitted.
pub fn trace(tracks: &[Track<'_>]) -> String {
    let events: Vec<Value> = tracks.iter().enumerate().flat_map(|(process, track)| events(process, track)).collect();
    json!({ "displayTimeUnit": "ns", "traceEvents": events }).to_string()
}

fn events(process: usize, track: &Track<'_>) -> Vec<Value> {
    let name = json!({ "name": track.name });
    let mut all = vec![json!({ "name": "process_name", "ph": "M", "pid": process, "tid": 0, "args": name })];
    let mut spans: Vec<(f64, f64, &str)> = track
        .times
        .iter()
        .filter_map(|t| Some((*t.start.get(track.replay)?, *t.nanoseconds.get(track.replay)?, t.name.as_str())))
        .collect();
    spans.sort_by(|a, b| a.0.total_cmp(&b.0));
    // End time of each row; events of a row must not overlap.
    let mut rows: Vec<f64> = Vec::new();
    for (start, nanoseconds, name) in spans {
        let row = rows.iter().position(|&end| end <= start).unwrap_or_else(|| {
            rows.push(0.0);
            rows.len() - 1
        });
        rows[row] = start + nanoseconds;
        all.push(json!({
            "name": name, "ph": "X", "pid": process, "tid": row, "ts": start / 1e3, "dur": nanoseconds / 1e3,
        }));
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn concurrent_passes_get_separate_rows() {
        let time = |name: &str, start: f64, nanoseconds: f64| PassTime {
            name: name.into(),
            start: vec![start],
            nanoseconds: vec![nanoseconds],
        };
        let times = [time("b", 10.0, 10.0), time("a", 0.0, 10.0), time("c", 15.0, 10.0)];
        let text = trace(&[Track { name: "step \"1\"", times: &times, replay: 0 }]);
        let value: Value = serde_json::from_str(&text).unwrap();
        let rows: Vec<_> = value["traceEvents"]
            .as_array()
            .unwrap()
            .iter()
            .filter(|e| e["ph"] == "X")
            .map(|e| (e["name"].as_str().unwrap().to_owned(), e["tid"].as_u64().unwrap()))
            .collect();
        assert_eq!(rows, [("a".into(), 0), ("b".into(), 0), ("c".into(), 1)]);
        // An unmeasured replay leaves only the process name.
        let other: Value = serde_json::from_str(&trace(&[Track { name: "x", times: &times, replay: 1 }])).unwrap();
        assert_eq!(other["traceEvents"].as_array().unwrap().len(), 1);
    }
}
