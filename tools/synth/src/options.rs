//! Options of scene generation, with defaults and limits.
//!
//! [`SynthOptions::validate`] refuses values that cannot work (no views, no pixels) and values that look like typing
//! errors (a million views). All other values render.

use std::str::FromStr;

use crate::error::SynthError;

/// Scene to generate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum SceneName {
    /// Furnished living room: two windows, three lamps, matte and glossy surfaces, some metal.
    #[default]
    LivingRoom,
    /// Furnished room with one lamp, no windows and no specular reflection.
    Diffuse,
    /// Furnished room with a wall mirror, a glossy floor, chrome and brass.
    Mirror,
    /// Furnished room lit only by an environment map through its windows. `gt/environment.exr` holds the map.
    EnvOnly,
    /// Furnished room at night: colored lamps, windows nearly dark.
    Night,
    /// Small box with two blocks and a sphere under one ceiling light. Renders quickly; meant for tests.
    Box,
}

impl SceneName {
    /// All scenes, in the order of listings.
    pub const ALL: [Self; 6] = [Self::LivingRoom, Self::Diffuse, Self::Mirror, Self::EnvOnly, Self::Night, Self::Box];

    /// Returns the name as written on a command line.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::LivingRoom => "livingroom",
            Self::Diffuse => "diffuse",
            Self::Mirror => "mirror",
            Self::EnvOnly => "envonly",
            Self::Night => "night",
            Self::Box => "box",
        }
    }

    /// Returns a one-line description of the scene.
    pub fn describe(self) -> &'static str {
        match self {
            Self::LivingRoom => "furnished room, two windows, three lamps, mixed materials",
            Self::Diffuse => "furnished room, one lamp, no specular reflection",
            Self::Mirror => "furnished room with a mirror, glossy floor and metal",
            Self::EnvOnly => "furnished room lit through its windows by an environment only",
            Self::Night => "furnished room at night, colored lamps",
            Self::Box => "small box with two blocks and a sphere, quick to render",
        }
    }

    /// Returns all names separated by commas, for messages.
    pub fn list() -> String {
        Self::ALL.map(Self::as_str).join(", ")
    }
}

impl std::fmt::Display for SceneName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.as_str())
    }
}

impl FromStr for SceneName {
    type Err = SynthError;

    fn from_str(text: &str) -> Result<Self, SynthError> {
        Self::ALL
            .into_iter()
            .find(|name| name.as_str().eq_ignore_ascii_case(text))
            .ok_or_else(|| SynthError::UnknownScene { name: text.to_owned(), known: Self::list() })
    }
}

/// Layout of a scene directory. Priors are the same in all layouts, as is ground truth that a layout does not define.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum SynthLayout {
    /// `transforms.json`, `split.json` and `images/`.
    #[default]
    Nerfstudio,
    /// TensoIR: `transforms_train.json`, `transforms_test.json` and a folder per view.
    ///
    /// A folder holds `rgba.png`, `albedo.png`, `normal.png`, `roughness.png` and `rgba_LIGHT.png`.
    TensoIr,
    /// FIPT: `train/` and `val/`, each with `transforms.json` and HDR images.
    ///
    /// The cameras use Mitsuba's axes. The images lie in `Image/`, `albedo/` and `Roughness/`.
    Fipt,
}

impl SynthLayout {
    /// All layouts, in the order of listings.
    pub const ALL: [Self; 3] = [Self::Nerfstudio, Self::TensoIr, Self::Fipt];

    /// Returns the name as written on a command line.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Nerfstudio => "nerfstudio",
            Self::TensoIr => "tensoir",
            Self::Fipt => "fipt",
        }
    }
}

impl FromStr for SynthLayout {
    type Err = SynthError;

    fn from_str(text: &str) -> Result<Self, SynthError> {
        let known = || Self::ALL.map(Self::as_str).join(", ");
        Self::ALL
            .into_iter()
            .find(|layout| layout.as_str().eq_ignore_ascii_case(text))
            .ok_or_else(|| SynthError::UnknownLayout { name: text.to_owned(), known: known() })
    }
}

/// Options that determine the output: equal options give equal bytes on any number of threads.
#[derive(Debug, Clone, PartialEq)]
pub struct SynthOptions {
    /// Scene to generate.
    pub scene: SceneName,
    /// Layout of the directory.
    pub layout: SynthLayout,
    /// Number of training views.
    pub views: usize,
    /// Number of test views, in addition to the training views and numbered after them.
    pub test_views: usize,
    /// Image width in pixels.
    pub width: usize,
    /// Image height in pixels.
    pub height: usize,
    /// Seed of furniture, colors, wall pictures and cameras.
    pub seed: u64,
    /// Paths per pixel before denoising. Pixels that cover several surfaces get more.
    pub samples_per_pixel: usize,
    /// Number of surface points in `points.ply`.
    pub points: usize,
    /// Side of a cell of semantic priors in pixels. 1 gives maps at image resolution.
    pub semantic_cell: usize,
    /// Fraction of the regions of semantic priors that get a wrong class, 0 to 1.
    ///
    /// The wrong class is that of another pixel of the view.
    pub semantic_wrong: f32,
    /// Denoises the images. Otherwise each pixel is the plain mean of its samples.
    pub denoise: bool,
    /// Writes `gt/relit`: the test views under other lighting, for scenes with several light groups.
    pub relit: bool,
    /// Permits replacing an existing scene directory at the output path.
    pub replace: bool,
}

impl Default for SynthOptions {
    fn default() -> Self {
        Self {
            scene: SceneName::default(),
            layout: SynthLayout::default(),
            views: 12,
            test_views: 4,
            width: 160,
            height: 120,
            seed: 1,
            samples_per_pixel: 48,
            points: 5000,
            semantic_cell: 8,
            semantic_wrong: 0.0,
            denoise: true,
            relit: true,
            replace: false,
        }
    }
}

impl SynthOptions {
    /// Checks every number against its limits.
    ///
    /// # Errors
    ///
    /// [`SynthError::OutOfRange`] for the first integer option outside its limits; [`SynthError::NoShare`] for a
    /// fraction outside 0 to 1.
    pub fn validate(&self) -> Result<(), SynthError> {
        let limits: [(&'static str, usize, u64, u64); 7] = [
            ("the number of training views", self.views, 1, 2000),
            ("the number of test views", self.test_views, 0, 2000),
            ("the image width", self.width, 16, 2048),
            ("the image height", self.height, 16, 2048),
            ("the number of samples per pixel", self.samples_per_pixel, 1, 65_536),
            ("the number of points", self.points, 0, 5_000_000),
            ("the size of a semantic cell in pixels", self.semantic_cell, 1, 256),
        ];
        for (option, value, min, max) in limits {
            let value = value as u64;
            if value < min || value > max {
                return Err(SynthError::OutOfRange { option, value, min, max });
            }
        }
        if !(0.0..=1.0).contains(&self.semantic_wrong) {
            return Err(SynthError::NoShare {
                option: "the share of wrong semantic regions",
                value: self.semantic_wrong,
            });
        }
        Ok(())
    }
}
