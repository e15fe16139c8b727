//! Directory of a batch: leases, results and records, shared by all workers.

use crate::batch::{Run, write_if_changed};
use crate::error::{Result, failed};
use crate::lease::{self, Content, Lease};
use crate::result::{RunResult, State};
use serde::{Deserialize, Serialize};
use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant, SystemTime};

/// Directory of a batch, as one worker sees it.
#[derive(Debug)]
pub struct Store {
    root: PathBuf,
    expiry: Duration,
    /// Content of each lease and when it was first seen, by run.
    seen: Mutex<HashMap<String, (Vec<u8>, Instant)>>,
    /// Done results that this worker has read, by run. A done result that answers its run never changes.
    ended: Mutex<HashMap<String, RunResult>>,
}

/// Answer to a claim.
#[derive(Debug)]
pub enum Claim {
    /// The run is this worker's.
    Held(Lease),
    /// Another worker holds the run.
    Busy,
    /// The run has a result.
    Ended(Box<RunResult>),
}

/// What the run directory was begun with.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Record {
    /// Identity of the run.
    pub identity: String,
    /// Number of attempts.
    pub attempts: u32,
}

impl Store {
    /// Opens the directory of a batch; creates it if it is missing.
    ///
    /// `expiry`: how long a lease stays valid without a renewal, by this worker's monotonic clock. Wall clocks of
    /// several machines differ.
    ///
    /// # Errors
    /// If the directory cannot be written.
    pub fn open(root: &Path, expiry: Duration) -> Result<Store> {
        let store = Store::at(root, expiry);
        for folder in [store.leases(), store.results(), root.join("runs"), root.join("variants"), root.join("plans")] {
            std::fs::create_dir_all(&folder).map_err(failed("made", &folder))?;
        }
        store.sweep();
        Ok(store)
    }

    /// Names the directory of a batch, which may be missing. Writes nothing.
    pub fn at(root: &Path, expiry: Duration) -> Store {
        Store { root: root.to_owned(), expiry, seen: Mutex::default(), ended: Mutex::default() }
    }

    /// Returns the directory.
    pub fn root(&self) -> &Path {
        &self.root
    }

    fn leases(&self) -> PathBuf {
        self.root.join("leases")
    }

    fn results(&self) -> PathBuf {
        self.root.join("results")
    }

    fn result_path(&self, run: &Run) -> PathBuf {
        self.results().join(format!("{}.json", run.key()))
    }

    /// Removes temporary lease files of dead processes.
    fn sweep(&self) {
        for entry in std::fs::read_dir(self.leases()).into_iter().flatten().flatten() {
            let path = entry.path();
            let temporary = entry.file_name().to_string_lossy().ends_with(".tmp");
            let dead =
                || Content::parse(&std::fs::read(&path).unwrap_or_default()).is_some_and(|c| c.holder.has_ended());
            if temporary && dead() {
                // A file that cannot be removed is harmless.
                let _ = std::fs::remove_file(&path);
            }
        }
    }

    /// Reads the result of a run of any identity. A damaged file counts as none.
    pub fn result(&self, run: &Run) -> Option<RunResult> {
        serde_json::from_slice(&std::fs::read(self.result_path(run)).ok()?).ok()
    }

    /// Returns the result that answers a run, if any. Reads a done one from the disk once.
    pub(crate) fn answer(&self, run: &Run, evaluate: bool) -> Option<RunResult> {
        let key = run.key();
        let ended = || self.ended.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = ended().get(&key).filter(|r| r.answers(run, evaluate)) {
            return Some(known.clone());
        }
        let result = self.result(run).filter(|r| r.answers(run, evaluate))?;
        if result.state == State::Done {
            ended().insert(key, result.clone());
        }
        Some(result)
    }

    /// Lists the keys of all runs that have a result, of any identity.
    ///
    /// # Errors
    /// If the directory cannot be read.
    pub(crate) fn result_keys(&self) -> Result<HashSet<String>> {
        let folder = self.results();
        let mut keys = HashSet::new();
        for entry in std::fs::read_dir(&folder).map_err(failed("read", &folder))? {
            let name = entry.map_err(failed("read", &folder))?.file_name();
            keys.extend(name.to_str().and_then(|n| n.strip_suffix(".json")).map(str::to_owned));
        }
        Ok(keys)
    }

    /// Lists the generation of the lease of each run that has one, by the run's key.
    ///
    /// # Errors
    /// If the directory cannot be read.
    pub(crate) fn leased(&self) -> Result<HashMap<String, u64>> {
        lease::list(&self.leases())
    }

    /// Returns whether a listed lease is there and not known to be free.
    pub(crate) fn is_busy(&self, run: &Run, generation: u64) -> bool {
        let key = run.key();
        lease::read(&self.leases(), &key, generation).is_some_and(|bytes| !self.is_free(&key, &bytes))
    }

    /// Returns whether the summary is about as new as the result of a run.
    ///
    /// Both times are those of the shared disk: the clocks of several machines differ.
    pub(crate) fn has_fresh_summary(&self, run: &Run, interval: Duration) -> bool {
        let written = |path: &Path| std::fs::metadata(path).and_then(|m| m.modified()).ok();
        let distance = |a: SystemTime, b: SystemTime| a.duration_since(b).unwrap_or_else(|e| e.duration());
        let times = written(&self.root.join("summary.jsonl")).zip(written(&self.result_path(run)));
        times.is_some_and(|(summary, result)| distance(summary, result) < interval)
    }

    /// Claims a run for this worker.
    ///
    /// `again`: failed result that the worker may replace by another attempt.
    ///
    /// # Errors
    /// If the directory cannot be read or written.
    pub fn claim(&self, run: &Run, evaluate: bool, again: Option<&RunResult>) -> Result<Claim> {
        let ended = || self.answer(run, evaluate).filter(|r| again != Some(r));
        if let Some(result) = ended() {
            return Ok(Claim::Ended(Box::new(result)));
        }
        let (folder, key) = (self.leases(), run.key());
        let generation = match lease::latest(&folder, &key)? {
            None => 1,
            Some(found) if self.is_free(&key, &found.bytes) => found.generation + 1,
            Some(_) => return Ok(Claim::Busy),
        };
        let Some(lease) = Lease::create(&folder, &key, generation)? else { return Ok(Claim::Busy) };
        // The last holder may have ended between the two looks.
        if let Some(result) = ended() {
            lease.remove();
            return Ok(Claim::Ended(Box::new(result)));
        }
        Ok(Claim::Held(lease))
    }

    /// Returns whether the lease with this content was released or is dead.
    fn is_free(&self, key: &str, bytes: &[u8]) -> bool {
        let content = Content::parse(bytes);
        if content.is_some_and(|c| c.released || c.holder.has_ended()) {
            return true;
        }
        let mut seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        match seen.get(key) {
            Some((before, since)) if before == bytes => since.elapsed() >= self.expiry,
            _ => {
                seen.insert(key.to_owned(), (bytes.to_owned(), Instant::now()));
                false
            }
        }
    }

    /// Writes the result of a held run and removes its leases. Returns false if the lease was lost.
    ///
    /// An existing result that answers the run stays. Equal runs give equal bits, so that the first result is as good.
    ///
    /// # Errors
    /// If the result cannot be written.
    pub fn finish(&self, lease: Lease, run: &Run, evaluate: bool, result: &RunResult) -> Result<bool> {
        if !lease.is_valid() {
            return Ok(false);
        }
        let path = self.result_path(run);
        let temporary = self.results().join(format!(".{}.{}.new", run.key(), lease.generation()));
        let text = serde_json::to_string(result).unwrap_or_default();
        sgs_scene::atomic_write(&temporary, |f| std::io::Write::write_all(f, text.as_bytes()))?;
        let written = match std::fs::hard_link(&temporary, &path) {
            Err(e) if e.kind() == std::io::ErrorKind::AlreadyExists => {
                if self.result(run).is_some_and(|there| there.answers(run, evaluate)) {
                    Ok(())
                } else {
                    std::fs::rename(&temporary, &path)
                }
            }
            other => other,
        };
        let _ = std::fs::remove_file(&temporary);
        written.map_err(failed("written", &path))?;
        lease.remove();
        Ok(true)
    }

    /// Removes the result of a held run before another attempt.
    pub(crate) fn forget(&self, run: &Run) -> Result<()> {
        remove(&self.result_path(run))
    }

    /// Forgets result and attempts of a run.
    ///
    /// A queue then starts the run again, on what its directory holds.
    ///
    /// # Errors
    /// If a file cannot be removed.
    pub fn reopen(&self, run: &Run) -> Result<()> {
        self.ended.lock().unwrap_or_else(PoisonError::into_inner).remove(&run.key());
        self.forget(run)?;
        remove(&run.path(&self.root, "json"))
    }

    /// Reads the record beside a run directory.
    pub(crate) fn record(&self, run: &Run) -> Option<Record> {
        serde_json::from_slice(&std::fs::read(run.path(&self.root, "json")).ok()?).ok()
    }

    /// Writes the record beside a run directory.
    pub(crate) fn write_record(&self, run: &Run, record: &Record) -> Result<()> {
        write_if_changed(&run.path(&self.root, "json"), &serde_json::to_string(record).unwrap_or_default())
    }
}

/// Removes a file that may be missing.
fn remove(path: &Path) -> Result<()> {
    match std::fs::remove_file(path) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(failed("removed", path)(e)),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::batch::tests::run;
    use crate::result::State;
    use std::sync::atomic::{AtomicUsize, Ordering};

    const LONG: Duration = Duration::from_secs(600);

    fn held(claim: Claim) -> Lease {
        match claim {
            Claim::Held(lease) => lease,
            other => panic!("{other:?}"),
        }
    }

    fn done(run: &Run) -> RunResult {
        RunResult { state: State::Done, attempts: 1, ..RunResult::of(run) }
    }

    #[test]
    fn each_run_is_claimed_exactly_once() {
        let folder = tempfile::tempdir().unwrap();
        let runs: Vec<Run> = (0..40).map(|seed| run("a", seed)).collect();
        let claims: Vec<AtomicUsize> = runs.iter().map(|_| AtomicUsize::new(0)).collect();
        std::thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| {
                    let store = Store::open(folder.path(), LONG).unwrap();
                    for (run, count) in runs.iter().zip(&claims) {
                        if let Claim::Held(lease) = store.claim(run, false, None).unwrap() {
                            count.fetch_add(1, Ordering::SeqCst);
                            std::thread::yield_now();
                            assert!(store.finish(lease, run, false, &done(run)).unwrap());
                        }
                    }
                });
            }
        });
        assert!(claims.iter().all(|c| c.load(Ordering::SeqCst) == 1), "{claims:?}");
        assert_eq!(std::fs::read_dir(folder.path().join("leases")).unwrap().count(), 0);
        assert_eq!(std::fs::read_dir(folder.path().join("results")).unwrap().count(), 40);
    }

    #[test]
    fn stale_lease_is_taken_over_exactly_once() {
        let folder = tempfile::tempdir().unwrap();
        let (run, expiry) = (run("a", 0), Duration::from_millis(200));
        let store = Store::open(folder.path(), expiry).unwrap();
        let mut stale = held(store.claim(&run, false, None).unwrap());
        let taken: Vec<Lease> = std::thread::scope(|scope| {
            let observe = || {
                let store = Store::open(folder.path(), expiry).unwrap();
                let begun = Instant::now();
                while begun.elapsed() < 2 * expiry {
                    if let Claim::Held(lease) = store.claim(&run, false, None).unwrap() {
                        assert!(begun.elapsed() >= expiry, "taken over after {:?}", begun.elapsed());
                        return Some(lease);
                    }
                    std::thread::sleep(Duration::from_millis(5));
                }
                None
            };
            let observers: Vec<_> = (0..6).map(|_| scope.spawn(observe)).collect();
            observers.into_iter().filter_map(|o| o.join().unwrap()).collect()
        });
        assert_eq!(taken.iter().map(Lease::generation).collect::<Vec<_>>(), [2]);
        // The holder notices the higher generation, and its result is refused.
        assert!(!stale.renew().unwrap());
        assert!(!store.finish(stale, &run, false, &done(&run)).unwrap());
        assert_eq!(store.result(&run), None);
        let taken = taken.into_iter().next().unwrap();
        assert!(store.finish(taken, &run, false, &done(&run)).unwrap());
        assert_eq!(std::fs::read_dir(folder.path().join("leases")).unwrap().count(), 0);
    }

    #[test]
    fn renewed_lease_stays_and_released_lease_is_free() {
        let folder = tempfile::tempdir().unwrap();
        let run = run("a", 0);
        let store = Store::open(folder.path(), Duration::from_millis(150)).unwrap();
        let mut lease = held(store.claim(&run, false, None).unwrap());
        for _ in 0..10 {
            std::thread::sleep(Duration::from_millis(40));
            assert!(lease.renew().unwrap());
            assert!(matches!(store.claim(&run, false, None).unwrap(), Claim::Busy));
        }
        lease.release().unwrap();
        let next = held(store.claim(&run, false, None).unwrap());
        assert_eq!(next.generation(), 2);
    }

    #[test]
    fn lease_of_an_ended_process_is_free_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let run = run("a", 0);
        let store = Store::open(folder.path(), LONG).unwrap();
        let _lease = held(store.claim(&run, false, None).unwrap());
        let path = folder.path().join("leases").join(format!("{}.1.json", run.key()));
        let mut content = Content::parse(&std::fs::read(&path).unwrap()).unwrap();
        let Some(started) = content.holder.started else { return };
        content.holder.started = Some(started + 1);
        std::fs::write(&path, serde_json::to_string(&content).unwrap()).unwrap();
        assert_eq!(held(store.claim(&run, false, None).unwrap()).generation(), 2);
        // A damaged file names no process and expires.
        std::fs::write(folder.path().join("leases").join(format!("{}.3.json", run.key())), "{").unwrap();
        assert!(matches!(store.claim(&run, false, None).unwrap(), Claim::Busy));
    }

    #[test]
    fn done_answers_are_read_once_and_failed_ones_again() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path(), LONG).unwrap();
        let (done_run, failed_run) = (run("a", 0), run("b", 0));
        let put = |run: &Run, result: &RunResult| {
            std::fs::write(store.result_path(run), serde_json::to_string(result).unwrap()).unwrap();
        };
        assert_eq!(store.answer(&done_run, false), None);
        put(&done_run, &done(&done_run));
        put(&failed_run, &RunResult::of(&failed_run));
        assert_eq!(store.answer(&done_run, false), Some(done(&done_run)));
        assert_eq!(store.answer(&failed_run, false).unwrap().state, State::Failed);
        // Another worker trained the failed run again.
        put(&failed_run, &done(&failed_run));
        assert_eq!(store.answer(&failed_run, false), Some(done(&failed_run)));
        std::fs::write(store.result_path(&done_run), "{").unwrap();
        assert_eq!(store.answer(&done_run, false), Some(done(&done_run)));
        // A known result answers neither another identity nor a request for an evaluation.
        assert_eq!(store.answer(&Run { identity: "changed".into(), ..done_run.clone() }, false), None);
        assert_eq!(store.answer(&done_run, true), None);
        let keys = store.result_keys().unwrap();
        assert!(keys.len() == 2 && keys.contains(&done_run.key()));
    }

    #[test]
    fn leases_are_listed_by_run_with_their_highest_generation() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path(), LONG).unwrap();
        for (scene, generation) in [("a.1", 1), ("a.1", 2), ("a", 10)] {
            Lease::create(&store.leases(), &run(scene, 0).key(), generation).unwrap().unwrap();
        }
        for other in [".x.fast.seed0.3.token.tmp", "note.txt", "a.fast.seed0.x.json"] {
            std::fs::write(store.leases().join(other), "").unwrap();
        }
        let expected = [(run("a.1", 0).key(), 2), (run("a", 0).key(), 10)];
        assert_eq!(store.leased().unwrap(), HashMap::from(expected));
        assert!(store.is_busy(&run("a", 0), 10) && !store.is_busy(&run("a", 0), 9));
    }

    #[test]
    fn reopened_runs_are_claimed_again() {
        let folder = tempfile::tempdir().unwrap();
        let (first, store) = (run("a", 0), Store::open(folder.path(), LONG).unwrap());
        store.reopen(&first).unwrap();
        let lease = held(store.claim(&first, false, None).unwrap());
        store.write_record(&first, &Record { identity: first.identity.clone(), attempts: 3 }).unwrap();
        assert!(store.finish(lease, &first, false, &done(&first)).unwrap());
        assert!(matches!(store.claim(&first, false, None).unwrap(), Claim::Ended(_)));
        store.reopen(&first).unwrap();
        assert_eq!((store.record(&first), store.result(&first)), (None, None));
        held(store.claim(&first, false, None).unwrap());
    }

    #[test]
    fn result_is_written_once_for_an_identity() {
        let folder = tempfile::tempdir().unwrap();
        let first = run("a", 0);
        let store = Store::open(folder.path(), LONG).unwrap();
        let lease = held(store.claim(&first, false, None).unwrap());
        assert!(store.finish(lease, &first, false, &done(&first)).unwrap());
        // A second result of the same identity changes nothing.
        let lease = Lease::create(&store.leases(), &first.key(), 1).unwrap().unwrap();
        let other = RunResult { attempts: 9, ..done(&first) };
        assert!(store.finish(lease, &first, false, &other).unwrap());
        assert_eq!(store.result(&first), Some(done(&first)));
        assert!(matches!(store.claim(&first, false, None).unwrap(), Claim::Ended(r) if *r == done(&first)));
        // Another identity replaces it.
        let changed = Run { identity: "changed".into(), ..first.clone() };
        let lease = held(store.claim(&changed, false, None).unwrap());
        assert!(store.finish(lease, &changed, false, &done(&changed)).unwrap());
        assert_eq!(store.result(&first), Some(done(&changed)));
        // A failed result is replaced only on request.
        let failed = run("b", 0);
        let lease = held(store.claim(&failed, false, None).unwrap());
        let result = RunResult::of(&failed);
        assert!(store.finish(lease, &failed, false, &result).unwrap());
        assert!(matches!(store.claim(&failed, false, None).unwrap(), Claim::Ended(_)));
        assert_eq!(held(store.claim(&failed, false, Some(&result)).unwrap()).generation(), 1);
        let names = std::fs::read_dir(folder.path().join("results")).unwrap().map(|e| e.unwrap().file_name());
        assert!(names.into_iter().all(|n| !n.to_string_lossy().starts_with('.')));
    }
}
