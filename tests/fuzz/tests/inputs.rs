//! Every target with its corpus and mutations, and targets with planted faults.

use sgs_fuzz::{Campaign, Counting, Generator, Rng, TARGETS, Tally, Target, corpus::corpus, find, quietly};
use std::sync::Mutex;
use std::time::Duration;

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Lock for one campaign at a time: memory and panics are counted for the whole program.
static ALONE: Mutex<()> = Mutex::new(());

fn campaign(target: &Target, seed: u64, inputs: u64) -> Tally {
    let _alone = ALONE.lock().unwrap_or_else(|e| e.into_inner());
    quietly();
    Campaign::new(target, seed).run(inputs, Duration::MAX)
}

#[test]
fn every_reader_returns_a_value_or_an_error() {
    // SGS_TEST_FUZZ=SECONDS fuzzes each target for this time.
    let seconds: Option<u64> = std::env::var("SGS_TEST_FUZZ").ok().and_then(|text| text.parse().ok());
    let mut wrong = Vec::new();
    for target in TARGETS {
        let tally = match seconds {
            None => campaign(target, 1, INPUTS + corpus(target).len() as u64),
            Some(seconds) => {
                let _alone = ALONE.lock().unwrap_or_else(|e| e.into_inner());
                quietly();
                Campaign::new(target, 1).run(u64::MAX, Duration::from_secs(seconds))
            }
        };
        println!("{}: {} inputs in {:.1} s", target.name, tally.inputs, tally.time.as_secs_f64());
        for finding in &tally.findings {
            let place = std::env::temp_dir().join(format!("sgs-fuzz-{}-{}", target.name, wrong.len()));
            std::fs::write(&place, &finding.input).expect("the input is written");
            wrong.push(format!("{}: {}; {}", target.name, finding.what, place.display()));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Number of mutations for each target.
const INPUTS: u64 = 200;

#[test]
fn every_target_has_files_that_it_reads() {
    for target in TARGETS {
        let files = corpus(target);
        assert!(!files.is_empty(), "{} has no corpus", target.name);
        let total: usize = files.values().map(Vec::len).sum();
        assert!(total < 200_000, "the corpus of {} has {total} bytes", target.name);
        // The target must also be registered for libFuzzer.
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("libfuzzer");
        let source = std::fs::read_to_string(folder.join(format!("fuzz_targets/{}.rs", target.name)));
        assert!(
            source.is_ok_and(|s| s.contains(&format!("\"{}\"", target.name))),
            "{} is not for libFuzzer",
            target.name
        );
        let manifest = std::fs::read_to_string(folder.join("Cargo.toml")).expect("a manifest");
        assert!(manifest.contains(&format!("name = \"{}\"", target.name)), "{} is not in the manifest", target.name);
    }
    let of = |name: &str| find(name).expect("a target");
    let outcome = |name: &str, file: &str| (of(name).run)(&corpus(of(name))[file]);
    assert!(outcome("splats_ply", "own.ply").starts_with("ply 2 of degree 1"));
    assert!(outcome("gltf", "own.glb").contains("true gltf"));
    for (target, file, start) in [
        ("spz", "v4.spz", "spz 3 of degree 0"),
        ("spz", "own.spz", "spz 2 of degree 1"),
        ("dot_splat", "own.splat", "splat 2 of degree 0"),
        ("ksplat", "minimal.ksplat", "ksplat 3 of degree 0"),
        ("sog", "own.sog", "sog 2 of degree 1"),
        ("splats_ply", "turned.ply", "ply 2 of degree 1"),
    ] {
        assert!(outcome(target, file).starts_with(start), "{target}: {}", outcome(target, file));
    }
    assert!(outcome("sog_meta", "meta.json").contains("means_l.webp"));
    assert!(outcome("transforms", "two.json").starts_with("Transforms"));
    let measured = outcome("transforms", "measured.json");
    assert!(measured.starts_with("Transforms") && measured.contains("mask_path that does not exist"), "{measured}");
    assert!(outcome("colmap_images_bin", "two.bin").starts_with("Colmap"));
    assert!(outcome("colmap_cameras_txt", "fisheyes.txt").starts_with("Colmap"));
    assert!(outcome("colmap_cameras_bin", "polynomials.bin").starts_with("Colmap"));
    for (target, file) in [
        ("rgbd_depths", "two.txt"),
        ("rgbd_images", "two.txt"),
        ("rgbd_intrinsics", "kinect.txt"),
        ("scannet_intrinsics", "color.txt"),
        ("scannet_pose", "one.txt"),
        ("scannet_pose", "lost.txt"),
    ] {
        assert!(outcome(target, file).starts_with("Rgbd"), "{target}: {}", outcome(target, file));
    }
    assert!(outcome("scannet_pose", "lost.txt").contains("because they have no pose"));
    assert_eq!(outcome("run_cameras", "two.json"), "2 views photograph ");
    assert!(outcome("blender", "two.json").starts_with("Blender"));
    assert!(outcome("interiorverse", "two.json").starts_with("InteriorVerse"));
    assert!(
        outcome("fipt_cameras", "two.txt").starts_with("Fipt")
            && outcome("fipt_transforms", "two.json").starts_with("Fipt")
    );
    assert!(
        outcome("lights", "three.json").starts_with("3 lights") && outcome("edit", "add.json").starts_with("4 lights")
    );
    assert!(outcome("settings", "some.toml").ends_with("read") && outcome("run_settings", "some.toml") == "read");
    assert!(
        outcome("visibility", "small.safetensors") == "read"
            && outcome("checkpoint", "plain.safetensors").starts_with('2')
    );
    let materials = outcome("intrinsic_checkpoint", "automatic.safetensors");
    assert_eq!(materials, "true 2 2 [true, true, true, true] 2 true true");
    assert_eq!(outcome("page_request", "page.txt"), "HTTP/1.1 200 OK 7");
    for name in ["masks", "regions", "normals", "semantics", "text", "materials"] {
        let answer = if name == "semantics" { "features" } else { name };
        assert!(outcome("provider_talk", &format!("{name}.bin")).contains(&format!("text{answer}")), "{name}");
    }
}

#[test]
fn planted_faults_are_found() {
    fn panics(bytes: &[u8]) -> String {
        let at = bytes.first().map_or(0, |b| usize::from(*b == b'7'));
        format!("{}", [1][at])
    }
    fn swallows(bytes: &[u8]) -> String {
        let many = if bytes.windows(2).any(|w| w == b"18") { 100 << 20 } else { 1 };
        format!("{}", vec![0_u8; many].len())
    }
    fn allocates_all(bytes: &[u8]) -> String {
        let mut room: Vec<u8> = Vec::new();
        format!("{}", room.try_reserve_exact(bytes.len() << 40).is_ok())
    }
    fn sound(bytes: &[u8]) -> String {
        format!("{}", bytes.len())
    }
    let found = |run: fn(&[u8]) -> String| {
        let mut target = find("bytes").expect("a target").clone();
        target.run = run;
        campaign(&target, 5, 5000).findings
    };
    let (panic, memory, all) = (found(panics), found(swallows), found(allocates_all));
    assert!(panic.len() == 1 && panic[0].input == b"7" && panic[0].what.contains("inputs.rs"), "{panic:?}");
    assert!(memory.len() == 1 && memory[0].input == b"18" && memory[0].what.starts_with("memory"), "{memory:?}");
    assert!(all.len() == 1 && all[0].input.len() == 1 && all[0].what.starts_with("memory"), "{all:?}");
    assert!(found(sound).is_empty());
}

#[test]
fn changes_depend_on_the_seed_alone() {
    for name in ["splats_ply", "gltf", "photograph_png", "provider_talk"] {
        let target = find(name).expect("a target");
        let files: Vec<Vec<u8>> = corpus(target).into_values().collect();
        let inputs = |seed| {
            let (generator, mut random) = (Generator::new(target, files.clone()), Rng::new(seed));
            (0..200).map(|_| generator.next(&mut random)).collect::<Vec<_>>()
        };
        assert!(inputs(3) == inputs(3) && inputs(3) != inputs(4), "{name}");
        let changed = inputs(3).iter().filter(|input| !files.contains(input)).count();
        assert!(changed > 150, "{changed} of 200 changes of {name} changed something");
    }
    let first = campaign(find("lights").expect("a target"), 9, 300);
    let second = campaign(find("lights").expect("a target"), 9, 300);
    assert_eq!((first.inputs, first.results), (second.inputs, second.results));
}

#[test]
fn ledger_resumes_where_it_ends() {
    let folder = tempfile::tempdir().expect("a folder");
    let (ledger, grown) = (folder.path().join("ledger.toml"), folder.path().join("grown"));
    let fuzz = |seconds: &str| {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_sgs-fuzz"));
        command.args(["--target", "lights", "--target", "profile", "--jobs", "2", "--seconds", seconds]);
        command.arg("--ledger").arg(&ledger).arg("--grown").arg(&grown).arg("--output").arg(folder.path());
        let out = command.output().expect("it runs");
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        let text = std::fs::read_to_string(&ledger).expect("a ledger");
        (String::from_utf8(out.stdout).expect("text"), text.parse::<toml::Table>().expect("a table"))
    };
    let number = |ledger: &toml::Table, target: &str, what: &str| {
        let value = &ledger[target][what];
        value.as_float().or(value.as_integer().map(|i| i as f64)).expect("a number")
    };
    let (_, first) = fuzz("0.5");
    for target in ["lights", "profile"] {
        assert!(number(&first, target, "seconds") >= 0.5 && number(&first, target, "inputs") > 20.0, "{first}");
        assert_eq!(number(&first, target, "findings"), 0.0);
    }
    // Lights have endlessly many results, so some inputs must be new.
    assert!(std::fs::read_dir(grown.join("lights")).expect("inputs").count() > 0, "nothing new was kept");
    let (output, again) = fuzz("0.5");
    assert_eq!(again, first, "all have had enough");
    assert!(output.contains("lights") && output.contains("profile"), "{output}");
    // A slice lasts at least a second, so the time of the first run depends on how busy the machine is.
    let longer = number(&first, "lights", "seconds") + 0.5;
    let (_, more) = fuzz(&longer.to_string());
    assert!(number(&more, "lights", "seconds") >= longer);
    assert!(number(&more, "lights", "slices") > number(&first, "lights", "slices"), "with another seed");
}
