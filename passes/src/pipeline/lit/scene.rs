//! Scene of a shaded view, and its filtered environment map.

use crate::Tuning;
use crate::pipeline::{ShadedEnvironment, ShadedScene};
use crate::shade::environment::{Environment, environment_filter};
use sgs_engine::exec::{ExecOptions, Executor};
use sgs_engine::graph::{CompileOptions, Graph};
use sgs_engine::{Device, DeviceBuffer, Location, Result};
use std::sync::Arc;

/// Shading inputs without lights, which come with each frame.
#[derive(Debug)]
pub struct LitScene {
    /// Geometry, materials, visibility and responses to emitters; its lights and its environment map are not used.
    pub scene: ShadedScene,
    /// Filtered environment map.
    pub environment: Option<LitEnvironment>,
}

/// Environment map that was filtered once and does not change.
///
/// Another one may replace it; frames in flight still use this one.
#[derive(Debug)]
pub struct LitEnvironment {
    /// Tables and texels.
    pub(super) source: ShadedEnvironment,
    /// Radiance of all mip levels.
    pub(super) radiance: DeviceBuffer,
}

impl LitScene {
    /// Filters the environment map of a scene (waits for the device).
    ///
    /// # Errors
    /// If memory runs out or the device fails.
    pub fn new(device: &Device, tuning: &Tuning, mut scene: ShadedScene) -> Result<LitScene> {
        scene.lights = None;
        let source = scene.environment.take();
        let environment = source.map(|e| LitEnvironment::new(device, tuning, e)).transpose()?;
        Ok(LitScene { scene, environment })
    }
}

impl LitEnvironment {
    /// Filters an environment map (waits for the device).
    ///
    /// # Errors
    /// If memory runs out or the device fails.
    pub fn new(device: &Device, tuning: &Tuning, source: ShadedEnvironment) -> Result<LitEnvironment> {
        let mut g = Graph::new("environment");
        let tables = source.tables.declare(&mut g);
        let texels = source.texels.declare(&mut g, false);
        let bytes = 12 * u64::from(source.tables.filtered_texels());
        let stored = g.external("environment_radiance", bytes);
        let filtered = environment_filter(&mut g, tuning, &source.tables, &tables, texels.parameters)?;
        g.copy("keep_radiance", filtered.radiance, stored)?;
        let radiance = device.buffer("environment_radiance", bytes, Location::Device)?;
        let plan = Arc::new(g.compile(&CompileOptions::default())?);
        let mut exec = Executor::new(device, plan, ExecOptions { frames_in_flight: 1, ..Default::default() })?;
        exec.bind(stored, &radiance)?;
        source.texels.bind(&mut exec, &texels)?;
        source.memory.bind(&mut exec, &source.tables, &tables)?;
        exec.submit(&[])?;
        exec.finish()?;
        Ok(LitEnvironment { source, radiance })
    }

    /// Returns the mip levels and filter tables.
    pub fn tables(&self) -> &Environment {
        &self.source.tables
    }
}
