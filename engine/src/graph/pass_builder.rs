//! Declaring one pass that runs a kernel.
//!
//! Calls chain and never fail; what was wrong with them is returned, all of it, by the dispatch at the end.

use std::sync::Arc;

use super::builder::{Graph, use_of};
use super::condition::Counts;
use super::error::GraphError;
use super::pass::{Dispatch, INDIRECT_BYTES, Pass, PassKind, Use, writes};
use super::resource::{Buffer, Image, Slice};
use crate::shader::{Access, BindingKind, Shader};

/// Groups along one axis that every Vulkan device can dispatch.
pub const GROUP_LIMIT: u32 = 65_535;

/// A pass under way; see [`Graph::pass`].
#[derive(Debug)]
#[must_use = "a pass is declared by its dispatch"]
pub struct PassBuilder<'g> {
    graph: &'g mut Graph,
    name: String,
    pub(super) shader: Arc<Shader>,
    /// By position in the kernel's bindings: what is bound, and whether its contents are discarded.
    bound: Vec<Option<(Slice, bool)>>,
    specs: Vec<(u32, u32)>,
    push: Vec<u8>,
    subgroup_size: Option<u32>,
    uses_subgroups: bool,
    condition: Option<Slice>,
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
            condition: None,
            errors: Vec::new(),
        }
    }

    /// Binds a buffer, or a slice of one, to the kernel's binding of that name.
    pub fn bind(self, name: &str, slice: impl Into<Slice>) -> Self {
        self.bind_as(name, slice.into(), false)
    }

    /// Binds, and promises that the pass overwrites all of the slice that anyone will read: what it held before need
    /// not be computed.
    pub fn bind_discard(self, name: &str, slice: impl Into<Slice>) -> Self {
        self.bind_as(name, slice.into(), true)
    }

    /// Binds several.
    pub fn bind_all(self, bindings: impl IntoIterator<Item = (&'static str, Slice)>) -> Self {
        bindings.into_iter().fold(self, |pass, (name, slice)| pass.bind(name, slice))
    }

    /// Binds an image to the kernel's binding of that name.
    pub fn bind_image(self, name: &str, image: Image) -> Self {
        self.bind_image_as(name, image, false)
    }

    /// Binds an image, and promises that the pass overwrites all of it that anyone will read.
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

    /// Refuses buffers where the kernel wants an image, images where it wants a buffer, and images of other formats.
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

    /// Gives a specialization constant its value, as raw bits.
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

    /// Gives the push constants.
    pub fn push(mut self, bytes: &[u8]) -> Self {
        self.push = bytes.to_vec();
        self
    }

    /// Requests a subgroup size; without a request, the pass runs at the device's default size. A kernel that uses subgroups and
    /// has a constant `SUBGROUP` must request the size that this constant has.
    pub fn subgroup_size(mut self, size: Option<u32>) -> Self {
        if let Some(size) = size.filter(|size| !size.is_power_of_two() || *size > 128) {
            self.errors.push(GraphError::SubgroupSize { pass: self.name.clone(), size });
        }
        self.subgroup_size = size;
        self
    }

    /// Promises that the specialized kernel executes no subgroup operation, so that its constant `SUBGROUP` is free.
    pub fn without_subgroups(mut self) -> Self {
        self.uses_subgroups = false;
        self
    }

    /// Lets the pass run only if a 32-bit word is not zero when its turn comes: a word that earlier passes wrote, or a
    /// switch of the host. A pass that may not run promises nothing, so discards are taken as plain bindings. Needs
    /// [`Graph::set_gate`]; a pass has one condition, the last given.
    pub fn when(mut self, word: impl Into<Slice>) -> Self {
        match self.graph.resolve_word(&self.name, word.into()) {
            Ok(word) => self.condition = Some(word),
            Err(error) => self.errors.push(error),
        }
        self
    }

    /// Declares the pass that writes the group counts of this one, and says where they are.
    fn gated(&mut self, word: Slice, counts: Counts) -> Option<(Buffer, u64)> {
        match self.graph.gated(&self.name, word, counts) {
            Ok(arguments) => Some((arguments, 0)),
            Err(error) => {
                self.errors.push(error);
                None
            }
        }
    }

    /// Declares the pass with a fixed number of groups.
    pub fn dispatch(mut self, groups: [u32; 3]) -> Result<(), GraphError> {
        for (axis, count) in ['x', 'y', 'z'].into_iter().zip(groups) {
            if count > GROUP_LIMIT {
                self.errors.push(GraphError::GroupCount { pass: self.name.clone(), axis, count, limit: GROUP_LIMIT });
            }
        }
        if let Some(word) = self.condition {
            let arguments = self.gated(word, Counts::Fixed(groups));
            return self.indirect(arguments);
        }
        self.declare(Dispatch::Groups(groups), None)
    }

    /// Declares the pass with the number of groups that three 32-bit numbers in a buffer will say.
    pub fn dispatch_indirect(mut self, buffer: Buffer, offset: u64) -> Result<(), GraphError> {
        let Some(word) = self.condition else { return self.indirect(Some((buffer, offset))) };
        let arguments = match self.check_indirect(buffer, offset) {
            Ok(counts) => self.gated(word, Counts::Found(counts)),
            Err(error) => {
                self.errors.push(error);
                None
            }
        };
        self.indirect(arguments)
    }

    /// Declares the pass with group counts in a buffer, if they could be found.
    fn indirect(mut self, counts: Option<(Buffer, u64)>) -> Result<(), GraphError> {
        let Some((buffer, offset)) = counts else { return self.declare(Dispatch::Groups([0; 3]), None) };
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

    /// Checks that the size the kernel is specialized for is the one it runs at.
    fn check_subgroup_constant(&mut self) {
        let Some(spec) = self.shader.specs.iter().find(|s| s.name == "SUBGROUP") else { return };
        let given = self.specs.binary_search_by_key(&spec.id, |&(id, _)| id).ok();
        let constant = given.map_or(spec.default, |at| self.specs[at].1);
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
                given: self.push.len(),
                expected: shader.push_bytes,
            });
        }
        self.check_subgroup_constant();
        // What is touched, under which name, and whether the contents are discarded.
        let mut touched: Vec<(&str, Slice, Access, Use, bool)> = Vec::new();
        let mut bindings = Vec::with_capacity(shader.bindings.len());
        for (binding, bound) in shader.bindings.iter().zip(&self.bound) {
            if let Some((slice, discard)) = *bound {
                let discard = discard && self.condition.is_none();
                touched.push((&binding.name, slice, binding.access, use_of(binding.kind), discard));
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
            touched.push(("group counts", slice, Access::Read, Use::Indirect, false));
        }
        for (i, (second, slice, access, ..)) in touched.iter().enumerate() {
            for (first, other, before, ..) in &touched[..i] {
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
        let when = self.condition.map(|word| self.graph.condition(word));
        for (_, slice, access, _, discard) in &touched {
            if *access != Access::Write && !discard {
                self.errors.extend(self.graph.check_written(&self.name, slice, when).err());
            }
        }
        GraphError::collect(self.errors)?;
        self.graph.finish(Pass {
            name: self.name,
            condition: self.condition,
            accesses: touched.iter().map(|&(_, slice, access, used, _)| (slice, access, used)).collect(),
            discards: touched.iter().filter(|t| t.4).map(|t| t.1).collect(),
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

/// Whether an error already says why a binding is not bound; a second complaint would only distract.
fn failed_to_bind(error: &GraphError, name: &str) -> bool {
    match error {
        GraphError::DiscardOfRead { binding, .. }
        | GraphError::BindingKind { binding, .. }
        | GraphError::ImageFormat { binding, .. } => binding == name,
        GraphError::WriteToReadOnly { through, .. } => through == name,
        // These do not say which binding they were about.
        GraphError::UnknownBuffer { .. } | GraphError::EmptySlice { .. } | GraphError::SliceRange { .. } => true,
        GraphError::ImageAsBuffer { .. } | GraphError::BufferAsImage { .. } => true,
        _ => false,
    }
}

fn list<'a>(names: impl Iterator<Item = &'a str>) -> String {
    names.collect::<Vec<_>>().join(", ")
}
