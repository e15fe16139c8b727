//! Trained runs: directory, files, rendering and shading.
//!
//! Reads everything that training writes. Contains no schedule and no training.

mod classify;
mod contents;
mod convert;
mod directory;
mod emitters;
mod error;
mod exchange;
mod export;
pub mod floats;
mod gltf_lights;
pub mod harmonics;
mod head;
mod known;
mod learned_views;
mod light_list;
mod lights;
mod lock;
pub mod materials;
mod placement;
mod published;
mod render;
mod rollback;
mod shaded;
mod shadows;
mod stage;
mod usd_lights;
mod visibility;

pub use classify::{Classes, Classifier, NO_RELEVANCE};
pub use contents::{Contents, RunContents, entries};
pub use convert::{camera, gaussian_data, pack_depths, pack_image, pack_normals, splats};
pub use directory::RunDirectory;
pub use emitters::{
    EmitterFile, EmitterRow, EnclosureRow, MOST_OPENINGS, OpeningRow, SKY, check_openings, read_emitters, read_sky,
    write_emitters,
};
pub use error::{Result, RunError, io_error, remove};
pub use exchange::{Exchange, is_gltf, read_exchange, read_light, read_splats};
pub use export::{Export, ExportFormat, write_exchange, write_export};
pub use gltf_lights::{gltf_leaves_out, read_light_source};
pub use head::SemanticHead;
pub use known::{KnownEmitters, MOST_KNOWN};
pub use learned_views::{LearnedCameras, LearnedLens, LearnedViewRow, use_learned_views};
pub use light_list::{LightList, ListedLight, PhysicalRow, read_light_list, write_light_list};
pub use lights::{LightFile, LightRow, LobeRow, MOST as MOST_LIGHTS, raw_lobe, write_lights};
pub use lock::{DirectoryLock, LockHolder, process_start};
pub use placement::{join, placed};
pub use published::{MOST_AMPLITUDE, PATCHES, published_light, read_lights, rectangle_patches};
pub use render::render_view;
pub use rollback::RollbackFiles;
pub use shaded::{
    RunLight, ShadedView, Shading, Texels, Visibility, displayed, light_of, shaded_environment, shaded_scene,
};
pub use shadows::{Rays, traced};
pub use stage::StageKind;
pub use visibility::{VisibilityFile, field_box};
