//! The graph of a step. Everything reads parameters before anything moves them.

use super::inputs::Declared;
use super::{IntrinsicOptions, Steps};
use crate::Tuning;
use crate::kernel::stage;
use crate::loss::{
    Compose, EdgeAware, MaterialLosses, MaterialPictures, Materials, Msg, Photometric, compose, compose_bwd,
    edge_aware, loss_sum, material_pictures, material_pictures_bwd, material_sum, msg, photometric, photometric_bwd,
    pictures,
};
use crate::optim::EPSILON;
use crate::pipeline::{RING, SurfaceHandles};
use crate::scene::StepWords;
use crate::shade::environment::{
    Environment, EnvironmentView, environment as ambient_light, environment_bwd, environment_clamp, environment_filter,
    environment_filter_bwd, environment_smoothness,
};
use crate::shade::lights::{LightParameters, Lights, Shape, lights_materials_bwd, lights_prepare, lights_train};
use crate::shade::{PixelMaterials, Pixels, RawMaterials, materials, materials_bwd, values};
use crate::splat::Screen;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::intrinsic_report as report;
use sgs_shaders::structs::{LossStats, MaterialStats};

type Built<T> = std::result::Result<T, GraphError>;

/// Epsilon of the texels' Adam.
const TEXEL_EPSILON: f32 = 1e-8;

/// What tells the host.
#[derive(Clone, Copy, Debug)]
pub(super) struct Words {
    pub flags: Buffer,
    pub skipped: Buffer,
    pub reports: Buffer,
}

pub(super) fn build(
    g: &mut Graph,
    t: &Tuning,
    steps: &Steps,
    surface: &SurfaceHandles,
    inputs: &Declared,
    environment: Option<&Environment>,
    words: &Words,
    o: &IntrinsicOptions,
) -> Built<()> {
    let step = steps.shaded;
    let screen = Screen { step, largest: o.shape.largest, tile: t.tile };
    let pixels = screen.pixels();
    let (seen, weights) = (&surface.surfaces, &surface.weights);
    let n = o.shape.gaussians;

    // What the pixels are made of.
    let raw = RawMaterials {
        albedo: inputs.albedo.parameters,
        roughness: inputs.roughness.parameters,
        metallic: inputs.metallic.map(|m| m.parameters),
    };
    let of_gaussians = values(g, t, &raw, n)?;
    let of_pixels = PixelMaterials {
        materials: g.transient("materials", 16 * pixels),
        metallic: raw.metallic.map(|_| g.transient("pixel_metallic", 4 * pixels)),
    };
    materials(g, t, &screen, &of_gaussians, weights, &of_pixels)?;
    let gradient = PixelMaterials {
        materials: g.transient("materials_gradient", 16 * pixels),
        metallic: raw.metallic.map(|_| g.transient("metallic_gradient", 4 * pixels)),
    };
    g.fill("clear_materials_gradient", gradient.materials, 0)?;
    if let Some(metallic) = gradient.metallic {
        g.fill("clear_metallic_gradient", metallic, 0)?;
    }

    // Light.
    let shaded = Pixels { screen, surfaces: *seen, materials: of_pixels };
    let lit = match &inputs.lights {
        Some(l) => {
            let parameters =
                LightParameters { positions: l.positions.parameters, lobes: l.lobes.parameters, gains: l.gains };
            let prepared = lights_prepare(g, *t, "lights_prepare", step, l.model, &parameters, None)?;
            let shape = Shape::for_device(*t);
            let lights = Lights { pixels: shaded, prepared, normalizer: l.normalizer, shape };
            let direct = g.transient("direct", 12 * pixels);
            let sums = lights_train(g, &lights, direct)?;
            Some((lights, parameters, direct, sums))
        }
        None => None,
    };
    let around = match (environment, &inputs.environment) {
        (Some(e), Some((texels, tables))) => {
            let filtered = environment_filter(g, t, e, tables, texels.parameters)?;
            let view = EnvironmentView {
                step,
                points: seen.points,
                normals: seen.normals,
                coverage: seen.coverage,
                materials: of_pixels.materials,
                metallic: of_pixels.metallic,
                pixels,
            };
            let ambient = g.transient("ambient", 12 * pixels);
            ambient_light(g, t, e, tables, &view, &filtered, ambient)?;
            Some((e, texels, tables, filtered, view, ambient))
        }
        _ => None,
    };

    // The picture, and the way back to light.
    let composed = Compose {
        step,
        direct: lit.as_ref().map(|l| l.2),
        ambient: around.as_ref().map(|a| a.5),
        coverage: seen.coverage,
        returning: o.returning,
        largest: o.shape.largest,
    };
    let image = g.transient("shaded", 12 * pixels);
    let saturated = compose(g, *t, &composed, image)?;
    let (grad_image, stats) = compared(g, t, "shaded", step, image, inputs.targets, o)?;
    let radiance_gradient = g.transient("radiance_gradient", 12 * pixels);
    compose_bwd(g, *t, &composed, grad_image, radiance_gradient)?;

    // The priors, compared as they are displayed.
    let shown = Materials { step, materials: of_pixels.materials, coverage: seen.coverage, largest: o.shape.largest };
    let seen_as = pictures(g, "material_pictures", o.shape.largest, true);
    material_pictures(g, *t, &shown, &seen_as)?;
    let clear = |g: &mut Graph, name: &str| -> Built<Buffer> {
        let buffer = g.transient(format!("grad_{name}_picture"), 12 * pixels);
        g.fill(format!("clear_grad_{name}_picture"), buffer, 0)?;
        Ok(buffer)
    };
    let (albedo_gradient, albedo_stats) = match inputs.albedo_priors {
        Some(priors) => {
            let (gradient, stats) = compared(g, t, "albedo", steps.albedo, seen_as.albedo, priors, o)?;
            (gradient, Some(stats))
        }
        None => (clear(g, "albedo")?, None),
    };
    let (roughness_gradient, roughness_stats) = match (inputs.roughness_priors, seen_as.roughness) {
        (Some(priors), Some(picture)) => {
            let (gradient, stats) = compared(g, t, "roughness", steps.roughness, picture, priors, o)?;
            (gradient, Some(stats))
        }
        _ => (clear(g, "roughness")?, None),
    };
    let of_pictures = MaterialPictures { albedo: albedo_gradient, roughness: Some(roughness_gradient) };
    let mut losses = MaterialLosses { saturated: Some(saturated), ..Default::default() };
    if o.edge_aware {
        let edges = EdgeAware {
            step,
            weights: steps.weights,
            pictures: seen_as,
            targets: inputs.targets,
            largest: o.shape.largest,
        };
        losses.edge = Some(edge_aware(g, *t, &edges, &of_pictures)?);
    }
    if let (Some(priors), true) = (inputs.albedo_priors, o.gradients) {
        let scales = Msg {
            step,
            weights: steps.weights,
            pictures: seen_as,
            coverage: seen.coverage,
            albedo_prior: priors,
            roughness_prior: inputs.roughness_priors,
            all_views: true,
            mask: None,
            largest: o.shape.largest,
        };
        losses.msg = Some(msg(g, *t, &scales, &of_pictures)?);
    }
    let material_stats = g.transient("material_stats", size_of::<MaterialStats>() as u64);
    material_sum(g, *t, step, steps.weights, &losses, material_stats)?;
    material_pictures_bwd(g, *t, &shown, &of_pictures, gradient.materials)?;

    // Back through light to materials.
    if let Some((_, _, _, sums)) = &lit {
        lights_materials_bwd(g, *t, &shaded, sums, radiance_gradient, gradient.materials, gradient.metallic)?;
    }
    let words_of = StepWords { step, flags: words.flags, skipped: words.skipped };
    let mut moves = Vec::new();
    if let Some((e, texels, tables, filtered, view, _)) = &around {
        let sums =
            environment_bwd(g, t, e, tables, view, filtered, radiance_gradient, gradient.materials, gradient.metallic)?;
        let smoothness = environment_smoothness(g, t, e, tables, texels.parameters, filtered, o.environment_smooth);
        let grad_texels = texels.gradient(g);
        environment_filter_bwd(g, t, e, tables, filtered, &sums, smoothness.as_ref(), grad_texels)?;
        moves.push((**texels, grad_texels, o.rates.environment, TEXEL_EPSILON));
    }
    let grads = RawMaterials {
        albedo: inputs.albedo.gradient(g),
        roughness: inputs.roughness.gradient(g),
        metallic: inputs.metallic.map(|m| m.gradient(g)),
    };
    materials_bwd(g, t, &raw, weights, n, &gradient, false, &grads)?;
    moves.push((inputs.albedo, grads.albedo, o.rates.albedo, EPSILON));
    moves.push((inputs.roughness, grads.roughness, o.rates.roughness, EPSILON));
    if let (Some(metallic), Some(gradient)) = (inputs.metallic, grads.metallic) {
        moves.push((metallic, gradient, o.rates.metallic, EPSILON));
    }

    // Everything moves at once.
    for (what, gradient, rate, epsilon) in moves {
        what.follow(g, t, &words_of, gradient, rate, epsilon, true)?;
    }
    if let Some((e, texels, ..)) = &around {
        environment_clamp(g, t, e, texels.parameters)?;
    }
    let bindings = report::Bindings {
        params: step.into(),
        skipped: words.skipped.into(),
        shaded: stats.into(),
        albedo: albedo_stats.unwrap_or(stats).into(),
        roughness: roughness_stats.unwrap_or(stats).into(),
        metallic: stats.into(),
        materials: material_stats.into(),
        reports: words.reports.into(),
    };
    let specs = report::Specs {
        ring: RING,
        albedo: albedo_stats.is_some(),
        roughness: roughness_stats.is_some(),
        metallic: false,
    };
    stage(g, "intrinsic_report", &report::KERNEL, bindings.entries(), specs.entries(), &[]).dispatch([1, 1, 1])
}

/// A picture against photographs or priors: its gradient, and what the loss came to.
fn compared(
    g: &mut Graph,
    t: &Tuning,
    name: &str,
    step: Buffer,
    image: Buffer,
    targets: Buffer,
    o: &IntrinsicOptions,
) -> Built<(Buffer, Buffer)> {
    g.set_prefix(format!("{name}."));
    let loss = Photometric { step, image, targets, channels: 3, largest: o.shape.largest };
    let partials = photometric(g, *t, &loss)?;
    let gradient = g.transient("grad_image", 12 * u64::from(o.shape.largest[0]) * u64::from(o.shape.largest[1]));
    photometric_bwd(g, *t, &loss, &partials, gradient)?;
    let stats = g.transient("loss_stats", size_of::<LossStats>() as u64);
    loss_sum(g, *t, step, (partials.sums, partials.count), None, stats)?;
    g.set_prefix("");
    Ok((gradient, stats))
}
