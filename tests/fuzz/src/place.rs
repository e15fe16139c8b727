//! Temporary directory of a target, in memory if possible, deleted on drop.

use std::cell::RefCell;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use tempfile::TempDir;

/// Temporary directory.
pub struct Place(TempDir);

thread_local! {
    static PLACES: RefCell<HashMap<&'static str, Rc<Place>>> = RefCell::default();
}

impl Place {
    /// Creates an empty directory.
    #[allow(clippy::new_without_default, reason = "it makes a folder")]
    pub fn new() -> Place {
        let memory = Path::new("/dev/shm");
        let made = tempfile::Builder::new().prefix("sgs-fuzz-").tempdir_in(memory);
        Place(made.or_else(|_| tempfile::tempdir()).expect("a folder for inputs can be made"))
    }

    /// Returns this thread's directory with this name; `fill` fills it at the first call.
    pub fn of(name: &'static str, fill: fn(&Place)) -> Rc<Place> {
        if let Some(place) = PLACES.with_borrow(|all| all.get(name).cloned()) {
            return place;
        }
        let place = Rc::new(Place::new());
        fill(&place);
        PLACES.with_borrow_mut(|all| all.insert(name, place.clone()));
        place
    }

    /// Deletes all directories of this thread, since a failure may have damaged one.
    pub fn forget() {
        PLACES.with_borrow_mut(HashMap::clear);
    }

    /// Returns the path of the directory or of a file in it.
    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Writes a file and creates its parent directories.
    pub fn put(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.path(name);
        if std::fs::write(&path, bytes).is_err() {
            let folder = path.parent().expect("a file lies in a folder");
            std::fs::create_dir_all(folder).expect("folders for inputs can be made");
            std::fs::write(&path, bytes).expect("inputs can be written");
        }
        path
    }
}
