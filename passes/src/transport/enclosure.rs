//! Box around a scene, whose patches close the transport of light.
//!
//! A ray that meets no surfel meets a patch, so that what no photograph shows is neither black nor open. `enclosure.glsl`
//! finds the patch of a ray.

use super::Surfels;
use sgs_shaders::structs::EnclosureBox;

/// Largest number of patches.
const PATCHES: u64 = 1 << 24;

/// Reason why an enclosure cannot be built.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum EnclosureError {
    /// The corners do not span a box.
    #[error(
        "building the enclosure failed: its corners are {low:?} and {high:?}; give finite ones, each coordinate of the second above the first's"
    )]
    Corners {
        /// Corner with the least coordinates.
        low: [f32; 3],
        /// Corner with the largest coordinates.
        high: [f32; 3],
    },
    /// The size of a cell is not a length.
    #[error("building the enclosure failed: its cells have a side of {cell}; give a finite length above 0")]
    Cell {
        /// Side of a cell.
        cell: f32,
    },
    /// The faces have too many cells.
    #[error(
        "building the enclosure failed: its faces have {patches} cells, and {PATCHES} are the most; give larger cells"
    )]
    Patches {
        /// Number of cells.
        patches: u64,
    },
}

/// Axis-aligned box, its faces cut into patches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Enclosure {
    low: [f32; 3],
    high: [f32; 3],
    cells: [u32; 3],
}

/// Patch of an enclosure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Patch {
    /// Center.
    pub center: [f32; 3],
    /// Unit normal, into the box.
    pub normal: [f32; 3],
    /// Face: 0 to 5 for low x, high x, low y, high y, low z, high z.
    pub face: u32,
    /// Area.
    pub area: f32,
}

impl Enclosure {
    /// Creates the box between two corners. Cells have about the side `cell`, at least one along each axis.
    ///
    /// # Errors
    /// If the corners span no box, if `cell` is not a length, or if there are too many cells.
    pub fn new(low: [f32; 3], high: [f32; 3], cell: f32) -> Result<Enclosure, EnclosureError> {
        if !(0..3)
            .all(|k| low[k].is_finite() && high[k].is_finite() && low[k] < high[k] && (high[k] - low[k]).is_finite())
        {
            return Err(EnclosureError::Corners { low, high });
        }
        if !(cell.is_finite() && cell > 0.0) {
            return Err(EnclosureError::Cell { cell });
        }
        let cells = [0, 1, 2].map(|k| (f64::from(high[k] - low[k]) / f64::from(cell)).round().clamp(1.0, 1e6) as u64);
        let patches = 2 * (cells[0] * cells[1] + cells[1] * cells[2] + cells[2] * cells[0]);
        if patches > PATCHES {
            return Err(EnclosureError::Patches { patches });
        }
        Ok(Enclosure { low, high, cells: cells.map(|c| c as u32) })
    }

    /// Returns the corner with the least coordinates.
    pub fn low(&self) -> [f32; 3] {
        self.low
    }

    /// Returns the corner with the largest coordinates.
    pub fn high(&self) -> [f32; 3] {
        self.high
    }

    /// Returns the number of cells along each axis.
    pub fn cells(&self) -> [u32; 3] {
        self.cells
    }

    /// Returns the number of patches.
    pub fn patch_count(&self) -> u32 {
        let [x, y, z] = self.cells;
        2 * (x * y + y * z + z * x)
    }

    /// Returns the patches in the order of their numbers. A face's cells follow each other along the next axis first.
    pub fn patches(&self) -> Vec<Patch> {
        let side = |k: usize| (self.high[k] - self.low[k]) / self.cells[k] as f32;
        let mut all = Vec::with_capacity(self.patch_count() as usize);
        for face in 0..6_u32 {
            let axis = face as usize / 2;
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            for at in 0..self.cells[u] * self.cells[v] {
                let (mut center, mut normal) = ([0.0; 3], [0.0; 3]);
                center[axis] = if face % 2 == 0 { self.low[axis] } else { self.high[axis] };
                normal[axis] = if face % 2 == 0 { 1.0 } else { -1.0 };
                for (k, cell) in [(u, at % self.cells[u]), (v, at / self.cells[u])] {
                    center[k] = self.low[k] + (cell as f32 + 0.5) * side(k);
                }
                all.push(Patch { center, normal, face, area: side(u) * side(v) });
            }
        }
        all
    }

    /// Returns the box as kernels read it.
    pub fn shape(&self) -> EnclosureBox {
        EnclosureBox { low: self.low, high: self.high, cells: self.cells }
    }
}

/// Returns surfels and patches as kernels read receivers, 8 floats each.
///
/// Surfels come first. A receiver is its point, its radius (0 for a patch), its normal and 0.
pub fn receivers(surfels: &Surfels, enclosure: &Enclosure) -> Vec<f32> {
    let record = |[x, y, z]: [f32; 3], radius: f32, [a, b, c]: [f32; 3]| [x, y, z, radius, a, b, c, 0.0];
    let discs = (0..surfels.len()).map(|i| record(surfels.points[i], surfels.radii[i], surfels.normals[i]));
    let patches = enclosure.patches().into_iter().map(|p| record(p.center, 0.0, p.normal));
    discs.chain(patches).flatten().collect()
}
