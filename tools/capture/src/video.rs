//! Sharp frames of a video.
//!
//! ffmpeg decodes the video twice. The first pass measures the sharpness of every frame, at most 1600 pixels wide. The
//! second pass returns the chosen frames at full size and turned upright. Frames are converted to RGB by ffmpeg, which
//! knows the color matrix of the video, and written as JPEG here.

use crate::error::{CaptureError, Result, io_error};
use crate::pnm::Pnm;
use crate::prepared::{Prepared, QUALITY};
use crate::process::{Processes, Program};
use crate::sharpness::{sharpest, sharpness};
use sgs_scene::{atomic_write, encode_jpeg};
use std::io::{BufReader, ErrorKind, Write};
use std::path::Path;

const FFMPEG: Program = Program { name: "ffmpeg", package: "ffmpeg" };

/// Writes the sharpest frame of each of `count` intervals of a video into `folder`.
pub(crate) fn frames(video: &Path, count: usize, folder: &Path, processes: &Processes) -> Result<Vec<Prepared>> {
    let mut values = Vec::new();
    decode(video, "scale='min(1600,iw)':-2,format=gray", "pgm", processes, |frame| {
        values.push(sharpness(&frame));
        Ok(())
    })?;
    if values.is_empty() {
        return Err(CaptureError::Input(format!("{} holds no frames; give a video", video.display())));
    }
    let chosen = sharpest(&values, count);
    let terms: Vec<String> = chosen.iter().map(|n| format!("eq(n,{n})")).collect();
    let filter = format!("select='{}',format=rgb24", terms.join("+"));
    let (mut numbers, mut prepared) = (chosen.iter(), Vec::new());
    decode(video, &filter, "ppm", processes, |frame| {
        let Some(number) = numbers.next() else { return Ok(()) };
        let name = format!("frame_{:06}.jpg", number + 1);
        let path = folder.join(&name);
        let bytes = encode_jpeg(&frame.image(), QUALITY)?;
        atomic_write(&path, |out| out.write_all(&bytes))?;
        let file = format!("frame {}", number + 1);
        prepared.push(Prepared { file, name, size: (frame.width, frame.height), focal: None, camera: String::new() });
        Ok(())
    })?;
    Ok(prepared)
}

/// Decodes a video through a filter and passes its frames on.
fn decode(
    video: &Path,
    filter: &str,
    codec: &str,
    processes: &Processes,
    mut each: impl FnMut(Pnm) -> Result<()>,
) -> Result<()> {
    // The prefix keeps names with a colon from being read as a protocol.
    let mut input = std::ffi::OsString::from("file:");
    input.push(video);
    let mut command = FFMPEG.command();
    command.args(["-hide_banner", "-nostdin", "-v", "error", "-i"]).arg(input);
    command.args(["-map", "0:v:0", "-vf", filter, "-fps_mode", "passthrough", "-f", "image2pipe", "-c:v", codec, "-"]);
    let mut running = processes.start(FFMPEG, "ffmpeg", &mut command, true)?;
    if let Some(output) = running.output() {
        let mut output = BufReader::with_capacity(1 << 20, output);
        let mut next = || Pnm::read(&mut output);
        while let Some(frame) = next().transpose() {
            processes.check()?;
            match frame {
                Ok(frame) => each(frame)?,
                // The log of a program that failed tells more.
                Err(error) if error.kind() == ErrorKind::UnexpectedEof => break,
                Err(error) => return Err(io_error("decode", video)(error)),
            }
        }
    }
    match running.wait() {
        Err(CaptureError::Program { message, .. }) => Err(CaptureError::Input(format!(
            "ffmpeg cannot read {} as a video ({message}); give a video or a folder of photographs",
            video.display()
        ))),
        result => result,
    }
}
