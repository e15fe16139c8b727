//! PLY files of other programs: detection by property names, reading and writing.

use sgs_scene::{ALBEDO_RANGE, PlyDialect, ROUGHNESS_RANGE, SH_C0, Splats, srgb_to_linear};
use std::path::Path;

fn sample(n: usize) -> Splats {
    let mut state = 7_u32;
    let mut next = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 23) as f32 * 4.0 - 4.0
    };
    let mut many = |k: usize| (0..k).map(|_| next()).collect::<Vec<f32>>();
    Splats {
        means: many(n * 3).as_chunks::<3>().0.to_vec(),
        log_scales: many(n * 3).as_chunks::<3>().0.to_vec(),
        rotations: many(n * 4).as_chunks::<4>().0.to_vec(),
        opacity_logits: many(n),
        sh: [many(n * 3), many(n * 9), many(n * 15), many(n * 21)],
        normals: Some(many(n * 3).as_chunks::<3>().0.to_vec()),
        albedo: Some(many(n * 3).as_chunks::<3>().0.to_vec()),
        roughness: Some(many(n)),
        metallic: Some(many(n)),
        semantic: Some((4, many(n * 4))),
        light_gains: Some(vec![1.5; n]),
        emitters: Some((0..n as u32).map(|i| i % 3).collect()),
        antialiased: false,
    }
}

fn names(path: &Path) -> Vec<String> {
    let bytes = std::fs::read(path).unwrap();
    let end = bytes.windows(10).position(|w| w == b"end_header").unwrap();
    let header = std::str::from_utf8(&bytes[..end]).unwrap();
    header.lines().filter_map(|l| l.strip_prefix("property float ")).map(str::to_owned).collect()
}

fn activated(stored: f32, [low, span]: [f32; 2]) -> f32 {
    low + span / (1.0 + (-stored).exp())
}

fn far(a: &[f32], b: &[f32], range: [f32; 2]) -> f32 {
    let off = |(a, b): (&f32, &f32)| (activated(*a, range) - activated(*b, range)).abs();
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(off).fold(0.0, f32::max)
}

#[test]
fn splats_round_trip_through_every_dialect() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    let splats = sample(40);
    for dialect in PlyDialect::ALL {
        splats.write_ply_as(&path, dialect).unwrap();
        let (back, found) = Splats::read_ply_dialect(&path).unwrap();
        assert_eq!(found, dialect, "{:?}", names(&path));
        // Attributes that all dialects store keep every bit.
        assert_eq!(
            (&back.means, &back.log_scales, &back.rotations, &back.opacity_logits, &back.normals),
            (&splats.means, &splats.log_scales, &splats.rotations, &splats.opacity_logits, &splats.normals)
        );
        let mesh = dialect == PlyDialect::Mesh2Splat;
        assert_eq!(back.sh == splats.sh, !mesh, "{dialect:?}");
        assert_eq!(back.semantic.is_some(), matches!(dialect, PlyDialect::Own | PlyDialect::Sgs), "{dialect:?}");
        assert_eq!(dialect.leaves_out(&splats).contains(&"semantic features"), back.semantic.is_none());
        assert_eq!(back.emitters.is_some(), dialect == PlyDialect::Own, "{dialect:?}");
        assert_eq!(dialect.leaves_out(&splats).contains(&"emitters"), back.emitters.is_none());
        if dialect == PlyDialect::ThreeDgs {
            assert_eq!((&back.albedo, &back.roughness, &back.metallic), (&None, &None, &None));
            assert!(dialect.leaves_out(&splats).contains(&"materials"));
            continue;
        }
        let flat = |s: &Splats| s.albedo.as_ref().unwrap().as_flattened().to_vec();
        // The published range of albedo begins at 0.09; darker values are clamped.
        let published = matches!(dialect, PlyDialect::R3dg | PlyDialect::Sgs);
        let expected: Vec<f32> = match published {
            true => flat(&splats)
                .iter()
                .map(|v| {
                    let p = (activated(*v, ALBEDO_RANGE).max(0.0901) - 0.01) / 0.98;
                    (p / (1.0 - p)).ln()
                })
                .collect(),
            false => flat(&splats),
        };
        assert!(far(&flat(&back), &expected, ALBEDO_RANGE) < 2e-4, "{dialect:?}");
        let roughness = |s: &Splats| s.roughness.clone().unwrap();
        assert!(far(&roughness(&back), &roughness(&splats), ROUGHNESS_RANGE) < 1e-5, "{dialect:?}");
        let metallic = back.metallic.clone().unwrap_or_default();
        match published {
            true => assert!(back.metallic.is_none() && dialect.leaves_out(&splats).contains(&"metallic")),
            false => assert!(far(&metallic, splats.metallic.as_ref().unwrap(), [0.0, 1.0]) < 1e-5, "{dialect:?}"),
        }
        if dialect == PlyDialect::Own {
            assert_eq!(back, splats);
        }
    }
}

#[test]
fn property_names_match_each_program() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    let splats = sample(1);
    let tail = |dialect, count: usize| {
        splats.write_ply_as(&path, dialect).unwrap();
        let names = names(&path);
        names[names.len() - count..].join(" ")
    };
    assert_eq!(tail(PlyDialect::ThreeDgs, 4), "rot_0 rot_1 rot_2 rot_3");
    assert_eq!(tail(PlyDialect::GsIr, 8), "normal_0 normal_1 normal_2 albedo_0 albedo_1 albedo_2 roughness metallic");
    assert_eq!(tail(PlyDialect::R3dg, 5), "rot_3 base_color_0 base_color_1 base_color_2 roughness");
    assert_eq!(
        tail(PlyDialect::Sgs, 6),
        "semantic_feature_2 semantic_feature_3 base_color_0 base_color_1 base_color_2 roughness"
    );
    assert_eq!(
        tail(PlyDialect::Mesh2Splat, 13),
        "f_dc_0 f_dc_1 f_dc_2 metallicFactor roughnessFactor opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3"
    );
}

/// Reads a hand-written file with one splat. The file has the properties that all programs share, plus `more` with
/// `values`.
fn by_hand(path: &Path, more: &str, values: &str) -> (Splats, PlyDialect) {
    let text = format!(
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
         property float nx\nproperty float ny\nproperty float nz\nproperty float f_dc_0\nproperty float f_dc_1\n\
         property float f_dc_2\nproperty float opacity\nproperty float scale_0\nproperty float scale_1\n\
         property float scale_2\nproperty float rot_0\nproperty float rot_1\nproperty float rot_2\n\
         property float rot_3\n{more}end_header\n1 2 3 0 0 0 0.5 -0.5 0 1 -3 -3 -3 1 0 0 0 {values}\n"
    );
    std::fs::write(path, text).unwrap();
    Splats::read_ply_dialect(path).unwrap()
}

#[test]
fn foreign_materials_are_decoded() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    let (plain, dialect) = by_hand(&path, "", "");
    assert_eq!((dialect, &plain.normals, &plain.albedo), (PlyDialect::ThreeDgs, &None, &None));

    let floats = |names: &[&str]| names.iter().map(|n| format!("property float {n}\n")).collect::<String>();
    let albedo = |s: &Splats, k: usize| activated(s.albedo.as_ref().unwrap()[0][k], ALBEDO_RANGE);
    let roughness = |s: &Splats| activated(s.roughness.as_ref().unwrap()[0], ROUGHNESS_RANGE);
    let metallic = |s: &Splats| activated(s.metallic.as_ref().unwrap()[0], [0.0, 1.0]);
    let near = |a: f32, b: f32| assert!((a - b).abs() < 1e-5, "{a} is not {b}");

    let more = ["normal_0", "normal_1", "normal_2", "albedo_0", "albedo_1", "albedo_2", "roughness", "metallic"];
    let (s, dialect) = by_hand(&path, &floats(&more), "0 0 1 0 1 -1 0.5 2");
    assert_eq!((dialect, s.normals.as_ref().unwrap()[0]), (PlyDialect::GsIr, [0.0, 0.0, 1.0]));
    near(albedo(&s, 0), 0.5);
    near(albedo(&s, 1), 0.731_058_6);
    near(roughness(&s), 0.622_459_3);
    near(metallic(&s), 0.880_797_1);

    let more = ["base_color_0", "base_color_1", "base_color_2", "roughness", "incidents_dc_0", "visibility_dc_0"];
    let (s, dialect) = by_hand(&path, &floats(&more), "0 1 -1 0.5 9 9");
    assert_eq!(dialect, PlyDialect::R3dg);
    near(albedo(&s, 0), 0.09 + 0.45);
    near(albedo(&s, 2), 0.09 + 0.9 * 0.268_941_4);
    assert_eq!(s.roughness.as_ref().unwrap()[0], 0.5);

    let (s, dialect) = by_hand(&path, &floats(&["semantic_feature_0", "semantic_feature_1"]), "5 6");
    assert_eq!((dialect, s.semantic), (PlyDialect::Sgs, Some((2, vec![5.0, 6.0]))));

    for (more, values) in [
        (floats(&["metallicFactor", "roughnessFactor"]), "0.2 0.4"),
        ("property uchar metallic\nproperty uchar roughness\n".to_owned(), "51 102"),
    ] {
        let (s, dialect) = by_hand(&path, &more, values);
        assert_eq!(dialect, PlyDialect::Mesh2Splat);
        near(albedo(&s, 0), srgb_to_linear(0.5 + SH_C0 * 0.5));
        near(metallic(&s), 0.2);
        near(roughness(&s), 0.4);
    }
}

#[test]
fn dialects_with_materials_require_materials() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.ply");
    let bare = Splats { albedo: None, ..sample(2) };
    for dialect in [PlyDialect::GsIr, PlyDialect::R3dg, PlyDialect::Mesh2Splat] {
        let error = bare.write_ply_as(&path, dialect).unwrap_err().to_string();
        assert!(error.contains("no materials") && error.contains(dialect.name()), "{error}");
        assert!(!path.exists());
    }
    bare.write_ply_as(&path, PlyDialect::Sgs).unwrap();
    assert_eq!(Splats::read_ply_dialect(&path).unwrap().1, PlyDialect::Sgs);
}
