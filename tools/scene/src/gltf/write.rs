//! Writer of splats and lights to glTF files.

use super::{
    COMPRESSION, LIGHTS, METALLIC_RANGE, PunctualKind, PunctualLight, SPLATTING, compressed, logistic, material,
    sh_name, unit,
};
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

/// Coding of the splats of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GltfCoding {
    /// All numbers as 32-bit floats, with what the reader needs to restore every bit.
    Floats,
    /// Splats as SPZ of version 2 by `KHR_gaussian_splatting_compression_spz_2`. Normals, materials and features are
    /// floats.
    Spz,
}

/// Attribute of all splats.
struct Attribute<'a> {
    name: String,
    wide: usize,
    numbers: Numbers<'a>,
    /// Whether SPZ holds the numbers.
    in_spz: bool,
}

impl Attribute<'_> {
    /// Returns the bytes of the numbers of `n` splats.
    fn bytes(&self, n: usize) -> usize {
        4 * self.wide * n
    }
}

/// Numbers of a file.
struct Content<'a> {
    splats: &'a Splats,
    attributes: Vec<Attribute<'a>>,
    /// Compressed splats; empty without compression.
    payload: Vec<u8>,
    /// Least and greatest position.
    bounds: [[f32; 3]; 2],
}

impl<'a> Content<'a> {
    fn new(splats: &'a Splats, coding: GltfCoding) -> Result<Self> {
        let mut attributes = attributes(splats);
        let bounds = |of: &Splats| {
            let most =
                |f: fn(f32, f32) -> f32, from: f32| [0, 1, 2].map(|k| of.means.iter().map(|m| m[k]).fold(from, f));
            [most(f32::min, f32::INFINITY), most(f32::max, f32::NEG_INFINITY)]
        };
        if coding == GltfCoding::Floats {
            attributes.iter_mut().for_each(|a| a.in_spz = false);
            return Ok(Self { splats, attributes, payload: Vec::new(), bounds: bounds(splats) });
        }
        attributes.retain(|a| !a.name.starts_with("_RAW_"));
        let payload = compressed::packed(splats)?;
        let read =
            compressed::unpacked(&payload).map_err(|problem| SceneError::Data { what: "the splats", problem })?;
        let bounds = bounds(&read.splats);
        Ok(Self { splats, attributes, payload, bounds })
    }

    /// Returns the attributes whose numbers are written as floats.
    fn floats(&self) -> impl Iterator<Item = &Attribute<'a>> {
        self.attributes.iter().filter(|a| !a.in_spz)
    }

    /// Returns the bytes of all attributes that are floats.
    fn float_bytes(&self) -> usize {
        self.floats().map(|a| a.bytes(self.splats.len())).sum()
    }

    /// Returns the bytes of the buffer: floats, payload, and zeros up to a multiple of four.
    fn bytes(&self) -> usize {
        (self.float_bytes() + self.payload.len()).next_multiple_of(4)
    }

    fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        let n = self.splats.len();
        let (mut row, mut bytes) = (Vec::new(), Vec::new());
        for attribute in self.floats() {
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
        out.write_all(&self.payload)?;
        out.write_all(&vec![0; self.bytes() - self.float_bytes() - self.payload.len()])
    }
}

/// Writes splats and lights as `.glb`, or as `.gltf` with a `.bin` file. The `.bin` file has the same stem and
/// directory.
///
/// Splats and lights are in the coordinates of the scene. A node above them holds the transform from the scene to the file.
///
/// # Errors
/// Fails if there are no splats, which glTF cannot express, if a position does not fit into SPZ, if a `.glb` would exceed
/// 4 GiB, or if writing fails.
pub fn write_gltf(
    path: &Path,
    splats: &Splats,
    coding: GltfCoding,
    lights: &[PunctualLight],
    light_extras: Option<&Value>,
    transform: Option<&Placement>,
) -> Result<()> {
    splats.check()?;
    if splats.is_empty() {
        let problem = "there are none, and glTF has no way to say so; write a PLY".into();
        return Err(SceneError::Data { what: "the splats", problem });
    }
    let content = Content::new(splats, coding)?;
    let total = content.bytes();
    let binary = path.extension().is_none_or(|e| !e.eq_ignore_ascii_case("gltf"));
    let beside = path.with_extension("bin");
    let uri = (!binary).then(|| beside.file_name().unwrap_or_default().to_string_lossy().replace(' ', "%20"));
    let lights: Vec<PunctualLight> = lights.iter().map(|light| scaled(light, transform)).collect();
    let mut document = document(&content, uri, &lights, light_extras);
    if let Some(transform) = transform {
        place(&mut document, transform);
    }
    if !binary {
        atomic_write(&beside, |out| content.write(out))?;
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
        content.write(out)
    })
}

fn attributes<'a>(s: &'a Splats) -> Vec<Attribute<'a>> {
    let mut all = Vec::new();
    let mut put = |name: String, wide: usize, numbers: Numbers<'a>| {
        let in_spz = !name.starts_with('_');
        all.push(Attribute { name, wide, numbers, in_spz });
    };
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
    content: &Content<'_>,
    uri: Option<String>,
    lights: &[PunctualLight],
    light_extras: Option<&Value>,
) -> Value {
    let (mut views, mut accessors, mut names) = (Vec::new(), Vec::new(), serde_json::Map::new());
    let (mut offset, count) = (0, content.splats.len());
    for (i, a) in content.attributes.iter().enumerate() {
        let kind = ["SCALAR", "VEC2", "VEC3", "VEC4"][a.wide - 1];
        let mut accessor = json!({"componentType": FLOAT, "count": count, "type": kind});
        if !a.in_spz {
            accessor["bufferView"] = json!(views.len());
            let length = a.bytes(count);
            views.push(json!({"buffer": 0, "byteOffset": offset, "byteLength": length, "target": 34962}));
            offset += length;
        }
        if a.name == "POSITION" {
            let [least, greatest] = content.bounds;
            accessor["min"] = json!(least);
            accessor["max"] = json!(greatest);
        }
        accessors.push(accessor);
        names.insert(a.name.clone(), json!(i));
    }
    let mut splatting = json!({
        "kernel": "ellipse", "colorSpace": "srgb_rec709_display",
        "sortingMethod": "cameraDistance", "projection": "perspective"
    });
    let mut used = vec![SPLATTING];
    if !content.payload.is_empty() {
        splatting["extensions"] = json!({COMPRESSION: {"bufferView": views.len()}});
        views.push(json!({"buffer": 0, "byteOffset": offset, "byteLength": content.payload.len()}));
        used.push(COMPRESSION);
    }
    let required = used[1..].to_vec();
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
    let mut buffer = json!({"byteLength": content.bytes()});
    if let Some(uri) = uri {
        buffer["uri"] = json!(uri);
    }
    let mut document = json!({
        "asset": {"version": "2.0", "generator": concat!("SGS ", env!("CARGO_PKG_VERSION"))},
        "scene": 0,
        "scenes": [{"nodes": (0..nodes.len()).collect::<Vec<_>>()}],
        "nodes": nodes,
        "meshes": [{"primitives": [{
            "mode": 0,
            "attributes": names,
            "extensions": {SPLATTING: splatting}
        }]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [buffer],
    });
    if !all.is_empty() {
        used.push(LIGHTS);
        let mut object = json!({"lights": all});
        if let Some(extras) = light_extras {
            object["extras"] = extras.clone();
        }
        document["extensions"] = json!({LIGHTS: object});
    }
    document["extensionsUsed"] = json!(used);
    if !required.is_empty() {
        document["extensionsRequired"] = json!([&[SPLATTING], &required[..]].concat());
    }
    document
}
