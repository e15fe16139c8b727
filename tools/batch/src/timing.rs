//! Intervals of a queue, and what follows from them.

use std::time::Duration;

/// Intervals of a queue.
#[derive(Clone, Copy, Debug)]
pub struct Timing {
    /// Interval of renewals of a lease.
    pub heartbeat: Duration,
    /// Time without a renewal after which the holder lets a run go.
    pub give_up: Duration,
    /// Interval at which a process is polled.
    pub poll: Duration,
    /// Interval at which runs of other workers are polled.
    pub idle: Duration,
    /// Delay of the first retry; each further one doubles it.
    pub delay: Duration,
    /// Longest delay of a retry.
    pub longest_delay: Duration,
    /// Time from the request to end until a process is killed.
    pub grace: Duration,
}

impl Timing {
    /// Time without a renewal after which other workers take a run over; for [`Store::open`](crate::Store::open).
    pub const EXPIRY: Duration = Duration::from_secs(15);

    /// Largest number of leases of other workers that one pass over the runs reads.
    pub const LOOKS: usize = 64;

    /// Returns how many free runs a worker chooses among after lost claims.
    pub fn spread(losses: u32) -> usize {
        1 << losses.saturating_sub(1).min(12)
    }

    /// Returns the delay of a worker that found no free run. `held`: runs that others train.
    ///
    /// It grows with the number of runs, so that many idle workers do not overload the shared disk.
    pub fn idle_delay(&self, held: usize) -> Duration {
        self.idle.saturating_mul((held / 8).clamp(1, 16) as u32)
    }

    /// Returns the least time between two summaries of a batch that still trains.
    ///
    /// A summary holds all results, so that a summary after each run would take quadratic time.
    pub fn summary_interval(&self, runs: usize) -> Duration {
        Duration::from_millis(10).saturating_mul(runs as u32)
    }

    /// Returns the delay before the `n`-th retry.
    pub fn retry_delay(&self, n: u32) -> Duration {
        self.delay.saturating_mul(1 << n.saturating_sub(1).min(16)).min(self.longest_delay)
    }
}

impl Default for Timing {
    fn default() -> Self {
        Timing {
            heartbeat: Duration::from_secs(2),
            give_up: Duration::from_secs(8),
            poll: Duration::from_millis(50),
            idle: Duration::from_millis(500),
            delay: Duration::from_secs(1),
            longest_delay: Duration::from_secs(60),
            grace: Duration::from_secs(30),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn delays_grow_to_their_limits() {
        let timing = Timing::default();
        let seconds = |d: Duration| d.as_secs_f64();
        assert_eq!([1, 2, 3, 6, 7, 99].map(|n| seconds(timing.retry_delay(n))), [1.0, 2.0, 4.0, 32.0, 60.0, 60.0]);
        assert_eq!([0, 8, 15, 16, 128, 4096].map(|n| seconds(timing.idle_delay(n))), [0.5, 0.5, 0.5, 1.0, 8.0, 8.0]);
        assert_eq!([1, 100, 10_000].map(|n| seconds(timing.summary_interval(n))), [0.01, 1.0, 100.0]);
        assert_eq!([0, 1, 2, 9, 99].map(Timing::spread), [1, 1, 2, 256, 4096]);
    }
}
