//! Atomic writes of files.
//!
//! Content goes to a temporary file beside the target, is flushed to the disk, and is then renamed to the target. After
//! a kill, a crash or a full disk, the target is either the old file or the complete new file.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use crate::error::{Result, SceneError, io_error};

/// Writes `path` atomically with the content that `write` produces. The content goes to a temporary file beside `path`,
/// is flushed to the disk, and is then renamed into place.
///
/// The parent directory must exist. If `write` fails, the temporary file is removed and `path` is unchanged.
pub fn atomic_write(path: &Path, write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>) -> Result<()> {
    let Some(name) = path.file_name() else {
        return Err(SceneError::Io {
            action: "write",
            path: path.to_path_buf(),
            cause: io::Error::new(io::ErrorKind::InvalidInput, "the path has no file name"),
        });
    };
    let directory = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    // Not `Builder::tempfile_in`: its files are for their owner alone, and its errors name the temporary file.
    let hidden = format!(".{}.", name.to_string_lossy());
    let create = |path: &Path| File::create_new(path);
    let temporary = tempfile::Builder::new().prefix(&hidden).suffix(".tmp").make_in(directory, create);
    let (file, temporary) = temporary.map_err(io_error("write", path))?.into_parts();
    let mut buffered = BufWriter::with_capacity(1 << 16, file);
    write(&mut buffered).map_err(io_error("write", path))?;
    buffered.flush().map_err(io_error("write", path))?;
    let file = buffered.into_inner().map_err(|e| io_error("write", path)(e.into_error()))?;
    file.sync_all().map_err(io_error("write", path))?;
    drop(file);

    temporary.persist(path).map_err(|e| io_error("write", path)(e.error))?;
    // The rename survives a power cut only after the directory is flushed to the disk. Some file systems cannot sync a
    // directory; the file is complete in either case.
    if let Ok(directory) = File::open(directory) {
        let _ = directory.sync_all();
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn names(directory: &Path) -> Vec<String> {
        let mut names: Vec<_> =
            fs::read_dir(directory).unwrap().map(|e| e.unwrap().file_name().to_string_lossy().into_owned()).collect();
        names.sort();
        names
    }

    #[test]
    fn replaces_the_file_and_leaves_nothing_beside_it() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.txt");
        atomic_write(&path, |w| w.write_all(b"old")).unwrap();
        atomic_write(&path, |w| w.write_all(b"new")).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(names(directory.path()), ["a.txt"]);
    }

    #[cfg(unix)]
    #[test]
    fn files_have_the_permissions_of_ordinary_files() {
        use std::os::unix::fs::PermissionsExt;
        let directory = tempfile::tempdir().unwrap();
        let mode = |name: &str| fs::metadata(directory.path().join(name)).unwrap().permissions().mode();
        atomic_write(&directory.path().join("a.txt"), |w| w.write_all(b"x")).unwrap();
        fs::write(directory.path().join("b.txt"), b"x").unwrap();
        assert_eq!(mode("a.txt"), mode("b.txt"));
    }

    #[test]
    fn failed_write_keeps_the_old_file() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.txt");
        atomic_write(&path, |w| w.write_all(b"old")).unwrap();
        let error = atomic_write(&path, |w| {
            w.write_all(b"half of the n")?;
            w.flush()?;
            Err(io::Error::new(io::ErrorKind::StorageFull, "no space left"))
        })
        .unwrap_err();
        assert_eq!(error.to_string(), format!("cannot write {}: no space left", path.display()));
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(names(directory.path()), ["a.txt"]);
    }

    #[test]
    fn missing_directory_is_named_in_the_error() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("none/a.txt");
        let error = atomic_write(&path, |w| w.write_all(b"x")).unwrap_err().to_string();
        assert_eq!(error, format!("cannot write {}: No such file or directory (os error 2)", path.display()));
        assert!(atomic_write(Path::new("/"), |_| Ok(())).is_err());
    }

    #[test]
    fn concurrent_writers_leave_one_complete_file() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.txt");
        std::thread::scope(|scope| {
            for letter in b'a'..b'i' {
                let path = &path;
                scope.spawn(move || atomic_write(path, |w| w.write_all(&[letter; 100_000])).unwrap());
            }
        });
        let content = fs::read(&path).unwrap();
        assert_eq!(content.len(), 100_000);
        assert!(content.iter().all(|&b| b == content[0]));
        assert_eq!(names(directory.path()), ["a.txt"]);
    }
}
