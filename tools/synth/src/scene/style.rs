//! Styles of the named rooms: lights and surface properties.

use glam::Vec3;

use crate::options::SceneName;

/// Emission of the windows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Windows {
    /// No windows.
    None,
    /// Panes that emit evenly.
    Panes,
    /// Openings onto an environment map.
    Open,
}

/// Style of a room. Strengths are relative, because exposure is set later from rendered views.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Style {
    /// Emission of the windows.
    pub(crate) windows: Windows,
    /// Radiance of the panes.
    pub(crate) daylight: Vec3,
    /// Intensities (radiance × projected area) of floor, ceiling and table lamp.
    ///
    /// Zero leaves a lamp unlit.
    pub(crate) lamps: [Vec3; 3],
    /// Scale of the dielectric reflectance. Zero also turns metals into dielectrics.
    pub(crate) specular: f32,
    /// Enables a mirror on the wall, a glossy floor and polished metal.
    pub(crate) polished: bool,
}

impl Style {
    /// Returns the style of a named room.
    pub(crate) fn of(name: SceneName) -> Self {
        let day = Self {
            windows: Windows::Panes,
            daylight: Vec3::new(2.0, 2.3, 2.7),
            lamps: [Vec3::new(2.0, 1.5, 0.95), Vec3::new(1.5, 1.22, 0.9), Vec3::new(1.1, 0.74, 0.42)],
            specular: 1.0,
            polished: false,
        };
        match name {
            SceneName::LivingRoom | SceneName::Box => day,
            SceneName::Diffuse => Self {
                windows: Windows::None,
                lamps: [Vec3::ZERO, Vec3::new(4.0, 3.6, 3.1), Vec3::ZERO],
                specular: 0.0,
                ..day
            },
            SceneName::Mirror => Self { polished: true, ..day },
            SceneName::EnvOnly => Self { windows: Windows::Open, lamps: [Vec3::ZERO; 3], ..day },
            SceneName::Night => Self {
                daylight: Vec3::new(0.05, 0.08, 0.16),
                lamps: [Vec3::new(2.4, 1.1, 0.5), Vec3::new(0.55, 0.5, 0.65), Vec3::new(0.5, 0.75, 1.7)],
                ..day
            },
        }
    }
}
