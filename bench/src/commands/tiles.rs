//! Tiles of a report's view, and how unevenly they load the schedulers of a device.

use crate::report::Report;
use sgs_engine::graph::Plan;
use sgs_passes::cost::constant;

/// Fact with the number of entries of all tiles of a view.
pub const ALL_TILES: &str = "entries of all tiles";

/// Fact with the number of entries of the tile that has most.
pub const LONGEST_TILE: &str = "entries of the longest tile";

/// Fact with the sides of a tile, and the shares of its pixels that entries need.
pub const TILE: &str = "tile; of its pixels an entry tries, shows at";

/// Fact with the number of subgroups of a tile in the forward pass of blending.
pub const TILE_PARTS: &str = "subgroups of a tile, forward pass";

/// Passes with a subgroup per tile.
const BY_TILE: [&str; 3] = ["blend_bwd", "blend_bwd_atomic", "blend_bwd_splat"];

/// Passes with a subgroup per part of a tile. Views of many tiles have one part (ADR 0030).
const BY_PART: [&str; 2] = ["blend", "blend_buckets"];

/// Returns the number of subgroups of a tile in the forward pass of a plan.
pub fn parts(plan: &Plan) -> Option<f64> {
    plan.passes.iter().find_map(|pass| {
        let of = |name: &str| constant(pass, name);
        Some(of("TILE_WIDTH")? / of("PART_WIDTH")? * (of("TILE_HEIGHT")? / of("PART_HEIGHT")?))
    })
}

/// Tiles of a view.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tiles {
    /// Number of tiles of the largest view; 0 if unknown.
    count: f64,
    /// Share of a view's entries that its longest tile has; 0 if unknown.
    longest: f64,
    /// Subgroups of a tile in the forward pass; absent in reports from before tiles had parts.
    parts: Option<f64>,
}

impl Tiles {
    /// Returns the tiles of a report. Facts that the report lacks are unknown.
    pub fn of(report: &Report) -> Tiles {
        let value = |name: &str| report.facts.iter().find(|fact| fact.name == name).map(|fact| &fact.value);
        let number = |name: &str| value(name).and_then(|v| v.as_f64()).filter(|v| *v > 0.0);
        let tile = value(TILE).and_then(|v| v.as_str()).and_then(|text| sides(text.split(';').next()?));
        let view = report.setting_text("size").and_then(|text| sides(&text));
        let count = |(view, tile): ([f64; 2], [f64; 2])| (view[0] / tile[0]).ceil() * (view[1] / tile[1]).ceil();
        Tiles {
            count: view.zip(tile).map_or(0.0, count),
            longest: number(LONGEST_TILE).zip(number(ALL_TILES)).map_or(0.0, |(longest, all)| longest / all),
            parts: number(TILE_PARTS),
        }
    }

    /// Returns the time of a pass relative to evenly loaded schedulers; 1 if unknown.
    ///
    /// A scheduler runs its subgroups one after the other. One scheduler has the longest tile. One has
    /// `subgroups / schedulers` of them, rounded up, which are assumed to be equally long. The slower of both determines
    /// the time. Parts of a tile count as equal shares of it. Other devices are assumed to split tiles as the measured one.
    pub fn imbalance(&self, pass: &str, schedulers: f64) -> f64 {
        let parts = match pass {
            pass if BY_TILE.contains(&pass) => 1.0,
            pass if BY_PART.contains(&pass) => self.parts.unwrap_or(1.0),
            _ => return 1.0,
        };
        let subgroups = parts * self.count;
        let rounds = if subgroups > 0.0 { (subgroups / schedulers).ceil() * schedulers / subgroups } else { 1.0 };
        rounds.max(schedulers * self.longest / parts).max(1.0)
    }
}

/// Parses the sides of a rectangle, such as 426x320.
fn sides(text: &str) -> Option<[f64; 2]> {
    let (width, height) = text.split_once('x')?;
    let side = |text: &str| text.trim().parse::<f64>().ok().filter(|side| *side >= 1.0);
    Some([side(width)?, side(height)?])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::DeviceLine;

    fn report(size: &str) -> Report {
        let text = String::new;
        let device = DeviceLine { name: text(), kind: text(), driver: text(), api: text(), subgroup_size: 32 };
        let mut report = Report::new("step", device, 1, 0);
        report.setting("size", size);
        report
    }

    #[test]
    fn few_tiles_load_schedulers_unevenly() {
        let mut report = report("426x320");
        // Without facts no pass is uneven.
        assert_eq!(Tiles::of(&report), Tiles::default());
        assert_eq!(Tiles::of(&report).imbalance("blend_bwd", 528.0), 1.0);
        report.fact(TILE, "16x16; 44.0 %, 24.4 %");
        let tiles = Tiles::of(&report);
        assert_eq!(tiles.count, 540.0);
        // Twelve schedulers have two tiles, the others one.
        assert_eq!(tiles.imbalance("blend_bwd", 528.0), 2.0 * 528.0 / 540.0);
        assert_eq!(tiles.imbalance("blend_bwd", 540.0), 1.0);
        assert_eq!(tiles.imbalance("blend_bwd", 1080.0), 2.0);
        assert_eq!(tiles.imbalance("photometric", 528.0), 1.0);
        // Reports from before tiles had parts have one subgroup per tile in the forward pass as well.
        assert_eq!(tiles.imbalance("blend", 528.0), 2.0 * 528.0 / 540.0);
        report.fact(TILE_PARTS, 4.0);
        let tiles = Tiles::of(&report);
        assert_eq!(tiles.imbalance("blend", 528.0), 5.0 * 528.0 / 2160.0);
        assert_eq!(tiles.imbalance("blend_bwd", 528.0), 2.0 * 528.0 / 540.0);
    }

    #[test]
    fn longest_tile_counts_if_it_takes_longer() {
        let mut report = report("426x320");
        report.fact(TILE, "16x16; 44.0 %, 24.4 %");
        report.fact(LONGEST_TILE, 500.0);
        report.fact(ALL_TILES, 10_000.0);
        let tiles = Tiles::of(&report);
        assert_eq!(tiles.longest, 0.05);
        assert_eq!(tiles.imbalance("blend_bwd", 100.0), 5.0);
        // A part has a quarter of the longest tile.
        assert_eq!(Tiles { parts: Some(4.0), ..tiles }.imbalance("blend", 100.0), 1.25);
        assert_eq!(Tiles { longest: 0.001, ..tiles }.imbalance("blend_bwd", 528.0), 2.0 * 528.0 / 540.0);
    }

    #[test]
    fn sides_are_positive_numbers() {
        assert_eq!(sides("8x16"), Some([8.0, 16.0]));
        assert!(["16", "x16", "0x16", "16xa"].iter().all(|text| sides(text).is_none()));
    }
}
