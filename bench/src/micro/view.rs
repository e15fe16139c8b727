//! Graph that projects and bins the Gaussians of a view; statistics of its blending.

use crate::harness::{Rig, bytes};
use sgs_engine::Device;
use sgs_engine::graph::{Buffer, Graph, Slice};
use sgs_passes::Tuning;
use sgs_passes::pipeline::{Camera, Step};
use sgs_passes::reference::sub_tiles;
use sgs_passes::scene::{GaussianData, Gaussians, Handles, Model};
use sgs_passes::splat::{Channels, Entries, Screen, Visible, intersect, project};
use sgs_shaders::structs::{Splat, Work};

/// Graph under construction with all inputs of blending.
pub struct View {
    /// Graph under construction.
    pub graph: Graph,
    /// Size and tiles of the image.
    pub screen: Screen,
    /// Gaussians.
    pub handles: Handles,
    /// Visible Gaussians.
    pub visible: Visible,
    /// Tile entries.
    pub entries: Entries,
    /// Contents of input buffers, extended by later stages.
    pub inputs: Vec<(Buffer, Vec<u8>)>,
    flags: Buffer,
    required: Buffer,
}

/// Gaussians and the view in which they are rendered.
pub struct Subject<'s> {
    /// Device that is measured.
    pub device: &'s Device,
    /// Kernel sizes.
    pub tuning: Tuning,
    /// Parameter groups of the Gaussians.
    pub model: Model,
    /// Gaussians to render.
    pub data: &'s GaussianData,
    /// Camera of the view.
    pub camera: Camera,
    /// Blended channels.
    pub channels: Channels,
}

impl Subject<'_> {
    /// Builds the view with the additions of `extend`.
    ///
    /// Grows the entry capacity as required.
    ///
    /// The returned rig has run once.
    ///
    /// # Errors
    /// If memory runs out or the device fails.
    pub fn rig<T>(&self, mut extend: impl FnMut(&mut View) -> anyhow::Result<T>) -> anyhow::Result<(Rig, T)> {
        let mut capacity = u32::try_from(self.data.len() * 4).unwrap_or(u32::MAX).max(1 << 14);
        for _ in 0..3 {
            let mut view = self.view(capacity)?;
            let more = extend(&mut view)?;
            let View { graph, inputs, flags, required, .. } = view;
            let mut rig = Rig::new(self.device, graph, inputs, true)?;
            rig.measure(1, 1)?;
            if rig.get::<u32>(flags)?[0] == 0 {
                return Ok((rig, more));
            }
            let required = rig.get::<u32>(required)?[0];
            capacity = required.saturating_add(required / 8);
        }
        anyhow::bail!("There is no room for the view's tile entries.")
    }

    fn view(&self, capacity: u32) -> anyhow::Result<View> {
        let t = self.tuning;
        let count = self.data.len() as u32;
        // Used for the declaration only: the rig allocates its own memory.
        let gaussians = Gaussians::new(self.device, self.model, count, false)?;
        let mut g = Graph::new("view");
        let step = g.uniform("step", size_of::<Step>() as u64);
        let screen = Screen { step, largest: self.camera.size, tile: t.tile };
        let handles = gaussians.declare(&mut g, false);
        let flags = g.external("flags", 4);
        let required = g.external("wanted", 4);
        let visible = project(&mut g, &t, &screen, &handles, self.channels)?;
        let entries = intersect(&mut g, &t, &screen, &visible, capacity, flags)?;
        g.copy("out.wanted", entries.wanted, required)?;
        let mut inputs = handles.contents(self.data);
        let mut camera = self.camera;
        camera.tiles = [camera.size[0].div_ceil(t.tile[0]), camera.size[1].div_ceil(t.tile[1])];
        let values = Step { camera, step: 1, sh_degree: self.model.sh_degree, ..Default::default() };
        inputs.push((step, bytes(&[values])));
        Ok(View { graph: g, screen, handles, visible, entries, inputs, flags, required })
    }
}

impl View {
    /// Copies a transient to an external buffer for readback.
    ///
    /// # Errors
    /// If the graph refuses the copy.
    pub fn keep(&mut self, name: &str, what: impl Into<Slice>, bytes: u64) -> anyhow::Result<Buffer> {
        let output = self.graph.external(name, bytes);
        let what: Slice = what.into();
        self.graph.copy(format!("out.{name}"), Slice { bytes, ..what }, output)?;
        Ok(output)
    }
}

/// Returns a count with the dispatch arguments for 256 elements per workgroup.
pub fn work_of(count: u32) -> Work {
    let groups = count.div_ceil(256).max(1);
    let x = groups.min(65_535);
    Work { x, y: groups.div_ceil(x), z: 1, count }
}

/// Blending workload of a view.
#[derive(Clone, Copy, Debug, Default)]
pub struct Overlap {
    /// Number of visible splats.
    pub visible: f64,
    /// Number of tile entries.
    pub entries: f64,
    /// Mean number of pixels per entry that blending tries.
    ///
    /// They are not yet opaque at its turn, and lie in slots that are not skipped.
    pub tried: f64,
    /// Mean number of these pixels where the entry has an alpha of at least 1/255.
    pub showing: f64,
    /// Share of the pairs of entry and slot that sub-tiles leave.
    ///
    /// Counted whether these are on or not.
    pub slots: f64,
    /// Entries of the tile that has most.
    pub longest: f64,
}

/// Approximate maximum of entry-pixel pairs that are evaluated. Beyond it, tiles are skipped evenly.
const PAIRS: u64 = 40_000_000;

/// Evaluates the tiles of a view on the host in the order of blending.
///
/// # Errors
/// If the device fails.
pub fn overlap(s: &Subject<'_>) -> anyhow::Result<Overlap> {
    overlap_of(s, s.tuning.slot())
}

/// Evaluates the tiles of a view like [`overlap`], with other slots.
///
/// # Errors
/// If the device fails.
pub fn overlap_of(s: &Subject<'_>, slot: [u32; 2]) -> anyhow::Result<Overlap> {
    let (rig, [ranges, sorted, owners, splats, visible]) = s.rig(|v| {
        let (e, n) = (u64::from(v.entries.capacity), u64::from(v.visible.capacity));
        let (tiles, entries, visible) = (u64::from(v.screen.tiles()), v.entries, v.visible);
        Ok([
            v.keep("tile_ranges", entries.tile_ranges, 8 * tiles)?,
            v.keep("sorted", entries.sorted, 4 * e)?,
            v.keep("entry_splats", entries.splats, 4 * e)?,
            v.keep("splats", visible.splats, size_of::<Splat>() as u64 * n)?,
            v.keep("visible", visible.work.slice, size_of::<Work>() as u64)?,
        ])
    })?;
    let ranges: Vec<[u32; 2]> = rig.get(ranges)?;
    let (sorted, owners): (Vec<u32>, Vec<u32>) = (rig.get(sorted)?, rig.get(owners)?);
    let splats: Vec<Splat> = rig.get(splats)?;
    let [width, height] = s.tuning.tile;
    let across = s.camera.size[0].div_ceil(width);
    let entries: u64 = ranges.iter().map(|r| u64::from(r[1] - r[0])).sum();
    let every = (entries * u64::from(width * height) / PAIRS + 1) as usize;
    let slots = width / slot[0] * (height / slot[1]);
    let margins = [f64::from(s.tuning.slot_margin), sub_tiles::GAP];
    let alpha_min = f64::from(s.tuning.accuracy.alpha_min);
    let (mut walked, mut tried, mut showing, mut left) = (0_u64, 0_u64, 0_u64, 0_u64);
    for (tile, range) in ranges.iter().enumerate().step_by(every) {
        walked += u64::from(range[1] - range[0]);
        let corner = [tile as u32 % across * width, tile as u32 / across * height];
        let list: Vec<(&Splat, u32)> = sorted[range[0] as usize..range[1] as usize]
            .iter()
            .map(|&e| &splats[owners[e as usize] as usize])
            .map(|splat| (splat, sub_tiles::touched(splat, alpha_min, corner, s.tuning.tile, slot, margins)))
            .collect();
        left += list.iter().map(|(_, touched)| u64::from(touched.count_ones())).sum::<u64>();
        for pixel in 0..width * height {
            let at = [corner[0] + pixel % width, corner[1] + pixel / width];
            if at[0] >= s.camera.size[0] || at[1] >= s.camera.size[1] {
                continue;
            }
            let own = pixel / width / slot[1] * (width / slot[0]) + pixel % width / slot[0];
            let kept = |touched: u32| !s.tuning.sub_tiles || touched >> own & 1 == 1;
            let order = list.iter().filter(|(_, touched)| kept(*touched)).map(|(splat, _)| *splat);
            let (t, contributing) = walk(order, at.map(|x| x as f32 + 0.5));
            tried += t;
            showing += contributing;
        }
    }
    let each = 1.0 / walked.max(1) as f64;
    let visible = f64::from(rig.get::<Work>(visible)?[0].count);
    Ok(Overlap {
        visible,
        entries: entries as f64,
        tried: tried as f64 * each,
        showing: showing as f64 * each,
        slots: left as f64 * each / f64::from(slots),
        longest: ranges.iter().map(|r| f64::from(r[1] - r[0])).fold(0.0, f64::max),
    })
}

/// Returns the numbers of splats that a pixel evaluates, and that contribute.
///
/// The evaluation stops when the pixel is opaque.
fn walk<'s>(order: impl Iterator<Item = &'s Splat>, at: [f32; 2]) -> (u64, u64) {
    let (mut transmittance, mut tried, mut showing) = (1.0_f32, 0, 0);
    for s in order {
        tried += 1;
        let (dx, dy) = (at[0] - s.mean[0], at[1] - s.mean[1]);
        let (p, q) = (s.factor[0] * dx + s.factor[1] * dy, s.factor[2] * dy);
        let alpha = (s.opacity * (-(p * p + q * q)).exp2()).min(0.99);
        if alpha >= 1.0 / 255.0 {
            showing += 1;
            transmittance *= 1.0 - alpha;
            if transmittance < 1e-4 {
                break;
            }
        }
    }
    (tried, showing)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixel_stops_when_opaque() {
        let splat = |x: f32| Splat { mean: [x, 0.5], factor: [1.0, 0.0, 1.0], opacity: 0.995 };
        let far = splat(100.0);
        let near = splat(0.5);
        // Two splats of alpha 0.99 leave a transmittance of 1e-4, which may round to either side of the threshold. A
        // third one ends the loop for certain.
        let (tried, showing) = walk([&far, &near, &near, &near, &near].into_iter(), [0.5, 0.5]);
        assert!((3..=4).contains(&tried) && showing == tried - 1, "{tried} {showing}");
        assert_eq!(walk([&far].into_iter(), [0.5, 0.5]), (1, 0));
    }
}
