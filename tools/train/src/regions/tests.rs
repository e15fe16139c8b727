use super::*;

fn maps(views: &[&[u16]]) -> RegionMaps {
    let mut all = RegionMaps { source: RegionSource::Masks, views: vec![], ids: vec![] };
    for ids in views {
        all.views.push(RegionView { first: all.ids.len() as u32, regions: regions_of(ids) });
        all.ids.extend(*ids);
    }
    all
}

#[test]
fn class_is_that_of_the_nearest_sample() {
    for (map, size) in [([1, 1], [5, 4]), ([4, 3], [10, 7]), ([5, 1], [5, 1]), ([7, 2], [3, 9]), ([2, 3], [1, 1])] {
        let samples: Vec<u32> = (0..map[0] * map[1]).map(|i| if i == 3 { NO_LABEL } else { 10 * i }).collect();
        let found = classes(&samples, map, size);
        assert_eq!(found.len() as u32, size[0] * size[1]);
        for (p, id) in found.iter().enumerate() {
            let at = [p as u32 % size[0], p as u32 / size[0]];
            // The first and last samples lie on the first and last pixels.
            let place = [0, 1].map(|k| match size[k] {
                1 => 0.0,
                n => f64::from(at[k]) * f64::from(map[k] - 1) / f64::from(n - 1),
            });
            let nearest = place.map(|x| (x + 0.5 + 1e-9).floor() as u32);
            let sample = nearest[1] * map[0] + nearest[0];
            assert_eq!(u32::from(*id), if sample == 3 { 0 } else { 10 * sample + 1 }, "{map:?} {size:?} {at:?}");
        }
    }
    // A class whose id exceeds 16 bits becomes no region.
    assert_eq!(classes(&[65_534, 65_535], [2, 1], [2, 1]), [65_535, 0]);
}

#[test]
fn regions_are_drawn_in_proportion_to_pixels() {
    let ids: Vec<u16> = (0..1000)
        .map(|i| {
            if i < 100 {
                7
            } else if i < 400 {
                65_535
            } else {
                0
            }
        })
        .collect();
    let all = maps(&[&[0; 40], &ids, &[&[3; 15][..], &[4; 16]].concat()]);
    assert_eq!(all.views[1].regions, [(7, 100), (65_535, 300)]);
    assert_eq!(all.views[2].regions, [(4, 16)]);
    let count = |id: u32| (1..=20_000).filter(|&step| all.draw(1, 9, step) == id).count();
    let found = [count(7), count(65_535), count(0)];
    assert!((4700..5300).contains(&found[0]) && found[0] + found[1] == 20_000, "{found:?}");
    assert!((1..100).all(|step| all.draw(0, 9, step) == 0 && all.draw(2, 9, step) == 4));
    assert_eq!(all.draw(1, 9, 5), all.draw(1, 9, 5));
    assert!((1..50).any(|step| all.draw(1, 9, step) != all.draw(1, 10, step)));
    assert_eq!((all.ids(0).len(), all.ids(1), all.ids(2).len()), (40, &ids[..], 31));
    assert_eq!(all.bytes(), 4 * 536);
}
