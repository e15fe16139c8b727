//! Reading of JSON files with errors that name the file and line.

use std::path::Path;

use serde::de::DeserializeOwned;

use crate::error::{Result, SceneError, io_error};

/// Reads a JSON file into `T`. Skips a byte-order mark.
///
/// # Errors
/// If the file cannot be read or does not hold a `T`.
pub fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T> {
    let text = std::fs::read_to_string(path).map_err(io_error("read", path))?;
    let text = text.strip_prefix('\u{feff}').unwrap_or(&text);
    serde_json::from_str(text).map_err(|error| {
        // The parser repeats the location at the end of its message.
        let message = error.to_string();
        let problem = message.rsplit_once(" at line ").map_or(message.as_str(), |(problem, _)| problem);
        SceneError::Json {
            path: path.to_path_buf(),
            line: error.line(),
            column: error.column(),
            problem: format!("{problem}; correct the file"),
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_name_the_file_line_and_column() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.json");
        let fail = |text: &str| {
            std::fs::write(&path, text).unwrap();
            let error = read_json::<Vec<f64>>(&path).unwrap_err().to_string();
            error.strip_prefix(&path.display().to_string()).unwrap().to_string()
        };
        assert_eq!(fail("[1,\n 2"), ", line 2, column 2: EOF while parsing a list; correct the file");
        assert_eq!(fail("[1,\nNaN]"), ", line 2, column 1: expected value; correct the file");
        assert_eq!(fail("[\"a\"]"), ", line 1, column 4: invalid type: string \"a\", expected f64; correct the file");
        assert!(fail("[1e999]").contains("number out of range"));
        assert!(fail(&"[".repeat(100_000)).contains("line 1"));
        std::fs::write(&path, "\u{feff}[1]").unwrap();
        assert_eq!(read_json::<Vec<f64>>(&path).unwrap(), [1.0]);
        std::fs::write(&path, b"\xff\xfe").unwrap();
        let error = read_json::<Vec<f64>>(&path).unwrap_err().to_string();
        assert!(error.starts_with("cannot read "), "{error}");
    }
}
