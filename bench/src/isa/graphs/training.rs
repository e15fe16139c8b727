//! Graphs of training: the published model and every choice that selects other kernels.

use sgs_config::{Backward, DensifyRule, Metallic, PRESETS, Settings, VisibilityKind, accuracy_named, overlay};
use sgs_engine::Device;
use sgs_scene::{Scene, SceneOptions, Splats};
use sgs_train::{Geometry, Intrinsic, TransportPlan};
use std::path::Path;

/// Returns the settings of every preset and of every level of accuracy.
fn bases() -> anyhow::Result<Vec<Settings>> {
    let mut all = Vec::new();
    for preset in PRESETS {
        all.push(Settings::from_table(preset.table()?)?);
    }
    for name in ["balanced", "fast"] {
        let mut table = sgs_config::Preset::find("default")?.table()?;
        overlay(&mut table, accuracy_named(name)?);
        all.push(Settings::from_table(table)?);
    }
    Ok(all)
}

/// Returns the defaults, changed.
fn with(change: impl FnOnce(&mut Settings)) -> Settings {
    let mut s = Settings::default();
    change(&mut s);
    s
}

/// Reduces the tables of the visibility field, on whose size no kernel depends. Planning is then faster.
pub fn smaller(s: &mut Settings) {
    s.intrinsic.visibility.log2_table = s.intrinsic.visibility.log2_table.min(10);
}

/// Builds the graphs of the geometry stage.
pub fn geometry(device: &Device, scene: &Scene) -> anyhow::Result<()> {
    let mut all = bases()?;
    all.push(with(|s| s.geometry.backward = Backward::Splat));
    all.push(with(|s| s.geometry.backward = Backward::Bucket));
    all.push(with(|s| {
        s.geometry.backward = Backward::Bucket;
        s.geometry.densify.rule = DensifyRule::Geometric;
    }));
    all.push(with(|s| {
        s.geometry.backward = Backward::Bucket;
        (s.geometry.semantics, s.geometry.normals) = (false, false);
        (s.geometry.losses.depth_smooth, s.geometry.losses.depth_variance) = (0.0, 0.0);
    }));
    if device.info().optional.float_atomics {
        all.push(with(|s| s.geometry.backward = Backward::Atomic));
    }
    all.push(with(|s| s.geometry.dense_adam = true));
    for dense in [false, true] {
        all.push(with(|s| (s.accuracy.state_bits, s.geometry.dense_adam) = (16, dense)));
    }
    for bits in [16, 32] {
        all.push(with(|s| (s.accuracy.state_bits, s.geometry.densify.rule) = (bits, DensifyRule::Mcmc)));
    }
    all.push(with(|s| s.geometry.semantic_geometry = false));
    all.push(with(|s| s.geometry.semantics = false));
    all.push(with(|s| (s.geometry.semantics, s.geometry.normals) = (false, false)));
    all.push(with(|s| {
        (s.geometry.semantics, s.geometry.normals) = (false, false);
        (s.geometry.losses.depth_smooth, s.geometry.losses.depth_variance) = (0.0, 0.0);
    }));
    all.push(with(|s| s.geometry.densify.until = 0.0));
    for (colors_alone, lens) in [(false, 0.0), (true, 0.0), (false, 1e-3)] {
        all.push(with(|s| {
            s.geometry.rates.views = [1e-3, 1e-3, lens, lens].into();
            if colors_alone {
                (s.geometry.semantics, s.geometry.normals) = (false, false);
                (s.geometry.losses.depth_smooth, s.geometry.losses.depth_variance) = (0.0, 0.0);
            }
        }));
    }
    for s in &all {
        Geometry::new(device, scene, s, None)?.build_graphs()?;
    }
    Ok(())
}

/// Builds the graphs of geometry steps with prior depths of all meanings. Takes the true depths of a scene as priors.
pub fn depths(device: &Device, scene: &Path) -> anyhow::Result<()> {
    std::fs::rename(scene.join("gt/depth"), scene.join("priors/depth"))?;
    let about = scene.join("priors/priors.json");
    let given: serde_json::Value = serde_json::from_slice(&std::fs::read(&about)?)?;
    for meaning in ["metric", "scale", "inverse-scale-shift"] {
        let mut settings = given.clone();
        settings["depth"] = serde_json::json!({ "meaning": meaning });
        std::fs::write(&about, settings.to_string())?;
        let scene = Scene::open(scene, &SceneOptions::default())?;
        for normals in [false, true] {
            let s = with(|s| (s.geometry.normals, s.geometry.semantics) = (normals, normals));
            Geometry::new(device, &scene, &s, None)?.build_graphs()?;
        }
        // A sensor measures along the rays of the given lens, also while training learns another.
        Geometry::new(device, &scene, &with(|s| s.geometry.rates.views = [1e-3; 4].into()), None)?.build_graphs()?;
    }
    Ok(())
}

/// Builds the graphs of the intrinsic stage.
pub fn intrinsic(device: &Device, scene: &Scene, splats: &Splats) -> anyhow::Result<()> {
    let mut all = bases()?;
    for kind in [VisibilityKind::Field, VisibilityKind::Traced, VisibilityKind::None] {
        for (normals, metallic) in
            [(0.0, Metallic::On), (1e-3, Metallic::On), (0.0, Metallic::Off), (1e-3, Metallic::Off)]
        {
            all.push(with(|s| {
                s.intrinsic.visibility.kind = kind;
                s.intrinsic.rates.normals = normals;
                s.intrinsic.metallic = metallic;
                // Independent of the lights, and slow to prepare.
                s.intrinsic.environment.resolution = 0;
            }));
        }
    }
    all.push(with(|s| s.intrinsic.metallic = Metallic::On));
    all.push(with(|s| s.intrinsic.metallic = Metallic::Off));
    all.push(with(|s| s.intrinsic.lights.grid = 0));
    // Planning starts no provider.
    all.push(with(|s| {
        (s.intrinsic.relight.provider, s.intrinsic.relight_from) = ("provider".into(), 1);
        s.intrinsic.environment.resolution = 0;
    }));
    for s in &mut all {
        // Changes the sizes of the model with the photographs, which show nothing here.
        s.intrinsic.automatic.enabled = false;
        smaller(s);
        Intrinsic::planned(device, scene, s, splats)?.build_graphs()?;
    }
    Ok(())
}

/// Builds the graphs of the transport stage after its fit.
pub fn transport(device: &Device, scene: &Scene, splats: &Splats) -> anyhow::Result<()> {
    for metallic in [Metallic::On, Metallic::Off] {
        let mut settings = with(|s| s.intrinsic.metallic = metallic);
        smaller(&mut settings);
        TransportPlan::of(device, scene, &settings, splats)?.training.build_graphs()?;
    }
    Ok(())
}
