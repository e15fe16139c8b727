//! Opens a scene and reads everything that training and evaluation read.

use sgs_scene::{GroundTruth, GroundTruthKind, LoadOptions, Noise, Result, Scene, SceneOptions};
use std::path::Path;

/// Number of views that are read.
const VIEWS: usize = 3;

/// Opens a scene and reads what it has.
pub(crate) fn scene(root: &Path) -> String {
    // The number of points is fixed, so that damaged cameras alone do not use up memory.
    let options = SceneOptions { random_points: 100, ..SceneOptions::default() };
    match Scene::open(root, &options) {
        Ok(scene) => all(&scene),
        Err(error) => error.to_string(),
    }
}

/// Reads everything of a scene and returns a text of the results.
fn all(scene: &Scene) -> String {
    let mut words = format!("{:?} {} {}", scene.layout, scene.points.len().min(9), scene.warnings.join(" "));
    let mut note = |result: Result<String>| {
        words.push_str(&result.unwrap_or_else(|error| error.to_string()));
        words.push(' ');
    };
    assert!(!scene.split.train.is_empty() && !scene.points.is_empty(), "a scene has views and points");
    assert!(scene.extent() > 0.0 && scene.extent().is_finite(), "a scene has an extent, not {}", scene.extent());
    note(scene.text_embeddings().map(|t| format!("{}", t.is_some())));
    let truth = GroundTruth::of(scene);
    note(truth.depth_definition().map(|d| format!("{}", d.is_some())));
    note(truth.semantic_labels().map(|d| format!("{}", d.is_some())));
    let relit = truth.relit_names();
    for (i, view) in scene.views.iter().enumerate().take(VIEWS) {
        assert!(view.camera.problem().is_none(), "views have cameras that can be");
        let finite = |image: sgs_scene::Image| {
            image.check()?;
            assert!(image.data.iter().all(|v| v.is_finite()), "photographs are finite");
            Ok("p".to_owned())
        };
        note(scene.load_image(i).and_then(finite));
        note(view.load_linear(&scene.load_options()).and_then(finite));
        note(view.load_stored(&LoadOptions::default()).map(|p| format!("{}", p.linear)));
        note(scene.load_mask(i).map(|m| format!("{}", m.is_some())));
        view.coverage();
        note(scene.normal_prior(i).map(|m| format!("{}", m.is_some())));
        for prior in [Scene::albedo_prior, Scene::roughness_prior, Scene::metallic_prior] {
            note(prior(scene, i).map(|m| format!("{}", m.is_some())));
        }
        note(scene.region_prior(i).map(|m| format!("{}", m.is_some())));
        note(scene.pseudo_region_prior(&view.camera).map(|m| format!("{}", m.is_some())));
        note(scene.semantic_prior(i).map(|m| format!("{}", m.is_some())));
        note(scene.depth_prior(i).map(|m| format!("{}", m.is_some())));
        note(scene.sensor_depth(i).map(|m| format!("{}", m.is_some())));
        for kind in GroundTruthKind::ALL {
            note(truth.load(kind, i).map(|m| format!("{}", m.is_some())));
        }
        note(truth.semantic(i).map(|m| format!("{}", m.is_some())));
        for name in relit.iter().take(2) {
            note(truth.relit(name, i).map(|m| format!("{}", m.is_some())));
            note(truth.relit_albedo(name, i).map(|m| format!("{}", m.is_some())));
        }
    }
    note(scene.depth_points(50, 1).map(|p| format!("{}", p.map_or(0, |p| p.len()))));
    let noise =
        Noise { positions: 0.1, normals: 5.0, semantics: 0.5, rotations: 1.0, translations: 0.1, ..Default::default() };
    let noisy = scene.disturbed(&noise);
    note(noisy.normal_prior(0).map(|m| format!("{}", m.is_some())));
    note(noisy.semantic_prior(0).map(|m| format!("{}", m.is_some())));
    words
}
