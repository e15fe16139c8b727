//! Intrinsic stage in the output of `sgs plan`.

use super::plan::{counted, source_of};
use sgs_config::Settings;
use sgs_engine::graph::Plan;
use sgs_engine::{Budget, Device};
use sgs_passes::cost::Cost;
use sgs_passes::pipeline::IntrinsicOptions;
use sgs_run::read_splats;
use sgs_scene::{Scene, Splats};
use sgs_train::{AlbedoComparisons, CONSISTENCY_INTERVAL, Decision, IdleLoss, Intrinsic, IntrinsicNeeds, PriorKinds};
use std::path::Path;
use std::sync::Arc;

/// Model and estimated cost of the stage. Training is set up for its first step, then dropped.
pub struct IntrinsicPlan {
    gaussians: usize,
    /// Whether the scene's initial points stand in for trained geometry.
    points: bool,
    options: IntrinsicOptions,
    resolution: Option<u32>,
    priors: PriorKinds,
    comparisons: AlbedoComparisons,
    stores_surfaces: bool,
    interval: u32,
    /// Losses that have a weight but cannot run.
    idle: Vec<IdleLoss>,
    needs: IntrinsicNeeds,
    /// Decisions about the model before the first step.
    decisions: Vec<Decision>,
    /// Graph of a step that compares nothing with other views.
    pub graph: Arc<Plan>,
    /// Operations and bytes of that step.
    cost: Cost,
}

/// Returns the Gaussians of a file, or those of the scene's initial points.
pub fn geometry_of(scene: &Scene, s: &Settings, start: Option<&Path>) -> anyhow::Result<Splats> {
    Ok(match start {
        Some(file) => read_splats(file)?,
        None => Splats::from_points(&scene.points, s.geometry.sh_degree.start() as usize)?,
    })
}

impl IntrinsicPlan {
    pub fn of(device: &Device, scene: &Scene, s: &Settings, start: Option<&Path>) -> anyhow::Result<IntrinsicPlan> {
        let splats = geometry_of(scene, s, start)?;
        let mut training = Intrinsic::planned(device, scene, s, &splats)?;
        let graph = training.executor()?.executor().plan().clone();
        let (cost, _) = training.step_cost()?;
        Ok(IntrinsicPlan {
            gaussians: training.gaussians(),
            points: start.is_none(),
            options: *training.options(),
            resolution: {
                let e = &training.required().environment;
                e.enabled().then_some(e.resolution)
            },
            decisions: training.decisions().to_vec(),
            priors: training.priors(),
            comparisons: training.comparisons(),
            stores_surfaces: training.keeps_surfaces(),
            interval: CONSISTENCY_INTERVAL,
            idle: training.idle_losses().to_vec(),
            needs: *training.needs(),
            graph,
            cost,
        })
    }

    pub fn json(&self, budget: &Budget) -> serde_json::Value {
        let o = &self.options;
        let PriorKinds { albedo, roughness, metallic } = self.priors;
        serde_json::json!({
            "gaussians": self.gaussians,
            "from_points": self.points,
            "metallic": o.metallic,
            "lights": o.lights.map(|(model, _)| model.lights),
            "lobes": o.lights.map(|(model, _)| model.lobes),
            "environment": self.resolution,
            "visibility": o.visibility.map(|v| serde_json::json!({
                "levels": v.levels, "log2_table": v.log2_table, "coarsest": v.coarsest, "finest": v.finest,
                "entries": v.entries(), "bytes": self.needs.visibility,
            })),
            "decisions": self.decisions,
            "priors": {"albedo": albedo, "roughness": roughness, "metallic": metallic},
            "cross_view": self.comparisons.cross_view,
            "relight": self.comparisons.relight && o.relight,
            "relight_asked": self.comparisons.relight && o.relight,
            "own_prior": self.comparisons.relight && o.own_prior,
            "warnings": self.idle,
            "surfaces_kept": self.stores_surfaces,
            "needs": self.needs,
            "needs_bytes": self.needs.total(),
            "budget": budget,
            "step_operations": self.cost.operations,
            "step_bytes": self.cost.bytes,
            "passes": self.graph.groups.iter().map(|g| g.passes.len()).sum::<usize>(),
            "barriers": self.graph.groups.iter().filter(|g| g.barrier.is_some()).count(),
        })
    }

    pub fn print(&self, budget: &Budget) {
        let o = &self.options;
        let stand_in =
            if self.points { ", the scene's points: what geometry comes to needs more (--start)" } else { "" };
        println!("Gaussians   {}, standing still{stand_in}", self.gaussians);
        let p = &self.priors;
        let known = [("albedo", p.albedo), ("roughness", p.roughness), ("metallic", p.metallic)];
        let answers: Vec<&str> = known.iter().filter(|(_, there)| *there).map(|(name, _)| *name).collect();
        let metallic = if o.metallic { "albedo, roughness, metallic" } else { "albedo, roughness" };
        println!("materials   {metallic} (intrinsic.metallic)");
        println!("priors      {}", if answers.is_empty() { "none".to_owned() } else { answers.join(", ") });
        match &o.lights {
            Some((model, _)) => println!("lights      {} of {} lobes (intrinsic.lights)", model.lights, model.lobes),
            None => println!("lights      none (intrinsic.lights.grid)"),
        }
        match self.resolution {
            Some(size) => println!("environment a cube of {size} x {size} texels a face (intrinsic.environment)"),
            None => println!("environment none (intrinsic.environment.resolution)"),
        }
        match &o.visibility {
            Some(v) => println!(
                "visibility  a field of {} levels, {} to {}, {} entries (intrinsic.visibility)",
                v.levels,
                v.coarsest,
                v.finest,
                v.entries()
            ),
            None => println!("visibility  no field (intrinsic.visibility.kind, or there are no lights)"),
        }
        for d in &self.decisions {
            println!("required    {d}");
        }
        let AlbedoComparisons { cross_view, relight } = self.comparisons;
        let every = format!("every {} steps", self.interval);
        let interval = |due: bool| if due { every.as_str() } else { "never" };
        println!("cross view  {} (albedo in pseudo-views)", interval(cross_view));
        println!("relight     {} (albedo against intrinsic.relight.provider)", interval(relight && o.relight));
        println!("own prior   {} (albedo of regions against the view's prior)", interval(relight && o.own_prior));
        for warning in IdleLoss::warnings(&self.idle) {
            println!("warning     {warning}");
        }
        println!(
            "surfaces    {}",
            if self.stores_surfaces {
                "kept for all training views"
            } else {
                "recomputed in each step: memory is short"
            }
        );
        print_step(&self.graph, &self.cost, &self.needs, budget);
    }
}

/// Prints passes, cost and memory of a step that compares nothing with other views.
pub fn print_step(graph: &Plan, cost: &Cost, needs: &IntrinsicNeeds, budget: &Budget) {
    let mib = |b: u64| b as f64 / f64::from(1 << 20);
    println!(
        "a step      {} passes in {} groups, {} barriers",
        graph.groups.iter().map(|g| g.passes.len()).sum::<usize>(),
        graph.groups.len(),
        graph.groups.iter().filter(|g| g.barrier.is_some()).count()
    );
    println!(
        "computed    {} operations and {} MB moved in a step that compares nothing with other views",
        counted(cost.operations),
        (cost.bytes / 1e6).round()
    );
    for (name, bytes) in needs.parts().into_iter().filter(|(_, bytes)| *bytes > 0) {
        println!("memory      {:>9.1} MiB {name}", mib(bytes));
    }
    println!(
        "in all      {:>9.1} MiB, of a budget of {:.1} MiB ({})",
        mib(needs.total()),
        mib(budget.budget),
        source_of(budget)
    );
}
