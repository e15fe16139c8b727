//! Directory under construction, renamed into place when complete.
//!
//! An incomplete directory is removed.

use std::fs;
use std::path::{Path, PathBuf};

use crate::error::SynthError;

/// Directory under construction.
pub(crate) struct Stage {
    out: PathBuf,
    work: PathBuf,
    committed: bool,
}

impl Stage {
    /// Checks that `out` may be written and creates its temporary sibling.
    pub(crate) fn open(out: &Path, replace: bool) -> Result<Self, SynthError> {
        let name = out.file_name().ok_or_else(|| SynthError::BadPath(out.to_owned()))?;
        check(out, replace)?;
        let parent = match out.parent() {
            Some(p) if !p.as_os_str().is_empty() => p.to_owned(),
            _ => PathBuf::from("."),
        };
        fs::create_dir_all(&parent).map_err(SynthError::io("create", &parent))?;
        let sibling = format!(".{}.partial-{}", name.to_string_lossy(), std::process::id());
        let work = parent.join(sibling);
        remove(&work)?;
        fs::create_dir(&work).map_err(SynthError::io("create", &work))?;
        Ok(Self { out: out.to_owned(), work, committed: false })
    }

    /// Returns the path of a file under construction and creates its folder.
    pub(crate) fn file(&self, relative: impl AsRef<Path>) -> Result<PathBuf, SynthError> {
        let path = self.work.join(relative);
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder).map_err(SynthError::io("create", folder))?;
        }
        Ok(path)
    }

    /// Writes a whole file.
    pub(crate) fn write(&self, relative: impl AsRef<Path>, bytes: &[u8]) -> Result<(), SynthError> {
        let path = self.file(relative)?;
        fs::write(&path, bytes).map_err(SynthError::io("write", path))
    }

    /// Renames the directory into place. Removes the previous directory last.
    pub(crate) fn commit(mut self) -> Result<(), SynthError> {
        let old = self.work.with_extension("old");
        remove(&old)?;
        if self.out.exists() {
            fs::rename(&self.out, &old).map_err(SynthError::io("move away", &self.out))?;
        }
        fs::rename(&self.work, &self.out).map_err(SynthError::io("rename into", &self.out))?;
        self.committed = true;
        remove(&old)
    }
}

impl Drop for Stage {
    fn drop(&mut self) {
        if !self.committed {
            // Best effort: no caller can receive an error here.
            let _ = fs::remove_dir_all(&self.work);
        }
    }
}

/// Refuses an existing output path that may not be replaced.
///
/// Permits an empty directory, and with `replace` a scene directory.
fn check(out: &Path, replace: bool) -> Result<(), SynthError> {
    if !out.exists() {
        return Ok(());
    }
    if !out.is_dir() {
        return Err(SynthError::OutputOccupied(out.to_owned()));
    }
    let mut entries = fs::read_dir(out).map_err(SynthError::io("read", out))?;
    if entries.next().is_none() {
        return Ok(());
    }
    if !replace {
        return Err(SynthError::OutputOccupied(out.to_owned()));
    }
    let cameras = ["transforms.json", "transforms_train.json", "train/transforms.json"];
    if !cameras.iter().any(|name| out.join(name).is_file()) {
        return Err(SynthError::NotAScene(out.to_owned()));
    }
    Ok(())
}

fn remove(path: &Path) -> Result<(), SynthError> {
    if path.exists() {
        fs::remove_dir_all(path).map_err(SynthError::io("remove", path))?;
    }
    Ok(())
}
