//! Framing of messages in a byte stream: magic number, length, payload.

use crate::error::Nonsense;
use crate::message::Message;

/// Magic number of every message.
pub(crate) const MAGIC: [u8; 4] = *b"SGSP";
/// Size of the magic number and the length in bytes.
const HEAD: usize = 12;

/// Encodes a message for the pipe.
pub(crate) fn framed(message: &Message) -> Result<Vec<u8>, Nonsense> {
    let payload = message.encode()?;
    let mut bytes = Vec::with_capacity(HEAD + payload.len());
    bytes.extend(MAGIC);
    bytes.extend((payload.len() as u64).to_le_bytes());
    bytes.extend(payload);
    Ok(bytes)
}

/// Decoder that assembles messages from arriving bytes.
#[derive(Debug)]
pub(crate) struct Decoder {
    bytes: Vec<u8>,
    limit: u64,
}

impl Decoder {
    /// Creates a decoder for payloads of at most `limit` bytes.
    pub(crate) fn new(limit: u64) -> Decoder {
        Decoder { bytes: Vec::new(), limit }
    }

    /// Appends arrived bytes.
    pub(crate) fn push(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
    }

    /// Returns true if a message has begun but is incomplete.
    pub(crate) fn is_amid(&self) -> bool {
        !self.bytes.is_empty()
    }

    /// Returns the next message if it is complete.
    ///
    /// A wrong magic number or length is detected before the payload arrives.
    pub(crate) fn next(&mut self) -> Result<Option<Message>, Nonsense> {
        let head = &self.bytes[..self.bytes.len().min(MAGIC.len())];
        if *head != MAGIC[..head.len()] {
            let shown = String::from_utf8_lossy(&self.bytes[..self.bytes.len().min(24)]);
            return Err(Nonsense::Magic(shown.chars().flat_map(char::escape_default).collect()));
        }
        let Some(length) = self.bytes.get(MAGIC.len()..HEAD).and_then(|b| b.try_into().ok()).map(u64::from_le_bytes)
        else {
            return Ok(None);
        };
        if length > self.limit {
            return Err(Nonsense::Length { length, limit: self.limit });
        }
        // The limit is checked, so the sum does not overflow.
        let end = HEAD + length as usize;
        if self.bytes.len() < end {
            return Ok(None);
        }
        let rest = self.bytes.split_off(end);
        let whole = std::mem::replace(&mut self.bytes, rest);
        Message::decode(&whole[HEAD..]).map(Some)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn decoding_is_independent_of_chunk_size() {
        let messages = [Message::new(json!({"n": 1})), Message::new(json!({"n": 2, "longer": "yes"}))];
        let bytes: Vec<u8> = messages.iter().flat_map(|m| framed(m).unwrap()).collect();
        for piece in [1, 3, 7, 50, bytes.len()] {
            let mut decoder = Decoder::new(1000);
            let mut found = Vec::new();
            for part in bytes.chunks(piece) {
                decoder.push(part);
                while let Some(message) = decoder.next().unwrap() {
                    found.push(message);
                }
            }
            assert_eq!(found, messages);
            assert!(!decoder.is_amid());
        }
    }

    #[test]
    fn magic_and_length_are_checked_before_the_payload() {
        let mut decoder = Decoder::new(1000);
        decoder.push(b"SG");
        assert_eq!(decoder.next(), Ok(None));
        decoder.push(b"X");
        assert_eq!(decoder.next(), Err(Nonsense::Magic("SGX".into())));
        let mut decoder = Decoder::new(1000);
        decoder.push(b"SGSP");
        decoder.push(&1001_u64.to_le_bytes());
        assert_eq!(decoder.next(), Err(Nonsense::Length { length: 1001, limit: 1000 }));
        let mut decoder = Decoder::new(u64::MAX);
        decoder.push(b"Loading weights...\n\x1b[1m");
        let error = decoder.next().unwrap_err().to_string();
        assert!(error.contains(r#"there was "Loading weights...\n\u{1b}[1m""#), "{error}");
    }
}
