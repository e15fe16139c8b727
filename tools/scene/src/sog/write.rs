//! Writer of SOG.

use super::clusters::Codebook;
use super::container::{Texture, write_archive};
use super::meta::{Asset, Coded, Files, Harmonics, Means, Meta};
use super::palette::Palette;
use super::{COEFFICIENTS, ROW, compress, rotation};
use crate::activation::{byte, logistic, unit};
use crate::atomic::atomic_write;
use crate::error::{Result, SceneError, io_error};
use crate::placement::Placement;
use crate::splats::Splats;
use std::io::Write;
use std::path::Path;

/// Largest side of a WebP image.
const MOST_SIDE: usize = 16_383;

/// Writes splats as a `.sog` file, or as a directory of images.
///
/// `path` is the archive, or the `meta.json` of the directory. Splats are written in Morton order. The same splats give the same bytes.
///
/// # Errors
/// Fails if there are too many splats, or if writing fails.
pub fn write_sog(path: &Path, splats: &Splats, transform: Option<&Placement>) -> Result<()> {
    splats.check()?;
    let files = files(splats, transform.copied()).map_err(|e| match e {
        Problem::Data(problem) => SceneError::Data { what: "the splats", problem },
        Problem::Io(e) => io_error("write", path)(e),
    })?;
    if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("json")) {
        // The text is last, so that a reader never finds it without its images.
        return files
            .iter()
            .rev()
            .try_for_each(|(name, bytes)| atomic_write(&path.with_file_name(name), |out| out.write_all(bytes)));
    }
    atomic_write(path, |out| write_archive(out, &files))
}

/// Names of the images of a directory.
const NAMES: [&str; 7] =
    ["means_l.webp", "means_u.webp", "scales.webp", "quats.webp", "sh0.webp", "shN_centroids.webp", "shN_labels.webp"];

/// Function that returns the pixel of the splat with the given index.
type Pixel<'a> = &'a dyn Fn(usize) -> [u8; 4];

enum Problem {
    Data(String),
    Io(std::io::Error),
}

impl From<std::io::Error> for Problem {
    fn from(e: std::io::Error) -> Problem {
        Problem::Io(e)
    }
}

/// Returns `meta.json` and the images.
fn files(s: &Splats, transform: Option<Placement>) -> std::result::Result<Vec<(&'static str, Vec<u8>)>, Problem> {
    let n = s.len();
    let width = ((n.max(1) as f64).sqrt() / 4.0).ceil() as usize * 4;
    let height = n.max(1).div_ceil(width).next_multiple_of(4);
    if width > MOST_SIDE {
        return Err(Problem::Data(format!("there are {n}, but an image of a SOG holds 268 million at most")));
    }
    let ranges: [[f64; 2]; 3] = std::array::from_fn(|k| {
        let values = s.means.iter().map(|m| compress(f64::from(m[k])));
        values
            .fold(None, |range: Option<[f64; 2]>, v| Some(range.map_or([v; 2], |[a, b]| [a.min(v), b.max(v)])))
            .unwrap_or([0.0; 2])
    });
    let whole = |i: usize| -> [u16; 3] {
        std::array::from_fn(|k| {
            let [low, high] = ranges[k];
            let at = (compress(f64::from(s.means[i][k])) - low) / (high - low).max(f64::MIN_POSITIVE);
            (65_535.0 * at).round().clamp(0.0, 65_535.0) as u16
        })
    };
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by_cached_key(|i| (morton(whole(*i)), *i));
    let texture = |pixel: Pixel<'_>| -> std::io::Result<Vec<u8>> {
        let mut data: Vec<[u8; 4]> = order.iter().map(|i| pixel(*i)).collect();
        data.resize(width * height, [0, 0, 0, 255]);
        Texture { width, height, data }.encode()
    };
    let bytes = |i: usize, which: usize| {
        let [x, y, z] = whole(i).map(|v| v.to_le_bytes()[which]);
        [x, y, z, 255]
    };
    let scales = Codebook::of(s.log_scales.as_flattened().iter().copied());
    let colors = Codebook::of(s.sh[0].iter().copied());
    let mut files = vec![
        (NAMES[0], texture(&|i| bytes(i, 0))?),
        (NAMES[1], texture(&|i| bytes(i, 1))?),
        (
            NAMES[2],
            texture(&|i| {
                let [x, y, z] = s.log_scales[i].map(|v| scales.index(v));
                [x, y, z, 255]
            })?,
        ),
        (NAMES[3], texture(&|i| rotation::pack(unit(s.rotations[i])))?),
        (
            NAMES[4],
            texture(&|i| {
                let color = |k: usize| colors.index(s.sh[0][3 * i + k]);
                [color(0), color(1), color(2), byte(logistic(s.opacity_logits[i]))]
            })?,
        ),
    ];
    let harmonics = if s.sh_degree() == 0 || n == 0 { None } else { Some(harmonics(s, &texture, &mut files)?) };
    let one = |name: &str| [name.to_owned()];
    let meta = Meta {
        version: 2,
        asset: Some(Asset { generator: concat!("SGS ", env!("CARGO_PKG_VERSION")) }),
        count: n,
        antialias: s.antialiased,
        means: Means {
            mins: ranges.map(|r| r[0]),
            maxs: ranges.map(|r| r[1]),
            files: [NAMES[0].to_owned(), NAMES[1].to_owned()],
        },
        scales: Coded { codebook: scales.0, files: one(NAMES[2]) },
        quats: Files { files: one(NAMES[3]) },
        sh0: Coded { codebook: colors.0, files: one(NAMES[4]) },
        harmonics,
        sgs_transform: transform,
    };
    files.insert(0, ("meta.json", serde_json::to_vec(&meta).map_err(std::io::Error::other)?));
    Ok(files)
}

/// Adds the images of the harmonics above band 0.
fn harmonics(
    s: &Splats,
    texture: &dyn Fn(Pixel<'_>) -> std::io::Result<Vec<u8>>,
    files: &mut Vec<(&'static str, Vec<u8>)>,
) -> std::io::Result<Harmonics> {
    let bands = s.sh_degree();
    let wide = COEFFICIENTS[bands];
    let mut rows = Vec::with_capacity(s.len() * 3 * wide);
    for i in 0..s.len() {
        for band in 1..=bands {
            let row = 3 * (2 * band + 1);
            rows.extend_from_slice(&s.sh[band][i * row..(i + 1) * row]);
        }
    }
    let palette = Palette::of(&rows, 3 * wide);
    drop(rows);
    let codes = Codebook::of(palette.entries.iter().copied());
    let count = palette.entries.len() / (3 * wide);
    let mut data: Vec<[u8; 4]> = palette
        .entries
        .as_chunks::<3>()
        .0
        .iter()
        .map(|c| {
            let [r, g, b] = c.map(|v| codes.index(v));
            [r, g, b, 255]
        })
        .collect();
    let height = count.div_ceil(ROW);
    data.resize(ROW * wide * height, [0, 0, 0, 255]);
    files.push((NAMES[5], Texture { width: ROW * wide, height, data }.encode()?));
    let label = |i: usize| {
        let [low, high] = palette.labels[i].to_le_bytes();
        [low, high, 0, 255]
    };
    files.push((NAMES[6], texture(&label)?));
    let names = [NAMES[5].to_owned(), NAMES[6].to_owned()];
    Ok(Harmonics { count, bands, codebook: codes.0, files: names })
}

/// Interleaves the bits of a position.
fn morton(at: [u16; 3]) -> u64 {
    let spread = |v: u16| (0..16).fold(0_u64, |all, bit| all | u64::from(v >> bit & 1) << (3 * bit));
    spread(at[0]) | spread(at[1]) << 1 | spread(at[2]) << 2
}

#[cfg(test)]
mod tests {
    use super::super::{is_sog_meta, read_sog};
    use super::*;
    use crate::splats::tests::waves;

    #[test]
    fn splats_come_back_within_the_steps_of_the_format() {
        let folder = tempfile::tempdir().unwrap();
        let placed = Placement { scale: 2.0, rotation: [0.5, 0.5, -0.5, 0.5], translation: [1.0, -2.0, 0.125] };
        for (name, degree) in [("a.sog", 3), ("b.sog", 0), ("c/meta.json", 2), ("d.sog", 1)] {
            let path = folder.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            let splats = waves(700, degree);
            write_sog(&path, &splats, Some(&placed)).unwrap();
            let first = std::fs::read(&path).unwrap();
            write_sog(&path, &splats, Some(&placed)).unwrap();
            assert!(std::fs::read(&path).unwrap() == first, "{name}: the bytes are the same every time");
            let file = read_sog(&path).unwrap();
            let found = file.splats;
            found.check().unwrap();
            assert_eq!((file.transform, found.len(), found.sh_degree()), (Some(placed), 700, degree));
            // The file has another order: each splat has a partner at its place.
            let mut partners = vec![false; 700];
            for (i, mean) in splats.means.iter().enumerate() {
                let away = |j: usize| -> f32 { mean.iter().zip(found.means[j]).map(|(a, b)| (a - b).powi(2)).sum() };
                let j = (0..700).min_by(|a, b| away(*a).total_cmp(&away(*b))).unwrap();
                assert!(away(j).sqrt() < 3e-3, "{name}: {mean:?} {:?}", found.means[j]);
                assert!(!std::mem::replace(&mut partners[j], true));
                let near = |a: &[f32], b: &[f32], step: f32| {
                    assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() <= step), "{name}: {a:?} {b:?}");
                };
                near(&splats.log_scales[i], &found.log_scales[j], 0.03);
                near(&splats.sh[0][3 * i..3 * i + 3], &found.sh[0][3 * j..3 * j + 3], 0.01);
                for band in 1..=degree {
                    let wide = 3 * (2 * band + 1);
                    near(&splats.sh[band][wide * i..][..wide], &found.sh[band][wide * j..][..wide], 0.01);
                }
            }
        }
        assert!(is_sog_meta(&std::fs::read(folder.path().join("c/meta.json")).unwrap()));
        assert!(!is_sog_meta(br#"{"asset": {"version": "2.0"}}"#));
    }

    #[test]
    fn no_splats_and_one_splat_are_a_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.sog");
        write_sog(&path, &waves(0, 0), None).unwrap();
        assert!(read_sog(&path).unwrap().splats.is_empty());
        write_sog(&path, &waves(1, 3), None).unwrap();
        let found = read_sog(&path).unwrap().splats;
        assert!((found.means[0][0] - waves(1, 3).means[0][0]).abs() < 1e-4);
        assert_eq!(found.sh[3], waves(1, 3).sh[3]);
    }

    #[test]
    fn damaged_files_are_refused_or_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.sog");
        write_sog(&path, &waves(20, 1), None).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        for length in (0..bytes.len()).step_by(101) {
            std::fs::write(&path, &bytes[..length]).unwrap();
            assert!(read_sog(&path).is_err(), "{length}");
        }
        for at in (0..bytes.len()).step_by(11) {
            let mut bad = bytes.clone();
            bad[at] ^= 0x21;
            std::fs::write(&path, &bad).unwrap();
            if let Ok(file) = read_sog(&path) {
                file.splats.check().unwrap();
            }
        }
        let text = folder.path().join("meta.json");
        let mut meta: serde_json::Value =
            serde_json::from_slice(&files(&waves(4, 0), None).ok().unwrap()[0].1).unwrap();
        let mut refused = |change: &dyn Fn(&mut serde_json::Value), words: &str| {
            let before = meta.clone();
            change(&mut meta);
            std::fs::write(&text, meta.to_string()).unwrap();
            let problem = read_sog(&text).unwrap_err().to_string();
            assert!(problem.contains(words), "{problem}");
            meta = before;
        };
        refused(&|m| m["version"] = 3.into(), "version 3");
        refused(&|m| m["scales"]["codebook"] = serde_json::json!([1.0]), "codebook of scales has 1 numbers");
        refused(&|m| m["means"]["maxs"][1] = 1e9.into(), "range of the means");
        refused(&|m| m["means"]["files"][0] = "../x.webp".into(), "not beside it");
        refused(&|_| (), "cannot read means_l.webp");
        refused(
            &|m| {
                m["sgs_transform"] =
                    serde_json::json!({"scale": 0.0, "rotation": [1, 0, 0, 0], "translation": [0, 0, 0]})
            },
            "recorded scale",
        );
    }
}
