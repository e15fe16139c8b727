//! Reading the vertices of a PLY file.

use std::collections::HashMap;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use super::header::{self, Format, Header, Scalar};
use crate::error::{Result, SceneError, io_error};

/// PLY file with a parsed header. The file is large enough for its number of vertices.
pub(crate) struct VertexTable {
    path: PathBuf,
    header: Header,
    /// Index of each property by name.
    places: HashMap<String, usize>,
    reader: BufReader<File>,
}

impl VertexTable {
    /// Opens a file, reads its header, and checks its size. Fails if the file is too small for its number of vertices.
    pub(crate) fn open(path: &Path) -> Result<Self> {
        let file = File::open(path).map_err(io_error("read", path))?;
        let size = file.metadata().map_err(io_error("read", path))?.len();
        let mut reader = BufReader::with_capacity(1 << 16, file);
        let header = header::read(path, &mut reader)?;
        let places = header.properties.iter().enumerate().map(|(i, p)| (p.name.clone(), i)).collect();
        let table = Self { path: path.to_path_buf(), header, places, reader };
        table.check_size(size)?;
        Ok(table)
    }

    fn check_size(&self, size: u64) -> Result<()> {
        let Header { format, count, properties, skip_bytes, end, .. } = &self.header;
        if properties.is_empty() && *count > 0 {
            return Err(self.fail("", "the vertices have no properties; the file is damaged"));
        }
        let need = match format {
            // Each value needs at least a digit and a separator; the last separator may be missing.
            Format::Ascii => count.saturating_mul(properties.len() as u64 * 2).saturating_add(*end).saturating_sub(1),
            _ => count.saturating_mul(self.stride() as u64).saturating_add(*skip_bytes),
        };
        if size >= need {
            return Ok(());
        }
        let problem = format!(
            "the header promises {count} vertices, which need {need} bytes, but the file has {size}; copy or export it \
             again"
        );
        Err(self.fail("", problem))
    }

    fn stride(&self) -> usize {
        self.header.properties.iter().map(|p| p.scalar.size()).sum()
    }

    /// Returns an error about this file.
    pub(crate) fn fail(&self, place: impl Into<String>, problem: impl Into<String>) -> SceneError {
        SceneError::points(&self.path, place, problem)
    }

    /// Returns the number of vertices. Callers may allocate memory for them, because the file is large enough to hold
    /// them.
    pub(crate) fn len(&self) -> usize {
        self.header.count as usize
    }

    /// Returns the texts of the header's comments.
    pub(crate) fn comments(&self) -> &[String] {
        &self.header.comments
    }

    /// Returns the index of a property.
    pub(crate) fn find(&self, name: &str) -> Option<usize> {
        self.places.get(name).copied()
    }

    /// Returns the indices of all `names`, or `None` if one is missing.
    pub(crate) fn find_all(&self, names: &[&str]) -> Option<Vec<usize>> {
        names.iter().map(|name| self.find(name)).collect()
    }

    /// Returns the indices of all `names`; fails if one is missing.
    pub(crate) fn need(&self, names: &[&str], purpose: &str) -> Result<Vec<usize>> {
        names
            .iter()
            .map(|name| {
                self.find(name).ok_or_else(|| {
                    self.fail("", format!("the vertices have no property \"{name}\", which {purpose} needs"))
                })
            })
            .collect()
    }

    /// Counts the properties named `prefix` plus a number, from 0 without gaps.
    pub(crate) fn count_numbered(&self, prefix: &str) -> usize {
        (0..).take_while(|i| self.find(&format!("{prefix}{i}")).is_some()).count()
    }

    /// Counts the properties whose names begin with `prefix`.
    pub(crate) fn count_prefixed(&self, prefix: &str) -> usize {
        self.header.properties.iter().filter(|p| p.name.starts_with(prefix)).count()
    }

    /// Returns the type of a property.
    pub(crate) fn scalar(&self, property: usize) -> Scalar {
        self.header.properties[property].scalar
    }

    /// Calls `row` with the requested properties of every vertex. Values are finite and in the order of `wanted`. `row`
    /// returns a description of the problem to reject a vertex.
    pub(crate) fn read(
        mut self,
        wanted: &[usize],
        mut row: impl FnMut(usize, &[f32]) -> std::result::Result<(), String>,
    ) -> Result<()> {
        let mut all = vec![0.0_f64; self.header.properties.len()];
        let mut picked = vec![0.0_f32; wanted.len()];
        let count = self.len();
        let mut source = Rows::new(&mut self)?;
        for vertex in 0..count {
            source.next(vertex, &mut all)?;
            for (value, &property) in picked.iter_mut().zip(wanted) {
                // A double may overflow the float, so the check follows the conversion.
                *value = all[property] as f32;
                if !value.is_finite() {
                    let name = &source.header.properties[property].name;
                    let problem = format!(
                        "the property \"{name}\" is {}; remove the vertex or export the file again",
                        all[property]
                    );
                    return Err(source.fail(vertex, problem));
                }
            }
            row(vertex, &picked).map_err(|problem| source.fail(vertex, problem))?;
        }
        Ok(())
    }
}

/// Sequential reader of the table's rows.
struct Rows<'a> {
    path: &'a Path,
    header: &'a Header,
    reader: &'a mut BufReader<File>,
    /// Offset and type of each property in a binary row.
    layout: Vec<(usize, Scalar)>,
    bytes: Vec<u8>,
    line: String,
    line_number: u64,
}

impl<'a> Rows<'a> {
    fn new(table: &'a mut VertexTable) -> Result<Self> {
        let VertexTable { path, header, reader, .. } = table;
        let mut offset = 0;
        let mut layout = Vec::with_capacity(header.properties.len());
        for property in &header.properties {
            layout.push((offset, property.scalar));
            offset += property.scalar.size();
        }
        let mut rows =
            Self { path, header, reader, layout, bytes: vec![0; offset], line: String::new(), line_number: 0 };
        if rows.header.format == Format::Ascii {
            rows.reader.seek(SeekFrom::Start(0)).map_err(io_error("read", rows.path))?;
            for _ in 0..rows.header.skip_lines {
                // The header's lines exist; lines of an element before the vertices may be missing.
                if rows.read_line()? == 0 {
                    return Err(rows.fail(0, "the file ends before it".into()));
                }
            }
        } else {
            rows.reader.seek(SeekFrom::Start(rows.header.skip_bytes)).map_err(io_error("read", rows.path))?;
        }
        Ok(rows)
    }

    fn fail(&self, vertex: usize, problem: String) -> SceneError {
        let place = match self.header.format {
            Format::Ascii => format!("vertex {vertex} (line {})", self.line_number),
            _ => format!("vertex {vertex}"),
        };
        SceneError::points(self.path, place, problem)
    }

    fn read_line(&mut self) -> Result<usize> {
        self.line.clear();
        self.line_number += 1;
        match self.reader.read_line(&mut self.line) {
            Ok(n) => Ok(n),
            Err(e) if e.kind() == io::ErrorKind::InvalidData => {
                let place = format!("line {}", self.line_number);
                Err(SceneError::points(self.path, place, "the line is not text; the file is damaged"))
            }
            Err(e) => Err(io_error("read", self.path)(e)),
        }
    }

    fn next(&mut self, vertex: usize, values: &mut [f64]) -> Result<()> {
        if self.header.format == Format::Ascii { self.next_ascii(vertex, values) } else { self.next_binary(values) }
    }

    fn next_ascii(&mut self, vertex: usize, values: &mut [f64]) -> Result<()> {
        if self.read_line()? == 0 {
            let problem = format!("the file ends before it, though {} vertices are promised", self.header.count);
            return Err(self.fail(vertex, problem));
        }
        let mut words = self.line.split_ascii_whitespace();
        for (value, property) in values.iter_mut().zip(&self.header.properties) {
            let Some(word) = words.next() else {
                let problem = format!("the line has fewer than {} values", self.header.properties.len());
                return Err(self.fail(vertex, problem));
            };
            let Ok(number) = word.parse() else {
                return Err(self.fail(vertex, format!("\"{word}\" for \"{}\" is not a number", property.name)));
            };
            *value = number;
        }
        Ok(())
    }

    fn next_binary(&mut self, values: &mut [f64]) -> Result<()> {
        self.reader.read_exact(&mut self.bytes).map_err(io_error("read", self.path))?;
        let big = self.header.format == Format::Big;
        for (value, &(offset, scalar)) in values.iter_mut().zip(&self.layout) {
            let mut word = [0; 8];
            let size = scalar.size();
            let bytes = &mut word[..size];
            bytes.copy_from_slice(&self.bytes[offset..offset + size]);
            if big {
                bytes.reverse();
            }
            let [a, b, c, d, ..] = word;
            *value = match scalar {
                Scalar::I8 => f64::from(a as i8),
                Scalar::U8 => f64::from(a),
                Scalar::I16 => f64::from(i16::from_le_bytes([a, b])),
                Scalar::U16 => f64::from(u16::from_le_bytes([a, b])),
                Scalar::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
                Scalar::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
                Scalar::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
                Scalar::F64 => f64::from_le_bytes(word),
            };
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn open(content: &[u8]) -> Result<VertexTable> {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.ply");
        std::fs::write(&path, content).unwrap();
        VertexTable::open(&path)
    }

    fn fail(content: &str) -> String {
        open(content.as_bytes()).err().unwrap().to_string()
    }

    /// Reads all rows of the columns `x` and `y`.
    fn rows(content: &[u8]) -> Result<Vec<[f32; 2]>> {
        let table = open(content)?;
        let wanted = table.need(&["y", "x"], "the test")?;
        let mut rows = Vec::new();
        table.read(&wanted, |_, v| {
            rows.push([v[1], v[0]]);
            Ok(())
        })?;
        Ok(rows)
    }

    #[test]
    fn all_types_and_byte_orders_give_the_same_rows() {
        for (big, name) in [(false, "binary_little_endian"), (true, "binary_big_endian")] {
            let header = format!(
                "ply\r\nformat {name} 1.0\ncomment by hand\nelement camera 2\nproperty ushort id\nelement vertex 2\n\
                 property char a\nproperty double x\nproperty uint b\nproperty short y\nproperty uchar c\n\
                 property float d\nproperty int e\nproperty ushort f\nelement face 1\n\
                 property list uchar int vertex_indices\nend_header\n"
            );
            let mut bytes = header.into_bytes();
            let mut put = |mut word: Vec<u8>| {
                if big {
                    word.reverse();
                }
                bytes.extend(word);
            };
            (0..2_u16).for_each(|v| put(v.to_le_bytes().to_vec()));
            for (x, y) in [(1.5_f64, -7_i16), (-1e-3, 300)] {
                put(vec![0x80]);
                put(x.to_le_bytes().to_vec());
                put(9_u32.to_le_bytes().to_vec());
                put(y.to_le_bytes().to_vec());
                put(vec![200]);
                put(0.5_f32.to_le_bytes().to_vec());
                put((-1_i32).to_le_bytes().to_vec());
                put(5_u16.to_le_bytes().to_vec());
            }
            assert_eq!(rows(&bytes).unwrap(), [[1.5, -7.0], [-1e-3, 300.0]]);
        }
        let ascii = "ply\nformat ascii 1.0\nelement camera 1\nproperty list uchar int ids\nelement vertex 2\n\
                     property float x\nproperty int y\nend_header\n2 5 6\n1.5 -7\n-1e-3   300\n3 0 1 2\n";
        assert_eq!(rows(ascii.as_bytes()).unwrap(), [[1.5, -7.0], [-1e-3, 300.0]]);
    }

    #[test]
    fn each_header_error_has_its_message() {
        assert!(fail("solid").contains("does not begin with \"ply\""));
        assert!(fail("").contains("does not begin with \"ply\""));
        assert!(fail("ply\nformat ascii 1.0\n").contains("line 3: the header ends before \"end_header\""));
        assert!(fail("ply\nformat middle_endian 1.0\nend_header\n").contains("line 2: the format \"middle_endian\""));
        assert!(fail("ply\nend_header\n").contains("names no format"));
        assert!(fail("ply\nformat ascii 1.0\nend_header\n").contains("no element \"vertex\""));
        assert!(fail("ply\nelement vertex many\n").contains("line 2: \"many\" is not a number"));
        assert!(fail("ply\nproperty float x\n").contains("line 2: a property stands before any element"));
        assert!(fail("ply\nelement vertex 1\nproperty quad x\n").contains("\"x\" has the unknown type \"quad\""));
        let twice = "ply\nelement vertex 1\nproperty float x\nproperty float x\n";
        assert!(fail(twice).contains("line 4: the property \"x\" is declared twice"));
        assert!(fail("ply\nsurprise\n").contains("\"surprise\" is no line of a PLY header"));
        let list = "ply\nformat ascii 1.0\nelement vertex 1\nproperty list uchar int z\nend_header\n";
        assert!(fail(list).contains("list property \"z\""));
        let before = "ply\nformat binary_little_endian 1.0\nelement face 1\nproperty list uchar int z\nend_header\n";
        assert!(fail(before).contains("\"face\" with a list stands before the vertices"));
        let empty = "ply\nformat ascii 1.0\nelement vertex 1\nend_header\n";
        assert!(fail(empty).contains("no properties"));
        assert!(open(b"ply\n\xff\xfe\n").err().unwrap().to_string().contains("not text"));
    }

    #[test]
    fn excessive_counts_are_rejected_before_allocation() {
        for format in ["ascii", "binary_little_endian"] {
            for count in ["3", "4000000000", "18446744073709551615"] {
                let text = format!(
                    "ply\nformat {format} 1.0\nelement vertex {count}\nproperty float x\nproperty float y\nend_header\n1 2"
                );
                let error = fail(&text);
                assert!(error.contains(&format!("promises {count} vertices")), "{error}");
            }
        }
        let before = "ply\nformat ascii 1.0\nelement camera 18446744073709551615\nproperty float f\nelement vertex 1\n\
                      property float x\nproperty float y\nend_header\n1 2\n";
        assert!(rows(before.as_bytes()).unwrap_err().to_string().contains("vertex 0 (line 10): the file ends"));
    }

    #[test]
    fn each_row_error_has_its_message() {
        let head = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nend_header\n";
        let fail = |body: &str| rows(format!("{head}{body}").as_bytes()).unwrap_err().to_string();
        assert!(fail("1 2\n3          \n").contains("vertex 1 (line 8): the line has fewer than 2 values"));
        assert!(fail("1 2\n3 four\n").contains("vertex 1 (line 8): \"four\" for \"y\" is not a number"));
        assert!(fail("1 nan\n3 4\n").contains("vertex 0 (line 7): the property \"y\" is NaN"));
        assert!(fail("1e99 2\n3 4\n").contains("the property \"x\" is 1000000000"));
        assert!(fail("1 2          \n").contains("vertex 1 (line 8): the file ends before it, though 2 vertices"));
        let missing = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n";
        assert!(rows(missing.as_bytes()).unwrap_err().to_string().contains("no property \"y\", which the test needs"));
    }
}
