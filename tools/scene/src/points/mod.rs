//! Point clouds: where splats begin.

mod file;
mod neighbors;
mod random;
mod tracks;

pub(crate) use neighbors::mean_square_distances;
pub use random::{Pcg, RandomBox};
pub(crate) use tracks::Tracks;

/// Points of a surface, with what is known about them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PointCloud {
    /// Positions in the world.
    pub positions: Vec<[f32; 3]>,
    /// Display-referred (sRGB) colors in `[0, 1]`.
    pub colors: Option<Vec<[f32; 3]>>,
    /// Normals in the world, of any length; zero where unknown.
    pub normals: Option<Vec<[f32; 3]>>,
}

impl PointCloud {
    /// Number of points.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// `count` of the points, spread evenly over their order; all of them if there are no more.
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

    /// The points whose entry in `kept` is true.
    pub(crate) fn filtered(&self, kept: &[bool]) -> PointCloud {
        let of = |values: &[[f32; 3]]| values.iter().zip(kept).filter(|(_, kept)| **kept).map(|(v, _)| *v).collect();
        PointCloud {
            positions: of(&self.positions),
            colors: self.colors.as_deref().map(of),
            normals: self.normals.as_deref().map(of),
        }
    }

    /// Whether colors and normals, where present, are as many as the points.
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
