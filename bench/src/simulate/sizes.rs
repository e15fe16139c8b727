//! Sizes of runs and scenes, measured on disk.

use super::plan::Sizes;
use anyhow::{Context, ensure};
use std::path::Path;

/// Bytes, files and folders below a directory.
#[derive(Clone, Copy, Default)]
struct Tree {
    bytes: u64,
    files: u64,
    folders: u64,
}

fn tree(folder: &Path, leave_out: &dyn Fn(&str) -> bool) -> anyhow::Result<Tree> {
    let mut all = Tree { folders: 1, ..Tree::default() };
    let entries = std::fs::read_dir(folder).with_context(|| format!("\"{}\" cannot be read", folder.display()))?;
    for entry in entries {
        let path = entry?.path();
        let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        if name.starts_with('.') || leave_out(&name) {
            continue;
        }
        let metadata = std::fs::metadata(&path)?;
        if metadata.is_dir() {
            let inner = tree(&path, &|_| false)?;
            all.bytes += inner.bytes;
            all.files += inner.files;
            all.folders += inner.folders;
        } else {
            all.bytes += metadata.len();
            all.files += 1;
        }
    }
    Ok(all)
}

impl Sizes {
    /// Measures a finished run: its checkpoint, and all other files.
    ///
    /// # Errors
    /// If the directory cannot be read or has no checkpoint.
    pub fn measure_run(&mut self, run: &Path) -> anyhow::Result<()> {
        let checkpoint = run.join("checkpoint");
        ensure!(checkpoint.is_dir(), "\"{}\" has no checkpoint; name the directory of a run", run.display());
        self.checkpoint = tree(&checkpoint, &|_| false)?.bytes as f64;
        self.run = tree(run, &|name| name == "checkpoint")?.bytes as f64;
        Ok(())
    }

    /// Measures the files of a scene that a batch hashes: all but `gt` and hidden ones.
    ///
    /// # Errors
    /// If the directory cannot be read or has no files.
    pub fn measure_scene(&mut self, scene: &Path) -> anyhow::Result<()> {
        let all = tree(scene, &|name| name == "gt")?;
        ensure!(all.files > 0, "\"{}\" has no files; name the directory of a scene", scene.display());
        (self.scene, self.files, self.folders) = (all.bytes as f64, all.files as f64, all.folders as f64);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::plan::Plan;

    #[test]
    fn runs_and_scenes_are_measured() {
        let folder = tempfile::tempdir().unwrap();
        let put = |name: &str, size: usize| {
            let path = folder.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, vec![0; size]).unwrap();
        };
        put("run/checkpoint/state", 500);
        put("run/scene.ply", 70);
        put("scene/images/1.png", 30);
        put("scene/transforms.json", 4);
        put("scene/gt/albedo.png", 1000);
        put("scene/.hidden", 1000);
        let mut sizes = Plan::ideal(vec![1.0], 1).sizes;
        sizes.measure_run(&folder.path().join("run")).unwrap();
        sizes.measure_scene(&folder.path().join("scene")).unwrap();
        assert_eq!((sizes.checkpoint, sizes.run), (500.0, 70.0));
        assert_eq!((sizes.scene, sizes.files, sizes.folders), (34.0, 2.0, 2.0));
        assert!(sizes.measure_run(&folder.path().join("scene")).is_err());
        assert!(sizes.measure_scene(&folder.path().join("none")).is_err());
    }
}
