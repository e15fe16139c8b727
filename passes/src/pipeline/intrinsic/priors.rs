//! Losses of a view's materials: priors, and smoothness guided by the photograph.

use super::IntrinsicOptions;
use super::build::Frame;
use crate::Tuning;
use crate::loss::{
    EdgeAware, MaterialImages, MaterialLosses, Materials, Msg, Photometric, Saturated, edge_aware, gray_image,
    gray_image_bwd, images, loss_sum, material_images, msg, photometric, photometric_bwd,
};
use crate::shade::PixelMaterials;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::structs::LossStats;

type Built<T> = Result<T, GraphError>;

/// Material losses accumulated so far.
pub(super) struct PriorLosses {
    /// Materials by pixel.
    pub shown: Materials,
    /// Materials as displayed.
    pub images: MaterialImages,
    /// Gradients of `images`.
    pub by_image: MaterialImages,
    pub losses: MaterialLosses,
    /// Loss statistics against the priors of albedo, roughness and metallic.
    pub stats: [Option<Buffer>; 3],
}

/// Compares the displayed materials of a view with their priors.
///
/// Propagates the gradient of metallic to `metallic_gradient` at once.
pub(super) fn priors(
    g: &mut Graph,
    f: &Frame<'_>,
    of_pixels: &PixelMaterials,
    metallic_gradient: Option<Buffer>,
    saturated: Saturated,
) -> Built<PriorLosses> {
    let shown = Materials {
        step: f.steps.shaded,
        materials: of_pixels.materials,
        coverage: f.seen.coverage,
        largest: f.o.shape.largest,
    };
    let seen_as = images(g, "material_images", f.o.shape.largest, true);
    material_images(g, *f.t, &shown, &seen_as)?;
    let clear = |g: &mut Graph, name: &str| -> Built<Buffer> {
        let buffer = g.transient(format!("grad_{name}_picture"), 12 * f.screen.pixels());
        g.fill(format!("clear_grad_{name}_picture"), buffer, 0)?;
        Ok(buffer)
    };
    let (albedo_gradient, albedo_stats) = match f.inputs.albedo_priors {
        Some(priors) => {
            let (gradient, stats) = compared(g, f.t, "albedo", f.steps.albedo, seen_as.albedo, priors, f.o)?;
            (gradient, Some(stats))
        }
        None => (clear(g, "albedo")?, None),
    };
    let (roughness_gradient, roughness_stats) = match (f.inputs.roughness_priors, seen_as.roughness) {
        (Some(priors), Some(rendered)) => {
            let (gradient, stats) = compared(g, f.t, "roughness", f.steps.roughness, rendered, priors, f.o)?;
            (gradient, Some(stats))
        }
        _ => (clear(g, "roughness")?, None),
    };
    let mut metallic_stats = None;
    if let (Some(priors), Some(values), Some(into)) = (f.inputs.metallic_priors, of_pixels.metallic, metallic_gradient)
    {
        let rendered = g.transient("metallic_image", 12 * f.screen.pixels());
        gray_image(g, *f.t, &f.screen, values, f.seen.coverage, rendered)?;
        let (by_image, stats) = compared(g, f.t, "metallic", f.steps.metallic, rendered, priors, f.o)?;
        gray_image_bwd(g, *f.t, &f.screen, by_image, f.seen.coverage, into)?;
        metallic_stats = Some(stats);
    }
    let of_images = MaterialImages { albedo: albedo_gradient, roughness: Some(roughness_gradient) };
    let mut losses = MaterialLosses { saturated: Some(saturated), ..Default::default() };
    if f.o.edge_aware {
        let edges = EdgeAware {
            step: f.steps.shaded,
            weights: f.steps.weights,
            images: seen_as,
            targets: f.inputs.targets,
            largest: f.o.shape.largest,
        };
        losses.edge = Some(edge_aware(g, *f.t, &edges, &of_images)?);
    }
    if let (Some(priors), true) = (f.inputs.albedo_priors, f.o.gradients) {
        let scales = Msg {
            step: f.steps.shaded,
            weights: f.steps.weights,
            images: seen_as,
            coverage: f.seen.coverage,
            albedo_prior: priors,
            roughness_prior: f.inputs.roughness_priors,
            all_views: true,
            mask: None,
            largest: f.o.shape.largest,
        };
        losses.msg = Some(msg(g, *f.t, &scales, &of_images)?);
    }
    let stats = [albedo_stats, roughness_stats, metallic_stats];
    Ok(PriorLosses { shown, images: seen_as, by_image: of_images, losses, stats })
}

/// Compares an image with photographs or priors. Returns its gradient and the loss statistics.
pub(super) fn compared(
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
