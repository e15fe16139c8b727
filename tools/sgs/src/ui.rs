//! Talking to people: logging, progress bars on a terminal, plain lines elsewhere, Ctrl-C.

use crate::common::Common;
use indicatif::{ProgressBar, ProgressStyle};
use std::io::IsTerminal;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::prelude::*;

/// Messages of the libraries, on standard error; `SGS_LOG` (as `info` or `sgs_train=debug`) chooses more or fewer.
pub fn start_logging(common: &Common) {
    let level = match (common.quiet, common.verbose) {
        (true, _) => LevelFilter::ERROR,
        (_, 0) => LevelFilter::WARN,
        (_, 1) => LevelFilter::INFO,
        _ => LevelFilter::DEBUG,
    };
    let wanted = std::env::var("SGS_LOG").ok().and_then(|text| text.parse::<Targets>().ok());
    // A window's system warns of what people can do nothing about.
    let usual = || Targets::new().with_default(level).with_target("winit", LevelFilter::ERROR);
    let lines = tracing_subscriber::fmt::layer().with_writer(std::io::stderr).without_time();
    tracing_subscriber::registry().with(lines.with_filter(wanted.unwrap_or_else(usual))).init();
}

/// Ends quietly, with the status of a program that a closed pipe has ended, where nobody reads on (`sgs plan SCENE | head`).
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

/// A bar on a terminal; elsewhere a line every tenth of the way.
pub struct Bar {
    bar: Option<ProgressBar>,
    quiet: bool,
    what: String,
    total: u64,
    next_line: u64,
    started: Instant,
}

impl Bar {
    /// For so many of something.
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

    /// So many are done.
    pub fn set(&mut self, done: u64, message: impl FnOnce() -> String) {
        if let Some(bar) = &self.bar {
            bar.set_position(done);
            if done.is_multiple_of(10) || done == self.total {
                bar.set_message(message());
            }
        } else if !self.quiet && (done >= self.next_line || done == self.total) {
            let seconds = self.started.elapsed().as_secs_f64();
            eprintln!("{} {done}/{} {} ({seconds:.0} s)", self.what, self.total, message());
            self.next_line = done + (self.total / 10).max(1);
        }
    }

    /// Says something that is to stay.
    pub fn say(&self, text: &str) {
        match &self.bar {
            Some(bar) => bar.println(text),
            None if !self.quiet => eprintln!("{text}"),
            None => {}
        }
    }

    /// Takes the bar away.
    pub fn finish(self) {
        if let Some(bar) = self.bar {
            bar.finish();
        }
    }
}

/// A flag that Ctrl-C (or a termination signal) raises; the second one ends the program at once.
pub fn interrupted() -> anyhow::Result<Arc<AtomicBool>> {
    let flag = Arc::new(AtomicBool::new(false));
    let raised = flag.clone();
    ctrlc::set_handler(move || {
        if raised.swap(true, Ordering::SeqCst) {
            std::process::exit(130);
        }
    })?;
    Ok(flag)
}
