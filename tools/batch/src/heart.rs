//! Heartbeat: a thread that renews a lease while its run is trained.

use crate::lease::Lease;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, mpsc};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Thread that renews a lease.
pub(crate) struct Heart {
    thread: JoinHandle<Lease>,
    end: mpsc::Sender<()>,
    pulse: Arc<Pulse>,
}

/// What the thread reports.
#[derive(Default)]
struct Pulse {
    lost: AtomicBool,
    /// Number of renewals that were quick enough to count.
    beats: AtomicU64,
}

impl Heart {
    /// Starts to renew a lease.
    ///
    /// `give_up`: how long the lease may stay without a renewal before it counts as lost. It must be shorter than the
    /// time after which others take it over.
    pub fn start(mut lease: Lease, interval: Duration, give_up: Duration) -> Heart {
        let (end, ended) = mpsc::channel();
        let pulse = Arc::new(Pulse::default());
        let shared = pulse.clone();
        let thread = std::thread::spawn(move || {
            let mut last = Instant::now();
            while ended.recv_timeout(interval) == Err(mpsc::RecvTimeoutError::Timeout) {
                let begun = Instant::now();
                match lease.renew() {
                    Ok(true) => {
                        last = begun;
                        // After a pause within the renewal the processes must not trust it.
                        if begun.elapsed() < interval.max(Duration::from_millis(500)) {
                            shared.beats.fetch_add(1, Ordering::SeqCst);
                        }
                    }
                    Ok(false) => shared.lost.store(true, Ordering::SeqCst),
                    Err(_) if last.elapsed() >= give_up => shared.lost.store(true, Ordering::SeqCst),
                    Err(_) => {}
                }
            }
            lease
        });
        Heart { thread, end, pulse }
    }

    /// Returns whether the lease was lost.
    pub fn is_lost(&self) -> bool {
        self.pulse.lost.load(Ordering::SeqCst)
    }

    /// Returns the number of renewals.
    pub fn beats(&self) -> u64 {
        self.pulse.beats.load(Ordering::SeqCst)
    }

    /// Stops the thread. Returns the lease.
    pub fn stop(self) -> Option<Lease> {
        drop(self.end);
        self.thread.join().ok()
    }
}
