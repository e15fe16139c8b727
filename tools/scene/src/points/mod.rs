//! Point clouds: the initial positions of splats.

mod file;
mod neighbors;
mod random;
mod tracks;

pub(crate) use neighbors::mean_square_distances;
pub use random::{Pcg, RandomBox};
pub(crate) use tracks::Tracks;

/// Surface points with optional attributes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PointCloud {
    /// Positions in world space.
    pub positions: Vec<[f32; 3]>,
    /// Display-referred (sRGB) colors in `[0, 1]`.
    pub colors: Option<Vec<[f32; 3]>>,
    /// World-space normals of any length; zero where unknown.
    pub normals: Option<Vec<[f32; 3]>>,
}

impl PointCloud {
    /// Returns the number of points.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Returns whether the cloud has no points.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Returns `count` points, spread evenly over their order. Returns all points if there are no more.
    #[must_use]
    pub fn spread(&self, count: usize) -> PointCloud {
        let n = self.len();
        let count = count.min(n);
        let of = |all: &Vec<[f32; 3]>| (0..count).filter_map(|i| all.get(i * n / count).copied()).collect();
        PointCloud {
            positions: of(&self.positions),
            colors: self.colors.as_ref().map(of),
            normals: self.normals.as_ref().map(of),
        }
    }

    /// Returns the points whose entry in `retained` is true.
    pub(crate) fn filtered(&self, retained: &[bool]) -> PointCloud {
        let of = |values: &[[f32; 3]]| {
            values.iter().zip(retained).filter(|(_, retained)| **retained).map(|(v, _)| *v).collect()
        };
        PointCloud {
            positions: of(&self.positions),
            colors: self.colors.as_deref().map(of),
            normals: self.normals.as_deref().map(of),
        }
    }

    /// Describes a mismatch between the numbers of positions, colors and normals. Returns `None` if they match.
    pub(crate) fn problem(&self) -> Option<String> {
        let n = self.len();
        for (name, other) in [("colors", &self.colors), ("normals", &self.normals)] {
            if let Some(other) = other
                && other.len() != n
            {
                return Some(format!("{} {name} do not fit {n} positions", other.len()));
            }
        }
        None
    }
}
