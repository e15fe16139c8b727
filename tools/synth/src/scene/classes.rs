//! The semantic classes, fixed for all scenes so that ids and embeddings agree between them.

/// Labels by class id; 0 is what belongs to nothing.
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

/// The id of a label of [`CLASSES`]; 0 for any other text.
pub(crate) fn class_id(label: &str) -> u16 {
    CLASSES.iter().position(|c| *c == label).unwrap_or(0) as u16
}
