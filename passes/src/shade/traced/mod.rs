//! `visibility_traced`: how much of a light a point sees, traced through the Gaussians themselves.
//!
//! A ray from a surface to a light gets through the product of 1 - alpha over all Gaussians whose density peaks between
//! the two, alpha taken at the peak and left out below 1/255, as in blending, each over what it is where the ray begins: the
//! Gaussians of the surface itself hide only by how much denser they become along the ray, so that a surface does not shadow
//! itself. Rays begin a little above it besides. Nothing is learned, and there is no gradient.
//!
//! The Gaussians' boxes (of the ellipsoids where alpha is 1/255) go into a BVH of eight children a node, built on the host
//! with every core (obvhs: PLOC with reinsertion; Ylitie et al. 2017), for geometry that does not change. Cost: 80 bytes for a
//! node visited, 52 for a Gaussian tried, a subgroup's rays together; memory about 60 bytes a Gaussian.
//!
//! Promises: the same bits from run to run, at most 1e-4 beside the product over all Gaussians. llvmpipe ends an
//! invocation's loops after 65535 rounds, all lights of [`lights_traced`] together: [`lights_train_traced`] and its like
//! take a ray an invocation.

mod lights;

pub use lights::{Sight, lights_bwd_traced, lights_normals_bwd_traced, lights_split_traced, lights_train_traced};

use super::Surfaces;
use super::lights::Lights;
use crate::Tuning;
use crate::kernel::{groups, stage};
use crate::reference::rng::{random_bits, uniform_from};
use crate::scene::{GaussianData, Group};
use crate::splat::Screen;
use glam::{Mat3, Quat, Vec3, Vec3A};
use obvhs::aabb::Aabb;
use obvhs::cwbvh::builder::build_cwbvh;
use obvhs::{Boundable, BvhBuildParams};
use sgs_engine::graph::exec::Executor;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_engine::{Device, DeviceBuffer, Location, Result};
use sgs_shaders::{lights_traced as lit, visibility_traced as kernel};

/// Below this a Gaussian shows nowhere.
const ALPHA_MIN: f32 = 1.0 / 255.0;
/// Half a million pixels under 64 lights.
const ROOM: u64 = 32 << 20;
/// Levels that a kernel remembers.
const STACK: usize = 32;

/// A Gaussian as rays see it: rows of the matrix that makes it a unit sphere, mean, opacity.
type TracedSplat = [f32; 13];

/// Why there is no tree.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TracedError {
    /// The tree is deeper than kernels can go.
    #[error(
        "The tree of {splats} Gaussians for shadows is {depth} levels deep, and {STACK} are the most: too many lie in one place."
    )]
    Depth {
        /// Gaussians in it.
        splats: usize,
        /// Its levels.
        depth: usize,
    },
}

/// A BVH of Gaussians, on the host.
#[derive(Clone, Debug)]
pub struct TracedTree {
    nodes: Vec<u32>,
    splats: Vec<TracedSplat>,
}

/// The tree as inputs of a graph.
#[derive(Clone, Copy, Debug)]
pub struct Traced {
    nodes: Buffer,
    splats: Buffer,
    /// How far above the surface rays begin.
    pub offset: f32,
    /// How far before the light rays of [`lights_train_traced`] and its like end, so that what a light is fixed in does not
    /// hide it.
    pub clearance: f32,
    /// Most bytes of what [`lights_train_traced`] and its like keep of rays: views that take more are gone through in
    /// stretches.
    pub room: u64,
}

/// What graphs need to know of a tree before there is one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TracedShape {
    /// Bytes of nodes and of Gaussians.
    pub sizes: [u64; 2],
    /// How far above the surface rays begin.
    pub offset: f32,
    /// As [`Traced::clearance`].
    pub clearance: f32,
    /// As [`Traced::room`].
    pub room: u64,
}

/// The tree in device memory.
#[derive(Debug)]
pub struct TracedMemory {
    nodes: DeviceBuffer,
    splats: DeviceBuffer,
}

impl TracedMemory {
    /// Puts it there.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn new(device: &Device, tree: &TracedTree) -> Result<TracedMemory> {
        let put = |name: &str, bytes: &[u8]| -> Result<DeviceBuffer> {
            let buffer = device.buffer(name, bytes.len() as u64, Location::Device)?;
            device.upload(&buffer, 0, bytes)?;
            Ok(buffer)
        };
        let nodes = put("traced.nodes", bytemuck::cast_slice(&tree.nodes))?;
        Ok(TracedMemory { nodes, splats: put("traced.splats", bytemuck::cast_slice(&tree.splats))? })
    }

    /// Puts it behind its handles.
    ///
    /// # Errors
    /// If the plan was made for another tree.
    pub fn bind(&self, exec: &mut Executor, traced: &Traced) -> Result<()> {
        exec.bind(traced.nodes, &self.nodes)?;
        exec.bind(traced.splats, &self.splats)
    }
}

impl Traced {
    /// Declares a tree as inputs of a graph.
    pub fn declare(g: &mut Graph, shape: &TracedShape) -> Traced {
        let [nodes, splats] = [g.input("traced.nodes", shape.sizes[0]), g.input("traced.splats", shape.sizes[1])];
        Traced { nodes, splats, offset: shape.offset, clearance: shape.clearance, room: shape.room }
    }
}

struct Boxed(Aabb);

impl Boundable for Boxed {
    fn aabb(&self) -> Aabb {
        self.0
    }
}

impl TracedTree {
    /// Of all Gaussians that show anywhere; those with numbers that are not finite do not.
    ///
    /// # Errors
    /// If the tree becomes too deep.
    pub fn new(data: &GaussianData) -> std::result::Result<TracedTree, TracedError> {
        let (boxes, splats): (Vec<Boxed>, Vec<TracedSplat>) = (0..data.len()).filter_map(|i| splat(data, i)).unzip();
        if splats.is_empty() {
            // One node without children.
            return Ok(TracedTree { nodes: vec![0; 20], splats: vec![TracedSplat::default()] });
        }
        let tree = build_cwbvh(&boxes, BvhBuildParams::medium_build(), &mut Default::default());
        let mut depth = 0;
        let mut open = vec![(0_usize, 1_usize)];
        while let Some((node, level)) = open.pop() {
            depth = depth.max(level);
            let node = &tree.nodes[node];
            open.extend((0..8).filter(|c| !node.is_leaf(*c)).map(|c| (node.child_node_index(c) as usize, level + 1)));
        }
        if depth > STACK {
            return Err(TracedError::Depth { splats: splats.len(), depth });
        }
        let nodes = bytemuck::cast_slice(&tree.nodes).to_vec();
        Ok(TracedTree { nodes, splats: tree.primitive_indices.iter().map(|&i| splats[i as usize]).collect() })
    }

    /// Gaussians in the tree.
    pub fn splats(&self) -> usize {
        self.splats.len()
    }

    /// Bytes on the device.
    pub fn bytes(&self) -> u64 {
        4 * self.nodes.len() as u64 + size_of_val(self.splats.as_slice()) as u64
    }

    /// What graphs need to know of it. `offset`: how far above the surface rays begin; `clearance`: how far before the
    /// light they end.
    pub fn shape(&self, offset: f32, clearance: f32) -> TracedShape {
        let sizes = [4 * self.nodes.len() as u64, size_of_val(self.splats.as_slice()) as u64];
        TracedShape { sizes, offset, clearance, room: ROOM }
    }

    /// Declares the tree as inputs of a graph. `offset`: how far above the surface rays begin.
    pub fn declare(&self, g: &mut Graph, offset: f32) -> Traced {
        Traced::declare(g, &self.shape(offset, 0.0))
    }

    /// What the host must put there once.
    pub fn contents(&self, traced: &Traced) -> [(Buffer, Vec<u8>); 2] {
        [
            (traced.nodes, bytemuck::cast_slice(&self.nodes).to_vec()),
            (traced.splats, bytemuck::cast_slice(&self.splats).to_vec()),
        ]
    }
}

/// The box of a Gaussian and what rays need of it; none if it shows nowhere.
fn splat(data: &GaussianData, i: usize) -> Option<(Boxed, TracedSplat)> {
    let three = |group: Group| Vec3::from_slice(&data.group(group)[3 * i..]);
    let (mean, log_scale) = (three(Group::Means), three(Group::LogScales));
    let logit = data.group(Group::OpacityLogits)[i];
    // As pictures have it.
    if !(mean.is_finite() && log_scale.is_finite() && logit.is_finite()) {
        return None;
    }
    let scale = log_scale.clamp(Vec3::splat(-16.0), Vec3::splat(8.0)).exp();
    let q = &data.group(Group::Rotations)[4 * i..4 * i + 4];
    // As the kernels of splatting take it: zero and what is not finite is the identity.
    let largest = q.iter().fold(0.0_f32, |m, c| m.max(c.abs()));
    let turn = if largest > 0.0 && q.iter().all(|c| c.is_finite()) {
        let s = q.iter().map(|c| c / largest).collect::<Vec<f32>>();
        Mat3::from_quat(Quat::from_xyzw(s[1], s[2], s[3], s[0]).normalize())
    } else {
        Mat3::IDENTITY
    };
    let opacity = 1.0 / (1.0 + (-logit).exp());
    if opacity < ALPHA_MIN {
        return None;
    }
    let radius = (2.0 * (opacity / ALPHA_MIN).ln()).max(0.0).sqrt();
    let axes = Mat3::from_cols(turn.x_axis * scale.x, turn.y_axis * scale.y, turn.z_axis * scale.z).transpose();
    let half = radius * Vec3::new(axes.x_axis.length(), axes.y_axis.length(), axes.z_axis.length());
    // Wider by rounding, of the kernels' as well.
    let half = half * 1.0001 + (mean.abs() + half) * 1e-6;
    // And by up to a hundredth at each side: trees of boxes with one center become chains.
    let wider = |axis: u32| 1.0 + 0.01 * uniform_from(random_bits(0, i as u32, axis)) as f32;
    let [low, high] = [0, 3].map(|k| half * Vec3::new(wider(k), wider(k + 1), wider(k + 2)));
    let rows = [turn.x_axis / scale.x, turn.y_axis / scale.y, turn.z_axis / scale.z, mean];
    let record = std::array::from_fn(|k| if k < 12 { rows[k / 3][k % 3] } else { opacity });
    Some((Boxed(Aabb::new(Vec3A::from(mean - low), Vec3A::from(mean + high))), record))
}

/// Writes `visibility`, `[places * pixels]` floats with the pixels of the largest view: how much of each of `count` places
/// (`[count * 3]` floats) the pixels of the view see; zero where there is no surface.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn visibility_traced(
    g: &mut Graph,
    t: &Tuning,
    screen: &Screen,
    surfaces: &Surfaces,
    traced: &Traced,
    places: (Buffer, u32),
    visibility: Buffer,
) -> std::result::Result<(), GraphError> {
    let workgroup = t.workgroup.min(64);
    let bindings = kernel::Bindings {
        params: screen.step.into(),
        points: surfaces.points.into(),
        normals: surfaces.normals.into(),
        coverage: surfaces.coverage.into(),
        places: places.0.into(),
        visibility: visibility.into(),
        tree_nodes: traced.nodes.into(),
        tree_splats: traced.splats.into(),
    };
    let pixels = screen.pixels();
    let per_place = pixels.div_ceil(u64::from(workgroup));
    let specs = kernel::Specs { workgroup, subgroup: t.subgroup_size };
    let push =
        kernel::Push { groups: per_place as u32, places: places.1, pixels: pixels as u32, offset: traced.offset };
    let bytes = bytemuck::bytes_of(&push);
    stage(g, "visibility_traced", &kernel::KERNEL, bindings.entries(), specs.entries(), bytes)
        .subgroup_size(Some(t.subgroup_size))
        .dispatch(groups(per_place * u64::from(places.1), 1))
}

/// As [`super::lights::lights`], each light as far as it is seen.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn lights_traced(
    g: &mut Graph,
    a: &Lights,
    traced: &Traced,
    direct: Buffer,
) -> std::result::Result<(), GraphError> {
    let p = &a.pixels;
    let bindings = lit::Bindings {
        params: p.screen.step.into(),
        prepared: a.prepared.lights.into(),
        prepared_floats: a.prepared.lights.into(),
        light_list: a.prepared.list.into(),
        points: p.surfaces.points.into(),
        normals: p.surfaces.normals.into(),
        coverage: p.surfaces.coverage.into(),
        materials: p.materials.materials.into(),
        metallic: p.materials.metallic.unwrap_or(p.materials.materials).into(),
        tree_nodes: traced.nodes.into(),
        tree_splats: traced.splats.into(),
        direct: direct.into(),
    };
    let specs = lit::Specs {
        subgroup: a.shape.subgroup,
        lobes: a.prepared.model.lobes,
        metallic: p.materials.metallic.is_some(),
        per_lane: 1,
        spread: a.shape.spread,
        traced_offset: traced.offset,
    };
    let push = lit::Push { normalizer: a.normalizer };
    stage(g, "lights_traced", &lit::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .subgroup_size(Some(a.shape.subgroup))
        .dispatch(groups(p.screen.pixels(), a.shape.subgroup))
}
