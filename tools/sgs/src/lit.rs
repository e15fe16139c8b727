//! Channels of materials and light of a run: its lights, or its emitters with their bounces.

use crate::failure::refuse_usage;
use crate::images::{self, Format, Part, check_materials, light_of_source};
use crate::video::Video;
use crate::viewpoints::ViewpointArgs;
use anyhow::bail;
use sgs_config::Settings;
use sgs_engine::Device;
use sgs_passes::pipeline::FrameEmitter;
use sgs_passes::transport::AreaLight;
use sgs_relight::Emitting;
use sgs_run::{EmitterFile, RunDirectory, RunLight, Shading, Visibility, read_emitters, shaded_scene};
use sgs_scene::{Camera, Image, Scene, Splats, names_exr_layer, write_exr_layers};
use std::path::{Path, PathBuf};

/// Request of channels.
pub struct WantedLight<'a> {
    /// Run directory, or a PLY or glTF file.
    pub source: &'a Path,
    /// Channels of materials and light.
    pub parts: Vec<Part>,
    /// Whether each light is rendered by itself.
    pub each: bool,
}

/// Requested channels, with the light of the source.
pub struct Light {
    parts: Vec<Part>,
    each: bool,
    from: LightSource,
}

enum LightSource {
    /// Lights and environment map, as published.
    Published(RunLight),
    /// Emitters, with the run and the scene from whose views their room is built.
    Emitters { run: RunDirectory, scene: Box<Scene>, seed: u64 },
}

impl Light {
    /// Returns the request; `None` if no channel of materials or light is requested.
    pub fn of(
        wanted: WantedLight<'_>,
        viewpoints: &ViewpointArgs,
        splats: &Splats,
        settings: Option<&Settings>,
    ) -> anyhow::Result<Option<Light>> {
        let WantedLight { source: path, parts, each } = wanted;
        let source = path.display();
        if parts.is_empty() && !each {
            return Ok(None);
        }
        check_materials(path, splats, parts.contains(&Part::Metallic))?;
        let lit = parts.iter().find(|p| p.is_light());
        if let (Some(settings), true) = (settings, lit.is_some() || each) {
            let run = RunDirectory::open(path)?;
            if run.emitters().is_file() {
                if parts.contains(&Part::Visibility) {
                    refuse_usage!("\"{source}\" is lit by emitters; leave \"visibility\" out of --channels.");
                }
                if each {
                    check_names(path, &read_emitters(&run.emitters())?)?;
                }
                let scene = Box::new(viewpoints.open_scene(path, Some(settings))?);
                let from = LightSource::Emitters { run, scene, seed: settings.seed };
                return Ok(Some(Light { parts, each, from }));
            }
        }
        let light = light_of_source(path, settings)?;
        if let (Some(part), None, None) = (lit, &light.lights, &light.environment) {
            let name = part.name();
            refuse_usage!(
                "\"{source}\" has materials but neither lights nor an environment; leave \"{name}\" out of --channels."
            );
        }
        if parts.contains(&Part::Visibility) && (matches!(light.visibility, Visibility::None) || light.lights.is_none())
        {
            refuse_usage!("\"{source}\" has no visibility of lights; leave \"visibility\" out of --channels.");
        }
        if each && light.lights.is_none() {
            refuse_usage!("\"{source}\" has no lights; leave out --lights.");
        }
        Ok(Some(Light { parts, each, from: LightSource::Published(light) }))
    }

    /// Uploads the scene. For emitters, builds the room and solves the bounces of each.
    pub fn ready(self, device: &Device, splats: &Splats) -> anyhow::Result<Lit> {
        let Light { parts, each, from } = self;
        let (scene, lights) = match from {
            LightSource::Published(RunLight { lights, environment, visibility }) => {
                let scene = shaded_scene(device, splats, lights.as_ref(), environment.as_ref(), &visibility)?;
                (scene, Lights::Gains(lights.iter().flat_map(|l| &l.lights).map(|l| l.gain).collect()))
            }
            LightSource::Emitters { run, scene, seed } => {
                let Some(emitting) = Emitting::open(device, &run, &scene, splats, seed)? else {
                    bail!("\"{}\" has no emitters.json.", run.path("").display());
                };
                let names = emitting.file.emitters.iter().map(|e| e.name.clone()).collect();
                (emitting.live(device, splats)?, Lights::Emitters { names, frame: emitting.frame() })
            }
        };
        let mut shading = Shading::new(device, scene)?;
        if !parts.contains(&Part::Visibility) {
            shading = shading.without_visibility();
        }
        Ok(Lit { parts, each, lights, shading })
    }
}

/// Refuses emitters that cannot be the layers of an image.
fn check_names(source: &Path, file: &EmitterFile) -> anyhow::Result<()> {
    let source = source.display();
    if file.emitters.is_empty() {
        refuse_usage!("\"{source}\" has no emitters; leave out --lights.");
    }
    if let Some(bad) = file.emitters.iter().find(|e| !names_exr_layer(&e.name)) {
        refuse_usage!(
            "The emitter \"{}\" cannot name a layer; rename it in emitters.json with Latin letters.",
            bad.name
        );
    }
    Ok(())
}

/// Shading of the requested channels.
pub struct Lit {
    parts: Vec<Part>,
    each: bool,
    lights: Lights,
    shading: Shading,
}

enum Lights {
    /// Gain of each light.
    Gains(Vec<f32>),
    /// Emitters with their names.
    Emitters { names: Vec<String>, frame: Vec<FrameEmitter> },
}

/// Destination of images.
pub struct LightFiles<'a> {
    /// Directory; no files without one.
    pub directory: Option<&'a Path>,
    /// Format of files, except those of emitters.
    pub format: Format,
    /// Display-referred background of all light.
    pub background: [f32; 3],
}

impl Lit {
    /// Writes the requested images; returns their paths.
    pub fn write(
        &mut self,
        device: &Device,
        to: &LightFiles<'_>,
        camera: &Camera,
        mut video: Option<&mut Video>,
    ) -> anyhow::Result<Vec<PathBuf>> {
        let mut written = Vec::new();
        let stem = &camera.name;
        if !self.parts.is_empty() {
            let shaded = self.shading.shade(camera)?;
            for part in &self.parts {
                let image = part.of(&shaded, to.background);
                if let Some(dir) = to.directory {
                    written.push(images::write(to.format, dir, stem, part.name(), &image)?);
                }
                if let Some(video) = &mut video {
                    video.push(&images::shown(&image))?;
                }
            }
        }
        let Some(dir) = to.directory.filter(|_| self.each) else { return Ok(written) };
        match &self.lights {
            Lights::Gains(gains) => {
                // As wide as the last number, so that names sort in order.
                let digits = gains.len().saturating_sub(1).to_string().len().max(2);
                for i in 0..gains.len() {
                    let alone: Vec<f32> = (0..).zip(gains).map(|(k, g)| if k == i { *g } else { 0.0 }).collect();
                    self.shading.set_gains(device, &alone)?;
                    let image = self.shading.direct(camera)?;
                    written.push(images::write(to.format, dir, stem, &format!("light_{i:0digits$}"), &image)?);
                }
                self.shading.set_gains(device, gains)?;
            }
            Lights::Emitters { names, frame } => {
                let mut layers: Vec<(&str, Image)> = Vec::new();
                for (i, name) in names.iter().enumerate() {
                    self.shading.set_emitters(&only(frame, |k| k == i));
                    layers.push((name, self.shading.shade_again(camera)?.radiance([0.0; 3])));
                }
                self.shading.set_emitters(frame);
                let path = dir.join(format!("{stem}_lights.exr"));
                write_exr_layers(&path, &layers)?;
                written.push(path);
            }
        }
        Ok(written)
    }
}

/// Returns the emitters of a frame, of which some are on.
pub fn only(frame: &[FrameEmitter], on: impl Fn(usize) -> bool) -> Vec<FrameEmitter> {
    let off = |e: &FrameEmitter| FrameEmitter::of(AreaLight { color: [0.0; 3], ..e.light });
    frame.iter().enumerate().map(|(i, e)| if on(i) { *e } else { off(e) }).collect()
}
