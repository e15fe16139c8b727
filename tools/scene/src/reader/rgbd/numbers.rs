//! Text files of numbers: matrices, and lines of a time and values.

use std::path::Path;

use crate::error::{Result, SceneError, io_error};

/// Largest accepted size of a text file in bytes.
const LARGEST: u64 = 64 << 20;

fn read_text(path: &Path) -> Result<String> {
    let length = path.metadata().map_err(io_error("read", path))?.len();
    if length > LARGEST {
        let problem = format!("the file has {length} bytes, more than a list of poses has; it is damaged");
        return Err(SceneError::cameras(path, "", problem));
    }
    let bytes = std::fs::read(path).map_err(io_error("read", path))?;
    let text = String::from_utf8_lossy(&bytes);
    Ok(text.strip_prefix('\u{feff}').unwrap_or(&text).to_owned())
}

/// Reads a matrix of `N` columns and at least `rows` rows, one row a line. Numbers may be infinite or NaN.
pub(super) fn matrix<const N: usize>(path: &Path, rows: usize) -> Result<Vec<Vec<f64>>> {
    let text = read_text(path)?;
    let mut found = Vec::new();
    for (i, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        let row: Option<Vec<f64>> = line.split_ascii_whitespace().map(|word| word.parse().ok()).collect();
        match row {
            Some(row) if row.len() == N => found.push(row),
            _ => {
                let problem = format!("\"{}\" is not {N} numbers; each row of the matrix has {N}", line.trim());
                return Err(SceneError::cameras(path, format!("line {}", i + 1), problem));
            }
        }
    }
    if found.len() < rows || found.len() > N {
        let problem = format!("the matrix has {} rows; it must have {rows}", found.len());
        return Err(SceneError::cameras(path, "", problem));
    }
    Ok(found)
}

/// Line of a list: its time in seconds, the words after it, and its number.
pub(super) struct Timed {
    pub(super) time: f64,
    pub(super) words: Vec<String>,
    pub(super) line: usize,
}

/// Reads a list of TUM: lines of a time and at least `words` words. Lines that start with # are comments.
pub(super) fn timed(path: &Path, words: usize) -> Result<Vec<Timed>> {
    let text = read_text(path)?;
    let mut found = Vec::new();
    for (i, content) in text.lines().enumerate() {
        let content = content.trim();
        if content.is_empty() || content.starts_with('#') {
            continue;
        }
        let mut all = content.split_ascii_whitespace();
        let time = all.next().and_then(|word| word.parse::<f64>().ok()).filter(|time| time.is_finite());
        let rest: Vec<String> = all.map(str::to_owned).collect();
        match time {
            Some(time) if rest.len() >= words => found.push(Timed { time, words: rest, line: i + 1 }),
            _ => {
                let problem = format!("\"{content}\" is not a time and {words} or more values");
                return Err(SceneError::cameras(path, format!("line {}", i + 1), problem));
            }
        }
    }
    Ok(found)
}

/// Returns the index of the line nearest in time, within `tolerance` seconds.
///
/// The lines are in order of time.
pub(super) fn nearest(lines: &[Timed], time: f64, tolerance: f64) -> Option<usize> {
    let after = lines.partition_point(|line| line.time < time);
    let candidates = [after.checked_sub(1), Some(after)].into_iter().flatten().filter(|i| *i < lines.len());
    let away = |i: &usize| (lines[*i].time - time).abs();
    candidates.min_by(|a, b| away(a).total_cmp(&away(b))).filter(|i| away(i) <= tolerance)
}
