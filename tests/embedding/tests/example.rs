//! The example runs, and shows what the renderer gives.

#[path = "../examples/host.rs"]
mod host;

#[test]
fn the_example_shows_what_the_renderer_gives() {
    assert_eq!(host::run(3), 0);
}
