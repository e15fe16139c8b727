//! Writing splats to PLY files for viewers.

use std::io::Write;
use std::path::Path;

use super::dialect::{Code, LIGHT_GAIN, OWN_ALBEDO, OWN_METALLIC, OWN_ROUGHNESS, color_of_albedo};
use super::layout::{REST, place_of_rest};
use super::{PlyDialect, Splats, comments};
use crate::atomic::atomic_write;
use crate::error::{Result, SceneError};
use crate::placement::Placement;

/// Source of the values of a property.
enum Source {
    Mean(usize),
    Normal(usize),
    Sh(usize, usize),
    Opacity,
    Scale(usize),
    Rotation(usize),
    Albedo(usize, Code),
    /// Albedo stored as the color.
    Shown(usize),
    Roughness(Code),
    Metallic(Code),
    Semantic(usize),
    Emitter,
    LightGain,
}

impl Source {
    fn value(&self, s: &Splats, i: usize) -> f32 {
        match *self {
            Source::Mean(k) => s.means[i][k],
            Source::Normal(k) => s.normals.as_ref().map_or(0.0, |n| n[i][k]),
            Source::Sh(band, at) => s.sh[band].get(i * (2 * band + 1) * 3 + at).copied().unwrap_or(0.0),
            Source::Opacity => s.opacity_logits[i],
            Source::Scale(k) => s.log_scales[i][k],
            Source::Rotation(k) => s.rotations[i][k],
            Source::Albedo(k, code) => s.albedo.as_ref().map_or(0.0, |a| OWN_ALBEDO.to(code, a[i][k])),
            Source::Shown(k) => s.albedo.as_ref().map_or(0.0, |a| color_of_albedo(a[i][k])),
            Source::Roughness(code) => s.roughness.as_ref().map_or(0.0, |r| OWN_ROUGHNESS.to(code, r[i])),
            // Splats without metallic are written as non-metallic.
            Source::Metallic(code) => match &s.metallic {
                Some(m) => OWN_METALLIC.to(code, m[i]),
                None => Code::Plain(1.0).to(code, 0.0),
            },
            Source::Semantic(k) => s.semantic.as_ref().map_or(0.0, |(channels, v)| v[i * channels + k]),
            Source::Emitter => s.emitters.as_ref().map_or(0.0, |e| e[i] as f32),
            Source::LightGain => s.light_gains.as_ref().map_or(1.0, |g| g[i]),
        }
    }
}

impl Splats {
    /// Writes a binary PLY file in this project's dialect. The properties are `x y z nx ny nz f_dc_* f_rest_* opacity
    /// scale_* rot_*`, as in 3DGS programs. `albedo_0..2 roughness metallic semantic_* emitter light_gain` follow if present.
    /// Absent normals are written as zeros.
    pub fn write_ply(&self, path: &Path) -> Result<()> {
        self.write_ply_as(path, PlyDialect::Own)
    }

    /// Writes a binary PLY file in a dialect. Attributes that the dialect cannot store are omitted
    /// ([`PlyDialect::leaves_out`]). Values outside its range are clamped.
    ///
    /// # Errors
    /// Fails if the dialect requires materials and these splats have none.
    pub fn write_ply_as(&self, path: &Path, dialect: PlyDialect) -> Result<()> {
        self.write_ply_placed(path, dialect, None)
    }

    /// Writes a PLY file as [`Splats::write_ply_as`], with a transform.
    ///
    /// A comment records the transform from the scene to the file.
    ///
    /// # Errors
    /// Fails if the dialect requires materials and these splats have none.
    pub fn write_ply_placed(&self, path: &Path, dialect: PlyDialect, transform: Option<&Placement>) -> Result<()> {
        self.check()?;
        if dialect.needs_materials() && (self.albedo.is_none() || self.roughness.is_none()) {
            let problem = format!("they have no materials, which {} files hold; write 3dgs instead", dialect.name());
            return Err(SceneError::Data { what: "the splats", problem });
        }
        let columns = self.columns(dialect);
        let mut header = "ply\nformat binary_little_endian 1.0\n".to_owned();
        header.push_str(&comments::lines(self.antialiased, transform));
        header.push_str(&format!("element vertex {}\n", self.len()));
        columns.iter().for_each(|(name, _)| header.push_str(&format!("property float {name}\n")));
        header.push_str("end_header\n");
        atomic_write(path, |out| {
            out.write_all(header.as_bytes())?;
            let mut bytes: Vec<u8> = Vec::new();
            for i in 0..self.len() {
                bytes.clear();
                bytes.extend(columns.iter().flat_map(|(_, source)| source.value(self, i).to_le_bytes()));
                out.write_all(&bytes)?;
            }
            Ok(())
        })
    }

    /// Returns the properties of a file, in file order.
    fn columns(&self, dialect: PlyDialect) -> Vec<(String, Source)> {
        let degree = self.sh_degree();
        let names = dialect.names(false);
        let own = dialect == PlyDialect::Own;
        let mesh = dialect == PlyDialect::Mesh2Splat;
        let mut columns: Vec<(String, Source)> = Vec::new();
        let mut put = |name: &str, source| columns.push((name.to_owned(), source));
        ["x", "y", "z"].into_iter().enumerate().for_each(|(k, n)| put(n, Source::Mean(k)));
        ["nx", "ny", "nz"].into_iter().enumerate().for_each(|(k, n)| put(n, Source::Normal(k)));
        (0..3).for_each(|k| put(&format!("f_dc_{k}"), if mesh { Source::Shown(k) } else { Source::Sh(0, k) }));
        let metallic = names.metallic.filter(|_| dialect != PlyDialect::ThreeDgs && (!own || self.metallic.is_some()));
        if mesh {
            metallic.iter().for_each(|(name, code)| put(name, Source::Metallic(*code)));
            put(names.roughness.0, Source::Roughness(names.roughness.1));
        } else {
            for i in 0..REST[degree] * 3 {
                let (band, at) = place_of_rest(degree, i);
                put(&format!("f_rest_{i}"), Source::Sh(band, at));
            }
        }
        put("opacity", Source::Opacity);
        (0..3).for_each(|k| put(&format!("scale_{k}"), Source::Scale(k)));
        (0..4).for_each(|k| put(&format!("rot_{k}"), Source::Rotation(k)));
        if mesh || dialect == PlyDialect::ThreeDgs {
            return columns;
        }
        if dialect == PlyDialect::GsIr {
            names.normals.into_iter().enumerate().for_each(|(k, n)| put(n, Source::Normal(k)));
        }
        let channels = self.semantic.as_ref().map_or(0, |(channels, _)| *channels);
        let semantic = names.semantic.map_or(0..0, |_| 0..channels);
        let prefix = names.semantic.unwrap_or_default();
        // Published SGS stores features before materials; this project stores them after.
        if !own {
            semantic.clone().for_each(|k| put(&format!("{prefix}{k}"), Source::Semantic(k)));
        }
        if let (Some((names, code)), true) = (names.albedo, self.albedo.is_some()) {
            names.into_iter().enumerate().for_each(|(k, n)| put(n, Source::Albedo(k, code)));
        }
        if self.roughness.is_some() {
            put(names.roughness.0, Source::Roughness(names.roughness.1));
        }
        metallic.iter().for_each(|(name, code)| put(name, Source::Metallic(*code)));
        if own {
            semantic.for_each(|k| put(&format!("{prefix}{k}"), Source::Semantic(k)));
        }
        if let Some(name) = names.emitter.filter(|_| self.emitters.is_some()) {
            put(name, Source::Emitter);
        }
        if own && self.light_gains.is_some() {
            put(LIGHT_GAIN, Source::LightGain);
        }
        columns
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Returns splats in which every value is different.
    pub(crate) fn sample(n: usize, degree: usize) -> Splats {
        let mut next = 0.0_f32;
        let mut value = || {
            next += 0.5;
            next
        };
        let mut many = |n: usize| (0..n).map(|_| value()).collect::<Vec<f32>>();
        let three = |v: Vec<f32>| v.chunks_exact(3).map(|v| [v[0], v[1], v[2]]).collect::<Vec<_>>();
        Splats {
            means: three(many(n * 3)),
            log_scales: three(many(n * 3)),
            rotations: many(n * 4).chunks_exact(4).map(|v| [v[0], v[1], v[2], v[3]]).collect(),
            opacity_logits: many(n),
            sh: std::array::from_fn(|d| if d <= degree { many(n * (2 * d + 1) * 3) } else { Vec::new() }),
            normals: Some(three(many(n * 3))),
            albedo: Some(three(many(n * 3))),
            roughness: Some(many(n)),
            metallic: Some(many(n)),
            semantic: Some((2, many(n * 2))),
            emitters: None,
            light_gains: None,
            antialiased: false,
        }
    }

    #[test]
    fn splats_round_trip_at_every_degree_with_and_without_attributes() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.ply");
        for degree in 0..=3 {
            let full = sample(5, degree);
            let bare =
                Splats { normals: None, albedo: None, roughness: None, metallic: None, semantic: None, ..full.clone() };
            let no_metal = Splats { metallic: None, ..full.clone() };
            let gains = Some(vec![1.0, 0.5, 2.0, 0.125, 1.5]);
            let emitting = Splats { emitters: Some(vec![0, 3, 0, 4096, 1]), light_gains: gains, ..full.clone() };
            let only_emitting = Splats { emitters: emitting.emitters.clone(), ..bare.clone() };
            let filtered = Splats { antialiased: true, ..bare.clone() };
            for splats in [full, bare, no_metal, emitting, only_emitting, filtered] {
                assert_eq!(splats.sh_degree(), degree);
                splats.write_ply(&path).unwrap();
                assert_eq!(Splats::read_ply(&path).unwrap(), splats);
            }
        }
        Splats::default().write_ply(&path).unwrap();
        assert!(Splats::read_ply(&path).unwrap().is_empty());
    }

    #[test]
    fn property_order_matches_3dgs() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.ply");
        let splats = sample(1, 1);
        splats.write_ply(&path).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
        let header = std::str::from_utf8(&bytes[..end]).unwrap();
        let names: Vec<_> = header.lines().filter_map(|l| l.strip_prefix("property float ")).collect();
        let expected = "x y z nx ny nz f_dc_0 f_dc_1 f_dc_2 f_rest_0 f_rest_1 f_rest_2 f_rest_3 f_rest_4 f_rest_5 \
                        f_rest_6 f_rest_7 f_rest_8 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3 albedo_0 \
                        albedo_1 albedo_2 roughness metallic semantic_0 semantic_1";
        assert_eq!(names.join(" "), expected);
        let row: Vec<f32> =
            bytes[end..].chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
        assert_eq!(row[..3], splats.means[0]);
        assert_eq!(row[3..6], splats.normals.as_ref().unwrap()[0]);
        assert_eq!(row[6..9], splats.sh[0]);
        // Memory: by coefficient, with r, g, b interleaved. File: three coefficients of red, of green, of blue.
        let b = &splats.sh[1];
        assert_eq!(row[9..18], [b[0], b[3], b[6], b[1], b[4], b[7], b[2], b[5], b[8]]);
        assert_eq!(row[18], splats.opacity_logits[0]);
        assert_eq!(row[22..26], splats.rotations[0]);
    }

    #[test]
    fn arrays_with_wrong_lengths_are_rejected() {
        let path = Path::new("never.ply");
        let fail = |change: fn(&mut Splats)| {
            let mut splats = sample(2, 1);
            change(&mut splats);
            splats.write_ply(path).unwrap_err().to_string()
        };
        assert_eq!(fail(|s| s.rotations.truncate(1)), "the splats: rotations has the length 1, but 2 splats need 2");
        assert!(fail(|s| s.sh[1].truncate(17)).contains("sh[1] has the length 17, but 2 splats need 18"));
        assert!(fail(|s| s.sh[0].clear()).contains("sh[0] has the length 0"));
        assert!(fail(|s| s.emitters = Some(vec![1])).contains("emitters has the length 1, but 2 splats need 2"));
        assert!(fail(|s| s.light_gains = Some(vec![1.0])).contains("light_gains has the length 1"));
        assert!(fail(|s| s.light_gains = Some(vec![1.0, 0.0])).contains("light gain 0"));
        assert!(fail(|s| s.emitters = Some(vec![0, 4097])).contains("belongs to emitter 4097"));
        assert!(fail(|s| s.semantic = Some((3, vec![0.0]))).contains("semantic has the length 1"));
        assert!(!path.exists());
    }

    #[test]
    fn truncated_files_are_errors() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.ply");
        sample(2, 3).write_ply(&path).unwrap();
        let whole = std::fs::read(&path).unwrap();
        for length in 0..whole.len() {
            std::fs::write(&path, &whole[..length]).unwrap();
            assert!(Splats::read_ply(&path).is_err(), "{length}");
        }
        for i in 0..whole.len() {
            let mut damaged = whole.clone();
            damaged[i] ^= 0x11;
            std::fs::write(&path, &damaged).unwrap();
            let _ = Splats::read_ply(&path);
        }
    }
}
