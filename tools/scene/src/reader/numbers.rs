//! Text files with a count and then three rows of three numbers per camera. FIPT writes `cam.txt` and `K_list.txt` in
//! this format.

use std::path::Path;

use crate::error::{Result, SceneError, io_error};

/// Three rows of three numbers, with the line number of the first row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Block {
    pub(super) rows: [[f64; 3]; 3],
    pub(super) line: usize,
}

/// Reads the blocks of a file. Skips a byte-order mark, empty lines and white space around numbers.
pub(super) fn read(path: &Path) -> Result<Vec<Block>> {
    let bytes = std::fs::read(path).map_err(io_error("read", path))?;
    let text = String::from_utf8_lossy(&bytes);
    let text = text.strip_prefix('\u{feff}').unwrap_or(&text);
    let fail = |line: usize, problem: String| Err(SceneError::cameras(path, format!("line {line}"), problem));
    let mut lines = text.lines().enumerate().map(|(i, l)| (i + 1, l.trim())).filter(|(_, l)| !l.is_empty());
    let Some((first, count)) = lines.next() else {
        return Err(SceneError::cameras(path, "", "the file is empty; it must begin with the number of cameras"));
    };
    let Ok(count) = count.parse::<usize>() else {
        return fail(first, format!("\"{count}\" is no number of cameras; the file must begin with it"));
    };
    let mut rows: Vec<([f64; 3], usize)> = Vec::new();
    for (line, text) in lines {
        let numbers: Vec<f64> = text.split_ascii_whitespace().map_while(|word| word.parse().ok()).collect();
        match numbers[..] {
            [x, y, z] if text.split_ascii_whitespace().count() == 3 => rows.push(([x, y, z], line)),
            _ => return fail(line, format!("\"{text}\" is not three numbers; each camera has three rows of three")),
        }
    }
    if rows.len() != count.saturating_mul(3) {
        let problem = format!("{count} cameras are promised, but there are {} rows; each has three", rows.len());
        return Err(SceneError::cameras(path, "", problem));
    }
    if count == 0 {
        return Err(SceneError::cameras(path, "", "the file holds no cameras; there must be at least one"));
    }
    let block = |b: &[([f64; 3], usize)]| Block { rows: [b[0].0, b[1].0, b[2].0], line: b[0].1 };
    Ok(rows.chunks_exact(3).map(block).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Vec<Block>, String> {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("cam.txt");
        std::fs::write(&path, text).unwrap();
        read(&path).map_err(|e| e.to_string().rsplit('/').next().unwrap().to_string())
    }

    #[test]
    fn byte_order_mark_and_white_space_are_skipped() {
        let text = "\u{feff}  2 \r\n\r\n 1 2\t3\r\n4 5 6 \n7 8 9\n\n  -1e1 0 0\n0 1 0\n0 0 1\n\n";
        let blocks = parse(text).unwrap();
        assert_eq!(blocks[0], Block { rows: [[1., 2., 3.], [4., 5., 6.], [7., 8., 9.]], line: 3 });
        assert_eq!((blocks[1].rows[0], blocks[1].line, blocks.len()), ([-10., 0., 0.], 7, 2));
    }

    #[test]
    fn each_error_has_its_message() {
        let fail = |text: &str| parse(text).unwrap_err();
        assert!(fail(" \n").starts_with("cam.txt: the file is empty"));
        assert!(fail("one\n").starts_with("cam.txt, line 1: \"one\" is no number of cameras"));
        assert!(fail("0\n").contains("holds no cameras"));
        assert!(fail("1\n1 2 3\n4 5 6\n").contains("1 cameras are promised, but there are 2 rows"));
        assert!(fail("1\n1 2 3\n4 5\n7 8 9").starts_with("cam.txt, line 3: \"4 5\" is not three numbers"));
        assert!(fail("1\n1 2 3 4\n").contains("line 2: \"1 2 3 4\""));
        assert!(fail("1\n1 2 x\n").contains("line 2: \"1 2 x\""));
    }
}
