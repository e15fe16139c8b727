//! Objects behind handles.
//!
//! Guarantees: a handle returns the object that it was made for and no other, as long as that object exists. The handle
//! encodes the kind, the context, and the generation of its slot. Stale handles, handles of another kind and handles of
//! another context are therefore refused.

use crate::border::{Outcome, fail};
use crate::types::{SgsHandle, SgsResult};

/// Object that a handle can stand for.
pub trait Object: Sized {
    /// Names of the kinds; the index is the kind minus one.
    const KINDS: &'static [&'static str];

    /// Returns the kind, from 1 to 15.
    fn kind(&self) -> u64;
}

struct Place<T> {
    /// Generation of the slot. Handles of earlier generations are stale.
    generation: u64,
    object: Option<T>,
}

/// Objects of one context.
pub struct Table<T> {
    places: Vec<Place<T>>,
    free: Vec<usize>,
    salt: u64,
}

const INDEX: u64 = 20;
const GENERATION: u64 = 20;
const SALT: u64 = 20;

const fn bits(count: u64) -> u64 {
    (1 << count) - 1
}

impl<T: Object> Table<T> {
    /// Creates an empty table. `salt` distinguishes contexts.
    pub fn new(salt: u64) -> Table<T> {
        Table { places: Vec::new(), free: Vec::new(), salt: salt & bits(SALT) }
    }

    /// Returns the number of objects.
    pub fn len(&self) -> usize {
        self.places.len() - self.free.len()
    }

    /// Adds an object and returns its handle.
    pub fn add(&mut self, object: T) -> Outcome<SgsHandle> {
        let index = match self.free.pop() {
            Some(index) => index,
            None if self.places.len() as u64 > bits(INDEX) => {
                return fail(SgsResult::SGS_ERROR_MEMORY, "There are too many objects.");
            }
            None => {
                self.places.push(Place { generation: 1, object: None });
                self.places.len() - 1
            }
        };
        let kind = object.kind();
        let place = &mut self.places[index];
        place.object = Some(object);
        Ok(index as u64
            | place.generation << INDEX
            | self.salt << (INDEX + GENERATION)
            | kind << (INDEX + GENERATION + SALT))
    }

    /// Returns the slot of a handle.
    fn find(&self, handle: SgsHandle, kind: Option<u64>) -> Outcome<usize> {
        let (index, generation) = (handle & bits(INDEX), handle >> INDEX & bits(GENERATION));
        let (salt, stated) = (handle >> (INDEX + GENERATION) & bits(SALT), handle >> (INDEX + GENERATION + SALT));
        let name = |kind: u64| T::KINDS.get(kind.wrapping_sub(1) as usize).copied().unwrap_or("object");
        let refuse = |text: String| fail(SgsResult::SGS_ERROR_HANDLE, text);
        if handle == 0 {
            return refuse(format!("The handle of the {} is 0.", kind.map_or("object", name)));
        }
        let place = self.places.get(index as usize);
        let known = place.filter(|_| salt == self.salt).and_then(|p| p.object.as_ref().map(|o| (p, o)));
        match known {
            Some((place, object)) if place.generation == generation && object.kind() == stated => match kind {
                Some(kind) if kind != stated => {
                    refuse(format!("The handle {handle:#x} is that of a {}, not of a {}.", name(stated), name(kind)))
                }
                _ => Ok(index as usize),
            },
            _ => refuse(format!("The handle {handle:#x} belongs to no {} of this context.", name(stated))),
        }
    }

    /// Returns the object of a handle, which must be of the kind.
    pub fn get(&mut self, handle: SgsHandle, kind: u64) -> Outcome<&mut T> {
        let index = self.find(handle, Some(kind))?;
        match self.places[index].object.as_mut() {
            Some(object) => Ok(object),
            None => fail(SgsResult::SGS_ERROR_HANDLE, "The object is gone."),
        }
    }

    /// Removes and returns an object. Accepts any kind if `kind` is absent. The handle is stale from now on.
    pub fn take(&mut self, handle: SgsHandle, kind: Option<u64>) -> Outcome<T> {
        let index = self.find(handle, kind)?;
        let place = &mut self.places[index];
        let Some(object) = place.object.take() else {
            return fail(SgsResult::SGS_ERROR_HANDLE, "The object is gone.");
        };
        place.generation += 1;
        // A slot whose generations are exhausted is never used again.
        if place.generation <= bits(GENERATION) {
            self.free.push(index);
        }
        Ok(object)
    }

    /// Removes and returns all objects.
    pub fn drain(&mut self) -> Vec<T> {
        let all = self.places.iter_mut().filter_map(|p| p.object.take()).collect();
        self.places.clear();
        self.free.clear();
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, PartialEq)]
    struct Thing(u64);

    impl Object for Thing {
        const KINDS: &'static [&'static str] = &["apple", "pear"];

        fn kind(&self) -> u64 {
            self.0
        }
    }

    #[test]
    fn handle_returns_only_its_own_object() {
        let mut table = Table::new(7);
        let mut other = Table::new(8);
        let (apple, pear) = (table.add(Thing(1)).unwrap(), table.add(Thing(2)).unwrap());
        let foreign = other.add(Thing(1)).unwrap();
        assert_ne!(apple, foreign);
        assert_eq!(*table.get(apple, 1).unwrap(), Thing(1));
        let text = |r: Outcome<&mut Thing>| r.unwrap_err().text;
        assert!(text(table.get(pear, 1)).contains("is that of a pear, not of a apple"));
        assert!(text(table.get(foreign, 1)).contains("belongs to no apple of this context"));
        assert!(text(table.get(0, 2)).contains("pear is 0"));
        assert_eq!(table.take(apple, None).unwrap(), Thing(1));
        assert!(table.take(apple, None).is_err());
        let again = table.add(Thing(1)).unwrap();
        assert_ne!(again, apple);
        assert!(table.get(apple, 1).is_err() && table.get(again, 1).is_ok());
        assert_eq!(table.len(), 2);
        for bit in 0..64 {
            assert!(table.get(again ^ 1 << bit, 1).is_err(), "bit {bit}");
        }
        assert_eq!(table.drain().len(), 2);
        assert!(table.get(again, 1).is_err() && table.len() == 0);
    }
}
