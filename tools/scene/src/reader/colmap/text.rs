//! COLMAP's text files.

use std::path::Path;

use super::{CameraRow, ImageRow, model};
use crate::error::{Result, SceneError, io_error};
use crate::points::{PointCloud, Tracks};

pub(super) fn read_text(path: &Path) -> Result<String> {
    let bytes = std::fs::read(path).map_err(io_error("read", path))?;
    // Image names may have any encoding; numbers are the same in all encodings.
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes);
    Ok(String::from_utf8_lossy(bytes).into_owned())
}

/// Words of one line; errors name the line.
pub(super) struct Words<'a> {
    path: &'a Path,
    line: usize,
    words: std::str::SplitAsciiWhitespace<'a>,
}

impl<'a> Words<'a> {
    pub(super) fn new(path: &'a Path, line: usize, text: &'a str) -> Self {
        Self { path, line, words: text.split_ascii_whitespace() }
    }

    pub(super) fn fail(&self, problem: impl Into<String>) -> SceneError {
        SceneError::cameras(self.path, format!("line {}", self.line), problem)
    }

    pub(super) fn word(&mut self, what: &str) -> Result<&'a str> {
        self.words.next().ok_or_else(|| self.fail(format!("the line ends before {what}; export the file again")))
    }

    pub(super) fn number<T: std::str::FromStr>(&mut self, what: &str) -> Result<T> {
        let word = self.word(what)?;
        word.parse().map_err(|_| self.fail(format!("\"{word}\" is no {what}; export the file again")))
    }

    pub(super) fn numbers<const N: usize>(&mut self, what: &str) -> Result<[f64; N]> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.number(what)?;
        }
        Ok(values)
    }
}

/// Returns lines with content and their numbers, from 1.
pub(super) fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    text.lines().enumerate().map(|(i, line)| (i + 1, line)).filter(|(_, line)| is_content(line))
}

fn is_content(line: &str) -> bool {
    let line = line.trim();
    !line.is_empty() && !line.starts_with('#')
}

/// Reads `cameras.txt`.
pub(super) fn read_cameras(path: &Path) -> Result<Vec<CameraRow>> {
    let text = read_text(path)?;
    let mut cameras = Vec::new();
    for (line, content) in lines(&text) {
        let mut words = Words::new(path, line, content);
        let id = words.number("camera number")?;
        let name = words.word("the camera model")?;
        let width = words.number("width in pixels")?;
        let height = words.number("height in pixels")?;
        let mut parameters: Vec<f64> = Vec::new();
        while let Some(word) = words.words.next() {
            let number = word.parse().map_err(|_| words.fail(format!("\"{word}\" is no camera parameter")))?;
            parameters.push(number);
        }
        let model = model::from_parameters(name, &parameters).map_err(|problem| words.fail(problem))?;
        cameras.push(CameraRow { id, width, height, model });
    }
    Ok(cameras)
}

/// Reads `images.txt`; the observed points are skipped.
pub(super) fn read_images(path: &Path) -> Result<Vec<ImageRow>> {
    let text = read_text(path)?;
    let mut images = Vec::new();
    let mut all = text.lines().enumerate();
    while let Some((i, content)) = all.next() {
        if !is_content(content) {
            continue;
        }
        let mut words = Words::new(path, i + 1, content);
        let id = words.number("image number")?;
        let rotation = words.numbers("part of a quaternion")?;
        let translation = words.numbers("part of a translation")?;
        let camera = words.number("camera number")?;
        words.word("the name of the image")?;
        // The name is the rest of the line, because it may contain spaces.
        let name = rest_after(content, 9).to_string();
        images.push(ImageRow { id, rotation, translation, camera, name, place: format!("line {}", i + 1) });
        // Observed points follow on a separate line, which is empty if there are none.
        all.next();
    }
    Ok(images)
}

/// Returns the text after the first `n` words of a line.
fn rest_after(line: &str, n: usize) -> &str {
    let mut rest = line.trim();
    for _ in 0..n {
        rest = rest.find(|c: char| c.is_ascii_whitespace()).map_or("", |at| rest[at..].trim_start());
    }
    rest
}

/// Reads `points3D.txt`: points and their tracks.
pub(super) fn read_points(path: &Path) -> Result<(PointCloud, Tracks)> {
    let text = read_text(path)?;
    let mut tracks = Tracks::default();
    let (mut positions, mut colors) = (Vec::new(), Vec::new());
    for (line, content) in lines(&text) {
        let mut words = Words::new(path, line, content);
        let _id: u64 = words.number("point number")?;
        let position = words.numbers::<3>("coordinate")?.map(|v| v as f32);
        if position.iter().any(|v| !v.is_finite()) {
            return Err(words.fail("the position is not finite; remove the point or run the reconstruction again"));
        }
        positions.push(position);
        let mut color = [0.0; 3];
        for value in &mut color {
            *value = f32::from(words.number::<u8>("color from 0 to 255")?) / 255.0;
        }
        colors.push(color);
        // The reprojection error precedes the track. The track is pairs of an image id and an observation index.
        words.words.next();
        while let Some(word) = words.words.next() {
            let image = word
                .parse()
                .map_err(|_| words.fail(format!("\"{word}\" is no image of a track; export the file again")))?;
            words.word("the second half of a track's last pair")?;
            tracks.add(image);
        }
        tracks.end_point();
    }
    Ok((PointCloud { positions, colors: Some(colors), normals: None }, tracks))
}
