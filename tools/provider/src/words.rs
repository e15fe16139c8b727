//! Splitting of command lines into words like in a shell, without a shell.

/// Splits a command line by the rules of POSIX shells.
///
/// They cover quotes, backslashes and comments, not variables or patterns.
pub(crate) fn words(line: &str) -> Result<Vec<String>, &'static str> {
    let words = shlex::split(line).ok_or(if line.ends_with('\\') {
        "ends in a backslash"
    } else {
        "has a quote that is not closed"
    })?;
    if words.first().is_none_or(String::is_empty) { Err("names no program") } else { Ok(words) }
}

#[cfg(test)]
mod tests {
    use super::words;

    #[test]
    fn words_split_like_in_a_shell() {
        let split = |line| words(line).unwrap();
        assert_eq!(split(" python3 -m  x\t'a b' "), ["python3", "-m", "x", "a b"]);
        assert_eq!(split(r#"a "b \" c"d '' \ e '\'"#), ["a", "b \" cd", "", " e", "\\"]);
        assert_eq!(split(r#"a "b\c" # d"#), ["a", "b\\c"]);
        assert_eq!(words("  "), Err("names no program"));
        assert_eq!(words("'' a"), Err("names no program"));
        assert_eq!(words("a 'b"), Err("has a quote that is not closed"));
        assert_eq!(words("a\\"), Err("ends in a backslash"));
    }
}
