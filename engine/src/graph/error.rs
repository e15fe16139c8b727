//! Errors of graph declarations. Each message names the pass, the resource and the conflicting values.

use super::plan::verify::VerifyError;
use crate::format::ImageFormat;
use crate::shader::Access;

/// Error of a graph declaration.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // The fields are what the messages say of them.
pub enum GraphError {
    /// A buffer of another graph is used.
    #[error("Pass [{pass}] uses buffer number {index}, but its graph has {count} buffers.")]
    UnknownBuffer { pass: String, index: u32, count: usize },
    /// A shared state is set on a buffer that is not external.
    #[error("Buffer [{buffer}] cannot be shared with the queue: it is not an external buffer.")]
    NotShared { buffer: String },
    /// An image has no texels, or a side exceeds the limit.
    #[error("Image [{image}] is declared with {width} x {height} texels, but a side has 1 to 65536.")]
    ImageSize { image: String, width: u32, height: u32 },
    /// The exit state of an external image is undefined.
    #[error("Image [{image}] has exit state Undefined; an external image needs a defined exit state.")]
    ExitUndefined { image: String },
    /// An image is used as a buffer.
    #[error("Pass [{pass}] uses image [{image}] as a buffer.")]
    ImageAsBuffer { pass: String, image: String },
    /// A buffer is used as an image.
    #[error("Pass [{pass}] uses buffer [{buffer}] as an image.")]
    BufferAsImage { pass: String, buffer: String },
    /// An image is bound to a buffer binding, or the reverse.
    #[error("Pass [{pass}] binds [{resource}] as [{binding}], which the kernel declares as {declared}.")]
    BindingKind { pass: String, resource: String, binding: String, declared: &'static str },
    /// The format of an image differs from the kernel's.
    #[error(
        "Pass [{pass}] binds image [{image}] of format {format} as [{binding}], which the kernel declares {declared}."
    )]
    ImageFormat { pass: String, image: String, binding: String, format: ImageFormat, declared: ImageFormat },
    /// A copy between a buffer and an image differs in size.
    #[error("Pass [{pass}] copies {bytes} bytes of buffer [{buffer}] to or from image [{image}] of {texels} bytes.")]
    ImageCopySize { pass: String, buffer: String, bytes: u64, image: String, texels: u64 },
    /// A copy of texels starts at a misaligned offset.
    #[error(
        "Pass [{pass}] copies texels of {texel} bytes to or from buffer [{buffer}] at offset {offset}, not a \
         multiple of that."
    )]
    TexelAlignment { pass: String, buffer: String, offset: u64, texel: u64 },
    /// A buffer has no bytes.
    #[error("Buffer [{buffer}] is declared with 0 bytes, but a buffer needs at least 1.")]
    EmptyBuffer { buffer: String },
    /// A read-only buffer is kept.
    #[error("Buffer [{buffer}] cannot be kept: it is {kind}, which no pass can write.")]
    KeepReadOnly { buffer: String, kind: &'static str },
    /// A slice has no bytes.
    #[error("Pass [{pass}] uses 0 bytes of buffer [{buffer}] at offset {offset}, but a slice needs at least 1.")]
    EmptySlice { pass: String, buffer: String, offset: u64 },
    /// A slice exceeds its buffer.
    #[error(
        "Pass [{pass}] uses {bytes} bytes of buffer [{buffer}] at offset {offset}, which end after its {size} bytes."
    )]
    SliceRange { pass: String, buffer: String, offset: u64, bytes: u64, size: u64 },
    /// The kernel has no binding of that name.
    #[error("Pass [{pass}] binds [{binding}], but kernel [{shader}] has only the bindings [{known}].")]
    UnknownBinding { pass: String, shader: String, binding: String, known: String },
    /// A binding is unbound.
    #[error("Pass [{pass}] leaves binding [{binding}] of kernel [{shader}] unbound.")]
    Unbound { pass: String, shader: String, binding: String },
    /// A binding is bound twice.
    #[error("Pass [{pass}] binds [{binding}] twice: to buffer [{first}] and to buffer [{second}].")]
    BoundTwice { pass: String, binding: String, first: String, second: String },
    /// The kernel has no specialization constant of that name.
    #[error("Pass [{pass}] specializes [{spec}], but kernel [{shader}] has only the constants [{known}].")]
    UnknownSpec { pass: String, shader: String, spec: String, known: String },
    /// A specialization constant is set twice.
    #[error("Pass [{pass}] specializes [{spec}] twice: with {first:#x} and with {second:#x}.")]
    SpecTwice { pass: String, spec: String, first: u32, second: u32 },
    /// The size of the push constants is wrong.
    #[error("Pass [{pass}] pushes {provided} bytes of constants, but kernel [{shader}] has {expected}.")]
    PushSize { pass: String, shader: String, provided: usize, expected: u32 },
    /// The subgroup size is invalid.
    #[error("Pass [{pass}] requires subgroups of {size}, which is not a power of two between 1 and 128.")]
    SubgroupSize { pass: String, size: u32 },
    /// The requested subgroup size differs from the specialized one, or is missing.
    #[error(
        "Pass [{pass}] specializes kernel [{shader}] for subgroups of {constant}, but requests {}.",
        requested.map_or_else(|| "no subgroup size".to_owned(), |size| format!("subgroups of {size}"))
    )]
    SubgroupConstant { pass: String, shader: String, constant: u32, requested: Option<u32> },
    /// One pass accesses the same bytes twice and writes them.
    #[error(
        "Pass [{pass}] touches the same bytes of buffer [{buffer}] as [{first}] and as [{second}] and writes them."
    )]
    Overlap { pass: String, buffer: String, first: String, second: String },
    /// A pass reads bytes that no earlier pass wrote.
    #[error(
        "Pass [{pass}] reads {bytes} bytes at offset {offset} of transient buffer [{buffer}], which no earlier pass \
         writes."
    )]
    Unwritten { pass: String, buffer: String, offset: u64, bytes: u64 },
    /// The number of groups exceeds the limit.
    #[error("Pass [{pass}] dispatches {count} groups along {axis}, more than the {limit} that every device supports.")]
    GroupCount { pass: String, axis: char, count: u32, limit: u32 },
    /// Indirect arguments are misaligned.
    #[error("Pass [{pass}] reads its group counts at offset {offset} of buffer [{buffer}], not a multiple of 4.")]
    IndirectAlignment { pass: String, buffer: String, offset: u64 },
    /// A pass writes a read-only buffer.
    #[error("Pass [{pass}] writes buffer [{buffer}] through [{through}], but it is {kind}.")]
    WriteToReadOnly { pass: String, buffer: String, through: String, kind: &'static str },
    /// A uniform is used outside a kernel.
    #[error("Pass [{pass}] uses uniform [{buffer}] as {role}, but only kernels can read it.")]
    UniformMisused { pass: String, buffer: String, role: &'static str },
    /// A pass discards contents that its kernel reads.
    #[error(
        "Pass [{pass}] discards the contents of [{binding}], but its kernel's access is {access:?}, which needs them."
    )]
    DiscardOfRead { pass: String, binding: String, access: Access },
    /// A fill is misaligned.
    #[error("Pass [{pass}] fills {bytes} bytes at offset {offset} of buffer [{buffer}]; both must be multiples of 4.")]
    FillAlignment { pass: String, buffer: String, offset: u64, bytes: u64 },
    /// The ranges of a copy differ in length.
    #[error("Pass [{pass}] copies {source_bytes} bytes of buffer [{from}] to {target_bytes} bytes of buffer [{to}].")]
    CopySize { pass: String, from: String, source_bytes: u64, to: String, target_bytes: u64 },
    /// A pass was begun and not finished.
    #[error("Pass [{pass}] was begun in graph [{graph}] but never dispatched without an error.")]
    Unfinished { graph: String, pass: String },
    /// The alignment is not a power of two.
    #[error("Graph [{graph}] is compiled for offsets aligned to {alignment} bytes, which is not a power of two.")]
    BadAlignment { graph: String, alignment: u64 },
    /// A bound slice is misaligned for the device.
    #[error(
        "Pass [{pass}] binds buffer [{buffer}] as [{binding}] at offset {offset}, not a multiple of the device's \
         {alignment}."
    )]
    SliceAlignment { pass: String, buffer: String, binding: String, offset: u64, alignment: u64 },
    /// Several errors, in the order of the calls.
    #[error("{}", .0.iter().map(|e| e.to_string()).collect::<Vec<_>>().join(" "))]
    Several(Vec<GraphError>),
    /// The verifier rejects the compiled plan: a defect of this crate.
    #[error("The plan of graph [{graph}] is wrong: {error}")]
    Verify { graph: String, error: Box<VerifyError> },
}

impl GraphError {
    /// Returns `Ok`, the only error, or all errors.
    pub(crate) fn collect(mut errors: Vec<GraphError>) -> Result<(), GraphError> {
        match errors.len() {
            0 => Ok(()),
            1 => Err(errors.remove(0)),
            _ => Err(GraphError::Several(errors)),
        }
    }
}
