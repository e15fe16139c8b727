//! Kernels made for tests (`tests/kernels`).
//!
//! They use only integers, so that results compare exactly.

use sgs_engine::shader::{Access, Binding, BindingKind, Shader};
use std::borrow::Cow;
use std::sync::Arc;

/// Kernel in the table of the build script.
struct Entry {
    name: &'static str,
    push_bytes: u32,
    bindings: &'static [(&'static str, u32, BindingKind, Access)],
    spirv: &'static [u32],
}

static TABLE: &[Entry] = include!(concat!(env!("OUT_DIR"), "/test_kernels.rs"));

/// Returns the kernel with this name; fails if there is none.
#[track_caller]
pub fn kernel(name: &str) -> Arc<Shader> {
    let Some(entry) = TABLE.iter().find(|entry| entry.name == name) else { panic!("no test kernel is called {name}") };
    Arc::new(Shader {
        name: Cow::Borrowed(entry.name),
        spirv: Cow::Borrowed(entry.spirv),
        bindings: entry
            .bindings
            .iter()
            .map(|&(name, number, kind, access)| Binding { name: Cow::Borrowed(name), number, kind, access })
            .collect(),
        push_bytes: entry.push_bytes,
        specs: Vec::new(),
    })
}

/// Computes on the CPU what `mixed` of `words.glsl` computes.
pub fn mixed(a: u32, b: u32) -> u32 {
    let mut x = a ^ b.wrapping_mul(0x9e37_79b9);
    x ^= x >> 15;
    x = x.wrapping_mul(0x85eb_ca6b);
    x ^ (x >> 13)
}
