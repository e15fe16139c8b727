//! Device that compiles kernels and runs nothing, for drivers without a GPU.
//!
//! Mesa's RADV compiles for a GPU family that is not there (`RADV_FORCE_FAMILY`), but has neither memory heaps nor
//! timeline semaphores then. Promises: kernels are compiled as [`Device`](super::Device) compiles them, by the same
//! code. Every object is destroyed when the device is dropped.

use super::fault::Gate;
use super::instance::Instance;
use super::objects::{ObjectKind, Objects};
use super::pipeline::{Compiler, Pipelines};
use super::statistics::{self, KernelStatistics};
use super::{DeviceInfo, Feature, FeatureStructs, Requirements, describe, select};
use crate::error::{Error, Result};
use crate::shader::Shader;
use ash::khr::pipeline_executable_properties::Device as StatisticsApi;
use ash::vk;
use std::ffi::CStr;
use std::sync::Arc;

/// Features that execution needs and compilation does not, by name.
const OF_EXECUTION: [Feature; 3] = [Feature::TimelineSemaphore, Feature::HostQueryReset, Feature::Synchronization2];

/// Device that compiles kernels and reports what the driver made of them.
pub struct CompileOnlyDevice {
    raw: ash::Device,
    info: DeviceInfo,
    api: StatisticsApi,
    pipelines: Pipelines,
    gate: Gate,
    // Last field, so that it is dropped after everything created from it.
    _instance: Arc<Instance>,
}

impl CompileOnlyDevice {
    /// Opens a device by index or part of its name; the first that can compile if `None`.
    ///
    /// `objects` counts the live Vulkan objects.
    ///
    /// # Errors
    /// If the loader is missing, no device matches, the device lacks a feature that kernels need, or its driver reports
    /// no statistics of kernels.
    pub fn open(requested: Option<&str>, objects: Objects) -> Result<CompileOnlyDevice> {
        let gate = Gate::new(Default::default(), objects);
        let instance = Instance::new(false, &[], &gate)?;
        let mut candidates = describe::candidates(&instance, &gate)?;
        for candidate in &mut candidates {
            let of_execution = |name: &String| OF_EXECUTION.iter().any(|f| f.name() == name);
            candidate.info.missing.retain(|name| !of_execution(name));
            if !statistics::supported(&instance, &gate, candidate.physical)? {
                candidate.info.missing.push(statistics::EXTENSION.to_string_lossy().into_owned());
            }
        }
        let infos: Vec<DeviceInfo> = candidates.iter().map(|c| c.info.clone()).collect();
        let index = match requested {
            Some(requested) => select::named(&infos, requested)?,
            None => infos.iter().find(|d| d.missing.is_empty()).or(infos.first()).map_or(0, |d| d.index),
        };
        let none = || Error::NoDevice { requested: "any device".to_owned(), found: super::identity::names(&infos) };
        let selected = candidates.into_iter().find(|c| c.info.index == index).ok_or_else(none)?;
        if !selected.info.missing.is_empty() {
            return Err(Error::MissingFeatures { device: selected.info.name, missing: selected.info.missing });
        }
        CompileOnlyDevice::create(instance, selected, gate)
    }

    fn create(instance: Arc<Instance>, selected: describe::Candidate, gate: Gate) -> Result<CompileOnlyDevice> {
        let info = selected.info;
        let needs = Requirements::new(info.clone(), selected.queue_family);
        // What execution needs changes no kernel, and the device may lack it.
        let features: Vec<Feature> = needs.features().into_iter().filter(|f| !OF_EXECUTION.contains(f)).collect();
        let extensions = needs.extensions().into_iter().chain([statistics::EXTENSION]);
        let extensions: Vec<_> = extensions.map(CStr::as_ptr).collect();
        let family = selected.queue_family.unwrap_or(0);
        let queues = [vk::DeviceQueueCreateInfo::default().queue_family_index(family).queue_priorities(&[1.0])];
        let mut structs = FeatureStructs::enabling(&features);
        let mut executables =
            vk::PhysicalDevicePipelineExecutablePropertiesFeaturesKHR::default().pipeline_executable_info(true);
        let create = vk::DeviceCreateInfo::default().queue_create_infos(&queues).enabled_extension_names(&extensions);
        let create = structs.chain(create).push_next(&mut executables);
        // SAFETY: the physical device belongs to the instance; it reported every enabled feature and extension.
        let raw = gate.make(ObjectKind::Device, "vkCreateDevice", &info.name, || unsafe {
            instance.raw.create_device(selected.physical, &create, None)
        })?;
        let pipelines = Pipelines::new(&raw, &gate, &info, None).inspect_err(|_| {
            // SAFETY: nothing was created from the device.
            unsafe { raw.destroy_device(None) };
            gate.count_destroyed(ObjectKind::Device);
        })?;
        let api = StatisticsApi::new(&instance.raw, &raw);
        Ok(CompileOnlyDevice { raw, info, api, pipelines, gate, _instance: instance })
    }

    /// Returns the properties of the device.
    ///
    /// [`DeviceInfo::missing`] leaves out what only execution needs.
    pub fn info(&self) -> &DeviceInfo {
        &self.info
    }

    /// Compiles a kernel and returns the driver's statistics of it.
    ///
    /// `specs` holds constant ids and bits by ascending id, as a pass does ([`PassKind`](crate::graph::PassKind)).
    ///
    /// # Errors
    /// If the device does not support the subgroup size, or the driver rejects the kernel.
    pub fn compile(
        &self,
        shader: &Arc<Shader>,
        specs: &[(u32, u32)],
        subgroup_size: Option<u32>,
    ) -> Result<KernelStatistics> {
        let compiler = Compiler { raw: &self.raw, gate: &self.gate, labels: None, statistics: true };
        let pipeline = self.pipelines.get(compiler, shader, specs, subgroup_size)?;
        let statistics = statistics::of_pipeline(&self.api, &self.gate, pipeline.raw, &shader.name)?;
        let pipeline = self.pipelines.info(shader, specs, subgroup_size, &pipeline);
        Ok(KernelStatistics { pipeline, statistics })
    }
}

impl Drop for CompileOnlyDevice {
    fn drop(&mut self) {
        self.pipelines.destroy(&self.raw, &self.gate);
        // SAFETY: nothing was submitted, and everything created from the device is destroyed.
        unsafe { self.raw.destroy_device(None) };
        self.gate.count_destroyed(ObjectKind::Device);
    }
}
