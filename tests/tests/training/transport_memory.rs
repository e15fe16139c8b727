//! Planned device memory of the transport stage, against what runs allocate.

use serde_json::Value;
use sgs_passes::pipeline::TransportShape;
use sgs_scene::{Scene, SceneOptions, Splats};
use sgs_tests::cli::sgs;
use sgs_tests::rooms::Room;
use sgs_tests::{Gpu, Place};
use sgs_train::FitNeeds;
use sgs_transport::{RoomOptions, fit_room, planned_patches};

/// Synthesizes a small room and trains its geometry and materials.
fn place() -> Place {
    let place = Place::new(Room::default());
    std::fs::remove_dir_all(place.path("scene")).unwrap();
    sgs(&["synth", &place.text("scene"), "--scene", "box", "--views", "8", "--size", "32x24"]).ok();
    let (scene, run) = (place.text("scene"), place.text("run"));
    let small =
        ["--geometry-steps", "20", "--no-densify", "--intrinsic-steps", "2", "--set", "intrinsic.lights.grid=2"];
    for stage in ["geometry", "intrinsic"] {
        sgs(&[&["train", &scene, "-o", &run, "--stage", stage][..], &small].concat()).ok();
    }
    place
}

#[test]
fn plan_bounds_the_memory_of_a_run() {
    let place = place();
    let (scene, run, start) = (place.text("scene"), place.text("run"), place.text("run/scene.ply"));
    let set = ["--set", "transport.surfels=256", "--set", "transport.steps=12"];
    let plan = |more: &[&str]| {
        sgs(&[&["plan", &scene, "--stage", "transport", "--start", &start][..], &set, more].concat()).ok()
    };
    let (json, text) = (plan(&["--json"]).json(), plan(&[]).stdout);
    sgs(&[&["train", &scene, "-o", &run, "--stage", "transport"][..], &set].concat()).ok();
    let summary: Value = serde_json::from_slice(&place.read("run/training.json")).unwrap();
    let of = |value: &Value| value.as_u64().unwrap();
    let (planned, real) = (of(&json["peak_bytes"]), of(&summary["transport"]["peak_device_bytes"]));
    assert!(real <= planned && planned <= real + real / 2, "{real} of {planned} planned bytes");
    assert_eq!(planned, of(&json["needs_bytes"]).max(of(&json["fit_bytes"])));
    let part = |name: &str| of(&json["fit"][name]);
    assert_eq!(of(&json["fit_bytes"]), part("shading").max(part("room") + part("light") + part("staging")));
    for word in ["MiB shading of the views", "MiB responses, receivers and samples", "peak   "] {
        assert!(text.contains(word), "{word}: {text}");
    }
}

#[test]
fn needs_bound_the_memory_of_a_fit() {
    let (gpu, place) = (Gpu::new(), place());
    let scene = Scene::open(&place.path("scene"), &SceneOptions::default()).unwrap();
    let splats = Splats::read_ply(&place.path("run/scene.ply")).unwrap();
    let cameras: Vec<_> = scene.split.train.iter().map(|&i| scene.views[i].camera.clone()).collect();
    let patches = planned_patches(&splats, &cameras).unwrap();
    let device = gpu.device();
    // With few rays shading is the largest part; with many it is the room.
    for (surfels, rays) in [(64, 16), (256, 64), (256, 1024)] {
        let shape = TransportShape::largest(16, surfels, patches, rays, splats.len() as u32);
        let needs = FitNeeds::of(device, &scene, &splats, &shape).unwrap();
        let options = RoomOptions { surfels: surfels as usize, rays, ..RoomOptions::default() };
        let (fitted, real) = device.memory_during(|| fit_room(device, &scene, &splats, options));
        assert!(!fitted.unwrap().emitters.emitters.is_empty());
        let planned = needs.peak();
        println!("{surfels} surfels, {rays} rays: {real} bytes, {needs:?}");
        assert!(real <= planned && planned <= real + real / 2, "{surfels}, {rays}: {real} of {planned} bytes");
    }
    let bare = Splats { albedo: None, roughness: None, normals: None, ..splats };
    let shape = TransportShape::largest(16, 64, patches, 16, bare.len() as u32);
    assert!(FitNeeds::of(device, &scene, &bare, &shape).unwrap().shading > 0);
}
