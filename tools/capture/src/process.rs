//! Child processes that end with the capture, with a log of what they print.

use crate::error::{CaptureError, Result, io_error};
use std::fs::File;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Time between two polls of a process.
const POLL: Duration = Duration::from_millis(20);
/// Bytes at the end of a log among which the reason of a failure is searched.
const TAIL: usize = 8192;

/// External program and the Debian package that has it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Program {
    pub(crate) name: &'static str,
    pub(crate) package: &'static str,
}

impl Program {
    /// Returns what the program prints for these arguments, whatever its exit status. Fails if it is not installed.
    pub(crate) fn prints(self, arguments: &[&str]) -> Result<String> {
        let output = self.command().args(arguments).stdin(Stdio::null()).output().map_err(|e| self.not_started(e))?;
        Ok(String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned())
    }

    /// Returns a command that starts the program.
    pub(crate) fn command(self) -> Command {
        let mut command = Command::new(self.name);
        // COLMAP is linked with Qt, which needs no display for its commands.
        command.env("QT_QPA_PLATFORM", "offscreen").stdin(Stdio::null());
        command
    }

    fn not_started(self, error: std::io::Error) -> CaptureError {
        match error.kind() {
            ErrorKind::NotFound => CaptureError::Missing { program: self.name, package: self.package },
            _ => io_error("start", Path::new(self.name))(error),
        }
    }
}

/// Starts processes whose output goes to a log.
pub(crate) struct Processes<'a> {
    /// Folder of the logs.
    pub(crate) folder: &'a Path,
    /// Flag that stops the capture.
    pub(crate) stop: &'a AtomicBool,
}

impl Processes<'_> {
    /// Fails if the capture is to stop.
    pub(crate) fn check(&self) -> Result<()> {
        if self.stop.load(Ordering::SeqCst) { Err(CaptureError::Stopped) } else { Ok(()) }
    }

    /// Runs a program to its end. `label` names the program and its command in errors.
    pub(crate) fn run(&self, program: Program, label: &str, command: &mut Command) -> Result<()> {
        let mut running = self.start(program, label, command, false)?;
        loop {
            self.check()?;
            if let Some(status) = running.child.try_wait().map_err(io_error("await", Path::new(program.name)))? {
                return running.result(status);
            }
            std::thread::sleep(POLL);
        }
    }

    /// Starts a program. If `piped`, its standard output is returned by [`Running::output`] and not logged.
    pub(crate) fn start(&self, program: Program, label: &str, command: &mut Command, piped: bool) -> Result<Running> {
        self.check()?;
        let log = self.folder.join(format!("{}.log", label.replace(' ', "-")));
        let file = File::options().create(true).append(true).open(&log).map_err(io_error("write", &log))?;
        let output = if piped { Stdio::piped() } else { file.try_clone().map_err(io_error("write", &log))?.into() };
        let child = command.stdout(output).stderr(file).spawn().map_err(|e| program.not_started(e))?;
        Ok(Running { child, label: label.to_owned(), log })
    }
}

/// Process that is killed on drop.
pub(crate) struct Running {
    child: Child,
    label: String,
    log: PathBuf,
}

impl Running {
    /// Takes the standard output of a piped process.
    pub(crate) fn output(&mut self) -> Option<ChildStdout> {
        self.child.stdout.take()
    }

    /// Waits for the end of the process.
    pub(crate) fn wait(mut self) -> Result<()> {
        let status = self.child.wait().map_err(io_error("await", Path::new(&self.label)))?;
        self.result(status)
    }

    fn result(&self, status: ExitStatus) -> Result<()> {
        if status.success() {
            return Ok(());
        }
        let log = std::fs::read(&self.log).unwrap_or_default();
        let tail = String::from_utf8_lossy(&log[log.len().saturating_sub(TAIL)..]).into_owned();
        Err(CaptureError::Program {
            program: self.label.clone(),
            status: status.to_string(),
            message: reason(&tail).unwrap_or("it printed nothing").to_owned(),
        })
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // Fails only if the process has ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Returns the line of a log that most likely says why a program failed.
fn reason(log: &str) -> Option<&str> {
    let lines = || log.lines().map(str::trim).filter(|line| !line.is_empty());
    let bad = |line: &&str| ["error", "fail", "cannot", "invalid"].iter().any(|w| line.to_lowercase().contains(w));
    lines().rfind(bad).or_else(|| lines().next_back())
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHELL: Program = Program { name: "sh", package: "dash" };

    fn run(script: &str, stop: &AtomicBool) -> Result<()> {
        let folder = tempfile::tempdir().unwrap();
        Processes { folder: folder.path(), stop }.run(SHELL, "sh test", SHELL.command().args(["-c", script]))
    }

    #[test]
    fn failures_name_the_last_reason() {
        let stop = AtomicBool::new(false);
        assert!(run("echo fine", &stop).is_ok());
        let error = run("echo ' ERROR: no file '; echo bye >&2; exit 3", &stop).unwrap_err().to_string();
        assert_eq!(error, "sh test failed (exit status: 3): ERROR: no file");
        let error = run("exit 4", &stop).unwrap_err().to_string();
        assert_eq!(error, "sh test failed (exit status: 4): it printed nothing");
    }

    #[test]
    fn missing_programs_are_named_with_their_package() {
        let none = Program { name: "sgs-no-such-program", package: "none" };
        let error = none.prints(&["-h"]).unwrap_err().to_string();
        assert_eq!(
            error,
            "the program sgs-no-such-program is not on the PATH; install it, on Debian with: apt-get install none"
        );
    }

    #[test]
    fn stopping_ends_the_process() {
        let begun = std::time::Instant::now();
        let stop = AtomicBool::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                std::thread::sleep(Duration::from_millis(100));
                stop.store(true, Ordering::SeqCst);
            });
            assert!(matches!(run("exec sleep 60", &stop), Err(CaptureError::Stopped)));
        });
        assert!(begun.elapsed() < Duration::from_secs(30));
    }
}
