//! Region numbers of single images made different between images.
//!
//! On disk the same number is the same region in every view. A network that looks at one image cannot know that, so its
//! regions get numbers that no other view has: nothing false is said then.

use std::collections::HashMap;

/// Hands out numbers that are free.
#[derive(Debug)]
pub(super) struct Numbers {
    last: u32,
}

impl Numbers {
    /// Above everything that is in use.
    pub(super) fn above(used: u16) -> Numbers {
        Numbers { last: u32::from(used) }
    }

    /// New numbers for an image's regions, in the order in which they appear; `None` if there are none left.
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
    fn numbers_never_meet() {
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
