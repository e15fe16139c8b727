//! Valid files: those around a damaged file, and the initial files of the corpus.

mod binary;
mod corpus;
mod text;

pub(crate) use binary::{exr_sky, png};
pub use corpus::write_seeds;
pub(crate) use text::{LIGHTS, SETTINGS, SPLATS_ASCII, unsized_transforms};

use crate::place::Place;
use text::*;

/// Binary form of COLMAP's files.
pub(crate) const COLMAP: bool = true;
/// Text form of COLMAP's files.
pub(crate) const TEXT: bool = false;

/// Writes two photographs with a transforms file, a split and class names.
pub(crate) fn scene(place: &Place) {
    place.put("transforms.json", TRANSFORMS.as_bytes());
    place.put("split.json", SPLIT.as_bytes());
    place.put("priors/priors.json", PRIORS.as_bytes());
    place.put("priors/semantic/labels.json", LABELS.as_bytes());
    place.put("priors/semantic/text_embeddings.npy", &binary::npy("<f4", &[2, 3], 4));
    place.put("priors/semantic/000.npy", &binary::npy("<f2", &[2, 3, 3], 2));
    place.put("images/000.png", &png(8, 6));
    place.put("images/001.png", &png(8, 6));
    place.put("mask/000.png", &binary::gray(8, 6));
    place.put("depth/000.png", &binary::gray16(8, 6));
}

/// Writes the same scene with held-out frames in a separate file.
pub(crate) fn scene_held_out(place: &Place) {
    scene(place);
    place.put("split.json", br#"{"train": ["000", "001"], "test": ["002", "003"]}"#);
    place.put("transforms_test.json", HELD_OUT.as_bytes());
    place.put("images/002.png", &png(8, 6));
    place.put("images/003.jpg", &binary::jpeg(8, 6));
}

/// Writes a scene in TensoIR's layout.
pub(crate) fn blender(place: &Place) {
    place.put("transforms_train.json", BLENDER.as_bytes());
    place.put("transforms_test.json", &BLENDER.replace("train_", "test_").into_bytes());
    for folder in ["train_000", "train_001", "test_000", "test_001"] {
        for name in ["rgba", "albedo", "normal", "rgba_sunset"] {
            place.put(&format!("{folder}/{name}.png"), &binary::rgba(8, 6));
        }
    }
}

/// Writes a scene in InteriorVerse's layout.
pub(crate) fn interiorverse(place: &Place) {
    place.put("transforms.json", INTERIORVERSE.as_bytes());
    for number in ["000", "001"] {
        for kind in ["im", "albedo", "normal", "material"] {
            place.put(&format!("{number}_{kind}.exr"), &binary::exr(8, 6, &["R", "G", "B"], true));
        }
        place.put(&format!("{number}_depth.exr"), &binary::exr(8, 6, &["Y"], false));
        place.put(&format!("{number}_mask.png"), &binary::gray(8, 6));
    }
}

/// Writes a scene in FIPT's layout of real captures.
pub(crate) fn fipt(place: &Place) {
    place.put("cam.txt", FIPT_CAMERAS.as_bytes());
    place.put("K_list.txt", FIPT_MATRICES.as_bytes());
    for number in ["000", "001"] {
        place.put(&format!("Image/{number}_0001.exr"), &binary::exr(8, 6, &["R", "G", "B"], true));
    }
}

/// Writes a scene in FIPT's layout of synthetic scenes.
pub(crate) fn fipt_synthetic(place: &Place) {
    for split in ["train", "val"] {
        place.put(&format!("{split}/transforms.json"), FIPT_TRANSFORMS.as_bytes());
        for number in ["000", "001"] {
            for folder in ["Image", "DiffCol", "Roughness"] {
                let exr = binary::exr(8, 6, &["R", "G", "B"], false);
                place.put(&format!("{split}/{folder}/{number}_0001.exr"), &exr);
            }
        }
    }
}

/// Writes a COLMAP model with two photographs.
pub(crate) fn colmap(place: &Place, binary: bool) {
    if binary {
        place.put("sparse/0/cameras.bin", &binary::colmap_cameras());
        place.put("sparse/0/images.bin", &binary::colmap_images());
        place.put("sparse/0/points3D.bin", &binary::colmap_points());
    } else {
        place.put("sparse/0/cameras.txt", COLMAP_CAMERAS.as_bytes());
        place.put("sparse/0/images.txt", COLMAP_IMAGES.as_bytes());
        place.put("sparse/0/points3D.txt", COLMAP_POINTS.as_bytes());
    }
    place.put("images/000.png", &png(8, 6));
    place.put("images/001.png", &png(8, 6));
}

/// Writes a COLMAP model with rigs and frames.
pub(crate) fn colmap_rigs(place: &Place, binary: bool) {
    colmap(place, binary);
    if binary {
        place.put("sparse/0/rigs.bin", &binary::colmap_rigs());
        place.put("sparse/0/frames.bin", &binary::colmap_frames());
    } else {
        place.put("sparse/0/rigs.txt", COLMAP_RIGS.as_bytes());
        place.put("sparse/0/frames.txt", COLMAP_FRAMES.as_bytes());
    }
}

/// Writes two frames in the layout of 7-Scenes.
pub(crate) fn seven_scenes(place: &Place) {
    for number in ["000000", "000001"] {
        place.put(&format!("frame-{number}.color.png"), &png(8, 6));
        place.put(&format!("frame-{number}.pose.txt"), RGBD_POSE.as_bytes());
        place.put(&format!("frame-{number}.depth.png"), &binary::gray16(8, 6));
    }
}

/// Writes a recording in TUM's layout.
pub(crate) fn tum(place: &Place) {
    place.put("rgb.txt", TUM_IMAGES.as_bytes());
    place.put("depth.txt", TUM_DEPTHS.as_bytes());
    place.put("groundtruth.txt", TUM_POSES.as_bytes());
    for time in ["1.0", "2.0"] {
        place.put(&format!("rgb/{time}.png"), &png(8, 6));
        place.put(&format!("depth/{time}.png"), &binary::gray16(8, 6));
    }
}

/// Writes three frames in ScanNet's layout.
pub(crate) fn scannet(place: &Place) {
    place.put("intrinsic/intrinsic_color.txt", SCANNET_INTRINSICS.as_bytes());
    for number in ["0", "1", "2"] {
        place.put(&format!("color/{number}.png"), &png(8, 6));
        place.put(&format!("pose/{number}.txt"), RGBD_POSE.as_bytes());
        place.put(&format!("depth/{number}.png"), &binary::gray16(8, 6));
    }
}
