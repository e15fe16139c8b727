//! Choice of the backward kernel that is fastest on a device.

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
        Backward::Bucket => BackwardKernel::Bucket,
        Backward::Atomic => BackwardKernel::Atomic,
    };
    if !kernel.runs_on(device.info()) {
        return Err(Requirement::FloatAtomics.into());
    }
    Ok(kernel)
}

/// Least times of blending over a few steps, in nanoseconds.
struct Times {
    forward: f64,
    backward: f64,
}

impl Geometry {
    /// Times the deterministic kernels on the current step and selects the fastest. Parameters do not change meanwhile.
    /// A kernel is selected before an earlier one only if it takes less than 85 % of the time, so that noise does not
    /// decide between runs. Buckets are timed only if their checkpoints leave memory for as many Gaussians. What their
    /// forward pass takes longer counts as theirs.
    ///
    /// # Errors
    /// If the device fails.
    pub fn choose_backward(&mut self) -> Result<()> {
        self.status.hold(&self.device)?;
        self.options.timestamps = true;
        let pixel = self.time_backward(BackwardKernel::Pixel)?;
        let splat = self.time_backward(BackwardKernel::Splat)?.backward;
        let bucket = match self.buckets_fit()? {
            true => {
                let times = self.time_backward(BackwardKernel::Bucket)?;
                times.backward + (times.forward - pixel.forward).max(0.0)
            }
            false => f64::INFINITY,
        };
        let mut chosen = (pixel.backward, BackwardKernel::Pixel, Backward::Pixel);
        for other in
            [(splat, BackwardKernel::Splat, Backward::Splat), (bucket, BackwardKernel::Bucket, Backward::Bucket)]
        {
            if other.0 < 0.85 * chosen.0 {
                chosen = other;
            }
        }
        let (_, kernel, name) = chosen;
        tracing::info!(
            pixel_ns = pixel.backward,
            splat_ns = splat,
            bucket_ns = bucket,
            chosen = ?name,
            "backward kernel"
        );
        self.options.timestamps = false;
        self.options.backward = kernel;
        self.settings.geometry.backward = name;
        self.rebuild()?;
        Ok(self.status.clear_flags(&self.device)?)
    }

    /// Returns whether as many Gaussians fit with checkpoints as without.
    fn buckets_fit(&mut self) -> Result<bool> {
        let count = self.gaussians.count(&self.device)?;
        let limit = if self.settings.geometry.densify.enabled() { self.most.max(count) } else { count };
        self.options.backward = BackwardKernel::Pixel;
        let without = self.most_that_fit(count, limit)?;
        self.options.backward = BackwardKernel::Bucket;
        let fits = self.fits(&self.gaussians.layout(), self.options.entry_capacity)?;
        Ok(fits && self.most_that_fit(count, limit)? == without)
    }

    /// Returns the least times of a backward kernel and of blending over five steps.
    fn time_backward(&mut self, kernel: BackwardKernel) -> Result<Times> {
        self.options.backward = kernel;
        self.rebuild()?;
        for step in 1..=5 {
            let values = self.values_after(step, 0);
            self.exec_of(step)?.submit(&values)?;
        }
        self.exec()?.finish()?;
        let times = self.take_times();
        let least = |of: &dyn Fn(&str) -> bool| {
            let passes = times.iter().filter(|t| of(&t.name));
            passes.map(|t| t.nanoseconds.iter().copied().fold(f64::INFINITY, f64::min)).sum::<f64>()
        };
        Ok(Times {
            forward: least(&|name| ["blend", "blend_buckets", "clear_bucket_tiles"].contains(&name)),
            backward: least(&|name| name.starts_with("blend_bwd")),
        })
    }
}
