//! What other views, and other light, ask of albedo in a region.

use super::COPIES;
use super::build::Frame;
use super::priors::Asked;
use crate::loss::{
    CarryOptions, CrossPicture, MaterialPictures, Materials, Msg, Seen, carry_mask, cross_view, material_pictures,
    own_prior, pictures, region_mask, relight,
};
use crate::pipeline::{Masks, SurfaceHandles};
use crate::shade::{PixelMaterials, SURFACE_DEPTH, Weights, materials, surface_depth};
use crate::splat::{Screen, wanted_words};
use sgs_engine::graph::{Buffer, Graph, GraphError};

/// A pseudo-view whose albedo has been compared.
pub(super) struct Other {
    pub weights: Weights,
    pub shown: Materials,
    pub by_picture: MaterialPictures,
}

/// Compares albedo of the step's region with its prior under other light, or with what pseudo-views see of it.
pub(super) fn across_views(
    g: &mut Graph,
    f: &Frame<'_>,
    pseudo: &[SurfaceHandles],
    of_gaussians: &PixelMaterials,
    asked: &mut Asked,
) -> Result<Vec<Other>, GraphError> {
    let pixels = f.screen.pixels();
    let region = match (f.o.cross_view || f.o.relight || f.o.own_prior, f.inputs.regions) {
        (true, Some(masks)) if f.o.masks == Masks::Given => Some(masks),
        (true, Some(ids)) => {
            let mask = g.transient("region_mask", 4 * wanted_words(pixels));
            region_mask(g, *f.t, &f.screen, ids, mask)?;
            Some(mask)
        }
        _ => None,
    };
    if let (Some(mask), true) = (region, f.o.relight) {
        under_other_lights(g, f, mask, asked)?;
    }
    if let (Some(mask), true, Some(prior)) = (region, f.o.own_prior, f.inputs.albedo_priors) {
        let compared = in_region(f, mask, prior, asked.pictures.albedo);
        asked.losses.own_prior = Some(own_prior(g, *f.t, &compared, asked.by_picture.albedo)?);
    }
    let mut others = Vec::new();
    // Pseudo-views are about albedo alone.
    let bare = PixelMaterials { metallic: None, ..*of_gaussians };
    if let (Some(mask), true) = (region, f.o.cross_view) {
        let mine = CrossPicture {
            step: f.steps.shaded,
            albedo: asked.pictures.albedo,
            mask,
            albedo_gradient: asked.by_picture.albedo,
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
            let picture = pictures(g, "pictures", f.o.shape.largest, false);
            material_pictures(g, *f.t, &shown, &picture)?;
            let mask = match (f.o.masks, f.inputs.pseudo_regions) {
                (Masks::Given, _) => mask,
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
            let by_picture = pictures(g, "grad_pictures", f.o.shape.largest, false);
            g.fill("clear_grad_pictures", by_picture.albedo, 0)?;
            compared.push(CrossPicture {
                step,
                albedo: picture.albedo,
                mask,
                albedo_gradient: by_picture.albedo,
                largest: f.o.shape.largest,
            });
            others.push(Other { weights: surface.weights, shown, by_picture });
        }
        g.set_prefix("");
        asked.losses.cross_view = Some(cross_view(g, *f.t, f.steps.weights, &compared)?);
    }
    Ok(others)
}

/// Compares materials of the step's region with what is said of them under other lights.
fn under_other_lights(g: &mut Graph, f: &Frame<'_>, mask: Buffer, asked: &mut Asked) -> Result<(), GraphError> {
    let (albedo, roughness) = f.inputs.estimates.split_at(COPIES);
    let share = |of: &[Option<Buffer>]| 1.0 / of.iter().flatten().count().max(1) as f32;
    let (by_albedo, by_roughness) = (share(albedo), f.o.relight_roughness * share(roughness));
    let gray = asked.pictures.roughness.zip(asked.by_picture.roughness).filter(|_| by_roughness > 0.0);
    let all = albedo.iter().flatten().map(|e| (*e, asked.pictures.albedo, asked.by_picture.albedo, by_albedo));
    // Gray pictures have three channels as well.
    let rough = roughness.iter().flatten();
    let rough = rough.filter_map(|e| gray.map(|(picture, gradient)| (*e, picture, gradient, by_roughness)));
    let all: Vec<_> = all.map(|e| (e, true)).chain(rough.map(|e| (e, false))).collect();
    for (number, ((estimate, picture, gradient, share), of_albedo)) in all.into_iter().enumerate() {
        let compared = in_region(f, mask, estimate, picture);
        let loss = relight(g, *f.t, &compared, number as u32, share, gradient)?;
        let into = if of_albedo { &mut asked.losses.relight } else { &mut asked.losses.relight_roughness };
        if let Some(free) = into.iter_mut().find(|l| l.is_none()) {
            *free = Some(loss);
        }
    }
    asked.losses.roughness_share = f.o.relight_roughness;
    Ok(())
}

/// A picture of the step's region against what is said of it.
fn in_region(f: &Frame<'_>, mask: Buffer, said: Buffer, picture: Buffer) -> Msg {
    Msg {
        step: f.steps.shaded,
        weights: f.steps.weights,
        pictures: MaterialPictures { albedo: picture, roughness: None },
        coverage: f.seen.coverage,
        albedo_prior: said,
        roughness_prior: None,
        all_views: true,
        mask: Some(mask),
        largest: f.o.shape.largest,
    }
}
