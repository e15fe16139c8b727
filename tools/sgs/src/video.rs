//! Videos of rendered frames. The ffmpeg program encodes MP4 and WebP; GIF needs no other program.

use crate::failure::refuse_usage;
use anyhow::{Context, bail};
use sgs_scene::Image;
use std::fs::File;
use std::io::{BufWriter, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// Speed of the color quantization of a GIF, from 1 (best) to 30 (fastest).
const GIF_SPEED: i32 = 10;

/// Options of a video.
#[derive(clap::Args)]
pub struct VideoArgs {
    /// Write the frames as a video. Without --output only the video is written. MP4 and WebP need the program ffmpeg.
    #[arg(long, value_name = "FILE.mp4|webp|gif")]
    pub video: Option<PathBuf>,
    /// Frames per second of the video.
    #[arg(long, value_name = "N", requires = "video", default_value_t = 24, value_parser = clap::value_parser!(u32).range(1..=100))]
    fps: u32,
}

impl VideoArgs {
    /// Prepares the video if `--video` is set. Refuses an output that cannot be written before any work is done.
    pub fn open(&self) -> anyhow::Result<Option<Video>> {
        self.video.as_deref().map(|path| Video::new(path, self.fps)).transpose()
    }
}

/// Video that is being written. The file appears under its name when [`Video::finish`] succeeds.
pub struct Video {
    path: PathBuf,
    /// Temporary file beside `path`, with the same extension.
    partial: PathBuf,
    gif: bool,
    fps: u32,
    frames: u32,
    size: [u32; 2],
    sink: Option<Sink>,
}

enum Sink {
    Gif(Box<gif::Encoder<BufWriter<File>>>),
    Ffmpeg(Child),
}

impl Video {
    fn new(path: &Path, fps: u32) -> anyhow::Result<Video> {
        let shown = path.display();
        let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
        let gif = match extension.as_deref() {
            Some("gif") => true,
            Some("mp4" | "webp") => false,
            _ => refuse_usage!("--video \"{shown}\" does not end in .mp4, .webp or .gif."),
        };
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        if !folder.is_dir() {
            refuse_usage!("--video \"{shown}\" cannot be written: its directory does not exist; create it first.");
        }
        if path.is_dir() {
            refuse_usage!("--video \"{shown}\" is a directory; name a file.");
        }
        if !gif && Command::new("ffmpeg").arg("-version").stdout(Stdio::null()).stderr(Stdio::null()).status().is_err()
        {
            bail!(
                "--video \"{shown}\" needs the program ffmpeg, which is not on PATH; install it, or write a .gif instead."
            );
        }
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let partial = folder.join(format!(".{}-{name}", std::process::id()));
        Ok(Video { path: path.to_owned(), partial, gif, fps, frames: 0, size: [0; 2], sink: None })
    }

    /// Appends a frame of display-referred values with 1 or 3 channels. All frames must have the size of the first.
    pub fn push(&mut self, image: &Image) -> anyhow::Result<()> {
        let size = [image.width, image.height];
        if self.frames == 0 {
            self.size = size;
            self.sink = Some(self.start()?);
        }
        if size != self.size {
            let ([w, h], [a, b]) = (self.size, size);
            bail!("--video needs frames of one size, but cameras have {w}x{h} and {a}x{b}; use --path or --orbit.");
        }
        let mut bytes = bytes(image);
        let delay = self.delay(self.frames);
        self.frames += 1;
        match &mut self.sink {
            Some(Sink::Gif(encoder)) => {
                let mut frame = gif::Frame::from_rgb_speed(size[0] as u16, size[1] as u16, &bytes, GIF_SPEED);
                frame.delay = delay;
                encoder.write_frame(&frame).with_context(|| self.path.display().to_string())
            }
            Some(Sink::Ffmpeg(child)) => {
                let mut pipe = child.stdin.take().context("ffmpeg takes no frames")?;
                let sent = pipe.write_all(&bytes);
                bytes.clear();
                child.stdin = Some(pipe);
                // ffmpeg's error output states why it closed the pipe.
                if sent.is_err() { self.end() } else { Ok(()) }
            }
            None => Ok(()),
        }
    }

    /// Returns the display time of a GIF frame in hundredths of a second. Rounding errors do not accumulate.
    fn delay(&self, frame: u32) -> u16 {
        let until = |n: u32| (u64::from(n) * 200 + u64::from(self.fps)) / (2 * u64::from(self.fps));
        (until(frame + 1) - until(frame)) as u16
    }

    fn start(&self) -> anyhow::Result<Sink> {
        let [width, height] = self.size;
        if self.gif {
            let (Ok(w), Ok(h)) = (u16::try_from(width), u16::try_from(height)) else {
                bail!("A GIF has at most 65535 columns and rows, not {width}x{height}.");
            };
            let cannot = || format!("\"{}\" cannot be written", self.path.display());
            let file = BufWriter::new(File::create(&self.partial).with_context(cannot)?);
            let mut encoder = gif::Encoder::new(file, w, h, &[]).with_context(cannot)?;
            encoder.set_repeat(gif::Repeat::Infinite).with_context(cannot)?;
            return Ok(Sink::Gif(Box::new(encoder)));
        }
        let mut command = Command::new("ffmpeg");
        command.args(["-hide_banner", "-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24"]);
        command.args(["-video_size", &format!("{width}x{height}"), "-framerate", &self.fps.to_string(), "-i", "-"]);
        let webp = self.path.extension().is_some_and(|e| e.eq_ignore_ascii_case("webp"));
        if webp {
            command.args(["-c:v", "libwebp", "-quality", "85", "-loop", "0"]);
        } else {
            // H.264 with 4:2:0 subsampling needs even sides; an odd last row or column is cropped.
            command.args(["-vf", "crop=trunc(iw/2)*2:trunc(ih/2)*2:0:0", "-pix_fmt", "yuv420p"]);
            command.args(["-movflags", "+faststart"]);
        }
        command.arg(&self.partial);
        command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped());
        Ok(Sink::Ffmpeg(command.spawn().context("ffmpeg cannot be started")?))
    }

    /// Completes the file and returns its path.
    pub fn finish(mut self) -> anyhow::Result<PathBuf> {
        self.end()?;
        let moved = std::fs::rename(&self.partial, &self.path);
        moved.with_context(|| format!("\"{}\" cannot be written", self.path.display()))?;
        Ok(self.path.clone())
    }

    fn end(&mut self) -> anyhow::Result<()> {
        match self.sink.take() {
            Some(Sink::Gif(encoder)) => {
                let written = encoder.into_inner().and_then(|mut file| Ok(file.flush()?));
                written.with_context(|| format!("\"{}\" cannot be written", self.path.display()))
            }
            Some(Sink::Ffmpeg(mut child)) => {
                drop(child.stdin.take());
                let mut text = String::new();
                if let Some(mut errors) = child.stderr.take() {
                    let _closed = errors.read_to_string(&mut text);
                }
                let status = child.wait().context("ffmpeg cannot be awaited")?;
                let reason = text.lines().map(str::trim).find(|l| !l.is_empty()).unwrap_or("it says nothing");
                if !status.success() {
                    bail!("\"{}\" cannot be written: ffmpeg failed: {reason}.", self.path.display());
                }
                Ok(())
            }
            None => bail!("\"{}\" cannot be written: there are no frames.", self.path.display()),
        }
    }
}

impl Drop for Video {
    fn drop(&mut self) {
        if let Some(Sink::Ffmpeg(mut child)) = self.sink.take() {
            let _ended = child.kill().and_then(|()| child.wait());
        }
        // Absent after `finish`.
        let _absent = std::fs::remove_file(&self.partial);
    }
}

/// Converts an image to 8-bit RGB.
fn bytes(image: &Image) -> Vec<u8> {
    let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
    let channels = image.channels.max(1) as usize;
    let colors = image.data.chunks_exact(channels);
    colors.flat_map(|p| if channels >= 3 { [p[0], p[1], p[2]] } else { [p[0]; 3] }.map(byte)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gif_delays_sum_to_the_duration() {
        let folder = tempfile::tempdir().expect("a folder");
        for fps in [1, 7, 24, 30, 60, 100] {
            let video = Video::new(&folder.path().join("a.gif"), fps).expect("a video");
            let sum: u32 = (0..fps * 3).map(|i| u32::from(video.delay(i))).sum();
            assert_eq!(sum, 300, "{fps}");
        }
    }

    #[test]
    fn gif_contains_every_frame() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("a.gif");
        let mut video = Video::new(&path, 10).expect("a video");
        for value in [0.0, 0.5, 1.0] {
            video.push(&Image { width: 4, height: 3, channels: 1, data: vec![value; 12] }).expect("a frame");
        }
        let other = video.push(&Image::new(3, 4, 3)).expect_err("another size").to_string();
        assert!(other.contains("4x3 and 3x4"), "{other}");
        video.finish().expect("a file");
        let mut options = gif::DecodeOptions::new();
        options.set_color_output(gif::ColorOutput::RGBA);
        let mut decoder = options.read_info(File::open(&path).expect("a file")).expect("a GIF");
        let mut found = Vec::new();
        while let Some(frame) = decoder.read_next_frame().expect("a frame") {
            found.push((frame.width, frame.delay, frame.buffer[0]));
        }
        assert_eq!(found, [(4, 10, 0), (4, 10, 128), (4, 10, 255)]);
        assert_eq!(std::fs::read_dir(folder.path()).expect("a folder").count(), 1, "a partial file is left");
    }

    #[test]
    fn unwritable_output_is_refused_before_the_first_frame() {
        let folder = tempfile::tempdir().expect("a folder");
        let error = |name: &str| Video::new(&folder.path().join(name), 10).err().map(|e| e.to_string());
        assert!(error("a.avi").is_some_and(|e| e.contains(".mp4, .webp or .gif")));
        assert!(error("none/a.gif").is_some_and(|e| e.contains("does not exist")));
        let mut video = Video::new(&folder.path().join("a.gif"), 10).expect("a video");
        assert!(video.end().is_err_and(|e| e.to_string().contains("no frames")));
    }
}
