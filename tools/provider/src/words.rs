//! Splitting of command lines into words like in a shell, without a shell.

/// Splits a command line at whitespace.
///
/// Single and double quotes protect whitespace. A backslash protects the next character, except within single quotes.
pub(crate) fn words(line: &str) -> Result<Vec<String>, &'static str> {
    let mut words = Vec::new();
    let mut word: Option<String> = None;
    let mut quote = None;
    let mut letters = line.chars();
    while let Some(c) = letters.next() {
        match (c, quote) {
            ('\\', None | Some('"')) => match letters.next() {
                Some(next) => word.get_or_insert_default().push(next),
                None => return Err("ends in a backslash"),
            },
            (c, Some(q)) if c == q => quote = None,
            (c, Some(_)) => word.get_or_insert_default().push(c),
            ('"' | '\'', None) => {
                quote = Some(c);
                word.get_or_insert_default();
            }
            (c, None) if c.is_whitespace() => words.extend(word.take()),
            (c, None) => word.get_or_insert_default().push(c),
        }
    }
    if quote.is_some() {
        return Err("has a quote that is not closed");
    }
    words.extend(word);
    if words.first().is_none_or(String::is_empty) {
        return Err("names no program");
    }
    Ok(words)
}

#[cfg(test)]
mod tests {
    use super::words;

    #[test]
    fn words_split_like_in_a_shell() {
        let split = |line| words(line).unwrap();
        assert_eq!(split(" python3 -m  x\t'a b' "), ["python3", "-m", "x", "a b"]);
        assert_eq!(split(r#"a "b \" c"d '' \ e '\'"#), ["a", "b \" cd", "", " e", "\\"]);
        assert_eq!(words("  "), Err("names no program"));
        assert_eq!(words("'' a"), Err("names no program"));
        assert_eq!(words("a 'b"), Err("has a quote that is not closed"));
        assert_eq!(words("a\\"), Err("ends in a backslash"));
    }
}
