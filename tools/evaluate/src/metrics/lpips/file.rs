//! File of LPIPS weights. Safetensors of 32-bit floats, with the network's name in the metadata.
//!
//! Tensors: `features.N.weight` (outputs, inputs, rows, columns) and `features.N.bias` (outputs), numbered as in
//! torchvision, and `heads.0` to `heads.4` (channels).

use super::layers::{LpipsNet, Numbers};
use crate::metrics::MetricError;
use safetensors::{Dtype, SafeTensors};
use std::path::Path;

/// Format name in the metadata.
const FORMAT: &str = "sgs-lpips-1";

/// Weights of a file.
pub(super) struct Weights {
    pub net: LpipsNet,
    pub convolutions: Vec<Numbers>,
    pub heads: Vec<Vec<f32>>,
}

impl Weights {
    /// Reads a file.
    pub fn load(path: &Path) -> Result<Weights, MetricError> {
        let fail = |reason: String| MetricError::File { path: path.to_owned(), reason };
        let bytes = std::fs::read(path).map_err(|e| match e.kind() {
            std::io::ErrorKind::NotFound => fail("there is no such file".into()),
            _ => fail(format!("cannot be read: {e}")),
        })?;
        let made = "tools/priors/sgs_priors/lpips_weights.py makes them";
        let damaged = |e: safetensors::SafeTensorError| fail(format!("damaged or no weights of LPIPS ({made}): {e}"));
        let (_, header) = SafeTensors::read_metadata(&bytes).map_err(damaged)?;
        let tensors = SafeTensors::deserialize(&bytes).map_err(damaged)?;
        let meta = header.metadata().clone().unwrap_or_default();
        if meta.get("format").map(String::as_str) != Some(FORMAT) {
            return Err(fail(format!("no weights of LPIPS ({made}): its metadata does not say \"{FORMAT}\"")));
        }
        let name = meta.get("net").map_or("", String::as_str);
        let Some(net) = LpipsNet::ALL.into_iter().find(|net| net.name() == name) else {
            return Err(fail(format!("its metadata says net \"{name}\", but must say \"vgg\" or \"alex\"")));
        };
        let floats = |name: String, shape: &[usize]| -> Result<Vec<f32>, MetricError> {
            let tensor = tensors.tensor(&name).map_err(|_| fail(format!("there is no \"{name}\" in it")))?;
            if tensor.dtype() != Dtype::F32 || tensor.shape() != shape {
                let (kind, found) = (tensor.dtype(), tensor.shape());
                return Err(fail(format!("\"{name}\" is {kind:?} {found:?}, but must be F32 {shape:?}")));
            }
            let values: Vec<f32> = tensor.data().as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
            match values.iter().all(|v| v.is_finite()) {
                true => Ok(values),
                false => Err(fail(format!("damaged: \"{name}\" holds values that are not finite"))),
            }
        };
        let mut convolutions = Vec::new();
        for s in net.shapes() {
            let weights = floats(format!("features.{}.weight", s.at), &[s.outputs, s.inputs, s.width, s.width])?;
            convolutions.push(Numbers { weights, biases: floats(format!("features.{}.bias", s.at), &[s.outputs])? });
        }
        let mut heads = Vec::new();
        for (i, channels) in net.stages().enumerate() {
            let head = floats(format!("heads.{i}"), &[channels])?;
            if head.iter().any(|v| *v < 0.0) {
                return Err(fail(format!("\"heads.{i}\" holds weights below 0, which no distance has")));
            }
            heads.push(head);
        }
        Ok(Weights { net, convolutions, heads })
    }
}
