use super::*;
use glam::{DMat3, DVec3};

fn camera(name: &str, position: DVec3, turn: f64, width: u32) -> Camera {
    let rotation = DMat3::from_rotation_y(turn);
    let side = f64::from(width);
    Camera {
        name: name.into(),
        width,
        height: 60,
        fx: side,
        fy: 1.1 * side,
        cx: 0.45 * side,
        cy: 31.0,
        rotation,
        translation: -(rotation * position),
        near: sgs_scene::NEAR,
    }
}

/// Four cameras on a line, of different sizes, and two test views. One test view lies between the first two cameras.
fn scene() -> (Vec<Camera>, Vec<Camera>) {
    let at = |x: f64| DVec3::new(x, 0.2 * x, -1.0);
    let train = vec![
        camera("a", at(0.0), 0.0, 100),
        camera("b", at(1.0), 0.1, 80),
        camera("c", at(3.0), 0.2, 80),
        camera("d", at(3.5), 3.0, 80),
    ];
    (train, vec![camera("far", at(9.0), 0.0, 10), camera("t", at(0.4), 0.05, 10)])
}

fn options(neighbors: Neighbors) -> PseudoOptions {
    PseudoOptions { neighbors, ..Default::default() }
}

fn same_pose(a: &Camera, b: &Camera) -> bool {
    let rotation = (a.rotation.transpose() * b.rotation - DMat3::IDENTITY).to_cols_array();
    rotation.iter().all(|v| v.abs() < 1e-12) && a.position().distance(b.position()) < 1e-12
}

#[test]
fn sequences_join_nearest_views() {
    let (train, test) = scene();
    let views = PseudoViews::between(&train, &test, &options(Neighbors::Training));
    let neighbors: Vec<[&str; 2]> = (0..4).map(|v| [views.neighbor(v, 0), views.neighbor(v, 1)]).collect();
    // Camera d is nearer to c in space, but its orientation differs more.
    assert_eq!(neighbors, [["b", "c"], ["a", "c"], ["b", "a"], ["c", "b"]]);
    for (v, own) in train.iter().enumerate() {
        let other = |which| train.iter().find(|c| c.name == views.neighbor(v, which)).unwrap();
        assert!(same_pose(&views.camera(v, 0, 0), own) && same_pose(&views.camera(v, 0, 19), other(0)));
        assert!(same_pose(&views.camera(v, 1, 0), other(1)) && same_pose(&views.camera(v, 1, 19), own));
        for which in 0..2 {
            for i in 0..20 {
                let c = views.camera(v, which, i);
                assert_eq!((c.width, c.height, c.fx, c.fy, c.cx, c.cy), {
                    (own.width, own.height, own.fx, own.fy, own.cx, own.cy)
                });
                assert_eq!(c.problem(), None);
            }
        }
    }
    // Constant steps along the line and of the rotation.
    let (first, second) = (views.camera(0, 0, 7), views.camera(0, 0, 8));
    let step = DVec3::new(1.0, 0.2, 0.0) / 19.0;
    assert!((second.position() - first.position() - step).length() < 1e-12);
    let turned = DMat3::from_rotation_y(0.1 / 19.0);
    assert!(
        (second.rotation.transpose() * turned * first.rotation - DMat3::IDENTITY)
            .to_cols_array()
            .iter()
            .all(|v| v.abs() < 1e-12)
    );
}

#[test]
fn test_views_are_neighbors_only_on_request() {
    let (train, test) = scene();
    let views = PseudoViews::between(&train, &test, &options(Neighbors::Test));
    assert_eq!((views.neighbor(0, 0), views.neighbor(0, 1)), ("b", "t"));
    assert!(same_pose(&views.camera(0, 1, 0), &test[1]) && same_pose(&views.camera(0, 1, 19), &train[0]));
    assert_eq!(views.camera(0, 1, 0).width, 100);
    // Without test views the result equals that of training neighbors.
    let without = PseudoViews::between(&train, &[], &options(Neighbors::Test));
    assert_eq!(without.cameras(), PseudoViews::between(&train, &test, &options(Neighbors::Training)).cameras());
}

#[test]
fn few_or_coincident_views_are_handled() {
    let (train, _) = scene();
    let one = PseudoViews::between(&train[..1], &[], &PseudoOptions::default());
    assert!(one.cameras().iter().all(|c| same_pose(c, &train[0])));
    assert_eq!(one.cameras().len(), 40);
    let two = PseudoViews::between(&train[..2], &[], &PseudoOptions::default());
    assert_eq!((two.neighbor(0, 0), two.neighbor(0, 1)), ("b", "b"));
    assert!(same_pose(&two.camera(0, 1, 0), &train[1]) && same_pose(&two.camera(0, 1, 19), &train[0]));
    let twice = [train[0].clone(), Camera { name: "again".into(), ..train[0].clone() }, train[1].clone()];
    for position in [Position::Linear, Position::Cubic] {
        let o = PseudoOptions { position, ..Default::default() };
        let views = PseudoViews::between(&twice, &[], &o);
        assert_eq!((views.neighbor(0, 0), views.neighbor(0, 1)), ("again", "b"));
        assert!((0..20).all(|i| same_pose(&views.camera(0, 0, i), &train[0])));
        assert!(views.cameras().iter().all(|c| c.problem().is_none()));
    }
    assert_eq!(PseudoViews::between(&[], &[], &PseudoOptions::default()).cameras(), []);
    // A single pose is the start of the sequence.
    let single = PseudoViews::between(&train, &[], &PseudoOptions { poses: 1, ..Default::default() });
    assert!(same_pose(&single.camera(0, 0, 0), &train[0]) && single.draw(3, 9) == [0, 0]);
}

#[test]
fn opposite_cameras_are_interpolated() {
    let train = [camera("a", DVec3::ZERO, 0.0, 80), camera("b", DVec3::new(2.0, 0.0, 0.0), std::f64::consts::PI, 80)];
    let views = PseudoViews::between(&train, &[], &PseudoOptions::default());
    let middle = views.camera(0, 0, 9);
    assert!(middle.problem().is_none() && (middle.rotation.determinant() - 1.0).abs() < 1e-12);
    // The rotation is about the common vertical axis, so the horizon stays level.
    assert!((middle.rotation * DVec3::Y - DVec3::Y).length() < 1e-9);
    // Both sequences of a pair pass the same positions, from opposite ends.
    let (there, back) = (views.camera(0, 0, 5), views.camera(0, 1, 14));
    assert!(there.position().distance(back.position()) < 1e-9);
}

#[test]
fn draws_are_uniform_and_deterministic() {
    let (train, test) = scene();
    let views = PseudoViews::between(&train, &test, &PseudoOptions::default());
    let mut counts = [[0_u32; 20]; 2];
    let mut together = 0;
    for step in 1..=20_000 {
        let drawn = views.draw(5, step);
        (0..2).for_each(|which| counts[which][drawn[which] as usize] += 1);
        together += u32::from(drawn[0] == drawn[1]);
    }
    assert!(counts.iter().flatten().all(|n| (850..1150).contains(n)), "{counts:?}");
    assert!((850..1150).contains(&together), "{together}");
    assert_eq!(views.draw(5, 77), views.draw(5, 77));
    assert!((1..50).any(|s| views.draw(5, s) != views.draw(6, s)));
}

#[test]
fn names_match_file_names() {
    let (train, _) = scene();
    let views = PseudoViews::between(&train, &[], &PseudoOptions::default());
    assert_eq!((views.name(0, 1, 7), views.camera(3, 0, 12).name), ("a_1_07".into(), "d_0_12".into()));
    let mut names: Vec<String> = views.cameras().into_iter().map(|c| c.name).collect();
    names.dedup();
    assert_eq!((names.len(), views.views(), views.poses()), (160, 4, 20));
}

#[test]
fn options_are_written_as_words() {
    let text = toml::to_string(&PseudoOptions { neighbors: Neighbors::Test, ..Default::default() }).unwrap();
    assert!(text.contains("neighbors = \"test\"") && text.contains("position = \"linear\""), "{text}");
}
