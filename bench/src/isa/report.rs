//! Report of compiled kernels: JSON for programs, a Markdown table for people.

use super::Job;
use super::worker::Gpu;
use anyhow::Context;
use serde::{Deserialize, Serialize, Serializer};
use std::cmp::Reverse;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Kernels of several GPU families.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Families in the requested order.
    pub families: Vec<Family>,
}

/// Kernels of one GPU family.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Family {
    /// Name as in `RADV_FORCE_FAMILY`.
    pub family: String,
    /// Device by the driver.
    pub gpu: Gpu,
    /// Kernels by name, lanes and specialization.
    pub rows: Vec<Row>,
}

/// Compiled kernel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// GPU family; that of the list.
    #[serde(skip)]
    pub family: String,
    /// Lanes of a subgroup.
    pub lanes: u32,
    /// Name of the kernel.
    pub kernel: String,
    /// Bits of the specialization constants by name.
    pub specs: BTreeMap<String, u32>,
    /// Numbers by the driver's names; empty if the kernel did not compile.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty", serialize_with = "plain")]
    pub statistics: BTreeMap<String, f64>,
    /// Reason why there are none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub problem: Option<String>,
}

impl Family {
    /// Names the family in each row.
    fn named(mut self) -> Family {
        self.rows.iter_mut().for_each(|row| row.family.clone_from(&self.family));
        self
    }
}

/// Writes whole numbers as integers.
fn plain<S: Serializer>(numbers: &BTreeMap<String, f64>, s: S) -> Result<S::Ok, S::Error> {
    let whole = |n: f64| n.fract() == 0.0 && n.abs() < 1e15;
    s.collect_map(numbers.iter().map(|(name, n)| {
        let number = if whole(*n) { serde_json::Value::from(*n as i64) } else { serde_json::Value::from(*n) };
        (name, number)
    }))
}

/// Columns of the table: heading and the driver's name.
const COLUMNS: [(&str, &str); 8] = [
    ("VGPRs", "VGPRs"),
    ("SGPRs", "SGPRs"),
    ("spilled VGPRs", "Spilled VGPRs"),
    ("spilled SGPRs", "Spilled SGPRs"),
    ("scratch", "Scratch size"),
    ("LDS", "LDS size"),
    ("code", "Code size"),
    ("waves per SIMD", "Subgroups per SIMD"),
];

impl Row {
    /// Returns the row of a job.
    pub fn new(family: &str, job: &Job, statistics: BTreeMap<String, f64>, problem: Option<String>) -> Row {
        let known = sgs_shaders::ALL.iter().find(|k| k.name == job.kernel);
        let name = |id: u32| {
            let spec = known.and_then(|k| k.specs.iter().find(|s| s.id == id));
            spec.map_or_else(|| id.to_string(), |s| s.name.to_string())
        };
        let specs = job.specs.iter().map(|(id, bits)| (name(*id), *bits)).collect();
        Row { family: family.to_owned(), lanes: job.lanes, kernel: job.kernel.clone(), specs, statistics, problem }
    }

    /// Returns a number by the driver's name, if the driver reports it.
    pub fn number(&self, name: &str) -> Option<f64> {
        self.statistics.get(name).copied()
    }

    /// Returns the number of registers.
    pub fn registers(&self) -> f64 {
        self.number("VGPRs").unwrap_or(0.0)
    }

    /// Returns spilled vector registers, spilled scalar registers, bytes of scratch.
    pub fn spills(&self) -> [f64; 3] {
        ["Spilled VGPRs", "Spilled SGPRs", "Scratch size"].map(|name| self.number(name).unwrap_or(0.0))
    }

    /// Returns the specialization as text.
    pub fn specialization(&self) -> String {
        let specs: Vec<String> = self.specs.iter().map(|(name, bits)| format!("{name}={}", value(*bits))).collect();
        specs.join(" ")
    }

    /// Names the row in sentences.
    pub fn title(&self) -> String {
        format!("{} on {} at {} lanes ({})", self.kernel, self.family, self.lanes, self.specialization())
    }
}

/// Writes a specialization constant. Integers are small, so that larger bits are those of a float.
fn value(bits: u32) -> String {
    match bits {
        u32::MAX => "max".to_owned(),
        0..=0x0fff_ffff => bits.to_string(),
        _ => format!("{:?}", f32::from_bits(bits)),
    }
}

impl Report {
    /// Returns all rows, the worst first.
    ///
    /// Those that did not compile, then by spills, then by vector registers.
    pub fn sorted(&self) -> Vec<&Row> {
        let mut rows: Vec<&Row> = self.families.iter().flat_map(|f| &f.rows).collect();
        // The numbers are whole. The sort is stable, so that equal rows stay in the order of the report.
        rows.sort_by_key(|r| {
            let spills = r.spills().map(|n| Reverse(n as u64));
            (r.problem.is_none(), spills, Reverse(r.registers() as u64))
        });
        rows
    }

    /// Writes the table in Markdown.
    pub fn table(&self) -> String {
        let mut text = String::from("| family | lanes | kernel | specialization |");
        for (heading, _) in COLUMNS {
            let _infallible = write!(text, " {heading} |");
        }
        text.push_str("\n|---|---|---|---|");
        text.push_str(&"---|".repeat(COLUMNS.len()));
        text.push('\n');
        for row in self.sorted() {
            let _infallible =
                write!(text, "| {} | {} | {} | {} |", row.family, row.lanes, row.kernel, row.specialization());
            for (column, (_, name)) in COLUMNS.iter().enumerate() {
                let cell = match (&row.problem, column) {
                    (Some(problem), 0) => problem.clone(),
                    _ => row.number(name).map_or_else(String::new, |n| n.to_string()),
                };
                let _infallible = write!(text, " {cell} |");
            }
            text.push('\n');
        }
        text
    }

    /// Writes the report as JSON, one line per kernel.
    ///
    /// # Errors
    /// If a number is not finite.
    pub fn json(&self) -> anyhow::Result<String> {
        let mut text = String::from("{\"families\": [");
        for (i, f) in self.families.iter().enumerate() {
            let (name, gpu) = (serde_json::to_string(&f.family)?, serde_json::to_string(&f.gpu)?);
            let _infallible = write!(text, "{}\n{{\"family\": {name}, \"gpu\": {gpu}, \"rows\": [", separator(i));
            for (k, row) in f.rows.iter().enumerate() {
                let _infallible = write!(text, "{}\n{}", separator(k), serde_json::to_string(row)?);
            }
            text.push_str("\n]}");
        }
        text.push_str("\n]}\n");
        Ok(text)
    }

    /// Reads a file, or all JSON files of a folder in the order of their names.
    ///
    /// # Errors
    /// If there is no file, or one cannot be read.
    pub fn read(path: &Path) -> anyhow::Result<Report> {
        let mut files: Vec<PathBuf> = vec![path.to_owned()];
        if path.is_dir() {
            let entries = std::fs::read_dir(path).with_context(|| format!("\"{}\"", path.display()))?;
            let all = entries.filter_map(|e| e.ok().map(|e| e.path()));
            files = all.filter(|p| p.extension().is_some_and(|e| e == "json")).collect();
            files.sort();
            anyhow::ensure!(!files.is_empty(), "\"{}\" holds no JSON file; name the stored reports.", path.display());
        }
        let mut report = Report::default();
        for file in files {
            let name = || format!("\"{}\" is no report of engine-bench isa", file.display());
            let text = std::fs::read_to_string(&file).with_context(name)?;
            let one: Report = serde_json::from_str(&text).with_context(name)?;
            report.families.extend(one.families.into_iter().map(Family::named));
        }
        Ok(report)
    }
}

fn separator(index: usize) -> &'static str {
    if index == 0 { "" } else { "," }
}
