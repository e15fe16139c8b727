//! Table of buffers: kind, size, offset, lifetime, and users.

use std::fmt::{self, Write};

use super::{Page, Text, bytes, hue};
use crate::graph::resource::BufferKind;
use crate::shader::Access;

/// Writes the table.
pub(super) fn write(page: &Page<'_>, out: &mut String) -> fmt::Result {
    let plan = page.plan;
    let columns = (plan.groups.len() + 1).max(1) as f64;
    writeln!(
        out,
        "<section id=\"buffers\"><h2>buffers</h2><table><thead><tr><th>name</th><th>kind</th><th>size</th>\
         <th>offset</th><th class=\"wide\">alive in groups 0 to {}</th><th>read by</th><th>written by</th></tr></thead>\
         <tbody>",
        plan.groups.len().saturating_sub(1)
    )?;
    for (index, info) in plan.buffers.iter().enumerate() {
        let name = Text(&info.name);
        let kind = match info.kind {
            BufferKind::External if !info.keep => "input",
            BufferKind::External => "external",
            BufferKind::Transient if info.keep => "kept transient",
            BufferKind::Transient => "transient",
            BufferKind::Uniform => "uniform",
        };
        let kind = match &info.image {
            Some(image) => format!("{kind} image {}x{} {}", image.size[0], image.size[1], image.format),
            None => kind.to_owned(),
        };
        let mut strip = String::new();
        if let Some((first, last)) = page.lifetimes[index].or(page.used[index]) {
            let (from, to) = (100.0 * first as f64 / columns, 100.0 * (last + 1) as f64 / columns);
            let class = if page.lifetimes[index].is_some() { "" } else { " class=\"bound\"" };
            strip = format!(
                "<i{class} style=\"left:{from:.2}%;width:{:.2}%\" title=\"groups {first} to {last}\"></i>",
                (to.min(100.0) - from).max(0.4)
            );
        }
        let by = |matches_access: &dyn Fn(Access) -> bool| {
            let passes = plan.groups.iter().flat_map(|group| &group.passes);
            passes
                .filter(|&&pass| {
                    plan.passes[pass].accesses.iter().any(|a| a.0.buffer.index() == index && matches_access(a.1))
                })
                .count()
        };
        let place = plan.placements[index].map_or_else(String::new, |place| match info.image {
            Some(_) => format!("slot {place}"),
            None => place.to_string(),
        });
        writeln!(
            out,
            "<tr id=\"b{index}\" data-buffer=\"{index}\" data-find=\"{name} {kind}\" style=\"--hue:{}\"><th>{name}</th>\
             <td>{kind}</td><td title=\"{} bytes\">{}</td><td>{place}</td><td class=\"strip\">{strip}</td><td>{}</td>\
             <td>{}</td></tr>",
            hue(index),
            info.bytes,
            bytes(info.bytes),
            by(&|access| access != Access::Write),
            by(&|access| access != Access::Read),
        )?;
    }
    writeln!(out, "</tbody></table></section>")
}
