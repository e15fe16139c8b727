//! Curves over steps, and bar charts.

use crate::text::{escape, number};
use serde_json::Value;
use std::collections::BTreeMap;

/// Size of a curve, in SVG units.
const SIZE: [f64; 2] = [300.0, 130.0];
/// Margins for labels at the left and at the bottom.
const EDGE: [f64; 2] = [52.0, 16.0];
/// Maximum number of points drawn per curve; a row of pixels shows no more.
const MOST: usize = 600;

/// Draws the curves of a log (`log.jsonl`), one per value that changes.
///
/// Each line is the JSON of one step. Stages (`stage`) are drawn separately, under their names. Lines that are not
/// valid JSON are skipped, such as the last line of a killed run.
pub fn log(text: &str) -> String {
    let mut stages: BTreeMap<String, BTreeMap<String, Vec<[f64; 2]>>> = BTreeMap::new();
    for line in text.lines() {
        let Ok(Value::Object(line)) = serde_json::from_str::<Value>(line) else { continue };
        let Some(step) = line.get("step").and_then(Value::as_f64) else { continue };
        let stage = line.get("stage").and_then(Value::as_str).unwrap_or("geometry");
        let curves = stages.entry(stage.to_owned()).or_default();
        for (name, value) in line.iter().filter(|(name, _)| *name != "step") {
            if let Some(v) = value.as_f64() {
                curves.entry(name.clone()).or_default().push([step, v]);
            }
        }
    }
    let mut out = String::new();
    for (stage, curves) in &stages {
        // Constant values carry no information, e.g. losses that a run does not use.
        let moving = curves.iter().filter(|(_, points)| points.iter().any(|p| p[1] != points[0][1]));
        let drawn: String = moving.map(|(name, points)| curve(name, points)).collect();
        if !drawn.is_empty() {
            out.push_str(&format!("<h3>{}</h3>\n<div class=\"grid\">\n{drawn}</div>\n", escape(stage)));
        }
    }
    out
}

/// Draws one curve: the values and their moving average.
fn curve(name: &str, points: &[[f64; 2]]) -> String {
    let bounds =
        |k: usize| points.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |b, p| [b[0].min(p[k]), b[1].max(p[k])]);
    let ([x0, x1], [y0, y1]) = (bounds(0), bounds(1));
    let [w, h] = SIZE;
    let at = |p: &[f64; 2]| {
        let x = EDGE[0] + (p[0] - x0) / (x1 - x0).max(1e-30) * (w - EDGE[0] - 6.0);
        let y = 6.0 + (y1 - p[1]) / (y1 - y0).max(1e-30) * (h - EDGE[1] - 12.0);
        format!("{x:.1},{y:.1} ")
    };
    let every = points.len().div_ceil(MOST).max(1);
    let raw: String = points.iter().step_by(every).map(at).collect();
    let mean: String = smooth(points).iter().step_by(every).map(at).collect();
    let last = points.last().map_or(0.0, |p| p[1]);
    let label = |x: f64, y: f64, anchor: &str, v: f64| {
        format!("<text x=\"{x}\" y=\"{y}\" text-anchor=\"{anchor}\">{}</text>", number(v))
    };
    let (left, bottom) = (EDGE[0], h - EDGE[1]);
    format!(
        "<figure><svg viewBox=\"0 0 {w} {h}\" role=\"img\" aria-label=\"{name} over steps\">\
         <path class=\"axis\" d=\"M{left} 4V{bottom}H{w}\"/><polyline class=\"raw\" points=\"{raw}\"/>\
         <polyline class=\"mean\" points=\"{mean}\"/>{}{}{}{}</svg><figcaption>{name} <small>{} at the end</small>\
         </figcaption></figure>\n",
        label(left - 4.0, 12.0, "end", y1),
        label(left - 4.0, bottom - 1.0, "end", y0),
        label(left, h - 4.0, "start", x0),
        label(w - 4.0, h - 4.0, "end", x1),
        number(last),
        name = escape(&name.replace('_', " ")),
    )
}

/// Returns the moving average; its window narrows at both ends.
fn smooth(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let half = points.len() / 24;
    let mean = |i: usize| {
        let reach = half.min(i).min(points.len() - 1 - i);
        let window = &points[i - reach..=i + reach];
        [points[i][0], window.iter().map(|p| p[1]).sum::<f64>() / window.len() as f64]
    };
    (0..points.len()).map(mean).collect()
}

/// Draws bars with names and values in `unit`, the largest first.
///
/// Values beyond the first `most` are summed.
pub fn bars(values: &[(String, f64)], most: usize, unit: &str) -> String {
    let mut sorted: Vec<&(String, f64)> = values.iter().filter(|(_, v)| v.is_finite()).collect();
    sorted.sort_by(|a, b| b.1.total_cmp(&a.1));
    let total: f64 = sorted.iter().map(|(_, v)| v).sum();
    let rest: f64 = sorted.iter().skip(most).map(|(_, v)| v).sum();
    let mut rows: Vec<(String, f64)> = sorted.iter().take(most).map(|r| (*r).clone()).collect();
    if sorted.len() > most {
        rows.push((format!("{} others", sorted.len() - most), rest));
    }
    let widest = rows.iter().map(|(_, v)| *v).fold(1e-30, f64::max);
    let row = |(name, v): &(String, f64)| {
        format!(
            "<span>{}</span><i style=\"width:{:.2}%\"></i><span>{} {} <small>{:.1} %</small></span>\n",
            escape(name),
            100.0 * v.max(0.0) / widest,
            number(*v),
            escape(unit),
            100.0 * v / total.max(1e-30)
        )
    };
    if rows.is_empty() {
        String::new()
    } else {
        format!("<div class=\"bars\">\n{}</div>\n", rows.iter().map(row).collect::<String>())
    }
}

/// Sums the times of a Chrome trace (`profile.json`) by pass name.
///
/// Returns the times in milliseconds and their total.
pub fn times(trace: &Value) -> (Vec<(String, f64)>, f64) {
    let mut sums: BTreeMap<&str, f64> = BTreeMap::new();
    for event in trace["traceEvents"].as_array().into_iter().flatten() {
        if let (Some("X"), Some(name), Some(us)) = (event["ph"].as_str(), event["name"].as_str(), event["dur"].as_f64())
        {
            *sums.entry(name).or_default() += us / 1e3;
        }
    }
    let total = sums.values().sum();
    (sums.into_iter().map(|(name, v)| (name.to_owned(), v)).collect(), total)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn log_draws_changing_values_by_stage() {
        let text = "{\"step\":1,\"loss\":0.5,\"skipped\":0}\n{\"step\":2,\"loss\":0.25,\"skipped\":0}\n\
                    {\"stage\":\"intrinsic\",\"step\":1,\"<albedo>\":3}\n{\"stage\":\"intrinsic\",\"step\":9,\"<albedo>\":4,\"x\":null}\n{\"st";
        let html = log(text);
        assert_eq!(html.matches("<svg").count(), 2, "{html}");
        assert!(
            html.contains("<h3>geometry</h3>")
                && html.contains("<h3>intrinsic</h3>")
                && html.contains("0.25 at the end")
        );
        assert!(html.contains("&lt;albedo&gt;") && !html.contains("skipped") && !html.contains("NaN"));
        // From the upper left to the lower right.
        assert!(html.contains("points=\"52.0,6.0 294.0,108.0 \""), "{html}");
        assert_eq!(log(""), "");
    }

    #[test]
    fn smooth_is_a_moving_average() {
        let points: Vec<[f64; 2]> = (0..48).map(|i| [i as f64, if i % 2 == 0 { 0.0 } else { 1.0 }]).collect();
        let mean = smooth(&points);
        assert_eq!((mean[0][1], mean[47][1]), (0.0, 1.0));
        assert!((2..46).all(|i| (mean[i][1] - 0.5).abs() < 0.11));
    }

    #[test]
    fn bars_are_sorted_and_the_rest_is_summed() {
        let values: Vec<(String, f64)> = (1..=5).map(|i| (format!("p{i}"), f64::from(i))).collect();
        let html = bars(&values, 3, "ms");
        let at = |t: &str| html.find(t).unwrap_or_else(|| panic!("{t}: {html}"));
        assert!(at(">p5<") < at(">p4<") && at(">p3<") < at(">2 others<") && !html.contains(">p2<"));
        assert!(html.contains("33.3 %") && html.contains("20.0 %"), "{html}");
        assert_eq!(bars(&[], 3, "ms"), "");
    }

    #[test]
    fn times_sum_passes_of_equal_name() {
        let event = |name: &str, us: f64| json!({"ph": "X", "name": name, "dur": us});
        let trace = json!({"traceEvents": [{"ph": "M", "name": "process_name"}, event("a", 1500.0), event("b", 10.0), event("a", 500.0)]});
        assert_eq!(times(&trace), (vec![("a".into(), 2.0), ("b".into(), 0.01)], 2.01));
        assert_eq!(times(&json!(7)).1, 0.0);
    }
}
