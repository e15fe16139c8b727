//! Reflection of SPIR-V: named bindings, struct layouts, specialization constants.

use crate::access::accesses;
use sgs_shader_abi::{Access, Binding, BindingKind, ImageFormat, SpecConstant};
use spirq::prelude::*;
use spirq::ty::{DescriptorType, ScalarType, StructType};

/// Kernel with everything that the Rust side is generated from.
pub struct Kernel {
    /// File stem.
    pub name: String,
    /// Folder name.
    pub family: String,
    /// Optional GLSL extension that the kernel requires, if any.
    pub extension: Option<&'static str>,
    /// SPIR-V module.
    pub spirv: Vec<u32>,
    /// Bindings of set 0, sorted by number.
    pub bindings: Vec<Binding>,
    /// Push constants, if any.
    pub push: Option<Struct>,
    /// Specialization constants, sorted by id.
    pub specs: Vec<Spec>,
    /// Structs that bindings and push constants contain, innermost first.
    pub structs: Vec<Struct>,
}

/// One specialization constant, with its Rust type.
pub struct Spec {
    /// The constant.
    pub constant: SpecConstant,
    /// Rust type: `u32`, `i32`, `f32` or `bool`.
    pub ty: &'static str,
}

/// Struct with checked offsets.
#[derive(Clone, PartialEq)]
pub struct Struct {
    /// GLSL name.
    pub name: String,
    /// Members in order.
    pub fields: Vec<Field>,
    /// Size without trailing padding.
    pub bytes: usize,
}

/// One member of a struct.
#[derive(Clone, PartialEq)]
pub struct Field {
    /// GLSL name.
    pub name: String,
    /// Type.
    pub ty: FieldType,
    /// Byte offset.
    pub offset: usize,
}

/// Type that GLSL and Rust share.
#[derive(Clone, PartialEq)]
pub enum FieldType {
    /// Scalar, by its Rust name.
    Scalar(&'static str),
    /// Fixed-size array. Vectors and matrices are arrays too.
    Array(Box<FieldType>, usize),
    /// Another generated struct.
    Struct(String),
}

impl FieldType {
    /// Returns the type as Rust source.
    pub fn rust(&self) -> String {
        match self {
            FieldType::Scalar(s) => (*s).to_owned(),
            FieldType::Array(t, n) => format!("[{}; {n}]", t.rust()),
            FieldType::Struct(s) => s.clone(),
        }
    }
}

/// Reflects a module.
///
/// Errors are sentences without the period.
pub(crate) fn reflect(name: String, family: String, spirv: &[u32]) -> Result<Kernel, String> {
    let entry = ReflectConfig::new()
        .spv(legible(spirv))
        .ref_all_rscs(true)
        .reflect()
        .map_err(|e| e.to_string())?
        .into_iter()
        .next()
        .ok_or("it has no entry point")?;
    let access = accesses(spirv);
    let defaults = spec_defaults(spirv);
    let mut kernel = Kernel {
        name,
        family,
        extension: None,
        spirv: spirv.to_vec(),
        bindings: vec![],
        push: None,
        specs: vec![],
        structs: vec![],
    };
    for var in entry.vars {
        match var {
            Variable::Descriptor { name, desc_bind, desc_ty, ty, .. } => {
                if desc_bind.set() != 0 {
                    return Err(format!("descriptor set {} is used, only set 0 exists", desc_bind.set()));
                }
                let kind = match desc_ty {
                    DescriptorType::UniformBuffer() => BindingKind::Uniform,
                    DescriptorType::StorageBuffer(_) => BindingKind::Storage,
                    DescriptorType::StorageImage(_) => BindingKind::Image(image_format(&ty)?),
                    other => {
                        return Err(format!(
                            "binding {desc_bind} is a {other:?}, only buffers and storage images are supported"
                        ));
                    }
                };
                if matches!(kind, BindingKind::Image(_)) {
                    let name =
                        name.filter(|n| !n.is_empty()).ok_or_else(|| format!("binding {desc_bind} has no name"))?;
                    let number = desc_bind.bind();
                    let access = access.get(&number).copied().unwrap_or(Access::Read);
                    kernel.bindings.push(Binding { name: name.into(), number, kind, access });
                    continue;
                }
                let Type::Struct(block) = &ty else { return Err(format!("binding {desc_bind} is not a block")) };
                let name = match name.filter(|n| !n.is_empty()) {
                    Some(n) => n,
                    None => match block.members.as_slice() {
                        [only] => only.name.clone().ok_or("a buffer member has no name")?,
                        _ => return Err(format!("the unnamed block at binding {desc_bind} has several members")),
                    },
                };
                for member in &block.members {
                    let mut inner = &member.ty;
                    if let Type::Array(a) = inner {
                        inner = &a.element_ty;
                    }
                    if let Type::Struct(s) = inner {
                        collect_struct(s, &mut kernel.structs)?;
                    }
                }
                let number = desc_bind.bind();
                let access = access.get(&number).copied().unwrap_or(Access::Read);
                kernel.bindings.push(Binding { name: name.into(), number, kind, access });
            }
            Variable::PushConstant { ty: Type::Struct(s), .. } => {
                let mut push = layout(&s, &mut kernel.structs)?;
                push.name = "Push".into();
                kernel.push = Some(push);
            }
            Variable::SpecConstant { name, spec_id, ty } => {
                let Some(name) = name.filter(|n| !n.is_empty()) else { continue };
                let Type::Scalar(scalar) = ty else { return Err(format!("constant \"{name}\" is not a scalar")) };
                let ty = match scalar {
                    ScalarType::Boolean => "bool",
                    _ => scalar_name(&scalar)?,
                };
                let default = defaults.iter().find(|d| d.0 == spec_id).map_or(0, |d| d.1);
                let constant = SpecConstant { name: name.into(), id: spec_id, default };
                kernel.specs.push(Spec { constant, ty });
            }
            _ => {}
        }
    }
    kernel.bindings.sort_by_key(|b| b.number);
    kernel.specs.sort_by_key(|s| s.constant.id);
    kernel.specs.dedup_by_key(|s| s.constant.id);
    Ok(kernel)
}

/// Returns the format of a storage image.
fn image_format(ty: &Type) -> Result<ImageFormat, String> {
    let Type::StorageImage(image) = ty else { return Err(format!("{ty} is not a storage image")) };
    if image.dim != spirq::spirv::Dim::Dim2D || image.is_array || image.is_multisampled {
        return Err("an image is not a plain image2D".into());
    }
    use spirq::spirv::ImageFormat as F;
    Ok(match image.fmt {
        F::R32f => ImageFormat::R32Float,
        F::R32ui => ImageFormat::R32Uint,
        F::Rgba8 => ImageFormat::Rgba8Unorm,
        F::Rgba16f => ImageFormat::Rgba16Float,
        F::Rgba32f => ImageFormat::Rgba32Float,
        other => return Err(format!("image format {other:?} has no counterpart on the host")),
    })
}

fn scalar_name(s: &ScalarType) -> Result<&'static str, String> {
    Ok(match s {
        ScalarType::Integer { bits: 32, is_signed: true } => "i32",
        ScalarType::Integer { bits: 32, is_signed: false } => "u32",
        ScalarType::Integer { bits: 64, is_signed: false } => "u64",
        ScalarType::Float { bits: 32 } => "f32",
        other => return Err(format!("{other:?} has no counterpart on the host")),
    })
}

fn collect_struct(s: &StructType, into: &mut Vec<Struct>) -> Result<String, String> {
    let made = layout(s, into)?;
    let name = made.name.clone();
    match into.iter().find(|o| o.name == name) {
        Some(other) if *other != made => return Err(format!("struct \"{name}\" has two layouts")),
        Some(_) => {}
        None => into.push(made),
    }
    Ok(name)
}

fn layout(s: &StructType, into: &mut Vec<Struct>) -> Result<Struct, String> {
    let name = s.name.clone().ok_or("a struct has no name")?;
    let mut fields = Vec::new();
    let mut end = 0;
    for m in &s.members {
        let member = m.name.clone().ok_or("a struct member has no name")?;
        let offset = m.offset.ok_or_else(|| format!("\"{name}.{member}\" has no offset"))?;
        if offset != end {
            return Err(format!("\"{name}.{member}\" is padded to offset {offset}; use scalar layout"));
        }
        let (ty, bytes) = field_type(&m.ty, into)?;
        end += bytes;
        fields.push(Field { name: member, ty, offset });
    }
    Ok(Struct { name, fields, bytes: end })
}

fn field_type(ty: &Type, into: &mut Vec<Struct>) -> Result<(FieldType, usize), String> {
    let array = |t: FieldType, n: usize| FieldType::Array(Box::new(t), n);
    Ok(match ty {
        Type::Scalar(s) => (FieldType::Scalar(scalar_name(s)?), if scalar_name(s)? == "u64" { 8 } else { 4 }),
        Type::Vector(v) => {
            (array(FieldType::Scalar(scalar_name(&v.scalar_ty)?), v.nscalar as usize), 4 * v.nscalar as usize)
        }
        Type::Matrix(m) => {
            let (n, k) = (m.nvector as usize, m.vector_ty.nscalar as usize);
            if m.stride != Some(4 * k) {
                return Err("a matrix has padded columns; use scalar layout".into());
            }
            (array(array(FieldType::Scalar("f32"), k), n), 4 * n * k)
        }
        Type::Array(a) => {
            let (t, bytes) = field_type(&a.element_ty, into)?;
            let n = a.nelement.ok_or("an array in a struct has no length")? as usize;
            (array(t, n), bytes * n)
        }
        Type::Struct(s) => {
            let name = collect_struct(s, into)?;
            let bytes = into.iter().find(|o| o.name == name).map_or(0, |o| o.bytes);
            (FieldType::Struct(name), bytes)
        }
        other => return Err(format!("{other} has no counterpart on the host")),
    })
}

/// Returns the module in a form that spirq can read.
///
/// Constants replace all operations on specialization constants. Spirq evaluates only some of these operations. Their
/// values affect only arrays in shared or private memory, and no layout that the host shares. Spirq does not support
/// cooperative matrices, and no interface contains them. Their types become structs of one component, and their
/// operations are removed.
fn legible(spirv: &[u32]) -> Vec<u32> {
    let mut out = spirv[..spirv.len().min(5)].to_vec();
    let mut bools = Vec::new();
    let mut rest = spirv.get(5..).unwrap_or(&[]);
    while let Some(&head) = rest.first() {
        let length = (head >> 16) as usize;
        if length == 0 || length > rest.len() {
            break;
        }
        let (instruction, tail) = rest.split_at(length);
        rest = tail;
        match head & 0xffff {
            // OpSpecConstantOp becomes OpConstantTrue or OpConstant 1.
            52 if bools.contains(&instruction[1]) => out.extend([(3 << 16) | 41, instruction[1], instruction[2]]),
            52 => out.extend([(4 << 16) | 43, instruction[1], instruction[2], 1]),
            // OpTypeCooperativeMatrixKHR becomes OpTypeStruct. Loads, stores, products and lengths are removed.
            4456 => out.extend([(3 << 16) | 30, instruction[1], instruction[2]]),
            4457..=4460 => {}
            opcode => {
                // OpTypeBool
                if opcode == 20 {
                    bools.push(instruction[1]);
                }
                out.extend_from_slice(instruction);
            }
        }
    }
    out
}

/// Returns `(constant_id, default bits)` of every 32-bit specialization constant.
fn spec_defaults(spirv: &[u32]) -> Vec<(u32, u32)> {
    let mut ids = Vec::new();
    let mut values = Vec::new();
    let mut words = spirv.get(5..).unwrap_or(&[]);
    while let Some(&head) = words.first() {
        let length = (head >> 16) as usize;
        if length == 0 || length > words.len() {
            break;
        }
        match head & 0xffff {
            // OpDecorate SpecId
            71 if length > 3 && words[2] == 1 => ids.push((words[1], words[3])),
            // OpSpecConstantTrue, OpSpecConstantFalse, OpSpecConstant
            48 => values.push((words[2], 1)),
            49 => values.push((words[2], 0)),
            50 => values.push((words[2], words[3])),
            _ => {}
        }
        words = &words[length..];
    }
    let value = |id| values.iter().find(|v| v.0 == id).map_or(0, |v| v.1);
    ids.into_iter().map(|(id, spec)| (spec, value(id))).collect()
}
