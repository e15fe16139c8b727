//! Folders of photographs without cameras: commands that estimate the cameras.

use std::path::{Path, PathBuf};

use crate::image::stem_of;

/// Returns the commands for a folder of photographs without cameras. Returns `None` for a folder without photographs.
pub(super) fn problem(root: &Path) -> Option<String> {
    let inner = root.join("images");
    let (folder, count) =
        [inner.as_path(), root].map(|folder| (folder, count(folder))).into_iter().find(|f| f.1 > 0)?;
    let [root, folder] = [root, folder].map(quoted);
    Some(format!(
        "holds {count} photographs without cameras; make a scene of them by COLMAP: sgs capture {folder} -o SCENE (for a \
         few views, VGGT: python demo_colmap.py --scene_dir {root}, with the photographs in its images folder)"
    ))
}

/// Counts the photographs in a folder by their extension.
fn count(folder: &Path) -> usize {
    let files = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| PathBuf::from(entry.file_name()));
    // `stem_of` removes only image extensions.
    files.filter(|file| file.extension().is_some() && stem_of(file) != file.to_string_lossy()).count()
}

/// Quotes a path for a shell.
fn quoted(path: &Path) -> String {
    let text = path.display().to_string();
    let plain = |c: char| c.is_alphanumeric() || "/._-+,:@".contains(c);
    if text.chars().all(plain) { text } else { format!("'{}'", text.replace('\'', "'\\''")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_name_the_quoted_folders() {
        let directory = tempfile::tempdir().unwrap();
        let root = directory.path().join("my room");
        std::fs::create_dir_all(root.join("images")).unwrap();
        std::fs::write(root.join("notes.txt"), "").unwrap();
        assert_eq!(problem(&root), None);
        std::fs::write(root.join("b.jpeg"), "").unwrap();
        let at = root.display();
        let message = problem(&root).unwrap();
        assert!(message.contains(&format!("sgs capture '{at}' -o SCENE")), "{message}");
        std::fs::write(root.join("images/a.JPG"), "").unwrap();
        let message = problem(&root).unwrap();
        assert!(
            message.starts_with("holds 1 photographs") && message.contains(&format!("sgs capture '{at}/images' -o")),
            "{message}"
        );
        assert!(message.contains(&format!("demo_colmap.py --scene_dir '{at}'")), "{message}");
    }
}
