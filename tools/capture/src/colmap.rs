//! COLMAP's commands, run on the processor.

use crate::error::{CaptureError, Result, io_error};
use crate::groups::Group;
use crate::process::{Processes, Program};
use sgs_scene::ColmapModel;
use std::path::{Path, PathBuf};
use std::process::Command;

const COLMAP: Program = Program { name: "colmap", package: "colmap" };

/// COLMAP in a version, over one folder of images.
pub(crate) struct Colmap<'a> {
    /// Folder of the images.
    pub(crate) images: &'a Path,
    /// Folder for the database and the models.
    pub(crate) folder: &'a Path,
    /// Starts the processes.
    pub(crate) processes: &'a Processes<'a>,
    /// First words of the help text.
    pub(crate) version: String,
    extraction: &'static str,
    matching: &'static str,
}

/// Pairs of images that are matched.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Pairs {
    All,
    Neighbors,
}

impl<'a> Colmap<'a> {
    /// Asks COLMAP for its version and the names of its options. Fails if it is not installed.
    pub(crate) fn open(images: &'a Path, folder: &'a Path, processes: &'a Processes<'a>) -> Result<Self> {
        let help = COLMAP.prints(&["help"])?;
        let first = help.lines().map(str::trim).find(|line| line.starts_with("COLMAP")).unwrap_or("COLMAP");
        let version = first.split(" -- ").next().unwrap_or(first).to_owned();
        // Version 3.13 renamed these groups of options.
        let renamed = COLMAP.prints(&["feature_extractor", "-h"])?.contains("--FeatureExtraction.use_gpu");
        let (extraction, matching) =
            if renamed { ("FeatureExtraction", "FeatureMatching") } else { ("SiftExtraction", "SiftMatching") };
        Ok(Self { images, folder, processes, version, extraction, matching })
    }

    fn database(&self) -> PathBuf {
        self.folder.join("database.db")
    }

    /// Runs a command of COLMAP with paths and other options.
    fn run(&self, name: &str, paths: &[(&str, &Path)], options: &[(String, String)]) -> Result<()> {
        let mut command: Command = COLMAP.command();
        command.arg(name);
        for (option, path) in paths {
            command.arg(option).arg(path);
        }
        for (option, value) in options {
            command.arg(format!("--{option}")).arg(value);
        }
        self.processes.run(COLMAP, &format!("colmap {name}"), &mut command)
    }

    /// Extracts the features of a group of images.
    pub(crate) fn extract(&self, group: &Group, number: usize) -> Result<()> {
        let list = self.folder.join(format!("group-{number}.txt"));
        std::fs::write(&list, group.names.join("\n") + "\n").map_err(io_error("write", &list))?;
        let mut options = vec![
            (format!("{}.use_gpu", self.extraction), "0".to_owned()),
            ("ImageReader.single_camera".to_owned(), "1".to_owned()),
            ("ImageReader.camera_model".to_owned(), group.model().to_owned()),
        ];
        options.extend(group.parameters().map(|values| ("ImageReader.camera_params".to_owned(), values)));
        let database = self.database();
        let paths = [
            ("--database_path", database.as_path()),
            ("--image_path", self.images),
            ("--image_list_path", list.as_path()),
        ];
        self.run("feature_extractor", &paths, &options)
    }

    /// Matches features.
    pub(crate) fn match_features(&self, pairs: Pairs) -> Result<()> {
        let name = match pairs {
            Pairs::All => "exhaustive_matcher",
            Pairs::Neighbors => "sequential_matcher",
        };
        let options = [(format!("{}.use_gpu", self.matching), "0".to_owned())];
        self.run(name, &[("--database_path", self.database().as_path())], &options)
    }

    /// Estimates cameras and points. Returns the folders of the models with what they hold, largest first.
    pub(crate) fn reconstruct(&self) -> Result<Vec<(PathBuf, ColmapModel)>> {
        let sparse = self.folder.join("sparse");
        std::fs::create_dir(&sparse).map_err(io_error("create", &sparse))?;
        let database = self.database();
        let paths = [
            ("--database_path", database.as_path()),
            ("--image_path", self.images),
            ("--output_path", sparse.as_path()),
        ];
        let done = self.run("mapper", &paths, &[]);
        let mut models = Vec::new();
        for entry in std::fs::read_dir(&sparse).map_err(io_error("read", &sparse))?.flatten() {
            if let Some(model) = ColmapModel::read(&entry.path())? {
                models.push((entry.path(), model));
            }
        }
        models.sort_by_key(|(path, model)| (std::cmp::Reverse((model.images.len(), model.points)), path.clone()));
        match done {
            // The command fails if it finds no first pair of images. A signal is another failure.
            Err(CaptureError::Program { status, .. }) if status.starts_with("exit status: 1") => Ok(models),
            Err(error) => Err(error),
            Ok(()) => Ok(models),
        }
    }

    /// Removes the distortion from the images of a model. `output` receives images and cameras.
    pub(crate) fn undistort(&self, model: &Path, output: &Path) -> Result<()> {
        let paths = [("--image_path", self.images), ("--input_path", model), ("--output_path", output)];
        self.run("image_undistorter", &paths, &[("output_type".to_owned(), "COLMAP".to_owned())])
    }
}
