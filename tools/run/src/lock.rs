//! Lock of a directory that a command writes into: at most one writer.
//!
//! The lock is a file in the directory that names its holder. The holder keeps it locked through the operating
//! system. A killed holder leaves the file behind. The next holder on the same machine takes it over if it is
//! unlocked and its process is gone.

use crate::error::{Result, RunError, io_error};
use serde::{Deserialize, Serialize};
use std::fs::{File, TryLockError};
use std::io::{Read, Seek, Write};
use std::path::{Path, PathBuf};

/// Name of the lock file.
const LOCK_FILE: &str = ".lock";

/// Process that holds a lock.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LockHolder {
    /// Process id.
    pub pid: u32,
    /// Host name.
    pub host: String,
    /// Start time in clock ticks since boot; `None` if the system does not report it.
    pub started: Option<u64>,
    /// Boot id of the machine; `None` if the system does not report it.
    pub boot: Option<String>,
}

impl LockHolder {
    /// Returns the description of this process.
    pub fn this_process() -> LockHolder {
        let pid = std::process::id();
        let host = gethostname::gethostname().to_string_lossy().into_owned();
        LockHolder { pid, host, started: process_start(pid), boot: boot() }
    }

    /// Returns whether the process ran on this machine.
    fn is_here(&self) -> bool {
        let this = LockHolder::this_process();
        // Containers on one machine share the boot id. A rebooted machine keeps its host name.
        self.host == this.host || self.boot.is_some() && self.boot == this.boot
    }

    /// Returns whether the process still runs on this machine.
    ///
    /// A running process has the same id and the same start time.
    fn is_alive(&self) -> bool {
        self.started.is_some() && self.boot == boot() && process_start(self.pid) == self.started
    }
}

/// Returns the start time of a process in clock ticks since boot.
///
/// `None` if the process does not exist, or the system does not report the time.
pub fn process_start(pid: u32) -> Option<u64> {
    let text = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    // The program name is in parentheses and may contain spaces; the start time is field 22.
    text.rsplit_once(')')?.1.split_whitespace().nth(19)?.parse().ok()
}

fn boot() -> Option<String> {
    let text = std::fs::read_to_string("/proc/sys/kernel/random/boot_id").ok()?;
    Some(text.trim().to_owned())
}

/// Held lock of a directory.
///
/// Dropping it removes the lock file. Directories that the lock created are removed if they are still empty.
#[derive(Debug)]
pub struct DirectoryLock {
    path: PathBuf,
    made: Vec<PathBuf>,
    recovered: Option<LockHolder>,
    _file: File,
}

impl DirectoryLock {
    /// Locks a directory; creates it if it is missing.
    ///
    /// # Errors
    /// [`RunError::Locked`] if another process holds the lock; [`RunError::Io`] if the directory or the lock file
    /// cannot be written.
    pub fn acquire(root: &Path) -> Result<DirectoryLock> {
        let made = missing_folders(root);
        std::fs::create_dir_all(root).map_err(io_error("made", root))?;
        let path = root.join(LOCK_FILE);
        let locked = lock(root, &path);
        if locked.is_err() {
            remove_empty(&made);
        }
        let (file, recovered) = locked?;
        Ok(DirectoryLock { path, made, recovered, _file: file })
    }

    /// Removes the lock of a process on another machine. Returns whether the directory had one.
    ///
    /// Only for callers that know that the process has ended. Locks of this machine stay: acquiring recovers them.
    ///
    /// # Errors
    /// If the file cannot be removed.
    pub fn remove_foreign(root: &Path) -> Result<bool> {
        let path = root.join(LOCK_FILE);
        let holder = File::open(&path).ok().and_then(|mut file| holder(&mut file));
        if holder.is_none_or(|holder| holder.is_here()) {
            return Ok(false);
        }
        std::fs::remove_file(&path).map_err(io_error("removed", &path))?;
        Ok(true)
    }

    /// Returns the dead process whose lock was taken over, if any.
    pub fn recovered(&self) -> Option<&LockHolder> {
        self.recovered.as_ref()
    }
}

impl Drop for DirectoryLock {
    fn drop(&mut self) {
        // The next holder recovers a file that cannot be removed.
        let _ = std::fs::remove_file(&self.path);
        remove_empty(&self.made);
    }
}

/// Returns the missing ancestors of a directory and itself, outermost first.
fn missing_folders(root: &Path) -> Vec<PathBuf> {
    let missing = root.ancestors().take_while(|p| !p.as_os_str().is_empty() && !p.exists());
    let mut folders: Vec<PathBuf> = missing.map(Path::to_owned).collect();
    folders.reverse();
    folders
}

/// Removes empty folders, innermost first.
fn remove_empty(folders: &[PathBuf]) {
    for folder in folders.iter().rev() {
        // Fails if the folder is not empty.
        let _ = std::fs::remove_dir(folder);
    }
}

/// Opens, locks and signs the lock file. Also returns the dead holder that left it behind.
fn lock(root: &Path, path: &Path) -> Result<(File, Option<LockHolder>)> {
    let failed = |e| io_error("written", path)(e);
    // A holder that ends between opening and locking removes the file; then a new file is opened.
    for _ in 0..100 {
        let options = || File::options().read(true).write(true).create(true).truncate(false).to_owned();
        let mut file = options().open(path).map_err(failed)?;
        match file.try_lock() {
            Ok(()) if !is_still(&file, path) => continue,
            Err(TryLockError::WouldBlock) => return Err(locked(root, holder(&mut file))),
            // Some network file systems have no locks; the recorded holder decides.
            Ok(()) | Err(TryLockError::Error(_)) => {}
        }
        let left = holder(&mut file);
        if let Some(other) = &left
            && (!other.is_here() || other.is_alive())
        {
            return Err(locked(root, left));
        }
        let text = serde_json::to_string(&LockHolder::this_process()).map_err(|e| failed(e.into()))?;
        file.set_len(0).and_then(|()| file.rewind()).map_err(failed)?;
        file.write_all(text.as_bytes()).map_err(failed)?;
        return Ok((file, left));
    }
    Err(locked(root, None))
}

/// Returns whether a path still names an open file.
#[cfg(unix)]
fn is_still(file: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let identity = |m: std::fs::Metadata| (m.dev(), m.ino());
    let there = std::fs::metadata(path).map(identity).ok();
    there.is_some() && there == file.metadata().map(identity).ok()
}

#[cfg(not(unix))]
fn is_still(_: &File, _: &Path) -> bool {
    true
}

/// Returns the holder recorded in a lock file.
fn holder(file: &mut File) -> Option<LockHolder> {
    let mut text = String::new();
    file.read_to_string(&mut text).ok()?;
    serde_json::from_str(&text).ok()
}

fn locked(root: &Path, holder: Option<LockHolder>) -> RunError {
    let lock = root.join(LOCK_FILE);
    let reason = match holder {
        Some(h) if !h.is_here() => format!(
            "process {} on {} writes into it; wait for it, or delete \"{}\" if that process has ended",
            h.pid,
            h.host,
            lock.display()
        ),
        Some(h) => format!("process {} writes into it; wait for it, or name another directory", h.pid),
        None => "another process writes into it; wait for it, or name another directory".to_owned(),
    };
    RunError::Locked { path: root.to_owned(), reason }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn leave(root: &Path, holder: &LockHolder) {
        std::fs::write(root.join(LOCK_FILE), serde_json::to_string(holder).unwrap()).unwrap();
    }

    #[test]
    fn held_lock_is_refused_and_released_lock_is_free() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().join("a/b");
        let lock = DirectoryLock::acquire(&root).unwrap();
        assert_eq!(lock.recovered(), None);
        let refused = DirectoryLock::acquire(&root).unwrap_err();
        assert!(matches!(refused, RunError::Locked { .. }));
        assert!(refused.to_string().contains(&format!("process {}", std::process::id())), "{refused}");
        drop(lock);
        assert!(!folder.path().join("a").exists(), "an empty directory stays");
        let lock = DirectoryLock::acquire(&root).unwrap();
        std::fs::write(root.join("result"), "").unwrap();
        drop(lock);
        assert_eq!(std::fs::read_dir(&root).unwrap().count(), 1, "the lock's file stays");
    }

    #[test]
    fn lock_of_a_dead_process_is_recovered() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        let this = LockHolder::this_process();
        let Some(started) = this.started else { return };
        // Same id with another start time, a process before a reboot, and a process of another container.
        let earlier = LockHolder { started: Some(started - 1), ..this.clone() };
        let rebooted = LockHolder { boot: Some("another boot".into()), ..this.clone() };
        let container = LockHolder { host: "another name".into(), ..earlier.clone() };
        for left in [earlier, rebooted, container] {
            leave(root, &left);
            assert_eq!(DirectoryLock::acquire(root).unwrap().recovered(), Some(&left));
        }
        // A recorded process that still runs holds the lock even if the file itself is not locked.
        leave(root, &this);
        assert!(matches!(DirectoryLock::acquire(root), Err(RunError::Locked { .. })));
        let elsewhere = LockHolder { host: "far".into(), boot: None, ..this };
        leave(root, &elsewhere);
        let refused = DirectoryLock::acquire(root).unwrap_err().to_string();
        assert!(refused.contains(" on far ") && refused.contains("delete"), "{refused}");
        assert!(DirectoryLock::remove_foreign(root).unwrap());
        let lock = DirectoryLock::acquire(root).unwrap();
        assert!(!DirectoryLock::remove_foreign(root).unwrap(), "a lock of this machine was removed");
        drop(lock);
        // A truncated file names no holder.
        std::fs::write(root.join(LOCK_FILE), "{\"pid\": 1").unwrap();
        assert_eq!(DirectoryLock::acquire(root).unwrap().recovered(), None);
    }
}
