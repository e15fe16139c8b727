//! Checks of the numbers of an edit. Errors begin with the name of the field.

/// Checks that all values are finite.
pub(super) fn finite<'v>(name: &str, values: impl IntoIterator<Item = &'v f32>) -> std::result::Result<(), String> {
    match values.into_iter().find(|v| !v.is_finite()) {
        Some(v) => Err(format!("{name} holds {v}, which is not finite")),
        None => Ok(()),
    }
}

/// Checks that all values are finite and at least 0.
pub(super) fn positive<'v>(name: &str, values: impl IntoIterator<Item = &'v f32>) -> std::result::Result<(), String> {
    match values.into_iter().find(|v| !(v.is_finite() && **v >= 0.0)) {
        Some(v) => Err(format!("{name} holds {v}, but must be finite and at least 0")),
        None => Ok(()),
    }
}
