//! Scenes on disk: cameras, photographs, points, priors, ground truth, and splats.
//!
//! [`Scene::open`] detects the layout of a directory from its files and converts all data to common conventions. These
//! are OpenCV camera axes, world-to-camera poses, pixel centers at half-integers, undistorted sRGB-encoded photographs,
//! and world-space normals. [`Splats`] are read and written as PLY files that common viewers accept. All files are
//! written to a temporary file and renamed into place ([`atomic_write`]).
//!
//! Invalid files cause a [`SceneError`], whose message is one sentence for the author of the file. Input never causes a
//! panic. The crate depends on neither graphics devices nor training.

mod activation;
mod atomic;
mod beside;
mod camera;
mod depth;
mod depth_normals;
mod depth_prior;
mod dot_splat;
mod error;
mod exposure;
mod gltf;
mod ground_truth;
mod image;
mod json;
mod ksplat;
mod map_file;
mod maps;
mod mask_use;
mod noise;
mod placement;
mod ply;
mod points;
mod prior_settings;
mod priors;
mod reader;
mod scene;
mod sog;
mod splat_kind;
mod splats;
mod split;
mod split_rule;
mod spz;
mod unit;
mod usd;
mod view;
mod web;

pub use atomic::atomic_write;
pub use beside::GroundTruthKind;
pub use camera::{Camera, Distortion, MAX_CAMERA_NUMBER, MAX_IMAGE_SIDE, NEAR, Projection, Residual};
pub use depth::DepthDefinition;
pub use dot_splat::{read_splat, write_splat};
pub use error::{Result, SceneError, is_storage_error};
pub use gltf::{GltfCoding, GltfScene, PunctualKind, PunctualLight, write_gltf};
pub use ground_truth::GroundTruth;
pub use image::{
    Exif, ExrImage, Image, NpyArray, Upright, encode_jpeg, encode_png, linear_to_srgb, names_exr_layer,
    read_environment, read_exr, read_ids, read_upright, resize, resize_valid, srgb_to_linear, undistort,
    undistort_coverage, write_environment, write_exr, write_exr_layers, write_ids, write_npy_f16, write_npy_f32,
    write_png,
};
pub use json::read_json;
pub use ksplat::read_ksplat;
pub use map_file::NormalFrame;
pub use maps::{FeatureMap, MaskedMap, RegionMap};
pub use mask_use::MaskUse;
pub use noise::Noise;
pub use placement::Placement;
pub use points::{Pcg, PointCloud, RandomBox};
pub use prior_settings::DepthMeaning;
pub use priors::{TextEmbeddings, UnknownClass};
pub use reader::{ColmapModel, Layout};
pub use scene::{Scene, SceneOptions};
pub use sog::{is_sog_meta, read_sog, write_sog};
pub use splat_kind::SplatKind;
pub use splats::{ALBEDO_RANGE, MOST_EMITTERS, PlyDialect, ROUGHNESS_RANGE, SH_C0, SplatFile, Splats};
pub use split::Split;
pub use split_rule::SplitRule;
pub use spz::{SpzVersion, read_spz, write_spz};
pub use unit::Unit;
pub use usd::{UsdLight, UsdShape, usd_leaves_out, write_usd};
pub use view::{LoadOptions, Photograph, View};
pub use web::{CHUNK as PAGE_CHUNK, Page, PageChunk, PageLight, WrittenPage, write_page};
