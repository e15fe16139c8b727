//! Graphs of blending with every number of subgroups per tile.
//!
//! Other graphs have views of one size, and thus one number of subgroups.

use super::entries::{CAPACITY, EntryGraph};
use sgs_engine::Device;
use sgs_passes::Tuning;
use sgs_passes::splat::{BackwardKernel, Blended, Channels, blend, blend_bwd, blend_debt, blend_for};

/// Builds the forward passes and the backward pass over buckets.
///
/// Each with colors alone and with all channels.
pub fn build(device: &Device) -> anyhow::Result<()> {
    for (normals, parts) in [false, true].into_iter().flat_map(|normals| [1, 2, 4, 8].map(|parts| (normals, parts))) {
        let t = Tuning { tile_parts: Some(parts), ..Tuning::for_device(device.info()) };
        let channels = Channels { colors: true, normals, depth: normals };
        let mut v = EntryGraph::new(device, "parts", &t, channels)?;
        let (g, screen) = (&mut v.graph, &v.screen);
        let mut blended = |name: &str| Blended {
            image: g.external(format!("{name}.image"), v.image_bytes),
            transmittance: g.external(format!("{name}.transmittance"), 4 * screen.pixels()),
        };
        let [plain, kept, gradient] = ["plain", "kept", "gradient"].map(&mut blended);
        blend(g, &t, screen, &v.visible, &v.entries, &plain)?;
        let which = BackwardKernel::Bucket;
        let buckets = blend_for(g, &t, screen, &v.visible, &v.entries, &kept, which)?;
        let mut owed = blend_debt(g, &t, screen, channels.count(), &kept, &gradient)?;
        owed.buckets = buckets;
        let sums = blend_bwd(g, &t, screen, &v.visible, &v.entries, &owed, which, true)?;
        let rows = g.external("rows", 4 * u64::from(7 + channels.count()) * u64::from(CAPACITY));
        g.copy("keep", sums.gradients, rows)?;
        v.finish(device)?;
    }
    Ok(())
}
