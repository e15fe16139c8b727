//! Providers for tests: the Python providers of `tools/priors`, run as a user runs them.

use std::path::Path;

/// Returns the command line of a provider.
///
/// Examples of `what`: "misbehave=hang" and "stand-in=SCENE --noise 0".
pub fn provider(what: &str) -> String {
    let serve = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tools/priors/serve");
    format!("python3 -B '{}' {what}", serve.display())
}
