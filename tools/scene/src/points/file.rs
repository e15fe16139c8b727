//! Point clouds in PLY files.

use std::io::Write;
use std::path::Path;

use super::PointCloud;
use crate::atomic::atomic_write;
use crate::error::{Result, SceneError};
use crate::ply::{Scalar, VertexTable};

/// Property names that programs use for colors.
const COLOR_NAMES: [[&str; 3]; 3] =
    [["red", "green", "blue"], ["diffuse_red", "diffuse_green", "diffuse_blue"], ["r", "g", "b"]];

impl PointCloud {
    /// Reads a PLY file with `x y z` and optional normals and colors. Normals are `nx ny nz`. Colors are `red green
    /// blue`, the same names with the prefix `diffuse_`, or `r g b`.
    ///
    /// Colors stored as bytes or 16-bit numbers are divided by their maximum. Floats stay unchanged, unless any exceeds
    /// 1: then the range is 0 to 255. All-zero normals count as absent, because many programs write zeros for missing
    /// normals.
    pub fn read_ply(path: &Path) -> Result<Self> {
        let table = VertexTable::open(path)?;
        let mut wanted = table.need(&["x", "y", "z"], "a point cloud")?;
        let color = COLOR_NAMES.iter().find_map(|names| table.find_all(names));
        let normal = table.find_all(&["nx", "ny", "nz"]);
        let maximum = color.as_ref().map(|c| match table.scalar(c[0]) {
            Scalar::U8 | Scalar::I8 => 255.0,
            Scalar::U16 | Scalar::I16 => 65_535.0,
            _ => 1.0,
        });
        wanted.extend(color.iter().flatten());
        wanted.extend(normal.iter().flatten());

        let count = table.len();
        let mut cloud = Self {
            positions: Vec::with_capacity(count),
            colors: maximum.map(|_| Vec::with_capacity(count)),
            normals: normal.as_ref().map(|_| Vec::with_capacity(count)),
        };
        table.read(&wanted, |_, values| {
            let mut triples = values.chunks_exact(3).map(|v| [v[0], v[1], v[2]]);
            cloud.positions.extend(triples.next());
            if let Some(colors) = &mut cloud.colors {
                colors.extend(triples.next());
            }
            if let Some(normals) = &mut cloud.normals {
                normals.extend(triples.next());
            }
            Ok(())
        })?;
        if let (Some(colors), Some(mut maximum)) = (&mut cloud.colors, maximum) {
            if maximum == 1.0 && colors.iter().flatten().any(|&v| v > 1.0) {
                maximum = 255.0;
            }
            colors.iter_mut().flatten().for_each(|v| *v = (*v / maximum).clamp(0.0, 1.0));
        }
        if cloud.normals.as_ref().is_some_and(|n| n.iter().flatten().all(|&v| v == 0.0)) {
            cloud.normals = None;
        }
        Ok(cloud)
    }

    /// Writes a binary PLY file with `x y z` and optional normals and colors. Normals are `nx ny nz`; colors are `red
    /// green blue` as bytes.
    pub fn write_ply(&self, path: &Path) -> Result<()> {
        if let Some(problem) = self.problem() {
            return Err(SceneError::Data { what: "the point cloud", problem });
        }
        let mut header = format!("ply\nformat binary_little_endian 1.0\nelement vertex {}\n", self.len());
        let mut declare = |kind: &str, names: [&str; 3]| {
            names.iter().for_each(|name| header.push_str(&format!("property {kind} {name}\n")));
        };
        declare("float", ["x", "y", "z"]);
        if self.normals.is_some() {
            declare("float", ["nx", "ny", "nz"]);
        }
        if self.colors.is_some() {
            declare("uchar", COLOR_NAMES[0]);
        }
        header.push_str("end_header\n");
        atomic_write(path, |out| {
            out.write_all(header.as_bytes())?;
            for (i, position) in self.positions.iter().enumerate() {
                out.write_all(position.map(f32::to_le_bytes).as_flattened())?;
                if let Some(normals) = &self.normals {
                    out.write_all(normals[i].map(f32::to_le_bytes).as_flattened())?;
                }
                if let Some(colors) = &self.colors {
                    out.write_all(&colors[i].map(|v| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8))?;
                }
            }
            Ok(())
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(content: &str) -> Result<PointCloud> {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.ply");
        std::fs::write(&path, content).unwrap();
        PointCloud::read_ply(&path)
    }

    fn cloud() -> PointCloud {
        PointCloud {
            positions: vec![[1.0, -2.0, 3.5], [0.0, 1e-20, -4e9]],
            colors: Some(vec![[0.0, 1.0, 51.0 / 255.0], [1.0, 0.0, 0.0]]),
            normals: Some(vec![[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]),
        }
    }

    #[test]
    fn clouds_round_trip_with_and_without_attributes() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.ply");
        let bare = PointCloud { colors: None, normals: None, ..cloud() };
        for cloud in [cloud(), bare, PointCloud { normals: None, ..cloud() }, PointCloud { colors: None, ..cloud() }] {
            cloud.write_ply(&path).unwrap();
            assert_eq!(PointCloud::read_ply(&path).unwrap(), cloud);
        }
        let broken = PointCloud { colors: Some(vec![]), ..cloud() };
        let error = broken.write_ply(&path).unwrap_err().to_string();
        assert_eq!(error, "the point cloud: 0 colors do not fit 2 positions");
    }

    #[test]
    fn colors_of_all_types_and_names_are_read() {
        let with = |kind: &str, names: [&str; 3], rows: &str| {
            let [r, g, b] = names;
            let text = format!(
                "ply\nformat ascii 1.0\nelement vertex 2\nproperty {kind} {r}\nproperty {kind} {g}\nproperty {kind} {b}\n\
                 property float x\nproperty float y\nproperty float z\nend_header\n{rows}\n"
            );
            read(&text).unwrap().colors.unwrap()
        };
        let expected = vec![[1.0, 0.0, 0.2], [0.0, 0.0, 0.0]];
        assert_eq!(with("uchar", ["red", "green", "blue"], "255 0 51 1 2 3\n0 0 0 1 2 3"), expected);
        assert_eq!(with("ushort", ["r", "g", "b"], "65535 0 13107 1 2 3\n0 0 0 1 2 3"), expected);
        assert_eq!(with("float", ["red", "green", "blue"], "1 0 0.2 1 2 3\n0 0 0 1 2 3"), expected);
        let diffuse = ["diffuse_red", "diffuse_green", "diffuse_blue"];
        assert_eq!(with("float", diffuse, "255 0 51 1 2 3\n0 0 0 1 2 3"), expected);
    }

    #[test]
    fn zero_normals_count_as_absent() {
        let text = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
                    property float nx\nproperty float ny\nproperty float nz\nend_header\n1 2 3 0 0 0\n";
        assert_eq!(read(text).unwrap().normals, None);
        assert_eq!(read(&text.replace("3 0 0 0", "3 0 0 9")).unwrap().normals, Some(vec![[0.0, 0.0, 9.0]]));
    }

    #[test]
    fn truncated_files_are_errors() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.ply");
        cloud().write_ply(&path).unwrap();
        let whole = std::fs::read(&path).unwrap();
        for length in 0..whole.len() {
            std::fs::write(&path, &whole[..length]).unwrap();
            assert!(PointCloud::read_ply(&path).is_err(), "{length}");
        }
    }
}
