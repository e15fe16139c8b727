//! Training with densification by Markov chain Monte Carlo.

use sgs_tests::Place;
use sgs_tests::cli::sgs;
use sgs_tests::rooms::Room;

/// Selects the rule.
const RULE: [&str; 2] = ["--set", "geometry.densify.rule=mcmc"];

fn number(place: &Place, file: &str, pointer: &str) -> f64 {
    let value: serde_json::Value = serde_json::from_slice(&place.read(file)).unwrap();
    value.pointer(pointer).and_then(serde_json::Value::as_f64).unwrap_or_else(|| panic!("{file} lacks {pointer}"))
}

/// Kills and resumes trainings in both storages of the state.
#[test]
fn killed_mcmc_training_resumes_with_the_same_bits() {
    let place = Place::new(Room::default());
    for bits in ["accuracy.state_bits=32", "accuracy.state_bits=16"] {
        let options = [&RULE[..], &["--set", bits]].concat();
        let (straight, killed) = (format!("straight-{bits}"), format!("killed-{bits}"));
        sgs(&place.arguments(&straight, 40, &options)).ok();
        place.train_killed(&killed, 40, &options, &[9, 24]);
        place.assert_same(&straight, &killed);
        // 5 % more after each of the densifications, of which the last leaves an interval.
        let log = String::from_utf8(place.read(&format!("{straight}/log.jsonl"))).unwrap();
        let lines: Vec<serde_json::Value> = log.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
        let counts: Vec<u64> =
            lines.iter().filter_map(|l| l.pointer("/densified/after").and_then(serde_json::Value::as_u64)).collect();
        let before = lines.iter().find_map(|l| l.pointer("/densified/before").and_then(serde_json::Value::as_u64));
        let grown = std::iter::successors(before, |n| Some(n + n / 20)).skip(1);
        assert!(counts.len() >= 5 && counts.iter().copied().eq(grown.take(counts.len())), "{before:?} {counts:?}");
    }
}

/// Growth to the limit improves images at test views.
#[test]
fn mcmc_training_improves_test_images() {
    let place = Place::new(Room::default());
    let train = |run: &str, more: &[&str]| {
        let lean =
            ["-q", "--stage", "geometry", "--set", "geometry.semantics=false", "--set", "geometry.normals=false"];
        sgs(&place.arguments(run, 200, &[&lean, more].concat())).ok();
        sgs(&["eval", &place.text(run), "--json", &place.text("measures.json")]).ok();
        let count = number(&place, &format!("{run}/training.json"), "/gaussians");
        (number(&place, "measures.json", "/mean/nvs/psnr"), count)
    };
    let fixed = train("fixed", &["--no-densify"]);
    let grown = train("grown", &[&RULE[..], &["--set", "geometry.densify.max_gaussians=600"]].concat());
    assert!(grown.1 == 600.0 && grown.0 > fixed.0 + 0.5, "{grown:?} {fixed:?}");
}
