//! Stub for systems other than Unix, which do not support providers.

use crate::error::Nonsense;
use crate::message::Message;
use std::io;
use std::time::Duration;

/// Reason why no message arrived.
#[allow(dead_code, reason = "the same type as on Unix")]
pub(crate) enum Broken {
    Ended(String),
    TimeOut,
    Nonsense(Nonsense),
}

/// Uninhabited type.
pub(crate) enum Pipe {}

impl Pipe {
    pub(crate) fn start(_words: &[String], _limit: u64) -> io::Result<Pipe> {
        Err(io::Error::new(io::ErrorKind::Unsupported, "providers need a Unix system"))
    }

    pub(crate) fn last(&self) -> &str {
        match *self {}
    }

    pub(crate) fn exchange(&mut self, _out: &[u8], _limit: Duration) -> Result<Message, Broken> {
        match *self {}
    }

    pub(crate) fn finish(&mut self) {
        match *self {}
    }
}
