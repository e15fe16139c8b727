//! Converts a rendered image on the device to the image of a window.
//!
//! Guarantees: nothing is read back or allocated per frame. All changing data travels in the frame's uniforms. Views
//! draw the source image; the engine's swapchain owns the window.

use super::{ViewError, ViewResult};
use crate::splat::{Letters, Mark, Show, ShowStep, ShownKind, TexelFormat, show};
use sgs_engine::exec::{ExecOptions, Executor};
use sgs_engine::graph::{Buffer, CompileOptions, Graph, ImageState};
use sgs_engine::{Device, DeviceBuffer, DeviceImage, ImageFormat, Location, Ticket};
use std::sync::Arc;

/// Capacity of a [`Display`]: text cells and marks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DisplayRoom {
    /// Characters per line.
    pub columns: u32,
    /// Number of lines.
    pub rows: u32,
    /// Number of marks.
    pub marks: u32,
}

/// Overlay of an image, and its presentation.
#[derive(Clone, Copy, Debug)]
pub struct Shown<'a> {
    /// Content of the source image.
    pub kind: ShownKind,
    /// Factor on light or values.
    pub gain: f32,
    /// Marks; those beyond the capacity are ignored.
    pub marks: &'a [Mark],
    /// One byte per cell of [`DisplayRoom`], or empty.
    pub text: &'a [u8],
    /// Screen pixels along one pixel of a glyph.
    pub letter_size: u32,
}

/// Font on the device, for displays of any size.
#[derive(Clone)]
pub struct Font {
    letters: Letters,
    pixels: DeviceBuffer,
}

impl Font {
    /// Uploads the glyph pixels: one byte each, by glyph, then by row. Missing pixels are blank.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(device: &Device, letters: Letters, pixels: &[u8]) -> sgs_engine::Result<Font> {
        let buffer = device.buffer("font", letters.bytes(), Location::Device)?;
        let mut words = vec![0; letters.bytes() as usize];
        let count = pixels.len().min(words.len());
        words[..count].copy_from_slice(&pixels[..count]);
        device.upload(&buffer, 0, &words)?;
        Ok(Font { letters, pixels: buffer })
    }
}

/// Display of images of one size in one format.
pub struct Display {
    exec: Executor,
    room: DisplayRoom,
    step: Buffer,
    marks: Buffer,
    text: Buffer,
    rendered: DeviceImage,
    window: DeviceImage,
}

impl Display {
    /// Prepares for source images of a size, to be shown in an 8-bit format.
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

    /// Prepares for a window and for source images of another size: `[window, source]`.
    ///
    /// Source images are interpolated bilinearly. Marks and text have the window's resolution.
    ///
    /// # Errors
    /// As [`Display::new`].
    pub fn scaled(
        device: &Device,
        font: &Font,
        [size, image_size]: [[u32; 2]; 2],
        format: ImageFormat,
        room: DisplayRoom,
    ) -> ViewResult<Display> {
        let texel = TexelFormat::try_from(format)?;
        if texel.bytes() != 4 {
            return Err(ViewError::Format(format));
        }
        // Every Vulkan implementation lets kernels read images of this format.
        let rendered = device.image("image", image_size, ImageFormat::Rgba16Float)?;
        let window = device.image("window", size, format)?;
        let mut g = Graph::new("display");
        let what = Show {
            step: g.uniform("show_step", size_of::<ShowStep>() as u64),
            image: g.external_image(
                "image",
                image_size,
                ImageFormat::Rgba16Float,
                ImageState::General,
                ImageState::General,
            ),
            render_size: image_size,
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
        exec.bind_image(what.image, &rendered)?;
        exec.bind_image(target, &window)?;
        let Show { step, marks, text, .. } = what;
        Ok(Display { exec, room, step, marks, text, rendered, window })
    }

    /// Returns the image that views draw into: [`ImageFormat::Rgba16Float`], in the general layout.
    pub fn image(&self) -> &DeviceImage {
        &self.rendered
    }

    /// Returns the displayed image, in the general layout.
    pub fn window(&self) -> &DeviceImage {
        &self.window
    }

    /// Returns the capacity.
    pub fn room(&self) -> DisplayRoom {
        self.room
    }

    /// Submits the conversion of the source image to the window's image.
    ///
    /// Reads [`Display::image`] and writes [`Display::window`], after all earlier submissions. Ignores marks and text
    /// beyond the capacity.
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

    /// Waits for the submitted work.
    ///
    /// # Errors
    /// If the device fails.
    pub fn finish(&mut self) -> sgs_engine::Result<()> {
        self.exec.finish()
    }
}
