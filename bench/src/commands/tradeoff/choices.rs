//! Choices of both stages as command-line settings and as resolved settings.

use anyhow::{Context, ensure};
use sgs_config::{Settings, accuracy_named, overlay};
use sgs_passes::Tuning;

/// Maximum relative difference of gradients due to the order of sums.
///
/// Tests use the same bound for finite differences.
const ROUNDING: f64 = 1e-3;

/// Effect of a choice, which determines its checks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Equivalent implementation: a step matches that of `exact` up to rounding.
    Same,
    /// Accuracy of a step.
    Accuracy,
    /// Later steps only: the cost appears in a training, not in a single step.
    Later,
    /// Model: gradients are not comparable.
    Model,
}

/// Choice of settings that is measured.
#[derive(Clone, Debug)]
pub struct Choice {
    /// Short name.
    pub name: String,
    /// Settings as typed on the command line.
    pub setting: String,
    /// Effect of the choice.
    pub kind: Kind,
    /// Differences from the common settings.
    over: toml::Table,
}

impl Choice {
    /// Creates a choice from `assignments`.
    ///
    /// An optional `--accuracy NAME` comes first, then `KEY=VALUE` as for `--set`.
    pub fn new(name: &str, assignments: &[&str], kind: Kind) -> anyhow::Result<Choice> {
        let mut over = toml::Table::new();
        for assignment in assignments {
            let table = match assignment.strip_prefix("--accuracy ") {
                Some(level) => accuracy_named(level)?,
                None => set(assignment)?,
            };
            overlay(&mut over, table);
        }
        let setting: Vec<String> = assignments.iter().map(|assignment| format!("`{assignment}`")).collect();
        Ok(Choice { name: name.to_owned(), setting: setting.join(", "), kind, over })
    }

    /// Creates the choice of an accuracy level.
    pub fn level(name: &str) -> anyhow::Result<Choice> {
        Choice::new(name, &[&format!("--accuracy {name}")], Kind::Accuracy)
    }

    /// Returns the full settings of the choice.
    pub fn settings(&self, base: &Settings) -> anyhow::Result<Settings> {
        let mut table = base.to_table()?;
        overlay(&mut table, self.over.clone());
        let settings = Settings::from_table(table)?;
        settings.check()?;
        Ok(settings)
    }

    /// Returns the gradient error if it is allowed for this kind of choice.
    ///
    /// # Errors
    /// If the choice must match `exact` and does not.
    pub fn checked_gradient(&self, gradient: f64) -> anyhow::Result<f64> {
        let allowed = self.kind != Kind::Same || gradient <= ROUNDING;
        ensure!(allowed, "\"{}\" should come to the same as exact, but its gradient is {gradient:.1e} off.", self.name);
        Ok(gradient)
    }

    /// Returns whether the error of the choice appears in one step.
    pub fn shows(&self) -> bool {
        matches!(self.kind, Kind::Same | Kind::Accuracy)
    }
}

/// Parses a setting to a table. Words need no quotes.
pub fn set(pair: &str) -> anyhow::Result<toml::Table> {
    let (key, value) = pair.split_once('=').with_context(|| format!("\"{pair}\" sets nothing."))?;
    let quoted = || format!("{key} = \"{value}\"").parse();
    format!("{key} = {value}").parse().or_else(|_| quoted()).with_context(|| format!("\"{pair}\""))
}

/// Returns the choices of the geometry stage.
///
/// Order: `exact`, every single choice, levels of accuracy, equivalent implementations.
pub fn of_geometry(own: &Tuning) -> anyhow::Result<Vec<Choice>> {
    let mut all = vec![Choice::level("exact")?];
    let mut add = |name: &str, assignments: &[&str], kind: Kind| -> anyhow::Result<()> {
        all.push(Choice::new(name, assignments, kind)?);
        Ok(())
    };
    for bits in [24, 16] {
        add(&format!("depth of {bits} bits"), &[&format!("accuracy.depth_bits={bits}")], Kind::Accuracy)?;
    }
    for parts in [128.0_f32, 64.0, 32.0] {
        let assignment = format!("accuracy.alpha_min={}", 1.0 / parts);
        add(&format!("alpha from 1/{parts}"), &[&assignment], Kind::Accuracy)?;
    }
    add("last splat kept", &["accuracy.keep_last=true"], Kind::Accuracy)?;
    for least in ["0.001", "0.01", "0.05"] {
        let assignments = [&format!("accuracy.transmittance_min={least}"), "accuracy.keep_last=true"];
        add(&format!("transmittance to {least}, last splat kept"), &assignments, Kind::Accuracy)?;
    }
    add("colors in 16 bits", &["accuracy.color_bits=16"], Kind::Accuracy)?;
    // A step has the gradients of exact; what it leaves is rounded.
    add("compact", &["--accuracy compact"], Kind::Later)?;
    for level in ["balanced", "fast"] {
        add(level, &[&format!("--accuracy {level}")], Kind::Accuracy)?;
    }
    let [width, height] = own.tile;
    for rows in [height / 2, height * 2] {
        add(&format!("tiles of {width}x{rows}"), &[&format!("train.tile_rows={rows}")], Kind::Same)?;
    }
    add("backward by splats", &["geometry.backward=splat"], Kind::Same)?;
    add("backward by buckets", &["geometry.backward=bucket"], Kind::Same)?;
    add("backward by atomics", &["geometry.backward=atomic"], Kind::Same)?;
    // Equivalent within one step; trajectories over several steps differ.
    add("Adam of all", &["geometry.dense_adam=true"], Kind::Same)?;
    Ok(all)
}

/// Returns the choices of the intrinsic stage for these settings.
///
/// Order: `exact`, every single choice, levels of accuracy, combinations, other models.
pub fn of_intrinsic(base: &Settings, own: &Tuning) -> anyhow::Result<Vec<Choice>> {
    let mut all = vec![Choice::level("exact")?];
    let mut add = |name: &str, assignments: &[&str], kind: Kind| -> anyhow::Result<()> {
        all.push(Choice::new(name, assignments, kind)?);
        Ok(())
    };
    add("weights recomputed", &["intrinsic.surface_bytes=1"], Kind::Same)?;
    add("environment every 4", &["intrinsic.environment.every=4"], Kind::Later)?;
    add("environment every 8", &["intrinsic.environment.every=8"], Kind::Later)?;
    add("one pair of 4", &["intrinsic.visibility.sample=4"], Kind::Accuracy)?;
    add("one pair of 16", &["intrinsic.visibility.sample=16"], Kind::Accuracy)?;
    add("lights culled, 0.002", &["intrinsic.cull_error=0.002"], Kind::Accuracy)?;
    add("lights culled, 0.02", &["intrinsic.cull_error=0.02"], Kind::Accuracy)?;
    add("half size", &["intrinsic.scale=0.5"], Kind::Accuracy)?;
    add("weights in 16 bits", &["accuracy.weight_bits=16"], Kind::Accuracy)?;
    add("field in 16 bits", &["accuracy.visibility_bits=16"], Kind::Accuracy)?;
    let rows = own.tile[1];
    for (name, rows) in [("tiles of half the rows", rows / 2), ("tiles of twice the rows", rows * 2)] {
        add(name, &[&format!("train.tile_rows={rows}")], Kind::Same)?;
    }
    for level in ["balanced", "fast"] {
        add(level, &[&format!("--accuracy {level}")], Kind::Accuracy)?;
    }
    let draft = ["--accuracy fast", "intrinsic.cull_error=0.02", "intrinsic.scale=0.5"];
    add("fast, culled, half size", &draft, Kind::Accuracy)?;
    let s = &base.intrinsic;
    if s.lights.grid > 1 {
        add("fewer lights", &[&format!("intrinsic.lights.grid={}", s.lights.grid - 1)], Kind::Model)?;
    }
    if s.lights.lobes > 1 {
        add("fewer lobes", &[&format!("intrinsic.lights.lobes={}", s.lights.lobes / 2)], Kind::Model)?;
    }
    if s.environment.resolution > 16 {
        let half = s.environment.resolution / 2;
        add("coarser environment", &[&format!("intrinsic.environment.resolution={half}")], Kind::Model)?;
    }
    if s.visibility.levels > 4 {
        let levels = s.visibility.levels / 2;
        let ratio = f64::from(s.visibility.finest) / f64::from(s.visibility.coarsest.max(1));
        let finest =
            f64::from(s.visibility.coarsest) * ratio.powf(f64::from(levels - 1) / f64::from(s.visibility.levels - 1));
        let assignments = [("levels", f64::from(levels)), ("finest", finest.round())];
        let assignments = assignments.map(|(key, value)| format!("intrinsic.visibility.{key}={value}"));
        add("half of the field", &assignments.each_ref().map(String::as_str), Kind::Model)?;
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;
    use sgs_config::Backward;
    use sgs_passes::Accuracy;

    /// Returns all choices of both stages.
    fn all() -> [Vec<Choice>; 2] {
        let own = Tuning::for_subgroups(8);
        [of_geometry(&own).unwrap(), of_intrinsic(&Settings::default(), &own).unwrap()]
    }

    fn settings(choice: &Choice) -> Settings {
        choice.settings(&Settings::default()).unwrap()
    }

    /// Returns the accuracy settings in which a choice differs from `exact`.
    ///
    /// A new setting fails to compile here until it is listed.
    fn traded(a: &Accuracy) -> Vec<&'static str> {
        let Accuracy {
            depth_bits,
            alpha_min,
            transmittance_min,
            keep_last,
            visibility_bits,
            color_bits,
            weight_bits,
            state_bits,
        } = *a;
        let exact = Accuracy::EXACT;
        let all = [
            ("depth_bits", depth_bits != exact.depth_bits),
            ("alpha_min", alpha_min != exact.alpha_min),
            ("transmittance_min", transmittance_min != exact.transmittance_min),
            ("keep_last", keep_last != exact.keep_last),
            ("visibility_bits", visibility_bits != exact.visibility_bits),
            ("color_bits", color_bits != exact.color_bits),
            ("weight_bits", weight_bits != exact.weight_bits),
            ("state_bits", state_bits != exact.state_bits),
        ];
        all.into_iter().filter(|(_, differs)| *differs).map(|(name, _)| name).collect()
    }

    #[test]
    fn every_accuracy_setting_has_a_choice() {
        let of = |choices: &[Choice]| choices.iter().flat_map(|c| traded(&settings(c).accuracy)).collect::<Vec<_>>();
        let found = all().map(|choices| of(&choices)).concat();
        let every = toml::Table::try_from(Accuracy::EXACT).unwrap();
        for name in every.keys() {
            assert!(found.contains(&name.as_str()), "no choice has another {name}");
        }
        assert!(traded(&Accuracy::EXACT).is_empty());
        // Every setting also has a choice of its own, except where it depends on another setting.
        let alone = |name: &str| all().concat().iter().any(|c| traded(&settings(c).accuracy) == [name]);
        assert!(every.keys().all(|name| alone(name) || name == "transmittance_min"));
        let with_last = |c: &Choice| traded(&settings(c).accuracy) == ["transmittance_min", "keep_last"];
        assert!(all()[0].iter().any(with_last));
        // Training settings that trade accuracy for speed have choices, too.
        let [_, lit] = all();
        let intrinsic: Vec<_> = lit.iter().map(|c| settings(c).intrinsic).collect();
        assert!(intrinsic.iter().any(|s| s.environment.every > 1) && intrinsic.iter().any(|s| s.visibility.sample > 1));
        assert!(intrinsic.iter().any(|s| s.cull_error > 0.0) && intrinsic.iter().any(|s| s.scale < 1.0));
        assert!(intrinsic.iter().any(|s| s.lights.grid < 4) && intrinsic.iter().any(|s| s.lights.lobes < 12));
    }

    /// Parses the settings of the table as `sgs train --accuracy ... --set ...` does.
    fn parsed_settings(text: &str) -> Settings {
        let mut table = toml::Table::new();
        for assignment in text.split(", ") {
            let assignment = assignment.strip_prefix('`').and_then(|a| a.strip_suffix('`')).unwrap();
            if let Some(level) = assignment.strip_prefix("--accuracy ") {
                assert!(table.is_empty(), "\"{text}\": levels go before settings");
                table = accuracy_named(level).unwrap();
                continue;
            }
            let (key, value) = assignment.split_once('=').unwrap();
            let parsed = format!("x = {value}").parse::<toml::Table>().ok().and_then(|mut t| t.remove("x"));
            let mut over = parsed.unwrap_or_else(|| toml::Value::String(value.to_owned()));
            for part in key.rsplit('.') {
                over = toml::Value::Table([(part.to_owned(), over)].into_iter().collect());
            }
            let toml::Value::Table(over) = over else { unreachable!() };
            overlay(&mut table, over);
        }
        Settings::from_table(table).unwrap()
    }

    #[test]
    fn printed_settings_are_the_measured_settings() {
        for choice in all().concat() {
            assert_eq!(parsed_settings(&choice.setting), settings(&choice), "{}", choice.name);
        }
        let of = |name: &str| settings(all()[0].iter().find(|c| c.name == name).unwrap());
        let exact = Accuracy::EXACT;
        for (name, accuracy) in [
            ("exact", exact),
            ("depth of 16 bits", Accuracy { depth_bits: 16, ..exact }),
            ("alpha from 1/128", Accuracy { alpha_min: 1.0 / 128.0, ..exact }),
            ("alpha from 1/64", Accuracy { alpha_min: 1.0 / 64.0, ..exact }),
            ("alpha from 1/32", Accuracy { alpha_min: 1.0 / 32.0, ..exact }),
            ("transmittance to 0.05, last splat kept", Accuracy { transmittance_min: 0.05, keep_last: true, ..exact }),
            ("compact", Accuracy::COMPACT),
            ("balanced", Accuracy::BALANCED),
            ("fast", Accuracy::FAST),
            ("tiles of 8x32", exact),
        ] {
            assert_eq!(of(name).accuracy, accuracy, "{name}");
        }
        let ways = ["backward by splats", "backward by buckets", "backward by atomics"];
        let ways = ways.map(|name| of(name).geometry.backward);
        assert_eq!(ways, [Backward::Splat, Backward::Bucket, Backward::Atomic]);
        assert_eq!((of("tiles of 8x8").train.tile_rows, of("tiles of 8x32").train.tile_rows), (8, 32));
        assert!(of("Adam of all").geometry.dense_adam);
    }

    #[test]
    fn choices_are_distinct_and_exact_is_first() {
        for choices in all() {
            assert!(choices[0].name == "exact" && settings(&choices[0]) == Settings::default());
            for (i, a) in choices.iter().enumerate() {
                let duplicate = choices[..i].iter().find(|b| b.name == a.name || settings(b) == settings(a));
                assert!(duplicate.is_none(), "{} is {}", a.name, duplicate.unwrap().name);
            }
        }
    }

    #[test]
    fn equivalent_choices_have_exact_accuracy() {
        let same: Vec<Choice> = all().concat().into_iter().filter(|c| c.kind == Kind::Same).collect();
        let names: Vec<&str> = same.iter().map(|c| c.name.as_str()).collect();
        let tiles = ["tiles of half the rows", "tiles of twice the rows"];
        let backward = ["backward by splats", "backward by buckets", "backward by atomics"];
        let geometry = [&["tiles of 8x8", "tiles of 8x32"], &backward[..], &["Adam of all"]].concat();
        assert_eq!(names, [&geometry[..], &["weights recomputed"], &tiles].concat());
        assert!(same.iter().all(|c| c.shows() && settings(c).accuracy == Accuracy::EXACT));
        // Only equivalent choices have a bound on their gradient error.
        assert_eq!(same[0].checked_gradient(1e-4).unwrap(), 1e-4);
        let message = same[0].checked_gradient(0.01).unwrap_err().to_string();
        assert_eq!(message, "\"tiles of 8x8\" should come to the same as exact, but its gradient is 1.0e-2 off.");
        assert!(Choice::level("fast").unwrap().checked_gradient(0.5).is_ok());
    }
}
