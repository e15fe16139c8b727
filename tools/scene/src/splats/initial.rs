//! Initial splats from a point cloud.

use super::{SH_C0, Splats};
use crate::error::{Result, SceneError};
use crate::points::{PointCloud, mean_square_distances};

/// Smallest mean squared distance; duplicates are below it.
const MIN_SQUARE_DISTANCE: f32 = 1e-7;

/// Initial opacity of every splat.
const OPACITY: f32 = 0.1;

impl Splats {
    /// Creates one isotropic splat per point.
    ///
    /// The scale is the root of the mean squared distance to the three nearest neighbors. The opacity is 0.1. Band 0
    /// holds the color of the point, or gray without colors. Higher bands up to `sh_degree` are zero. Normals are
    /// copied.
    pub fn from_points(points: &PointCloud, sh_degree: usize) -> Result<Self> {
        if points.is_empty() {
            let problem = "there are no points to start splats from".into();
            return Err(SceneError::Data { what: "the point cloud", problem });
        }
        if let Some(problem) = points.problem() {
            return Err(SceneError::Data { what: "the point cloud", problem });
        }
        if points.positions.iter().flatten().any(|v| !v.is_finite()) {
            let problem = "some positions are not finite".into();
            return Err(SceneError::Data { what: "the point cloud", problem });
        }
        if sh_degree > 3 {
            let value = sh_degree.to_string();
            let expected = "the degree of the spherical harmonics must be 0 to 3";
            return Err(SceneError::Option { option: "sh_degree", value, expected });
        }
        let n = points.len();
        let distances = mean_square_distances(&points.positions);
        let log_scale = |d2: &f32| [0.5 * d2.clamp(MIN_SQUARE_DISTANCE, f32::MAX).ln(); 3];
        let dc = match &points.colors {
            Some(colors) => colors.iter().flatten().map(|c| (c - 0.5) / SH_C0).collect(),
            None => vec![0.0; n * 3],
        };
        let mut sh: [Vec<f32>; 4] =
            std::array::from_fn(|d| if d <= sh_degree { vec![0.0; n * (2 * d + 1) * 3] } else { Vec::new() });
        sh[0] = dc;
        Ok(Self {
            means: points.positions.clone(),
            log_scales: distances.iter().map(log_scale).collect(),
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; n],
            opacity_logits: vec![(OPACITY / (1.0 - OPACITY)).ln(); n],
            sh,
            normals: points.normals.clone(),
            ..Self::default()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn initial_values_match_3dgs() {
        let points = PointCloud {
            positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0], [9.0, 9.0, 9.0]],
            colors: Some(vec![[0.5, 1.0, 0.0]; 5]),
            normals: Some(vec![[0.0, 0.0, 2.0]; 5]),
        };
        let splats = Splats::from_points(&points, 2).unwrap();
        splats.check().unwrap();
        // The neighbors of the origin are at 1, 2 and 3, so the mean square is 14/3.
        let expected = (14.0_f32 / 3.0).sqrt().ln();
        assert!(splats.log_scales[0].iter().all(|v| (v - expected).abs() < 1e-6));
        assert!((splats.opacity_logits[4] + 2.197_224_6).abs() < 1e-6);
        assert_eq!(splats.rotations[2], [1.0, 0.0, 0.0, 0.0]);
        assert!((splats.sh[0][1] - 0.5 / 0.282_094_8).abs() < 1e-6);
        assert_eq!((splats.sh[0][0], splats.sh[1].len(), splats.sh[2].len(), splats.sh[3].len()), (0.0, 45, 75, 0));
        assert_eq!(splats.normals, points.normals);
    }

    #[test]
    fn duplicates_and_single_points_have_the_smallest_scale() {
        for positions in [vec![[1.0; 3]], vec![[1.0; 3]; 9]] {
            let splats = Splats::from_points(&PointCloud { positions, ..Default::default() }, 0).unwrap();
            assert!(splats.log_scales.iter().flatten().all(|v| (v - 0.5 * 1e-7_f32.ln()).abs() < 1e-6));
            assert!(splats.sh[0].iter().all(|&v| v == 0.0));
        }
    }

    #[test]
    fn invalid_input_is_rejected() {
        let fail = |positions: Vec<[f32; 3]>, degree| {
            Splats::from_points(&PointCloud { positions, ..Default::default() }, degree).unwrap_err().to_string()
        };
        assert_eq!(fail(vec![], 0), "the point cloud: there are no points to start splats from");
        assert!(fail(vec![[0.0, f32::NAN, 0.0]], 0).contains("not finite"));
        assert_eq!(fail(vec![[0.0; 3]], 4), "sh_degree is 4, but the degree of the spherical harmonics must be 0 to 3");
        let far = Splats::from_points(&PointCloud { positions: vec![[3e38; 3], [-3e38; 3]], ..Default::default() }, 0);
        assert!(far.unwrap().log_scales.iter().flatten().all(|v| v.is_finite()));
    }
}
