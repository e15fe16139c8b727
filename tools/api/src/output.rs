//! Checks of output directories. A wrong `-o` overwrites no result, no scene and no file of another program.

use crate::refuse_usage;
use sgs_run::{Contents, DirectoryLock, RunContents, entries};
use std::path::Path;

/// Data that a command is about to write into a run directory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Begin {
    /// Geometry, followed by materials if both stages are requested.
    Geometry,
    /// Materials on the geometry stored in the run.
    Materials,
    /// Materials on geometry from a file.
    MaterialsFrom,
    /// Emitters and materials on the geometry stored in the run.
    Emitters,
}

/// Values of `--force` and `--resume`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Permission {
    /// Allows existing data to be replaced.
    pub force: bool,
    /// Continues existing data.
    pub resume: bool,
}

/// Refuses a run directory whose data training would destroy, or that is not a run.
pub fn check_run(root: &Path, begin: Begin, permission: Permission) -> anyhow::Result<()> {
    let name = root.display();
    let run = match check_kind(root, "a run")? {
        Contents::Run(run) => run,
        _ => RunContents::default(),
    };
    let RunContents { materials, transport, .. } = run;
    let adds = match begin {
        Begin::Materials => !materials,
        Begin::Emitters => !transport,
        Begin::Geometry | Begin::MaterialsFrom => false,
    };
    if permission.resume || permission.force || !run.is_trained() || adds {
        return Ok(());
    }
    if begin == Begin::Emitters {
        refuse_usage!("\"{name}\" has emitters: find them again on the same geometry with --force.");
    }
    if begin == Begin::Materials {
        refuse_usage!(
            "\"{name}\" has materials: continue them with --resume, or train them again on the same geometry with --force."
        );
    }
    let state = if root.join("training.json").is_file() { "a finished run" } else { "an unfinished run" };
    refuse_usage!(
        "\"{name}\" holds {state}: continue it with --resume, replace it with --force, or name another directory."
    )
}

/// Refuses files, scenes and directories that hold other programs' files.
///
/// Otherwise returns the contents of the directory. `what`: purpose of the directory, as error messages name it.
fn check_kind(root: &Path, what: &str) -> anyhow::Result<Contents> {
    let name = root.display();
    match Contents::of(root) {
        Contents::File => refuse_usage!("\"{name}\" is a file: name a directory for {what}."),
        Contents::Scene(_) => {
            refuse_usage!("\"{name}\" is a scene: name another directory for {what}, so that the scene stays as it is.")
        }
        Contents::Other(file) => refuse_usage!(
            "\"{name}\" holds files that do not belong to {what}, such as \"{file}\": name a new or an empty directory."
        ),
        contents => Ok(contents),
    }
}

/// Refuses a path for a new scene that holds anything.
pub fn check_scene(root: &Path) -> anyhow::Result<()> {
    let name = root.display();
    match check_kind(root, "a scene")? {
        Contents::Run(_) => refuse_usage!("\"{name}\" is a run: name another directory for a scene."),
        _ => Ok(()),
    }
}

/// Refuses a directory for a table of runs that holds anything else. `batch`: name of the folder of its batch.
pub fn check_series(root: &Path, tables: &[&str], batch: &str) -> anyhow::Result<()> {
    let name = root.display();
    match Contents::of(root) {
        Contents::Other(_) => {
            let belongs = |entry: &String| {
                let path = root.join(entry);
                let table = tables.iter().any(|t| *entry == format!("{t}.json") || *entry == format!("{t}.md"));
                table || *entry == batch && path.join("leases").is_dir() || path.is_dir() && matches!(Contents::of(&path), Contents::Run(_) | Contents::Nothing)
                    // A run without its settings file.
                    || path.join("checkpoint").is_dir()
            };
            match entries(root).into_iter().find(|entry| !belongs(entry)) {
                None => Ok(()),
                Some(file) => refuse_usage!(
                    "\"{name}\" holds files that do not belong to a table of runs, such as \"{file}\": name a new or an \
                     empty directory."
                ),
            }
        }
        Contents::Run(_) => refuse_usage!("\"{name}\" is a run: name another directory for a table of runs."),
        _ => check_kind(root, "a table of runs").map(|_| ()),
    }
}

/// Refuses a directory for a batch that holds anything else. A directory with results of a batch is one.
pub fn check_batch(root: &Path) -> anyhow::Result<()> {
    let is_batch = || root.join("results").is_dir() && root.join("leases").is_dir();
    // Another command over the directory may be hashing the scenes, or was stopped while it did.
    let own = ["hashes", "leases", "results", "runs", "variants"];
    let begun = || root.join("hashes").is_dir() && entries(root).iter().all(|entry| own.contains(&entry.as_str()));
    // It may also finish its first folders between the two checks, and go on with other files.
    if is_batch() || begun() || is_batch() {
        return Ok(());
    }
    if let Contents::Run(_) = check_kind(root, "a batch")? {
        refuse_usage!("\"{}\" is a run: name another directory for a batch.", root.display());
    }
    Ok(())
}

/// Refuses a scene or a run as the directory for images.
///
/// Without `--force`, also refuses a directory that holds files other than images, videos and JSON.
pub fn check_images(root: &Path, force: bool) -> anyhow::Result<()> {
    let name = root.display();
    match Contents::of(root) {
        Contents::Run(_) => refuse_usage!("\"{name}\" is a run: name another directory for images."),
        Contents::Other(_) => {
            let image = |entry: &String| {
                let path = Path::new(entry);
                let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase());
                extension
                    .is_some_and(|e| ["png", "exr", "jpg", "jpeg", "gif", "mp4", "webp", "json"].contains(&e.as_str()))
            };
            if let Some(file) = entries(root).into_iter().find(|entry| !image(entry)).filter(|_| !force) {
                refuse_usage!(
                    "\"{name}\" holds files other than images, such as \"{file}\": name another directory, or write among \
                     them with --force."
                );
            }
        }
        _ => {
            check_kind(root, "images")?;
        }
    }
    Ok(())
}

/// Creates a directory and its parents.
pub fn make(root: &Path) -> anyhow::Result<()> {
    std::fs::create_dir_all(root).map_err(|e| anyhow::anyhow!("\"{}\" cannot be made: {e}.", root.display()))
}

/// Locks a directory while a command writes into it. Warns if the lock of a dead process was replaced.
pub fn lock(root: &Path) -> anyhow::Result<DirectoryLock> {
    let lock = DirectoryLock::acquire(root)?;
    if let Some(holder) = lock.recovered() {
        tracing::warn!(
            "\"{}\" was still locked by process {} on {}, which has ended; its lock is taken over.",
            root.display(),
            holder.pid,
            holder.host
        );
    }
    Ok(lock)
}
