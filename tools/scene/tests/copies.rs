//! MipNeRF-360, DL3DV and VGGT directories. They have the layouts of COLMAP and nerfstudio with downscaled copies of
//! the images.

mod common;

use std::path::Path;

use common::open;
use common::written::{Seat, assert_sees, encoded, rgba, seats};
use glam::{DMat3, DQuat, DVec2};
use sgs_scene::{Layout, PointCloud};

/// Returns the camera of the full-size photograph of a copy in `images_4`. The photograph is four times as large as the
/// copy.
fn full(seat: &Seat) -> Seat {
    Seat { focal: seat.focal * 4.0, center: seat.center * 4.0, size: (seat.size.0 * 4, seat.size.1 * 4), ..*seat }
}

fn write_image(path: &Path, seat: &Seat) {
    let color = |hit: &common::written::Hit| {
        let [r, g, b] = hit.light().map(encoded);
        [r, g, b, 1.0]
    };
    rgba(path, seat.size, &seat.hits().iter().map(color).collect::<Vec<_>>());
}

/// Returns the world-to-camera pose in COLMAP's representation.
fn pose(seat: &Seat) -> ([f64; 4], [f64; 3]) {
    let rotation = DMat3::from_cols(seat.right, -seat.up, seat.ahead).transpose();
    let q = DQuat::from_mat3(&rotation);
    ([q.w, q.x, q.y, q.z], (-(rotation * seat.origin)).to_array())
}

/// Writes a binary model with one PINHOLE camera.
fn write_binary(folder: &Path, names: &[String], seats: &[Seat]) {
    std::fs::create_dir_all(folder).unwrap();
    let big = &seats[0];
    let mut cameras = 1_u64.to_le_bytes().to_vec();
    cameras.extend(1_u32.to_le_bytes());
    cameras.extend(1_i32.to_le_bytes());
    [big.size.0, big.size.1].iter().for_each(|&n| cameras.extend(u64::from(n).to_le_bytes()));
    let DVec2 { x, y } = big.focal;
    [x, y, big.center.x, big.center.y].iter().for_each(|v| cameras.extend(v.to_le_bytes()));
    let mut images = (names.len() as u64).to_le_bytes().to_vec();
    for (i, (name, seat)) in names.iter().zip(seats).enumerate() {
        let (q, t) = pose(seat);
        images.extend((i as u32 + 1).to_le_bytes());
        q.iter().chain(&t).for_each(|v| images.extend(v.to_le_bytes()));
        images.extend(1_u32.to_le_bytes());
        images.extend(name.as_bytes());
        images.push(0);
        images.extend(0_u64.to_le_bytes());
    }
    std::fs::write(folder.join("cameras.bin"), cameras).unwrap();
    std::fs::write(folder.join("images.bin"), images).unwrap();
}

fn one_point() -> PointCloud {
    PointCloud { positions: vec![[0.5, -1.0, 2.0]], ..Default::default() }
}

#[test]
fn mip_nerf_360_is_read_with_and_without_full_size_images() {
    let directory = tempfile::tempdir().unwrap();
    let root = directory.path();
    let small = seats(9);
    let large: Vec<Seat> = small.iter().map(full).collect();
    // Copies of JPEG photographs are often PNG.
    let names: Vec<String> = (0..9).map(|i| format!("DSC0{i:04}.JPG")).collect();
    write_binary(&root.join("sparse/0"), &names, &large);
    std::fs::write(root.join("sparse/0/points3D.bin"), 0_u64.to_le_bytes()).unwrap();
    one_point().write_ply(&root.join("sparse/0/points3D.ply")).unwrap();
    for (i, seat) in small.iter().enumerate() {
        write_image(&root.join(format!("images_4/DSC0{i:04}.png")), seat);
        let tiny = Seat { focal: seat.focal / 2.0, center: seat.center / 2.0, size: (24, 20), ..*seat };
        write_image(&root.join(format!("images_8/DSC0{i:04}.png")), &tiny);
    }
    let scene = open(root);
    assert_eq!((scene.layout, scene.views.len(), scene.points_are_random), (Layout::Colmap, 9, false));
    assert_eq!(scene.warnings, Vec::<String>::new());
    small.iter().zip(&scene.views).for_each(|(seat, view)| assert_sees(&view.camera, seat));
    assert_eq!(scene.load_image(0).unwrap().width, 48);

    for (i, seat) in large.iter().enumerate() {
        write_image(&root.join(format!("images/DSC0{i:04}.png")), seat);
    }
    let scene = open(root);
    large.iter().zip(&scene.views).for_each(|(seat, view)| assert_sees(&view.camera, seat));
    // An image whose size matches neither the camera nor a copy is rejected.
    std::fs::remove_dir_all(root.join("images")).unwrap();
    let wrong = Seat { size: (48, 33), ..small[3] };
    write_image(&root.join("images_4/DSC00003.png"), &wrong);
    let error = sgs_scene::Scene::open(root, &Default::default()).unwrap_err().to_string();
    assert!(error.contains("DSC00003.png is 48×33 pixels, but ") && error.contains("gives 192×160"), "{error}");
}

#[test]
fn dl3dv_is_read_from_every_location_of_its_file() {
    let small = seats(9);
    let frames = |folder: &str| {
        let frame = |(i, seat): (usize, &Seat)| {
            format!("{{\"file_path\": \"{folder}/frame_{:05}.png\", \"transform_matrix\": {}}}", i + 1, seat.opengl())
        };
        let frames: Vec<String> = small.iter().enumerate().map(frame).collect();
        format!(
            "{{\"w\": 192, \"h\": 160, \"fl_x\": 120, \"fl_y\": 128, \"cx\": 76, \"cy\": 70, \"k1\": 0, \"frames\": [{}]}}",
            frames.join(",")
        )
    };
    // Location of the file, image folder in the file, and actual image folder.
    for (file, named, folder) in [
        ("transforms.json", "images", "images_4"),
        ("transforms.json", "gaussian_splat/images_4", "gaussian_splat/images_4"),
        ("transforms.json", "gaussian_splat/images", "gaussian_splat/images_4"),
        ("gaussian_splat/transforms.json", "images_4", "gaussian_splat/images_4"),
        ("nerfstudio/transforms.json", "images", "nerfstudio/images_4"),
    ] {
        let directory = tempfile::tempdir().unwrap();
        let root = directory.path();
        for (i, seat) in small.iter().enumerate() {
            write_image(&root.join(folder).join(format!("frame_{:05}.png", i + 1)), seat);
        }
        std::fs::write(root.join(file), frames(named)).unwrap();
        let scene = open(root);
        assert_eq!((scene.layout, scene.views.len()), (Layout::Transforms, 9), "{file} {named}");
        assert_eq!(scene.views[8].camera.name, "frame_00009");
        small.iter().zip(&scene.views).for_each(|(seat, view)| assert_sees(&view.camera, seat));
    }
}

#[test]
fn vggt_exports_are_read_in_binary_and_text_form() {
    let seats = seats(9);
    let names: Vec<String> = (0..9).map(|i| format!("{i:03}.png")).collect();
    for text in [false, true] {
        let directory = tempfile::tempdir().unwrap();
        let root = directory.path();
        let folder = root.join("sparse");
        if text {
            std::fs::create_dir_all(&folder).unwrap();
            let mut images = "\u{feff}# written by an editor\n".to_string();
            let mut cameras = "\u{feff}# a camera for each image\n".to_string();
            for (i, seat) in seats.iter().enumerate() {
                let (q, t) = pose(seat);
                let numbers: Vec<String> = q.iter().chain(&t).map(f64::to_string).collect();
                images.push_str(&format!("{} {} {} {}\n\n", i + 1, numbers.join(" "), i + 1, names[i]));
                let (f, c) = (seat.focal, seat.center);
                cameras.push_str(&format!("{} PINHOLE 48 40 {} {} {} {}\n", i + 1, f.x, f.y, c.x, c.y));
            }
            std::fs::write(folder.join("images.txt"), images).unwrap();
            std::fs::write(folder.join("cameras.txt"), cameras).unwrap();
        } else {
            write_binary(&folder, &names, &seats);
        }
        one_point().write_ply(&folder.join("points.ply")).unwrap();
        for (name, seat) in names.iter().zip(&seats) {
            write_image(&root.join("images").join(name), seat);
        }
        let scene = open(root);
        assert_eq!((scene.layout, scene.views.len()), (Layout::Colmap, 9));
        assert_eq!((scene.points.len(), scene.warnings.len()), (1, 0));
        seats.iter().zip(&scene.views).for_each(|(seat, view)| assert_sees(&view.camera, seat));
    }
}
