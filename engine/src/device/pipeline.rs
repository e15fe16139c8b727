//! Compute pipelines and their on-disk cache. Cached per kernel and specialization.

use super::fault::Gate;
use super::local_size::local_size;
use super::objects::ObjectKind;
use super::{Device, DeviceInfo, Shared, cache};
use crate::error::{Error, Result};
use crate::shader::{BindingKind, Shader};
use ash::{ext, vk};
use std::collections::hash_map::Entry;
use std::collections::{HashMap, HashSet};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Compute pipeline with its layouts.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pipeline {
    pub raw: vk::Pipeline,
    pub layout: vk::PipelineLayout,
    pub set_layout: vk::DescriptorSetLayout,
    /// Invocations of a workgroup along each axis.
    workgroup: [u32; 3],
    full_subgroups: bool,
}

/// Create info of a pipeline, for tests and reports.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PipelineInfo {
    /// Kernel name.
    pub kernel: String,
    /// Specialization constants by name.
    pub specs: Vec<(String, u32)>,
    /// Invocations of a workgroup along each axis.
    pub workgroup: [u32; 3],
    /// Lanes of each subgroup.
    pub subgroup_size: u32,
    /// Whether the pipeline requests `subgroup_size`. False on devices that have one size and no `subgroupSizeControl`.
    pub requested: bool,
    /// Whether the pipeline sets `REQUIRE_FULL_SUBGROUPS`.
    pub full_subgroups: bool,
    /// Whether the kernel uses subgroups.
    pub uses_subgroups: bool,
}

/// Subgroup configuration of a pipeline.
#[derive(Clone, Copy)]
struct Subgroups {
    /// Size to request, where the device allows requests.
    requested: Option<u32>,
    full: bool,
}

/// Device, as far as compilation uses it.
#[derive(Clone, Copy)]
pub(crate) struct Compiler<'d> {
    pub raw: &'d ash::Device,
    pub gate: &'d Gate,
    pub labels: Option<&'d ext::debug_utils::Device>,
    /// Whether the driver captures statistics. The device must have the extension.
    pub statistics: bool,
}

#[derive(PartialEq, Eq, Hash)]
struct Key {
    // Names are unique only within one program; hosts may bring other kernels, so the module itself is the key.
    shader: Arc<Shader>,
    specs: Vec<(u32, u32)>,
    subgroup_size: u32,
}

pub(crate) struct Pipelines {
    cache: vk::PipelineCache,
    path: Option<PathBuf>,
    subgroup_size_control: bool,
    full_subgroups: bool,
    /// Subgroup size of pipelines whose pass requests none.
    subgroup_size: u32,
    subgroup_sizes: (u32, u32),
    pipelines: Mutex<HashMap<Key, Pipeline>>,
    /// Whether pipelines were compiled since the on-disk cache was written.
    unsaved: AtomicBool,
}

/// Kernel, specialization constants and subgroup size of a pipeline.
pub(crate) type Wanted<'a> = (&'a Arc<Shader>, &'a [(u32, u32)], Option<u32>);

impl Pipelines {
    pub fn new(device: &ash::Device, gate: &Gate, info: &DeviceInfo, folder: Option<PathBuf>) -> Result<Pipelines> {
        let path = folder.map(|f| cache::file(&f, info));
        let data = path.as_deref().map(cache::read).unwrap_or_default();
        let create = vk::PipelineCacheCreateInfo::default().initial_data(&data);
        // SAFETY: the device is alive; by its checksum, the data was written by a driver, and by its header, a driver
        // ignores data of another.
        let cache = gate.make(ObjectKind::PipelineCache, "vkCreatePipelineCache", "kernels", || unsafe {
            device.create_pipeline_cache(&create, None)
        })?;
        Ok(Pipelines {
            cache,
            path,
            subgroup_size_control: info.optional.subgroup_size_control,
            full_subgroups: info.optional.full_subgroups,
            subgroup_size: info.subgroup_size,
            subgroup_sizes: info.subgroup_sizes,
            pipelines: Mutex::default(),
            unsaved: AtomicBool::new(false),
        })
    }

    /// Returns the pipeline of a kernel at a subgroup size; the device's default size if `None`.
    pub fn get(
        &self,
        compiler: Compiler<'_>,
        shader: &Arc<Shader>,
        specs: &[(u32, u32)],
        subgroup_size: Option<u32>,
    ) -> Result<Pipeline> {
        let subgroup_size = subgroup_size.unwrap_or(self.subgroup_size);
        let (low, high) = self.subgroup_sizes;
        if !(low..=high).contains(&subgroup_size) {
            return Err(Error::SubgroupSize { kernel: shader.name.to_string(), size: subgroup_size, low, high });
        }
        let key = Key { shader: shader.clone(), specs: specs.to_vec(), subgroup_size };
        if let Some(pipeline) = self.lock().get(&key) {
            return Ok(*pipeline);
        }
        let workgroup = local_size(&shader.spirv, specs);
        // The flag requires rows of whole subgroups.
        let full = self.full_subgroups && workgroup[0].is_multiple_of(subgroup_size);
        let subgroups = Subgroups { requested: Some(subgroup_size).filter(|_| self.subgroup_size_control), full };
        // Without the lock, so that several threads compile at once.
        let pipeline = create(compiler, self.cache, shader, specs, subgroups, workgroup)?;
        set_name(compiler.labels, compiler.gate, pipeline.raw, &shader.name);
        match self.lock().entry(key) {
            Entry::Vacant(place) => {
                self.unsaved.store(true, Ordering::Relaxed);
                Ok(*place.insert(pipeline))
            }
            Entry::Occupied(first) => {
                destroy(compiler.raw, compiler.gate, &pipeline);
                Ok(*first.get())
            }
        }
    }

    /// Compiles missing pipelines on all cores, then writes the on-disk cache.
    ///
    /// # Errors
    /// The first error that a kernel causes.
    pub fn compile(&self, compiler: Compiler<'_>, wanted: &[Wanted<'_>]) -> Result<()> {
        let missing: Vec<&Wanted<'_>> = {
            let there = self.lock();
            let mut keys = HashSet::new();
            let key = |(shader, specs, size): &Wanted<'_>| Key {
                shader: (*shader).clone(),
                specs: specs.to_vec(),
                subgroup_size: size.unwrap_or(self.subgroup_size),
            };
            wanted
                .iter()
                .map(|wanted| (wanted, key(wanted)))
                .filter(|(_, key)| !there.contains_key(key))
                .filter_map(|(wanted, key)| keys.insert(key).then_some(wanted))
                .collect()
        };
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let threads = if compiler.gate.is_watched() { 1 } else { cores.min(missing.len()) };
        let (next, first) = (AtomicUsize::new(0), Mutex::new(None));
        let work = || {
            while let Some((shader, specs, size)) = missing.get(next.fetch_add(1, Ordering::Relaxed)) {
                if let Err(error) = self.get(compiler, shader, specs, *size) {
                    first.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
                    return;
                }
            }
        };
        std::thread::scope(|scope| {
            (1..threads).for_each(|_| drop(scope.spawn(work)));
            work();
        });
        match first.into_inner().unwrap_or_else(PoisonError::into_inner) {
            Some(error) => Err(error),
            None => {
                self.save(compiler.raw, compiler.gate);
                Ok(())
            }
        }
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<Key, Pipeline>> {
        self.pipelines.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Writes the on-disk cache if pipelines were compiled since the last call.
    ///
    /// A process that is killed later has its kernels compiled for the next one.
    fn save(&self, device: &ash::Device, gate: &Gate) {
        let Some(path) = self.path.as_ref().filter(|_| self.unsaved.swap(false, Ordering::Relaxed)) else { return };
        // SAFETY: the cache is alive.
        let data =
            gate.call("vkGetPipelineCacheData", "kernels", || unsafe { device.get_pipeline_cache_data(self.cache) });
        match data {
            Ok(data) => cache::write(path, &data),
            Err(_) => self.unsaved.store(true, Ordering::Relaxed),
        }
    }

    /// Describes a pipeline of this collection.
    pub fn info(
        &self,
        shader: &Shader,
        specs: &[(u32, u32)],
        subgroup_size: Option<u32>,
        pipeline: &Pipeline,
    ) -> PipelineInfo {
        let name_of = |id: u32| {
            let known = shader.specs.iter().find(|s| s.id == id);
            known.map_or_else(|| id.to_string(), |s| s.name.to_string())
        };
        PipelineInfo {
            kernel: shader.name.to_string(),
            specs: specs.iter().map(|(id, bits)| (name_of(*id), *bits)).collect(),
            workgroup: pipeline.workgroup,
            subgroup_size: subgroup_size.unwrap_or(self.subgroup_size),
            requested: self.subgroup_size_control,
            full_subgroups: pipeline.full_subgroups,
            uses_subgroups: shader.uses_subgroups(),
        }
    }

    fn infos(&self) -> Vec<PipelineInfo> {
        self.compiled().into_iter().map(|(info, _)| info).collect()
    }

    /// Lists all pipelines by kernel name and specialization.
    pub fn compiled(&self) -> Vec<(PipelineInfo, vk::Pipeline)> {
        let pipelines = self.lock();
        let info = |(key, pipeline): (&Key, &Pipeline)| {
            (self.info(&key.shader, &key.specs, Some(key.subgroup_size), pipeline), pipeline.raw)
        };
        let mut infos: Vec<_> = pipelines.iter().map(info).collect();
        infos.sort_by(|(a, _), (b, _)| (&a.kernel, &a.specs).cmp(&(&b.kernel, &b.specs)));
        infos
    }

    /// Writes the on-disk cache and destroys every pipeline.
    pub fn destroy(&self, device: &ash::Device, gate: &Gate) {
        self.save(device, gate);
        for (_, pipeline) in self.lock().drain() {
            destroy(device, gate, &pipeline);
        }
        // SAFETY: as above; nothing uses the cache any more.
        unsafe { device.destroy_pipeline_cache(self.cache, None) };
        gate.count_destroyed(ObjectKind::PipelineCache);
    }
}

impl Device {
    /// Compiles a kernel ahead of its first pass. Constants not in `specs` have their defaults.
    ///
    /// # Errors
    /// If the device does not support the subgroup size, or the driver rejects the kernel.
    pub fn compile(&self, shader: &Arc<Shader>, specs: &[(&str, u32)], subgroup_size: Option<u32>) -> Result<()> {
        if self.0.is_planning() {
            return Ok(());
        }
        self.0.pipeline(shader, &ids_of(shader, specs), subgroup_size).map(|_| ())
    }

    /// Returns a file beside the pipeline cache, for what was measured on this device.
    ///
    /// Its name contains device, driver and subgroup size, then `name`. `None` if the device has no pipeline cache.
    pub fn cache_file(&self, name: &str) -> Option<PathBuf> {
        self.0.pipelines.path.as_ref().map(|path| path.with_extension(name))
    }

    /// Lists the create infos of all pipelines, by kernel name.
    pub fn pipelines(&self) -> Vec<PipelineInfo> {
        self.0.pipelines.infos()
    }
}

/// Destroys a pipeline that no work in flight uses.
fn destroy(device: &ash::Device, gate: &Gate, pipeline: &Pipeline) {
    // SAFETY: the caller has waited for the work that uses it; it came from this device.
    unsafe {
        device.destroy_pipeline(pipeline.raw, None);
        device.destroy_pipeline_layout(pipeline.layout, None);
        device.destroy_descriptor_set_layout(pipeline.set_layout, None);
    }
    gate.count_destroyed(ObjectKind::Pipeline);
    gate.count_destroyed(ObjectKind::PipelineLayout);
    gate.count_destroyed(ObjectKind::SetLayout);
}

impl Shared {
    /// Returns the pipeline of a kernel, compiled on first use.
    pub fn pipeline(&self, shader: &Arc<Shader>, specs: &[(u32, u32)], subgroup_size: Option<u32>) -> Result<Pipeline> {
        self.pipelines.get(self.compiler(), shader, specs, subgroup_size)
    }

    /// Compiles missing pipelines.
    pub fn compile(&self, wanted: &[Wanted<'_>]) -> Result<()> {
        self.pipelines.compile(self.compiler(), wanted)
    }

    fn compiler(&self) -> Compiler<'_> {
        Compiler {
            raw: &self.raw,
            gate: &self.gate,
            labels: self.labels.as_ref(),
            statistics: self.statistics.is_some(),
        }
    }
}

/// Converts named constants to ids, in order. Names that the kernel does not have are left out.
pub(super) fn ids_of(shader: &Shader, specs: &[(&str, u32)]) -> Vec<(u32, u32)> {
    let id = |name: &str| shader.specs.iter().find(|s| s.name == name).map(|s| s.id);
    let mut ids: Vec<_> = specs.iter().filter_map(|(name, bits)| Some((id(name)?, *bits))).collect();
    ids.sort_unstable();
    ids
}

/// Names an object for capture tools and messages.
pub(super) fn set_name<T: vk::Handle>(labels: Option<&ext::debug_utils::Device>, gate: &Gate, handle: T, text: &str) {
    let Some(api) = labels else { return };
    let Ok(name) = std::ffi::CString::new(text) else { return };
    let info = vk::DebugUtilsObjectNameInfoEXT::default().object_handle(handle).object_name(&name);
    // SAFETY: the handle was created from the device of `labels`. A failure loses only the name.
    let _lost_name =
        gate.call("vkSetDebugUtilsObjectNameEXT", text, || unsafe { api.set_debug_utils_object_name(&info) });
}

fn create(
    compiler: Compiler<'_>,
    cache: vk::PipelineCache,
    shader: &Shader,
    specs: &[(u32, u32)],
    subgroups: Subgroups,
    workgroup: [u32; 3],
) -> Result<Pipeline> {
    let Compiler { raw, gate, .. } = compiler;
    let name = &shader.name;
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
    let set_layout = gate.make(ObjectKind::SetLayout, "vkCreateDescriptorSetLayout", name, || unsafe {
        raw.create_descriptor_set_layout(&set_info, None)
    })?;
    let result = layout(compiler, shader, set_layout).and_then(|layout| {
        compile(compiler, cache, shader, specs, subgroups, layout)
            .map(|pipeline| Pipeline { raw: pipeline, layout, set_layout, workgroup, full_subgroups: subgroups.full })
            .inspect_err(|_| {
                // SAFETY: nothing was created with the layout.
                unsafe { raw.destroy_pipeline_layout(layout, None) };
                gate.count_destroyed(ObjectKind::PipelineLayout);
            })
    });
    result.inspect_err(|_| {
        // SAFETY: no object created with the layout is left.
        unsafe { raw.destroy_descriptor_set_layout(set_layout, None) };
        gate.count_destroyed(ObjectKind::SetLayout);
    })
}

fn layout(compiler: Compiler<'_>, shader: &Shader, set_layout: vk::DescriptorSetLayout) -> Result<vk::PipelineLayout> {
    let sets = [set_layout];
    let push = [vk::PushConstantRange::default().stage_flags(vk::ShaderStageFlags::COMPUTE).size(shader.push_bytes)];
    let mut info = vk::PipelineLayoutCreateInfo::default().set_layouts(&sets);
    if shader.push_bytes > 0 {
        info = info.push_constant_ranges(&push);
    }
    // SAFETY: the device and the set layout are alive.
    compiler.gate.make(ObjectKind::PipelineLayout, "vkCreatePipelineLayout", &shader.name, || unsafe {
        compiler.raw.create_pipeline_layout(&info, None)
    })
}

fn compile(
    compiler: Compiler<'_>,
    cache: vk::PipelineCache,
    shader: &Shader,
    specs: &[(u32, u32)],
    subgroups: Subgroups,
    layout: vk::PipelineLayout,
) -> Result<vk::Pipeline> {
    let Compiler { raw, gate, .. } = compiler;
    let module_info = vk::ShaderModuleCreateInfo::default().code(&shader.spirv);
    // SAFETY: the SPIR-V is a module compiled for Vulkan 1.3.
    let module = gate.make(ObjectKind::ShaderModule, "vkCreateShaderModule", &shader.name, || unsafe {
        raw.create_shader_module(&module_info, None)
    })?;
    let entries: Vec<_> = specs
        .iter()
        .enumerate()
        .map(|(i, (id, _))| vk::SpecializationMapEntry::default().constant_id(*id).offset(4 * i as u32).size(4))
        .collect();
    let values: Vec<u8> = specs.iter().flat_map(|(_, bits)| bits.to_ne_bytes()).collect();
    let specialization = vk::SpecializationInfo::default().map_entries(&entries).data(&values);
    let mut required = vk::PipelineShaderStageRequiredSubgroupSizeCreateInfo::default()
        .required_subgroup_size(subgroups.requested.unwrap_or(0));
    let mut stage = vk::PipelineShaderStageCreateInfo::default()
        .stage(vk::ShaderStageFlags::COMPUTE)
        .module(module)
        .name(c"main")
        .specialization_info(&specialization);
    if subgroups.requested.is_some() {
        stage = stage.push_next(&mut required);
    }
    if subgroups.full {
        stage = stage.flags(vk::PipelineShaderStageCreateFlags::REQUIRE_FULL_SUBGROUPS);
    }
    let flags = match compiler.statistics {
        true => vk::PipelineCreateFlags::CAPTURE_STATISTICS_KHR,
        false => vk::PipelineCreateFlags::empty(),
    };
    let info = [vk::ComputePipelineCreateInfo::default().flags(flags).stage(stage).layout(layout)];
    // SAFETY: module, layout and cache belong to this device; the specialization covers 32-bit constants.
    let result = gate.make(ObjectKind::Pipeline, "vkCreateComputePipelines", &shader.name, || unsafe {
        raw.create_compute_pipelines(cache, &info, None).map(|p| p[0]).map_err(|(_, result)| result)
    });
    // SAFETY: a module is not needed once its pipeline is created.
    unsafe { raw.destroy_shader_module(module, None) };
    gate.count_destroyed(ObjectKind::ShaderModule);
    result
}

pub(crate) fn descriptor_type(kind: BindingKind) -> vk::DescriptorType {
    match kind {
        BindingKind::Storage => vk::DescriptorType::STORAGE_BUFFER,
        BindingKind::Uniform => vk::DescriptorType::UNIFORM_BUFFER,
        BindingKind::Image(_) => vk::DescriptorType::STORAGE_IMAGE,
    }
}
