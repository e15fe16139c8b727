//! Access of a kernel to each binding, from its loads, stores and atomics.
//!
//! Decorations (`readonly`, `writeonly`) state what a kernel may do, but hazards depend on what the code does.

use sgs_shader_abi::Access;
use std::collections::{BTreeMap, BTreeSet};

#[derive(Default, Clone, Copy)]
struct Seen {
    read: bool,
    write: bool,
    accumulate: bool,
}

mod op {
    pub const TYPE_IMAGE: u32 = 25;
    pub const TYPE_POINTER: u32 = 32;
    pub const FUNCTION_CALL: u32 = 57;
    pub const VARIABLE: u32 = 59;
    pub const IMAGE_TEXEL_POINTER: u32 = 60;
    pub const LOAD: u32 = 61;
    pub const STORE: u32 = 62;
    pub const COPY_MEMORY: u32 = 63;
    pub const ACCESS_CHAIN: u32 = 65;
    pub const IN_BOUNDS_ACCESS_CHAIN: u32 = 66;
    pub const DECORATE: u32 = 71;
    pub const COPY_OBJECT: u32 = 83;
    pub const IMAGE_READ: u32 = 98;
    pub const IMAGE_WRITE: u32 = 99;
    pub const ATOMIC_LOAD: u32 = 227;
    pub const ATOMIC_STORE: u32 = 228;
    pub const ATOMIC_EXCHANGE: u32 = 229;
    pub const ATOMIC_COMPARE_EXCHANGE: u32 = 230;
    pub const ATOMIC_XOR: u32 = 242;
    pub const MATRIX_LOAD: u32 = 4457;
    pub const MATRIX_STORE: u32 = 4458;
    pub const ATOMIC_FADD: u32 = 6035;
    /// Increment, decrement, add, subtract.
    pub const ATOMIC_ADDITIVE: std::ops::RangeInclusive<u32> = 232..=235;
}

const DECORATION_BINDING: u32 = 33;

/// Returns the access to each binding of a module, by binding number.
///
/// Assumes that all bindings are in descriptor set 0.
pub fn accesses(spirv: &[u32]) -> BTreeMap<u32, Access> {
    let instructions = || Instructions { words: spirv.get(5..).unwrap_or(&[]) };
    // Ids that instructions use: all their operand words, except for names and decorations. A literal may equal an id
    // and count as a use. That only makes the result more conservative.
    let mut used = BTreeSet::new();
    let mut binding_of = BTreeMap::new();
    for i in instructions() {
        match i[0] & 0xffff {
            op::DECORATE if i.len() > 3 && i[2] == DECORATION_BINDING => {
                binding_of.insert(i[1], i[3]);
            }
            o if is_atomic(o) => used.extend(i[3..].iter().copied()),
            o if o > 54 && i.len() > 1 => used.extend(i[1..].iter().copied()),
            _ => {}
        }
    }
    // `used` does not contain the definition of an atomic's result (word 2), which was skipped above. In unoptimized
    // code, the result is an operand only of instructions that use it.
    let mut seen: BTreeMap<u32, Seen> = BTreeMap::new();
    let mut root: BTreeMap<u32, u32> = BTreeMap::new();
    // Image types, pointers to these types, and variables of the pointer types.
    let mut images = BTreeSet::new();
    for i in instructions() {
        let opcode = i[0] & 0xffff;
        match opcode {
            op::TYPE_IMAGE => _ = images.insert(i[1]),
            op::TYPE_POINTER if images.contains(&i[3]) => _ = images.insert(i[1]),
            op::VARIABLE => {
                if images.contains(&i[1]) {
                    images.insert(i[2]);
                }
                if let Some(&b) = binding_of.get(&i[2]) {
                    root.insert(i[2], b);
                    seen.entry(b).or_default();
                }
            }
            op::ACCESS_CHAIN | op::IN_BOUNDS_ACCESS_CHAIN | op::COPY_OBJECT => {
                if let Some(&b) = root.get(&i[3]) {
                    root.insert(i[2], b);
                }
            }
            // Loading an image only takes its handle. Later instructions access its texels.
            op::LOAD if images.contains(&i[3]) => {
                if let Some(&b) = root.get(&i[3]) {
                    root.insert(i[2], b);
                }
            }
            op::IMAGE_READ => mark(&root, &mut seen, i[3], |s| s.read = true),
            op::IMAGE_WRITE => mark(&root, &mut seen, i[1], |s| s.write = true),
            op::IMAGE_TEXEL_POINTER => {
                if let Some(&b) = root.get(&i[3]) {
                    root.insert(i[2], b);
                }
            }
            op::LOAD | op::ATOMIC_LOAD | op::MATRIX_LOAD => mark(&root, &mut seen, i[3], |s| s.read = true),
            op::STORE | op::ATOMIC_STORE | op::MATRIX_STORE => mark(&root, &mut seen, i[1], |s| s.write = true),
            op::COPY_MEMORY => {
                mark(&root, &mut seen, i[1], |s| s.write = true);
                mark(&root, &mut seen, i[2], |s| s.read = true);
            }
            op::FUNCTION_CALL => {
                for &argument in &i[4..] {
                    mark(&root, &mut seen, argument, |s| (s.read, s.write) = (true, true));
                }
            }
            o if is_atomic(o) => {
                let adds = op::ATOMIC_ADDITIVE.contains(&o) || o == op::ATOMIC_FADD;
                if adds && !used.contains(&i[2]) {
                    mark(&root, &mut seen, i[3], |s| s.accumulate = true);
                } else {
                    mark(&root, &mut seen, i[3], |s| (s.read, s.write) = (true, true));
                }
            }
            _ => {}
        }
    }
    seen.into_iter().map(|(b, s)| (b, s.access())).collect()
}

impl Seen {
    fn access(self) -> Access {
        match (self.read, self.write, self.accumulate) {
            (_, false, false) => Access::Read,
            (false, true, false) => Access::Write,
            (false, false, true) => Access::Accumulate,
            _ => Access::ReadWrite,
        }
    }
}

fn is_atomic(opcode: u32) -> bool {
    (op::ATOMIC_EXCHANGE..=op::ATOMIC_XOR).contains(&opcode)
        || opcode == op::ATOMIC_COMPARE_EXCHANGE
        || opcode == op::ATOMIC_FADD
}

fn mark(root: &BTreeMap<u32, u32>, seen: &mut BTreeMap<u32, Seen>, pointer: u32, f: impl Fn(&mut Seen)) {
    if let Some(b) = root.get(&pointer) {
        f(seen.entry(*b).or_default());
    }
}

struct Instructions<'a> {
    words: &'a [u32],
}

impl<'a> Iterator for Instructions<'a> {
    type Item = &'a [u32];

    fn next(&mut self) -> Option<&'a [u32]> {
        let length = (*self.words.first()? >> 16) as usize;
        if length == 0 || length > self.words.len() {
            return None;
        }
        let (head, tail) = self.words.split_at(length);
        self.words = tail;
        Some(head)
    }
}
