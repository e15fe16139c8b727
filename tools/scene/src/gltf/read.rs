//! Reader of splats and lights from glTF files of this or another program.

use super::document::{Document, Light, Lights, NodeLight, Primitive, Splatting};
use super::{
    GltfScene, LIGHTS, METALLIC_RANGE, Placement, PunctualKind, PunctualLight, SPLATTING, agrees, buffer, logistic,
    material, nodes, sh_name, unit, unlogistic, unmaterial,
};
use crate::error::{Result, SceneError, io_error};
use crate::splats::{ALBEDO_RANGE, ROUGHNESS_RANGE, Splats};
use glam::{DMat4, DVec3};
use serde_json::Value;
use std::path::Path;

/// Result whose error is a description of the problem.
type Found<T> = std::result::Result<T, String>;

/// Smallest number of bytes per splat under any quantization.
const LEAST_BYTES: usize = 20;

impl GltfScene {
    /// Reads a `.gltf` or `.glb` file. Reads all primitives with `KHR_gaussian_splatting` and all lights of the scene.
    ///
    /// # Errors
    /// Fails if the file is damaged, requires an unsupported extension, holds no splats, or places them with an
    /// unsupported transform.
    pub fn read(path: &Path) -> Result<GltfScene> {
        let bytes = std::fs::read(path).map_err(io_error("read", path))?;
        read(path, &bytes).map_err(|problem| SceneError::points(path, "", problem))
    }

    /// Reads the lights of a `.gltf` or `.glb` file, which needs no splats.
    ///
    /// # Errors
    /// Fails if the file is damaged, or a light is invalid.
    pub fn read_lights(path: &Path) -> Result<GltfScene> {
        let bytes = std::fs::read(path).map_err(io_error("read", path))?;
        let read = || -> Found<GltfScene> {
            let document = document(buffer::chunks(&bytes)?.0)?;
            let mut scene = GltfScene::default();
            let nodes = nodes::all(&document)?;
            scene.transform = nodes.transform;
            lights(&document, &nodes.placed, &mut scene)?;
            Ok(scene)
        };
        read().map_err(|problem| SceneError::points(path, "", problem))
    }
}

fn document(json: &[u8]) -> Found<Document> {
    let document: Document = serde_json::from_slice(json).map_err(|e| format!("it is no glTF: {e}"))?;
    if !document.asset.version.starts_with("2.") {
        return Err(format!("it is glTF {}, not 2", document.asset.version));
    }
    Ok(document)
}

fn read(path: &Path, bytes: &[u8]) -> Found<GltfScene> {
    let (json, binary) = buffer::chunks(bytes)?;
    let document = document(json)?;
    if let Some(other) = document.extensions_required.iter().find(|e| !matches!(e.as_str(), SPLATTING | LIGHTS)) {
        return Err(format!("it needs the extension {other}, which is not read; export it without"));
    }
    let buffers = buffer::buffers(path, &document, binary)?;
    let total: usize = buffers.iter().map(Vec::len).sum();
    let nodes::Nodes { placed, transform } = nodes::all(&document)?;
    let mut scene = GltfScene { transform, ..GltfScene::default() };
    let mut meshes = 0_usize;
    let mut splats = 0_usize;
    for (index, matrix) in &placed {
        let Some(mesh) = document.nodes[*index].mesh else { continue };
        let Some(mesh) = document.meshes.get(mesh) else { return Err(format!("there is no mesh {mesh}")) };
        for (i, primitive) in mesh.primitives.iter().enumerate() {
            let Some(extension) = primitive.extensions.get(SPLATTING) else {
                meshes += 1;
                continue;
            };
            let named = |problem| format!("node {index}, primitive {i}: {problem}");
            note(extension, primitive, &mut scene.left_out).map_err(named)?;
            let attributes = Attributes { document: &document, buffers: &buffers, primitive };
            splats = splats.saturating_add(attributes.count().map_err(named)?);
            if splats.saturating_mul(LEAST_BYTES) > total {
                return Err("its splats are more than its buffers hold: bytes are used twice".into());
            }
            let part = attributes.splats().map_err(named)?;
            scene.parts.push((part, nodes::placement(matrix).map_err(named)?));
        }
    }
    if scene.parts.is_empty() {
        return Err(format!("it holds no splats: no primitive of its scene has {SPLATTING}"));
    }
    if meshes > 0 {
        scene.left_out.push(format!("{meshes} primitives that are no splats"));
    }
    lights(&document, &placed, &mut scene)?;
    Ok(scene)
}

/// Rejects unsupported splats and records approximations in `left_out`.
fn note(extension: &Value, primitive: &Primitive, left_out: &mut Vec<String>) -> Found<()> {
    let splatting = Splatting::deserialize_from(extension)?;
    if primitive.mode != 0 {
        return Err("splats that are no points".into());
    }
    if let Some(other) = splatting.extensions.keys().next() {
        return Err(format!("its splats need {other}, which is not read; export them without"));
    }
    if !matches!(splatting.kernel.as_str(), "ellipse" | "") {
        return Err(format!("its kernel is \"{}\"; only \"ellipse\" is read", splatting.kernel));
    }
    if !matches!(splatting.color_space.as_str(), "srgb_rec709_display" | "BT.709" | "") {
        left_out.push(format!("the color space \"{}\": colors are read as sRGB", splatting.color_space));
    }
    Ok(())
}

impl Splatting {
    fn deserialize_from(value: &Value) -> Found<Splatting> {
        serde_json::from_value(value.clone()).map_err(|e| format!("{SPLATTING} is not as it must be: {e}"))
    }
}

/// Attributes of a primitive.
struct Attributes<'a> {
    document: &'a Document,
    buffers: &'a [Vec<u8>],
    primitive: &'a Primitive,
}

impl Attributes<'_> {
    fn count(&self) -> Found<usize> {
        let at = self.primitive.attributes.get("POSITION").ok_or("it has no POSITION")?;
        Ok(self.document.accessors.get(*at).ok_or_else(|| format!("there is no accessor {at}"))?.count)
    }

    /// Reads an optional attribute; returns an error unless every splat has a value.
    fn optional(&self, name: &str, wide: usize) -> Found<Option<Vec<f32>>> {
        let Some(at) = self.primitive.attributes.get(name) else { return Ok(None) };
        let accessor = self.document.accessors.get(*at).ok_or_else(|| format!("there is no accessor {at}"))?;
        let count = self.count()?;
        if accessor.count != count {
            return Err(format!("{name} has {} elements, but POSITION {count}", accessor.count));
        }
        buffer::numbers(self.document, self.buffers, accessor, wide).map(Some).map_err(|e| format!("{name}: {e}"))
    }

    fn need(&self, name: &str, wide: usize) -> Found<Vec<f32>> {
        self.optional(name, wide)?.ok_or_else(|| format!("it has no {name}, which splats need"))
    }

    /// Prefers stored raw values that match the standard attribute. `value` maps a raw value to the standard one, and
    /// `back` maps the standard value to a raw one.
    fn stored(
        &self,
        shown: Vec<f32>,
        raw: &str,
        wide: usize,
        value: impl Fn(f32) -> f64,
        back: impl Fn(f32) -> f32,
    ) -> Found<Vec<f32>> {
        let raw = self.optional(raw, wide)?.unwrap_or_default();
        let one = |(i, shown): (usize, f32)| match raw.get(i) {
            Some(raw) if agrees(shown, value(*raw)) => *raw,
            _ => back(shown),
        };
        Ok(shown.into_iter().enumerate().map(one).collect())
    }

    fn material(&self, name: &str, wide: usize, range: [f32; 2]) -> Found<Option<Vec<f32>>> {
        let Some(shown) = self.optional(&format!("_{name}"), wide)? else { return Ok(None) };
        let value = |raw| material(raw, range);
        self.stored(shown, &format!("_RAW_{name}"), wide, value, |v| unmaterial(v, range)).map(Some)
    }

    fn rotations(&self) -> Found<Vec<[f32; 4]>> {
        let shown = self.need(&format!("{SPLATTING}:ROTATION"), 4)?;
        let raw = self.optional("_RAW_ROTATION", 4)?.unwrap_or_default();
        let raw = raw.as_chunks::<4>().0;
        let one = |(i, q): (usize, &[f32; 4])| {
            let [x, y, z, w] = *q;
            let own = raw.get(i).filter(|raw| {
                let normalized = unit(**raw);
                [w, x, y, z].iter().zip(normalized).all(|(a, b)| (f64::from(*a) - b).abs() < 1e-6)
            });
            match own {
                Some(raw) => Ok(*raw),
                None if *q == [0.0; 4] => Err(format!("the rotation of splat {i} is a zero quaternion")),
                None => Ok([w, x, y, z]),
            }
        };
        shown.as_chunks::<4>().0.iter().enumerate().map(one).collect()
    }

    fn splats(&self) -> Found<Splats> {
        let triples = |v: Vec<f32>| v.as_chunks::<3>().0.to_vec();
        let scales = self.need(&format!("{SPLATTING}:SCALE"), 3)?;
        let log = |v: f32| v.max(1e-20).ln();
        let opacity = self.need(&format!("{SPLATTING}:OPACITY"), 1)?;
        let mut sh = [self.need(&sh_name(0, 0), 3)?, Vec::new(), Vec::new(), Vec::new()];
        for band in 1..4 {
            if self.primitive.attributes.contains_key(&sh_name(band, 0)) {
                sh[band] = self.band(band)?;
            } else {
                break;
            }
        }
        let mut semantic = Vec::new();
        while let Some(values) = self.optional(&format!("_SEMANTIC_{}", semantic.len()), 1)? {
            semantic.push(values);
        }
        let means = triples(self.need("POSITION", 3)?);
        let row = |i| semantic.iter().map(move |v: &Vec<f32>| v[i]);
        let semantic_rows: Vec<f32> = (0..means.len()).flat_map(row).collect();
        Ok(Splats {
            log_scales: triples(self.stored(scales, "_RAW_SCALE", 3, |v| f64::from(v).exp(), log)?),
            rotations: self.rotations()?,
            opacity_logits: self.stored(opacity, "_RAW_OPACITY", 1, logistic, |v| unlogistic(f64::from(v)))?,
            sh,
            normals: self.optional("_NORMAL", 3)?.map(triples),
            albedo: self.material("ALBEDO", 3, ALBEDO_RANGE)?.map(triples),
            roughness: self.material("ROUGHNESS", 1, ROUGHNESS_RANGE)?,
            metallic: self.material("METALLIC", 1, METALLIC_RANGE)?,
            semantic: (!semantic.is_empty()).then_some((semantic.len(), semantic_rows)),
            emitters: None,
            light_gains: None,
            antialiased: false,
            means,
        })
    }

    /// Reads a band of spherical harmonics, splat by splat.
    fn band(&self, band: usize) -> Found<Vec<f32>> {
        let wide = 2 * band + 1;
        let coefficients = (0..wide).map(|c| self.need(&sh_name(band, c), 3)).collect::<Found<Vec<_>>>()?;
        let mut out = Vec::with_capacity(coefficients[0].len() * wide);
        for i in 0..coefficients[0].len() / 3 {
            coefficients.iter().for_each(|c| out.extend(&c[3 * i..3 * i + 3]));
        }
        Ok(out)
    }
}

fn lights(document: &Document, placed: &[(usize, DMat4)], scene: &mut GltfScene) -> Found<()> {
    let Some(value) = document.extensions.get(LIGHTS) else { return Ok(()) };
    let all: Lights =
        serde_json::from_value(value.clone()).map_err(|e| format!("{LIGHTS} is not as it must be: {e}"))?;
    let mut others = 0;
    for (index, matrix) in placed {
        let Some(value) = document.nodes[*index].extensions.get(LIGHTS) else { continue };
        let node: NodeLight =
            serde_json::from_value(value.clone()).map_err(|e| format!("node {index}: {LIGHTS}: {e}"))?;
        let Some(light) = all.lights.get(node.light) else {
            return Err(format!("node {index}: there is no light {}", node.light));
        };
        let cone =
            PunctualKind::Spot { inner_angle: light.spot.inner_cone_angle, outer_angle: light.spot.outer_cone_angle };
        let kind = match light.kind.as_str() {
            "point" => PunctualKind::Point,
            "spot" => cone,
            "directional" => PunctualKind::Directional,
            _ => {
                others += 1;
                continue;
            }
        };
        let name = if light.name.is_empty() { &document.nodes[*index].name } else { &light.name };
        let mut light = punctual(light, kind, name, matrix).map_err(|e| format!("node {index}: {e}"))?;
        if let (Some(transform), true) = (&scene.transform, light.has_intensity()) {
            light.intensity /= (transform.scale * transform.scale) as f32;
        }
        scene.lights.push(light);
    }
    if others > 0 {
        scene.left_out.push(format!("{others} lights of unknown kinds"));
    }
    scene.light_extras = all.extras;
    Ok(())
}

fn punctual(light: &Light, kind: PunctualKind, name: &str, matrix: &DMat4) -> Found<PunctualLight> {
    let position = matrix.w_axis.truncate().as_vec3().to_array();
    let numbers = position.iter().chain(&light.color).chain([&light.intensity]);
    if numbers.clone().any(|v| !v.is_finite()) || light.intensity < 0.0 || light.color.iter().any(|v| *v < 0.0) {
        return Err("its light has a place, color or intensity that no light has".into());
    }
    let along = (-matrix.z_axis.truncate()).normalize_or_zero();
    if kind != PunctualKind::Point && along == DVec3::ZERO {
        return Err("its light has no direction, because the node is flat; scale it by more than 0".into());
    }
    Ok(PunctualLight {
        name: name.to_owned(),
        kind,
        position,
        direction: along.as_vec3().to_array(),
        color: light.color,
        intensity: light.intensity,
        extras: light.extras.clone(),
    })
}

impl GltfScene {
    /// Returns the splats if the file has one set and its transform is the identity.
    pub fn in_place(&self) -> Option<&Splats> {
        match &self.parts[..] {
            [(splats, place)] if *place == Placement::NONE => Some(splats),
            _ => None,
        }
    }
}
