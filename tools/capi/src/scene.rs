//! Scenes and cameras, and rendering into the caller's memory.

use crate::border::{Outcome, fail, read, string, write};
use crate::context::{Inner, SgsContext, claim, hand_over, with};
use crate::object::{SceneObject, Thing};
use crate::types::*;
use sgs_passes::pipeline::{Camera, Renderer};
use sgs_passes::splat::Channels;
use sgs_scene::{MAX_CAMERA_NUMBER, MAX_IMAGE_SIDE, Splats};
use std::ffi::c_char;
use std::path::Path;
use std::sync::Arc;

/// Converts a camera to that of the kernels.
pub(crate) fn camera(c: &SgsCamera) -> Outcome<Camera> {
    let wrong = |text: &str| fail(SgsResult::SGS_ERROR_ARGUMENT, text);
    let m = &c.world_to_camera;
    let numbers = c.focal.iter().chain(&c.center).chain(m).chain([&c.near_plane]);
    if numbers.clone().any(|v| !v.is_finite()) {
        return wrong("SgsCamera holds numbers that are not finite.");
    }
    if c.width == 0 || c.height == 0 || c.width > MAX_IMAGE_SIDE || c.height > MAX_IMAGE_SIDE {
        return wrong("SgsCamera.width and height must be between 1 and 65536.");
    }
    if c.focal.iter().any(|f| *f <= 0.0) || c.near_plane < 0.0 {
        return wrong("SgsCamera.focal must be positive, and near_plane not negative.");
    }
    let most = MAX_CAMERA_NUMBER as f32;
    if numbers.clone().any(|v| v.abs() > most) || c.focal.iter().any(|f| *f < 1.0 / most) {
        return wrong("SgsCamera holds numbers beyond 1e15, or a focal length below 1e-15.");
    }
    let row = |i: usize| [m[4 * i], m[4 * i + 1], m[4 * i + 2], m[4 * i + 3]];
    let (rows, near) = ([row(0), row(1), row(2)], if c.near_plane > 0.0 { c.near_plane } else { 0.01 });
    // A rotation or a mirror has orthonormal rows. Any other matrix would silently distort colors and shapes of splats.
    let dot = |i: usize, j: usize| (0..3).map(|k| rows[i][k] * rows[j][k]).sum::<f32>();
    if (0..3).any(|i| (dot(i, i) - 1.0).abs() > 1e-2 || dot(i, (i + 1) % 3).abs() > 1e-2) {
        return wrong("SgsCamera.world_to_camera has no rotation in its first three columns.");
    }
    let position = [0, 1, 2].map(|k| -rows.iter().map(|r| r[k] * r[3]).sum::<f32>());
    Ok(Camera {
        world_to_camera: rows,
        position,
        near,
        focal: c.focal,
        center: c.center,
        size: [c.width, c.height],
        tiles: [0, 0],
        radial: 0.0,
    })
}

/// Loads Gaussians from a PLY file or a run directory.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_scene_load(
    context: *const SgsContext,
    path: *const c_char,
    scene: *mut SgsScene,
) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            claim(scene)?;
            let path = string(path, "path")?;
            let path = Path::new(&path);
            let file = if path.is_dir() { path.join("scene.ply") } else { path.to_owned() };
            let splats = Splats::read_ply(&file)?;
            let object = Thing::Scene(Arc::new(SceneObject::new(&inner.device, &splats)?));
            hand_over(inner, scene, object)
        })
    }
}

/// Returns the description of a scene.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_scene_get(
    context: *const SgsContext,
    scene: SgsScene,
    info: *mut SgsSceneInfo,
) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            let gaussians = &inner.scene(scene)?.gaussians;
            let value = SgsSceneInfo {
                struct_size: 0,
                gaussians: gaussians.capacity,
                sh_degree: gaussians.model.sh_degree,
                normals: u32::from(gaussians.model.normals),
                bytes: gaussians.bytes(),
            };
            write(info, &value)
        })
    }
}

/// Writes the Gaussians as a PLY file for viewers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_scene_export(
    context: *const SgsContext,
    scene: SgsScene,
    path: *const c_char,
) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            let path = string(path, "path")?;
            let scene = inner.scene(scene)?.clone();
            let data = scene.gaussians.download(&inner.device)?;
            Ok(sgs_run::splats(&data, scene.gaussians.model).write_ply(Path::new(&path))?)
        })
    }
}

/// Loads the cameras of a transforms file.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_cameras_load(
    context: *const SgsContext,
    path: *const c_char,
    cameras: *mut SgsCameras,
) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            claim(cameras)?;
            let path = string(path, "path")?;
            let all = sgs_scene::Camera::read_transforms(Path::new(&path))?;
            hand_over(inner, cameras, Thing::Cameras(all))
        })
    }
}

/// Returns the number of cameras.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_cameras_count(
    context: *const SgsContext,
    cameras: SgsCameras,
    count: *mut u32,
) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            let all = inner.cameras(cameras)?.len() as u32;
            let Some(count) = count.as_mut() else {
                return fail(SgsResult::SGS_ERROR_NULL, "The place for the count is null.");
            };
            *count = all;
            Ok(())
        })
    }
}

/// Returns one of the cameras.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_cameras_get(
    context: *const SgsContext,
    cameras: SgsCameras,
    index: u32,
    camera: *mut SgsCamera,
) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            let all = inner.cameras(cameras)?;
            let Some(c) = all.get(index as usize) else {
                let text = format!("Camera {index} does not exist, there are {}.", all.len());
                return fail(SgsResult::SGS_ERROR_ARGUMENT, text);
            };
            let c = sgs_run::camera(c);
            let mut world_to_camera = [0.0; 12];
            world_to_camera.copy_from_slice(c.world_to_camera.as_flattened());
            let value = SgsCamera {
                struct_size: 0,
                width: c.size[0],
                height: c.size[1],
                near_plane: c.near,
                focal: c.focal,
                center: c.center,
                world_to_camera,
            };
            write(camera, &value)
        })
    }
}

/// Renders one layer into the caller's memory and waits. Rows start at the top. The layer determines the number of
/// floats per pixel. `count`: capacity of `pixels` in floats.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_render(
    context: *const SgsContext,
    scene: SgsScene,
    camera: *const SgsCamera,
    info: *const SgsRenderInfo,
    pixels: *mut f32,
    count: usize,
) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            let scene = inner.scene(scene)?.clone();
            let view = self::camera(&read(camera)?)?;
            let info = read(info)?;
            if pixels.is_null() {
                return fail(SgsResult::SGS_ERROR_NULL, "The place for the pixels is null.");
            }
            if info.layer > SGS_LAYER_ALPHA {
                return fail(SgsResult::SGS_ERROR_ARGUMENT, format!("There is no layer {}.", info.layer));
            }
            if info.layer == SGS_LAYER_NORMAL && !scene.gaussians.model.normals {
                return fail(SgsResult::SGS_ERROR_ARGUMENT, "The scene has no normals.");
            }
            let floats = if info.layer == SGS_LAYER_COLOR || info.layer == SGS_LAYER_NORMAL { 3 } else { 1 };
            let needed = view.size[0] as usize * view.size[1] as usize * floats;
            if count < needed {
                let text = format!("The image takes {needed} floats, but there is room for {count}.");
                return fail(SgsResult::SGS_ERROR_SPACE, text);
            }
            let rendered = render(inner, &scene, &view, &info)?;
            std::ptr::copy_nonoverlapping(rendered.as_ptr(), pixels, needed);
            Ok(())
        })
    }
}

fn render(inner: &Inner, scene: &SceneObject, camera: &Camera, info: &SgsRenderInfo) -> Outcome<Vec<f32>> {
    let channels =
        Channels { colors: true, normals: info.layer == SGS_LAYER_NORMAL, depth: info.layer == SGS_LAYER_DEPTH };
    let mut cached = scene.renderer.lock().unwrap_or_else(|e| e.into_inner());
    // Removed first, so that a failure leaves no renderer in an undefined state.
    let mut renderer = match cached.take() {
        Some((had, renderer)) if had == channels => renderer,
        _ => Renderer::new(&inner.device, inner.tuning, &scene.gaussians, camera.size, channels)?,
    };
    let rendered = renderer.render(&scene.gaussians, camera, scene.degree(info.sh_bands), info.background)?;
    *cached = Some((channels, renderer));
    let c = rendered.channels as usize;
    let pick = |from: usize, count: usize| -> Vec<f32> {
        rendered.image.chunks_exact(c).flat_map(|p| p[from..from + count].iter().copied()).collect()
    };
    Ok(match info.layer {
        SGS_LAYER_DEPTH => pick(3, 1),
        SGS_LAYER_NORMAL => pick(3, 3),
        SGS_LAYER_ALPHA => rendered.transmittance.iter().map(|t| 1.0 - t).collect(),
        _ => pick(0, 3),
    })
}
