//! Reading splats from PLY files of this and other programs.

use std::path::Path;

use super::dialect::{LIGHT_GAIN, Names, OWN_ALBEDO, OWN_METALLIC, OWN_ROUGHNESS, albedo_of_color};
use super::layout::{degree_of_rest, place_of_rest};
use super::{MOST_EMITTERS, PlyDialect, SplatFile, Splats, comments};
use crate::error::Result;
use crate::ply::{Scalar, VertexTable};

const PURPOSE: &str = "a splat file";

/// Start of each optional group in a row of requested properties.
#[derive(Default)]
struct Groups {
    normals: Option<usize>,
    albedo: Option<usize>,
    roughness: Option<usize>,
    metallic: Option<usize>,
    semantic: Option<(usize, usize)>,
    emitter: Option<usize>,
    light_gain: Option<usize>,
}

impl Splats {
    /// Reads a 3DGS PLY file with the extensions of any [`PlyDialect`].
    ///
    /// Properties may have any order and type. All-zero normals count as absent, because 3DGS files store zeros there.
    /// Non-finite values, zero quaternions, light gains that are not above 0, and emitters that are not whole numbers from 0
    /// to [`MOST_EMITTERS`] are errors.
    pub fn read_ply(path: &Path) -> Result<Self> {
        Ok(Self::read_ply_dialect(path)?.0)
    }

    /// Reads a PLY file as [`Splats::read_ply`] and returns its dialect. Materials are converted to this project's
    /// encoding.
    pub fn read_ply_dialect(path: &Path) -> Result<(Self, PlyDialect)> {
        Self::read_table(VertexTable::open(path)?)
    }

    /// Reads a PLY file as [`Splats::read_ply_dialect`], with its comments.
    pub fn read_ply_file(path: &Path) -> Result<(SplatFile, PlyDialect)> {
        let table = VertexTable::open(path)?;
        let transform = comments::transform(table.comments()).map_err(|problem| table.fail("", problem))?;
        let left_out = comments::left_out(table.comments());
        let (splats, dialect) = Self::read_table(table)?;
        Ok((SplatFile { splats, transform, left_out }, dialect))
    }

    fn read_table(table: VertexTable) -> Result<(Self, PlyDialect)> {
        let mut wanted = table.need(&["x", "y", "z", "scale_0", "scale_1", "scale_2"], PURPOSE)?;
        wanted.extend(table.need(&["rot_0", "rot_1", "rot_2", "rot_3", "opacity"], PURPOSE)?);
        wanted.extend(table.need(&["f_dc_0", "f_dc_1", "f_dc_2"], PURPOSE)?);
        let rest_at = wanted.len();
        let rest = table.count_prefixed("f_rest_");
        let Some(degree) = degree_of_rest(rest) else {
            let problem = format!("there are {rest} properties f_rest_*, but degrees 0 to 3 have 0, 9, 24 or 45");
            return Err(table.fail("", problem));
        };
        for i in 0..rest {
            wanted.extend(table.need(&[format!("f_rest_{i}").as_str()], PURPOSE)?);
        }
        let dialect = PlyDialect::of(&table);
        let bytes = table.find("roughness").is_some_and(|p| table.scalar(p) == Scalar::U8);
        let names = dialect.names(bytes);
        let groups = optional_groups(&table, &names, &mut wanted);
        let [mut albedo_code, mut metallic_code] = [OWN_ALBEDO, OWN_METALLIC];
        if let Some((_, code)) = names.albedo {
            albedo_code = code;
        }
        if let Some((_, code)) = names.metallic {
            metallic_code = code;
        }
        // Dialects without albedo properties store the albedo as the color.
        let from_color = names.albedo.is_none() && groups.roughness.is_some();

        let n = table.len();
        let mut splats = Self {
            means: Vec::with_capacity(n),
            log_scales: Vec::with_capacity(n),
            rotations: Vec::with_capacity(n),
            opacity_logits: Vec::with_capacity(n),
            sh: std::array::from_fn(|d| if d <= degree { vec![0.0; n * (2 * d + 1) * 3] } else { Vec::new() }),
            normals: groups.normals.map(|_| Vec::with_capacity(n)),
            albedo: (groups.albedo.is_some() || from_color).then(|| Vec::with_capacity(n)),
            roughness: groups.roughness.map(|_| Vec::with_capacity(n)),
            metallic: groups.metallic.map(|_| Vec::with_capacity(n)),
            semantic: groups.semantic.map(|(_, channels)| (channels, Vec::with_capacity(n * channels))),
            emitters: groups.emitter.map(|_| Vec::with_capacity(n)),
            light_gains: groups.light_gain.map(|_| Vec::with_capacity(n)),
            antialiased: comments::antialiased(table.comments()),
        };
        let places: Vec<_> = (0..rest).map(|i| place_of_rest(degree, i)).collect();
        table.read(&wanted, |i, v| {
            let three = |at: usize| [v[at], v[at + 1], v[at + 2]];
            splats.means.push(three(0));
            splats.log_scales.push(three(3));
            let rotation = [v[6], v[7], v[8], v[9]];
            if rotation == [0.0; 4] {
                return Err("the rotation is a zero quaternion; remove the splat or set it to 1 0 0 0".into());
            }
            splats.rotations.push(rotation);
            splats.opacity_logits.push(v[10]);
            splats.sh[0][i * 3..i * 3 + 3].copy_from_slice(&v[11..14]);
            for (&(band, position), &value) in places.iter().zip(&v[rest_at..]) {
                splats.sh[band][i * (2 * band + 1) * 3 + position] = value;
            }
            if let (Some(target), Some(at)) = (&mut splats.normals, groups.normals) {
                target.push(three(at));
            }
            if let (Some(target), Some(at)) = (&mut splats.albedo, groups.albedo) {
                target.push(three(at).map(|v| albedo_code.to(OWN_ALBEDO, v)));
            } else if let Some(target) = &mut splats.albedo {
                target.push(three(11).map(albedo_of_color));
            }
            if let (Some(target), Some(at)) = (&mut splats.roughness, groups.roughness) {
                target.push(names.roughness.1.to(OWN_ROUGHNESS, v[at]));
            }
            if let (Some(target), Some(at)) = (&mut splats.metallic, groups.metallic) {
                target.push(metallic_code.to(OWN_METALLIC, v[at]));
            }
            if let (Some((channels, target)), Some((at, _))) = (&mut splats.semantic, groups.semantic) {
                target.extend_from_slice(&v[at..at + *channels]);
            }
            if let (Some(target), Some(at)) = (&mut splats.emitters, groups.emitter) {
                target.push(emitter(v[at])?);
            }
            if let (Some(target), Some(at)) = (&mut splats.light_gains, groups.light_gain) {
                if v[at] <= 0.0 {
                    return Err(format!("light_gain is {}; use a number above 0", v[at]));
                }
                target.push(v[at]);
            }
            Ok(())
        })?;
        if splats.normals.as_ref().is_some_and(|n| n.iter().flatten().all(|&v| v == 0.0)) {
            splats.normals = None;
        }
        Ok((splats, dialect))
    }
}

/// Returns the emitter that a stored number means.
fn emitter(stored: f32) -> std::result::Result<u32, String> {
    let whole = (0.0..=MOST_EMITTERS as f32).contains(&stored) && stored.fract() == 0.0;
    let wrong = || format!("emitter is {stored}; use a whole number from 0 to {MOST_EMITTERS}");
    whole.then_some(stored as u32).ok_or_else(wrong)
}

fn optional_groups(table: &VertexTable, names: &Names, wanted: &mut Vec<usize>) -> Groups {
    let mut group = |names: &[&str]| {
        let at = wanted.len();
        wanted.extend(table.find_all(names)?);
        Some(at)
    };
    let normals = group(&names.normals);
    let albedo = names.albedo.as_ref().and_then(|(names, _)| group(names));
    let roughness = group(&[names.roughness.0]);
    let metallic = names.metallic.and_then(|(name, _)| group(&[name]));
    let emitter = names.emitter.and_then(|name| group(&[name]));
    let light_gain = names.emitter.and_then(|_| group(&[LIGHT_GAIN]));
    let prefix = names.semantic.unwrap_or("semantic_");
    let channels = table.count_numbered(prefix);
    let names: Vec<String> = (0..channels).map(|i| format!("{prefix}{i}")).collect();
    let semantic = if channels == 0 { None } else { group(&names.iter().map(String::as_str).collect::<Vec<_>>()) };
    Groups { normals, albedo, roughness, metallic, semantic: semantic.map(|at| (at, channels)), emitter, light_gain }
}

#[cfg(test)]
mod tests {
    use super::super::write::tests::sample;
    use super::*;

    #[test]
    fn foreign_files_with_any_property_order_and_type_are_read() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.ply");
        let text = "ply\nformat ascii 1.0\nelement vertex 1\nproperty double rot_3\nproperty float rot_0\n\
                    property float rot_1\nproperty float rot_2\nproperty float opacity\nproperty float scale_2\n\
                    property float scale_0\nproperty float scale_1\nproperty uchar f_dc_0\nproperty float f_dc_1\n\
                    property float f_dc_2\nproperty float z\nproperty float y\nproperty float x\nproperty float label\n\
                    end_header\n4 1 2 3 -2 0.3 0.1 0.2 7 8 9 30 20 10 99\n";
        std::fs::write(&path, text).unwrap();
        let splats = Splats::read_ply(&path).unwrap();
        assert_eq!(splats.means, [[10.0, 20.0, 30.0]]);
        assert_eq!(splats.log_scales, [[0.1, 0.2, 0.3]]);
        assert_eq!(splats.rotations, [[1.0, 2.0, 3.0, 4.0]]);
        assert_eq!(splats.opacity_logits, [-2.0]);
        assert_eq!(splats.sh[0], [7.0, 8.0, 9.0]);
        assert_eq!(splats.sh_degree(), 0);
        assert_eq!((&splats.normals, &splats.albedo, &splats.semantic), (&None, &None, &None));

        let fail = |from: &str, to: &str| {
            std::fs::write(&path, text.replace(from, to)).unwrap();
            Splats::read_ply(&path).unwrap_err().to_string()
        };
        assert!(fail("\n4 1 2 3", "\n0 0 0 0").contains("vertex 0 (line 20): the rotation is a zero quaternion"));
    }

    #[test]
    fn emitters_are_whole_numbers() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.ply");
        let read = |stored: f32| {
            let splats = Splats { emitters: Some(vec![1, 4096]), ..sample(2, 0) };
            splats.write_ply(&path).unwrap();
            let mut bytes = std::fs::read(&path).unwrap();
            let at = bytes.len() - 4;
            bytes[at..].copy_from_slice(&stored.to_le_bytes());
            std::fs::write(&path, bytes).unwrap();
            Splats::read_ply(&path).map(|s| s.emitters).map_err(|e| e.to_string())
        };
        assert_eq!(read(0.0), Ok(Some(vec![1, 0])));
        assert_eq!(read(4096.0), Ok(Some(vec![1, 4096])));
        for wrong in [0.5, -1.0, 4097.0, 1e30] {
            let error = read(wrong).unwrap_err();
            assert!(error.contains("vertex 1") && error.contains("use a whole number from 0 to 4096"), "{error}");
        }
    }

    #[test]
    fn each_error_has_its_message() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.ply");
        sample(2, 1).write_ply(&path).unwrap();
        let whole = std::fs::read(&path).unwrap();
        let fail = |change: &dyn Fn(&mut Vec<u8>)| {
            let mut bytes = whole.clone();
            change(&mut bytes);
            std::fs::write(&path, bytes).unwrap();
            Splats::read_ply(&path).unwrap_err().to_string()
        };
        let rename = |from: &'static str, to: &'static str| {
            move |bytes: &mut Vec<u8>| {
                let at = bytes.windows(from.len()).position(|w| w == from.as_bytes()).unwrap();
                bytes.splice(at..at + from.len(), to.bytes());
            }
        };
        let error = fail(&rename("f_rest_8\n", "f_other_8\n"));
        assert!(error.contains("there are 8 properties f_rest_*, but degrees 0 to 3 have 0, 9, 24 or 45"), "{error}");
        let error = fail(&rename("f_rest_8\n", "f_rest_9\n"));
        assert!(error.contains("no property \"f_rest_8\", which a splat file needs"), "{error}");
        for name in ["x", "scale_1", "rot_3", "opacity", "f_dc_2"] {
            let declared: &'static str = format!("property float {name}\n").leak();
            let error = fail(&rename(declared, "property float other\n"));
            assert!(error.contains(&format!("no property \"{name}\", which a splat file needs")), "{error}");
        }
        let end = whole.len();
        let error = fail(&|bytes| bytes[end - 4..].copy_from_slice(&f32::NAN.to_le_bytes()));
        assert!(error.contains("vertex 1: the property \"semantic_1\" is NaN"), "{error}");
        let error = fail(&|bytes| bytes.truncate(end - 1));
        assert!(error.contains("promises 2 vertices"), "{error}");
    }
}
