//! Semantic classes in images: loading the decoder of a run, and writing labels and relevance.

use crate::palette::{Color, colors, hex};
use sgs_run::{NO_RELEVANCE, SemanticHead};
use sgs_scene::{Image, write_exr, write_png};
use std::path::{Path, PathBuf};

pub use sgs_api::head_of;

/// Result of writing a file.
type Written = sgs_scene::Result<()>;

/// Names and colors of the classes.
pub struct Legend {
    labels: Vec<String>,
    colors: Vec<Color>,
}

impl Legend {
    /// Creates the legend of these classes.
    pub fn new(labels: &[String]) -> Legend {
        Legend { labels: labels.to_vec(), colors: colors(labels.len()) }
    }

    /// Writes `labels.json`, the names and colors of the label indices. Returns the path.
    pub fn write(&self, dir: &Path) -> anyhow::Result<PathBuf> {
        let class = |(i, (name, color)): (usize, (&String, &Color))| serde_json::json!({"index": i, "name": name, "color": hex(*color)});
        let classes: Vec<_> = self.labels.iter().zip(&self.colors).enumerate().map(class).collect();
        let text = serde_json::to_string_pretty(&serde_json::json!({"none": -1, "classes": classes}))?;
        let path = dir.join("labels.json");
        sgs_scene::atomic_write(&path, |f| std::io::Write::write_all(f, text.as_bytes()))?;
        Ok(path)
    }

    /// Writes every pixel in the color of its class, transparent if it has no class.
    pub fn write_png(&self, path: &Path, size: [u32; 2], labels: &[Option<u32>]) -> Written {
        let color = |label: &Option<u32>| match label.and_then(|l| self.colors.get(l as usize)) {
            Some([r, g, b]) => [*r, *g, *b, 255].map(|v| f32::from(v) / 255.0),
            None => [0.0; 4],
        };
        let image =
            Image { width: size[0], height: size[1], channels: 4, data: labels.iter().flat_map(color).collect() };
        write_png(path, &image)
    }
}

/// Writes the class index of every pixel, -1 if it has no class.
pub fn write_labels_exr(path: &Path, size: [u32; 2], labels: &[Option<u32>]) -> Written {
    let data = labels.iter().map(|l| l.map_or(-1.0, |l| l as f32)).collect();
    write_exr(path, &Image { width: size[0], height: size[1], channels: 1, data }, &["Y"])
}

/// Mapping from relevance to gray.
///
/// Black is the probability by chance or less; white is the maximum that the class can reach. At high temperatures
/// such as that of training, both are almost equal. The scaling keeps such images readable.
#[derive(Clone, Copy)]
pub struct Scale {
    chance: f32,
    most: f32,
}

impl Scale {
    /// Returns the scale of a class.
    pub fn of(head: &SemanticHead, class: usize) -> Scale {
        let chance = 1.0 / head.text.labels.len() as f32;
        let most = head.peak(class) as f32;
        // If the class cannot exceed chance, as with a single class, gray is the probability itself.
        if most > chance + 1e-6 { Scale { chance, most } } else { Scale { chance: 0.0, most: 1.0 } }
    }

    fn gray(self, relevance: f32) -> f32 {
        ((relevance - self.chance) / (self.most - self.chance)).clamp(0.0, 1.0)
    }
}

/// Writes relevance as gray, transparent where a pixel shows nothing.
pub fn write_relevance_png(path: &Path, size: [u32; 2], relevance: &[f32], scale: Scale) -> Written {
    let gray = |r: &f32| if *r == NO_RELEVANCE { [0.0; 2] } else { [scale.gray(*r), 1.0] };
    let data = relevance.iter().flat_map(gray).collect();
    write_png(path, &Image { width: size[0], height: size[1], channels: 2, data })
}

/// Writes relevance unscaled, -1 where a pixel shows nothing.
pub fn write_relevance_exr(path: &Path, size: [u32; 2], relevance: Vec<f32>) -> Written {
    write_exr(path, &Image { width: size[0], height: size[1], channels: 1, data: relevance }, &["Y"])
}

/// Returns a class name as part of a file name. Percent-encodes characters that file systems reserve.
pub fn file_part(class: &str) -> String {
    let allowed = |c: char| !c.is_control() && !r#"/\:*?"<>|%"#.contains(c);
    let mut bytes = [0; 4];
    class
        .chars()
        .map(|c| match allowed(c) {
            true => c.to_string(),
            false => c.encode_utf8(&mut bytes).bytes().map(|b| format!("%{b:02X}")).collect(),
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn class_names_become_valid_file_names() {
        assert_eq!(file_part("light source"), "light source");
        assert_eq!(file_part("../a/b"), "..%2Fa%2Fb");
        assert_eq!(file_part("a%2Fb"), "a%252Fb");
        assert_eq!(file_part("дверь\n\u{85}"), "дверь%0A%C2%85");
    }
}
