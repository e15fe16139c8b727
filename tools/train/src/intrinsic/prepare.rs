//! Preparation of the stage: its data, its model, and the memory that it allocates.

use super::automatic::{Automatic, Found, required, tables};
use super::consistency::{Consistency, StepKind};
use super::data::{Material, MaterialPriors, scene_box, shortest_axes};
use super::needs::Sizes;
use super::relit::Relit;
use super::room::{PriorViews, lacks_normals};
use super::surfaces::Surfaces;
use super::values::light_scale;
use super::{IN_FLIGHT, Intrinsic, IntrinsicNeeds, Priors, decisions, parameters, room, start};
use crate::data::{Packed, PixelPriors};
use crate::divergence::Watch;
use crate::error::{Requirement, Result};
use crate::idle::{self, FoundForMaterials, PriorKinds};
use crate::limits;
use crate::schedule::Schedule;
use crate::uniforms::uniform_bytes;
use sgs_config::{LobeLayout, MaterialStart, Metallic, Settings, VisibilityKind};
use sgs_engine::{Device, DeviceBuffer, Location};
use sgs_passes::Matrices;
use sgs_passes::pipeline::{
    COPIES, EnvironmentMemory, IntrinsicOptions, IntrinsicParameters, IntrinsicRates, IntrinsicSizes, IntrinsicStatus,
    Masks, SurfaceBuilder, TransportMemory, TransportShape,
};
use sgs_passes::scene::{Gaussians, Model};
use sgs_passes::shade::lights::{Axes, LightModel};
use sgs_run::materials::span;
use sgs_run::{Rays, gaussian_data, traced};
use sgs_scene::{Scene, Splats, Unit};
use sgs_transport::TrainingRoom;

/// Purpose of a stage.
pub(super) enum Purpose {
    /// Training under the lights of the published model.
    Training,
    /// Estimate of its needs.
    Planning,
    /// Training under the physical lights of a room.
    InRoom(Box<TrainingRoom>),
    /// Estimate of the needs with a room of these sizes.
    PlanningRoom(TransportShape),
}

impl Intrinsic {
    /// Prepares training on given splats.
    ///
    /// # Errors
    /// If data cannot be read or memory runs out.
    pub fn new(device: &Device, scene: &Scene, settings: &Settings, splats: &Splats) -> Result<Intrinsic> {
        Intrinsic::of(device, scene, settings, splats, Purpose::Training)
    }

    /// Plans a training: like [`Intrinsic::new`], but starts no provider.
    /// Used to estimate what such a training needs.
    ///
    /// # Errors
    /// If data cannot be read or memory runs out.
    pub fn planned(device: &Device, scene: &Scene, settings: &Settings, splats: &Splats) -> Result<Intrinsic> {
        Intrinsic::of(device, scene, settings, splats, Purpose::Planning)
    }

    pub(super) fn of(
        device: &Device,
        scene: &Scene,
        settings: &Settings,
        splats: &Splats,
        purpose: Purpose,
    ) -> Result<Intrinsic> {
        settings.check()?;
        let starts_provider = matches!(purpose, Purpose::Training | Purpose::InRoom(_));
        let (room, planned_room) = match purpose {
            Purpose::Training | Purpose::Planning => (None, None),
            Purpose::InRoom(room) => (Some(*room), None),
            Purpose::PlanningRoom(shape) => (None, Some(TransportMemory::empty(device, shape)?)),
        };
        let smaller = (settings.intrinsic.scale < 1.0).then(|| scene.scaled(settings.intrinsic.scale));
        let scene = smaller.as_ref().unwrap_or(scene);
        let disturbed = settings.noise.on(scene, settings.seed);
        let scene = disturbed.as_ref().unwrap_or(scene);
        let unit = room.as_ref().map_or(scene.unit(), |room| room.unit);
        let scaled = (unit != Unit::OWN).then(|| scene.in_unit(unit));
        let scene = scaled.as_ref().unwrap_or(scene);
        if splats.is_empty() {
            return Err(Requirement::NotEmpty.into());
        }
        let s = &settings.intrinsic;
        if settings.memory.budget > 0 {
            device.set_memory_budget(Some(settings.memory.budget));
        }
        let budget = device.budget();
        let cameras: Vec<&sgs_scene::Camera> = scene.split.train.iter().map(|&i| &scene.views[i].camera).collect();
        let mut splats = splats.clone().in_unit(unit);
        if lacks_normals(&splats) {
            tracing::info!("the splats have no normals; the shortest axis of each stands in");
            splats.normals = Some(shortest_axes(&splats, &cameras));
        }
        let bounds = scene_box(&splats, &cameras);
        let mut packed = Packed::read(scene, PixelPriors::default())?;
        packed.split(device.info().largest_binding());
        let read = |kind: Material, weight: f32| -> Result<Option<MaterialPriors>> {
            if weight > 0.0 { MaterialPriors::read(scene, kind) } else { Ok(None) }
        };
        let mut albedo = read(Material::Albedo, s.losses.albedo)?;
        let mut roughness = read(Material::Roughness, s.losses.roughness)?;
        let answers = if s.metallic == Metallic::Off { None } else { read(Material::Metallic, s.losses.metallic)? };
        // Priors are packed like the photographs.
        let one = limits::Remedy::Views { views: 1, scale: settings.scale };
        limits::check(device.info(), &[limits::Single::bound("pixels of a photograph", packed.image_bytes(), one)])?;
        let requested = settings;
        let (of, automatic, mut decisions) = match s.automatic.enabled {
            true => {
                let found = Found {
                    splats: &splats,
                    cameras: &cameras,
                    bounds: &bounds,
                    roughness: roughness.as_ref().map(|p| &p.packed[..]),
                    metallic: answers.as_ref().map(|p| &p.packed[..]),
                };
                let (of, decisions) = required(&found, s);
                (of, Some(Automatic::new(&packed)), decisions)
            }
            false => (s.clone(), None, Vec::new()),
        };
        let settings = &Settings { intrinsic: of, ..settings.clone() };
        let s = &settings.intrinsic;
        let any_metallic = answers.is_some();
        let answers = answers.filter(|_| s.metallic != Metallic::Off);
        let metallic = match s.metallic {
            Metallic::Auto => answers.is_some(),
            Metallic::On => true,
            Metallic::Off => false,
        };
        let tuning = settings.tuning(device.info());
        if settings.accuracy.visibility_bits == 16
            && let Err(why) = Matrices::for_device(device.info())
        {
            tracing::info!("accuracy.visibility_bits = 16 uses no matrix units: {why}");
        }
        let model = Model { sh_degree: 0, normals: true, semantics: false, mip: splats.antialiased };
        let gaussians = Gaussians::with(device, model, splats.len() as u32, false, false)?;
        gaussians.upload(device, &gaussian_data(&splats, model))?;
        let schedule = Schedule::new(settings, scene.extent(), packed.views().len());
        let consistency = Consistency::load(device, scene, settings, packed.largest, !starts_provider)?;
        let others = consistency.as_ref().map(|c| c.cameras(settings, &schedule)).unwrap_or_default();
        let builder = Surfaces::measure(device, tuning, &gaussians, packed.views(), packed.largest, &others)?;
        let axes = if s.lights.layout == LobeLayout::Grid { Axes::Grid } else { Axes::Free };
        let light_model = LightModel { lights: s.lights.grid.max(1).pow(3), lobes: s.lights.lobes, axes };
        let seed = settings.seed as u32;
        let has_environment = s.environment.enabled();
        let environment = has_environment.then(|| tables(s, s.environment.resolution)).transpose()?;
        let traced = match s.visibility.kind == VisibilityKind::Traced && s.lights.enabled() {
            true => Some(traced(device, &splats, Rays::of(&s.visibility))?),
            false => None,
        };
        let (traced, shape) = traced.unzip();
        let r = &s.rates;
        let material_rates = match &room {
            Some(_) => room::material_rates(roughness.is_some(), answers.is_some()),
            None => [r.materials; 3],
        };
        let mut options = IntrinsicOptions {
            shape: builder.shape(),
            albedo_range: span(s.albedo_range),
            metallic,
            lights: s.lights.enabled().then(|| (light_model, 1.0 / light_model.lights as f32)),
            visibility: s.visibility.config().filter(|_| s.lights.enabled()),
            traced: shape,
            transport: {
                let memory = room.as_ref().map(|room| &room.memory).or(planned_room.as_ref());
                memory.map(|memory| room::training(*memory.shape(), albedo.is_some()))
            },
            visibility_jitter: s.losses.visibility_jitter > 0.0,
            visibility_sample: s.visibility.sample,
            light_regularizers: [s.losses.light_position, s.losses.light_value],
            cull_error: s.cull_error,
            environment_smooth: s.losses.environment_smooth,
            environment_every: s.environment.every,
            masks: consistency.as_ref().map_or(Masks::Carried, |c| c.regions().masks()),
            cross_view: false,
            relight: false,
            own_prior: s.own_prior_weight() > 0.0 && albedo.is_some(),
            relight_roughness: s.relight.roughness,
            edge_aware: s.losses.albedo_smooth > 0.0 || s.losses.roughness_smooth > 0.0,
            gradients: s.losses.gradients > 0.0,
            rates: IntrinsicRates {
                albedo: material_rates[0],
                roughness: material_rates[1],
                metallic: material_rates[2],
                // The published unit is the one in which the box has side 3.
                light_positions: r.lights * light_scale(&bounds).sqrt(),
                lights: r.lights,
                environment: r.environment,
                visibility: r.visibility,
                normals: r.normals,
            },
            image: false,
            timestamps: false,
            frames_in_flight: IN_FLIGHT,
        };
        // Starts no provider if no step would compare its answers.
        let due = (1..=s.steps).any(|step| StepKind::of(s, step) == StepKind::Relight);
        let command = s.relight.command().filter(|_| s.losses.relight > 0.0 && due && consistency.is_some());
        let relit = match command {
            Some(command) => {
                let helper = if starts_provider { Relit::helper(settings, command)? } else { None };
                let wanted = helper.is_some() || !starts_provider;
                let make = || Relit::new(device, scene, settings, helper, &bounds, &packed);
                wanted.then(make).transpose()?
            }
            None => None,
        };
        options.relight = relit.is_some();
        let sizes = Sizes {
            inputs: IntrinsicSizes {
                targets: packed.image_bytes(),
                albedo: albedo.as_ref().map(|_| packed.image_bytes()),
                roughness: roughness.as_ref().map(|_| packed.image_bytes()),
                metallic: answers.as_ref().map(|_| packed.image_bytes()),
                regions: consistency.as_ref().map(|c| c.regions().ids().bytes()),
                pseudo_regions: consistency.as_ref().and_then(|c| c.regions().pseudo_ids()).map(DeviceBuffer::bytes),
                estimates: relit
                    .as_ref()
                    .map_or([None; 2 * COPIES], |r| r.bound(0).map(|e| e.map(DeviceBuffer::bytes))),
            },
            parts: packed.parts() as u64,
            relit: relit.as_ref().map(|_| Relit::options(&bounds)),
            queries_masks: consistency.as_ref().is_some_and(Consistency::queries_provider),
            environment: environment.as_ref(),
            options: &options,
            geometry: gaussians.bytes(),
            surfaces: 1,
            surface_arena: builder.compiled().arena_bytes,
            // Gaussians also store their count, beside the parameters.
            surface_small: 16
                + SurfaceBuilder::BYTES
                + uniform_bytes(device, builder.compiled(), SurfaceBuilder::FRAMES),
            kinds: StepKind::ALL.map(|kind| {
                let can = consistency.is_some() && (kind != StepKind::Relight || options.relight || options.own_prior);
                kind == StepKind::Plain || can && (1..=s.steps).any(|step| StepKind::of(s, step) == kind)
            }),
        };
        decisions::add(&mut decisions, s, answers.is_some(), consistency.is_some(), sizes.kinds);
        let found = FoundForMaterials {
            priors: PriorKinds { albedo: albedo.is_some(), roughness: roughness.is_some(), metallic: any_metallic },
            regions: consistency.is_some(),
            estimates: relit.is_some(),
        };
        let idle = idle::of_materials(settings, found);
        // Surfaces of all views are stored if they fit beside everything else.
        let all = IntrinsicNeeds::of(device, &tuning, &Sizes { surfaces: packed.views().len() as u64, ..sizes })?;
        let one = IntrinsicNeeds { surfaces: options.shape.bytes(), ..all };
        let step = limits::Single::buffer("intermediate results of a step", one.largest_arena(), limits::Remedy::Step);
        limits::check(device.info(), &[step])?;
        one.check(&budget, options.transport.is_some())?;
        let stores_all = match s.surface_bytes {
            0 => all.total() <= budget.left(),
            most => all.surfaces <= most,
        };
        let needs = if stores_all { all } else { one };
        if !stores_all {
            decisions.push(decisions::without_surfaces(s, all.surfaces));
        }
        let watch = Watch::new(packed.plain());
        let photographs =
            (room.is_some() && albedo.is_some()).then(|| packed.images().map(<[u32]>::to_vec).collect::<Vec<_>>());
        let data = packed.upload(device)?;
        let mut surfaces = Surfaces::new(device, builder, &gaussians, &data, stores_all, &others)?;
        if let Some(room) = &room {
            surfaces.light(device, room, &data)?;
        }
        let views = PriorViews { device, gaussians: &gaussians, data: &data };
        if let (Some(albedo), Some(photographs)) = (&mut albedo, &photographs) {
            decisions.push(room::correct_priors(&views, photographs, &mut surfaces, albedo)?);
        }
        if let (Some(roughness), Some(_)) = (&mut roughness, &room) {
            decisions.push(room::equalize_priors(&views, &mut surfaces, roughness)?);
        }
        let up = |priors: &Option<MaterialPriors>, name: &str| {
            priors.as_ref().map(|p| p.upload(device, name, &data)).transpose()
        };
        let priors = Priors {
            albedo: up(&albedo, "albedo_priors")?,
            roughness: up(&roughness, "roughness_priors")?,
            metallic: up(&answers, "metallic_priors")?,
        };
        let environment = match environment {
            Some(made) => Some((EnvironmentMemory::new(device, &made)?, made)).map(|(memory, made)| (made, memory)),
            None => None,
        };
        let begin = match s.start {
            MaterialStart::Priors => {
                let unless = |known: bool, priors| if known { None } else { priors };
                let wanted = [
                    unless(splats.albedo.is_some(), albedo.as_ref()),
                    unless(splats.roughness.is_some(), roughness.as_ref()),
                    unless(splats.metallic.is_some(), answers.as_ref()),
                ];
                let trains_lights = s.lights.enabled() || has_environment;
                start::start(device, &gaussians, &mut surfaces, &data, wanted, trains_lights)?
            }
            MaterialStart::Gray => start::Start::default(),
        };
        drop((albedo, roughness, answers));
        let initial = parameters::Initial {
            splats: &splats,
            start: begin,
            settings: s,
            options: &options,
            light_model: &light_model,
            bounds: &bounds,
            environment: environment.as_ref().map(|(environment, _)| environment),
            table_bits: tuning.accuracy.visibility_bits,
            seed,
        };
        let transport = room::trainables(device, room.as_ref(), planned_room.as_ref(), splats.len())?;
        let parameters = IntrinsicParameters { transport, ..initial.allocate(device)? };
        let gains = device.buffer("light_gains", light_model.gain_bytes(), Location::Device)?;
        device.upload(&gains, 0, bytemuck::cast_slice(&vec![1.0_f32; light_model.lights as usize]))?;
        let status = IntrinsicStatus::new(device)?;
        let mut training = Intrinsic {
            device: device.clone(),
            tuning,
            settings: requested.clone(),
            required: settings.clone(),
            automatic,
            decisions,
            reported: 0,
            idle,
            recent: [-1.0; 3],
            schedule,
            data,
            priors,
            splats,
            gaussians,
            surfaces,
            needs,
            parameters,
            light_model,
            bounds,
            unit,
            gains,
            environment,
            environment_updates: None,
            update_intervals: [0, 0],
            traced,
            room,
            planned_room,
            status,
            options,
            consistency,
            shown: None,
            relit,
            execs: [None, None, None],
            submitted: 0,
            done: 0,
            watch,
            roll_backs: Vec::new(),
        };
        training.keep_environment()?;
        training.measure_poll()?;
        Ok(training)
    }
}
