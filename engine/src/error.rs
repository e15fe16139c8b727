//! What can go wrong below the graph: each error names the call or the thing, and the figures.

use ash::vk;

/// Errors of the engine.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The Vulkan loader is missing.
    #[error("The Vulkan loader could not be opened ({0}); install it (libvulkan1 on Debian) together with a driver.")]
    Loader(String),
    /// No device matches.
    #[error("No Vulkan device matches \"{wanted}\"; found: {found}.")]
    NoDevice {
        /// What was asked for.
        wanted: String,
        /// Names of those there are.
        found: String,
    },
    /// A device lacks required features.
    #[error("Device \"{device}\" lacks {}.", missing.join(", "))]
    MissingFeatures {
        /// Its name.
        device: String,
        /// What is missing, by name.
        missing: Vec<String>,
    },
    /// A pass requests a subgroup size that the device does not run.
    #[error("Kernel \"{kernel}\" requests {size} lanes a subgroup, but the device runs {low} to {high}.")]
    SubgroupSize {
        /// The kernel.
        kernel: String,
        /// Lanes that it requests.
        size: u32,
        /// Fewest lanes of the device.
        low: u32,
        /// Most lanes of the device.
        high: u32,
    },
    /// A layer was asked for that is not installed.
    #[error("The validation layer is not installed (vulkan-validationlayers on Debian).")]
    NoValidation,
    /// A Vulkan call failed.
    #[error("{call} failed for \"{what}\": {result}.")]
    Vulkan {
        /// The call.
        call: &'static str,
        /// The object or pass concerned.
        what: String,
        /// Its result.
        result: vk::Result,
    },
    /// Memory ran out.
    #[error("{bytes} bytes for \"{what}\" could not be allocated: {reason}.")]
    OutOfMemory {
        /// The buffer.
        what: String,
        /// Its size.
        bytes: u64,
        /// The allocator's words.
        reason: String,
    },
    /// The memory budget does not allow it.
    #[error("{bytes} bytes for \"{what}\" exceed the memory budget: {used} of {budget} bytes are in use.")]
    OverBudget {
        /// The buffer or image.
        what: String,
        /// Its size.
        bytes: u64,
        /// Bytes in use.
        used: u64,
        /// Bytes that may be.
        budget: u64,
    },
    /// A buffer exceeds what one binding may cover.
    #[error("Buffer \"{what}\" needs {bytes} bytes, but one storage binding covers at most {limit} on this device.")]
    BindingTooLarge {
        /// The buffer.
        what: String,
        /// Its size.
        bytes: u64,
        /// The device's limit.
        limit: u64,
    },
    /// A buffer exceeds what the device allows for one.
    #[error("Buffer \"{what}\" needs {bytes} bytes, but {device} allows {limit} in one buffer.")]
    BufferTooLarge {
        /// The buffer.
        what: String,
        /// Its size.
        bytes: u64,
        /// The device's limit.
        limit: u64,
        /// The device.
        device: String,
    },
    /// A kernel binds more storage buffers than the device allows.
    #[error("Pass \"{pass}\" binds {count} storage buffers, but {device} allows {limit} in one kernel.")]
    TooManyBuffers {
        /// The pass.
        pass: String,
        /// How many it binds.
        count: u32,
        /// The device's limit.
        limit: u32,
        /// The device.
        device: String,
    },
    /// An image of a size that the device does not have.
    #[error("Image \"{what}\" would be {} x {} texels, but a side has 1 to {limit} on this device.", size[0], size[1])]
    ImageSize {
        /// The image.
        what: String,
        /// Width and height.
        size: [u32; 2],
        /// The device's limit.
        limit: u32,
    },
    /// Texels that do not fill an image.
    #[error("Image \"{image}\" is given {given} bytes, but its texels take {expected}.")]
    ImageBytes {
        /// The image.
        image: String,
        /// Bytes given.
        given: u64,
        /// Bytes of the packed image.
        expected: u64,
    },
    /// An image bound as a storage image that cannot be one.
    #[error("Image \"{image}\" of format {format} cannot be read or written by kernels on this device.")]
    NotStorageImage {
        /// The image.
        image: String,
        /// Its format.
        format: crate::ImageFormat,
    },
    /// An image that is not what the plan declares.
    #[error("Image \"{image}\" is declared as {declared}, but {given} is bound.")]
    WrongImage {
        /// The image of the plan.
        image: String,
        /// What was given.
        given: String,
        /// Size and format as declared.
        declared: String,
    },
    /// The device is gone.
    #[error("The device was lost in {0}.")]
    DeviceLost(String),
    /// The GPU did not answer in time.
    #[error("Work submitted as \"{what}\" did not finish within {} s{}.", limit.as_secs_f64(), unfinished(pass))]
    Timeout {
        /// What was waited for.
        what: String,
        /// How long.
        limit: std::time::Duration,
        /// The first pass that has not ended, where timestamps tell.
        pass: Option<String>,
    },
    /// A plan's external buffer has no memory bound to it.
    #[error("Buffer \"{buffer}\" of plan \"{plan}\" is not bound to any memory.")]
    Unbound {
        /// The buffer.
        buffer: String,
        /// The plan.
        plan: String,
    },
    /// A range lies outside a buffer.
    #[error("Bytes {offset}..{end} lie outside buffer \"{buffer}\" of {bytes} bytes.")]
    OutOfRange {
        /// The buffer.
        buffer: String,
        /// First byte.
        offset: u64,
        /// One past the last.
        end: u64,
        /// The buffer's size.
        bytes: u64,
    },
    /// The buffer cannot be read or written by the host.
    #[error("Buffer \"{0}\" is not visible to the host.")]
    NotHostVisible(String),
    /// A window cannot be shown in.
    #[error("Nothing can be shown in this window: {0}.")]
    Window(String),
    /// What a host says of its device cannot be.
    #[error("The host's device cannot be used: {0}.")]
    Host(String),
    /// Something was to be submitted on a device whose host does all the submitting.
    #[error("\"{0}\" must be submitted, but the host gave no queue.")]
    NoQueue(String),
    /// Every slot that the host may record from is still in use.
    #[error("Plan \"{plan}\" is recorded {slots} times and none is released, so it cannot be recorded again yet.")]
    SlotsHeld {
        /// The plan.
        plan: String,
        /// How many slots there are.
        slots: usize,
    },
    /// An extension is needed that the device lacks, or that the host did not enable.
    #[error("{what} needs {extension}, which is not enabled on device \"{device}\".")]
    MissingExtension {
        /// What for.
        what: String,
        /// The extension.
        extension: &'static str,
        /// The device.
        device: String,
    },
    /// Memory that was not made to be shared cannot be exported.
    #[error("\"{0}\" was not made to be shared, so its memory cannot be exported.")]
    NotShared(String),
    /// The graph is wrong.
    #[error(transparent)]
    Graph(#[from] crate::graph::GraphError),
}

fn unfinished(pass: &Option<String>) -> String {
    pass.as_ref().map_or_else(String::new, |p| format!("; pass \"{p}\" has not ended"))
}

impl Error {
    /// Whether memory, of the device, of the host or of the budget, did not suffice.
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

/// Result with the engine's error.
pub type Result<T> = std::result::Result<T, Error>;

/// Names the failed call and what it was for.
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
