//! Arrays of messages: a number type, a shape, and little-endian bytes in C order.

use crate::error::Nonsense;
use crate::kind::Kind;
use half::f16;

/// Array of a message.
#[derive(Clone, Debug, PartialEq)]
pub struct Array {
    /// Type of the numbers.
    pub kind: Kind,
    /// Length along each axis. The last index varies fastest.
    pub shape: Vec<usize>,
    /// Numbers, little-endian.
    pub bytes: Vec<u8>,
}

impl Array {
    /// Creates an array of bytes, such as an 8-bit image.
    pub fn u8(shape: &[usize], values: Vec<u8>) -> Array {
        Array { kind: Kind::U8, shape: shape.to_vec(), bytes: values }
    }

    /// Creates an array of 32-bit floats.
    pub fn f32(shape: &[usize], values: &[f32]) -> Array {
        let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        Array { kind: Kind::F32, shape: shape.to_vec(), bytes }
    }

    /// Returns the numbers of a float array, or an empty vector for other types.
    pub fn floats(&self) -> Vec<f32> {
        match self.kind {
            Kind::F32 => words::<4>(&self.bytes).map(f32::from_le_bytes).collect(),
            Kind::F16 => words::<2>(&self.bytes).map(|w| f16::from_le_bytes(w).to_f32()).collect(),
            _ => Vec::new(),
        }
    }

    /// Returns the numbers of a half-float array, or an empty vector for other types.
    pub fn halves(&self) -> Vec<f16> {
        if self.kind == Kind::F16 { words::<2>(&self.bytes).map(f16::from_le_bytes).collect() } else { Vec::new() }
    }

    /// Returns the numbers of a 16-bit array, or an empty vector for other types.
    pub fn words(&self) -> Vec<u16> {
        if self.kind == Kind::U16 { words::<2>(&self.bytes).map(u16::from_le_bytes).collect() } else { Vec::new() }
    }

    /// Returns an error for the first number of a float array that `allowed` refuses.
    pub(crate) fn check(&self, name: &str, expected: &'static str, allowed: fn(f32) -> bool) -> Result<(), Nonsense> {
        let values = self.floats();
        match values.iter().position(|v| !allowed(*v)) {
            None => Ok(()),
            Some(index) => {
                Err(Nonsense::Value { name: name.to_owned(), value: f64::from(values[index]), index, expected })
            }
        }
    }
}

fn words<const N: usize>(bytes: &[u8]) -> impl Iterator<Item = [u8; N]> {
    bytes.chunks_exact(N).map(|chunk| {
        let mut word = [0; N];
        word.copy_from_slice(chunk);
        word
    })
}
