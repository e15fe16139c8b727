//! Measures alternatives to the enclosure: the radiance of rays that meet no surfel.
//!
//! Trains nothing. `SGS_TEST_RUN` names a run with emitters:
//!
//!     SGS_TEST_RUN=RUN cargo test -p sgs-relight --locked closures -- --ignored --nocapture

use super::*;
use crate::emitting::emission;
use crate::painted::read;
use sgs_engine::DeviceOptions;
use sgs_passes::Tuning;
use sgs_passes::pipeline::TransportScene;
use sgs_passes::transport::{Enclosure, SolveOptions, SurfelTree};
use sgs_run::{RunDirectory, Visibility, shaded_scene};
use sgs_transport::{LitRoom, TransportError};
use std::f32::consts::PI;
use std::path::Path;

/// Hemispherical reflectance of a patch's specular lobe, as in a room.
const SHEEN: f32 = 0.03;
/// Number of bounces on the host.
const BOUNCES: usize = 40;
/// Minimum number of surfels of a plane.
const LEAST_SURFELS: usize = 30;

/// Radiance of rays that meet no surfel.
#[derive(Clone, Copy, PartialEq)]
enum Closure {
    Black,
    /// Mean radiosity of all surfels.
    MeanOfSurfels,
    /// Mean radiosity that the receiver's other rays meet.
    MeanOfHits,
    /// Box, all its faces of the mean albedo of the surfels.
    BoxOfMean,
    /// Box of the run.
    BoxOfRun,
    /// Planes through walls, floor and ceiling, with their surfels' mean reflectance.
    Planes,
}

const ALL: [(Closure, &str); 6] = [
    (Closure::Black, "black"),
    (Closure::MeanOfSurfels, "mean radiosity of the surfels"),
    (Closure::MeanOfHits, "mean of the receiver's rays that hit"),
    (Closure::BoxOfMean, "box, mean albedo"),
    (Closure::BoxOfRun, "box, fitted albedo per face"),
    (Closure::Planes, "planes through walls, floor and ceiling"),
];

impl Closure {
    /// Returns the irradiance of the surfels, or of all receivers, `[receivers * 3]`.
    fn bounced(self, device: &Device, lit: &LitRoom<'_>) -> sgs_transport::Result<Vec<f32>> {
        let patches = 3 * lit.surfels.len()..lit.reflectance.len();
        let solve = |reflectance: &[f32], source: &[f32]| {
            Ok::<_, TransportError>(lit.scene.solve(reflectance, source, &SolveOptions::default())?)
        };
        match self {
            Closure::BoxOfRun => solve(&lit.reflectance, &lit.source),
            Closure::Black | Closure::BoxOfMean => {
                let albedo = lit.surfels.mean_albedo().map(|a| if self == Closure::Black { 0.0 } else { a + SHEEN });
                let (mut reflectance, mut source) = (lit.reflectance.clone(), lit.source.clone());
                for at in patches {
                    source[at] *= albedo[at % 3] / reflectance[at];
                    reflectance[at] = albedo[at % 3];
                }
                solve(&reflectance, &source)
            }
            Closure::MeanOfSurfels | Closure::MeanOfHits => self.averaged(lit),
            Closure::Planes => planes(device, lit),
        }
    }

    /// Returns the irradiance of the surfels if rays without a hit meet a mean.
    fn averaged(self, lit: &LitRoom<'_>) -> sgs_transport::Result<Vec<f32>> {
        let (n, rays) = (lit.surfels.len(), lit.scene.options().rays as usize);
        let targets = lit.scene.targets()?;
        let (mut radiosity, mut irradiance) = (lit.source[..3 * n].to_vec(), vec![0.0; 3 * n]);
        for _ in 0..BOUNCES {
            for c in 0..3 {
                let values = || radiosity.iter().skip(c).step_by(3).map(|b| f64::from(*b));
                let mean_of_surfels = values().sum::<f64>() / n as f64;
                for i in 0..n {
                    let hits = targets[i * rays..(i + 1) * rays].iter().filter(|t| (**t as usize) < n);
                    let count = hits.clone().count();
                    let sum: f64 = hits.map(|t| f64::from(radiosity[3 * *t as usize + c])).sum();
                    let mean = match self {
                        Closure::MeanOfHits if count > 0 => sum / count as f64,
                        _ => mean_of_surfels,
                    };
                    let all = sum + (rays - count) as f64 * mean;
                    irradiance[3 * i + c] = PI * (all / rays as f64) as f32;
                }
            }
            let next = |i: usize| lit.source[i] + lit.reflectance[i] * irradiance[i] / PI;
            radiosity = (0..3 * n).map(next).collect();
        }
        Ok(irradiance)
    }
}

/// Returns the irradiance of the receivers of a box of planes.
///
/// A plane is where most surfels face the inside, in the outer half of the room. Without enough of them, it is the face of
/// the enclosure, of the mean reflectance of all surfels.
fn planes(device: &Device, lit: &LitRoom<'_>) -> sgs_transport::Result<Vec<f32>> {
    let (n, discs) = (lit.surfels.len(), &lit.surfels.discs);
    let mean = |all: &[usize]| {
        [0, 1, 2].map(|c| all.iter().map(|i| lit.reflectance[3 * i + c]).sum::<f32>() / all.len().max(1) as f32)
    };
    let (mut corners, mut reflectance) = ([lit.enclosure.low(), lit.enclosure.high()], [[0.0; 3]; 6]);
    let edge = (corners[1][0] - corners[0][0]) / lit.enclosure.cells()[0] as f32;
    for face in 0..6 {
        let (axis, high) = (face / 2, face % 2);
        let inward = if high == 0 { 1.0 } else { -1.0 };
        let middle = 0.5 * (lit.enclosure.low()[axis] + lit.enclosure.high()[axis]);
        let width = 2.0 * lit.surfels.cell;
        let mut bins: std::collections::BTreeMap<i32, Vec<usize>> = Default::default();
        for i in (0..n).filter(|i| inward * discs.normals[*i][axis] > 0.9) {
            let from_middle = inward * (middle - discs.points[i][axis]);
            if from_middle > 0.0 {
                bins.entry((from_middle / width) as i32).or_default().push(i);
            }
        }
        let most = bins.into_values().max_by_key(Vec::len).filter(|all| all.len() >= LEAST_SURFELS);
        if let Some(all) = &most {
            corners[high][axis] = all.iter().map(|i| discs.points[*i][axis]).sum::<f32>() / all.len() as f32;
        }
        reflectance[face] = mean(&most.unwrap_or_else(|| (0..n).collect()));
    }
    let enclosure = Enclosure::new(corners[0], corners[1], edge)?;
    let (tree, tuning) = (SurfelTree::new(discs)?, Tuning::for_device(device.info()));
    let scene = TransportScene::new(device, tuning, (discs, &tree), &enclosure, *lit.scene.options())?;
    let of_patches = enclosure.patches().into_iter().flat_map(|p| reflectance[p.face as usize]);
    let all: Vec<f32> = lit.reflectance[..3 * n].iter().copied().chain(of_patches).collect();
    let mut source = vec![0.0; all.len()];
    let unit = scene.unit_light(lit.lights)?;
    for (light, unit) in lit.lights.iter().zip(unit.chunks_exact(scene.receivers() as usize)) {
        source.iter_mut().enumerate().for_each(|(at, s)| *s += light.color[at % 3] * unit[at / 3] * all[at] / PI);
    }
    Ok(scene.solve(&all, &source, &SolveOptions::default())?)
}

/// Gaussians, room and true lights of a relit set.
struct Set {
    name: String,
    splats: Splats,
    emitting: Emitting,
    lights: Lights,
}

/// Returns the sets whose true lights are known.
fn sets(at: &Measured<'_>, splats: &Splats, emitting: &Emitting, seed: u64) -> Result<Vec<Set>> {
    let known: TrueLights = read(&at.truth.lights().expect("gt/lights.json"), "lights")?;
    let mut sets = Vec::new();
    for name in at.truth.relit_names() {
        let mut edited = splats.clone();
        let list = known.relight.get(&name).unwrap_or(&known.training);
        if !known.relight.contains_key(&name) {
            let Ok(change) = painted_of(at.device, at.scene, splats, &at.truth, &name)? else { continue };
            let mut chosen = vec![false; splats.len()];
            change.place.gaussians.iter().flatten().for_each(|&g| chosen[g] = true);
            edit_materials(&change, &chosen, &mut edited);
        }
        let emitting = emitting.of_splats(at.device, at.scene, &edited, seed)?;
        let Some(lights) = true_lights(list, &known, &emitting) else { continue };
        sets.push(Set { name, splats: edited, emitting, lights });
    }
    Ok(sets)
}

#[test]
#[ignore = "takes minutes, and needs the run that SGS_TEST_RUN names"]
fn closures() {
    let run = std::env::var("SGS_TEST_RUN").expect("SGS_TEST_RUN names a run with emitters");
    let run = RunDirectory::open(Path::new(&run)).unwrap();
    let settings = run.settings().unwrap();
    let device = &Device::open(&DeviceOptions::default()).unwrap();
    let scene = &Scene::open(&settings.scene, &settings.scene_options()).unwrap();
    let splats = Splats::read_ply(&run.path("scene.ply")).unwrap();
    let emitting = Emitting::open(device, &run, scene, &splats, settings.seed).unwrap().expect("emitters.json");
    let at = Measured { device, scene, views: &scene.split.test, truth: GroundTruth::of(scene) };
    let sets = sets(&at, &splats, &emitting, settings.seed).unwrap();
    let names: Vec<String> = sets.iter().map(|s| format!("`{}`", s.name)).collect();
    println!("| closure | {} | mean |\n|---|{}", names.join(" | "), "---|".repeat(sets.len() + 1));
    for (closure, name) in ALL {
        let of_set = |set: &Set| {
            let Set { splats, emitting, lights, .. } = set;
            let emission = emission(splats, &lights.radiance);
            let mut shaded = shaded_scene(device, splats, None, None, &Visibility::None).unwrap();
            let light = emitting.room.light_by(&lights.lights, &emission, |lit| closure.bounced(device, lit)).unwrap();
            shaded.transport = Some(light);
            psnr(&at.measure(&set.name, shaded).unwrap())
        };
        let all: Vec<f64> = sets.iter().map(of_set).collect();
        let row: Vec<String> =
            all.iter().chain([&(all.iter().sum::<f64>() / all.len() as f64)]).map(|v| format!("{v:.2}")).collect();
        println!("| {name} | {} |", row.join(" | "));
    }
}
