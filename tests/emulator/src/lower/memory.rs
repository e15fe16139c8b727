//! Access chains, loads, stores and atomics.

use super::{Lower, Pointer, Scope, Value};
use crate::code::{Atomic, NONE, Place, Slot, Space, Step};
use crate::fault::Fault;
use crate::module::{Inst, Type};
use crate::scalar::{Bin, Un};
use spirv::Op;
use std::rc::Rc;

impl Lower<'_, '_> {
    /// Translates an access chain.
    pub(super) fn chain(&mut self, scope: &mut Scope, args: &[u32]) -> Result<(), Fault> {
        let mut pointer = self.pointer(scope, args[2])?;
        let bytes = matches!(pointer.space, Space::Buffer(_) | Space::Push);
        for &index in &args[3..] {
            let literal = self.module.constants.get(&index).map(|bits| bits[0]);
            let (element, length, stride) = match self.module.ty(pointer.ty)? {
                Type::Struct(members) => {
                    let member = literal.ok_or(Fault::Damaged("a member has no constant index"))?;
                    let inner = *members.get(member as usize).ok_or(Fault::Damaged("a struct lacks a member"))?;
                    if bytes {
                        let (offset, columns) = self.module.member_layout(pointer.ty, member)?;
                        pointer.fixed += offset;
                        pointer.columns = columns;
                    } else {
                        pointer.fixed += self.module.step(pointer.ty, member)?.1;
                    }
                    pointer.ty = inner;
                    continue;
                }
                Type::Vector(e, n) => (*e, Some(*n), if bytes { 4 } else { 1 }),
                Type::Matrix(e, n) => (*e, Some(*n), if bytes { pointer.columns } else { self.module.flat(*e)? }),
                Type::Array(e, n, stride) => (*e, Some(*n), if bytes { *stride } else { self.module.flat(*e)? }),
                Type::RuntimeArray(e, stride) => (*e, None, *stride),
                _ => return Err(Fault::Damaged("a scalar has no elements")),
            };
            pointer.ty = element;
            match (literal, length) {
                (Some(k), Some(n)) if k < n => pointer.fixed += k * stride,
                (Some(k), None) if k.checked_mul(stride).is_some() => pointer.fixed += k * stride,
                _ => {
                    let at = self.one(scope, index)?;
                    if let Some(n) = length {
                        self.step(Step::Index(at, n));
                    }
                    let factor = self.constant(stride);
                    let scaled = if stride == 1 { at } else { self.bin(Bin::IMul, at, factor) };
                    pointer.at = if pointer.at == NONE { scaled } else { self.bin(Bin::IAdd, pointer.at, scaled) };
                }
            }
        }
        scope.values.insert(args[1], Value::Pointer(pointer));
        Ok(())
    }

    /// Returns the places of the scalars behind a pointer.
    pub(super) fn places(&self, pointer: &Pointer) -> Result<Vec<Place>, Fault> {
        let offsets = match pointer.space {
            Space::Buffer(_) | Space::Push => self.module.bytes(pointer.ty, pointer.columns)?,
            Space::Registers(..) | Space::Shared => (0..self.module.flat(pointer.ty)?).collect(),
        };
        let place = |offset| Place { space: pointer.space, fixed: pointer.fixed + offset, at: pointer.at };
        Ok(offsets.into_iter().map(place).collect())
    }

    pub(super) fn load(&mut self, pointer: &Pointer) -> Result<Rc<[Slot]>, Fault> {
        let places = self.places(pointer)?;
        Ok(places
            .into_iter()
            .map(|place| match place.space {
                Space::Registers(first, _) if place.at == NONE && self.code.inputs.iter().any(|(_, s)| *s == first) => {
                    first + place.fixed
                }
                Space::Registers(first, _) if place.at == NONE => self.un(Un::Copy, first + place.fixed),
                _ => {
                    let d = self.slots(1)[0];
                    self.step(Step::Load(d, place));
                    d
                }
            })
            .collect())
    }

    pub(super) fn store(&mut self, pointer: &Pointer, values: &[Slot]) -> Result<(), Fault> {
        for (place, value) in self.places(pointer)?.into_iter().zip(values) {
            match place.space {
                Space::Registers(first, _) if place.at == NONE => {
                    self.step(Step::Un(Un::Copy, first + place.fixed, *value));
                }
                _ => self.step(Step::Store(place, *value)),
            }
        }
        Ok(())
    }

    /// Translates an atomic operation.
    pub(super) fn atomic(&mut self, scope: &mut Scope, inst: Inst<'_>) -> Result<(), Fault> {
        let args = inst.args;
        if inst.op == Op::AtomicStore {
            let place = self.places(&self.pointer(scope, args[0])?)?[0];
            let value = self.one(scope, args[3])?;
            self.step(Step::Atomic(Atomic::Store, NONE, place, value, NONE));
            return Ok(());
        }
        let place = self.places(&self.pointer(scope, args[2])?)?[0];
        let (op, value, comparator) = match inst.op {
            Op::AtomicLoad => (Atomic::Load, NONE, NONE),
            Op::AtomicCompareExchange => {
                (Atomic::CompareExchange, self.one(scope, args[6])?, self.one(scope, args[7])?)
            }
            Op::AtomicIIncrement => (Atomic::Combine(Bin::IAdd), self.constant(1), NONE),
            Op::AtomicIDecrement => (Atomic::Combine(Bin::ISub), self.constant(1), NONE),
            _ => {
                let op = match inst.op {
                    Op::AtomicExchange => Atomic::Exchange,
                    Op::AtomicIAdd => Atomic::Combine(Bin::IAdd),
                    Op::AtomicISub => Atomic::Combine(Bin::ISub),
                    Op::AtomicUMin => Atomic::Combine(Bin::UMin),
                    Op::AtomicUMax => Atomic::Combine(Bin::UMax),
                    Op::AtomicSMin => Atomic::Combine(Bin::SMin),
                    Op::AtomicSMax => Atomic::Combine(Bin::SMax),
                    Op::AtomicAnd => Atomic::Combine(Bin::And),
                    Op::AtomicOr => Atomic::Combine(Bin::Or),
                    Op::AtomicXor => Atomic::Combine(Bin::Xor),
                    Op::AtomicFAddEXT => Atomic::Combine(Bin::FAdd),
                    Op::AtomicFMinEXT => Atomic::Combine(Bin::FMin),
                    Op::AtomicFMaxEXT => Atomic::Combine(Bin::FMax),
                    other => return Err(Fault::missing(format!("Op{other:?}"))),
                };
                (op, self.one(scope, args[5])?, NONE)
            }
        };
        let d = self.slots(1);
        self.step(Step::Atomic(op, d[0], place, value, comparator));
        scope.values.insert(args[1], Value::Registers(d));
        Ok(())
    }

    /// Translates the length of a runtime array.
    pub(super) fn length(&mut self, scope: &mut Scope, args: &[u32]) -> Result<(), Fault> {
        let pointer = self.pointer(scope, args[2])?;
        let (Space::Buffer(binding), Type::Struct(members)) = (pointer.space, self.module.ty(pointer.ty)?) else {
            return Err(Fault::Damaged("a length of no buffer"));
        };
        let Some(Type::RuntimeArray(_, stride)) = members.get(args[3] as usize).and_then(|m| self.module.types.get(m))
        else {
            return Err(Fault::Damaged("a length of no runtime array"));
        };
        let (offset, _) = self.module.member_layout(pointer.ty, args[3])?;
        let d = self.slots(1);
        self.step(Step::Length(d[0], binding, offset, *stride));
        scope.values.insert(args[1], Value::Registers(d));
        Ok(())
    }
}
