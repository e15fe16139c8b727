//! Losses of albedo in a region, across views and across lights.

use super::COPIES;
use super::build::Frame;
use super::priors::PriorLosses;
use crate::loss::{
    CarryOptions, CrossViewImage, MaterialImages, Materials, Msg, Seen, carry_mask, cross_view, images,
    material_images, own_prior, region_mask, relight,
};
use crate::pipeline::{Masks, SurfaceHandles};
use crate::shade::{PixelMaterials, SURFACE_DEPTH, Weights, materials, surface_depth};
use crate::splat::{Screen, wanted_words};
use sgs_engine::graph::{Buffer, Graph, GraphError};

/// Pseudo-view with the gradient of its albedo image.
pub(super) struct Other {
    pub weights: Weights,
    pub shown: Materials,
    pub by_image: MaterialImages,
}

/// Adds the losses of the step's region.
///
/// Compares materials with estimates under other lights, and albedo with the view's own prior or with pseudo-views, as
/// the options say.
pub(super) fn across_views(
    g: &mut Graph,
    f: &Frame<'_>,
    pseudo: &[SurfaceHandles],
    of_gaussians: &PixelMaterials,
    prior_losses: &mut PriorLosses,
) -> Result<Vec<Other>, GraphError> {
    let pixels = f.screen.pixels();
    let region = match (f.o.cross_view || f.o.relight || f.o.own_prior, f.inputs.regions) {
        (true, Some(masks)) if f.o.masks == Masks::Provided => Some(masks),
        (true, Some(ids)) => {
            let mask = g.transient("region_mask", 4 * wanted_words(pixels));
            region_mask(g, *f.t, &f.screen, ids, mask)?;
            Some(mask)
        }
        _ => None,
    };
    if let (Some(mask), true) = (region, f.o.relight) {
        under_other_lights(g, f, mask, prior_losses)?;
    }
    if let (Some(mask), true, Some(prior)) = (region, f.o.own_prior, f.inputs.albedo_priors) {
        let compared = in_region(f, mask, prior, prior_losses.images.albedo);
        prior_losses.losses.own_prior = Some(own_prior(g, *f.t, &compared, prior_losses.by_image.albedo)?);
    }
    let mut others = Vec::new();
    // Pseudo-views compare only albedo.
    let bare = PixelMaterials { metallic: None, ..*of_gaussians };
    if let (Some(mask), true) = (region, f.o.cross_view) {
        let mine = CrossViewImage {
            step: f.steps.shaded,
            albedo: prior_losses.images.albedo,
            mask,
            albedo_gradient: prior_losses.by_image.albedo,
            largest: f.o.shape.largest,
        };
        let depth = surface_depth(g, f.t, &f.screen, f.seen)?;
        let trained = Seen { screen: f.screen, blended: depth, channels: SURFACE_DEPTH };
        let mut compared = vec![mine];
        for (i, (surface, step)) in pseudo.iter().zip(f.steps.pseudo).enumerate() {
            g.set_prefix(format!("pseudo{i}."));
            let other = Screen { step, ..f.screen };
            let of_other = PixelMaterials { materials: g.transient("materials", 16 * pixels), metallic: None };
            materials(g, f.t, &other, &bare, &surface.weights, &of_other)?;
            let coverage = surface.surfaces.coverage;
            let shown = Materials { step, materials: of_other.materials, coverage, largest: f.o.shape.largest };
            let image = images(g, "images", f.o.shape.largest, false);
            material_images(g, *f.t, &shown, &image)?;
            let mask = match (f.o.masks, f.inputs.pseudo_regions) {
                (Masks::Provided, _) => mask,
                (Masks::Numbered, Some(ids)) => {
                    let numbered = g.transient("region_mask", 4 * wanted_words(pixels));
                    region_mask(g, *f.t, &other, ids, numbered)?;
                    numbered
                }
                (Masks::Carried | Masks::Numbered, _) => {
                    let depth = surface_depth(g, f.t, &other, &surface.surfaces)?;
                    let seen_there = Seen { screen: other, blended: depth, channels: SURFACE_DEPTH };
                    let carried = g.transient("carried", 4 * wanted_words(pixels));
                    carry_mask(g, *f.t, "carry_mask", &trained, mask, &seen_there, CarryOptions::default(), carried)?;
                    carried
                }
            };
            let by_image = images(g, "grad_images", f.o.shape.largest, false);
            g.fill("clear_grad_images", by_image.albedo, 0)?;
            compared.push(CrossViewImage {
                step,
                albedo: image.albedo,
                mask,
                albedo_gradient: by_image.albedo,
                largest: f.o.shape.largest,
            });
            others.push(Other { weights: surface.weights, shown, by_image });
        }
        g.set_prefix("");
        prior_losses.losses.cross_view = Some(cross_view(g, *f.t, f.steps.weights, &compared)?);
    }
    Ok(others)
}

/// Compares materials of the step's region with their estimates under other lights.
fn under_other_lights(
    g: &mut Graph,
    f: &Frame<'_>,
    mask: Buffer,
    prior_losses: &mut PriorLosses,
) -> Result<(), GraphError> {
    let (albedo, roughness) = f.inputs.estimates.split_at(COPIES);
    let share = |of: &[Option<Buffer>]| 1.0 / of.iter().flatten().count().max(1) as f32;
    let (by_albedo, by_roughness) = (share(albedo), f.o.relight_roughness * share(roughness));
    let gray = prior_losses.images.roughness.zip(prior_losses.by_image.roughness).filter(|_| by_roughness > 0.0);
    let all =
        albedo.iter().flatten().map(|e| (*e, prior_losses.images.albedo, prior_losses.by_image.albedo, by_albedo));
    // Gray images have three channels as well.
    let rough = roughness.iter().flatten();
    let rough = rough.filter_map(|e| gray.map(|(image, gradient)| (*e, image, gradient, by_roughness)));
    let all: Vec<_> = all.map(|e| (e, true)).chain(rough.map(|e| (e, false))).collect();
    for (number, ((estimate, image, gradient, share), of_albedo)) in all.into_iter().enumerate() {
        let compared = in_region(f, mask, estimate, image);
        let loss = relight(g, *f.t, &compared, number as u32, share, gradient)?;
        let into =
            if of_albedo { &mut prior_losses.losses.relight } else { &mut prior_losses.losses.relight_roughness };
        if let Some(free) = into.iter_mut().find(|l| l.is_none()) {
            *free = Some(loss);
        }
    }
    prior_losses.losses.roughness_share = f.o.relight_roughness;
    Ok(())
}

/// Pairs an image with an estimate or prior of it, within the step's region.
fn in_region(f: &Frame<'_>, mask: Buffer, estimate: Buffer, image: Buffer) -> Msg {
    Msg {
        step: f.steps.shaded,
        weights: f.steps.weights,
        images: MaterialImages { albedo: image, roughness: None },
        coverage: f.seen.coverage,
        albedo_prior: estimate,
        roughness_prior: None,
        all_views: true,
        mask: Some(mask),
        largest: f.o.shape.largest,
    }
}
