//! Visibility field of a run in one file: tables per level, network, box.
//!
//! Guarantees: a saved field is loaded bit for bit. A missing, damaged or misshapen file is refused with a sentence
//! that states which. Inference on a device is in other modules.

use crate::error::{Result, RunError};
use crate::floats::Floats;
use safetensors::{Dtype, SafeTensors};
use sgs_passes::pipeline::FieldStep;
use sgs_passes::shade::visibility::{FIELD_FEATURES, FIELD_WIDTH, FieldConfig};
use std::collections::HashMap;
use std::path::Path;

/// Format identifier in the file.
const FORMAT: &str = "sgs-visibility-1";

/// Trained visibility field.
#[derive(Clone, Debug, PartialEq)]
pub struct VisibilityFile {
    /// Dimensions of the field.
    pub config: FieldConfig,
    /// Lower corner of the box in world space.
    pub low: [f32; 3],
    /// Upper corner.
    pub high: [f32; 3],
    /// Two features per entry, level by level.
    pub tables: Vec<f32>,
    /// Weights of the three layers. Inputs of the first: features, direction, distance.
    pub mlp: Vec<f32>,
}

impl VisibilityFile {
    /// Returns the field reduced to its `levels` coarsest levels.
    pub fn first_levels(&self, levels: u32) -> VisibilityFile {
        let [tables, mlp] = self.config.numbers_of_first_levels(levels, 1, [&self.tables, &self.mlp]);
        VisibilityFile { config: self.config.first_levels(levels), tables, mlp, ..*self }
    }

    /// Writes the field atomically.
    ///
    /// # Errors
    /// If the field would not load again, or the file cannot be written. An existing file then remains unchanged.
    pub fn save(&self, path: &Path) -> Result<()> {
        let fail = |reason: String| file(path, reason);
        self.check().map_err(fail)?;
        let c = &self.config;
        let sizes = [c.levels, c.log2_table, c.coarsest, c.finest];
        let mut meta: HashMap<String, String> =
            SIZES.iter().zip(sizes).map(|(name, n)| ((*name).to_owned(), n.to_string())).collect();
        if c.of != c.levels {
            meta.insert(OF.to_owned(), c.of.to_string());
        }
        meta.insert("format".to_owned(), FORMAT.to_owned());
        let corners = [self.low, self.high];
        let mut tensors = vec![("box".to_owned(), Floats(corners.as_flattened(), vec![2, 3]))];
        let mut rest = self.tables.as_slice();
        for (level, entries) in c.level_entries().into_iter().enumerate() {
            let (table, after) = rest.split_at(entries as usize * FIELD_FEATURES);
            rest = after;
            tensors.push((table_name(level), Floats(table, vec![entries as usize, FIELD_FEATURES])));
        }
        let mut rest = self.mlp.as_slice();
        for (name, shape) in layers(c) {
            let (weights, after) = rest.split_at(shape[0] * shape[1]);
            rest = after;
            tensors.push((name.to_owned(), Floats(weights, shape.to_vec())));
        }
        let bytes = crate::floats::serialize(tensors, meta).map_err(|e| fail(e.to_string()))?;
        sgs_scene::atomic_write(path, |f| std::io::Write::write_all(f, &bytes))?;
        Ok(())
    }

    /// Reads a file written by [`VisibilityFile::save`].
    ///
    /// # Errors
    /// If the file does not exist or does not hold a field.
    pub fn load(path: &Path) -> Result<VisibilityFile> {
        let fail = |reason: String| file(path, reason);
        let bytes = std::fs::read(path).map_err(|e| match e.kind() {
            std::io::ErrorKind::NotFound => fail("there is no such file".into()),
            _ => fail(format!("cannot be read: {e}")),
        })?;
        let damaged = |e: safetensors::SafeTensorError| fail(format!("damaged or not a visibility field: {e}"));
        let (_, header) = SafeTensors::read_metadata(&bytes).map_err(damaged)?;
        let tensors = SafeTensors::deserialize(&bytes).map_err(damaged)?;
        let meta = header.metadata().clone().unwrap_or_default();
        if meta.get("format").map(String::as_str) != Some(FORMAT) {
            return Err(fail(format!("not a visibility field: its metadata does not say \"{FORMAT}\"")));
        }
        let size = |name: &str| -> Result<u32> {
            let value = meta.get(name).and_then(|text| text.parse().ok());
            value.ok_or_else(|| fail(format!("the metadata does not say \"{name}\"")))
        };
        let [levels, log2_table, coarsest, finest] = SIZES;
        let config = FieldConfig::new(size(levels)?, size(log2_table)?, size(coarsest)?, size(finest)?);
        let of = if meta.contains_key(OF) { size(OF)? } else { config.levels };
        let config = FieldConfig { of, ..config };
        config.check().map_err(|e| fail(e.to_string()))?;
        let floats = |name: &str, shape: [usize; 2]| -> Result<Vec<f32>> {
            let tensor = tensors.tensor(name).map_err(|_| fail(format!("there is no \"{name}\" in it")))?;
            if tensor.dtype() != Dtype::F32 || tensor.shape() != shape {
                let (kind, found) = (tensor.dtype(), tensor.shape());
                return Err(fail(format!("\"{name}\" is {kind:?} {found:?}, but must be F32 {shape:?}")));
            }
            Ok(tensor.data().as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect())
        };
        let corners = floats("box", [2, 3])?;
        let mut tables = Vec::new();
        for (level, entries) in config.level_entries().into_iter().enumerate() {
            tables.extend(floats(&table_name(level), [entries as usize, FIELD_FEATURES])?);
        }
        let mut mlp = Vec::new();
        for (name, shape) in layers(&config) {
            mlp.extend(floats(name, shape)?);
        }
        let corner = |first: usize| [0, 1, 2].map(|k| corners[first + k]);
        let field = VisibilityFile { config, low: corner(0), high: corner(3), tables, mlp };
        field.check().map_err(fail)?;
        Ok(field)
    }

    /// Returns the first problem as an error.
    fn check(&self) -> std::result::Result<(), String> {
        self.config.check().map_err(|e| e.to_string())?;
        let table = self.config.entries() as usize * FIELD_FEATURES;
        for (name, values, length) in [("tables", &self.tables, table), ("layers", &self.mlp, self.config.weights())] {
            if values.len() != length {
                return Err(format!("its {name} have {} numbers, but must have {length}", values.len()));
            }
            if values.iter().any(|v| !v.is_finite()) {
                return Err(format!("damaged: its {name} hold values that are not finite"));
            }
        }
        if !(0..3).all(|k| self.high[k] - self.low[k] > 0.0 && (self.high[k] - self.low[k]).is_finite()) {
            return Err(format!("the box from {:?} to {:?} is none", self.low, self.high));
        }
        Ok(())
    }
}

/// Metadata key of the original number of levels, if the field was reduced.
const OF: &str = "of_levels";

/// Names of the sizes in the metadata.
const SIZES: [&str; 4] = ["levels", "log2_table", "coarsest", "finest"];

fn table_name(level: usize) -> String {
    format!("table.{level}")
}

/// Returns names and shapes of the network's tensors, in the order of `mlp`.
fn layers(config: &FieldConfig) -> [(&'static str, [usize; 2]); 3] {
    let width = FIELD_WIDTH;
    [("first", [width, config.inputs()]), ("second", [width, width]), ("last", [1, width])]
}

fn file(path: &Path, reason: String) -> RunError {
    RunError::File { path: path.to_owned(), reason }
}

/// Returns the uniform with the box of a field.
pub fn field_box(low: [f32; 3], high: [f32; 3]) -> FieldStep {
    let inverse = std::array::from_fn(|i| 1.0 / (high[i] - low[i]).max(1e-20));
    FieldStep { box_min: low, box_max: high, box_inverse: inverse, ..FieldStep::default() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn field() -> VisibilityFile {
        let config = FieldConfig::new(3, 8, 4, 20);
        let (low, high) = ([-1.0, 0.0, 0.5], [1.0, 0.1, 3.0]);
        VisibilityFile { config, low, high, tables: config.initial_tables(1), mlp: config.initial_weights(1) }
    }

    #[test]
    fn field_roundtrips_bit_for_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("visibility.safetensors");
        let mut saved = field();
        (saved.tables[3], saved.mlp[4]) = (f32::MIN_POSITIVE / 8.0, -0.0);
        saved.save(&path).unwrap();
        let back = VisibilityFile::load(&path).unwrap();
        assert_eq!(back, saved);
        let same = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits());
        assert!(same(&back.tables, &saved.tables) && same(&back.mlp, &saved.mlp));
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "something was left beside it");
    }

    #[test]
    fn reduced_field_roundtrips() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("visibility.safetensors");
        let few = field().first_levels(2);
        assert_eq!((few.config.levels, few.config.of), (2, 3));
        few.save(&path).unwrap();
        assert_eq!(VisibilityFile::load(&path).unwrap(), few);
        let mut bytes = std::fs::read(&path).unwrap();
        let at = bytes.windows(14).position(|w| w == b"of_levels\":\"3\"").unwrap();
        bytes[at + 12] = b'1';
        std::fs::write(&path, &bytes).unwrap();
        assert!(
            VisibilityFile::load(&path)
                .unwrap_err()
                .to_string()
                .contains("with 2 levels cannot be the first ones of 1")
        );
    }

    #[test]
    fn each_fault_has_its_own_message() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("visibility.safetensors");
        let error = || VisibilityFile::load(&path).err().map_or_else(|| "loaded".to_owned(), |e| e.to_string());
        assert!(error().contains("there is no such file"), "{}", error());
        std::fs::write(&path, b"not a field at all").unwrap();
        assert!(error().contains("damaged or not a visibility field"), "{}", error());
        let refused = |change: fn(&mut VisibilityFile)| {
            let mut field = field();
            change(&mut field);
            field.save(&path).unwrap_err().to_string()
        };
        assert!(refused(|f| f.tables.truncate(9)).contains("its tables have 9 numbers"));
        assert!(refused(|f| f.mlp[5] = f32::NAN).contains("its layers hold values that are not finite"));
        assert!(refused(|f| f.high[1] = f.low[1]).contains("is none"));
        assert!(refused(|f| f.config.levels = 0).contains("1 to 16 levels"));
        assert_eq!(std::fs::read(&path).unwrap(), b"not a field at all");
        // Data that contradicts the metadata.
        let other = field();
        other.save(&path).unwrap();
        let whole = std::fs::read(&path).unwrap();
        let at = whole.windows(12).position(|w| w == b"coarsest\":\"4").unwrap();
        let mut changed = whole.clone();
        changed[at + 11] = b'5';
        std::fs::write(&path, &changed).unwrap();
        assert!(error().contains("\"table.0\" is F32"), "{}", error());
        for length in (0..whole.len()).step_by(97) {
            std::fs::write(&path, &whole[..length]).unwrap();
            assert!(VisibilityFile::load(&path).is_err(), "{length}");
        }
        // The format itself allows NaN.
        let bits = other.mlp[0].to_le_bytes();
        let at = whole.windows(4).position(|w| w == bits).unwrap();
        let mut changed = whole.clone();
        changed[at..at + 4].copy_from_slice(&f32::NAN.to_le_bytes());
        std::fs::write(&path, &changed).unwrap();
        assert!(error().contains("not finite"), "{}", error());
    }
}
