//! A folder of a target's own, gone with the value: in memory where the system has such a place.

use std::cell::RefCell;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use tempfile::TempDir;

/// A folder.
pub struct Place(TempDir);

thread_local! {
    static PLACES: RefCell<HashMap<&'static str, Rc<Place>>> = RefCell::default();
}

impl Place {
    /// An empty one.
    #[allow(clippy::new_without_default, reason = "it makes a folder")]
    pub fn new() -> Place {
        let memory = Path::new("/dev/shm");
        let made = tempfile::Builder::new().prefix("sgs-fuzz-").tempdir_in(memory);
        Place(made.or_else(|_| tempfile::tempdir()).expect("a folder for inputs can be made"))
    }

    /// The one of this name and thread, which `fill` fills when it is first asked for.
    pub fn of(name: &'static str, fill: fn(&Place)) -> Rc<Place> {
        if let Some(place) = PLACES.with_borrow(|all| all.get(name).cloned()) {
            return place;
        }
        let place = Rc::new(Place::new());
        fill(&place);
        PLACES.with_borrow_mut(|all| all.insert(name, place.clone()));
        place
    }

    /// Forgets all of this thread's: something has gone wrong in one.
    pub fn forget() {
        PLACES.with_borrow_mut(HashMap::clear);
    }

    /// The folder, or what is in it.
    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Writes a file, with the folders that it lies in.
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
