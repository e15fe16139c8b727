//! Planning for a GPU that is not there: graphs are compiled and collected, and no kernel runs.
//!
//! Programs build their graphs by [`Device::info`]. A planning device reports the properties of the other GPU, so that
//! programs build the graphs that they would build there. Promises: submitted graphs do nothing, copies of the host run,
//! and buffers are zero until the host writes to them. The plans therefore depend on no timing and no uninitialized memory.

use super::{Device, DeviceInfo, MatrixShape, Shared};
use crate::graph::Plan;
use std::sync::{Arc, Mutex, PoisonError};

/// GPU to plan for, as far as graphs depend on it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlannedGpu {
    /// Lanes of a subgroup.
    pub subgroup_size: u32,
    /// Whether the GPU adds 32-bit floats atomically.
    pub float_atomics: bool,
    /// Shapes of cooperative matrices; see [`DeviceInfo::matrices`].
    pub matrices: Vec<MatrixShape>,
}

impl PlannedGpu {
    /// Replaces the properties of the device that stands in.
    pub(super) fn replace(&self, info: &mut DeviceInfo) {
        info.kind = "discrete";
        info.subgroup_size = self.subgroup_size;
        info.subgroup_sizes = (self.subgroup_size, self.subgroup_size);
        info.optional.float_atomics = self.float_atomics;
        info.optional.cooperative_matrix = !self.matrices.is_empty();
        info.matrices.clone_from(&self.matrices);
    }
}

/// Plans of a planning device.
#[derive(Default)]
pub(crate) struct Plans(Mutex<Vec<Arc<Plan>>>);

impl Device {
    /// Returns the plans of all executors that were created, in order. Empty unless the device plans for another GPU.
    pub fn plans(&self) -> Vec<Arc<Plan>> {
        let plans = self.0.plans.as_ref();
        plans.map(|p| p.0.lock().unwrap_or_else(PoisonError::into_inner).clone()).unwrap_or_default()
    }
}

impl Shared {
    /// Returns whether graphs are only collected.
    pub fn is_planning(&self) -> bool {
        self.plans.is_some()
    }

    /// Collects a plan, if the device plans for another GPU.
    pub fn collect_plan(&self, plan: &Arc<Plan>) {
        if let Some(plans) = &self.plans {
            plans.0.lock().unwrap_or_else(PoisonError::into_inner).push(plan.clone());
        }
    }
}
