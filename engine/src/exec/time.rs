//! GPU times of passes from timestamp queries.

use crate::device::Device;
use crate::error::{Error, Result};
use crate::graph::Plan;
use crate::graph::dump::PassTime;
use ash::vk;

pub(super) struct Times {
    enabled: bool,
    passes: Vec<PassTime>,
    live: Vec<usize>,
    stamps: Vec<u64>,
}

impl Times {
    pub fn new(plan: &Plan, enabled: bool) -> Times {
        let named =
            plan.passes.iter().map(|p| PassTime { name: p.name.clone(), start: vec![], nanoseconds: vec![] }).collect();
        let live = plan.groups.iter().flat_map(|g| g.passes.iter().copied()).collect();
        Times { enabled, passes: named, live, stamps: vec![0; 2 * plan.passes.len()] }
    }

    pub fn enabled(&self) -> bool {
        self.enabled && !self.passes.is_empty()
    }

    /// Reads the timestamps of a finished replay.
    pub fn collect(&mut self, device: &Device, queries: vk::QueryPool) -> Result<()> {
        if !self.enabled() {
            return Ok(());
        }
        let raw = &device.0.raw;
        for &pass in &self.live {
            let stamps = &mut self.stamps[2 * pass..2 * pass + 2];
            // SAFETY: the replay is done, so both stamps are written; the pool has two queries for every pass.
            device.0.gate.call("vkGetQueryPoolResults", &self.passes[pass].name, || unsafe {
                raw.get_query_pool_results(queries, 2 * pass as u32, stamps, vk::QueryResultFlags::TYPE_64)
            })?;
        }
        let period = f64::from(device.info().timestamp_period);
        let first = self.live.iter().map(|&p| self.stamps[2 * p]).min().unwrap_or(0);
        for &pass in &self.live {
            let (begin, end) = (self.stamps[2 * pass], self.stamps[2 * pass + 1]);
            self.passes[pass].start.push(begin.wrapping_sub(first) as f64 * period);
            self.passes[pass].nanoseconds.push(end.wrapping_sub(begin) as f64 * period);
        }
        Ok(())
    }

    /// Returns the first pass in plan order whose end timestamp is not available.
    pub fn running(&self, device: &Device, queries: vk::QueryPool) -> Option<String> {
        // Mesa's lavapipe blocks until all work is done, even without the WAIT flag; the pass name does not justify a
        // hang.
        if !self.enabled() || device.info().kind == "cpu" {
            return None;
        }
        let unfinished = |pass: usize| {
            // Timestamp and its availability.
            let mut stamp = [[0u64; 2]];
            let flags = vk::QueryResultFlags::TYPE_64 | vk::QueryResultFlags::WITH_AVAILABILITY;
            // SAFETY: the pool has two queries for every pass, reset by the replay; the call does not wait.
            let read = device.0.gate.call("vkGetQueryPoolResults", &self.passes[pass].name, || unsafe {
                device.0.raw.get_query_pool_results(queries, 2 * pass as u32 + 1, &mut stamp, flags)
            });
            match read {
                Ok(()) => Some(stamp[0][1] == 0),
                Err(Error::Vulkan { result: vk::Result::NOT_READY, .. }) => Some(true),
                Err(_) => None,
            }
        };
        first_unfinished(&self.live, unfinished).map(|pass| self.passes[pass].name.clone())
    }

    pub fn take(&mut self) -> Vec<PassTime> {
        let mut times = Vec::with_capacity(self.live.len());
        for &p in &self.live {
            let pass = &mut self.passes[p];
            let (start, nanoseconds) = (std::mem::take(&mut pass.start), std::mem::take(&mut pass.nanoseconds));
            times.push(PassTime { name: pass.name.clone(), start, nanoseconds });
        }
        times
    }
}

/// Returns the first unfinished pass; `None` if unknown.
fn first_unfinished(live: &[usize], mut open: impl FnMut(usize) -> Option<bool>) -> Option<usize> {
    for &pass in live {
        if open(pass)? {
            return Some(pass);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_unfinished_pass_is_found() {
        let live = [2, 0, 5];
        assert_eq!(first_unfinished(&live, |p| Some(p == 0 || p == 5)), Some(0));
        assert_eq!(first_unfinished(&live, |p| Some(p == 5)), Some(5));
        assert_eq!(first_unfinished(&live, |_| Some(false)), None);
        assert_eq!(first_unfinished(&live, |p| (p != 0).then_some(p == 5)), None);
    }
}
