//! Guidance by branch counters: compiler counters are read, new branches are followed.

use sgs_fuzz::{Campaign, Tally, Target, distill, enlist, find, quietly};
use std::path::Path;
use std::process::Command;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::Duration;

/// Stand-in for the compiler's counters, incremented by hand.
static COUNTERS: [AtomicU64; 1000] = [const { AtomicU64::new(0) }; 1000];

/// Word whose letters the maze compares one after the other.
const WORD: &[u8] = b"way";

fn maze(bytes: &[u8], count: impl Fn(usize)) -> String {
    let right = bytes.iter().zip(WORD).take_while(|(a, b)| a == b).count();
    (0..right).for_each(count);
    assert!(right < WORD.len(), "the end of the maze");
    String::new()
}

fn counted(bytes: &[u8]) -> String {
    // The counters lie far apart, as in real code of different branches.
    maze(bytes, |letter| {
        let _before = COUNTERS[100 + 200 * letter].fetch_add(1 << (8 * letter), Relaxed);
    })
}

fn uncounted(bytes: &[u8]) -> String {
    maze(bytes, |_| ())
}

/// Creates a target without a corpus.
fn maze_of(run: fn(&[u8]) -> String) -> Target {
    let mut target = find("bytes").expect("a target").clone();
    (target.name, target.run) = ("maze", run);
    target
}

#[test]
fn coverage_guidance_reaches_what_random_inputs_miss() {
    quietly();
    enlist(&COUNTERS);
    let feed = |run: fn(&[u8]) -> String| -> Tally {
        let target = maze_of(run);
        Campaign::new(&target, 3).run(INPUTS, Duration::MAX)
    };
    let (led, blind) = (feed(counted), feed(uncounted));
    let [finding] = &led.findings[..] else { panic!("{:?} after {} inputs", led.findings, led.inputs) };
    assert!(finding.input == WORD && finding.what.contains("the end of the maze"), "{finding:?}");
    assert_eq!(led.branches, Some(WORD.len() - 1), "one a letter, but for the last input, which is a finding");
    // Distillation prefers one input that takes both branches, and leaves out shorter and failing inputs.
    let target = maze_of(counted);
    let inputs = ["w", "x", "wa", "way", "wax and more"].map(|text| text.as_bytes().to_vec());
    assert_eq!(distill(&target, &inputs, 1000), Some((vec![b"wa".to_vec()], 2)));
    assert_eq!(distill(&target, &inputs, 201), Some((vec![b"w".to_vec()], 1)), "there is room for a byte");
    assert!(blind.findings.is_empty() && blind.branches == Some(0), "{blind:?}");
}

/// About ten times the number of inputs that the guided campaign needs.
const INPUTS: u64 = 400_000;

#[test]
fn compiler_counters_are_read() {
    let folder = tempfile::tempdir().expect("a folder");
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(here.join("coverage.toml")).expect("settings");
    let settings: toml::Table = text.parse().expect("TOML");
    let flags = settings["build"]["rustflags"].as_array().expect("flags");
    let flags: Vec<&str> = flags.iter().map(|f| f.as_str().expect("a flag")).collect();
    // The reader has counters, and the program that reads them does not. Other code surrounds the reader, since
    // counters at both ends may be left out.
    let read = r#"
        macro_rules! other {
            ($name:ident) => {
                #[inline(never)]
                pub fn $name(text: &str) -> usize {
                    text.split('/').filter(|t| t.len() > 3 && !t.contains("..")).map(|t| t.trim().len()).sum()
                }
            };
        }
        other!(before);
        #[inline(never)]
        pub fn read(text: &str) -> usize {
            match text.as_bytes() {
                [b'a', b'b', ..] => text.len(),
                [b'a', ..] => 1,
                _ => 0,
            }
        }
        other!(after);
    "#;
    let source = r#"
        extern crate self as sgs_fuzz;
        #[path = "HERE/hook.rs"]
        mod hook;
        #[path = "HERE/coverage.rs"]
        mod coverage;
        pub use coverage::enlist;
        fn main() {
            let mut coverage = coverage::Coverage::of_program();
            let mut came = Vec::new();
            for text in std::env::args().skip(1) {
                coverage.begin();
                let length = read::read(&text);
                let far = coverage.elsewhere();
                came.push((length, far | coverage.is_new()));
            }
            println!("{} {came:?}", coverage.counts());
            // Lest the linker leave them out.
            assert!(read::before("a") + read::after("b") == 0);
        }
    "#;
    let source = source.replace("HERE", &here.join("src").display().to_string());
    let build = |flags: &[&str]| {
        let rustc = |arguments: &[&str], name: &str, text: &str| {
            std::fs::write(folder.path().join(name), text).expect("written");
            let mut rustc = Command::new(std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into()));
            rustc.current_dir(folder.path()).args(["--edition", "2024", "-Copt-level=1", "-Adead_code"]);
            let out = rustc.args(arguments).arg(name).output().expect("rustc runs");
            assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        };
        rustc(&[flags, &["--crate-type", "rlib"]].concat(), "read.rs", read);
        rustc(&["--extern", "read=libread.rlib"], "main.rs", &source);
        let texts = ["x", "x", "ax", "ax", "ab", "x", "ab"];
        let out = Command::new(folder.path().join("main")).args(texts).output().expect("it runs");
        String::from_utf8(out.stdout).expect("text")
    };
    let came = |new: [bool; 7]| format!("{:?}\n", [0, 0, 1, 1, 2, 0, 2].into_iter().zip(new).collect::<Vec<_>>());
    assert_eq!(build(&flags), format!("true {}", came([true, false, true, false, true, false, false])));
    assert_eq!(build(&[]), format!("false {}", came([false; 7])));
}
