//! Surfels, transport matrices and their solutions on the device.
//!
//! Kernels and references get the same numbers.

use crate::Gpu;
use crate::lit::narrow;
use sgs_engine::graph::{Buffer, Graph};
use sgs_passes::Tuning;
use sgs_passes::reference::rng::Pcg;
use sgs_passes::reference::transport::{Bounds, Disc, Matrix, V3};
use sgs_passes::transport::{
    AdjointInputs, Enclosure, MatrixColumns, MatrixRows, MatrixShape, Solution, SolveGradients, SolveInputs,
    SolveOptions, SurfelTree, Surfels, TransportRays, receivers, transport_adjoint, transport_rays, transport_rows,
    transport_solve, transposed,
};

/// Returns values as bytes.
pub fn bytes<T: bytemuck::NoUninit>(data: &[T]) -> Vec<u8> {
    bytemuck::cast_slice(data).to_vec()
}

/// Draws a unit vector.
pub fn random_unit(rng: &mut Pcg) -> V3 {
    let v = [rng.normal(), rng.normal(), rng.normal()];
    let length = v.iter().map(|x| x * x).sum::<f64>().sqrt();
    v.map(|x| x / length)
}

/// Draws discs of all sizes in a cube, some of them parallel to an axis.
pub fn random_surfels(count: usize, seed: u32) -> Surfels {
    let mut rng = Pcg::new(seed);
    let typical = 1.5 / (count.max(1) as f64).cbrt();
    let mut s = Surfels::default();
    for _ in 0..count {
        let normal = match rng.next_u32() % 8 {
            k @ 0..3 => std::array::from_fn(|axis| if axis == k as usize { 1.0 } else { 0.0 }),
            3 => [0.0, -1.0, 0.0],
            _ => random_unit(&mut rng),
        };
        s.points.push([0; 3].map(|_| rng.range(-1.4, 1.4) as f32));
        s.normals.push(normal.map(|x| x as f32));
        s.radii.push((typical * rng.range(0.1, 1.0)) as f32);
    }
    s
}

/// Returns the discs of surfels.
pub fn discs(s: &Surfels) -> Vec<Disc> {
    let disc = |i: usize| {
        let normal = s.normals[i].map(f64::from);
        let length = normal.iter().map(|x| x * x).sum::<f64>().sqrt();
        let normal = if length > 0.0 { normal.map(|x| x / length) } else { normal };
        Disc { point: s.points[i].map(f64::from), normal, radius: s.radii[i].into() }
    };
    (0..s.len()).map(disc).collect()
}

/// Returns the box of an enclosure.
pub fn bounds(e: &Enclosure) -> Bounds {
    Bounds { low: e.low().map(f64::from), high: e.high().map(f64::from), cells: e.cells() }
}

/// Scene of which rays are traced.
#[derive(Clone, Debug)]
pub struct Traced {
    /// Surfels.
    pub surfels: Surfels,
    /// Box around them.
    pub enclosure: Enclosure,
    /// Number of rays of a receiver.
    pub rays: u32,
    /// Seed of the directions.
    pub seed: u32,
    /// Distance above the receiver at which rays begin.
    pub offset: f32,
}

impl Traced {
    /// Traces all rays on the device. `changed` may change the receivers, 8 floats each.
    pub fn targets(&self, gpu: &Gpu, changed: impl Fn(&mut [f32])) -> Vec<u32> {
        let tree = SurfelTree::new(&self.surfels).unwrap();
        let mut g = Graph::new("transport_rays");
        let handles = tree.declare(&mut g);
        let mut records = receivers(&self.surfels, &self.enclosure);
        changed(&mut records);
        let buffer = g.input("receivers", 4 * records.len() as u64);
        let what = TransportRays {
            tree: handles,
            receivers: buffer,
            enclosure: self.enclosure,
            surfels: self.surfels.len() as u32,
            rays: self.rays,
            seed: self.seed,
            offset: self.offset,
        };
        let targets = g.external("targets", what.target_bytes());
        transport_rays(&mut g, &gpu.tuning(), &what, targets).unwrap();
        let mut inputs = vec![(buffer, bytes(&records))];
        inputs.extend(tree.contents(&handles));
        gpu.run(g, &inputs).get(targets)
    }

    /// Returns the transport matrix.
    pub fn matrix(&self, gpu: &Gpu) -> Matrix {
        let receivers = self.surfels.len() + self.enclosure.patch_count() as usize;
        Matrix { receivers, targets: self.targets(gpu, |_| ()) }
    }
}

/// Radiosity problem.
#[derive(Clone, Debug)]
pub struct Problem {
    /// Transport matrix.
    pub matrix: Matrix,
    /// Reflectance of each receiver.
    pub reflectance: Vec<V3>,
    /// Source of each receiver, light by light.
    pub sources: Vec<Vec<V3>>,
}

/// Solution of a problem on the device.
#[derive(Clone, Debug)]
pub struct Solved {
    /// Radiosity, light by light.
    pub radiosity: Vec<Vec<f32>>,
    /// Irradiance, light by light.
    pub irradiance: Vec<Vec<f32>>,
    /// Iterations and last relative change of each light.
    pub convergence: Vec<(u32, f32)>,
}

/// Gradients of a problem on the device.
#[derive(Clone, Debug)]
pub struct Gradients {
    /// Gradient of the sources, light by light.
    pub sources: Vec<Vec<f32>>,
    /// Gradient of the reflectance.
    pub reflectance: Vec<f32>,
    /// Iterations and last relative change of each light.
    pub convergence: Vec<(u32, f32)>,
}

/// Gradients of a solution, light by light; absent ones are zero.
#[derive(Clone, Copy, Debug)]
pub struct By<'a> {
    /// Gradient of the radiosity.
    pub radiosity: Option<&'a [Vec<V3>]>,
    /// Gradient of the irradiance.
    pub irradiance: Option<&'a [Vec<V3>]>,
}

/// Returns values as floats.
pub fn flat(values: &[V3]) -> Vec<f64> {
    values.iter().flatten().copied().collect()
}

/// Draws numbers that are exact in 32-bit floats.
pub fn random_values(count: usize, [low, high]: [f64; 2], rng: &mut Pcg) -> Vec<V3> {
    (0..count).map(|_| [0; 3].map(|_| narrow(rng.range(low, high)))).collect()
}

/// Interleaves the values of lights as kernels read them.
fn interleaved(lights: &[Vec<V3>]) -> Vec<u8> {
    let count = lights[0].len();
    let all: Vec<f32> = (0..count).flat_map(|i| lights.iter().flat_map(move |l| l[i].map(|x| x as f32))).collect();
    bytes(&all)
}

/// Separates the values of lights.
fn separate(values: &[f32], lights: usize) -> Vec<Vec<f32>> {
    let triples: Vec<&[f32]> = values.chunks(3).collect();
    (0..lights).map(|l| triples.iter().skip(l).step_by(lights).flat_map(|t| t.to_vec()).collect()).collect()
}

fn convergence(words: &[u32]) -> Vec<(u32, f32)> {
    words.chunks(2).map(|w| (w[0], f32::from_bits(w[1]))).collect()
}

impl Problem {
    /// Draws reflectance up to `most` and sources of some lights for a matrix.
    pub fn random(matrix: Matrix, lights: usize, most: f64, seed: u32) -> Problem {
        let mut rng = Pcg::new(seed);
        let n = matrix.receivers;
        let reflectance = random_values(n, [0.0, most], &mut rng);
        let sources = (0..lights).map(|l| random_values(n, [0.0, 10_f64.powi(l as i32)], &mut rng)).collect();
        Problem { matrix, reflectance, sources }
    }

    fn shape(&self) -> MatrixShape {
        let receivers = self.matrix.receivers as u32;
        MatrixShape { receivers, rays: self.matrix.targets.len() as u32 / receivers }
    }

    /// Declares reflectance and a buffer of the size of the sources.
    fn declare(&self, g: &mut Graph) -> (Vec<(Buffer, Vec<u8>)>, u64) {
        let n = self.matrix.receivers as u64;
        let reflectance = g.input("reflectance", 12 * n);
        let data: Vec<f32> = self.reflectance.iter().flatten().map(|x| *x as f32).collect();
        (vec![(reflectance, bytes(&data))], 12 * n * self.sources.len() as u64)
    }

    /// Solves on the device, from `initial` radiosity if it is present.
    pub fn solve(&self, gpu: &Gpu, options: &SolveOptions, initial: Option<&[Vec<V3>]>) -> Solved {
        self.solve_with(gpu, gpu.tuning(), options, initial)
    }

    /// Solves on the device with other kernel sizes.
    pub fn solve_with(&self, gpu: &Gpu, tuning: Tuning, options: &SolveOptions, initial: Option<&[Vec<V3>]>) -> Solved {
        let mut g = Graph::new("transport_solve");
        let (mut inputs, size) = self.declare(&mut g);
        let shape = self.shape();
        let targets = g.input("targets", 4 * self.matrix.targets.len() as u64);
        inputs.push((targets, bytes(&self.matrix.targets)));
        let rows = MatrixRows { shape, rows: g.external("rows", shape.bytes()) };
        transport_rows(&mut g, &tuning, targets, &rows).unwrap();
        let source = g.input("source", size);
        inputs.push((source, interleaved(&self.sources)));
        let initial = initial.map(|values| {
            let buffer = g.input("initial", size);
            inputs.push((buffer, interleaved(values)));
            buffer
        });
        let lights = self.sources.len();
        let [radiosity, irradiance] = ["radiosity", "irradiance"].map(|name| g.external(name, size));
        let into = Solution { radiosity, irradiance, convergence: g.external("convergence", 8 * lights as u64) };
        let a = SolveInputs { matrix: rows, lights: lights as u32, reflectance: inputs[0].0, source, initial };
        transport_solve(&mut g, &tuning, &a, options, &into).unwrap();
        let out = gpu.run(g, &inputs);
        Solved {
            radiosity: separate(&out.get(radiosity), lights),
            irradiance: separate(&out.get(irradiance), lights),
            convergence: convergence(&out.get(into.convergence)),
        }
    }

    /// Computes gradients on the device. `irradiance` is that of the solution, light by light.
    pub fn gradients(&self, gpu: &Gpu, options: &SolveOptions, irradiance: &[Vec<V3>], by: By<'_>) -> Gradients {
        let mut g = Graph::new("transport_adjoint");
        let (mut inputs, size) = self.declare(&mut g);
        let shape = self.shape();
        let columns = transposed(&self.matrix.targets, shape.receivers);
        let mut input = |g: &mut Graph, name: &str, data: Vec<u8>| {
            let buffer = g.input(name, data.len() as u64);
            inputs.push((buffer, data));
            buffer
        };
        let matrix = MatrixColumns {
            shape,
            starts: input(&mut g, "starts", bytes(&columns.starts)),
            rows: input(&mut g, "column_rows", bytes(&columns.rows)),
        };
        let found = input(&mut g, "irradiance", interleaved(irradiance));
        let [radiosity_gradient, irradiance_gradient] =
            [by.radiosity, by.irradiance].map(|values| values.map(|v| input(&mut g, "gradient", interleaved(v))));
        let lights = self.sources.len();
        let into = SolveGradients {
            source: g.external("source_gradient", size),
            reflectance: g.external("reflectance_gradient", 12 * u64::from(shape.receivers)),
            convergence: g.external("convergence", 8 * lights as u64),
        };
        let a = AdjointInputs {
            matrix,
            lights: lights as u32,
            reflectance: inputs[0].0,
            irradiance: found,
            radiosity_gradient,
            irradiance_gradient,
        };
        transport_adjoint(&mut g, &gpu.tuning(), &a, options, &into).unwrap();
        let out = gpu.run(g, &inputs);
        Gradients {
            sources: separate(&out.get(into.source), lights),
            reflectance: out.get(into.reflectance),
            convergence: convergence(&out.get(into.convergence)),
        }
    }
}
