//! Choice of the backward kernel that is faster on a device.

use super::Geometry;
use crate::error::{Requirement, Result};
use sgs_config::Backward;
use sgs_engine::Device;
use sgs_passes::splat::BackwardKernel;

/// Returns the kernel that training starts with under a setting.
pub(super) fn kernel_of(requested: Backward, device: &Device) -> Result<BackwardKernel> {
    let kernel = match requested {
        Backward::Auto | Backward::Pixel => BackwardKernel::Pixel,
        Backward::Splat => BackwardKernel::Splat,
        Backward::Atomic => BackwardKernel::Atomic,
    };
    if !kernel.runs_on(device.info()) {
        return Err(Requirement::FloatAtomics.into());
    }
    Ok(kernel)
}

impl Geometry {
    /// Times the pixel and the splat kernel on the current step. Selects the faster one. Parameters do not change
    /// meanwhile. The splat kernel is selected only if it takes less than 85 % of the time, so that noise does not
    /// decide between runs.
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

    /// Returns the least time of a backward kernel over five steps, in nanoseconds.
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
