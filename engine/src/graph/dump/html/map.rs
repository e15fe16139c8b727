//! Map of passes: one line per pass, an arc per dependency, a bar for measured time.

use std::fmt::{self, Write};

use super::{Page, Text, duration, list};

/// Height of a line in pixels.
const LINE: usize = 20;
/// Width of the arc area in pixels.
const GUTTER: usize = 92;

/// Writes the map.
pub(super) fn write(page: &Page<'_>, out: &mut String) -> fmt::Result {
    let plan = page.plan;
    let mut line_of = vec![None; plan.passes.len()];
    for (line, &pass) in plan.groups.iter().flat_map(|group| &group.passes).enumerate() {
        line_of[pass] = Some(line);
    }
    let longest = page.longest();
    let height = LINE * page.running();
    writeln!(out, "<nav id=\"map\" aria-label=\"passes\"><h2>passes</h2><div class=\"lines\">")?;
    writeln!(out, "<svg class=\"arcs\" width=\"{GUTTER}\" height=\"{height}\" aria-hidden=\"true\">")?;
    for (pass, dependencies) in page.dependencies.iter().enumerate() {
        let Some(to) = line_of[pass] else { continue };
        for &before in dependencies {
            let Some(from) = line_of[before as usize] else { continue };
            let middle = |line: usize| LINE * line + LINE / 2;
            // Longer dependencies get wider arcs, clamped to the gutter.
            let span = to.abs_diff(from) as f64;
            let reach = (GUTTER as f64 - 4.0) * (1.0 - (-span / 9.0).exp()).max(0.12);
            let (x, y0, y1) = (GUTTER as f64, middle(from), middle(to));
            let bend = x - 4.0 / 3.0 * reach;
            writeln!(
                out,
                "<path data-from=\"{before}\" data-to=\"{pass}\" d=\"M{x} {y0}C{bend:.1} {y0} {bend:.1} {y1} {x} {y1}\"/>"
            )?;
        }
    }
    writeln!(out, "</svg><ol>")?;
    for (at, group) in plan.groups.iter().enumerate() {
        for (index, &pass) in group.passes.iter().enumerate() {
            let name = Text(&plan.passes[pass].name);
            let mut style = String::new();
            let mut time = String::new();
            if let Some(nanoseconds) = page.times[pass] {
                let percent = 100.0 * nanoseconds / longest.max(1.0);
                style = format!(" style=\"--time:{percent:.1}%\"");
                time = format!("<i>{}</i>", duration(nanoseconds));
            }
            let edge = match (index, &group.barrier) {
                (0, Some(_)) => "first barred",
                (0, None) => "first",
                _ => "",
            };
            writeln!(
                out,
                "<li class=\"{edge}\" data-pass=\"{pass}\" data-find=\"{name}\"{style}><a href=\"#p{pass}\" \
                 data-in=\"{}\" data-out=\"{}\"><span>{name}</span>{time}<b>{at}</b></a></li>",
                list(&page.dependencies[pass]),
                list(&page.dependents[pass]),
            )?;
        }
    }
    writeln!(
        out,
        "</ol></div><p class=\"legend\">Hover over a pass: <em class=\"in\">its dependencies</em>, \
         <em class=\"out\">its dependents</em>. A line stands for a barrier; the number is the group.</p></nav>"
    )
}
