//! Provider output: single messages, whole replies of a process, command lines.

use super::text_of;
use crate::place::Place;
use sgs_provider::{Message, Provider, ProviderImage, ProviderOptions};
use sgs_scene::Image;

/// Decodes a single payload.
pub(crate) fn message(bytes: &[u8]) -> String {
    text_of(Message::decode(bytes), |message| {
        // Decoding drops arrays of unknown types, so that the rest can be encoded again.
        let again = message.encode().and_then(|bytes| Message::decode(&bytes));
        assert_eq!(again.map(|m| m.arrays).ok().as_ref(), Some(&message.arrays), "arrays come back");
        format!("{} {:?}", message.arrays.len().min(3), message.text["kind"].as_str())
    })
}

/// Runs a process that prints these bytes; the first byte selects the request.
pub(crate) fn talk(bytes: &[u8]) -> String {
    let Some((choice, stream)) = bytes.split_first() else { return String::new() };
    let place = Place::of("provider_talk", |_| ());
    let file = place.put("said", stream);
    let options = ProviderOptions {
        command: format!("cat '{}'", file.display()),
        start_seconds: 20.0,
        answer_seconds: 20.0,
        limit: 1 << 20,
        seed: 1,
    };
    let mut provider = match Provider::start(&options) {
        Ok(provider) => provider,
        Err(error) => return error.to_string(),
    };
    let image = Image::new(12, 9, 3);
    let rendered = ProviderImage::srgb(&image);
    let frames = [rendered.clone(), rendered.clone(), rendered.clone()];
    let fits = |image: &Image| image.check().expect("answers have the size of the question");
    let mut words = provider.about().list();
    // Two requests, so that data after the first reply is read.
    for _ in 0..2 {
        words += &match choice % 8 {
            0 => text_of(provider.masks(&frames, Some([3.0, 2.0])), |masks| {
                assert!(masks.frames.iter().all(|f| f.len() == 12 * 9), "masks fit");
                "masks".into()
            }),
            1 => text_of(provider.regions(&rendered), |r| {
                assert_eq!(r.ids.len(), r.size[0] as usize * r.size[1] as usize, "regions fit");
                "regions".into()
            }),
            2 => text_of(provider.normals(&rendered), |n| {
                fits(&n.image);
                "normals".into()
            }),
            3 => text_of(provider.semantics(&rendered), |f| {
                assert_eq!(f.data.len(), f.shape.iter().product::<usize>(), "features fit");
                "features".into()
            }),
            4 => text_of(provider.text(&["wall".into(), "floor".into()]), |(width, all)| {
                assert_eq!(all.len(), 2 * width, "embeddings fit");
                "text".into()
            }),
            5 => text_of(provider.classes(std::slice::from_ref(&rendered)), |names| format!("{}", names.len().min(3))),
            7 => text_of(provider.depth(&rendered), |d| {
                fits(&d.image);
                d.confidence.iter().for_each(fits);
                d.meaning.name().into()
            }),
            _ => text_of(provider.materials(&rendered, &["albedo", "roughness", "metallic"]), |m| {
                [&m.albedo, &m.roughness, &m.metallic].into_iter().flatten().for_each(fits);
                "materials".into()
            }),
        };
    }
    words
}

/// Starts a provider from a command line whose program does not exist.
pub(crate) fn command(bytes: &[u8]) -> String {
    let text = String::from_utf8_lossy(bytes);
    let mut options = ProviderOptions::new(&format!("/none/of/these/{text}"));
    options.start_seconds = 1.0;
    match Provider::start(&options) {
        Ok(_) => panic!("a program was started that does not exist"),
        Err(error) => error.to_string(),
    }
}
