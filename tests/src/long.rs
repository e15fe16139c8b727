//! Tests that take long.

/// Returns whether tests run that take long. If not, it says so in the output of the test.
pub fn takes_long() -> bool {
    let wanted = std::env::var_os("SGS_TEST_LONG").is_some();
    if !wanted {
        println!("skipped: it takes long; SGS_TEST_LONG=1 runs it");
    }
    wanted
}
