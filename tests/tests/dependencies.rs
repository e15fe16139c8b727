//! Dependencies: each has a reason, an allowed license, one version and a public source.
//!
//! The lists are those of `deny.toml`, so that `cargo deny check` and this test agree.

use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process::Command;

fn read(path: &str) -> String {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the workspace");
    std::fs::read_to_string(root.join(path)).unwrap_or_else(|e| panic!("{path}: {e}"))
}

fn deny() -> toml::Table {
    read("deny.toml").parse().expect("deny.toml is TOML")
}

/// Returns the metadata of all packages that are built on Linux.
fn metadata() -> Value {
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--format-version", "1", "--locked", "--filter-platform", "x86_64-unknown-linux-gnu"])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("cargo runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("JSON")
}

/// Returns name, version, license and source of the packages of others.
///
/// Packages that only tests need are included.
fn packages(metadata: &Value) -> Vec<[&str; 4]> {
    let nodes = metadata["resolve"]["nodes"].as_array().expect("nodes").iter();
    let built: BTreeSet<&str> = nodes.filter_map(|node| node["id"].as_str()).collect();
    let all = metadata["packages"].as_array().expect("packages").iter();
    let all = all.filter(|p| built.contains(p["id"].as_str().expect("an id")) && !p["source"].is_null());
    all.map(|p| ["name", "version", "license", "source"].map(|key| p[key].as_str().unwrap_or("none"))).collect()
}

#[test]
fn every_dependency_has_a_reason() {
    let page = read("docs/project/dependencies.md");
    let mut listed = BTreeSet::new();
    for row in page.lines().filter(|l| l.starts_with("| `")) {
        let (names, reason) = row.trim_matches('|').split_once('|').expect("two columns");
        assert!(reason.trim().len() > 5, "{names} has no reason");
        listed.extend(names.split(',').map(|n| n.trim().trim_matches('`').to_owned()));
    }
    let manifest: toml::Table = read("Cargo.toml").parse().expect("the manifest is TOML");
    let all = manifest["workspace"]["dependencies"].as_table().expect("a table");
    let direct: BTreeSet<String> =
        all.iter().filter(|(_, value)| value.get("path").is_none()).map(|(name, _)| name.clone()).collect();
    assert_eq!(listed, direct);
}

/// Returns whether allowed licenses alone satisfy an SPDX license expression.
fn satisfied(expression: &str, allowed: &[&str]) -> bool {
    let flat = expression.replace(['(', ')'], "").replace(" / ", " OR ").replace('/', " OR ");
    let part = |part: &str| part.split(" OR ").any(|license| allowed.contains(&license.trim()));
    flat.split(" AND ").all(part)
}

fn words(list: &toml::Value) -> Vec<&str> {
    list.as_array().expect("a list").iter().filter_map(toml::Value::as_str).collect()
}

/// Checks the licenses in the manifests of all built packages.
#[test]
fn licenses_are_permissive() {
    let (metadata, deny) = (metadata(), deny());
    let allowed = words(&deny["licenses"]["allow"]);
    let exceptions = deny["licenses"]["exceptions"].as_array().expect("a list");
    let refused: Vec<_> = packages(&metadata)
        .into_iter()
        .filter(|[name, _, license, _]| {
            let exception = exceptions.iter().find(|e| e["crate"].as_str() == Some(name));
            let more = exception.map_or_else(Vec::new, |e| words(&e["allow"]));
            !satisfied(license, &[&allowed[..], &more[..]].concat())
        })
        .collect();
    assert!(refused.is_empty(), "{refused:?}");
    assert!(!satisfied("GPL-3.0", &allowed) && !satisfied("MIT AND GPL-2.0", &allowed));
    assert!(satisfied("GPL-2.0 OR MIT", &allowed));
}

#[test]
fn only_listed_packages_have_two_versions() {
    let metadata = metadata();
    let mut versions: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for [name, version, ..] in packages(&metadata) {
        versions.entry(name).or_default().insert(version);
    }
    versions.retain(|_, found| found.len() > 1);
    let deny = deny();
    let skipped: BTreeMap<&str, &str> = deny["bans"]["skip"]
        .as_array()
        .expect("a list")
        .iter()
        .map(|entry| entry["crate"].as_str().and_then(|name| name.split_once('@')).expect("a name and a version"))
        .collect();
    assert!(versions.keys().eq(skipped.keys()), "built: {versions:?}, listed: {skipped:?}");
    for (name, found) in versions {
        let rest = found.iter().filter(|version| !version.starts_with(&format!("{}.", skipped[name])));
        assert_eq!(rest.count(), 1, "{name}: {found:?}");
    }
}

#[test]
fn packages_come_from_the_public_registry() {
    let metadata = metadata();
    let public = "registry+https://github.com/rust-lang/crates.io-index";
    let other: Vec<_> = packages(&metadata).into_iter().filter(|[.., source]| *source != public).collect();
    assert!(other.is_empty(), "{other:?}");
}
