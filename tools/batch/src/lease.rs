//! Lease of a run: the right of one worker to train it.
//!
//! The file `KEY.GENERATION.json` is created exclusively. Its holder renews it with an increasing counter. A lease whose
//! content does not change for a while is dead, and another worker creates the next generation. The highest generation
//! is the valid one.

use crate::error::{Result, failed};
use crate::holder::Holder;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Content of a lease file.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Content {
    #[serde(flatten)]
    pub holder: Holder,
    /// Number of renewals.
    pub counter: u64,
    /// Whether the holder released the run without a result.
    pub released: bool,
}

/// Held lease.
#[derive(Debug)]
pub struct Lease {
    folder: PathBuf,
    key: String,
    generation: u64,
    content: Content,
}

/// Lease file of the highest generation.
pub(crate) struct Found {
    pub generation: u64,
    /// Bytes of the file. They change with each renewal.
    pub bytes: Vec<u8>,
}

impl Lease {
    /// Creates the lease of a generation; `None` if it exists.
    pub(crate) fn create(folder: &Path, key: &str, generation: u64) -> Result<Option<Lease>> {
        let content = Content { holder: Holder::this_process(), counter: 0, released: false };
        let lease = Lease { folder: folder.to_owned(), key: key.to_owned(), generation, content };
        let path = lease.path();
        let temporary = lease.write_temporary()?;
        let linked = std::fs::hard_link(&temporary, &path);
        // The link is the lease; the other name has no use.
        let _ = std::fs::remove_file(&temporary);
        match linked {
            Ok(()) => Ok(Some(lease)),
            // A network file system may repeat a request that succeeded. Then the file is this lease.
            Err(e) if e.kind() == std::io::ErrorKind::AlreadyExists => Ok(lease.is_own().then_some(lease)),
            Err(e) => Err(failed("made by a hard link, which leases need", &path)(e)),
        }
    }

    /// Returns the generation. It is above 1 if the run was taken over.
    pub fn generation(&self) -> u64 {
        self.generation
    }

    /// Returns the run's key.
    pub fn key(&self) -> &str {
        &self.key
    }

    /// Returns whether this lease is still the valid one.
    ///
    /// Each generation follows the one before, so that asking for the next one is enough. A listing would grow with the
    /// number of workers.
    pub fn is_valid(&self) -> bool {
        let next = path(&self.folder, &self.key, self.generation + 1);
        self.is_own() && matches!(next.try_exists(), Ok(false))
    }

    /// Renews the lease. Returns false if it is no longer valid.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn renew(&mut self) -> Result<bool> {
        if !self.is_valid() {
            return Ok(false);
        }
        self.content.counter += 1;
        self.replace()?;
        Ok(true)
    }

    /// Releases the run without a result. The next worker claims the next generation.
    pub(crate) fn release(mut self) -> Result<()> {
        if self.is_valid() {
            self.content.released = true;
            self.replace()?;
        }
        Ok(())
    }

    /// Removes the files of this generation and earlier ones.
    ///
    /// Earlier ones first: while a file exists, the file of the next generation also does.
    pub(crate) fn remove(self) {
        let mut all = generations(&self.folder, &self.key).unwrap_or_default();
        all.sort_unstable();
        for generation in all {
            if generation <= self.generation {
                // A file that stays is ignored: the run has a result.
                let _ = std::fs::remove_file(path(&self.folder, &self.key, generation));
            }
        }
    }

    fn path(&self) -> PathBuf {
        path(&self.folder, &self.key, self.generation)
    }

    /// Returns whether the file exists with this lease's token.
    fn is_own(&self) -> bool {
        let bytes = std::fs::read(self.path()).unwrap_or_default();
        Content::parse(&bytes).is_some_and(|c| c.holder.token == self.content.holder.token)
    }

    fn replace(&self) -> Result<()> {
        let (temporary, path) = (self.write_temporary()?, self.path());
        std::fs::rename(&temporary, &path).map_err(failed("written", &path))
    }

    /// Writes the content into a hidden file. Leases are not flushed: they have no value after a power cut.
    fn write_temporary(&self) -> Result<PathBuf> {
        let Lease { key, generation, content, .. } = self;
        let temporary = self.folder.join(format!(".{key}.{generation}.{}.tmp", content.holder.token));
        let write = || -> std::io::Result<()> {
            let mut file = std::fs::File::create(&temporary)?;
            file.write_all(serde_json::to_string(content)?.as_bytes())
        };
        write().map_err(failed("written", &temporary))?;
        Ok(temporary)
    }
}

impl Content {
    pub(crate) fn parse(bytes: &[u8]) -> Option<Content> {
        serde_json::from_slice(bytes).ok()
    }
}

fn path(folder: &Path, key: &str, generation: u64) -> PathBuf {
    folder.join(format!("{key}.{generation}.json"))
}

/// Returns the generations of a run's lease files.
fn generations(folder: &Path, key: &str) -> Result<Vec<u64>> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed("read", folder))? {
        let name = entry.map_err(failed("read", folder))?.file_name();
        let generation = name.to_str().and_then(|n| n.strip_prefix(key)?.strip_prefix('.')?.strip_suffix(".json"));
        found.extend(generation.and_then(|g| g.parse::<u64>().ok()));
    }
    Ok(found)
}

/// Lists the highest generation of each run that has a lease, by the run's key.
pub(crate) fn list(folder: &Path) -> Result<HashMap<String, u64>> {
    let mut found = HashMap::new();
    for entry in std::fs::read_dir(folder).map_err(failed("read", folder))? {
        let name = entry.map_err(failed("read", folder))?.file_name();
        let parts = name.to_str().and_then(|n| n.strip_suffix(".json")?.rsplit_once('.'));
        let Some((key, generation)) = parts.and_then(|(key, g)| Some((key, g.parse::<u64>().ok()?))) else { continue };
        let highest = found.entry(key.to_owned()).or_insert(generation);
        *highest = generation.max(*highest);
    }
    Ok(found)
}

/// Reads the lease of a generation; `None` if it is absent.
pub(crate) fn read(folder: &Path, key: &str, generation: u64) -> Option<Vec<u8>> {
    std::fs::read(path(folder, key, generation)).ok()
}

/// Reads the lease of the highest generation, if any.
pub(crate) fn latest(folder: &Path, key: &str) -> Result<Option<Found>> {
    let Some(generation) = generations(folder, key)?.into_iter().max() else { return Ok(None) };
    // The holder may have removed the file since; then its bytes are empty, and the next look finds none.
    let bytes = read(folder, key, generation).unwrap_or_default();
    Ok(Some(Found { generation, bytes }))
}
