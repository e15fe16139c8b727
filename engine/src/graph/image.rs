//! Declaration of images and of passes that only move texels.
//!
//! An image is accessed as a whole. As with buffers, a pass that writes some texels is assumed to preserve the
//! others. Between passes an image has the same hazards as a buffer; its layout changes only at the beginning and end
//! of a replay.

use super::builder::Graph;
use super::error::GraphError;
use super::pass::{Pass, PassKind, Use};
use super::ranges::RangeMap;
use super::resource::{Buffer, BufferKind, BufferState, Image, ImageInfo, ImageState, Slice};
use crate::format::ImageFormat;
use crate::shader::Access;

/// Maximum side of a declared image in texels; devices may support less.
const SIDE_LIMIT: u32 = 65_536;

impl Graph {
    /// Declares an image that is bound at replay and persists. Writes to it are outputs.
    ///
    /// A replay expects the state `entry` and leaves the state `exit`. Other commands on the queue may use the image
    /// before and after.
    pub fn external_image(
        &mut self,
        name: impl Into<String>,
        size: [u32; 2],
        format: ImageFormat,
        entry: ImageState,
        exit: ImageState,
    ) -> Image {
        self.declare_image(name.into(), BufferKind::External, true, ImageInfo { size, format, entry, exit })
    }

    /// Declares an image that is bound at replay in state `state`. No pass may write it.
    pub fn input_image(
        &mut self,
        name: impl Into<String>,
        size: [u32; 2],
        format: ImageFormat,
        state: ImageState,
    ) -> Image {
        let info = ImageInfo { size, format, entry: state, exit: state };
        self.declare_image(name.into(), BufferKind::External, false, info)
    }

    /// Declares an image that exists only within a replay. Its initial contents are undefined.
    pub fn transient_image(&mut self, name: impl Into<String>, size: [u32; 2], format: ImageFormat) -> Image {
        let info = ImageInfo { size, format, entry: ImageState::Undefined, exit: ImageState::Undefined };
        self.declare_image(self.prefixed(name), BufferKind::Transient, false, info)
    }

    /// Preserves the texels of a transient image until the next replay.
    pub fn keep_image(&mut self, image: Image) {
        self.keep(image.0);
    }

    fn declare_image(&mut self, name: String, kind: BufferKind, keep: bool, info: ImageInfo) -> Image {
        let [width, height] = info.size;
        let fits = |side: u32| (1..=SIDE_LIMIT).contains(&side);
        if !fits(width) || !fits(height) {
            self.errors.push(GraphError::ImageSize { image: name.clone(), width, height });
        }
        if kind == BufferKind::External && info.exit == ImageState::Undefined {
            self.errors.push(GraphError::ExitUndefined { image: name.clone() });
        }
        let bytes = info.format.packed_bytes(info.size).max(1);
        let buffer = self.declare(name, bytes, kind, keep);
        let declared = &mut self.buffers[buffer.index()];
        declared.image = Some(info);
        if kind == BufferKind::External {
            (declared.entry, declared.exit) = (BufferState::Queue, BufferState::Queue);
            if info.entry == ImageState::Undefined {
                self.written[buffer.index()] = Some(RangeMap::new(bytes, false));
            }
        }
        Image(buffer)
    }

    /// Declares a pass that copies tightly packed texels to an image. Rows run from the top.
    pub fn copy_to_image(
        &mut self,
        name: impl Into<String>,
        source: impl Into<Slice>,
        target: Image,
    ) -> Result<(), GraphError> {
        let name = self.prefixed(name);
        self.begin(&name);
        let (source, texels) = self.packed_range(&name, source.into(), target)?;
        self.check_not_uniform(&name, source.buffer, "the source of a copy")?;
        self.check_write(&name, target.0, "copy")?;
        self.check_written(&name, &source)?;
        self.finish(Pass {
            name,
            kind: PassKind::CopyToImage { source, target },
            accesses: vec![(source, Access::Read, Use::Transfer), (texels, Access::Write, Use::Transfer)],
            discards: vec![texels],
        })
    }

    /// Declares a pass that copies the texels of an image to a buffer, tightly packed.
    pub fn copy_from_image(
        &mut self,
        name: impl Into<String>,
        source: Image,
        target: impl Into<Slice>,
    ) -> Result<(), GraphError> {
        let name = self.prefixed(name);
        self.begin(&name);
        let (target, texels) = self.packed_range(&name, target.into(), source)?;
        self.check_write(&name, target.buffer, "copy")?;
        self.check_written(&name, &texels)?;
        self.finish(Pass {
            name,
            kind: PassKind::CopyFromImage { source, target },
            accesses: vec![(texels, Access::Read, Use::Transfer), (target, Access::Write, Use::Transfer)],
            discards: vec![target],
        })
    }

    /// Declares a pass that sets every texel to one value: red, green, blue, alpha, as far as the format has them.
    ///
    /// Values of integer formats are rounded toward zero.
    pub fn clear_image(&mut self, name: impl Into<String>, target: Image, value: [f32; 4]) -> Result<(), GraphError> {
        let name = self.prefixed(name);
        self.begin(&name);
        let texels = self.resolve_image(&name, target)?;
        self.check_write(&name, target.0, "clear")?;
        let integer = self.buffers[target.index()].image.is_some_and(|info| info.format == ImageFormat::R32Uint);
        let value = value.map(|component| if integer { component as u32 } else { component.to_bits() });
        self.finish(Pass {
            name,
            kind: PassKind::ClearImage { target, value },
            accesses: vec![(texels, Access::Write, Use::Transfer)],
            discards: vec![texels],
        })
    }

    /// Returns the range of a whole image.
    pub(super) fn resolve_image(&self, pass: &str, image: Image) -> Result<Slice, GraphError> {
        match self.buffers.get(image.index()) {
            None => Err(self.unknown_buffer(pass, image.0)),
            Some(info) if info.image.is_none() => {
                Err(GraphError::BufferAsImage { pass: pass.to_owned(), buffer: info.name.clone() })
            }
            Some(info) => Ok(image.0.slice(0, info.bytes)),
        }
    }

    /// Checks that a slice holds exactly the packed texels of an image. Returns the slice and the range of the image.
    fn packed_range(&self, pass: &str, slice: Slice, image: Image) -> Result<(Slice, Slice), GraphError> {
        let slice = self.resolve(pass, slice)?;
        let texels = self.resolve_image(pass, image)?;
        let buffer = || self.buffers[slice.buffer.index()].name.clone();
        let info = &self.buffers[image.index()];
        if slice.bytes != texels.bytes {
            return Err(GraphError::ImageCopySize {
                pass: pass.to_owned(),
                buffer: buffer(),
                bytes: slice.bytes,
                image: info.name.clone(),
                texels: texels.bytes,
            });
        }
        let texel = info.image.map_or(1, |image| image.format.texel_bytes());
        if !slice.offset.is_multiple_of(texel) {
            let (pass, buffer) = (pass.to_owned(), buffer());
            return Err(GraphError::TexelAlignment { pass, buffer, offset: slice.offset, texel });
        }
        Ok((slice, texels))
    }
}

impl From<Image> for Buffer {
    /// Returns the buffer handle of the image in its plan.
    fn from(image: Image) -> Self {
        image.0
    }
}
