//! Which backward kernel a device is faster with.

use super::Geometry;
use crate::error::{Result, TrainError};
use sgs_config::Backward;
use sgs_engine::Device;
use sgs_passes::splat::BackwardKernel;

/// The kernel that a setting begins with.
pub(super) fn kernel_of(asked: Backward, device: &Device) -> Result<BackwardKernel> {
    let kernel = match asked {
        Backward::Auto | Backward::Pixel => BackwardKernel::Pixel,
        Backward::Splat => BackwardKernel::Splat,
        Backward::Atomic => BackwardKernel::Atomic,
    };
    if !kernel.runs_on(device.info()) {
        return Err(TrainError::Setting(
            "geometry.backward is \"atomic\", but the device has no atomics of 32-bit floats \
             (shaderBufferFloat32AtomicAdd); use \"auto\"."
                .into(),
        ));
    }
    Ok(kernel)
}

impl Geometry {
    /// Times both backward kernels on the step as it is, with parameters held, and takes the faster one. The splat
    /// kernel has to win clearly, so that noise does not decide between runs.
    ///
    /// # Errors
    /// If the device fails.
    pub fn choose_backward(&mut self) -> Result<()> {
        self.status.hold(&self.device)?;
        self.options.timestamps = true;
        let pixel = self.time_backward(BackwardKernel::Pixel)?;
        let splat = self.time_backward(BackwardKernel::Splat)?;
        let (kernel, name) = if splat < 0.85 * pixel {
            (BackwardKernel::Splat, Backward::Splat)
        } else {
            (BackwardKernel::Pixel, Backward::Pixel)
        };
        tracing::info!(pixel_ns = pixel, splat_ns = splat, chosen = ?name, "backward kernel");
        self.options.timestamps = false;
        self.options.backward = kernel;
        self.settings.geometry.backward = name;
        self.rebuild()?;
        Ok(self.status.clear_flags(&self.device)?)
    }

    /// Least nanoseconds of a backward kernel over a few views.
    fn time_backward(&mut self, kernel: BackwardKernel) -> Result<f64> {
        self.options.backward = kernel;
        self.rebuild()?;
        for step in 1..=5 {
            let values = self.values(step);
            self.exec()?.submit(&values)?;
        }
        self.exec()?.finish()?;
        let times = self.take_times();
        let backward = times.iter().filter(|t| t.name.starts_with("blend_bwd"));
        Ok(backward.flat_map(|t| t.nanoseconds.iter().copied()).fold(f64::INFINITY, f64::min))
    }
}
