//! Processes of this program that train the runs of a batch or of a table.

use crate::common::Common;
use crate::ui::SUPERVISED;
use sgs_batch::{DeviceMemory, Exit, Launch, Launcher, Process, quote};
use sgs_engine::find_device;
use std::ffi::OsString;
use std::io::{Read, Write};
use std::process::{Child, Command, Stdio};
use std::thread::JoinHandle;

/// Number of runs side by side.
#[derive(Clone, Copy, Debug)]
pub enum Jobs {
    /// A number per device.
    Auto,
    /// This number.
    Exactly(u16),
}

impl Jobs {
    /// Parses `N` or `auto`.
    ///
    /// # Errors
    /// A description of the expected format.
    pub fn parse(text: &str) -> Result<Jobs, String> {
        match text {
            "auto" => Ok(Jobs::Auto),
            _ => {
                let number = text.parse().ok().filter(|n| *n > 0);
                number.map(Jobs::Exactly).ok_or_else(|| "a number above 0, or auto".into())
            }
        }
    }

    /// Returns the number for some devices. `per_device`: that of each device for `auto`.
    pub fn number(self, devices: usize, per_device: usize) -> usize {
        match self {
            Jobs::Auto => devices.saturating_mul(per_device),
            Jobs::Exactly(n) => usize::from(n),
        }
    }
}

/// Device of jobs.
pub struct Device {
    /// Option `--device` of the processes; none for the default.
    option: Option<String>,
    memory: DeviceMemory,
}

/// Finds the devices of the jobs. They are not opened: each process opens its own.
///
/// `named`: values of `--devices`; without any, the device of `--device`.
pub fn devices(common: &Common, named: &[String]) -> anyhow::Result<Vec<Device>> {
    let mut options: Vec<Option<String>> = named.iter().cloned().map(Some).collect();
    if options.is_empty() {
        options.push(common.device.clone());
    }
    let find = |option: Option<String>| {
        let found = find_device(option.as_deref())?;
        let memory = DeviceMemory { uuid: found.info.uuid, bytes: found.available_bytes };
        Ok(Device { option, memory })
    };
    options.into_iter().map(find).collect()
}

/// Starts this program for each run.
pub struct Programs<'a> {
    /// Options that the processes share with this command.
    pub common: &'a Common,
    /// Devices that the jobs take in turn.
    pub devices: &'a [Device],
    /// Returns the other arguments of a process.
    pub arguments: &'a (dyn Fn(&Launch<'_>) -> Vec<OsString> + Sync),
}

impl Programs<'_> {
    fn of(&self, worker: usize) -> Option<&Device> {
        self.devices.get(worker % self.devices.len().max(1))
    }
}

impl Launcher for Programs<'_> {
    fn device(&self, worker: usize) -> Option<DeviceMemory> {
        self.of(worker).map(|device| device.memory.clone())
    }

    fn start(&self, launch: &Launch<'_>) -> std::io::Result<Box<dyn Process>> {
        let mut command = Command::new(std::env::current_exe()?);
        command.args((self.arguments)(launch));
        if let Some(option) = self.of(launch.worker).and_then(|device| device.option.as_ref()) {
            command.args(["--device", option]);
        }
        if let Some(limit) = self.common.timeout {
            command.args(["--timeout", &limit.as_secs_f64().to_string()]);
        }
        if self.common.validate {
            command.arg("--validate");
        }
        command.arg("--json");
        if let Some(folder) = launch.log.parent() {
            std::fs::create_dir_all(folder)?;
        }
        let mut log = std::fs::File::options().create(true).append(true).open(&launch.log)?;
        writeln!(log, "$ {}", line(&command))?;
        command.env(SUPERVISED, "1").stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(log);
        // Ctrl-C of a terminal reaches the batch alone, which then stops its processes once.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let mut child = command.spawn()?;
        let stdout = child.stdout.take();
        let output = std::thread::spawn(move || {
            let mut text = Vec::new();
            // A process that is killed leaves an incomplete answer, which counts as none.
            let _ = stdout.map(|mut pipe| pipe.read_to_end(&mut text));
            String::from_utf8_lossy(&text).into_owned()
        });
        Ok(Box::new(Program { child, output: Some(output) }))
    }
}

/// Formats a command as a line of a shell, for the log.
fn line(command: &Command) -> String {
    let words = std::iter::once(command.get_program()).chain(command.get_args());
    let quoted = words.map(|word| quote(&word.to_string_lossy()));
    quoted.collect::<Vec<_>>().join(" ")
}

/// Started program.
struct Program {
    child: Child,
    output: Option<JoinHandle<String>>,
}

impl Process for Program {
    fn poll(&mut self) -> std::io::Result<Option<Exit>> {
        let Some(status) = self.child.try_wait()? else { return Ok(None) };
        let output = self.output.take().and_then(|thread| thread.join().ok()).unwrap_or_default();
        #[cfg(unix)]
        let signal = std::os::unix::process::ExitStatusExt::signal(&status);
        #[cfg(not(unix))]
        let signal = None;
        Ok(Some(Exit { status: status.code(), signal, output }))
    }

    #[cfg(unix)]
    fn terminate(&mut self) {
        let pid = i32::try_from(self.child.id()).ok().and_then(rustix::process::Pid::from_raw);
        if let Some(pid) = pid {
            // A process that has just ended needs no signal.
            let _ = rustix::process::kill_process(pid, rustix::process::Signal::TERM);
        }
    }

    #[cfg(not(unix))]
    fn terminate(&mut self) {
        self.kill();
    }

    fn kill(&mut self) {
        // Fails only if the process has ended.
        let _ = self.child.kill();
    }

    fn beat(&mut self) {
        // A process that has just ended reads nothing.
        let _ = self.child.stdin.as_mut().map(|pipe| pipe.write_all(b"."));
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        // Only after an error of the supervisor does the process still run.
        if self.output.is_some() {
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }
}
