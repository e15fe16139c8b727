//! Checkpoint file of the transport stage, parsed without a device.

use crate::error::{Result, TrainError, error};
use safetensors::{Dtype, SafeTensors};
use sgs_run::EmitterFile;
use sgs_run::floats::{Numbers, serialize};
use sgs_transport::FittedRoom;
use std::collections::HashMap;
use std::path::Path;

/// Format name in the metadata.
const FORMAT: &str = "sgs-transport-1";

/// Tensor of the checkpoint of the materials' training.
const TRAINING: &str = "training";

/// Tensor of the emitters of the Gaussians.
const OF_GAUSSIANS: &str = "emitters";

/// Contents of a checkpoint.
pub(crate) struct Saved {
    /// Fitted room; none before the first step.
    pub fitted: Option<FittedRoom>,
    /// Number of finished steps.
    pub step: u32,
    /// Checkpoint of the materials' training; none before the second step.
    pub training: Option<Vec<u8>>,
}

impl Saved {
    /// Writes a checkpoint.
    ///
    /// # Errors
    /// If the file cannot be written.
    ///
    /// `training`: finished steps of the materials' training and its checkpoint.
    pub fn write(path: &Path, fitted: Option<&FittedRoom>, training: Option<(u32, Vec<u8>)>) -> Result<()> {
        let refused = |e: &dyn std::fmt::Display| error(path, e.to_string());
        let step = (u32::from(fitted.is_some()) + training.as_ref().map_or(0, |t| t.0)).to_string();
        let words: Option<Vec<u32>> = training.map(|(_, bytes)| {
            let whole = bytes.chunks(4).map(|b| std::array::from_fn(|i| b.get(i).copied().unwrap_or(b' ')));
            whole.map(u32::from_le_bytes).collect()
        });
        let mut meta = HashMap::from([("format".to_owned(), FORMAT.to_owned()), ("step".to_owned(), step)]);
        let mut tensors = Vec::new();
        if let Some(FittedRoom { emitters, of_gaussians, psnr, uniform_psnr }) = fitted {
            meta.insert("psnr".to_owned(), psnr.to_string());
            meta.insert("uniform_psnr".to_owned(), uniform_psnr.to_string());
            meta.insert("file".to_owned(), serde_json::to_string(emitters).map_err(|e| refused(&e))?);
            tensors.push((OF_GAUSSIANS, Numbers::Words(of_gaussians, vec![of_gaussians.len()])));
        }
        if let Some(words) = &words {
            tensors.push((TRAINING, Numbers::Words(words, vec![words.len()])));
        }
        let bytes = serialize(tensors, meta).map_err(|e| refused(&e))?;
        sgs_scene::atomic_write(path, |f| std::io::Write::write_all(f, &bytes))?;
        Ok(())
    }

    /// Reads a checkpoint of a scene with this number of splats.
    ///
    /// # Errors
    /// If the file is damaged, or belongs to other splats.
    pub fn read(path: &Path, splats: usize) -> Result<Saved> {
        let refused = |reason: String| error(path, reason);
        let bytes = std::fs::read(path).map_err(|e| refused(e.to_string()))?;
        let (_, header) = SafeTensors::read_metadata(&bytes).map_err(|e| refused(format!("not a checkpoint: {e}")))?;
        let meta = header.metadata().clone().unwrap_or_default();
        let text = |name: &str| meta.get(name).map(String::as_str);
        if text("format") != Some(FORMAT) {
            return Err(refused("not a checkpoint of the transport stage".into()));
        }
        let step = text("step").and_then(|t| t.parse().ok());
        let step: u32 = step.ok_or_else(|| refused("damaged: the step is no number".into()))?;
        if step == 0 {
            return Ok(Saved { fitted: None, step, training: None });
        }
        let number = |name: &str| {
            let number = text(name).and_then(|t| t.parse::<f64>().ok());
            number.ok_or_else(|| refused(format!("the checkpoint does not say its {name}")))
        };
        let (psnr, uniform_psnr) = (number("psnr")?, number("uniform_psnr")?);
        let file = text("file").ok_or_else(|| refused("the checkpoint has no emitters".into()))?;
        let emitters: EmitterFile =
            serde_json::from_str(file).map_err(|e| refused(format!("damaged: not emitters: {e}")))?;
        let tensors = SafeTensors::deserialize(&bytes).map_err(|e| refused(format!("damaged: {e}")))?;
        let tensor = tensors.tensor(OF_GAUSSIANS).map_err(|e| refused(format!("damaged: {e}")))?;
        if tensor.dtype() != Dtype::U32 || tensor.shape() != [splats] {
            let found = tensor.shape();
            return Err(refused(format!("the emitters of {found:?} splats do not belong to {splats} splats")));
        }
        let of_gaussians = tensor.data().as_chunks().0.iter().map(|b| u32::from_le_bytes(*b)).collect();
        let fitted = FittedRoom { emitters, of_gaussians, psnr, uniform_psnr };
        check(&fitted, splats).map_err(|reason| refused(format!("damaged: {reason}")))?;
        let training = tensors.tensor(TRAINING).ok().map(|t| t.data().to_vec());
        if training.is_some() != (step > 1) {
            return Err(refused(format!("damaged: step {step} does not match its tensors")));
        }
        Ok(Saved { fitted: Some(fitted), step, training })
    }
}

/// Checks that a room is valid and belongs to this number of splats.
pub(super) fn check(fitted: &FittedRoom, splats: usize) -> std::result::Result<(), String> {
    let FittedRoom { emitters, of_gaussians, .. } = fitted;
    emitters.check()?;
    if of_gaussians.len() != splats {
        return Err(format!("{} splats have an emitter, not {splats}", of_gaussians.len()));
    }
    let known = emitters.emitters.len();
    match of_gaussians.iter().find(|e| **e as usize > known) {
        Some(bad) => Err(format!("a splat belongs to emitter {bad} of {known}")),
        None => Ok(()),
    }
}

/// Returns the error of a fit whose result is invalid.
pub(super) fn invalid(reason: String) -> TrainError {
    TrainError::Transport(sgs_transport::TransportError::Refused(format!("The fit of the room failed: {reason}.")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use sgs_config::TransportSettings;
    use sgs_passes::transport::LightShape;
    use sgs_run::{EmitterRow, EnclosureRow};

    fn room() -> FittedRoom {
        let enclosure = EnclosureRow { low: [0.0; 3], high: [1.0; 3], albedo: [[0.5; 3]; 6] };
        let shape = LightShape::Sphere { center: [0.1; 3], radius: 0.3 };
        let row = EmitterRow { name: "bulb".into(), on: true, color: [1.5, 0.1, 0.0], shape };
        let emitters = EmitterFile::new(enclosure, TransportSettings::default(), vec![row]);
        FittedRoom { emitters, of_gaussians: vec![0, 1, 1, 0], psnr: 0.1 + 0.2, uniform_psnr: 0.1 }
    }

    #[test]
    fn checkpoint_holds_every_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("transport.safetensors");
        Saved::write(&path, None, None).unwrap();
        assert_eq!(Saved::read(&path, 4).unwrap().fitted, None);
        Saved::write(&path, Some(&room()), None).unwrap();
        assert_eq!(Saved::read(&path, 4).unwrap().fitted, Some(room()));
        let endless = FittedRoom { psnr: f64::INFINITY, ..room() };
        Saved::write(&path, Some(&endless), None).unwrap();
        assert_eq!(Saved::read(&path, 4).unwrap().fitted, Some(endless));
        Saved::write(&path, Some(&room()), Some((7, vec![1, 2, 3, 4, 5]))).unwrap();
        let saved = Saved::read(&path, 4).unwrap();
        assert_eq!((saved.step, saved.training), (8, Some(vec![1, 2, 3, 4, 5, b' ', b' ', b' '])));
    }

    #[test]
    fn damaged_checkpoints_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("transport.safetensors");
        let refused = |room: &FittedRoom, splats: usize| {
            Saved::write(&path, Some(room), None).unwrap();
            Saved::read(&path, splats).err().map(|e| e.to_string()).unwrap_or_default()
        };
        assert!(refused(&room(), 5).contains("do not belong to 5 splats"));
        let stray = FittedRoom { of_gaussians: vec![0, 2, 0, 0], ..room() };
        assert!(refused(&stray, 4).contains("belongs to emitter 2 of 1"));
        let mut flat = room();
        flat.emitters.enclosure.high[2] = 0.0;
        assert!(refused(&flat, 4).contains("along z"));
        let whole = std::fs::read(&path).unwrap();
        for length in 0..whole.len() {
            std::fs::write(&path, &whole[..length]).unwrap();
            assert!(Saved::read(&path, 4).is_err(), "{length}");
        }
    }
}
