//! Hash key of a declaration: equal declarations have equal keys in every process and on every machine.
//!
//! All structs are destructured without `..`, so that a new field does not compile until the key includes it.

use std::collections::HashMap;
use std::sync::Arc;

use super::CompileOptions;
use crate::graph::pass::{Dispatch, Pass, PassKind, Use};
use crate::graph::resource::{BufferInfo, BufferKind, ImageInfo, Slice};
use crate::shader::{Access, Binding, BindingKind, Shader, SpecConstant};

/// Returns the key of a graph with its compile options.
pub(in crate::graph) fn key(name: &str, buffers: &[BufferInfo], passes: &[Pass], options: &CompileOptions) -> u64 {
    // Verification does not change the plan.
    let CompileOptions { alignment, alias, reorder, verify: _ } = *options;
    let mut hash = Hash::default();
    hash.text(name);
    hash.word(alignment);
    hash.word(u64::from(alias) | u64::from(reorder) << 1);
    hash.word(buffers.len() as u64);
    for BufferInfo { name, bytes, kind, keep, entry, exit, image } in buffers {
        hash.text(name);
        hash.word(*bytes);
        hash.word(match kind {
            BufferKind::External => 0,
            BufferKind::Transient => 1,
            BufferKind::Uniform => 2,
        });
        hash.word(u64::from(*keep));
        hash.word(*entry as u64 | (*exit as u64) << 8);
        match image {
            None => hash.word(0),
            Some(ImageInfo { size: [width, height], format, entry, exit }) => {
                hash.word(1 | (*format as u64) << 8 | (*entry as u64) << 16 | (*exit as u64) << 24);
                hash.word(u64::from(*width) << 32 | u64::from(*height));
            }
        }
    }
    let mut shaders = HashMap::new();
    hash.word(passes.len() as u64);
    for pass in passes {
        hash.pass(pass, &mut shaders);
    }
    hash.state
}

/// Non-cryptographic 64-bit hash.
struct Hash {
    state: u64,
}

impl Default for Hash {
    fn default() -> Self {
        Hash { state: 0x5347_5320_706c_616e }
    }
}

impl Hash {
    fn word(&mut self, word: u64) {
        let mixed = (self.state ^ word).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        self.state = (mixed ^ (mixed >> 32)).wrapping_mul(0xd6e8_feb8_6659_fd93).rotate_left(23);
    }

    fn bytes(&mut self, bytes: &[u8]) {
        self.word(bytes.len() as u64);
        for chunk in bytes.chunks(8) {
            let mut word = [0; 8];
            word[..chunk.len()].copy_from_slice(chunk);
            self.word(u64::from_le_bytes(word));
        }
    }

    fn text(&mut self, text: &str) {
        self.bytes(text.as_bytes());
    }

    fn slice(&mut self, slice: &Slice) {
        let Slice { buffer, offset, bytes } = slice;
        self.word(buffer.index() as u64);
        self.word(*offset);
        self.word(*bytes);
    }

    fn access(&mut self, access: Access) {
        self.word(match access {
            Access::Read => 0,
            Access::Write => 1,
            Access::ReadWrite => 2,
            Access::Accumulate => 3,
        });
    }

    /// Hashes a pass. `shaders` caches the hash of each kernel by address, because many passes share one.
    fn pass(&mut self, pass: &Pass, shaders: &mut HashMap<*const Shader, u64>) {
        let Pass { name, kind, accesses, discards } = pass;
        self.text(name);
        match kind {
            PassKind::Compute { shader, specs, push, bindings, subgroup_size, dispatch } => {
                self.word(0);
                self.word(*shaders.entry(Arc::as_ptr(shader)).or_insert_with(|| shader_key(shader)));
                self.word(specs.len() as u64);
                for &(id, bits) in specs {
                    self.word(u64::from(id) << 32 | u64::from(bits));
                }
                self.bytes(push);
                self.word(bindings.len() as u64);
                for (number, slice) in bindings {
                    self.word(u64::from(*number));
                    self.slice(slice);
                }
                self.word(subgroup_size.map_or(0, u64::from));
                match dispatch {
                    Dispatch::Groups(groups) => groups.iter().for_each(|&count| self.word(u64::from(count))),
                    Dispatch::Indirect { buffer, offset } => {
                        self.word(u64::MAX);
                        self.word(buffer.index() as u64);
                        self.word(*offset);
                    }
                }
            }
            PassKind::Fill { target, value } => {
                self.word(1);
                self.slice(target);
                self.word(u64::from(*value));
            }
            PassKind::Copy { source, target } => {
                self.word(2);
                self.slice(source);
                self.slice(target);
            }
            PassKind::CopyToImage { source, target } => {
                self.word(3);
                self.slice(source);
                self.word(target.index() as u64);
            }
            PassKind::CopyFromImage { source, target } => {
                self.word(4);
                self.word(source.index() as u64);
                self.slice(target);
            }
            PassKind::ClearImage { target, value } => {
                self.word(5);
                self.word(target.index() as u64);
                value.iter().for_each(|&bits| self.word(u64::from(bits)));
            }
        }
        self.word(accesses.len() as u64);
        for (slice, access, used) in accesses {
            self.slice(slice);
            self.access(*access);
            self.word(match used {
                Use::Compute => 0,
                Use::Indirect => 1,
                Use::Transfer => 2,
                Use::Uniform => 3,
            });
        }
        self.word(discards.len() as u64);
        discards.iter().for_each(|slice| self.slice(slice));
    }
}

fn shader_key(shader: &Shader) -> u64 {
    let Shader { name, spirv, bindings, push_bytes, specs } = shader;
    let mut hash = Hash::default();
    hash.text(name);
    hash.word(spirv.len() as u64);
    for pair in spirv.chunks(2) {
        hash.word(u64::from(pair[0]) << 32 | u64::from(pair.get(1).copied().unwrap_or(0)));
    }
    hash.word(bindings.len() as u64);
    for Binding { name, number, kind, access } in bindings {
        hash.text(name);
        hash.word(u64::from(*number));
        hash.word(match kind {
            BindingKind::Storage => 0,
            BindingKind::Uniform => 1,
            BindingKind::Image(format) => 2 | (*format as u64) << 8,
        });
        hash.access(*access);
    }
    hash.word(u64::from(*push_bytes));
    hash.word(specs.len() as u64);
    for SpecConstant { name, id, default } in specs {
        hash.text(name);
        hash.word(u64::from(*id) << 32 | u64::from(*default));
    }
    hash.state
}
