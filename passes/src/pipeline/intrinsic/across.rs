//! What other views, and other light, ask of albedo in a region.

use super::build::Frame;
use super::priors::Asked;
use crate::loss::{
    CarryOptions, CrossPicture, MaterialPictures, Materials, Msg, Seen, carry_mask, cross_view, material_pictures,
    pictures, region_mask, relight,
};
use crate::pipeline::SurfaceHandles;
use crate::shade::{PixelMaterials, SURFACE_DEPTH, Weights, materials, surface_depth};
use crate::splat::{Screen, wanted_words};
use sgs_engine::graph::{Graph, GraphError};

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
    let region = match (f.o.cross_view || f.o.relight, f.inputs.regions) {
        (true, Some(ids)) => {
            let mask = g.transient("region_mask", 4 * wanted_words(pixels));
            region_mask(g, *f.t, &f.screen, ids, mask)?;
            Some(mask)
        }
        _ => None,
    };
    if let (Some(mask), Some(priors), true) = (region, f.inputs.albedo_priors, f.o.relight) {
        let estimate = Msg {
            step: f.steps.shaded,
            weights: f.steps.weights,
            pictures: MaterialPictures { roughness: None, ..asked.pictures },
            coverage: f.seen.coverage,
            albedo_prior: priors,
            roughness_prior: None,
            all_views: true,
            mask: Some(mask),
            largest: f.o.shape.largest,
        };
        asked.losses.relight[0] = Some(relight(g, *f.t, &estimate, 0, 1.0, asked.by_picture.albedo)?);
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
            let depth = surface_depth(g, f.t, &other, &surface.surfaces)?;
            let seen_there = Seen { screen: other, blended: depth, channels: SURFACE_DEPTH };
            let carried = g.transient("carried", 4 * wanted_words(pixels));
            carry_mask(g, *f.t, "carry_mask", &trained, mask, &seen_there, CarryOptions::default(), carried)?;
            let by_picture = pictures(g, "grad_pictures", f.o.shape.largest, false);
            g.fill("clear_grad_pictures", by_picture.albedo, 0)?;
            compared.push(CrossPicture {
                step,
                albedo: picture.albedo,
                mask: carried,
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
