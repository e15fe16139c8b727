//! Translation of a module to [`Code`]: inlines functions and splits values into scalars.

mod flow;
mod memory;
mod tiles;
mod values;

use crate::code::{Block, BuiltIn, Code, Edge, End, Slot, Space, Step};
use crate::fault::Fault;
use crate::module::{Module, Type};
use crate::scalar::{Bin, Un};
use spirv::{Decoration, Op, StorageClass};
use std::collections::HashMap;
use std::rc::Rc;

/// Pointer: its memory, the type that it points to, and the word.
#[derive(Clone, Copy)]
struct Pointer {
    space: Space,
    ty: u32,
    /// Constant part of the offset, in words or bytes.
    fixed: u32,
    /// Register with the rest, or [`crate::code::NONE`].
    at: Slot,
    /// Stride of the columns of matrices in memory with a layout.
    columns: u32,
}

/// Value of an id.
#[derive(Clone)]
enum Value {
    /// Registers of the scalars.
    Registers(Rc<[Slot]>),
    Pointer(Pointer),
    /// Image by its place in [`Code::bindings`].
    Image(u32),
}

/// Ids of one inlined function.
#[derive(Default)]
struct Scope {
    values: HashMap<u32, Value>,
    /// Labels of blocks.
    labels: HashMap<u32, u32>,
    /// Registers of phis, which edges write.
    phis: HashMap<u32, Rc<[Slot]>>,
    /// Place to return to and the registers of the result. None at the entry.
    back: Option<(u32, Rc<[Slot]>)>,
    /// Label of the current block.
    block: u32,
}

/// Translation in progress.
struct Lower<'m, 'w> {
    module: &'m Module<'w>,
    code: Code,
    globals: HashMap<u32, Value>,
    constants: HashMap<u32, Slot>,
    /// Steps of the open block, if one is open.
    open: Option<Vec<Step>>,
    /// Block index of each label.
    labels: Vec<u32>,
}

/// Translates a module.
pub(crate) fn lower(module: &Module<'_>) -> Result<Code, Fault> {
    let mut lower = Lower {
        module,
        code: Code { local_size: module.local_size, ..Code::default() },
        globals: HashMap::new(),
        constants: HashMap::new(),
        open: Some(Vec::new()),
        labels: Vec::new(),
    };
    for (id, ty, class) in &module.globals {
        lower.global(*id, *ty, *class)?;
    }
    lower.inline(module.entry, Vec::new(), true)?;
    if lower.open.is_some() {
        lower.close(End::Exit);
    }
    let labels = lower.labels;
    let mut code = lower.code;
    for block in &mut code.blocks {
        for edge in block.end.edges() {
            edge.target = labels[edge.target as usize];
        }
    }
    code.mask();
    Ok(code)
}

impl End {
    fn edges(&mut self) -> Vec<&mut Edge> {
        match self {
            End::Jump(e) => vec![e],
            End::Branch(_, yes, no) => vec![yes, no],
            End::Switch(_, cases, other) => cases.iter_mut().map(|(_, e)| e).chain([other]).collect(),
            End::Exit | End::Unreachable => Vec::new(),
        }
    }
}

impl<'w> Lower<'_, 'w> {
    fn slots(&mut self, count: u32) -> Rc<[Slot]> {
        let first = self.code.slots;
        self.code.slots += count;
        (first..first + count).collect()
    }

    /// Returns registers that keep their value between blocks.
    fn variable(&mut self, count: u32) -> Rc<[Slot]> {
        let slots = self.slots(count);
        if let Some(first) = slots.first() {
            self.code.variables.push((*first, count));
        }
        slots
    }

    fn constant(&mut self, bits: u32) -> Slot {
        if let Some(slot) = self.constants.get(&bits) {
            return *slot;
        }
        let slot = self.slots(1)[0];
        self.constants.insert(bits, slot);
        self.code.constants.push((slot, bits));
        slot
    }

    fn step(&mut self, step: Step) {
        // Code after a return belongs to no block.
        if let Some(steps) = &mut self.open {
            steps.push(step);
        }
    }

    fn un(&mut self, op: Un, a: Slot) -> Slot {
        let d = self.slots(1)[0];
        self.step(Step::Un(op, d, a));
        d
    }

    fn bin(&mut self, op: Bin, a: Slot, b: Slot) -> Slot {
        let d = self.slots(1)[0];
        self.step(Step::Bin(op, d, a, b));
        d
    }

    fn label(&mut self) -> u32 {
        self.labels.push(u32::MAX);
        self.labels.len() as u32 - 1
    }

    /// Ends the open block.
    fn close(&mut self, end: End) {
        if let Some(steps) = self.open.take() {
            self.code.blocks.push(Block { steps, end });
        }
    }

    /// Begins the block of a label.
    fn begin(&mut self, label: u32) {
        self.close(End::Jump(Edge { target: label, copies: Vec::new() }));
        self.labels[label as usize] = self.code.blocks.len() as u32;
        self.open = Some(Vec::new());
    }

    fn value(&mut self, scope: &Scope, id: u32) -> Result<Rc<[Slot]>, Fault> {
        if let Some(Value::Registers(slots)) = scope.values.get(&id) {
            return Ok(slots.clone());
        }
        let module = self.module;
        Ok(module.bits(id)?.iter().map(|bits| self.constant(*bits)).collect())
    }

    fn one(&mut self, scope: &Scope, id: u32) -> Result<Slot, Fault> {
        self.value(scope, id)?.first().copied().ok_or(Fault::Damaged("a value is empty"))
    }

    fn pointer(&self, scope: &Scope, id: u32) -> Result<Pointer, Fault> {
        match scope.values.get(&id).or_else(|| self.globals.get(&id)) {
            Some(Value::Pointer(pointer)) => Ok(*pointer),
            _ => Err(Fault::missing("pointers in memory".to_owned())),
        }
    }

    /// Returns the binding of an image.
    fn image(&self, scope: &Scope, id: u32) -> Option<u32> {
        match scope.values.get(&id).or_else(|| self.globals.get(&id)) {
            Some(Value::Image(binding)) => Some(*binding),
            _ => None,
        }
    }

    /// Returns the type that a pointer type points to.
    fn pointee(&self, ty: u32) -> Result<u32, Fault> {
        match self.module.ty(ty)? {
            Type::Pointer(inner) => Ok(*inner),
            _ => Err(Fault::Damaged("a pointer has another type")),
        }
    }

    /// Declares a global variable.
    fn global(&mut self, id: u32, ty: u32, class: u32) -> Result<(), Fault> {
        let ty = self.pointee(ty)?;
        let name = self.module.names.get(&id).cloned().unwrap_or_default();
        let storage = [StorageClass::StorageBuffer as u32, StorageClass::Uniform as u32];
        let image = matches!(self.module.ty(ty)?, Type::Opaque(Op::TypeImage));
        let (space, fixed) = if image || storage.contains(&class) {
            let binding = self.module.decoration(id, Decoration::Binding);
            self.code.bindings.push(binding.ok_or(Fault::Damaged("a buffer has no binding"))?);
            let block = self.module.names.get(&ty).cloned().unwrap_or_default();
            let name = if name.is_empty() { block.trim_end_matches("_block").to_owned() } else { name };
            self.code.binding_names.push(name);
            if image {
                self.globals.insert(id, Value::Image(self.code.bindings.len() as u32 - 1));
                return Ok(());
            }
            (Space::Buffer(self.code.bindings.len() as u32 - 1), 0)
        } else if class == StorageClass::PushConstant as u32 {
            (Space::Push, 0)
        } else if class == StorageClass::Workgroup as u32 {
            let (first, words) = (self.code.shared_words(), self.module.flat(ty)?);
            self.code.shared.push((first, words, name));
            (Space::Shared, first)
        } else if class == StorageClass::Private as u32 {
            let count = self.module.flat(ty)?;
            let slots = self.variable(count);
            (Space::Registers(slots[0], count), 0)
        } else if class == StorageClass::Input as u32 {
            let built_in =
                self.module.decoration(id, Decoration::BuiltIn).ok_or(Fault::Damaged("an input is no built-in"))?;
            let built_in = match built_in {
                24 => BuiltIn::NumWorkgroups,
                25 => BuiltIn::WorkgroupSize,
                26 => BuiltIn::WorkgroupId,
                27 => BuiltIn::LocalId,
                28 => BuiltIn::GlobalId,
                29 => BuiltIn::LocalIndex,
                36 => BuiltIn::SubgroupSize,
                38 => BuiltIn::NumSubgroups,
                40 => BuiltIn::SubgroupId,
                41 => BuiltIn::Lane,
                other => return Err(Fault::missing(format!("built-in {other}"))),
            };
            let count = self.module.flat(ty)?;
            let slots = self.slots(count);
            self.code.inputs.push((built_in, slots[0]));
            (Space::Registers(slots[0], count), 0)
        } else {
            return Err(Fault::missing(format!("variables of storage class {class}")));
        };
        self.globals.insert(id, Value::Pointer(Pointer { space, ty, fixed, at: crate::code::NONE, columns: 0 }));
        Ok(())
    }
}
