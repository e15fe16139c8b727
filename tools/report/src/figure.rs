//! Images in a page: single, or ground truth and render under a slider.

use crate::text::escape;
use base64::prelude::{BASE64_STANDARD, Engine as _};
use sgs_scene::{Image, Result, encode_jpeg, encode_png, resize};

/// Number of pixels above which images become JPEG.
///
/// As PNG, a dozen photographs would make the page too large for browsers.
const PNG_PIXELS: usize = 1 << 17;

/// JPEG quality.
const QUALITY: u8 = 90;

/// Encodes an image as a data URI: PNG, or JPEG if it is large.
///
/// Values are display-referred, with 1, 3 or 4 channels. A wider image than `width` is reduced by averaging displayed
/// values, which suits viewing but not measuring.
///
/// # Errors
/// If the image is invalid.
pub fn data_uri(image: &Image, width: u32) -> Result<String> {
    let small;
    let shown = if image.width > width.max(1) {
        let height = (u64::from(image.height) * u64::from(width.max(1)) / u64::from(image.width)).max(1);
        small = resize(image, width.max(1), height as u32);
        &small
    } else {
        image
    };
    if shown.pixels() > PNG_PIXELS && (shown.channels == 1 || shown.channels == 3) {
        return Ok(format!("data:image/jpeg;base64,{}", BASE64_STANDARD.encode(encode_jpeg(shown, QUALITY)?)));
    }
    Ok(format!("data:image/png;base64,{}", BASE64_STANDARD.encode(encode_png(shown)?)))
}

/// Returns the HTML of an image above its name, which enlarges on a click.
///
/// `uri` is from [`data_uri`]; `note` is HTML.
pub fn rendered(name: &str, uri: &str, [width, height]: [u32; 2], note: &str) -> String {
    let name = escape(name);
    format!(
        "<figure><img src=\"{uri}\" width=\"{width}\" height=\"{height}\" alt=\"{name}\">{}{}</figure>\n",
        enlarge(&name),
        caption(&name, note)
    )
}

/// Returns the HTML of a slider: ground truth at the left, render at the right.
///
/// `note` is HTML. Without its script the page shows half of each.
pub fn slider(name: &str, truth: &str, render: &str, [width, height]: [u32; 2], note: &str) -> String {
    let name = escape(name);
    format!(
        "<figure><div class=\"slider\"><img src=\"{render}\" width=\"{width}\" height=\"{height}\" alt=\"{name}: render\">\
         <img class=\"over\" src=\"{truth}\" width=\"{width}\" height=\"{height}\" alt=\"{name}: truth\">\
         <span class=\"left\">truth</span><span class=\"right\">render</span>\
         <input type=\"range\" min=\"0\" max=\"100\" step=\"0.1\" value=\"50\" aria-label=\"{name}: truth to the left, render to the right\">\
         </div>{}{}</figure>\n",
        enlarge(&name),
        caption(&name, note)
    )
}

fn caption(name: &str, note: &str) -> String {
    let note = if note.is_empty() { String::new() } else { format!(" <small>{note}</small>") };
    format!("<figcaption>{name}{note}</figcaption>")
}

/// Returns the button that the page's script handles; hidden without the script.
fn enlarge(name: &str) -> String {
    format!("<button type=\"button\" class=\"enlarge\" aria-label=\"Enlarge {name}\">&#x2922;</button>")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_images_are_png_and_large_ones_jpeg() {
        let small = data_uri(&Image::new(8, 4, 3), 640).unwrap();
        assert!(small.starts_with("data:image/png;base64,iVBOR"), "{small}");
        assert!(data_uri(&Image::new(512, 300, 3), 640).unwrap().starts_with("data:image/jpeg;base64,/9j/"));
        assert!(data_uri(&Image::new(512, 300, 3), 100).unwrap().starts_with("data:image/png"));
        assert!(data_uri(&Image::new(512, 300, 4), 640).unwrap().starts_with("data:image/png"));
        assert!(data_uri(&Image::new(0, 0, 3), 640).is_err());
    }

    #[test]
    fn names_are_escaped() {
        for html in [rendered("<b>", "data:,", [1, 1], ""), slider("<b>", "data:,", "data:,", [1, 1], "1 dB")] {
            assert!(
                !html.contains("<b>") && html.contains("&lt;b&gt;") && html.contains("class=\"enlarge\""),
                "{html}"
            );
        }
    }
}
