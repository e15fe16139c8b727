//! File names of a view in each layout, and the camera files.

use glam::Vec3;
use serde_json::{Value, json};

use crate::error::SynthError;
use crate::options::SynthLayout;
use crate::output::stage::Stage;
use crate::output::{exr, meta, png};
use crate::trace::camera::Camera;
use crate::trace::denoise::Image;
use crate::trace::film::Film;
use crate::views::{FOV_X, Views};

/// File names of one view in a layout.
pub(crate) struct Names {
    layout: SynthLayout,
    /// Folder of the view's split, in layouts that have one.
    split: &'static str,
    /// Number of the view; within its split except in the Nerfstudio layout.
    number: usize,
}

impl Names {
    /// Returns the names of view `index`. The first `train` views are training views.
    pub(crate) fn new(layout: SynthLayout, index: usize, train: usize) -> Self {
        let test = index >= train;
        let number = if test && layout != SynthLayout::Nerfstudio { index - train } else { index };
        let split = match (layout, test) {
            (_, false) => "train",
            (SynthLayout::Fipt, true) => "val",
            (_, true) => "test",
        };
        Self { layout, split, number }
    }

    /// Returns the base name of the view's priors and ground truth.
    pub(crate) fn stem(&self) -> String {
        let number = meta::stem(self.number);
        match self.layout {
            SynthLayout::Nerfstudio => number,
            SynthLayout::TensoIr | SynthLayout::Fipt => format!("{}_{number}", self.split),
        }
    }

    /// Returns the `file_path` of the view's frame, relative to the scene.
    fn file_path(&self) -> String {
        match self.layout {
            SynthLayout::Nerfstudio => format!("images/{}.png", self.stem()),
            SynthLayout::TensoIr => format!("./{}/rgba", self.stem()),
            SynthLayout::Fipt => format!("./{}/r_{}", self.split, self.number),
        }
    }

    /// Writes the image. HDR layouts hold linear radiance.
    pub(crate) fn image(&self, stage: &Stage, film: &Film, image: &Image) -> Result<(), SynthError> {
        let (w, h) = (film.width, film.height);
        match self.layout {
            SynthLayout::Nerfstudio => png::rgb(&stage.file(self.file_path())?, w, h, &display(image)),
            SynthLayout::TensoIr => self.rgba(stage, "rgba", film, &display(image), |_| true),
            SynthLayout::Fipt => exr::rgb(&stage.file(self.hdr("Image"))?, w, h, image),
        }
    }

    /// Writes the view under another lighting.
    pub(crate) fn relit(&self, stage: &Stage, name: &str, film: &Film, image: &Image) -> Result<(), SynthError> {
        match self.layout {
            SynthLayout::TensoIr => self.rgba(stage, &format!("rgba_{name}"), film, &display(image), |_| true),
            SynthLayout::Nerfstudio | SynthLayout::Fipt => {
                let path = stage.file(format!("gt/relit/{name}/{}.exr", self.stem()))?;
                exr::rgb(&path, film.width, film.height, image)
            }
        }
    }

    /// Writes linear albedo.
    pub(crate) fn albedo(&self, stage: &Stage, film: &Film) -> Result<(), SynthError> {
        let albedo: Vec<Vec3> = film.pixels.iter().map(|p| p.albedo).collect();
        let path = match self.layout {
            SynthLayout::Nerfstudio => format!("gt/albedo/{}.exr", self.stem()),
            SynthLayout::TensoIr => return self.rgba(stage, "albedo", film, &albedo, |p| film.features[p].surface),
            SynthLayout::Fipt => format!("{}/albedo/{}.exr", self.split, meta::stem(self.number)),
        };
        exr::rgb(&stage.file(path)?, film.width, film.height, &albedo)
    }

    /// Writes world-space normals.
    pub(crate) fn normal(&self, stage: &Stage, film: &Film) -> Result<(), SynthError> {
        let normal: Vec<Vec3> = film.features.iter().map(|f| f.normal).collect();
        if self.layout == SynthLayout::TensoIr {
            let shown: Vec<Vec3> = normal.iter().map(|n| 0.5 * *n + Vec3::splat(0.5)).collect();
            return self.rgba(stage, "normal", film, &shown, |p| normal[p] != Vec3::ZERO);
        }
        exr::rgb(&stage.file(format!("gt/normal/{}.exr", self.stem()))?, film.width, film.height, &normal)
    }

    /// Writes roughness.
    pub(crate) fn roughness(&self, stage: &Stage, film: &Film) -> Result<(), SynthError> {
        let roughness: Vec<f32> = film.pixels.iter().map(|p| p.roughness).collect();
        let path = match self.layout {
            SynthLayout::Nerfstudio => format!("gt/roughness/{}.exr", self.stem()),
            SynthLayout::TensoIr => {
                let gray: Vec<Vec3> = roughness.iter().map(|r| Vec3::splat(*r)).collect();
                return self.rgba(stage, "roughness", film, &gray, |_| true);
            }
            SynthLayout::Fipt => self.hdr("Roughness"),
        };
        exr::half(&stage.file(path)?, film.width, film.height, &roughness)
    }

    /// Returns the path of an HDR file in FIPT's naming.
    fn hdr(&self, folder: &str) -> String {
        format!("{}/{folder}/{}_0001.exr", self.split, meta::stem(self.number))
    }

    /// Writes a file of the view's TensoIR folder. Alpha is 1 where `counts` holds for a pixel.
    fn rgba(
        &self,
        stage: &Stage,
        name: &str,
        film: &Film,
        map: &[Vec3],
        counts: impl Fn(usize) -> bool,
    ) -> Result<(), SynthError> {
        let path = stage.file(format!("{}/{name}.png", self.stem()))?;
        let alpha: Vec<bool> = (0..map.len()).map(counts).collect();
        png::rgba(&path, film.width, film.height, map, &alpha)
    }
}

fn display(image: &Image) -> Vec<Vec3> {
    image.iter().map(|c| crate::color::encode3(*c)).collect()
}

/// Writes the camera files and the split.
pub(crate) fn cameras(stage: &Stage, layout: SynthLayout, views: &Views) -> Result<(), SynthError> {
    if layout == SynthLayout::Nerfstudio {
        stage.write("transforms.json", &meta::text(&meta::transforms(views)))?;
        return stage.write("split.json", &meta::text(&meta::split(views)));
    }
    let train = views.train.len();
    for (first, cameras) in [(0, &views.train), (train, &views.test)] {
        if cameras.is_empty() {
            continue;
        }
        let frame = |(i, camera): (usize, &Camera)| frame(&Names::new(layout, first + i, train), camera);
        let frames: Vec<Value> = cameras.iter().enumerate().map(frame).collect();
        let split = Names::new(layout, first, train).split;
        let path = match layout {
            SynthLayout::Fipt => format!("{split}/transforms.json"),
            _ => format!("transforms_{split}.json"),
        };
        stage.write(path, &meta::text(&json!({ "camera_angle_x": FOV_X, "frames": frames })))?;
    }
    Ok(())
}

/// Returns a camera frame with OpenGL axes; FIPT gets Mitsuba's (x left, y up, z forward).
fn frame(names: &Names, camera: &Camera) -> Value {
    let m = camera.matrix();
    let sign = if names.layout == SynthLayout::Fipt { [-1.0, 1.0, -1.0, 1.0] } else { [1.0; 4] };
    let row = |r: usize| {
        let values = m.row(r).to_array();
        [0, 1, 2, 3].map(|k| sign[k] * values[k])
    };
    json!({ "file_path": names.file_path(), "transform_matrix": [row(0), row(1), row(2), row(3)] })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn view_names_match_the_layout() {
        let of = |layout, index| {
            let names = Names::new(layout, index, 3);
            (names.stem(), names.file_path())
        };
        let pair = |a: &str, b: &str| (a.to_owned(), b.to_owned());
        assert_eq!(of(SynthLayout::Nerfstudio, 4), pair("004", "images/004.png"));
        assert_eq!(of(SynthLayout::TensoIr, 2), pair("train_002", "./train_002/rgba"));
        assert_eq!(of(SynthLayout::TensoIr, 3), pair("test_000", "./test_000/rgba"));
        assert_eq!(of(SynthLayout::Fipt, 4), pair("val_001", "./val/r_1"));
        assert_eq!(Names::new(SynthLayout::Fipt, 4, 3).hdr("Image"), "val/Image/001_0001.exr");
    }
}
