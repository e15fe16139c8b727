//! Visibility field in device memory.

use super::{Field, FieldConfig, FieldError, Gradients, Moments};
use half::f16;
use sgs_engine::exec::Executor;
use sgs_engine::graph::{Buffer, Graph};
use sgs_engine::{Device, DeviceBuffer, Location, Result};
use sgs_shaders::structs::{FieldLevel, FieldStep};

/// Parameters of a visibility field, and the buffers that training adds.
#[derive(Debug)]
pub struct VisibilityField {
    config: FieldConfig,
    levels: DeviceBuffer,
    tables: DeviceBuffer,
    mlp: DeviceBuffer,
    packed: Option<DeviceBuffer>,
    training: Option<Training>,
}

#[derive(Debug)]
struct Training {
    table_moments: DeviceBuffer,
    mlp_moments: DeviceBuffer,
    /// Integers, zero between steps; see [`Gradients`].
    table_gradients: DeviceBuffer,
    touched: DeviceBuffer,
}

/// Buffers of a visibility field in one graph.
#[derive(Clone, Copy, Debug)]
pub struct FieldHandles {
    /// Field, whose step is a uniform that the host writes before each replay.
    pub field: Field,
    /// Buffers that only training has.
    pub training: Option<TrainingHandles>,
}

/// Buffers in one graph that training adds to a visibility field.
#[derive(Clone, Copy, Debug)]
pub struct TrainingHandles {
    /// Moments of the tables.
    pub table_moments: Buffer,
    /// Moments of the layers.
    pub mlp_moments: Buffer,
    /// Gradients of the tables; see [`Gradients`].
    pub table_gradients: Buffer,
    /// Bits of the touched entries.
    pub touched: Buffer,
}

impl FieldHandles {
    /// Returns the gradients for [`super::visibility_bwd`] with `lights` lights. Gradients of layers and lights, and
    /// the scale, live within a replay. Returns `None` without training.
    pub fn gradients(&self, g: &mut Graph, lights: u32) -> Option<Gradients> {
        let TrainingHandles { table_gradients: tables, touched, .. } = self.training?;
        Some(Gradients {
            mlp: g.transient("visibility.mlp_gradient", 4 * self.field.config.weights() as u64),
            lights: g.transient("visibility.light_gradients", 12 * u64::from(lights)),
            tables,
            touched,
            scale: g.transient("visibility.scale", 8),
        })
    }

    /// Returns the moments for [`super::visibility_adam`], or `None` without training.
    pub fn moments(&self, flags: Buffer, flag_words: u32, skipped: Buffer) -> Option<Moments> {
        let TrainingHandles { table_moments: tables, mlp_moments: mlp, .. } = self.training?;
        Some(Moments { tables, mlp, flags, flag_words, skipped })
    }
}

/// Returns the bytes of tables, layers, and touched bits.
fn sizes(config: &FieldConfig) -> [u64; 3] {
    let entries = u64::from(config.entries());
    [8 * entries, 4 * config.weights() as u64, 4 * entries.div_ceil(32)]
}

/// Returns the bytes of the tables' 16-bit copy.
fn packed_bytes(config: &FieldConfig) -> u64 {
    4 * u64::from(config.entries())
}

/// Packs tables into words of two halves, with the kernels' rounding.
pub fn packed_tables(tables: &[f32]) -> Vec<u32> {
    let most = f16::MAX.to_f32();
    let bits = |x: f32| u32::from(f16::from_f32(x.clamp(-most, most)).to_bits());
    tables.chunks_exact(2).map(|t| bits(t[0]) | bits(t[1]) << 16).collect()
}

impl VisibilityField {
    /// Allocates a field with random initial values. The values are [`FieldConfig::initial_tables`] and
    /// [`FieldConfig::initial_weights`]. `training` adds moments and gradients. `table_bits` of 16
    /// ([`crate::Accuracy::visibility_bits`]) adds a copy of the tables. The configuration must pass [`FieldConfig::check`].
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(
        device: &Device,
        config: FieldConfig,
        seed: u32,
        training: bool,
        table_bits: u32,
    ) -> Result<VisibilityField> {
        let [tables, mlp, bits] = sizes(&config);
        let make = |name: &str, bytes: u64| device.buffer(name, bytes, Location::Device);
        let levels = config.table_levels();
        let training = if training {
            Some(Training {
                table_moments: make("visibility_table_moments", 2 * tables)?,
                mlp_moments: make("visibility_mlp_moments", 2 * mlp)?,
                table_gradients: make("visibility_table_gradients", 2 * tables)?,
                touched: make("visibility_touched", bits)?,
            })
        } else {
            None
        };
        let field = VisibilityField {
            config,
            levels: make("visibility_levels", (levels.len() * size_of::<FieldLevel>()) as u64)?,
            tables: make("visibility_tables", tables)?,
            mlp: make("visibility_mlp", mlp)?,
            packed: match table_bits {
                16 => Some(make("visibility_packed_tables", packed_bytes(&config))?),
                _ => None,
            },
            training,
        };
        device.upload(&field.levels, 0, bytemuck::cast_slice(&levels))?;
        field.upload(device, &config.initial_tables(seed), &config.initial_weights(seed))?;
        Ok(field)
    }

    /// Returns the field without its finest levels. The coarsest `levels` keep their values and moments
    /// ([`FieldConfig::numbers_of_first_levels`]). No work may be in flight. The old buffers are released before the
    /// new ones are allocated.
    ///
    /// # Errors
    /// If the device fails.
    pub fn into_first_levels(self, device: &Device, levels: u32) -> Result<VisibilityField> {
        let config = self.config;
        let few = |each: usize, [tables, layers]: &[Vec<f32>; 2]| {
            config.numbers_of_first_levels(levels, each, [tables, layers])
        };
        let [tables, layers] = few(1, &self.download(device)?);
        let moments = if self.training.is_some() { Some(few(2, &self.download_moments(device)?)) } else { None };
        let table_bits = if self.packed.is_some() { 16 } else { 32 };
        drop(self);
        let left = VisibilityField::new(device, config.first_levels(levels), 0, moments.is_some(), table_bits)?;
        left.upload(device, &tables, &layers)?;
        if let Some([tables, layers]) = &moments {
            left.upload_moments(device, [tables, layers])?;
        }
        Ok(left)
    }

    /// Returns the shape of the field.
    pub fn config(&self) -> &FieldConfig {
        &self.config
    }

    /// Replaces the parameters and resets the optimizer.
    ///
    /// # Errors
    /// If the device fails, or if the entries exceed the capacity.
    pub fn upload(&self, device: &Device, tables: &[f32], mlp: &[f32]) -> Result<()> {
        device.upload(&self.tables, 0, bytemuck::cast_slice(tables))?;
        device.upload(&self.mlp, 0, bytemuck::cast_slice(mlp))?;
        if let Some(packed) = &self.packed {
            device.upload(packed, 0, bytemuck::cast_slice(&packed_tables(tables)))?;
        }
        let Some(t) = &self.training else { return Ok(()) };
        for buffer in [&t.table_moments, &t.mlp_moments, &t.table_gradients, &t.touched] {
            device.fill(buffer, 0)?;
        }
        Ok(())
    }

    /// Downloads the tables and layers.
    ///
    /// # Errors
    /// If the device fails.
    pub fn download(&self, device: &Device) -> Result<[Vec<f32>; 2]> {
        let all = |b: &DeviceBuffer| device.download_as(b, b.bytes() as usize / 4);
        Ok([all(&self.tables)?, all(&self.mlp)?])
    }

    /// Downloads Adam's moments of tables and layers, in pairs, for checkpoints. Both are empty without training.
    ///
    /// # Errors
    /// If the device fails.
    pub fn download_moments(&self, device: &Device) -> Result<[Vec<f32>; 2]> {
        let all = |b: &DeviceBuffer| device.download_as(b, b.bytes() as usize / 4);
        match &self.training {
            Some(t) => Ok([all(&t.table_moments)?, all(&t.mlp_moments)?]),
            None => Ok([vec![], vec![]]),
        }
    }

    /// Restores the moments that [`VisibilityField::download_moments`] returned.
    ///
    /// # Errors
    /// If the device fails, or if the entries exceed the capacity.
    pub fn upload_moments(&self, device: &Device, [tables, mlp]: [&[f32]; 2]) -> Result<()> {
        let Some(t) = &self.training else { return Ok(()) };
        device.upload(&t.table_moments, 0, bytemuck::cast_slice(tables))?;
        device.upload(&t.mlp_moments, 0, bytemuck::cast_slice(mlp))
    }

    /// Returns the device memory in bytes of a field with this configuration.
    ///
    /// # Errors
    /// If the configuration is invalid.
    pub fn bytes(config: &FieldConfig, training: bool, table_bits: u32) -> std::result::Result<u64, FieldError> {
        config.check()?;
        let [tables, mlp, bits] = sizes(config);
        let levels = u64::from(config.levels) * size_of::<FieldLevel>() as u64;
        let packed = if table_bits == 16 { packed_bytes(config) } else { 0 };
        Ok(levels + packed + if training { 5 * tables + 3 * mlp + bits } else { tables + mlp })
    }

    /// Declares the buffers in a graph; kernels may write them if `training`.
    pub fn declare(&self, g: &mut Graph, training: bool) -> FieldHandles {
        let table_bits = if self.packed.is_some() { 16 } else { 32 };
        VisibilityField::handles(g, self.config, training && self.training.is_some(), table_bits)
    }

    /// Declares the buffers of a field that need not exist yet.
    pub fn handles(g: &mut Graph, config: FieldConfig, training: bool, table_bits: u32) -> FieldHandles {
        let [tables, mlp, bits] = sizes(&config);
        let levels = u64::from(config.levels) * size_of::<FieldLevel>() as u64;
        let mut learned =
            |name: &str, bytes: u64| if training { g.external(name, bytes) } else { g.input(name, bytes) };
        let (table_buffer, mlp_buffer) = (learned("visibility_tables", tables), learned("visibility_mlp", mlp));
        let packed = (table_bits == 16).then(|| learned("visibility_packed_tables", packed_bytes(&config)));
        let field = Field {
            config,
            step: g.uniform("visibility_step", size_of::<FieldStep>() as u64),
            levels: g.input("visibility_levels", levels),
            tables: table_buffer,
            packed,
            mlp: mlp_buffer,
        };
        let beside = |g: &mut Graph| TrainingHandles {
            table_moments: g.external("visibility_table_moments", 2 * tables),
            mlp_moments: g.external("visibility_mlp_moments", 2 * mlp),
            table_gradients: g.external("visibility_table_gradients", 2 * tables),
            touched: g.external("visibility_touched", bits),
        };
        FieldHandles { field, training: training.then(|| beside(g)) }
    }

    /// Binds the buffers to their handles.
    ///
    /// # Errors
    /// If the plan declares larger buffers.
    pub fn bind(&self, exec: &mut Executor, handles: &FieldHandles) -> Result<()> {
        exec.bind(handles.field.levels, &self.levels)?;
        exec.bind(handles.field.tables, &self.tables)?;
        if let (Some(handle), Some(memory)) = (handles.field.packed, &self.packed) {
            exec.bind(handle, memory)?;
        }
        exec.bind(handles.field.mlp, &self.mlp)?;
        if let (Some(handles), Some(t)) = (handles.training, &self.training) {
            exec.bind(handles.table_moments, &t.table_moments)?;
            exec.bind(handles.mlp_moments, &t.mlp_moments)?;
            exec.bind(handles.table_gradients, &t.table_gradients)?;
            exec.bind(handles.touched, &t.touched)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_matches_the_published_size() {
        let megabytes = |training, bits| VisibilityField::bytes(&FieldConfig::default(), training, bits).unwrap() >> 20;
        assert_eq!((megabytes(false, 32), megabytes(true, 32), megabytes(true, 16)), (54, 274, 302));
    }
}
