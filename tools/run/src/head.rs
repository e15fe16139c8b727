//! Semantic head of a run: decoder and classes, in one file.
//!
//! Guarantees: a saved head is loaded bit for bit. A missing, damaged or misshapen file is refused with a sentence
//! that states which. Inference on a device is in other modules.

use crate::error::{Result, RunError};
use crate::floats::Floats;
use safetensors::{Dtype, SafeTensors};
use sgs_passes::loss::normalize_embeddings;
use sgs_passes::scene::{AUGMENTED, EMBEDDING};
use sgs_scene::TextEmbeddings;
use std::collections::{HashMap, HashSet};
use std::path::Path;
use strsim::levenshtein;

/// Format identifier in the file.
const FORMAT: &str = "sgs-semantics-1";

/// Semantic head of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct SemanticHead {
    /// Decoder: 512 rows of 32 weights and a bias.
    pub decoder: Vec<f32>,
    /// Classes and their text embeddings, 512 wide, of any length.
    pub text: TextEmbeddings,
    /// Divisor of the logits before the softmax.
    pub temperature: f32,
}

impl SemanticHead {
    /// Writes the head atomically.
    ///
    /// # Errors
    /// If the head would not load again, or the file cannot be written. An existing file then remains unchanged.
    pub fn save(&self, path: &Path) -> Result<()> {
        let fail = |reason: String| file(path, reason);
        self.check().map_err(fail)?;
        let labels = serde_json::to_string(&self.text.labels).map_err(|e| fail(e.to_string()))?;
        let meta = HashMap::from([
            ("format".to_owned(), FORMAT.to_owned()),
            ("labels".to_owned(), labels),
            // Shortest text that parses to the same number.
            ("temperature".to_owned(), self.temperature.to_string()),
        ]);
        let tensors = [
            ("decoder", Floats(&self.decoder, vec![EMBEDDING, AUGMENTED])),
            ("text_embeddings", Floats(&self.text.data, vec![self.text.labels.len(), EMBEDDING])),
        ];
        let bytes = crate::floats::serialize(tensors, meta).map_err(|e| fail(e.to_string()))?;
        sgs_scene::atomic_write(path, |f| std::io::Write::write_all(f, &bytes))?;
        Ok(())
    }

    /// Reads a file written by [`SemanticHead::save`].
    ///
    /// # Errors
    /// If the file does not exist or does not hold a head.
    pub fn load(path: &Path) -> Result<SemanticHead> {
        let fail = |reason: String| file(path, reason);
        let bytes = std::fs::read(path).map_err(|e| match e.kind() {
            std::io::ErrorKind::NotFound => fail("there is no such file, so that features have no classes".into()),
            _ => fail(format!("cannot be read: {e}")),
        })?;
        let damaged = |e: safetensors::SafeTensorError| fail(format!("damaged or not a semantic head: {e}"));
        let (_, header) = SafeTensors::read_metadata(&bytes).map_err(damaged)?;
        let tensors = SafeTensors::deserialize(&bytes).map_err(damaged)?;
        let meta = header.metadata().clone().unwrap_or_default();
        if meta.get("format").map(String::as_str) != Some(FORMAT) {
            return Err(fail(format!("not a semantic head: its metadata does not say \"{FORMAT}\"")));
        }
        let labels = meta.get("labels").and_then(|text| serde_json::from_str::<Vec<String>>(text).ok());
        let labels = labels.ok_or_else(|| fail("the metadata does not name the classes".into()))?;
        let temperature = meta.get("temperature").and_then(|text| text.parse().ok());
        let temperature = temperature.ok_or_else(|| fail("the metadata does not say the temperature".into()))?;
        let floats = |name: &str, shape: [usize; 2]| -> Result<Vec<f32>> {
            let tensor = tensors.tensor(name).map_err(|_| fail(format!("there is no \"{name}\" in it")))?;
            if tensor.dtype() != Dtype::F32 || tensor.shape() != shape {
                let (kind, found) = (tensor.dtype(), tensor.shape());
                return Err(fail(format!("\"{name}\" is {kind:?} {found:?}, but must be F32 {shape:?}")));
            }
            Ok(tensor.data().as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect())
        };
        let data = floats("text_embeddings", [labels.len(), EMBEDDING])?;
        let decoder = floats("decoder", [EMBEDDING, AUGMENTED])?;
        let head = SemanticHead { decoder, text: TextEmbeddings { labels, channels: EMBEDDING, data }, temperature };
        head.check().map_err(fail)?;
        Ok(head)
    }

    /// Returns the first problem as an error.
    fn check(&self) -> std::result::Result<(), String> {
        let (decoder, text) = (&self.decoder, &self.text);
        let labels = &text.labels;
        if decoder.len() != EMBEDDING * AUGMENTED {
            return Err(format!("the decoder has {} numbers, but must have {EMBEDDING} × {AUGMENTED}", decoder.len()));
        }
        if labels.is_empty() {
            return Err("there are no classes".into());
        }
        if text.channels != EMBEDDING || text.data.len() != labels.len() * EMBEDDING {
            let (found, width) = (text.data.len(), text.channels);
            return Err(format!(
                "{} classes have {found} numbers in rows of {width}, but must have {EMBEDDING} each",
                labels.len()
            ));
        }
        let mut seen = HashSet::new();
        if let Some(label) = labels.iter().find(|label| !seen.insert(*label)) {
            return Err(format!("the class \"{label}\" occurs twice"));
        }
        for (name, values) in [("decoder", decoder), ("text_embeddings", &text.data)] {
            if values.iter().any(|v| !v.is_finite()) {
                return Err(format!("damaged: \"{name}\" holds values that are not finite"));
            }
        }
        if !(self.temperature > 0.0 && self.temperature.is_finite()) {
            return Err(format!("the temperature is {}, but must be a finite number above 0", self.temperature));
        }
        Ok(())
    }

    /// Returns about the maximum probability that a class reaches.
    ///
    /// This is its softmax probability for features that decode to its own text embedding.
    pub fn peak(&self, class: usize) -> f64 {
        let unit = normalize_embeddings(&self.text.data);
        let texts: Vec<&[f32]> = unit.chunks(EMBEDDING).collect();
        let Some(own) = texts.get(class) else { return 0.0 };
        let dot = |other: &[f32]| own.iter().zip(other).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum::<f64>();
        let above = |other: &&[f32]| ((dot(other) - dot(own)) / f64::from(self.temperature)).exp();
        1.0 / texts.iter().map(above).sum::<f64>()
    }

    /// Returns the index of a class.
    ///
    /// # Errors
    /// If no class has this name. The sentence lists the most similar names.
    pub fn class(&self, name: &str) -> Result<usize> {
        let labels = &self.text.labels;
        if let Some(class) = labels.iter().position(|label| label == name) {
            return Ok(class);
        }
        let small = name.to_lowercase();
        let mut near: Vec<(usize, &String)> = labels
            .iter()
            .filter_map(|label| {
                let other = label.to_lowercase();
                let within =
                    !small.is_empty() && !other.is_empty() && (other.contains(&small) || small.contains(&other));
                let away = levenshtein(&small, &other);
                (within || away <= 2.max(small.chars().count() / 3)).then_some((away, label))
            })
            .collect();
        near.sort();
        let list = |names: &[&String]| names.iter().map(|n| format!("\"{n}\"")).collect::<Vec<_>>().join(", ");
        let hint = match near.iter().take(3).map(|(_, label)| *label).collect::<Vec<_>>() {
            names if !names.is_empty() => format!("did you mean {}?", list(&names)),
            _ => {
                let shown: Vec<_> = labels.iter().take(30).collect();
                let more = labels.len() - shown.len();
                let rest = if more > 0 { format!(" and {more} more") } else { String::new() };
                format!("there are {}{rest}.", list(&shown))
            }
        };
        Err(RunError::Refused(format!("There is no class \"{name}\"; {hint}")))
    }
}

fn file(path: &Path, reason: String) -> RunError {
    RunError::File { path: path.to_owned(), reason }
}

#[cfg(test)]
mod tests {
    use super::*;

    type Meta = HashMap<String, String>;
    type Tensors = Vec<(&'static str, Vec<f32>, [usize; 2])>;

    fn head(labels: &[&str]) -> SemanticHead {
        let number = |i: usize| (i as f32 * 0.37).sin();
        SemanticHead {
            decoder: (0..EMBEDDING * AUGMENTED).map(number).collect(),
            text: TextEmbeddings {
                labels: labels.iter().map(|l| (*l).to_owned()).collect(),
                channels: EMBEDDING,
                data: (7..7 + labels.len() * EMBEDDING).map(number).collect(),
            },
            temperature: 0.07,
        }
    }

    #[test]
    fn head_roundtrips_bit_for_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("semantics.safetensors");
        for labels in [&["wall"][..], &["wall", "sofa, \"big\"", "дверь", ""]] {
            let mut head = head(labels);
            (head.decoder[3], head.decoder[4], head.temperature) = (f32::MIN_POSITIVE / 8.0, -0.0, 0.1 + 0.2);
            head.save(&path).unwrap();
            let back = SemanticHead::load(&path).unwrap();
            assert_eq!(back, head);
            assert!(back.decoder.iter().zip(&head.decoder).all(|(a, b)| a.to_bits() == b.to_bits()));
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "something was left beside it");
    }

    #[test]
    fn each_fault_has_its_own_message() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("semantics.safetensors");
        let error = || SemanticHead::load(&path).unwrap_err().to_string();
        assert!(error().starts_with(&format!("\"{}\": there is no such file", path.display())), "{}", error());
        std::fs::write(&path, b"not a head at all").unwrap();
        assert!(error().contains("damaged or not a semantic head"), "{}", error());

        // A head that would not load again is not written, and the file stays unchanged.
        let refused = |change: fn(&mut SemanticHead)| {
            let mut head = head(&["wall", "sofa"]);
            change(&mut head);
            head.save(&path).unwrap_err().to_string()
        };
        assert!(refused(|h| h.decoder.truncate(9)).contains("the decoder has 9 numbers"));
        assert!(refused(|h| h.text.data.truncate(600)).contains("2 classes have 600 numbers"));
        assert!(refused(|h| h.text.channels = 256).contains("in rows of 256"));
        assert!(refused(|h| h.text.labels[1] = "wall".into()).contains("\"wall\" occurs twice"));
        assert!(refused(|h| h.decoder[5] = f32::NAN).contains("\"decoder\" holds values that are not finite"));
        assert!(refused(|h| h.text.data[5] = f32::INFINITY).contains("\"text_embeddings\" holds values that are not"));
        assert!(refused(|h| h.temperature = 0.0).contains("the temperature is 0, but must be"));
        assert!(refused(|h| h.temperature = f32::NAN).contains("the temperature is NaN"));
        assert!(refused(|h| (h.text.labels.clear(), h.text.data.clear()).0).contains("there are no classes"));
        assert_eq!(std::fs::read(&path).unwrap(), b"not a head at all");

        // Files of other programs are refused for the same reasons.
        let write = |change: &dyn Fn(&mut Meta, &mut Tensors)| {
            let h = head(&["wall", "sofa"]);
            let mut meta = HashMap::from([
                ("format".to_owned(), FORMAT.to_owned()),
                ("labels".to_owned(), r#"["wall", "sofa"]"#.to_owned()),
                ("temperature".to_owned(), "0.5".to_owned()),
            ]);
            let mut tensors = vec![("decoder", h.decoder, [512, 33]), ("text_embeddings", h.text.data, [2, EMBEDDING])];
            change(&mut meta, &mut tensors);
            let views = tensors.iter().map(|(name, data, shape)| (*name, Floats(data, shape.to_vec())));
            std::fs::write(&path, safetensors::serialize(views, Some(meta)).unwrap()).unwrap();
            SemanticHead::load(&path).map_or_else(|e| e.to_string(), |_| "loaded".to_owned())
        };
        assert_eq!(write(&|_, _| ()), "loaded");
        assert!(write(&|m, _| drop(m.remove("format"))).contains("not a semantic head"));
        assert!(write(&|m, _| drop(m.remove("labels"))).contains("does not name the classes"));
        assert!(write(&|m, _| drop(m.insert("labels".into(), "wall".into()))).contains("does not name the classes"));
        assert!(write(&|m, _| drop(m.insert("temperature".into(), "warm".into()))).contains("the temperature"));
        assert!(write(&|m, _| drop(m.insert("temperature".into(), "-1".into()))).contains("the temperature is -1"));
        let more = r#"["wall", "sofa", "lamp"]"#;
        let error = write(&|m, _| drop(m.insert("labels".into(), more.into())));
        assert!(error.contains("\"text_embeddings\" is F32 [2, 512], but must be F32 [3, 512]"), "{error}");
        assert!(write(&|_, t| drop(t.remove(0))).contains("there is no \"decoder\" in it"));
        assert!(write(&|_, t| t[0].2 = [33, 512]).contains("\"decoder\" is F32 [33, 512]"));
        assert!(write(&|_, t| t[0].1[7] = f32::NAN).contains("\"decoder\" holds values that are not finite"));
    }

    #[test]
    fn truncated_or_corrupted_files_do_not_panic() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        head(&["wall"]).save(&path).unwrap();
        let whole = std::fs::read(&path).unwrap();
        for length in (0..whole.len()).step_by(97).chain([whole.len() - 1]) {
            std::fs::write(&path, &whole[..length]).unwrap();
            assert!(SemanticHead::load(&path).is_err(), "{length}");
        }
        for at in 0..400 {
            let mut damaged = whole.clone();
            damaged[at] ^= 0x15;
            std::fs::write(&path, damaged).unwrap();
            let _ = SemanticHead::load(&path);
        }
    }

    #[test]
    fn peak_is_the_softmax_of_the_class_text() {
        let mut h = head(&["a", "b", "c"]);
        h.text.data.fill(0.0);
        // Embeddings of different lengths: along two axes, and between them.
        (h.text.data[0], h.text.data[EMBEDDING + 1]) = (2.0, 5.0);
        (h.text.data[2 * EMBEDDING], h.text.data[2 * EMBEDDING + 1]) = (3.0, 3.0);
        h.temperature = 0.5;
        let e = |x: f64| (2.0 * x).exp();
        let expected = e(1.0) / (e(1.0) + e(0.0) + e(0.5_f64.sqrt()));
        assert!((h.peak(0) - expected).abs() < 1e-6 && (h.peak(1) - expected).abs() < 1e-6);
        assert!((h.peak(2) - e(1.0) / (e(1.0) + 2.0 * e(0.5_f64.sqrt()))).abs() < 1e-6);
        h.temperature = 1e-3;
        assert_eq!((h.peak(0), h.peak(3)), (1.0, 0.0));
    }

    #[test]
    fn classes_are_found_by_name_or_similar_names_suggested() {
        let h = head(&["wall", "sofa", "floor lamp", "lamp", "table"]);
        assert_eq!(h.class("lamp").unwrap(), 3);
        let error = |name: &str| h.class(name).unwrap_err().to_string();
        assert_eq!(error("soffa"), "There is no class \"soffa\"; did you mean \"sofa\"?");
        assert_eq!(error("Lamp"), "There is no class \"Lamp\"; did you mean \"lamp\", \"floor lamp\"?");
        let all = "there are \"wall\", \"sofa\", \"floor lamp\", \"lamp\", \"table\".";
        assert_eq!(error("refrigerator"), format!("There is no class \"refrigerator\"; {all}"));
        let names: Vec<String> = (0..40).map(|i| format!("thing number {i}")).collect();
        let many = head(&names.iter().map(String::as_str).collect::<Vec<_>>());
        assert!(many.class("q").unwrap_err().to_string().ends_with("\"thing number 29\" and 10 more."));
    }
}
