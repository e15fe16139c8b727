//! Camera poses, and interpolation between them.

use glam::{DQuat, DVec3};
use sgs_scene::Camera;

/// Pose of a camera, camera to world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Position in the world.
    pub position: DVec3,
    /// Unit quaternion.
    pub rotation: DQuat,
}

impl Pose {
    /// Returns the pose of a camera.
    pub fn of(camera: &Camera) -> Pose {
        let rotation = DQuat::from_mat3(&camera.rotation.transpose()).normalize();
        Pose { position: camera.position(), rotation }
    }

    /// Returns the distance of two poses: of the positions in scene units plus the angle between the orientations.
    ///
    /// Both terms have weight 1, as in the published code.
    pub fn distance(&self, other: &Pose) -> f64 {
        let cosine = 2.0 * self.rotation.dot(other.rotation).powi(2) - 1.0;
        // Rounding may leave the domain of the arc cosine. The NaN would then be the nearest pose to every other.
        self.position.distance(other.position) + cosine.clamp(-1.0, 1.0).acos()
    }

    /// Returns the pose at `t`, where 0 is this pose and 1 is `other`. The end poses are exact. Positions lie on the
    /// line between both, or on the curve that `around` bends ([`bend`]).
    pub fn toward(&self, other: &Pose, t: f64, around: Option<[Option<DVec3>; 2]>) -> Pose {
        if t <= 0.0 {
            return *self;
        }
        if t >= 1.0 {
            return *other;
        }
        let (a, b) = (self.position, other.position);
        let position = around.map_or_else(|| a.lerp(b, t), |[before, behind]| curve(before, a, b, behind, t));
        Pose { position, rotation: turn(self.rotation, other.rotation, t) }
    }
}

/// Interpolates between two orientations by the shorter arc. Half a turn has two shortest arcs. The axis whose largest
/// component is positive is then chosen, so that rounding does not decide.
fn turn(from: DQuat, to: DQuat, t: f64) -> DQuat {
    let mut between = from.conjugate() * to;
    let axis = between.xyz();
    let largest = axis.to_array().into_iter().fold(0.0, |m: f64, c| if c.abs() > m.abs() + 1e-9 { c } else { m });
    if between.w < -1e-9 || between.w <= 1e-9 && largest < 0.0 {
        between = -between;
    }
    let axis = between.xyz();
    let Some(unit) = axis.try_normalize() else { return from };
    let angle = 2.0 * axis.length().atan2(between.w.max(0.0));
    (from * DQuat::from_axis_angle(unit, t * angle)).normalize()
}

/// Returns the positions that bend the path between two poses. These are the nearest position behind its start and the
/// nearest one beyond its end, seen along the path.
pub fn bend(from: &Pose, to: &Pose, all: impl Iterator<Item = DVec3> + Clone) -> [Option<DVec3>; 2] {
    let (a, b) = (from.position, to.position);
    let nearest = |to: DVec3, along: DVec3| {
        let behind = all.clone().filter(|p| (to - *p).dot(along) > 0.0);
        behind.min_by(|p, q| p.distance(to).total_cmp(&q.distance(to)))
    };
    [nearest(a, b - a), nearest(b, a - b)]
}

/// Returns the point at `t` on a cubic curve from `a` to `b`. Slopes are those of Catmull and Rom: half of the vector
/// from the neighbor on one side to that on the other. Without a neighbor the slope is `b - a`. No slope is longer than
/// that, so that a distant neighbor makes no loop.
fn curve(before: Option<DVec3>, a: DVec3, b: DVec3, behind: Option<DVec3>, t: f64) -> DVec3 {
    let way = b - a;
    let slope = |s: Option<DVec3>| s.unwrap_or(way).clamp_length_max(way.length());
    let at_a = slope(before.map(|p| 0.5 * (b - p)));
    let at_b = slope(behind.map(|p| 0.5 * (p - a)));
    let (t2, t3) = (t * t, t * t * t);
    let from_a = (t3 - 2.0 * t2 + t) * at_a;
    let from_b = (t3 - t2) * at_b;
    a + (3.0 * t2 - 2.0 * t3) * way + from_a + from_b
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: DQuat, b: DQuat) -> bool {
        a.dot(b).abs() > 1.0 - 1e-12
    }

    #[test]
    fn orientations_follow_the_shorter_arc_at_constant_speed() {
        let about = |angle: f64| DQuat::from_rotation_y(angle);
        assert!(close(turn(about(0.2), about(1.2), 0.25), about(0.45)));
        // From 170 to -170 degrees the arc is 20 degrees, not 340. The sign of a quaternion does not matter.
        let (from, to) = (about(170_f64.to_radians()), about(-170_f64.to_radians()));
        for to in [to, -to] {
            assert!(close(turn(from, to, 0.5), about(180_f64.to_radians())));
            assert!(close(turn(from, to, 0.1), about(172_f64.to_radians())));
        }
        assert!(close(turn(from, from, 0.5), from) && close(turn(from, -from, 0.5), from));
    }

    #[test]
    fn half_turn_does_not_depend_on_rounding() {
        let from = DQuat::from_euler(glam::EulerRot::XYZ, 0.3, -0.2, 0.5);
        for axis in [DVec3::Y, DVec3::new(1.0, 2.0, -3.0).normalize(), DVec3::new(-1.0, -1.0, 0.0).normalize()] {
            let half = |angle: f64| turn(from, from * DQuat::from_axis_angle(axis, angle), 0.5);
            let exact = half(std::f64::consts::PI);
            for noise in [-1e-12, 1e-12] {
                assert!(close(half(std::f64::consts::PI + noise), exact), "{axis}");
                assert!(close(half(-std::f64::consts::PI + noise), exact), "{axis}");
            }
            assert!(exact.is_finite() && (exact.angle_between(from) - std::f64::consts::FRAC_PI_2).abs() < 1e-6);
        }
    }

    #[test]
    fn distance_matches_its_definition() {
        let a = Pose { position: DVec3::new(1.0, 2.0, 3.0), rotation: DQuat::from_rotation_x(0.4) };
        let b = Pose { position: DVec3::new(1.0, 5.0, 7.0), rotation: -DQuat::from_rotation_x(1.0) };
        assert!((a.distance(&b) - 5.6).abs() < 1e-12);
        // The distance of a pose from itself is neither negative nor NaN.
        let own = a.distance(&a);
        assert!((0.0..1e-7).contains(&own), "{own}");
    }

    /// Rounding raises the cosine of equal orientations above 1. The angle is then 0, not NaN.
    #[test]
    fn equal_orientations_have_no_angle() {
        let mut beyond = 0;
        for i in 0..1000 {
            let a = 0.003 * f64::from(i);
            let rotation = DQuat::from_euler(glam::EulerRot::XYZ, a, 0.7 * a, -0.4 * a).normalize();
            beyond += usize::from(2.0 * rotation.dot(rotation).powi(2) - 1.0 > 1.0);
            let pose = Pose { position: DVec3::ZERO, rotation };
            for other in [pose, Pose { rotation: -rotation, ..pose }] {
                let found = pose.distance(&other);
                assert!((0.0..1e-7).contains(&found), "{a}: {found}");
            }
        }
        assert!(beyond > 0, "rounding never went beyond one");
    }

    #[test]
    fn curves_preserve_ends_and_straight_lines() {
        let [p, a, b, q] = [0.0, 1.0, 2.0, 3.0].map(|x| DVec3::new(x, -x, 0.5));
        for t in [0.0, 0.2, 0.7, 1.0] {
            let line = a.lerp(b, t);
            assert!(curve(Some(p), a, b, Some(q), t).distance(line) < 1e-12);
            assert!(curve(None, a, b, None, t).distance(line) < 1e-12);
            assert!(curve(Some(p), a, a, Some(q), t).distance(a) < 1e-12);
        }
        // Cameras on a circle: the curve bows outward, the line does not.
        let at = |angle: f64| DVec3::new(angle.cos(), angle.sin(), 0.0);
        let [p, a, b, q] = [0.0, 0.5, 1.0, 1.5].map(at);
        let middle = curve(Some(p), a, b, Some(q), 0.5);
        assert!(middle.length() > 0.99 && a.lerp(b, 0.5).length() < 0.97, "{}", middle.length());
        // A distant neighbor makes no loop.
        let far = curve(Some(DVec3::new(-1e6, 0.0, 0.0)), a, b, Some(q), 0.1);
        assert!(far.distance(a) < a.distance(b));
    }

    #[test]
    fn bend_finds_positions_behind_and_ahead() {
        let pose = |x: f64| Pose { position: DVec3::new(x, 0.0, 0.0), rotation: DQuat::IDENTITY };
        let all = [-5.0, -1.0, 0.0, 1.0, 4.0].map(|x| DVec3::new(x, 0.1, 0.0));
        let found = bend(&pose(0.0), &pose(1.0), all.into_iter());
        assert_eq!(found.map(|p| p.map(|p| p.x)), [Some(-1.0), Some(4.0)]);
        assert_eq!(bend(&pose(0.0), &pose(0.0), all.into_iter()), [None, None]);
    }
}
