//! Writing cameras to a transforms file.

use std::io::Write;
use std::path::Path;

use glam::DVec4;
use serde_json::json;

use crate::atomic::atomic_write;
use crate::camera::Camera;
use crate::error::Result;

impl Camera {
    /// Writes cameras as a transforms file for [`Camera::read_transforms`]. Every frame has its intrinsics and a
    /// camera-to-world pose with OpenGL axes. The frame's image is `NAME.png`, which need not exist.
    ///
    /// # Errors
    /// Fails if the file cannot be written.
    pub fn write_transforms(path: &Path, cameras: &[Camera]) -> Result<()> {
        let frames: Vec<_> = cameras.iter().map(frame).collect();
        let text = format!("{:#}\n", json!({ "frames": frames }));
        atomic_write(path, |out| out.write_all(text.as_bytes()))
    }
}

fn frame(camera: &Camera) -> serde_json::Value {
    let to_world = camera.rotation.transpose();
    let columns = [
        to_world.x_axis.extend(0.0),
        -to_world.y_axis.extend(0.0),
        -to_world.z_axis.extend(0.0),
        camera.position().extend(1.0),
    ];
    let row = |i: usize| columns.map(|c: DVec4| c[i]);
    json!({
        "file_path": format!("{}.png", camera.name),
        "w": camera.width,
        "h": camera.height,
        "fl_x": camera.fx,
        "fl_y": camera.fy,
        "cx": camera.cx,
        "cy": camera.cy,
        "transform_matrix": [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]],
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::tests::camera;

    #[test]
    fn cameras_round_trip() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("cameras.json");
        let mut other = camera();
        other.name = "photo.2_1_07".into();
        (other.width, other.fx, other.cx, other.translation.z) = (81, 70.0, 12.25, -4.0);
        let written = [camera(), other];
        Camera::write_transforms(&path, &written).unwrap();
        let read = Camera::read_transforms(&path).unwrap();
        assert_eq!(read.len(), 2);
        for (a, b) in written.iter().zip(&read) {
            let rest = |c: &Camera| (c.name.clone(), c.width, c.height, c.fx, c.fy, c.cx, c.cy);
            assert_eq!(rest(a), rest(b));
            assert!((a.translation - b.translation).length() < 1e-9);
            let turned = a.rotation - b.rotation;
            assert!(turned.to_cols_array().iter().all(|v| v.abs() < 1e-9));
        }
    }
}
