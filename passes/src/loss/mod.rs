//! Losses: each a forward pass that leaves sums, and a gradient by what was rendered.

pub mod compose;
pub mod correspondence;
pub mod cross_view;
pub mod edge_aware;
pub mod geometry_loss;
pub mod gray_picture;
pub mod material_pictures;
pub mod material_sum;
pub mod msg;
pub mod octahedral;
pub mod photometric;
pub mod region_mask;
pub mod semantic;
pub mod semantic_labels;
pub mod semantic_sum;
pub mod sum;
pub mod wanted;

pub use compose::{Compose, Saturated, compose, compose_bwd};
pub use correspondence::{
    Correspondence, Pictured, Regions, correspondence_bwd, correspondence_train_bwd, pack_mask, region, regions,
};
pub use cross_view::{CrossPicture, CrossView, cross_view};
pub use edge_aware::{EdgeAware, EdgeSums, edge_aware};
pub use geometry_loss::{GeometryLoss, GeometrySums, geometry_loss};
pub use gray_picture::{gray_picture, gray_picture_bwd};
pub use material_pictures::{MaterialPictures, Materials, material_pictures, material_pictures_bwd, pictures};
pub use material_sum::{MaterialLosses, material_sum};
pub use msg::{Msg, MsgLoss, msg, own_prior, relight};
pub use octahedral::{octahedral_decode, octahedral_encode};
pub use photometric::{Partials, Photometric, photometric, photometric_bwd, photometric_bwd_in_place};
pub use region_mask::{CarryOptions, Seen, carry_mask, pack_regions, region_mask};
pub use semantic::{
    Head, Prepared, SemanticLoss, SemanticSums, SemanticTargets, count_targets, decoder_gradient, normalize_embeddings,
    sampled_pixels, semantic_loss, semantic_prepare, semantic_targets,
};
pub use semantic_labels::{NO_LABEL, Relevance, SemanticLabels, semantic_labels};
pub use semantic_sum::semantic_sum;
pub use sum::loss_sum;
pub use wanted::wanted_samples;
