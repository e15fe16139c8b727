//! `visibility_traced`: visibility of lights, traced through the Gaussians themselves.
//!
//! The transmittance of a ray from a surface to a light is the product of 1 - alpha over all Gaussians whose density
//! peaks between the two. Alpha is taken at the peak and ignored below 1/255, as in blending. Each factor is divided by
//! its value at the start of the ray. Gaussians of the surface itself therefore occlude only by their increase in
//! density along the ray, so that a surface does not shadow itself. Rays also start slightly above the surface. Nothing
//! is learned, and visibility has no gradient.
//!
//! The Gaussians' boxes (of the ellipsoids where alpha is 1/255) form a BVH with eight children per node. The host
//! builds it on all cores (obvhs: PLOC with reinsertion; Ylitie et al. 2017), for geometry that does not change. Cost:
//! 80 bytes per visited node and 52 per tested Gaussian, shared by a subgroup's rays. Memory: about 60 bytes per
//! Gaussian.
//!
//! Guarantees: results are bit-identical from run to run, and within 1e-4 of the product over all Gaussians. llvmpipe
//! ends an invocation's loops after 65535 iterations, which covers all lights of [`lights_traced`] together.
//! [`lights_train_traced`] and its variants trace one ray per invocation.

mod lights;

pub use lights::{Sight, lights_bwd_traced, lights_normals_bwd_traced, lights_split_traced, lights_train_traced};

use super::Surfaces;
use super::lights::Lights;
use crate::Tuning;
use crate::bvh::{Boxed, Bvh, STACK};
use crate::kernel::{groups, stage};
use crate::rng::{random_bits, uniform_from};
use crate::scene::{GaussianData, Group};
use crate::splat::Screen;
use glam::{Mat3, Quat, Vec3, Vec3A};
use obvhs::aabb::Aabb;
use sgs_engine::exec::Executor;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_engine::{Device, DeviceBuffer, Location, Result};
use sgs_shaders::{lights_traced as lit, visibility_traced as kernel};

/// Minimum alpha of a visible Gaussian.
const ALPHA_MIN: f32 = 1.0 / 255.0;
/// Default capacity in bytes: half a million pixels under 64 lights.
const ROOM: u64 = 32 << 20;

/// Gaussian in the layout of ray tracing. Rows of the matrix that transforms the Gaussian to a unit sphere, mean,
/// opacity.
type TracedSplat = [f32; 13];

/// Reason why a tree cannot be built.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TracedError {
    /// The tree is deeper than kernels can traverse.
    #[error(
        "The tree of {splats} Gaussians for shadows is {depth} levels deep, and {STACK} are the most: too many lie in one place."
    )]
    Depth {
        /// Gaussians in the tree.
        splats: usize,
        /// Levels of the tree.
        depth: usize,
    },
}

/// BVH of Gaussians on the host.
#[derive(Clone, Debug)]
pub struct TracedTree {
    nodes: Vec<u32>,
    splats: Vec<TracedSplat>,
}

/// BVH of Gaussians as inputs of a graph.
#[derive(Clone, Copy, Debug)]
pub struct Traced {
    nodes: Buffer,
    splats: Buffer,
    /// Distance above the surface at which rays start.
    pub offset: f32,
    /// Distance before the light at which rays of [`lights_train_traced`] end. Also applies to its variants. A light's
    /// fixture therefore does not occlude the light.
    pub clearance: f32,
    /// Maximum bytes of visibility that [`lights_train_traced`] stores. Also applies to its variants. Larger views are
    /// processed in stretches.
    pub room: u64,
}

/// Properties of a tree that graphs need before the tree exists.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TracedShape {
    /// Bytes of nodes and of Gaussians.
    pub sizes: [u64; 2],
    /// Distance above the surface at which rays start.
    pub offset: f32,
    /// Distance before the light, as [`Traced::clearance`].
    pub clearance: f32,
    /// Capacity, as [`Traced::room`].
    pub room: u64,
}

/// BVH of Gaussians in device memory.
#[derive(Debug)]
pub struct TracedMemory {
    nodes: DeviceBuffer,
    splats: DeviceBuffer,
}

impl TracedMemory {
    /// Uploads a tree.
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

    /// Binds the buffers to their handles.
    ///
    /// # Errors
    /// If the plan was built for another tree.
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

impl TracedTree {
    /// Builds the tree of all visible Gaussians. Gaussians with values that are not finite are invisible.
    ///
    /// # Errors
    /// If the tree becomes too deep.
    pub fn new(data: &GaussianData) -> std::result::Result<TracedTree, TracedError> {
        let (boxes, splats): (Vec<Boxed>, Vec<TracedSplat>) = (0..data.len()).filter_map(|i| splat(data, i)).unzip();
        if splats.is_empty() {
            // One node without children.
            return Ok(TracedTree { nodes: vec![0; 20], splats: vec![TracedSplat::default()] });
        }
        let Bvh { nodes, order } =
            Bvh::new(&boxes).map_err(|depth| TracedError::Depth { splats: splats.len(), depth })?;
        Ok(TracedTree { nodes, splats: order.iter().map(|&i| splats[i as usize]).collect() })
    }

    /// Returns the number of Gaussians in the tree.
    pub fn splats(&self) -> usize {
        self.splats.len()
    }

    /// Returns the bytes on the device.
    pub fn bytes(&self) -> u64 {
        4 * self.nodes.len() as u64 + size_of_val(self.splats.as_slice()) as u64
    }

    /// Returns the properties of the tree that graphs need. Rays start at distance `offset` above the surface, and end
    /// at distance `clearance` before the light.
    pub fn shape(&self, offset: f32, clearance: f32) -> TracedShape {
        let sizes = [4 * self.nodes.len() as u64, size_of_val(self.splats.as_slice()) as u64];
        TracedShape { sizes, offset, clearance, room: ROOM }
    }

    /// Declares the tree as inputs of a graph. Rays start at distance `offset` above the surface.
    pub fn declare(&self, g: &mut Graph, offset: f32) -> Traced {
        Traced::declare(g, &self.shape(offset, 0.0))
    }

    /// Returns the contents that the host uploads once.
    pub fn contents(&self, traced: &Traced) -> [(Buffer, Vec<u8>); 2] {
        [
            (traced.nodes, bytemuck::cast_slice(&self.nodes).to_vec()),
            (traced.splats, bytemuck::cast_slice(&self.splats).to_vec()),
        ]
    }
}

/// Returns the box and record of a Gaussian, or `None` if it is invisible.
fn splat(data: &GaussianData, i: usize) -> Option<(Boxed, TracedSplat)> {
    let three = |group: Group| Vec3::from_slice(&data.group(group)[3 * i..]);
    let (mean, log_scale) = (three(Group::Means), three(Group::LogScales));
    let logit = data.group(Group::OpacityLogits)[i];
    // Rendering skips these Gaussians, too.
    if !(mean.is_finite() && log_scale.is_finite() && logit.is_finite()) {
        return None;
    }
    let scale = log_scale.clamp(Vec3::splat(-16.0), Vec3::splat(8.0)).exp();
    let q = &data.group(Group::Rotations)[4 * i..4 * i + 4];
    // Matches the splatting kernels: a quaternion that is zero or not finite is the identity.
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
    // Margin for rounding, including that of the kernels.
    let half = half * 1.0001 + (mean.abs() + half) * 1e-6;
    // Random widening by up to 1 % per side: boxes with a common center would degenerate the tree to a chain.
    let wider = |axis: u32| 1.0 + 0.01 * uniform_from(random_bits(0, i as u32, axis)) as f32;
    let [low, high] = [0, 3].map(|k| half * Vec3::new(wider(k), wider(k + 1), wider(k + 2)));
    let rows = [turn.x_axis / scale.x, turn.y_axis / scale.y, turn.z_axis / scale.z, mean];
    let record = std::array::from_fn(|k| if k < 12 { rows[k / 3][k % 3] } else { opacity });
    Some((Boxed(Aabb::new(Vec3A::from(mean - low), Vec3A::from(mean + high))), record))
}

/// Writes how visible each of `count` positions is from the pixels of a view. `visibility` holds `[places * pixels]`
/// floats, positions are `[count * 3]` floats. `pixels` is that of the largest view. Pixels without a surface are zero.
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

/// Computes [`super::lights::lights`] with traced visibility.
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
