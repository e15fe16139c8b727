//! InteriorVerse's layout: files are written and read back.

mod common;

use std::path::Path;

use common::open;
use common::written::{Hit, Seat, assert_sees, encoded, exr, gray, seats, worst, worst_angle};
use sgs_scene::{DepthDefinition, GroundTruth, GroundTruthKind, Layout, Scene, SceneOptions};

/// Function that returns the depth of a hit in the file's unit.
type DepthOf = fn(&Hit) -> f64;

/// Parameters of a written scene.
struct Written {
    /// Numbers of the images.
    numbers: Vec<String>,
    /// Depth of a hit in the file's unit.
    depth: DepthOf,
    /// Factor on the light of a view.
    brightness: fn(usize) -> f32,
    /// Whether a pixel is invalid.
    invalid: fn(usize) -> bool,
}

impl Default for Written {
    fn default() -> Self {
        Self {
            numbers: (0..9).map(|i| format!("{i:03}")).collect(),
            depth: |hit| 1000.0 * hit.z,
            brightness: |_| 1.0,
            invalid: |pixel| pixel % 48 < 6 && pixel / 48 < 9,
        }
    }
}

impl Written {
    /// Writes the scene and returns its cameras.
    fn write(&self, root: &Path) -> Vec<Seat> {
        let seats = seats(self.numbers.len());
        let mut frames = Vec::new();
        for (i, (seat, number)) in seats.iter().zip(&self.numbers).enumerate() {
            let hits = seat.hits();
            let put = |kind: &str, value: &dyn Fn(&Hit) -> [f32; 3], invalid: [f32; 3]| {
                let of = |(p, hit)| if (self.invalid)(p) { invalid } else { value(hit) };
                let pixels: Vec<[f32; 3]> = hits.iter().enumerate().map(of).collect();
                exr(&root.join(format!("{number}_{kind}.exr")), seat.size, &pixels);
            };
            let scale = (self.brightness)(i);
            put("im", &|hit| hit.light().map(|v| v * scale), [f32::NAN; 3]);
            put("albedo", &|hit| hit.albedo(), [99.0; 3]);
            put("depth", &|hit| [(self.depth)(hit) as f32; 3], [f32::INFINITY; 3]);
            put("material", &|hit| [hit.roughness(), hit.metallic(), 0.77], [50.0; 3]);
            let axes = |hit: &Hit| [seat.right, seat.up, -seat.ahead].map(|axis| hit.normal.dot(axis) as f32);
            put("normal", &axes, [7.0, 0.0, 0.0]);
            let mask: Vec<u8> = (0..hits.len()).map(|p| if (self.invalid)(p) { 0 } else { 255 }).collect();
            gray(&root.join(format!("{number}_mask.png")), seat.size, &mask);
            let split = if i % 4 == 1 { "test" } else { "train" };
            frames.push(format!(
                "{{\"file_path\": \"{number}_im.exr\", \"split\": \"{split}\", \"transform_matrix\": {}}}",
                seat.opengl()
            ));
        }
        // The file order differs from the view order, and some editors write a byte-order mark.
        frames.reverse();
        let json = format!(
            "\u{feff}\n {{\"fl_x\": 30, \"fl_y\": 32, \"cx\": 19, \"cy\": 17.5, \"w\": 48, \"h\": 40, \"frames\": [{}]}}",
            frames.join(",\n")
        );
        std::fs::write(root.join("transforms.json"), json).unwrap();
        seats
    }

    fn scene(&self, change: impl FnOnce(&mut SceneOptions)) -> (tempfile::TempDir, Vec<Seat>, Scene) {
        let directory = tempfile::tempdir().unwrap();
        let seats = self.write(directory.path());
        let mut options = SceneOptions::default();
        change(&mut options);
        let scene = Scene::open(directory.path(), &options).unwrap();
        (directory, seats, scene)
    }
}

fn valid(pixel: usize) -> bool {
    !(Written::default().invalid)(pixel)
}

#[test]
fn cameras_images_and_split_are_read() {
    let (_keep, seats, scene) = Written::default().scene(|_| ());
    assert_eq!((scene.layout, scene.views.len()), (Layout::InteriorVerse, 9));
    assert_eq!(scene.split.test, [1, 5]);
    assert_eq!((scene.exposure(), scene.warnings.len()), (1.0, 0), "{:?}", scene.warnings);
    let start = scene.start_warnings().unwrap();
    assert!(start.len() == 1 && start[0].contains("has no point cloud; starting from"), "{start:?}");
    for (i, seat) in seats.iter().enumerate() {
        assert_eq!(scene.views[i].camera.name, format!("{i:03}_im"));
        assert_sees(&scene.views[i].camera, seat);
        let hits = seat.hits();
        let image = scene.load_image(i).unwrap();
        assert!(worst(&image, |p| hits[p].light().map(encoded).to_vec(), valid) < 1e-5);
    }
}

#[test]
fn ground_truth_is_in_world_space_and_scene_units() {
    let (_keep, seats, scene) = Written::default().scene(|_| ());
    let truth = GroundTruth::of(&scene);
    assert_eq!(truth.depth_definition().unwrap(), Some(DepthDefinition { unit: 1e-3, along_ray: false }));
    for (i, seat) in seats.iter().enumerate() {
        let hits = seat.hits();
        let get = |kind| truth.load(kind, i).unwrap().unwrap();
        // Normals in a wrong frame or with another camera's axes would have large errors.
        assert!(worst_angle(&get(GroundTruthKind::Normal), &hits, valid) < 0.01);
        assert!(worst(&get(GroundTruthKind::Depth), |p| vec![hits[p].z as f32], valid) < 1e-4);
        assert!(worst(&get(GroundTruthKind::Albedo), |p| hits[p].albedo().to_vec(), valid) < 1e-6);
        assert!(worst(&get(GroundTruthKind::Roughness), |p| vec![hits[p].roughness()], valid) < 1e-6);
        assert!(worst(&get(GroundTruthKind::Metallic), |p| vec![hits[p].metallic()], valid) < 1e-6);
        assert_eq!(worst(&get(GroundTruthKind::Mask), |p| vec![f32::from(u8::from(valid(p)))], |_| true), 0.0);
        for kind in [GroundTruthKind::Normal, GroundTruthKind::Depth, GroundTruthKind::Albedo] {
            let map = get(kind);
            let zero = vec![0.0; map.channels as usize];
            assert_eq!(worst(&map, |_| zero.clone(), |p| !valid(p)), 0.0, "{kind:?} at invalid pixels");
        }
    }
}

/// Depth becomes camera z in scene units under every definition.
#[test]
fn depth_of_every_definition_becomes_camera_z() {
    let millimeters_of_ray: DepthOf = |hit| 1000.0 * hit.distance;
    let meters: DepthOf = |hit| hit.z;
    let centimeters_of_ray: DepthOf = |hit| 100.0 * hit.distance;
    for (depth, unit, along_ray) in
        [(millimeters_of_ray, 1e-3, true), (meters, 1.0, false), (centimeters_of_ray, 1e-2, true)]
    {
        let (_keep, seats, scene) = Written { depth, ..Default::default() }.scene(|_| ());
        let truth = GroundTruth::of(&scene);
        assert_eq!(truth.depth_definition().unwrap(), Some(DepthDefinition { unit, along_ray }));
        let hits = seats[3].hits();
        let map = truth.load(GroundTruthKind::Depth, 3).unwrap().unwrap();
        assert!(worst(&map, |p| vec![hits[p].z as f32], valid) < 1e-4);
    }
    // Depth that fits no definition is not loaded; other maps still are.
    let (_keep, _, scene) = Written { depth: |hit| 3.3 * hit.z, ..Default::default() }.scene(|_| ());
    let truth = GroundTruth::of(&scene);
    assert_eq!(truth.depth_definition().unwrap(), None);
    assert!(truth.load(GroundTruthKind::Depth, 0).unwrap().is_none());
    assert!(truth.load(GroundTruthKind::Normal, 0).unwrap().is_some());
}

#[test]
fn exposure_is_chosen_from_the_training_views() {
    // Test views are bright enough to change the exposure if they were measured.
    let bright = Written { brightness: |i| if i % 4 == 1 { 1e4 } else { 16.0 }, ..Default::default() };
    let (_keep, seats, scene) = bright.scene(|_| ());
    assert_eq!((scene.exposure(), scene.options.exposure), (1.0 / 16.0, Some(1.0 / 16.0)));
    assert!(scene.warnings.iter().any(|w| w.contains("exposed by 0.0625, chosen from the training views")));
    let hits = seats[0].hits();
    let image = scene.load_image(0).unwrap();
    assert!(worst(&image, |p| hits[p].light().map(encoded).to_vec(), valid) < 1e-5);

    let (_keep, _, dark) = Written { brightness: |_| 1.0 / 64.0, ..Default::default() }.scene(|_| ());
    assert!([32.0, 64.0].contains(&dark.exposure()), "{}", dark.exposure());
    let (_keep, seats, scene) = Written::default().scene(|o| o.exposure = Some(0.5));
    assert_eq!((scene.exposure(), scene.warnings.len()), (0.5, 0));
    let hits = seats[2].hits();
    let half = |p: usize| hits[p].light().map(|v| encoded(0.5 * v)).to_vec();
    assert!(worst(&scene.load_image(2).unwrap(), half, valid) < 1e-5);
}

#[test]
fn invalid_pixels_are_excluded_and_do_not_spread() {
    let (keep, seats, scene) = Written::default().scene(|_| ());
    let mask = scene.load_mask(4).unwrap().unwrap();
    assert_eq!(worst(&mask, |p| vec![f32::from(u8::from(valid(p)))], |_| true), 0.0);
    assert!(scene.load_image(4).unwrap().data.iter().all(|v| v.is_finite()));

    // At half size, a pixel is valid only if all of it is valid. Rows 8 and 9 share a pixel that is half valid.
    let half = Scene::open(keep.path(), &SceneOptions { scale: 0.5, ..Default::default() }).unwrap();
    let mask = half.load_mask(4).unwrap().unwrap();
    assert_eq!((mask.width, mask.height), (24, 20));
    assert_eq!(
        [mask.pixel(0, 3)[0], mask.pixel(0, 4)[0], mask.pixel(0, 5)[0], mask.pixel(3, 4)[0]],
        [0.0, 0.0, 1.0, 1.0]
    );
    let hits = seats[4].hits();
    let truth = GroundTruth::of(&half);
    let albedo = truth.load(GroundTruthKind::Albedo, 4).unwrap().unwrap();
    // The invalid half of this pixel has the value 99.
    let expected = hits[9 * 48].albedo();
    assert!(albedo.pixel(0, 4).iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-5), "{:?}", albedo.pixel(0, 4));

    let options = SceneOptions { masks: sgs_scene::MaskUse::Ignored, ..Default::default() };
    assert!(Scene::open(keep.path(), &options).unwrap().load_mask(4).unwrap().is_none());
    std::fs::remove_file(keep.path().join("004_mask.png")).unwrap();
    let error = Scene::open(keep.path(), &SceneOptions::default()).unwrap_err().to_string();
    assert!(error.contains("004_im.exr: the pixel in column 0, row 0 is not a number"), "{error}");
}

/// Maps beside the images are ground truth and must not be loaded as priors.
#[test]
fn ground_truth_is_never_a_prior() {
    let (keep, _, scene) = Written::default().scene(|_| ());
    for i in 0..scene.views.len() {
        assert!(scene.albedo_prior(i).unwrap().is_none() && scene.normal_prior(i).unwrap().is_none());
        assert!(scene.roughness_prior(i).unwrap().is_none() && scene.metallic_prior(i).unwrap().is_none());
    }
    exr(&keep.path().join("priors/albedo/002_im.exr"), (48, 40), &[[0.125; 3]; 48 * 40]);
    let prior = open(keep.path()).albedo_prior(2).unwrap().unwrap();
    assert_eq!(prior.image.data[0], 0.125);
    // Training opens and loads a scene whose ground truth is unreadable.
    for kind in ["albedo", "normal", "depth", "material"] {
        std::fs::write(keep.path().join(format!("002_{kind}.exr")), "broken").unwrap();
    }
    let scene = open(keep.path());
    assert_eq!(scene.load_train_images().unwrap().len(), 7);
    let error = GroundTruth::of(&scene).load(GroundTruthKind::Albedo, 2).unwrap_err().to_string();
    assert!(error.contains("002_albedo.exr: the file cannot be read as EXR"), "{error}");
    // Maps in `gt` take precedence over maps beside the images.
    exr(&keep.path().join("gt/albedo/002_im.exr"), (48, 40), &[[0.25; 3]; 48 * 40]);
    assert_eq!(GroundTruth::of(&scene).load(GroundTruthKind::Albedo, 2).unwrap().unwrap().data[0], 0.25);
}

#[test]
fn numbers_sort_by_value_and_missing_images_cause_one_warning() {
    let numbers: Vec<String> = ["8", "9", "10", "11", "100"].map(String::from).to_vec();
    let written = Written { numbers, ..Default::default() };
    let (keep, seats, scene) = written.scene(|_| ());
    let names: Vec<&str> = scene.views.iter().map(|v| v.camera.name.as_str()).collect();
    assert_eq!(names, ["8_im", "9_im", "10_im", "11_im", "100_im"]);
    seats.iter().zip(&scene.views).for_each(|(seat, view)| assert_sees(&view.camera, seat));
    for name in ["9_im.exr", "100_im.exr"] {
        std::fs::remove_file(keep.path().join(name)).unwrap();
    }
    let scene = open(keep.path());
    assert_eq!(scene.views.len(), 3);
    let warnings: Vec<&String> = scene.warnings.iter().filter(|w| w.contains("skipped")).collect();
    assert_eq!(warnings.len(), 1);
    assert!(warnings[0].starts_with("2 of 5 frames in "), "{}", warnings[0]);
}

#[test]
fn cameras_are_read_from_a_list_of_origins_and_targets() {
    let directory = tempfile::tempdir().unwrap();
    let root = directory.path();
    let seats = Written::default().write(root);
    std::fs::remove_file(root.join("transforms.json")).unwrap();
    let (poses, matrices) = common::written::look_at_lists(&seats);
    std::fs::write(root.join("cam.txt"), poses).unwrap();
    std::fs::write(root.join("K_list.txt"), matrices).unwrap();
    let scene = open(root);
    assert_eq!((scene.layout, scene.views.len()), (Layout::InteriorVerse, 9));
    seats.iter().zip(&scene.views).for_each(|(seat, view)| assert_sees(&view.camera, seat));
    let normal = GroundTruth::of(&scene).load(GroundTruthKind::Normal, 7).unwrap().unwrap();
    assert!(worst_angle(&normal, &seats[7].hits(), valid) < 0.01);
}

#[test]
fn each_error_has_its_message() {
    let fail = |change: &dyn Fn(&Path)| {
        let directory = tempfile::tempdir().unwrap();
        Written::default().write(directory.path());
        change(directory.path());
        let opened = Scene::open(directory.path(), &SceneOptions::default());
        let truth = |scene: &Scene| GroundTruth::of(scene).load(GroundTruthKind::Normal, 2).map(|_| ());
        let error = opened.and_then(|scene| truth(&scene)).unwrap_err().to_string();
        error.replace(&format!("{}/", directory.path().display()), "")
    };
    let replace = |root: &Path, from: &str, to: &str| {
        let path = root.join("transforms.json");
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.contains(from), "{from}");
        std::fs::write(path, text.replacen(from, to, 1)).unwrap();
    };
    let small = |name: &str| {
        let name = name.to_string();
        move |root: &Path| exr(&root.join(&name), (47, 40), &[[0.5; 3]; 47 * 40])
    };
    let error = fail(&|root| std::fs::remove_file(root.join("transforms.json")).unwrap());
    assert!(
        error.contains("holds InteriorVerse images (000_im.exr) without cameras; put a transforms.json"),
        "{error}"
    );
    let error = fail(&small("003_im.exr"));
    assert!(error.contains("003_im.exr is 47×40 pixels, but transforms.json gives 48×40"), "{error}");
    let error = fail(&small("002_normal.exr"));
    assert!(error.contains("002_normal.exr: the map is 47×40 pixels, but its image 002_im.exr is 48×40"), "{error}");
    let error = fail(&|root| gray(&root.join("002_mask.png"), (48, 39), &[255; 48 * 39]));
    assert!(error.contains("002_mask.png: the map is 48×39 pixels, but its image 002_im.exr"), "{error}");
    let error = fail(&|root| replace(root, "\"frames\": [", "\"frames\": [], \"was\": ["));
    assert!(error.contains("transforms.json: the list of frames is empty"), "{error}");
    let error = fail(&|root| replace(root, "\"fl_x\": 30,", ""));
    assert!(error.contains("frame 0 (008_im.exr): there is no focal length"), "{error}");
    let error = fail(&|root| replace(root, "[[", "[[1e999, "));
    assert!(error.contains("transforms.json, line 2") && error.contains("number out of range"), "{error}");
    let error = fail(&|root| std::fs::write(root.join("001_im.exr"), "broken").unwrap());
    assert!(error.contains("001_im.exr: the file cannot be read as EXR"), "{error}");
    let error = fail(&|root| {
        for i in 0..9 {
            std::fs::rename(root.join(format!("{i:03}_im.exr")), root.join(format!("1{i:03}_im.exr"))).unwrap();
        }
    });
    assert!(error.contains("none of the 9 frames has its image (the first should be 008_im.exr)"), "{error}");
}
