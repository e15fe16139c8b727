//! Contents of a directory that a command writes into.

use crate::directory::RunDirectory;
use crate::stage::StageKind;
use sgs_scene::Layout;
use std::path::Path;

/// Contents of a directory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Contents {
    /// Missing or empty.
    Nothing,
    /// File instead of a directory.
    File,
    /// A scene.
    Scene(Layout),
    /// A run.
    Run(RunContents),
    /// Other files; holds the first name in order.
    Other(String),
}

/// Contents of a run directory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RunContents {
    /// Geometry stage with a checkpoint, or geometry from elsewhere.
    pub geometry: bool,
    /// Intrinsic stage with a checkpoint, or its lights.
    pub materials: bool,
    /// Transport stage with a checkpoint, or its emitters.
    pub transport: bool,
}

impl Contents {
    /// Inspects a directory. Hidden files do not count.
    pub fn of(root: &Path) -> Contents {
        if root.is_file() {
            return Contents::File;
        }
        if let Some(layout) = Layout::of(root) {
            return Contents::Scene(layout);
        }
        if let Some(run) = RunContents::of(root) {
            return Contents::Run(run);
        }
        match entries(root).into_iter().next() {
            None => Contents::Nothing,
            Some(name) => Contents::Other(name),
        }
    }
}

impl RunContents {
    /// Inspects a directory; `None` if it is not a run directory.
    pub fn of(root: &Path) -> Option<RunContents> {
        let run = RunDirectory::open(root).ok()?;
        let geometry = run.checkpoint(StageKind::Geometry).is_file() || run.path("scene.ply").is_file();
        let materials = run.checkpoint(StageKind::Intrinsic).is_file() || run.path("lights.json").is_file();
        let transport = run.checkpoint(StageKind::Transport).is_file() || run.emitters().is_file();
        // `config.toml` alone is no evidence: other programs have files of this name.
        let found = RunContents { geometry, materials, transport };
        (found.is_trained() || run.path("checkpoint").is_dir()).then_some(found)
    }

    /// Returns whether replacing the run would lose trained data.
    pub fn is_trained(self) -> bool {
        self.geometry || self.materials || self.transport
    }
}

/// Returns the names of the files and folders of a directory in order.
///
/// Hidden files, among them the lock, `lost+found` and an empty `checkpoint` folder do not count.
pub fn entries(root: &Path) -> Vec<String> {
    let is_empty = |path: &Path| path.is_dir() && std::fs::read_dir(path).is_ok_and(|mut d| d.next().is_none());
    let all = std::fs::read_dir(root).into_iter().flatten().flatten();
    let counted = all.filter(|entry| entry.file_name() != "checkpoint" || !is_empty(&entry.path()));
    let names = counted.map(|entry| entry.file_name().to_string_lossy().into_owned());
    let mut names: Vec<String> = names.filter(|name| !name.starts_with('.') && name != "lost+found").collect();
    names.sort();
    names
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_of_directories_are_recognized() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        let put = |name: &str| {
            std::fs::create_dir_all(root.join(name).parent().unwrap()).unwrap();
            std::fs::write(root.join(name), "").unwrap();
        };
        assert_eq!(Contents::of(&root.join("none")), Contents::Nothing);
        put(".lock");
        std::fs::create_dir(root.join("checkpoint")).unwrap();
        assert_eq!(Contents::of(root), Contents::Nothing);
        put("notes.txt");
        assert_eq!(Contents::of(root), Contents::Other("notes.txt".into()));
        assert_eq!(Contents::of(&root.join("notes.txt")), Contents::File);
        put("config.toml");
        let run =
            |[geometry, materials, transport]: [bool; 3]| Contents::Run(RunContents { geometry, materials, transport });
        assert_eq!(Contents::of(root), run([false; 3]));
        put("checkpoint/geometry.safetensors");
        assert_eq!(Contents::of(root), run([true, false, false]));
        put("lights.json");
        assert_eq!(Contents::of(root), run([true, true, false]));
        put("emitters.json");
        assert_eq!(Contents::of(root), run([true; 3]));
        std::fs::remove_dir_all(root.join("checkpoint")).unwrap();
        std::fs::remove_file(root.join("lights.json")).unwrap();
        assert_eq!(Contents::of(root), run([false, false, true]));
        std::fs::remove_file(root.join("emitters.json")).unwrap();
        assert_eq!(Contents::of(root), Contents::Other("config.toml".into()), "a file of another program");
        put("sparse/0/cameras.txt");
        assert_eq!(Contents::of(root), Contents::Scene(Layout::Colmap));
    }
}
