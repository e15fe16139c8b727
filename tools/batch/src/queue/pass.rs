//! One pass over the runs: finds a free one and trains it.

use super::{Queue, Shared, Slot, lock};
use crate::error::Result;
use crate::timing::Timing;
use std::collections::hash_map::RandomState;
use std::collections::{HashMap, HashSet};
use std::hash::{BuildHasher, Hasher};
use std::sync::atomic::Ordering;

impl Shared<'_> {
    /// Trains the first free run that the worker's device admits. Returns the number of runs that others hold if there is none,
    /// and `None` if another pass is due at once.
    ///
    /// Lists the leases once. Reads those that are due, and asks for the results of runs without a lease.
    pub(super) fn work_once(&self, worker: usize) -> Result<Option<usize>> {
        let Queue { store, batch, .. } = self.queue;
        let mut leased = store.leased()?;
        let (due, held) = self.due(&leased);
        let (mut losses, mut skips) = (0, 0);
        for &i in &self.order {
            if self.stopping() {
                return Ok(None);
            }
            if !matches!(lock(&self.slots)[i], Slot::Open) {
                continue;
            }
            let run = &batch.runs[i];
            if let Some(generation) = leased.get(&run.key())
                && (!due.contains(&i) || store.is_busy(run, *generation))
            {
                continue;
            }
            if skips > 0 && !leased.contains_key(&run.key()) {
                skips -= 1;
                continue;
            }
            let permit = {
                let mut slots = lock(&self.slots);
                if !matches!(slots[i], Slot::Open) {
                    continue;
                }
                let device = self.devices[worker].as_ref();
                let permit = device.map(|device| self.admission.admit(device, self.demand(i)));
                if matches!(permit, Some(None)) {
                    continue;
                }
                slots[i] = Slot::Working;
                permit.flatten()
            };
            let (slot, worked) = self.claim(i, worker, permit)?;
            let lost = matches!(slot, Slot::Open);
            let ended = {
                let mut slots = lock(&self.slots);
                slots[i] = slot;
                self.order.iter().filter(|i| matches!(slots[**i], Slot::Ended(_))).count()
            };
            if worked {
                self.ended(i, ended)?;
                return Ok(None);
            }
            if lost {
                // Another worker was faster. It and others may have claimed more runs meanwhile. After each loss, workers
                // that start together spread over twice as many runs.
                losses += 1;
                leased = store.leased()?;
                skips = RandomState::new().build_hasher().finish() as usize % Timing::spread(losses);
            }
        }
        // After a loss, runs that were skipped may still be free.
        Ok((losses == 0).then_some(held))
    }

    /// Returns the runs whose leases this pass reads, and the number of held runs.
    ///
    /// Few leases are all read. Many are read in turn: each worker would read those of all others otherwise.
    fn due(&self, leased: &HashMap<String, u64>) -> (HashSet<usize>, usize) {
        let slots = lock(&self.slots);
        let open = self.order.iter().copied().filter(|i| matches!(slots[*i], Slot::Open));
        let held: Vec<usize> = open.filter(|i| leased.contains_key(&self.queue.batch.runs[*i].key())).collect();
        let start = self.cursor.fetch_add(Timing::LOOKS, Ordering::SeqCst);
        let due = (0..held.len().min(Timing::LOOKS)).map(|i| held[start.wrapping_add(i) % held.len()]).collect();
        (due, held.len())
    }
}
