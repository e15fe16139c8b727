//! Second lighting in which a report shows a run: warm lights at dusk.

use sgs_run::RunLight;
use sgs_scene::Image;

/// Factors of the lights' red, green and blue.
const WARM: [f32; 3] = [1.5, 0.9, 0.45];

/// Factors of the environment map's red, green and blue.
const DUSK: [f32; 3] = [0.12, 0.18, 0.4];

/// Returns the light of a run with warm lights and a dusk environment map.
///
/// Returns `None` if the run has neither lights nor an environment map. Without lights, the environment map is warm.
pub fn light(run: &RunLight) -> Option<RunLight> {
    let mut light = run.clone();
    if light.lights.is_none() && light.environment.is_none() {
        return None;
    }
    // A dusk environment map alone would be too dark.
    let factors = if light.lights.is_some() { DUSK } else { WARM };
    for light in light.lights.iter_mut().flat_map(|file| &mut file.lights) {
        for lobe in &mut light.lobes {
            lobe.amplitude = [0, 1, 2].map(|c| lobe.amplitude[c] * WARM[c]);
        }
    }
    if let Some(environment) = &mut light.environment {
        environment.data.iter_mut().enumerate().for_each(|(i, v)| *v *= factors[i % 3]);
    }
    Some(light)
}

/// Returns the exposure that scales an image to the mean `like`, within 2 stops.
pub fn exposure(relit: &Image, like: f32) -> f32 {
    (like / mean(relit).max(1e-9)).clamp(0.25, 4.0)
}

/// Returns the mean of all finite values.
pub fn mean(image: &Image) -> f32 {
    let finite = image.data.iter().filter(|v| v.is_finite());
    let (sum, count) = finite.fold((0.0_f64, 0.0_f64), |(sum, n), v| (sum + f64::from(*v), n + 1.0));
    (sum / count.max(1.0)) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use sgs_run::{LightFile, LightRow, LobeRow, Visibility};

    #[test]
    fn evening_changes_only_colors() {
        let lobe = LobeRow { axis: [0.0, 0.0, 1.0], sharpness: 1.0, amplitude: [2.0; 3] };
        let row = LightRow { position: [1.0; 3], gain: 3.0, lobes: vec![lobe] };
        let lights = Some(LightFile::new(1.0, vec![row]));
        let run = RunLight { lights, environment: None, visibility: Visibility::None };
        let found = light(&run).expect("light").lights.expect("lights");
        assert_eq!((found.lights[0].gain, found.lights[0].position), (3.0, [1.0; 3]));
        assert_eq!(found.lights[0].lobes[0].amplitude, WARM.map(|v| 2.0 * v));
        let dark = RunLight { lights: None, environment: None, visibility: Visibility::None };
        assert!(light(&dark).is_none());
    }

    #[test]
    fn exposure_is_bounded() {
        let image = |v: f32| Image { width: 2, height: 1, channels: 1, data: vec![v, f32::NAN] };
        assert_eq!(exposure(&image(0.5), 1.0), 2.0);
        assert_eq!((exposure(&image(0.0), 1.0), exposure(&image(9.0), 1.0)), (4.0, 0.25));
    }
}
