//! Compute pipelines, made once for each kernel and specialization, and their cache on disk.

use super::DeviceInfo;
use crate::error::{Check, Result};
use crate::shader::{BindingKind, Shader};
use ash::vk;
use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};

/// A kernel ready to run, with the layouts it is bound through.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pipeline {
    pub raw: vk::Pipeline,
    pub layout: vk::PipelineLayout,
    pub set_layout: vk::DescriptorSetLayout,
}

#[derive(PartialEq, Eq, Hash)]
struct Key {
    // Names are unique among kernels of one program, but hosts may bring their own: the module itself is the key.
    shader: Arc<Shader>,
    specs: Vec<(u32, u32)>,
    subgroup_size: Option<u32>,
}

pub(crate) struct Pipelines {
    cache: vk::PipelineCache,
    path: Option<PathBuf>,
    subgroup_size_control: bool,
    full_subgroups: bool,
    made: Mutex<HashMap<Key, Pipeline>>,
}

impl Pipelines {
    pub fn new(device: &ash::Device, info: &DeviceInfo, folder: Option<PathBuf>) -> Result<Pipelines> {
        // The driver checks the header of the data itself; the file is named after device and driver so that
        // several devices keep theirs.
        let path = folder.map(|f| {
            let clean =
                |s: &str| s.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).collect::<String>();
            f.join(format!("{}-{}.bin", clean(&info.name), clean(&info.driver)))
        });
        let data = path.as_ref().and_then(|p| std::fs::read(p).ok()).unwrap_or_default();
        let create = vk::PipelineCacheCreateInfo::default().initial_data(&data);
        // SAFETY: the device is alive; invalid initial data is ignored by the driver as the specification demands.
        let cache = unsafe { device.create_pipeline_cache(&create, None) }.check("vkCreatePipelineCache", "kernels")?;
        let subgroup_size_control = info.optional.subgroup_size_control;
        let full_subgroups = info.optional.full_subgroups;
        Ok(Pipelines { cache, path, subgroup_size_control, full_subgroups, made: Mutex::default() })
    }

    pub fn get(
        &self,
        device: &super::Shared,
        shader: &Arc<Shader>,
        specs: &[(u32, u32)],
        subgroup_size: Option<u32>,
    ) -> Result<Pipeline> {
        let subgroup_size = subgroup_size.filter(|_| self.subgroup_size_control);
        let key = Key { shader: shader.clone(), specs: specs.to_vec(), subgroup_size };
        let mut made = self.made.lock().unwrap_or_else(|e| e.into_inner());
        if let Some(pipeline) = made.get(&key) {
            return Ok(*pipeline);
        }
        // Kernels that name their subgroup size count on every lane being there.
        let full = self.full_subgroups && subgroup_size.is_some();
        let pipeline = create(device, self.cache, shader, specs, subgroup_size, full)?;
        device.name(pipeline.raw, &shader.name);
        made.insert(key, pipeline);
        Ok(pipeline)
    }

    /// Writes the cache and destroys every pipeline.
    pub fn destroy(&self, device: &ash::Device) {
        let mut made = self.made.lock().unwrap_or_else(|e| e.into_inner());
        if let (Some(path), false) = (&self.path, made.is_empty()) {
            // SAFETY: the cache is alive.
            if let Ok(data) = unsafe { device.get_pipeline_cache_data(self.cache) } {
                // Losing the cache costs time, never a result, so failures are not errors.
                let temporary = path.with_extension(format!("{}.tmp", std::process::id()));
                let written = path
                    .parent()
                    .map_or(Ok(()), std::fs::create_dir_all)
                    .and_then(|()| std::fs::write(&temporary, data))
                    .and_then(|()| std::fs::rename(&temporary, path));
                if let Err(error) = written {
                    tracing::debug!(%error, "pipeline cache not written");
                }
            }
        }
        for (_, p) in made.drain() {
            // SAFETY: the caller has waited for all work; these came from this device.
            unsafe {
                device.destroy_pipeline(p.raw, None);
                device.destroy_pipeline_layout(p.layout, None);
                device.destroy_descriptor_set_layout(p.set_layout, None);
            }
        }
        // SAFETY: as above; nothing is made from the cache any more.
        unsafe { device.destroy_pipeline_cache(self.cache, None) };
    }
}

fn create(
    device: &super::Shared,
    cache: vk::PipelineCache,
    shader: &Shader,
    specs: &[(u32, u32)],
    subgroup_size: Option<u32>,
    full_subgroups: bool,
) -> Result<Pipeline> {
    let raw = &device.raw;
    let bindings: Vec<_> = shader
        .bindings
        .iter()
        .map(|b| {
            vk::DescriptorSetLayoutBinding::default()
                .binding(b.number)
                .descriptor_count(1)
                .descriptor_type(descriptor_type(b.kind))
                .stage_flags(vk::ShaderStageFlags::COMPUTE)
        })
        .collect();
    let set_info = vk::DescriptorSetLayoutCreateInfo::default().bindings(&bindings);
    // SAFETY: the device is alive and `bindings` outlives the call.
    let set_layout = unsafe { raw.create_descriptor_set_layout(&set_info, None) }
        .check("vkCreateDescriptorSetLayout", &shader.name)?;
    let sets = [set_layout];
    let push = [vk::PushConstantRange::default().stage_flags(vk::ShaderStageFlags::COMPUTE).size(shader.push_bytes)];
    let mut layout_info = vk::PipelineLayoutCreateInfo::default().set_layouts(&sets);
    if shader.push_bytes > 0 {
        layout_info = layout_info.push_constant_ranges(&push);
    }
    // SAFETY: as above.
    let layout = unsafe { raw.create_pipeline_layout(&layout_info, None) };
    let module_info = vk::ShaderModuleCreateInfo::default().code(&shader.spirv);
    // SAFETY: the SPIR-V is a module compiled for Vulkan 1.3.
    let module = unsafe { raw.create_shader_module(&module_info, None) };
    let made = match (layout, module) {
        (Ok(layout), Ok(module)) => {
            let entries: Vec<_> = specs
                .iter()
                .enumerate()
                .map(|(i, (id, _))| vk::SpecializationMapEntry::default().constant_id(*id).offset(4 * i as u32).size(4))
                .collect();
            let values: Vec<u8> = specs.iter().flat_map(|(_, bits)| bits.to_ne_bytes()).collect();
            let specialization = vk::SpecializationInfo::default().map_entries(&entries).data(&values);
            let mut required = vk::PipelineShaderStageRequiredSubgroupSizeCreateInfo::default()
                .required_subgroup_size(subgroup_size.unwrap_or(0));
            let mut stage = vk::PipelineShaderStageCreateInfo::default()
                .stage(vk::ShaderStageFlags::COMPUTE)
                .module(module)
                .name(c"main")
                .specialization_info(&specialization);
            if subgroup_size.is_some() {
                stage = stage.push_next(&mut required);
            }
            if full_subgroups {
                stage = stage.flags(vk::PipelineShaderStageCreateFlags::REQUIRE_FULL_SUBGROUPS);
            }
            let info = [vk::ComputePipelineCreateInfo::default().stage(stage).layout(layout)];
            // SAFETY: module, layout and cache belong to this device; the specialization covers 32-bit constants.
            let pipelines = unsafe { raw.create_compute_pipelines(cache, &info, None) };
            match pipelines {
                Ok(p) => Ok(Pipeline { raw: p[0], layout, set_layout }),
                Err((_, result)) => Err(result),
            }
        }
        (Err(result), _) | (_, Err(result)) => Err(result),
    };
    // SAFETY: a module is not needed once pipelines are made; on failure everything made so far is given back.
    unsafe {
        if let Ok(module) = module {
            raw.destroy_shader_module(module, None);
        }
        if made.is_err() {
            if let Ok(layout) = layout {
                raw.destroy_pipeline_layout(layout, None);
            }
            raw.destroy_descriptor_set_layout(set_layout, None);
        }
    }
    made.check("vkCreateComputePipelines", &shader.name)
}

pub(crate) fn descriptor_type(kind: BindingKind) -> vk::DescriptorType {
    match kind {
        BindingKind::Storage => vk::DescriptorType::STORAGE_BUFFER,
        BindingKind::Uniform => vk::DescriptorType::UNIFORM_BUFFER,
    }
}
