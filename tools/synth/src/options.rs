//! What a caller may choose, with defaults and limits.
//!
//! [`SynthOptions::validate`] refuses what could not work (no views, no pixels) or would only be a slip of the finger
//! (a million views); everything it lets through renders.

use std::str::FromStr;

use crate::error::SynthError;

/// The scenes that can be made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum SceneName {
    /// A furnished living room: two windows, three lamps, matte and glossy surfaces, some metal.
    #[default]
    LivingRoom,
    /// The same kind of room with one lamp, no windows and no specular reflection at all.
    Diffuse,
    /// The room with a wall mirror, a glossy floor, chrome and brass.
    Mirror,
    /// The room lit through its windows by an environment only; `gt/environment.exr` holds it.
    EnvOnly,
    /// The room at night: colored lamps, windows nearly dark.
    Night,
    /// A small box with two blocks and a sphere under one ceiling light: quick to render, for tests.
    Box,
}

impl SceneName {
    /// Every scene, in the order in which they are listed to people.
    pub const ALL: [Self; 6] = [Self::LivingRoom, Self::Diffuse, Self::Mirror, Self::EnvOnly, Self::Night, Self::Box];

    /// The name as written on a command line.
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

    /// One line on what the scene is for.
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

    /// All names separated by commas, for messages.
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

/// The layouts in which a scene can be written. Priors, and ground truth that a layout has no place for, are the same in all.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum SynthLayout {
    /// `transforms.json`, `split.json` and `images/`.
    #[default]
    Nerfstudio,
    /// `transforms_train.json`, `transforms_test.json` and a folder per view with `rgba.png`, `albedo.png`, `normal.png`,
    /// `roughness.png` and `rgba_LIGHT.png`.
    TensoIr,
    /// `train/` and `val/` with `transforms.json` (Mitsuba's axes), HDR images in `Image/`, `albedo/` and `Roughness/`.
    Fipt,
}

impl SynthLayout {
    /// Every layout, in the order in which they are listed to people.
    pub const ALL: [Self; 3] = [Self::Nerfstudio, Self::TensoIr, Self::Fipt];

    /// The name as written on a command line.
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

/// Everything that determines the output: the same options give the same bytes on any number of threads.
#[derive(Debug, Clone, PartialEq)]
pub struct SynthOptions {
    /// Which scene.
    pub scene: SceneName,
    /// The layout of the directory.
    pub layout: SynthLayout,
    /// Training views.
    pub views: usize,
    /// Test views, made besides the training views and numbered after them.
    pub test_views: usize,
    /// Image width in pixels.
    pub width: usize,
    /// Image height in pixels.
    pub height: usize,
    /// Chooses furniture, colors, pictures and cameras.
    pub seed: u64,
    /// Paths traced for each pixel before denoising; pixels in which several surfaces meet get more.
    pub samples_per_pixel: usize,
    /// Surface points in `points.ply`.
    pub points: usize,
    /// Pixels along the side of a cell of semantic priors; 1 for maps at image resolution.
    pub semantic_cell: usize,
    /// Share of the regions of semantic priors that have the class of another place in the view, 0 to 1.
    pub semantic_wrong: f32,
    /// Whether images are denoised; without it they are the plain average of their samples.
    pub denoise: bool,
    /// Whether `gt/relit` is written: the test views under other lighting, where the scene has several light groups.
    pub relit: bool,
    /// Whether an existing scene directory at the output path may be replaced.
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
    /// [`SynthError::OutOfRange`] for the first option that lies outside.
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
