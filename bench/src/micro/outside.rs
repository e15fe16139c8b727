//! Benchmark of light from outside: `transport_lights` of a window onto an environment, and of a sun through openings.
//!
//! The surfels and pixels of `area_lights`. Some pairs are checked against the reference.

use super::Context;
use super::area_lights::{check, receivers_at, rows_of, surfels};
use super::lights::{Lit, bind};
use crate::harness::{Rig, add_passes, bytes};
use crate::report::Report;
use sgs_engine::graph::Graph;
use sgs_passes::cost::Counts;
use sgs_passes::shade::environment::latlong;
use sgs_passes::shade::lights::LightModel;
use sgs_passes::transport::{
    AreaLight, AreaLights, LIGHT_SAMPLES, LightReceivers, LightShape, Opening, Outside, SKY_SIZE, ShadowRays, Sky,
    SurfelTree, parts_of, transport_lights,
};

/// Number of openings of a room with many.
const MANY: u32 = 64;

/// Light from outside, and how many openings and texels its rays see.
struct Case {
    name: &'static str,
    light: AreaLight,
    outside: Outside,
}

/// Returns an environment that is brightest above.
fn sky() -> Option<Sky> {
    let [columns, rows] = SKY_SIZE;
    let of =
        |i: u32| [1.0, 0.8, 0.6].map(|c| c * (1.5 + latlong::direction(SKY_SIZE, i % columns, i / columns)[1] as f32));
    Sky::new(&(0..columns * rows).flat_map(of).collect::<Vec<f32>>(), SKY_SIZE)
}

/// Returns strips of the wall at low z, which together are all of it.
fn strips() -> Vec<Opening> {
    let width = 3.2 / MANY as f32;
    let strip = |i: u32| Opening {
        corner: [-1.6 + i as f32 * width, -1.6, -1.6],
        edge_u: [width, 0.0, 0.0],
        edge_v: [0.0, 3.2, 0.0],
    };
    (0..MANY).map(strip).collect()
}

fn cases() -> [Case; 3] {
    let light = |shape| AreaLight { shape, color: [1.0; 3] };
    let (edge_u, edge_v) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
    let window = light(LightShape::Window { corner: [-0.5, -0.5, -1.45], edge_u, edge_v });
    let sun = light(LightShape::Directional { direction: [0.3, 0.4, 0.8], angular_radius: 0.05 });
    let through = |openings| Outside { openings, sky: None };
    [
        Case { name: "window_light", light: window, outside: Outside { openings: Vec::new(), sky: sky() } },
        Case { name: "sun_6_openings", light: sun, outside: through(Opening::around(1.6).to_vec()) },
        Case { name: "sun_64_openings", light: sun, outside: through(strips()) },
    ]
}

/// Measures all.
pub fn all(c: &Context<'_>, report: &mut Report) -> anyhow::Result<()> {
    let (size, model, surfels) = (c.workload.largest, LightModel::default(), surfels());
    let (lit, tree) = (Lit::room(size, model), SurfelTree::new(&surfels)?);
    let (n, count) = (lit.points.len(), surfels.len());
    for Case { name, light, outside } in cases() {
        let parts = parts_of([&light]).len();
        let mut g = Graph::new(name);
        let mut b = bind(&mut g, &lit, size, model);
        let (of_tree, of_outside) = (tree.declare(&mut g), outside.declare(&mut g));
        let lights = AreaLights::declare(&mut g, parts as u32);
        b.inputs.extend(tree.contents(&of_tree));
        b.inputs.extend(outside.contents(&of_outside));
        b.inputs.extend(lights.contents(&[light]));
        let rays = ShadowRays {
            tree: of_tree,
            outside: of_outside,
            offset: 0.01,
            clearance: 0.01,
            samples: LIGHT_SAMPLES,
            seed: 3,
        };
        let buffer = g.input("receivers", 32 * count as u64);
        b.inputs.push((buffer, bytes(&rows_of(&surfels))));
        let of_surfels = LightReceivers::Surfels { receivers: buffer, count: count as u32 };
        let of_pixels = LightReceivers::Pixels { screen: b.pixels.screen, surfaces: b.pixels.surfaces };
        let units = [("surfels_unit", of_surfels, count), ("unit", of_pixels, n)];
        let mut found = Vec::new();
        for (what, to, receivers) in &units {
            let unit = g.external(*what, 4 * (parts * receivers) as u64);
            transport_lights(&mut g, c.tuning, to, &lights, &rays, None, unit)?;
            found.push(unit);
        }
        let mut rig = Rig::new(c.device, g, b.inputs, true)?;
        let (times, _) = rig.measure(c.warmup, c.repeats)?;
        let sun = f64::from(u8::from(matches!(light.shape, LightShape::Directional { .. })));
        let counts = |receivers: usize| Counts {
            pixels: receivers as f64,
            lights: parts as f64,
            gaussians: tree.discs() as f64,
            suns: sun,
            openings: outside.openings.len() as f64,
            windows: parts as f64 * (1.0 - sun),
            sky: outside.sky.as_ref().map_or(1.0, |s| f64::from(s.size()[0] * s.size()[1])),
            ..Default::default()
        };
        let (surfel_times, pixel_times): (Vec<_>, Vec<_>) =
            times.into_iter().partition(|t| t.name == "transport_lights");
        add_passes(report, rig.plan(), &surfel_times, &counts(count), &c.ceiling);
        add_passes(report, rig.plan(), &pixel_times, &counts(n), &c.ceiling);
        let of = [receivers_at(&surfels.points, &surfels.normals), receivers_at(&lit.points, &lit.normals)];
        for ((unit, receivers), (what, ..)) in found.into_iter().zip(&of).zip(&units) {
            check(what, &rig.get::<f32>(unit)?, receivers, &surfels, (&[light], &outside))?;
        }
    }
    report.check("light from outside: some irradiances by a window and a sun are those of the reference".to_owned());
    Ok(())
}
