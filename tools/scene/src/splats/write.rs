//! Splats to PLY files that viewers read.

use std::io::Write;
use std::path::Path;

use super::Splats;
use super::layout::{REST, place_of_rest};
use crate::atomic::atomic_write;
use crate::error::Result;

impl Splats {
    /// Writes a binary PLY file: `x y z nx ny nz f_dc_* f_rest_* opacity scale_* rot_*` as every 3DGS program does, then
    /// `albedo_0..2 roughness metallic semantic_*` where present. Absent normals are written as zeros.
    pub fn write_ply(&self, path: &Path) -> Result<()> {
        self.check()?;
        let degree = self.sh_degree();
        let header = self.header(degree);
        let rest: Vec<_> = (0..REST[degree] * 3).map(|i| place_of_rest(degree, i)).collect();
        atomic_write(path, |out| {
            out.write_all(header.as_bytes())?;
            let mut row: Vec<f32> = Vec::new();
            let mut bytes: Vec<u8> = Vec::new();
            for i in 0..self.len() {
                row.clear();
                row.extend(self.means[i]);
                row.extend(self.normals.as_ref().map_or([0.0; 3], |n| n[i]));
                row.extend(self.sh[0].get(i * 3..i * 3 + 3).unwrap_or(&[0.0; 3]));
                row.extend(rest.iter().map(|&(band, at)| self.sh[band][i * (2 * band + 1) * 3 + at]));
                row.push(self.opacity_logits[i]);
                row.extend(self.log_scales[i]);
                row.extend(self.rotations[i]);
                row.extend(self.albedo.iter().flat_map(|v| v[i]));
                row.extend(self.roughness.iter().map(|v| v[i]));
                row.extend(self.metallic.iter().map(|v| v[i]));
                if let Some((channels, values)) = &self.semantic {
                    row.extend(&values[i * channels..(i + 1) * channels]);
                }
                bytes.clear();
                bytes.extend(row.iter().flat_map(|v| v.to_le_bytes()));
                out.write_all(&bytes)?;
            }
            Ok(())
        })
    }

    fn header(&self, degree: usize) -> String {
        let mut header = format!("ply\nformat binary_little_endian 1.0\nelement vertex {}\n", self.len());
        let mut declare = |name: &str| header.push_str(&format!("property float {name}\n"));
        ["x", "y", "z", "nx", "ny", "nz"].into_iter().for_each(&mut declare);
        (0..3).for_each(|i| declare(&format!("f_dc_{i}")));
        (0..REST[degree] * 3).for_each(|i| declare(&format!("f_rest_{i}")));
        declare("opacity");
        (0..3).for_each(|i| declare(&format!("scale_{i}")));
        (0..4).for_each(|i| declare(&format!("rot_{i}")));
        if self.albedo.is_some() {
            (0..3).for_each(|i| declare(&format!("albedo_{i}")));
        }
        if self.roughness.is_some() {
            declare("roughness");
        }
        if self.metallic.is_some() {
            declare("metallic");
        }
        let channels = self.semantic.as_ref().map_or(0, |(channels, _)| *channels);
        (0..channels).for_each(|i| declare(&format!("semantic_{i}")));
        header.push_str("end_header\n");
        header
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Splats in which every value is different.
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
        }
    }

    #[test]
    fn round_trip_at_every_degree_with_and_without_extras() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.ply");
        for degree in 0..=3 {
            let full = sample(5, degree);
            let bare =
                Splats { normals: None, albedo: None, roughness: None, metallic: None, semantic: None, ..full.clone() };
            let no_metal = Splats { metallic: None, ..full.clone() };
            for splats in [full, bare, no_metal] {
                assert_eq!(splats.sh_degree(), degree);
                splats.write_ply(&path).unwrap();
                assert_eq!(Splats::read_ply(&path).unwrap(), splats);
            }
        }
        Splats::default().write_ply(&path).unwrap();
        assert!(Splats::read_ply(&path).unwrap().is_empty());
    }

    #[test]
    fn the_order_is_that_of_every_viewer() {
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
        // Memory: coefficient by coefficient, r g b. File: three coefficients of red, of green, of blue.
        let b = &splats.sh[1];
        assert_eq!(row[9..18], [b[0], b[3], b[6], b[1], b[4], b[7], b[2], b[5], b[8]]);
        assert_eq!(row[18], splats.opacity_logits[0]);
        assert_eq!(row[22..26], splats.rotations[0]);
    }

    #[test]
    fn arrays_of_wrong_length_are_refused() {
        let path = Path::new("never.ply");
        let fail = |change: fn(&mut Splats)| {
            let mut splats = sample(2, 1);
            change(&mut splats);
            splats.write_ply(path).unwrap_err().to_string()
        };
        assert_eq!(fail(|s| s.rotations.truncate(1)), "the splats: rotations has the length 1, but 2 splats need 2");
        assert!(fail(|s| s.sh[1].truncate(17)).contains("sh[1] has the length 17, but 2 splats need 18"));
        assert!(fail(|s| s.sh[0].clear()).contains("sh[0] has the length 0"));
        assert!(fail(|s| s.semantic = Some((3, vec![0.0]))).contains("semantic has the length 1"));
        assert!(!path.exists());
    }

    #[test]
    fn a_file_cut_anywhere_is_an_error() {
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
