//! Conversion of poses from files, with orthonormal rotations.

use glam::{DMat3, DQuat, DVec3};

/// Largest deviation of an accepted rotation from orthonormal; files round to few digits.
const TOLERANCE: f64 = 1e-2;

/// Camera axes of a file, seen from behind the camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Axes {
    /// x right, y up, z backward.
    OpenGl,
    /// x left, y up, z forward.
    Mitsuba,
    /// x right, y down, z forward.
    OpenCv,
}

/// Converts a camera-to-world matrix to a world-to-camera pose. `rows` are the rows of the matrix, with camera axes
/// `axes`. The result has OpenCV axes.
///
/// The error text is the end of a sentence about the matrix.
pub(super) fn from_matrix(rows: &[Vec<f64>], axes: Axes) -> Result<(DMat3, DVec3), String> {
    let lengths: Vec<String> = rows.iter().map(|r| r.len().to_string()).collect();
    if !(rows.len() == 3 || rows.len() == 4) || rows.iter().any(|r| r.len() != 4) {
        let found = lengths.join(", ");
        return Err(format!("transform_matrix has rows of [{found}] values; it must be 4×4 or 3×4"));
    }
    if rows.iter().flatten().any(|v| !v.is_finite()) {
        return Err("transform_matrix holds values that are not finite; correct or remove the frame".into());
    }
    if let Some(last) = rows.get(3)
        && (DVec3::new(last[0], last[1], last[2]).length() > 1e-6 || (last[3] - 1.0).abs() > 1e-6)
    {
        return Err(format!("the last row of transform_matrix is {last:?}; it must be [0, 0, 0, 1]"));
    }
    let column = |k: usize| DVec3::new(rows[0][k], rows[1][k], rows[2][k]);
    let rotation = orthonormal(DMat3::from_cols(column(0), column(1), column(2)))
        .map_err(|problem| format!("transform_matrix {problem}"))?;
    let to_world = match axes {
        Axes::OpenGl => DMat3::from_cols(rotation.x_axis, -rotation.y_axis, -rotation.z_axis),
        Axes::Mitsuba => DMat3::from_cols(-rotation.x_axis, -rotation.y_axis, rotation.z_axis),
        Axes::OpenCv => rotation,
    };
    let to_camera = to_world.transpose();
    Ok((to_camera, -(to_camera * column(3))))
}

/// Returns the world-to-camera pose of a camera at `origin` that looks at `target`. `up` points to the upper edge of
/// the image.
pub(super) fn from_look_at(origin: DVec3, target: DVec3, up: DVec3) -> Result<(DMat3, DVec3), String> {
    if !(origin.is_finite() && target.is_finite() && up.is_finite()) {
        return Err("the pose holds values that are not finite; correct or remove the camera".into());
    }
    let forward = (target - origin).try_normalize();
    let forward = forward.ok_or("the camera looks at where it stands; its second row must be another point")?;
    let right = forward.cross(up);
    if right.length() < TOLERANCE * up.length() || up.length() < 1e-9 {
        return Err("the camera looks along its own up vector; its third row must point to the upper edge".into());
    }
    let right = right.normalize();
    let to_camera = DMat3::from_cols(right, forward.cross(right), forward).transpose();
    Ok((to_camera, -(to_camera * origin)))
}

/// Converts a quaternion `(w, x, y, z)` and a translation to a pose. Both are world-to-camera, as in COLMAP.
pub(super) fn from_quaternion(q: [f64; 4], t: [f64; 3]) -> Result<(DMat3, DVec3), String> {
    let translation = DVec3::from_array(t);
    let quaternion = DQuat::from_xyzw(q[1], q[2], q[3], q[0]);
    if !(quaternion.is_finite() && translation.is_finite()) {
        return Err("the pose holds values that are not finite; correct or remove the image".into());
    }
    // Files round to few digits; a larger deviation from unit length indicates a wrong column.
    if (quaternion.length() - 1.0).abs() > TOLERANCE {
        return Err(format!("the quaternion {q:?} has the length {}; it must be 1", quaternion.length()));
    }
    Ok((DMat3::from_quat(quaternion.normalize()), translation))
}

/// Returns the rotation nearest to an almost orthonormal matrix.
fn orthonormal(matrix: DMat3) -> Result<DMat3, String> {
    let deviation = (matrix.transpose() * matrix - DMat3::IDENTITY).to_cols_array();
    let worst = deviation.iter().fold(0.0_f64, |worst, v| worst.max(v.abs()));
    if worst > TOLERANCE {
        let [x, y, z] = [matrix.x_axis, matrix.y_axis, matrix.z_axis].map(DVec3::length);
        return Err(format!(
            "is not a rigid pose: the columns of its rotation have the lengths {x:.4}, {y:.4}, {z:.4} and must be \
             orthonormal"
        ));
    }
    if matrix.determinant() < 0.0 {
        return Err("mirrors space: the determinant of its rotation is −1 and must be 1".into());
    }
    // Newton iteration for the polar decomposition, which converges quadratically from this start.
    let mut rotation = matrix;
    for _ in 0..6 {
        rotation = 0.5 * (rotation + rotation.inverse().transpose());
    }
    Ok(rotation)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(rotation: DMat3, t: DVec3) -> Vec<Vec<f64>> {
        let r = rotation.transpose().to_cols_array();
        vec![
            vec![r[0], r[1], r[2], t.x],
            vec![r[3], r[4], r[5], t.y],
            vec![r[6], r[7], r[8], t.z],
            vec![0.0, 0.0, 0.0, 1.0],
        ]
    }

    fn from_opengl(rows: &[Vec<f64>]) -> Result<(DMat3, DVec3), String> {
        from_matrix(rows, Axes::OpenGl)
    }

    #[test]
    fn mitsuba_axes_are_x_left_y_up_z_forward() {
        let (rotation, translation) =
            from_matrix(&rows(DMat3::IDENTITY, DVec3::new(1.0, 2.0, 3.0)), Axes::Mitsuba).unwrap();
        let p = rotation * DVec3::new(0.5, 2.25, 5.0) + translation;
        assert!((p - DVec3::new(0.5, -0.25, 2.0)).length() < 1e-12, "{p}");
        assert!((rotation.determinant() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn look_at_target_projects_to_the_optical_axis() {
        let (origin, target) = (DVec3::new(1.0, 2.0, 3.0), DVec3::new(4.0, 2.0, 7.0));
        // The up vector need not be a unit vector or perpendicular.
        let (rotation, translation) = from_look_at(origin, target, DVec3::new(0.3, 2.0, 0.1)).unwrap();
        assert!((rotation * target + translation - DVec3::new(0.0, 0.0, 5.0)).length() < 1e-12);
        assert!((rotation.determinant() - 1.0).abs() < 1e-12);
        assert!((rotation * DVec3::new(0.3, 2.0, 0.1)).y < 0.0, "up is up");
        let fail = |a: DVec3, b: DVec3, up: DVec3| from_look_at(a, b, up).unwrap_err();
        assert!(fail(origin, origin, DVec3::Y).contains("looks at where it stands"));
        assert!(fail(origin, origin + DVec3::Y, DVec3::Y).contains("along its own up vector"));
        assert!(fail(origin, target, DVec3::ZERO).contains("along its own up vector"));
        assert!(fail(origin, target, DVec3::NAN).contains("not finite"));
    }

    #[test]
    fn opengl_axes_are_x_right_y_up_z_backward() {
        let (rotation, translation) = from_opengl(&rows(DMat3::IDENTITY, DVec3::new(1.0, 2.0, 3.0))).unwrap();
        // A point in front of (−z), right of (+x) and above (+y) the camera.
        let p = rotation * DVec3::new(1.5, 2.25, 1.0) + translation;
        assert!((p - DVec3::new(0.5, -0.25, 2.0)).length() < 1e-12, "{p}");
        assert!((rotation.determinant() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn rounded_rotations_become_orthonormal() {
        let exact = DMat3::from_rotation_y(0.7) * DMat3::from_rotation_x(0.3);
        let rounded = DMat3::from_cols_array(&exact.to_cols_array().map(|v| (v * 1000.0).round() / 1000.0));
        let clean = orthonormal(rounded).unwrap();
        assert!((clean.transpose() * clean - DMat3::IDENTITY).to_cols_array().iter().all(|v| v.abs() < 1e-14));
        assert!((clean - exact).to_cols_array().iter().all(|v| v.abs() < 1e-3));
    }

    #[test]
    fn quaternions_are_world_to_camera_with_w_first() {
        let q = DQuat::from_rotation_z(0.3);
        let (rotation, _) = from_quaternion([q.w, q.x, q.y, q.z], [0.0; 3]).unwrap();
        assert!((rotation - DMat3::from_rotation_z(0.3)).to_cols_array().iter().all(|v| v.abs() < 1e-12));
    }

    #[test]
    fn each_error_has_its_message() {
        let good = rows(DMat3::IDENTITY, DVec3::ZERO);
        let fail = |change: fn(&mut Vec<Vec<f64>>)| {
            let mut rows = good.clone();
            change(&mut rows);
            from_opengl(&rows).unwrap_err()
        };
        assert!(from_opengl(&good[..3]).is_ok());
        assert!(fail(|r| r.truncate(2)).contains("rows of [4, 4] values; it must be 4×4"));
        assert!(fail(|r| r[1].truncate(3)).contains("rows of [4, 3, 4, 4] values"));
        assert!(fail(|r| r[0][3] = f64::NAN).contains("not finite"));
        assert!(fail(|r| r[3][3] = 2.0).contains("last row of transform_matrix is [0.0, 0.0, 0.0, 2.0]"));
        assert!(fail(|r| r[0][0] = 2.0).contains("lengths 2.0000, 1.0000, 1.0000"));
        assert!(fail(|r| r[0][0] = -1.0).contains("mirrors space"));
        assert!(fail(|r| r[0][0] = 0.0).contains("lengths 0.0000"));
        assert!(from_quaternion([0.0; 4], [0.0; 3]).unwrap_err().contains("has the length 0; it must be 1"));
        assert!(from_quaternion([1.0, 0.0, 0.0, f64::NAN], [0.0; 3]).unwrap_err().contains("not finite"));
    }
}
