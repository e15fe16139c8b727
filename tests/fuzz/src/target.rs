//! The readers, as functions of bytes.

use crate::fix::{self, Fix};
use crate::targets::{images, light, provider, runs, scenes, splats, tensors};
use crate::words::Words::{self, *};
use std::path::{Path, PathBuf};

/// A reader.
#[derive(Clone, Debug)]
pub struct Target {
    /// Its name; that of its folder of the corpus.
    pub name: &'static str,
    /// Brings bytes to the reader. What it came to is said in words, of which new ones show new ways through it.
    pub run: fn(&[u8]) -> String,
    /// What its files are made of.
    pub words: &'static [Words],
    /// What readers check first.
    pub(crate) fix: Option<Fix>,
    /// Bytes of memory that a byte of input may stand for. Compressed images stand for many.
    pub per_byte: usize,
}

const fn target(name: &'static str, run: fn(&[u8]) -> String, words: &'static [Words]) -> Target {
    Target { name, run, words, fix: None, per_byte: 64 }
}

const fn fixed(name: &'static str, run: fn(&[u8]) -> String, words: &'static [Words], fix: Fix) -> Target {
    Target { name, run, words, fix: Some(fix), per_byte: 64 }
}

/// Images: deflate stands for a thousand bytes at most, each of which becomes numbers of 32 bits, several times.
const fn picture(name: &'static str, run: fn(&[u8]) -> String, words: &'static [Words], fix: Option<Fix>) -> Target {
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
    target("colmap_images_bin", scenes::colmap_images_bin, &[Cameras]),
    target("colmap_images_txt", scenes::colmap_images_txt, &[Numbers, Cameras]),
    target("colmap_points_bin", scenes::colmap_points_bin, &[Cameras]),
    target("colmap_points_txt", scenes::colmap_points_txt, &[Numbers, Cameras]),
    target("edit", light::edit, &[Numbers, Json, Light]),
    picture("environment", light::environment, &[Exr], None),
    target("fipt_cameras", scenes::fipt_cameras, &[Numbers, Cameras]),
    target("fipt_matrices", scenes::fipt_matrices, &[Numbers, Cameras]),
    target("fipt_transforms", scenes::fipt_transforms, &[Numbers, Json, Cameras]),
    fixed("gltf", splats::gltf, &[Numbers, Json, Gltf], fix::glb),
    fixed("head", tensors::head, &[Numbers, Json, Tensors], fix::safetensors),
    target("interiorverse", scenes::interiorverse, &[Numbers, Json, Cameras]),
    fixed("intrinsic_checkpoint", tensors::intrinsic_checkpoint, &[Numbers, Json, Tensors], fix::safetensors),
    target("labels", scenes::labels, &[Numbers, Json, Cameras]),
    target("lights", light::lights, &[Numbers, Json, Light]),
    target("lights_beside", light::lights_beside, &[Numbers, Json, Light]),
    fixed("lpips", tensors::lpips, &[Numbers, Json, Tensors], fix::safetensors),
    picture("map_exr", images::map_exr, &[Exr], None),
    fixed("map_npy", images::map_npy, &[Numbers, Npy], fix::npy),
    picture("map_png", images::map_png, &[Png], Some(fix::png)),
    target("metrics", runs::metrics, &[Numbers, Json, Run]),
    picture("photograph_exr", images::photograph_exr, &[Exr], None),
    picture("photograph_jpeg", images::photograph_jpeg, &[Jpeg], None),
    picture("photograph_png", images::photograph_png, &[Png], Some(fix::png)),
    target("page_request", runs::request, &[Numbers, Http]),
    target("points_ply", splats::points, &[Numbers, Ply]),
    target("priors", scenes::priors, &[Numbers, Json, Cameras]),
    target("profile", runs::profile, &[Numbers, Json, Run]),
    target("provider_command", provider::command, &[Numbers, Json]),
    fixed("provider_message", provider::message, &[Numbers, Json, Tensors, Provider], fix::safetensors),
    fixed("provider_talk", provider::talk, &[Numbers, Json, Tensors, Provider], fix::talk),
    target("run_log", runs::log, &[Numbers, Json, Run]),
    target("run_settings", runs::settings_of_run, &[Numbers, Toml]),
    target("settings", runs::settings, &[Numbers, Toml]),
    target("splats_ply", splats::splats, &[Numbers, Ply]),
    target("split", scenes::split, &[Numbers, Json, Cameras]),
    target("training", runs::training, &[Numbers, Json, Run]),
    target("transforms", scenes::transforms, &[Numbers, Json, Cameras]),
    target("transforms_held_out", scenes::transforms_held_out, &[Numbers, Json, Cameras]),
    target("true_edit", light::true_edit, &[Numbers, Json, Light]),
    target("true_lights", light::true_lights, &[Numbers, Json, Light]),
    fixed("visibility", tensors::visibility, &[Numbers, Json, Tensors], fix::safetensors),
];

/// The target of a name.
pub fn find(name: &str) -> Option<&'static Target> {
    TARGETS.iter().find(|t| t.name == name)
}

/// For libFuzzer: brings bytes to a target.
///
/// # Panics
/// If there is none of that name, or its reader panics.
pub fn fuzz(name: &str, bytes: &[u8]) {
    let target = find(name).expect("the target is known");
    let _said = (target.run)(bytes);
}

/// The kept files of a target, in the order of their names.
pub fn corpus(target: &Target) -> Vec<(PathBuf, Vec<u8>)> {
    files(&folder(target))
}

/// Where the kept files of a target lie.
pub fn folder(target: &Target) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("corpus").join(target.name)
}

/// What lies in a folder, in the order of names; nothing if there is none.
pub fn files(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut files: Vec<_> = entries.filter_map(|e| Some((e.path(), std::fs::read(e.path()).ok()?))).collect();
    files.sort();
    files
}
