//! A child process and its three pipes, on Unix.
//!
//! All three are non-blocking and are served by one loop that runs while an answer is awaited: it sends what is left of
//! the question, takes what comes of the answer, and passes on what the child says on its standard error. So neither side
//! can wait for the other, and no thread is needed. The child leads a process group, and the whole group is killed, so
//! that helpers of a helper end too.

use crate::error::Nonsense;
use crate::frame::Decoder;
use crate::message::Message;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, kill_process_group, waitid};
use std::io::{self, ErrorKind, Read, Write};
use std::os::unix::process::CommandExt;
use std::process::{Child, ChildStderr, ChildStdin, ChildStdout, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

/// How long a child may take to end by itself once its input is closed or it has closed its output.
const GRACE: Duration = Duration::from_secs(2);
/// The longest line of standard error that is kept whole.
const LINE: usize = 2000;

/// Why no message came.
pub(crate) enum Broken {
    Ended(String),
    TimeOut,
    Nonsense(Nonsense),
}

/// A running child.
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
        // From here on the child is reaped whatever happens.
        pipe.stdin.as_ref().map_or(Ok(()), |f| rustix::io::ioctl_fionbio(f, true))?;
        pipe.stdout.as_ref().map_or(Ok(()), |f| rustix::io::ioctl_fionbio(f, true))?;
        pipe.stderr.as_ref().map_or(Ok(()), |f| rustix::io::ioctl_fionbio(f, true))?;
        Ok(pipe)
    }

    /// The last line that the child wrote to its standard error.
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

    /// Waits until a pipe is ready, and serves all that are.
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
        self.hear();
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

    /// Sends as much as goes. A child that no longer reads may still have something to say, so that is no error here.
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

    /// Passes on what the child says on its standard error, a limited amount at a time.
    fn hear(&mut self) {
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

    /// The child has closed its output: waits a moment for its end and its last words, and says how it went.
    fn farewell(&mut self) -> String {
        let amid = if self.decoder.is_amid() { " in the middle of a message" } else { "" };
        let ended = self.linger(GRACE);
        let status = self.stop();
        match (ended, status) {
            (true, Some(status)) => format!("{}{amid}", told(status)),
            _ => format!("closed its output{amid}"),
        }
    }

    /// Hears the child out until it ends or the time is over; true if it ended.
    fn linger(&mut self, limit: Duration) -> bool {
        let deadline = Instant::now() + limit;
        let mut nap = Duration::from_micros(200);
        loop {
            let ended = self.has_ended();
            self.hear();
            // Nobody wants what it writes now, but it may have to get rid of it before it can end.
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

    /// Whether the child has ended; it is not reaped, so that its number stays its own.
    fn has_ended(&self) -> bool {
        let options = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
        let found = waitid(WaitId::Pid(Pid::from_child(&self.child)), options);
        !matches!(found, Ok(None) | Err(rustix::io::Errno::INTR))
    }

    /// Asks the child to end by closing its input, then makes it.
    pub(crate) fn finish(&mut self) {
        self.stdin = None;
        self.linger(GRACE);
        self.stop();
    }

    /// Kills the group and reaps the child. Its status, if it is known.
    pub(crate) fn stop(&mut self) -> Option<ExitStatus> {
        if self.reaped {
            return None;
        }
        self.hear();
        self.end_line();
        // The child is not reaped yet, so its number cannot be another's; a failure means that nobody is left.
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

/// How a process ended.
fn told(status: ExitStatus) -> String {
    use std::os::unix::process::ExitStatusExt;
    match (status.code(), status.signal()) {
        (Some(code), _) => format!("ended with status {code}"),
        (None, Some(signal)) => format!("was ended by signal {signal}"),
        (None, None) => "ended".to_owned(),
    }
}
