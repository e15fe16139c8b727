//! Files of tensors: training state of runs, and weights of metrics.

use super::text_of;
use crate::place::Place;
use sgs_evaluate::metrics::{Lpips, LpipsRange};
use sgs_run::{SemanticHead, VisibilityFile};
use sgs_train::fuzzed;

pub(crate) fn head(bytes: &[u8]) -> String {
    let place = Place::of("head", |_| ());
    text_of(SemanticHead::load(&place.put("semantics.safetensors", bytes)), |head| {
        let first = head.text.labels[0].clone();
        assert_eq!(head.class(&first).ok(), Some(0), "classes have names");
        let peak = head.peak(0);
        assert!(peak.is_nan() || (0.0..=1.0).contains(&peak), "the probability is {peak}");
        let again = place.path("again.safetensors");
        let back = head.save(&again).and_then(|()| SemanticHead::load(&again));
        assert_eq!(back.map(|h| h.text.labels).ok(), Some(head.text.labels.clone()), "a head comes back");
        text_of(head.class("flor"), |class| format!("{}", class.min(3)))
    })
}

pub(crate) fn visibility(bytes: &[u8]) -> String {
    let place = Place::of("visibility", |_| ());
    text_of(VisibilityFile::load(&place.put("visibility.safetensors", bytes)), |field| {
        let again = place.path("again.safetensors");
        let back = field.save(&again).and_then(|()| VisibilityFile::load(&again));
        assert_eq!(back.ok(), Some(field), "a field comes back");
        "read".into()
    })
}

pub(crate) fn lpips(bytes: &[u8]) -> String {
    let place = Place::of("lpips", |_| ());
    text_of(Lpips::load(&place.put("lpips.safetensors", bytes), LpipsRange::Plain), |_| "read".into())
}

/// Reads the state of a training, without the steps that need a device.
pub(crate) fn checkpoint(bytes: &[u8]) -> String {
    let place = Place::of("checkpoint", |_| ());
    let path = place.put("geometry.safetensors", bytes);
    let words = |degree, semantics, any| text_of(fuzzed::checkpoint(&path, degree, semantics, any), |text| text);
    words(0, false, false) + &words(0, false, true) + &words(1, true, false)
}

/// Reads a fitted room.
pub(crate) fn transport_checkpoint(bytes: &[u8]) -> String {
    let place = Place::of("transport_checkpoint", |_| ());
    text_of(fuzzed::transport_checkpoint(&place.put("transport.safetensors", bytes)), |text| text)
}

/// Reads the state of intrinsic training, without the steps that need a device.
pub(crate) fn intrinsic_checkpoint(bytes: &[u8]) -> String {
    let place = Place::of("intrinsic_checkpoint", |_| ());
    text_of(fuzzed::intrinsic_checkpoint(&place.put("intrinsic.safetensors", bytes)), |text| text)
}
