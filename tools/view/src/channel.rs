//! What of a scene is shown: the names of `sgs render`, and the keys that choose them.

use sgs_passes::pipeline::LitLayer;
use sgs_passes::splat::{Layer, ShownKind};

/// A channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[allow(missing_docs)] // They are named as `sgs render` names them.
pub enum Channel {
    Rgb,
    Pbr,
    Albedo,
    Roughness,
    Normal,
    Depth,
    Diffuse,
    Specular,
    Direct,
    Env,
    Metallic,
    Visibility,
    Alpha,
}

/// Which kind of view draws a channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Drawn {
    Blended(Layer),
    Lit(LitLayer),
}

impl Channel {
    /// All of them. The first nine have keys, 1 to 9.
    pub const ALL: [Channel; 13] = [
        Channel::Rgb,
        Channel::Pbr,
        Channel::Albedo,
        Channel::Roughness,
        Channel::Normal,
        Channel::Depth,
        Channel::Diffuse,
        Channel::Specular,
        Channel::Direct,
        Channel::Env,
        Channel::Metallic,
        Channel::Visibility,
        Channel::Alpha,
    ];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Channel::Rgb => "rgb",
            Channel::Pbr => "pbr",
            Channel::Albedo => "albedo",
            Channel::Roughness => "roughness",
            Channel::Normal => "normal",
            Channel::Depth => "depth",
            Channel::Diffuse => "diffuse",
            Channel::Specular => "specular",
            Channel::Direct => "direct",
            Channel::Env => "env",
            Channel::Metallic => "metallic",
            Channel::Visibility => "visibility",
            Channel::Alpha => "alpha",
        }
    }

    /// By its name.
    pub fn named(name: &str) -> Option<Channel> {
        Channel::ALL.into_iter().find(|c| c.name() == name)
    }

    /// By a digit.
    pub(crate) fn numbered(digit: char) -> Option<Channel> {
        let digit = digit.to_digit(10)? as usize;
        Channel::ALL[..9].get(digit.checked_sub(1)?).copied()
    }

    pub(crate) fn drawn(self) -> Drawn {
        match self {
            Channel::Rgb => Drawn::Blended(Layer::Color),
            Channel::Normal => Drawn::Blended(Layer::Normal),
            Channel::Depth => Drawn::Blended(Layer::Depth),
            Channel::Alpha => Drawn::Blended(Layer::Alpha),
            Channel::Pbr => Drawn::Lit(LitLayer::Shaded),
            Channel::Albedo => Drawn::Lit(LitLayer::Albedo),
            Channel::Roughness => Drawn::Lit(LitLayer::Roughness),
            Channel::Metallic => Drawn::Lit(LitLayer::Metallic),
            Channel::Diffuse => Drawn::Lit(LitLayer::Diffuse),
            Channel::Specular => Drawn::Lit(LitLayer::Specular),
            Channel::Visibility => Drawn::Lit(LitLayer::Visibility),
            Channel::Env => Drawn::Lit(LitLayer::Environment),
            Channel::Direct => Drawn::Lit(LitLayer::Direct),
        }
    }

    pub(crate) fn kind(self) -> ShownKind {
        match self.drawn() {
            Drawn::Blended(Layer::Color) => ShownKind::Encoded,
            Drawn::Blended(Layer::Normal) => ShownKind::Directions,
            Drawn::Blended(_) => ShownKind::Values,
            Drawn::Lit(layer) if layer.is_value() => ShownKind::Values,
            Drawn::Lit(_) => ShownKind::Linear,
        }
    }

    /// Whether lamps show in it, so that handles make sense.
    pub(crate) fn shows_lamps(self) -> bool {
        matches!(self, Channel::Pbr | Channel::Diffuse | Channel::Specular | Channel::Direct | Channel::Visibility)
    }

    /// Whether exposure means anything: not for what is a quantity with an end.
    pub(crate) fn has_exposure(self) -> bool {
        matches!(self, Channel::Rgb | Channel::Depth) || (self.kind() == ShownKind::Linear && self != Channel::Albedo)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digits_and_names_lead_to_channels() {
        assert_eq!([Channel::numbered('1'), Channel::numbered('9')], [Some(Channel::Rgb), Some(Channel::Direct)]);
        assert_eq!([Channel::numbered('0'), Channel::numbered('x')], [None; 2]);
        for channel in Channel::ALL {
            assert_eq!(Channel::named(channel.name()), Some(channel));
        }
        assert_eq!(Channel::named("color"), None);
    }
}
