//! Graphs built apart, joined into one: a forward pass, its backward pass, an optimizer, each in a file of its own.
//!
//! The passes of the other graph come after those declared so far. Its buffers become buffers of this graph, or are taken
//! for buffers that this graph has; nothing is copied, neither when joining nor when replaying.

use super::builder::Graph;
use super::error::GraphError;
use super::pass::{Dispatch, PassKind, Use, writes};
use super::resource::{Buffer, BufferInfo, BufferKind, Image, Slice};
use crate::shader::Access;

/// What the buffers of a joined graph are called in the graph that took it.
#[derive(Clone, Debug)]
pub struct Joined {
    buffers: Vec<Buffer>,
}

impl Joined {
    /// A buffer of the joined graph.
    ///
    /// # Panics
    /// Never for a buffer of that graph.
    pub fn buffer(&self, theirs: Buffer) -> Buffer {
        self.buffers[theirs.index()]
    }

    /// An image of the joined graph.
    pub fn image(&self, theirs: Image) -> Image {
        Image(self.buffer(theirs.0))
    }

    fn slice(&self, theirs: Slice) -> Slice {
        Slice { buffer: self.buffer(theirs.buffer), ..theirs }
    }
}

impl Graph {
    /// Appends the passes of another graph. Each pair of `mapping` takes an external buffer, an input or a uniform of the
    /// other graph (images as [`Buffer`]s too) for a buffer of this one, whatever its kind; what it declares of others on
    /// the queue is then forgotten. The remaining buffers are taken over as they are.
    ///
    /// # Errors
    /// If a pair does not fit, or a pass of the other graph does what it may not do to a buffer of this one. The graph
    /// cannot be compiled then.
    pub fn join(&mut self, other: Graph, mapping: &[(Buffer, Buffer)]) -> Result<Joined, GraphError> {
        let name = other.name.clone();
        self.begin(&name);
        let joined = self.take_buffers(&name, &other, mapping)?;
        self.errors.extend(other.errors);
        if let Some(pass) = other.open {
            self.errors.push(GraphError::Unfinished { graph: name.clone(), pass });
        }
        self.gate = self.gate.take().or(other.gate);
        self.costs.extend(other.costs);
        for mut pass in other.passes {
            let move_to = |slice: &mut Slice| *slice = joined.slice(*slice);
            pass.accesses.iter_mut().for_each(|(slice, ..)| move_to(slice));
            pass.discards.iter_mut().chain(&mut pass.condition).for_each(move_to);
            match &mut pass.kind {
                PassKind::Compute { bindings, dispatch, .. } => {
                    bindings.iter_mut().for_each(|(_, slice)| move_to(slice));
                    if let Dispatch::Indirect { buffer, .. } = dispatch {
                        *buffer = joined.buffer(*buffer);
                    }
                }
                PassKind::Fill { target, .. } => move_to(target),
                PassKind::Copy { source, target } => {
                    move_to(source);
                    move_to(target);
                }
                PassKind::CopyToImage { source, target } => {
                    move_to(source);
                    *target = joined.image(*target);
                }
                PassKind::CopyFromImage { source, target } => {
                    *source = joined.image(*source);
                    move_to(target);
                }
                PassKind::ClearImage { target, .. } => *target = joined.image(*target),
            }
            self.check_moved(&pass)?;
            self.finish(pass)?;
            self.open = Some(name.clone());
        }
        self.open = None;
        Ok(joined)
    }

    /// Numbers the buffers of another graph.
    fn take_buffers(&mut self, name: &str, other: &Graph, mapping: &[(Buffer, Buffer)]) -> Result<Joined, GraphError> {
        let mut buffers: Vec<Option<Buffer>> = vec![None; other.buffers.len()];
        for &(theirs, ours) in mapping {
            let Some(their) = other.buffers.get(theirs.index()) else { return Err(other.unknown("join", theirs)) };
            let Some(our) = self.buffers.get(ours.index()) else { return Err(self.unknown("join", ours)) };
            let wrong = |why| {
                let (theirs, ours) = (their.name.clone(), our.name.clone());
                Err(GraphError::Join { graph: name.to_owned(), theirs, ours, why })
            };
            let make = |info: &BufferInfo| info.image.map(|image| (image.size, image.format));
            match their.kind {
                BufferKind::Transient => return wrong("is a transient"),
                BufferKind::History => return wrong("belongs to a history"),
                BufferKind::External | BufferKind::Uniform => {}
            }
            if make(their) != make(our) {
                return wrong("is of another size and format");
            }
            if their.bytes > our.bytes {
                return wrong("is larger");
            }
            if their.switch != our.switch {
                return wrong("only one of them is a switch");
            }
            if buffers[theirs.index()].replace(ours).is_some() {
                return wrong("is taken for two buffers");
            }
        }
        let first = self.buffers.len();
        let mut joined = Joined { buffers: Vec::with_capacity(buffers.len()) };
        for (info, mapped) in other.buffers.iter().zip(&buffers) {
            joined.buffers.push(match mapped {
                Some(buffer) => *buffer,
                None => {
                    let buffer = self.declare(info.name.clone(), info.bytes.max(1), info.kind, info.keep);
                    self.buffers[buffer.index()] = info.clone();
                    self.written[buffer.index()] = other.fresh(info);
                    buffer
                }
            });
        }
        for info in &mut self.buffers[first..] {
            if let Some(pair) = &mut info.pair {
                pair.partner = joined.buffer(pair.partner);
            }
        }
        Ok(joined)
    }

    /// Checks again what depends on which buffers a pass touches.
    fn check_moved(&self, pass: &super::pass::Pass) -> Result<(), GraphError> {
        let when = pass.condition.map(|word| self.condition(word));
        for (at, (slice, access, used)) in pass.accesses.iter().enumerate() {
            if writes(*access) {
                self.check_write(&pass.name, slice.buffer, "join")?;
            }
            if matches!(used, Use::Transfer | Use::Indirect) {
                self.check_not_uniform(&pass.name, slice.buffer, "more than a kernel's binding")?;
            }
            if *access != Access::Write && !pass.discards(slice) {
                self.check_written(&pass.name, slice, when)?;
            }
            for (other, before, _) in &pass.accesses[..at] {
                if slice.overlaps(other) && (writes(*access) || writes(*before)) {
                    let buffer = self.buffers[slice.buffer.index()].name.clone();
                    let (first, second) = ("one".into(), "another".into());
                    return Err(GraphError::Overlap { pass: pass.name.clone(), buffer, first, second });
                }
            }
        }
        Ok(())
    }
}
