//! Keys and what they do.

use crate::channel::Channel;
use crate::lamps::LampAction;
use winit::keyboard::{Key, NamedKey};

/// What the keys and the mouse do, a line each.
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
[ ]  ; '              hue, saturation of the chosen light
O  Backspace          switch it, reset it
I  Delete             new light, remove it
J K                   environment map darker, brighter
Z                     reset all light
P                     save the image and its camera
E                     save the edit for sgs relight
H  Esc                help, leave";

/// Directions that one walks in while keys are held: the axis, and which way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Walk(pub usize, pub i8);

/// What a key does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Action {
    /// Shows another channel.
    Show(Channel),
    /// The next or previous one.
    Turn(i32),
    /// Stops of exposure more; nothing sets it back.
    Exposure(Option<f32>),
    /// Cameras on; nothing is the first.
    Camera(Option<i32>),
    /// Handles on and off.
    Handles,
    /// Of the chosen light.
    Lamp(LampAction),
    /// A new light.
    Add,
    /// Without the chosen light.
    Remove,
    /// A factor of the surroundings.
    Sky(f32),
    /// All light as it was.
    Reset,
    /// Saves the picture.
    Picture,
    /// Saves the edit.
    Edit,
    /// Shows what keys do.
    Help,
    /// Closes the window.
    Leave,
}

/// What a key that was pressed does.
pub fn action(key: &Key) -> Option<Action> {
    let named = match key {
        Key::Named(named) => match named {
            NamedKey::Home => Action::Camera(None),
            NamedKey::Backspace => Action::Lamp(LampAction::Reset),
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
                '[' => Action::Lamp(LampAction::Hue(-1.0 / 24.0)),
                ']' => Action::Lamp(LampAction::Hue(1.0 / 24.0)),
                ';' => Action::Lamp(LampAction::Saturation(-0.1)),
                '\'' => Action::Lamp(LampAction::Saturation(0.1)),
                'o' => Action::Lamp(LampAction::Switch),
                'i' => Action::Add,
                'j' => Action::Sky(0.8),
                'k' => Action::Sky(1.25),
                'z' => Action::Reset,
                'p' => Action::Picture,
                'e' => Action::Edit,
                'h' | '?' => Action::Help,
                _ => return None,
            }
        }
        _ => return None,
    };
    Some(named)
}

/// Where a key that is held takes one.
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
    fn no_key_does_two_things_and_help_names_all() {
        let key = |letter: char| Key::Character(letter.to_string().into());
        for letter in (' '..='~').filter(|l| !l.is_ascii_uppercase()) {
            let (acts, walks) = (action(&key(letter)), walk(&key(letter)));
            assert!(acts.is_none() || walks.is_none(), "{letter}");
            let shown = letter.to_ascii_uppercase();
            let known = KEYS.contains(shown) || "=_?".contains(letter) || letter.is_ascii_digit();
            assert!(acts.is_none() && walks.is_none() || known, "{letter} is not in the help");
        }
        assert_eq!(action(&key('P')), Some(Action::Picture));
        assert!(KEYS.lines().all(|line| line.is_ascii() && line.len() < 72));
    }
}
