//! How much of the device training may take.

use serde::{Deserialize, Serialize};

/// Memory of the device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MemorySettings {
    /// Most bytes that training may take, all in; 0 for what the device or its driver has.
    pub budget: u64,
}
