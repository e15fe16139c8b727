//! Messages on standard error.

use std::io::Write;

/// Prints a line on standard error. A line that cannot be written is left out: a full disk must not end a training.
pub fn say(text: impl std::fmt::Display) {
    let _ = writeln!(std::io::stderr(), "{text}");
}
