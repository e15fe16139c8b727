//! The example runs and shows the renderer's image.

#[path = "../examples/host.rs"]
mod host;

#[test]
fn example_shows_the_image_of_the_renderer() {
    assert_eq!(host::run(3), 0);
}

#[test]
fn example_shows_a_run_under_changing_light() {
    let folder = tempfile::tempdir().unwrap();
    sgs_tests::runs::fabricate(folder.path(), sgs_tests::runs::Parts::ALL);
    let [relit, sum, moved] = host::relight(folder.path());
    assert!(relit < 1e-5 && sum < 1e-5 && moved > 0.01, "{relit} {sum} {moved}");
}
