//! Header of a PLY file.

use std::collections::HashSet;
use std::io::BufRead;
use std::path::Path;

use crate::error::{Result, SceneError, io_error};

/// Largest accepted header in bytes. The header of a splat file with 512 semantic channels has less than 20 kB.
const MAX_HEADER: u64 = 1 << 20;

/// Encoding of the values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Format {
    Ascii,
    Little,
    Big,
}

/// Type of a property.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    pub(crate) fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

/// Property of the vertices.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Property {
    pub(crate) name: String,
    pub(crate) scalar: Scalar,
}

/// Header data about the vertices.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Header {
    pub(crate) format: Format,
    /// Number of vertices.
    pub(crate) count: u64,
    pub(crate) properties: Vec<Property>,
    /// Bytes before the vertices: the header and preceding binary elements.
    pub(crate) skip_bytes: u64,
    /// Lines before the vertices: the header and preceding ASCII elements.
    pub(crate) skip_lines: u64,
    /// Offset of the end of the header in bytes.
    pub(crate) end: u64,
    /// Texts of the comments.
    pub(crate) comments: Vec<String>,
}

#[derive(Default)]
struct Element {
    name: String,
    count: u64,
    properties: Vec<Property>,
    names: HashSet<String>,
    list: Option<String>,
}

/// Reads the header up to and including the line `end_header`.
pub(crate) fn read(path: &Path, reader: &mut impl BufRead) -> Result<Header> {
    let mut format = None;
    let mut elements: Vec<Element> = Vec::new();
    let mut end = 0;
    let mut line_number = 0_u64;
    let mut raw = Vec::new();
    let mut comments = Vec::new();
    loop {
        raw.clear();
        let mut limited = std::io::Read::take(&mut *reader, MAX_HEADER - end.min(MAX_HEADER));
        end += limited.read_until(b'\n', &mut raw).map_err(io_error("read", path))? as u64;
        line_number += 1;
        let place = format!("line {line_number}");
        let fail = |problem: String| SceneError::points(path, place.clone(), problem);
        if line_number == 1 && raw.trim_ascii_end() != b"ply" {
            return Err(SceneError::points(path, "", "the file does not begin with \"ply\"; it is not a PLY file"));
        }
        if raw.last() != Some(&b'\n') {
            return Err(fail("the header ends before \"end_header\"; the file is truncated or damaged".into()));
        }
        let Ok(line) = std::str::from_utf8(&raw) else {
            return Err(fail("the header holds bytes that are not text; the file is damaged".into()));
        };
        let words: Vec<&str> = line.split_whitespace().collect();
        match words[..] {
            ["format", name, _version] => {
                format = Some(match name {
                    "ascii" => Format::Ascii,
                    "binary_little_endian" => Format::Little,
                    "binary_big_endian" => Format::Big,
                    _ => {
                        return Err(fail(format!("the format \"{name}\" is none of PLY's; export the file again")));
                    }
                });
            }
            ["element", name, count] => {
                let count = count.parse().map_err(|_| fail(format!("\"{count}\" is not a number of elements")))?;
                elements.push(Element { name: name.into(), count, ..Element::default() });
            }
            ["property", "list", _, _, name] => {
                let element = elements.last_mut().ok_or_else(|| fail("a property stands before any element".into()))?;
                element.list = Some(name.into());
            }
            ["property", kind, name] => {
                let element = elements.last_mut().ok_or_else(|| fail("a property stands before any element".into()))?;
                let scalar = Scalar::parse(kind)
                    .ok_or_else(|| fail(format!("the property \"{name}\" has the unknown type \"{kind}\"")))?;
                if !element.names.insert(name.into()) {
                    return Err(fail(format!("the property \"{name}\" is declared twice")));
                }
                element.properties.push(Property { name: name.into(), scalar });
            }
            ["end_header"] => break,
            ["comment", ref text @ ..] => comments.push(text.join(" ")),
            ["ply"] | ["obj_info", ..] | [] => {}
            _ => {
                return Err(fail(format!("\"{}\" is no line of a PLY header", line.trim())));
            }
        }
    }
    let format = format.ok_or_else(|| {
        SceneError::points(path, "", "the header names no format; the file is damaged or not a PLY file")
    })?;
    Ok(Header { comments, ..resolve(path, format, elements, end, line_number)? })
}

/// Finds the vertex element and the sizes of the elements before it.
fn resolve(path: &Path, format: Format, elements: Vec<Element>, end: u64, lines: u64) -> Result<Header> {
    let fail = |problem: String| SceneError::points(path, "", problem);
    let (mut skip_bytes, mut skip_lines) = (end, lines);
    for element in elements {
        if element.name == "vertex" {
            if let Some(list) = element.list {
                return Err(fail(format!("the vertices have the list property \"{list}\"; export them without it")));
            }
            let Element { count, properties, .. } = element;
            return Ok(Header { format, count, properties, skip_bytes, skip_lines, end, comments: Vec::new() });
        }
        if element.list.is_some() && format != Format::Ascii {
            let problem =
                format!("the element \"{}\" with a list stands before the vertices; put it after", element.name);
            return Err(fail(problem));
        }
        let stride: usize = element.properties.iter().map(|p| p.scalar.size()).sum();
        skip_bytes = skip_bytes.saturating_add(element.count.saturating_mul(stride as u64));
        skip_lines = skip_lines.saturating_add(element.count);
    }
    Err(fail("the header has no element \"vertex\"; the file holds neither points nor splats".into()))
}
