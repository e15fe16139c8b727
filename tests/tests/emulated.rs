//! Tests of kernels again on the emulator, at 32 and 64 lanes.
//!
//! `device` compares passes with references. With `SGS_TEST_EMULATE`, the emulator runs their graphs, and reports races
//! and other undefined operations. Each kernel with subgroup operations must run at both sizes, or have a reason why not.

use sgs_passes::kernel::shader;
use sgs_tests::program::program;
use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

/// Tests of `device`, by a part of their names.
const TESTS: &[&str] = &[
    "compact::adam_matches_reference_within_a_unit_of_the_last_place",
    "compact::opacity_reset_clears_compact_moments",
    "correspondence::",
    "decoder::label_maps_match_reference",
    "densify::",
    "environment::environment_light_and_gradients_match_reference",
    "environment::smoothness_is_the_mean_over_the_map_with_its_gradient",
    "emulator::differences_of_a_small_map_match_reference",
    "feature_views::",
    "features::",
    "gbuffer::",
    "geometry_loss::",
    "learned_normals::",
    "learned_views::",
    "lights::",
    "lights_regularize::",
    "loss::",
    "loss_properties::",
    "material_images::",
    "material_losses::",
    "optim::",
    "prim::",
    "relocate::noise",
    "semantic::",
    "shading_properties::",
    "splat_bwd::",
    "tile_parts::",
    "traced::",
    "traced_lights::",
    "transport::",
    "transport_responses::",
    "transport_shade::",
    "transport_solve::",
    "transport_source::",
    "visibility::",
    "visibility_bwd::",
    "visibility_lights::",
    "visibility_matrices::",
    "visibility_matrices_bwd::",
    "visible_bits::",
];

/// Tests that are left out.
const SKIPPED: &[&str] = &[
    // They run executors of their own, which do nothing here.
    "prim::sort_writes_nothing_after_the_last_element",
    "learned_normals::training_restores_perturbed_normals",
    "learned_views::moved_cameras_and_exposures_are_found",
    // A few blocks of narrow subgroups are its subject.
    "traced_lights::results_are_independent_of_stretches",
    // They take long.
    "correspondence::correspondence_at_extremes",
    "loss_properties::material_losses_match_reference",
    "material_losses::relight_loss_matches_reference",
    "prim::scan_of_a_million_and_folded_grids",
    "prim::sort_of_a_million",
    "semantic::pixels_without_labels_are_skipped_and_counted",
    "traced::rays_through_random_gaussians_match_reference",
    "transport::rays_meet_extreme_discs",
    "transport_solve::transport_is_reciprocal",
    "correspondence::correspondence_matches_reference",
    "densify::densify_fills_the_cap_exactly",
    "densify::densify_matches_reference",
    "loss::photometric_at_odd_sizes",
    "loss::photometric_of_a_folded_grid",
    "semantic::decoder_fits_its_targets",
    "semantic::semantic_loss_at_extremes",
    "semantic::semantic_loss_is_deterministic",
    "semantic::semantic_loss_matches_reference_at_odd_sizes",
    "semantic::semantic_loss_of_a_map_of_several_runs_matches_reference",
    "splat_bwd::backward_kernels_agree_on_many_gaussians_bit_for_bit",
    "splat_bwd::gradients_at_other_accuracies_match_reference",
    "transport::targets_of_receivers_match_all_discs",
    "transport_shade::many_lights_and_no_lights_match_reference",
    "transport_shade::radiance_and_gradients_match_reference",
    "visibility_bwd::sampled_pairs_are_unbiased",
];

/// Kernels with subgroup operations that do not run here, and the reason.
const ABSENT: &[(&str, &str)] = &[("lights_savings", "only benchmarks run it")];

/// Runs tests on the emulator, in an order of execution. Returns the kernels that ran.
fn run(lanes: u32, order: &str, tests: &[&str]) -> BTreeSet<String> {
    let list = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("emulated{lanes}-{order}"));
    // Tests append to the list.
    if list.exists() {
        std::fs::remove_file(&list).unwrap();
    }
    let mut command = Command::new(program("device"));
    command.args(tests).args(SKIPPED.iter().flat_map(|name| ["--skip", name]));
    command.env("SGS_TEST_EMULATE", lanes.to_string()).env("SGS_TEST_ORDER", order);
    command.env("SGS_TEST_EMULATED_KERNELS", &list);
    let output = command.output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout);
    if !text.contains("test result: ok.") || text.contains("running 0 tests") {
        let lines: Vec<&str> = text.lines().collect();
        panic!("at {lanes} lanes: {}\n{}", output.status, lines[lines.len().saturating_sub(60)..].join("\n"));
    }
    let listed = std::fs::read_to_string(&list).unwrap();
    let suffix = format!(" {lanes}");
    listed.lines().filter_map(|line| line.strip_suffix(&suffix)).map(str::to_owned).collect()
}

/// Returns the kernels with subgroup operations.
fn with_subgroups() -> BTreeSet<String> {
    let all = sgs_shaders::ALL.iter().filter(|kernel| shader(kernel).uses_subgroups());
    all.map(|kernel| kernel.name.to_owned()).filter(|name| !name.contains("cooperative")).collect()
}

/// Checks that a set of kernels has each one with subgroup operations.
///
/// Kernels with a reason may be absent.
fn check(ran: &BTreeSet<String>, lanes: u32) {
    let needed = with_subgroups();
    let absent: BTreeSet<String> = ABSENT.iter().map(|(name, _)| (*name).to_owned()).collect();
    let missing: Vec<&String> = needed.iter().filter(|k| !ran.contains(*k) && !absent.contains(*k)).collect();
    assert!(missing.is_empty(), "no test runs these kernels at {lanes} lanes on the emulator: {missing:?}");
    let stale: Vec<&String> = absent.iter().filter(|k| ran.contains(*k) || !needed.contains(*k)).collect();
    assert!(stale.is_empty(), "these kernels run, or have no subgroup operations: {stale:?}");
}

#[test]
fn kernels_match_references_at_32_lanes() {
    check(&run(32, "1", TESTS), 32);
}

#[test]
fn kernels_match_references_at_64_lanes() {
    check(&run(64, "descending", TESTS), 64);
}

#[test]
#[should_panic(expected = "no test runs these kernels")]
fn missing_kernel_is_noticed() {
    let mut ran = with_subgroups();
    ran.remove("scan_down");
    ran.retain(|name| ABSENT.iter().all(|(absent, _)| absent != name));
    check(&ran, 32);
}
