//! Photographs, and maps as priors and ground truth of every kind.

use super::describe;
use super::text_of;
use crate::place::Place;
use crate::seeds;
use sgs_scene::{Exif, NpyArray, read_exr, read_ids, read_upright};
use std::path::Path;

/// Reads a scene whose first photograph has these bytes.
///
/// The camera takes its size from the photograph.
fn photograph(name: &'static str, file: &str, bytes: &[u8]) -> String {
    let place = Place::of(name, |place| {
        place.put("split.json", br#"{"train": ["000"], "test": ["other"]}"#);
        place.put("other.png", &seeds::png(8, 6));
    });
    place.put("transforms.json", seeds::unsized_transforms(file).as_bytes());
    place.put(&format!("images/{file}"), bytes);
    describe::scene(&place.path(""))
}

pub(crate) fn photograph_png(bytes: &[u8]) -> String {
    photograph("photograph_png", "000.png", bytes)
}

pub(crate) fn photograph_jpeg(bytes: &[u8]) -> String {
    photograph("photograph_jpeg", "000.jpg", bytes)
}

pub(crate) fn photograph_exr(bytes: &[u8]) -> String {
    photograph("photograph_exr", "000.exr", bytes)
}

/// Reads a scene that uses these bytes for every map of a view.
fn maps(name: &'static str, extension: &str, bytes: &[u8]) -> (String, std::rc::Rc<Place>) {
    let place = Place::of(name, seeds::scene);
    let folders: &[&str] = match extension {
        "npy" => &["priors/normal", "priors/albedo", "priors/roughness", "priors/semantic"],
        "png" => &["priors/normal", "priors/albedo", "priors/masks", "priors/masks/pseudo", "gt/albedo", "gt/semantic"],
        _ => &["priors/normal", "priors/albedo", "priors/metallic", "gt/depth", "gt/normal", "gt/mask", "gt/relit/day"],
    };
    for folder in folders {
        place.put(&format!("{folder}/000.{extension}"), bytes);
    }
    (describe::scene(&place.path("")), place)
}

/// Reads a scene of InteriorVerse that uses these bytes for all files of a view.
fn beside(bytes: &[u8]) -> String {
    let place = Place::of("map_exr_beside", seeds::interiorverse);
    for kind in ["albedo", "normal", "depth", "material", "mask"] {
        place.put(&format!("000_{kind}.exr"), bytes);
    }
    describe::scene(&place.path(""))
}

pub(crate) fn map_exr(bytes: &[u8]) -> String {
    let (words, place) = maps("map_exr", "exr", bytes);
    let read = text_of(read_exr(&place.path("priors/normal/000.exr")), |exr| {
        assert!(exr.image.check().is_ok() && exr.names.len() == exr.image.channels as usize, "sizes fit");
        exr.names.join(" ")
    });
    format!("{words} {read} {}", beside(bytes))
}

pub(crate) fn map_png(bytes: &[u8]) -> String {
    let (words, place) = maps("map_png", "png", bytes);
    let read = text_of(read_ids(&place.path("priors/masks/000.png")), |(width, height, ids)| {
        assert_eq!(ids.len() as u64, u64::from(width) * u64::from(height), "sizes fit");
        "ids".into()
    });
    words + &read
}

pub(crate) fn map_npy(bytes: &[u8]) -> String {
    let (words, place) = maps("map_npy", "npy", bytes);
    let array = |path: &Path| {
        text_of(NpyArray::read(path), |array| {
            let count = array.shape.iter().product::<usize>();
            assert!(array.to_f32().len() == count && array.to_f16().len() == count, "sizes fit");
            text_of(array.to_image(), |image| format!("{}", image.channels.min(9)))
        })
    };
    let words = words + &array(&place.path("priors/albedo/000.npy"));
    // The same bytes as text embeddings of the classes.
    let texts = Place::of("map_npy_texts", seeds::scene);
    texts.put("priors/semantic/text_embeddings.npy", bytes);
    words + &describe::scene(&texts.path(""))
}

/// Reads EXIF data.
pub(crate) fn exif(bytes: &[u8]) -> String {
    let exif = Exif::parse(bytes);
    assert!((1..=8).contains(&exif.orientation), "orientations are 1 to 8");
    let focal = exif.focal_pixels(640, 480);
    assert!(focal.is_none_or(|focal| focal.is_finite() && focal > 0.0), "focal lengths are positive");
    format!("{} {} {}", exif.orientation, exif.camera.len().min(9), focal.is_some())
}

/// Reads a photograph and turns it upright.
fn upright(name: &'static str, file: &str, bytes: &[u8]) -> String {
    let place = Place::of(name, |_| ());
    let path = place.put(file, bytes);
    text_of(read_upright(&path), |upright| {
        upright.image.check().expect("the pixels fit the size");
        format!("{} {}", upright.image.channels, upright.exif.orientation)
    })
}

pub(crate) fn upright_tiff(bytes: &[u8]) -> String {
    upright("upright_tiff", "a.tif", bytes)
}

pub(crate) fn upright_webp(bytes: &[u8]) -> String {
    upright("upright_webp", "a.webp", bytes)
}
