//! Semantic classes, fixed for all scenes.
//!
//! Ids and embeddings therefore agree between scenes.

/// Labels by class id; 0 is the background, which belongs to no object.
pub(crate) const CLASSES: [&str; 22] = [
    "background",
    "wall",
    "ceiling",
    "floor",
    "carpet",
    "sofa",
    "cushion",
    "table",
    "chair",
    "lamp",
    "bookcase",
    "book",
    "cabinet",
    "window",
    "curtain",
    "picture",
    "mirror",
    "trim",
    "plant",
    "tableware",
    "fruit",
    "ornament",
];

/// Returns the id of a label of [`CLASSES`], or 0 for any other text.
pub(crate) fn class_id(label: &str) -> u16 {
    CLASSES.iter().position(|c| *c == label).unwrap_or(0) as u16
}
