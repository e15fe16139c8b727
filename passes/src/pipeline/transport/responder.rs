//! Responses of moved emitters, computed between frames.

use super::{ShadedTransport, TransportScene};
use crate::Tuning;
use crate::transport::{
    AreaLight, AreaLights, DirectLight, LightReceivers, MatrixRows, OutsideHandles, ResponseSource, Responses,
    Solution, SolveInputs, SolveOptions, SurfelHandles, response_source, response_store, transport_lights,
    transport_solve,
};
use sgs_engine::exec::{ExecOptions, Executor};
use sgs_engine::graph::{Buffer, CompileOptions, Graph};
use sgs_engine::{Device, Location, Result};
use sgs_shaders::structs::LightRecord;
use std::sync::Arc;

/// Number of updates in flight. Another one waits for the first of them.
const IN_FLIGHT: usize = 4;

/// Computes the response to one emitter again, without waiting for the device.
///
/// Frames that are submitted afterwards show it.
pub struct Responder {
    exec: Executor,
    record: Buffer,
    emitter: Buffer,
    /// First part of each emitter.
    parts: Vec<u32>,
}

impl Responder {
    /// Compiles the update for the emitters of a scene with responses. `reflectance` holds `[receivers * 3]` floats.
    ///
    /// # Errors
    /// If the scene has no responses, or memory runs out.
    pub fn new(device: &Device, tuning: Tuning, transport: &ShadedTransport, reflectance: &[f32]) -> Result<Responder> {
        let (scene, memory): (&TransportScene, _) = (transport.scene(), transport.response_memory());
        let receivers = scene.receivers();
        let mut g = Graph::new("respond");
        let record = g.uniform("emitter_record", size_of::<LightRecord>() as u64);
        let emitter = g.uniform("emitter", 4);
        let tree = SurfelHandles::declare(&mut g, scene.tree_shape());
        let outside = OutsideHandles::declare(&mut g, scene.outside_shape());
        let all = g.input("receivers", scene.receiver_memory().bytes());
        let matrix = MatrixRows { shape: scene.shape(), rows: g.input("matrix_rows", scene.row_memory().bytes()) };
        let of_reflectance = g.input("reflectance", 12 * u64::from(receivers));
        let responses = memory.map(|m| g.external("responses", m.bytes()));
        let direct = transport.direct_memory();
        let units = direct.map(|m| g.external("direct_light", m.bytes()));
        let unit = g.transient("unit", 4 * u64::from(receivers));
        // Colors have no effect on the irradiance of color 1.
        let lights = AreaLights { records: record, colors: record, count: 1 };
        let to = LightReceivers::Surfels { receivers: all, count: receivers };
        transport_lights(&mut g, tuning, &to, &lights, &scene.shadow_rays(tree, outside), None, unit)?;
        let [source, radiosity, irradiance] =
            ["source", "radiosity", "irradiance"].map(|name| g.transient(name, 12 * u64::from(receivers)));
        response_source(&mut g, &tuning, &ResponseSource { receivers, unit, reflectance: of_reflectance, source })?;
        let inputs = SolveInputs { matrix, lights: 1, reflectance: of_reflectance, source, initial: None };
        let into = Solution { radiosity, irradiance, convergence: g.transient("convergence", 8) };
        transport_solve(&mut g, &tuning, &inputs, &SolveOptions::default(), &into)?;
        if let Some(responses) = responses {
            let a = Responses { lights: transport.emitter_parts(), receivers, responses, colors: record };
            let direct = units.map(|units| DirectLight { unit, units });
            response_store(&mut g, &tuning, &a, emitter, irradiance, direct.as_ref())?;
        }
        let plan = Arc::new(g.compile(&CompileOptions::default())?);
        let options = ExecOptions { frames_in_flight: IN_FLIGHT, ..Default::default() };
        let mut exec = Executor::new(device, plan, options)?;
        let buffer = device.buffer("reflectance", 12 * u64::from(receivers), Location::Device)?;
        device.upload(&buffer, 0, bytemuck::cast_slice(reflectance))?;
        scene.tree().bind(&mut exec, &tree)?;
        scene.outside().bind(&mut exec, &outside)?;
        exec.bind(all, scene.receiver_memory())?;
        exec.bind(matrix.rows, scene.row_memory())?;
        exec.bind(of_reflectance, &buffer)?;
        if let (Some(handle), Some(memory)) = (responses, memory) {
            exec.bind(handle, memory)?;
        }
        if let (Some(handle), Some(memory)) = (units.filter(|_| responses.is_some()), direct) {
            exec.bind(handle, memory)?;
        }
        let parts = (0..transport.emitters()).map(|i| transport.first_part(i)).collect();
        Ok(Responder { exec, record, emitter, parts })
    }

    /// Submits the update of one emitter, in the unit of the scene.
    ///
    /// # Errors
    /// If the device fails.
    pub fn update(&mut self, emitter: u32, light: &AreaLight) -> Result<()> {
        let Some(first) = self.parts.get(emitter as usize) else { return Ok(()) };
        for (index, part) in (*first..).zip(light.parts()) {
            let uniforms =
                [(self.record, bytemuck::bytes_of(&part.record)), (self.emitter, bytemuck::bytes_of(&index))];
            self.exec.submit(&uniforms)?;
        }
        Ok(())
    }
}
