//! Rollback checkpoints of a diverged training: the last validated one and a candidate.
//!
//! Both are hard links to earlier checkpoints where the file system has links. They take no space until the next
//! checkpoint is written.

use crate::error::{Result, error, remove};
use std::path::{Path, PathBuf};

/// Rollback checkpoints of a stage.
#[derive(Clone, Debug)]
pub struct RollbackFiles {
    checkpoint: PathBuf,
    candidate: PathBuf,
    validated: PathBuf,
}

impl RollbackFiles {
    /// Returns the rollback files beside a checkpoint.
    pub fn beside(checkpoint: PathBuf) -> RollbackFiles {
        let beside = |what: &str| checkpoint.with_extension(format!("{what}.safetensors"));
        RollbackFiles { candidate: beside("candidate"), validated: beside("validated"), checkpoint }
    }

    /// Marks the current checkpoint as the candidate.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn set_candidate(&self) -> Result<()> {
        let beside = self.checkpoint.with_file_name(".candidate.tmp");
        remove(&beside)?;
        std::fs::hard_link(&self.checkpoint, &beside)
            .or_else(|_| std::fs::copy(&self.checkpoint, &beside).map(|_| ()))
            .and_then(|()| std::fs::rename(&beside, &self.candidate))
            .map_err(|e| error(&self.candidate, format!("cannot be written: {e}")))
    }

    /// Replaces the validated checkpoint by the candidate. Does nothing without a candidate.
    ///
    /// # Errors
    /// If a file cannot be renamed.
    pub fn validate(&self) -> Result<()> {
        match std::fs::rename(&self.candidate, &self.validated) {
            Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
                Err(error(&self.validated, format!("cannot be written: {e}")))
            }
            _ => Ok(()),
        }
    }

    /// Drops the candidate and returns the validated checkpoint, if any.
    ///
    /// # Errors
    /// If a file cannot be removed.
    pub fn last_validated(&self) -> Result<Option<&Path>> {
        remove(&self.candidate)?;
        Ok(self.validated.is_file().then_some(&self.validated))
    }

    /// Removes candidate and validated checkpoint.
    ///
    /// # Errors
    /// If a file cannot be removed.
    pub fn remove(&self) -> Result<()> {
        remove(&self.candidate)?;
        remove(&self.validated)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn later_checkpoints_leave_the_validated_one_unchanged() {
        let folder = tempfile::tempdir().unwrap();
        let checkpoint = folder.path().join("stage.safetensors");
        let files = RollbackFiles::beside(checkpoint.clone());
        let write = |text: &str| {
            sgs_scene::atomic_write(&checkpoint, |f| std::io::Write::write_all(f, text.as_bytes())).unwrap()
        };
        let validated = || files.last_validated().unwrap().map(|p| std::fs::read_to_string(p).unwrap());
        files.validate().unwrap();
        assert_eq!(validated(), None);
        write("one");
        files.set_candidate().unwrap();
        files.validate().unwrap();
        write("two");
        files.set_candidate().unwrap();
        write("by hand");
        assert_eq!(validated().as_deref(), Some("one"));
        // The candidate is gone: nothing replaces the validated one.
        files.validate().unwrap();
        assert_eq!(validated().as_deref(), Some("one"));
        write("three");
        files.set_candidate().unwrap();
        files.validate().unwrap();
        assert_eq!(validated().as_deref(), Some("three"));
        files.remove().unwrap();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
