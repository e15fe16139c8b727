//! Test that `sgs.h` matches the sources. `SGS_WRITE_HEADER=1 cargo test -p sgs-capi --test header` updates the file.

use std::path::Path;

fn generated() -> String {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let config = cbindgen::Config::from_file(root.join("cbindgen.toml")).expect("cbindgen.toml");
    let mut builder = cbindgen::Builder::new().with_config(config);
    // File by file, so that cbindgen runs neither cargo nor a download.
    for file in ["types", "context", "host", "scene", "view", "relight", "emitter", "trainer"] {
        builder = builder.with_src(root.join("src").join(file).with_extension("rs"));
    }
    let mut text = Vec::new();
    builder.generate().expect("bindings").write(&mut text);
    String::from_utf8(text).expect("UTF-8")
}

#[test]
fn header_matches_sources() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("include/sgs.h");
    let generated = generated();
    if std::env::var_os("SGS_WRITE_HEADER").is_some() {
        std::fs::write(&path, &generated).expect("sgs.h can be written");
    }
    let there = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(there == generated, "sgs.h is out of date; renew it with SGS_WRITE_HEADER=1");
    // A file that lost its functions would be current too.
    for name in [
        "sgs_version",
        "sgs_context_adopt",
        "sgs_view_record",
        "sgs_train_step",
        "sgs_relight_open",
        "SGS_ERROR_HANDLE",
    ] {
        assert!(there.contains(name), "{name} is missing");
    }
}
