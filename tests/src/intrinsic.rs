//! Settings and scenes for tests of the intrinsic stage.

use crate::Place;
use crate::rooms::Room;
use sgs_config::Settings;

/// Returns settings of a stage that takes a second or two.
pub fn settings(steps: u32) -> Settings {
    let mut s = Settings::default();
    s.geometry.steps = 20;
    s.geometry.densify.until = 0.0;
    s.intrinsic.steps = steps;
    s.intrinsic.environment.resolution = 16;
    s.intrinsic.lights.grid = 2;
    s.intrinsic.relight_from = 4;
    s.geometry.pseudo.poses = 3;
    (s.intrinsic.visibility.levels, s.intrinsic.visibility.log2_table) = (4, 10);
    (s.intrinsic.visibility.coarsest, s.intrinsic.visibility.finest) = (4, 32);
    s
}

/// Creates a room with priors and masks.
///
/// The priors cover normals, albedo, roughness and metallic.
pub fn place() -> (Place, Room) {
    let room = Room { priors: true, ..Room::default() };
    let place = Place::new(room);
    room.write_materials(&place.path("scene"));
    (place, room)
}
