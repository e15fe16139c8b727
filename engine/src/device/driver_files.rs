//! Driver files of the Vulkan loader, to find out why a device is missing.
//!
//! The loader reads one JSON file per driver, which names the driver's library. Source: the driver interface document of
//! the Vulkan loader, "Driver Discovery on Linux".

use serde::Serialize;
use std::path::{Path, PathBuf};

/// Driver file and what the loader makes of it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct DriverFile {
    /// Path of the file.
    pub path: PathBuf,
    /// Library that the file names; absent if it cannot be read.
    pub library: Option<String>,
    /// Vulkan version that the file names.
    pub api: Option<String>,
    /// Reason why the loader rejects the file; absent if it accepts it.
    pub problem: Option<String>,
}

/// Variables that select driver files, in the order in which the loader reads them.
pub const DRIVER_VARIABLES: [&str; 5] = [
    "VK_DRIVER_FILES",
    "VK_ICD_FILENAMES",
    "VK_ADD_DRIVER_FILES",
    "VK_LOADER_DRIVERS_SELECT",
    "VK_LOADER_DRIVERS_DISABLE",
];

/// Finds the driver files that the loader reads, and tries to load their libraries.
///
/// `variable` returns the value of an environment variable. Loading a library runs its initializers, as the loader does.
pub fn driver_files(variable: &dyn Fn(&str) -> Option<String>) -> Vec<DriverFile> {
    paths(variable).iter().map(|path| examine(path, &load)).collect()
}

/// Returns the paths of the driver files in the order of the loader.
fn paths(variable: &dyn Fn(&str) -> Option<String>) -> Vec<PathBuf> {
    let given = |name: &str| variable(name).filter(|value| !value.is_empty());
    let split = |value: String| value.split(':').filter(|p| !p.is_empty()).map(PathBuf::from).collect::<Vec<_>>();
    let files = |path: PathBuf| if path.is_dir() { json_files(&path) } else { vec![path] };
    if let Some(only) = given("VK_DRIVER_FILES").or_else(|| given("VK_ICD_FILENAMES")) {
        return split(only).into_iter().flat_map(files).collect();
    }
    let home = given("HOME").map(PathBuf::from);
    let at_home =
        |name: &str, below: &str| given(name).map(PathBuf::from).or_else(|| home.as_ref().map(|home| home.join(below)));
    let mut folders: Vec<PathBuf> = Vec::new();
    folders.extend(at_home("XDG_CONFIG_HOME", ".config"));
    folders.extend(split(given("XDG_CONFIG_DIRS").unwrap_or_else(|| "/etc/xdg".to_owned())));
    folders.push("/etc".into());
    folders.extend(at_home("XDG_DATA_HOME", ".local/share"));
    folders.extend(split(given("XDG_DATA_DIRS").unwrap_or_else(|| "/usr/local/share:/usr/share".to_owned())));
    let added = given("VK_ADD_DRIVER_FILES").map(split).unwrap_or_default().into_iter().flat_map(files);
    let found = folders.iter().flat_map(|folder| json_files(&folder.join("vulkan/icd.d")));
    let mut all: Vec<PathBuf> = Vec::new();
    for path in added.chain(found) {
        if !all.contains(&path) {
            all.push(path);
        }
    }
    all
}

/// Returns the JSON files of a folder, sorted; none if it cannot be read.
fn json_files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut files: Vec<PathBuf> = entries.filter(|p| p.extension().is_some_and(|e| e == "json")).collect();
    files.sort();
    files
}

/// Reads a driver file and tries to load its library with `load`.
fn examine(path: &Path, load: &dyn Fn(&Path) -> Result<(), String>) -> DriverFile {
    let mut file = DriverFile { path: path.to_owned(), library: None, api: None, problem: None };
    let text = match std::fs::read_to_string(path) {
        Ok(text) => text,
        Err(e) => {
            file.problem = Some(format!("cannot be read: {e}"));
            return file;
        }
    };
    let json: serde_json::Value = match serde_json::from_str(&text) {
        Ok(json) => json,
        Err(e) => {
            file.problem = Some(format!("no JSON: {e}"));
            return file;
        }
    };
    let text = |name: &str| json["ICD"][name].as_str().map(str::to_owned);
    (file.library, file.api) = (text("library_path"), text("api_version"));
    let word = text("library_arch");
    let other = if cfg!(target_pointer_width = "64") { "32" } else { "64" };
    file.problem = match &file.library {
        None => Some("names no ICD.library_path".to_owned()),
        Some(_) if word.as_deref() == Some(other) => Some(format!("its library is for {other} bits")),
        Some(library) => {
            // A path with a slash is relative to the file; a bare name is searched by the system.
            let at = match library.contains('/') {
                true => path.parent().unwrap_or(Path::new("")).join(library),
                false => PathBuf::from(library),
            };
            load(&at).err()
        }
    };
    file
}

/// Loads a library, and unloads it again.
fn load(library: &Path) -> Result<(), String> {
    // SAFETY: the loader loads the same library when an instance is created. Its initializers are sound by the platform's
    // contract.
    match unsafe { ash::Entry::load_from(library) } {
        // Drivers export another entry point than the loader does.
        Ok(_) | Err(ash::LoadingError::MissingEntryPoint(_)) => Ok(()),
        Err(ash::LoadingError::LibraryLoadFailure(e)) => Err(format!("its library cannot be loaded: {e}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn driver_files_are_found_in_the_order_of_the_loader() {
        let folder = std::env::temp_dir().join(format!("sgs-driver-files-{}", std::process::id()));
        let [a, b] = ["a", "b"].map(|name| folder.join(name).join("vulkan/icd.d"));
        for (at, name) in [(&a, "2.json"), (&a, "1.json"), (&a, "note.txt"), (&b, "3.json")] {
            std::fs::create_dir_all(at).unwrap();
            std::fs::write(at.join(name), "{}").unwrap();
        }
        let text = |path: &Path| path.to_str().unwrap().to_owned();
        let found = |variables: &[(&str, String)]| {
            let variable = |name: &str| variables.iter().find(|(n, _)| *n == name).map(|(_, value)| value.clone());
            let all = paths(&variable);
            let ours = all.into_iter().filter(|path| path.starts_with(&folder));
            ours.map(|path| path.file_name().unwrap().to_str().unwrap().to_owned()).collect::<Vec<_>>()
        };
        let (config, data) = (text(&folder.join("b")), text(&folder.join("a")));
        let both = [("XDG_CONFIG_HOME", config), ("XDG_DATA_DIRS", data)];
        assert_eq!(found(&both), ["3.json", "1.json", "2.json"]);
        let added = [&both[..], &[("VK_ADD_DRIVER_FILES", text(&a.join("2.json")))]].concat();
        assert_eq!(found(&added), ["2.json", "3.json", "1.json"]);
        let only =
            [&added[..], &[("VK_ICD_FILENAMES", text(&b)), ("VK_DRIVER_FILES", format!("{}:", text(&a)))]].concat();
        assert_eq!(found(&only), ["1.json", "2.json"], "nothing else is read");
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn rejected_files_have_a_reason() {
        let folder = std::env::temp_dir().join(format!("sgs-driver-file-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let path = folder.join("driver.json");
        let problem = |text: &str| {
            std::fs::write(&path, text).unwrap();
            examine(&path, &load).problem.unwrap_or_default()
        };
        let named = |library: &str| format!(r#"{{"ICD": {{"library_path": "{library}", "api_version": "1.3.0"}}}}"#);
        assert!(problem("{").contains("no JSON"));
        assert!(problem("{}").contains("ICD.library_path"));
        assert!(problem(r#"{"ICD": {"library_path": "a.so", "library_arch": "32"}}"#).contains("32 bits"));
        let missing = problem(&named("./missing.so"));
        assert!(missing.contains("cannot be loaded") && missing.contains(folder.to_str().unwrap()), "{missing}");
        assert!(problem(&named("libsgs-none.so")).contains("libsgs-none.so"));
        // Any library loads, as a driver does.
        assert_eq!(problem(&named("libc.so.6")), "");
        std::fs::write(folder.join("text.so"), "no library").unwrap();
        assert!(problem(&named("./text.so")).contains("cannot be loaded"));
        std::fs::remove_dir_all(&folder).unwrap();
        assert!(examine(&path, &load).problem.unwrap().contains("cannot be read"));
    }
}
