//! Instructions that compute values.

use super::{Lower, Scope, Value};
use crate::code::{Combine, Group, NONE, Slot, Step, Vote};
use crate::fault::Fault;
use crate::module::{Inst, Type};
use crate::scalar::{Bin, Tri, Un};
use spirv::{GLOp, Op};
use std::rc::Rc;

impl Lower<'_, '_> {
    /// Translates an instruction of a function.
    pub(super) fn inst(&mut self, scope: &mut Scope, inst: Inst<'_>) -> Result<(), Fault> {
        if self.flow(scope, inst)? {
            return Ok(());
        }
        let args = inst.args;
        match inst.op {
            Op::Variable => {
                let ty = self.pointee(args[0])?;
                let count = self.module.flat(ty)?;
                let slots = self.variable(count);
                let space = crate::code::Space::Registers(slots[0], count);
                let pointer = super::Pointer { space, ty, fixed: 0, at: NONE, columns: 0 };
                scope.values.insert(args[1], Value::Pointer(pointer));
                if let Some(initial) = args.get(3) {
                    let initial = self.value(scope, *initial)?;
                    self.store(&pointer, &initial)?;
                }
            }
            Op::AccessChain | Op::InBoundsAccessChain => self.chain(scope, args)?,
            Op::Store => {
                let pointer = self.pointer(scope, args[0])?;
                let values = self.value(scope, args[1])?;
                self.store(&pointer, &values)?;
            }
            Op::ControlBarrier => {
                let (scope, semantics) = (self.module.scalar(args[0])?, self.module.scalar(args[2])?);
                self.step(Step::Barrier(scope, semantics));
            }
            Op::MemoryBarrier => {
                let semantics = self.module.scalar(args[1])?;
                self.step(Step::MemoryBarrier(semantics));
            }
            Op::Load if self.image(scope, args[2]).is_some() => {
                if let Some(binding) = self.image(scope, args[2]) {
                    scope.values.insert(args[1], Value::Image(binding));
                }
            }
            Op::ImageWrite => {
                let binding = self.image(scope, args[0]).ok_or(Fault::Damaged("a texel of no image"))?;
                let (at, texel) = (self.value(scope, args[1])?, self.value(scope, args[2])?);
                let component = |k: usize| texel[k.min(texel.len() - 1)];
                let all = [component(0), component(1), component(2), component(3)];
                self.step(Step::SetTexel(binding, [at[0], at[1]], all));
            }
            Op::ImageRead => {
                let binding = self.image(scope, args[2]).ok_or(Fault::Damaged("a texel of no image"))?;
                let at = self.value(scope, args[3])?;
                let texel = self.slots(self.module.flat(args[0])?);
                for (k, d) in texel.iter().enumerate() {
                    self.step(Step::Texel(*d, binding, [at[0], at[1]], k as u32));
                }
                scope.values.insert(args[1], Value::Registers(texel));
            }
            Op::CooperativeMatrixLoadKHR | Op::CooperativeMatrixStoreKHR | Op::CooperativeMatrixMulAddKHR => {
                self.tiles(scope, inst)?;
            }
            Op::ArrayLength => self.length(scope, args)?,
            Op::AtomicLoad
            | Op::AtomicStore
            | Op::AtomicExchange
            | Op::AtomicCompareExchange
            | Op::AtomicIIncrement
            | Op::AtomicIDecrement
            | Op::AtomicIAdd
            | Op::AtomicISub
            | Op::AtomicUMin
            | Op::AtomicUMax
            | Op::AtomicSMin
            | Op::AtomicSMax
            | Op::AtomicAnd
            | Op::AtomicOr
            | Op::AtomicXor
            | Op::AtomicFAddEXT
            | Op::AtomicFMinEXT
            | Op::AtomicFMaxEXT => self.atomic(scope, inst)?,
            Op::Line | Op::NoLine | Op::Nop => {}
            _ => {
                let found = self.compute(scope, inst)?;
                scope.values.insert(args[1], Value::Registers(found));
            }
        }
        Ok(())
    }

    /// Translates an instruction whose result are registers.
    fn compute(&mut self, scope: &Scope, inst: Inst<'_>) -> Result<Rc<[Slot]>, Fault> {
        let args = inst.args;
        if let Some(op) = Un::of(inst.op) {
            let a = self.value(scope, args[2])?;
            return Ok(a.iter().map(|a| self.un(op, *a)).collect());
        }
        if let Some(op) = Bin::of(inst.op) {
            let (a, b) = (self.value(scope, args[2])?, self.value(scope, args[3])?);
            return Ok(a.iter().zip(b.iter()).map(|(a, b)| self.bin(op, *a, *b)).collect());
        }
        if let Some(op) = Tri::of(inst.op) {
            let (base, offset) = (self.value(scope, args[2])?, self.one(scope, args[3])?);
            let count = self.one(scope, args[4])?;
            return Ok(base.iter().map(|b| self.tri(op, *b, offset, count)).collect());
        }
        Ok(match inst.op {
            Op::Load => {
                let pointer = self.pointer(scope, args[2])?;
                self.load(&pointer)?
            }
            Op::Undef => {
                let undefined = self.constant(u32::MAX);
                (0..self.module.flat(args[0])?).map(|_| undefined).collect()
            }
            Op::CopyLogical | Op::CopyObject => self.value(scope, args[2])?,
            // A cooperative matrix has the same number in each element.
            Op::CompositeConstruct if self.module.tile_of(args[0]).is_some() => {
                let value = self.one(scope, args[2])?;
                (0..self.module.flat(args[0])?).map(|_| value).collect()
            }
            Op::FConvert => {
                let a = self.value(scope, args[2])?;
                let op = if matches!(self.module.ty(args[0])?, Type::Half) { Un::RoundHalf } else { Un::Copy };
                a.iter().map(|a| self.un(op, *a)).collect()
            }
            Op::CompositeConstruct => {
                let mut all = Vec::new();
                for id in &args[2..] {
                    all.extend(self.value(scope, *id)?.iter());
                }
                all.into()
            }
            Op::CompositeExtract => {
                let from = self.value(scope, args[2])?;
                let ty = self.type_of(scope, args[2])?;
                let (offset, count) = self.module.member(ty, &args[3..])?;
                from[offset as usize..(offset + count) as usize].into()
            }
            Op::CompositeInsert => {
                let object = self.value(scope, args[2])?;
                let mut all = self.value(scope, args[3])?.to_vec();
                let (offset, count) = self.module.member(args[0], &args[4..])?;
                all[offset as usize..(offset + count) as usize].copy_from_slice(&object);
                all.into()
            }
            Op::VectorShuffle => {
                let (a, b) = (self.value(scope, args[2])?, self.value(scope, args[3])?);
                let undefined = self.constant(u32::MAX);
                let all: Vec<Slot> = a.iter().chain(b.iter()).copied().collect();
                args[4..].iter().map(|k| all.get(*k as usize).copied().unwrap_or(undefined)).collect()
            }
            Op::VectorExtractDynamic => {
                let (all, index) = (self.value(scope, args[2])?, self.one(scope, args[3])?);
                self.step(Step::Index(index, all.len() as u32));
                let mut found = all[0];
                for (k, one) in all.iter().enumerate().skip(1) {
                    let k = self.constant(k as u32);
                    let here = self.bin(Bin::IEqual, index, k);
                    found = self.tri(Tri::Select, here, *one, found);
                }
                [found].into()
            }
            Op::Select => {
                let c = self.value(scope, args[2])?;
                let (a, b) = (self.value(scope, args[3])?, self.value(scope, args[4])?);
                let c = |k: usize| c[k.min(c.len() - 1)];
                (0..a.len()).map(|k| self.tri(Tri::Select, c(k), a[k], b[k])).collect()
            }
            Op::Any | Op::All => {
                let a = self.value(scope, args[2])?;
                let op = if inst.op == Op::Any { Bin::LogicalOr } else { Bin::LogicalAnd };
                let joined = a[1..].iter().fold(a[0], |x, y| self.bin(op, x, *y));
                [joined].into()
            }
            Op::Dot => {
                let (a, b) = (self.value(scope, args[2])?, self.value(scope, args[3])?);
                [self.dot(&a, &b)].into()
            }
            Op::VectorTimesScalar | Op::MatrixTimesScalar => {
                let (a, b) = (self.value(scope, args[2])?, self.one(scope, args[3])?);
                a.iter().map(|a| self.bin(Bin::FMul, *a, b)).collect()
            }
            Op::MatrixTimesVector => {
                let (m, v) = (self.value(scope, args[2])?, self.value(scope, args[3])?);
                self.times(&m, &v).into()
            }
            Op::VectorTimesMatrix => {
                let (v, m) = (self.value(scope, args[2])?, self.value(scope, args[3])?);
                m.chunks(v.len()).map(|column| self.dot(&v, column)).collect()
            }
            Op::MatrixTimesMatrix => {
                let (a, b) = (self.value(scope, args[2])?, self.value(scope, args[3])?);
                let rows = self.columns(self.type_of(scope, args[3])?)?;
                b.chunks(rows as usize).flat_map(|column| self.times(&a, column)).collect()
            }
            Op::Transpose => {
                let m = self.value(scope, args[2])?;
                let rows = self.columns(self.type_of(scope, args[2])?)? as usize;
                (0..rows).flat_map(|r| m.iter().copied().skip(r).step_by(rows).collect::<Vec<_>>()).collect()
            }
            Op::OuterProduct => {
                let (a, b) = (self.value(scope, args[2])?, self.value(scope, args[3])?);
                b.iter().flat_map(|b| a.iter().map(|a| self.bin(Bin::FMul, *a, *b)).collect::<Vec<_>>()).collect()
            }
            Op::ExtInst if args[2] == self.module.glsl => self.glsl(scope, args)?,
            _ => self.group(scope, inst)?,
        })
    }

    pub(super) fn tri(&mut self, op: Tri, a: Slot, b: Slot, c: Slot) -> Slot {
        let d = self.slots(1)[0];
        self.step(Step::Tri(op, d, a, b, c));
        d
    }

    fn dot(&mut self, a: &[Slot], b: &[Slot]) -> Slot {
        let first = self.bin(Bin::FMul, a[0], b[0]);
        a[1..].iter().zip(&b[1..]).fold(first, |sum, (a, b)| {
            let product = self.bin(Bin::FMul, *a, *b);
            self.bin(Bin::FAdd, sum, product)
        })
    }

    /// Multiplies a matrix by a vector.
    fn times(&mut self, m: &[Slot], v: &[Slot]) -> Vec<Slot> {
        let rows = m.len() / v.len();
        let row = |r: usize| m.iter().copied().skip(r).step_by(rows).collect::<Vec<_>>();
        (0..rows).map(|r| self.dot(&row(r), v)).collect()
    }

    /// Returns the number of rows of a matrix type.
    fn columns(&self, ty: u32) -> Result<u32, Fault> {
        match self.module.ty(ty)? {
            Type::Matrix(column, _) => self.module.flat(*column),
            _ => Err(Fault::Damaged("a matrix has another type")),
        }
    }

    /// Returns the type of an id of the open function or of a constant.
    pub(super) fn type_of(&self, scope: &Scope, id: u32) -> Result<u32, Fault> {
        let (function, _) = self.module.labels.get(&scope.block).ok_or(Fault::Damaged("a block is unknown"))?;
        let constant = self.module.constant_types.get(&id).copied();
        let insts = self.module.functions[function].result_types.get(&id).copied();
        constant.or(insts).ok_or(Fault::Damaged("a value has no type"))
    }

    /// Translates an instruction of `GLSL.std.450`.
    fn glsl(&mut self, scope: &Scope, args: &[u32]) -> Result<Rc<[Slot]>, Fault> {
        let op = GLOp::from_u32(args[3]).ok_or_else(|| Fault::missing(format!("GLSL.std.450 {}", args[3])))?;
        let mut operands = Vec::new();
        for id in &args[4..] {
            operands.push(self.value(scope, *id)?);
        }
        let a = operands[0].clone();
        if let Some(op) = Un::glsl(op) {
            return Ok(a.iter().map(|a| self.un(op, *a)).collect());
        }
        if let Some(op) = Bin::glsl(op) {
            return Ok((0..a.len()).map(|k| self.bin(op, a[k], operands[1][k])).collect());
        }
        if let Some(op) = Tri::glsl(op) {
            return Ok((0..a.len()).map(|k| self.tri(op, a[k], operands[1][k], operands[2][k])).collect());
        }
        Ok(match op {
            GLOp::Length => [self.length_of(&a)].into(),
            GLOp::Distance => {
                let d: Vec<Slot> = (0..a.len()).map(|k| self.bin(Bin::FSub, a[k], operands[1][k])).collect();
                [self.length_of(&d)].into()
            }
            GLOp::Normalize => {
                let length = self.length_of(&a);
                a.iter().map(|a| self.bin(Bin::FDiv, *a, length)).collect()
            }
            GLOp::Cross => {
                let b = operands[1].clone();
                let part = |lower: &mut Self, i: usize, j: usize| {
                    let (x, y) = (lower.bin(Bin::FMul, a[i], b[j]), lower.bin(Bin::FMul, a[j], b[i]));
                    lower.bin(Bin::FSub, x, y)
                };
                [part(self, 1, 2), part(self, 2, 0), part(self, 0, 1)].into()
            }
            GLOp::PackHalf2x16 => [self.bin(Bin::PackHalf, a[0], a[1])].into(),
            GLOp::UnpackHalf2x16 => [self.un(Un::HalfLow, a[0]), self.un(Un::HalfHigh, a[0])].into(),
            GLOp::UnpackUnorm4x8 | GLOp::UnpackUnorm2x16 => {
                let (op, n) = if op == GLOp::UnpackUnorm4x8 { (Bin::Unorm8, 4) } else { (Bin::Unorm16, 2) };
                (0..n)
                    .map(|k| {
                        let k = self.constant(k);
                        self.bin(op, a[0], k)
                    })
                    .collect()
            }
            GLOp::FrexpStruct => {
                let mantissas: Vec<Slot> = a.iter().map(|a| self.un(Un::FrexpMantissa, *a)).collect();
                let exponents = a.iter().map(|a| self.un(Un::FrexpExponent, *a)).collect::<Vec<_>>();
                mantissas.into_iter().chain(exponents).collect()
            }
            other => return Err(Fault::missing(format!("GLSL.std.450 {other:?}"))),
        })
    }

    fn length_of(&mut self, a: &[Slot]) -> Slot {
        let square = self.dot(a, a);
        self.un(Un::Sqrt, square)
    }

    /// Translates an operation of subgroups.
    fn group(&mut self, scope: &Scope, inst: Inst<'_>) -> Result<Rc<[Slot]>, Fault> {
        let args = inst.args;
        let arithmetic = match inst.op {
            Op::GroupNonUniformIAdd => Some((Bin::IAdd, 0)),
            Op::GroupNonUniformFAdd => Some((Bin::FAdd, 0)),
            Op::GroupNonUniformIMul => Some((Bin::IMul, 1)),
            Op::GroupNonUniformFMul => Some((Bin::FMul, 1.0_f32.to_bits())),
            Op::GroupNonUniformSMin => Some((Bin::SMin, i32::MAX as u32)),
            Op::GroupNonUniformUMin => Some((Bin::UMin, u32::MAX)),
            Op::GroupNonUniformFMin => Some((Bin::FMin, f32::INFINITY.to_bits())),
            Op::GroupNonUniformSMax => Some((Bin::SMax, i32::MIN as u32)),
            Op::GroupNonUniformUMax => Some((Bin::UMax, 0)),
            Op::GroupNonUniformFMax => Some((Bin::FMax, f32::NEG_INFINITY.to_bits())),
            Op::GroupNonUniformBitwiseAnd | Op::GroupNonUniformLogicalAnd => Some((Bin::And, u32::MAX)),
            Op::GroupNonUniformBitwiseOr | Op::GroupNonUniformLogicalOr => Some((Bin::Or, 0)),
            Op::GroupNonUniformBitwiseXor | Op::GroupNonUniformLogicalXor => Some((Bin::Xor, 0)),
            _ => None,
        };
        let combine = |k: u32, cluster: Option<u32>| match (k, cluster) {
            (0, _) => Ok(Combine::Reduce),
            (1, _) => Ok(Combine::Inclusive),
            (2, _) => Ok(Combine::Exclusive),
            (3, Some(size)) => Ok(Combine::Clustered(size)),
            _ => Err(Fault::missing(format!("group operation {k}"))),
        };
        if let Some((op, identity)) = arithmetic {
            let cluster = args.get(5).map(|id| self.module.scalar(*id)).transpose()?;
            let how = combine(args[3], cluster)?;
            let a = self.value(scope, args[4])?;
            return Ok(a.iter().map(|a| self.lanes(Group::Arithmetic(op, how, identity), *a, NONE)).collect());
        }
        let shuffle = match inst.op {
            Op::GroupNonUniformBroadcast => Some(Group::Broadcast),
            Op::GroupNonUniformShuffle => Some(Group::Shuffle),
            Op::GroupNonUniformShuffleXor => Some(Group::ShuffleXor),
            Op::GroupNonUniformShuffleUp => Some(Group::ShuffleUp),
            Op::GroupNonUniformShuffleDown => Some(Group::ShuffleDown),
            _ => None,
        };
        if let Some(op) = shuffle {
            let (a, which) = (self.value(scope, args[3])?, self.one(scope, args[4])?);
            return Ok(a.iter().map(|a| self.lanes(op, *a, which)).collect());
        }
        Ok(match inst.op {
            Op::GroupNonUniformElect => [self.lanes(Group::Elect, NONE, NONE)].into(),
            Op::GroupNonUniformAll | Op::GroupNonUniformAny => {
                let a = self.one(scope, args[3])?;
                let op = if inst.op == Op::GroupNonUniformAll { Group::All } else { Group::Any };
                [self.lanes(op, a, NONE)].into()
            }
            Op::GroupNonUniformAllEqual => {
                let a = self.value(scope, args[3])?;
                let each: Vec<Slot> = a.iter().map(|a| self.lanes(Group::AllEqual, *a, NONE)).collect();
                [each[1..].iter().fold(each[0], |x, y| self.bin(Bin::LogicalAnd, x, *y))].into()
            }
            Op::GroupNonUniformBroadcastFirst => {
                let a = self.value(scope, args[3])?;
                a.iter().map(|a| self.lanes(Group::BroadcastFirst, *a, NONE)).collect()
            }
            Op::GroupNonUniformBallot => {
                let a = self.one(scope, args[3])?;
                (0..4).map(|k| self.lanes(Group::Ballot(k), a, NONE)).collect()
            }
            Op::GroupNonUniformInverseBallot => {
                let ballot = self.value(scope, args[3])?;
                let (_, lane) =
                    *self.code.inputs.iter().find(|(b, _)| *b == crate::code::BuiltIn::Lane).ok_or_else(|| {
                        Fault::missing("an inverse ballot without gl_SubgroupInvocationID".to_owned())
                    })?;
                [self.vote(Vote::Bit, &ballot, lane)].into()
            }
            Op::GroupNonUniformBallotBitExtract => {
                let (ballot, lane) = (self.value(scope, args[3])?, self.one(scope, args[4])?);
                [self.vote(Vote::Bit, &ballot, lane)].into()
            }
            Op::GroupNonUniformBallotBitCount => {
                let (how, ballot) = (combine(args[3], None)?, self.value(scope, args[4])?);
                [self.vote(Vote::Count(how), &ballot, NONE)].into()
            }
            Op::GroupNonUniformBallotFindLSB | Op::GroupNonUniformBallotFindMSB => {
                let ballot = self.value(scope, args[3])?;
                let lowest = inst.op == Op::GroupNonUniformBallotFindLSB;
                [self.vote(if lowest { Vote::Lowest } else { Vote::Highest }, &ballot, NONE)].into()
            }
            other => return Err(Fault::missing(format!("Op{other:?}"))),
        })
    }

    fn lanes(&mut self, op: Group, a: Slot, b: Slot) -> Slot {
        let d = self.slots(1)[0];
        self.step(Step::Group(op, d, a, b));
        d
    }

    fn vote(&mut self, op: Vote, ballot: &[Slot], lane: Slot) -> Slot {
        let d = self.slots(1)[0];
        self.step(Step::Vote(op, d, [ballot[0], ballot[1], ballot[2], ballot[3]], lane));
        d
    }
}
