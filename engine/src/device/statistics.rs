//! Statistics of compiled kernels, as the driver reports them.
//!
//! They come from `VK_KHR_pipeline_executable_properties`. Names and units are the driver's: NVIDIA reports registers,
//! stack and shared memory, RADV registers, spills and code size. Promises: nothing is compiled or reported unless
//! [`DeviceOptions::kernel_statistics`] requests it.
//!
//! [`DeviceOptions::kernel_statistics`]: super::DeviceOptions::kernel_statistics

use super::fault::Gate;
use super::pipeline::PipelineInfo;
use super::{Device, Instance};
use crate::error::Result;
use ash::khr::pipeline_executable_properties::Device as Api;
use ash::{khr, vk};
use std::ffi::CStr;

/// Extension that reports the statistics.
pub(super) const EXTENSION: &CStr = khr::pipeline_executable_properties::NAME;

/// One number that the driver reports of a kernel.
#[derive(Clone, Debug, PartialEq)]
pub struct Statistic {
    /// Driver's name of it, such as "Register Count".
    pub name: String,
    /// Value; booleans are 0 or 1.
    pub value: f64,
}

/// Statistics of a kernel.
#[derive(Clone, Debug, PartialEq)]
pub struct KernelStatistics {
    /// Kernel, specialization and subgroup size.
    pub pipeline: PipelineInfo,
    /// Numbers of the driver, in its order; empty if it reports none.
    pub statistics: Vec<Statistic>,
}

/// Returns whether a device reports statistics.
pub(super) fn supported(instance: &Instance, gate: &Gate, physical: vk::PhysicalDevice) -> Result<bool> {
    // SAFETY: the physical device comes from this instance.
    let extensions = gate.call("vkEnumerateDeviceExtensionProperties", "device", || unsafe {
        instance.raw.enumerate_device_extension_properties(physical)
    })?;
    if !extensions.iter().any(|e| e.extension_name_as_c_str() == Ok(EXTENSION)) {
        return Ok(false);
    }
    let mut executables = vk::PhysicalDevicePipelineExecutablePropertiesFeaturesKHR::default();
    let mut features = vk::PhysicalDeviceFeatures2::default().push_next(&mut executables);
    // SAFETY: the chain holds a struct of an extension that the device has.
    unsafe { instance.raw.get_physical_device_features2(physical, &mut features) };
    Ok(executables.pipeline_executable_info != 0)
}

impl Device {
    /// Returns the driver's statistics of every compiled pipeline, by kernel name.
    ///
    /// Returns `None` if they were not requested, or the driver does not report any.
    ///
    /// # Errors
    /// If the driver runs out of memory.
    pub fn kernel_statistics(&self) -> Result<Option<Vec<KernelStatistics>>> {
        let Some(api) = &self.0.statistics else { return Ok(None) };
        let gate = &self.0.gate;
        let mut all = Vec::new();
        for (pipeline, raw) in self.0.pipelines.compiled() {
            let statistics = of_pipeline(api, gate, raw, &pipeline.kernel)?;
            all.push(KernelStatistics { pipeline, statistics });
        }
        Ok(Some(all))
    }
}

/// Returns the statistics of a living pipeline that captures them.
pub(super) fn of_pipeline(api: &Api, gate: &Gate, raw: vk::Pipeline, name: &str) -> Result<Vec<Statistic>> {
    let info = vk::PipelineInfoKHR::default().pipeline(raw);
    // SAFETY: the pipeline is alive and captures statistics, as the caller promises.
    let executables = gate.call("vkGetPipelineExecutablePropertiesKHR", name, || unsafe {
        api.get_pipeline_executable_properties(&info)
    })?;
    let mut statistics = Vec::new();
    for index in 0..executables.len() as u32 {
        let info = vk::PipelineExecutableInfoKHR::default().pipeline(raw).executable_index(index);
        // SAFETY: as above; the index is below the number of executables.
        let found = gate.call("vkGetPipelineExecutableStatisticsKHR", name, || unsafe {
            api.get_pipeline_executable_statistics(&info)
        })?;
        statistics.extend(found.iter().map(statistic));
    }
    Ok(statistics)
}

fn statistic(s: &vk::PipelineExecutableStatisticKHR<'_>) -> Statistic {
    let name = s.name_as_c_str().unwrap_or_default().to_string_lossy().into_owned();
    // SAFETY: the driver writes the union's member that the format names.
    let value = unsafe {
        match s.format {
            vk::PipelineExecutableStatisticFormatKHR::BOOL32 => f64::from(s.value.b32),
            vk::PipelineExecutableStatisticFormatKHR::INT64 => s.value.i64 as f64,
            vk::PipelineExecutableStatisticFormatKHR::UINT64 => s.value.u64 as f64,
            _ => s.value.f64,
        }
    };
    Statistic { name, value }
}
