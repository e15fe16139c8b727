//! Memory of histories: two buffers each, which swap roles at each replay.
//!
//! Nothing is copied or recorded again: each slot is recorded for one of the two arrangements, and slots alternate.

use super::Executor;
use crate::error::{Error, Result};
use crate::graph::{Buffer, BufferKind};
use crate::memory::{DeviceBuffer, Location};

impl Executor {
    pub(super) fn has_histories(&self) -> bool {
        self.plan.buffers.iter().any(|info| info.kind == BufferKind::History)
    }

    /// Creates and fills the memory of every history.
    pub(super) fn make_histories(&mut self) -> Result<()> {
        for (index, info) in self.plan.buffers.iter().enumerate() {
            if info.kind == BufferKind::History {
                self.externals[index] = Some(self.device.buffer(&info.name, info.bytes, Location::Device)?);
            }
        }
        self.fill_histories()
    }

    fn fill_histories(&self) -> Result<()> {
        for (info, memory) in self.plan.buffers.iter().zip(&self.externals) {
            if let (Some(pair), Some(memory)) = (info.pair, memory) {
                self.device.fill(memory, pair.value)?;
            }
        }
        Ok(())
    }

    /// Resets histories to their initial values. Waits for replays in flight.
    ///
    /// # Errors
    /// [`Error::Timeout`], [`Error::DeviceLost`].
    pub fn reset_histories(&mut self) -> Result<()> {
        self.finish()?;
        self.fill_histories()
    }

    /// Returns the memory behind a half of a history after the latest replay.
    ///
    /// The current half holds that replay's output, the previous half its input. Valid until the next submission.
    ///
    /// # Errors
    /// [`Error::Unbound`] if the buffer belongs to no history.
    pub fn history(&self, buffer: Buffer) -> Result<&DeviceBuffer> {
        let unbound = || Error::Unbound { buffer: format!("number {}", buffer.index()), plan: self.plan.name.clone() };
        let pair = self.plan.buffers.get(buffer.index()).and_then(|info| info.pair);
        pair.ok_or_else(unbound)?;
        let last = &self.slots[(self.next + self.slots.len() - 1) % self.slots.len()];
        self.externals[self.history_half(buffer.index(), last.swapped)].as_ref().ok_or_else(unbound)
    }
}
