//! Tables of metrics, from the JSON in `metrics.json`.
//!
//! Every number becomes a column, named by its path. A new metric requires no change here.

use crate::text::{escape, number};
use serde_json::Value;
use std::collections::BTreeSet;

/// Columns that come first, in this order.
const FIRST: [&str; 6] = ["nvs psnr", "nvs psnr_aligned", "nvs ssim", "nvs ssim_aligned", "nvs flip", "nvs lpips"];

/// Metrics by the last word of their path: name with unit, factor, decimals.
const MEASURES: [(&str, &str, f64, usize); 19] = [
    ("psnr", "PSNR (dB)", 1.0, 2),
    ("psnr_aligned", "PSNR, aligned (dB)", 1.0, 2),
    ("psnr_scaled", "PSNR, scaled (dB)", 1.0, 2),
    ("psnr_scaled_per_view", "PSNR, scaled per view (dB)", 1.0, 2),
    ("psnr_gain", "PSNR, one gain (dB)", 1.0, 2),
    ("psnr_gain_per_view", "PSNR, gain per view (dB)", 1.0, 2),
    ("ssim", "SSIM", 1.0, 3),
    ("ssim_aligned", "SSIM, aligned", 1.0, 3),
    ("flip", "FLIP", 1.0, 3),
    ("lpips", "LPIPS", 1.0, 3),
    ("normal_mae_deg", "Normal error (°)", 1.0, 2),
    ("normal_coverage", "Normal coverage (%)", 100.0, 1),
    ("nvs", "Rendering (frames/s)", 1.0, 1),
    ("pbr", "Shading (frames/s)", 1.0, 1),
    ("depth_rel", "Depth error (%)", 100.0, 2),
    ("sensor_depth_rel", "Sensor depth error (%)", 100.0, 2),
    ("roughness_mse", "Roughness MSE", 1.0, 4),
    ("metallic_mse", "Metallic MSE", 1.0, 4),
    ("accuracy", "Correct labels (%)", 100.0, 1),
];

/// Prefixes of metric names, by the first word of the path.
const GROUPS: [(&str, &str); 5] =
    [("nvs", ""), ("pbr", "Shaded "), ("albedo", "Albedo "), ("semantic", ""), ("fps", "")];

/// Headline metrics, shown as cards if present.
const HEADLINE: [&str; 7] =
    ["nvs psnr", "nvs psnr_aligned", "nvs ssim", "pbr psnr", "albedo psnr", "normal_mae_deg", "semantic accuracy"];

/// Format of a metric.
struct Measure {
    name: String,
    factor: f64,
    decimals: usize,
}

impl Measure {
    /// Returns the format of a path; `largest` sets the decimals of metrics without an entry.
    fn of(path: &str, largest: f64) -> Measure {
        let (group, last) = path.split_once(' ').unwrap_or(("", path));
        let group = GROUPS.iter().find(|(g, _)| *g == group).map(|(_, name)| *name).filter(|_| !group.is_empty());
        let known = MEASURES.iter().find(|(word, ..)| *word == last);
        match (known, group) {
            (Some((_, name, factor, decimals)), group) if group.is_some() || last == path => {
                let name = format!("{}{name}", group.unwrap_or_default());
                Measure { name, factor: *factor, decimals: *decimals }
            }
            _ => {
                let digits = if largest > 0.0 { 3 - largest.log10().floor() as i32 } else { 0 };
                Measure { name: path.replace('_', " "), factor: 1.0, decimals: digits.clamp(0, 6) as usize }
            }
        }
    }

    fn write(&self, value: f64) -> String {
        if value.is_finite() { format!("{:.*}", self.decimals, value * self.factor) } else { number(value) }
    }
}

/// Returns the headline metrics and other facts as cards.
pub fn cards(split: &Value, more: &[(String, String)]) -> String {
    let means = numbers(&split["mean"]);
    let known = HEADLINE.iter().filter_map(|path| means.iter().find(|(p, _)| p == path));
    let of = |(path, v): &(String, f64)| {
        let measure = Measure::of(path, v.abs());
        let value = measure.write(*v);
        (measure.name, value)
    };
    let all: Vec<(String, String)> = known.map(of).chain(more.iter().cloned()).collect();
    let card = |(name, v): &(String, String)| format!("<div><dt>{}</dt><dd>{}</dd></div>\n", escape(name), escape(v));
    if all.is_empty() {
        return String::new();
    }
    format!("<dl class=\"cards\">\n{}</dl>\n", all.iter().map(card).collect::<String>())
}

/// Returns a table of the views of a split, with their means below.
///
/// Empty without numbers. The values of `relit` have their own table ([`relit`]).
pub fn views(split: &Value) -> String {
    let empty = Vec::new();
    let all = split["views"].as_array().unwrap_or(&empty);
    let mut rows: Vec<(String, Vec<(String, f64)>)> = all.iter().map(|v| (name_of(v), numbers(v))).collect();
    rows.push(("mean".into(), numbers(&split["mean"])));
    table("view", &rows)
}

/// Returns a table of the relit sets: means over the views, then the mean over the sets.
///
/// A list below it gives the reasons for sets without numbers.
pub fn relit(split: &Value) -> String {
    let Some(sets) = split["mean"]["relit"].as_object() else { return String::new() };
    let (mean, others): (Vec<_>, Vec<_>) = sets.iter().partition(|(name, _)| *name == "mean");
    let measured = others.iter().filter(|(_, v)| v["reason"].is_null()).chain(&mean);
    let rows: Vec<_> = measured.map(|(name, v)| ((*name).clone(), numbers(v))).collect();
    let reason = |(name, v): &(&String, &Value)| {
        v["reason"].as_str().map(|why| format!("<li>{}: {}</li>\n", escape(name), escape(why)))
    };
    let reasons: String = others.iter().filter_map(reason).collect();
    let reasons = if reasons.is_empty() { reasons } else { format!("<p>Not measured:</p>\n<ul>\n{reasons}</ul>\n") };
    table("lighting", &rows) + &reasons
}

/// Returns a table of names and values, one pair per row.
pub fn facts(rows: &[(String, String)]) -> String {
    let row =
        |(name, value): &(String, String)| format!("<tr><th>{}</th><td>{}</td></tr>\n", escape(name), escape(value));
    format!("<div class=\"wide\"><table class=\"facts\">\n{}</table></div>\n", rows.iter().map(row).collect::<String>())
}

fn name_of(view: &Value) -> String {
    view["name"].as_str().unwrap_or("?").to_owned()
}

/// Returns all numbers by path; spaces separate the words.
fn numbers(value: &Value) -> Vec<(String, f64)> {
    let mut found = Vec::new();
    let mut open = vec![(String::new(), value)];
    while let Some((path, value)) = open.pop() {
        match value {
            Value::Number(n) => found.extend(n.as_f64().map(|v| (path, v))),
            Value::Object(map) => {
                let below = |k: &String| if path.is_empty() { k.clone() } else { format!("{path} {k}") };
                open.extend(map.iter().filter(|(k, _)| *k != "relit").map(|(k, v)| (below(k), v)));
            }
            _ => {}
        }
    }
    found
}

fn table(first: &str, rows: &[(String, Vec<(String, f64)>)]) -> String {
    let columns: BTreeSet<&str> = rows.iter().flat_map(|(_, v)| v).map(|(k, _)| k.as_str()).collect();
    let mut columns: Vec<&str> = columns.into_iter().collect();
    columns.sort_by_key(|c| FIRST.iter().position(|f| f == c).unwrap_or(FIRST.len()));
    if columns.is_empty() {
        return String::new();
    }
    let mut out = format!("<div class=\"wide\"><table>\n<thead><tr><th>{}</th>", escape(first));
    let largest = |c: &str| {
        let values = rows.iter().flat_map(|(_, v)| v).filter(|(k, _)| k == c);
        values.fold(0.0, |m: f64, (_, v)| m.max(v.abs()))
    };
    let measures: Vec<Measure> = columns.iter().map(|c| Measure::of(c, largest(c))).collect();
    for m in &measures {
        out.push_str(&format!("<th>{}</th>", escape(&m.name)));
    }
    out.push_str("</tr></thead>\n<tbody>\n");
    for (name, values) in rows {
        let class = if name == "mean" { " class=\"mean\"" } else { "" };
        out.push_str(&format!("<tr{class}><th>{}</th>", escape(name)));
        for (c, m) in columns.iter().zip(&measures) {
            let value = values.iter().find(|(k, _)| k == c).map_or("–".to_owned(), |(_, v)| m.write(*v));
            out.push_str(&format!("<td>{value}</td>"));
        }
        out.push_str("</tr>\n");
    }
    out.push_str("</tbody></table></div>\n");
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn each_metric_has_a_column() {
        let split = json!({
            "mean": {"nvs": {"psnr": 30.123, "ssim": 0.9}, "albedo": {"psnr": 20.0}, "relit": {"night": {"psnr": 11.5}}},
            "views": [{"name": "<a>", "nvs": {"psnr": 30.123, "ssim": 0.9}}],
        });
        let html = views(&split);
        let at = |text: &str| html.find(text).unwrap_or_else(|| panic!("{text} is missing: {html}"));
        assert!(
            at("<th>PSNR (dB)</th>") < at("<th>SSIM</th>") && at("<th>SSIM</th>") < at("<th>Albedo PSNR (dB)</th>")
        );
        assert!(at("&lt;a&gt;") < at("class=\"mean\"") && html.contains("<td>–</td>"));
        assert!(!html.contains("night") && relit(&split).contains("<th>night</th><td>11.50</td>"));
        assert_eq!((views(&json!({})), relit(&json!(3))), (String::new(), String::new()));
    }

    #[test]
    fn aligned_measures_stand_beside_the_others() {
        let nvs = |psnr: f64| json!({"psnr": psnr, "psnr_aligned": psnr + 5.0, "ssim": 0.9, "ssim_aligned": 0.95});
        let split = json!({"mean": {"nvs": nvs(27.0)}, "views": [{"name": "a", "nvs": nvs(26.5)}]});
        let html = views(&split);
        let heads = "<th>PSNR (dB)</th><th>PSNR, aligned (dB)</th><th>SSIM</th><th>SSIM, aligned</th></tr>";
        assert!(html.contains(heads), "{html}");
        for psnr in ["<td>27.00</td><td>32.00</td>", "<td>26.50</td><td>31.50</td>"] {
            assert!(html.contains(&format!("{psnr}<td>0.900</td><td>0.950</td>")), "{psnr}: {html}");
        }
        assert!(cards(&split, &[]).contains("<dt>PSNR, aligned (dB)</dt><dd>32.00</dd>"));
        let unaligned = json!({"mean": {"nvs": {"psnr": 27.0}}, "views": []});
        assert!(!(views(&unaligned) + &cards(&unaligned, &[])).contains("aligned"));
    }

    #[test]
    fn unmeasured_relit_sets_show_their_reason() {
        let set = |psnr: f64| json!({"psnr": psnr});
        let sets = json!({"mean": set(20.0), "night": set(20.0), "<city>": {"reason": "No light & no edit."}});
        let html = relit(&json!({"mean": {"relit": sets}}));
        let at = |text: &str| html.find(text).unwrap_or_else(|| panic!("{text} is missing: {html}"));
        assert!(at("<th>night</th>") < at("class=\"mean\""));
        assert!(at("class=\"mean\"") < at("<li>&lt;city&gt;: No light &amp; no edit.</li>"));
        let alone = relit(&json!({"mean": {"relit": {"city": {"reason": "No light."}}}}));
        assert!(!alone.contains("<table>") && alone.contains("<li>city: No light.</li>"), "{alone}");
    }

    #[test]
    fn metrics_have_fixed_decimals_and_units() {
        let split = json!({
            "mean": {"nvs": {"psnr": 30.1, "ssim": 0.9}, "fps": {"nvs": 47.58}, "depth_rel": 0.0344, "other_thing": 0.5},
            "views": [
                {"name": "a", "nvs": {"psnr": 30.0, "ssim": 0.90049}, "depth_rel": 0.1, "other_thing": 12.0},
                {"name": "b", "nvs": {"psnr": 30.2, "ssim": 0.9}, "depth_rel": 0.01, "other_thing": null},
            ],
        });
        let html = views(&split);
        for text in
            ["<td>30.00</td>", "<td>30.20</td>", "<td>0.900</td>", "<td>3.44</td>", "<td>10.00</td>", "<td>12.00</td>"]
        {
            assert!(html.contains(text), "{text}: {html}");
        }
        assert!(html.contains("<th>Rendering (frames/s)</th>") && html.contains("<td>47.6</td>"), "{html}");
        assert!(html.contains("<th>Depth error (%)</th>") && html.contains("<th>other thing</th>"), "{html}");
        let html = cards(&split, &[("Gaussians".into(), "5000".into())]);
        assert!(html.contains("<dt>PSNR (dB)</dt><dd>30.10</dd>") && html.contains("<dd>5000</dd>"), "{html}");
        assert!(!html.contains("Depth error"));
        assert_eq!(cards(&json!({}), &[]), "");
    }
}
