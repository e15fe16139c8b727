//! Text files.

pub(crate) const TRANSFORMS: &str = r#"{"w": 8, "h": 6, "fl_x": 7.5, "fl_y": 7, "cx": 4, "cy": 3, "camera_model": "OPENCV",
"k1": 0.01, "k2": -0.002, "p1": 0.001, "p2": 0,
"frames": [
{"file_path": "images/000.png", "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]]},
{"file_path": "images/001.png", "fl_x": 8, "transform_matrix": [[0.8, 0, 0.6, 1], [0, 1, 0, 0], [-0.6, 0, 0.8, 2.5], [0, 0, 0, 1]]}
]}
"#;

/// Frames with masks and depth of a sensor.
pub(crate) const MEASURED: &str = r#"{"w": 8, "h": 6, "fl_x": 7.5, "depth_unit_scale_factor": 0.0002, "frames": [
{"file_path": "images/000.png", "mask_path": "mask/000.png", "depth_file_path": "depth/000.png",
"transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]]},
{"file_path": "images/001.png", "mask_path": "mask/none.png", "depth_file_path": ".\\depth\\000.png", "depth_unit_scale_factor": 1,
"transform_matrix": [[0.8, 0, 0.6, 1], [0, 1, 0, 0], [-0.6, 0, 0.8, 2.5], [0, 0, 0, 1]]}]}
"#;

pub(crate) const HELD_OUT: &str = r#"{"camera_angle_x": 0.7, "frames": [
{"file_path": "images/002", "w": 8, "h": 6, "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 3]]},
{"file_path": ".\\images\\003.jpg", "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4]]}]}
"#;

pub(crate) const BLENDER: &str = r#"{"camera_angle_x": 0.69, "frames": [
{"file_path": "./train_000/rgba", "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]},
{"file_path": "./train_001/rgba", "transform_matrix": [[0.8, 0, 0.6, 2.4], [0, 1, 0, 0], [-0.6, 0, 0.8, 3.2], [0, 0, 0, 1]]}]}
"#;

pub(crate) const INTERIORVERSE: &str = r#"{"fl_x": 7, "w": 8, "h": 6, "frames": [
{"file_path": "000_im.exr", "split": "train", "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]]},
{"file_path": "001_im.exr", "split": "test", "transform_matrix": [[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]]}]}
"#;

pub(crate) const FIPT_TRANSFORMS: &str = r#"{"camera_angle_x": 1.1, "frames": [
{"transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]]},
{"transform_matrix": [[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]]}]}
"#;

/// Returns a transforms file whose first frame takes its size from the photograph.
pub(crate) fn unsized_transforms(file: &str) -> String {
    let pose = "[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]]";
    format!(
        r#"{{"camera_angle_x": 0.8, "k1": 0.02, "frames": [{{"file_path": "images/{file}", "transform_matrix": {pose}}},
        {{"file_path": "other.png", "transform_matrix": {pose}}}]}}"#
    )
}

pub(crate) const SPLIT: &str = "{\"train\": [\"000\", \"001.png\"], \"test\": []}\n";

pub(crate) const PRIORS: &str = "{\"normal\": {\"frame\": \"camera-opencv\"}}\n";

pub(crate) const LABELS: &str = "{\"labels\": [\"wall\", \"floor\"], \"dim\": 3}\n";

pub(crate) const FIPT_CAMERAS: &str = "2\n0 0 2\n0 0 0\n0 1 0\n1 0 2\n0 0 0\n0 1 0\n";

pub(crate) const FIPT_MATRICES: &str = "2\n7 0 4\n0 7 3\n0 0 1\n7 0 4\n0 7.5 3\n0 0 1\n";

pub(crate) const COLMAP_CAMERAS: &str =
    "# Camera list\n1 PINHOLE 8 6 7 7 4 3\n2 OPENCV 8 6 7 7 4 3 0.01 0 0.001 0\n3 SIMPLE_RADIAL 8 6 7 4 3 0.1\n";

/// Cameras 1 and 2, which images have, with lenses that are not polynomials.
pub(crate) const COLMAP_MODELS: &str = "1 FOV 8 6 7 7 4 3 0.9\n2 RAD_TAN_THIN_PRISM_FISHEYE 8 6 7 7 4 3 0.1 0 0 0 0 0 0.01 0 0 0 0.01 0\n\
     3 SIMPLE_DIVISION 8 6 7 4 3 -0.2\n4 EUCM 8 6 7 7 4 3 0.6 1.1\n5 FISHEYE 8 6 7 7 4 3\n";

/// Fisheye lenses with polynomials.
pub(crate) const COLMAP_FISHEYES: &str = "1 OPENCV_FISHEYE 8 6 7 7 4 3 0.1 0.01 0 0\n\
     2 THIN_PRISM_FISHEYE 8 6 7 7 4 3 0.1 0 0.001 0 0.01 0 0.001 0.002\n\
     3 SIMPLE_RADIAL_FISHEYE 8 6 7 4 3 0.1\n4 RADIAL_FISHEYE 8 6 7 4 3 0.1 0.01\n";

pub(crate) const COLMAP_IMAGES: &str =
    "# Image list\n1 1 0 0 0 0 0 2 1 000.png\n1.5 2.5 3 2.5 3.5 -1\n2 0.96 0 0.28 0 0.5 0 2 2 001.png\n\n";

pub(crate) const COLMAP_POINTS: &str =
    "# Points\n1 0.1 0.2 0.3 255 0 10 0.5 1 0 2 1\n2 -0.1 0.5 1e-3 1 2 3 0.25 1 1\n3 0 0 1 0 0 0 1\n";

pub(crate) const COLMAP_RIGS: &str = "# Rigs\n1 2 CAMERA 1 CAMERA 2 1 0.96 0 0.28 0 0.5 0 0\n2 1 IMU 4\n";

pub(crate) const COLMAP_FRAMES: &str = "# Frames\n1 1 1 0 0 0 0 0 2 3 CAMERA 1 1 CAMERA 2 2 IMU 3 7\n";

pub(crate) const RGBD_POSE: &str = "1 0 0 0.5\n0 0.8 -0.6 1\n0 0.6 0.8 -2\n0 0 0 1\n";

/// Pose of a tracker that is lost.
pub(crate) const RGBD_LOST: &str =
    "-inf -inf -inf -inf\n-inf -inf -inf -inf\n-inf -inf -inf -inf\n-inf -inf -inf -inf\n";

pub(crate) const SCANNET_INTRINSICS: &str = "7 0 4 0\n0 7.5 3 0\n0 0 1 0\n0 0 0 1\n";

pub(crate) const KINECT_INTRINSICS: &str = " 7.0e+00 0 4\n0 7.5 3\n0 0 1\n";

pub(crate) const TUM_IMAGES: &str = "# color images\n1.0 rgb/1.0.png\n2.0 rgb/2.0.png\n";

pub(crate) const TUM_DEPTHS: &str = "# depth maps\n1.01 depth/1.0.png\n2.5 depth/2.0.png\n";

pub(crate) const TUM_POSES: &str = "# time tx ty tz qx qy qz qw\n0.99 0 0 2 0 0 0 1\n2.01 0.5 0 2 0 0.28 0 0.96\n";

/// Splats in ASCII PLY, with normals and materials.
pub(crate) const SPLATS_ASCII: &str = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n\
property float nx\nproperty float ny\nproperty float nz\nproperty float f_dc_0\nproperty float f_dc_1\nproperty float f_dc_2\n\
property float opacity\nproperty float scale_0\nproperty float scale_1\nproperty float scale_2\nproperty float rot_0\n\
property float rot_1\nproperty float rot_2\nproperty float rot_3\nproperty float albedo_0\nproperty float albedo_1\n\
property float albedo_2\nproperty float roughness\nend_header\n0 0 0 0 1 0 0.1 0.2 0.3 1 -3 -3 -3 1 0 0 0 0 0 0 0\n\
1 0 1 0 0 1 0.1 0.2 0.3 -1 -3 -4 -3 0.5 0.5 0 0 0.5 0 -1 2\n";

pub(crate) const POINTS_ASCII: &str = "ply\nformat ascii 1.0\ncomment made by hand\nelement vertex 3\nproperty double x\nproperty double y\n\
property double z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nelement face 1\n\
property list uchar int vertex_indices\nend_header\n0 0 0 255 0 0\n1 0 0 0 255 0\n0 1 0.5 0 0 255\n3 0 1 2\n";

pub(crate) const LIGHTS: &str = r#"{"format": "sgs-lights-1", "normalizer": 0.0625, "lights": [
{"position": [0, 1.5, 0], "gain": 1, "lobes": [{"axis": [0, 0, 1], "sharpness": 2, "amplitude": [1, 0.5, 0.25]},
{"axis": [0, 1, 0], "sharpness": 0, "amplitude": [0.1, 0.1, 0.1]}]},
{"position": [1, 1, 1], "gain": 0, "lobes": []},
{"position": [-1, 0.5, 2], "gain": 2.5, "lobes": [{"axis": [0.6, 0, 0.8], "sharpness": 9.5, "amplitude": [3, 2, 1]}]}]}
"#;

pub(crate) const TYPED_LIGHTS: &str = r#"{"format": "sgs-lights-2", "normalizer": 0.0625, "lights": [
{"type": "lobes", "position": [0, 1.5, 0], "gain": 1, "lobes": [{"axis": [0, 0, 1], "sharpness": 2, "amplitude": [1, 0.5, 0.25]}]},
{"type": "point", "position": [0, 0, 2], "color": [3, 2, 1], "gain": 0.5},
{"type": "sphere", "center": [1, 0, 2], "radius": 0.1, "color": [3, 2, 1]},
{"type": "rectangle", "corner": [0, 0, 1], "edge_u": [1, 0, 0], "edge_v": [0, 0, 1], "color": [3, 2, 1], "gain": 0},
{"type": "disk", "center": [0, 0, 3], "normal": [0, 0, -1], "radius": 0.5, "color": [3, 2, 1]},
{"type": "spot", "position": [0, 1, 2], "axis": [0, 0, -1], "inner_angle": 20, "outer_angle": 35, "color": [3, 2, 1]},
{"type": "lobe", "position": [1, 1, 2], "axis": [0, 0.6, -0.8], "sharpness": 9.5, "color": [3, 2, 1]}]}
"#;

pub(crate) const EMITTERS: &str = r#"{"format": "sgs-emitters-1", "surfels": 8192, "rays": 64,
"enclosure": {"low": [-2, -1.5, 0], "high": [2, 1.5, 3], "albedo": [[0.5, 0.5, 0.5], [0.5, 0.5, 0.5], [0.6, 0.5, 0.4],
[0.5, 0.5, 0.5], [0, 0, 0], [1, 1, 1]]}, "emitters": [
{"name": "bulb", "on": true, "color": [3, 2, 1], "shape": {"type": "point", "position": [0, 0, 2]}},
{"name": "globe", "on": false, "color": [1, 1, 1], "shape": {"type": "sphere", "center": [1, 0, 2], "radius": 0.1}},
{"name": "window", "on": true, "color": [1, 2, 3], "shape": {"type": "rectangle", "corner": [0, 0, 1], "edge_u": [1, 0, 0],
"edge_v": [0, 0, 1]}},
{"name": "panel", "on": true, "color": [0, 0, 0], "shape": {"type": "disk", "center": [0, 0, 3], "normal": [0, 0, -1], "radius": 0.5}},
{"name": "spot", "on": true, "color": [5, 5, 5], "shape": {"type": "spot", "position": [0, 1, 2], "axis": [0, 0, -1],
"inner_angle": 20, "outer_angle": 35}},
{"name": "sun", "on": true, "color": [9, 9, 8], "shape": {"type": "directional", "direction": [1, 1, -1], "angular_radius": 0.27}},
{"name": "lobe", "on": true, "color": [4, 4, 2], "shape": {"type": "lobe", "position": [1, 1, 2], "axis": [0, 0.6, -0.8], "sharpness": 9.5}},
{"name": "view", "on": true, "color": [1, 1, 1], "shape": {"type": "window", "corner": [0, 0, 1], "edge_u": [1, 0, 0],
"edge_v": [0, 0, 1]}}], "openings": [{"corner": [0, 0, 1], "edge_u": [1, 0, 0], "edge_v": [0, 0, 1]}], "environment": "sky.exr"}
"#;

pub(crate) const KNOWN_EMITTERS: &str = r#"{"format": "sgs-emitters-1", "emitters": [
{"name": "bulb", "shape": {"type": "sphere", "center": [1, 0, 2], "radius": 0.1}},
{"name": "off", "on": false, "shape": {"type": "point", "position": [0, 0, 2]}},
{"name": "sun", "color": [9, 9, 8], "shape": {"type": "directional", "direction": [1, 1, -1], "angular_radius": 0.27}}],
"openings": [{"corner": [0, 0, 1], "edge_u": [1, 0, 0], "edge_v": [0, 0, 1]}]}
"#;

pub(crate) const EDITS: [&str; 5] = [
    r#"{"lights": {"off": true, "add": [{"position": [0, 1, 0], "intensity": [1, 2, 3]},
{"corners": [[0, 2, 0], [1, 2, 0], [1, 2, 1], [0, 2, 1]], "radiance": [5, 5, 5], "patches": 3},
{"position": [1, 1, 1], "lobes": [{"axis": [0, 0, 1], "sharpness": 3, "amplitude": [1, 1, 1]}]}]},
"environment": {"off": true}}
"#,
    r#"{"lights": {"only": [0, 2], "change": [{"light": 1, "on": true, "intensity": 2, "color": [1, 0.5, 0], "by": [0, 0.1, 0]},
{"light": 0, "to": [1, 2, 3]}]}, "environment": {"scale": 0.5, "color": [1, 1, 0.8], "rotate": {"axis": [0, 1, 0], "degrees": 30}},
"materials": [{"where": {"box": [[-1, -1, -1], [1, 1, 1]]}, "set": {"albedo": [0.5, 0.1, 0.1]}, "scale": {"roughness": 0.5}},
{"where": {"gaussians": [1, 2, 3]}, "set": {"metallic": 1}}, {"where": {"class": "wall"}, "scale": {"albedo": [1, 1, 2]}},
{"where": {"region": {"view": "000", "id": 3}}, "set": {"roughness": 0.1}}],
"insert": [{"source": "chair.ply", "scale": 0.5, "rotation": [1, 0, 0, 1], "translation": [0, 0, 1]}]}
"#,
    "{\"environment\": {\"file\": \"sky.exr\", \"rotate\": {\"axis\": [1, 1, 0], \"degrees\": -90}}}\n",
    r#"{"lights": {"add": [{"type": "disk", "center": [0, 0, 3], "normal": [0, 0, -1], "radius": 0.5, "color": [3, 2, 1], "gain": 2},
{"type": "spot", "position": [0, 1, 2], "axis": [0, 0, -1], "inner_angle": 20, "outer_angle": 35, "color": [3, 2, 1]},
{"type": "lobes", "position": [0, 1, 0], "gain": 1, "lobes": [{"axis": [0, 0, 1], "sharpness": 2, "amplitude": [1, 1, 1]}]}]}}
"#,
    r#"{"emitters": {"openings": [{"corner": [0, 0, 1], "edge_u": [1, 0, 0], "edge_v": [0, 0, 1]}],
"environment": {"file": "sky.exr", "scale": 2, "color": [1, 1, 0.8], "rotate": {"axis": [0, 1, 0], "degrees": 30}},
"only": ["window 1"], "change": [{"emitter": "window 1", "intensity": 2}],
"add": [{"shape": {"type": "directional", "direction": [0, -1, 1], "angular_radius": 0.27}, "color": [3, 3, 2.5]}]}}
"#,
];

pub(crate) const TRUE_LIGHTS: &str = r#"{"unit": "metre", "training": [{"on": true, "position": [0, 1, 0], "point_light_intensity_equivalent": [1, 2, 3]}],
"relight": {"a": [{"name": "bulb", "on": true, "position": [0, 1, 0], "radius": 0.1, "point_light_intensity_equivalent": [1, 2, 3]},
{"name": "pane", "on": true, "corners": [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], "radiance": [1, 1, 1]},
{"name": "sky", "on": false, "environment": "sky.exr", "factor": [1, 1, 2]}],
"b": [{"on": true, "position": [0, 1, 0]}], "c": []}}
"#;

pub(crate) const TRUE_EDIT: &str =
    "{\"instance_id\": 3, \"new_base_color_linear\": [0.1, 0.5, 0.2], \"new_roughness\": 0.4, \"new_metallic\": 0}\n";

pub(crate) const SETTINGS: &str = r#"seed = 7
scale = 0.5
[geometry]
steps = 300
background = [0.1, 0.2, 0.3]
[geometry.rates]
factor = 0.5
[geometry.densify]
until = 0.5
[intrinsic.visibility]
kind = "traced"
[intrinsic.environment]
resolution = 32
[provider]
command = "python3 -m sgs_priors 'a b'"
[train]
on_divergence = "roll-back"
"#;

pub(crate) const METRICS: &str = r#"{"test": {"mean": {"nvs": {"psnr": 30.5, "ssim": 0.9, "flip": 0.1}, "relit": {"night": {"psnr": 11.5}},
"semantic": {"accuracy": 0.5}}, "views": [{"name": "000", "nvs": {"psnr": 30.5, "ssim": 0.9}, "depth_rel": 0.02}],
"lpips": {"net": "vgg", "version": "0.1", "range": [0, 1]}}, "gaussians": 1200, "steps_per_second": 4.5, "seconds": 10}
"#;

pub(crate) const LEARNED_CAMERAS: &str = r#"{"format": "sgs-cameras-1",
"lens": {"focal": 0.9, "center": [0.01, -0.02], "vignetting": -0.3, "distortion": 0.02}, "views": [
{"name": "000", "world_to_camera": [[1, 0, 0, 0.1], [0, -1, 0, 0], [0, 0, -1, 2]], "gains": [1.02, 1, 0.98]},
{"name": "001", "world_to_camera": [[0.8, 0, -0.6, 0.5], [0, -1, 0, 0], [-0.6, 0, -0.8, 2]], "gains": [1, 0.9, 1.2]}]}
"#;

pub(crate) const TRAINING: &str =
    "{\"resumed_from\": 0, \"seconds\": 12.5, \"intrinsic\": {\"steps\": 3}, \"peak_device_bytes\": 1048576}\n";

pub(crate) const PROFILE: &str = r#"{"traceEvents": [{"ph": "X", "name": "splat.project", "dur": 120.5, "ts": 0, "pid": 1, "tid": 1},
{"ph": "X", "name": "loss.l1", "dur": 20}, {"ph": "M", "name": "x"}, {"ph": "X", "name": "splat.project", "dur": 100}]}
"#;

pub(crate) const LOG: &str = r#"{"step":1,"loss":0.5,"l1":0.25,"ssim":0.5,"gaussians":100,"skipped":0}
{"step":2,"loss":0.4,"l1":0.2,"ssim":0.6,"gaussians":120,"skipped":0}
{"step":3,"loss":1e-3,"l1":0.1,"ssim":0.7,"gaussians":120,"skipped":1,"rates":0.5}
{"stage":"intrinsic","step":1,"shaded":0.5,"l1":0.25}
{"stage":"intrinsic","step":2,"shaded":0.25,"l1":0.2}
"#;
