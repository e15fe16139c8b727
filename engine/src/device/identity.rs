//! Identity of devices, and the choice of a device among those of a scheduler.
//!
//! Ray, Slurm and containers name GPUs in environment variables. Vulkan ignores these, so [`select_auto`] maps them to
//! Vulkan devices: UUIDs as they are, indices by the UUIDs of `nvidia-smi` or by PCI address. It guesses nothing. If a
//! variable could mean several devices, the choice is refused.

use super::info::DeviceInfo;
use crate::error::{Error, Result};
use serde::Serialize;

/// PCI vendor of NVIDIA.
const NVIDIA: u32 = 0x10de;
/// PCI vendor of AMD.
const AMD: u32 = 0x1002;

/// Chosen device.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Selection {
    /// Index in the loader's list.
    pub index: usize,
    /// Reason for the choice, as a part of a sentence.
    pub reason: String,
}

/// Environment that tells which devices a scheduler has made visible.
pub struct Environment<'a> {
    /// Returns the value of a variable.
    pub variable: &'a dyn Fn(&str) -> Option<String>,
    /// Returns the UUIDs of NVIDIA's devices by index, if `nvidia-smi` tells them.
    pub nvidia_uuids: &'a dyn Fn() -> Option<Vec<String>>,
}

impl Environment<'static> {
    /// Returns the environment of this process.
    pub fn current() -> Environment<'static> {
        Environment { variable: &|name| std::env::var(name).ok(), nvidia_uuids: &nvidia_uuids }
    }
}

/// Asks `nvidia-smi` for the UUIDs of all devices.
fn nvidia_uuids() -> Option<Vec<String>> {
    let arguments = ["--query-gpu=uuid", "--format=csv,noheader"];
    let output = std::process::Command::new("nvidia-smi").args(arguments).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    let uuids: Vec<String> = text.lines().map(|line| line.trim().to_owned()).filter(|l| !l.is_empty()).collect();
    (output.status.success() && !uuids.is_empty()).then_some(uuids)
}

/// Restriction that a variable places on the devices of a vendor.
enum Restriction {
    /// All devices may be used.
    Absent,
    /// No device of the vendor may be used.
    Hidden,
    /// First visible device: an index or a UUID.
    First(String),
}

/// Variable of a scheduler.
struct Variable {
    name: &'static str,
    /// Vendor whose devices it names; none for the GPUs of all vendors.
    vendor: Option<u32>,
    read: fn(&str) -> Restriction,
}

/// Variables in the order of their precedence.
const VARIABLES: [Variable; 4] = [
    Variable { name: "CUDA_VISIBLE_DEVICES", vendor: Some(NVIDIA), read: listed },
    Variable { name: "ROCR_VISIBLE_DEVICES", vendor: Some(AMD), read: listed },
    Variable { name: "NVIDIA_VISIBLE_DEVICES", vendor: Some(NVIDIA), read: injected },
    Variable { name: "SLURM_JOB_GPUS", vendor: None, read: listed },
];

/// Reads a list of devices. An empty list and invalid entries hide all devices, as in CUDA.
fn listed(value: &str) -> Restriction {
    match value.split(',').next().map(str::trim) {
        None | Some("" | "-1" | "NoDevFiles") => Restriction::Hidden,
        Some(first) => Restriction::First(first.to_owned()),
    }
}

/// Reads the devices that a container has. Words say that nothing restricts the devices that are there.
fn injected(value: &str) -> Restriction {
    match value.trim() {
        "" | "all" | "void" | "none" => Restriction::Absent,
        value => listed(value),
    }
}

/// Selects the device that a scheduler has made visible, else the best: discrete, integrated, virtual, cpu.
///
/// # Errors
/// If there is no device, or a variable could mean several devices or none that is there.
pub fn select_auto(all: &[DeviceInfo], environment: &Environment<'_>) -> Result<Selection> {
    let is_gpu = |d: &DeviceInfo| d.kind != "cpu" && d.kind != "other";
    let mut hidden: Vec<(&'static str, u32)> = Vec::new();
    for Variable { name, vendor, read } in VARIABLES {
        let Some(value) = (environment.variable)(name) else { continue };
        let mut gpus: Vec<&DeviceInfo> =
            all.iter().filter(|d| is_gpu(d) && vendor.is_none_or(|v| d.vendor == v)).collect();
        if gpus.is_empty() {
            continue;
        }
        gpus.sort_by(|a, b| (&a.pci, a.index).cmp(&(&b.pci, b.index)));
        match (read)(&value) {
            Restriction::Absent => {}
            Restriction::Hidden => hidden.extend(vendor.map(|v| (name, v))),
            Restriction::First(entry) => {
                let index = visible(&gpus, name, &value, &entry, environment)?;
                return Ok(Selection { index, reason: format!("{name} is \"{value}\"") });
            }
        }
    }
    let shown = |d: &&DeviceInfo| !hidden.iter().any(|(_, vendor)| *vendor == d.vendor);
    let mut rest: Vec<&DeviceInfo> = all.iter().filter(shown).collect();
    // The stable sort keeps the loader's order among equals; complete devices precede incomplete ones.
    rest.sort_by_key(|d| (!d.missing.is_empty(), rank(d)));
    let Some(best) = rest.first() else {
        return Err(match hidden.first() {
            Some((name, _)) => refused(&format!("{name} hides all devices"), all),
            None => Error::NoDevice { requested: "any device".to_owned(), found: names(all) },
        });
    };
    let equals =
        rest.iter().filter(|d| d.missing.is_empty() == best.missing.is_empty() && rank(d) == rank(best)).count();
    let reason = match (equals, hidden.first()) {
        (1, None) => format!("it is the only {} device", best.kind),
        (1, Some((name, _))) => format!("it is the only {} device, and {name} hides others", best.kind),
        (count, _) => format!("it is the first of {count} {} devices", best.kind),
    };
    Ok(Selection { index: best.index, reason })
}

/// Returns the index of the device that an entry of a variable names.
fn visible(
    gpus: &[&DeviceInfo],
    variable: &str,
    value: &str,
    entry: &str,
    environment: &Environment<'_>,
) -> Result<usize> {
    let fail = |why: &str| {
        let all: Vec<DeviceInfo> = gpus.iter().map(|d| (*d).clone()).collect();
        refused(&format!("{variable} is \"{value}\", but {why}"), &all)
    };
    let by_uuid = |uuid: &str| {
        let found: Vec<&&DeviceInfo> = gpus.iter().filter(|d| has_uuid(d, uuid)).collect();
        match found[..] {
            [device] => Ok(device.index),
            [] => Err(fail(&format!("no Vulkan device has the UUID {uuid}"))),
            _ => Err(fail(&format!("several Vulkan devices have the UUID {uuid}"))),
        }
    };
    let Ok(number) = entry.parse::<usize>() else { return by_uuid(entry) };
    let first = gpus.first().map(|d| (&d.name, d.vendor));
    let alike = gpus.iter().all(|d| Some((&d.name, d.vendor)) == first);
    let by_speed = variable == "CUDA_VISIBLE_DEVICES"
        && (environment.variable)("CUDA_DEVICE_ORDER").is_none_or(|order| order != "PCI_BUS_ID");
    if !alike && by_speed {
        return Err(fail(
            "its indices count unlike devices by their speed; set CUDA_DEVICE_ORDER=PCI_BUS_ID, or use UUIDs",
        ));
    }
    if gpus.len() > 1
        && gpus.iter().all(|d| d.vendor == NVIDIA)
        && let Some(uuids) = (environment.nvidia_uuids)()
    {
        return match uuids.get(number) {
            Some(uuid) => by_uuid(uuid),
            None => Err(fail(&format!("nvidia-smi lists {} devices", uuids.len()))),
        };
    }
    if gpus.len() > 1 && gpus.iter().any(|d| d.pci.is_none()) {
        return Err(fail("the drivers do not tell the PCI addresses by which its indices count"));
    }
    match gpus.get(number) {
        Some(device) => Ok(device.index),
        None => Err(fail(&format!("there is no GPU of that index among {}", gpus.len()))),
    }
}

/// Returns the rank of the kind of a device, the best first.
pub(super) fn rank(device: &DeviceInfo) -> u32 {
    match device.kind {
        "discrete" => 0,
        "integrated" => 1,
        "virtual" => 2,
        "cpu" => 3,
        _ => 4,
    }
}

/// Returns whether the UUID of a device begins with that of a request.
pub(super) fn has_uuid(device: &DeviceInfo, requested: &str) -> bool {
    let plain = |uuid: &str| uuid.chars().filter(char::is_ascii_hexdigit).collect::<String>().to_lowercase();
    let bare = |uuid: &str| {
        let lower = uuid.trim().to_lowercase();
        lower.strip_prefix("gpu-").map_or_else(|| lower.clone(), str::to_owned)
    };
    let requested = bare(requested);
    let valid = !requested.is_empty() && requested.chars().all(|c| c.is_ascii_hexdigit() || c == '-');
    valid && plain(&device.uuid).starts_with(&plain(&requested))
}

/// Returns whether a device has the PCI address of a request.
///
/// The domain may be absent or have four or eight digits: `01:00.0`, `0000:01:00.0`, `00000000:01:00.0`.
pub(super) fn has_pci(device: &DeviceInfo, requested: &str) -> bool {
    let numbers = |address: &str| {
        let (rest, function) = address.trim().rsplit_once('.')?;
        let mut parts: Vec<u32> = rest.split(':').map(|p| u32::from_str_radix(p, 16).ok()).collect::<Option<_>>()?;
        if parts.len() == 2 {
            parts.insert(0, 0);
        }
        parts.push(u32::from_str_radix(function, 16).ok()?);
        (parts.len() == 4).then_some(parts)
    };
    let requested = numbers(requested);
    requested.is_some() && device.pci.as_deref().and_then(numbers) == requested
}

/// Creates the error of a request that does not name one device.
pub(super) fn refused(why: &str, all: &[DeviceInfo]) -> Error {
    let line = |d: &DeviceInfo| {
        let pci = d.pci.as_ref().map(|pci| format!(", pci:{pci}")).unwrap_or_default();
        format!("{}: {} (uuid:{}{pci})", d.index, d.name, d.uuid)
    };
    let found: Vec<String> = all.iter().map(line).collect();
    Error::UnclearDevice { why: why.to_owned(), found: found.join("; ") }
}

/// Returns the names of all devices.
pub(super) fn names(all: &[DeviceInfo]) -> String {
    match all {
        [] => "none".to_owned(),
        all => all.iter().map(|d| d.name.as_str()).collect::<Vec<_>>().join(", "),
    }
}

/// Returns the hyphenated text of a UUID.
pub(super) fn uuid_text(bytes: &[u8; 16]) -> String {
    let hex: String = bytes.iter().map(|b| format!("{b:02x}")).collect();
    [&hex[..8], &hex[8..12], &hex[12..16], &hex[16..20], &hex[20..]].join("-")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::info::tests::device;

    /// Returns two NVIDIA devices, one of AMD and a processor. The loader lists NVIDIA's in the reverse order of their addresses.
    fn machine() -> Vec<DeviceInfo> {
        let of = |index, name, kind, vendor, byte: u8, pci: &str| DeviceInfo {
            vendor,
            uuid: uuid_text(&[byte; 16]),
            pci: Some(pci.to_owned()).filter(|p| !p.is_empty()),
            ..device(index, name, kind, &[])
        };
        vec![
            of(0, "H200", "discrete", NVIDIA, 0xb1, "0000:41:00.0"),
            of(1, "H200", "discrete", NVIDIA, 0xa0, "0000:01:00.0"),
            of(2, "MI300", "discrete", AMD, 0xc2, "0000:81:00.0"),
            of(3, "llvmpipe", "cpu", 0x10005, 0x6c, ""),
        ]
    }

    fn auto_with(
        all: &[DeviceInfo],
        variables: &[(&str, &str)],
        smi: Option<&[&str]>,
    ) -> std::result::Result<Selection, String> {
        let variable = |name: &str| variables.iter().find(|(n, _)| *n == name).map(|(_, value)| (*value).to_owned());
        let nvidia_uuids = || smi.map(|all| all.iter().map(|uuid| (*uuid).to_owned()).collect());
        select_auto(all, &Environment { variable: &variable, nvidia_uuids: &nvidia_uuids }).map_err(|e| e.to_string())
    }

    fn auto(variables: &[(&str, &str)]) -> std::result::Result<usize, String> {
        auto_with(&machine(), variables, None).map(|s| s.index)
    }

    #[test]
    fn without_variables_the_best_device_is_chosen() {
        assert_eq!(
            auto_with(&machine(), &[], None).unwrap(),
            Selection { index: 0, reason: "it is the first of 3 discrete devices".into() }
        );
        let cpu = &machine()[3..];
        assert_eq!(auto_with(cpu, &[], None).unwrap().reason, "it is the only cpu device");
        // Variables of absent vendors mean nothing.
        let all = [("CUDA_VISIBLE_DEVICES", "3"), ("ROCR_VISIBLE_DEVICES", ""), ("SLURM_JOB_GPUS", "7")];
        assert_eq!(auto_with(cpu, &all, None).unwrap().index, 3);
        assert!(auto_with(&[], &[], None).unwrap_err().contains("\"any device\""));
    }

    #[test]
    fn indices_count_by_pci_address_and_uuids_are_exact() {
        assert_eq!([auto(&[("CUDA_VISIBLE_DEVICES", "0")]), auto(&[("CUDA_VISIBLE_DEVICES", "1,0")])], [Ok(1), Ok(0)]);
        assert_eq!(auto(&[("CUDA_VISIBLE_DEVICES", "GPU-b1b1b1b1")]), Ok(0));
        assert_eq!(auto(&[("CUDA_VISIBLE_DEVICES", " GPU-A0A0A0A0-a0a0-a0a0-a0a0-a0a0a0a0a0a0 ,1")]), Ok(1));
        assert_eq!(auto(&[("ROCR_VISIBLE_DEVICES", "0")]), Ok(2));
        assert_eq!(auto(&[("NVIDIA_VISIBLE_DEVICES", "GPU-a0"), ("SLURM_JOB_GPUS", "2")]), Ok(1));
        assert_eq!(auto(&[("NVIDIA_VISIBLE_DEVICES", "all"), ("SLURM_JOB_GPUS", "2")]), Ok(2));
        // nvidia-smi counts otherwise where a device is absent from Vulkan.
        let smi = ["GPU-00", "GPU-a0a0a0a0-a0a0-a0a0-a0a0-a0a0a0a0a0a0", "GPU-b1b1b1b1-b1b1-b1b1-b1b1-b1b1b1b1b1b1"];
        let chosen = |entry| auto_with(&machine(), &[("CUDA_VISIBLE_DEVICES", entry)], Some(&smi)).map(|s| s.index);
        assert_eq!([chosen("1"), chosen("2")], [Ok(1), Ok(0)]);
        assert!(chosen("0").unwrap_err().contains("no Vulkan device has the UUID GPU-00"));
        assert!(chosen("3").unwrap_err().contains("nvidia-smi lists 3 devices"));
    }

    #[test]
    fn hidden_devices_are_not_chosen() {
        assert_eq!(auto(&[("CUDA_VISIBLE_DEVICES", "")]), Ok(2));
        let none = [("CUDA_VISIBLE_DEVICES", "-1"), ("ROCR_VISIBLE_DEVICES", "")];
        assert_eq!(auto(&none), Ok(3));
        assert!(
            auto_with(&machine()[..3], &none, None).unwrap_err().contains("CUDA_VISIBLE_DEVICES hides all devices")
        );
    }

    #[test]
    fn unclear_variables_are_refused_with_the_devices() {
        let error = auto(&[("CUDA_VISIBLE_DEVICES", "5")]).unwrap_err();
        assert_eq!(
            error,
            "CUDA_VISIBLE_DEVICES is \"5\", but there is no GPU of that index among 2; select one with --device: 1: H200 \
             (uuid:a0a0a0a0-a0a0-a0a0-a0a0-a0a0a0a0a0a0, pci:0000:01:00.0); 0: H200 \
             (uuid:b1b1b1b1-b1b1-b1b1-b1b1-b1b1b1b1b1b1, pci:0000:41:00.0)."
        );
        assert!(
            auto(&[("CUDA_VISIBLE_DEVICES", "MIG-b1b1")])
                .unwrap_err()
                .contains("no Vulkan device has the UUID MIG-b1b1")
        );
        let mut unlike = machine();
        unlike[0].name = "T4".to_owned();
        let chosen = |variables: &[(&str, &str)]| auto_with(&unlike, variables, None).map(|s| s.index);
        assert!(chosen(&[("CUDA_VISIBLE_DEVICES", "0")]).unwrap_err().contains("CUDA_DEVICE_ORDER=PCI_BUS_ID"));
        assert_eq!(chosen(&[("CUDA_VISIBLE_DEVICES", "0"), ("CUDA_DEVICE_ORDER", "PCI_BUS_ID")]), Ok(1));
        unlike[0].name = "H200".to_owned();
        unlike[1].pci = None;
        let chosen = |entry| auto_with(&unlike, &[("CUDA_VISIBLE_DEVICES", entry)], None).map(|s| s.index);
        assert!(chosen("0").unwrap_err().contains("PCI addresses"));
        unlike[1].uuid = unlike[0].uuid.clone();
        assert!(auto_with(&unlike, &[("CUDA_VISIBLE_DEVICES", "GPU-b1")], None).unwrap_err().contains("several"));
    }

    #[test]
    fn spellings_of_uuids_and_addresses_are_equal() {
        let device = &machine()[1];
        for uuid in ["a0a0a0a0-a0a0-a0a0-a0a0-a0a0a0a0a0a0", "A0A0A0A0A0A0A0A0A0A0A0A0A0A0A0A0", "GPU-a0a0", "a"] {
            assert!(has_uuid(device, uuid), "{uuid}");
        }
        assert!(
            !["", "GPU-", "a1", "g0", "a0a0a0a0-a0a0-a0a0-a0a0-a0a0a0a0a0a0a"]
                .iter()
                .any(|uuid| has_uuid(device, uuid))
        );
        for pci in ["0000:01:00.0", "01:00.0", "00000000:01:00.0", "1:0.0"] {
            assert!(has_pci(device, pci), "{pci}");
        }
        assert!(!["0001:01:00.0", "01:00", "02:00.0", "", "x:00.0"].iter().any(|pci| has_pci(device, pci)));
        assert!(!has_pci(&machine()[3], "01:00.0"));
    }
}
