//! Benchmark of transport: rays, a solve, its adjoint, the source of light, sums of responses and the irradiance of Gaussians.
//!
//! A furnished room of 8192 surfels in an enclosure, 64 rays each. Some rays are checked against all discs. The solve is
//! checked by one more bounce of the reference; the adjoint by the identity of scalar products with the solve.

use super::Context;
use crate::harness::{Rig, add_passes, bytes, spans};
use crate::report::Report;
use crate::stats::Summary;
use sgs_engine::graph::{Buffer, Graph};
use sgs_passes::cost::Counts;
use sgs_passes::reference::rng::Pcg;
use sgs_passes::reference::transport::{
    self as reference, Disc, Matrix, RoomParameters, SurfelMaterial, V3, direction, source,
};
use sgs_passes::shade::PixelMaterials;
use sgs_passes::transport::{
    AdjointInputs, DirectLight, Enclosure, GatherColumns, GatherInputs, GaussianEmitters, MatrixColumns, MatrixRows,
    MatrixShape, NearestOptions, ParameterGradients, ResponseRadiosity, ResponseSource, Responses, Solution,
    SolveGradients, SolveInputs, SolveOptions, SourceGradients, SourceInputs, Sources, SurfelTree, Surfels,
    TransportRays, gaussian_emission, irradiance_gather, irradiance_gather_bwd, nearest_surfels, receivers,
    response_radiosity, response_source, response_store, response_sum, transport_adjoint, transport_rays,
    transport_rows, transport_solve, transport_source, transport_source_bwd, transposed,
};
use std::time::Instant;

/// Number of surfels.
const SURFELS: usize = 8192;
/// Number of rays of a receiver.
const RAYS: u32 = 64;
/// Number of lights.
const LIGHTS: usize = 8;
/// Number of rays that the reference traces.
const CHECKED: usize = 512;
/// Number of emitters whose responses are added.
const EMITTERS: u32 = 8;
/// Corners of the room, in meters.
const ROOM: [[f32; 3]; 2] = [[0.0; 3], [6.0, 5.0, 2.7]];
/// Distance above surfels at which rays begin.
const OFFSET: f32 = 0.01;

/// Measures all.
pub fn all(c: &Context<'_>, report: &mut Report) -> anyhow::Result<()> {
    let surfels = room();
    let [low, high] = [ROOM[0].map(|x| x - 0.2), ROOM[1].map(|x| x + 0.2)];
    let enclosure = Enclosure::new(low, high, 0.4)?;
    let (rows, targets) = rays(c, report, &surfels, &enclosure)?;
    let shape = MatrixShape { receivers: SURFELS as u32 + enclosure.patch_count(), rays: RAYS };
    let case = Case::new(shape, rows, targets);
    for accelerated in [true, false] {
        case.solve(c, report, accelerated)?;
    }
    case.adjoint(c, report)?;
    sources(c, report, shape.receivers)?;
    case.responses(c, report)?;
    case.gather(c, report, &surfels)
}

/// Measures reflectance and source of all receivers, and their gradients.
fn sources(c: &Context<'_>, report: &mut Report, receivers: u32) -> anyhow::Result<()> {
    let mut rng = Pcg::new(19);
    let (surfels, patches) = (SURFELS, receivers as usize - SURFELS);
    let mut color = |low: f64, high: f64| [0; 3].map(|_| f64::from(rng.range(low, high) as f32));
    let room = RoomParameters {
        surfels: (0..surfels)
            .map(|_| SurfelMaterial { albedo: color(0.05, 0.9), roughness: color(0.1, 1.0)[0], metallic: 0.0 })
            .collect(),
        enclosure: (0..6).map(|_| color(-1.0, 1.0)).collect(),
        faces: (0..patches).map(|i| i * 6 / patches.max(1)).collect(),
        unit: (0..LIGHTS).map(|_| (0..receivers).map(|_| color(0.0, 1.0)[0]).collect()).collect(),
        log_colors: (0..LIGHTS).map(|_| color(-1.0, 2.0)).collect(),
    };
    let gradient: Vec<V3> = (0..receivers).map(|_| color(-1.0, 1.0)).collect();
    let mut g = Graph::new("transport_source");
    let mut inputs = Vec::new();
    let mut input = |g: &mut Graph, name: &str, data: Vec<u8>| {
        let buffer = g.input(name, data.len() as u64);
        inputs.push((buffer, data));
        buffer
    };
    let materials = room.surfels.iter().flat_map(|m| [m.albedo[0], m.albedo[1], m.albedo[2], m.roughness]);
    let narrow = |values: Vec<f64>| bytes(&values.iter().map(|x| *x as f32).collect::<Vec<_>>());
    let faces: Vec<u32> = room.faces.iter().map(|face| *face as u32).collect();
    let a = SourceInputs {
        receivers,
        surfels: surfels as u32,
        lights: LIGHTS as u32,
        materials: PixelMaterials {
            materials: input(&mut g, "materials", narrow(materials.collect())),
            metallic: None,
        },
        enclosure: input(&mut g, "enclosure", narrow(room.enclosure.concat())),
        faces: input(&mut g, "faces", bytes(&faces)),
        unit: input(&mut g, "unit", narrow(room.unit.concat())),
        log_colors: input(&mut g, "log_colors", narrow(room.log_colors.concat())),
    };
    let by_source = input(&mut g, "by_source", narrow(gradient.concat()));
    let by_reflectance = input(&mut g, "by_reflectance", narrow(vec![0.0; 3 * receivers as usize]));
    let by_colors = input(&mut g, "by_colors", narrow(vec![0.0; 3 * LIGHTS]));
    let n = u64::from(receivers);
    let into = Sources {
        reflectance: g.external("reflectance", 12 * n),
        source: g.external("source", 12 * n),
        colors: g.external("colors", 12 * LIGHTS as u64),
    };
    transport_source(&mut g, &c.tuning, &a, &into)?;
    let gradients = SourceGradients { reflectance: by_reflectance, source: by_source, colors: by_colors };
    let back = ParameterGradients {
        materials: PixelMaterials { materials: g.external("materials_gradient", 16 * surfels as u64), metallic: None },
        log_colors: g.external("colors_gradient", 12 * LIGHTS as u64),
        enclosure: g.external("enclosure_gradient", 72),
    };
    transport_source_bwd(&mut g, &c.tuning, &a, &gradients, &back)?;
    let mut rig = Rig::new(c.device, g, inputs, true)?;
    let (times, _) = rig.measure(c.warmup, c.repeats)?;
    add_passes(report, rig.plan(), &times, &Counts::default(), &c.ceiling);
    // The source is linear in the colors: its gradients by log colors add up to its product with the gradient.
    let right: f64 =
        source(&room).source.iter().zip(&gradient).map(|(s, g)| s[0] * g[0] + s[1] * g[1] + s[2] * g[2]).sum();
    let found: f64 = rig.get::<f32>(back.log_colors)?.iter().map(|x| f64::from(*x)).sum();
    let scale: f64 = source(&room).source.iter().flatten().sum();
    anyhow::ensure!((found - right).abs() < 1e-4 * scale, "Gradients by log colors add up to {found}, not {right}.");
    report.check(format!("transport: gradients of {LIGHTS} lights add up to those of the reference"));
    Ok(())
}

/// Draws surfels on the walls of a room and on boxes in it.
fn room() -> Surfels {
    let mut rng = Pcg::new(7);
    let mut boxes = vec![(ROOM[0], ROOM[1], true)];
    for _ in 0..12 {
        let size = [0; 3].map(|_| rng.range(0.3, 1.2) as f32);
        let low = [0, 1, 2].map(|k| if k == 2 { 0.0 } else { rng.range(0.0, f64::from(ROOM[1][k] - size[k])) as f32 });
        boxes.push((low, [0, 1, 2].map(|k| low[k] + size[k]), false));
    }
    let area = |low: &[f32; 3], high: &[f32; 3], face: usize| {
        let side = |k: usize| high[k] - low[k];
        side((face / 2 + 1) % 3) * side((face / 2 + 2) % 3)
    };
    let faces: Vec<_> = boxes.iter().flat_map(|b| (0..6).map(move |face| (*b, face))).collect();
    let all: f32 = faces.iter().map(|((low, high, _), face)| area(low, high, *face)).sum();
    let mut s = Surfels::default();
    let mut carry = 0.0;
    for ((low, high, inward), face) in &faces {
        carry += SURFELS as f32 * area(low, high, *face) / all;
        let axis = face / 2;
        while carry >= 0.5 && s.len() < SURFELS {
            carry -= 1.0;
            let mut point = [0, 1, 2].map(|k| rng.range(low[k].into(), high[k].into()) as f32);
            point[axis] = if face % 2 == 0 { low[axis] } else { high[axis] };
            let mut normal = [0.0; 3];
            normal[axis] = if (face % 2 == 0) == *inward { 1.0 } else { -1.0 };
            s.points.push(point);
            s.normals.push(normal);
            s.radii.push((1.5 * all / (std::f32::consts::PI * SURFELS as f32)).sqrt());
        }
    }
    while s.len() < SURFELS {
        let last = s.len() - 1;
        s.points.push(s.points[last]);
        s.normals.push(s.normals[last]);
        s.radii.push(s.radii[last]);
    }
    s
}

/// Measures the rays. Returns the packed rows and the targets.
fn rays(
    c: &Context<'_>,
    report: &mut Report,
    surfels: &Surfels,
    enclosure: &Enclosure,
) -> anyhow::Result<(Vec<u32>, Vec<u32>)> {
    let begin = Instant::now();
    let tree = SurfelTree::new(surfels)?;
    report.fact("transport: building the tree, ms", begin.elapsed().as_secs_f64() * 1e3);
    let mut g = Graph::new("transport_rays");
    let handles = tree.declare(&mut g);
    let records = receivers(surfels, enclosure);
    let buffer = g.input("receivers", 4 * records.len() as u64);
    let what = TransportRays {
        tree: handles,
        receivers: buffer,
        enclosure: *enclosure,
        surfels: SURFELS as u32,
        rays: RAYS,
        seed: 3,
        offset: OFFSET,
    };
    let shape = MatrixShape { receivers: what.count(), rays: RAYS };
    let targets = g.external("targets", what.target_bytes());
    let rows = MatrixRows { shape, rows: g.external("rows", shape.bytes()) };
    transport_rays(&mut g, &c.tuning, &what, targets)?;
    transport_rows(&mut g, &c.tuning, targets, &rows)?;
    let mut inputs = vec![(buffer, bytes(&records))];
    inputs.extend(tree.contents(&handles));
    let mut rig = Rig::new(c.device, g, inputs, true)?;
    let (times, _) = rig.measure(c.warmup, c.repeats)?;
    add_passes(report, rig.plan(), &times, &Counts::default(), &c.ceiling);

    let found: Vec<u32> = rig.get(targets)?;
    let discs: Vec<Disc> = (0..SURFELS)
        .map(|i| Disc {
            point: surfels.points[i].map(f64::from),
            normal: surfels.normals[i].map(f64::from),
            radius: surfels.radii[i].into(),
        })
        .collect();
    for at in (0..SURFELS * RAYS as usize).step_by(SURFELS * RAYS as usize / CHECKED) {
        let i = at / RAYS as usize;
        let (point, normal) = (discs[i].point, discs[i].normal);
        let along = direction(normal, what.seed, i as u32, at as u32 % RAYS, RAYS);
        let from: V3 = std::array::from_fn(|k| point[k] + f64::from(OFFSET) * normal[k]);
        let met = ((found[at] as usize) < SURFELS).then_some(found[at] as usize);
        let right = Disc::may_be_closest(&discs, from, along, f64::INFINITY, met);
        anyhow::ensure!(right, "Ray {at} meets {met:?}, which is not the reference's.");
    }
    report.check(format!("transport: {CHECKED} rays meet what the reference's do"));
    Ok((rig.get(rows.rows)?, found))
}

/// Matrix with reflectance and source.
struct Case {
    shape: MatrixShape,
    rows: Vec<u32>,
    matrix: Matrix,
    reflectance: Vec<V3>,
    source: Vec<V3>,
}

/// Returns triples as floats of the device.
fn floats(values: &[V3]) -> Vec<u8> {
    bytes(&values.iter().flatten().map(|x| *x as f32).collect::<Vec<f32>>())
}

fn triples(values: &[f32]) -> Vec<V3> {
    values.chunks(3).map(|c| [c[0], c[1], c[2]].map(f64::from)).collect()
}

fn dot(a: &[V3], b: &[V3]) -> f64 {
    a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| a * b).sum()
}

impl Case {
    fn new(shape: MatrixShape, rows: Vec<u32>, targets: Vec<u32>) -> Case {
        let mut rng = Pcg::new(11);
        let n = shape.receivers as usize;
        let reflectance = (0..n).map(|_| [0; 3].map(|_| rng.range(0.2, 0.9))).collect();
        // Direct light falls on some surfaces.
        let source = (0..n).map(|i| [if i % 7 < 2 { rng.range(0.5, 2.0) } else { 0.0 }; 3]).collect();
        Case { shape, rows, matrix: Matrix { receivers: n, targets }, reflectance, source }
    }

    fn measure(
        c: &Context<'_>,
        report: &mut Report,
        name: &str,
        g: Graph,
        inputs: Vec<(Buffer, Vec<u8>)>,
    ) -> anyhow::Result<Rig> {
        let mut rig = Rig::new(c.device, g, inputs, true)?;
        let (times, _) = rig.measure(c.warmup, c.repeats)?;
        add_passes(report, rig.plan(), &times, &Counts::default(), &c.ceiling);
        report.time(
            &format!("transport: {name}"),
            "ms",
            Summary::of(&spans(&times).iter().map(|t| t / 1e6).collect::<Vec<_>>()),
        );
        Ok(rig)
    }

    /// Measures the solve with the default tolerance.
    fn solve(&self, c: &Context<'_>, report: &mut Report, accelerated: bool) -> anyhow::Result<()> {
        let name = if accelerated { "solve" } else { "solve with Jacobi's iteration" };
        let n = u64::from(self.shape.receivers);
        let mut g = Graph::new(if accelerated { "transport_solve" } else { "transport_jacobi" });
        let rows = MatrixRows { shape: self.shape, rows: g.input("rows", self.shape.bytes()) };
        let [reflectance, source] = ["reflectance", "source"].map(|name| g.input(name, 12 * n));
        let [radiosity, irradiance] = ["radiosity", "irradiance"].map(|name| g.external(name, 12 * n));
        let into = Solution { radiosity, irradiance, convergence: g.external("convergence", 8) };
        let a = SolveInputs { matrix: rows, lights: 1, reflectance, source, initial: None };
        let options = SolveOptions { accelerated, ..SolveOptions::default() };
        transport_solve(&mut g, &c.tuning, &a, &options, &into)?;
        let inputs = vec![
            (rows.rows, bytes(&self.rows)),
            (reflectance, floats(&self.reflectance)),
            (source, floats(&self.source)),
        ];
        let rig = Case::measure(c, report, name, g, inputs)?;
        let iterations = rig.get::<u32>(into.convergence)?[0];
        report.fact(&format!("transport: iterations of the {name}"), iterations);
        let found = triples(&rig.get::<f32>(radiosity)?);
        let (next, _) = self.matrix.bounce(&self.reflectance, &self.source, &found);
        let off = next.iter().zip(&found).flat_map(|(a, b)| (0..3).map(|k| (a[k] - b[k]).abs() / a[k].max(1e-2)));
        let off = off.fold(0.0, f64::max);
        anyhow::ensure!(
            off < 2e-3 && iterations < options.iterations,
            "After {iterations} iterations a bounce changes {off}."
        );
        report.check(format!("transport: after the {name} a bounce changes at most {off:.1e}"));
        Ok(())
    }

    /// Measures the adjoint.
    fn adjoint(&self, c: &Context<'_>, report: &mut Report) -> anyhow::Result<()> {
        let n = u64::from(self.shape.receivers);
        let begin = Instant::now();
        let columns = transposed(&self.matrix.targets, self.shape.receivers);
        report.fact("transport: transposing, ms", begin.elapsed().as_secs_f64() * 1e3);
        let mut g = Graph::new("transport_adjoint");
        let matrix = MatrixColumns {
            shape: self.shape,
            starts: g.input("starts", 4 * (n + 1)),
            rows: g.input("column_rows", 4 * columns.rows.len() as u64),
        };
        let [reflectance, irradiance, gradient] =
            ["reflectance", "irradiance", "irradiance_gradient"].map(|name| g.input(name, 12 * n));
        let [by_source, by_reflectance] =
            ["source_gradient", "reflectance_gradient"].map(|name| g.external(name, 12 * n));
        let convergence = g.external("convergence", 8);
        let into = SolveGradients { source: by_source, reflectance: by_reflectance, convergence };
        let a = AdjointInputs {
            matrix,
            lights: 1,
            reflectance,
            irradiance,
            radiosity_gradient: None,
            irradiance_gradient: Some(gradient),
        };
        transport_adjoint(&mut g, &c.tuning, &a, &SolveOptions::default(), &into)?;
        // The irradiance under this source, by many bounces.
        let mut solved = (self.source.clone(), Vec::new());
        for _ in 0..60 {
            solved = self.matrix.bounce(&self.reflectance, &self.source, &solved.0);
        }
        let mut rng = Pcg::new(13);
        let direction: Vec<V3> = (0..n).map(|_| [0; 3].map(|_| rng.range(0.0, 1.0))).collect();
        let inputs = vec![
            (matrix.starts, bytes(&columns.starts)),
            (matrix.rows, bytes(&columns.rows)),
            (reflectance, floats(&self.reflectance)),
            (irradiance, floats(&solved.1)),
            (gradient, floats(&direction)),
        ];
        let rig = Case::measure(c, report, "adjoint", g, inputs)?;
        let found = triples(&rig.get::<f32>(by_source)?);
        // The irradiance is linear in the source.
        let (one, other) = (dot(&found, &self.source), dot(&direction, &solved.1));
        anyhow::ensure!((one / other - 1.0).abs() < 2e-3, "Scalar products of the adjoint are {one} and {other}.");
        report.check(format!("transport: scalar products of the adjoint differ by {:.1e}", (one / other - 1.0).abs()));
        Ok(())
    }

    /// Measures the sum of responses, and the emission of Gaussians.
    fn responses(&self, c: &Context<'_>, report: &mut Report) -> anyhow::Result<()> {
        let (receivers, count) = (self.shape.receivers, c.workload.start.len() as u32);
        let mut g = Graph::new("response_sum");
        let a = Responses {
            lights: EMITTERS,
            receivers,
            responses: g.input("responses", 12 * u64::from(EMITTERS) * u64::from(receivers)),
            colors: g.input("colors", 12 * u64::from(EMITTERS)),
        };
        let emitters = GaussianEmitters {
            gaussians: count,
            emitters: EMITTERS,
            numbers: g.input("numbers", 4 * u64::from(count)),
            radiance: a.colors,
        };
        let irradiance = g.external("irradiance", 12 * u64::from(receivers));
        let values = g.external("values", 16 * u64::from(count));
        response_sum(&mut g, &c.tuning, &a, irradiance)?;
        gaussian_emission(&mut g, &c.tuning, &emitters, values)?;
        // The response to one of the emitters of another scene.
        let again = Responses { responses: g.external("stored", 12 * u64::from(EMITTERS) * u64::from(receivers)), ..a };
        let index = g.input("emitter", 4);
        let unit = g.input("unit", 4 * u64::from(receivers));
        let source = g.external("source", 12 * u64::from(receivers));
        let from_unit = ResponseSource { receivers, unit, reflectance: irradiance, source };
        response_source(&mut g, &c.tuning, &from_unit)?;
        let pairs = 4 * u64::from(EMITTERS) * u64::from(receivers);
        let direct = DirectLight { unit, units: g.external("units", pairs) };
        response_store(&mut g, &c.tuning, &again, index, source, Some(&direct))?;
        let radiosity = ResponseRadiosity {
            lights: EMITTERS,
            receivers,
            unit: g.input("direct_light", pairs),
            colors: a.colors,
            irradiance,
            reflectance: source,
            radiosity: g.external("radiosity", 12 * u64::from(receivers)),
        };
        response_radiosity(&mut g, &c.tuning, &radiosity)?;
        let mut rng = Pcg::new(19);
        let mut random = |n: u32| (0..n).map(|_| [0; 3].map(|_| rng.range(0.0, 2.0))).collect::<Vec<V3>>();
        let (responses, colors) = (random(EMITTERS * receivers), random(EMITTERS));
        let numbers: Vec<u32> = (0..count).map(|i| i % (EMITTERS + 1)).collect();
        let inputs = vec![
            (a.responses, floats(&responses)),
            (a.colors, floats(&colors)),
            (emitters.numbers, bytes(&numbers)),
            (index, bytes(&[1_u32])),
            (unit, bytes(&vec![1.0_f32; receivers as usize])),
            (radiosity.unit, bytes(&vec![1.0_f32; (EMITTERS * receivers) as usize])),
        ];
        let rig = Case::measure(c, report, "sum of responses", g, inputs)?;
        let by_emitter: Vec<Vec<V3>> = responses.chunks(receivers as usize).map(<[V3]>::to_vec).collect();
        let expected = reference::response_sum(&by_emitter, &colors, receivers as usize);
        let found = triples(&rig.get::<f32>(irradiance)?);
        let apart = |a: &V3, b: &V3| (0..3).map(|k| (a[k] - b[k]).abs() / b[k].max(1e-3)).fold(0.0, f64::max);
        let off = found.iter().zip(&expected).map(|(a, b)| apart(a, b)).fold(0.0, f64::max);
        anyhow::ensure!(off < 1e-5, "The sum of responses differs by {off} from the reference.");
        report.check(format!("transport: the sum of {EMITTERS} responses differs by {off:.1e} from the reference"));
        Ok(())
    }

    /// Measures the irradiance of Gaussians and its transpose.
    fn gather(&self, c: &Context<'_>, report: &mut Report, surfels: &Surfels) -> anyhow::Result<()> {
        let mut rng = Pcg::new(17);
        let count = c.workload.start.len();
        let points: Vec<[f32; 3]> =
            (0..count).map(|_| [0, 1, 2].map(|k| rng.range(ROOM[0][k].into(), ROOM[1][k].into()) as f32)).collect();
        let normals: Vec<[f32; 3]> = (0..count).map(|i| surfels.normals[i % SURFELS]).collect();
        let begin = Instant::now();
        let options = NearestOptions { normal_length: 0.25, least_distance: 0.01 };
        let nearest = nearest_surfels(&points, &normals, surfels, &options);
        report.fact("transport: nearest surfels, ms", begin.elapsed().as_secs_f64() * 1e3);
        let columns = nearest.columns(self.shape.receivers);
        let mut g = Graph::new("irradiance_gather");
        let mut inputs = Vec::new();
        let mut input = |g: &mut Graph, name: &str, data: Vec<u8>| {
            let buffer = g.input(name, data.len() as u64);
            inputs.push((buffer, data));
            buffer
        };
        let a = GatherInputs {
            gaussians: count as u32,
            receivers: self.shape.receivers,
            lights: 1,
            neighbors: input(&mut g, "neighbors", bytes(&nearest.neighbors)),
            weights: input(&mut g, "weights", bytes(&nearest.weights)),
            irradiance: input(&mut g, "irradiance", floats(&self.source)),
            log_gains: Some(input(&mut g, "log_gains", bytes(&vec![0.0_f32; count]))),
        };
        let back = GatherColumns {
            receivers: self.shape.receivers,
            starts: input(&mut g, "starts", bytes(&columns.starts)),
            gaussians: input(&mut g, "gaussians", bytes(&columns.gaussians)),
            weights: input(&mut g, "column_weights", bytes(&columns.weights)),
        };
        let gradient = input(&mut g, "values_gradient", bytes(&vec![1.0_f32; 4 * count]));
        let values = g.external("values", 16 * count as u64);
        let sums = g.external("irradiance_gradient", 12 * u64::from(self.shape.receivers));
        irradiance_gather(&mut g, &c.tuning, &a, values)?;
        irradiance_gather_bwd(&mut g, &c.tuning, &back, gradient, sums)?;
        let mut rig = Rig::new(c.device, g, inputs, true)?;
        let (times, _) = rig.measure(c.warmup, c.repeats)?;
        let counts = Counts { gaussians: count as f64, ..Default::default() };
        add_passes(report, rig.plan(), &times, &counts, &c.ceiling);
        // Weights of every Gaussian add up to one.
        let all: f64 = rig.get::<f32>(sums)?.iter().map(|x| f64::from(*x)).sum();
        let right = 3.0 * count as f64;
        anyhow::ensure!((all / right - 1.0).abs() < 1e-4, "The transposed gather distributes {all} of {right}.");
        report.check(format!("transport: the gather of {count} Gaussians keeps the sum of gradients"));
        Ok(())
    }
}
