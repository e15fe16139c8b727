//! Message: a JSON object and named arrays, as one safetensors file.
//!
//! The object is the value of the key `sgs` in the file's metadata. Files of safetensors libraries are valid payloads,
//! so a provider needs no codec of its own.

use crate::array::Array;
use crate::error::Nonsense;
use crate::kind::Kind;
use safetensors::SafeTensors;
use safetensors::tensor::TensorView;
use serde_json::Value;
use std::collections::{BTreeMap, HashMap};

/// Metadata key of the message's text.
const KEY: &str = "sgs";

/// Message of either side.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Message {
    /// JSON text; always an object.
    pub text: Value,
    /// Arrays by name.
    pub arrays: BTreeMap<String, Array>,
}

impl Message {
    /// Creates a message without arrays.
    pub fn new(text: Value) -> Message {
        Message { text, arrays: BTreeMap::new() }
    }

    /// Returns the payload.
    ///
    /// # Errors
    /// If an array's bytes do not match its shape.
    pub fn encode(&self) -> Result<Vec<u8>, Nonsense> {
        let wrong = |e: safetensors::SafeTensorError| Nonsense::Payload(e.to_string());
        let mut views = Vec::new();
        for (name, array) in &self.arrays {
            views.push((name, TensorView::new(array.kind.dtype(), array.shape.clone(), &array.bytes).map_err(wrong)?));
        }
        let metadata = HashMap::from([(KEY.to_owned(), self.text.to_string())]);
        safetensors::serialize(views, Some(metadata)).map_err(wrong)
    }

    /// Decodes a message from its payload.
    ///
    /// Skips arrays of unknown number types; only a later request for such an array is an error.
    ///
    /// # Errors
    /// If the payload is not a safetensors file, or its text is not a JSON object.
    pub fn decode(payload: &[u8]) -> Result<Message, Nonsense> {
        let wrong = |e: safetensors::SafeTensorError| Nonsense::Payload(e.to_string());
        let (_, metadata) = SafeTensors::read_metadata(payload).map_err(wrong)?;
        let text = metadata.metadata().as_ref().and_then(|m| m.get(KEY));
        let text =
            text.ok_or_else(|| Nonsense::Text(format!("is absent; it belongs into the metadata as \"{KEY}\"")))?;
        let text: Value = serde_json::from_str(text).map_err(|e| Nonsense::Text(format!("is not JSON ({e})")))?;
        if !text.is_object() {
            return Err(Nonsense::Text("is not a JSON object".into()));
        }
        let file = SafeTensors::deserialize(payload).map_err(wrong)?;
        let mut arrays = BTreeMap::new();
        for (name, view) in file.iter() {
            if let Some(kind) = Kind::from_dtype(view.dtype()) {
                let array = Array { kind, shape: view.shape().to_vec(), bytes: view.data().to_vec() };
                arrays.insert(name.to_owned(), array);
            }
        }
        Ok(Message { text, arrays })
    }

    /// Removes and returns a required array of the given type and shape.
    ///
    /// A 0 in `shape` stands for any nonzero length.
    pub(crate) fn take(&mut self, name: &str, kind: Kind, shape: &[usize]) -> Result<Array, Nonsense> {
        let Some(array) = self.arrays.remove(name) else {
            let names: Vec<String> = self.arrays.keys().map(|n| format!("\"{n}\"")).collect();
            let there = if names.is_empty() { "none of a known type".into() } else { names.join(", ") };
            return Err(Nonsense::Missing { name: name.into(), there });
        };
        if array.kind != kind {
            return Err(Nonsense::Type { name: name.into(), found: array.kind.to_string(), expected: kind });
        }
        let fits = array.shape.len() == shape.len()
            && array.shape.iter().zip(shape).all(|(&is, &must)| if must == 0 { is > 0 } else { is == must });
        if !fits {
            let axes: Vec<String> =
                shape.iter().map(|n| if *n == 0 { "any".to_owned() } else { n.to_string() }).collect();
            let expected = format!("[{}]", axes.join(", "));
            return Err(Nonsense::Shape { name: name.into(), found: array.shape, expected });
        }
        if kind == Kind::Bool
            && let Some(index) = array.bytes.iter().position(|b| *b > 1)
        {
            let value = f64::from(array.bytes[index]);
            return Err(Nonsense::Value { name: name.into(), value, index, expected: "only 0 and 1" });
        }
        Ok(array)
    }

    /// Returns a required text field.
    pub(crate) fn string(&self, name: &'static str, expected: &str) -> Result<&str, Nonsense> {
        self.text[name].as_str().ok_or_else(|| self.wrong(name, expected))
    }

    /// Returns a required field that is a list of texts.
    pub(crate) fn strings(&self, name: &'static str) -> Result<Vec<String>, Nonsense> {
        let list = self.text[name].as_array();
        let texts = list.and_then(|l| l.iter().map(|v| v.as_str().map(str::to_owned)).collect::<Option<Vec<_>>>());
        texts.ok_or_else(|| self.wrong(name, "a list of texts"))
    }

    /// Returns the error for a field with a wrong value.
    pub(crate) fn wrong(&self, name: &'static str, expected: &str) -> Nonsense {
        let found = match self.text.get(name) {
            None => "absent".to_owned(),
            Some(value) => value.to_string().chars().take(60).collect(),
        };
        Nonsense::Field { name, expected: expected.to_owned(), found }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn sample() -> Message {
        let mut message = Message::new(json!({"kind": "answer", "to": 3, "text": "größer"}));
        message.arrays.insert("a".into(), Array::f32(&[2, 2], &[0.5, -1.0, f32::NAN, 4.0]));
        message.arrays.insert("b".into(), Array::u8(&[3], vec![1, 2, 255]));
        message
    }

    #[test]
    fn messages_round_trip() {
        let message = sample();
        let back = Message::decode(&message.encode().unwrap()).unwrap();
        assert_eq!(back.text, message.text);
        assert_eq!(back.arrays["a"].bytes, message.arrays["a"].bytes);
        assert_eq!(back.arrays["b"], message.arrays["b"]);
        assert!(back.arrays["a"].floats()[2].is_nan());
    }

    #[test]
    fn damaged_payloads_never_panic() {
        let whole = sample().encode().unwrap();
        for length in 0..whole.len() {
            assert!(Message::decode(&whole[..length]).is_err(), "{length}");
        }
        for i in 0..whole.len() {
            for flip in [1, 0x20, 0x80, 0xff] {
                let mut damaged = whole.clone();
                damaged[i] ^= flip;
                let _ = Message::decode(&damaged);
            }
        }
    }

    #[test]
    fn message_errors_name_field_or_array() {
        let fail = |name: &str, kind, shape: &[usize]| sample().take(name, kind, shape).unwrap_err().to_string();
        assert!(sample().take("a", Kind::F32, &[0, 2]).is_ok());
        assert_eq!(fail("c", Kind::F32, &[1]), "the array \"c\" is missing; there is \"a\", \"b\"");
        assert_eq!(fail("a", Kind::F16, &[2, 2]), "the array \"a\" holds F32, but must hold F16");
        assert_eq!(fail("a", Kind::F32, &[2, 0, 3]), "the array \"a\" has the shape [2, 2], but must have [2, any, 3]");
        assert_eq!(fail("a", Kind::F32, &[2, 3]), "the array \"a\" has the shape [2, 2], but must have [2, 3]");
        let mut marks = Message::new(json!({}));
        marks.arrays.insert("m".into(), Array { kind: Kind::Bool, shape: vec![2], bytes: vec![1, 7] });
        let error = marks.take("m", Kind::Bool, &[2]).unwrap_err().to_string();
        assert_eq!(error, "the array \"m\" holds 7 at index 1, but must hold only 0 and 1");
        let error = sample().arrays["a"].check("a", "finite numbers", f32::is_finite).unwrap_err().to_string();
        assert_eq!(error, "the array \"a\" holds NaN at index 2, but must hold finite numbers");
        let error = sample().string("frame", "a frame").unwrap_err().to_string();
        assert_eq!(error, "the field \"frame\" must be a frame, but is absent");
        let error = sample().strings("to").unwrap_err().to_string();
        assert_eq!(error, "the field \"to\" must be a list of texts, but is 3");
        let bare = safetensors::serialize(Vec::<(String, TensorView)>::new(), None).unwrap();
        assert!(Message::decode(&bare).unwrap_err().to_string().starts_with("the message's text is absent"));
    }
}
