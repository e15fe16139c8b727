//! Selection of a physical device.

use super::describe::Candidate;
use super::identity::{Environment, has_pci, has_uuid, names, rank, refused, select_auto};
use super::info::DeviceInfo;
use crate::error::{Error, Result};

/// Selects a device: by index, part of its name, `uuid:`, `pci:`, or `auto` (the default, [`select_auto`]).
pub(crate) fn choose(all: Vec<Candidate>, requested: Option<&str>, environment: &Environment<'_>) -> Result<Candidate> {
    let infos: Vec<DeviceInfo> = all.iter().map(|c| c.info.clone()).collect();
    let index = match requested {
        None | Some("auto") => {
            let selection = select_auto(&infos, environment)?;
            tracing::info!("device {}: {}", selection.index, selection.reason);
            selection.index
        }
        Some(requested) => named(&infos, requested)?,
    };
    let none = || Error::NoDevice { requested: "any device".to_owned(), found: names(&infos) };
    let chosen = all.into_iter().find(|c| c.info.index == index).ok_or_else(none)?;
    if !chosen.info.missing.is_empty() {
        return Err(Error::MissingFeatures { device: chosen.info.name, missing: chosen.info.missing });
    }
    Ok(chosen)
}

/// Returns the index of the device that a request names. Of several with the name, it is the best.
pub(super) fn named(all: &[DeviceInfo], requested: &str) -> Result<usize> {
    let matches = |d: &&DeviceInfo| match (requested.parse::<usize>(), requested.split_once(':')) {
        (Ok(index), _) => d.index == index,
        (_, Some(("uuid", uuid))) => has_uuid(d, uuid),
        (_, Some(("pci", pci))) => has_pci(d, pci),
        _ => d.name.to_lowercase().contains(&requested.to_lowercase()),
    };
    let mut found: Vec<&DeviceInfo> = all.iter().filter(matches).collect();
    if found.len() > 1 && (requested.starts_with("uuid:") || requested.starts_with("pci:")) {
        let found: Vec<DeviceInfo> = found.into_iter().cloned().collect();
        return Err(refused(&format!("several devices match \"{requested}\""), &found));
    }
    found.sort_by_key(|d| (!d.missing.is_empty(), rank(d)));
    let none = || Error::NoDevice { requested: requested.to_owned(), found: names(all) };
    found.first().map(|d| d.index).ok_or_else(none)
}

#[cfg(test)]
mod tests {
    use super::super::describe::missing_size_control;
    use super::super::info::tests::device;
    use super::*;
    use ash::vk;

    fn candidate(index: usize, name: &str, kind: &'static str, missing: &[&str]) -> Candidate {
        let info = device(index, name, kind, missing);
        Candidate { physical: vk::PhysicalDevice::null(), queue_family: Some(0), transfer_family: None, info }
    }

    /// Selects without variables of a scheduler.
    fn choose(all: Vec<Candidate>, requested: Option<&str>) -> Result<Candidate> {
        let environment = Environment { variable: &|_| None, nvidia_uuids: &|| None };
        super::choose(all, requested, &environment)
    }

    fn sample_candidates() -> Vec<Candidate> {
        vec![
            candidate(0, "llvmpipe", "cpu", &[]),
            candidate(1, "Small GPU", "integrated", &[]),
            candidate(2, "Old GPU", "discrete", &["scalarBlockLayout", "synchronization2"]),
        ]
    }

    #[test]
    fn best_complete_device_is_selected() {
        assert_eq!(choose(sample_candidates(), None).map(|c| c.info.index).ok(), Some(1));
        assert_eq!(choose(sample_candidates(), Some("0")).map(|c| c.info.index).ok(), Some(0));
        assert_eq!(choose(sample_candidates(), Some("PIPE")).map(|c| c.info.index).ok(), Some(0));
        assert_eq!(choose(sample_candidates(), Some("auto")).map(|c| c.info.index).ok(), Some(1));
        assert_eq!(choose(sample_candidates(), Some("uuid:00")).map(|c| c.info.index).ok(), Some(0));
    }

    #[test]
    fn variable_subgroup_size_requires_size_control() {
        assert_eq!(missing_size_control(true, (8, 32)), None);
        assert_eq!(missing_size_control(false, (32, 32)), None);
        let missing = missing_size_control(false, (32, 64)).unwrap_or_default();
        let refused =
            choose(vec![candidate(0, "Wide GPU", "discrete", &[&missing])], None).err().map(|e| e.to_string());
        let sentence = "Device \"Wide GPU\" lacks subgroupSizeControl (its subgroups have 32 to 64 lanes, and each kernel \
                        needs one size).";
        assert_eq!(refused.as_deref(), Some(sentence));
    }

    #[test]
    fn selection_errors_name_missing_features() {
        let fail = |all, requested| choose(all, requested).err().map(|e| e.to_string()).unwrap_or_default();
        assert_eq!(
            fail(sample_candidates(), Some("old")),
            "Device \"Old GPU\" lacks scalarBlockLayout, synchronization2."
        );
        let found = "found: llvmpipe, Small GPU, Old GPU.";
        assert_eq!(fail(sample_candidates(), Some("3")), format!("No Vulkan device matches \"3\"; {found}"));
        assert_eq!(
            fail(sample_candidates(), Some("pci:01:00.0")),
            format!("No Vulkan device matches \"pci:01:00.0\"; {found}")
        );
        assert!(fail(sample_candidates(), Some("uuid:0")).starts_with("several devices match \"uuid:0\"; select one"));
        assert_eq!(fail(Vec::new(), None), "No Vulkan device matches \"any device\"; found: none.");
        assert_eq!(
            fail(sample_candidates().split_off(2), None),
            "Device \"Old GPU\" lacks scalarBlockLayout, synchronization2."
        );
    }
}
