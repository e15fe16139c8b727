//! Which images see the points of a reconstruction.

use std::collections::{HashMap, HashSet};

/// For each point, the numbers of the images that see it.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Tracks {
    /// Where the images of each point end.
    ends: Vec<usize>,
    /// Numbers of images, point after point.
    images: Vec<u32>,
    /// View names by the numbers of their images.
    names: HashMap<u32, String>,
}

impl Tracks {
    /// Adds an image that sees the point that [`Tracks::end_point`] ends next.
    pub(crate) fn add(&mut self, image: u32) {
        self.images.push(image);
    }

    /// Ends the track of a point.
    pub(crate) fn end_point(&mut self) {
        self.ends.push(self.images.len());
    }

    /// Sets the names of the images.
    pub(crate) fn name(&mut self, names: HashMap<u32, String>) {
        self.names = names;
    }

    /// Whether no image sees any point: the file has no tracks.
    pub(crate) fn is_empty(&self) -> bool {
        self.images.is_empty()
    }

    /// For each point, whether at least two of these views see it.
    pub(crate) fn seen_twice(&self, views: &HashSet<&str>) -> Vec<bool> {
        let counts: HashSet<u32> =
            self.names.iter().filter(|(_, name)| views.contains(name.as_str())).map(|(image, _)| *image).collect();
        let starts = std::iter::once(&0).chain(&self.ends);
        let seen = |(&from, &to): (&usize, &usize)| {
            let mut images = self.images[from..to].iter().filter(|image| counts.contains(image));
            // A track may hold two observations of one image.
            images.next().is_some_and(|first| images.any(|other| other != first))
        };
        starts.zip(&self.ends).map(seen).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_different_views_must_see_a_point() {
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
