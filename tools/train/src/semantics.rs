//! Semantic features and targets of the training views, and class embeddings.
//! The maps of all views are stored consecutively in GPU memory.

use crate::error::{Requirement, Result, TrainError};
use half::f16;
use sgs_engine::exec::{ExecOptions, Executor};
use sgs_engine::graph::{CompileOptions, Graph};
use sgs_engine::{Device, DeviceBuffer, Location};
use sgs_passes::Tuning;
use sgs_passes::loss::{count_targets, normalize_embeddings, semantic_targets};
use sgs_passes::pipeline::{SemanticInputs, SemanticSizes, SemanticTarget, Step};
use sgs_passes::scene::{Decoder, EMBEDDING};
use sgs_scene::{Camera, FeatureMap, Image, Scene, TextEmbeddings};
use std::ops::RangeInclusive;
use std::sync::Arc;

/// Map of a view in the buffers of all views.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SemanticView {
    /// Width and height of the map; zeros for a view without a map.
    pub size: [u32; 2],
    /// First sample.
    pub offset: u32,
    /// Number of valid samples.
    pub valid: u32,
    /// Number of samples with a class.
    pub labeled: u32,
}

/// Semantic priors of the training views, before any of them is on the device.
pub struct SemanticMaps {
    /// Class names and text embeddings, as stored.
    pub text: TextEmbeddings,
    /// Maps by training view, in the order of the split; counts of samples are not yet known.
    views: Vec<SemanticView>,
    samples: u64,
    largest: u32,
}

/// Classes of the samples of all maps.
pub struct SemanticLabels {
    /// Maps by training view.
    pub views: Vec<SemanticView>,
    /// Class of each sample, with the maps stored consecutively.
    /// The class is [`sgs_passes::loss::NO_LABEL`] for a sample without a class.
    pub labels: Vec<u32>,
}

/// Device data that semantic losses compare with.
pub struct SemanticData {
    /// Features: `[samples * 512]` halves.
    pub features: DeviceBuffer,
    /// Targets: `[samples]` of `SemanticTarget`.
    pub targets: DeviceBuffer,
    /// Class embeddings: `[classes * 512]` floats, each row of unit length.
    pub embeddings: DeviceBuffer,
    /// Class names and text embeddings, as stored.
    pub text: TextEmbeddings,
    /// Number of samples of the largest map.
    pub largest: u32,
    /// Maps by training view, in the order of the split.
    pub views: Vec<SemanticView>,
}

impl SemanticMaps {
    /// Inspects the maps of the training views.
    /// Returns none without text embeddings or without any map. Maps may differ in size. A map larger than its image is
    /// reduced to the cells nearest to the image's pixels.
    ///
    /// # Errors
    /// If a file cannot be used, the feature width is not 512, or the maps hold too many samples.
    pub fn read(scene: &Scene) -> Result<Option<SemanticMaps>> {
        let Some(text) = scene.text_embeddings()? else { return Ok(None) };
        if text.channels != EMBEDDING {
            return Err(Requirement::EmbeddingWidth { found: text.channels, expected: EMBEDDING }.into());
        }
        let mut views = Vec::new();
        let mut samples = 0_u64;
        let mut largest = 0;
        // Only one map at a time is in the host's memory.
        for &i in &scene.split.train {
            let map = scene.semantic_prior(i)?;
            let size = map.map_or([0, 0], |m| size_within(&m, &scene.views[i].camera));
            views.push(SemanticView { size, offset: samples as u32, ..Default::default() });
            samples += u64::from(size[0]) * u64::from(size[1]);
            largest = largest.max(size[0] * size[1]);
        }
        if samples == 0 {
            return Ok(None);
        }
        // Kernels count words of two halves in 32 bits.
        if samples * EMBEDDING as u64 / 2 > u64::from(u32::MAX) {
            return Err(Requirement::FewerCells(samples).into());
        }
        Ok(Some(SemanticMaps { text, views, samples, largest }))
    }

    /// Rejects maps whose total size exceeds the device's largest binding.
    ///
    /// # Errors
    /// If the device's largest binding is smaller than the features of all views.
    pub fn check(&self, device: &Device) -> Result<()> {
        let (bytes, most) = (self.samples * 2 * EMBEDDING as u64, device.info().max_storage_range);
        if bytes <= most {
            return Ok(());
        }
        let mib = |bytes: u64| bytes.div_ceil(1 << 20);
        Err(TrainError::Memory(format!(
            "The semantic maps of {} views hold {} cells in {} MiB, but {} binds at most {} MiB at once; use smaller maps in \
             priors/semantic, --scale or --views.",
            self.views.len(),
            self.samples,
            mib(bytes),
            device.info().name,
            most >> 20
        )))
    }

    /// Returns the sizes of the device data.
    pub fn sizes(&self) -> SemanticSizes {
        SemanticSizes { samples: self.samples, largest: self.largest, classes: self.text.labels.len() as u32 }
    }

    /// Uploads the maps and computes the targets of their samples.
    ///
    /// # Errors
    /// If a file cannot be read any more, or memory runs out.
    pub fn upload(self, device: &Device, scene: &Scene) -> Result<SemanticData> {
        let SemanticMaps { text, mut views, samples, largest } = self;
        let row = 2 * EMBEDDING as u64;
        let features = device.buffer("semantic_features", samples * row, Location::Device)?;
        for (&i, view) in scene.split.train.iter().zip(&views) {
            if let Some(FeatureMap { data, .. }) = used(scene, i, view.size)? {
                device.upload(&features, u64::from(view.offset) * row, bytemuck::cast_slice::<f16, u8>(&data))?;
            }
        }
        let unit = normalize_embeddings(&text.data);
        let embeddings = device.buffer("text_embeddings", 4 * unit.len() as u64, Location::Device)?;
        device.upload(&embeddings, 0, bytemuck::cast_slice(&unit))?;
        let bytes = samples * size_of::<SemanticTarget>() as u64;
        let targets = device.buffer("semantic_targets", bytes, Location::Device)?;
        work_out(device, &features, &embeddings, text.labels.len() as u32, samples as u32, &targets)?;
        let computed: Vec<SemanticTarget> = device.download_as(&targets, samples as usize)?;
        for view in &mut views {
            let count = view.size[0] * view.size[1];
            let first = view.offset as usize;
            [view.valid, view.labeled] = count_targets(&computed[first..first + count as usize]);
        }
        Ok(SemanticData { features, targets, embeddings, text, largest, views })
    }

    /// Computes only the classes, with one map at a time in device memory.
    ///
    /// # Errors
    /// If a file cannot be read any more, or memory runs out.
    pub fn labels(self, device: &Device, scene: &Scene) -> Result<SemanticLabels> {
        let unit = normalize_embeddings(&self.text.data);
        let embeddings = device.buffer("text_embeddings", 4 * unit.len() as u64, Location::Device)?;
        device.upload(&embeddings, 0, bytemuck::cast_slice(&unit))?;
        let largest = u64::from(self.largest);
        let features = device.buffer("semantic_features", largest * 2 * EMBEDDING as u64, Location::Device)?;
        device.fill(&features, 0)?;
        let targets =
            device.buffer("semantic_targets", largest * size_of::<SemanticTarget>() as u64, Location::Device)?;
        let mut labels = Vec::new();
        for (&i, view) in scene.split.train.iter().zip(&self.views) {
            let Some(FeatureMap { data, .. }) = used(scene, i, view.size)? else { continue };
            device.upload(&features, 0, bytemuck::cast_slice::<f16, u8>(&data))?;
            // Samples past the end of a smaller map are left over from an earlier one and are ignored.
            work_out(device, &features, &embeddings, self.text.labels.len() as u32, self.largest, &targets)?;
            labels.extend(labels_of(device, &targets, data.len() / EMBEDDING)?);
        }
        Ok(SemanticLabels { views: self.views, labels })
    }
}

fn labels_of(device: &Device, targets: &DeviceBuffer, samples: usize) -> Result<Vec<u32>> {
    let computed: Vec<SemanticTarget> = device.download_as(targets, samples)?;
    Ok(computed.iter().map(|t| t.label).collect())
}

/// Returns the map of a view as training uses it, at this width and height.
fn used(scene: &Scene, view: usize, size: [u32; 2]) -> Result<Option<FeatureMap>> {
    let Some(map) = scene.semantic_prior(view)? else { return Ok(None) };
    let mut map = thinned(map, size);
    if let Some(mask) = scene.load_mask(view)? {
        clear_invalid(&mut map, &mask);
    }
    Ok(Some(map))
}

/// Clears the cells that the loss compares with invalid pixels.
///
/// A cleared cell has no target. The loss interpolates up to four pixels of the image for a cell. The cell is cleared if one of them is invalid.
fn clear_invalid(map: &mut FeatureMap, mask: &Image) {
    let (width, height) = (mask.width as usize, mask.height as usize);
    for (at, cell) in map.data.chunks_exact_mut(map.channels).enumerate() {
        let columns = interpolated(at % map.width, map.width, width);
        let valid = |y: usize| columns.clone().all(|x| mask.data[y * width + x] > 0.5);
        if !interpolated(at / map.width, map.height, height).all(valid) {
            cell.fill(f16::ZERO);
        }
    }
}

/// Returns the pixels from which a sample is interpolated along an axis. `aligned` of `semantic.glsl` does the same.
fn interpolated(i: usize, samples: usize, pixels: usize) -> RangeInclusive<usize> {
    let steps = samples.max(2) - 1;
    let at = if samples > 1 { i * (pixels - 1) } else { 0 };
    at / steps..=at.div_ceil(steps)
}

/// Returns the used width and height of a map: at most those of the image.
fn size_within(map: &FeatureMap, camera: &Camera) -> [u32; 2] {
    [(map.width as u32).min(camera.width), (map.height as u32).min(camera.height)]
}

/// Reduces a map to a given width and height.
/// The result holds the cells nearest to evenly spaced positions, including the first and the last.
fn thinned(map: FeatureMap, [width, height]: [u32; 2]) -> FeatureMap {
    let (width, height) = (width as usize, height as usize);
    if (map.width, map.height) == (width, height) {
        return map;
    }
    let nearest = |i: usize, of: usize, from: usize| match of {
        0 | 1 => 0,
        _ => (2 * i * (from - 1) + of - 1) / (2 * (of - 1)),
    };
    let mut data = Vec::with_capacity(width * height * map.channels);
    for row in 0..height {
        let row = nearest(row, height, map.height) * map.width;
        for column in 0..width {
            let at = (row + nearest(column, width, map.width)) * map.channels;
            data.extend_from_slice(&map.data[at..at + map.channels]);
        }
    }
    FeatureMap { width, height, channels: map.channels, data }
}

impl SemanticData {
    /// Loads the maps of the training views. Returns none without text embeddings or any map.
    ///
    /// # Errors
    /// If a file cannot be used, the feature width is not 512, or memory runs out.
    pub fn load(device: &Device, scene: &Scene) -> Result<Option<SemanticData>> {
        SemanticMaps::read(scene)?.map(|maps| maps.upload(device, scene)).transpose()
    }

    /// Returns the classes of all samples.
    ///
    /// # Errors
    /// If the device fails.
    pub fn labels(&self, device: &Device) -> Result<SemanticLabels> {
        let samples = self.targets.bytes() as usize / size_of::<SemanticTarget>();
        Ok(SemanticLabels { views: self.views.clone(), labels: labels_of(device, &self.targets, samples)? })
    }

    /// Returns the inputs that a step binds.
    pub fn inputs<'a>(&'a self, decoder: &'a Decoder) -> SemanticInputs<'a> {
        SemanticInputs {
            decoder,
            features: &self.features,
            targets: &self.targets,
            embeddings: &self.embeddings,
            largest: self.largest,
        }
    }

    /// Returns the number of bytes of device memory.
    pub fn bytes(&self) -> u64 {
        self.features.bytes() + self.targets.bytes() + self.embeddings.bytes()
    }
}

impl SemanticView {
    /// Writes the view's map into the values of a step.
    pub fn fill(&self, step: &mut Step) {
        step.semantic_size = self.size;
        step.semantic_offset = self.offset;
        step.semantic_valid = self.valid;
        step.semantic_labeled = self.labeled;
    }
}

/// Runs `semantic_target` once over all samples.
fn work_out(
    device: &Device,
    features: &DeviceBuffer,
    embeddings: &DeviceBuffer,
    classes: u32,
    samples: u32,
    targets: &DeviceBuffer,
) -> Result<()> {
    let run = || -> sgs_engine::Result<()> {
        let mut g = Graph::new("semantic_targets");
        let handles = [g.input("features", features.bytes()), g.input("embeddings", embeddings.bytes())];
        let out = g.external("targets", targets.bytes());
        let tuning = Tuning::for_device(device.info());
        semantic_targets(&mut g, tuning, handles[0], handles[1], classes, None, samples, out)?;
        let plan = Arc::new(g.compile(&CompileOptions::default())?);
        let mut exec = Executor::new(device, plan, ExecOptions::default())?;
        exec.bind(handles[0], features)?;
        exec.bind(handles[1], embeddings)?;
        exec.bind(out, targets)?;
        exec.submit(&[])?;
        exec.finish()
    };
    Ok(run()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn oversized_maps_are_reduced_to_the_nearest_cells() {
        let map = |width: usize, height: usize| FeatureMap {
            width,
            height,
            channels: 1,
            data: (0..width * height).map(|i| f16::from_f32(i as f32)).collect(),
        };
        let reduced = |of: FeatureMap, size: [u32; 2]| -> Vec<f32> {
            let small = thinned(of, size);
            assert_eq!([small.width as u32, small.height as u32], size);
            small.data.iter().map(|v| v.to_f32()).collect()
        };
        assert_eq!(reduced(map(5, 1), [5, 1]), [0.0, 1.0, 2.0, 3.0, 4.0]);
        assert_eq!(reduced(map(5, 1), [3, 1]), [0.0, 2.0, 4.0]);
        assert_eq!(reduced(map(9, 2), [4, 2]), [0.0, 3.0, 5.0, 8.0, 9.0, 12.0, 14.0, 17.0]);
        assert_eq!(reduced(map(4, 3), [1, 1]), [0.0]);
    }

    #[test]
    fn cells_of_invalid_pixels_are_cleared() {
        let cleared = |[width, height]: [usize; 2], size: [u32; 2], invalid: [u32; 2]| -> Vec<usize> {
            let mut map = FeatureMap { width, height, channels: 2, data: vec![f16::ONE; 2 * width * height] };
            let mut mask = Image { data: vec![1.0; (size[0] * size[1]) as usize], ..Image::new(size[0], size[1], 1) };
            mask.pixel_mut(invalid[0], invalid[1])[0] = 0.0;
            clear_invalid(&mut map, &mask);
            let cells: Vec<&[f16]> = map.data.chunks_exact(2).collect();
            assert!(cells.iter().all(|cell| cell[0] == cell[1]));
            (0..cells.len()).filter(|at| cells[*at][0] == f16::ZERO).collect()
        };
        // One cell per pixel.
        assert_eq!(cleared([4, 3], [4, 3], [2, 1]), [6]);
        assert_eq!(cleared([4, 3], [4, 3], [3, 2]), [11]);
        // The cells of a row lie at pixels 0, 3.5 and 7, those of a column at 0 and 5.
        for (x, cell) in [(0, Some(0)), (1, None), (3, Some(1)), (4, Some(1)), (5, None), (7, Some(2))] {
            assert_eq!(cleared([3, 2], [8, 6], [x, 0]), cell.into_iter().collect::<Vec<_>>(), "{x}");
            assert_eq!(cleared([3, 2], [8, 6], [x, 5]), cell.map(|c| c + 3).into_iter().collect::<Vec<_>>(), "{x}");
            assert!(cleared([3, 2], [8, 6], [x, 3]).is_empty());
        }
        // A single cell lies at the first pixel.
        assert_eq!(cleared([1, 1], [8, 6], [0, 0]), [0]);
        assert!(cleared([1, 1], [8, 6], [1, 0]).is_empty());
        assert_eq!(cleared([1, 1], [1, 1], [0, 0]), [0]);
    }
}
