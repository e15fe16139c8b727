//! Minimum memory traffic and operations of every pass, as a function of counts.
//!
//! Measured times are compared with these numbers. Bytes are those that must come from or go to memory once, if caches
//! are perfect within a pass and empty between passes. Operations are in single precision; a multiply-add counts two,
//! as in the arithmetic rate of the ceiling. An exponential, root or division counts four. Both follow from the stage's
//! definition and the plan's specialization constants, not from the kernel's code. A kernel that does more than
//! necessary shows a lower share. Atomic operations are those on device memory.

mod area_lights;
mod atomics;
mod environment;
mod material;
mod meaning;
mod model;
mod shade;
mod surface;
mod transport;
mod visibility;

use crate::scene::Group;
use sgs_engine::graph::{Dispatch, Pass, PassKind, Plan};

/// Counts that costs depend on; means over the measured steps.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Counts {
    /// Number of Gaussians.
    pub gaussians: f64,
    /// Gaussians that are visible in a view.
    pub visible: f64,
    /// Tile entries.
    pub entries: f64,
    /// Pixels of a view.
    pub pixels: f64,
    /// Pairs of entry and pixel that blending must test. These are all entries of a tile at each of its pixels, until
    /// the pixel is opaque.
    pub pairs: f64,
    /// Scalars per Gaussian.
    pub width: f64,
    /// Elements of a primitive that is measured on its own.
    pub elements: f64,
    /// Gaussians that densification copies.
    pub moved: f64,
    /// Samples of a semantic target map.
    pub samples: f64,
    /// Pixels of a region.
    pub masked: f64,
    /// Pixels at which features are blended.
    pub wanted: f64,
    /// Lights that are on.
    pub lights: f64,
    /// Directional lights, of those that are on.
    pub suns: f64,
    /// Openings of a room.
    pub openings: f64,
    /// Parts of windows, of the lights that are on.
    pub windows: f64,
    /// Texels of the environment that windows show.
    pub sky: f64,
    /// Entries of hash tables that a step touches.
    pub touched: f64,
    /// Entries of the sparse matrix of blending weights, if geometry is fixed.
    pub weights: f64,
}

/// Cost of a pass.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Cost {
    /// Bytes read and written.
    pub bytes: f64,
    /// Arithmetic operations.
    pub operations: f64,
    /// Atomic operations on device memory.
    pub atomics: f64,
}

/// Returns the cost of all passes of a plan. The second value is the number of passes without a cost model.
pub fn of_plan(plan: &Plan, counts: &Counts) -> (Cost, usize) {
    let mut all = (Cost::default(), 0);
    for pass in &plan.passes {
        match cost(pass, counts) {
            Some(c) => {
                all.0.bytes += c.bytes;
                all.0.operations += c.operations;
                all.0.atomics += c.atomics;
            }
            // If the backward pass takes several dispatches, the first carries the cost of all.
            None if matches!(&pass.kind, PassKind::Compute { shader, .. } if shader.name == "blend_features_bwd") => {}
            None => all.1 += 1,
        }
    }
    all
}

/// Description of a pass in the plan.
struct Stage<'p> {
    kernel: &'p str,
    /// Specialization constants by name; absent ones are 0.
    specs: &'p dyn Fn(&str) -> f64,
    /// Push constants as words.
    push: &'p dyn Fn(usize) -> f64,
    /// Workgroups along x, if the plan knows them.
    groups: f64,
}

/// Returns a specialization constant of a pass; `None` if its kernel lacks it.
pub fn constant(pass: &Pass, name: &str) -> Option<f64> {
    let PassKind::Compute { shader, specs, .. } = &pass.kind else { return None };
    let constant = shader.specs.iter().find(|s| s.name == name)?;
    let specialized = specs.iter().find(|(id, _)| *id == constant.id);
    Some(f64::from(specialized.map_or(constant.default, |(_, bits)| *bits)))
}

/// Returns the cost of a pass, or `None` for an unknown kernel.
pub fn cost(pass: &Pass, counts: &Counts) -> Option<Cost> {
    match &pass.kind {
        PassKind::Fill { target, .. } => Some(Cost { bytes: target.bytes as f64, ..Default::default() }),
        PassKind::Copy { source: slice, .. }
        | PassKind::CopyToImage { source: slice, .. }
        | PassKind::CopyFromImage { target: slice, .. } => {
            Some(Cost { bytes: 2.0 * slice.bytes as f64, ..Default::default() })
        }
        // Every texel is written once; the plan knows the number of texels.
        PassKind::ClearImage { .. } => {
            let bytes = pass.accesses.iter().map(|(slice, ..)| slice.bytes as f64).sum();
            Some(Cost { bytes, ..Default::default() })
        }
        PassKind::Compute { shader, push, dispatch, .. } => {
            let spec = |name: &str| constant(pass, name).unwrap_or(0.0);
            let word = |i: usize| {
                let bytes = push.get(4 * i..4 * i + 4).and_then(|b| b.try_into().ok());
                f64::from(bytes.map_or(0, u32::from_le_bytes))
            };
            let groups = if let Dispatch::Groups([x, ..]) = dispatch { f64::from(*x) } else { 0.0 };
            let stage = Stage { kernel: &shader.name, specs: &spec, push: &word, groups };
            let elements = elements(&pass.name, counts);
            let cost = model::kernel(&stage, counts, elements)?;
            Some(Cost { atomics: atomics::count(&stage, counts), ..cost })
        }
    }
}

/// Returns the number of elements of a primitive, from its pass name. Names of a pseudo-view's passes begin with it.
fn elements(pass: &str, c: &Counts) -> f64 {
    let mut parts = pass.split('.').skip_while(|part| part.starts_with("pseudo"));
    match parts.next().unwrap_or(pass) {
        // One count per workgroup of 256 Gaussians.
        "project_scan" => (c.gaussians / 256.0).ceil(),
        "depth_sort" | "entry_scan" => c.visible,
        "tile_sort" => c.entries,
        owner if owner.starts_with("densify") || owner.starts_with("relocate") => c.gaussians,
        "adam" => {
            let group = parts.next().and_then(|name| Group::ALL.into_iter().find(|g| g.name() == name));
            group.map_or(c.elements, |g| f64::from(g.width()) * c.gaussians)
        }
        _ => c.elements,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Tuning;
    use crate::prim::{Count, radix_sort};
    use sgs_engine::graph::Graph;

    #[test]
    fn radix_sort_moves_twenty_bytes_per_element_and_digit() {
        let mut g = Graph::new("sort");
        let n = 1 << 20;
        let keys = g.input("keys", 4 * n);
        let tuning = Tuning::for_subgroups(32);
        let sorted = radix_sort(&mut g, tuning, "sort", keys, None, 0..32, true, Count::Host(n as u32)).unwrap();
        let out = g.external("out", 4 * n);
        g.copy("out", sorted.values, out).unwrap();
        let plan = g.compile(&Default::default()).unwrap();
        let counts = Counts { elements: n as f64, ..Default::default() };
        let passes = plan.passes.iter().filter(|p| p.name.starts_with("sort."));
        let bytes: f64 = passes.map(|p| cost(p, &counts).unwrap_or_else(|| panic!("{}", p.name)).bytes).sum();
        // Four digits of 20 bytes, 4 less for the values that the first digit generates. Per value of the digit and
        // block, 16 more: 1 per element and digit.
        assert!((bytes / n as f64 - (4.0 * 21.0 - 4.0)).abs() < 0.5, "{}", bytes / n as f64);
        // The copy adds one read and one write.
        let (all, unknown) = of_plan(&plan, &counts);
        assert!(unknown == 0 && (all.bytes - bytes - 8.0 * n as f64).abs() < 1.0, "{all:?} {bytes}");
    }
}
