//! Transport stage in the output of `sgs plan`.

use super::plan_intrinsic::{geometry_of, print_step};
use sgs_config::Settings;
use sgs_engine::graph::Plan;
use sgs_engine::{Budget, Device};
use sgs_passes::cost::Cost;
use sgs_passes::pipeline::TransportShape;
use sgs_scene::Scene;
use sgs_train::{Decision, FitNeeds, IntrinsicNeeds, PriorKinds};
use std::path::Path;
use std::sync::Arc;

/// Model and estimated cost of the stage, for a room of the largest size.
pub struct TransportPlan {
    /// Whether the scene's initial points stand in for trained geometry.
    points: bool,
    room: TransportShape,
    steps: u32,
    priors: PriorKinds,
    /// Memory of the fit, which ends before the first step of training.
    fit: FitNeeds,
    needs: IntrinsicNeeds,
    decisions: Vec<Decision>,
    /// Graph of a step.
    pub graph: Arc<Plan>,
    /// Operations and bytes of a step.
    cost: Cost,
}

impl TransportPlan {
    pub fn of(device: &Device, scene: &Scene, s: &Settings, start: Option<&Path>) -> anyhow::Result<TransportPlan> {
        let splats = geometry_of(scene, s, start)?;
        let sgs_train::TransportPlan { mut training, room } = sgs_train::TransportPlan::of(device, scene, s, &splats)?;
        let fit = FitNeeds::of(device, scene, &splats, &room)?;
        let graph = training.executor()?.executor().plan().clone();
        let (cost, _) = training.step_cost()?;
        Ok(TransportPlan {
            points: start.is_none(),
            room,
            steps: s.transport.steps,
            priors: training.priors(),
            fit,
            needs: *training.needs(),
            decisions: training.decisions().to_vec(),
            graph,
            cost,
        })
    }

    /// Returns the largest memory of the stage: that of the fit or of training.
    fn peak(&self) -> u64 {
        self.fit.peak().max(self.needs.total())
    }

    pub fn json(&self, budget: &Budget) -> serde_json::Value {
        let PriorKinds { albedo, roughness, metallic } = self.priors;
        serde_json::json!({
            "gaussians": self.room.gaussians,
            "from_points": self.points,
            "surfels": self.room.surfels,
            "patches": self.room.matrix.receivers - self.room.surfels,
            "rays": self.room.matrix.rays,
            "emitters": self.room.lights,
            "steps": self.steps,
            "priors": {"albedo": albedo, "roughness": roughness, "metallic": metallic},
            "decisions": self.decisions,
            "room_bytes": self.room.bytes(),
            "needs": self.needs,
            "needs_bytes": self.needs.total(),
            "fit": self.fit,
            "fit_bytes": self.fit.peak(),
            "peak_bytes": self.peak(),
            "budget": budget,
            "step_operations": self.cost.operations,
            "step_bytes": self.cost.bytes,
            "passes": self.graph.groups.iter().map(|g| g.passes.len()).sum::<usize>(),
            "barriers": self.graph.groups.iter().filter(|g| g.barrier.is_some()).count(),
        })
    }

    pub fn print(&self, budget: &Budget) {
        let mib = |b: u64| b as f64 / f64::from(1 << 20);
        let stand_in =
            if self.points { ", the scene's points: what geometry comes to needs more (--start)" } else { "" };
        println!("Gaussians   {}, standing still{stand_in}", self.room.gaussians);
        let p = &self.priors;
        let of = |prior: bool| if prior { "from priors" } else { "no priors" };
        println!(
            "materials   albedo ({}), roughness ({}), metallic ({})",
            of(p.albedo),
            of(p.roughness),
            of(p.metallic)
        );
        let gains = if p.albedo { "trained" } else { "fixed at 1: no albedo priors" };
        println!("light gains {gains}");
        println!(
            "room        {} surfels at most (transport.surfels), an enclosure of {} patches, {} rays each: {:.1} MiB",
            self.room.surfels,
            self.room.matrix.receivers - self.room.surfels,
            self.room.matrix.rays,
            mib(self.room.bytes())
        );
        println!(
            "emitters    found in the photographs in a fit before the first step; the sizes below hold for {}",
            self.room.lights
        );
        println!("training    {} steps of materials and lights (transport.steps)", self.steps);
        println!(
            "selection   beside the intrinsic stage, left out if emitters and bounces gain less than 1 dB over uniform light"
        );
        for d in &self.decisions {
            println!("required    {d}");
        }
        for (name, bytes) in self.fit.parts() {
            println!("fit         {:>9.1} MiB {name}", mib(bytes));
        }
        print_step(&self.graph, &self.cost, &self.needs, budget);
        println!(
            "peak        {:>9.1} MiB; the fit needs {:.1} MiB and ends before training",
            mib(self.peak()),
            mib(self.fit.peak())
        );
    }
}
