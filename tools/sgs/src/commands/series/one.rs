//! Process of a run of a table: trains what is missing, and measures it.

use super::run::{TableRun, check_geometry, of_seed, state_of_geometry};
use super::{Row, START, Series, Start};
use crate::cameras::splats_of;
use crate::commands::progress::Progress;
use crate::commands::train::validated;
use crate::common::Common;
use crate::failure::refuse_usage;
use crate::output;
use crate::ui::Stop;
use anyhow::bail;
use sgs_api::{MeasureOptions, Split, measure};
use sgs_config::Settings;
use sgs_engine::Device;
use sgs_evaluate::metrics::Lpips;
use sgs_run::{RunDirectory, StageKind, use_learned_views};
use sgs_scene::Scene;
use sgs_study::{Measures, State};
use sgs_train::{Outcome, StartGeometry, Trainer, TrainerOptions};
use std::path::Path;
use std::sync::Arc;

/// Trains and measures the run of a row, or trains the shared geometry of the rows.
pub fn run(
    common: &Common,
    a: &Series,
    name: &str,
    seed: u64,
    rows: &[Row],
    lpips: Option<&Lpips>,
) -> anyhow::Result<()> {
    let one = One { common, a, stop: &Stop::on_signals()?, seed, lpips };
    if name == START {
        let started = rows.iter().find_map(|row| match &row.start {
            Some(Start::Training { entry, settings }) => Some((a.output.join(entry.folder(seed)), settings)),
            _ => None,
        });
        let Some((root, settings)) = started else { refuse_usage!("The rows of this table train no shared geometry.") };
        one.form(&root, settings)?;
        common.answer(&serde_json::json!({}))?;
        return Ok(());
    }
    // Rows of one folder have the same settings.
    let Some(row) = rows.iter().find(|row| row.entry.run == name) else {
        refuse_usage!("The table has no row \"{name}\".");
    };
    let measures = one.come_to(row)?;
    common.answer(&measures)?;
    Ok(())
}

/// Context of the process.
struct One<'a> {
    common: &'a Common,
    a: &'a Series,
    stop: &'a Stop,
    seed: u64,
    lpips: Option<&'a Lpips>,
}

impl One<'_> {
    /// Trains the shared geometry, unless it is finished.
    fn form(&self, root: &Path, settings: &Settings) -> anyhow::Result<()> {
        let (scene, requested) = of_seed(settings, self.seed)?;
        let state = state_of_geometry(root, &requested);
        if !matches!(state, State::Absent | State::Begun) {
            return Ok(());
        }
        check_geometry(root, &requested, self.a.force)?;
        let _lock = output::lock(root)?;
        let device = self.common.open_device()?;
        let options = TrainerOptions { resume: state == State::Begun, ..Default::default() };
        self.train(&device, &Arc::new(scene), &requested, root, options)?;
        validated(&device)
    }

    /// Trains and measures a run; skips what is done.
    fn come_to(&self, row: &Row) -> anyhow::Result<Measures> {
        let (run, scene) = TableRun::new(row, self.seed, &self.a.output)?;
        let state = run.state(self.lpips.map(|l| l.about()));
        if let State::Measured(measures) = state {
            return Ok(*measures);
        }
        let resume_materials = run.has_begun_materials(&state);
        run.check(&state, self.a.force)?;
        let TableRun { root, start, settings, .. } = &run;
        let _lock = output::lock(root)?;
        let device = self.common.open_device()?;
        let scene = Arc::new(scene);
        if start.is_none() && matches!(state, State::Absent | State::Begun) {
            let resume = state == State::Begun;
            let options = TrainerOptions { stages: vec![StageKind::Geometry], resume, ..Default::default() };
            self.train(&device, &scene, settings, root, options)?;
        }
        if let Some(stage) = row.materials.filter(|_| state != State::Trained) {
            let directory = RunDirectory::create(root)?;
            if start.is_some() && state == State::Absent {
                directory.forget()?;
            }
            let resume = resume_materials && directory.checkpoint(stage).is_file();
            let start = start.clone().map(StartGeometry::File);
            self.train(
                &device,
                &scene,
                settings,
                root,
                TrainerOptions { stages: vec![stage], resume, start, run: None },
            )?;
        }
        let (splats, _) = splats_of(root)?;
        let directory = RunDirectory::open(root)?;
        let options = MeasureOptions { split: Split::Test, lpips: self.lpips, images: None, align: row.align };
        let learned = directory.learned_views()?.map(|learned| {
            let mut scene = (*scene).clone();
            use_learned_views(&mut scene, &learned);
            scene
        });
        measure(&device, learned.as_ref().unwrap_or(&scene), &directory, &splats, settings, options)?;
        validated(&device)?;
        match Measures::read(&directory) {
            Some(measures) => Ok(measures),
            None => bail!("\"{}\" was measured, but its metrics.json does not say so.", root.display()),
        }
    }

    /// Trains a stage into a run directory.
    fn train(
        &self,
        device: &Device,
        scene: &Arc<Scene>,
        settings: &Settings,
        root: &Path,
        options: TrainerOptions,
    ) -> anyhow::Result<()> {
        let options = TrainerOptions { run: Some(root.to_owned()), ..options };
        let mut trainer = Trainer::new(device, scene.clone(), settings, options)?;
        match trainer.run(&mut Progress::of_series(self.common, self.stop))? {
            Outcome::Finished => Ok(()),
            Outcome::Stopped { step, .. } => Err(self.stop.failure(format!("stopped after step {step}"))),
        }
    }
}
