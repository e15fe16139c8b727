//! Kind of a file with splats.

use crate::dot_splat::read_splat;
use crate::error::{Result, io_error};
use crate::ksplat::{is_ksplat, read_ksplat};
use crate::sog::{is_sog_meta, read_sog};
use crate::splats::{SplatFile, Splats};
use crate::spz::read_spz;
use std::io::Read;
use std::path::Path;

/// Kind of a file with splats.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SplatKind {
    /// PLY of any dialect.
    Ply,
    /// glTF, text or binary.
    Gltf,
    /// SPZ.
    Spz,
    /// `.splat`.
    Splat,
    /// `.ksplat`.
    Ksplat,
    /// SOG: an archive, or the `meta.json` of a directory.
    Sog,
}

impl SplatKind {
    /// Detects the kind from the content. Files without a mark of their own are known by the names `.splat` and `.ksplat`.
    ///
    /// # Errors
    /// Fails if the file cannot be read.
    pub fn of(path: &Path) -> Result<SplatKind> {
        let mut first = Vec::new();
        let file = std::fs::File::open(path).map_err(io_error("read", path))?;
        file.take(16).read_to_end(&mut first).map_err(io_error("read", path))?;
        let named = |end: &str| path.extension().is_some_and(|e| e.eq_ignore_ascii_case(end));
        Ok(match &first[..] {
            [b'g', b'l', b'T', b'F', ..] => SplatKind::Gltf,
            [b'N', b'G', b'S', b'P', ..] | [0x1f, 0x8b, ..] => SplatKind::Spz,
            [b'P', b'K', ..] => SplatKind::Sog,
            text if text.trim_ascii_start().first() == Some(&b'{') => {
                let text = std::fs::read(path).map_err(io_error("read", path))?;
                if is_sog_meta(&text) { SplatKind::Sog } else { SplatKind::Gltf }
            }
            [b'p', b'l', b'y', ..] => SplatKind::Ply,
            start if named("ksplat") || is_ksplat(start) && !named("splat") => SplatKind::Ksplat,
            _ if named("splat") => SplatKind::Splat,
            _ => SplatKind::Ply,
        })
    }

    /// Returns the name of the kind.
    pub fn name(self) -> &'static str {
        match self {
            SplatKind::Ply => "ply",
            SplatKind::Gltf => "gltf",
            SplatKind::Spz => "spz",
            SplatKind::Splat => "splat",
            SplatKind::Ksplat => "ksplat",
            SplatKind::Sog => "sog",
        }
    }
}

impl SplatFile {
    /// Reads the splats of a file that is no glTF, and returns its format. A PLY has the name of its dialect.
    ///
    /// # Errors
    /// Fails if the file is damaged.
    pub fn read(path: &Path, kind: SplatKind) -> Result<(SplatFile, &'static str)> {
        let file = match kind {
            SplatKind::Ply | SplatKind::Gltf => {
                let (file, dialect) = Splats::read_ply_file(path)?;
                return Ok((file, dialect.name()));
            }
            SplatKind::Spz => read_spz(path)?,
            SplatKind::Splat => read_splat(path)?,
            SplatKind::Ksplat => read_ksplat(path)?,
            SplatKind::Sog => read_sog(path)?,
        };
        Ok((file, kind.name()))
    }
}
