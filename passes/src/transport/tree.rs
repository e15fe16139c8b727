//! BVH of surfels for rays: built on the host, traversed by `surfels.glsl`.
//!
//! The discs' boxes form a BVH with eight children per node (obvhs: PLOC with reinsertion; Ylitie et al. 2017). Cost: 80
//! bytes per visited node and 32 per tested disc. Memory: about 50 bytes per surfel.

use crate::bvh::{Boxed, Bvh, STACK};
use crate::rng::{random_bits, uniform_from};
use glam::{Vec3, Vec3A};
use obvhs::aabb::Aabb;
use sgs_engine::exec::Executor;
use sgs_engine::graph::{Buffer, Graph};
use sgs_engine::{Device, DeviceBuffer, Location, Result};
use sgs_shaders::structs::SurfelDisc;

/// One-sided discs that stand for the surfaces of a scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Surfels {
    /// World-space centers.
    pub points: Vec<[f32; 3]>,
    /// World-space unit normals. A ray meets a disc only against its normal.
    pub normals: Vec<[f32; 3]>,
    /// Radii, in units of length of the device.
    pub radii: Vec<f32>,
}

impl Surfels {
    /// Returns the number of surfels.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Returns whether there are no surfels.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// Returns center, unit normal and radius, or `None` if no ray can meet the disc.
    fn disc(&self, i: usize) -> Option<(Vec3, Vec3, f32)> {
        let (point, normal, radius) = (Vec3::from(self.points[i]), Vec3::from(self.normals[i]), self.radii[i]);
        let unit = normal.as_dvec3().normalize_or_zero().as_vec3();
        let real = point.is_finite() && unit.is_finite() && unit != Vec3::ZERO && radius.is_finite() && radius > 0.0;
        real.then_some((point, unit, radius))
    }
}

/// Reason why a tree cannot be built.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TreeError {
    /// The tree is deeper than kernels can traverse.
    #[error(
        "building the tree of {discs} surfels failed: it has {depth} levels, and {STACK} are the most; remove surfels that coincide"
    )]
    Depth {
        /// Surfels in the tree.
        discs: usize,
        /// Levels of the tree.
        depth: usize,
    },
    /// The lists of surfels have different lengths.
    #[error(
        "building the tree of surfels failed: {points} points, {normals} normals and {radii} radii; give one of each per surfel"
    )]
    Lengths {
        /// Number of points.
        points: usize,
        /// Number of normals.
        normals: usize,
        /// Number of radii.
        radii: usize,
    },
}

/// BVH of surfels on the host.
#[derive(Clone, Debug)]
pub struct SurfelTree {
    nodes: Vec<u32>,
    discs: Vec<SurfelDisc>,
}

/// Properties of a tree that graphs need before the tree exists.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SurfelTreeShape {
    /// Bytes of the nodes.
    pub node_bytes: u64,
    /// Bytes of the discs.
    pub disc_bytes: u64,
}

/// BVH of surfels as inputs of a graph.
#[derive(Clone, Copy, Debug)]
pub struct SurfelHandles {
    /// Nodes, 20 words each.
    pub nodes: Buffer,
    /// Discs in the order of the leaves, 8 words each: center, radius, normal, index.
    pub discs: Buffer,
}

/// BVH of surfels in device memory. Clones share the memory.
#[derive(Clone, Debug)]
pub struct SurfelMemory {
    nodes: DeviceBuffer,
    discs: DeviceBuffer,
}

impl SurfelMemory {
    /// Uploads a tree.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(device: &Device, tree: &SurfelTree) -> Result<SurfelMemory> {
        let put = |name: &str, bytes: &[u8]| -> Result<DeviceBuffer> {
            let buffer = device.buffer(name, bytes.len() as u64, Location::Device)?;
            device.upload(&buffer, 0, bytes)?;
            Ok(buffer)
        };
        let nodes = put("surfel_nodes", bytemuck::cast_slice(&tree.nodes))?;
        Ok(SurfelMemory { nodes, discs: put("surfel_discs", bytemuck::cast_slice(&tree.discs))? })
    }

    /// Binds the buffers to their handles.
    ///
    /// # Errors
    /// If the plan was built for another tree.
    pub fn bind(&self, exec: &mut Executor, handles: &SurfelHandles) -> Result<()> {
        exec.bind(handles.nodes, &self.nodes)?;
        exec.bind(handles.discs, &self.discs)
    }
}

impl SurfelHandles {
    /// Declares a tree as inputs of a graph.
    pub fn declare(g: &mut Graph, shape: &SurfelTreeShape) -> SurfelHandles {
        let nodes = g.input("surfel_nodes", shape.node_bytes);
        SurfelHandles { nodes, discs: g.input("surfel_discs", shape.disc_bytes) }
    }
}

impl SurfelTree {
    /// Builds the tree. Leaves out surfels with values that are not finite, without a normal or without an area.
    ///
    /// # Errors
    /// If the lists of surfels have different lengths, or the tree becomes too deep.
    pub fn new(surfels: &Surfels) -> std::result::Result<SurfelTree, TreeError> {
        let [points, normals, radii] = [surfels.points.len(), surfels.normals.len(), surfels.radii.len()];
        if normals != points || radii != points {
            return Err(TreeError::Lengths { points, normals, radii });
        }
        let (boxes, discs): (Vec<Boxed>, Vec<SurfelDisc>) = (0..points).filter_map(|i| record(surfels, i)).unzip();
        if discs.is_empty() {
            // One node without children.
            return Ok(SurfelTree { nodes: vec![0; 20], discs: vec![SurfelDisc::default()] });
        }
        let Bvh { nodes, order } = Bvh::new(&boxes).map_err(|depth| TreeError::Depth { discs: discs.len(), depth })?;
        Ok(SurfelTree { nodes, discs: order.iter().map(|&i| discs[i as usize]).collect() })
    }

    /// Returns the number of surfels in the tree; a tree without surfels has one that no ray meets.
    pub fn discs(&self) -> usize {
        self.discs.len()
    }

    /// Returns the properties of the tree that graphs need.
    pub fn shape(&self) -> SurfelTreeShape {
        let node_bytes = size_of_val(self.nodes.as_slice()) as u64;
        SurfelTreeShape { node_bytes, disc_bytes: size_of_val(self.discs.as_slice()) as u64 }
    }

    /// Declares the tree as inputs of a graph.
    pub fn declare(&self, g: &mut Graph) -> SurfelHandles {
        SurfelHandles::declare(g, &self.shape())
    }

    /// Returns the contents that the host uploads once.
    pub fn contents(&self, handles: &SurfelHandles) -> [(Buffer, Vec<u8>); 2] {
        let nodes = bytemuck::cast_slice(&self.nodes).to_vec();
        [(handles.nodes, nodes), (handles.discs, bytemuck::cast_slice(&self.discs).to_vec())]
    }
}

/// Returns the box and record of a surfel, or `None` if no ray can meet it.
fn record(surfels: &Surfels, i: usize) -> Option<(Boxed, SurfelDisc)> {
    let (point, normal, radius) = surfels.disc(i)?;
    // A disc is flat: along its normal's axis, the box has no height.
    let half = radius * (Vec3::ONE - normal * normal).max(Vec3::ZERO).map(f32::sqrt);
    // Margin for rounding, including that of the kernels.
    let margin = 2e-6 * (point.abs().max_element() + radius);
    // Random widening by up to 1 % per side: boxes with a common center would degenerate the tree to a chain.
    let wider = |axis: u32| 1.0 + 0.01 * uniform_from(random_bits(0, i as u32, axis)) as f32;
    let [low, high] = [0, 3].map(|k| (half + margin) * Vec3::new(wider(k), wider(k + 1), wider(k + 2)));
    let disc = SurfelDisc { point: point.into(), radius, normal: normal.into(), index: i as u32 };
    Some((Boxed(Aabb::new(Vec3A::from(point - low), Vec3A::from(point + high))), disc))
}
