//! From a picture on the device to one that a window takes.
//!
//! Promises: nothing is read back or made from picture to picture; everything that changes travels in the frame's own
//! uniforms. Leaves drawing the picture to views, and the window to the engine's swapchain.

use super::{ViewError, ViewResult};
use crate::splat::{Letters, Mark, Show, ShowStep, ShownKind, TexelFormat, show};
use sgs_engine::graph::exec::{ExecOptions, Executor};
use sgs_engine::graph::{Buffer, CompileOptions, Graph, ImageState};
use sgs_engine::{Device, DeviceBuffer, DeviceImage, ImageFormat, Location, Ticket};
use std::sync::Arc;

/// Letters along a line and lines, marks: the most that a [`Display`] has room for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DisplayRoom {
    /// Letters along a line.
    pub columns: u32,
    /// Lines.
    pub rows: u32,
    /// Marks.
    pub marks: u32,
}

/// What lies over a picture, and how it is shown.
#[derive(Clone, Copy, Debug)]
pub struct Shown<'a> {
    /// What the picture holds.
    pub kind: ShownKind,
    /// Factor of light or values.
    pub gain: f32,
    /// As many as there is room for.
    pub marks: &'a [Mark],
    /// As many bytes as [`DisplayRoom`] has cells, or none.
    pub text: &'a [u8],
    /// Pixels of the screen along a pixel of a letter.
    pub letter_size: u32,
}

/// A font on the device, for displays of any size.
#[derive(Clone)]
pub struct Font {
    letters: Letters,
    pixels: DeviceBuffer,
}

impl Font {
    /// Uploads the pixels of letters: a byte each, letter by letter, row by row; what is missing is blank.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(device: &Device, letters: Letters, pixels: &[u8]) -> sgs_engine::Result<Font> {
        let buffer = device.buffer("font", letters.bytes(), Location::Device)?;
        let mut words = vec![0; letters.bytes() as usize];
        let given = pixels.len().min(words.len());
        words[..given].copy_from_slice(&pixels[..given]);
        device.upload(&buffer, 0, &words)?;
        Ok(Font { letters, pixels: buffer })
    }
}

/// Shows pictures of one size in one format.
pub struct Display {
    exec: Executor,
    room: DisplayRoom,
    step: Buffer,
    marks: Buffer,
    text: Buffer,
    picture: DeviceImage,
    window: DeviceImage,
}

impl Display {
    /// Prepares for pictures of a size, to be shown in an 8-bit format.
    ///
    /// # Errors
    /// [`ViewError::Format`] for other formats; if memory runs out.
    pub fn new(
        device: &Device,
        font: &Font,
        size: [u32; 2],
        format: ImageFormat,
        room: DisplayRoom,
    ) -> ViewResult<Display> {
        Display::scaled(device, font, [size, size], format, room)
    }

    /// Prepares for a window and for pictures of another size, which are interpolated bilinearly: `[window, picture]`. Marks
    /// and letters have the window's resolution.
    ///
    /// # Errors
    /// As for [`Display::new`].
    pub fn scaled(
        device: &Device,
        font: &Font,
        [size, picture_size]: [[u32; 2]; 2],
        format: ImageFormat,
        room: DisplayRoom,
    ) -> ViewResult<Display> {
        let texel = TexelFormat::try_from(format)?;
        if texel.bytes() != 4 {
            return Err(ViewError::Format(format));
        }
        // Where this format of a picture cannot be read by kernels there is no Vulkan.
        let picture = device.image("picture", picture_size, ImageFormat::Rgba16Float)?;
        let window = device.image("window", size, format)?;
        let mut g = Graph::new("display");
        let what = Show {
            step: g.uniform("show_step", size_of::<ShowStep>() as u64),
            picture: g.external_image(
                "picture",
                picture_size,
                ImageFormat::Rgba16Float,
                ImageState::General,
                ImageState::General,
            ),
            picture_size,
            marks: g.uniform("marks", size_of::<Mark>() as u64 * u64::from(room.marks.max(1))),
            text: g.uniform("text", u64::from(room.columns * room.rows).next_multiple_of(4).max(4)),
            font: g.input("font", font.letters.bytes()),
            texels: g.transient("texels", 4 * u64::from(size[0]) * u64::from(size[1])),
        };
        let target = g.external_image("window", size, format, ImageState::Undefined, ImageState::General);
        show(&mut g, size, &what, font.letters, texel)
            .and_then(|()| g.copy_to_image("copy_to_window", what.texels, target))
            .map_err(sgs_engine::Error::from)?;
        let plan = Arc::new(g.compile(&CompileOptions::default()).map_err(sgs_engine::Error::from)?);
        let options = ExecOptions { frames_in_flight: 2, ..Default::default() };
        let mut exec = Executor::new(device, plan, options)?;
        exec.bind(what.font, &font.pixels)?;
        exec.bind_image(what.picture, &picture)?;
        exec.bind_image(target, &window)?;
        let Show { step, marks, text, .. } = what;
        Ok(Display { exec, room, step, marks, text, picture, window })
    }

    /// Where views draw what is to be shown: [`ImageFormat::Rgba16Float`], in the general layout.
    pub fn picture(&self) -> &DeviceImage {
        &self.picture
    }

    /// What was shown, in the general layout.
    pub fn window(&self) -> &DeviceImage {
        &self.window
    }

    /// What it has room for.
    pub fn room(&self) -> DisplayRoom {
        self.room
    }

    /// Submits what makes [`Display::window`] of [`Display::picture`], behind everything submitted so far. Marks and letters
    /// beyond the room are left out.
    ///
    /// # Errors
    /// If the device fails.
    pub fn submit(&mut self, shown: &Shown<'_>) -> sgs_engine::Result<Ticket> {
        let marks = &shown.marks[..shown.marks.len().min(self.room.marks as usize)];
        let cells = (self.room.columns * self.room.rows) as usize;
        let text = &shown.text[..shown.text.len().min(cells)];
        let columns = if text.len() == cells { self.room.columns } else { 0 };
        let step = ShowStep {
            kind: shown.kind.number(),
            gain: shown.gain,
            marks: marks.len() as u32,
            columns,
            rows: self.room.rows,
            letter_size: shown.letter_size,
        };
        let uniforms =
            [(self.step, bytemuck::bytes_of(&step)), (self.marks, bytemuck::cast_slice(marks)), (self.text, text)];
        self.exec.submit(&uniforms)
    }

    /// Waits for what was submitted.
    ///
    /// # Errors
    /// If the device fails.
    pub fn finish(&mut self) -> sgs_engine::Result<()> {
        self.exec.finish()
    }
}
