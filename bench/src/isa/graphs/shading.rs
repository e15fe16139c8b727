//! Graphs that shade views: point lights, environment map, and each kind of visibility.

use super::SIZE;
use super::training::smaller;
use sgs_config::Settings;
use sgs_engine::Device;
use sgs_engine::graph::ImageState;
use sgs_passes::Tuning;
use sgs_passes::pipeline::{Camera, Lighting, LitLayer, LitOptions, LitScene, LitView, ShadedScene, Shader, ViewError};
use sgs_passes::shade::lights::{Axes, LightModel};
use sgs_passes::splat::{Encoding, TexelFormat};
use sgs_run::{LightFile, Rays, Texels, Visibility, VisibilityFile, shaded_scene};
use sgs_scene::Splats;

/// Model of the point lights: the default number, on either layout.
fn models() -> [LightModel; 2] {
    [Axes::Grid, Axes::Free].map(|axes| LightModel { axes, ..Default::default() })
}

/// Builds all.
pub fn build(device: &Device, splats: &Splats) -> anyhow::Result<()> {
    let mut settings = Settings::default();
    smaller(&mut settings);
    let of = &settings.intrinsic.visibility;
    let mut kinds = vec![Visibility::None, Visibility::Traced(Rays::of(of))];
    if let Some(config) = of.config() {
        let (tables, mlp) = (config.initial_tables(1), config.initial_weights(1));
        let (low, high) = ([-1.0; 3], [1.0; 3]);
        kinds.push(Visibility::Learned(Box::new(VisibilityFile { config, low, high, tables, mlp })));
    }
    let environment = Texels::uniform(settings.intrinsic.environment.resolution, [1.0; 3]);
    for visibility in &kinds {
        for model in models() {
            let positions: Vec<f32> = model.start_positions([-1.0; 3], [1.0; 3]).concat();
            let gains = vec![1.0; model.lights as usize];
            let file = LightFile::of(&model, 1.0 / 64.0, &positions, &model.start_lobes(), &gains);
            let make = || shaded_scene(device, splats, Some(&file), None, visibility);
            let lighting = Lighting {
                model,
                normalizer: 1.0 / 64.0,
                count: model.lights,
                positions,
                lobes: model.start_lobes(),
                gains,
                environment: [1.0; 3],
                emitters: Vec::new(),
            };
            scene(device, make()?, Some(make()?), &lighting)?;
        }
        scene(device, shaded_scene(device, splats, None, None, visibility)?, None, &dark())?;
    }
    // The environment map is independent of the lights.
    let make = || shaded_scene(device, splats, None, Some(&environment), &Visibility::None);
    scene(device, make()?, Some(make()?), &dark())
}

/// Returns a lighting without lights.
pub fn dark() -> Lighting {
    Lighting {
        model: LightModel { lights: 1, lobes: 1, axes: Axes::Free },
        normalizer: 1.0,
        count: 0,
        positions: vec![0.0; 3],
        lobes: vec![0.0; 7],
        gains: vec![0.0],
        environment: [1.0; 3],
        emitters: Vec::new(),
    }
}

/// Builds the graphs of a scene: one that downloads every term, and one for each layer of a window.
pub fn scene(device: &Device, one: ShadedScene, other: Option<ShadedScene>, lighting: &Lighting) -> anyhow::Result<()> {
    let tuning = Tuning::for_device(device.info());
    let camera = Camera { size: SIZE, near: 0.01, focal: [50.0; 2], ..Default::default() };
    let mut shader = Shader::new(device, tuning, &one, SIZE)?;
    shader.shade(&one, &camera)?;
    Shader::new(device, tuning, &one, SIZE)?.without_visibility().shade(&one, &camera)?;
    let lit = LitScene::new(device, &tuning, other.unwrap_or(one))?;
    for layer in LitLayer::ALL {
        let options = LitOptions {
            size: SIZE,
            layer,
            format: TexelFormat::Rgba8Unorm,
            encoding: Encoding::Display,
            entry: ImageState::Undefined,
            exit: ImageState::General,
            frames_in_flight: 1,
            capacity: [0, 0],
        };
        match LitView::new(device, tuning, &lit, lighting, options) {
            // Not every scene has every layer.
            Ok(_) | Err(ViewError::Without(_)) => {}
            Err(error) => return Err(error.into()),
        }
    }
    Ok(())
}
