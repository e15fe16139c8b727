//! Harness that runs the `sgs` program as a user does and captures its results.
//!
//! The results are the exit status, standard output and standard error. Cargo gives the path of a program only to the
//! tests of its own package. This module therefore looks for the program next to the test programs. It builds the
//! program first if the program is absent or older than any source, so that no test runs an outdated program.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant, SystemTime};

/// Result of a finished run of the program.
#[derive(Clone, Debug)]
pub struct Finished {
    /// Exit status; `None` if a signal ended the program.
    pub status: Option<i32>,
    /// Standard output.
    pub stdout: String,
    /// Standard error.
    pub stderr: String,
    arguments: String,
}

impl Finished {
    /// Fails unless the program succeeded.
    #[track_caller]
    pub fn ok(self) -> Finished {
        assert_eq!(self.status, Some(0), "sgs {}\n{}{}", self.arguments, self.stdout, self.stderr);
        self
    }

    /// Fails unless the program refused with one sentence that contains all words.
    ///
    /// The exit status must be that of a refusal: 1, 2, 42 or 75. The sentence is on standard error; warnings may
    /// precede it. Standard output is empty, or with `--json` holds the same sentence as JSON.
    #[track_caller]
    pub fn refused(&self, words: &[&str]) -> &Finished {
        let context = format!("sgs {}\n{}{}", self.arguments, self.stdout, self.stderr);
        assert!(self.status.is_some_and(|s| [1, 2, 42, 75].contains(&s)), "{context}");
        self.assert_no_panic();
        let message: Vec<&str> =
            self.stderr.lines().filter(|l| !l.trim_start().starts_with("WARN") && !l.trim().is_empty()).collect();
        let [sentence] = message[..] else { panic!("one line was expected: {context}") };
        assert!(sentence.starts_with("sgs: ") && sentence.len() < 700, "{context}");
        if self.arguments.split(' ').any(|a| a == "--json") {
            assert_eq!(self.json()["error"], sentence["sgs: ".len()..], "{context}");
        } else {
            assert_eq!(self.stdout, "", "{context}");
        }
        for word in words {
            assert!(sentence.contains(word), "\"{word}\" is missing: {context}");
        }
        self
    }

    /// Fails unless the program refused with this exit status; see [`Finished::refused`].
    #[track_caller]
    pub fn refused_with(&self, status: i32, words: &[&str]) -> &Finished {
        let context = format!("sgs {}\n{}{}", self.arguments, self.stdout, self.stderr);
        assert_eq!(self.status, Some(status), "{context}");
        self.refused(words)
    }

    /// Fails if the program panicked.
    #[track_caller]
    pub fn assert_no_panic(&self) {
        for word in ["panicked", "RUST_BACKTRACE", "stack backtrace"] {
            assert!(!self.stderr.contains(word), "sgs {}\n{}", self.arguments, self.stderr);
        }
    }

    /// Parses standard output as JSON.
    #[track_caller]
    pub fn json(&self) -> serde_json::Value {
        serde_json::from_str(&self.stdout).unwrap_or_else(|e| panic!("sgs {}: {e}\n{}", self.arguments, self.stdout))
    }
}

/// Runs the program to its end.
pub fn sgs<S: AsRef<str>>(arguments: &[S]) -> Finished {
    let output = command(arguments).output().unwrap_or_else(|e| panic!("sgs cannot be run: {e}"));
    finished(arguments, output)
}

/// Runs the program as [`sgs`] does, with additional environment variables.
pub fn sgs_with<S: AsRef<str>>(arguments: &[S], environment: &[(&str, &str)]) -> Finished {
    let output = command(arguments).envs(environment.iter().copied()).output();
    finished(arguments, output.unwrap_or_else(|e| panic!("sgs cannot be run: {e}")))
}

/// Starts the program; [`wait`] returns its output.
pub fn start<S: AsRef<str>>(arguments: &[S]) -> Child {
    start_with(arguments, &[])
}

/// Starts the program as [`start`] does, with additional environment variables.
pub fn start_with<S: AsRef<str>>(arguments: &[S], environment: &[(&str, &str)]) -> Child {
    let mut command = command(arguments);
    command.envs(environment.iter().copied());
    command.stdout(Stdio::piped()).stderr(Stdio::piped());
    command.spawn().unwrap_or_else(|e| panic!("sgs cannot be run: {e}"))
}

/// Waits for a program from [`start`].
pub fn wait(child: Child) -> Finished {
    finished(&["(started before)"], child.wait_with_output().unwrap_or_else(|e| panic!("sgs cannot be awaited: {e}")))
}

/// Runs the program from a shell after commands that set limits or signals.
pub fn sgs_after<S: AsRef<str>>(preparation: &str, arguments: &[S]) -> Finished {
    let direct = command(arguments);
    let mut shell = Command::new("bash");
    shell.arg("-c").arg(format!("{preparation}; exec \"$@\"")).arg("bash").arg(direct.get_program());
    shell.args(direct.get_args());
    for (name, value) in direct.get_envs() {
        match value {
            Some(value) => shell.env(name, value),
            None => shell.env_remove(name),
        };
    }
    finished(arguments, shell.output().unwrap_or_else(|e| panic!("bash cannot be run: {e}")))
}

/// Runs the program with a closed reader of its standard output.
pub fn sgs_with_closed_stdout<S: AsRef<str>>(arguments: &[S]) -> Finished {
    let (reader, writer) = std::io::pipe().unwrap_or_else(|e| panic!("there is no pipe: {e}"));
    drop(reader);
    let output = command(arguments).stdout(writer).output();
    finished(arguments, output.unwrap_or_else(|e| panic!("sgs cannot be run: {e}")))
}

/// Sends a signal, named without SIG.
pub fn signal(child: &Child, name: &str) {
    let status = Command::new("kill").arg(format!("-{name}")).arg(child.id().to_string()).status();
    assert!(status.is_ok_and(|s| s.success()), "the signal {name} could not be sent");
}

/// Waits until a condition holds while a program runs.
///
/// Returns false if the program ended first. Fails after five minutes.
#[track_caller]
pub fn until(child: &mut Child, mut holds: impl FnMut() -> bool) -> bool {
    let begun = Instant::now();
    loop {
        if holds() {
            return true;
        }
        if child.try_wait().is_ok_and(|s| s.is_some()) {
            return false;
        }
        assert!(begun.elapsed() < Duration::from_secs(300), "nothing happened within five minutes");
        std::thread::sleep(Duration::from_millis(1));
    }
}

fn command<S: AsRef<str>>(arguments: &[S]) -> Command {
    let program = program();
    let mut command = Command::new(program);
    command.args(arguments.iter().map(AsRef::as_ref));
    if let Ok(device) = std::env::var("SGS_TEST_DEVICE")
        && !arguments.iter().any(|a| a.as_ref() == "--device")
    {
        command.args(["--device", &device]);
    }
    // Tests share one pipeline cache and leave the user's cache alone.
    let cache = program.with_file_name("sgs-tests-cache");
    command.env("XDG_CACHE_HOME", cache).env("RUST_BACKTRACE", "1").env_remove("SGS_LOG").stdin(Stdio::null());
    command
}

fn finished<S: AsRef<str>>(arguments: &[S], output: Output) -> Finished {
    let text = |bytes: Vec<u8>| String::from_utf8_lossy(&bytes).into_owned();
    Finished {
        status: output.status.code(),
        stdout: text(output.stdout),
        stderr: text(output.stderr),
        arguments: arguments.iter().map(AsRef::as_ref).collect::<Vec<_>>().join(" "),
    }
}

/// Returns the path of the program, built if necessary.
pub fn program() -> &'static Path {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    PROGRAM.get_or_init(|| {
        let test = std::env::current_exe().unwrap_or_else(|e| panic!("where the tests are is unknown: {e}"));
        let profile = test.parent().and_then(Path::parent).unwrap_or_else(|| panic!("{} is no test", test.display()));
        let path = profile.join(format!("sgs{}", std::env::consts::EXE_SUFFIX));
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let built = path.metadata().and_then(|m| m.modified()).ok();
        if built.is_none_or(|built| newest(&root) > built) {
            let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
            let mut command = Command::new(cargo);
            command.current_dir(&root).args(["build", "--quiet", "--package", "sgs"]);
            if profile.file_name().is_some_and(|n| n == "release") {
                command.arg("--release");
            }
            assert!(command.status().is_ok_and(|s| s.success()), "sgs could not be built");
        }
        path
    })
}

/// Returns the time of the latest change of the program's sources.
fn newest(root: &Path) -> SystemTime {
    let mut newest = SystemTime::UNIX_EPOCH;
    let folders = ["engine", "passes", "shaders-glsl", "tools"];
    let mut open: Vec<PathBuf> = folders.iter().map(|f| root.join(f)).collect();
    while let Some(folder) = open.pop() {
        for entry in std::fs::read_dir(&folder).into_iter().flatten().flatten() {
            let name = entry.file_name();
            match entry.metadata() {
                Ok(m) if m.is_dir() && name != "tests" && name != "examples" => open.push(entry.path()),
                Ok(m) if m.is_file() => newest = newest.max(m.modified().unwrap_or(newest)),
                _ => {}
            }
        }
    }
    newest
}
