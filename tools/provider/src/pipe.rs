//! Child process and its three pipes, on Unix.
//!
//! All pipes are non-blocking. One loop serves them while an answer is pending: it sends the rest of the question,
//! receives the answer, and logs the child's standard error. Neither side can therefore block the other, and no thread
//! is needed. The child leads a process group. The whole group is killed, so that the child's own children end too.

use crate::error::Nonsense;
use crate::frame::Decoder;
use crate::message::Message;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, kill_process_group, waitid};
use std::io::{self, ErrorKind, Read, Write};
use std::os::unix::process::CommandExt;
use std::process::{Child, ChildStderr, ChildStdin, ChildStdout, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

/// Time for a child to end by itself after its input or output is closed.
const GRACE: Duration = Duration::from_secs(2);
/// Longest stored part of a line of standard error, in bytes.
const LINE: usize = 2000;

/// Reason why no message arrived.
pub(crate) enum Broken {
    Ended(String),
    TimeOut,
    Nonsense(Nonsense),
}

/// Running child.
pub(crate) struct Pipe {
    child: Child,
    stdin: Option<ChildStdin>,
    stdout: Option<ChildStdout>,
    stderr: Option<ChildStderr>,
    decoder: Decoder,
    line: Vec<u8>,
    last: String,
    reaped: bool,
}

impl Pipe {
    /// Starts a program.
    pub(crate) fn start(words: &[String], limit: u64) -> io::Result<Pipe> {
        let mut command = Command::new(&words[0]);
        command.args(&words[1..]).process_group(0);
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn()?;
        let (stdin, stdout, stderr) = (child.stdin.take(), child.stdout.take(), child.stderr.take());
        let decoder = Decoder::new(limit);
        let pipe = Pipe { child, stdin, stdout, stderr, decoder, line: Vec::new(), last: String::new(), reaped: false };
        // From here on, dropping `pipe` reaps the child on every path.
        pipe.stdin.as_ref().map_or(Ok(()), |f| rustix::io::ioctl_fionbio(f, true))?;
        pipe.stdout.as_ref().map_or(Ok(()), |f| rustix::io::ioctl_fionbio(f, true))?;
        pipe.stderr.as_ref().map_or(Ok(()), |f| rustix::io::ioctl_fionbio(f, true))?;
        Ok(pipe)
    }

    /// Returns the last line of the child's standard error.
    pub(crate) fn last(&self) -> &str {
        &self.last
    }

    /// Sends bytes and waits for the next message.
    pub(crate) fn exchange(&mut self, mut out: &[u8], limit: Duration) -> Result<Message, Broken> {
        let deadline = Instant::now() + limit;
        loop {
            match self.decoder.next() {
                Ok(Some(message)) => return Ok(message),
                Ok(None) => {}
                Err(nonsense) => return Err(Broken::Nonsense(nonsense)),
            }
            if self.stdout.is_none() {
                return Err(Broken::Ended(self.farewell()));
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Err(Broken::TimeOut);
            }
            if let Err(e) = self.serve(&mut out, left) {
                return Err(Broken::Ended(format!("cannot be reached ({e})")));
            }
        }
    }

    /// Waits until a pipe is ready, then serves all pipes.
    fn serve(&mut self, out: &mut &[u8], left: Duration) -> io::Result<()> {
        let mut waiting = Vec::with_capacity(3);
        if let Some(pipe) = &self.stdout {
            waiting.push(PollFd::new(pipe, PollFlags::IN));
        }
        if let Some(pipe) = &self.stderr {
            waiting.push(PollFd::new(pipe, PollFlags::IN));
        }
        if let Some(pipe) = self.stdin.as_ref().filter(|_| !out.is_empty()) {
            waiting.push(PollFd::new(pipe, PollFlags::OUT));
        }
        let left = Timespec::try_from(left.min(Duration::from_secs(3600))).map_err(io::Error::other)?;
        match poll(&mut waiting, Some(&left)) {
            Ok(_) | Err(rustix::io::Errno::INTR) => {}
            Err(e) => return Err(e.into()),
        }
        drop(waiting);
        self.send(out);
        self.log_stderr();
        let mut bytes = vec![0; 1 << 18];
        if let Some(pipe) = &mut self.stdout {
            match pipe.read(&mut bytes) {
                Ok(0) => self.stdout = None,
                Ok(n) => self.decoder.push(&bytes[..n]),
                Err(e) if is_transient(&e) => {}
                Err(_) => self.stdout = None,
            }
        }
        Ok(())
    }

    /// Sends as many bytes as the pipe accepts.
    ///
    /// A write error is not reported: a child that no longer reads may still have sent an answer.
    fn send(&mut self, out: &mut &[u8]) {
        while let Some(pipe) = self.stdin.as_mut().filter(|_| !out.is_empty()) {
            match pipe.write(out) {
                Ok(n) => *out = &out[n..],
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(e) if e.kind() == ErrorKind::WouldBlock => return,
                Err(_) => self.stdin = None,
            }
        }
    }

    /// Logs the child's standard error, a limited amount at a time.
    fn log_stderr(&mut self) {
        let mut bytes = [0; 1 << 14];
        for _ in 0..16 {
            let Some(pipe) = &mut self.stderr else { return };
            match pipe.read(&mut bytes) {
                Ok(0) => self.stderr = None,
                Ok(n) => self.note(&bytes[..n]),
                Err(e) if is_transient(&e) => return,
                Err(_) => self.stderr = None,
            }
        }
    }

    fn note(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            // Progress bars end their lines with a carriage return.
            if byte == b'\n' || byte == b'\r' {
                self.end_line();
            } else if self.line.len() < LINE {
                self.line.push(byte);
            }
        }
    }

    fn end_line(&mut self) {
        let line = String::from_utf8_lossy(&self.line).replace(|c: char| c.is_control(), " ");
        let line = line.trim();
        if !line.is_empty() {
            tracing::info!(target: "provider", "{line}");
            self.last = line.chars().take(300).collect();
        }
        self.line.clear();
    }

    /// Describes the end of a child that closed its output.
    ///
    /// Waits up to the grace period for its end and its last lines, then stops it.
    fn farewell(&mut self) -> String {
        let amid = if self.decoder.is_amid() { " in the middle of a message" } else { "" };
        let ended = self.linger(GRACE);
        let status = self.stop();
        match (ended, status) {
            (true, Some(status)) => format!("{}{amid}", answers(status)),
            _ => format!("closed its output{amid}"),
        }
    }

    /// Reads the child's output until it ends or the time is over. Returns true if it ended.
    fn linger(&mut self, limit: Duration) -> bool {
        let deadline = Instant::now() + limit;
        let mut nap = Duration::from_micros(200);
        loop {
            let ended = self.has_ended();
            self.log_stderr();
            // This output is discarded, but a full pipe could block the child from ending.
            let mut bytes = [0; 1 << 14];
            for _ in 0..16 {
                let Some(pipe) = &mut self.stdout else { break };
                match pipe.read(&mut bytes) {
                    Ok(0) => self.stdout = None,
                    Ok(_) => {}
                    Err(_) => break,
                }
            }
            if ended {
                self.end_line();
                return true;
            }
            if Instant::now() >= deadline {
                self.end_line();
                return false;
            }
            std::thread::sleep(nap);
            nap = (2 * nap).min(Duration::from_millis(20));
        }
    }

    /// Returns true if the child has ended. Does not reap it, so that its process id stays reserved.
    fn has_ended(&self) -> bool {
        let options = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
        let found = waitid(WaitId::Pid(Pid::from_child(&self.child)), options);
        !matches!(found, Ok(None) | Err(rustix::io::Errno::INTR))
    }

    /// Closes the child's input, waits up to the grace period, and kills the group.
    pub(crate) fn finish(&mut self) {
        self.stdin = None;
        self.linger(GRACE);
        self.stop();
    }

    /// Kills the group and reaps the child. Returns the exit status if known.
    pub(crate) fn stop(&mut self) -> Option<ExitStatus> {
        if self.reaped {
            return None;
        }
        self.log_stderr();
        self.end_line();
        // The child is not reaped yet, so its process id cannot belong to another process. A failure means that the
        // group is empty.
        let _ = kill_process_group(Pid::from_child(&self.child), Signal::KILL);
        self.stdin = None;
        self.reaped = true;
        self.child.wait().ok()
    }
}

impl Drop for Pipe {
    fn drop(&mut self) {
        self.stop();
    }
}

fn is_transient(e: &io::Error) -> bool {
    matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted)
}

/// Describes the end of a process.
fn answers(status: ExitStatus) -> String {
    use std::os::unix::process::ExitStatusExt;
    match (status.code(), status.signal()) {
        (Some(code), _) => format!("ended with status {code}"),
        (None, Some(signal)) => format!("was ended by signal {signal}"),
        (None, None) => "ended".to_owned(),
    }
}
