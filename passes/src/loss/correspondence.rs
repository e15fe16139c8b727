//! `region`, `correspondence_bwd`, `correspondence_train_bwd`: correspondence loss of semantic features.
//!
//! A region of the training view should have the same features and the same class in pseudo-views. SGS-Intrinsic, stage
//! I. Inputs are a training view and p pseudo-views, with a mask of the same region in each. Terms:
//! * distance |mean features of the pseudo-view's region - mean features of the training view's region|;
//! * mean cross-entropy of the pseudo-view's pixels in the region to the most frequent class in the training view's
//!   region. That class has no gradient.
//!
//! Both are averaged over the pseudo-views and multiplied by `weight_correspondence`. The paper writes a sum: with two
//! pseudo-views, twice as much. A pseudo-view contributes 0 if its region, or the training view's, has fewer than 16
//! pixels; the mean is still over all p. Pixels with non-finite features belong to no region.
//!
//! The loss has two stages, so that a pipeline can render between them: [`region`] for every image, then the gradients.
//! `correspondence_bwd` writes the feature channels of a pseudo-view's gradient at the pixels of its mask only. No
//! other pixels are read ([`crate::splat::blend_features_bwd`] with the mask as the selected pixels).
//! `correspondence_train_bwd` adds to the gradients at the training view's mask, which must have been written
//! ([`super::semantic_loss`] with the mask among the selected pixels). Neither uses float atomics; classes of pixels
//! are counted with integer atomics. All kernels process lists of the masks' pixels, so the cost follows the region's
//! size.
//!
//! Cost. `region_sums`: 128 bytes and 32 operations per pixel of the mask, and 66 C more operations in the training
//! view. `correspondence_bwd`: 256 bytes and about 5000 + 270 C operations per pixel of the mask.
//! `correspondence_train_bwd`: 384 bytes per pixel of the mask.

use super::semantic::{Head, Prepared, batch_groups, partials, reduce};
use crate::Tuning;
use crate::kernel::stage;
use crate::scene::AUGMENTED;
use sgs_engine::graph::{Buffer, Graph, GraphError, Slice};
use sgs_shaders::structs::Region;
use sgs_shaders::{correspondence_bwd as pseudo, correspondence_train_bwd as train, region_finish, region_sums};

/// Image with the mask of a region.
#[derive(Clone, Copy, Debug)]
pub struct ImagePart {
    /// Uniform `Step` of this image: its size, `mask_offset`, weights.
    pub step: Buffer,
    /// `[P * channels]` floats.
    pub image: Buffer,
    /// Floats of a pixel of `image` and of its gradient.
    pub channels: u32,
    /// Channel of the first of the 32 features.
    pub first: u32,
    /// Upper bounds of the width and height of all views, in pixels.
    pub largest: [u32; 2],
    /// One bit per pixel ([`pack_mask`]), from word `mask_offset`.
    pub mask: Buffer,
}

impl ImagePart {
    fn pixels(&self) -> u64 {
        u64::from(self.largest[0]) * u64::from(self.largest[1])
    }
}

/// Region statistics of a training view and its pseudo-views.
#[derive(Clone, Copy, Debug)]
pub struct Regions {
    /// `[1 + pairs]` records of `Region`, the training view's first.
    pub buffer: Buffer,
    /// Number of pseudo-views.
    pub pairs: u32,
}

/// Loss sums of the pseudo-views.
#[derive(Clone, Copy, Debug)]
pub struct Correspondence {
    /// Cross-entropy by pseudo-view and workgroup.
    pub sums: Buffer,
    /// Number of workgroups of a pseudo-view.
    pub count: u32,
    /// Distance from the sums of one pseudo-view to those of the next, in floats.
    pub pitch: u32,
}

const REGION: u64 = size_of::<Region>() as u64;

/// Packs a mask into bits: pixel p is bit p % 32 of word p / 32.
pub fn pack_mask(mask: &[bool]) -> Vec<u32> {
    let word = |bits: &[bool]| bits.iter().enumerate().fold(0, |w, (i, &b)| w | u32::from(b) << i);
    mask.chunks(32).map(word).collect()
}

/// Declares the buffer of the regions.
pub fn regions(g: &mut Graph, pairs: u32) -> Regions {
    Regions { buffer: g.transient("correspondence.regions", u64::from(1 + pairs) * REGION), pairs }
}

fn slice(regions: &Regions, rendered: u32) -> Slice {
    regions.buffer.slice(u64::from(rendered) * REGION, REGION)
}

/// Returns the number of workgroups that share the words of a mask.
fn list_groups(tuning: Tuning, p: &ImagePart, classes: u32) -> u32 {
    batch_groups(tuning, p.pixels(), lane_pixels(tuning, p) * tuning.subgroup_size, 128 + 2 * classes)
}

fn lane_pixels(tuning: Tuning, p: &ImagePart) -> u32 {
    tuning.lane_pixels(p.pixels())
}

/// Adds the passes that compute the region of an image. Image 0 is the training view, the others are pseudo-views.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn region(
    g: &mut Graph,
    p: &ImagePart,
    head: &Head,
    prepared: &Prepared,
    into: &Regions,
    rendered: u32,
) -> Result<(), GraphError> {
    let name = |what: &str| format!("region{rendered}.{what}");
    let count = list_groups(prepared.tuning, p, head.classes);
    let sums = g.transient(name("sums"), u64::from(count) * 4 * AUGMENTED as u64);
    let histogram = g.transient(name("histogram"), 4 * u64::from(head.classes));
    g.fill(name("clear"), histogram, 0)?;
    let subgroup = prepared.tuning.subgroup_size;
    let bindings = region_sums::Bindings {
        params: p.step.into(),
        image: p.image.into(),
        mask: p.mask.into(),
        matrices: prepared.matrices.into(),
        region_sums: sums.into(),
        histogram: histogram.into(),
    };
    let specs = region_sums::Specs {
        subgroup,
        tiles: prepared.tuning.tiles(),
        classes: head.classes,
        channels: p.channels,
        first: p.first,
        classify: rendered == 0,
        lane_pixels: lane_pixels(prepared.tuning, p),
    };
    stage(g, &name("sum"), &region_sums::KERNEL, bindings.entries(), specs.entries(), &[])
        .subgroup_size(Some(subgroup))
        .dispatch([count, 1, 1])?;
    let bindings = region_finish::Bindings {
        region_sums: sums.into(),
        histogram: histogram.into(),
        region: slice(into, rendered),
    };
    let specs = region_finish::Specs { workgroup: 64, classes: head.classes };
    let push = region_finish::Push { groups: count };
    let name = name("finish");
    stage(g, &name, &region_finish::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch([1, 1, 1])
}

/// Adds the gradient passes of the pseudo-views. Each image comes with the gradient buffer that its passes write. The
/// passes also add to `prepared.accumulated`. The images are those of regions 1, 2, and so on, and have the same
/// `largest`.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn correspondence_bwd(
    g: &mut Graph,
    tuning: Tuning,
    images: &[(ImagePart, Buffer)],
    head: &Head,
    prepared: &Prepared,
    from: &Regions,
) -> Result<Correspondence, GraphError> {
    let count = images.iter().map(|(p, _)| list_groups(tuning, p, head.classes)).max().unwrap_or(1);
    // Sums of each pseudo-view have their own binding, which requires alignment.
    let pitch = count.next_multiple_of(64);
    let bytes = 4 * u64::from(pitch);
    let sums = g.transient("correspondence.sums", bytes * images.len().max(1) as u64);
    for (i, (p, grad_image)) in images.iter().enumerate() {
        let name = format!("correspondence{i}");
        let partials = partials(g, &name, head.classes, count);
        let bindings = pseudo::Bindings {
            params: p.step.into(),
            image: p.image.into(),
            mask: p.mask.into(),
            matrices: prepared.matrices.into(),
            trained: slice(from, 0),
            region: slice(from, 1 + i as u32),
            grad_image: (*grad_image).into(),
            partials: partials.into(),
            sums: sums.slice(i as u64 * bytes, bytes),
        };
        let specs = pseudo::Specs {
            subgroup: tuning.subgroup_size,
            tiles: tuning.tiles(),
            classes: head.classes,
            channels: p.channels,
            first: p.first,
            lane_pixels: lane_pixels(tuning, p),
        };
        let push = pseudo::Push { share: 1.0 / images.len() as f32 };
        let bytes = bytemuck::bytes_of(&push);
        stage(g, &format!("{name}.bwd"), &pseudo::KERNEL, bindings.entries(), specs.entries(), bytes)
            .subgroup_size(Some(tuning.subgroup_size))
            .dispatch([count, 1, 1])?;
        reduce(g, tuning, &name, partials, prepared, count)?;
    }
    Ok(Correspondence { sums, count, pitch })
}

/// Adds the training view's gradients to `grad_image`. Its feature channels must have been written.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn correspondence_train_bwd(
    g: &mut Graph,
    tuning: Tuning,
    p: &ImagePart,
    from: &Regions,
    grad_image: Buffer,
) -> Result<(), GraphError> {
    let bindings = train::Bindings {
        params: p.step.into(),
        image: p.image.into(),
        mask: p.mask.into(),
        regions: from.buffer.into(),
        grad_image: grad_image.into(),
    };
    let subgroup = tuning.subgroup_size;
    let lane_pixels = lane_pixels(tuning, p);
    let specs = train::Specs { subgroup, channels: p.channels, first: p.first, pairs: from.pairs, lane_pixels };
    stage(g, "correspondence_train_bwd", &train::KERNEL, bindings.entries(), specs.entries(), &[])
        .subgroup_size(Some(subgroup))
        .dispatch([list_groups(tuning, p, 0), 1, 1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pack_mask_starts_at_lowest_bit() {
        let mut mask = vec![false; 70];
        [0, 31, 33, 69].into_iter().for_each(|i| mask[i] = true);
        assert_eq!(pack_mask(&mask), [0x8000_0001, 2, 32]);
    }
}
