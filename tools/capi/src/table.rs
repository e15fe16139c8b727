//! Objects behind numbers.
//!
//! Promises: a number is answered by the object it was made for and by nothing else, for as long as that exists. It tells
//! its kind, its context, and which use of its place it is, so that stale numbers, numbers of another kind and numbers of
//! another context are refused instead of believed.

use crate::border::{Outcome, fail};
use crate::types::{SgsHandle, SgsResult};

/// What a number can stand for.
pub trait Object: Sized {
    /// What the kinds are called, by number less one.
    const KINDS: &'static [&'static str];

    /// Its kind, from 1 to 15.
    fn kind(&self) -> u64;
}

struct Place<T> {
    /// Which use this is; numbers of earlier uses are stale.
    generation: u64,
    object: Option<T>,
}

/// The objects of one context.
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
    /// An empty one. `salt` tells contexts apart.
    pub fn new(salt: u64) -> Table<T> {
        Table { places: Vec::new(), free: Vec::new(), salt: salt & bits(SALT) }
    }

    /// How many objects there are.
    pub fn len(&self) -> usize {
        self.places.len() - self.free.len()
    }

    /// A number for a new object.
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

    /// The place of a number.
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

    /// The object of a number, which must be of a kind.
    pub fn get(&mut self, handle: SgsHandle, kind: u64) -> Outcome<&mut T> {
        let index = self.find(handle, Some(kind))?;
        match self.places[index].object.as_mut() {
            Some(object) => Ok(object),
            None => fail(SgsResult::SGS_ERROR_HANDLE, "The object is gone."),
        }
    }

    /// Takes an object out; of any kind if `kind` is absent. Its number is stale from now on.
    pub fn take(&mut self, handle: SgsHandle, kind: Option<u64>) -> Outcome<T> {
        let index = self.find(handle, kind)?;
        let place = &mut self.places[index];
        let Some(object) = place.object.take() else {
            return fail(SgsResult::SGS_ERROR_HANDLE, "The object is gone.");
        };
        place.generation += 1;
        // A place whose generations are used up is never used again.
        if place.generation <= bits(GENERATION) {
            self.free.push(index);
        }
        Ok(object)
    }

    /// Takes everything out.
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
    fn a_number_is_answered_by_its_own_object_alone() {
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
