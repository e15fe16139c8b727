//! Images or a video of a run or file from any cameras: `sgs render`.
//!
//! Channels: trained values (color, depth, normals, classes), materials, and lighting terms.

use super::train::validated;
use crate::cameras::{splats_of, upload};
use crate::classes::{Legend, Scale, file_part, head_of, write_labels_exr, write_relevance_exr, write_relevance_png};
use crate::common::Common;
use crate::failure::refuse_usage;
use crate::images::{Format, Part, background_of};
use crate::lit::{Light, LightFiles, WantedLight};
use crate::output;
use crate::ui::Bar;
use crate::video::VideoArgs;
use crate::viewpoints::ViewpointArgs;
use sgs_engine::Device;
use sgs_passes::Tuning;
use sgs_passes::pipeline::{RenderedImage, Renderer};
use sgs_passes::splat::Channels;
use sgs_run::{Classes, Classifier, SemanticHead};
use sgs_scene::{Image, Splats, write_exr, write_png};
use std::path::{Path, PathBuf};

#[derive(clap::Args)]
pub struct Args {
    /// Run directory, or a PLY or glTF file.
    source: PathBuf,
    #[command(flatten)]
    viewpoints: ViewpointArgs,
    /// Directory for the images.
    #[arg(short, long, value_name = "DIR", required_unless_present = "video")]
    output: Option<PathBuf>,
    #[command(flatten)]
    video: VideoArgs,
    /// Channels to write. "semantic": classes; labels.json in the directory lists ids and colors. "albedo" and later need
    /// materials, "pbr" and later also light. "lights" is --lights.
    #[arg(long, value_delimiter = ',', default_value = "rgb")]
    channels: Vec<Channel>,
    /// Also write the probability of this class per pixel; may be repeated. PNG: black at chance, white at the maximum of
    /// the class; EXR: the probability.
    #[arg(long, value_name = "CLASS")]
    query: Vec<String>,
    /// Also write the contribution of each light: STEM_light_NN. Of a run with emitters: STEM_lights.exr, whose layers are the
    /// emitters with their bounces, linear.
    #[arg(long)]
    lights: bool,
    /// Temperature of the probabilities of --query; by default that of training.
    #[arg(long, value_name = "T")]
    temperature: Option<f32>,
    /// Write into a directory with other files.
    #[arg(long)]
    force: bool,
    /// File format: exr (blended values, float32) or png (display values).
    #[arg(long, value_enum, default_value = "png")]
    format: Format,
    /// Background color.
    #[arg(
        long,
        value_name = "r,g,b",
        value_delimiter = ',',
        num_args = 1,
        default_value = "0,0,0",
        allow_negative_numbers = true
    )]
    background: Vec<f32>,
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Channel {
    Rgb,
    Alpha,
    Depth,
    #[value(alias = "normals")]
    Normal,
    Semantic,
    Albedo,
    Roughness,
    Metallic,
    Pbr,
    Diffuse,
    Specular,
    Visibility,
    #[value(alias = "environment")]
    Env,
    Direct,
    Lights,
}

impl Channel {
    /// Returns the channel of a shaded view; `None` for other channels.
    fn part(self) -> Option<Part> {
        Some(match self {
            Channel::Albedo => Part::Albedo,
            Channel::Roughness => Part::Roughness,
            Channel::Metallic => Part::Metallic,
            Channel::Pbr => Part::Pbr,
            Channel::Diffuse => Part::Diffuse,
            Channel::Specular => Part::Specular,
            Channel::Visibility => Part::Visibility,
            Channel::Env => Part::Env,
            Channel::Direct => Part::Direct,
            Channel::Rgb | Channel::Alpha | Channel::Depth | Channel::Normal => return None,
            Channel::Semantic | Channel::Lights => return None,
        })
    }
}

pub fn run(common: &Common, a: &Args) -> anyhow::Result<()> {
    let background = background_of(&a.background)?;
    check_video(a)?;
    if let Some(output) = &a.output {
        output::check_images(output, a.force)?;
    }
    let mut video = a.video.open()?;
    let (splats, settings) = splats_of(&a.source)?;
    let cameras = a.viewpoints.cameras(&a.source, settings.as_ref(), &splats, None)?;
    if a.channels.contains(&Channel::Normal) && splats.normals.is_none() {
        refuse_usage!("\"{}\" holds no normals; leave \"normal\" out of --channels.", a.source.display());
    }
    let requested = RequestedViews::of(a, &splats)?;
    let wanted = WantedLight {
        source: &a.source,
        parts: a.channels.iter().filter_map(|c| c.part()).collect(),
        each: a.lights || a.channels.contains(&Channel::Lights),
    };
    let light = Light::of(wanted, &a.viewpoints, &splats, settings.as_ref())?;
    let device = common.open_device()?;
    let mut light = light.map(|light| light.ready(&device, &splats)).transpose()?;
    let gaussians = upload(&device, &splats, requested.is_some())?;
    let mut meaning = requested.map(|requested| Meaning::new(&device, requested)).transpose()?;
    let channels = Channels {
        colors: true,
        normals: a.channels.contains(&Channel::Normal),
        depth: a.channels.contains(&Channel::Depth),
    };
    let make = if meaning.is_some() { Renderer::with_features } else { Renderer::new };
    let mut renderer = make(&device, Tuning::for_device(device.info()), &gaussians, [1, 1], channels)?;
    if let Some(output) = &a.output {
        output::make(output)?;
    }
    let mut bar = Bar::new(common, "rendering", cameras.len() as u64, 0);
    let mut written = Vec::new();
    // All frames of a video share the depth scale of the first, to avoid flicker.
    let mut far = None;
    for (i, camera) in cameras.iter().enumerate() {
        let c = sgs_run::camera(camera);
        let rendered = renderer.render(&gaussians, &c, gaussians.model.sh_degree, background)?;
        for channel in &a.channels {
            let Some(blended) = Blended::of(*channel, &rendered, channels) else { continue };
            if let Some(output) = &a.output {
                written.push(blended.write(a.format, output, &camera.name)?);
            }
            if let Some(video) = &mut video {
                video.push(&blended.shown(*far.get_or_insert_with(|| blended.largest())))?;
            }
        }
        if let Some(light) = &mut light {
            let to = LightFiles { directory: a.output.as_deref(), format: a.format, background };
            written.extend(light.write(&device, &to, camera, video.as_mut())?);
        }
        if let (Some(meaning), Some(output)) = (&mut meaning, &a.output) {
            let classes = meaning.classifier.classify(&renderer, &rendered)?;
            written.extend(meaning.write(a, output, &camera.name, rendered.size, classes)?);
        }
        bar.set(i as u64 + 1, || camera.name.clone());
    }
    bar.finish();
    if let Some(video) = video {
        written.push(video.finish()?);
    }
    let mut answer = serde_json::json!({"gaussians": splats.len(), "files": written});
    if let (Some(meaning), Some(output)) = (meaning.filter(|_| a.channels.contains(&Channel::Semantic)), &a.output) {
        answer["labels"] = serde_json::to_value(meaning.legend.write(output)?)?;
    }
    common.answer(&answer)?;
    validated(&device)
}

/// Refuses channels that a video cannot show, and images without a directory.
fn check_video(a: &Args) -> anyhow::Result<()> {
    if a.video.video.is_none() {
        return Ok(());
    }
    let [channel] = a.channels[..] else { refuse_usage!("--video shows one channel; name only one with --channels.") };
    if matches!(channel, Channel::Semantic | Channel::Lights) {
        refuse_usage!(
            "--video does not show the channels \"semantic\" and \"lights\"; choose another with --channels."
        );
    }
    if a.output.is_none() && (a.lights || !a.query.is_empty()) {
        refuse_usage!("--lights and --query write images; name their directory with --output.");
    }
    Ok(())
}

/// Channel of a blended image.
struct Blended {
    channel: Channel,
    name: &'static str,
    /// Names of its channels in an EXR file.
    names: &'static [&'static str],
    image: Image,
}

impl Blended {
    /// Extracts a channel from an image; `None` if the channel is classified or shaded.
    fn of(channel: Channel, p: &RenderedImage, channels: Channels) -> Option<Blended> {
        let c = p.channels as usize;
        let pixels = p.transmittance.len();
        let pick = |from: usize, count: usize| -> Vec<f32> {
            (0..pixels).flat_map(|i| (from..from + count).map(move |k| p.image[i * c + k])).collect()
        };
        let (name, names, data): (_, &[_], Vec<f32>) = match channel {
            Channel::Rgb => ("rgb", &["R", "G", "B"], pick(0, 3)),
            Channel::Alpha => ("alpha", &["Y"], p.transmittance.iter().map(|t| 1.0 - t).collect()),
            Channel::Normal => ("normal", &["X", "Y", "Z"], pick(3, 3)),
            Channel::Depth => ("depth", &["Z"], pick(if channels.normals { 6 } else { 3 }, 1)),
            _ => return None,
        };
        let image = Image { width: p.size[0], height: p.size[1], channels: names.len() as u32, data };
        Some(Blended { channel, name, names, image })
    }

    /// Returns the largest value, at least 1e-6.
    fn largest(&self) -> f32 {
        self.image.data.iter().fold(1e-6, |m: f32, v| m.max(*v))
    }

    /// Returns display-referred values; `far` is the depth shown as white.
    fn shown(&self, far: f32) -> Image {
        let value = |v: &f32| match self.channel {
            Channel::Normal => *v * 0.5 + 0.5,
            Channel::Depth => *v / far,
            _ => *v,
        };
        Image { data: self.image.data.iter().map(|v| value(v).clamp(0.0, 1.0)).collect(), ..self.image.clone() }
    }

    /// Writes the channel; returns the path.
    fn write(&self, format: Format, dir: &Path, stem: &str) -> anyhow::Result<PathBuf> {
        let path = format.file(dir, stem, self.name);
        match format {
            Format::Exr => write_exr(&path, &self.image, self.names)?,
            Format::Png => write_png(&path, &self.shown(self.largest()))?,
        }
        Ok(path)
    }
}

/// Requested semantic classes.
struct RequestedViews {
    head: SemanticHead,
    queries: Vec<usize>,
}

impl RequestedViews {
    /// Returns the request; `None` if neither the channel nor a class is requested.
    fn of(a: &Args, splats: &Splats) -> anyhow::Result<Option<RequestedViews>> {
        if !a.channels.contains(&Channel::Semantic) && a.query.is_empty() {
            return Ok(None);
        }
        let mut head = head_of(&a.source, splats)?;
        match a.temperature {
            Some(t) if !(t.is_finite() && t >= 1e-3) => {
                refuse_usage!("--temperature is {t}, but must be at least 0.001.")
            }
            Some(t) => head.temperature = t,
            None => {}
        }
        let mut queries = Vec::new();
        for name in &a.query {
            let class = head.class(name)?;
            if !queries.contains(&class) {
                queries.push(class);
            }
        }
        Ok(Some(RequestedViews { head, queries }))
    }
}

/// Classifier of images, and the legend of its output.
struct Meaning {
    classifier: Classifier,
    legend: Legend,
    /// File name part and gray scale of each query.
    queries: Vec<(String, Scale)>,
}

impl Meaning {
    fn new(device: &Device, RequestedViews { head, queries }: RequestedViews) -> anyhow::Result<Meaning> {
        let classifier = Classifier::new(device, &head, &queries)?;
        let queries = queries.iter().map(|q| (file_part(&head.text.labels[*q]), Scale::of(&head, *q))).collect();
        Ok(Meaning { classifier, legend: Legend::new(&head.text.labels), queries })
    }

    /// Writes the requested images; returns their paths.
    fn write(
        &self,
        a: &Args,
        dir: &Path,
        stem: &str,
        size: [u32; 2],
        classes: Classes,
    ) -> anyhow::Result<Vec<PathBuf>> {
        let mut written = Vec::new();
        if a.channels.contains(&Channel::Semantic) {
            let path = a.format.file(dir, stem, "semantic");
            match a.format {
                Format::Exr => write_labels_exr(&path, size, &classes.labels)?,
                Format::Png => self.legend.write_png(&path, size, &classes.labels)?,
            }
            written.push(path);
        }
        for ((name, scale), relevance) in self.queries.iter().zip(classes.relevance) {
            let path = a.format.file(dir, stem, &format!("semantic_{name}"));
            match a.format {
                Format::Exr => write_relevance_exr(&path, size, relevance)?,
                Format::Png => write_relevance_png(&path, size, &relevance, *scale)?,
            }
            written.push(path);
        }
        Ok(written)
    }
}
