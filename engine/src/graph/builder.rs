//! Declaration of a graph: its buffers, and its passes in data-flow order.
//!
//! Promises that every accepted declaration is valid: slices lie in their buffers, every binding is bound, no
//! read-only buffer is written, and no transient is read before it is written. The compiler ([`super::plan`])
//! optimizes.

use std::sync::Arc;

use super::error::GraphError;
use super::pass::{Pass, PassKind, Use, writes};
use super::pass_builder::PassBuilder;
use super::plan::{self, CompileOptions, Plan};
use super::ranges::RangeMap;
use super::resource::{Buffer, BufferInfo, BufferKind, BufferState, Slice};
use crate::shader::{Access, BindingKind, Shader};

/// Frame graph under construction.
#[derive(Clone, Debug)]
pub struct Graph {
    pub(super) name: String,
    /// Prefix of the names of transients and passes.
    prefix: String,
    pub(super) buffers: Vec<BufferInfo>,
    pub(super) passes: Vec<Pass>,
    /// By buffer: bytes that passes write, for a transient or an image with undefined contents. `None` for others.
    pub(super) written: Vec<Option<RangeMap<bool>>>,
    /// Errors of calls that return no result.
    pub(super) errors: Vec<GraphError>,
    /// Pass that was begun and is not finished.
    pub(super) open: Option<String>,
}

impl Graph {
    /// Creates an empty graph.
    pub fn new(name: impl Into<String>) -> Self {
        Graph {
            name: name.into(),
            prefix: String::new(),
            buffers: Vec::new(),
            passes: Vec::new(),
            written: Vec::new(),
            errors: Vec::new(),
            open: None,
        }
    }

    /// Declares a buffer that is bound at replay and persists. Writes to it are outputs.
    pub fn external(&mut self, name: impl Into<String>, bytes: u64) -> Buffer {
        self.declare(name.into(), bytes, BufferKind::External, true)
    }

    /// Declares a buffer that is bound at replay and that no pass may write.
    pub fn input(&mut self, name: impl Into<String>, bytes: u64) -> Buffer {
        self.declare(name.into(), bytes, BufferKind::External, false)
    }

    /// Declares a small buffer that the host writes before each replay; no pass may write it.
    pub fn uniform(&mut self, name: impl Into<String>, bytes: u64) -> Buffer {
        self.declare(name.into(), bytes, BufferKind::Uniform, false)
    }

    /// Declares a buffer that exists only within a replay. Its initial contents are undefined.
    pub fn transient(&mut self, name: impl Into<String>, bytes: u64) -> Buffer {
        self.declare(self.prefixed(name), bytes, BufferKind::Transient, false)
    }

    pub(super) fn declare(&mut self, name: String, bytes: u64, kind: BufferKind, keep: bool) -> Buffer {
        if bytes == 0 {
            self.errors.push(GraphError::EmptyBuffer { buffer: name.clone() });
        }
        let buffer = Buffer(u32::try_from(self.buffers.len()).expect("invariant: fewer than 2^32 buffers"));
        self.written.push((kind == BufferKind::Transient).then(|| RangeMap::new(bytes, false)));
        let state = BufferState::Ready;
        self.buffers.push(BufferInfo { name, bytes, kind, keep, entry: state, exit: state, image: None });
        buffer
    }

    /// Declares which users access an external buffer before and after a replay.
    pub fn shared(&mut self, buffer: Buffer, entry: BufferState, exit: BufferState) {
        match self.buffers.get_mut(buffer.index()) {
            Some(info) if info.kind == BufferKind::External && info.image.is_none() => {
                (info.entry, info.exit) = (entry, exit);
            }
            Some(info) => {
                let error = GraphError::NotShared { buffer: info.name.clone() };
                self.errors.push(error);
            }
            None => {
                let error = self.unknown_buffer("shared", buffer);
                self.errors.push(error);
            }
        }
    }

    /// Preserves a transient until the next replay of a plan in the same arena.
    pub fn keep(&mut self, buffer: Buffer) {
        match self.buffers.get_mut(buffer.index()) {
            Some(info) if info.writable() => info.keep = true,
            Some(info) => {
                let error = GraphError::KeepReadOnly { buffer: info.name.clone(), kind: read_only(info) };
                self.errors.push(error);
            }
            None => {
                let error = self.unknown_buffer("keep", buffer);
                self.errors.push(error);
            }
        }
    }

    /// Sets the name prefix of transients and passes declared from now on. Distinguishes repeated stages. Empty for
    /// none.
    pub fn set_prefix(&mut self, prefix: impl Into<String>) {
        self.prefix = prefix.into();
    }

    pub(super) fn prefixed(&self, name: impl Into<String>) -> String {
        if self.prefix.is_empty() { name.into() } else { format!("{}{}", self.prefix, name.into()) }
    }

    /// Begins a pass that runs a kernel. [`PassBuilder::dispatch`] declares it if it returns no error.
    pub fn pass(&mut self, name: impl Into<String>, shader: &Arc<Shader>) -> PassBuilder<'_> {
        let name = self.prefixed(name);
        self.begin(&name);
        PassBuilder::new(self, name, Arc::clone(shader))
    }

    /// Declares a pass that fills a range with a 32-bit `value`.
    pub fn fill(&mut self, name: impl Into<String>, target: impl Into<Slice>, value: u32) -> Result<(), GraphError> {
        let name = self.prefixed(name);
        self.begin(&name);
        let target = self.resolve(&name, target.into())?;
        self.check_write(&name, target.buffer, "fill")?;
        if !(target.offset.is_multiple_of(4) && target.bytes.is_multiple_of(4)) {
            let buffer = self.buffers[target.buffer.index()].name.clone();
            return Err(GraphError::FillAlignment { pass: name, buffer, offset: target.offset, bytes: target.bytes });
        }
        self.finish(Pass {
            name,
            kind: PassKind::Fill { target, value },
            accesses: vec![(target, Access::Write, Use::Transfer)],
            discards: vec![target],
        })
    }

    /// Declares a pass that copies a range to another of equal length.
    pub fn copy(
        &mut self,
        name: impl Into<String>,
        source: impl Into<Slice>,
        target: impl Into<Slice>,
    ) -> Result<(), GraphError> {
        let name = self.prefixed(name);
        self.begin(&name);
        let source = self.resolve(&name, source.into())?;
        let target = self.resolve(&name, target.into())?;
        self.check_not_uniform(&name, source.buffer, "the source of a copy")?;
        self.check_write(&name, target.buffer, "copy")?;
        if source.bytes != target.bytes {
            return Err(GraphError::CopySize {
                pass: name,
                from: self.buffers[source.buffer.index()].name.clone(),
                source_bytes: source.bytes,
                to: self.buffers[target.buffer.index()].name.clone(),
                target_bytes: target.bytes,
            });
        }
        if source.overlaps(&target) {
            let buffer = self.buffers[source.buffer.index()].name.clone();
            return Err(GraphError::Overlap { pass: name, buffer, first: "source".into(), second: "target".into() });
        }
        self.check_written(&name, &source)?;
        self.finish(Pass {
            name,
            kind: PassKind::Copy { source, target },
            accesses: vec![(source, Access::Read, Use::Transfer), (target, Access::Write, Use::Transfer)],
            discards: vec![target],
        })
    }

    /// Compiles the declaration into a plan.
    pub fn compile(mut self, options: &CompileOptions) -> Result<Plan, GraphError> {
        let graph = self.name.clone();
        if let Some(pass) = self.open.take() {
            self.errors.push(GraphError::Unfinished { graph: graph.clone(), pass });
        }
        if options.alignment.is_power_of_two() {
            self.check_alignment(options.alignment);
        } else {
            self.errors.push(GraphError::BadAlignment { graph: graph.clone(), alignment: options.alignment });
        }
        GraphError::collect(std::mem::take(&mut self.errors))?;
        let plan = plan::compile(self, options);
        if options.verify {
            plan::verify::verify(&plan).map_err(|error| GraphError::Verify { graph, error: Box::new(error) })?;
        }
        Ok(plan)
    }

    /// Collects bound slices with misaligned offsets.
    fn check_alignment(&mut self, alignment: u64) {
        for pass in &self.passes {
            let PassKind::Compute { shader, bindings, .. } = &pass.kind else { continue };
            for (binding, (_, slice)) in shader.bindings.iter().zip(bindings) {
                // Images are bound as a whole, at offset 0.
                if !slice.offset.is_multiple_of(alignment) {
                    self.errors.push(GraphError::SliceAlignment {
                        pass: pass.name.clone(),
                        buffer: self.buffers[slice.buffer.index()].name.clone(),
                        binding: binding.name.to_string(),
                        offset: slice.offset,
                        alignment,
                    });
                }
            }
        }
    }

    /// Opens a pass. The graph does not compile until [`Graph::finish`] closes it.
    pub(super) fn begin(&mut self, name: &str) {
        if let Some(pass) = self.open.replace(name.to_owned()) {
            self.errors.push(GraphError::Unfinished { graph: self.name.clone(), pass });
        }
    }

    /// Adds a pass that has passed all checks.
    pub(super) fn finish(&mut self, pass: Pass) -> Result<(), GraphError> {
        for (slice, ..) in pass.accesses.iter().filter(|(_, access, _)| writes(*access)) {
            if let Some(written) = &mut self.written[slice.buffer.index()] {
                written.set(slice.range(), true);
            }
        }
        self.passes.push(pass);
        self.open = None;
        Ok(())
    }

    /// Checks a slice and resolves its length.
    pub(super) fn resolve(&self, pass: &str, mut slice: Slice) -> Result<Slice, GraphError> {
        let Some(info) = self.buffers.get(slice.buffer.index()) else {
            return Err(self.unknown_buffer(pass, slice.buffer));
        };
        if info.image.is_some() {
            return Err(GraphError::ImageAsBuffer { pass: pass.to_owned(), image: info.name.clone() });
        }
        let Slice { offset, .. } = slice;
        if slice.bytes == Slice::WHOLE {
            slice.bytes = info.bytes.saturating_sub(offset);
        }
        let bytes = slice.bytes;
        let (pass, buffer) = (pass.to_owned(), info.name.clone());
        if offset.checked_add(bytes).is_none_or(|end| end > info.bytes) {
            return Err(GraphError::SliceRange { pass, buffer, offset, bytes, size: info.bytes });
        }
        if bytes == 0 {
            return Err(GraphError::EmptySlice { pass, buffer, offset });
        }
        Ok(slice)
    }

    pub(super) fn check_write(&self, pass: &str, buffer: Buffer, through: &str) -> Result<(), GraphError> {
        let info = &self.buffers[buffer.index()];
        if info.writable() {
            return Ok(());
        }
        Err(GraphError::WriteToReadOnly {
            pass: pass.to_owned(),
            buffer: info.name.clone(),
            through: through.to_owned(),
            kind: read_only(info),
        })
    }

    pub(super) fn check_not_uniform(&self, pass: &str, buffer: Buffer, role: &'static str) -> Result<(), GraphError> {
        let info = &self.buffers[buffer.index()];
        if info.kind != BufferKind::Uniform {
            return Ok(());
        }
        Err(GraphError::UniformMisused { pass: pass.to_owned(), buffer: info.name.clone(), role })
    }

    /// Rejects reads of a transient range that no earlier pass has written.
    ///
    /// One written byte suffices: a buffer bound as a whole may have gaps and slack.
    pub(super) fn check_written(&self, pass: &str, slice: &Slice) -> Result<(), GraphError> {
        match &self.written[slice.buffer.index()] {
            Some(written) if !written.any(slice.range(), |&written| written) => Err(GraphError::Unwritten {
                pass: pass.to_owned(),
                buffer: self.buffers[slice.buffer.index()].name.clone(),
                offset: slice.offset,
                bytes: slice.bytes,
            }),
            _ => Ok(()),
        }
    }

    pub(super) fn unknown_buffer(&self, pass: &str, buffer: Buffer) -> GraphError {
        GraphError::UnknownBuffer { pass: pass.to_owned(), index: buffer.0, count: self.buffers.len() }
    }
}

/// Describes a read-only buffer in messages.
fn read_only(info: &BufferInfo) -> &'static str {
    match info.kind {
        BufferKind::Uniform => "a uniform",
        BufferKind::External | BufferKind::Transient => "a read-only input",
    }
}

/// Returns how a kernel uses a binding of this kind.
pub(super) fn use_of(kind: BindingKind) -> Use {
    match kind {
        BindingKind::Storage | BindingKind::Image(_) => Use::Compute,
        BindingKind::Uniform => Use::Uniform,
    }
}
