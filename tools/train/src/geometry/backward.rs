//! Choice of the backward kernel that is fastest on a device.

use super::Geometry;
use super::choice::{self, Choice, Key};
use crate::error::{Requirement, Result};
use sgs_config::Backward;
use sgs_engine::Device;
use sgs_passes::splat::BackwardKernel;
use std::path::PathBuf;

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
    /// Selects the kernel of the following steps: the cached one, else the best.
    ///
    /// CPU devices run lanes one after the other. In `engine-bench` the pixel kernel is faster on them by far.
    pub(super) fn decide_backward(&mut self) -> Result<()> {
        if let Some(cached) = self.cached_backward()? {
            return self.use_backward(cached);
        }
        match self.device.info().kind {
            "cpu" => self.use_backward(Backward::Pixel),
            _ => self.measure_backward(),
        }
    }

    /// Selects the cached kernel, else the fastest deterministic one.
    ///
    /// Parameters do not change meanwhile. Returns whether kernels were timed. The choice is cached by device, driver,
    /// subgroup size, and classes of sizes.
    ///
    /// # Errors
    /// If the device fails.
    pub fn choose_backward(&mut self) -> Result<bool> {
        match self.cached_backward()? {
            Some(cached) => self.use_backward(cached).map(|()| false),
            None => self.measure_backward().map(|()| true),
        }
    }

    /// Returns the cached choice, if it considered the same kernels.
    fn cached_backward(&mut self) -> Result<Option<Backward>> {
        let Some((file, key)) = self.cache()? else { return Ok(None) };
        let Some(found) = choice::read(&file, &key) else { return Ok(None) };
        Ok((found.buckets == self.buckets_fit()?).then_some(found.kernel))
    }

    /// Returns the file of the cached choice, and what it holds for.
    fn cache(&self) -> Result<Option<(PathBuf, Key)>> {
        let [width, height] = self.options.largest;
        let info = self.device.info();
        let key = Key {
            device: info.name.clone(),
            driver: info.driver.clone(),
            subgroup_size: info.subgroup_size,
            code: BackwardKernel::code(),
            pixels: choice::class(u64::from(width) * u64::from(height)),
            gaussians: choice::class(u64::from(self.gaussians.count(&self.device)?)),
            channels: self.options.channels.count(),
            statistics: self.options.statistics.is_some(),
        };
        Ok(self.device.cache_file(&key.file()).map(|file| (file, key)))
    }

    /// Continues with a kernel. Steps of the same kernel stay as they are.
    fn use_backward(&mut self, chosen: Backward) -> Result<()> {
        let kernel = kernel_of(chosen, &self.device)?;
        self.settings.geometry.backward = chosen;
        if self.options.backward != kernel {
            self.options.backward = kernel;
            self.rebuild()?;
        }
        Ok(())
    }

    /// Times the deterministic kernels on the current step and selects the fastest.
    ///
    /// A kernel is selected before an earlier one only if it takes less than 85 % of the time, so that noise does not
    /// decide between runs. Buckets are timed only if their checkpoints leave memory for as many Gaussians. What their
    /// forward pass takes longer counts as theirs.
    fn measure_backward(&mut self) -> Result<()> {
        let cache = self.cache()?;
        let buckets = self.buckets_fit()?;
        self.status.hold(&self.device)?;
        self.options.timestamps = true;
        let pixel = self.time_backward(BackwardKernel::Pixel)?;
        let splat = self.time_backward(BackwardKernel::Splat)?.backward;
        let bucket = match buckets {
            true => {
                let times = self.time_backward(BackwardKernel::Bucket)?;
                times.backward + (times.forward - pixel.forward).max(0.0)
            }
            false => f64::INFINITY,
        };
        let mut chosen = (pixel.backward, Backward::Pixel);
        for other in [(splat, Backward::Splat), (bucket, Backward::Bucket)] {
            if other.0 < 0.85 * chosen.0 {
                chosen = other;
            }
        }
        let (_, kernel) = chosen;
        tracing::info!(
            pixel_ns = pixel.backward,
            splat_ns = splat,
            bucket_ns = bucket,
            chosen = ?kernel,
            "backward kernel"
        );
        self.options.timestamps = false;
        self.options.backward = kernel_of(kernel, &self.device)?;
        self.settings.geometry.backward = kernel;
        self.rebuild()?;
        self.status.clear_flags(&self.device)?;
        if let Some((file, key)) = cache {
            choice::write(&file, &Choice { key, buckets, kernel });
        }
        Ok(())
    }

    /// Returns whether as many Gaussians fit with checkpoints as without.
    fn buckets_fit(&mut self) -> Result<bool> {
        let count = self.gaussians.count(&self.device)?;
        let limit = if self.settings.geometry.densify.enabled() { self.most.max(count) } else { count };
        let current = self.options.backward;
        self.options.backward = BackwardKernel::Pixel;
        let without = self.most_that_fit(count, limit)?;
        self.options.backward = BackwardKernel::Bucket;
        let fits = self.fits(&self.gaussians.layout(), self.options.entry_capacity)?;
        let fits = fits && self.most_that_fit(count, limit)? == without;
        self.options.backward = current;
        Ok(fits)
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
