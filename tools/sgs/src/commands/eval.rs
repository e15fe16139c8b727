//! Metrics of a run at the views of a split, and their images: `sgs eval`.

use super::train::validated;
use crate::cameras::splats_of;
use crate::classes::Legend;
use crate::common::Common;
use crate::output;
use crate::scenes::open_scene_of_run;
use anyhow::bail;
use sgs_api::{EvaluatedImages, MeasureOptions, measure};
use sgs_evaluate::metrics::{Lpips, LpipsRange};
use sgs_evaluate::{Evaluation, Nvs, RELIT_MEAN, RelitSet, Rendered, ShadedMetrics};
use sgs_run::{RunDirectory, ShadedView, displayed};
use sgs_scene::{Image, Scene, write_png};
use std::path::{Path, PathBuf};

#[derive(clap::Args)]
pub struct Args {
    /// Run directory.
    run: PathBuf,
    /// Scene directory, if the scene has moved.
    #[arg(long)]
    scene: Option<PathBuf>,
    /// Split of the evaluated views.
    #[arg(long, value_enum, default_value = "test")]
    split: Split,
    /// Directory for PNG images of every view: color, normals, depth, classes, and ground truth.
    #[arg(long, value_name = "DIR")]
    images: Option<PathBuf>,
    /// Weights of LPIPS (VGG or AlexNet); enables this metric. tools/priors/sgs_priors/lpips_weights.py converts
    /// published weights.
    #[arg(long, value_name = "FILE.safetensors")]
    lpips: Option<PathBuf>,
    /// Scale images for LPIPS to -1 to 1, its own convention. By default 0 to 1, the convention of 3DGS evaluations.
    #[arg(long, requires = "lpips")]
    lpips_signed: bool,
    /// Measure each view again with the camera that fits it best. Runs that learn cameras or exposures do so anyway.
    #[arg(long)]
    align: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Split {
    Test,
    Train,
}

impl From<Split> for sgs_api::Split {
    fn from(split: Split) -> sgs_api::Split {
        match split {
            Split::Test => sgs_api::Split::Test,
            Split::Train => sgs_api::Split::Train,
        }
    }
}

pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    let run = RunDirectory::open(&a.run)?;
    let (splats, settings) = splats_of(&a.run)?;
    let Some(mut settings) = settings else { bail!("\"{}\" is not a run directory.", a.run.display()) };
    if let Some(scene) = &a.scene {
        settings.scene.clone_from(scene);
    }
    let range = if a.lpips_signed { LpipsRange::Signed } else { LpipsRange::Plain };
    let lpips = a.lpips.as_deref().map(|file| Lpips::load(file, range)).transpose()?;
    if let Some(images) = &a.images {
        output::check_images(images, true)?;
    }
    let scene = open_scene_of_run(&a.run, &settings)?;
    let device = common.open_device()?;
    let mut written = a.images.as_deref().map(|dir| Written { dir, legend: None });
    let images = written.as_mut().map(|images| images as &mut dyn EvaluatedImages);
    let options = MeasureOptions { split: a.split.into(), lpips: lpips.as_ref(), images, align: a.align };
    let result = measure(&device, &scene, &run, &splats, &settings, options)?;
    if !common.answer(&result)? {
        print_table(&result);
    }
    validated(&device)
}

/// Writer of the images of every view.
struct Written<'a> {
    dir: &'a Path,
    legend: Option<Legend>,
}

impl EvaluatedImages for Written<'_> {
    fn begin(&mut self, classes: Option<&[String]>) -> anyhow::Result<()> {
        output::make(self.dir)?;
        self.legend = classes.map(Legend::new);
        self.legend.as_ref().map(|legend| legend.write(self.dir)).transpose()?;
        Ok(())
    }

    fn rendered(&mut self, scene: &Scene, name: &str, rendered: &Rendered) -> sgs_evaluate::Result<()> {
        let dir = self.dir;
        write_png(&dir.join(format!("{name}_rgb.png")), &rendered.rgb)?;
        let mut row = photograph(scene, name)?;
        row.push(rendered.rgb.clone());
        if let Some(normal) = &rendered.normal {
            let mut shown = normal.clone();
            shown.data.iter_mut().for_each(|v| *v = *v * 0.5 + 0.5);
            write_png(&dir.join(format!("{name}_normal.png")), &shown)?;
            row.push(shown);
        }
        write_png(&dir.join(format!("{name}_beside.png")), &beside(&row))?;
        let mut shown = rendered.depth.clone();
        let far = shown.data.iter().fold(1e-6_f32, |m, v| m.max(*v));
        shown.data.iter_mut().for_each(|v| *v /= far);
        write_png(&dir.join(format!("{name}_depth.png")), &shown)?;
        if let (Some(legend), Some(labels)) = (&self.legend, &rendered.labels) {
            let size = [rendered.rgb.width, rendered.rgb.height];
            legend.write_png(&dir.join(format!("{name}_semantic.png")), size, labels)?;
        }
        Ok(())
    }

    fn shaded(
        &mut self,
        scene: &Scene,
        name: &str,
        shaded: &ShadedView,
        background: [f32; 3],
    ) -> sgs_evaluate::Result<()> {
        let mut row = photograph(scene, name)?;
        row.push(displayed(&shaded.radiance(background)));
        row.push(displayed(&shaded.albedo()));
        row.push(gray(&shaded.roughness()));
        row.push(displayed(&shaded.direct()));
        row.push(displayed(&shaded.ambient()));
        row.extend(shaded.visibility().map(|v| gray(&v)));
        write_png(&self.dir.join(format!("{name}_shaded.png")), &beside(&row))?;
        Ok(())
    }
}

/// Returns the photograph of a view, if the scene has it.
fn photograph(scene: &Scene, name: &str) -> sgs_scene::Result<Vec<Image>> {
    let view = scene.views.iter().position(|v| v.camera.name == name);
    Ok(view.map(|i| scene.load_image(i)).transpose()?.into_iter().collect())
}

/// Repeats one channel as three.
fn gray(image: &Image) -> Image {
    let data = image.data.iter().flat_map(|v| [*v; 3]).collect();
    Image { channels: 3, data, ..image.clone() }
}

/// Joins color images of equal height side by side.
fn beside(images: &[Image]) -> Image {
    let (width, height) = (images.iter().map(|i| i.width).sum(), images.first().map_or(0, |i| i.height));
    let row =
        |y: u32| images.iter().flat_map(move |i| (0..i.width).flat_map(move |x| i.pixel(x, y)[..3].iter().copied()));
    Image { width, height, channels: 3, data: (0..height).flat_map(row).collect() }
}

fn print_table(e: &Evaluation) {
    let lpips = e.lpips.is_some();
    let row = |name: &str, [psnr, ssim, flip, l, normal, covered, depth, labels]: [String; 8]| {
        let l = if lpips { format!(" {l:>8}") } else { String::new() };
        println!("{name:<20} {psnr:>8} {ssim:>8} {flip:>8}{l} {normal:>10} {covered:>9} {depth:>10} {labels:>8}");
    };
    let cell = |v: Option<f64>, digits: usize| v.map_or("-".to_owned(), |v| format!("{v:.digits$}"));
    let line = |name: &str, nvs: &Nvs, [normal, covered, depth, labels]: [Option<f64>; 4]| {
        let (psnr, ssim, flip) = (cell(Some(nvs.psnr), 2), cell(Some(nvs.ssim), 4), cell(Some(nvs.flip), 4));
        let geometry = [cell(normal, 2), cell(covered, 4), cell(depth, 4), cell(labels, 4)];
        let [normal, covered, depth, labels] = geometry;
        row(name, [psnr, ssim, flip, cell(nvs.lpips, 4), normal, covered, depth, labels]);
    };
    row("view", ["PSNR", "SSIM", "FLIP", "LPIPS", "normal °", "covered", "depth rel", "labels"].map(str::to_owned));
    for v in &e.views {
        let labels = v.semantic.map(|s| s.accuracy);
        line(&v.name, &v.nvs, [v.normal_mae_deg, v.normal_coverage, v.depth_rel.or(v.sensor_depth_rel), labels]);
    }
    let m = &e.mean;
    let labels = m.semantic.map(|s| s.accuracy);
    line("mean", &m.nvs, [m.normal_mae_deg, m.normal_coverage, m.depth_rel.or(m.sensor_depth_rel), labels]);
    if let (Some(psnr), Some(ssim)) = (m.nvs.psnr_aligned, m.nvs.ssim_aligned) {
        println!("{:<20} {psnr:>8.2} {ssim:>8.4}", "mean, aligned");
    }
    if let Some(m) = &m.shaded {
        print_shaded(m);
    }
    if let Some(fps) = &m.fps {
        let pbr = fps.pbr.map_or_else(String::new, |v| format!(", shaded {v:.1}"));
        println!("\n{:<20} {:>8.1} rendered{pbr}", "frames per second", fps.nvs);
    }
}

/// Prints means over the views of materials, shaded and relit images.
fn print_shaded(m: &ShadedMetrics) {
    let learned = |v: Option<f64>| v.map_or_else(String::new, |v| format!(" {v:>8.4} LPIPS"));
    println!();
    if let Some(v) = &m.pbr {
        let lpips = learned(v.lpips);
        println!("{:<20} {:>8.2} dB {:>8.4} SSIM {:>8.4} FLIP{lpips}", "shaded image", v.psnr, v.ssim, v.flip);
    }
    if let Some(v) = &m.albedo {
        let (lpips, scaled, each) = (learned(v.lpips), v.psnr_scaled, v.psnr_scaled_per_view);
        let after = format!("{scaled:>8.2} dB after a gain per channel ({each:.2} dB per view)");
        println!("{:<20} {:>8.2} dB {:>8.4} SSIM {after}{lpips}", "albedo", v.psnr, v.ssim);
    }
    for (name, value) in [("roughness MSE", m.roughness_mse), ("metallic MSE", m.metallic_mse)] {
        if let Some(v) = value {
            println!("{name:<20} {v:>8.5}");
        }
    }
    let (mean, sets): (Vec<_>, Vec<_>) = m.relit.iter().partition(|(name, _)| *name == RELIT_MEAN);
    for (name, set) in sets.into_iter().chain(mean) {
        let name = if name == RELIT_MEAN { "mean of relit sets" } else { name };
        match set {
            RelitSet::Measured(v) => println!(
                "{name:<20} {:>8.2} dB {:>8.4} SSIM {:>8.2} dB after one gain ({:.2} dB per view)",
                v.psnr, v.ssim, v.psnr_gain, v.psnr_gain_per_view
            ),
            RelitSet::Skipped { reason } => println!("{name:<20} not measured: {reason}"),
        }
    }
    if !m.relit_bounces.is_empty() {
        println!("\n{:<20} {:>8} {:>8} {:>8} {:>8}", "bounces, dB", "direct", "one", "all", "learned");
    }
    for (name, v) in &m.relit_bounces {
        let learned = v.learned_emitters.map_or_else(|| "-".to_owned(), |v| format!("{v:.2}"));
        println!("{name:<20} {:>8.2} {:>8.2} {:>8.2} {learned:>8}", v.direct, v.one_bounce, v.all_bounces);
    }
}
