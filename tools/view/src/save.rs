//! Files saved from the window: images with their cameras, edits.

use crate::error::Result;
use sgs_relight::Edit;
use sgs_scene::{Camera, Image, atomic_write, write_png};
use std::path::{Path, PathBuf};

/// Returns the first unused name and path `DIR/WORD-000.EXTENSION`.
///
/// Neither the file nor a JSON file of that name exists.
fn free(dir: &Path, word: &str, extension: &str) -> (String, PathBuf) {
    let name = |k: u32| format!("{word}-{k:03}");
    let taken = |k: &u32| [extension, "json"].iter().any(|e| dir.join(format!("{}.{e}", name(*k))).exists());
    let first = (0..).find(|k| !taken(k)).unwrap_or(u32::MAX);
    (name(first), dir.join(format!("{}.{extension}", name(first))))
}

/// Writes texels with 8 bits per channel as a PNG image.
pub fn image(path: &Path, [width, height]: [u32; 2], texels: &[u8], blue_first: bool) -> Result<()> {
    let order = if blue_first { [2, 1, 0] } else { [0, 1, 2] };
    let data = texels.chunks_exact(4).flat_map(|t| order.map(|c| f32::from(t[c]) / 255.0)).collect();
    Ok(write_png(path, &Image { width, height, channels: 3, data })?)
}

/// Writes an image and its camera for `sgs render`. Returns the path of the image.
pub fn image_and_camera(dir: &Path, camera: &Camera, texels: &[u8], blue_first: bool) -> Result<PathBuf> {
    let (name, path) = free(dir, "view", "png");
    image(&path, [camera.width, camera.height], texels, blue_first)?;
    Camera::write_transforms(&path.with_extension("json"), &[Camera { name, ..camera.clone() }])?;
    Ok(path)
}

/// Writes an edit without its empty fields. Returns the path.
pub fn edit(dir: &Path, edit: &Edit) -> Result<PathBuf> {
    let (_, path) = free(dir, "edit", "json");
    let value = serde_json::to_value(edit).map_or(serde_json::Value::Null, without_empty);
    let text = format!("{value:#}\n");
    atomic_write(&path, |file| std::io::Write::write_all(file, text.as_bytes()))?;
    Ok(path)
}

/// Removes empty fields.
fn without_empty(value: serde_json::Value) -> serde_json::Value {
    use serde_json::Value;
    let empty = |v: &Value| match v {
        Value::Null | Value::Bool(false) => true,
        Value::Array(a) => a.is_empty(),
        Value::Object(o) => o.is_empty(),
        _ => false,
    };
    match value {
        // The field `on` of a change is significant for both values.
        Value::Object(map) => map
            .into_iter()
            .map(|(k, v)| (k, without_empty(v)))
            .filter(|(k, v)| k == "on" && v.is_boolean() || !empty(v))
            .collect(),
        Value::Array(all) => all.into_iter().map(without_empty).collect(),
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sgs_relight::{LightChange, LightEdit};

    #[test]
    fn edit_json_omits_empty_fields_and_parses() {
        let change =
            LightChange { light: Some(0), on: Some(false), color: Some([1.0, 0.5, 0.25]), ..Default::default() };
        let lights = LightEdit { change: vec![change], ..Default::default() };
        let sample = Edit { lights, ..Default::default() };
        let value = without_empty(serde_json::to_value(&sample).expect("JSON"));
        let expected = r#"{"lights":{"change":[{"color":[1.0,0.5,0.25],"light":0,"on":false}]}}"#;
        assert_eq!(value.to_string(), expected);
        assert_eq!(Edit::parse(expected, Path::new("")), Ok(sample));
        assert_eq!(without_empty(serde_json::to_value(Edit::default()).expect("JSON")).to_string(), "{}");
    }
}
