//! Tables of metrics, from the JSON that `metrics.json` holds.
//!
//! Whatever numbers there are become columns, by their path; a measure that is new needs nothing here.

use crate::text::{escape, number};
use serde_json::Value;
use std::collections::BTreeSet;

/// Columns that come first, in this order.
const FIRST: [&str; 4] = ["nvs psnr", "nvs ssim", "nvs flip", "nvs lpips"];

/// A table of the views of a split, and their means below; without numbers it is empty. `relit` has tables of its own
/// ([`relit`]).
pub fn views(split: &Value) -> String {
    let empty = Vec::new();
    let all = split["views"].as_array().unwrap_or(&empty);
    let mut rows: Vec<(String, Vec<(String, f64)>)> = all.iter().map(|v| (name_of(v), numbers(v))).collect();
    rows.push(("mean".into(), numbers(&split["mean"])));
    table("view", &rows)
}

/// A table of the sets under other lights: means over the views, then the mean over the sets; below it, why other sets have no
/// numbers.
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

/// Names and what they say, one a row.
pub fn facts(rows: &[(String, String)]) -> String {
    let row =
        |(name, value): &(String, String)| format!("<tr><th>{}</th><td>{}</td></tr>\n", escape(name), escape(value));
    format!("<div class=\"wide\"><table class=\"facts\">\n{}</table></div>\n", rows.iter().map(row).collect::<String>())
}

fn name_of(view: &Value) -> String {
    view["name"].as_str().unwrap_or("?").to_owned()
}

/// Numbers by path, words apart by a space.
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
    for c in &columns {
        out.push_str(&format!("<th>{}</th>", escape(&c.replace('_', " "))));
    }
    out.push_str("</tr></thead>\n<tbody>\n");
    for (name, values) in rows {
        let class = if name == "mean" { " class=\"mean\"" } else { "" };
        out.push_str(&format!("<tr{class}><th>{}</th>", escape(name)));
        for c in &columns {
            let value = values.iter().find(|(k, _)| k == c).map_or("–".to_owned(), |(_, v)| number(*v));
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
    fn whatever_is_measured_is_a_column() {
        let split = json!({
            "mean": {"nvs": {"psnr": 30.123, "ssim": 0.9}, "albedo": {"psnr": 20.0}, "relit": {"night": {"psnr": 11.5}}},
            "views": [{"name": "<a>", "nvs": {"psnr": 30.123, "ssim": 0.9}}],
        });
        let html = views(&split);
        let at = |text: &str| html.find(text).unwrap_or_else(|| panic!("{text} is missing: {html}"));
        assert!(
            at("<th>nvs psnr</th>") < at("<th>nvs ssim</th>") && at("<th>nvs ssim</th>") < at("<th>albedo psnr</th>")
        );
        assert!(
            at("&lt;a&gt;") < at("class=\"mean\"") && html.contains("<td>30.12</td>") && html.contains("<td>–</td>")
        );
        assert!(!html.contains("night") && relit(&split).contains("<th>night</th><td>11.5</td>"));
        assert_eq!((views(&json!({})), relit(&json!(3))), (String::new(), String::new()));
    }

    #[test]
    fn relit_sets_without_numbers_have_a_reason() {
        let set = |psnr: f64| json!({"psnr": psnr});
        let sets = json!({"mean": set(20.0), "night": set(20.0), "<city>": {"reason": "No light & no edit."}});
        let html = relit(&json!({"mean": {"relit": sets}}));
        let at = |text: &str| html.find(text).unwrap_or_else(|| panic!("{text} is missing: {html}"));
        assert!(at("<th>night</th>") < at("class=\"mean\""));
        assert!(at("class=\"mean\"") < at("<li>&lt;city&gt;: No light &amp; no edit.</li>"));
        let alone = relit(&json!({"mean": {"relit": {"city": {"reason": "No light."}}}}));
        assert!(!alone.contains("<table>") && alone.contains("<li>city: No light.</li>"), "{alone}");
    }
}
