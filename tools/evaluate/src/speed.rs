//! Rendering speed in frames per second, without readback and metrics.

use crate::error::Result;
use serde::Serialize;
use sgs_engine::Device;
use sgs_passes::Tuning;
use sgs_passes::pipeline::Renderer;
use sgs_passes::scene::Gaussians;
use sgs_passes::splat::Channels;
use sgs_run::{Shading, camera};
use sgs_scene::Scene;

/// Frames per second of one view at a time, including submission and waiting.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Fps {
    /// Frames per second of color rendering.
    pub nvs: f64,
    /// Frames per second of shading, where the run has materials.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pbr: Option<f64>,
}

/// Number of views that are timed, at most, evenly spread.
const VIEWS: usize = 8;
/// Number of frames that are timed, at least.
const LEAST_FRAMES: usize = 3;
/// Number of timed frames per view, at most.
const REPEATS: usize = 5;
/// Seconds after which no frame starts, once the least number of frames is timed.
const SECONDS: f64 = 1.0;

/// Returns the frames per second of color rendering at these views. Uses every band of the spherical harmonics.
///
/// # Errors
/// If memory runs out or the device fails.
pub fn render_fps(
    device: &Device,
    scene: &Scene,
    gaussians: &Gaussians,
    views: &[usize],
    background: [f32; 3],
) -> Result<f64> {
    let channels = Channels { colors: true, normals: false, depth: false };
    let mut renderer = Renderer::new(device, Tuning::for_device(device.info()), gaussians, [1, 1], channels)?;
    median_fps(views, |view| {
        let seen = camera(&scene.views[view].camera);
        Ok(renderer.time(gaussians, &seen, gaussians.model.sh_degree, background)?)
    })
}

/// Returns the frames per second of shading at these views.
///
/// # Errors
/// If memory runs out or the device fails.
pub fn shade_fps(shading: &mut Shading, scene: &Scene, views: &[usize]) -> Result<f64> {
    median_fps(views, |view| Ok(shading.time(&scene.views[view].camera)?))
}

/// Returns the inverse of the median frame time. One untimed frame per view warms up. Returns 0 without views.
fn median_fps(views: &[usize], mut frame: impl FnMut(usize) -> Result<f64>) -> Result<f64> {
    let count = views.len().min(VIEWS);
    let chosen: Vec<usize> = (0..count).map(|i| views[i * views.len() / count]).collect();
    // Buffers grow at the first frame of a view, and drivers compile at the first frame of all.
    let (mut spent, mut warm) = (0.0, Vec::new());
    for view in chosen {
        if spent > SECONDS {
            break;
        }
        spent += frame(view)?;
        warm.push(view);
    }
    let mut seconds = Vec::new();
    let frames = REPEATS * warm.len();
    for view in warm.iter().cycle().take(frames) {
        if seconds.len() >= LEAST_FRAMES && spent > SECONDS {
            break;
        }
        let taken = frame(*view)?;
        spent += taken;
        seconds.push(taken);
    }
    seconds.sort_by(f64::total_cmp);
    let median = match seconds.len() {
        0 => return Ok(0.0),
        n if n % 2 == 1 => seconds[n / 2],
        n => 0.5 * (seconds[n / 2 - 1] + seconds[n / 2]),
    };
    Ok(1.0 / median.max(1e-9))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Slow warm-up frames do not count. The median of the others does.
    #[test]
    fn fps_is_that_of_the_median_frame() {
        let mut calls = Vec::new();
        let fps = median_fps(&[4, 7], |view| {
            calls.push(view);
            Ok(match calls.len() {
                1 | 2 => 0.1,
                3 => 0.25,
                n if n % 2 == 0 => 0.02,
                _ => 0.06,
            })
        });
        // 0.25, then 0.02 five times and 0.06 four times: the median of ten is halfway between 0.02 and 0.06.
        assert!((fps.unwrap() - 25.0).abs() < 1e-9, "{calls:?}");
        assert_eq!(calls, [4, 7].repeat(6));
    }

    #[test]
    fn slow_frames_are_timed_three_times() {
        let mut calls = 0;
        let fps = median_fps(&(0..100).collect::<Vec<_>>(), |_| {
            calls += 1;
            Ok(2.0)
        });
        assert_eq!((fps.unwrap(), calls), (0.5, 1 + LEAST_FRAMES));
        assert_eq!(median_fps(&[], |_| Ok(1.0)).unwrap(), 0.0);
    }
}
