//! Losses. Each has a forward pass that writes sums, and a pass for the gradient of the rendered values.

pub mod compose;
pub mod correspondence;
pub mod cross_view;
pub mod depth_fit;
pub mod edge_aware;
pub mod geometry_loss;
pub mod gray_image;
pub mod material_images;
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
    Correspondence, ImagePart, Regions, correspondence_bwd, correspondence_train_bwd, pack_mask, region, regions,
};
pub use cross_view::{CrossView, CrossViewImage, cross_view};
pub use depth_fit::{DepthFit, Fit, depth_fit};
pub use edge_aware::{EdgeAware, EdgeSums, edge_aware};
pub use geometry_loss::{GeometryLoss, GeometrySums, geometry_loss, pack_depth, pack_relative_depth, unpack_depth};
pub use gray_image::{gray_image, gray_image_bwd};
pub use material_images::{MaterialImages, Materials, images, material_images, material_images_bwd};
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
