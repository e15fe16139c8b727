//! Masks of valid pixels in training: inverted masks train to the same bits as ordinary ones.

use sgs_scene::{Image, write_png};
use sgs_tests::Place;
use sgs_tests::cli::sgs;
use sgs_tests::rooms::Room;

/// Returns a mask with every gray: white in a disk that differs between views, black outside, soft between.
fn mask(view: usize, [width, height]: [u32; 2]) -> Image {
    let mut mask = Image::new(width, height, 1);
    let (x0, y0) = (0.3 + 0.05 * view as f32, 0.5);
    for y in 0..height {
        for x in 0..width {
            let at = [x as f32 / width as f32 - x0, y as f32 / height as f32 - y0];
            // Whole steps of 8 bits, which an inverted file holds exactly.
            let gray = (255.0 * (6.0 * (0.45 - at[0].hypot(at[1]))).clamp(0.0, 1.0)).round();
            mask.pixel_mut(x, y)[0] = gray / 255.0;
        }
    }
    mask
}

#[test]
fn inverted_masks_train_to_the_same_bits() {
    let room = Room::default();
    let place = Place::new(room);
    let write = |change: fn(f32) -> f32| {
        std::fs::create_dir_all(place.path("scene/masks")).unwrap();
        for view in 0..room.views {
            let mut mask = mask(view, room.size);
            mask.data.iter_mut().for_each(|v| *v = change(*v));
            write_png(&place.path(&format!("scene/masks/{view:03}.png")), &mask).unwrap();
        }
    };
    let train = |run: &str, masks: &str| {
        sgs(&place.arguments(run, 24, &["--seed", "3", "--set", masks])).ok();
        let measures = place.text(&format!("{run}.json"));
        sgs(&["eval", &place.text(run), "--json", &measures]).ok();
        let measures: serde_json::Value = serde_json::from_slice(&std::fs::read(&measures).unwrap()).unwrap();
        measures["mean"]["nvs"].clone()
    };
    write(|v| v);
    let ordinary = train("ordinary", "masks=true");
    train("ignored", "masks=false");
    write(|v| 1.0 - v);
    let inverted = train("inverted", "masks=\"inverted\"");
    train("wrong", "masks=true");
    place.assert_same("ordinary", "inverted");
    assert_eq!(ordinary["psnr"], inverted["psnr"]);
    assert!(ordinary["psnr"].is_number(), "{ordinary}");
    // The masks matter, and so does their sense.
    for other in ["ignored", "wrong"] {
        assert!(place.read("ordinary/scene.ply") != place.read(&format!("{other}/scene.ply")), "{other}");
    }
}
