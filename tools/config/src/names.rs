//! Validation of names in tables of settings. Unknown names get a suggestion.

use crate::error::ConfigError;

/// Returns a parser's message on one line without a final period.
pub fn one_line(message: &str) -> String {
    message.trim().trim_end_matches('.').replace('\n', " ")
}

/// Settings that are a number or this word, with the allowed numbers.
const OR_WORD: [(&str, &str, &str); 2] = [
    ("geometry.sh_degree", super::degree::AUTO, "0 to 3"),
    (OWN_PRIOR, super::own_prior::AUTO, "a number of at least 0"),
];

/// Setting among these that may be a fraction.
const OWN_PRIOR: &str = "intrinsic.losses.own_prior";

/// Checks that every key of `given` is known and has a value of the same kind.
pub(super) fn compare(prefix: &str, given: &toml::Table, known: &toml::Table, all: &toml::Table) -> crate::Result<()> {
    use toml::Value::{Array, Float, Integer, Table};
    let fail = |what: String| Err(ConfigError::new(what));
    for (key, value) in given {
        let name = format!("{prefix}{key}");
        let Some(expected) = known.get(key) else {
            let hint = match nearest(&name, all) {
                Some(near) => format!("did you mean \"{near}\"?"),
                None => format!(
                    "there are {}.",
                    known.keys().map(|k| format!("{prefix}{k}")).collect::<Vec<_>>().join(", ")
                ),
            };
            return fail(format!("\"{name}\" is not a setting; {hint}"));
        };
        if let Some((_, word, numbers)) = OR_WORD.iter().find(|(n, ..)| *n == name) {
            match value {
                Integer(n) if *n < 0 => return fail(format!("{name} is {n}, but must be at least 0.")),
                Integer(_) => continue,
                Float(f) if name == OWN_PRIOR && f.is_finite() && *f >= 0.0 => continue,
                toml::Value::String(s) if s == word => continue,
                _ => return fail(format!("{name} is {value}, but must be {numbers} or \"{word}\".")),
            }
        }
        match (value, expected) {
            (Table(value), Table(expected)) => compare(&format!("{name}."), value, expected, all)?,
            (Integer(n), Integer(_)) if *n < 0 => return fail(format!("{name} is {n}, but must be at least 0.")),
            // A list of words: its default holds all of them.
            (Array(values), Array(all)) if matches!(all.first(), Some(toml::Value::String(_))) => {
                if let Some(wrong) = values.iter().find(|value| !all.contains(value)) {
                    let words: Vec<&str> = all.iter().filter_map(toml::Value::as_str).collect();
                    return fail(format!("{name} has {wrong}, but must be a list of {}.", words.join(", ")));
                }
            }
            (Array(values), Array(expected)) => {
                let numbers = values.iter().all(|v| matches!(v, Integer(_) | Float(_)));
                if values.len() != expected.len() || !numbers {
                    return fail(format!("{name} is {value}, but must be {} numbers.", expected.len()));
                }
            }
            (Integer(_), Float(_)) => {}
            (value, expected) if value.same_type(expected) => {}
            (value, expected) => {
                let kind = match expected {
                    Table(_) => "a group of settings",
                    Integer(_) => "a whole number",
                    Float(_) => "a number",
                    toml::Value::Boolean(_) => "true or false",
                    Array(all) if matches!(all.first(), Some(toml::Value::String(_))) => {
                        let words: Vec<&str> = all.iter().filter_map(toml::Value::as_str).collect();
                        return fail(format!("{name} is {value}, but must be a list of {}.", words.join(", ")));
                    }
                    Array(all) => return fail(format!("{name} is {value}, but must be {} numbers.", all.len())),
                    _ => "text",
                };
                return fail(format!("{name} is {value}, but must be {kind}."));
            }
        }
    }
    Ok(())
}

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
    let away = |n: &String| distance(name, n).min(distance(&last(name), &last(n)) + 1);
    let (far, near) = names.into_iter().map(|n| (away(&n), n)).min()?;
    (far <= 3).then_some(near)
}

/// Describes the first word that is not an allowed value of its setting.
///
/// Tries each word separately, because the parser's errors do not name the setting. `refuse` parses a table and
/// returns the error.
pub(super) fn word(table: &toml::Table, refuse: impl Fn(toml::Table) -> Option<toml::de::Error>) -> Option<String> {
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
        let name = path.join(".");
        if known.is_empty() {
            return Some(format!("\"{name}\" is wrong: {}.", one_line(error.message())));
        }
        let alike = known.iter().filter(|_| word.len() <= MOST_LETTERS);
        let near = alike.map(|k| (distance(&word, k), *k)).min().filter(|(far, _)| *far <= 2);
        let hint = near.map_or_else(String::new, |(_, k)| format!("; did you mean \"{k}\"?"));
        let all: Vec<String> = known.iter().map(|k| format!("\"{k}\"")).collect();
        let end = if hint.is_empty() { "." } else { "" };
        Some(format!("\"{name}\" is \"{word}\", but must be one of {}{hint}{end}", all.join(", ")))
    })
}

/// Returns the Levenshtein distance in characters.
pub fn distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.chars().enumerate() {
        let mut diagonal = std::mem::replace(&mut row[0], i + 1);
        for (j, y) in b.iter().enumerate() {
            let change = diagonal + usize::from(x != *y);
            diagonal = row[j + 1];
            row[j + 1] = change.min(row[j] + 1).min(diagonal + 1);
        }
    }
    row[b.len()]
}
