//! Search for the parameter that is farthest from its usual range. Runs on parameters that are read back after
//! divergence.

use crate::error::TrainError;

/// Group of parameters, with their usual range.
pub(crate) struct Group<'a> {
    /// Name of the group.
    pub name: &'a str,
    /// Pass that updates the group.
    pub pass: &'static str,
    /// Values, element after element.
    pub values: &'a [f32],
    /// Scalars per element.
    pub width: usize,
    /// Noun for an element.
    pub element: &'static str,
    /// Center of the usual range. The median of the values if it is not known.
    pub middle: Option<f32>,
    /// Usual distance from the center, at most.
    pub reach: f32,
}

/// Parameter that is farthest out of its range.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Worst {
    text: String,
    out: f64,
}

impl std::fmt::Display for Worst {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.text)
    }
}

/// Makes the error of a training that has diverged. Names the parameter that is farthest out of its range.
pub(crate) fn diverged(step: u32, reason: &str, groups: &[Group<'_>]) -> TrainError {
    let found = worst(groups).map_or_else(String::new, |w| format!("; farthest out is {w}"));
    TrainError::diverged(step, format!("it has diverged: {reason}{found}"))
}

/// Finds the parameter that is farthest out of its range. A NaN is farther out than any number.
fn worst(groups: &[Group<'_>]) -> Option<Worst> {
    let mut found: Option<Worst> = None;
    for g in groups {
        let middles: Vec<f32> = match g.middle {
            Some(m) => vec![m; g.width],
            None => (0..g.width).map(|c| median(g.values.iter().skip(c).step_by(g.width.max(1)))).collect(),
        };
        let away = |(i, v): (usize, &f32)| {
            let out = (f64::from(*v) - f64::from(middles[i % g.width])).abs() / f64::from(g.reach.max(1e-30));
            (if out.is_nan() { f64::INFINITY } else { out }, i)
        };
        let farthest = g.values.iter().enumerate().map(away).reduce(|a, b| if b.0 > a.0 { b } else { a });
        if let Some((out, i)) = farthest.filter(|(out, _)| found.as_ref().is_none_or(|w| *out > w.out)) {
            let Group { name, pass, width, element, .. } = g;
            let text =
                format!("{name}[{}] of {element} {}, which pass {pass} moves: {}", i % width, i / width, g.values[i]);
            found = Some(Worst { text, out });
        }
    }
    found
}

fn median<'a>(values: impl Iterator<Item = &'a f32>) -> f32 {
    let mut all: Vec<f32> = values.copied().filter(|v| v.is_finite()).collect();
    let middle = all.len() / 2;
    if all.is_empty() {
        return 0.0;
    }
    *all.select_nth_unstable_by(middle, f32::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn group<'a>(name: &'a str, values: &'a [f32], middle: Option<f32>, reach: f32) -> Group<'a> {
        Group { name, pass: "move", values, width: 2, element: "splat", middle, reach }
    }

    #[test]
    fn farthest_parameter_is_named() {
        let near = [100.0, 5.0, 101.0, 6.0, 99.0, 5.5];
        let far = [0.0, -9.0, 1.0, 2.0];
        let text = |groups: &[Group<'_>]| worst(groups).map(|w| w.to_string());
        let groups = [group("means", &near, None, 1.0), group("scales", &far, Some(0.0), 2.0)];
        assert_eq!(text(&groups).unwrap(), "scales[1] of splat 0, which pass move moves: -9");
        let none = [0.0, 1.0, f32::NAN, 0.0];
        let groups = [group("means", &near, None, 1.0), group("sh0", &none, Some(0.0), 1e9)];
        assert_eq!(text(&groups).unwrap(), "sh0[0] of splat 1, which pass move moves: NaN");
        assert_eq!(worst(&[]), None);
        assert_eq!(worst(&[group("means", &[], None, 1.0)]), None);
    }
}
