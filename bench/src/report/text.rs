//! Text form of a report: tables for the terminal.

use super::Report;
use std::fmt::Write;

impl Report {
    /// Returns the report as text.
    pub fn text(&self) -> String {
        let mut out = String::new();
        let d = &self.device;
        let _ = writeln!(
            out,
            "{}: {} ({}), {}, Vulkan {}, subgroups of {}",
            self.command, d.name, d.kind, d.driver, d.api, d.subgroup_size
        );
        let stated = self.settings.iter().filter(|(_, v)| v.as_str() != Some(""));
        let settings: Vec<String> = stated.map(|(k, v)| format!("{k} {}", plain(v))).collect();
        let _ = writeln!(out, "{}; {} repeats after {}", settings.join(", "), self.repeats, self.warmup);
        if let Some(c) = &self.ceiling {
            let measured = c.atomics_per_second > 0.0;
            let atomics = measured.then(|| format!(", {:.2} G atomic additions/s", c.atomics_per_second / 1e9));
            let _ = writeln!(
                out,
                "ceiling: {:.2} GB/s moved by a copy, {:.1} G operations/s in multiply-adds{}",
                c.bytes_per_second / 1e9,
                c.operations_per_second / 1e9,
                atomics.unwrap_or_default()
            );
        }
        let mut plans: Vec<&str> = Vec::new();
        for p in &self.passes {
            if !plans.contains(&p.plan.as_str()) {
                plans.push(&p.plan);
            }
        }
        for plan in plans {
            self.table(&mut out, plan);
        }
        if !self.values.is_empty() {
            let _ = writeln!(out, "\n{:<52} {:>12} {:>10} {:>12}", "measured", "median", "MAD", "least");
        }
        for v in &self.values {
            let name = format!("{}, {}", v.name, v.unit);
            let s = v.value;
            let _ = writeln!(out, "{name:<52} {:>12} {:>10} {:>12}", number(s.median), number(s.mad), number(s.least));
        }
        if !self.facts.is_empty() {
            out.push('\n');
        }
        for f in &self.facts {
            let _ = writeln!(out, "{:<52} {}", f.name, plain(&f.value));
        }
        for c in &self.checks {
            let _ = writeln!(out, "checked: {c}");
        }
        out
    }

    fn table(&self, out: &mut String, plan: &str) {
        let rows: Vec<_> = self.passes.iter().filter(|p| p.plan == plan).collect();
        let all: f64 = rows.iter().map(|p| p.nanoseconds.median).sum();
        let _ = writeln!(
            out,
            "\n{:<34} {:>10} {:>9} {:>9} {:>6} {:>10} {:>9} {:>8} {:>7}",
            plan, "median ms", "MAD", "least", "of all", "MB", "M ops", "ceiling", "bound"
        );
        for p in &rows {
            let ms = p.nanoseconds.scaled(1e-6);
            let or_dash = |v: Option<f64>, digits: usize| v.map_or("-".to_owned(), |v| format!("{v:.digits$}"));
            let _ = writeln!(
                out,
                "{:<34} {:>10.3} {:>9.3} {:>9.3} {:>5.1}% {:>10} {:>9} {:>8} {:>7}",
                p.pass,
                ms.median,
                ms.mad,
                ms.least,
                100.0 * p.nanoseconds.median / all.max(1e-9),
                or_dash(p.bytes.map(|b| b / 1e6), 3),
                or_dash(p.operations.map(|o| o / 1e6), 2),
                p.share.map_or("-".to_owned(), |s| format!("{:.1}%", 100.0 * s)),
                p.bound.as_deref().map_or("-", |b| if b == "memory" { "memory" } else { "arith." }),
            );
        }
        // Fraction of the total: time at the ceiling over measured time, for passes with a cost model.
        let modeled: f64 = rows.iter().filter(|p| p.share.is_some()).map(|p| p.nanoseconds.median).sum();
        let bound: f64 = rows.iter().filter_map(|p| Some(p.share? * p.nanoseconds.median)).sum();
        let _ = writeln!(
            out,
            "{:<34} {:>10.3} {:>9} {:>9.3} {:>6} {:>10.3} {:>9.2} {:>7.1}%",
            "sum",
            all / 1e6,
            "",
            rows.iter().map(|p| p.nanoseconds.least).sum::<f64>() / 1e6,
            "",
            rows.iter().filter_map(|p| p.bytes).sum::<f64>() / 1e6,
            rows.iter().filter_map(|p| p.operations).sum::<f64>() / 1e6,
            100.0 * bound / modeled.max(1e-9),
        );
    }
}

fn plain(value: &serde_json::Value) -> String {
    match value {
        serde_json::Value::String(s) => s.clone(),
        serde_json::Value::Number(n) if n.is_f64() => number(n.as_f64().unwrap_or(f64::NAN)),
        other => other.to_string(),
    }
}

fn number(v: f64) -> String {
    match v.abs() {
        0.0 => "0".to_owned(),
        a if a >= 1000.0 => format!("{v:.0}"),
        a if a >= 10.0 => format!("{v:.2}"),
        a if a >= 0.01 => format!("{v:.4}"),
        _ => format!("{v:.3e}"),
    }
}
