//! Output of failures: one sentence on standard error, and JSON.

use crate::common::Common;
use crate::message::say;
pub use sgs_api::{Kind, failure, refuse_usage, usage};

/// Replaces control characters by spaces. The content of a file cannot move a terminal's cursor.
fn one_line(sentence: &str) -> String {
    sentence.trim_end().chars().map(|c| if c.is_control() { ' ' } else { c }).collect()
}

/// Prints an error, and with `--json` also as JSON. Returns the exit status.
pub fn report(common: &Common, error: &anyhow::Error) -> i32 {
    let kind = Kind::of(error);
    let sentence = one_line(&format!("{error:#}"));
    say(format_args!("sgs: {sentence}"));
    report_json(common, &sentence, kind);
    kind.status()
}

fn report_json(common: &Common, sentence: &str, kind: Kind) {
    if let Err(error) = common.answer(&serde_json::json!({"error": sentence, "kind": kind.name()})) {
        say(format_args!("sgs: {}", one_line(&format!("{error:#}"))));
    }
}

/// Prints clap's error about invalid arguments, or the requested help. Returns the exit status.
pub fn report_arguments(mut error: clap::Error, arguments: &[std::ffi::OsString]) -> i32 {
    suggest_steps(&mut error);
    // A closed output stream is no further error.
    let _ = error.print();
    if error.use_stderr()
        && let Some(common) = Common::json_only(arguments)
    {
        let text = error.to_string();
        let sentence = text.lines().next().unwrap_or_default().trim_start_matches("error: ");
        report_json(&common, sentence, Kind::Usage);
    }
    error.exit_code()
}

/// Suggests the step options of the stages for other programs' step options.
fn suggest_steps(error: &mut clap::Error) {
    use clap::error::{ContextKind, ContextValue};
    let Some(ContextValue::String(option)) = error.get(ContextKind::InvalidArg) else { return };
    if !["--iterations", "--iters", "--steps", "--max-steps"].contains(&option.as_str()) {
        return;
    }
    let tip = "each stage has its own number of steps: --geometry-steps N, --intrinsic-steps N".into();
    error.remove(ContextKind::SuggestedArg);
    error.remove(ContextKind::TrailingArg);
    error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![tip]));
}
