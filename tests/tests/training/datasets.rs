//! Training and evaluation on a data set in the layout of InteriorVerse.
//!
//! The exposure is chosen, recorded and retained. Invalid pixels count neither in training nor in metrics. Evaluation
//! uses the ground truth beside the images.

use sgs_scene::{
    GroundTruth, GroundTruthKind, Image, LoadOptions, NormalFrame, Scene, SceneOptions, write_exr, write_png,
};
use sgs_tests::Place;
use sgs_tests::cli::sgs;
use sgs_tests::rooms::{Room, transforms, write_json};

/// Returns whether a pixel is invalid.
///
/// Invalid pixels form a block, which is saturated in one view and black in the next.
fn invalid(pixel: usize) -> bool {
    pixel % 32 < 10 && pixel / 32 < 12
}

/// Writes the room in `scene` to `release` in the layout of InteriorVerse.
fn write_release(place: &Place) {
    let (scene, release) = (place.path("scene"), place.path("release"));
    std::fs::create_dir(&release).unwrap();
    let room = Scene::open(&scene, &SceneOptions::default()).unwrap();
    let truth = GroundTruth::of(&room);
    let mut cameras = transforms(&Room::default().cameras());
    for (i, view) in room.views.iter().enumerate() {
        let put = |kind: &str, image: &Image| {
            write_exr(&release.join(format!("{i:03}_{kind}.exr")), image, &["R", "G", "B"][..image.channels as usize])
                .unwrap();
        };
        let mut light = view.load_linear(&LoadOptions { exposure: 1.0, ..Default::default() }).unwrap();
        light.data.iter_mut().for_each(|v| *v *= 32.0);
        for (p, pixel) in light.data.chunks_exact_mut(3).enumerate().filter(|(p, _)| invalid(*p)) {
            pixel.fill(if i % 2 == 0 { f32::NAN } else { 4000.0 + p as f32 });
        }
        put("im", &light);
        let mut depth = truth.load(GroundTruthKind::Depth, i).unwrap().unwrap();
        depth.data.iter_mut().for_each(|d| *d *= 1000.0);
        put("depth", &depth);
        let mut normal = truth.load(GroundTruthKind::Normal, i).unwrap().unwrap();
        let to_camera = NormalFrame::CameraOpengl.to_world(view.camera.rotation).transpose();
        for n in normal.data.chunks_exact_mut(3) {
            let v = to_camera * glam::DVec3::new(f64::from(n[0]), f64::from(n[1]), f64::from(n[2]));
            n.copy_from_slice(&v.as_vec3().to_array());
        }
        put("normal", &normal);
        let mut mask = Image::new(32, 24, 1);
        mask.data.iter_mut().enumerate().for_each(|(p, v)| *v = f32::from(u8::from(!invalid(p))));
        write_png(&release.join(format!("{i:03}_mask.png")), &mask).unwrap();
        let frame = &mut cameras["frames"][i];
        frame["file_path"] = format!("{i:03}_im.exr").into();
        frame["split"] = if i % 4 == 1 { "test" } else { "train" }.into();
    }
    write_json(&release.join("transforms.json"), &cameras);
    std::fs::copy(scene.join("points.ply"), release.join("points.ply")).unwrap();
}

#[test]
fn interiorverse_trains_and_is_measured() {
    let place = Place::new(Room { truth: true, ..Room::default() });
    write_release(&place);
    let train = |run: &str, more: &[&str]| {
        let (scene, run) = (place.text("release"), place.text(run));
        let mut arguments = vec!["train", &scene, "-o", &run, "--geometry-steps", "40", "--no-densify"];
        arguments.extend(more);
        sgs(&arguments)
    };
    let exposure_of = |run: &str| -> f64 {
        let config = String::from_utf8(place.read(&format!("{run}/config.toml"))).unwrap();
        let value = config.lines().find_map(|line| line.strip_prefix("exposure = "));
        value.expect("the exposure is recorded").parse().unwrap()
    };
    let psnr = |run: &str| {
        let eval = sgs(&["--json", "eval", &place.text(run)]).ok().json();
        assert_eq!(eval["views"].as_array().unwrap().len(), 2);
        (eval["mean"]["nvs"]["psnr"].as_f64().unwrap(), eval["mean"].clone())
    };
    train("masked", &[]).ok();
    // The images are 32 times as bright as the room. The recorded exposure is a power of two that corrects most of
    // that.
    let exposure = exposure_of("masked");
    assert!((1.0 / 64.0..=1.0 / 4.0).contains(&exposure) && exposure.log2().fract() == 0.0, "{exposure}");
    let (masked, mean) = psnr("masked");
    assert!(mean["normal_mae_deg"].as_f64().unwrap() < 90.0 && mean["depth_rel"].as_f64().unwrap() < 0.5, "{mean}");
    // If invalid pixels counted, they would dominate training and metrics.
    train("all", &["--set", "masks=false"]).ok();
    let (all, _) = psnr("all");
    assert!(masked > all + 3.0, "{masked} dB and {all} dB");

    // Resuming retains the recorded exposure.
    train("masked", &["--resume", "--set", "exposure=0"]).ok();
    assert_eq!(exposure_of("masked"), exposure);
}
