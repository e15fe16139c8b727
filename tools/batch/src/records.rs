//! Records of scenes: workers that start together hash each scene once, not each worker all scenes.
//!
//! A worker believes the record of another one only if that one began to read the scene after the worker started.
//! Then the record says no less than reading the scene again. Both times are those of the shared disk.

use crate::error::{Result, failed};
use crate::holder::Holder;
use crate::identity::{Digest, scene_digest};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

/// Name of the folder below the directory of a batch.
const FOLDER: &str = "hashes";

/// What is known about a scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Record {
    /// Scene directory.
    scene: PathBuf,
    /// When reading began, in nanoseconds of the disk's clock.
    began: u64,
    /// Hash of the scene.
    digest: String,
    /// Estimated cost of each variant. Text, because JSON numbers of other programs are too short.
    costs: BTreeMap<String, String>,
}

impl Record {
    /// Reads a scene. `costs`: estimates the cost of each variant.
    ///
    /// # Errors
    /// If the scene cannot be read.
    pub fn read(scene: &Path, costs: impl FnOnce() -> BTreeMap<String, u128>) -> Result<Record> {
        let digest = scene_digest(scene)?.to_string();
        let costs = costs().into_iter().map(|(variant, cost)| (variant, cost.to_string())).collect();
        Ok(Record { scene: scene.to_owned(), began: 0, digest, costs })
    }

    /// Returns the hash.
    pub fn digest(&self) -> Option<Digest> {
        Digest::parse(&self.digest)
    }

    /// Returns the estimated cost of a variant, if known.
    pub fn cost(&self, variant: &str) -> Option<u128> {
        self.costs.get(variant)?.parse().ok()
    }
}

/// Folder of the records, as one worker sees it.
pub(crate) struct Records {
    folder: PathBuf,
    /// When this worker started, by the disk's clock.
    started: u64,
    token: String,
}

impl Records {
    /// Opens the folder of a batch's directory; creates it if it is missing.
    ///
    /// # Errors
    /// If the folder cannot be made.
    pub fn open(root: &Path) -> Result<Records> {
        let folder = root.join(FOLDER);
        std::fs::create_dir_all(&folder).map_err(failed("made", &folder))?;
        let token = Holder::this_process().token;
        let mut records = Records { folder, started: 0, token };
        let mark = records.temporary("start");
        // A batch that ends may have removed the folder. Then this worker believes no record.
        records.started = write_new(&mark, b"").unwrap_or(u64::MAX);
        // A file that stays is ignored.
        let _ = std::fs::remove_file(&mark);
        Ok(records)
    }

    /// Reads a scene, or believes a record made since this worker started.
    ///
    /// `costs`: estimates the cost of each variant.
    ///
    /// # Errors
    /// If the scene cannot be read.
    pub fn record(&self, name: &str, scene: &Path, costs: impl FnOnce() -> BTreeMap<String, u128>) -> Result<Record> {
        let path = self.folder.join(format!("{name}.json"));
        let read = || -> Option<Record> { serde_json::from_slice(&std::fs::read(&path).ok()?).ok() };
        if let Some(record) = read().filter(|r| r.began > self.started && r.scene == scene && r.digest().is_some()) {
            return Ok(record);
        }
        let temporary = self.temporary(name);
        // Without a time, the record is of no use to others.
        let began = write_new(&temporary, b"").unwrap_or(0);
        let made = Record::read(scene, costs).map(|record| Record { began, ..record });
        let publish = |record: &Record| -> std::io::Result<()> {
            write_new(&temporary, serde_json::to_string(record)?.as_bytes())?;
            std::fs::rename(&temporary, &path)
        };
        // A record that cannot be written only costs the others time.
        if made.as_ref().is_ok_and(|record| began == 0 || publish(record).is_err()) || made.is_err() {
            let _ = std::fs::remove_file(&temporary);
        }
        made
    }

    /// Removes the records of a batch's directory. A worker that still starts only loses time.
    pub fn remove(root: &Path) {
        // After the rename no other worker removes the same files.
        let unique = root.join(format!(".{FOLDER}.{}", Holder::this_process().token));
        if std::fs::rename(root.join(FOLDER), &unique).is_ok() {
            // Files that stay have no effect.
            let _ = std::fs::remove_dir_all(&unique);
        }
    }

    fn temporary(&self, name: &str) -> PathBuf {
        self.folder.join(format!(".{name}.{}.tmp", self.token))
    }
}

/// Writes a file. Returns the time that the disk gave it, in nanoseconds.
fn write_new(path: &Path, bytes: &[u8]) -> std::io::Result<u64> {
    let mut file = std::fs::File::create(path)?;
    file.write_all(bytes)?;
    let time = file.metadata()?.modified()?.duration_since(UNIX_EPOCH).unwrap_or_default();
    Ok(u64::try_from(time.as_nanos()).unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;
    use std::time::Duration;

    #[test]
    fn records_are_believed_only_if_they_began_after_the_start() {
        let folder = tempfile::tempdir().unwrap();
        let scene = folder.path().join("room");
        std::fs::create_dir(&scene).unwrap();
        let put = |text: &str| std::fs::write(scene.join("cameras.txt"), text).unwrap();
        put("one");
        // Times of some disks are coarse.
        let pause = || std::thread::sleep(Duration::from_millis(30));
        let open = || Records::open(folder.path()).unwrap();
        let reads = Cell::new(0);
        let record = |records: &Records| {
            let costs = || {
                reads.set(reads.get() + 1);
                BTreeMap::from([("fast".to_owned(), u128::MAX)])
            };
            records.record("room", &scene, costs).unwrap()
        };
        let (early, late) = (open(), open());
        pause();
        let first = record(&early);
        assert_eq!((first.digest(), first.cost("fast")), (Some(scene_digest(&scene).unwrap()), Some(u128::MAX)));
        // The other worker started before the record began.
        assert_eq!(record(&late), first);
        assert_eq!(reads.get(), 1);
        // A later worker reads the scene again and finds the change.
        pause();
        put("two");
        let last = open();
        pause();
        let second = record(&last);
        assert!(second.digest() != first.digest() && reads.get() == 2);
        assert_eq!(record(&late), second);
        // Neither another scene of the same name nor a damaged record is believed.
        let other = folder.path().join("other");
        std::fs::create_dir(&other).unwrap();
        assert_ne!(last.record("room", &other, BTreeMap::new).unwrap().digest(), second.digest());
        std::fs::write(folder.path().join("hashes/room.json"), "{").unwrap();
        assert_eq!(record(&last).digest(), second.digest());
        assert_eq!(reads.get(), 3);
        assert!(last.record("none", &folder.path().join("none"), BTreeMap::new).is_err());
        let names = std::fs::read_dir(folder.path().join("hashes")).unwrap().map(|e| e.unwrap().file_name());
        assert_eq!(names.collect::<Vec<_>>(), ["room.json"]);
        // A worker that has started goes on without the folder.
        Records::remove(folder.path());
        Records::remove(folder.path());
        assert_eq!(record(&last).digest(), second.digest());
        let names = std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name());
        assert_eq!(names.filter(|n| n != "room" && n != "other").count(), 0);
    }
}
