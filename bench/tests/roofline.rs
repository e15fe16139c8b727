//! `engine-bench roofline` over stored reports.

use std::path::Path;
use std::process::{Command, Output};

fn run(arguments: &[&str]) -> Output {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("results");
    Command::new(env!("CARGO_BIN_EXE_engine-bench"))
        .arg("roofline")
        .args(arguments)
        .current_dir(folder)
        .output()
        .unwrap()
}

#[test]
fn stored_step_is_predicted_and_errors_are_sentences() {
    let step = ["nvidia-h100.json", "gaussians=1000000"];
    let done = run(&[&step[..], &["--rows", "3", "--target", "h200"]].concat());
    let text = String::from_utf8(done.stdout).unwrap();
    assert!(done.status.success() && text.lines().count() == 7, "{text}");
    assert!(text.contains("| NVIDIA H100 80GB HBM3, measured, ms | h200, predicted | at best |"), "{text}");
    // A report with the time of a dispatch shows what barriers take.
    let small = ["nvidia-h200.json", "gaussians=100000", "--rows", "3", "--target", "4090,h200"];
    let text = String::from_utf8(run(&small).stdout).unwrap();
    assert!(text.lines().count() == 8, "{text}");
    assert!(text.ends_with("\n| of it 34 barriers | 0.068 | 0.068 | | 0.068 | |\n"), "{text}");
    // A device is predicted as it was measured.
    let done = run(&[&step[..], &["--against", "nvidia-h100.json"]].concat());
    let text = String::from_utf8(done.stdout).unwrap();
    assert!(text.contains("ratio 1.00, for 39 of 39 passes. Ratio of a pass: median 1.00"), "{text}");
    // A step of 100 000 Gaussians by the ratios of one of 20 000, and by counts alone.
    let step = ["llvmpipe.json", "gaussians=100000"];
    let done = run(&[&step[..], &["--ratios", "llvmpipe.json,gaussians=20000", "--rows", "5"]].concat());
    let text = String::from_utf8(done.stdout).unwrap();
    assert!(
        done.status.success() && text.contains("34 other passes") && text.contains("Error from counts: +1"),
        "{text}"
    );
    for (arguments, words) in [
        (vec!["llvmpipe.json", "gaussians=100000", "--ratios", "llvmpipe.json,gaussians=100000"], "the same step"),
        (vec!["llvmpipe.json", "gaussians=100000", "--ratios", "nvidia-h100.json,gaussians=1000000"], "--against"),
        (vec!["nvidia-h100.json"], "Reports of \"step\" are"),
        (vec!["none.json"], "none.json"),
        (vec!["nvidia-h100.json", "gaussians=1000000", "--plan", "none"], "no plan \"none\""),
        (vec!["nvidia-h100.json", "gaussians=1000000", "--target", "3dfx"], "unknown device"),
        (vec!["nvidia-h100.json", "gaussians=1000000", "--against", "llvmpipe.json"], "There is no report"),
    ] {
        let refused = run(&arguments);
        let text = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert!(!refused.status.success() && text.contains(words) && !text.contains("panicked"), "{words}: {text}");
    }
}
