//! JSON files of a scene directory.

use serde_json::{Value, json};

use crate::options::SynthOptions;
use crate::scene::Scene;
use crate::scene::classes::CLASSES;
use crate::trace::camera::Camera;
use crate::views::{FOV_X, Views};

/// Returns the base name of a view's files.
pub(crate) fn stem(view: usize) -> String {
    format!("{view:03}")
}

/// Returns `transforms.json`: the shared projection and each view's OpenGL camera-to-world matrix.
pub(crate) fn transforms(views: &Views) -> Value {
    let first: &Camera = &views.train[0];
    let center = first.center();
    let frames: Vec<Value> = views
        .train
        .iter()
        .chain(&views.test)
        .enumerate()
        .map(|(index, camera)| {
            let m = camera.matrix();
            let rows: Vec<[f32; 4]> = (0..4).map(|r| m.row(r).to_array()).collect();
            json!({
                "file_path": format!("images/{}.png", stem(index)),
                "transform_matrix": rows,
            })
        })
        .collect();
    json!({
        "camera_model": "OPENCV",
        "fl_x": first.focal,
        "fl_y": first.focal,
        "cx": center.x,
        "cy": center.y,
        "w": first.width,
        "h": first.height,
        "ply_file_path": "points.ply",
        "frames": frames,
    })
}

/// Returns `split.json`.
pub(crate) fn split(views: &Views) -> Value {
    let train = views.train.len();
    let test = train + views.test.len();
    json!({
        "train": (0..train).map(stem).collect::<Vec<_>>(),
        "test": (train..test).map(stem).collect::<Vec<_>>(),
    })
}

/// Returns `priors/semantic/labels.json`.
pub(crate) fn labels(dim: usize, cell: usize) -> Value {
    json!({
        "labels": CLASSES,
        "dim": dim,
        "feature_scale": cell,
        "note": "text_embeddings[i] belongs to labels[i]; unit vectors; the same label has the same vector in every set",
    })
}

/// Returns `scene.json`: the options of the scene and the meaning of its ids.
pub(crate) fn scene(scene: &Scene, options: &SynthOptions) -> Value {
    let classes: Vec<Value> = CLASSES.iter().enumerate().map(|(id, name)| json!({ "id": id, "name": name })).collect();
    let instances: Vec<Value> = scene
        .instances
        .iter()
        .enumerate()
        .skip(1)
        .map(|(id, instance)| {
            json!({
                "id": id,
                "name": instance.name,
                "class_id": instance.class,
                "class_name": CLASSES[instance.class as usize],
            })
        })
        .collect();
    json!({
        "scene": options.scene.as_str(),
        "source": "procedural",
        "seed": options.seed,
        "width": options.width,
        "height": options.height,
        "fov_x_deg": FOV_X.to_degrees(),
        "samples_per_pixel": options.samples_per_pixel,
        "denoised": options.denoise,
        "room": { "min": scene.interior.min.to_array(), "max": scene.interior.max.to_array() },
        "classes": classes,
        "instances": instances,
    })
}

/// Returns pretty-printed JSON with a final newline.
pub(crate) fn text(value: &Value) -> Vec<u8> {
    let mut out = format!("{value:#}").into_bytes();
    out.push(b'\n');
    out
}
