//! Messages of the libraries, forwarded to the logger `sgs` of Python.

use pyo3::prelude::*;
use std::fmt::Write;
use tracing::field::{Field, Visit};
use tracing::{Event, Level, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::filter::LevelFilter;
use tracing_subscriber::layer::{Context, SubscriberExt};
use tracing_subscriber::util::SubscriberInitExt;

/// Starts forwarding. A subscriber that a host has installed stays.
pub fn start() {
    let layer = Forward.with_filter(LevelFilter::INFO);
    // Fails only if another subscriber is there, which then gets the messages.
    let _ = tracing_subscriber::registry().with(layer).try_init();
}

struct Forward;

impl<S: Subscriber> Layer<S> for Forward {
    fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
        let mut text = Message(String::new());
        event.record(&mut text);
        let level = match *event.metadata().level() {
            Level::ERROR => "error",
            Level::WARN => "warning",
            _ => "info",
        };
        Python::attach(|py| {
            let logged = py
                .import("logging")
                .and_then(|logging| logging.call_method1("getLogger", ("sgs",))?.call_method1(level, ("%s", text.0)));
            if let Err(error) = logged {
                error.write_unraisable(py, None);
            }
        });
    }
}

/// Text of an event, with its fields.
struct Message(String);

impl Visit for Message {
    fn record_debug(&mut self, field: &Field, value: &dyn std::fmt::Debug) {
        // Writing to a string does not fail.
        let _ = match field.name() {
            "message" => write!(self.0, "{value:?}"),
            name => write!(self.0, " {name}={value:?}"),
        };
    }
}
