//! Buffers of Gaussians, and their handles in a graph.

use super::{Group, Model};
use sgs_engine::exec::Executor;
use sgs_engine::graph::{Buffer, Graph};
use sgs_engine::{Device, DeviceBuffer, Location, Result};
use sgs_shaders::structs::Work;

/// Scalars per Gaussian of the densification statistics. They are the sum of screen gradients, count, sum of blending
/// weights, and sum of gradients by the raw normal.
pub const STATISTICS: u32 = 4;

/// Parameters of Gaussians on the host. Each group is one flat array, empty for groups that the model lacks.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GaussianData {
    /// By position in [`Group::ALL`].
    pub groups: [Vec<f32>; Group::COUNT],
}

impl GaussianData {
    /// Returns the number of Gaussians.
    pub fn len(&self) -> usize {
        self.groups[Group::OpacityLogits as usize].len()
    }

    /// Returns whether the data contains no Gaussians.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the parameters of one group.
    pub fn group(&self, group: Group) -> &[f32] {
        &self.groups[group as usize]
    }
}

/// Sizes of the buffers of Gaussians, which need not exist.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Parameter groups.
    pub model: Model,
    /// Largest number of Gaussians.
    pub capacity: u32,
    /// Whether moments exist.
    pub training: bool,
    /// Whether densification statistics exist; never without training.
    pub statistics: bool,
}

impl Layout {
    /// Returns the number of scalars of a group. An absent group takes a placeholder of four scalars, which specialized
    /// kernels never access.
    fn scalars(&self, group: Group) -> u64 {
        if self.model.has(group) { u64::from(self.capacity) * u64::from(group.width()) } else { 4 }
    }

    /// Returns the bytes of the parameters.
    pub fn parameter_bytes(&self) -> u64 {
        Group::ALL.into_iter().map(|g| 4 * self.scalars(g)).sum()
    }

    /// Returns the bytes of Adam's moments.
    pub fn moment_bytes(&self) -> u64 {
        if self.training { 2 * self.parameter_bytes() } else { 0 }
    }

    /// Returns the bytes of the densification statistics.
    pub fn statistics_bytes(&self) -> u64 {
        match (self.training, self.statistics) {
            (true, true) => u64::from(self.capacity) * u64::from(STATISTICS) * 4,
            (true, false) => 4,
            _ => 0,
        }
    }

    /// Declares the buffers in a graph. Kernels may write them if `training`.
    pub fn declare(&self, g: &mut Graph, training: bool) -> Handles {
        let mut add = |name: &str, bytes: u64| if training { g.external(name, bytes) } else { g.input(name, bytes) };
        let parameters = Group::ALL.map(|group| add(group.name(), 4 * self.scalars(group)));
        let optimizer = self.training && training;
        let moments = optimizer
            .then(|| Group::ALL.map(|group| add(&format!("{}_moments", group.name()), 8 * self.scalars(group))));
        let statistics = optimizer.then(|| add("statistics", self.statistics_bytes()));
        let work = add("gaussians", size_of::<Work>() as u64);
        Handles { model: self.model, capacity: self.capacity, parameters, moments, statistics, work }
    }
}

/// Gaussians in device memory, with capacity for more.
#[derive(Debug)]
pub struct Gaussians {
    /// Parameter groups.
    pub model: Model,
    /// Largest number of Gaussians.
    pub capacity: u32,
    parameters: [DeviceBuffer; Group::COUNT],
    /// Pairs of first and second moments; only for training.
    moments: Option<[DeviceBuffer; Group::COUNT]>,
    statistics: Option<DeviceBuffer>,
    work: DeviceBuffer,
}

impl Gaussians {
    /// Creates the buffers. `training` adds moments and statistics.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(device: &Device, model: Model, capacity: u32, training: bool) -> Result<Gaussians> {
        Gaussians::with(device, model, capacity, training, training)
    }

    /// Creates the buffers like [`Gaussians::new`], with or without statistics. Densification requires `statistics`.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn with(device: &Device, model: Model, capacity: u32, training: bool, statistics: bool) -> Result<Gaussians> {
        let capacity = capacity.max(1);
        let layout = Layout { model, capacity, training, statistics };
        let make = |suffix: &str, bytes: u64| -> Result<[DeviceBuffer; Group::COUNT]> {
            let mut made = Vec::with_capacity(Group::COUNT);
            for g in Group::ALL {
                made.push(device.buffer(
                    &format!("{}{suffix}", g.name()),
                    layout.scalars(g) * bytes,
                    Location::Device,
                )?);
            }
            Ok(made.try_into().unwrap_or_else(|_| unreachable!("invariant: one is made for each group")))
        };
        let parameters = make("", 4)?;
        let moments = if training { Some(make("_moments", 8)?) } else { None };
        let statistics = match layout.statistics_bytes() {
            0 => None,
            bytes => Some(device.buffer("statistics", bytes, Location::Device)?),
        };
        let work = device.buffer("gaussians", size_of::<Work>() as u64, Location::Device)?;
        let gaussians = Gaussians { model, capacity, parameters, moments, statistics, work };
        gaussians.reset_optimizer(device)?;
        device.upload(&gaussians.work, 0, bytemuck::bytes_of(&work_of(0)))?;
        Ok(gaussians)
    }

    /// Replaces the parameters and resets the optimizer.
    ///
    /// # Errors
    /// If the device fails or the data exceeds the capacity.
    pub fn upload(&self, device: &Device, data: &GaussianData) -> Result<()> {
        for g in self.model.groups() {
            device.upload(&self.parameters[g as usize], 0, bytemuck::cast_slice(data.group(g)))?;
        }
        self.reset_optimizer(device)?;
        device.upload(&self.work, 0, bytemuck::bytes_of(&work_of(data.len() as u32)))
    }

    /// Returns the current parameters.
    ///
    /// # Errors
    /// If the device fails.
    pub fn download(&self, device: &Device) -> Result<GaussianData> {
        let count = self.count(device)? as usize;
        let mut data = GaussianData::default();
        for g in self.model.groups() {
            data.groups[g as usize] = device.download_as(&self.parameters[g as usize], count * g.width() as usize)?;
        }
        Ok(data)
    }

    /// Returns Adam's moments and the densification statistics, for checkpoints. Moments are pairs, by group.
    ///
    /// # Errors
    /// If the device fails.
    pub fn download_optimizer(&self, device: &Device) -> Result<(GaussianData, Vec<f32>)> {
        let count = self.count(device)? as usize;
        let mut data = GaussianData::default();
        let mut statistics = Vec::new();
        if let (Some(moments), Some(buffer)) = (&self.moments, &self.statistics) {
            for g in self.model.groups() {
                data.groups[g as usize] = device.download_as(&moments[g as usize], 2 * count * g.width() as usize)?;
            }
            if self.has_statistics() {
                statistics = device.download_as(buffer, count * STATISTICS as usize)?;
            }
        }
        Ok((data, statistics))
    }

    /// Restores the state from [`Gaussians::download_optimizer`].
    ///
    /// # Errors
    /// If the device fails.
    pub fn upload_optimizer(&self, device: &Device, moments: &GaussianData, statistics: &[f32]) -> Result<()> {
        if let (Some(buffers), Some(buffer)) = (&self.moments, &self.statistics) {
            for g in self.model.groups() {
                device.upload(&buffers[g as usize], 0, bytemuck::cast_slice(moments.group(g)))?;
            }
            device.upload(buffer, 0, bytemuck::cast_slice(statistics))?;
        }
        Ok(())
    }

    /// Grows the buffers to `capacity`, group by group. At any time only one buffer exists twice.
    ///
    /// # Errors
    /// If memory runs out. The Gaussians are unchanged then, though some groups take more memory.
    pub fn grow(&mut self, device: &Device, capacity: u32) -> Result<()> {
        let old = self.layout();
        let layout = Layout { capacity: capacity.max(self.capacity), ..old };
        let larger = |name: &str, from: &mut DeviceBuffer, bytes: u64, used: u64| -> Result<()> {
            let to = device.buffer(name, bytes, Location::Device)?;
            device.fill(&to, 0)?;
            device.copy(from, &to, used)?;
            *from = to;
            Ok(())
        };
        for g in Group::ALL.into_iter().filter(|g| old.model.has(*g)) {
            let (scalars, used) = (layout.scalars(g), old.scalars(g));
            larger(g.name(), &mut self.parameters[g as usize], 4 * scalars, 4 * used)?;
            if let Some(moments) = &mut self.moments {
                larger(&format!("{}_moments", g.name()), &mut moments[g as usize], 8 * scalars, 8 * used)?;
            }
        }
        if let Some(statistics) = self.statistics.as_mut().filter(|_| old.statistics) {
            larger("statistics", statistics, layout.statistics_bytes(), old.statistics_bytes())?;
        }
        self.capacity = layout.capacity;
        Ok(())
    }

    /// Returns the same Gaussians with another highest band of spherical harmonics. Added bands and their moments are
    /// zero; removed bands are lost. Both objects share the other buffers.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn with_degree(&self, device: &Device, sh_degree: u32) -> Result<Gaussians> {
        let model = Model { sh_degree, ..self.model };
        let layout = Layout { model, ..self.layout() };
        let changed = |old: &[DeviceBuffer; Group::COUNT], suffix: &str, bytes: u64| -> Result<_> {
            let mut buffers = old.clone();
            for g in Group::ALL.into_iter().filter(|g| model.has(*g) != self.model.has(*g)) {
                let name = format!("{}{suffix}", g.name());
                let buffer = device.buffer(&name, layout.scalars(g) * bytes, Location::Device)?;
                device.fill(&buffer, 0)?;
                buffers[g as usize] = buffer;
            }
            Ok(buffers)
        };
        Ok(Gaussians {
            model,
            capacity: self.capacity,
            parameters: changed(&self.parameters, "", 4)?,
            moments: self.moments.as_ref().map(|m| changed(m, "_moments", 8)).transpose()?,
            statistics: self.statistics.clone(),
            work: self.work.clone(),
        })
    }

    /// Returns the current number of Gaussians. Waits for the device.
    ///
    /// # Errors
    /// If the device fails.
    pub fn count(&self, device: &Device) -> Result<u32> {
        Ok(device.download_as::<Work>(&self.work, 1)?[0].count)
    }

    fn has_statistics(&self) -> bool {
        let bytes = u64::from(self.capacity) * u64::from(STATISTICS) * 4;
        self.statistics.as_ref().is_some_and(|s| s.bytes() >= bytes)
    }

    /// Returns the bytes of device memory for parameters, moments and statistics.
    pub fn bytes(&self) -> u64 {
        let sum = |b: &[DeviceBuffer; Group::COUNT]| b.iter().map(DeviceBuffer::bytes).sum::<u64>();
        sum(&self.parameters)
            + self.moments.as_ref().map_or(0, sum)
            + self.statistics.as_ref().map_or(0, DeviceBuffer::bytes)
    }

    fn reset_optimizer(&self, device: &Device) -> Result<()> {
        for buffer in self.moments.iter().flatten().chain(&self.statistics) {
            device.fill(buffer, 0)?;
        }
        Ok(())
    }

    /// Returns the sizes of the buffers.
    pub fn layout(&self) -> Layout {
        let (training, statistics) = (self.moments.is_some(), self.has_statistics());
        Layout { model: self.model, capacity: self.capacity, training, statistics }
    }

    /// Declares the buffers in a graph. Kernels may write them if `training`.
    pub fn declare(&self, g: &mut Graph, training: bool) -> Handles {
        self.layout().declare(g, training)
    }

    /// Binds the buffers to their handles.
    ///
    /// # Errors
    /// If the plan was compiled for larger buffers.
    pub fn bind(&self, exec: &mut Executor, handles: &Handles) -> Result<()> {
        for (handle, buffer) in handles.parameters.iter().zip(&self.parameters) {
            exec.bind(*handle, buffer)?;
        }
        if let (Some(handles), Some(buffers)) = (&handles.moments, &self.moments) {
            for (handle, buffer) in handles.iter().zip(buffers) {
                exec.bind(*handle, buffer)?;
            }
        }
        if let (Some(handle), Some(buffer)) = (handles.statistics, &self.statistics) {
            exec.bind(handle, buffer)?;
        }
        exec.bind(handles.work, &self.work)
    }
}

fn work_of(count: u32) -> Work {
    let groups = count.div_ceil(256).max(1);
    let x = groups.min(65535);
    Work { x, y: groups.div_ceil(x), z: 1, count }
}

/// Buffers of Gaussians in one graph.
#[derive(Clone, Copy, Debug)]
pub struct Handles {
    /// Parameter groups.
    pub model: Model,
    /// Largest number of Gaussians.
    pub capacity: u32,
    /// By position in [`Group::ALL`].
    pub parameters: [Buffer; Group::COUNT],
    /// Pairs of moments, by position in [`Group::ALL`].
    pub moments: Option<[Buffer; Group::COUNT]>,
    /// Densification statistics.
    pub statistics: Option<Buffer>,
    /// Count and dispatch size.
    pub work: Buffer,
}

impl Handles {
    /// Returns the parameters of one group.
    pub fn group(&self, group: Group) -> Buffer {
        self.parameters[group as usize]
    }
}
