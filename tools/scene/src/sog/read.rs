//! Reader of SOG.

use super::container::Container;
use super::meta::{Harmonics, Meta};
use super::{COEFFICIENTS, ROW, expand, rotation};
use crate::activation::unlogistic;
use crate::error::{Result, SceneError, io_error};
use crate::splats::{SplatFile, Splats};
use serde::Deserialize;
use serde::de::IgnoredAny;
use std::path::Path;

/// Result whose error is a description of the problem.
type Found<T> = std::result::Result<T, String>;

/// Reads a `.sog` file, or the `meta.json` of a directory.
///
/// # Errors
/// Fails if the file is damaged, of another version, or names images that are lossy.
pub fn read_sog(path: &Path) -> Result<SplatFile> {
    let bytes = std::fs::read(path).map_err(io_error("read", path))?;
    read(path, bytes).map_err(|problem| SceneError::points(path, "", problem))
}

/// Returns whether a JSON text is the `meta.json` of a SOG.
pub fn is_sog_meta(text: &[u8]) -> bool {
    #[derive(Deserialize)]
    struct Start {
        #[serde(rename = "means")]
        _means: IgnoredAny,
        #[serde(rename = "quats")]
        _quats: IgnoredAny,
    }
    serde_json::from_slice::<Start>(text).is_ok()
}

fn read(path: &Path, bytes: Vec<u8>) -> Found<SplatFile> {
    let own = if bytes.starts_with(b"PK") { None } else { Some(bytes.clone()) };
    let mut container = Container::open(path, bytes)?;
    let text = match own {
        Some(text) => text,
        None => container.file("meta.json")?,
    };
    let meta = Meta::read(&text)?;
    let n = meta.count;
    let mut load = |name: &str| container.texture(name, n);
    let [low, high] = [load(&meta.means.files[0])?, load(&meta.means.files[1])?];
    let (scales, rotations, colors) =
        (load(&meta.scales.files[0])?, load(&meta.quats.files[0])?, load(&meta.sh0.files[0])?);
    let mean = |(low, high): (&[u8; 4], &[u8; 4])| -> [f32; 3] {
        std::array::from_fn(|k| {
            let at = f64::from(u16::from_le_bytes([low[k], high[k]])) / 65_535.0;
            let [from, to] = [meta.means.mins[k], meta.means.maxs[k]];
            expand(from + (to - from) * at) as f32
        })
    };
    let coded = |book: &[f32], pixel: &[u8; 4]| -> [f32; 3] { std::array::from_fn(|k| book[usize::from(pixel[k])]) };
    let mut splats = Splats {
        means: low.data.iter().zip(&high.data).take(n).map(mean).collect(),
        log_scales: scales.data.iter().take(n).map(|p| coded(&meta.scales.codebook, p)).collect(),
        rotations: rotations.data.iter().take(n).map(|p| rotation::unpack(*p)).collect(),
        opacity_logits: colors.data.iter().take(n).map(|p| unlogistic(f64::from(p[3]) / 255.0)).collect(),
        antialiased: meta.antialias,
        ..Splats::default()
    };
    splats.sh[0] = colors.data.iter().take(n).flat_map(|p| coded(&meta.sh0.codebook, p)).collect();
    if let Some(harmonics) = &meta.harmonics {
        read_harmonics(&mut container, harmonics, n, &mut splats)?;
    }
    Ok(SplatFile { splats, transform: meta.sgs_transform, left_out: Vec::new() })
}

fn read_harmonics(container: &mut Container, h: &Harmonics, n: usize, splats: &mut Splats) -> Found<()> {
    let wide = COEFFICIENTS[h.bands];
    if wide == 0 {
        return Ok(());
    }
    let entries = container.texture(&h.files[0], wide * h.count)?;
    let labels = container.texture(&h.files[1], n)?;
    if entries.width != ROW * wide || entries.height < h.count.div_ceil(ROW) {
        let (width, height) = (entries.width, entries.height);
        let problem = format!("{}: {width}×{height} pixels do not hold {} entries of {wide}", h.files[0], h.count);
        return Err(problem);
    }
    for band in 1..=h.bands {
        splats.sh[band].reserve_exact(n * 3 * (2 * band + 1));
    }
    for (i, pixel) in labels.data.iter().take(n).enumerate() {
        let label = usize::from(u16::from_le_bytes([pixel[0], pixel[1]]));
        if label >= h.count {
            return Err(format!("splat {i} has entry {label} of {} entries of harmonics", h.count));
        }
        let first = label / ROW * entries.width + label % ROW * wide;
        for band in 1..=h.bands {
            let row = &entries.data[first + COEFFICIENTS[band - 1]..first + COEFFICIENTS[band]];
            splats.sh[band].extend(row.iter().flat_map(|p| [p[0], p[1], p[2]].map(|c| h.codebook[usize::from(c)])));
        }
    }
    Ok(())
}
