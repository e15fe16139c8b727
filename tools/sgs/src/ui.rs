//! Output for the user: logs, progress bars on a terminal, plain lines elsewhere. Handles Ctrl-C.

use crate::common::Common;
use crate::failure::{Kind, failure};
use crate::message::say;
use indicatif::{ProgressBar, ProgressStyle};
use signal_hook::{consts, flag};
use std::io::{IsTerminal, Read};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::prelude::*;

/// Starts logging to standard error. `SGS_LOG` (`info` or `sgs_train=debug`) overrides the level.
pub fn start_logging(common: &Common) {
    let level = match (common.quiet, common.verbose) {
        (true, _) => LevelFilter::ERROR,
        (_, 0) => LevelFilter::WARN,
        (_, 1) => LevelFilter::INFO,
        _ => LevelFilter::DEBUG,
    };
    let wanted = std::env::var("SGS_LOG").ok().and_then(|text| text.parse::<Targets>().ok());
    // Users cannot act on the warnings of the window system.
    let usual = || Targets::new().with_default(level).with_target("winit", LevelFilter::ERROR);
    let lines = tracing_subscriber::fmt::layer().with_writer(std::io::stderr).without_time();
    // Module names help only in debugging; color codes are for terminals only.
    let lines = lines.with_target(level >= LevelFilter::DEBUG).with_ansi(std::io::stderr().is_terminal());
    tracing_subscriber::registry().with(lines.with_filter(wanted.unwrap_or_else(usual))).init();
}

/// Installs a panic hook that ends the program silently if its output is closed.
///
/// Example: `sgs plan SCENE | head`. The exit status is that of a program ended by SIGPIPE.
pub fn heed_closed_pipes() {
    let usual = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |info| {
        let text = info.payload().downcast_ref::<String>().map_or("", String::as_str);
        if text.starts_with("failed printing to ") && text.contains("Broken pipe") {
            std::process::exit(128 + 13);
        }
        usual(info);
    }));
}

/// Variable that tells a process that a supervisor beats on its standard input.
pub const SUPERVISED: &str = "SGS_SUPERVISED";

/// Time without a heartbeat after which a process stops itself.
const LONGEST_PAUSE: Duration = Duration::from_secs(8);

/// Time in which a process that stops itself may write a checkpoint.
///
/// With the longest pause, it stays below the time after which other machines take a run over.
const LAST_WORK: Duration = Duration::from_secs(4);

/// Stops this process when its supervisor ends or sends no heartbeat.
///
/// A process without a supervisor could write into a run that another machine has taken over.
pub fn heed_supervisor() {
    if std::env::var_os(SUPERVISED).is_none() {
        return;
    }
    let (beat, beats) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        let mut byte = [0];
        while matches!(std::io::stdin().read(&mut byte), Ok(1..)) && beat.send(()).is_ok() {}
    });
    std::thread::spawn(move || {
        while beats.recv_timeout(LONGEST_PAUSE).is_ok() {}
        // Training writes a checkpoint; other commands end at once.
        let _ = signal_hook::low_level::raise(consts::SIGTERM);
        std::thread::sleep(LAST_WORK);
        std::process::exit(Kind::Terminated.status());
    });
}

/// Progress bar on a terminal; elsewhere a line for every tenth of the total.
pub struct Bar {
    bar: Option<ProgressBar>,
    quiet: bool,
    what: String,
    total: u64,
    next_line: u64,
    started: Instant,
}

impl Bar {
    /// Creates a bar for `total` items, of which `start` are done.
    pub fn new(common: &Common, what: &str, total: u64, start: u64) -> Bar {
        let terminal = std::io::stderr().is_terminal();
        let bar = (terminal && !common.quiet).then(|| {
            let bar = ProgressBar::new(total);
            let style = ProgressStyle::with_template("{prefix} [{bar:32}] {pos}/{len} {msg} ({eta} left)");
            bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> "));
            bar.set_prefix(what.to_owned());
            bar.set_position(start);
            bar.reset_eta();
            bar
        });
        Bar { bar, quiet: common.quiet, what: what.to_owned(), total, next_line: start + 1, started: Instant::now() }
    }

    /// Sets the number of finished items.
    pub fn set(&mut self, done: u64, message: impl FnOnce() -> String) {
        if let Some(bar) = &self.bar {
            bar.set_position(done);
            if done.is_multiple_of(10) || done == self.total {
                bar.set_message(message());
            }
        } else if !self.quiet && (done >= self.next_line || done == self.total) {
            let seconds = self.started.elapsed().as_secs_f64();
            say(format_args!("{} {done}/{} {} ({seconds:.0} s)", self.what, self.total, message()));
            self.next_line = done + (self.total / 10).max(1);
        }
    }

    /// Prints a line that stays above the bar.
    pub fn say(&self, text: &str) {
        match &self.bar {
            Some(bar) => bar.println(text),
            None if !self.quiet => say(text),
            None => {}
        }
    }

    /// Completes the bar.
    pub fn finish(self) {
        if let Some(bar) = self.bar {
            bar.finish();
        }
    }
}

/// Flag that a signal raises to stop a command; dereferences to the flag.
pub struct Stop {
    raised: Arc<AtomicBool>,
    terminated: Arc<AtomicBool>,
}

impl Stop {
    /// Raises the flag on Ctrl-C and on signals that end a process. Ctrl-C exits at once if the flag is up.
    ///
    /// Schedulers send SIGTERM several times and to several processes, so that it arrives again from a supervisor. It
    /// must not interrupt the writing of a checkpoint.
    pub fn on_signals() -> anyhow::Result<Stop> {
        let stop = Stop { raised: Arc::default(), terminated: Arc::default() };
        for (signal, terminates) in SIGNALS {
            if *terminates {
                flag::register(*signal, stop.terminated.clone())?;
            } else {
                // This handler runs first, so that the first signal finds the flag down.
                let status = Kind::Interrupted.status();
                flag::register_conditional_shutdown(*signal, status, stop.raised.clone())?;
            }
            flag::register(*signal, stop.raised.clone())?;
        }
        Ok(stop)
    }

    /// Creates the error of a command that was stopped.
    pub fn failure(&self, text: impl Into<String>) -> anyhow::Error {
        let kind = if self.terminated.load(Ordering::SeqCst) { Kind::Terminated } else { Kind::Interrupted };
        failure(kind, text)
    }
}

impl std::ops::Deref for Stop {
    type Target = AtomicBool;

    fn deref(&self) -> &AtomicBool {
        &self.raised
    }
}

/// Signals that stop a command, and whether they count as termination from outside.
#[cfg(unix)]
const SIGNALS: &[(i32, bool)] = &[(consts::SIGINT, false), (consts::SIGTERM, true), (consts::SIGHUP, true)];
#[cfg(not(unix))]
const SIGNALS: &[(i32, bool)] = &[(consts::SIGINT, false), (consts::SIGTERM, true)];
