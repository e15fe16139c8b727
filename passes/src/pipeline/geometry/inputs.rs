//! Inputs of a geometry step besides the Gaussians, and their sizes.

use crate::loss::{Fit, Head, SemanticTargets};
use crate::scene::{Decoder, DecoderHandles, EMBEDDING, LearnedViews, ViewHandles, ViewKinds};
use sgs_engine::exec::Executor;
use sgs_engine::graph::{Buffer, Graph};
use sgs_engine::{DeviceBuffer, Result};
use sgs_shaders::structs::SemanticTarget;

/// Device memory that a geometry step reads.
#[derive(Clone, Copy, Debug)]
pub struct Inputs<'a> {
    /// Photographs, packed.
    pub targets: &'a DeviceBuffer,
    /// Normal priors, packed like the photographs.
    pub normals: Option<&'a DeviceBuffer>,
    /// Prior depths, packed like the photographs ([`crate::loss::pack_depth`]).
    pub depths: Option<(&'a DeviceBuffer, Fit)>,
    /// Semantic targets; the Gaussians must have features.
    pub semantics: Option<SemanticInputs<'a>>,
    /// Regions for pseudo-views.
    ///
    /// Region ids of the training views ([`crate::loss::pack_regions`]), or masks of all views of a step, depending on
    /// [`GeometryOptions::pseudo`](super::GeometryOptions::pseudo).
    pub regions: Option<&'a DeviceBuffer>,
    /// Region ids of the pseudo-views, for numbered masks.
    pub pseudo_regions: Option<&'a DeviceBuffer>,
    /// What is learned of the training views, if anything is.
    pub views: Option<(&'a LearnedViews, ViewKinds)>,
}

/// Inputs of the semantic loss.
#[derive(Clone, Copy, Debug)]
pub struct SemanticInputs<'a> {
    /// Decoder, trained with the Gaussians.
    pub decoder: &'a Decoder,
    /// `[samples * 512]` half floats: target features of all views, concatenated.
    pub features: &'a DeviceBuffer,
    /// `[samples]` of `SemanticTarget`.
    pub targets: &'a DeviceBuffer,
    /// `[classes * 512]` floats: text embeddings, rows of length one.
    pub embeddings: &'a DeviceBuffer,
    /// Number of samples of the largest map.
    pub largest: u32,
}

/// Sizes of [`Inputs`], to compile a plan without them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct InputSizes {
    /// Bytes of the photographs.
    pub targets: u64,
    /// Number of buffers of photographs, and of priors. A step binds one; 0 is one.
    pub parts: u64,
    /// Bytes of the normal priors.
    pub normals: Option<u64>,
    /// Bytes of the prior depths, and their relation to depth.
    pub depths: Option<(u64, Fit)>,
    /// Sizes of the semantic inputs.
    pub semantics: Option<SemanticSizes>,
    /// Bytes of the regions.
    pub regions: Option<u64>,
    /// Bytes of the regions of the pseudo-views.
    pub pseudo_regions: Option<u64>,
    /// Number of views of which something is learned, and what.
    pub views: Option<(u32, ViewKinds)>,
}

/// Sizes of [`SemanticInputs`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SemanticSizes {
    /// Number of samples of all maps.
    pub samples: u64,
    /// Number of samples of the largest map.
    pub largest: u32,
    /// Number of classes.
    pub classes: u32,
}

/// Bytes of the target features of one sample.
const ROW: u64 = 2 * EMBEDDING as u64;

impl SemanticSizes {
    /// Returns the bytes of the target features, which form one buffer.
    pub fn feature_bytes(&self) -> u64 {
        self.samples * ROW
    }

    /// Returns the bytes of all inputs except the decoder.
    pub fn bytes(&self) -> u64 {
        self.samples * (ROW + size_of::<SemanticTarget>() as u64) + self.text_bytes()
    }

    fn text_bytes(&self) -> u64 {
        u64::from(self.classes) * 4 * EMBEDDING as u64
    }
}

impl<'a> Inputs<'a> {
    /// Returns inputs of photographs alone.
    pub fn of(targets: &'a DeviceBuffer) -> Inputs<'a> {
        let (normals, depths, semantics, regions, pseudo_regions, views) = (None, None, None, None, None, None);
        Inputs { targets, normals, depths, semantics, regions, pseudo_regions, views }
    }

    /// Returns the sizes of the inputs.
    pub fn sizes(&self) -> InputSizes {
        InputSizes {
            targets: self.targets.bytes(),
            parts: 1,
            normals: self.normals.map(DeviceBuffer::bytes),
            depths: self.depths.map(|(priors, fit)| (priors.bytes(), fit)),
            semantics: self.semantics.map(|s| SemanticSizes {
                samples: s.features.bytes() / ROW,
                largest: s.largest,
                classes: (s.embeddings.bytes() / (4 * EMBEDDING as u64)) as u32,
            }),
            regions: self.regions.map(DeviceBuffer::bytes),
            pseudo_regions: self.pseudo_regions.map(DeviceBuffer::bytes),
            views: self.views.map(|(views, kinds)| (views.count(), kinds)),
        }
    }
}

/// Handles of the inputs in a graph.
#[derive(Clone, Copy, Debug)]
pub(super) struct InputHandles {
    pub targets: Buffer,
    pub normals: Option<Buffer>,
    pub depths: Option<(Buffer, Fit)>,
    pub semantics: Option<SemanticHandles>,
    pub regions: Option<Buffer>,
    pub pseudo_regions: Option<Buffer>,
    pub views: Option<ViewHandles>,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct SemanticHandles {
    pub decoder: DecoderHandles,
    pub targets: SemanticTargets,
    pub head: Head,
}

impl InputHandles {
    pub fn declare(g: &mut Graph, sizes: &InputSizes) -> InputHandles {
        InputHandles {
            targets: g.input("targets", sizes.targets),
            normals: sizes.normals.map(|bytes| g.input("normal_priors", bytes)),
            depths: sizes.depths.map(|(bytes, fit)| (g.input("depth_priors", bytes), fit)),
            semantics: sizes.semantics.map(|s| {
                let decoder = Decoder::handles(g, true);
                let embeddings = g.input("text_embeddings", s.text_bytes());
                SemanticHandles {
                    decoder,
                    targets: SemanticTargets {
                        features: g.input("semantic_features", s.samples * ROW),
                        targets: g.input("semantic_targets", s.samples * size_of::<SemanticTarget>() as u64),
                        largest: s.largest,
                    },
                    head: Head { decoder: decoder.parameters, embeddings, classes: s.classes },
                }
            }),
            regions: sizes.regions.map(|bytes| g.input("regions", bytes)),
            pseudo_regions: sizes.pseudo_regions.map(|bytes| g.input("pseudo_regions", bytes)),
            views: sizes.views.map(|(count, kinds)| LearnedViews::declare(g, count, kinds)),
        }
    }

    pub fn bind(&self, exec: &mut Executor, inputs: &Inputs<'_>) -> Result<()> {
        exec.bind(self.targets, inputs.targets)?;
        let maps = [
            (self.normals, inputs.normals),
            (self.depths.map(|d| d.0), inputs.depths.map(|d| d.0)),
            (self.regions, inputs.regions),
            (self.pseudo_regions, inputs.pseudo_regions),
        ];
        for (handle, memory) in maps {
            if let (Some(handle), Some(memory)) = (handle, memory) {
                exec.bind(handle, memory)?;
            }
        }
        if let (Some(handles), Some((views, _))) = (&self.views, inputs.views) {
            views.bind(exec, handles)?;
        }
        if let (Some(handles), Some(memory)) = (&self.semantics, &inputs.semantics) {
            memory.decoder.bind(exec, &handles.decoder)?;
            exec.bind(handles.targets.features, memory.features)?;
            exec.bind(handles.targets.targets, memory.targets)?;
            exec.bind(handles.head.embeddings, memory.embeddings)?;
        }
        Ok(())
    }
}
