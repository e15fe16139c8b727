//! Comments in PLY files of splats: rendering mode, and the transform from the scene to the file.

use crate::placement::Placement;

/// Word before the rendering mode, as Brush has it.
const MODE: &str = "SplatRenderMode:";
/// Word before the eight numbers of the transform.
const TRANSFORM: &str = "SgsTransform:";

/// Mode of splats for the 2D Mip filter.
const MIP: &str = "mip";

/// Returns the lines of a header.
pub(super) fn lines(antialiased: bool, transform: Option<&Placement>) -> String {
    let mut lines = format!("comment {MODE} {}\n", if antialiased { MIP } else { "default" });
    if let Some(Placement { scale, rotation: [w, x, y, z], translation: [a, b, c] }) = transform {
        lines.push_str(&format!("comment {TRANSFORM} {scale:?} {w:?} {x:?} {y:?} {z:?} {a:?} {b:?} {c:?}\n"));
    }
    lines
}

/// Returns the recorded transform.
pub(super) fn transform(comments: &[String]) -> Result<Option<Placement>, String> {
    let Some(text) = comments.iter().find_map(|line| line.strip_prefix(TRANSFORM)) else { return Ok(None) };
    let numbers: Option<Vec<f64>> = text.split_whitespace().map(|word| word.parse().ok()).collect();
    let Some(&[scale, w, x, y, z, a, b, c]) = numbers.as_deref() else {
        return Err(format!("the comment \"{TRANSFORM}{text}\" needs 8 numbers: scale, rotation, translation"));
    };
    let placement = Placement { scale, rotation: [w, x, y, z], translation: [a, b, c] };
    placement.check().map(|()| Some(placement))
}

fn mode(comments: &[String]) -> Option<&str> {
    comments.iter().find_map(|line| line.strip_prefix(MODE)).map(str::trim)
}

/// Returns whether the splats are for the 2D Mip filter.
pub(super) fn antialiased(comments: &[String]) -> bool {
    mode(comments) == Some(MIP)
}

/// Returns what the comments request and the renderer does not do.
pub(super) fn left_out(comments: &[String]) -> Vec<String> {
    match mode(comments) {
        None | Some("default" | MIP) => Vec::new(),
        Some(other) => vec![format!("the rendering mode \"{other}\"")],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transforms_come_back_bit_for_bit() {
        let placed = Placement { scale: 0.1, rotation: [0.5, -0.5, 0.5, 0.5], translation: [1e-9, 2.0, 1.0 / 3.0] };
        for filter in [false, true] {
            let text = lines(filter, Some(&placed));
            let comments: Vec<String> =
                text.lines().map(|line| line.strip_prefix("comment ").unwrap().to_owned()).collect();
            assert_eq!((transform(&comments), antialiased(&comments)), (Ok(Some(placed)), filter));
            assert!(left_out(&comments).is_empty());
        }
        let read = |line: &str| transform(&[line.to_owned()]);
        assert_eq!(read("made by hand"), Ok(None));
        assert!(read("SgsTransform: 1 2 3").unwrap_err().contains("8 numbers"));
        assert!(read("SgsTransform: 0 1 0 0 0 0 0 0").unwrap_err().contains("scale is 0"));
        assert!(antialiased(&["SplatRenderMode: mip".to_owned()]) && !antialiased(&[]));
        assert_eq!(left_out(&["SplatRenderMode: 2dgs".to_owned()]), ["the rendering mode \"2dgs\""]);
    }
}
