//! `meta.json` of SOG.

use super::{CODES, COEFFICIENTS};
use crate::placement::Placement;
use serde::{Deserialize, Serialize};

/// Result whose error is a description of the problem.
type Found<T> = std::result::Result<T, String>;

#[derive(Serialize, Deserialize)]
pub(super) struct Meta {
    pub(super) version: u32,
    #[serde(skip_serializing_if = "Option::is_none", skip_deserializing)]
    pub(super) asset: Option<Asset>,
    pub(super) count: usize,
    #[serde(default)]
    pub(super) antialias: bool,
    pub(super) means: Means,
    pub(super) scales: Coded,
    pub(super) quats: Files,
    pub(super) sh0: Coded,
    #[serde(rename = "shN", skip_serializing_if = "Option::is_none")]
    pub(super) harmonics: Option<Harmonics>,
    /// Transform from the scene to the file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) sgs_transform: Option<Placement>,
}

#[derive(Serialize)]
pub(super) struct Asset {
    pub(super) generator: &'static str,
}

#[derive(Serialize, Deserialize)]
pub(super) struct Means {
    pub(super) mins: [f64; 3],
    pub(super) maxs: [f64; 3],
    pub(super) files: [String; 2],
}

#[derive(Serialize, Deserialize)]
pub(super) struct Coded {
    pub(super) codebook: Vec<f32>,
    pub(super) files: [String; 1],
}

#[derive(Serialize, Deserialize)]
pub(super) struct Files {
    pub(super) files: [String; 1],
}

#[derive(Serialize, Deserialize)]
pub(super) struct Harmonics {
    pub(super) count: usize,
    pub(super) bands: usize,
    pub(super) codebook: Vec<f32>,
    pub(super) files: [String; 2],
}

impl Meta {
    /// Reads and checks the text.
    pub(super) fn read(text: &[u8]) -> Found<Meta> {
        /// Part that every version has.
        #[derive(Deserialize)]
        struct Start {
            version: Option<u32>,
        }
        let wrong = |e: serde_json::Error| format!("meta.json is not as SOG has it: {e}");
        let start: Start = serde_json::from_slice(text).map_err(wrong)?;
        match start.version {
            Some(2) => {}
            Some(other) => return Err(format!("meta.json has version {other}; version 2 of SOG is read")),
            None => return Err("meta.json has no version; version 2 of SOG is read, export it again".into()),
        }
        let meta: Meta = serde_json::from_slice(text).map_err(wrong)?;
        let harmonics = meta.harmonics.iter().map(|h| ("shN", &h.codebook));
        for (name, book) in
            [("scales", &meta.scales.codebook), ("sh0", &meta.sh0.codebook)].into_iter().chain(harmonics)
        {
            if book.len() != CODES {
                return Err(format!("meta.json: the codebook of {name} has {} numbers instead of {CODES}", book.len()));
            }
            if let Some(bad) = book.iter().find(|v| !v.is_finite()) {
                return Err(format!("meta.json: the codebook of {name} holds {bad}"));
            }
        }
        // The largest logarithm of a 32-bit float is below 89.
        if let Some(bad) = meta.means.mins.iter().chain(&meta.means.maxs).find(|v| v.is_nan() || v.abs() > 88.0) {
            return Err(format!("meta.json: a range of the means is {bad}; use numbers from -88 to 88"));
        }
        if let Some(h) = &meta.harmonics
            && (h.bands >= COEFFICIENTS.len() || h.count > 65_536)
        {
            return Err(format!(
                "meta.json: {} bands and {} entries of harmonics; at most 3 and 65536",
                h.bands, h.count
            ));
        }
        if let Some(transform) = &meta.sgs_transform {
            transform.check().map_err(|e| format!("meta.json: {e}"))?;
        }
        Ok(meta)
    }
}
