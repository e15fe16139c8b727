//! A kernel as the engine sees it: SPIR-V with the facts reflected from it.
//!
//! Promises that every binding has a name, a number, and what the code behind it really does (load, store, only
//! atomic accumulation). Leaves compilation and reflection to whoever builds the kernels.

use std::borrow::Cow;

use crate::format::ImageFormat;

/// What a kernel does to a binding, read off its code rather than its decorations.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize)]
pub enum Access {
    /// Only loads.
    Read,
    /// Only stores; whatever was there before is lost as far as the graph knows only if the pass says so.
    Write,
    /// Loads and stores, or atomics that do not merely add.
    ReadWrite,
    /// Only atomic additions and subtractions whose results are unused: passes that accumulate commute.
    Accumulate,
}

/// The descriptor type of a binding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize)]
pub enum BindingKind {
    /// A storage buffer.
    Storage,
    /// A uniform buffer.
    Uniform,
    /// A storage image of this format.
    Image(ImageFormat),
}

/// One binding of descriptor set 0.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Binding {
    /// The name of the block's instance, or of the image, in GLSL.
    pub name: Cow<'static, str>,
    /// The binding number.
    pub number: u32,
    /// Storage buffer, uniform buffer or image.
    pub kind: BindingKind,
    /// What the code does to it.
    pub access: Access,
}

/// One specialization constant (32 bits wide).
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct SpecConstant {
    /// Its name in GLSL.
    pub name: Cow<'static, str>,
    /// Its `constant_id`.
    pub id: u32,
    /// The value it has if none is given, as raw bits.
    pub default: u32,
}

/// A compiled kernel with its reflection. Cheap to share behind an `Arc`.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Shader {
    /// The stage's name; also the trace label of its passes.
    pub name: Cow<'static, str>,
    /// The module.
    pub spirv: Cow<'static, [u32]>,
    /// Bindings of set 0, by ascending number.
    pub bindings: Vec<Binding>,
    /// Bytes of push constants (0 if none; at most 128).
    pub push_bytes: u32,
    /// Specialization constants.
    pub specs: Vec<SpecConstant>,
}

impl Shader {
    /// Whether the code uses subgroups: whether it declares a capability of `GroupNonUniform`.
    pub fn uses_subgroups(&self) -> bool {
        const OP_CAPABILITY: u32 = 17;
        const GROUP_NON_UNIFORM: std::ops::RangeInclusive<u32> = 61..=68;
        // Capabilities are the first instructions of a module.
        crate::device::instructions(&self.spirv)
            .map_while(|op| if op[0] & 0xffff == OP_CAPABILITY { op.get(1) } else { None })
            .any(|capability| GROUP_NON_UNIFORM.contains(capability))
    }

    /// The binding of that name.
    pub fn binding(&self, name: &str) -> Option<&Binding> {
        self.bindings.iter().find(|b| b.name == name)
    }
}
