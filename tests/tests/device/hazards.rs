//! Hazards of the method and extreme trainings, as docs/how/extremes.md lists them.
//!
//! Their tests are in other files.

/// Training tests by file, test and property.
const TRAININGS: &[(&str, &str, &str)] = &[
    (
        "divergence",
        "divergence_is_reported_and_lower_rates_resume",
        "learning rates a hundred times too high, stopped and resumed with lower ones",
    ),
    (
        "divergence",
        "rollback_is_deterministic_and_resumes",
        "the same, gone back from: twice with the same bits, and after kills",
    ),
    ("divergence", "late_divergence_keeps_the_last_good_state", "rates of positions that grow until it diverges"),
    ("divergence", "divergence_of_materials_is_rolled_back", "the same of materials and lights"),
    (
        "divergence",
        "healthy_training_is_not_rolled_back",
        "rates a thousand times too low and ten times too high, poses, points and priors that are wrong, resets after resets",
    ),
    ("long", "geometry_with_every_loss", "500 steps of geometry with every loss on; 100 000 with `SGS_TEST_LONG=1`"),
    ("long", "materials_with_every_loss", "300 steps of materials with every loss on; 100 000 with `SGS_TEST_LONG=1`"),
];

/// docs/how/extremes.md lists every training. The tests are in other files.
#[test]
fn the_documentation_lists_every_training() {
    let text = include_str!("../../../docs/how/extremes.md");
    for (file, name, what) in TRAININGS {
        let row = format!("| {what} | `{file}::{name}` |");
        assert!(text.lines().any(|l| l == row), "docs/how/extremes.md lacks\n{row}");
        let source =
            if *file == "long" { include_str!("../long.rs") } else { include_str!("../training/divergence.rs") };
        assert!(source.contains(&format!("fn {name}()")), "there is no {file}::{name}");
    }
    let rows = text.lines().filter(|l| l.contains("| `divergence::") || l.contains("| `long::")).count();
    assert_eq!(rows, TRAININGS.len(), "docs/how/extremes.md has a training too many");
}

/// Hazard, its treatment, and the files and functions of its tests.
type Hazard = (&'static str, &'static str, &'static [(&'static str, &'static str)]);

/// Numerical hazards of the method.
const HAZARDS: &[Hazard] = &[
    (
        "roughness near zero",
        "its square at least 1e-3; the peak is written without what cancels",
        &[("lights", "lights_at_extremes"), ("shading_properties", "shaded_lights_match_reference")],
    ),
    (
        "pixels of the background, whatever they hold",
        "not shaded; gradients stay as they are",
        &[("lights", "lights_skip_pixels_without_surface"), ("gbuffer", "single_pixel_and_empty_views_are_handled")],
    ),
    (
        "grazing views and lights",
        "the cosine of the view is at least 1e-4, lights below the horizon add nothing",
        &[("lights", "lights_at_extremes"), ("shading_properties", "shaded_lights_match_reference")],
    ),
    (
        "normals that face away",
        "as at grazing views",
        &[("lights", "lights_at_extremes"), ("environment", "environment_light_and_gradients_match_reference")],
    ),
    (
        "light opposite the camera: no half vector",
        "its length squared is at least 1e-16",
        &[("lights", "a_light_opposite_the_camera_is_finite"), ("lights", "lights_at_extremes")],
    ),
    (
        "a light in the surface",
        "distances squared at least 1e-3",
        &[("lights", "lights_skip_pixels_without_surface"), ("lights", "lights_at_extremes")],
    ),
    (
        "sharpness without bound",
        "its logarithm at most 9.5; cosines less one as half the square of a difference",
        &[("lights", "lights_at_extremes")],
    ),
    ("amplitude without bound", "its logarithm at most 15", &[("lights", "lights_at_extremes")]),
    (
        "saturated pixels",
        "no gradient, or only one that leads back; they are counted",
        &[("material_images", "composed_images_match_reference")],
    ),
    (
        "texels of the environment map below zero",
        "zero after each step",
        &[
            ("environment", "the_background_is_the_cube_along_rays_and_negative_texels_become_black"),
            ("environment", "training_leaves_no_texel_below_zero"),
        ],
    ),
    (
        "opacity near one at a pixel",
        "at most 0.99",
        &[
            ("splat_bwd", "hard_splats_have_finite_gradients"),
            ("extremes", "opacities_at_both_ends"),
            ("properties", "render_gradients_match_reference"),
        ],
    ),
    (
        "depths whose squares overflow",
        "blended as 1e18 at most, without a gradient beyond",
        &[("extremes", "positions_far_away")],
    ),
    (
        "opacity near zero where it divides",
        "at least 1e-3; pixels below are not shaded",
        &[("geometry_loss", "geometry_loss_at_extremes"), ("gbuffer", "gbuffer_and_materials_match_reference")],
    ),
    (
        "variance of depth that cancels",
        "at least 1e-6, no gradient below",
        &[("geometry_loss", "geometry_loss_at_odd_sizes"), ("loss_properties", "surface_losses_match_reference")],
    ),
    (
        "degenerate covariances",
        "0.3 px² more on the diagonal; no determinant of products; logarithms of scales within -16 and 8",
        &[
            ("extremes", "scales_down_to_nothing"),
            ("extremes", "scales_beyond_the_room"),
            ("properties", "gaussian_of_condition_1e17_is_rendered_in_place"),
        ],
    ),
    (
        "splats whose numbers are not finite",
        "not drawn, and without gradients, for a position, a scale or an opacity (infinite or NaN); quaternions are no rotation; colors of NaN are black, infinite ones as the largest that there are",
        &[
            ("extremes", "positions_that_are_no_numbers"),
            ("extremes", "scales_that_are_no_numbers"),
            ("extremes", "opacities_that_are_no_numbers"),
            ("extremes", "quaternions_that_are_no_numbers"),
            ("extremes", "colors_without_bound"),
        ],
    ),
    (
        "quaternions of zero, where splats are drawn and where they are split",
        "no rotation",
        &[
            ("extremes", "quaternions_without_direction"),
            ("densify", "splits_of_degenerate_quaternions_match_reference"),
        ],
    ),
    (
        "normals of zero",
        "no direction; blended ones are divided by 1e-3 at least, so what is asked of them is a thousand times as large at most; those that light learns have no gradient",
        &[("geometry_loss", "geometry_loss_at_extremes"), ("learned_normals", "extremes_are_finite")],
    ),
    (
        "empty masks of regions",
        "fewer than 16 pixels are no evidence",
        &[
            ("correspondence", "small_regions_have_no_correspondence"),
            ("material_losses", "small_regions_and_equal_means_have_zero_gradient"),
        ],
    ),
    (
        "logarithm of zero in cross-entropy",
        "logarithm and softmax are one",
        &[("semantic", "semantic_loss_at_extremes")],
    ),
    (
        "arc cosine of more than one, between poses",
        "the cosine is at most one",
        &[("tools/train/src/pseudo/path", "equal_orientations_have_no_angle")],
    ),
    (
        "priors that are not numbers",
        "masked, each pixel by itself",
        &[
            ("meaning", "invalid_semantic_priors_are_skipped_or_named"),
            ("nan_priors", "all_nan_priors_equal_no_priors"),
        ],
    ),
    (
        "priors that are missing",
        "the loss is absent",
        &[
            ("nan_priors", "all_nan_priors_equal_no_priors"),
            ("geometry_loss", "geometry_loss_of_a_model_that_lacks_something"),
        ],
    ),
    (
        "points outside of the visibility field",
        "taken to its faces; the box follows from splats and cameras",
        &[
            ("visibility", "values_are_finite_at_the_edges"),
            ("tools/train/src/intrinsic/data", "scene_box_contains_splats_and_cameras"),
        ],
    ),
    ("densification of what nobody has seen", "a mean over one at least", &[("densify", "densify_of_one_kind_only")]),
    (
        "the norm of a difference of zero",
        "no gradient",
        &[
            ("correspondence", "correspondence_at_extremes"),
            ("material_losses", "small_regions_and_equal_means_have_zero_gradient"),
        ],
    ),
    (
        "the cosine with a vector of zero",
        "left out of the sum, no gradient",
        &[("semantic", "semantic_loss_at_extremes"), ("semantic", "pixels_without_labels_are_skipped_and_counted")],
    ),
    (
        "Adam of gradients next to nothing",
        "epsilon of 1e-15; gradients of exactly zero move nothing, but with `geometry.dense_adam`",
        &[("optim", "adam_survives_extreme_gradients")],
    ),
    (
        "sums whose order is chance",
        "a fixed order, or integers; atomics of floats only where they are asked for",
        &[
            ("splat_bwd", "backward_kernels_agree_on_many_gaussians_bit_for_bit"),
            ("environment", "sums_do_not_depend_on_order_or_groups"),
        ],
    ),
    (
        "normals along an axis",
        "opacity says where a surface is, not components of zero",
        &[("environment", "white_is_white_and_nothing_is_created")],
    ),
    (
        "angles between equal and opposite normals",
        "by arc tangent",
        &[("tools/evaluate/src/metrics/normal", "parallel_vectors_have_no_angle")],
    ),
    (
        "rays that meet no surfel",
        "meet a patch of the enclosure",
        &[("transport", "every_ray_leaves_through_a_patch"), ("transport_extremes", "no_surfel")],
    ),
    (
        "discs seen edge-on or from behind",
        "missed",
        &[("transport", "edge_on_discs_are_missed_and_backs_are_transparent")],
    ),
    (
        "a receiver in a physical light",
        "points, spots and lobes count as 0.03 away at least; inside of a sphere, the whole hemisphere is bright",
        &[
            ("transport_lights", "degenerate_receivers_match_reference"),
            ("transport_lights", "lobes_are_points_at_zero_and_narrow_at_1e4"),
            ("transport_extremes", "lights_in_surfels"),
            ("transport_extremes", "a_light_around_the_room"),
        ],
    ),
    (
        "a reflecting pixel whose roughness, position or normal is no number, or that is seen edge-on or from behind",
        "no ray, the gathered irradiance instead; the view is raised to a cosine of 0.01",
        &[("transport_reflect", "extreme_pixels_match_reference")],
    ),
    (
        "light that never leaves: a reflectance of 1 in a closed room",
        "iterations end at their largest number",
        &[("transport_extremes", "albedo_of_one_in_a_closed_room")],
    ),
];

/// docs/how/extremes.md lists every hazard.
///
/// A test is a function in a file of the tests, or in a file given by its path.
#[test]
fn the_documentation_lists_every_hazard() {
    let text = include_str!("../../../docs/how/extremes.md");
    let (_, section) = text.split_once("| hazard | remedy | test |\n|---|---|---|\n").expect("a table of hazards");
    let rows: Vec<&str> = section.lines().take_while(|l| l.starts_with('|')).collect();
    assert_eq!(rows.len(), HAZARDS.len(), "hazards in docs/how/extremes.md");
    for ((hazard, done, tests), row) in HAZARDS.iter().zip(rows) {
        let all: Vec<String> = tests.iter().map(|(file, name)| format!("`{file}::{name}`")).collect();
        assert_eq!(row, format!("| {hazard} | {done} | {} |", all.join(", ")), "docs/how/extremes.md");
        for (file, name) in *tests {
            let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
            let places = ["..", "tests", "tests/device", "tests/alone", "tests/training", "tests/command"];
            let mut paths = places.iter().map(|place| root.join(place).join(format!("{file}.rs")));
            let source = paths.find_map(|path| std::fs::read_to_string(path).ok());
            let source = source.unwrap_or_else(|| panic!("there is no file {file}.rs"));
            let line = source.lines().any(|l| l.trim_start().starts_with(&format!("{name}: \"")));
            assert!(
                line || source.contains(&format!("#[test]\nfn {name}()"))
                    || source.contains(&format!("#[test]\n    fn {name}()")),
                "there is no {file}::{name}"
            );
        }
    }
}
