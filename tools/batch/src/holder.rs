//! Process that holds a lease.

use serde::{Deserialize, Serialize};
use std::collections::hash_map::RandomState;
use std::hash::{BuildHasher, Hasher};
use std::time::{SystemTime, UNIX_EPOCH};

/// Process that holds a lease, as its file records it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Holder {
    /// Host name, for people.
    pub host: String,
    /// Process id.
    pub pid: u32,
    /// Start time in clock ticks since boot; `None` if the system does not report it.
    pub started: Option<u64>,
    /// Boot id of the machine; `None` if the system does not report it.
    pub boot: Option<String>,
    /// Namespace of process ids; `None` if the system does not report it.
    pub namespace: Option<String>,
    /// Word that no other lease has.
    pub token: String,
}

impl Holder {
    /// Returns this process, with a new token.
    pub fn this_process() -> Holder {
        let lock = sgs_run::LockHolder::this_process();
        // Hash maps are seeded at random; two holders of one process differ.
        let random = RandomState::new().build_hasher().finish();
        // The time only makes the token unique. Nothing compares it.
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_nanos();
        let started = lock.started.unwrap_or_default();
        let token = format!("{}-{}-{started}-{now:x}-{random:x}", lock.host, lock.pid);
        let sgs_run::LockHolder { pid, host, started, boot } = lock;
        Holder { host, pid, started, boot, namespace: namespace(), token }
    }

    /// Returns whether the process is known to have ended.
    ///
    /// Only a process of the same boot and the same namespace of process ids is known. All others may still run.
    pub fn has_ended(&self) -> bool {
        let same = |a: &Option<String>, b: Option<String>| a.is_some() && *a == b;
        let boot = sgs_run::LockHolder::this_process().boot;
        let here = same(&self.boot, boot) && same(&self.namespace, namespace());
        here && self.started.is_some() && sgs_run::process_start(self.pid) != self.started
    }
}

/// Returns the namespace of process ids. Containers of one machine have different ones.
fn namespace() -> Option<String> {
    Some(std::fs::read_link("/proc/self/ns/pid").ok()?.to_string_lossy().into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_local_processes_are_known_to_have_ended() {
        let this = Holder::this_process();
        let Some(started) = this.started else { return };
        assert!(!this.has_ended());
        let gone = Holder { started: Some(started + 1), ..this.clone() };
        assert!(gone.has_ended());
        assert!(!Holder { boot: Some("another".into()), ..gone.clone() }.has_ended());
        assert!(!Holder { namespace: Some("another".into()), ..gone.clone() }.has_ended());
        assert!(!Holder { started: None, ..gone }.has_ended());
        assert_ne!(this.token, Holder::this_process().token);
    }
}
