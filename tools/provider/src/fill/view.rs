//! Questions about one view.

use super::write::Writer;
use super::{Encoding, FillError, NormalFrame, Prior, Provider, ProviderImage, Scene};
use glam::{DMat3, DVec3};
use sgs_scene::{Image, View};

/// Asks for the missing priors of one view.
pub(super) fn fill(
    scene: &Scene,
    index: usize,
    provider: &mut Provider,
    kinds: &[Prior],
    writer: &mut Writer,
) -> Result<(), FillError> {
    let view = scene.view(index)?;
    let name = view.camera.name.as_str();
    let mut lacks = Vec::new();
    for &kind in kinds {
        // A provider of text embeddings alone makes no feature maps.
        let makes = kind != Prior::Semantic || provider.offers("semantics");
        if makes && writer.lacks(kind, name) {
            lacks.push(kind);
        }
    }
    if lacks.is_empty() {
        return Ok(());
    }
    let stored = view.load_stored(&scene.load_options())?;
    let rendered = ProviderImage {
        image: &stored.image,
        encoding: if stored.linear { Encoding::Linear } else { Encoding::Srgb },
        view: Some(name),
        // The camera of a distorted photograph is not a pinhole camera.
        camera: view.distortion.is_none().then_some(&view.stored_camera),
    };
    if lacks.contains(&Prior::Normal) {
        let found = provider.normals(&rendered)?;
        let frame = writer.frame(found.frame)?;
        writer.normal(name, &turned(found.image, found.frame, frame, view))?;
    }
    if lacks.contains(&Prior::Depth) {
        let found = provider.depth(&rendered)?;
        writer.meaning(found.meaning)?;
        writer.depth(name, &found)?;
    }
    if lacks.contains(&Prior::Semantic) {
        let found = provider.semantics(&rendered)?;
        writer.features(name, &found)?;
    }
    if lacks.contains(&Prior::Masks) {
        let same = provider.about().offers.get("regions").is_some_and(|o| o.same_ids);
        let found = provider.regions(&rendered)?;
        writer.regions(name, found, same)?;
    }
    let maps: Vec<&str> = lacks
        .iter()
        .filter(|k| matches!(k, Prior::Albedo | Prior::Roughness | Prior::Metallic))
        .map(|k| k.name())
        .collect();
    if !maps.is_empty() {
        let found = provider.materials(&rendered, &maps)?;
        writer.materials(name, &found)?;
    }
    Ok(())
}

/// Rotates normals from one frame to another.
pub(super) fn turned(mut image: Image, from: NormalFrame, to: NormalFrame, view: &View) -> Image {
    if from != to {
        let rotation = view.camera.rotation;
        let matrix: DMat3 = to.to_world(rotation).transpose() * from.to_world(rotation);
        for n in image.data.chunks_exact_mut(3) {
            let turned = matrix * DVec3::new(f64::from(n[0]), f64::from(n[1]), f64::from(n[2]));
            n.copy_from_slice(&turned.as_vec3().to_array());
        }
    }
    image
}
