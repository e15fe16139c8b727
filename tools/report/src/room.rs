//! Drawing of the scene from above and from the side: Gaussians, cameras and lights.

use crate::text::escape;
use glam::DVec3;

/// Maximum number of points drawn.
const POINTS: usize = 4000;
/// Longest side of a drawing, in SVG units.
const LONGEST: f64 = 420.0;
const MARGIN: f64 = 14.0;

/// Camera in the drawing.
#[derive(Clone, Debug)]
pub struct Eye {
    /// Position in the world.
    pub position: DVec3,
    /// Viewing direction, a unit vector.
    pub forward: DVec3,
    /// Up direction, opposite to increasing rows of its images.
    pub up: DVec3,
}

/// Light in the drawing.
#[derive(Clone, Debug)]
pub struct LightMark {
    /// Displayed name.
    pub name: String,
    /// Position in the world.
    pub position: DVec3,
    /// Fraction of the light of all lights, 0 to 1.
    pub share: f64,
    /// CSS color.
    pub color: String,
}

/// Draws plan and elevation; returns an empty string without cameras and lights.
///
/// Points are subsampled. Outliers are left out.
pub fn drawing(points: &[[f32; 3]], eyes: &[Eye], lights: &[LightMark]) -> String {
    if eyes.is_empty() && lights.is_empty() {
        return String::new();
    }
    let [right, front, up] = axes(eyes);
    let every = points.len().div_ceil(POINTS).max(1);
    let shown: Vec<DVec3> =
        points.iter().step_by(every).map(|p| DVec3::from(p.map(f64::from))).filter(|p| p.is_finite()).collect();
    let views = [("from above", right, front), ("from the side", right, up)];
    let figures = views.map(|(name, x, y)| {
        format!("<figure>{}<figcaption>{name}</figcaption></figure>\n", svg(name, &shown, eyes, lights, x, y))
    });
    format!("<div class=\"grid large\">\n{}</div>\n", figures.concat())
}

/// Returns the right, front and up axes.
///
/// Up is the mean up direction of the cameras, snapped to a world axis if close.
fn axes(eyes: &[Eye]) -> [DVec3; 3] {
    let sum: DVec3 = eyes.iter().map(|e| e.up).sum();
    let mean = sum.try_normalize().unwrap_or(DVec3::Z);
    let snap = |v: DVec3| {
        let all = [DVec3::X, DVec3::Y, DVec3::Z].map(|a| if a.dot(v) < 0.0 { -a } else { a });
        all.into_iter().find(|a| a.dot(v) > 0.8).unwrap_or(v)
    };
    let up = snap(mean);
    let start = [DVec3::X, DVec3::Y].into_iter().find(|a| a.dot(up).abs() < 0.8).unwrap_or(DVec3::X);
    let right = (start - up * start.dot(up)).normalize_or(DVec3::X);
    [right, up.cross(right), up]
}

fn svg(name: &str, points: &[DVec3], eyes: &[Eye], lights: &[LightMark], x: DVec3, y: DVec3) -> String {
    let flat = |p: DVec3| [p.dot(x), p.dot(y)];
    let mut bounds = [[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]];
    let mut hold = |p: [f64; 2]| {
        for k in 0..2 {
            bounds[0][k] = bounds[0][k].min(p[k]);
            bounds[1][k] = bounds[1][k].max(p[k]);
        }
    };
    eyes.iter().map(|e| e.position).chain(lights.iter().map(|l| l.position)).for_each(|p| hold(flat(p)));
    // Outlier Gaussians would shrink the scene to a dot.
    for k in 0..2 {
        let mut along: Vec<f64> = points.iter().map(|p| flat(*p)[k]).collect();
        along.sort_by(f64::total_cmp);
        if let (Some(low), Some(high)) =
            (along.get(along.len() / 50), along.get((along.len() * 49 / 50).min(along.len().saturating_sub(1))))
        {
            bounds[0][k] = bounds[0][k].min(*low);
            bounds[1][k] = bounds[1][k].max(*high);
        }
    }
    let [low, high] = bounds;
    let extent = (high[0] - low[0]).max(high[1] - low[1]).max(1e-9);
    let unit = LONGEST / extent;
    let at = |p: [f64; 2]| [MARGIN + (p[0] - low[0]) * unit, MARGIN + (high[1] - p[1]) * unit];
    let [w, h] = [(high[0] - low[0]) * unit + 2.0 * MARGIN, (high[1] - low[1]) * unit + 2.0 * MARGIN];
    let mut out = format!("<svg viewBox=\"0 0 {w:.0} {h:.0}\" role=\"img\" aria-label=\"the room {name}\">");
    let mut dots = String::new();
    for p in points {
        let [u, v] = at(flat(*p));
        if (0.0..w).contains(&u) && (0.0..h).contains(&v) {
            dots.push_str(&format!("M{u:.0} {v:.0}h1"));
        }
    }
    out.push_str(&format!("<path d=\"{dots}\" stroke=\"var(--faint)\" opacity=\"0.45\"/>"));
    for eye in eyes {
        let [u, v] = at(flat(eye.position));
        let [a, b] = [eye.forward.dot(x) * 11.0, -eye.forward.dot(y) * 11.0];
        out.push_str(&format!(
            "<path d=\"M{u:.1} {v:.1}l{a:.1} {b:.1}\" stroke=\"var(--mark2)\" stroke-width=\"1.5\"/>\
             <circle cx=\"{u:.1}\" cy=\"{v:.1}\" r=\"2.5\" fill=\"var(--mark2)\"/>"
        ));
    }
    for light in lights.iter().rev() {
        let [u, v] = at(flat(light.position));
        let r = 3.0 + 14.0 * light.share.clamp(0.0, 1.0).sqrt();
        out.push_str(&format!(
            "<circle class=\"light\" cx=\"{u:.1}\" cy=\"{v:.1}\" r=\"{r:.1}\" fill=\"{}\" stroke=\"var(--text)\"><title>{}: {:.1} %</title>\
             </circle>",
            escape(&light.color),
            escape(&light.name),
            100.0 * light.share
        ));
        if light.share >= 0.03 {
            out.push_str(&format!(
                "<text x=\"{:.1}\" y=\"{:.1}\">{}</text>",
                u + r + 2.0,
                v + 3.0,
                escape(&light.name)
            ));
        }
    }
    out.push_str("</svg>");
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn eye(x: f64) -> Eye {
        Eye { position: DVec3::new(x, 0.0, 1.5), forward: DVec3::Y, up: DVec3::new(0.0, 0.3, 0.95).normalize() }
    }

    #[test]
    fn up_axis_follows_the_cameras() {
        let [right, front, up] = axes(&[eye(0.0), eye(1.0)]);
        assert_eq!((right, front, up), (DVec3::X, DVec3::Y, DVec3::Z));
        let upside_down = Eye { up: DVec3::NEG_Y, ..eye(0.0) };
        assert_eq!(axes(&[upside_down])[2], DVec3::NEG_Y);
        assert_eq!(axes(&[])[2], DVec3::Z);
    }

    #[test]
    fn lights_are_drawn_at_their_positions() {
        let light = |name: &str, p: [f64; 3], share| LightMark {
            name: name.into(),
            position: p.into(),
            share,
            color: "#fff".into(),
        };
        let html = drawing(
            &[[f32::NAN, 0.0, 0.0]],
            &[],
            &[light("<0>", [0.0, 0.0, 0.0], 0.5), light("1", [2.0, 1.0, 4.0], 0.01)],
        );
        // Width is twice the depth from above; height is twice the width from the side.
        assert!(html.contains("viewBox=\"0 0 448 238\"") && html.contains("viewBox=\"0 0 238 448\""), "{html}");
        assert!(html.contains("cx=\"14.0\" cy=\"224.0\"") && html.contains("cx=\"434.0\" cy=\"14.0\""), "{html}");
        assert!(html.contains("&lt;0&gt;") && !html.contains("<0>") && !html.contains("NaN"));
        assert_eq!(drawing(&[[0.0; 3]], &[], &[]), "");
    }
}
