//! Renumbering of regions of single images, unique across images.
//!
//! On disk, equal numbers mean the same region in every view. A network that processes one image at a time cannot match
//! regions across views. Its regions therefore get numbers that no other view has, which avoids false matches.

use std::collections::HashMap;

/// Allocator of unused region numbers.
#[derive(Debug)]
pub(super) struct Numbers {
    last: u32,
}

impl Numbers {
    /// Creates an allocator of numbers above `used`.
    pub(super) fn above(used: u16) -> Numbers {
        Numbers { last: u32::from(used) }
    }

    /// Assigns new numbers to an image's regions, in order of appearance.
    ///
    /// Returns `None` if no numbers are left.
    pub(super) fn renumber(&mut self, ids: &mut [u16]) -> Option<()> {
        let mut new: HashMap<u16, u16> = HashMap::new();
        for id in ids.iter_mut().filter(|id| **id != 0) {
            let next = match new.get(id) {
                Some(known) => *known,
                None => {
                    self.last += 1;
                    let next = u16::try_from(self.last).ok()?;
                    new.insert(*id, next);
                    next
                }
            };
            *id = next;
        }
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn region_numbers_are_unique_across_images() {
        let mut numbers = Numbers::above(10);
        let mut a = [0, 7, 7, 900, 0, 7];
        let mut b = [7, 0, 1];
        assert!(numbers.renumber(&mut a).is_some() && numbers.renumber(&mut b).is_some());
        assert_eq!((a, b), ([0, 11, 11, 12, 0, 11], [13, 0, 14]));
        let mut full = Numbers::above(u16::MAX - 1);
        assert!(full.renumber(&mut [5, 5, 0]).is_some());
        assert!(full.renumber(&mut [0, 5]).is_none());
    }
}
