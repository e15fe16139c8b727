//! Load of the shared disk over time.

use super::disk::Ops;

/// Seconds of an interval of the record.
const INTERVAL: f64 = 10.0;

/// Operations and bytes of all workers over time.
#[derive(Clone, Debug, Default)]
pub struct Load {
    /// All operations by place.
    pub ops: Ops,
    /// All bytes.
    pub bytes: f64,
    operations: Vec<f64>,
    transfers: Vec<f64>,
}

fn put(into: &mut Vec<f64>, from: f64, to: f64, amount: f64) {
    let (first, last) = ((from / INTERVAL) as usize, (to / INTERVAL) as usize);
    if into.len() <= last {
        into.resize(last + 1, 0.0);
    }
    if first == last {
        into[first] += amount;
        return;
    }
    for i in first..=last {
        let (start, end) = (i as f64 * INTERVAL, (i + 1) as f64 * INTERVAL);
        into[i] += amount * (to.min(end) - from.max(start)) / (to - from);
    }
}

impl Load {
    /// Adds operations at a time.
    pub fn add(&mut self, at: f64, ops: &Ops) {
        self.ops += *ops;
        put(&mut self.operations, at, at, ops.total());
    }

    /// Adds operations that are spread over a time.
    pub fn spread(&mut self, from: f64, to: f64, ops: &Ops) {
        self.ops += *ops;
        put(&mut self.operations, from, to, ops.total());
    }

    /// Adds bytes at a time.
    pub fn add_bytes(&mut self, at: f64, bytes: f64) {
        self.spread_bytes(at, at, bytes);
    }

    /// Adds bytes that are spread over a time.
    pub fn spread_bytes(&mut self, from: f64, to: f64, bytes: f64) {
        if bytes > 0.0 {
            self.bytes += bytes;
            put(&mut self.transfers, from, to, bytes);
        }
    }

    /// Returns the most operations and bytes a second, over ten seconds.
    pub fn peaks(&self) -> (f64, f64) {
        let most = |all: &[f64]| all.iter().copied().fold(0.0, f64::max) / INTERVAL;
        (most(&self.operations), most(&self.transfers))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spread_load_keeps_its_sum_and_peaks_where_it_is() {
        let mut load = Load::default();
        let one = Ops { leases: 1.0, ..Ops::NONE };
        load.spread(5.0, 25.0, &(one * 40.0));
        assert_eq!(load.operations, [10.0, 20.0, 10.0]);
        load.add(12.0, &(one * 30.0));
        assert_eq!((load.ops.total(), load.peaks().0), (70.0, 5.0));
        load.add_bytes(99.0, 1000.0);
        assert_eq!((load.bytes, load.peaks().1), (1000.0, 100.0));
    }
}
