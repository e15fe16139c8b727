//! Compiled kernel: SPIR-V with its reflection.
//!
//! Promises: every binding has a name, a number, and the access that the code performs (load, store, atomic
//! accumulation). Kernel build scripts compile and reflect.

use std::borrow::Cow;

pub use sgs_shader_abi::{Access, Binding, BindingKind, SpecConstant};

/// Compiled kernel with its reflection. Shared cheaply in an `Arc`.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Shader {
    /// Name of the kernel; also the trace label of its passes.
    pub name: Cow<'static, str>,
    /// SPIR-V module.
    pub spirv: Cow<'static, [u32]>,
    /// Bindings of set 0, by ascending number.
    pub bindings: Vec<Binding>,
    /// Size of the push constants in bytes (0 if none; at most 128).
    pub push_bytes: u32,
    /// Specialization constants.
    pub specs: Vec<SpecConstant>,
}

impl Shader {
    /// Returns whether the code uses subgroups: whether it declares a `GroupNonUniform` capability.
    pub fn uses_subgroups(&self) -> bool {
        const OP_CAPABILITY: u32 = 17;
        const GROUP_NON_UNIFORM: std::ops::RangeInclusive<u32> = 61..=68;
        // Capabilities are the first instructions of a module.
        instructions(&self.spirv)
            .map_while(|op| if op[0] & 0xffff == OP_CAPABILITY { op.get(1) } else { None })
            .any(|capability| GROUP_NON_UNIFORM.contains(capability))
    }

    /// Returns the binding of a name.
    pub fn binding(&self, name: &str) -> Option<&Binding> {
        self.bindings.iter().find(|b| b.name == name)
    }
}

/// Iterates over the instructions of a module, leading word included; stops at a damaged one.
pub(crate) fn instructions(spirv: &[u32]) -> impl Iterator<Item = &[u32]> {
    let mut rest = spirv.get(5..).unwrap_or_default();
    std::iter::from_fn(move || {
        let words = (*rest.first()? >> 16) as usize;
        let (op, after) = rest.split_at_checked(words).filter(|_| words > 0)?;
        rest = after;
        Some(op)
    })
}
