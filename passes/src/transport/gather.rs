//! `irradiance_gather`: irradiance of Gaussians from their nearest surfels; `irradiance_gather_bwd`: its transpose.
//!
//! Cost: 64 bytes of the matrix, 96 of the surfels' irradiance and 16 written per Gaussian. The transpose reads 8 bytes and
//! 16 of the gradients per entry.

use super::Surfels;
use super::nearest::{NO_NEIGHBOR, Tree};
use crate::Tuning;
use crate::kernel::{groups, stage};
use rayon::prelude::*;
use sgs_engine::graph::{Buffer, Graph, GraphError};
use sgs_shaders::{irradiance_gather as kernel, irradiance_gather_bwd as backward};

/// Number of surfels whose irradiance a Gaussian gets.
pub const NEIGHBORS: usize = 8;

/// Nearest surfels of each Gaussian.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Nearest {
    /// Surfels, nearest first, `[Gaussians * 8]`; [`NO_NEIGHBOR`] if there are fewer.
    pub neighbors: Vec<u32>,
    /// Weights, `[Gaussians * 8]`; those of a Gaussian add up to 1, or are all 0.
    pub weights: Vec<f32>,
}

/// Distance in which surfels are the nearest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NearestOptions {
    /// Length by which normals are multiplied: the distance that a unit of their difference counts as.
    pub normal_length: f32,
    /// Length below which distances hardly change the weights.
    pub least_distance: f32,
}

/// Compressed columns of the matrix of weights: the Gaussians of each receiver.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NearestColumns {
    /// Start of each receiver's column, `[receivers + 1]`.
    pub starts: Vec<u32>,
    /// Gaussians in increasing order; never empty, so that it can be uploaded.
    pub gaussians: Vec<u32>,
    /// Weights of the entries.
    pub weights: Vec<f32>,
}

/// Finds the nearest surfels of each point by position and normal. Weights are inverse squares of distances.
///
/// Points with values that are not finite have no neighbors, and surfels with such values are none.
pub fn nearest_surfels(
    points: &[[f32; 3]],
    normals: &[[f32; 3]],
    surfels: &Surfels,
    options: &NearestOptions,
) -> Nearest {
    let key = |p: &[f32; 3], n: &[f32; 3]| {
        std::array::from_fn(|k| if k < 3 { p[k] } else { options.normal_length * n[k - 3] })
    };
    let tree = Tree::new(surfels.points.iter().zip(&surfels.normals).map(|(p, n)| key(p, n)).collect());
    let least = f64::from(options.least_distance).powi(2).max(1e-30);
    let find = |(p, n): (&[f32; 3], &[f32; 3])| {
        let found = tree.nearest::<NEIGHBORS>(&key(p, n));
        let raw = found.map(|(square, i)| if i == NO_NEIGHBOR { 0.0 } else { 1.0 / (f64::from(square) + least) });
        let all: f64 = raw.iter().sum();
        (found.map(|(_, i)| i), raw.map(|w| if all > 0.0 { (w / all) as f32 } else { 0.0 }))
    };
    let rows: Vec<_> = points.par_iter().zip(normals).map(find).collect();
    Nearest { neighbors: rows.iter().flat_map(|r| r.0).collect(), weights: rows.iter().flat_map(|r| r.1).collect() }
}

impl Nearest {
    /// Transposes the matrix of weights for `receivers` surfels and patches.
    pub fn columns(&self, receivers: u32) -> NearestColumns {
        let count = receivers as usize;
        let mut starts = vec![0_u32; count + 1];
        let real = |i: &u32| *i < receivers;
        self.neighbors.iter().filter(|i| real(i)).for_each(|&i| starts[i as usize + 1] += 1);
        for i in 0..count {
            starts[i + 1] += starts[i];
        }
        let mut next = starts.clone();
        let entries = (starts[count] as usize).max(1);
        let (mut gaussians, mut weights) = (vec![0; entries], vec![0.0; entries]);
        for (at, &i) in self.neighbors.iter().enumerate().filter(|(_, i)| real(i)) {
            let slot = &mut next[i as usize];
            gaussians[*slot as usize] = (at / NEIGHBORS) as u32;
            weights[*slot as usize] = self.weights[at];
            *slot += 1;
        }
        NearestColumns { starts, gaussians, weights }
    }
}

/// Inputs of [`irradiance_gather`].
#[derive(Clone, Copy, Debug)]
pub struct GatherInputs {
    /// Number of Gaussians.
    pub gaussians: u32,
    /// Number of receivers.
    pub receivers: u32,
    /// Number of independent sets of light of the irradiance; the first counts.
    pub lights: u32,
    /// Surfels of each Gaussian, `[Gaussians * 8]` words.
    pub neighbors: Buffer,
    /// Their weights, `[Gaussians * 8]` floats.
    pub weights: Buffer,
    /// Irradiance, `[receivers * lights * 3]` floats.
    pub irradiance: Buffer,
    /// Logarithms of the gains of the Gaussians, `[Gaussians]` floats; gains are 1 without them.
    pub log_gains: Option<Buffer>,
}

/// Computes the irradiance of all Gaussians: `values` is `[Gaussians * 4]` floats, red, green, blue and the gain.
///
/// The pass `materials` blends them to pixels.
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn irradiance_gather(g: &mut Graph, t: &Tuning, a: &GatherInputs, values: Buffer) -> Result<(), GraphError> {
    let bindings = kernel::Bindings {
        neighbors: a.neighbors.into(),
        neighbor_weights: a.weights.into(),
        irradiance: a.irradiance.into(),
        log_gains: a.log_gains.unwrap_or(a.weights).into(),
        values: values.into(),
    };
    let specs = kernel::Specs { workgroup: t.workgroup, gains: a.log_gains.is_some() };
    let push = kernel::Push { gaussians: a.gaussians, receivers: a.receivers, lights: a.lights };
    stage(g, "irradiance_gather", &kernel::KERNEL, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .dispatch(groups(a.gaussians.into(), t.workgroup))
}

/// Columns of the matrix of weights on the device.
#[derive(Clone, Copy, Debug)]
pub struct GatherColumns {
    /// Number of receivers.
    pub receivers: u32,
    /// Start of each receiver's column, `[receivers + 1]` words.
    pub starts: Buffer,
    /// Gaussians of the columns.
    pub gaussians: Buffer,
    /// Weights of the columns.
    pub weights: Buffer,
}

/// Computes the gradient of the receivers' irradiance, `[receivers * 3]` floats.
///
/// `values_gradient` is that of the values of [`irradiance_gather`].
///
/// # Errors
/// If a buffer does not belong to the graph or is too small to be bound.
pub fn irradiance_gather_bwd(
    g: &mut Graph,
    t: &Tuning,
    columns: &GatherColumns,
    values_gradient: Buffer,
    irradiance_gradient: Buffer,
) -> Result<(), GraphError> {
    let bindings = backward::Bindings {
        column_starts: columns.starts.into(),
        column_gaussians: columns.gaussians.into(),
        column_weights: columns.weights.into(),
        values_gradient: values_gradient.into(),
        irradiance_gradient: irradiance_gradient.into(),
    };
    let specs = backward::Specs { workgroup: t.workgroup };
    let (kernel, push) = (&backward::KERNEL, backward::Push { receivers: columns.receivers });
    stage(g, "irradiance_gather_bwd", kernel, bindings.entries(), specs.entries(), bytemuck::bytes_of(&push))
        .subgroup_size(Some(t.subgroup_size))
        .dispatch(groups(8 * u64::from(columns.receivers), t.workgroup))
}
