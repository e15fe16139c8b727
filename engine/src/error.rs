//! Engine errors below the graph. Each names the call or resource, and the values.

use ash::vk;

/// Errors of the engine.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The Vulkan loader is missing.
    #[error("The Vulkan loader could not be opened ({0}); install it (libvulkan1 on Debian) together with a driver.")]
    Loader(String),
    /// No device matches.
    #[error("No Vulkan device matches \"{requested}\"; found: {found}.")]
    NoDevice {
        /// Requested index or name.
        requested: String,
        /// Names of the available devices.
        found: String,
    },
    /// A request could mean several devices, or none.
    #[error("{why}; select one with --device: {found}.")]
    UnclearDevice {
        /// What is unclear.
        why: String,
        /// Devices to select from.
        found: String,
    },
    /// A device lacks required features.
    #[error("Device \"{device}\" lacks {}.", missing.join(", "))]
    MissingFeatures {
        /// Name of the device.
        device: String,
        /// Names of the missing features.
        missing: Vec<String>,
    },
    /// A pass requests a subgroup size that the device does not support.
    #[error("Kernel \"{kernel}\" requests {size} lanes a subgroup, but the device runs {low} to {high}.")]
    SubgroupSize {
        /// Name of the kernel.
        kernel: String,
        /// Requested subgroup size.
        size: u32,
        /// Smallest subgroup size of the device.
        low: u32,
        /// Largest subgroup size of the device.
        high: u32,
    },
    /// Validation is requested but the layer is not installed.
    #[error("The validation layer is not installed (vulkan-validationlayers on Debian).")]
    NoValidation,
    /// A Vulkan call failed.
    #[error("{call} failed for \"{what}\": {result}.")]
    Vulkan {
        /// Name of the call.
        call: &'static str,
        /// Object or pass of the call.
        what: String,
        /// Result code.
        result: vk::Result,
    },
    /// Memory ran out.
    #[error("{bytes} bytes for \"{what}\" could not be allocated: {reason}.")]
    OutOfMemory {
        /// Name of the buffer.
        what: String,
        /// Size in bytes.
        bytes: u64,
        /// Message of the allocator.
        reason: String,
    },
    /// The memory budget is exceeded.
    #[error("{bytes} bytes for \"{what}\" exceed the memory budget: {used} of {budget} bytes are in use.")]
    OverBudget {
        /// Buffer or image.
        what: String,
        /// Size in bytes.
        bytes: u64,
        /// Bytes in use.
        used: u64,
        /// Budget in bytes.
        budget: u64,
    },
    /// A buffer exceeds the largest storage binding.
    #[error("Buffer \"{what}\" needs {bytes} bytes, but one storage binding covers at most {limit} on this device.")]
    BindingTooLarge {
        /// Name of the buffer.
        what: String,
        /// Size in bytes.
        bytes: u64,
        /// Limit of the device in bytes.
        limit: u64,
    },
    /// A buffer exceeds the largest buffer of the device.
    #[error("Buffer \"{what}\" needs {bytes} bytes, but {device} allows {limit} in one buffer.")]
    BufferTooLarge {
        /// Name of the buffer.
        what: String,
        /// Size in bytes.
        bytes: u64,
        /// Limit of the device in bytes.
        limit: u64,
        /// Name of the device.
        device: String,
    },
    /// A kernel binds more storage buffers than the device supports.
    #[error("Pass \"{pass}\" binds {count} storage buffers, but {device} allows {limit} in one kernel.")]
    TooManyBuffers {
        /// Name of the pass.
        pass: String,
        /// Number of storage buffers.
        count: u32,
        /// Limit of the device.
        limit: u32,
        /// Name of the device.
        device: String,
    },
    /// The device does not support the image size.
    #[error("Image \"{what}\" would be {} x {} texels, but a side has 1 to {limit} on this device.", size[0], size[1])]
    ImageSize {
        /// Name of the image.
        what: String,
        /// Width and height.
        size: [u32; 2],
        /// Limit of the device in texels.
        limit: u32,
    },
    /// The number of bytes differs from the image's.
    #[error("Image \"{image}\" receives {provided} bytes, but its texels take {expected}.")]
    ImageBytes {
        /// Name of the image.
        image: String,
        /// Provided bytes.
        provided: u64,
        /// Bytes of the packed image.
        expected: u64,
    },
    /// A kernel binds an image whose format does not support storage.
    #[error("Image \"{image}\" of format {format} cannot be read or written by kernels on this device.")]
    NotStorageImage {
        /// Name of the image.
        image: String,
        /// Format of the image.
        format: crate::ImageFormat,
    },
    /// The bound image differs from the plan's declaration.
    #[error("Image \"{image}\" is declared as {declared}, but {bound} is bound.")]
    WrongImage {
        /// Name of the image in the plan.
        image: String,
        /// Size and format of the bound image.
        bound: String,
        /// Declared size and format.
        declared: String,
    },
    /// The device was lost.
    #[error("The device was lost in {0}.")]
    DeviceLost(String),
    /// A wait reached its time limit.
    #[error("Work submitted as \"{what}\" did not finish within {} s{}.", limit.as_secs_f64(), unfinished(pass))]
    Timeout {
        /// Name of the awaited work.
        what: String,
        /// Time limit.
        limit: std::time::Duration,
        /// First unfinished pass, if timestamps are available.
        pass: Option<String>,
    },
    /// A plan's external buffer has no memory bound to it.
    #[error("Buffer \"{buffer}\" of plan \"{plan}\" is not bound to any memory.")]
    Unbound {
        /// Name of the buffer.
        buffer: String,
        /// Name of the plan.
        plan: String,
    },
    /// A range exceeds a buffer.
    #[error("Bytes {offset}..{end} lie outside buffer \"{buffer}\" of {bytes} bytes.")]
    OutOfRange {
        /// Name of the buffer.
        buffer: String,
        /// First byte.
        offset: u64,
        /// Byte after the last.
        end: u64,
        /// Size of the buffer in bytes.
        bytes: u64,
    },
    /// The host cannot read or write the buffer.
    #[error("Buffer \"{0}\" is not visible to the host.")]
    NotHostVisible(String),
    /// A window cannot be presented to.
    #[error("The window cannot be presented to: {0}.")]
    Window(String),
    /// The description of a host's device is invalid.
    #[error("The host's device cannot be used: {0}.")]
    Host(String),
    /// A submission is requested on a host's device without a queue.
    #[error("\"{0}\" cannot be submitted: the host provided no queue.")]
    NoQueue(String),
    /// Every host recording slot is in use.
    #[error("Plan \"{plan}\" cannot be recorded: all {slots} recordings are in use; report one as done first.")]
    SlotsInUse {
        /// Name of the plan.
        plan: String,
        /// Number of slots.
        slots: usize,
    },
    /// A required extension is missing or was not enabled by the host.
    #[error("{what} needs {extension}, which is not enabled on device \"{device}\".")]
    MissingExtension {
        /// Operation that needs it.
        what: String,
        /// Name of the extension.
        extension: &'static str,
        /// Name of the device.
        device: String,
    },
    /// Memory is exported that was not created for sharing.
    #[error("\"{0}\" was not made to be shared, so its memory cannot be exported.")]
    NotShared(String),
    /// The graph is invalid.
    #[error(transparent)]
    Graph(#[from] crate::graph::GraphError),
}

fn unfinished(pass: &Option<String>) -> String {
    pass.as_ref().map_or_else(String::new, |p| format!("; pass \"{p}\" has not ended"))
}

impl Error {
    /// Returns whether device memory, host memory or the budget was exhausted.
    pub fn is_out_of_memory(&self) -> bool {
        match self {
            Error::OutOfMemory { .. } | Error::OverBudget { .. } => true,
            Error::Vulkan { result, .. } => {
                matches!(*result, vk::Result::ERROR_OUT_OF_DEVICE_MEMORY | vk::Result::ERROR_OUT_OF_HOST_MEMORY)
            }
            _ => false,
        }
    }
}

/// Result with [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

/// Converts a Vulkan result into an error that names the call and its object.
pub(crate) trait Check<T> {
    fn check(self, call: &'static str, what: &str) -> Result<T>;
}

impl<T> Check<T> for std::result::Result<T, vk::Result> {
    fn check(self, call: &'static str, what: &str) -> Result<T> {
        self.map_err(|result| match result {
            vk::Result::ERROR_DEVICE_LOST => Error::DeviceLost(format!("{call} for \"{what}\"")),
            _ => Error::Vulkan { call, what: what.to_owned(), result },
        })
    }
}
