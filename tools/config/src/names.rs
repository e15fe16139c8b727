//! Validation of names in tables of settings. Unknown names get a suggestion.

use crate::error::ConfigError;
use sgs_scene::MaskUse;
use strsim::levenshtein;

/// Returns a parser's message on one line without a final period.
pub fn one_line(message: &str) -> String {
    message.trim().trim_end_matches('.').replace('\n', " ")
}

/// Returns the mark that ends a sentence: none if it ends with a question.
pub fn end_mark(sentence: &str) -> &'static str {
    if sentence.ends_with('?') { "" } else { "." }
}

/// Settings that are numbers or this word, with the allowed numbers.
const OR_WORD: [(&str, &str, &str); 3] = [
    (VIEW_RATES, super::view_rates::AUTO, "4 numbers"),
    ("geometry.sh_degree", super::degree::AUTO, "0 to 3"),
    (OWN_PRIOR, super::own_prior::AUTO, "a number of at least 0"),
];

/// Setting that is true, false or a word.
const MASKS: &str = "masks";

/// Setting among these that is a list.
const VIEW_RATES: &str = "geometry.rates.views";

/// Setting among these that may be a fraction.
const OWN_PRIOR: &str = "intrinsic.losses.own_prior";

/// Checks that every key of `table` is known and has a value of the same kind.
pub(super) fn compare(prefix: &str, table: &toml::Table, known: &toml::Table, all: &toml::Table) -> crate::Result<()> {
    use toml::Value::{Array, Float, Integer, Table};
    for (key, value) in table {
        let name = format!("{prefix}{key}");
        let Some(expected) = known.get(key) else {
            let nearest = match EXPECTED.iter().find(|(expected, _)| *expected == name) {
                Some((_, new)) => new.map(str::to_owned),
                None => nearest(&name, all),
            };
            let known = known.keys().map(|k| format!("{prefix}{k}")).collect();
            return Err(ConfigError::UnknownSetting { name, nearest, known });
        };
        if let Some((_, word, numbers)) = OR_WORD.iter().find(|(n, ..)| *n == name) {
            let list = name == VIEW_RATES;
            match value {
                Integer(n) if *n < 0 && !list => return Err(ConfigError::range(name, n, "at least 0")),
                Integer(_) if !list => continue,
                Array(values) if list && are_numbers(values, 4) => continue,
                Float(f) if name == OWN_PRIOR && f.is_finite() && *f >= 0.0 => continue,
                toml::Value::String(s) if s == word => continue,
                _ => return Err(ConfigError::kind(name, value, format!("{numbers} or \"{word}\""))),
            }
        }
        if name == MASKS {
            match value {
                toml::Value::Boolean(_) => continue,
                toml::Value::String(s) if s == MaskUse::INVERTED => continue,
                _ => return Err(ConfigError::kind(name, value, "true, false or \"inverted\"")),
            }
        }
        match (value, expected) {
            (Table(value), Table(expected)) => compare(&format!("{name}."), value, expected, all)?,
            (Integer(n), Integer(_)) if *n < 0 => return Err(ConfigError::range(name, n, "at least 0")),
            // A list of words: its default holds all of them.
            (Array(values), Array(all)) if matches!(all.first(), Some(toml::Value::String(_))) => {
                if let Some(wrong) = values.iter().find(|value| !all.contains(value)) {
                    return Err(ConfigError::UnknownItem {
                        setting: name,
                        item: wrong.to_string(),
                        known: words_of(all),
                    });
                }
            }
            (Array(values), Array(expected)) => {
                if !are_numbers(values, expected.len()) {
                    return Err(ConfigError::kind(name, value, format!("{} numbers", expected.len())));
                }
            }
            (Integer(_), Float(_)) => {}
            (value, expected) if value.same_type(expected) => {}
            (value, expected) => {
                let kind = match expected {
                    Table(_) => "a group of settings".to_owned(),
                    Integer(_) => "a whole number".to_owned(),
                    Float(_) => "a number".to_owned(),
                    toml::Value::Boolean(_) => "true or false".to_owned(),
                    Array(all) if matches!(all.first(), Some(toml::Value::String(_))) => {
                        format!("a list of {}", words_of(all).join(", "))
                    }
                    Array(all) => format!("{} numbers", all.len()),
                    _ => "text".to_owned(),
                };
                return Err(ConfigError::kind(name, value, kind));
            }
        }
    }
    Ok(())
}

/// Tells whether a list has this many items, all numbers.
fn are_numbers(values: &[toml::Value], count: usize) -> bool {
    values.len() == count && values.iter().all(|v| matches!(v, toml::Value::Integer(_) | toml::Value::Float(_)))
}

/// Returns the words of a list.
fn words_of(list: &[toml::Value]) -> Vec<String> {
    list.iter().filter_map(toml::Value::as_str).map(str::to_owned).collect()
}

/// Expected names that are no settings, and whose nearest name would mislead.
///
/// Each has the setting that expresses it, or none if its value is fixed.
const EXPECTED: [(&str, Option<&str>); 16] = [
    ("geometry.densify.enabled", Some("geometry.densify.until")),
    ("geometry.densify.statistic", Some("geometry.densify.rule")),
    ("geometry.entry_capacity", None),
    ("geometry.pseudo.poses", None),
    ("geometry.rates.means_final", Some("geometry.rates.means")),
    ("geometry.rates.semantics", None),
    ("geometry.temperature", None),
    ("intrinsic.automatic.ready", Some("intrinsic.automatic.limits")),
    ("intrinsic.automatic.settled", Some("intrinsic.automatic.limits")),
    ("intrinsic.environment.enabled", Some("intrinsic.environment.resolution")),
    ("intrinsic.lights.enabled", Some("intrinsic.lights.grid")),
    ("intrinsic.relight.roughness", None),
    ("noise.rotations", Some("noise.cameras")),
    ("noise.translations", Some("noise.cameras")),
    ("provider.answer_seconds", Some("provider.seconds")),
    ("provider.start_seconds", Some("provider.seconds")),
];

/// Maximum length of names that are compared.
const MOST_LETTERS: usize = 100;

/// Returns the setting whose name, or last component, is closest to `name`.
///
/// Returns `None` if no name is close.
fn nearest(name: &str, all: &toml::Table) -> Option<String> {
    // Longer than any setting, and slow to compare.
    if name.len() > MOST_LETTERS {
        return None;
    }
    fn collect(prefix: &str, table: &toml::Table, names: &mut Vec<String>) {
        for (key, value) in table {
            match value {
                toml::Value::Table(inner) => collect(&format!("{prefix}{key}."), inner, names),
                _ => names.push(format!("{prefix}{key}")),
            }
        }
    }
    let mut names = Vec::new();
    collect("", all, &mut names);
    let last = |n: &str| n.rsplit('.').next().unwrap_or_default().to_owned();
    let away = |n: &String| levenshtein(name, n).min(levenshtein(&last(name), &last(n)) + 1);
    let (far, near) = names.into_iter().map(|n| (away(&n), n)).min()?;
    (far <= 3).then_some(near)
}

/// Returns the error of the first word that is not an allowed value of its setting.
///
/// Tries each word separately, because the parser's errors do not name the setting. `refuse` parses a table and
/// returns the error.
pub(super) fn word(
    table: &toml::Table,
    refuse: impl Fn(toml::Table) -> Option<toml::de::Error>,
) -> Option<ConfigError> {
    fn words(path: &[String], table: &toml::Table, found: &mut Vec<(Vec<String>, String)>) {
        for (key, value) in table {
            let at = [path, std::slice::from_ref(key)].concat();
            match value {
                toml::Value::Table(inner) => words(&at, inner, found),
                toml::Value::String(word) => found.push((at, word.clone())),
                _ => {}
            }
        }
    }
    let mut found = Vec::new();
    words(&[], table, &mut found);
    found.into_iter().find_map(|(path, word)| {
        let mut alone = toml::Value::String(word.clone());
        for key in path.iter().rev() {
            alone = toml::Value::Table(toml::Table::from_iter([(key.clone(), alone)]));
        }
        let toml::Value::Table(alone) = alone else { return None };
        let error = refuse(alone)?;
        // Format of serde: "unknown variant `a`, expected `b` or `c`", or "... expected one of `b`, `c`".
        let known: Vec<&str> = error.message().split('`').skip(1).step_by(2).skip(1).collect();
        let setting = path.join(".");
        if known.is_empty() {
            let what = format!("\"{setting}\" is wrong: {}.", one_line(error.message()));
            return Some(ConfigError::Format(what));
        }
        let alike = known.iter().filter(|_| word.len() <= MOST_LETTERS);
        let near = alike.map(|k| (levenshtein(&word, k), *k)).min().filter(|(far, _)| *far <= 2);
        let nearest = near.map(|(_, k)| k.to_owned());
        let known = known.iter().map(|k| (*k).to_owned()).collect();
        Some(ConfigError::UnknownWord { setting, word, nearest, known })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Settings;

    #[test]
    fn masks_are_used_inverted_or_ignored() {
        let of = |text: &str| Settings::from_table(format!("masks = {text}").parse().unwrap());
        for (text, expected) in
            [("true", MaskUse::Valid), ("false", MaskUse::Ignored), ("\"inverted\"", MaskUse::Inverted)]
        {
            let s = of(text).unwrap();
            assert_eq!((s.masks, s.scene_options().masks), (expected, expected));
            assert_eq!(Settings::from_table(s.to_table().unwrap()).unwrap(), s);
        }
        for wrong in ["1", "\"inverse\""] {
            let error = of(wrong).unwrap_err().to_string();
            assert_eq!(error, format!("masks is {wrong}, but must be true, false or \"inverted\"."));
        }
    }
}
