//! Pseudo-views of a step.
//!
//! They are rendered like the training view and compared with it in one region. Their gradients reach the Gaussians
//! together with those of the training view. Pseudo-views blend only features and depth, no colors. A region that is
//! empty in an image costs its rendering and gives no gradients.

use super::build::{Built, FEATURE_BYTES, Rendering, render};
use super::inputs::InputHandles;
use super::{GeometryOptions, Masks, PSEUDO_VIEWS};
use crate::Tuning;
use crate::loss::{
    CarryOptions, Correspondence, Head, ImagePart, Prepared, Regions, Seen, carry_mask, correspondence_bwd,
    correspondence_train_bwd, region, region_mask, regions, wanted_samples,
};
use crate::pipeline::status::StatusHandles;
use crate::scene::{Group, Handles};
use crate::splat::{
    BackwardKernel, Channels, EntryFeatures, ExtraGradients, Wanted, blend_features, blend_features_bwd, features_bwd,
    project_bwd_features, wanted_words,
};
use sgs_engine::graph::{Buffer, Graph};

/// Prefixes of the pass names, by pseudo-view.
const PREFIXES: [&str; PSEUDO_VIEWS] = ["pseudo0.", "pseudo1."];

/// Region of the step in the training view.
pub(super) struct Region {
    /// One bit per pixel, from the step's `mask_offset`.
    pub mask: Buffer,
    masks: Masks,
    /// Region ids of the pseudo-views, for numbered masks.
    ids: Option<Buffer>,
    steps: [Buffer; PSEUDO_VIEWS],
}

/// Output of the pseudo-views for the optimizer.
pub(super) struct Pseudo {
    /// Gradients of positions, shapes and opacities.
    pub extra: Option<ExtraGradients>,
    /// `[Gaussians * 32]` floats: gradients of features, to which the training view adds its own.
    pub grad_features: Buffer,
    /// Number of tile entries that each pseudo-view required.
    pub wanted: [Buffer; PSEUDO_VIEWS],
}

/// Pseudo-view whose features have gradients.
struct Compared {
    view: Rendering,
    wanted: Wanted,
    image: Buffer,
    gradient: Buffer,
}

/// All pseudo-views of a step.
pub(super) struct Views([Compared; PSEUDO_VIEWS]);

/// Training view of a comparison.
pub(super) struct Training<'a> {
    pub view: &'a Rendering,
    /// Semantic head, and its prepared classes.
    pub head: (&'a Head, &'a Prepared),
    /// Its feature image.
    pub image: Buffer,
    /// Gradient of its feature image.
    pub gradient: Buffer,
}

impl Region {
    /// Declares the region; `None` without masks or regions.
    pub fn of(
        g: &mut Graph,
        t: &Tuning,
        view: &Rendering,
        inputs: &InputHandles,
        o: &GeometryOptions,
        steps: [Buffer; PSEUDO_VIEWS],
    ) -> Built<Option<Region>> {
        let (Some(masks), Some(regions)) = (o.pseudo, inputs.regions) else { return Ok(None) };
        let mask = match masks {
            Masks::Provided => regions,
            Masks::Carried | Masks::Numbered => {
                let mask = g.transient("region_mask", 4 * wanted_words(view.screen.pixels()));
                region_mask(g, *t, &view.screen, regions, mask)?;
                mask
            }
        };
        Ok(Some(Region { mask, masks, ids: inputs.pseudo_regions, steps }))
    }

    /// Renders the pseudo-views and compares the region across all views.
    ///
    /// Adds to the gradient of the training view.
    pub fn compare(
        self,
        g: &mut Graph,
        t: &Tuning,
        gaussians: &Handles,
        status: &StatusHandles,
        trained: &Training<'_>,
        o: &GeometryOptions,
    ) -> Built<(Views, (Correspondence, Regions))> {
        let &Training { view, head: (head, prepared), .. } = trained;
        let seen = |v: &Rendering| Seen { screen: v.screen, blended: v.blended, channels: v.channels };
        let image_part = |v: &Rendering, image: Buffer, mask: Buffer| ImagePart {
            step: v.screen.step,
            image,
            channels: Group::Semantics.width(),
            first: 0,
            largest: v.screen.largest,
            mask,
        };
        let all = regions(g, PSEUDO_VIEWS as u32);
        let training = image_part(view, trained.image, self.mask);
        region(g, &training, head, prepared, &all, 0)?;
        let channels = Channels { colors: false, normals: false, depth: true };
        let mut one = |i: usize| -> Built<Compared> {
            g.set_prefix(PREFIXES[i]);
            // Depth of pseudo-views has no gradients, so no backward kernel follows.
            let none = BackwardKernel::Pixel;
            let view_i = render(g, t, self.steps[i], gaussians, status, channels, o, none)?;
            let pixels = view_i.screen.pixels();
            let wanted = g.transient("wanted", 4 * wanted_words(pixels));
            match (self.masks, self.ids) {
                (Masks::Numbered, Some(ids)) => region_mask(g, *t, &view_i.screen, ids, wanted)?,
                (Masks::Carried | Masks::Numbered, _) => {
                    let options = CarryOptions::default();
                    carry_mask(g, *t, "carry_mask", &seen(view), self.mask, &seen(&view_i), options, wanted)?;
                }
                // A pseudo-view has no samples, so the wanted pixels are those of the region.
                (Masks::Provided, _) => wanted_samples(g, *t, &view_i.screen, Some(self.mask), self.mask, wanted)?,
            }
            let image = g.transient("feature_image", FEATURE_BYTES * pixels);
            let wanted = Wanted { pixels: wanted, dense: true };
            blend_features(g, t, &view_i.screen, gaussians, &view_i.visible, &view_i.entries, wanted, image)?;
            let gradient = g.transient("grad_feature_image", FEATURE_BYTES * pixels);
            Ok(Compared { view: view_i, wanted, image, gradient })
        };
        let views = Views([one(0)?, one(1)?]);
        g.set_prefix("");
        let mask = |c: &Compared| if self.masks == Masks::Provided { self.mask } else { c.wanted.pixels };
        let images = views.0.each_ref().map(|c| (image_part(&c.view, c.image, mask(c)), c.gradient));
        for (i, (rendered, _)) in images.iter().enumerate() {
            region(g, rendered, head, prepared, &all, 1 + i as u32)?;
        }
        let losses = correspondence_bwd(g, *t, &images, head, prepared, &all)?;
        correspondence_train_bwd(g, *t, &training, &all, trained.gradient)?;
        Ok((views, (losses, all)))
    }
}

impl Views {
    /// Propagates the gradients of the pseudo-views to the Gaussians.
    pub fn gather(self, g: &mut Graph, t: &Tuning, gaussians: &Handles, o: &GeometryOptions) -> Built<Pseudo> {
        let features = 4 * u64::from(Group::Semantics.width()) * u64::from(gaussians.capacity);
        let grad_features = g.transient("grad_features", features);
        g.fill("clear_grad_features", grad_features, 0)?;
        let extra = if o.semantic_geometry { Some(ExtraGradients::cleared(g, gaussians.capacity)?) } else { None };
        for (i, c) in self.0.iter().enumerate() {
            g.set_prefix(PREFIXES[i]);
            let (screen, visible, entries) = (&c.view.screen, &c.view.visible, &c.view.entries);
            let entries: EntryFeatures =
                blend_features_bwd(g, t, screen, gaussians, visible, entries, c.wanted, c.image, c.gradient)?;
            features_bwd(g, t, visible, &entries, grad_features)?;
            if let Some(extra) = &extra {
                project_bwd_features(g, t, screen, gaussians, visible, &entries, extra)?;
            }
        }
        g.set_prefix("");
        Ok(Pseudo { extra, grad_features, wanted: self.0.each_ref().map(|c| c.view.entries.wanted) })
    }
}
