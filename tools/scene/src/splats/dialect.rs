//! Dialects of PLY files: names and encodings of materials in other programs.
//!
//! All dialects agree on positions, spherical harmonics, opacities, scales and rotations, which are stored before
//! activation. They differ in the names of normals and materials, and in the activation of materials.
//! docs/reference/exchange.md documents each dialect. Sibling modules read and write the files.

use super::{SH_C0, Splats};
use crate::image::{linear_to_srgb, srgb_to_linear};
use crate::ply::{Scalar, VertexTable};

/// Smallest distance of a converted value from the ends of its range. The stored value would be infinite at the ends.
const MARGIN: f64 = 1e-6;

/// Program whose PLY files are read and written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlyDialect {
    /// This project: 3DGS with `albedo_0..2 roughness [metallic] [semantic_*] [emitter] [light_gain]`.
    Own,
    /// The original 3DGS program and most viewers, without materials.
    ThreeDgs,
    /// GS-IR: `normal_0..2 albedo_0..2 roughness metallic`.
    GsIr,
    /// Relightable 3D Gaussians: `base_color_0..2 roughness`.
    R3dg,
    /// SGS as published: R3DG with `semantic_feature_*`.
    Sgs,
    /// mesh2splat: albedo instead of color; `metallicFactor roughnessFactor` as plain values.
    Mesh2Splat,
}

/// Encoding of a material value between 0 and 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Code {
    /// Logistic encoding: the value is `low + span / (1 + exp(-stored))`.
    Logistic { low: f64, span: f64 },
    /// Linear encoding: the value is the stored number divided by this.
    Plain(f64),
}

/// Lowest albedo and span of this project's Gaussians. The value is `low + span * logistic(stored)`.
pub const ALBEDO_RANGE: [f32; 2] = [0.01, 0.98];
/// Lowest roughness and span, with the same encoding as [`ALBEDO_RANGE`].
pub const ROUGHNESS_RANGE: [f32; 2] = [0.09, 0.9];

pub(super) const OWN_ALBEDO: Code = Code::Logistic { low: 0.01, span: 0.98 };
pub(super) const OWN_ROUGHNESS: Code = Code::Logistic { low: 0.09, span: 0.9 };
pub(super) const OWN_METALLIC: Code = Code::Logistic { low: 0.0, span: 1.0 };
/// Range of albedo and roughness in published SGS; assumed for R3DG.
const PUBLISHED: Code = Code::Logistic { low: 0.09, span: 0.9 };

impl Code {
    fn value(self, stored: f32) -> f64 {
        match self {
            Code::Logistic { low, span } => low + span / (1.0 + (-f64::from(stored)).exp()),
            Code::Plain(whole) => f64::from(stored) / whole,
        }
    }

    fn stored(self, value: f64) -> f32 {
        match self {
            Code::Logistic { low, span } => {
                let p = ((value - low) / span).clamp(MARGIN, 1.0 - MARGIN);
                (p / (1.0 - p)).ln() as f32
            }
            Code::Plain(whole) => (value.clamp(0.0, 1.0) * whole) as f32,
        }
    }

    /// Converts a stored number to another encoding. Equal encodings preserve every bit.
    pub(super) fn to(self, other: Code, stored: f32) -> f32 {
        if self == other { stored } else { other.stored(self.value(stored)) }
    }
}

/// Property of the factor on the light that arrives.
pub(super) const LIGHT_GAIN: &str = "light_gain";

/// Property names and encodings of a dialect. Without `albedo`, the color represents the albedo.
pub(super) struct Names {
    pub(super) normals: [&'static str; 3],
    pub(super) albedo: Option<([&'static str; 3], Code)>,
    pub(super) roughness: (&'static str, Code),
    pub(super) metallic: Option<(&'static str, Code)>,
    pub(super) semantic: Option<&'static str>,
    pub(super) emitter: Option<&'static str>,
}

impl PlyDialect {
    /// All dialects.
    pub const ALL: [PlyDialect; 6] = [
        PlyDialect::Own,
        PlyDialect::ThreeDgs,
        PlyDialect::GsIr,
        PlyDialect::R3dg,
        PlyDialect::Sgs,
        PlyDialect::Mesh2Splat,
    ];

    /// Returns the name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            PlyDialect::Own => "ply",
            PlyDialect::ThreeDgs => "3dgs",
            PlyDialect::GsIr => "gs-ir",
            PlyDialect::R3dg => "r3dg",
            PlyDialect::Sgs => "sgs",
            PlyDialect::Mesh2Splat => "mesh2splat",
        }
    }

    /// Detects the dialect from property names.
    pub(super) fn of(table: &VertexTable) -> PlyDialect {
        let has = |name: &str| table.find(name).is_some();
        let byte = |name: &str| table.find(name).is_some_and(|p| table.scalar(p) == Scalar::U8);
        if has("semantic_feature_0") {
            PlyDialect::Sgs
        } else if has("base_color_0") {
            PlyDialect::R3dg
        } else if has("normal_0") && has("albedo_0") {
            PlyDialect::GsIr
        } else if has("roughnessFactor") || byte("roughness") {
            PlyDialect::Mesh2Splat
        } else if has("albedo_0")
            || has("roughness")
            || has("metallic")
            || has("semantic_0")
            || has("emitter")
            || has(LIGHT_GAIN)
        {
            PlyDialect::Own
        } else {
            PlyDialect::ThreeDgs
        }
    }

    /// Returns the property names and encodings. `bytes` selects the byte encoding of mesh2splat's short form.
    pub(super) fn names(self, bytes: bool) -> Names {
        let own = Names {
            normals: ["nx", "ny", "nz"],
            albedo: Some((["albedo_0", "albedo_1", "albedo_2"], OWN_ALBEDO)),
            roughness: ("roughness", OWN_ROUGHNESS),
            metallic: Some(("metallic", OWN_METALLIC)),
            semantic: Some("semantic_"),
            emitter: Some("emitter"),
        };
        let unit = Code::Logistic { low: 0.0, span: 1.0 };
        let base_color = Some((["base_color_0", "base_color_1", "base_color_2"], PUBLISHED));
        match self {
            PlyDialect::Own | PlyDialect::ThreeDgs => own,
            PlyDialect::GsIr => Names {
                normals: ["normal_0", "normal_1", "normal_2"],
                albedo: own.albedo.map(|(names, _)| (names, unit)),
                roughness: ("roughness", unit),
                metallic: Some(("metallic", unit)),
                semantic: None,
                emitter: None,
            },
            PlyDialect::R3dg | PlyDialect::Sgs => Names {
                albedo: base_color,
                roughness: ("roughness", PUBLISHED),
                metallic: None,
                semantic: (self == PlyDialect::Sgs).then_some("semantic_feature_"),
                emitter: None,
                ..own
            },
            PlyDialect::Mesh2Splat if bytes => Names {
                albedo: None,
                roughness: ("roughness", Code::Plain(255.0)),
                metallic: Some(("metallic", Code::Plain(255.0))),
                semantic: None,
                emitter: None,
                ..own
            },
            PlyDialect::Mesh2Splat => Names {
                albedo: None,
                roughness: ("roughnessFactor", Code::Plain(1.0)),
                metallic: Some(("metallicFactor", Code::Plain(1.0))),
                semantic: None,
                emitter: None,
                ..own
            },
        }
    }

    /// Returns whether files of the dialect always have materials.
    pub(super) fn needs_materials(self) -> bool {
        matches!(self, PlyDialect::GsIr | PlyDialect::R3dg | PlyDialect::Mesh2Splat)
    }

    /// Returns the attributes of these splats that the dialect cannot store.
    pub fn leaves_out(self, splats: &Splats) -> Vec<&'static str> {
        let plain = self == PlyDialect::ThreeDgs;
        let names = self.names(false);
        let mut out = Vec::new();
        if plain && (splats.albedo.is_some() || splats.roughness.is_some()) {
            out.push("materials");
        }
        if splats.metallic.is_some() && !plain && names.metallic.is_none() {
            out.push("metallic");
        }
        if splats.semantic.is_some() && (plain || names.semantic.is_none()) {
            out.push("semantic features");
        }
        if splats.emitters.is_some() && (plain || names.emitter.is_none()) {
            out.push("emitters");
        }
        if splats.light_gains.is_some() && self != PlyDialect::Own {
            out.push("light gains");
        }
        if self == PlyDialect::Mesh2Splat {
            out.push("colors, in whose place albedo stands");
        }
        out
    }
}

/// Returns the stored albedo of a color. The color is band 0 of the spherical harmonics, display-referred, and
/// represents the albedo.
pub(super) fn albedo_of_color(dc: f32) -> f32 {
    OWN_ALBEDO.stored(f64::from(srgb_to_linear((0.5 + SH_C0 * dc).clamp(0.0, 1.0))))
}

/// Inverts [`albedo_of_color`].
pub(super) fn color_of_albedo(stored: f32) -> f32 {
    (linear_to_srgb(OWN_ALBEDO.value(stored) as f32) - 0.5) / SH_C0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn converted_encodings_represent_the_same_value() {
        for stored in [-6.0_f32, -1.25, 0.0, 0.5, 4.0] {
            assert_eq!(OWN_ROUGHNESS.to(PUBLISHED, stored).to_bits(), stored.to_bits(), "equal codes keep bits");
            let there = OWN_ALBEDO.to(Code::Plain(1.0), stored);
            assert!((f64::from(there) - (0.01 + 0.98 / (1.0 + (-f64::from(stored)).exp()))).abs() < 1e-7);
            let back = Code::Plain(1.0).to(OWN_ALBEDO, there);
            assert!((back - stored).abs() < 1e-3 * stored.abs().max(1.0), "{stored} {back}");
            assert!((albedo_of_color(color_of_albedo(stored)) - stored).abs() < 1e-2, "{stored}");
        }
        // A value below the other range becomes that range's minimum.
        let darkest = OWN_ALBEDO.to(PUBLISHED, -9.0);
        assert!(darkest.is_finite() && (PUBLISHED.value(darkest) - 0.09).abs() < 1e-5);
        assert_eq!(Code::Plain(255.0).to(Code::Plain(1.0), 51.0), 0.2);
        assert!((f64::from(ALBEDO_RANGE[0]) - 0.01).abs() < 1e-8 && (f64::from(ROUGHNESS_RANGE[1]) - 0.9).abs() < 1e-7);
    }
}
