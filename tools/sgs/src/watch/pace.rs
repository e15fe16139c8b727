//! How often a training may be stopped for pictures.

use std::time::{Duration, Instant};

/// The share of a training's time that pictures may take.
pub const SHARE: f64 = 0.05;

/// When the next pictures are due: as soon as what the last ones took is no more than their share of what came after.
#[derive(Debug)]
pub struct Pace {
    due: Option<Instant>,
    /// Spent on pictures so far.
    pub spent: Duration,
}

impl Pace {
    /// The first ones are due at once.
    pub fn new() -> Pace {
        Pace { due: None, spent: Duration::ZERO }
    }

    /// Whether it is time.
    pub fn is_due(&self, now: Instant) -> bool {
        self.due.is_none_or(|due| now >= due)
    }

    /// Pictures were made.
    pub fn made(&mut self, begun: Instant, ended: Instant) {
        let cost = ended.saturating_duration_since(begun);
        self.spent += cost;
        // Nobody looks more often than a page asks.
        let rest = cost.mul_f64(1.0 / SHARE - 1.0).max(Duration::from_secs(2));
        self.due = Some(ended + rest);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_take_no_more_than_their_share() {
        let begun = Instant::now();
        let mut pace = Pace::new();
        let (mut now, mut pictures) = (begun, 0u32);
        // Pictures of changing cost, with steps of 30 ms between.
        while now < begun + Duration::from_secs(2000) {
            if pace.is_due(now) {
                let cost = Duration::from_millis(u64::from(40 + 170 * (pictures % 9)));
                pace.made(now, now + cost);
                now += cost;
                pictures += 1;
            }
            now += Duration::from_millis(30);
        }
        let share = pace.spent.as_secs_f64() / (now - begun).as_secs_f64();
        assert!(share <= SHARE && share > 0.6 * SHARE && pictures > 50, "{share}, {pictures}");
        // Cheap ones are not made all the time.
        let mut pace = Pace::new();
        pace.made(begun, begun + Duration::from_millis(1));
        assert!(!pace.is_due(begun + Duration::from_secs(1)) && pace.is_due(begun + Duration::from_secs(3)));
    }
}
