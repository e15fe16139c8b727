//! Point clouds in binary PLY: position, normal, 8-bit color.

use crate::points::Point;

/// Returns the bytes of a point cloud.
pub(crate) fn encode(points: &[Point]) -> Vec<u8> {
    let mut out = format!("ply\nformat binary_little_endian 1.0\nelement vertex {}\n", points.len()).into_bytes();
    for name in ["x", "y", "z", "nx", "ny", "nz"] {
        out.extend(format!("property float {name}\n").into_bytes());
    }
    for name in ["red", "green", "blue"] {
        out.extend(format!("property uchar {name}\n").into_bytes());
    }
    out.extend(b"end_header\n");
    for point in points {
        for v in [point.position, point.normal] {
            for x in v.to_array() {
                out.extend(x.to_le_bytes());
            }
        }
        out.extend(point.color);
    }
    out
}
