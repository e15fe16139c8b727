//! Keys and their actions.

use crate::channel::Channel;
use crate::lights::LightAction;
use winit::keyboard::{Key, NamedKey};

/// Help text: keys and mouse actions, one line each.
pub const KEYS: &str = "\
drag left             orbit; on a light: move it
drag right            look around
drag middle           move sideways
wheel                 nearer, farther; on a light: dim it
W A S D R F           walk; R up, F down; Shift faster
N B Home              next, previous, first camera
1 to 9                rgb pbr albedo roughness normal
                      depth diffuse specular direct
, .                   previous, next channel
+ - 0                 exposure
L                     handles of lights on and off
Tab                   choose the next light
[ ]  ; '              hue, saturation of the chosen light
O  Backspace          switch it, reset it
I  Delete             new light, remove it
J K                   environment map darker, brighter
Z                     reset all light
P                     save the image and its camera
E                     save the edit for sgs relight
H  Esc                help, leave";

/// Walking direction of a held key: the axis and the sign.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Walk(pub usize, pub i8);

/// Action of a key.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Action {
    /// Shows a channel.
    Show(Channel),
    /// Shows the next or previous channel.
    Turn(i32),
    /// Changes the exposure by stops; `None` resets it.
    Exposure(Option<f32>),
    /// Advances by a number of cameras; `None` selects the first.
    Camera(Option<i32>),
    /// Shows or hides the handles.
    Handles,
    /// Selects the next light.
    Next,
    /// Changes the selected light.
    LightParameters(LightAction),
    /// Adds a light.
    Add,
    /// Removes the selected light.
    Remove,
    /// Multiplies the environment map by a factor.
    Sky(f32),
    /// Resets all light.
    Reset,
    /// Saves the image.
    SaveImage,
    /// Saves the edit.
    Edit,
    /// Shows or hides the help.
    Help,
    /// Closes the window.
    Leave,
}

/// Returns the action of a pressed key.
pub fn action(key: &Key) -> Option<Action> {
    let named = match key {
        Key::Named(named) => match named {
            NamedKey::Home => Action::Camera(None),
            NamedKey::Backspace => Action::LightParameters(LightAction::Reset),
            NamedKey::Tab => Action::Next,
            NamedKey::Delete => Action::Remove,
            NamedKey::F1 => Action::Help,
            NamedKey::Escape => Action::Leave,
            _ => return None,
        },
        Key::Character(text) => {
            let letter = text.chars().next()?.to_ascii_lowercase();
            if let Some(channel) = Channel::numbered(letter) {
                return Some(Action::Show(channel));
            }
            match letter {
                ',' => Action::Turn(-1),
                '.' => Action::Turn(1),
                '+' | '=' => Action::Exposure(Some(0.5)),
                '-' | '_' => Action::Exposure(Some(-0.5)),
                '0' => Action::Exposure(None),
                'n' => Action::Camera(Some(1)),
                'b' => Action::Camera(Some(-1)),
                'l' => Action::Handles,
                '[' => Action::LightParameters(LightAction::Hue(-1.0 / 24.0)),
                ']' => Action::LightParameters(LightAction::Hue(1.0 / 24.0)),
                ';' => Action::LightParameters(LightAction::Saturation(-0.1)),
                '\'' => Action::LightParameters(LightAction::Saturation(0.1)),
                'o' => Action::LightParameters(LightAction::Switch),
                'i' => Action::Add,
                'j' => Action::Sky(0.8),
                'k' => Action::Sky(1.25),
                'z' => Action::Reset,
                'p' => Action::SaveImage,
                'e' => Action::Edit,
                'h' | '?' => Action::Help,
                _ => return None,
            }
        }
        _ => return None,
    };
    Some(named)
}

/// Returns the walking direction of a held key.
pub fn walk(key: &Key) -> Option<Walk> {
    let Key::Character(text) = key else { return None };
    Some(match text.chars().next()?.to_ascii_lowercase() {
        'w' => Walk(2, 1),
        's' => Walk(2, -1),
        'd' => Walk(0, 1),
        'a' => Walk(0, -1),
        'f' => Walk(1, 1),
        'r' => Walk(1, -1),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_unique_and_listed_in_the_help() {
        let key = |letter: char| Key::Character(letter.to_string().into());
        for letter in (' '..='~').filter(|l| !l.is_ascii_uppercase()) {
            let (acts, walks) = (action(&key(letter)), walk(&key(letter)));
            assert!(acts.is_none() || walks.is_none(), "{letter}");
            let shown = letter.to_ascii_uppercase();
            let known = KEYS.contains(shown) || "=_?".contains(letter) || letter.is_ascii_digit();
            assert!(acts.is_none() && walks.is_none() || known, "{letter} is not in the help");
        }
        assert_eq!(action(&key('P')), Some(Action::SaveImage));
        assert!(KEYS.lines().all(|line| line.is_ascii() && line.len() < 72));
    }
}
