//! Module in SPIR-V: types, constants with their specialization, decorations and functions.
//!
//! Every scalar has 32 bits, floats of 16 bits included. Values are flat lists of scalars, so that a matrix of 3 × 3 has
//! nine, and a cooperative matrix those of one lane.

use crate::fault::Fault;
use crate::scalar::{self, Bin, Tri, Un};
use half::f16;
use spirv::{Decoration, Op};
use std::collections::HashMap;

/// Instruction with all its words.
#[derive(Clone, Copy)]
pub(crate) struct Inst<'w> {
    pub op: Op,
    /// Operands, without the leading word.
    pub args: &'w [u32],
}

/// Type.
#[derive(Clone, Debug)]
pub(crate) enum Type {
    /// No value.
    Void,
    /// Truth value, 0 or 1.
    Bool,
    /// Integer of 32 bits.
    Int,
    /// Float of 32 bits.
    Float,
    /// Float of 16 bits, stored as one of 32 in a variable or in shared memory.
    Half,
    /// Cooperative matrix.
    Tile(Tile),
    /// Element and number of elements.
    Vector(u32, u32),
    /// Column and number of columns.
    Matrix(u32, u32),
    /// Element, number of elements and stride in bytes (0 without a layout).
    Array(u32, u32, u32),
    /// Element and stride in bytes.
    RuntimeArray(u32, u32),
    /// Members.
    Struct(Vec<u32>),
    /// Type that is pointed to.
    Pointer(u32),
    /// Anything that the emulator cannot load.
    Opaque(Op),
}

/// Cooperative matrix: its size, and its elements in a lane.
///
/// Which elements a lane has differs by the use, as it may on devices.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Tile {
    pub rows: u32,
    pub columns: u32,
    /// Left operand, right operand or sum: 0, 1 or 2.
    pub role: u32,
    pub share: u32,
}

impl Tile {
    /// Returns row and column of an element of a lane.
    ///
    /// The factor is odd and the number of elements a power of two, so that each element has one place.
    pub fn place(&self, lane: u32, index: u32) -> (u32, u32) {
        let count = self.rows * self.columns;
        let element = ((lane * self.share + index) * (2 * self.role + 5) + self.role) % count;
        (element / self.columns, element % self.columns)
    }
}

/// Basic block: its label and its instructions, the terminator last.
pub(crate) struct Block<'w> {
    pub label: u32,
    pub insts: Vec<Inst<'w>>,
}

/// Function: its parameters and blocks in the order of the module.
#[derive(Default)]
pub(crate) struct Function<'w> {
    /// Type of the result.
    pub result: u32,
    pub parameters: Vec<u32>,
    /// Type of each value.
    pub result_types: HashMap<u32, u32>,
    pub blocks: Vec<Block<'w>>,
}

/// Decoded module with specialized constants.
#[derive(Default)]
pub(crate) struct Module<'w> {
    pub types: HashMap<u32, Type>,
    /// Type of each constant.
    pub constant_types: HashMap<u32, u32>,
    /// Flat bits of each constant.
    pub constants: HashMap<u32, Vec<u32>>,
    pub names: HashMap<u32, String>,
    decorations: HashMap<(u32, u32), u32>,
    member_decorations: HashMap<(u32, u32, u32), u32>,
    /// Id, type and storage class of each global variable.
    pub globals: Vec<(u32, u32, u32)>,
    pub functions: HashMap<u32, Function<'w>>,
    /// Function and place of each block.
    pub labels: HashMap<u32, (u32, usize)>,
    pub entry: u32,
    pub local_size: [u32; 3],
    /// Lanes of a subgroup, if known.
    lanes: Option<u32>,
    /// Id of the instruction set of `GLSL.std.450`.
    pub glsl: u32,
}

/// Splits words into instructions.
fn instructions(words: &[u32]) -> Result<Vec<Inst<'_>>, Fault> {
    let mut rest = words.get(5..).ok_or(Fault::Damaged("it has no header"))?;
    let mut found = Vec::new();
    while let Some(&word) = rest.first() {
        let length = (word >> 16) as usize;
        let (inst, after) =
            rest.split_at_checked(length).filter(|_| length > 0).ok_or(Fault::Damaged("an instruction is cut off"))?;
        let op = Op::from_u32(word & 0xffff).ok_or_else(|| Fault::missing(format!("opcode {}", word & 0xffff)))?;
        found.push(Inst { op, args: &inst[1..] });
        rest = after;
    }
    Ok(found)
}

/// Reads a literal string.
fn text(words: &[u32]) -> String {
    let bytes = words.iter().flat_map(|w| w.to_le_bytes()).take_while(|b| *b != 0).collect();
    String::from_utf8(bytes).unwrap_or_default()
}

impl<'w> Module<'w> {
    /// Decodes a module. `specs` holds constant ids and bits. Cooperative matrices need the number of lanes.
    pub fn decode(words: &'w [u32], specs: &[(u32, u32)], lanes: Option<u32>) -> Result<Module<'w>, Fault> {
        let mut module = Module { local_size: [1; 3], lanes, ..Module::default() };
        let mut function: Option<(u32, Function<'w>)> = None;
        for inst in instructions(words)? {
            let args = inst.args;
            match (inst.op, function.as_mut()) {
                (Op::Function, _) => {
                    function = Some((args[1], Function { result: args[0], ..Function::default() }));
                }
                (Op::FunctionEnd, Some(_)) => {
                    let (id, done): (u32, Function<'_>) =
                        function.take().ok_or(Fault::Damaged("a function has no beginning"))?;
                    module.labels.extend(done.blocks.iter().enumerate().map(|(i, b)| (b.label, (id, i))));
                    module.functions.insert(id, done);
                }
                (Op::FunctionParameter, Some((_, f))) => {
                    f.parameters.push(args[1]);
                    f.result_types.insert(args[1], args[0]);
                }
                (Op::Label, Some((_, f))) => f.blocks.push(Block { label: args[0], insts: Vec::new() }),
                (Op::Line | Op::NoLine, _) => {}
                (_, Some((_, f))) => {
                    // Harmless for instructions without a result, because no id names them.
                    if let [ty, id, ..] = *args
                        && module.types.contains_key(&ty)
                    {
                        f.result_types.insert(id, ty);
                    }
                    f.blocks.last_mut().ok_or(Fault::Damaged("a function has no label"))?.insts.push(inst);
                }
                (_, None) => module.global(inst, specs)?,
            }
        }
        Ok(module)
    }

    fn global(&mut self, inst: Inst<'w>, specs: &[(u32, u32)]) -> Result<(), Fault> {
        let args = inst.args;
        match inst.op {
            Op::EntryPoint => self.entry = args[1],
            Op::ExecutionMode if args[1] == 17 => self.local_size = [args[2], args[3], args[4]],
            Op::ExtInstImport if text(&args[1..]) == "GLSL.std.450" => self.glsl = args[0],
            Op::Name => {
                self.names.insert(args[0], text(&args[1..]));
            }
            Op::Decorate => {
                self.decorations.insert((args[0], args[1]), args.get(2).copied().unwrap_or(1));
            }
            Op::MemberDecorate => {
                self.member_decorations.insert((args[0], args[1], args[2]), args.get(3).copied().unwrap_or(1));
            }
            Op::Variable => self.globals.push((args[1], args[0], args[2])),
            Op::Constant
            | Op::SpecConstant
            | Op::ConstantTrue
            | Op::SpecConstantTrue
            | Op::ConstantFalse
            | Op::SpecConstantFalse
            | Op::ConstantNull
            | Op::Undef
            | Op::ConstantComposite
            | Op::SpecConstantComposite
            | Op::SpecConstantOp => self.constant(inst, specs)?,
            Op::Capability
            | Op::Extension
            | Op::ExtInstImport
            | Op::MemoryModel
            | Op::ExecutionMode
            | Op::Source
            | Op::SourceExtension
            | Op::SourceContinued
            | Op::String
            | Op::MemberName
            | Op::ModuleProcessed
            | Op::Line
            | Op::NoLine => {}
            _ => self.type_of(inst)?,
        }
        Ok(())
    }

    fn type_of(&mut self, inst: Inst<'w>) -> Result<(), Fault> {
        let args = inst.args;
        let stride = self.decoration(args[0], Decoration::ArrayStride).unwrap_or(0);
        let ty = match inst.op {
            Op::TypeVoid | Op::TypeFunction => Type::Void,
            Op::TypeBool => Type::Bool,
            Op::TypeInt if args[1] == 32 => Type::Int,
            Op::TypeFloat if args[1] == 32 => Type::Float,
            Op::TypeFloat if args[1] == 16 => Type::Half,
            Op::TypeCooperativeMatrixKHR => Type::Tile(self.tile(args)?),
            Op::TypeVector => Type::Vector(args[1], args[2]),
            Op::TypeMatrix => Type::Matrix(args[1], args[2]),
            Op::TypeArray => Type::Array(args[1], self.scalar(args[2])?, stride),
            Op::TypeRuntimeArray => Type::RuntimeArray(args[1], stride),
            Op::TypeStruct => Type::Struct(args[1..].to_vec()),
            Op::TypePointer => Type::Pointer(args[2]),
            op => Type::Opaque(op),
        };
        self.types.insert(args[0], ty);
        Ok(())
    }

    /// Reads a type of cooperative matrices.
    fn tile(&self, args: &[u32]) -> Result<Tile, Fault> {
        let [rows, columns, role] = [args[3], args[4], args[5]].map(|id| self.scalar(id));
        let (rows, columns, role) = (rows?, columns?, role?);
        let lanes =
            self.lanes.ok_or_else(|| Fault::missing("cooperative matrices without a number of lanes".to_owned()))?;
        let count = rows * columns;
        if !count.is_power_of_two() || count % lanes != 0 || self.scalar(args[2])? != 3 {
            return Err(Fault::missing(format!("cooperative matrices of {rows} x {columns} in {lanes} lanes")));
        }
        Ok(Tile { rows, columns, role, share: count / lanes })
    }

    fn constant(&mut self, inst: Inst<'w>, specs: &[(u32, u32)]) -> Result<(), Fault> {
        let (ty, id, rest) = (inst.args[0], inst.args[1], &inst.args[2..]);
        let specialized = self.decoration(id, Decoration::SpecId);
        let specialized = specialized.and_then(|s| specs.iter().find(|(other, _)| *other == s)).map(|(_, bits)| *bits);
        let bits = match inst.op {
            Op::Constant if matches!(self.ty(ty)?, Type::Half) => {
                vec![f16::from_bits(rest[0] as u16).to_f32().to_bits()]
            }
            Op::Constant => vec![rest[0]],
            Op::SpecConstant => vec![specialized.unwrap_or(rest[0])],
            Op::ConstantTrue => vec![1],
            Op::ConstantFalse => vec![0],
            Op::SpecConstantTrue => vec![u32::from(specialized.unwrap_or(1) != 0)],
            Op::SpecConstantFalse => vec![u32::from(specialized.unwrap_or(0) != 0)],
            Op::ConstantNull => vec![0; self.flat(ty)? as usize],
            Op::Undef => vec![u32::MAX; self.flat(ty)? as usize],
            Op::SpecConstantOp => self.specialize(ty, rest)?,
            _ if matches!(self.ty(ty)?, Type::Tile(_)) => vec![self.scalar(rest[0])?; self.flat(ty)? as usize],
            _ => rest.iter().map(|id| self.bits(*id).cloned()).collect::<Result<Vec<_>, _>>()?.concat(),
        };
        if self.decoration(id, Decoration::BuiltIn) == Some(25) {
            self.local_size = [bits[0], bits[1], bits[2]];
        }
        self.constants.insert(id, bits);
        self.constant_types.insert(id, ty);
        Ok(())
    }

    /// Computes an operation on constants.
    fn specialize(&self, ty: u32, rest: &[u32]) -> Result<Vec<u32>, Fault> {
        let op = Op::from_u32(rest[0]).ok_or(Fault::Damaged("a constant has no operation"))?;
        let operands = |n: usize| -> Result<Vec<&Vec<u32>>, Fault> {
            rest[1..].iter().take(n).map(|id| self.bits(*id)).collect::<Result<_, _>>()
        };
        let lanes = self.flat(ty)? as usize;
        let mut found = Vec::with_capacity(lanes);
        for k in 0..lanes {
            let value = if let Some(op) = Un::of(op) {
                scalar::un(op, &[operands(1)?[0][k]])[0]
            } else if let Some(op) = Bin::of(op) {
                let o = operands(2)?;
                scalar::bin(op, &[o[0][k]], &[o[1][k]])[0]
            } else if op == Op::Select {
                let o = operands(3)?;
                scalar::tri(Tri::Select, &[o[0][k.min(o[0].len() - 1)]], &[o[1][k]], &[o[2][k]])[0]
            } else {
                return Err(Fault::missing(format!("constant Op{op:?}")));
            };
            found.push(value);
        }
        Ok(found)
    }

    /// Returns a decoration's operand.
    pub fn decoration(&self, id: u32, decoration: Decoration) -> Option<u32> {
        self.decorations.get(&(id, decoration as u32)).copied()
    }

    /// Returns the operand of a member's decoration.
    pub fn member_decoration(&self, id: u32, member: u32, decoration: Decoration) -> Option<u32> {
        self.member_decorations.get(&(id, member, decoration as u32)).copied()
    }

    /// Returns a type.
    pub fn ty(&self, id: u32) -> Result<&Type, Fault> {
        self.types.get(&id).ok_or(Fault::Damaged("a type is unknown"))
    }

    /// Returns a type's cooperative matrix, if it is one.
    pub fn tile_of(&self, id: u32) -> Option<Tile> {
        match self.types.get(&id) {
            Some(Type::Tile(tile)) => Some(*tile),
            _ => None,
        }
    }

    /// Returns the flat bits of a constant.
    pub fn bits(&self, id: u32) -> Result<&Vec<u32>, Fault> {
        self.constants.get(&id).ok_or(Fault::Damaged("a constant is unknown"))
    }

    /// Returns the bits of a scalar constant.
    pub fn scalar(&self, id: u32) -> Result<u32, Fault> {
        self.bits(id)?.first().copied().ok_or(Fault::Damaged("a constant is empty"))
    }

    /// Returns the number of scalars of a type.
    pub fn flat(&self, id: u32) -> Result<u32, Fault> {
        Ok(match self.ty(id)? {
            Type::Void => 0,
            Type::Bool | Type::Int | Type::Float | Type::Half => 1,
            Type::Tile(tile) => tile.share,
            Type::Vector(element, n) | Type::Matrix(element, n) | Type::Array(element, n, _) => {
                self.flat(*element)? * n
            }
            Type::Struct(members) => {
                let mut sum = 0;
                for member in members {
                    sum += self.flat(*member)?;
                }
                sum
            }
            Type::Opaque(op) => return Err(Fault::missing(format!("Op{op:?}"))),
            Type::RuntimeArray(..) | Type::Pointer(_) => return Err(Fault::missing("a value of a pointer".to_owned())),
        })
    }

    /// Returns the type of an element and its flat offset.
    pub fn step(&self, ty: u32, index: u32) -> Result<(u32, u32), Fault> {
        Ok(match self.ty(ty)? {
            Type::Vector(e, _) | Type::Matrix(e, _) | Type::Array(e, _, _) => (*e, self.flat(*e)? * index),
            Type::Struct(members) => {
                let mut before = 0;
                for member in &members[..index as usize] {
                    before += self.flat(*member)?;
                }
                (members[index as usize], before)
            }
            _ => return Err(Fault::Damaged("a scalar has no elements")),
        })
    }

    /// Returns flat offset and length of a member that literal indices name.
    pub fn member(&self, ty: u32, indices: &[u32]) -> Result<(u32, u32), Fault> {
        let (mut ty, mut offset) = (ty, 0);
        for &index in indices {
            let (inner, at) = self.step(ty, index)?;
            (ty, offset) = (inner, offset + at);
        }
        Ok((offset, self.flat(ty)?))
    }

    /// Returns the byte offsets of the scalars of a type in memory with a layout.
    pub fn bytes(&self, ty: u32, matrix_stride: u32) -> Result<Vec<u32>, Fault> {
        let repeat = |element: Vec<u32>, n: u32, stride: u32| -> Vec<u32> {
            (0..n).flat_map(|k| element.iter().map(move |b| b + k * stride).collect::<Vec<_>>()).collect()
        };
        Ok(match self.ty(ty)? {
            Type::Bool | Type::Int | Type::Float => vec![0],
            Type::Vector(e, n) => repeat(self.bytes(*e, 0)?, *n, 4),
            Type::Matrix(e, n) => repeat(self.bytes(*e, 0)?, *n, matrix_stride),
            Type::Array(e, n, stride) => repeat(self.bytes(*e, matrix_stride)?, *n, *stride),
            Type::Struct(members) => {
                let mut all = Vec::new();
                for (k, member) in members.iter().enumerate() {
                    let (offset, stride) = self.member_layout(ty, k as u32)?;
                    all.extend(self.bytes(*member, stride)?.into_iter().map(|b| b + offset));
                }
                all
            }
            other => return Err(Fault::missing(format!("a load of {other:?}"))),
        })
    }

    /// Returns a member's byte offset and the stride of the columns of its matrices.
    pub fn member_layout(&self, ty: u32, member: u32) -> Result<(u32, u32), Fault> {
        if self.member_decoration(ty, member, Decoration::RowMajor).is_some() {
            return Err(Fault::missing("matrices by rows".to_owned()));
        }
        let offset = self.member_decoration(ty, member, Decoration::Offset);
        let offset = offset.ok_or(Fault::Damaged("a member of a buffer has no offset"))?;
        Ok((offset, self.member_decoration(ty, member, Decoration::MatrixStride).unwrap_or(0)))
    }
}
