//! Errors of kernels: what the emulator cannot run, and what the standard leaves undefined.

/// Reason why a kernel did not finish.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Fault {
    /// The emulator lacks an instruction or a type.
    #[error("the emulator lacks {0}")]
    Missing(String),
    /// The module is no valid SPIR-V.
    #[error("the module is damaged: {0}")]
    Damaged(&'static str),
    /// Two invocations access a word without an order, and one of them writes.
    #[error(
        "race: invocations {first} and {second} access word {word} of {memory}, one writes, and no barrier orders them"
    )]
    Race {
        /// Buffer or shared variable.
        memory: String,
        /// Index of the 32-bit word.
        word: u32,
        /// Invocation that came first, counted over the dispatch; none if there are several.
        first: Invocation,
        /// Invocation that came later.
        second: Invocation,
    },
    /// An invocation reads shared memory that none has written.
    #[error("invocation {invocation} reads word {word} of {memory}, which its workgroup has not written")]
    Uninitialized {
        /// Shared variable.
        memory: String,
        /// Index of the 32-bit word.
        word: u32,
        /// Invocation, counted over the dispatch.
        invocation: Invocation,
    },
    /// An access lies outside a buffer.
    #[error("access outside {memory}: bytes {offset} to {offset} + 4 of {bytes}")]
    OutOfBounds {
        /// Buffer.
        memory: String,
        /// Byte offset from the beginning of the binding.
        offset: u32,
        /// Size of the binding.
        bytes: u64,
    },
    /// A texel lies outside an image.
    #[error("texel {at:?} of {memory}, which has {size:?}")]
    Texel {
        /// Image.
        memory: String,
        /// Coordinates.
        at: [u32; 2],
        /// Width and height.
        size: [u32; 2],
    },
    /// An index lies outside an array.
    #[error("index {index} of an array of {length}")]
    Index {
        /// Index.
        index: u32,
        /// Number of elements.
        length: u32,
    },
    /// Not all invocations of a workgroup or subgroup reach a barrier.
    #[error("divergent barrier: {0}")]
    Barrier(String),
    /// A shuffle reads an inactive lane, or a broadcast also several lanes.
    #[error("{operation} of lane {lane} reads lane {from}, which is {why}")]
    Shuffle {
        /// Name of the operation.
        operation: &'static str,
        /// Lane that reads.
        lane: u32,
        /// Lane that is read.
        from: u32,
        /// What is wrong with the lane.
        why: &'static str,
    },
    /// An integer division by zero, or a shift by 32 bits or more.
    #[error("{0} is undefined for its operands")]
    Arithmetic(String),
    /// A float lies outside the range of the integer that it becomes.
    #[error("the conversion of {0} to an integer is undefined")]
    Conversion(String),
    /// A kernel reaches a place that it declares unreachable.
    #[error("the kernel reaches an unreachable place")]
    Unreachable,
    /// A kernel runs for too long.
    #[error("the kernel does not end")]
    Endless,
    /// A fault with the kernel or pass in which it happened.
    #[error("{0}: {1}")]
    In(String, Box<Fault>),
}

/// Invocation by its number in the dispatch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Invocation(pub u32);

impl std::fmt::Display for Invocation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        if self.0 == u32::MAX { f.write_str("(several)") } else { write!(f, "{}", self.0) }
    }
}

impl Fault {
    pub(crate) fn missing(what: String) -> Fault {
        Fault::Missing(what)
    }

    /// Adds the place of the fault.
    pub(crate) fn within(self, place: &str) -> Fault {
        Fault::In(place.to_owned(), Box::new(self))
    }

    /// Returns the fault without its places.
    pub fn cause(&self) -> &Fault {
        match self {
            Fault::In(_, inner) => inner.cause(),
            other => other,
        }
    }
}
