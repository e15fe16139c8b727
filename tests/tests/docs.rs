//! The book matches the program: generated pages, links, anchors, shell blocks.
//!
//! `SGS_WRITE_DOCS=1 cargo test --workspace --test docs` regenerates the generated pages.

use sgs_config::{PRESETS, Settings};
use sgs_tests::cli::{program, sgs};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::path::{Component, Path, PathBuf};
use std::process::Command;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the workspace")
}

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// Compares a generated page with its file, or writes the file.
///
/// The variable `SGS_WRITE_DOCS` selects writing.
#[track_caller]
fn check_page(name: &str, text: &str) {
    let path = root().join("docs").join(name);
    if std::env::var_os("SGS_WRITE_DOCS").is_some() {
        std::fs::write(&path, text).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    }
    let found = std::fs::read_to_string(&path).unwrap_or_default();
    let line = found.lines().zip(text.lines()).position(|(a, b)| a != b);
    assert!(
        found == text,
        "docs/{name} differs from line {} on; run SGS_WRITE_DOCS=1 cargo test --workspace --test docs",
        line.map_or_else(|| found.lines().count().min(text.lines().count()) + 1, |l| l + 1)
    );
}

/// Returns the text of doc comments, one line per paragraph.
fn doc(attributes: &[syn::Attribute]) -> String {
    let mut text = String::new();
    for attribute in attributes.iter().filter(|a| a.path().is_ident("doc")) {
        if let syn::Meta::NameValue(value) = &attribute.meta
            && let syn::Expr::Lit(literal) = &value.value
            && let syn::Lit::Str(line) = &literal.lit
        {
            text.push_str(line.value().trim());
            text.push(' ');
        }
    }
    // A table cell cannot hold a rustdoc link or an unescaped vertical bar.
    text.trim().replace('|', "\\|").replace("[`", "`").replace("`]", "`")
}

/// Struct of settings.
///
/// `fields` holds the name, type and documentation of each field.
struct Group {
    doc: String,
    fields: Vec<(String, String, String)>,
}

/// Returns the structs of the crates that define settings, by name.
fn groups() -> BTreeMap<String, Group> {
    let mut groups = BTreeMap::new();
    let folder = root().join("tools/config/src");
    let mut files: Vec<PathBuf> =
        std::fs::read_dir(&folder).expect("a folder").map(|e| e.expect("a file").path()).collect();
    files.push(root().join("passes/src/accuracy.rs"));
    for file in files.iter().filter(|f| f.extension().is_some_and(|e| e == "rs")) {
        for item in syn::parse_file(&read(file)).unwrap_or_else(|e| panic!("{}: {e}", file.display())).items {
            let syn::Item::Struct(item) = item else { continue };
            let field = |f: &syn::Field| {
                let syn::Type::Path(path) = &f.ty else { return None };
                let ty = path.path.segments.last()?.ident.to_string();
                Some((f.ident.as_ref()?.to_string(), ty, doc(&f.attrs)))
            };
            let plain = |f: &syn::Field| Some((f.ident.as_ref()?.to_string(), String::new(), doc(&f.attrs)));
            let fields = item.fields.iter().filter_map(|f| field(f).or_else(|| plain(f))).collect();
            groups.insert(item.ident.to_string(), Group { doc: doc(&item.attrs), fields });
        }
    }
    groups
}

/// Formats a value.
///
/// A float that is exact in single precision gets only the digits that single precision needs.
fn shortest(value: &toml::Value) -> String {
    match value {
        toml::Value::Float(number) if f64::from(*number as f32) == *number => format!("{:?}", *number as f32),
        toml::Value::Array(all) => format!("[{}]", all.iter().map(shortest).collect::<Vec<_>>().join(", ")),
        other => other.to_string(),
    }
}

/// Appends the settings of a table and of its nested tables to the page.
///
/// `tables` holds the defaults, then the settings of each preset.
fn settings_of(
    groups: &BTreeMap<String, Group>,
    name: &str,
    prefix: &str,
    tables: &[toml::Table],
    page: &mut String,
    count: &mut usize,
) {
    let group = groups.get(name).unwrap_or_else(|| panic!("no struct {name}"));
    let title = if prefix.is_empty() { "Run".to_owned() } else { format!("`[{}]`", prefix.trim_end_matches('.')) };
    let mut rows = String::new();
    let mut below = Vec::new();
    let mut documented = BTreeSet::new();
    for (field, ty, doc) in &group.fields {
        let Some(value) = tables[0].get(field) else { continue };
        documented.insert(field.clone());
        if let toml::Value::Table(_) = value {
            below.push((field, ty));
            continue;
        }
        assert!(!doc.is_empty(), "{prefix}{field} has no documentation");
        *count += 1;
        let mut others = String::new();
        for (preset, table) in PRESETS.iter().zip(&tables[1..]) {
            if table.get(field) != Some(value) {
                let _ = write!(others, "<br>`{}`: `{}`", preset.name, shortest(&table[field]));
            }
        }
        let _ = writeln!(rows, "| `{field}` | `{}`{others} | {doc} |", shortest(value));
    }
    for key in tables[0].keys() {
        assert!(documented.contains(key), "{prefix}{key} is a setting without a field of that name");
    }
    if !rows.is_empty() {
        let _ = write!(page, "\n## {title}\n\n{}\n\n| setting | default | meaning |\n|---|---|---|\n{rows}", group.doc);
    }
    for (field, ty) in below {
        let inner: Vec<_> = tables.iter().map(|t| t[field].as_table().expect("a table").clone()).collect();
        settings_of(groups, ty, &format!("{prefix}{field}."), &inner, page, count);
    }
}

#[test]
fn settings_page_is_generated() {
    let table = |settings: &Settings| toml::Table::try_from(settings).expect("settings are TOML");
    let mut tables = vec![table(&Settings::default())];
    for preset in PRESETS {
        let settings = Settings::from_table(preset.table().expect("a preset is TOML")).expect("a preset is valid");
        tables.push(table(&settings));
    }
    let mut page = String::from(
        "# Settings\n\n`config.toml` of a run holds all settings. `--config FILE.toml` and `--set KEY=VALUE` change them \
         ([Presets](presets.md) says in which order).\nThe second column has the default, and the values of presets that differ.\n",
    );
    let mut count = 0;
    settings_of(&groups(), "Settings", "", &tables, &mut page, &mut count);
    assert!(count > 50, "{count} settings");
    check_page("reference/settings.md", &page);
}

#[test]
fn command_line_page_is_generated() {
    let help = |arguments: &[&str]| {
        let text = sgs(arguments).ok().stdout;
        text.lines().map(str::trim_end).collect::<Vec<_>>().join("\n").trim().to_owned()
    };
    let main = help(&["--help"]);
    let commands: Vec<&str> = main
        .lines()
        .skip_while(|l| *l != "Commands:")
        .skip(1)
        .take_while(|l| !l.is_empty())
        .filter(|l| l.starts_with("  ") && !l.starts_with("   "))
        .filter_map(|l| l.split_whitespace().next())
        .filter(|c| *c != "help")
        .collect();
    assert!(commands.len() > 10, "{commands:?}");
    let mut page =
        String::from("# Command line\n\nThis page holds what `sgs --help` and `sgs COMMAND --help` print.\n");
    let _ = write!(page, "\n## sgs\n\n```text\n{main}\n```\n");
    for command in commands {
        let _ = write!(page, "\n## sgs {command}\n\n```text\n{}\n```\n", help(&[command, "--help"]));
    }
    check_page("reference/cli.md", &page);
}

/// Returns the Markdown files of the documentation, sorted.
fn pages() -> Vec<PathBuf> {
    fn walk(folder: &Path, into: &mut Vec<PathBuf>) {
        for entry in std::fs::read_dir(folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                walk(&path, into);
            } else if path.extension().is_some_and(|e| e == "md") {
                into.push(path);
            }
        }
    }
    let mut all: Vec<_> = ["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md", "tools/priors/README.md"]
        .map(|p| root().join(p))
        .into();
    for folder in ["docs", "bench/results"] {
        walk(&root().join(folder), &mut all);
    }
    all.sort();
    all
}

/// Returns the lines of a page outside fenced blocks.
fn prose(text: &str) -> String {
    let mut fenced = false;
    let mut lines = Vec::new();
    for line in text.lines() {
        if line.trim_start().starts_with("```") {
            fenced = !fenced;
        } else if !fenced {
            lines.push(line);
        }
    }
    lines.join("\n")
}

/// Returns the targets of the inline links of a page.
fn links(text: &str) -> Vec<String> {
    let text = prose(text);
    let mut found = Vec::new();
    for (at, _) in text.match_indices("](") {
        let rest = &text[at + 2..];
        if let Some(end) = rest.find([')', ' ', '\n']) {
            found.push(rest[..end].to_owned());
        }
    }
    found
}

/// Returns the anchors of a page, as Markdown renderers derive them from headings.
fn anchors(text: &str) -> BTreeSet<String> {
    let mut anchors = BTreeSet::new();
    for line in prose(text).lines().filter(|l| l.starts_with('#')) {
        let title = line.trim_start_matches('#').trim().to_lowercase();
        let allowed = title.chars().filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'));
        anchors.insert(allowed.map(|c| if c == ' ' { '-' } else { c }).collect());
    }
    anchors
}

/// Returns a path without `.` and `..`.
fn plain(path: &Path) -> PathBuf {
    let mut out = PathBuf::new();
    for part in path.components() {
        match part {
            Component::ParentDir => {
                out.pop();
            }
            Component::CurDir => {}
            other => out.push(other),
        }
    }
    out
}

/// Returns the broken links of a page.
fn broken(page: &Path, text: &str) -> Vec<String> {
    let mut broken = Vec::new();
    for link in links(text) {
        if ["http:", "https:", "mailto:"].iter().any(|s| link.starts_with(s)) {
            continue;
        }
        let (file, anchor) = link.split_once('#').map_or((link.as_str(), None), |(f, a)| (f, Some(a)));
        let target =
            if file.is_empty() { page.to_owned() } else { plain(&page.parent().expect("a folder").join(file)) };
        let text = if target == page { Some(text.to_owned()) } else { std::fs::read_to_string(&target).ok() };
        let reached = match (target.exists() || target == page, anchor) {
            (false, _) => false,
            (true, None) => true,
            (true, Some(anchor)) => text.is_some_and(|t| anchors(&t).contains(anchor)),
        };
        if !reached {
            broken.push(format!("{}: {link}", page.strip_prefix(root()).unwrap_or(page).display()));
        }
    }
    broken
}

#[test]
fn links_and_anchors_resolve() {
    let broken: Vec<String> = pages().iter().flat_map(|page| broken(page, &read(page))).collect();
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[test]
fn planted_broken_links_are_caught() {
    let page = root().join("docs/planted.md");
    let text = "# One thing\n[a](no-such.md) [b](#one-thing) [c](#two) [d](introduction.md)\n```\n[e](none.md)\n```\n";
    assert_eq!(broken(&page, text), ["docs/planted.md: no-such.md", "docs/planted.md: #two"]);
}

#[test]
fn summary_lists_every_page_once() {
    let docs = root().join("docs");
    let listed = links(&read(&docs.join("SUMMARY.md")));
    let unique: BTreeSet<_> = listed.iter().cloned().collect();
    assert_eq!(listed.len(), unique.len(), "SUMMARY.md lists a page twice");
    let there: BTreeSet<String> = pages()
        .iter()
        .filter_map(|p| p.strip_prefix(&docs).ok())
        .map(|p| p.to_string_lossy().into_owned())
        .filter(|p| p != "SUMMARY.md")
        .collect();
    assert_eq!(unique, there);
}

/// Returns the shell blocks of a page that are marked to run.
fn scripts(text: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut script: Option<String> = None;
    for line in text.lines() {
        match &mut script {
            Some(lines) if line.trim() == "```" => {
                found.push(std::mem::take(lines));
                script = None;
            }
            Some(lines) => {
                lines.push_str(line);
                lines.push('\n');
            }
            None if line.trim() == "```sh run" => script = Some(String::new()),
            None => {}
        }
    }
    found
}

/// Runs the shell blocks of every page, in order.
///
/// Each page has its own folder. A wrapper shortens trainings and synthesizes small images.
#[test]
fn shell_blocks_run() {
    let mut count = 0;
    for page in pages() {
        let scripts = scripts(&read(&page));
        if scripts.is_empty() {
            continue;
        }
        count += scripts.len();
        let place = tempfile::tempdir().expect("a folder");
        let bin = place.path().join("bin");
        std::fs::create_dir(&bin).expect("a folder");
        let wrapper = format!(
            "#!/bin/sh\nif [ \"$1\" = train ]; then exec '{0}' \"$@\" --scale 0.5 --geometry-steps 30 --intrinsic-steps 4 \
             --set transport.steps=2; fi\nif [ \"$1\" = synth ]; then exec '{0}' synth \"$2\" --views 3 --size 64x48; fi\nexec '{0}' \"$@\"\n",
            program().display()
        );
        let tool = bin.join("sgs");
        std::fs::write(&tool, wrapper).expect("a file");
        assert!(Command::new("chmod").arg("+x").arg(&tool).status().is_ok_and(|s| s.success()));
        let path = format!("{}:{}", bin.display(), std::env::var("PATH").unwrap_or_default());
        let script = format!("set -eu\n{}", scripts.join("\n"));
        let run = Command::new("bash").arg("-c").arg(&script).current_dir(place.path()).env("PATH", path).output();
        let run = run.expect("bash runs");
        assert!(
            run.status.success(),
            "{}\n{script}\n{}{}",
            page.display(),
            String::from_utf8_lossy(&run.stdout),
            String::from_utf8_lossy(&run.stderr)
        );
    }
    assert!(count >= 5, "{count} blocks");
}
