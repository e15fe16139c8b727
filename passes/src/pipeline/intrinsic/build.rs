//! Graph of an intrinsic step. All reads of parameters precede their updates.

use super::across::{Other, across_views};
use super::inputs::Declared;
use super::priors::{PriorLosses, compared, priors};
use super::{IntrinsicOptions, Steps, transport};
use crate::Tuning;
use crate::kernel::stage;
use crate::loss::{Compose, compose, compose_bwd, material_images_bwd, material_sum};
use crate::optim::{AdamRule, EPSILON, Rate, StepWords};
use crate::pipeline::{RING, SurfaceHandles};
use crate::shade::environment::{
    Environment, EnvironmentView, StoredFilter, environment as ambient_light, environment_bwd, environment_clamp,
    environment_filter, environment_filter_bwd, environment_smoothness,
};
use crate::shade::lights::{
    LightParameterGradients, LightParameters, Lights, Shape, lights_bwd, lights_materials_bwd, lights_normals_bwd,
    lights_prepare_bwd, lights_prepare_culled, lights_regularize, lights_train,
};
use crate::shade::traced::{lights_bwd_traced, lights_normals_bwd_traced, lights_train_traced};
use crate::shade::visibility::{
    BackwardOptions, Gradients, lights_bwd_field, lights_normals_bwd_field, lights_train_field, visibility_adam,
    visibility_lights_bwd,
};
use crate::shade::{
    PixelMaterials, Pixels, RawMaterials, Surfaces, materials, materials_bwd, normals, normals_bwd, values,
};
use crate::splat::Screen;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::intrinsic_report as report;
use sgs_shaders::structs::MaterialStats;

type Built<T> = std::result::Result<T, GraphError>;

/// Epsilon of Adam for the environment map's texels.
pub(super) const TEXEL_EPSILON: f32 = 1e-8;

/// Handles of the status buffers.
#[derive(Clone, Copy, Debug)]
pub(super) struct Words {
    pub flags: Buffer,
    pub skipped: Buffer,
    pub reports: Buffer,
    /// Smoothness loss of the environment map, unless every step updates it.
    pub smoothness: Option<Buffer>,
}

/// Inputs shared by all passes of a step.
pub(super) struct Frame<'a> {
    pub t: &'a Tuning,
    pub steps: &'a Steps,
    pub screen: Screen,
    /// Surfaces of the view.
    pub seen: &'a Surfaces,
    pub inputs: &'a Declared,
    pub o: &'a IntrinsicOptions,
}

/// Declared resources of a step.
pub(super) struct StepResources<'a> {
    pub steps: &'a Steps,
    pub surface: &'a SurfaceHandles,
    pub pseudo: &'a [SurfaceHandles],
    pub inputs: &'a Declared,
    pub environment: Option<&'a Environment>,
    /// Stored levels of the environment map, if an update happens every several steps.
    pub stored: Option<&'a StoredFilter>,
    pub words: &'a Words,
}

/// Adds all passes of a step. Returns the shaded image.
pub(super) fn build(g: &mut Graph, t: &Tuning, all: &StepResources<'_>, o: &IntrinsicOptions) -> Built<Buffer> {
    let &StepResources { steps, surface, pseudo, inputs, environment, stored, words } = all;
    let step = steps.shaded;
    let screen = Screen { step, largest: o.shape.largest, tile: t.tile };
    let pixels = screen.pixels();
    let weights = &surface.weights;
    let n = o.shape.gaussians;
    let learned = inputs.normals.map(|l| normals(g, t, &screen, l.parameters, weights)).transpose()?;
    let seen = &learned.map_or(surface.surfaces, |l| l.of(&surface.surfaces));

    // Materials of the pixels.
    let raw = RawMaterials {
        albedo_range: o.albedo_range,
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
            let missing = o.missing(l.normalizer);
            let prepared = lights_prepare_culled(g, *t, "lights_prepare", step, l.model, &parameters, None, missing)?;
            let shape = Shape::for_device(*t);
            let lights = Lights { pixels: shaded, prepared, normalizer: l.normalizer, shape };
            let direct = g.transient("direct", 12 * pixels);
            let (sums, sight) = match (&inputs.visibility, &inputs.traced) {
                (Some(v), _) => (lights_train_field(g, *t, &lights, &v.field, direct)?, None),
                (None, Some(traced)) => {
                    let (sums, sight) = lights_train_traced(g, &lights, traced, direct)?;
                    (sums, Some((traced, sight)))
                }
                (None, None) => (lights_train(g, &lights, direct)?, None),
            };
            Some((lights, parameters, direct, sums, sight))
        }
        None => None,
    };
    let around = match (environment, &inputs.environment) {
        (Some(e), Some((texels, tables))) => {
            let filtered = match stored {
                Some(stored) => stored.filtered(),
                None => environment_filter(g, t, e, tables, texels.parameters)?,
            };
            let view = EnvironmentView::from(&shaded);
            let ambient = g.transient("ambient", 12 * pixels);
            ambient_light(g, t, e, tables, &view, &filtered, ambient)?;
            Some((e, texels, tables, filtered, view, ambient))
        }
        _ => None,
    };

    let frame = Frame { t, steps, screen, seen, inputs, o };
    let bounced = match (&o.transport, &inputs.transport) {
        (Some(training), Some(d)) => {
            Some((training, d, transport::forward(g, &frame, d, &shaded, &of_gaussians, weights, training)?))
        }
        _ => None,
    };

    // Shaded image, its loss, and the gradient of radiance.
    let composed = Compose {
        step,
        direct: lit.as_ref().map(|l| l.2).or(bounced.as_ref().map(|b| b.2.radiance)),
        ambient: around.as_ref().map(|a| a.5),
        coverage: seen.coverage,
        largest: o.shape.largest,
    };
    let image = if o.image { g.external("shaded", 12 * pixels) } else { g.transient("shaded", 12 * pixels) };
    let saturated = compose(g, *t, &composed, image)?;
    let (grad_image, stats) = compared(g, t, "shaded", step, image, inputs.targets, o)?;
    let radiance_gradient = g.transient("radiance_gradient", 12 * pixels);
    compose_bwd(g, *t, &composed, grad_image, radiance_gradient)?;

    // Other losses of materials.
    let mut prior_losses = priors(g, &frame, &of_pixels, gradient.metallic, saturated)?;
    let others = across_views(g, &frame, pseudo, &of_gaussians, &mut prior_losses)?;
    let PriorLosses { shown, by_image: of_images, losses, stats: of_priors, .. } = prior_losses;
    let material_stats = g.transient("material_stats", size_of::<MaterialStats>() as u64);
    material_sum(g, *t, step, steps.weights, &losses, material_stats)?;
    material_images_bwd(g, *t, &shown, &of_images, gradient.materials)?;

    // Gradients of materials through light.
    if let Some((_, _, _, sums, _)) = &lit {
        lights_materials_bwd(g, *t, &shaded, sums, radiance_gradient, gradient.materials, gradient.metallic)?;
    }
    let by_pixels = bounced.as_ref();
    let by_pixels = by_pixels
        .map(|(_, _, b)| transport::pixels_backward(g, &frame, b, radiance_gradient, &gradient))
        .transpose()?;
    let words_of = StepWords { step, flags: words.flags, skipped: words.skipped };
    let mut moves = Vec::new();
    let (mut light_losses, mut jitter) = (None, None);
    let mut smooth = words.smoothness.filter(|_| o.environment_smooth > 0.0).map(|b| (b, 1));
    if let (Some((lights, parameters, _, _, sight)), Some(l)) = (&lit, &inputs.lights) {
        let gradients = match (&inputs.visibility, sight) {
            (Some(v), _) => lights_bwd_field(g, *t, lights, &v.field, radiance_gradient)?,
            (None, Some((traced, sight))) => lights_bwd_traced(g, *t, lights, traced, sight, radiance_gradient)?,
            (None, None) => lights_bwd(g, *t, lights, radiance_gradient)?,
        };
        let into = LightParameterGradients { positions: l.positions.gradient(g), lobes: l.lobes.gradient(g) };
        let regularizers = match o.light_regularizers {
            [0.0, 0.0] => None,
            weights => {
                let losses = g.transient("light_regularizers", 8);
                light_losses = Some(losses);
                Some(lights_regularize(g, *t, lights, parameters, weights, losses)?)
            }
        };
        lights_prepare_bwd(g, &lights.prepared, parameters, &gradients, regularizers.as_ref(), &into)?;
        if let Some(v) = &inputs.visibility {
            let learned = v.gradients(g, l.model.lights).zip(v.moments(words.flags, 1, words.skipped));
            let (gradients, moments) = learned.expect("invariant: the field is declared for training");
            // Gradients of light positions through the field add to the direct ones.
            let gradients = Gradients { lights: into.positions, ..gradients };
            let options = BackwardOptions {
                regularized: o.visibility_jitter,
                add_places: true,
                sample: o.visibility_sample.max(1),
                ..Default::default()
            };
            jitter = visibility_lights_bwd(g, *t, lights, &v.field, radiance_gradient, &options, &gradients)?;
            visibility_adam(g, *t, &v.field, &gradients, &moments)?;
        }
        if let (Some(learned), Some(of_gaussians)) = (&learned, inputs.normals) {
            // As published, the environment map gives normals no gradient.
            let by_pixel = g.transient("normals_gradient", 12 * pixels);
            match (&inputs.visibility, sight) {
                (Some(v), _) => lights_normals_bwd_field(g, *t, lights, &v.field, radiance_gradient, by_pixel)?,
                (None, Some((traced, sight))) => {
                    lights_normals_bwd_traced(g, lights, traced, sight, radiance_gradient, by_pixel)?;
                }
                (None, None) => lights_normals_bwd(g, lights, radiance_gradient, by_pixel)?,
            }
            let gradient = of_gaussians.gradient(g);
            normals_bwd(g, t, learned, weights, n, by_pixel, gradient)?;
            moves.push((of_gaussians, gradient, Rate::Share(o.rates.normals), EPSILON));
        }
        moves.push((l.positions, into.positions, Rate::Constant(o.rates.light_positions), EPSILON));
        moves.push((l.lobes, into.lobes, Rate::Constant(o.rates.lights), EPSILON));
    }
    if let Some((e, texels, tables, filtered, view, _)) = &around {
        let sums =
            environment_bwd(g, t, e, tables, view, filtered, radiance_gradient, gradient.materials, gradient.metallic)?;
        if let Some(stored) = stored {
            stored.gather(g, t, e, &sums, 1.0 / o.environment_every as f32)?;
        } else {
            let weight = o.environment_smooth;
            let smoothness = environment_smoothness(g, t, e, tables, texels.parameters, weight);
            smooth = smoothness.as_ref().filter(|_| weight > 0.0).map(|s| (s.sums, s.groups));
            let grad_texels = texels.gradient(g);
            environment_filter_bwd(g, t, e, tables, filtered, &sums, smoothness.as_ref(), grad_texels)?;
            moves.push((**texels, grad_texels, Rate::Constant(o.rates.environment), TEXEL_EPSILON));
        }
    }
    let grads = RawMaterials {
        albedo_range: o.albedo_range,
        albedo: inputs.albedo.gradient(g),
        roughness: inputs.roughness.gradient(g),
        metallic: inputs.metallic.map(|m| m.gradient(g)),
    };
    materials_bwd(g, t, &raw, weights, n, &gradient, false, &grads)?;
    for (i, Other { weights, shown, by_image }) in others.into_iter().enumerate() {
        g.set_prefix(format!("pseudo{i}."));
        let gradient = PixelMaterials { materials: g.transient("materials_gradient", 16 * pixels), metallic: None };
        g.fill("clear_materials_gradient", gradient.materials, 0)?;
        material_images_bwd(g, *t, &shown, &by_image, gradient.materials)?;
        let bare = RawMaterials { metallic: None, ..raw };
        materials_bwd(g, t, &bare, &weights, n, &gradient, true, &RawMaterials { metallic: None, ..grads })?;
    }
    g.set_prefix("");
    if let (Some((training, d, bounced)), Some(by_pixels)) = (&bounced, by_pixels) {
        let into = transport::Into { raw: &raw, gradients: &grads };
        for (what, gradient, rate) in transport::backward(g, &frame, d, bounced, by_pixels, &into, training)? {
            moves.push((what, gradient, rate, EPSILON));
        }
    }
    moves.push((inputs.albedo, grads.albedo, Rate::Share(o.rates.albedo), EPSILON));
    moves.push((inputs.roughness, grads.roughness, Rate::Share(o.rates.roughness), EPSILON));
    if let (Some(metallic), Some(gradient)) = (inputs.metallic, grads.metallic) {
        moves.push((metallic, gradient, Rate::Share(o.rates.metallic), EPSILON));
    }

    // All parameters are updated together.
    for (what, gradient, rate, epsilon) in moves {
        what.follow(g, t, &words_of, gradient, AdamRule { rate, epsilon, skip_zero: true })?;
    }
    if let (Some((e, texels, ..)), None) = (&around, stored) {
        environment_clamp(g, t, e, texels.parameters)?;
    }
    let bindings = report::Bindings {
        params: step.into(),
        skipped: words.skipped.into(),
        shaded: stats.into(),
        albedo: of_priors[0].unwrap_or(stats).into(),
        roughness: of_priors[1].unwrap_or(stats).into(),
        metallic: of_priors[2].unwrap_or(stats).into(),
        materials: material_stats.into(),
        light_losses: light_losses.unwrap_or(stats).into(),
        smooth_sums: smooth.map_or(stats, |s| s.0).into(),
        jitter_sums: jitter.map_or(stats, |j| j.0).into(),
        reports: words.reports.into(),
    };
    let specs = report::Specs {
        ring: RING,
        albedo: of_priors[0].is_some(),
        roughness: of_priors[1].is_some(),
        metallic: of_priors[2].is_some(),
        lights: light_losses.is_some(),
    };
    let push = report::Push { smooth_count: smooth.map_or(0, |s| s.1), jitter_count: jitter.map_or(0, |j| j.1) };
    let push = bytemuck::bytes_of(&push);
    stage(g, "intrinsic_report", &report::KERNEL, bindings.entries(), specs.entries(), push).dispatch([1, 1, 1])?;
    Ok(image)
}
