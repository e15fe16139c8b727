//! Light of physical lights and of bounces, as shading reads it.

use super::TransportScene;
use crate::Tuning;
use crate::shade::{PixelMaterials, Pixels, Rows, materials};
use crate::transport::{
    AreaLight, AreaLights, GatherInputs, LightReceivers, NEIGHBORS, Nearest, ShadeTerms, ShadowRays, SurfelHandles,
    SurfelMemory, SurfelTreeShape, TransportShading, irradiance_gather, split_sum_table, transport_lights,
    transport_shade,
};
use sgs_engine::exec::Executor;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_engine::{Device, DeviceBuffer, Location, Result};
use std::sync::Arc;

/// Physical lights and bounced light of a scene, in device memory. Lengths are in the scene's unit.
#[derive(Debug)]
pub struct ShadedTransport {
    scene: Arc<TransportScene>,
    lights: Vec<AreaLight>,
    light_memory: [DeviceBuffer; 2],
    gaussians: u32,
    neighbors: [DeviceBuffer; 2],
    irradiance: DeviceBuffer,
    emission: DeviceBuffer,
    split_sum: DeviceBuffer,
}

/// Handles of a [`ShadedTransport`] in a graph.
#[derive(Debug)]
pub(crate) struct Declared {
    tree: SurfelHandles,
    lights: AreaLights,
    neighbors: [Buffer; 2],
    irradiance: Buffer,
    emission: Buffer,
    split_sum: Buffer,
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
        let declared = AreaLights::declare(&mut g, lights.len() as u32);
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
            emission: put("emission", bytemuck::cast_slice(&emitted))?,
            split_sum: put("split_sum", &table)?,
            lights: lights.to_vec(),
            scene,
        })
    }

    /// Returns the physical lights.
    pub fn lights(&self) -> &[AreaLight] {
        &self.lights
    }

    /// Declares all inputs.
    pub(crate) fn declare(&self, g: &mut Graph) -> Declared {
        let shape: &SurfelTreeShape = self.scene.tree_shape();
        let n = u64::from(self.gaussians.max(1));
        Declared {
            tree: SurfelHandles::declare(g, shape),
            lights: AreaLights::declare(g, self.lights.len() as u32),
            neighbors: ["neighbors", "neighbor_weights"].map(|name| g.input(name, 4 * NEIGHBORS as u64 * n)),
            irradiance: g.input("receiver_irradiance", self.irradiance.bytes()),
            emission: g.input("gaussian_emission", 16 * n),
            split_sum: g.input("split_sum", self.split_sum.bytes()),
        }
    }

    /// Binds all inputs.
    ///
    /// # Errors
    /// If the plan was compiled for other sizes.
    pub(crate) fn bind(&self, exec: &mut Executor, d: &Declared) -> Result<()> {
        let tree: &SurfelMemory = self.scene.tree();
        tree.bind(exec, &d.tree)?;
        exec.bind(d.lights.records, &self.light_memory[0])?;
        exec.bind(d.lights.colors, &self.light_memory[1])?;
        exec.bind(d.neighbors[0], &self.neighbors[0])?;
        exec.bind(d.neighbors[1], &self.neighbors[1])?;
        exec.bind(d.irradiance, &self.irradiance)?;
        exec.bind(d.emission, &self.emission)?;
        exec.bind(d.split_sum, &self.split_sum)
    }

    /// Adds the passes that shade a view; writes the terms.
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
    ) -> std::result::Result<(), GraphError> {
        let (screen, count) = (pixels.screen, pixels.screen.pixels());
        let values = g.transient("gaussian_irradiance", 16 * u64::from(self.gaussians.max(1)));
        let gather = GatherInputs {
            gaussians: self.gaussians,
            receivers: self.scene.receivers(),
            lights: 1,
            neighbors: d.neighbors[0],
            weights: d.neighbors[1],
            irradiance: d.irradiance,
        };
        irradiance_gather(g, t, &gather, values)?;
        let blended = |g: &mut Graph, name: &str, values: Buffer| {
            let into = g.transient(name, 16 * count);
            let plain = |buffer| PixelMaterials { materials: buffer, metallic: None };
            materials(g, t, &screen, &plain(values), rows, &plain(into)).map(|()| into)
        };
        let irradiance = blended(g, "pixel_irradiance", values)?;
        let emission = blended(g, "pixel_emission", d.emission)?;
        let unit = g.transient("unit_light", 4 * count * self.lights.len().max(1) as u64);
        let rays: ShadowRays = self.scene.shadow_rays(d.tree);
        let to = LightReceivers::Pixels { screen, surfaces: pixels.surfaces };
        g.fill("clear_unit_light", unit, 0)?;
        transport_lights(g, *t, &to, &d.lights, &rays, None, unit)?;
        let shading = TransportShading {
            pixels: *pixels,
            lights: d.lights,
            unit,
            irradiance,
            emission: Some(emission),
            split_sum: d.split_sum,
        };
        let radiance = g.transient("transport_radiance", 12 * count);
        let [diffuse, specular, indirect, emission] = terms.each;
        transport_shade(g, *t, &shading, radiance, Some(&ShadeTerms { diffuse, specular, indirect, emission }))
    }
}
