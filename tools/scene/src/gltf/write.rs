//! Writer of splats and lights to glTF files.

use super::{LIGHTS, METALLIC_RANGE, PunctualKind, PunctualLight, SPLATTING, logistic, material, sh_name, unit};
use crate::atomic::atomic_write;
use crate::error::{Result, SceneError};
use crate::image::srgb_to_linear;
use crate::placement::Placement;
use crate::splats::{ALBEDO_RANGE, ROUGHNESS_RANGE, SH_C0, Splats};
use glam::{DQuat, DVec3};
use serde_json::{Value, json};
use std::io::{self, Write};
use std::path::Path;

const FLOAT: u32 = 5126;

/// Function that appends the numbers of the splat with the given index.
type Numbers<'a> = Box<dyn Fn(usize, &mut Vec<f32>) + 'a>;

/// Attribute of all splats.
struct Attribute<'a> {
    name: String,
    wide: usize,
    numbers: Numbers<'a>,
}

/// Writes splats and lights as `.glb`, or as `.gltf` with a `.bin` file. The `.bin` file has the same stem and
/// directory.
///
/// Splats and lights are in the coordinates of the scene. A node above them holds the transform from the scene to the file.
///
/// # Errors
/// Fails if there are no splats, which glTF cannot express, if a `.glb` would exceed 4 GiB, or if writing fails.
pub fn write_gltf(
    path: &Path,
    splats: &Splats,
    lights: &[PunctualLight],
    light_extras: Option<&Value>,
    transform: Option<&Placement>,
) -> Result<()> {
    splats.check()?;
    if splats.is_empty() {
        let problem = "there are none, and glTF has no way to say so; write a PLY".into();
        return Err(SceneError::Data { what: "the splats", problem });
    }
    let attributes = attributes(splats);
    let n = splats.len();
    let total: usize = attributes.iter().map(|a| 4 * a.wide * n).sum();
    let binary = path.extension().is_none_or(|e| !e.eq_ignore_ascii_case("gltf"));
    let beside = path.with_extension("bin");
    let uri = (!binary).then(|| beside.file_name().unwrap_or_default().to_string_lossy().replace(' ', "%20"));
    let lights: Vec<PunctualLight> = lights.iter().map(|light| scaled(light, transform)).collect();
    let mut document = document(splats, &attributes, total, uri, &lights, light_extras);
    if let Some(transform) = transform {
        place(&mut document, transform);
    }
    let fill = |out: &mut dyn Write| -> io::Result<()> {
        let (mut row, mut bytes) = (Vec::new(), Vec::new());
        for attribute in &attributes {
            for i in 0..n {
                row.clear();
                (attribute.numbers)(i, &mut row);
                bytes.extend(row.iter().flat_map(|v| v.to_le_bytes()));
                if bytes.len() > 1 << 16 || i + 1 == n {
                    out.write_all(&bytes)?;
                    bytes.clear();
                }
            }
        }
        Ok(())
    };
    if !binary {
        atomic_write(&beside, |out| fill(out))?;
        let text = serde_json::to_string_pretty(&document).unwrap_or_default();
        return atomic_write(path, |out| out.write_all(text.as_bytes()));
    }
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let length = 12 + 8 + text.len() + 8 + total;
    let Ok(length) = u32::try_from(length) else {
        let problem = format!("they take {length} bytes, but a .glb has 4 GiB at most; write a .gltf");
        return Err(SceneError::Data { what: "the splats", problem });
    };
    atomic_write(path, |out| {
        out.write_all(b"glTF")?;
        [2, length, text.len() as u32].iter().try_for_each(|v| out.write_all(&v.to_le_bytes()))?;
        out.write_all(b"JSON")?;
        out.write_all(&text)?;
        out.write_all(&(total as u32).to_le_bytes())?;
        out.write_all(b"BIN\0")?;
        fill(out)
    })
}

fn attributes<'a>(s: &'a Splats) -> Vec<Attribute<'a>> {
    let mut all = Vec::new();
    let mut put = |name: String, wide: usize, numbers: Numbers<'a>| all.push(Attribute { name, wide, numbers });
    let own = |name: &str| format!("{SPLATTING}:{name}");
    put("POSITION".into(), 3, Box::new(|i, out| out.extend(s.means[i])));
    // Viewers without splat support show points in the color of band 0; glTF colors are linear.
    let color = |v: f32| srgb_to_linear((0.5 + SH_C0 * v).clamp(0.0, 1.0));
    put(
        "COLOR_0".into(),
        4,
        Box::new(move |i, out| {
            out.extend(s.sh[0][3 * i..3 * i + 3].iter().map(|v| color(*v)));
            out.push(logistic(s.opacity_logits[i]) as f32);
        }),
    );
    put(
        own("ROTATION"),
        4,
        Box::new(|i, out| {
            let [w, x, y, z] = unit(s.rotations[i]);
            out.extend([x, y, z, w].map(|v| v as f32));
        }),
    );
    put(own("SCALE"), 3, Box::new(|i, out| out.extend(s.log_scales[i].map(|v| f64::from(v).exp() as f32))));
    put(own("OPACITY"), 1, Box::new(|i, out| out.push(logistic(s.opacity_logits[i]) as f32)));
    for (band, values) in s.sh.iter().enumerate().take(s.sh_degree() + 1) {
        for c in 0..2 * band + 1 {
            let at = move |i: usize| (i * (2 * band + 1) + c) * 3;
            put(sh_name(band, c), 3, Box::new(move |i, out| out.extend(&values[at(i)..at(i) + 3])));
        }
    }
    if let Some(normals) = &s.normals {
        put("_NORMAL".into(), 3, Box::new(|i, out| out.extend(normals[i])));
    }
    if let Some(albedo) = &s.albedo {
        put("_ALBEDO".into(), 3, Box::new(|i, out| out.extend(albedo[i].map(|v| material(v, ALBEDO_RANGE) as f32))));
        put("_RAW_ALBEDO".into(), 3, Box::new(|i, out| out.extend(albedo[i])));
    }
    let scalars = [("ROUGHNESS", &s.roughness, ROUGHNESS_RANGE), ("METALLIC", &s.metallic, METALLIC_RANGE)];
    for (name, values, range) in scalars {
        if let Some(values) = values {
            put(format!("_{name}"), 1, Box::new(move |i, out| out.push(material(values[i], range) as f32)));
            put(format!("_RAW_{name}"), 1, Box::new(move |i, out| out.push(values[i])));
        }
    }
    if let Some((channels, values)) = &s.semantic {
        for c in 0..*channels {
            put(format!("_SEMANTIC_{c}"), 1, Box::new(move |i, out| out.push(values[i * channels + c])));
        }
    }
    put("_RAW_SCALE".into(), 3, Box::new(|i, out| out.extend(s.log_scales[i])));
    put("_RAW_ROTATION".into(), 4, Box::new(|i, out| out.extend(s.rotations[i])));
    put("_RAW_OPACITY".into(), 1, Box::new(|i, out| out.push(s.opacity_logits[i])));
    all
}

/// Returns the node of a light, and the light. Lights shine along -Z of their node.
fn punctual(light: &PunctualLight) -> (Value, Value) {
    let mut node = json!({"name": light.name, "translation": light.position});
    let mut object = json!({"name": light.name, "color": light.color, "intensity": light.intensity});
    let along = DVec3::from(light.direction.map(f64::from)).normalize_or(DVec3::NEG_Z);
    let turn = DQuat::from_rotation_arc(DVec3::NEG_Z, along);
    if turn != DQuat::IDENTITY {
        node["rotation"] = json!(turn.to_array());
    }
    object["type"] = match light.kind {
        PunctualKind::Point => json!("point"),
        PunctualKind::Spot { inner_angle, outer_angle } => {
            object["spot"] = json!({"innerConeAngle": inner_angle, "outerConeAngle": outer_angle});
            json!("spot")
        }
        PunctualKind::Directional => json!("directional"),
    };
    (node, object)
}

/// Returns a light whose intensity fits the lengths of the file.
fn scaled(light: &PunctualLight, transform: Option<&Placement>) -> PunctualLight {
    let by = transform.filter(|_| light.has_intensity()).map_or(1.0, |t| t.scale * t.scale);
    PunctualLight { intensity: light.intensity * by as f32, ..light.clone() }
}

/// Adds a node with the transform above all others.
fn place(document: &mut Value, transform: &Placement) {
    let Placement { scale, rotation: [w, x, y, z], translation } = *transform;
    let Some(nodes) = document["nodes"].as_array_mut() else { return };
    let children: Vec<usize> = (0..nodes.len()).collect();
    let root = children.len();
    nodes.push(json!({
        "name": "scene", "scale": [scale, scale, scale], "rotation": [x, y, z, w], "translation": translation,
        "children": children, "extras": {"sgs": {"transform": transform}},
    }));
    document["scenes"] = json!([{"nodes": [root]}]);
}

fn document(
    splats: &Splats,
    attributes: &[Attribute<'_>],
    total: usize,
    uri: Option<String>,
    lights: &[PunctualLight],
    light_extras: Option<&Value>,
) -> Value {
    let (mut views, mut accessors, mut names) = (Vec::new(), Vec::new(), serde_json::Map::new());
    let mut offset = 0;
    for (i, a) in attributes.iter().enumerate() {
        let length = 4 * a.wide * splats.len();
        views.push(json!({"buffer": 0, "byteOffset": offset, "byteLength": length, "target": 34962}));
        offset += length;
        let kind = ["SCALAR", "VEC2", "VEC3", "VEC4"][a.wide - 1];
        let mut accessor = json!({"bufferView": i, "componentType": FLOAT, "count": splats.len(), "type": kind});
        if a.name == "POSITION" {
            let most =
                |f: fn(f32, f32) -> f32, from: f32| [0, 1, 2].map(|k| splats.means.iter().map(|m| m[k]).fold(from, f));
            accessor["min"] = json!(most(f32::min, f32::INFINITY));
            accessor["max"] = json!(most(f32::max, f32::NEG_INFINITY));
        }
        accessors.push(accessor);
        names.insert(a.name.clone(), json!(i));
    }
    let mut nodes = vec![json!({"name": "splats", "mesh": 0})];
    let mut all = Vec::new();
    for (i, light) in lights.iter().enumerate() {
        let (mut node, mut object) = punctual(light);
        node["extensions"] = json!({LIGHTS: {"light": i}});
        nodes.push(node);
        if let Some(extras) = &light.extras {
            object["extras"] = extras.clone();
        }
        all.push(object);
    }
    let mut buffer = json!({"byteLength": total});
    if let Some(uri) = uri {
        buffer["uri"] = json!(uri);
    }
    let mut document = json!({
        "asset": {"version": "2.0", "generator": concat!("SGS ", env!("CARGO_PKG_VERSION"))},
        "extensionsUsed": [SPLATTING],
        "scene": 0,
        "scenes": [{"nodes": (0..nodes.len()).collect::<Vec<_>>()}],
        "nodes": nodes,
        "meshes": [{"primitives": [{
            "mode": 0,
            "attributes": names,
            "extensions": {SPLATTING: {
                "kernel": "ellipse", "colorSpace": "srgb_rec709_display",
                "sortingMethod": "cameraDistance", "projection": "perspective"
            }}
        }]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [buffer],
    });
    if !all.is_empty() {
        document["extensionsUsed"] = json!([SPLATTING, LIGHTS]);
        let mut object = json!({"lights": all});
        if let Some(extras) = light_extras {
            object["extras"] = extras.clone();
        }
        document["extensions"] = json!({LIGHTS: object});
    }
    document
}
