//! Parts of a tile: several subgroups blend one tile of a small view, so that the view occupies the device.
//!
//! Cost: each part fetches all entries of its tile, from a cache after the first one. It visits only the entries that can
//! show in its pixels. So parts share the arithmetic, and repeat the fetches and the tests of entries.

use super::Screen;
use crate::Tuning;

/// Subgroups of a compute unit that hide latencies: four for each of its schedulers.
const PER_UNIT: u32 = 16;

/// Largest number of parts of a tile.
const MOST: u32 = 8;

/// Returns the number of subgroups that should blend a tile: a power of two.
///
/// `tiles`: of the largest view. It depends on the device and the size of views only, so that every run takes the same number.
fn wanted(t: &Tuning, tiles: u32) -> u32 {
    if t.cpu {
        // Few threads run all subgroups, so parts would only repeat fetches.
        return 1;
    }
    t.parts(PER_UNIT).div_ceil(tiles.max(1)).clamp(1, MOST).next_power_of_two()
}

/// Returns the columns and rows of the part of a tile that a subgroup blends.
///
/// The longer side is halved again and again, as long as whole slots are left. A square meets fewest splats.
pub(super) fn part(t: &Tuning, screen: &Screen) -> [u32; 2] {
    let slot = t.slot();
    let wanted = t.tile_parts.unwrap_or_else(|| wanted(t, screen.tiles()));
    let (mut part, mut parts) = (screen.tile, 1);
    while parts < wanted {
        let by_length = if part[0] > part[1] { [0, 1] } else { [1, 0] };
        let Some(axis) = by_length.into_iter().find(|&axis| part[axis].is_multiple_of(2 * slot[axis])) else { break };
        part[axis] /= 2;
        parts *= 2;
    }
    part
}

/// Returns the number of parts of a tile.
pub(super) fn count(screen: &Screen, part: [u32; 2]) -> u32 {
    screen.tile[0] / part[0] * (screen.tile[1] / part[1])
}

/// Returns the pixels of a lane of a part.
pub(super) fn per_lane(t: &Tuning, part: [u32; 2]) -> u32 {
    (part[0] * part[1] / t.subgroup_size).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use sgs_engine::graph::Graph;

    fn screen(t: &Tuning, largest: [u32; 2]) -> Screen {
        Screen { step: Graph::new("screen").uniform("step", 4), largest, tile: t.tile }
    }

    #[test]
    fn few_tiles_have_more_parts() {
        let h200 = Tuning { units: 132, ..Tuning::for_subgroups(32) };
        let of = |t: &Tuning, size| count(&screen(t, size), part(t, &screen(t, size)));
        assert_eq!([[1920, 1080], [640, 480], [426, 320], [160, 120]].map(|size| of(&h200, size)), [1, 2, 4, 8]);
        let unknown = Tuning::for_subgroups(64);
        assert_eq!([[1920, 1080], [426, 320], [160, 120]].map(|size| of(&unknown, size)), [1, 2, 4]);
        let cpu = Tuning { cpu: true, workers: 8, ..Tuning::for_subgroups(8) };
        assert_eq!(of(&cpu, [8, 8]), 1);
    }

    #[test]
    fn parts_are_as_square_as_slots_allow() {
        let of = |t: Tuning, parts| part(&Tuning { tile_parts: Some(parts), ..t }, &screen(&t, [64, 64]));
        let wide = Tuning::for_subgroups(32);
        assert_eq!([1, 2, 4, 8, 16].map(|n| of(wide, n)), [[16, 16], [16, 8], [8, 8], [8, 4], [8, 4]]);
        let rows = Tuning { slot_width: 16, ..wide };
        assert_eq!([2, 4, 8].map(|n| of(rows, n)), [[16, 8], [16, 4], [16, 2]]);
        let columns = Tuning { slot_width: 4, ..Tuning::for_subgroups(64) };
        assert_eq!([2, 4, 8].map(|n| of(columns, n)), [[8, 16], [4, 16], [4, 16]]);
        let narrow = Tuning::for_subgroups(8);
        assert_eq!([2, 4, 8, 16].map(|n| of(narrow, n)), [[8, 8], [8, 4], [8, 2], [8, 1]]);
        for lanes in [8, 16, 32, 64, 128] {
            let t = Tuning::for_subgroups(lanes);
            for parts in [1, 2, 4, 8] {
                let p = of(t, parts);
                assert_eq!(p[0] * p[1], lanes * per_lane(&t, p), "{lanes} lanes, {parts} parts");
                assert_eq!(count(&screen(&t, [64, 64]), p), parts.min(t.tile[0] * t.tile[1] / lanes));
            }
        }
    }
}
