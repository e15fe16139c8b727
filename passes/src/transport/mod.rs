//! Transport of light between surfaces: surfels, the rays between them, and the radiosity that they exchange.
//!
//! Receivers are surfels, then patches of the box around the scene. Each has the same number of cosine-distributed rays,
//! traced once per geometry; the receivers that they meet are the rows of the transport matrix. Radiosity follows by
//! iteration, its gradients by iteration with the transposed matrix.

mod area_light;
mod enclosure;
mod gather;
mod light_check;
mod light_shape;
mod lights;
mod matrix;
mod nearest;
mod outside;
mod rays;
mod reflect;
mod responses;
mod shade;
mod solve;
mod source;
mod tree;

pub use area_light::{AreaLight, AreaLights, LightPart, LightShape, parts_of};
pub use enclosure::{Enclosure, EnclosureError, Patch, receivers};
pub use gather::{
    GatherColumns, GatherInputs, NEIGHBORS, Nearest, NearestColumns, NearestOptions, irradiance_gather,
    irradiance_gather_bwd, nearest_surfels,
};
pub use light_check::AreaLightError;
pub use lights::{LIGHT_SAMPLES, LightReceivers, ShadowRays, transport_lights};
pub use matrix::{MatrixColumns, MatrixRows, MatrixShape, Transposed, transport_rows, transposed};
pub use nearest::NO_NEIGHBOR;
pub use outside::{Opening, Outside, OutsideHandles, OutsideMemory, OutsideShape, SKY_SIZE, Sky};
pub use rays::{TransportRays, transport_rays};
pub use reflect::{ReflectionRays, reflection_bytes, transport_reflect};
pub use responses::{
    DirectLight, GaussianEmitters, ResponseRadiosity, ResponseSource, Responses, gaussian_emission, response_radiosity,
    response_source, response_store, response_sum,
};
pub use shade::{ShadeGradients, ShadeTerms, TransportShading, split_sum_table, transport_shade, transport_shade_bwd};
pub use solve::{
    AdjointInputs, Solution, SolveGradients, SolveInputs, SolveOptions, transport_adjoint, transport_bounce,
    transport_solve,
};
pub use source::{
    BlendGradients, ParameterGradients, SourceGradients, SourceInputs, Sources, irradiance_blend_bwd, transport_source,
    transport_source_bwd,
};
pub use tree::{SurfelHandles, SurfelMemory, SurfelTree, SurfelTreeShape, Surfels, TreeError};
