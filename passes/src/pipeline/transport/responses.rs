//! Responses of a room to its emitters, whose light changes with each frame.
//!
//! A frame sums the responses by the colors of its emitters. Colors and places are uniforms of the frame: switching, dimming
//! and recoloring need neither a solve nor memory. A window has three parts, one per channel: each is a light of the passes.

use crate::Tuning;
use crate::transport::{
    AreaLight, AreaLights, GaussianEmitters, ResponseRadiosity, Responses, gaussian_emission, parts_of,
    response_radiosity, response_sum,
};
use sgs_engine::exec::Executor;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_engine::{Device, DeviceBuffer, Location, Result};
use sgs_shaders::structs::LightRecord;

/// Emitter in a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameEmitter {
    /// Shape, place and color; black if the emitter is off.
    pub light: AreaLight,
    /// Radiance of its visible surface.
    pub surface: [f32; 3],
}

impl FrameEmitter {
    /// Returns an emitter whose surface emits the color of its light.
    pub fn of(light: AreaLight) -> FrameEmitter {
        FrameEmitter { light, surface: light.color }
    }

    /// Converts lengths as [`AreaLight::scaled`].
    pub(crate) fn scaled(&self, factor: f32) -> FrameEmitter {
        FrameEmitter { light: self.light.scaled(factor), ..*self }
    }
}

/// Responses in device memory.
#[derive(Clone, Debug)]
pub(super) struct EmitterResponses {
    /// Bounced irradiance by part of color 1, `[parts * receivers * 3]`.
    memory: DeviceBuffer,
    /// Number of the emitter of each Gaussian.
    numbers: DeviceBuffer,
    direct: Option<DirectMemory>,
    shape: Shape,
}

/// Direct light and reflectance of receivers in device memory.
#[derive(Clone, Debug)]
struct DirectMemory {
    /// Irradiance by emitter of color 1, `[emitters * receivers]`.
    units: DeviceBuffer,
    /// `[receivers * 3]`.
    reflectance: DeviceBuffer,
}

/// Results of [`EmitterResponses::sum`].
#[derive(Clone, Copy, Debug)]
pub(super) struct Summed {
    /// Irradiance of receivers that bounces, `[receivers * 3]`.
    pub irradiance: Buffer,
    /// Radiance that Gaussians emit, `[Gaussians * 4]`.
    pub emission: Buffer,
    /// Radiosity of receivers, `[receivers * 3]`; needs direct light.
    pub radiosity: Option<Buffer>,
}

/// Sizes of the passes.
#[derive(Clone, Copy, Debug)]
struct Shape {
    emitters: u32,
    parts: u32,
    receivers: u32,
    gaussians: u32,
}

/// Handles of the emitters of a frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EmitterHandles {
    records: Buffer,
    pub(super) colors: Buffer,
    surfaces: Buffer,
    /// How many parts of emitters are on, and which.
    pub(super) list: Buffer,
}

/// Handles of the responses in a graph.
#[derive(Clone, Copy, Debug)]
pub(super) struct DeclaredResponses {
    pub emitters: EmitterHandles,
    memory: Buffer,
    numbers: Buffer,
    /// Direct light by emitter, and reflectance.
    direct: Option<(Buffer, Buffer)>,
}

/// Contents of the uniforms of a frame.
#[derive(Debug)]
pub(crate) struct FrameUniforms {
    records: Vec<LightRecord>,
    colors: Vec<[f32; 3]>,
    surfaces: Vec<[f32; 3]>,
    list: Vec<u32>,
}

impl FrameUniforms {
    /// Returns the uniforms of emitters in the unit of the scene.
    pub(crate) fn new(emitters: &[FrameEmitter]) -> FrameUniforms {
        let parts = parts_of(emitters.iter().map(|e| &e.light));
        let on: Vec<u32> = (0..).zip(&parts).filter(|(_, p)| p.color != [0.0; 3]).map(|(i, _)| i).collect();
        let mut list = vec![0; 1 + parts.len().max(1)];
        list[0] = on.len() as u32;
        list[1..=on.len()].copy_from_slice(&on);
        let mut all = FrameUniforms {
            records: parts.iter().map(|p| p.record).collect(),
            colors: parts.iter().map(|p| p.color).collect(),
            surfaces: emitters.iter().map(|e| e.surface).collect(),
            list,
        };
        if emitters.is_empty() {
            // A uniform cannot be empty.
            all.records.push(bytemuck::Zeroable::zeroed());
            (all.colors, all.surfaces) = (vec![[0.0; 3]], vec![[0.0; 3]]);
        }
        all
    }

    /// Returns the bytes of each uniform.
    pub(crate) fn of(&self, handles: &EmitterHandles) -> [(Buffer, &[u8]); 4] {
        [
            (handles.records, bytemuck::cast_slice(&self.records)),
            (handles.colors, bytemuck::cast_slice(&self.colors)),
            (handles.surfaces, bytemuck::cast_slice(&self.surfaces)),
            (handles.list, bytemuck::cast_slice(&self.list)),
        ]
    }
}

impl EmitterResponses {
    /// Uploads responses and the numbers of the Gaussians' emitters.
    ///
    /// Responses are `[parts * receivers * 3]` floats.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(
        device: &Device,
        emitters: &[FrameEmitter],
        responses: &[f32],
        numbers: &[u32],
        receivers: u32,
    ) -> Result<EmitterResponses> {
        let put = |name: &str, bytes: &[u8]| -> Result<DeviceBuffer> {
            let buffer = device.buffer(name, bytes.len().max(12) as u64, Location::Device)?;
            if !bytes.is_empty() {
                device.upload(&buffer, 0, bytes)?;
            }
            Ok(buffer)
        };
        let parts = parts_of(emitters.iter().map(|e| &e.light)).len() as u32;
        let emitters = emitters.len() as u32;
        Ok(EmitterResponses {
            memory: put("responses", bytemuck::cast_slice(responses))?,
            numbers: put("emitter_numbers", bytemuck::cast_slice(numbers))?,
            direct: None,
            shape: Shape { emitters, parts, receivers, gaussians: numbers.len() as u32 },
        })
    }

    /// Uploads direct light and reflectance, for the radiosity.
    ///
    /// `unit` holds `[parts * receivers]` floats, `reflectance` `[receivers * 3]`.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn set_direct(&mut self, device: &Device, unit: &[f32], reflectance: &[f32]) -> Result<()> {
        let put = |name: &str, values: &[f32]| -> Result<DeviceBuffer> {
            let buffer = device.buffer(name, (4 * values.len() as u64).max(4), Location::Device)?;
            if !values.is_empty() {
                device.upload(&buffer, 0, bytemuck::cast_slice(values))?;
            }
            Ok(buffer)
        };
        self.direct =
            Some(DirectMemory { units: put("direct_light", unit)?, reflectance: put("reflectance", reflectance)? });
        Ok(())
    }

    /// Returns the memory of direct light by emitter, if the radiosity is summed.
    pub fn direct(&self) -> Option<&DeviceBuffer> {
        self.direct.as_ref().map(|d| &d.units)
    }

    /// Returns the memory of the responses.
    pub fn memory(&self) -> &DeviceBuffer {
        &self.memory
    }

    /// Returns the number of emitters.
    pub fn emitters(&self) -> u32 {
        self.shape.emitters
    }

    /// Returns the number of parts of the emitters.
    pub fn parts(&self) -> u32 {
        self.shape.parts
    }

    /// Declares responses and uniforms.
    pub fn declare(&self, g: &mut Graph) -> DeclaredResponses {
        let room = u64::from(self.shape.parts.max(1));
        let emitters = EmitterHandles {
            records: g.uniform("emitter_records", size_of::<LightRecord>() as u64 * room),
            colors: g.uniform("emitter_colors", 12 * room),
            surfaces: g.uniform("emitter_surfaces", 12 * u64::from(self.shape.emitters.max(1))),
            list: g.uniform("emitter_list", 4 * (1 + room)),
        };
        DeclaredResponses {
            emitters,
            memory: g.input("responses", self.memory.bytes()),
            numbers: g.input("emitter_numbers", self.numbers.bytes()),
            direct: self
                .direct
                .as_ref()
                .map(|d| (g.input("direct_light", d.units.bytes()), g.input("reflectance", d.reflectance.bytes()))),
        }
    }

    /// Binds the responses.
    ///
    /// # Errors
    /// If the plan was compiled for other sizes.
    pub fn bind(&self, exec: &mut Executor, d: &DeclaredResponses) -> Result<()> {
        if let (Some(memory), Some((units, reflectance))) = (&self.direct, d.direct) {
            exec.bind(units, &memory.units)?;
            exec.bind(reflectance, &memory.reflectance)?;
        }
        exec.bind(d.memory, &self.memory)?;
        exec.bind(d.numbers, &self.numbers)
    }

    /// Returns the emitters as lights of the passes.
    pub fn lights(&self, d: &DeclaredResponses) -> AreaLights {
        AreaLights { records: d.emitters.records, colors: d.emitters.colors, count: self.shape.parts }
    }

    /// Adds the passes of irradiance, emission and radiosity.
    ///
    /// # Errors
    /// If the graph rejects a pass.
    pub fn sum(
        &self,
        g: &mut Graph,
        t: &Tuning,
        d: &DeclaredResponses,
        into: &Summed,
    ) -> std::result::Result<(), GraphError> {
        let Shape { emitters, parts, receivers, gaussians } = self.shape;
        let colors = d.emitters.colors;
        let a = Responses { lights: parts, receivers, responses: d.memory, colors };
        response_sum(g, t, &a, into.irradiance)?;
        let a = GaussianEmitters { gaussians, emitters, numbers: d.numbers, radiance: d.emitters.surfaces };
        gaussian_emission(g, t, &a, into.emission)?;
        if let (Some(radiosity), Some((unit, reflectance))) = (into.radiosity, d.direct) {
            let irradiance = into.irradiance;
            let a = ResponseRadiosity { lights: parts, receivers, unit, colors, irradiance, reflectance, radiosity };
            response_radiosity(g, t, &a)?;
        }
        Ok(())
    }
}
