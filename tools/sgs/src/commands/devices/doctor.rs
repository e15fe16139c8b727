//! `sgs devices --doctor`: driver files of the Vulkan loader, and what is missing.

use crate::common::Common;
use anyhow::bail;
use serde::Serialize;
use sgs_engine::{DRIVER_VARIABLES, DeviceInfo, DriverFile, driver_files};
use std::path::Path;

/// What the system has, and what to do.
#[derive(Serialize)]
struct Report {
    /// Whether the Vulkan loader opens; else the error.
    loader: Result<(), String>,
    /// Driver files that the loader reads.
    drivers: Vec<DriverFile>,
    /// Variables that select driver files, with their values.
    variables: Vec<(&'static str, String)>,
    /// Names of the devices, and what each lacks.
    devices: Vec<Found>,
    /// What to install or change, one sentence each.
    advice: Vec<String>,
}

#[derive(Serialize)]
struct Found {
    name: String,
    kind: &'static str,
    missing: Vec<String>,
}

/// Hardware whose kernel driver is loaded.
#[derive(Clone, Copy, Default)]
struct Kernel {
    /// Kernel driver of NVIDIA.
    nvidia: bool,
    /// Render nodes of other GPUs.
    render_nodes: bool,
}

impl Kernel {
    fn here() -> Kernel {
        let is_render = |e: std::fs::DirEntry| e.file_name().to_string_lossy().starts_with("renderD");
        let mut nodes = std::fs::read_dir("/dev/dri").into_iter().flatten().flatten();
        Kernel {
            nvidia: Path::new("/proc/driver/nvidia/version").exists() || Path::new("/dev/nvidiactl").exists(),
            render_nodes: nodes.any(is_render),
        }
    }
}

pub fn run(common: &Common) -> anyhow::Result<()> {
    let variable = |name: &str| std::env::var(name).ok();
    let drivers = driver_files(&variable);
    let variables: Vec<_> = DRIVER_VARIABLES.into_iter().filter_map(|name| Some((name, variable(name)?))).collect();
    let (loader, devices) = match sgs_engine::devices() {
        Ok(devices) => (Ok(()), devices),
        Err(error) => (Err(error.to_string()), Vec::new()),
    };
    let advice = advice(loader.is_ok(), &drivers, !variables.is_empty(), &devices, Kernel::here());
    let usable = devices.iter().any(|d| d.missing.is_empty());
    let found = |d: DeviceInfo| Found { name: d.name, kind: d.kind, missing: d.missing };
    let report = Report { loader, drivers, variables, devices: devices.into_iter().map(found).collect(), advice };
    if !common.answer(&report)? {
        report.print();
    }
    if !usable {
        bail!("no device can run SGS; {}.", report.advice.first().map_or("see the report", String::as_str));
    }
    Ok(())
}

impl Report {
    fn print(&self) {
        match &self.loader {
            Ok(()) => println!("Vulkan loader: opened"),
            Err(error) => println!("Vulkan loader: {error}"),
        }
        for (name, value) in &self.variables {
            println!("variable {name} = {value}");
        }
        for DriverFile { path, library, api, problem } in &self.drivers {
            let library = library.as_deref().unwrap_or("no library");
            let api = api.as_ref().map(|api| format!(", Vulkan {api}")).unwrap_or_default();
            let verdict = problem.as_ref().map_or("accepted".to_owned(), |p| format!("rejected: {p}"));
            println!("driver file {}\n   {library}{api}\n   {verdict}", path.display());
        }
        for Found { name, kind, missing } in &self.devices {
            let lacks = if missing.is_empty() { "can run".to_owned() } else { format!("lacks {}", missing.join(", ")) };
            println!("device {name} ({kind})\n   {lacks}");
        }
        for line in &self.advice {
            println!("advice: {line}");
        }
    }
}

/// Returns what to install or change, the most useful first.
fn advice(loader: bool, drivers: &[DriverFile], selected: bool, devices: &[DeviceInfo], kernel: Kernel) -> Vec<String> {
    let mut advice = Vec::new();
    if !loader {
        advice.push("install the Vulkan loader (libvulkan1 on Debian)".to_owned());
    }
    let of_nvidia = |d: &&DriverFile| d.library.as_ref().is_some_and(|l| l.contains("nvidia"));
    let nvidia: Vec<&DriverFile> = drivers.iter().filter(of_nvidia).collect();
    for driver in drivers.iter().filter(|d| d.problem.is_some()) {
        let (path, problem) = (driver.path.display(), driver.problem.as_deref().unwrap_or_default());
        // The driver of NVIDIA is linked against libraries of X11, also where there is no screen.
        match ["libX11", "libXext", "libxcb", "libwayland", "libEGL", "libGL"].iter().any(|lib| problem.contains(lib)) {
            true if of_nvidia(&driver) => advice.push(format!(
                "install libx11-6, libxext6 and libegl1, which the driver of \"{path}\" needs also without a screen"
            )),
            _ => advice.push(format!("mend or remove \"{path}\": {problem}")),
        }
    }
    let has = |vendor: &str| devices.iter().any(|d| d.driver.to_lowercase().contains(vendor));
    if kernel.nvidia && nvidia.is_empty() {
        advice.push(
            "the kernel driver of NVIDIA is loaded, but its Vulkan driver is not here; in a container set \
             NVIDIA_DRIVER_CAPABILITIES=all, else install the driver's user part (nvidia-vulkan-icd on Debian)"
                .to_owned(),
        );
    } else if kernel.nvidia && nvidia.iter().all(|d| d.problem.is_none()) && loader && !has("nvidia") {
        advice.push(
            "NVIDIA's Vulkan driver loads but offers no device; compare its version with that of the kernel driver \
             (/proc/driver/nvidia/version), and check the rights of /dev/nvidia*"
                .to_owned(),
        );
    }
    if kernel.render_nodes && !kernel.nvidia && loader && devices.iter().all(|d| d.kind == "cpu") {
        advice.push("a GPU is there, but no driver for it; install mesa-vulkan-drivers, and check the rights of /dev/dri/renderD*".to_owned());
    }
    if selected && devices.is_empty() {
        advice.push("unset the variables that select driver files, or correct them".to_owned());
    }
    if drivers.is_empty() {
        advice.push("install a Vulkan driver (mesa-vulkan-drivers on Debian also runs on processors)".to_owned());
    }
    advice
}

#[cfg(test)]
mod tests {
    use super::*;

    fn driver(library: &str, problem: Option<&str>) -> DriverFile {
        DriverFile {
            path: "/etc/vulkan/icd.d/a.json".into(),
            library: Some(library.into()),
            api: None,
            problem: problem.map(str::to_owned),
        }
    }

    #[test]
    fn advice_fits_what_is_missing() {
        let (nvidia, none) = (Kernel { nvidia: true, ..Kernel::default() }, Kernel::default());
        let render = Kernel { render_nodes: true, ..Kernel::default() };
        let first = |loader, drivers: &[DriverFile], selected, kernel| {
            advice(loader, drivers, selected, &[], kernel).first().cloned().unwrap_or_default()
        };
        let lavapipe = driver("libvulkan_lvp.so", None);
        let glx = driver("libGLX_nvidia.so.0", None);
        let broken = driver(
            "libGLX_nvidia.so.0",
            Some("its library cannot be loaded: libX11.so.6: cannot open shared object file"),
        );
        let missing = driver("libnone.so", Some("its library cannot be loaded: libnone.so"));
        assert!(first(false, &[], false, none).contains("libvulkan1"));
        assert!(first(true, &[], false, none).contains("mesa-vulkan-drivers"));
        assert!(first(true, std::slice::from_ref(&lavapipe), false, nvidia).contains("NVIDIA_DRIVER_CAPABILITIES"));
        assert!(first(true, &[glx], false, nvidia).contains("/proc/driver/nvidia/version"));
        assert!(first(true, &[broken], false, nvidia).contains("libx11-6"));
        assert!(first(true, &[missing], false, none).contains("mend or remove"));
        assert!(first(true, std::slice::from_ref(&lavapipe), false, render).contains("renderD"));
        assert!(first(true, std::slice::from_ref(&lavapipe), true, none).contains("unset"));
        assert_eq!(first(true, &[lavapipe], false, none), "");
    }
}
