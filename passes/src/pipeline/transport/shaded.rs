//! Light of physical lights and of bounces, as shading reads it.

use super::responses::{DeclaredResponses, EmitterResponses, Summed};
use super::{EmitterHandles, FrameEmitter, FrameUniforms, TransportOptions, TransportScene};
use crate::Tuning;
use crate::shade::{PixelMaterials, Pixels, Rows, materials};
use crate::transport::{
    AreaLight, AreaLights, GatherInputs, LightReceivers, NEIGHBORS, Nearest, OutsideHandles, OutsideShape, ShadeTerms,
    SurfelHandles, SurfelMemory, SurfelTreeShape, TransportShading, irradiance_gather, parts_of, reflection_bytes,
    split_sum_table, transport_lights, transport_reflect, transport_shade,
};
use sgs_engine::exec::Executor;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_engine::{Device, DeviceBuffer, Location, Result};
use std::sync::Arc;

/// Physical lights and bounced light of a scene, in device memory. Lengths are in the scene's unit.
#[derive(Clone, Debug)]
pub struct ShadedTransport {
    scene: Arc<TransportScene>,
    lights: Vec<AreaLight>,
    light_memory: [DeviceBuffer; 2],
    gaussians: u32,
    neighbors: [DeviceBuffer; 2],
    irradiance: DeviceBuffer,
    /// Radiosity that pixels reflect. Responses sum it themselves.
    radiosity: Option<DeviceBuffer>,
    emission: DeviceBuffer,
    log_gains: Option<DeviceBuffer>,
    split_sum: DeviceBuffer,
    /// Responses to emitters whose light changes; then `irradiance`, `emission` and the colors are not used.
    responses: Option<EmitterResponses>,
    /// Emitters of frames that bring none, in the unit of the scene.
    emitters: Vec<FrameEmitter>,
}

/// Properties of which a plan depends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ShadedShape {
    tree: SurfelTreeShape,
    outside: OutsideShape,
    options: TransportOptions,
    /// Receivers, parts of lights, Gaussians.
    counts: [u32; 3],
    /// Whether the light changes with each frame.
    responses: bool,
    /// Whether the Gaussians have gains.
    gains: bool,
    /// Whether pixels reflect receivers.
    reflections: bool,
}

/// Handles of a [`ShadedTransport`] in a graph.
#[derive(Debug)]
pub(crate) struct Declared {
    tree: SurfelHandles,
    outside: OutsideHandles,
    lights: AreaLights,
    neighbors: [Buffer; 2],
    irradiance: Buffer,
    /// Radiosity of receivers that pixels reflect.
    radiosity: Option<Buffer>,
    emission: Buffer,
    log_gains: Option<Buffer>,
    split_sum: Buffer,
    responses: Option<DeclaredResponses>,
}

impl Declared {
    /// Returns the emitters of each frame, if their light changes.
    pub(crate) fn emitters(&self) -> Option<EmitterHandles> {
        self.responses.as_ref().map(|r| r.emitters)
    }
}

/// Terms of the light of a view, `[pixels * 3]` floats each.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Terms {
    /// Diffuse, specular, indirect, emission.
    pub each: [Buffer; 4],
}

impl ShadedTransport {
    /// Uploads lights, the irradiance that bounces, and emission.
    ///
    /// `irradiance` holds `[receivers * 3]` floats; `nearest` the surfels of each Gaussian; `emission` the emitted radiance of
    /// each Gaussian. Lights must be valid ([`AreaLight::check`]).
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(
        device: &Device,
        scene: Arc<TransportScene>,
        lights: &[AreaLight],
        nearest: &Nearest,
        irradiance: &[f32],
        emission: &[[f32; 3]],
    ) -> Result<ShadedTransport> {
        let put = |name: &str, bytes: &[u8]| -> Result<DeviceBuffer> {
            let buffer = device.buffer(name, bytes.len().max(4) as u64, Location::Device)?;
            if !bytes.is_empty() {
                device.upload(&buffer, 0, bytes)?;
            }
            Ok(buffer)
        };
        // This graph never runs. Its handles only label the contents.
        let mut g = Graph::new("lights");
        let declared = AreaLights::declare(&mut g, parts_of(lights).len() as u32);
        let [(_, records), (_, colors)] = declared.contents(lights);
        let (_, table) = split_sum_table(&mut g);
        let emitted: Vec<f32> = emission.iter().flat_map(|[r, g, b]| [*r, *g, *b, 0.0]).collect();
        Ok(ShadedTransport {
            light_memory: [put("light_records", &records)?, put("light_colors", &colors)?],
            gaussians: emission.len() as u32,
            neighbors: [
                put("neighbors", bytemuck::cast_slice(&nearest.neighbors))?,
                put("neighbor_weights", bytemuck::cast_slice(&nearest.weights))?,
            ],
            irradiance: put("irradiance", bytemuck::cast_slice(irradiance))?,
            radiosity: None,
            emission: put("emission", bytemuck::cast_slice(&emitted))?,
            log_gains: None,
            split_sum: put("split_sum", &table)?,
            lights: lights.to_vec(),
            responses: None,
            emitters: Vec::new(),
            scene,
        })
    }

    /// Sets the logarithm of each Gaussian's gain on the light that arrives. Without it gains are 1.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn with_gains(mut self, device: &Device, log_gains: &[f32]) -> Result<ShadedTransport> {
        let buffer = device.buffer("log_gains", (4 * log_gains.len()).max(4) as u64, Location::Device)?;
        if !log_gains.is_empty() {
            device.upload(&buffer, 0, bytemuck::cast_slice(log_gains))?;
        }
        self.log_gains = Some(buffer);
        Ok(self)
    }

    /// Sets the radiosity of receivers, which pixels then reflect.
    ///
    /// It is a radiance, `[receivers * 3]` floats. Without it, specular lobes reflect the gathered irradiance.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn with_radiosity(mut self, device: &Device, radiosity: &[f32]) -> Result<ShadedTransport> {
        let buffer = device.buffer("radiosity", (4 * radiosity.len() as u64).max(4), Location::Device)?;
        if !radiosity.is_empty() {
            device.upload(&buffer, 0, bytemuck::cast_slice(radiosity))?;
        }
        self.radiosity = Some(buffer);
        Ok(self)
    }

    /// Lets pixels reflect receivers, for emitters whose light changes with each frame.
    ///
    /// `unit` holds the direct irradiance by each part of the emitters, of color 1, `[parts * receivers]` floats; `reflectance`
    /// `[receivers * 3]`. Without responses it changes nothing.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn with_direct_light(mut self, device: &Device, unit: &[f32], reflectance: &[f32]) -> Result<ShadedTransport> {
        if let Some(responses) = &mut self.responses {
            responses.set_direct(device, unit, reflectance)?;
        }
        Ok(self)
    }

    /// Uploads emitters whose light changes with each frame.
    ///
    /// `responses` holds the irradiance that bounces by each part of the emitters of color 1, `[parts * receivers * 3]` floats;
    /// `numbers` the emitter of each Gaussian, from 1, or 0. Emitters have the unit of the scene.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn with_responses(
        device: &Device,
        scene: Arc<TransportScene>,
        emitters: &[FrameEmitter],
        nearest: &Nearest,
        responses: &[f32],
        numbers: &[u32],
    ) -> Result<ShadedTransport> {
        let lights: Vec<AreaLight> = emitters.iter().map(|e| e.light).collect();
        let responses = EmitterResponses::new(device, emitters, responses, numbers, scene.receivers())?;
        let plain = ShadedTransport::new(device, scene, &lights, nearest, &[], &[])?;
        Ok(ShadedTransport {
            gaussians: numbers.len() as u32,
            responses: Some(responses),
            emitters: emitters.to_vec(),
            ..plain
        })
    }

    /// Returns the surfels and their matrix.
    pub(super) fn scene(&self) -> &TransportScene {
        &self.scene
    }

    /// Returns the memory of the responses.
    pub(super) fn response_memory(&self) -> Option<&DeviceBuffer> {
        self.responses.as_ref().map(EmitterResponses::memory)
    }

    /// Returns the memory of the direct light by emitter, if pixels reflect receivers.
    pub(super) fn direct_memory(&self) -> Option<&DeviceBuffer> {
        self.responses.as_ref().and_then(EmitterResponses::direct)
    }

    /// Returns whether pixels reflect receivers.
    fn reflections(&self) -> bool {
        self.responses.as_ref().map_or(self.radiosity.is_some(), |r| r.direct().is_some())
    }

    /// Returns the index of the first part of an emitter.
    pub(super) fn first_part(&self, emitter: u32) -> u32 {
        parts_of(self.lights.iter().take(emitter as usize)).len() as u32
    }

    /// Returns the number of parts of the emitters whose light changes with each frame.
    pub(super) fn emitter_parts(&self) -> u32 {
        self.responses.as_ref().map_or(0, EmitterResponses::parts)
    }

    /// Returns the number of emitters whose light changes with each frame.
    pub fn emitters(&self) -> u32 {
        self.responses.as_ref().map_or(0, EmitterResponses::emitters)
    }

    /// Sets the emitters of frames that bring none, in the unit of the scene. Their number must not change.
    pub(crate) fn set_emitters(&mut self, emitters: Vec<FrameEmitter>) {
        self.emitters = emitters;
    }

    /// Returns the uniforms of frames that bring no emitters.
    pub(crate) fn uniforms(&self) -> FrameUniforms {
        FrameUniforms::new(&self.emitters)
    }

    /// Returns what a plan depends on.
    pub(crate) fn shape(&self) -> ShadedShape {
        ShadedShape {
            tree: *self.scene.tree_shape(),
            outside: self.scene.outside_shape(),
            options: *self.scene.options(),
            counts: [self.scene.receivers(), parts_of(&self.lights).len() as u32, self.gaussians],
            responses: self.responses.is_some(),
            gains: self.log_gains.is_some(),
            reflections: self.reflections(),
        }
    }

    /// Returns the physical lights.
    pub fn lights(&self) -> &[AreaLight] {
        &self.lights
    }

    /// Declares all inputs.
    pub(crate) fn declare(&self, g: &mut Graph) -> Declared {
        let shape: &SurfelTreeShape = self.scene.tree_shape();
        let n = u64::from(self.gaussians.max(1));
        let responses = self.responses.as_ref().map(|r| r.declare(g));
        let three = 12 * u64::from(self.scene.receivers());
        let (lights, irradiance, radiosity, emission) = match (&self.responses, &responses) {
            (Some(r), Some(declared)) => (
                r.lights(declared),
                g.transient("receiver_irradiance", three),
                r.direct().map(|_| g.transient("radiosity", three)),
                g.transient("gaussian_emission", 16 * n),
            ),
            _ => (
                AreaLights::declare(g, parts_of(&self.lights).len() as u32),
                g.input("receiver_irradiance", self.irradiance.bytes()),
                self.radiosity.as_ref().map(|r| g.input("radiosity", r.bytes())),
                g.input("gaussian_emission", 16 * n),
            ),
        };
        Declared {
            tree: SurfelHandles::declare(g, shape),
            outside: OutsideHandles::declare(g, self.scene.outside_shape()),
            lights,
            neighbors: ["neighbors", "neighbor_weights"].map(|name| g.input(name, 4 * NEIGHBORS as u64 * n)),
            irradiance,
            radiosity,
            emission,
            log_gains: self.log_gains.as_ref().map(|_| g.input("log_gains", 4 * n)),
            split_sum: g.input("split_sum", self.split_sum.bytes()),
            responses,
        }
    }

    /// Binds all inputs.
    ///
    /// # Errors
    /// If the plan was compiled for other sizes.
    pub(crate) fn bind(&self, exec: &mut Executor, d: &Declared) -> Result<()> {
        let tree: &SurfelMemory = self.scene.tree();
        tree.bind(exec, &d.tree)?;
        self.scene.outside().bind(exec, &d.outside)?;
        exec.bind(d.neighbors[0], &self.neighbors[0])?;
        exec.bind(d.neighbors[1], &self.neighbors[1])?;
        exec.bind(d.split_sum, &self.split_sum)?;
        if let (Some(handle), Some(buffer)) = (d.log_gains, &self.log_gains) {
            exec.bind(handle, buffer)?;
        }
        if let (Some(responses), Some(declared)) = (&self.responses, &d.responses) {
            return responses.bind(exec, declared);
        }
        exec.bind(d.lights.records, &self.light_memory[0])?;
        exec.bind(d.lights.colors, &self.light_memory[1])?;
        exec.bind(d.irradiance, &self.irradiance)?;
        if let (Some(handle), Some(buffer)) = (d.radiosity, &self.radiosity) {
            exec.bind(handle, buffer)?;
        }
        exec.bind(d.emission, &self.emission)
    }

    /// Adds the passes that shade a view; writes the terms. Returns their sum, `[pixels * 3]` floats.
    ///
    /// # Errors
    /// If the graph rejects a pass.
    pub(crate) fn shade(
        &self,
        g: &mut Graph,
        t: &Tuning,
        d: &Declared,
        (pixels, rows): (&Pixels, Rows),
        terms: &Terms,
    ) -> std::result::Result<Buffer, GraphError> {
        let (screen, count) = (pixels.screen, pixels.screen.pixels());
        let list = d.emitters().map(|e| e.list);
        if let (Some(responses), Some(declared)) = (&self.responses, &d.responses) {
            let into = Summed { irradiance: d.irradiance, emission: d.emission, radiosity: d.radiosity };
            responses.sum(g, t, declared, &into)?;
        }
        let values = g.transient("gaussian_irradiance", 16 * u64::from(self.gaussians.max(1)));
        let gather = GatherInputs {
            gaussians: self.gaussians,
            receivers: self.scene.receivers(),
            lights: 1,
            neighbors: d.neighbors[0],
            weights: d.neighbors[1],
            irradiance: d.irradiance,
            log_gains: d.log_gains,
        };
        irradiance_gather(g, t, &gather, values)?;
        let blended = |g: &mut Graph, name: &str, bytes: u64, values: Buffer| {
            let into = g.transient(name, bytes);
            let plain = |buffer| PixelMaterials { materials: buffer, metallic: None };
            materials(g, t, &screen, &plain(values), rows, &plain(into)).map(|()| into)
        };
        let bytes = if d.radiosity.is_some() { reflection_bytes(count) } else { 16 * count };
        let irradiance = blended(g, "pixel_irradiance", bytes, values)?;
        let emission = blended(g, "pixel_emission", 16 * count, d.emission)?;
        if let Some(radiosity) = d.radiosity {
            transport_reflect(g, t, pixels, &self.scene.reflection_rays(d.tree, radiosity), irradiance)?;
        }
        let unit = g.transient("unit_light", 4 * count * u64::from(d.lights.count.max(1)));
        let rays = self.scene.shadow_rays(d.tree, d.outside);
        let to = LightReceivers::Pixels { screen, surfaces: pixels.surfaces };
        g.fill("clear_unit_light", unit, 0)?;
        transport_lights(g, *t, &to, &d.lights, &rays, list, unit)?;
        let shading = TransportShading {
            pixels: *pixels,
            lights: d.lights,
            unit,
            irradiance,
            reflections: d.radiosity.is_some(),
            emission: Some(emission),
            split_sum: d.split_sum,
        };
        let radiance = g.transient("transport_radiance", 12 * count);
        let [diffuse, specular, indirect, emission] = terms.each;
        transport_shade(g, *t, &shading, radiance, Some(&ShadeTerms { diffuse, specular, indirect, emission }))?;
        Ok(radiance)
    }
}
