//! Options of devices that all programs share.

use std::path::PathBuf;

/// Returns the folder of the pipeline cache: `sgs` in the user's cache directory, if there is one.
pub fn cache_folder() -> Option<PathBuf> {
    let base = std::env::var_os("XDG_CACHE_HOME").map(PathBuf::from);
    let base = base.or_else(|| std::env::var_os("HOME").map(|h| PathBuf::from(h).join(".cache")))?;
    Some(base.join("sgs"))
}
