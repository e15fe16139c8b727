//! Help, completions and manual pages of the program. Help fits 80 columns. The test also checks where the files are
//! installed.

use sgs_tests::cli::{program, sgs};
use std::path::Path;
use std::process::Command;

/// Returns every command that `sgs --help` lists.
fn commands() -> Vec<String> {
    let help = sgs(&["--help"]).ok().stdout;
    let list = help.split("Commands:\n").nth(1).and_then(|l| l.split("\n\n").next()).expect("a list of commands");
    // Continuation lines have a larger indent.
    let names = list.lines().filter(|l| l.starts_with("  ") && !l.starts_with("   "));
    names.map(|l| l.split_whitespace().next().unwrap().to_owned()).filter(|n| n != "help").collect()
}

/// Returns the lines of more than 80 columns.
fn long_lines(text: &str) -> Vec<&str> {
    text.lines().filter(|l| l.chars().count() > 80).collect()
}

#[test]
fn help_fits_80_columns() {
    assert_eq!(long_lines(&format!("{}\n{}", "a".repeat(80), "é".repeat(81))), ["é".repeat(81)]);
    let commands = commands();
    for known in ["synth", "train", "render", "relight", "export", "devices", "man"] {
        assert!(commands.iter().any(|c| c == known), "{known}: {commands:?}");
    }
    let mut all = vec![vec!["--help".to_owned()], vec!["-h".to_owned()]];
    all.extend(commands.iter().flat_map(|c| ["--help", "-h"].map(|h| vec![c.clone(), h.to_owned()])));
    for arguments in all {
        let help = sgs(&arguments).ok().stdout;
        assert_eq!(long_lines(&help), [""; 0], "sgs {arguments:?}");
        assert!(help.contains("Usage: sgs"), "{help}");
        // The first line describes the command, not the package.
        assert!(!help.starts_with("The SGS command line"));
    }
}

/// Returns bash's completions after some words.
fn offered(script: &Path, words: &[&str]) -> Vec<String> {
    let last = words.len() - 1;
    let line = format!(
        "source '{}'; COMP_WORDS=({}); COMP_CWORD={last}; _sgs sgs '{}' '{}'; printf '%s\\n' \"${{COMPREPLY[@]}}\"",
        script.display(),
        words.iter().map(|w| format!("'{w}'")).collect::<Vec<_>>().join(" "),
        words[last],
        words[last - 1]
    );
    let output = Command::new("bash").args(["-c", &line]).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).lines().map(str::to_owned).collect()
}

#[test]
fn shells_get_completions() {
    let folder = tempfile::tempdir().unwrap();
    for shell in ["bash", "zsh", "fish"] {
        let script = sgs(&["completions", shell]).ok().stdout;
        for word in commands().iter().map(String::as_str).chain(["cameras", "memory-budget"]) {
            assert!(script.contains(word), "{shell}: {word}");
        }
        let file = folder.path().join(shell);
        std::fs::write(&file, &script).unwrap();
        match Command::new(shell).arg("-n").arg(&file).output() {
            Ok(output) => assert!(output.status.success(), "{shell}: {}", String::from_utf8_lossy(&output.stderr)),
            Err(_) => eprintln!("skipped: {shell} is not installed, so its script was not parsed"),
        }
    }
    let bash = folder.path().join("bash");
    assert_eq!(offered(&bash, &["sgs", "rel"]), ["relight"]);
    assert!(offered(&bash, &["sgs", "render", "--cam"]).contains(&"--cameras".to_owned()));
    assert_eq!(offered(&bash, &["sgs", "train", "--stage", "ge"]), ["geometry"]);
    assert_eq!(offered(&bash, &["sgs", "train", "--preset", "pa"]), ["paper", "parity"]);
    let refused = sgs(&["completions", "tcl"]);
    assert_eq!(refused.status, Some(2));
}

#[test]
fn manual_pages_and_the_rest_are_installed() {
    let folder = tempfile::tempdir().unwrap();
    let to = folder.path();
    let install = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tools/sgs/install");
    let output = Command::new(install).arg("/usr").arg(program()).env("DESTDIR", to).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let share = to.join("usr/share");
    for file in ["bash-completion/completions/sgs", "zsh/site-functions/_sgs", "fish/vendor_completions.d/sgs.fish"] {
        assert!(std::fs::read_to_string(share.join(file)).unwrap().contains("relight"), "{file}");
    }
    let page = |name: &str| std::fs::read_to_string(share.join("man/man1").join(name)).unwrap();
    for command in commands() {
        assert!(page("sgs.1").contains(&format!("sgs\\-{command}(1)")), "{command}");
        let own = page(&format!("sgs-{command}.1"));
        assert!(own.contains(".SH NAME") && own.contains(".SH SYNOPSIS") && own.contains("device"), "{own}");
    }
    let version = Command::new(to.join("usr/bin/sgs")).arg("--version").output().unwrap();
    assert!(String::from_utf8_lossy(&version.stdout).starts_with("sgs "));

    let file = to.join("file");
    std::fs::write(&file, "").unwrap();
    sgs(&["man", "-o", &file.display().to_string()]).refused(&["file\" cannot be made"]);
}
