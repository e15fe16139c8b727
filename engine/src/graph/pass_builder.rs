//! Declaration of one pass that runs a kernel.
//!
//! Calls chain and never fail; the final dispatch returns all their errors.

use std::sync::Arc;

use super::builder::{Graph, use_of};
use super::error::GraphError;
use super::pass::{Dispatch, INDIRECT_BYTES, Pass, PassKind, Use, writes};
use super::resource::{Buffer, Image, Slice};
use crate::shader::{Access, BindingKind, Shader};

/// Maximum groups along an axis that every Vulkan device supports.
pub const GROUP_LIMIT: u32 = 65_535;

/// Pass under construction; see [`Graph::pass`].
#[derive(Debug)]
#[must_use = "a pass is declared by its dispatch"]
pub struct PassBuilder<'g> {
    graph: &'g mut Graph,
    name: String,
    pub(super) shader: Arc<Shader>,
    /// By position in the kernel's bindings: bound slice, and whether its contents are discarded.
    bound: Vec<Option<(Slice, bool)>>,
    specs: Vec<(u32, u32)>,
    push: Vec<u8>,
    subgroup_size: Option<u32>,
    uses_subgroups: bool,
    errors: Vec<GraphError>,
}

impl<'g> PassBuilder<'g> {
    pub(super) fn new(graph: &'g mut Graph, name: String, shader: Arc<Shader>) -> Self {
        let uses_subgroups = shader.uses_subgroups();
        let bound = vec![None; shader.bindings.len()];
        PassBuilder {
            graph,
            name,
            shader,
            bound,
            specs: Vec::new(),
            push: Vec::new(),
            subgroup_size: None,
            uses_subgroups,
            errors: Vec::new(),
        }
    }

    /// Binds a buffer, or a slice of one, to a named binding of the kernel.
    pub fn bind(self, name: &str, slice: impl Into<Slice>) -> Self {
        self.bind_as(name, slice.into(), false)
    }

    /// Binds a slice whose earlier contents need not be computed. The caller promises that the pass overwrites all of
    /// the slice that is read later.
    pub fn bind_discard(self, name: &str, slice: impl Into<Slice>) -> Self {
        self.bind_as(name, slice.into(), true)
    }

    /// Binds several slices.
    pub fn bind_all(self, bindings: impl IntoIterator<Item = (&'static str, Slice)>) -> Self {
        bindings.into_iter().fold(self, |pass, (name, slice)| pass.bind(name, slice))
    }

    /// Binds an image to a named binding of the kernel.
    pub fn bind_image(self, name: &str, image: Image) -> Self {
        self.bind_image_as(name, image, false)
    }

    /// Binds an image whose earlier contents need not be computed. The caller promises that the pass overwrites all of
    /// the image that is read later.
    pub fn bind_image_discard(self, name: &str, image: Image) -> Self {
        self.bind_image_as(name, image, true)
    }

    fn bind_image_as(mut self, name: &str, image: Image, discard: bool) -> Self {
        let bound = self.graph.resolve_image(&self.name, image).and_then(|slice| self.try_bind(name, slice, discard));
        self.errors.extend(bound.err());
        self
    }

    fn bind_as(mut self, name: &str, slice: Slice, discard: bool) -> Self {
        let bound = self.graph.resolve(&self.name, slice).and_then(|slice| self.try_bind(name, slice, discard));
        self.errors.extend(bound.err());
        self
    }

    /// Rejects a binding of the wrong kind or format: buffers bound as images, images bound as buffers, and images of
    /// another format.
    fn check_kind(&self, name: &str, kind: BindingKind, slice: &Slice) -> Result<(), GraphError> {
        let info = &self.graph.buffers[slice.buffer.index()];
        let declared = match (kind, &info.image) {
            (BindingKind::Image(declared), Some(image)) if image.format != declared => {
                return Err(GraphError::ImageFormat {
                    pass: self.name.clone(),
                    image: info.name.clone(),
                    binding: name.to_owned(),
                    format: image.format,
                    declared,
                });
            }
            (BindingKind::Image(_), Some(_)) | (BindingKind::Storage | BindingKind::Uniform, None) => return Ok(()),
            (BindingKind::Image(_), None) => "an image",
            (BindingKind::Storage | BindingKind::Uniform, Some(_)) => "a buffer",
        };
        let (pass, resource) = (self.name.clone(), info.name.clone());
        Err(GraphError::BindingKind { pass, resource, binding: name.to_owned(), declared })
    }

    fn try_bind(&mut self, name: &str, slice: Slice, discard: bool) -> Result<(), GraphError> {
        let Some(position) = self.shader.bindings.iter().position(|b| b.name == name) else {
            return Err(GraphError::UnknownBinding {
                pass: self.name.clone(),
                shader: self.shader.name.to_string(),
                binding: name.to_owned(),
                known: list(self.shader.bindings.iter().map(|b| b.name.as_ref())),
            });
        };
        self.check_kind(name, self.shader.bindings[position].kind, &slice)?;
        let access = self.shader.bindings[position].access;
        if writes(access) {
            self.graph.check_write(&self.name, slice.buffer, name)?;
        }
        if discard && !matches!(access, Access::Write | Access::ReadWrite) {
            return Err(GraphError::DiscardOfRead { pass: self.name.clone(), binding: name.to_owned(), access });
        }
        if let Some((first, _)) = self.bound[position] {
            return Err(GraphError::BoundTwice {
                pass: self.name.clone(),
                binding: name.to_owned(),
                first: self.graph.buffers[first.buffer.index()].name.clone(),
                second: self.graph.buffers[slice.buffer.index()].name.clone(),
            });
        }
        self.bound[position] = Some((slice, discard));
        Ok(())
    }

    /// Sets a specialization constant, as raw bits.
    pub fn spec(mut self, name: &str, bits: u32) -> Self {
        let found = self.shader.specs.iter().find(|s| s.name == name).map(|s| s.id);
        match found {
            None => self.errors.push(GraphError::UnknownSpec {
                pass: self.name.clone(),
                shader: self.shader.name.to_string(),
                spec: name.to_owned(),
                known: list(self.shader.specs.iter().map(|s| s.name.as_ref())),
            }),
            Some(id) => match self.specs.binary_search_by_key(&id, |&(id, _)| id) {
                Ok(at) => self.errors.push(GraphError::SpecTwice {
                    pass: self.name.clone(),
                    spec: name.to_owned(),
                    first: self.specs[at].1,
                    second: bits,
                }),
                Err(at) => self.specs.insert(at, (id, bits)),
            },
        }
        self
    }

    /// Sets the push constants.
    pub fn push(mut self, bytes: &[u8]) -> Self {
        self.push = bytes.to_vec();
        self
    }

    /// Requests a subgroup size; `None` selects the device's default.
    ///
    /// A kernel that uses subgroups and has a constant `SUBGROUP` must request the value of that constant.
    pub fn subgroup_size(mut self, size: Option<u32>) -> Self {
        if let Some(size) = size.filter(|size| !size.is_power_of_two() || *size > 128) {
            self.errors.push(GraphError::SubgroupSize { pass: self.name.clone(), size });
        }
        self.subgroup_size = size;
        self
    }

    /// Promises that the specialized kernel executes no subgroup operation. Its constant `SUBGROUP` is then free.
    pub fn without_subgroups(mut self) -> Self {
        self.uses_subgroups = false;
        self
    }

    /// Declares the pass with constant group counts.
    pub fn dispatch(mut self, groups: [u32; 3]) -> Result<(), GraphError> {
        for (axis, count) in ['x', 'y', 'z'].into_iter().zip(groups) {
            if count > GROUP_LIMIT {
                self.errors.push(GraphError::GroupCount { pass: self.name.clone(), axis, count, limit: GROUP_LIMIT });
            }
        }
        self.declare(Dispatch::Groups(groups), None)
    }

    /// Declares the pass with group counts from three 32-bit numbers in a buffer.
    pub fn dispatch_indirect(mut self, buffer: Buffer, offset: u64) -> Result<(), GraphError> {
        let arguments = match self.check_indirect(buffer, offset) {
            Ok(slice) => Some(slice),
            Err(error) => {
                self.errors.push(error);
                None
            }
        };
        self.declare(Dispatch::Indirect { buffer, offset }, arguments)
    }

    fn check_indirect(&self, buffer: Buffer, offset: u64) -> Result<Slice, GraphError> {
        let slice = self.graph.resolve(&self.name, buffer.slice(offset, INDIRECT_BYTES))?;
        self.graph.check_not_uniform(&self.name, buffer, "its group counts")?;
        if !offset.is_multiple_of(4) {
            let name = self.graph.buffers[buffer.index()].name.clone();
            return Err(GraphError::IndirectAlignment { pass: self.name.clone(), buffer: name, offset });
        }
        Ok(slice)
    }

    /// Checks that the requested subgroup size equals the specialized one.
    fn check_subgroup_constant(&mut self) {
        let Some(spec) = self.shader.specs.iter().find(|s| s.name == "SUBGROUP") else { return };
        let specified = self.specs.binary_search_by_key(&spec.id, |&(id, _)| id).ok();
        let constant = specified.map_or(spec.default, |at| self.specs[at].1);
        if self.subgroup_size != Some(constant) && self.uses_subgroups {
            self.errors.push(GraphError::SubgroupConstant {
                pass: self.name.clone(),
                shader: self.shader.name.to_string(),
                constant,
                requested: self.subgroup_size,
            });
        }
    }

    fn declare(mut self, dispatch: Dispatch, arguments: Option<Slice>) -> Result<(), GraphError> {
        let shader = Arc::clone(&self.shader);
        if self.push.len() != shader.push_bytes as usize {
            self.errors.push(GraphError::PushSize {
                pass: self.name.clone(),
                shader: shader.name.to_string(),
                provided: self.push.len(),
                expected: shader.push_bytes,
            });
        }
        self.check_subgroup_constant();
        // Name, slice, access, use, and whether the contents are discarded.
        let mut all_accesses: Vec<(&str, Slice, Access, Use, bool)> = Vec::new();
        let mut bindings = Vec::with_capacity(shader.bindings.len());
        for (binding, bound) in shader.bindings.iter().zip(&self.bound) {
            if let Some((slice, discard)) = *bound {
                all_accesses.push((&binding.name, slice, binding.access, use_of(binding.kind), discard));
                bindings.push((binding.number, slice));
            } else if !self.errors.iter().any(|e| failed_to_bind(e, &binding.name)) {
                self.errors.push(GraphError::Unbound {
                    pass: self.name.clone(),
                    shader: shader.name.to_string(),
                    binding: binding.name.to_string(),
                });
            }
        }
        if let Some(slice) = arguments {
            all_accesses.push(("group counts", slice, Access::Read, Use::Indirect, false));
        }
        for (i, (second, slice, access, ..)) in all_accesses.iter().enumerate() {
            for (first, other, before, ..) in &all_accesses[..i] {
                if slice.overlaps(other) && (writes(*access) || writes(*before)) {
                    self.errors.push(GraphError::Overlap {
                        pass: self.name.clone(),
                        buffer: self.graph.buffers[slice.buffer.index()].name.clone(),
                        first: (*first).to_owned(),
                        second: (*second).to_owned(),
                    });
                }
            }
        }
        for (_, slice, access, _, discard) in &all_accesses {
            if *access != Access::Write && !discard {
                self.errors.extend(self.graph.check_written(&self.name, slice).err());
            }
        }
        GraphError::collect(self.errors)?;
        self.graph.finish(Pass {
            name: self.name,
            accesses: all_accesses.iter().map(|&(_, slice, access, used, _)| (slice, access, used)).collect(),
            discards: all_accesses.iter().filter(|t| t.4).map(|t| t.1).collect(),
            kind: PassKind::Compute {
                shader: self.shader,
                specs: self.specs,
                push: self.push,
                bindings,
                subgroup_size: self.subgroup_size,
                dispatch,
            },
        })
    }
}

/// Returns whether an error already explains an unbound binding. A second error would then be redundant.
fn failed_to_bind(error: &GraphError, name: &str) -> bool {
    match error {
        GraphError::DiscardOfRead { binding, .. }
        | GraphError::BindingKind { binding, .. }
        | GraphError::ImageFormat { binding, .. } => binding == name,
        GraphError::WriteToReadOnly { through, .. } => through == name,
        // These do not name their binding.
        GraphError::UnknownBuffer { .. } | GraphError::EmptySlice { .. } | GraphError::SliceRange { .. } => true,
        GraphError::ImageAsBuffer { .. } | GraphError::BufferAsImage { .. } => true,
        _ => false,
    }
}

fn list<'a>(names: impl Iterator<Item = &'a str>) -> String {
    names.collect::<Vec<_>>().join(", ")
}
