//! Checkpoints to go back to: the last one whose training went well from there on, and the next one, of which that is not known yet.
//!
//! Both are links to what was the checkpoint, where the file system has links: they take no room of their own until it is written again.

use crate::error::Result;
use crate::run::{error, remove};
use std::path::{Path, PathBuf};

/// Checkpoints of a stage to go back to.
#[derive(Clone, Debug)]
pub struct Kept {
    checkpoint: PathBuf,
    next: PathBuf,
    good: PathBuf,
}

impl Kept {
    /// Beside a checkpoint.
    pub(crate) fn of(checkpoint: PathBuf) -> Kept {
        let beside = |what: &str| checkpoint.with_extension(format!("{what}.safetensors"));
        Kept { next: beside("next"), good: beside("good"), checkpoint }
    }

    /// The checkpoint was written at one of its steps: it is the next one to go back to.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn saved(&self) -> Result<()> {
        let beside = self.checkpoint.with_file_name(".kept.tmp");
        remove(&beside)?;
        std::fs::hard_link(&self.checkpoint, &beside)
            .or_else(|_| std::fs::copy(&self.checkpoint, &beside).map(|_| ()))
            .and_then(|()| std::fs::rename(&beside, &self.next))
            .map_err(|e| error(&self.next, format!("cannot be written: {e}")))
    }

    /// Training went well from the next one on: it is the good one from now on. Does nothing if there is no next one.
    ///
    /// # Errors
    /// If a file cannot be renamed.
    pub fn vouched_for(&self) -> Result<()> {
        match std::fs::rename(&self.next, &self.good) {
            Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
                Err(error(&self.good, format!("cannot be written: {e}")))
            }
            _ => Ok(()),
        }
    }

    /// The good one, if there is one. What came after it is forgotten.
    ///
    /// # Errors
    /// If a file cannot be removed.
    pub fn go_back(&self) -> Result<Option<&Path>> {
        remove(&self.next)?;
        Ok(self.good.is_file().then_some(&self.good))
    }

    /// Removes both.
    ///
    /// # Errors
    /// If a file cannot be removed.
    pub fn forget(&self) -> Result<()> {
        remove(&self.next)?;
        remove(&self.good)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_good_stays_as_it_was() {
        let folder = tempfile::tempdir().unwrap();
        let checkpoint = folder.path().join("stage.safetensors");
        let kept = Kept::of(checkpoint.clone());
        let write = |text: &str| {
            sgs_scene::atomic_write(&checkpoint, |f| std::io::Write::write_all(f, text.as_bytes())).unwrap()
        };
        let good = || kept.go_back().unwrap().map(|p| std::fs::read_to_string(p).unwrap());
        kept.vouched_for().unwrap();
        assert_eq!(good(), None);
        write("one");
        kept.saved().unwrap();
        kept.vouched_for().unwrap();
        write("two");
        kept.saved().unwrap();
        write("by hand");
        assert_eq!(good().as_deref(), Some("one"));
        // It was gone back from.
        kept.vouched_for().unwrap();
        assert_eq!(good().as_deref(), Some("one"));
        write("three");
        kept.saved().unwrap();
        kept.vouched_for().unwrap();
        assert_eq!(good().as_deref(), Some("three"));
        kept.forget().unwrap();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
