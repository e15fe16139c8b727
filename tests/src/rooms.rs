//! Tiny room on disk: the inside of a box with smoothly painted walls.
//!
//! Color, normal and depth are known at every pixel.

use glam::{DMat3, DVec2, DVec3};
use serde_json::json;
use sgs_scene::{Camera, Image, write_exr, write_ids, write_png};
use std::path::Path;

/// Half the side lengths of the box.
pub const WALLS: DVec3 = DVec3::new(1.4, 1.0, 1.6);

/// Albedo of each wall, sRGB, in the order of [`Room::walls`].
pub const ALBEDO: [[f32; 3]; 6] =
    [[0.7, 0.2, 0.2], [0.2, 0.7, 0.2], [0.2, 0.2, 0.7], [0.7, 0.7, 0.2], [0.2, 0.7, 0.7], [0.7, 0.2, 0.7]];

/// Size and contents of a room.
#[derive(Clone, Copy, Debug)]
pub struct Room {
    /// Number of views; every fourth is a test view.
    pub views: usize,
    /// Columns and rows of an image.
    pub size: [u32; 2],
    /// Distance of neighboring points in each training view, in pixels.
    pub spacing: u32,
    /// Whether the room has priors of normals.
    pub priors: bool,
    /// Whether the room has ground truth of normals and depth.
    pub truth: bool,
}

impl Default for Room {
    fn default() -> Self {
        Room { views: 8, size: [32, 24], spacing: 4, priors: false, truth: false }
    }
}

/// Intersection of a ray and a wall.
struct Hit {
    depth: f64,
    position: DVec3,
    normal: DVec3,
    color: DVec3,
}

impl Room {
    /// Returns the cameras along an arc, all directed into the same half of the room.
    pub fn cameras(&self) -> Vec<Camera> {
        (0..self.views)
            .map(|i| {
                let along = i as f64 / self.views.max(2) as f64 * 2.0 - 1.0;
                let place = DVec3::new(0.5 * along, 0.25 * (5.0 * along).sin(), -0.7 + 0.3 * along * along);
                let forward = (DVec3::new(-0.35 * along, 0.1 * (3.0 * along).cos(), 1.2) - place).normalize();
                let right = DVec3::Y.cross(forward).normalize();
                let down = forward.cross(right);
                let rotation = DMat3::from_cols(right, down, forward).transpose();
                let [width, height] = self.size;
                Camera {
                    name: format!("{i:03}"),
                    width,
                    height,
                    fx: 0.7 * f64::from(width),
                    fy: 0.7 * f64::from(width),
                    cx: 0.5 * f64::from(width),
                    cy: 0.5 * f64::from(height),
                    rotation,
                    translation: -(rotation * place),
                    near: sgs_scene::NEAR,
                }
            })
            .collect()
    }

    /// Returns the wall behind every pixel.
    ///
    /// The index is twice the axis of the normal, plus one if the normal points along the positive axis.
    pub fn walls(&self, camera: &Camera) -> Vec<usize> {
        let wall = |x: u32, y: u32| {
            let n = hit(camera, DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5)).normal;
            let axis = (0..3).max_by(|&a, &b| n[a].abs().total_cmp(&n[b].abs())).unwrap_or(0);
            2 * axis + usize::from(n[axis] > 0.0)
        };
        (0..camera.height).flat_map(|y| (0..camera.width).map(move |x| (x, y))).map(|(x, y)| wall(x, y)).collect()
    }

    /// Returns the names of training and test views.
    pub fn split(&self) -> (Vec<String>, Vec<String>) {
        let names = |test: bool| (0..self.views).filter(|i| (i % 4 == 1) == test).map(|i| format!("{i:03}")).collect();
        (names(false), names(true))
    }

    /// Adds masks and priors of albedo, roughness and metallic to a scene directory.
    ///
    /// Every wall has one value.
    pub fn write_materials(&self, root: &Path) {
        for kind in ["albedo", "roughness", "metallic", "masks"] {
            std::fs::create_dir_all(root.join("priors").join(kind)).unwrap();
        }
        for camera in self.cameras() {
            let walls = self.walls(&camera);
            let (width, height) = (camera.width, camera.height);
            let albedo = walls.iter().flat_map(|w| ALBEDO[*w]).collect();
            let file = |kind: &str| root.join(format!("priors/{kind}/{}.png", camera.name));
            write_png(&file("albedo"), &Image { width, height, channels: 3, data: albedo }).unwrap();
            let one =
                |f: fn(usize) -> f32| Image { width, height, channels: 1, data: walls.iter().map(|w| f(*w)).collect() };
            write_png(&file("roughness"), &one(|w| 0.3 + 0.1 * w as f32)).unwrap();
            write_png(&file("metallic"), &one(|w| if w == 2 { 0.9 } else { 0.1 })).unwrap();
            let ids: Vec<u16> = walls.iter().map(|w| 1 + *w as u16).collect();
            write_ids(&file("masks"), width, height, &ids).unwrap();
        }
    }

    /// Writes the scene directory.
    pub fn write(&self, root: &Path) {
        let cameras = self.cameras();
        let (train, test) = self.split();
        for folder in ["images", "priors/normal", "gt/normal", "gt/depth"] {
            let requested = match folder.split('/').next() {
                Some("priors") => self.priors,
                Some("gt") => self.truth,
                _ => true,
            };
            if requested {
                std::fs::create_dir_all(root.join(folder)).unwrap();
            }
        }
        let mut points = Vec::new();
        for camera in &cameras {
            let mut color = Image::new(camera.width, camera.height, 3);
            let mut normal = Image::new(camera.width, camera.height, 3);
            let mut depth = Image::new(camera.width, camera.height, 1);
            for y in 0..camera.height {
                for x in 0..camera.width {
                    let at = (y * camera.width + x) as usize;
                    let hit = hit(camera, DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5));
                    color.data[3 * at..3 * at + 3].copy_from_slice(&hit.color.as_vec3().to_array());
                    normal.data[3 * at..3 * at + 3].copy_from_slice(&hit.normal.as_vec3().to_array());
                    depth.data[at] = hit.depth as f32;
                    let chosen = x % self.spacing == self.spacing / 2 && y % self.spacing == self.spacing / 2;
                    if chosen && train.contains(&camera.name) {
                        points.push((hit.position, hit.color));
                    }
                }
            }
            let name = &camera.name;
            write_png(&root.join(format!("images/{name}.png")), &color).unwrap();
            if self.priors && train.contains(name) {
                write_exr(&root.join(format!("priors/normal/{name}.exr")), &normal, &["X", "Y", "Z"]).unwrap();
            }
            if self.truth {
                write_exr(&root.join(format!("gt/normal/{name}.exr")), &normal, &["X", "Y", "Z"]).unwrap();
                write_exr(&root.join(format!("gt/depth/{name}.exr")), &depth, &["Y"]).unwrap();
            }
        }
        if self.priors {
            write_json(&root.join("priors/priors.json"), &json!({"normal": {"frame": "world"}}));
        }
        write_json(&root.join("split.json"), &json!({"train": train, "test": test}));
        write_json(&root.join("transforms.json"), &transforms(&cameras));
        let mut ply = format!("ply\nformat ascii 1.0\nelement vertex {}\n", points.len());
        for name in ["x", "y", "z"] {
            ply.push_str(&format!("property float {name}\n"));
        }
        for name in ["red", "green", "blue"] {
            ply.push_str(&format!("property uchar {name}\n"));
        }
        ply.push_str("end_header\n");
        for (p, c) in points {
            let c = (c * 255.0).round();
            ply.push_str(&format!("{:.6} {:.6} {:.6} {} {} {}\n", p.x, p.y, p.z, c.x, c.y, c.z));
        }
        std::fs::write(root.join("points.ply"), ply).unwrap();
    }
}

/// Returns a transforms file for these cameras, with intrinsics in every frame.
pub fn transforms(cameras: &[Camera]) -> serde_json::Value {
    let frames: Vec<_> = cameras
        .iter()
        .map(|c| {
            let to_world = c.rotation.transpose();
            let (x, y, z, t) = (to_world.x_axis, -to_world.y_axis, -to_world.z_axis, c.position());
            json!({
                "file_path": format!("images/{}.png", c.name),
                "w": c.width, "h": c.height, "fl_x": c.fx, "fl_y": c.fy, "cx": c.cx, "cy": c.cy,
                "transform_matrix":
                    [[x.x, y.x, z.x, t.x], [x.y, y.y, z.y, t.y], [x.z, y.z, z.z, t.z], [0.0, 0.0, 0.0, 1.0]],
            })
        })
        .collect();
    json!({"frames": frames})
}

/// Writes JSON.
pub fn write_json(path: &Path, value: &serde_json::Value) {
    std::fs::write(path, value.to_string()).unwrap();
}

/// Returns the intersection of a pixel's ray with the box.
fn hit(camera: &Camera, pixel: DVec2) -> Hit {
    let eye = camera.position();
    let ray = camera.unproject(pixel, 1.0) - eye;
    let mut depth = f64::INFINITY;
    let mut normal = DVec3::ZERO;
    for axis in 0..3 {
        if ray[axis] == 0.0 {
            continue;
        }
        let t = (WALLS[axis] * ray[axis].signum() - eye[axis]) / ray[axis];
        if t < depth {
            depth = t;
            normal = DVec3::ZERO;
            normal[axis] = -ray[axis].signum();
        }
    }
    let p = eye + ray * depth;
    let wave = |k: DVec3, phase: f64| {
        0.5 + 0.3 * (k.dot(p) + phase).sin() + 0.08 * (2.3 * k.dot(DVec3::new(p.y, p.z, p.x)) + phase).cos()
    };
    let color = DVec3::new(
        wave(DVec3::new(2.0, 1.0, 0.6), 0.3),
        wave(DVec3::new(-1.0, 2.2, 0.9), 1.1),
        wave(DVec3::new(0.7, -1.3, 1.9), 2.0),
    );
    // Every wall has its own shade, as in a lit room.
    let shade = 0.8 + 0.15 * normal.dot(DVec3::new(0.5, 0.8, 0.3));
    Hit { depth, position: p, normal, color: (color * shade).clamp(DVec3::ZERO, DVec3::ONE) }
}
