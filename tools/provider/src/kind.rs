//! Number types of messages.

use safetensors::Dtype;

/// Number type of the protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Byte that is 0 or 1.
    Bool,
    /// Byte.
    U8,
    /// Unsigned 16-bit integer.
    U16,
    /// Half-precision float.
    F16,
    /// 32-bit float.
    F32,
}

impl Kind {
    /// Returns the size of a number in bytes.
    pub fn size(self) -> usize {
        match self {
            Kind::Bool | Kind::U8 => 1,
            Kind::U16 | Kind::F16 => 2,
            Kind::F32 => 4,
        }
    }

    pub(crate) fn dtype(self) -> Dtype {
        match self {
            Kind::Bool => Dtype::BOOL,
            Kind::U8 => Dtype::U8,
            Kind::U16 => Dtype::U16,
            Kind::F16 => Dtype::F16,
            Kind::F32 => Dtype::F32,
        }
    }

    pub(crate) fn from_dtype(dtype: Dtype) -> Option<Kind> {
        [Kind::Bool, Kind::U8, Kind::U16, Kind::F16, Kind::F32].into_iter().find(|k| k.dtype() == dtype)
    }
}

impl std::fmt::Display for Kind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:?}", self.dtype())
    }
}
