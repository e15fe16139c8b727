//! Channels of a scene: the names of `sgs render` and the keys that select them.

use sgs_passes::pipeline::LitLayer;
use sgs_passes::splat::{Layer, ShownKind};

/// Channel of a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[allow(missing_docs)] // Named as in `sgs render`.
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

/// Kind of view that draws a channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Drawn {
    Blended(Layer),
    Lit(LitLayer),
}

impl Channel {
    /// All channels. The first nine have keys, 1 to 9.
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

    /// Returns the name.
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

    /// Returns the channel of a name.
    pub fn named(name: &str) -> Option<Channel> {
        Channel::ALL.into_iter().find(|c| c.name() == name)
    }

    /// Returns the channel of a digit key.
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

    /// Returns true if lights affect the channel, so that handles are useful.
    pub(crate) fn shows_lights(self) -> bool {
        matches!(self, Channel::Pbr | Channel::Diffuse | Channel::Specular | Channel::Direct | Channel::Visibility)
    }

    /// Returns true if exposure applies. Bounded quantities have none.
    pub(crate) fn has_exposure(self) -> bool {
        matches!(self, Channel::Rgb | Channel::Depth) || (self.kind() == ShownKind::Linear && self != Channel::Albedo)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digits_and_names_select_channels() {
        assert_eq!([Channel::numbered('1'), Channel::numbered('9')], [Some(Channel::Rgb), Some(Channel::Direct)]);
        assert_eq!([Channel::numbered('0'), Channel::numbered('x')], [None; 2]);
        for channel in Channel::ALL {
            assert_eq!(Channel::named(channel.name()), Some(channel));
        }
        assert_eq!(Channel::named("color"), None);
    }
}
