//! Limit on how often images may pause a training.

use std::time::{Duration, Instant};

/// Fraction of a training's time that images may take.
pub const SHARE: f64 = 0.05;

/// Time at which the next images are due.
///
/// The pause after each set of images is so long that rendering it took at most [`SHARE`] of the total.
#[derive(Debug)]
pub struct PageRate {
    due: Option<Instant>,
    /// Total time spent on images.
    pub spent: Duration,
}

impl PageRate {
    /// Creates a rate whose first images are due at once.
    pub fn new() -> PageRate {
        PageRate { due: None, spent: Duration::ZERO }
    }

    /// Returns whether images are due.
    pub fn is_due(&self, now: Instant) -> bool {
        self.due.is_none_or(|due| now >= due)
    }

    /// Records images that were rendered from `begun` to `ended`.
    pub fn made(&mut self, begun: Instant, ended: Instant) {
        let cost = ended.saturating_duration_since(begun);
        self.spent += cost;
        // The page polls every two seconds, so images in between would not be seen.
        let rest = cost.mul_f64(1.0 / SHARE - 1.0).max(Duration::from_secs(2));
        self.due = Some(ended + rest);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_take_at_most_their_share_of_the_time() {
        let begun = Instant::now();
        let mut rate = PageRate::new();
        let (mut now, mut images) = (begun, 0u32);
        // Images of varying cost, separated by steps of 30 ms.
        while now < begun + Duration::from_secs(2000) {
            if rate.is_due(now) {
                let cost = Duration::from_millis(u64::from(40 + 170 * (images % 9)));
                rate.made(now, now + cost);
                now += cost;
                images += 1;
            }
            now += Duration::from_millis(30);
        }
        let share = rate.spent.as_secs_f64() / (now - begun).as_secs_f64();
        assert!(share <= SHARE && share > 0.6 * SHARE && images > 50, "{share}, {images}");
        // Cheap images still wait two seconds.
        let mut rate = PageRate::new();
        rate.made(begun, begun + Duration::from_millis(1));
        assert!(!rate.is_due(begun + Duration::from_secs(1)) && rate.is_due(begun + Duration::from_secs(3)));
    }
}
