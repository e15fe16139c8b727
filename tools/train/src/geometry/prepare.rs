//! Preparation of the geometry stage: reads the data, checks sizes and memory, and allocates the Gaussians.

use super::capacity::{first_entry_capacity, most_by_binding, room_for};
use super::fit::{allowance, last_that};
use super::{Bands, Geometry, GeometryInputs, Growth, IN_FLIGHT, backward::kernel_of, decision};
use crate::data::PixelPriors;
use crate::divergence::Watch;
use crate::error::{Result, TrainError};
use crate::idle::{self, FoundForGeometry};
use crate::limits;
use crate::memory::Needs;
use crate::normals::{Prior, initial_normals};
use crate::reduce::LEAST;
use crate::schedule::{MOST_HALVINGS, Schedule};
use crate::semantics::SemanticMaps;
use sgs_config::{Filter, Settings, ShDegree, ViewRates};
use sgs_engine::Device;
use sgs_passes::pipeline::{GeometryOptions, InputSizes, LearnedView, Status};
use sgs_passes::scene::{Gaussians, Layout, LearnedViews, Model, ViewKinds};
use sgs_passes::splat::Channels;
use sgs_run::gaussian_data;
use sgs_scene::{Camera, Image, Scene, Splats, Unit};

impl Geometry {
    /// Prepares training from the scene's points or from given splats. Uses fewer points where memory does not suffice
    /// for all.
    ///
    /// # Errors
    /// If data cannot be read or memory runs out.
    pub fn new(device: &Device, scene: &Scene, settings: &Settings, start: Option<&Splats>) -> Result<Geometry> {
        let disturbed = settings.noise.on(scene, settings.seed);
        let scene = disturbed.as_ref().unwrap_or(scene);
        let unit = scene.unit();
        let scaled = (unit != Unit::OWN).then(|| scene.in_unit(unit));
        let scene = scaled.as_ref().unwrap_or(scene);
        let mut training = match start {
            Some(splats) if unit == Unit::OWN => Geometry::of(device, &GeometryInputs::Scene(scene), settings, splats),
            Some(splats) => {
                Geometry::of(device, &GeometryInputs::Scene(scene), settings, &splats.clone().in_unit(unit))
            }
            None => Geometry::from_points(device, scene, settings),
        }?;
        training.unit = unit;
        Ok(training)
    }

    /// Prepares training of Gaussians on display-referred images without a scene.
    ///
    /// # Errors
    /// If memory runs out.
    pub fn on_images(
        device: &Device,
        images: &[(&Camera, Image)],
        settings: &Settings,
        start: &Splats,
    ) -> Result<Geometry> {
        Geometry::of(device, &GeometryInputs::Renderings(images), settings, start)
    }

    /// Prepares training of given splats on a scene or on images.
    pub(crate) fn of(
        device: &Device,
        source: &GeometryInputs<'_>,
        settings: &Settings,
        start: &Splats,
    ) -> Result<Geometry> {
        settings.check()?;
        let g = &settings.geometry;
        let wanted = PixelPriors {
            normals: g.normals && (g.losses.normal > 0.0 || g.losses.normal_smooth > 0.0),
            depths: g.losses.depth > 0.0,
        };
        let budget = settings.memory.budget;
        if budget > 0 {
            device.set_memory_budget(Some(budget));
        }
        let wants_views = g.losses.correspondence > 0.0 && g.correspondence_from <= g.steps;
        let wants_semantics = g.semantics && (g.losses.semantic > 0.0 || g.losses.semantic_class > 0.0);
        let (mut data, maps) = source.read(wanted, wants_semantics)?;
        data.reduce(if g.coarse > 0.0 { MOST_HALVINGS } else { 0 }, LEAST);
        data.split(device.info().largest_binding());
        maps.iter().try_for_each(|maps| maps.check(device))?;
        let (rates, shown) = source.view_rates(g)?;
        let [cameras, gains, intrinsics, distortion] = rates.map(|rate| rate > 0.0);
        let kinds = ViewKinds { cameras, gains, lens: intrinsics || distortion };
        let inputs = InputSizes {
            targets: data.image_bytes(),
            parts: data.parts() as u64,
            normals: data.normal_bytes(),
            depths: data.depth_bytes(),
            semantics: maps.as_ref().map(SemanticMaps::sizes),
            views: kinds.any().then_some((data.views().len() as u32, kinds)),
            ..Default::default()
        };
        let sh_degree = match g.sh_degree {
            ShDegree::Fixed(degree) => degree,
            ShDegree::Auto => start.sh_degree() as u32,
        };
        let mip = g.filter == Filter::Mip;
        let model = Model { sh_degree, normals: inputs.normals.is_some(), semantics: maps.is_some(), mip };
        let mut initial;
        let mut start = start;
        if let (Some(priors), None) = (data.normals(), &start.normals) {
            let cameras = source.cameras();
            let views: Vec<Prior> = cameras.into_iter().zip(priors).collect();
            initial = start.clone();
            initial.normals = Some(initial_normals(&start.means, &views));
            start = &initial;
        }
        decision::check_statistic(g, model.normals)?;
        let count = start.len() as u32;
        let all_bands = Model { sh_degree: sh_degree.max(g.sh_degree.most()), ..model };
        let most = most_by_binding(device, all_bands);
        let wanted = most.min(g.densify.max_gaussians);
        let tuning = settings.tuning(device.info());
        // Regions are carried to pseudo-views by depth.
        let depth = g.depth_terms() || inputs.depths.is_some() || (wants_views && maps.is_some());
        let options = GeometryOptions {
            largest: data.largest,
            entry_capacity: first_entry_capacity(g.entry_capacity, count),
            channels: Channels { colors: true, normals: model.normals, depth },
            statistics: g.densify.statistic(),
            mcmc: g.densify.mcmc(),
            dense_adam: g.dense_adam,
            backward: kernel_of(g.backward, device)?,
            semantic_geometry: g.semantic_geometry,
            pseudo: None,
            timestamps: false,
            frames_in_flight: IN_FLIGHT,
        };
        let layout = Layout {
            model,
            capacity: count.max(1),
            training: true,
            statistics: options.statistics.is_some(),
            storage: tuning.accuracy.storage(),
        };
        let budget = device.budget();
        let of = |layout: &Layout| Needs::of(device, &tuning, layout, &inputs, &options);
        let first = of(&layout)?;
        let of_views = |views| limits::Remedy::Views { views, scale: settings.scale };
        let (views, one) = (of_views(data.views().len()), of_views(1));
        limits::check(
            device.info(),
            &[
                limits::Single::bound("pixels of a photograph", inputs.targets, one),
                limits::Single::bound("normal priors of a view", inputs.normals.unwrap_or(0), one),
                limits::Single::bound("semantic features", inputs.semantics.map_or(0, |s| s.feature_bytes()), views),
                limits::Single::buffer("intermediate results of a step", first.arena, limits::Remedy::Step),
            ],
        )?;
        first.check(&budget)?;
        if count > most {
            return Err(TrainError::Memory(format!(
                "The scene starts with {count} Gaussians, but at most {most} fit into the device's bindings; \
                 use fewer points, or a lower geometry.sh_degree."
            )));
        }
        let watch = Watch::new(data.plain());
        let data = data.upload(device)?;
        let semantics = source.semantics(device, maps, settings.seed)?;
        let correspondence = match &semantics {
            Some((data, _)) if wants_views => source.correspondence(device, data, settings, options.largest)?,
            _ => None,
        };
        let of = |layout: &Layout| match &correspondence {
            Some(c) => of(layout)?.with_views(device, &tuning, layout, &inputs, &options, c),
            None => of(layout),
        };
        let may = allowance(&budget);
        let capacity = match g.densify.enabled() {
            true => last_that(layout.capacity, room_for(count, wanted), |capacity| {
                Ok(of(&Layout { capacity, ..layout })?.total() <= may)
            })?,
            false => layout.capacity,
        };
        let layout = Layout { capacity, ..layout };
        let needs = of(&layout)?.with_bands(&of(&Layout { model: all_bands, ..layout })?);
        needs.check(&budget)?;
        let gaussians = Gaussians::of(device, &layout)?;
        gaussians.upload(device, &gaussian_data(start, model))?;
        let views = match inputs.views {
            Some((count, kinds)) => {
                let views = LearnedViews::new(device, count)?;
                let first = shown.as_ref().filter(|_| kinds.lens).and_then(|shown| shown.lens);
                if let Some([focal, x, y, distortion]) = first {
                    let (percent, corners) = (100.0 * focal.exp(), 100.0 * distortion);
                    tracing::info!(
                        "by the sensor's depth, the color camera's focal length is {percent:.1} % of the given one, and distortion moves its corners by {corners:.1} %"
                    );
                    let mut numbers = vec![LearnedView::default(); count as usize + 1];
                    let [focal, x, y, distortion] = [focal, x, y, distortion].map(|n| n as f32);
                    numbers[count as usize].values[..5].copy_from_slice(&[focal, x, y, 0.0, distortion]);
                    views.upload(device, &numbers)?;
                }
                Some((views, kinds))
            }
            None => None,
        };
        let status = Status::new(device)?;
        let mut decided = settings.clone();
        decided.geometry.rates.views = rates.into();
        let schedule = Schedule::new(&decided, source.extent(), data.views.len());
        let promised = settings.memory.budget > 0;
        let mut training = Geometry {
            device: device.clone(),
            tuning,
            settings: settings.clone(),
            schedule,
            data,
            semantics,
            correspondence,
            gaussians,
            views,
            cameras: source.cameras().into_iter().cloned().collect(),
            status,
            exec: None,
            densify: None,
            reset: None,
            options,
            most: wanted,
            needs,
            submitted: 0,
            done: 0,
            settled: 0,
            watch,
            roll_backs: Vec::new(),
            bands: (g.sh_degree == ShDegree::Auto).then(Bands::default),
            unit: Unit::OWN,
            decisions: Vec::new(),
            idle: Vec::new(),
            inputs,
            allowed: may,
            promised,
            growth: Growth::default(),
        };
        let found = FoundForGeometry {
            normals: model.normals,
            depths: inputs.depths.is_some(),
            semantics: model.semantics,
            regions: training.correspondence.is_some(),
        };
        training.decisions = decision::initial(&training.settings, found);
        let undecided = g.rates.views == ViewRates::Auto;
        training.decisions.extend(shown.filter(|_| undecided).map(|shown| decision::of_views(&shown)));
        training.idle = idle::of_geometry(&training.settings, found);
        training.rebuild()?;
        Ok(training)
    }
}
