//! Declaring images and the passes that only move texels.
//!
//! An image is touched as a whole: a pass that writes some of its texels is taken to leave the others as they were, as
//! with buffers. Between passes an image needs no more than a buffer does; its layout changes at the beginning and at the
//! end of a replay only.

use super::builder::Graph;
use super::error::GraphError;
use super::pass::{Pass, PassKind, Use};
use super::ranges::RangeMap;
use super::resource::{Buffer, BufferKind, BufferState, Image, ImageInfo, ImageState, Slice};
use crate::format::ImageFormat;
use crate::shader::Access;

/// Texels along a side that a declaration may ask for; devices may have fewer.
const SIDE_LIMIT: u32 = 65_536;

impl Graph {
    /// An image bound at replay, whose contents persist. Writes to it are outputs. A replay finds it in the state
    /// `entry` and leaves it in the state `exit`; others on the queue may use it before and after.
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

    /// An image bound at replay that no pass may write, found and left in the state `state`.
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

    /// An image that exists within a replay only. What it holds at first is undefined.
    pub fn transient_image(&mut self, name: impl Into<String>, size: [u32; 2], format: ImageFormat) -> Image {
        let info = ImageInfo { size, format, entry: ImageState::Undefined, exit: ImageState::Undefined };
        self.declare_image(self.prefixed(name), BufferKind::Transient, false, info)
    }

    /// Wants the texels of a transient image after the replay, until the next one begins.
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

    /// Declares a pass that copies tightly packed texels over an image: rows from the top, nothing between them.
    pub fn copy_to_image(
        &mut self,
        name: impl Into<String>,
        source: impl Into<Slice>,
        target: Image,
    ) -> Result<(), GraphError> {
        let name = self.prefixed(name);
        self.begin(&name);
        let (source, texels) = self.packed(&name, source.into(), target)?;
        self.check_not_uniform(&name, source.buffer, "the source of a copy")?;
        self.check_write(&name, target.0, "copy")?;
        self.check_written(&name, &source, None)?;
        self.finish(Pass {
            name,
            condition: None,
            kind: PassKind::CopyToImage { source, target },
            accesses: vec![(source, Access::Read, Use::Transfer), (texels, Access::Write, Use::Transfer)],
            discards: vec![texels],
        })
    }

    /// Declares a pass that copies the texels of an image, tightly packed.
    pub fn copy_from_image(
        &mut self,
        name: impl Into<String>,
        source: Image,
        target: impl Into<Slice>,
    ) -> Result<(), GraphError> {
        let name = self.prefixed(name);
        self.begin(&name);
        let (target, texels) = self.packed(&name, target.into(), source)?;
        self.check_write(&name, target.buffer, "copy")?;
        self.check_written(&name, &texels, None)?;
        self.finish(Pass {
            name,
            condition: None,
            kind: PassKind::CopyFromImage { source, target },
            accesses: vec![(texels, Access::Read, Use::Transfer), (target, Access::Write, Use::Transfer)],
            discards: vec![target],
        })
    }

    /// Declares a pass that gives every texel one value: red, green, blue, alpha, as far as the format has them.
    /// Integers are rounded toward zero.
    pub fn clear_image(&mut self, name: impl Into<String>, target: Image, value: [f32; 4]) -> Result<(), GraphError> {
        let name = self.prefixed(name);
        self.begin(&name);
        let texels = self.resolve_image(&name, target)?;
        self.check_write(&name, target.0, "clear")?;
        let integer = self.buffers[target.index()].image.is_some_and(|info| info.format == ImageFormat::R32Uint);
        let value = value.map(|component| if integer { component as u32 } else { component.to_bits() });
        self.finish(Pass {
            name,
            condition: None,
            kind: PassKind::ClearImage { target, value },
            accesses: vec![(texels, Access::Write, Use::Transfer)],
            discards: vec![texels],
        })
    }

    /// The range that stands for all of an image.
    pub(super) fn resolve_image(&self, pass: &str, image: Image) -> Result<Slice, GraphError> {
        match self.buffers.get(image.index()) {
            None => Err(self.unknown(pass, image.0)),
            Some(info) if info.image.is_none() => {
                Err(GraphError::BufferAsImage { pass: pass.to_owned(), buffer: info.name.clone() })
            }
            Some(info) => Ok(image.0.slice(0, info.bytes)),
        }
    }

    /// Checks that a slice holds exactly the packed texels of an image; returns it and the range of the image.
    fn packed(&self, pass: &str, slice: Slice, image: Image) -> Result<(Slice, Slice), GraphError> {
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
    /// The number that a plan knows the image by.
    fn from(image: Image) -> Self {
        image.0
    }
}
