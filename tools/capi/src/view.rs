//! Rendering into images of a host. Frames are recorded into its command buffers, or submitted between its semaphores.

use crate::border::{Outcome, fail, read, write};
use crate::context::{Inner, SgsContext, claim, hand_over, with};
use crate::object::{Shows, Thing, ViewObject};
use crate::scene::camera;
use crate::types::*;
use sgs_engine::ImageFormat;
use sgs_engine::exec::{Completion, Executor, SemaphorePoint};
use sgs_engine::graph::{Buffer, ImageState};
use sgs_engine::vk::{self, Handle};
use sgs_passes::pipeline::{Frame, LitFrame, View, ViewOptions};
use sgs_passes::splat::{Encoding, Layer, Presented, TexelFormat};

/// Number of wrapped images that are cached. A host has as many as its swapchain.
const IMAGES: usize = 16;

fn state(layout: u32, what: &str) -> Outcome<ImageState> {
    Ok(match vk::ImageLayout::from_raw(layout as i32) {
        vk::ImageLayout::UNDEFINED => ImageState::Undefined,
        vk::ImageLayout::GENERAL => ImageState::General,
        vk::ImageLayout::TRANSFER_SRC_OPTIMAL => ImageState::TransferSource,
        vk::ImageLayout::TRANSFER_DST_OPTIMAL => ImageState::TransferTarget,
        vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL => ImageState::ShaderRead,
        vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL => ImageState::ColorAttachment,
        vk::ImageLayout::PRESENT_SRC_KHR => ImageState::Present,
        _ => {
            let text = format!("SgsViewInfo.{what} is {layout}, which is no layout that images are handed over in.");
            return fail(SgsResult::SGS_ERROR_ARGUMENT, text);
        }
    })
}

/// Parameters that all views have.
pub(crate) struct Target {
    pub format: TexelFormat,
    pub encoding: Encoding,
    pub entry: ImageState,
    pub exit: ImageState,
    pub frames_in_flight: usize,
}

pub(crate) fn target(info: &SgsViewInfo) -> Outcome<Target> {
    let wrong = |text: String| fail(SgsResult::SGS_ERROR_ARGUMENT, text);
    let format = match vk::Format::from_raw(info.format as i32) {
        vk::Format::R8G8B8A8_UNORM => TexelFormat::Rgba8Unorm,
        vk::Format::B8G8R8A8_UNORM => TexelFormat::Bgra8Unorm,
        vk::Format::R8G8B8A8_SRGB => TexelFormat::Rgba8Srgb,
        vk::Format::B8G8R8A8_SRGB => TexelFormat::Bgra8Srgb,
        vk::Format::R16G16B16A16_SFLOAT => TexelFormat::Rgba16Float,
        vk::Format::R32G32B32A32_SFLOAT => TexelFormat::Rgba32Float,
        _ => return wrong(format!("SgsViewInfo.format is {}, which no view is rendered in.", info.format)),
    };
    let encoding = match info.encoding {
        SGS_ENCODING_DISPLAY => Encoding::Display,
        SGS_ENCODING_LINEAR => Encoding::Linear,
        other => return wrong(format!("There is no encoding {other}.")),
    };
    let exit = state(info.final_layout, "final_layout")?;
    if exit == ImageState::Undefined {
        return wrong("SgsViewInfo.final_layout is undefined, which no image can be left in.".into());
    }
    if info.frames_in_flight > 16 {
        return wrong(format!("SgsViewInfo.frames_in_flight is {}, but at most 16.", info.frames_in_flight));
    }
    Ok(Target {
        format,
        encoding,
        entry: state(info.initial_layout, "initial_layout")?,
        exit,
        frames_in_flight: if info.frames_in_flight == 0 { 2 } else { info.frames_in_flight as usize },
    })
}

fn options(info: &SgsViewInfo) -> Outcome<ViewOptions> {
    let wrong = |text: String| fail(SgsResult::SGS_ERROR_ARGUMENT, text);
    let layer = match info.layer {
        SGS_LAYER_COLOR => Layer::Color,
        SGS_LAYER_DEPTH => Layer::Depth,
        SGS_LAYER_NORMAL => Layer::Normal,
        SGS_LAYER_ALPHA => Layer::Alpha,
        other => return wrong(format!("There is no layer {other}.")),
    };
    if !info.depth_scale.is_finite() {
        return wrong("SgsViewInfo.depth_scale is not finite.".into());
    }
    let Target { format, encoding, entry, exit, frames_in_flight } = target(info)?;
    let depth_scale = if info.depth_scale == 0.0 { 1.0 } else { info.depth_scale };
    Ok(ViewOptions {
        size: [info.width, info.height],
        presented: Presented { layer, format, encoding, depth_scale },
        entry,
        exit,
        frames_in_flight,
        entry_capacity: 0,
    })
}

/// Creates a view of a scene for images of one size and format. The scene may be destroyed before the view.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_view_create(
    context: *const SgsContext,
    scene: SgsScene,
    info: *const SgsViewInfo,
    view: *mut SgsView,
) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            claim(view)?;
            let scene = inner.scene(scene)?.clone();
            let options = options(&read(info)?)?;
            let made = View::new(&inner.device, inner.tuning, &scene.gaussians, options)?;
            let object = ViewObject::new(Shows::Scene(scene, made));
            hand_over(inner, view, Thing::View(Box::new(object)))
        })
    }
}

/// Prepares a frame and passes it to `how`.
///
/// # Safety
/// As for the functions of the header: `frame` is null or a struct, and its image is what the header requires.
unsafe fn frame<R>(
    inner: &mut Inner,
    view: SgsView,
    frame: *const SgsFrame,
    how: impl FnOnce(&mut Executor, &[(Buffer, &[u8])]) -> sgs_engine::Result<R>,
) -> Outcome<R> {
    let device = inner.device.clone();
    let object = inner.view(view)?;
    // SAFETY: by the caller's contract.
    let (info, place) = unsafe {
        let info = read(frame)?;
        (info, read(info.camera)?)
    };
    let camera = camera(&place)?;
    if info.background.iter().any(|v| !v.is_finite()) {
        return fail(SgsResult::SGS_ERROR_ARGUMENT, "SgsFrame.background is not finite.");
    }
    if info.image == 0 {
        return fail(SgsResult::SGS_ERROR_NULL, "SgsFrame.image is null.");
    }
    if object.images.len() >= IMAGES && !object.images.contains_key(&info.image) {
        object.images.clear();
    }
    let (size, format) = object.target();
    let image = match object.images.get(&info.image) {
        Some(image) => image.clone(),
        None => {
            let raw = vk::Image::from_raw(info.image);
            let format = ImageFormat::from(format);
            // SAFETY: the host promises that the image is of the view's size and format, and lives.
            let image = unsafe { device.wrap_image("host's image", raw, size, format, false) }?;
            object.images.insert(info.image, image.clone());
            image
        }
    };
    match &mut object.shows {
        Shows::Scene(scene, view) => {
            let what = Frame { camera, sh_degree: scene.degree(info.sh_bands), background: info.background };
            Ok(view.frame(&scene.gaussians, &image, &what, how)?)
        }
        Shows::Relight(relight, view, exposure) => {
            let background = info.background.map(sgs_scene::srgb_to_linear);
            let what = LitFrame { camera, background, exposure: *exposure };
            let relight = relight.hold();
            Ok(view.frame(relight.scene(), relight.lighting(), &image, &what, how)?)
        }
    }
}

/// Records a frame into a command buffer of the host.
///
/// The frame runs after everything recorded before it and before everything recorded after it. The command buffer is in
/// the recording state, outside a render pass, used by this thread, and from a pool of the context's queue family. It
/// is submitted at most once at a time: to the context's queue, or ordered by the host against all other work of the
/// context. The call changes the bound compute pipeline, its descriptor set 0 and push constants. After an error the
/// command buffer must be recorded again.
///
/// The recording is held until sgs_recording_timeline, sgs_recording_fence or sgs_recording_done is called for it.
/// Returns SGS_ERROR_BUSY if as many recordings are held as frames may be in flight.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_view_record(
    context: *const SgsContext,
    view: SgsView,
    frame: *const SgsFrame,
    commands: VkCommandBuffer,
    recording: *mut SgsRecording,
) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            claim(recording)?;
            if commands.is_null() {
                return fail(SgsResult::SGS_ERROR_NULL, "The command buffer is null.");
            }
            let commands = vk::CommandBuffer::from_raw(commands as u64);
            let recorded = self::frame(inner, view, frame, |exec, uniforms| exec.record_into(commands, uniforms))?;
            hand_over(inner, recording, Thing::Recording(recorded))
        })
    }
}

/// # Safety
/// The host's statement about its submission is true.
unsafe fn end(context: *const SgsContext, recording: SgsRecording, until: Option<Completion>) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            let Thing::Recording(recorded) = inner.table.take(recording, Some(4))? else {
                return fail(SgsResult::SGS_ERROR_HANDLE, "The object is no recording.");
            };
            match until {
                Some(until) => recorded.until(until),
                None => recorded.release(),
            }
            Ok(())
        })
    }
}

/// Ends a recording whose submission signals a timeline semaphore. The submission is done when the semaphore reaches
/// `value`. The semaphore belongs to the device and lives until sgs_view_report shows the recording done, or the view
/// is destroyed. The handle becomes invalid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_recording_timeline(
    context: *const SgsContext,
    recording: SgsRecording,
    semaphore: VkSemaphore,
    value: u64,
) -> SgsResult {
    if semaphore == 0 {
        // SAFETY: by the caller's contract.
        return unsafe { with(context, |_| fail(SgsResult::SGS_ERROR_NULL, "The semaphore is null.")) };
    }
    let until = Completion::Timeline(vk::Semaphore::from_raw(semaphore), value);
    // SAFETY: by the caller's contract.
    unsafe { end(context, recording, Some(until)) }
}

/// Ends a recording whose submission is done when a fence is signaled. The fence is neither reset nor destroyed before
/// that. The handle becomes invalid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_recording_fence(
    context: *const SgsContext,
    recording: SgsRecording,
    fence: VkFence,
) -> SgsResult {
    if fence == 0 {
        // SAFETY: by the caller's contract.
        return unsafe { with(context, |_| fail(SgsResult::SGS_ERROR_NULL, "The fence is null.")) };
    }
    // SAFETY: by the caller's contract.
    unsafe { end(context, recording, Some(Completion::Fence(vk::Fence::from_raw(fence)))) }
}

/// Ends a recording whose submission is done or will never be made. The handle becomes invalid.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_recording_done(context: *const SgsContext, recording: SgsRecording) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe { end(context, recording, None) }
}

/// Converts semaphores of the host.
///
/// # Safety
/// `from` points to `count` structs, or `count` is 0.
unsafe fn semaphores(from: *const SgsSemaphore, count: u32, what: &str) -> Outcome<Vec<SemaphorePoint>> {
    if count == 0 {
        return Ok(Vec::new());
    }
    if from.is_null() || count > 256 {
        return fail(SgsResult::SGS_ERROR_NULL, format!("{what} is null, or {count} is too many."));
    }
    // SAFETY: by the caller's contract.
    let all = unsafe { std::slice::from_raw_parts(from, count as usize) };
    if all.iter().any(|s| s.semaphore == 0) {
        return fail(SgsResult::SGS_ERROR_NULL, format!("One of {what} is null."));
    }
    Ok(all.iter().map(|s| SemaphorePoint::timeline(vk::Semaphore::from_raw(s.semaphore), s.value)).collect())
}

/// Submits a frame to the context's queue. The frame waits for some semaphores and signals others. The semaphores
/// belong to the device. Each signal to wait for has been submitted, and each value to signal is new.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_view_submit(
    context: *const SgsContext,
    view: SgsView,
    frame: *const SgsFrame,
    waits: *const SgsSemaphore,
    wait_count: u32,
    signals: *const SgsSemaphore,
    signal_count: u32,
) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            let waits = semaphores(waits, wait_count, "waits")?;
            let signals = semaphores(signals, signal_count, "signals")?;
            self::frame(inner, view, frame, |exec, uniforms| exec.submit_with(uniforms, &waits, &signals).map(|_| ()))
        })
    }
}

/// Waits for the frames that sgs_view_submit has submitted.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_view_wait(context: *const SgsContext, view: SgsView) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            match &mut inner.view(view)?.shows {
                Shows::Scene(_, view) => view.finish()?,
                Shows::Relight(_, view, _) => view.finish()?,
            }
            Ok(())
        })
    }
}

/// Returns the report on frames that are done. Does not wait.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sgs_view_report(
    context: *const SgsContext,
    view: SgsView,
    report: *mut SgsViewReport,
) -> SgsResult {
    // SAFETY: by the caller's contract.
    unsafe {
        with(context, |inner| {
            let object = inner.view(view)?;
            let known = match &object.shows {
                Shows::Scene(_, view) => view.report()?,
                Shows::Relight(_, view, _) => view.report()?,
            };
            let value = SgsViewReport {
                struct_size: 0,
                frames: known.frames,
                incomplete: known.incomplete,
                recordings: object.open()? as u32,
            };
            write(report, &value)
        })
    }
}
