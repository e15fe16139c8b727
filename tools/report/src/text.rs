//! Text in HTML: escaping and numbers.

/// Escapes text for HTML elements and quoted attributes.
pub fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            // HTML has no control characters; browsers would show a box.
            c if c.is_control() && c != '\n' && c != '\t' => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out
}

/// Formats a number with four significant digits.
///
/// Integers below 1e7 are written in full. Other values outside 1e-4 to 1e6 use scientific notation with two decimals.
pub fn number(v: f64) -> String {
    let a = v.abs();
    if !v.is_finite() {
        return if v.is_nan() { "–".into() } else { "∞".into() };
    }
    match a {
        _ if a == 0.0 => "0".into(),
        _ if v.fract() == 0.0 && a < 1e7 => format!("{v:.0}"),
        _ if !(1e-4..1e6).contains(&a) => format!("{v:.2e}"),
        _ => {
            let digits = (3 - a.log10().floor() as i32).clamp(0, 7) as usize;
            let text = format!("{v:.digits$}");
            if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').into() } else { text }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn escaped_text_contains_no_markup() {
        assert_eq!(
            escape("<img src=\"x\" onerror='a()'>&\u{0}"),
            "&lt;img src=&quot;x&quot; onerror=&#39;a()&#39;&gt;&amp;\u{fffd}"
        );
    }

    #[test]
    fn numbers_have_four_significant_digits() {
        for (v, text) in [
            (0.0, "0"),
            (31.876_639, "31.88"),
            (0.960_866, "0.9609"),
            (0.003_771_1, "0.003771"),
            (11385.0, "11385"),
            (172_525_736.0, "1.73e8"),
            (12345.678, "12346"),
            (-0.5, "-0.5"),
            (f64::INFINITY, "∞"),
            (f64::NAN, "–"),
        ] {
            assert_eq!(number(v), text);
        }
    }
}
