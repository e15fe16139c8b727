//! engine-bench
fn main() {}
