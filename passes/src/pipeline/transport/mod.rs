//! Radiosity of a room on the device: the transport matrix, light of emitters on surfels, the solve, and what shading
//! needs of them.
//!
//! [`TransportScene`] traces the matrix once per geometry. Its functions wait for the device: they run once per change of
//! light. [`ShadedTransport`] holds the lights of a scene and the irradiance that bounces; [`super::Shader`] adds both to a view.

mod responder;
mod responses;
mod scene;
mod shaded;
mod training;

pub use responder::Responder;
pub use responses::FrameEmitter;
pub(super) use responses::{EmitterHandles, FrameUniforms};
pub use scene::{TransportOptions, TransportScene};
pub use shaded::ShadedTransport;
pub(super) use shaded::{Declared, ShadedShape, Terms};
pub(super) use training::TransportHandles;
pub use training::{TransportContents, TransportMemory, TransportShape, ViewLights};
