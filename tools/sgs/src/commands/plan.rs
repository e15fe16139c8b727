//! Model, reasons and estimated cost of a training: `sgs plan`.

use super::plan_intrinsic::IntrinsicPlan;
use super::plan_transport::TransportPlan;
use super::train::{Options, Stage, settings};
use crate::common::Common;
use crate::failure::{refuse_usage, usage};
use crate::scenes::{check_start, open_scene, warn_without_priors};
use sgs_config::ShDegree;
use sgs_engine::graph::{Plan, dump};
use sgs_engine::{Budget, BudgetSource};
use sgs_passes::cost::Cost;
use sgs_passes::pipeline::Masks;
use sgs_train::{Geometry, IdleLoss};
use std::path::{Path, PathBuf};

#[derive(clap::Args)]
pub struct Args {
    /// Scene directory.
    scene: PathBuf,
    /// Stage: geometry, intrinsic (materials, lights and shadows), transport (materials, emitters and bounced light), or all.
    #[arg(long, value_enum, default_value = "geometry")]
    stage: Stage,
    /// Geometry of the stages after the geometry stage, as a PLY or glTF file. By default the initial points of the geometry stage.
    #[arg(long, value_name = "FILE")]
    start: Option<PathBuf>,
    #[command(flatten)]
    options: Options,
    /// Final number of Gaussians for the estimate of memory and time. By default the initial number, twice and four times
    /// that.
    #[arg(long, value_name = "N")]
    gaussians: Option<u32>,
    /// Also print the compiled graph of a step: text below the summary, or json, dot or html instead of it.
    #[arg(long, value_enum, num_args = 0..=1, default_missing_value = "text", value_name = "FORMAT")]
    graph: Option<Format>,
    /// File for the graph. Its extension selects the format unless --graph does.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
}

/// Output format of a graph.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Format {
    /// Text for reading and comparing.
    Text,
    /// JSON for tools.
    Json,
    /// DOT for Graphviz.
    Dot,
    /// HTML page for a browser.
    Html,
}

impl Format {
    fn of(path: &Path) -> Option<Format> {
        match path.extension()?.to_str()? {
            "txt" | "text" => Some(Format::Text),
            "json" => Some(Format::Json),
            "dot" | "gv" => Some(Format::Dot),
            "html" | "htm" => Some(Format::Html),
            _ => None,
        }
    }

    fn write(self, plan: &Plan) -> String {
        match self {
            Format::Text => dump::text(plan),
            Format::Json => dump::json(plan),
            Format::Dot => dump::dot(plan),
            Format::Html => dump::html(plan, &[]),
        }
    }
}

/// Estimated memory and cost if training ends with `gaussians` Gaussians.
struct Expected {
    gaussians: u32,
    /// Maximum device memory in bytes.
    bytes: u64,
    /// Maximum if `sh_degree = "auto"` adds no band of harmonics.
    bytes_without_bands: Option<u64>,
    /// Maximum operations and bytes of a step.
    step: Cost,
    /// Cost of a step that compares its view with pseudo-views.
    pseudo_step: Option<Cost>,
}

impl Expected {
    fn json(&self) -> serde_json::Value {
        let mut value = serde_json::json!({
            "gaussians": self.gaussians,
            "bytes": self.bytes,
            "step_operations": self.step.operations,
            "step_bytes": self.step.bytes,
        });
        if let Some(bytes) = self.bytes_without_bands {
            value["bytes_without_bands"] = bytes.into();
        }
        if let Some(cost) = &self.pseudo_step {
            value["pseudo_step_operations"] = cost.operations.into();
            value["pseudo_step_bytes"] = cost.bytes.into();
        }
        value
    }

    fn work(cost: &Cost) -> String {
        format!("{} operations and moves {} MB", counted(cost.operations), (cost.bytes / 1e6).round())
    }
}

pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    // Before any work, so that a wrong name costs no time.
    let format = match (&a.output, a.graph) {
        (Some(path), None) => Some(Format::of(path).ok_or_else(|| {
            usage(format!("\"{}\" says no format; add --graph text, json, dot or html.", path.display()))
        })?),
        (_, format) => format,
    };
    let s = settings(&a.scene, &a.options)?;
    if a.start.is_some() && a.stage == Stage::Geometry {
        refuse_usage!("--start gives geometry to later stages; add --stage intrinsic, transport or all.");
    }
    let scene = open_scene(&s)?;
    if a.start.is_none() {
        check_start(&scene)?;
    }
    if a.stage != Stage::Geometry {
        warn_without_priors(&scene)?;
    }
    let device = common.open_device()?;
    // The stages are planned one after the other, as they are trained.
    let intrinsic = match a.stage {
        Stage::Geometry | Stage::Transport => None,
        _ => Some(IntrinsicPlan::of(&device, &scene, &s, a.start.as_deref())?),
    };
    let transport = match a.stage {
        Stage::Transport => true,
        Stage::All => s.transport.enabled(),
        _ => false,
    };
    let transport = transport.then(|| TransportPlan::of(&device, &scene, &s, a.start.as_deref())).transpose()?;
    let alone = match (a.stage, &intrinsic, &transport) {
        (Stage::Intrinsic, Some(plan), _) => Some((&plan.graph, plan.json(&device.budget()))),
        (Stage::Transport, _, Some(plan)) => Some((&plan.graph, plan.json(&device.budget()))),
        _ => None,
    };
    if let Some((graph, json)) = alone {
        if let (Some(path), Some(format)) = (&a.output, format) {
            let text = format.write(graph);
            sgs_scene::atomic_write(path, |f| std::io::Write::write_all(f, text.as_bytes()))?;
        }
        if common.json.is_some() && common.answer(&json)? {
            return Ok(());
        }
        if let (None, Some(format @ (Format::Json | Format::Dot | Format::Html))) = (&a.output, format) {
            println!("{}", format.write(graph));
            return Ok(());
        }
        println!("scene       {} ({} training views)", a.scene.display(), scene.split.train.len());
        println!("device      {}", device.info().name);
        if let Some(plan) = &intrinsic {
            plan.print(&device.budget());
        }
        if let Some(plan) = &transport {
            plan.print(&device.budget());
        }
        match (&a.output, format) {
            (Some(path), _) => println!("graph       {}", path.display()),
            (None, Some(_)) => println!("\n{}", dump::text(graph)),
            (None, None) => {}
        }
        return Ok(());
    }
    let mut training = Geometry::new(&device, &scene, &s, None)?;
    let g = training.gaussians();
    let (count, model, capacity, gaussian_bytes) = (g.count(&device)?, g.model, g.capacity, g.bytes());
    let plan = training.executor()?.plan().clone();
    let (now, _) = device.memory_use();
    if let (Some(path), Some(format)) = (&a.output, format) {
        let text = format.write(&plan);
        sgs_scene::atomic_write(path, |f| std::io::Write::write_all(f, text.as_bytes()))?;
    }
    let (needs, budget) = (*training.needs(), device.budget());
    let sight = training.sight()?;
    let entries = sight.most_entries;
    let ends = match a.gaussians {
        Some(n) => vec![n],
        None if s.geometry.densify.enabled() => [1, 2, 4].map(|k| count.saturating_mul(k)).to_vec(),
        None => vec![count],
    };
    let mut expected = Vec::new();
    for gaussians in ends {
        let seen = sight.with(gaussians);
        expected.push(Expected {
            gaussians,
            bytes: training.expected(gaussians, count, entries)?.total(),
            bytes_without_bands: training.expected_without_bands(gaussians, count, entries)?.map(|n| n.total()),
            step: training.step_cost(&seen)?.0,
            pseudo_step: training.pseudo_step_cost(&seen)?.map(|(cost, _)| cost),
        });
    }
    let most = training.most_within_budget(count, entries)?;
    if common.json.is_some() {
        let mut value = serde_json::json!({
            "views": scene.split.train.len(),
            "gaussians": count,
            "capacity": capacity,
            "sh_degree": model.sh_degree,
            "sh_degree_asked": s.geometry.sh_degree,
            "decisions": training.decisions(),
            "warnings": training.idle_losses(),
            "normals": model.normals,
            "semantics": model.semantics,
            "classes": training.classes(),
            "pseudo_views": training.masks().is_some(),
            "gaussian_bytes": gaussian_bytes,
            "arena_bytes": plan.arena_bytes,
            "arena_unaliased_bytes": plan.arena_unaliased_bytes,
            "device_bytes": now,
            "needs": needs,
            "needs_bytes": needs.total(),
            "entries": entries,
            "expected": expected.iter().map(Expected::json).collect::<Vec<_>>(),
            "most_within_budget": most,
            "budget": budget,
            "passes": plan.groups.iter().map(|g| g.passes.len()).sum::<usize>(),
            "barriers": plan.groups.iter().filter(|g| g.barrier.is_some()).count(),
        });
        if let Some(plan) = &intrinsic {
            value["intrinsic"] = plan.json(&budget);
        }
        if let Some(plan) = &transport {
            value["transport"] = plan.json(&budget);
        }
        if common.answer(&value)? {
            return Ok(());
        }
    }
    // A program that reads standard output expects nothing besides the graph.
    if let (None, Some(format @ (Format::Json | Format::Dot | Format::Html))) = (&a.output, format) {
        println!("{}", format.write(&plan));
        return Ok(());
    }
    let mib = |b: u64| b as f64 / f64::from(1 << 20);
    println!(
        "scene       {} ({} training views, {} test views)",
        a.scene.display(),
        scene.split.train.len(),
        scene.split.test.len()
    );
    println!("device      {}", device.info().name);
    println!(
        "Gaussians   {count} at first, room for {capacity} ({:.1} MiB with gradients' moments)",
        mib(gaussian_bytes)
    );
    let color = match s.geometry.sh_degree {
        ShDegree::Fixed(degree) => format!("of degree {degree} (geometry.sh_degree)"),
        ShDegree::Auto => format!(
            "of degree {} at first; all bands are tried early; a band stays if it gains {} dB at held-back views (geometry.sh_degree)",
            model.sh_degree, s.geometry.sh_gain
        ),
    };
    println!("color       spherical harmonics {color}");
    let why = |what: &str| {
        let found = training.decisions().iter().find(|d| d.what == what);
        found.map_or_else(String::new, |d| format!("{}; {}", d.reason, d.setting))
    };
    println!("normals     {} ({})", if model.normals { "one a Gaussian" } else { "none" }, why("normals"));
    let depth = training.decisions().iter().any(|d| d.what == "depth terms" && d.on);
    println!("prior depth {}", why("prior depth"));
    println!("depth       {} ({})", if depth { "losses of blended depth" } else { "no losses" }, why("depth terms"));
    match training.classes() {
        Some(classes) => {
            println!("semantics   32 features a Gaussian, {} classes ({})", classes.len(), why("semantics"));
        }
        None => println!("semantics   none ({})", why("semantics")),
    }
    let views = match training.masks() {
        Some(Masks::Carried) => "two views a step, regions carried by depth",
        Some(Masks::Numbered) => "two views a step, regions of priors/masks/pseudo",
        Some(Masks::Provided) => "two views a step, regions asked of provider.command",
        None => "none",
    };
    println!("pseudo      {views} ({})", why("pseudo-views"));
    for warning in IdleLoss::warnings(training.idle_losses()) {
        println!("warning     {warning}");
    }
    println!("densify     {}", if s.geometry.densify.enabled() { "on" } else { "off (--no-densify)" });
    println!(
        "a step      {} passes in {} groups, {} barriers",
        plan.groups.iter().map(|g| g.passes.len()).sum::<usize>(),
        plan.groups.len(),
        plan.groups.iter().filter(|g| g.barrier.is_some()).count()
    );
    println!(
        "arena       {:.1} MiB for transients ({:.1} MiB if nothing shared memory)",
        mib(plan.arena_bytes),
        mib(plan.arena_unaliased_bytes)
    );
    for (name, bytes) in needs.parts().into_iter().filter(|(_, bytes)| *bytes > 0) {
        println!("memory      {:>9.1} MiB {name}", mib(bytes));
    }
    println!(
        "in all      {:>9.1} MiB before growth, of a budget of {:.1} MiB ({})",
        mib(needs.total()),
        mib(budget.budget),
        source_of(&budget)
    );
    for e in &expected {
        let bands = e.bytes_without_bands.map_or_else(String::new, |b| format!(" ({:.1} if no band stays)", mib(b)));
        let pseudo = e.pseudo_step.as_ref().map_or_else(String::new, |c| {
            format!("; with pseudo-views, from step {} on, {}", s.geometry.correspondence_from, Expected::work(c))
        });
        println!(
            "peak        {:>9.1} MiB{bands} if training ends with {} Gaussians; a step then computes at most {}{pseudo}",
            mib(e.bytes),
            e.gaussians,
            Expected::work(&e.step)
        );
    }
    if s.geometry.densify.enabled() {
        println!(
            "growth      to {most} Gaussians at most: no more fit, or are asked for (memory.budget, geometry.densify.max_gaussians)"
        );
    }
    if let Some(plan) = &intrinsic {
        println!();
        plan.print(&budget);
    }
    if let Some(plan) = &transport {
        println!();
        plan.print(&budget);
    }
    match (&a.output, format) {
        (Some(path), _) => println!("graph       {}", path.display()),
        (None, Some(_)) => println!("\n{}", dump::text(&plan)),
        (None, None) => {}
    }
    Ok(())
}

/// Formats a large number with a unit prefix.
pub fn counted(number: f64) -> String {
    match number {
        n if n >= 1e12 => format!("{:.1} T", n / 1e12),
        n if n >= 1e9 => format!("{:.1} G", n / 1e9),
        n => format!("{:.1} M", n / 1e6),
    }
}

/// Describes the origin of a memory budget.
pub fn source_of(budget: &Budget) -> &'static str {
    match budget.source {
        BudgetSource::Configured => "as set",
        BudgetSource::Driver => "by the driver",
        BudgetSource::Heap => "the device's heap",
    }
}
