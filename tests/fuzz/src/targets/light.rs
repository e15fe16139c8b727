//! Lights, environment maps and edits of them.

use super::text_of;
use crate::place::Place;
use crate::seeds;
use sgs_relight::{Edit, fuzzed};
use sgs_run::{
    KnownEmitters, LightFile, LightList, MOST_KNOWN, read_emitters, read_exchange, read_light, read_light_list,
    read_lights, write_emitters, write_light_list,
};
use sgs_scene::read_environment;

/// Checks the invariants of all lights that are read.
fn sound(lights: &LightFile) -> String {
    let (model, positions, lobes, gains) = lights.raw();
    assert_eq!((positions.len(), gains.len()), (3 * model.lights as usize, model.lights as usize), "lights fit");
    assert!(lobes.iter().chain(&positions).chain(&gains).all(|v| v.is_finite()), "lights are finite");
    format!("{} lights of {} lobes", model.lights.min(4), model.lobes.min(4))
}

/// Returns the lights in the published model, or why it does not shade them.
fn published(list: &LightList) -> String {
    list.published().map_or_else(|reason| reason.chars().take(20).collect(), |lights| sound(&lights))
}

/// Reads lights and writes them again.
pub(crate) fn lights(bytes: &[u8]) -> String {
    let place = Place::of("lights", |_| ());
    text_of(read_light_list(&place.put("lights.json", bytes)), |list| {
        let again = place.path("again.json");
        let back = write_light_list(&again, &list).and_then(|()| read_light_list(&again));
        assert_eq!(back.as_ref().ok(), Some(&list), "lights come back");
        format!("{} {}", published(&list), list.format())
    })
}

/// Reads emitters of a run and of a scene. Writes those of a run again.
pub(crate) fn emitters(bytes: &[u8]) -> String {
    let place = Place::of("emitters", |_| ());
    let path = place.put("emitters.json", bytes);
    let known = text_of(KnownEmitters::read(&path), |known| {
        let count = known.emitters.len();
        assert!((1..=MOST_KNOWN).contains(&count) && known.emitters.iter().all(|e| e.on && e.light().check().is_ok()));
        format!("{} known emitters", count.min(4))
    });
    let of_run = text_of(read_emitters(&path), |file| {
        let lights = file.lights();
        assert!(lights.iter().all(|l| l.check().is_ok()), "lights are valid");
        let again = place.path("again.json");
        let back = write_emitters(&again, &file).and_then(|()| read_emitters(&again));
        assert_eq!(back.ok(), Some(file), "emitters come back");
        format!("{} emitters", lights.len().min(4))
    });
    format!("{of_run}; {known}")
}

/// Reads lights next to a PLY file.
pub(crate) fn lights_beside(bytes: &[u8]) -> String {
    let place = Place::of("lights_beside", |place| {
        place.put("scene.ply", seeds::SPLATS_ASCII.as_bytes());
    });
    place.put("scene.lights.json", bytes);
    let path = place.path("scene.ply");
    let all = text_of(read_exchange(&path), |e| e.lights.as_ref().map_or_else(String::new, published));
    all + &text_of(read_light(&path, 16), |light| format!("{}", light.lights.is_some()))
}

pub(crate) fn environment(bytes: &[u8]) -> String {
    let place = Place::of("environment", |place| {
        place.put("scene.ply", seeds::SPLATS_ASCII.as_bytes());
    });
    let path = place.put("scene.environment.exr", bytes);
    let words = text_of(read_environment(&path), |image| {
        assert!(
            image.check().is_ok() && image.data.iter().all(|v| v.is_finite() && *v >= 0.0),
            "light is no less than none"
        );
        format!("{}", image.width.min(9))
    });
    words
        + &text_of(read_light(&place.path("scene.ply"), 16), |light| {
            let texels = light.environment.map_or_else(Vec::new, |e| e.data);
            assert!(texels.iter().all(|v| v.is_finite()), "the environment map is finite");
            format!("{}", texels.len())
        })
}

/// Reads an edit as a file and as text, and applies it to three lights.
pub(crate) fn edit(bytes: &[u8]) -> String {
    let place = Place::of("edit", |place| {
        place.put("lights.json", seeds::LIGHTS.as_bytes());
        place.put("sky.exr", &seeds::exr_sky());
    });
    let file = text_of(Edit::read(&place.put("edit.json", bytes)), |edit| {
        let lights = read_lights(&place.path("lights.json")).expect("the lights are whole");
        text_of(fuzzed::edited_light(&edit, lights), |(lights, texels)| {
            let lights = lights.as_ref().map_or_else(String::new, sound);
            format!("{lights} {}", texels.is_some())
        })
    });
    let text = String::from_utf8_lossy(bytes);
    file + &text_of(Edit::parse(&text, &place.path("")), |edit| format!("{}", edit.insert.len().min(3)))
}

pub(crate) fn true_lights(bytes: &[u8]) -> String {
    let place = Place::of("true_lights", |_| ());
    text_of(fuzzed::true_lights(&place.put("lights.json", bytes)), |lights| {
        lights.as_ref().map_or_else(String::new, sound)
    })
}

pub(crate) fn true_edit(bytes: &[u8]) -> String {
    let place = Place::of("true_edit", |_| ());
    text_of(fuzzed::true_edit(&place.put("day.json", bytes)), |known| format!("{known}"))
}
