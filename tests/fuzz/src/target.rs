//! Readers as functions of bytes.

use crate::fix::{self, Fix};
use crate::targets::{images, light, provider, runs, scenes, splats, tensors};
use crate::words::Words::{self, *};
use std::path::{Path, PathBuf};

/// Reader under test.
#[derive(Clone, Debug)]
pub struct Target {
    /// Name of the target and of its corpus.
    pub name: &'static str,
    /// Gives bytes to the reader and returns a text of the result.
    ///
    /// A new text indicates a new path through the reader.
    pub run: fn(&[u8]) -> String,
    /// Keywords of its files.
    pub words: &'static [Words],
    /// Repair of the fields that the reader checks first.
    pub(crate) fix: Option<Fix>,
    /// Memory allowed per byte of input, in bytes; compressed images need much.
    pub per_byte: usize,
}

const fn target(name: &'static str, run: fn(&[u8]) -> String, words: &'static [Words]) -> Target {
    Target { name, run, words, fix: None, per_byte: 64 }
}

const fn fixed(name: &'static str, run: fn(&[u8]) -> String, words: &'static [Words], fix: Fix) -> Target {
    Target { name, run, words, fix: Some(fix), per_byte: 64 }
}

/// Creates a target of images.
///
/// Deflate expands a byte to a thousand at most. Each of these becomes a 32-bit number, several times. Files of compressed
/// splats have the same limit.
const fn image(name: &'static str, run: fn(&[u8]) -> String, words: &'static [Words], fix: Option<Fix>) -> Target {
    Target { name, run, words, fix, per_byte: 1 << 15 }
}

/// All targets.
pub const TARGETS: &[Target] = &[
    target("blender", scenes::blender, &[Numbers, Json, Cameras]),
    target("bytes", runs::bytes, &[Numbers]),
    target("cameras", scenes::cameras, &[Numbers, Json, Cameras]),
    fixed("checkpoint", tensors::checkpoint, &[Numbers, Json, Tensors], fix::safetensors),
    target("colmap_cameras_bin", scenes::colmap_cameras_bin, &[Cameras]),
    target("colmap_cameras_txt", scenes::colmap_cameras_txt, &[Numbers, Cameras]),
    target("colmap_frames_bin", scenes::colmap_frames_bin, &[Cameras]),
    target("colmap_frames_txt", scenes::colmap_frames_txt, &[Numbers, Cameras]),
    target("colmap_images_bin", scenes::colmap_images_bin, &[Cameras]),
    target("colmap_images_txt", scenes::colmap_images_txt, &[Numbers, Cameras]),
    target("colmap_points_bin", scenes::colmap_points_bin, &[Cameras]),
    target("colmap_points_txt", scenes::colmap_points_txt, &[Numbers, Cameras]),
    target("colmap_rigs_bin", scenes::colmap_rigs_bin, &[Cameras]),
    target("colmap_rigs_txt", scenes::colmap_rigs_txt, &[Numbers, Cameras]),
    target("dot_splat", splats::dot_splat, &[]),
    target("edit", light::edit, &[Numbers, Json, Light]),
    target("emitters", light::emitters, &[Numbers, Json, Light]),
    image("environment", light::environment, &[Exr], None),
    target("fipt_cameras", scenes::fipt_cameras, &[Numbers, Cameras]),
    target("fipt_matrices", scenes::fipt_matrices, &[Numbers, Cameras]),
    target("fipt_transforms", scenes::fipt_transforms, &[Numbers, Json, Cameras]),
    target("exif", images::exif, &[]),
    image("gltf", splats::gltf, &[Numbers, Json, Gltf], Some(fix::glb)),
    fixed("head", tensors::head, &[Numbers, Json, Tensors], fix::safetensors),
    target("interiorverse", scenes::interiorverse, &[Numbers, Json, Cameras]),
    fixed("intrinsic_checkpoint", tensors::intrinsic_checkpoint, &[Numbers, Json, Tensors], fix::safetensors),
    target("ksplat", splats::ksplat, &[]),
    target("labels", scenes::labels, &[Numbers, Json, Cameras]),
    target("lights", light::lights, &[Numbers, Json, Light]),
    target("lights_beside", light::lights_beside, &[Numbers, Json, Light]),
    fixed("lpips", tensors::lpips, &[Numbers, Json, Tensors], fix::safetensors),
    image("map_exr", images::map_exr, &[Exr], None),
    fixed("map_npy", images::map_npy, &[Numbers, Npy], fix::npy),
    image("map_png", images::map_png, &[Png], Some(fix::png)),
    target("metrics", runs::metrics, &[Numbers, Json, Run]),
    image("photograph_exr", images::photograph_exr, &[Exr], None),
    image("photograph_jpeg", images::photograph_jpeg, &[Jpeg], None),
    image("photograph_png", images::photograph_png, &[Png], Some(fix::png)),
    target("page_request", runs::request, &[Numbers, Http]),
    target("points_ply", splats::points, &[Numbers, Ply]),
    target("priors", scenes::priors, &[Numbers, Json, Cameras]),
    target("profile", runs::profile, &[Numbers, Json, Run]),
    target("provider_command", provider::command, &[Numbers, Json]),
    fixed("provider_message", provider::message, &[Numbers, Json, Tensors, Provider], fix::safetensors),
    fixed("provider_talk", provider::talk, &[Numbers, Json, Tensors, Provider], fix::talk),
    target("rgbd_depths", scenes::rgbd_depths, &[Numbers, Cameras]),
    target("rgbd_images", scenes::rgbd_images, &[Numbers, Cameras]),
    target("rgbd_intrinsics", scenes::rgbd_intrinsics, &[Numbers]),
    target("rgbd_pose", scenes::rgbd_pose, &[Numbers]),
    target("rgbd_times", scenes::rgbd_times, &[Numbers]),
    target("run_cameras", runs::cameras, &[Numbers, Json, Run]),
    target("run_log", runs::log, &[Numbers, Json, Run]),
    target("run_settings", runs::settings_of_run, &[Numbers, Toml]),
    target("scannet_intrinsics", scenes::scannet_intrinsics, &[Numbers]),
    target("scannet_pose", scenes::scannet_pose, &[Numbers]),
    target("settings", runs::settings, &[Numbers, Toml]),
    image("sog", splats::sog, &[Numbers, Json], None),
    target("sog_meta", splats::sog_meta, &[Numbers, Json]),
    target("splats_ply", splats::splats, &[Numbers, Ply]),
    target("split", scenes::split, &[Numbers, Json, Cameras]),
    image("spz", splats::spz, &[], None),
    target("training", runs::training, &[Numbers, Json, Run]),
    target("transforms", scenes::transforms, &[Numbers, Json, Cameras]),
    target("transforms_held_out", scenes::transforms_held_out, &[Numbers, Json, Cameras]),
    fixed("transport_checkpoint", tensors::transport_checkpoint, &[Numbers, Json, Tensors, Light], fix::safetensors),
    target("true_edit", light::true_edit, &[Numbers, Json, Light]),
    target("true_lights", light::true_lights, &[Numbers, Json, Light]),
    image("upright_tiff", images::upright_tiff, &[], None),
    image("upright_webp", images::upright_webp, &[], None),
    fixed("visibility", tensors::visibility, &[Numbers, Json, Tensors], fix::safetensors),
];

/// Returns the target with this name.
pub fn find(name: &str) -> Option<&'static Target> {
    TARGETS.iter().find(|t| t.name == name)
}

/// Runs a target on an input; for libFuzzer.
///
/// # Panics
/// If no target has this name, or its reader panics.
pub fn fuzz(name: &str, bytes: &[u8]) {
    let target = find(name).expect("the target is known");
    let _result = (target.run)(bytes);
}

/// Returns the files of a directory, ordered by name; empty if there is none.
pub fn files(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut files: Vec<_> = entries.filter_map(|e| Some((e.path(), std::fs::read(e.path()).ok()?))).collect();
    files.sort();
    files
}
