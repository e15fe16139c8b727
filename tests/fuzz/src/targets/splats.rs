//! Gaussians and points in files of many programs.

use super::text_of;
use crate::place::Place;
use sgs_run::{read_exchange, read_light, read_light_source, read_splats};
use sgs_scene::{PointCloud, Splats};

/// Checks the invariants of all splats that are read.
fn sound(splats: &Splats) -> String {
    splats.check().expect("splats fit each other");
    let all = splats.means.as_flattened().iter().chain(splats.log_scales.as_flattened()).chain(&splats.opacity_logits);
    assert!(all.chain(splats.rotations.as_flattened()).all(|v| v.is_finite()), "splats are finite");
    assert!(splats.sh.iter().flatten().all(|v| v.is_finite()), "colors are finite");
    let has = [
        splats.normals.is_some(),
        splats.albedo.is_some(),
        splats.roughness.is_some(),
        splats.metallic.is_some(),
        splats.semantic.is_some(),
    ];
    format!("{} of degree {} {has:?}", splats.len().min(3), splats.sh_degree())
}

pub(crate) fn splats(bytes: &[u8]) -> String {
    let place = Place::of("splats_ply", |_| ());
    let path = place.put("scene.ply", bytes);
    text_of(Splats::read_ply_dialect(&path), |(splats, dialect)| {
        // Splats that are read can be written and read again.
        let again = place.path("again.ply");
        let back = splats.write_ply(&again).and_then(|()| Splats::read_ply(&again));
        assert_eq!(back.map(|s| s.len()).ok(), Some(splats.len()), "splats come back");
        format!("{} {}", dialect.name(), sound(&splats))
    })
}

pub(crate) fn points(bytes: &[u8]) -> String {
    let place = Place::of("points_ply", |_| ());
    text_of(PointCloud::read_ply(&place.put("points.ply", bytes)), |points| {
        assert!(points.positions.iter().flatten().all(|v| v.is_finite()), "points are finite");
        let splats = text_of(Splats::from_points(&points, 1), |splats| sound(&splats));
        format!("{} {} {} {splats}", points.len().min(3), points.colors.is_some(), points.normals.is_some())
    })
}

pub(crate) fn gltf(bytes: &[u8]) -> String {
    let place = Place::of("gltf", |place| {
        place.put("scene.bin", &[0; 4096]);
    });
    let path = place.put("scene.glb", bytes);
    let light = text_of(read_light(&path, 16), |light| format!("{}", light.lights.is_some()));
    let splats = text_of(read_splats(&path), |splats| sound(&splats));
    let alone = text_of(read_light_source(&path), |list| {
        let valid = list.emitters().iter().all(|row| row.light().check().is_ok());
        format!("{} {valid}", list.lights.len().min(3))
    });
    let all = text_of(read_exchange(&path), |exchange| {
        if let Some(lights) = &exchange.lights {
            let _ = lights.published().map(|lights| lights.raw());
        }
        exchange.format.to_owned()
    });
    format!("{splats} {alone} {light} {all}")
}

/// Reads a file by its content, writes its splats as PLY, and reads them again.
fn any(target: &'static str, name: &str, bytes: &[u8]) -> String {
    let place = Place::of(target, |_| ());
    let path = place.put(name, bytes);
    text_of(read_exchange(&path), |exchange| {
        let splats = sound(&exchange.splats);
        let again = place.path("again.ply");
        let back = exchange.splats.write_ply(&again).and_then(|()| Splats::read_ply(&again));
        assert_eq!(back.map(|s| s.len()).ok(), Some(exchange.splats.len()), "splats come back");
        format!("{} {splats}", exchange.format)
    })
}

pub(crate) fn spz(bytes: &[u8]) -> String {
    any("spz", "scene.spz", bytes)
}

pub(crate) fn dot_splat(bytes: &[u8]) -> String {
    any("dot_splat", "scene.splat", bytes)
}

pub(crate) fn ksplat(bytes: &[u8]) -> String {
    any("ksplat", "scene.ksplat", bytes)
}

pub(crate) fn sog(bytes: &[u8]) -> String {
    any("sog", "scene.sog", bytes)
}

pub(crate) fn sog_meta(bytes: &[u8]) -> String {
    any("sog_meta", "meta.json", bytes)
}
