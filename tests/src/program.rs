//! Test programs that other tests start again.

use std::path::PathBuf;
use std::process::Command;
use std::time::SystemTime;

/// Returns the newest build of a test program. Builds the program if missing.
pub fn program(name: &str) -> PathBuf {
    let this = std::env::current_exe().unwrap();
    let folder = this.parent().unwrap();
    let found = || {
        let files = std::fs::read_dir(folder).unwrap().flatten().filter(|file| {
            let file = file.file_name();
            let hash = file.to_str().and_then(|f| f.strip_prefix(name)?.strip_prefix('-'));
            hash.is_some_and(|h| h.len() == 16 && h.bytes().all(|b| b.is_ascii_hexdigit()))
        });
        files
            .max_by_key(|f| f.metadata().and_then(|m| m.modified()).unwrap_or(SystemTime::UNIX_EPOCH))
            .map(|f| f.path())
    };
    found().unwrap_or_else(|| {
        let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
        let mut build = Command::new(cargo);
        build.args(["test", "--quiet", "--locked", "--no-run", "-p", "sgs-tests", "--test", name]);
        assert!(build.status().is_ok_and(|s| s.success()), "{name} could not be built");
        found().unwrap_or_else(|| panic!("{name} was not found in {}", folder.display()))
    })
}
