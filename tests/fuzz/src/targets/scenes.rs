//! Files that describe scenes: cameras, splits, names.
//!
//! Each file is placed in an otherwise valid scene.

use super::describe;
use super::text_of;
use crate::place::Place;
use crate::seeds::{self, COLMAP, TEXT};
use sgs_scene::Camera;

/// Reads a valid scene with one file replaced.
fn within(name: &'static str, fill: fn(&Place), file: &str, bytes: &[u8]) -> String {
    let place = Place::of(name, fill);
    place.put(file, bytes);
    describe::scene(&place.path(""))
}

pub(crate) fn transforms(bytes: &[u8]) -> String {
    within("transforms", seeds::scene, "transforms.json", bytes)
}

pub(crate) fn transforms_held_out(bytes: &[u8]) -> String {
    within("transforms_held_out", seeds::scene_held_out, "transforms_test.json", bytes)
}

pub(crate) fn split(bytes: &[u8]) -> String {
    within("split", seeds::scene, "split.json", bytes)
}

pub(crate) fn priors(bytes: &[u8]) -> String {
    within("priors", seeds::scene, "priors/priors.json", bytes)
}

pub(crate) fn labels(bytes: &[u8]) -> String {
    let place = Place::of("labels", seeds::scene);
    place.put("gt/semantic/labels.json", bytes);
    place.put("priors/semantic/labels.json", bytes);
    describe::scene(&place.path(""))
}

/// Reads cameras without images.
pub(crate) fn cameras(bytes: &[u8]) -> String {
    let place = Place::of("cameras", |place| {
        place.put("000.png", &seeds::png(8, 6));
    });
    let path = place.put("cameras.json", bytes);
    text_of(Camera::read_transforms(&path), |cameras| {
        assert!(cameras.iter().all(|c| c.problem().is_none()), "cameras can be");
        // Cameras that are read can be written and read again.
        let again = place.path("again.json");
        Camera::write_transforms(&again, &cameras).expect("cameras are written");
        let same = Camera::read_transforms(&again).map(|read| read.len());
        assert_eq!(same.ok(), Some(cameras.len()), "cameras come back");
        format!("{} cameras", cameras.len().min(4))
    })
}

pub(crate) fn blender(bytes: &[u8]) -> String {
    within("blender", seeds::blender, "transforms_train.json", bytes)
}

pub(crate) fn interiorverse(bytes: &[u8]) -> String {
    within("interiorverse", seeds::interiorverse, "transforms.json", bytes)
}

pub(crate) fn fipt_cameras(bytes: &[u8]) -> String {
    within("fipt_cameras", seeds::fipt, "cam.txt", bytes)
}

pub(crate) fn fipt_matrices(bytes: &[u8]) -> String {
    within("fipt_matrices", seeds::fipt, "K_list.txt", bytes)
}

pub(crate) fn fipt_transforms(bytes: &[u8]) -> String {
    within("fipt_transforms", seeds::fipt_synthetic, "train/transforms.json", bytes)
}

pub(crate) fn colmap_cameras_bin(bytes: &[u8]) -> String {
    within("colmap_cameras_bin", |place| seeds::colmap(place, COLMAP), "sparse/0/cameras.bin", bytes)
}

pub(crate) fn colmap_images_bin(bytes: &[u8]) -> String {
    within("colmap_images_bin", |place| seeds::colmap(place, COLMAP), "sparse/0/images.bin", bytes)
}

pub(crate) fn colmap_points_bin(bytes: &[u8]) -> String {
    within("colmap_points_bin", |place| seeds::colmap(place, COLMAP), "sparse/0/points3D.bin", bytes)
}

pub(crate) fn colmap_cameras_txt(bytes: &[u8]) -> String {
    within("colmap_cameras_txt", |place| seeds::colmap(place, TEXT), "sparse/0/cameras.txt", bytes)
}

pub(crate) fn colmap_images_txt(bytes: &[u8]) -> String {
    within("colmap_images_txt", |place| seeds::colmap(place, TEXT), "sparse/0/images.txt", bytes)
}

pub(crate) fn colmap_points_txt(bytes: &[u8]) -> String {
    within("colmap_points_txt", |place| seeds::colmap(place, TEXT), "sparse/0/points3D.txt", bytes)
}

pub(crate) fn colmap_rigs_bin(bytes: &[u8]) -> String {
    within("colmap_rigs_bin", |place| seeds::colmap_rigs(place, COLMAP), "sparse/0/rigs.bin", bytes)
}

pub(crate) fn colmap_frames_bin(bytes: &[u8]) -> String {
    within("colmap_frames_bin", |place| seeds::colmap_rigs(place, COLMAP), "sparse/0/frames.bin", bytes)
}

pub(crate) fn colmap_rigs_txt(bytes: &[u8]) -> String {
    within("colmap_rigs_txt", |place| seeds::colmap_rigs(place, TEXT), "sparse/0/rigs.txt", bytes)
}

pub(crate) fn colmap_frames_txt(bytes: &[u8]) -> String {
    within("colmap_frames_txt", |place| seeds::colmap_rigs(place, TEXT), "sparse/0/frames.txt", bytes)
}

pub(crate) fn rgbd_pose(bytes: &[u8]) -> String {
    within("rgbd_pose", seeds::seven_scenes, "frame-000000.pose.txt", bytes)
}

pub(crate) fn rgbd_images(bytes: &[u8]) -> String {
    within("rgbd_images", seeds::tum, "rgb.txt", bytes)
}

pub(crate) fn rgbd_depths(bytes: &[u8]) -> String {
    within("rgbd_depths", seeds::tum, "depth.txt", bytes)
}

pub(crate) fn rgbd_intrinsics(bytes: &[u8]) -> String {
    within("rgbd_intrinsics", seeds::seven_scenes, "camera-intrinsics.txt", bytes)
}

pub(crate) fn scannet_intrinsics(bytes: &[u8]) -> String {
    within("scannet_intrinsics", seeds::scannet, "intrinsic/intrinsic_color.txt", bytes)
}

pub(crate) fn scannet_pose(bytes: &[u8]) -> String {
    within("scannet_pose", seeds::scannet, "pose/0.txt", bytes)
}

pub(crate) fn rgbd_times(bytes: &[u8]) -> String {
    within("rgbd_times", seeds::tum, "groundtruth.txt", bytes)
}
