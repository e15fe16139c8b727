//! Properties of physical devices.

use crate::format::ImageFormat;
use serde::Serialize;

/// Properties of a physical device.
#[derive(Clone, Debug, Serialize)]
pub struct DeviceInfo {
    /// Index in the loader's list, as accepted by `--device INDEX`.
    pub index: usize,
    /// Name reported by the driver.
    pub name: String,
    /// UUID of the device: 32 hexadecimal digits with hyphens. The same in every process, and with other drivers that know it.
    pub uuid: String,
    /// PCI address, such as `0000:01:00.0`; absent for devices on no PCI bus.
    pub pci: Option<String>,
    /// PCI vendor, or an identifier that Khronos assigned.
    pub vendor: u32,
    /// `discrete`, `integrated`, `virtual`, `cpu` or `other`.
    pub kind: &'static str,
    /// Driver name and version.
    pub driver: String,
    /// Highest supported Vulkan version, as text.
    pub api: String,
    /// Default subgroup size.
    pub subgroup_size: u32,
    /// Smallest and largest subgroup size of kernels. Kernels request a size where the two differ.
    pub subgroup_sizes: (u32, u32),
    /// Compute units or streaming multiprocessors; `None` if the driver does not report them.
    pub compute_units: Option<u32>,
    /// Largest storage binding in bytes.
    pub max_storage_range: u64,
    /// Bytes of the largest buffer (`maxBufferSize`).
    pub max_buffer: u64,
    /// Bytes of the largest allocation (`maxMemoryAllocationSize`).
    pub max_allocation: u64,
    /// Shared memory of a workgroup in bytes.
    pub max_shared_bytes: u32,
    /// Maximum storage buffers of a kernel.
    pub max_storage_buffers: u32,
    /// Maximum invocations of a workgroup.
    pub max_workgroup: u32,
    /// Alignment of storage buffer offsets in bytes.
    pub storage_alignment: u64,
    /// Alignment of uniform buffer offsets in bytes.
    pub uniform_alignment: u64,
    /// Maximum width and height of an image in texels.
    pub max_image_size: u32,
    /// Image formats that kernels can read and write.
    pub storage_formats: Vec<ImageFormat>,
    /// Nanoseconds of a timestamp tick; 0 without timestamps.
    pub timestamp_period: f32,
    /// Device-local memory in bytes.
    pub memory_bytes: u64,
    /// Shapes of cooperative matrices with 16-bit operands and 32-bit sums; empty without support.
    pub matrices: Vec<MatrixShape>,
    /// Required features that are absent, by name.
    pub missing: Vec<String>,
    /// Optional features that are absent, by name, with the fallback.
    pub fallbacks: Vec<String>,
    /// Optional features in use.
    #[serde(skip)]
    pub optional: OptionalFeatures,
}

/// Optional features that are used if present.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OptionalFeatures {
    /// Float32 atomic add on storage buffers.
    pub float_atomics: bool,
    /// Subgroup size selection.
    pub subgroup_size_control: bool,
    /// Guarantee that every subgroup of a workgroup is full.
    pub full_subgroups: bool,
    /// `VK_EXT_memory_budget`.
    pub memory_budget: bool,
    /// `VK_KHR_external_memory_fd`: shares memory with other devices and processes.
    pub external_memory_fd: bool,
    /// `VK_KHR_external_semaphore_fd`: shares semaphores with other devices and processes.
    pub external_semaphore_fd: bool,
    /// `VK_KHR_cooperative_matrix` with 16-bit operands and 32-bit sums. See [`DeviceInfo::matrices`].
    pub cooperative_matrix: bool,
}

/// Shape of a subgroup-scope cooperative matrix. Operands are 16-bit floats, sums are 32-bit floats.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct MatrixShape {
    /// Rows of the first operand and of the sums.
    pub rows: u32,
    /// Columns of the second operand and of the sums.
    pub columns: u32,
    /// Columns of the first operand, rows of the second.
    pub depth: u32,
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::device::identity::uuid_text;

    pub(in crate::device) fn device(index: usize, name: &str, kind: &'static str, missing: &[&str]) -> DeviceInfo {
        DeviceInfo {
            index,
            name: name.to_owned(),
            uuid: uuid_text(&[index as u8; 16]),
            pci: None,
            vendor: 0,
            kind,
            driver: String::new(),
            api: "1.3.0".to_owned(),
            subgroup_size: 8,
            subgroup_sizes: (8, 8),
            compute_units: None,
            max_storage_range: 1 << 27,
            max_buffer: 1 << 30,
            max_allocation: 1 << 30,
            max_shared_bytes: 32768,
            max_storage_buffers: 32,
            max_workgroup: 256,
            storage_alignment: 16,
            uniform_alignment: 16,
            max_image_size: 4096,
            storage_formats: Vec::new(),
            timestamp_period: 1.0,
            memory_bytes: 1 << 30,
            matrices: Vec::new(),
            missing: missing.iter().map(|m| (*m).to_owned()).collect(),
            fallbacks: Vec::new(),
            optional: OptionalFeatures::default(),
        }
    }
}
