//! Plot of error over step time as SVG.

use super::front::Standing;
use anyhow::anyhow;
use plotters::prelude::*;

/// Smallest error that is drawn. Smaller errors, such as zero, are drawn here on the logarithmic axis.
const LEAST: f64 = 1e-8;

/// Color of choices that are not ranked.
const GRAY: RGBColor = RGBColor(128, 128, 128);

/// Position and style of a choice in the plot.
#[derive(Clone, Debug)]
pub struct Mark {
    /// Name of the choice.
    pub name: String,
    /// Step time.
    pub time: f64,
    /// Error of the choice.
    pub error: f64,
    /// Standing among all choices.
    pub standing: Standing,
}

/// Draws error over step time as SVG; `what` labels the errors.
///
/// The x axis is step time relative to the first choice, the y axis error in powers of ten. Choices on the front are
/// filled and joined by a line. Equivalent choices are gray crosses.
pub fn svg(points: &[Mark], title: &str, what: &str) -> anyhow::Result<String> {
    let mut out = String::new();
    draw(points, title, what, &mut out).map_err(|e| anyhow!("The drawing failed: {e}"))?;
    Ok(out)
}

fn draw(points: &[Mark], title: &str, what: &str, out: &mut String) -> Result<(), Box<dyn std::error::Error>> {
    let first = points.first().ok_or("there is nothing to draw")?.time;
    let at = |p: &Mark| (p.time / first, p.error.max(LEAST));
    let low = points.iter().map(|p| at(p).0).fold(f64::INFINITY, f64::min) - 0.05;
    let high = points.iter().map(|p| at(p).0).fold(0.0, f64::max) + 0.2;
    let top = points.iter().map(|p| at(p).1).fold(LEAST, f64::max) * 4.0;
    let root = SVGBackend::with_string(out, (960, 600)).into_drawing_area();
    root.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(&root)
        .caption(title, ("sans-serif", 18))
        .margin(16)
        .x_label_area_size(44)
        .y_label_area_size(72)
        .build_cartesian_2d(low..high, (LEAST / 2.0..top).log_scale())?;
    chart
        .configure_mesh()
        .x_desc("time of a training step, of exact; crosses: the same as exact in another way")
        .y_desc(what)
        .y_label_formatter(&|v| format!("{v:.0e}"))
        .light_line_style(WHITE)
        .draw()?;
    let mut front: Vec<(f64, f64)> = points.iter().filter(|p| p.standing == Standing::Front).map(at).collect();
    front.sort_by(|a, b| a.0.total_cmp(&b.0));
    chart.draw_series(LineSeries::new(front, BLUE.mix(0.5).stroke_width(2)))?;
    let mut names: Vec<(i32, i32, i32)> = Vec::new();
    // The upper of two adjacent points gets the upper name.
    let mut from_above: Vec<&Mark> = points.iter().collect();
    from_above.sort_by_key(|p| chart.backend_coord(&at(p)).1);
    let marks: Vec<(i32, i32)> = from_above.iter().map(|p| chart.backend_coord(&at(p))).collect();
    for p in from_above {
        match p.standing {
            Standing::Same => chart.draw_series([Cross::new(at(p), 4, GRAY.stroke_width(1))])?,
            Standing::Front => chart.draw_series([Circle::new(at(p), 5, BLUE.filled())])?,
            _ => chart.draw_series([Circle::new(at(p), 5, BLACK.mix(0.5).stroke_width(1))])?,
        };
        // Names move down until they overlap neither another name nor a mark to their right. A letter is 6 pixels
        // wide, a line 12 high.
        let (x, y) = chart.backend_coord(&at(p));
        let width = 6 * p.name.len() as i32;
        let mut down = -6;
        let on_name =
            |down: i32| names.iter().any(|&(a, b, w)| (b - y - down).abs() < 12 && a < x + width && x < a + w);
        let beside = marks.iter().any(|&(a, b)| (b - y).abs() < 9 && x + 5 < a && a < x + width);
        while on_name(down) || (beside && down < 0) {
            down += 12;
        }
        names.push((x, y + down, width));
        let color = if p.standing == Standing::Same { GRAY } else { BLACK };
        let style = ("sans-serif", 12).into_font().color(&color);
        let name = EmptyElement::at(at(p)) + Text::new(p.name.clone(), (8, down), style);
        chart.draw_series([name])?;
    }
    root.present()?;
    Ok(())
}
