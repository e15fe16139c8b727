//! Observations of reconstructed points in images.

use std::collections::{HashMap, HashSet};

/// Ids of the images that see each point.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Tracks {
    /// End of each point's range in `images`.
    ends: Vec<usize>,
    /// Image ids, point after point.
    images: Vec<u32>,
    /// View names by image id.
    names: HashMap<u32, String>,
}

impl Tracks {
    /// Adds an observing image to the current point's track. [`Tracks::end_point`] ends the track.
    pub(crate) fn add(&mut self, image: u32) {
        self.images.push(image);
    }

    /// Ends the track of a point.
    pub(crate) fn end_point(&mut self) {
        self.ends.push(self.images.len());
    }

    /// Sets the view names of the images.
    pub(crate) fn name(&mut self, names: HashMap<u32, String>) {
        self.names = names;
    }

    /// Returns whether there are no observations, that is, the file has no tracks.
    pub(crate) fn is_empty(&self) -> bool {
        self.images.is_empty()
    }

    /// Returns for each point whether at least two of these views see it.
    pub(crate) fn seen_twice(&self, views: &HashSet<&str>) -> Vec<bool> {
        let counts: HashSet<u32> =
            self.names.iter().filter(|(_, name)| views.contains(name.as_str())).map(|(image, _)| *image).collect();
        let starts = std::iter::once(&0).chain(&self.ends);
        let seen = |(&from, &to): (&usize, &usize)| {
            let mut images = self.images[from..to].iter().filter(|image| counts.contains(image));
            // A track may hold two observations of the same image.
            images.next().is_some_and(|first| images.any(|other| other != first))
        };
        starts.zip(&self.ends).map(seen).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seen_points_need_two_different_views() {
        let mut tracks = Tracks::default();
        for track in [&[1, 2][..], &[1, 1], &[], &[3, 9, 1], &[9, 3], &[2, 2, 3]] {
            track.iter().for_each(|image| tracks.add(*image));
            tracks.end_point();
        }
        tracks.name([(1, "a"), (2, "b"), (3, "c")].map(|(number, name)| (number, name.to_owned())).into());
        assert!(!tracks.is_empty() && Tracks::default().is_empty());
        assert_eq!(tracks.seen_twice(&["a", "b", "c"].into()), [true, false, false, true, false, true]);
        assert_eq!(tracks.seen_twice(&["a", "b"].into()), [true, false, false, false, false, false]);
        assert_eq!(tracks.seen_twice(&["b"].into()), [false; 6]);
    }
}
