//! Buffers of Gaussians, and their handles in a graph.

use super::{Group, Model, Storage};
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
    /// Storage of parameters and moments.
    pub storage: Storage,
}

impl Layout {
    /// Returns the scalars of the semantic features. Without them, a placeholder of four that no kernel accesses.
    fn features(&self) -> u64 {
        match self.model.semantics {
            true => u64::from(self.capacity) * u64::from(Group::Semantics.width()),
            false => 4,
        }
    }

    /// Returns the bytes of the parameters.
    pub fn parameter_bytes(&self) -> u64 {
        self.storage.parameter_bytes(&self.model, self.capacity) + 4 * self.features()
    }

    /// Returns the bytes of Adam's moments.
    pub fn moment_bytes(&self) -> u64 {
        let [first, second] = self.storage.moment_bytes(&self.model, self.capacity);
        if self.training { first + second + 8 * self.features() } else { 0 }
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
        let parameters = add("parameters", self.storage.parameter_bytes(&self.model, self.capacity));
        let semantics = add("semantics", 4 * self.features());
        let columns = self.storage.moment_bytes(&self.model, self.capacity);
        let moments = (self.training && training).then(|| MomentHandles {
            first: add(MOMENTS[0], columns[0]),
            second: add(MOMENTS[1], columns[1]),
            semantics: add("semantics_moments", 8 * self.features()),
        });
        let statistics = moments.is_some().then(|| add("statistics", self.statistics_bytes()));
        let work = add("gaussians", size_of::<Work>() as u64);
        let Layout { model, capacity, storage, .. } = *self;
        Handles { model, capacity, storage, parameters, semantics, moments, statistics, work }
    }
}

/// Gaussians in device memory, with capacity for more.
#[derive(Debug)]
pub struct Gaussians {
    /// Parameter groups.
    pub model: Model,
    /// Largest number of Gaussians.
    pub capacity: u32,
    /// Storage of parameters and moments.
    storage: Storage,
    /// All groups but the semantic features, in columns.
    parameters: DeviceBuffer,
    semantics: DeviceBuffer,
    /// Only for training.
    moments: Option<Moments>,
    statistics: Option<DeviceBuffer>,
    work: DeviceBuffer,
}

/// Adam's moments.
#[derive(Debug)]
struct Moments {
    /// First and second moments in columns. Compact storage has both in the first buffer.
    columns: [DeviceBuffer; 2],
    /// Pairs of moments of the semantic features.
    semantics: DeviceBuffer,
}

const MOMENTS: [&str; 2] = ["first_moments", "second_moments"];

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
        let storage = Storage::Exact;
        Gaussians::of(device, &Layout { model, capacity, training, statistics, storage })
    }

    /// Creates the buffers of a layout. A capacity of zero becomes one.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn of(device: &Device, layout: &Layout) -> Result<Gaussians> {
        let layout = Layout { capacity: layout.capacity.max(1), ..*layout };
        let Layout { model, capacity, training, storage, .. } = layout;
        let buffer = |name: &str, bytes: u64| device.buffer(name, bytes, Location::Device);
        let parameters = buffer("parameters", storage.parameter_bytes(&model, capacity))?;
        let semantics = buffer("semantics", 4 * layout.features())?;
        let columns = storage.moment_bytes(&model, capacity);
        let moments = match training {
            true => Some(Moments {
                columns: [buffer(MOMENTS[0], columns[0])?, buffer(MOMENTS[1], columns[1])?],
                semantics: buffer("semantics_moments", 8 * layout.features())?,
            }),
            false => None,
        };
        let statistics = match layout.statistics_bytes() {
            0 => None,
            bytes => Some(buffer("statistics", bytes)?),
        };
        let work = buffer("gaussians", size_of::<Work>() as u64)?;
        let gaussians = Gaussians { model, capacity, storage, parameters, semantics, moments, statistics, work };
        gaussians.reset_optimizer(device)?;
        device.upload(&gaussians.work, 0, bytemuck::bytes_of(&work_of(0)))?;
        Ok(gaussians)
    }

    /// Replaces the parameters and resets the optimizer. Compact storage rounds to nearest.
    ///
    /// # Errors
    /// If the device fails or the data exceeds the capacity.
    pub fn upload(&self, device: &Device, data: &GaussianData) -> Result<()> {
        let words = self.storage.store(&self.model, &self.model.to_columns(data));
        device.upload(&self.parameters, 0, bytemuck::cast_slice(&words))?;
        if self.model.semantics {
            device.upload(&self.semantics, 0, bytemuck::cast_slice(data.group(Group::Semantics)))?;
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
        let mut data = self.model.from_columns(&self.columns(device, count)?, count);
        if self.model.semantics {
            let features = count * Group::Semantics.width() as usize;
            data.groups[Group::Semantics as usize] = device.download_as(&self.semantics, features)?;
        }
        Ok(data)
    }

    /// Returns the columns of the first `count` Gaussians.
    fn columns(&self, device: &Device, count: usize) -> Result<Vec<f32>> {
        let words = self.storage.parameter_bytes(&self.model, count as u32) as usize / 4;
        Ok(self.storage.load(&self.model, &device.download_as::<u32>(&self.parameters, words)?))
    }

    /// Returns the columns of both moments of the first `count` Gaussians.
    fn moment_columns(&self, device: &Device, moments: &Moments, count: usize) -> Result<[Vec<f32>; 2]> {
        let [first, second] = self.storage.moment_bytes(&self.model, count as u32).map(|bytes| bytes as usize / 4);
        let first = device.download_as::<u32>(&moments.columns[0], first)?;
        let second = device.download_as::<u32>(&moments.columns[1], second)?;
        Ok(self.storage.load_moments([&first, &second]))
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
            let [first, second] = self.moment_columns(device, moments, count)?;
            data = self.model.moments_from_columns([&first, &second], count);
            if self.model.semantics {
                let pairs = 2 * count * Group::Semantics.width() as usize;
                data.groups[Group::Semantics as usize] = device.download_as(&moments.semantics, pairs)?;
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
            let [first, second] = self.model.moments_to_columns(moments);
            for (to, from) in buffers.columns.iter().zip(&self.storage.store_moments([&first, &second])) {
                device.upload(to, 0, bytemuck::cast_slice(from))?;
            }
            if self.model.semantics {
                device.upload(&buffers.semantics, 0, bytemuck::cast_slice(moments.group(Group::Semantics)))?;
            }
            device.upload(buffer, 0, bytemuck::cast_slice(statistics))?;
        }
        Ok(())
    }

    /// Grows the buffers to `capacity`, one after the other. At any time only one buffer exists twice.
    ///
    /// # Errors
    /// If memory runs out. The Gaussians are unchanged then, though some buffers take more memory.
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
        let [columns, used] = [layout, old].map(|l| l.storage.parameter_bytes(&l.model, l.capacity));
        let [features, used_features] = [layout, old].map(|l| l.features());
        larger("parameters", &mut self.parameters, columns, used)?;
        if let Some(moments) = &mut self.moments {
            let [columns, used] = [layout, old].map(|l| l.storage.moment_bytes(&l.model, l.capacity));
            for (k, buffer) in moments.columns.iter_mut().enumerate() {
                if columns[k] > used[k] {
                    larger(MOMENTS[k], buffer, columns[k], used[k])?;
                }
            }
        }
        if old.model.semantics {
            larger("semantics", &mut self.semantics, 4 * features, 4 * used_features)?;
            if let Some(moments) = &mut self.moments {
                larger("semantics_moments", &mut moments.semantics, 8 * features, 8 * used_features)?;
            }
        }
        if let Some(statistics) = self.statistics.as_mut().filter(|_| old.statistics) {
            larger("statistics", statistics, layout.statistics_bytes(), old.statistics_bytes())?;
        }
        self.capacity = layout.capacity;
        Ok(())
    }

    /// Changes the highest band of spherical harmonics. Added bands and their moments are zero; removed bands are lost.
    ///
    /// The columns pass through host memory. The old buffers are released before the new ones are created, if nothing else
    /// refers to them.
    ///
    /// # Errors
    /// If memory runs out. The Gaussians are unchanged then.
    pub fn set_degree(&mut self, device: &Device, sh_degree: u32) -> Result<()> {
        let (from, to) = (self.model, Model { sh_degree, ..self.model });
        let capacity = self.capacity as usize;
        let mut old = vec![self.columns(device, capacity)?];
        if let Some(moments) = &self.moments {
            old.extend(self.moment_columns(device, moments, capacity)?);
        }
        let new: Vec<_> = old.iter().map(|columns| from.converted(columns, &to)).collect();
        if let Err(error) = self.replace_columns(device, &to, &new) {
            self.replace_columns(device, &from, &old)?;
            return Err(error);
        }
        self.model = to;
        Ok(())
    }

    /// Replaces the buffers by those of columns: the parameters, then first and second moments if there are any.
    fn replace_columns(&mut self, device: &Device, model: &Model, columns: &[Vec<f32>]) -> Result<()> {
        let mut words = vec![self.storage.store(model, &columns[0])];
        if let [first, second] = &columns[1..] {
            words.extend(self.storage.store_moments([first, second]));
        }
        let moments = self.moments.iter_mut().flat_map(|m| &mut m.columns);
        let mut buffers: Vec<_> = std::iter::once(&mut self.parameters).chain(moments).collect();
        for buffer in &mut buffers {
            **buffer = self.work.clone();
        }
        let names = ["parameters"].into_iter().chain(MOMENTS);
        for ((buffer, name), words) in buffers.into_iter().zip(names).zip(&words) {
            *buffer = device.buffer(name, 4 * words.len() as u64, Location::Device)?;
            device.upload(buffer, 0, bytemuck::cast_slice(words))?;
        }
        Ok(())
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
        let moments = self.moments.iter().flat_map(|m| m.columns.iter().chain([&m.semantics]));
        let all = [&self.parameters, &self.semantics].into_iter().chain(moments).chain(&self.statistics);
        all.map(DeviceBuffer::bytes).sum()
    }

    fn reset_optimizer(&self, device: &Device) -> Result<()> {
        let moments = self.moments.iter().flat_map(|m| m.columns.iter().chain([&m.semantics]));
        for buffer in moments.chain(&self.statistics) {
            device.fill(buffer, 0)?;
        }
        Ok(())
    }

    /// Returns the sizes of the buffers.
    pub fn layout(&self) -> Layout {
        let (training, statistics) = (self.moments.is_some(), self.has_statistics());
        Layout { model: self.model, capacity: self.capacity, training, statistics, storage: self.storage }
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
        exec.bind(handles.parameters, &self.parameters)?;
        exec.bind(handles.semantics, &self.semantics)?;
        if let (Some(handles), Some(buffers)) = (&handles.moments, &self.moments) {
            exec.bind(handles.first, &buffers.columns[0])?;
            exec.bind(handles.second, &buffers.columns[1])?;
            exec.bind(handles.semantics, &buffers.semantics)?;
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
    /// Storage of parameters and moments.
    pub storage: Storage,
    /// All groups but the features, in columns.
    ///
    /// See [`Model::to_columns`] and [`Storage::store`].
    pub parameters: Buffer,
    /// `[Gaussians * 32]` semantic features; a placeholder if the model has none.
    pub semantics: Buffer,
    /// Adam's moments.
    pub moments: Option<MomentHandles>,
    /// Densification statistics.
    pub statistics: Option<Buffer>,
    /// Count and dispatch size.
    pub work: Buffer,
}

/// Buffers of Adam's moments in one graph.
#[derive(Clone, Copy, Debug)]
pub struct MomentHandles {
    /// First moments in columns; both moments if storage is compact ([`Storage`]).
    pub first: Buffer,
    /// Second moments in columns; a placeholder in compact storage.
    pub second: Buffer,
    /// `[Gaussians * 32]` pairs of moments of the semantic features.
    pub semantics: Buffer,
}

impl Handles {
    /// Returns the columns of 16 bytes of a Gaussian's parameters.
    pub fn columns(&self) -> u32 {
        self.storage.columns(&self.model)
    }

    /// Returns whether storage is compact.
    pub fn compact(&self) -> bool {
        self.storage == Storage::Compact
    }

    /// Returns the contents of the buffers for `data`.
    ///
    /// They are for graphs whose memory the caller owns.
    pub fn contents(&self, data: &GaussianData) -> Vec<(Buffer, Vec<u8>)> {
        let parameters = self.storage.store(&self.model, &self.model.to_columns(data));
        let mut all = vec![
            (self.parameters, bytemuck::cast_slice(&parameters).to_vec()),
            (self.work, bytemuck::bytes_of(&work_of(data.len() as u32)).to_vec()),
        ];
        if self.model.semantics {
            all.push((self.semantics, bytemuck::cast_slice(data.group(Group::Semantics)).to_vec()));
        }
        all
    }
}
