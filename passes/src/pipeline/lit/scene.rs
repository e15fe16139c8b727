//! What is shaded, and the surroundings as surfaces see them.

use crate::Tuning;
use crate::pipeline::{ShadedEnvironment, ShadedScene};
use crate::shade::environment::{Environment, environment_filter};
use sgs_engine::graph::exec::{ExecOptions, Executor};
use sgs_engine::graph::{CompileOptions, Graph};
use sgs_engine::{Device, DeviceBuffer, Location, Result};
use std::sync::Arc;

/// Everything that shades, but lamps: these come with each frame.
#[derive(Debug)]
pub struct LitScene {
    /// Geometry, materials and the visibility field; its lamps are not used, and neither are its surroundings.
    pub scene: ShadedScene,
    /// The surroundings.
    pub environment: Option<LitEnvironment>,
}

/// Surroundings that were filtered once. They do not change: others take their place, while frames under way keep these.
#[derive(Debug)]
pub struct LitEnvironment {
    /// Tables and texels.
    pub(super) given: ShadedEnvironment,
    /// All levels.
    pub(super) radiance: DeviceBuffer,
}

impl LitScene {
    /// Filters the surroundings of a scene (waits for the device).
    ///
    /// # Errors
    /// If memory runs out or the device fails.
    pub fn new(device: &Device, tuning: &Tuning, mut scene: ShadedScene) -> Result<LitScene> {
        scene.lights = None;
        let given = scene.environment.take();
        let environment = given.map(|e| LitEnvironment::new(device, tuning, e)).transpose()?;
        Ok(LitScene { scene, environment })
    }
}

impl LitEnvironment {
    /// Filters surroundings (waits for the device).
    ///
    /// # Errors
    /// If memory runs out or the device fails.
    pub fn new(device: &Device, tuning: &Tuning, given: ShadedEnvironment) -> Result<LitEnvironment> {
        let mut g = Graph::new("surroundings");
        let tables = given.tables.declare(&mut g);
        let texels = given.texels.declare(&mut g, false);
        let bytes = 12 * u64::from(given.tables.filtered_texels());
        let kept = g.external("environment_radiance", bytes);
        let filtered = environment_filter(&mut g, tuning, &given.tables, &tables, texels.parameters)?;
        g.copy("keep_radiance", filtered.radiance, kept)?;
        let radiance = device.buffer("environment_radiance", bytes, Location::Device)?;
        let plan = Arc::new(g.compile(&CompileOptions::default())?);
        let mut exec = Executor::new(device, plan, ExecOptions { frames_in_flight: 1, ..Default::default() })?;
        exec.bind(kept, &radiance)?;
        given.texels.bind(&mut exec, &texels)?;
        given.memory.bind(&mut exec, &given.tables, &tables)?;
        exec.submit(&[])?;
        exec.finish()?;
        Ok(LitEnvironment { given, radiance })
    }

    /// Its levels and tables.
    pub fn tables(&self) -> &Environment {
        &self.given.tables
    }
}
