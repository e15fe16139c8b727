//! Training with the 2D Mip filter: the run and its files record it, and everything that renders them uses it.

use sgs_tests::Place;
use sgs_tests::cli::sgs;
use sgs_tests::rooms::Room;

#[test]
fn runs_and_files_record_the_filter() {
    let place = Place::new(Room::default());
    let lean = ["-q", "--stage", "geometry", "--set", "geometry.semantics=false", "--set", "geometry.normals=false"];
    sgs(&place.arguments("run", 200, &[&lean[..], &["--set", "geometry.filter=mip"]].concat())).ok();
    let mode = |file: &str, word: &str| {
        let line = format!("comment SplatRenderMode: {word}\n");
        place.read(file).windows(line.len()).any(|w| w == line.as_bytes())
    };
    assert!(mode("run/scene.ply", "mip"));
    let psnr = |name: &str| {
        sgs(&["eval", &place.text("run"), "--split", "train", "--json", &place.text(name)]).ok();
        let value: serde_json::Value = serde_json::from_slice(&place.read(name)).unwrap();
        value.pointer("/mean/nvs/psnr").and_then(serde_json::Value::as_f64).unwrap()
    };
    let filtered = psnr("filtered.json");
    for file in ["a.ply", "a.spz", "a.sog"] {
        sgs(&["export", &place.text("run"), "-o", &place.text(file)]).ok();
        let back = place.text(&format!("{file}.ply"));
        sgs(&["export", &place.text(file), "-o", &back]).ok();
        assert!(mode(&format!("{file}.ply"), "mip"), "{file}");
    }
    let printed = sgs(&["export", &place.text("run"), "-o", &place.text("a.splat")]).ok().stderr.clone();
    assert!(printed.contains("the filter against aliasing"), "{printed}");
    // Without the comment, opacities are too high, and images of the training views get worse.
    let mut bytes = place.read("run/scene.ply");
    let from = b"SplatRenderMode: mip\n";
    let at = bytes.windows(from.len()).position(|w| w == from).unwrap();
    bytes.splice(at..at + from.len(), *b"SplatRenderMode: default\n");
    std::fs::write(place.path("run/scene.ply"), bytes).unwrap();
    let plain = psnr("plain.json");
    assert!(filtered > plain + 0.1, "{filtered} {plain}");
}
