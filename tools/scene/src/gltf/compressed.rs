//! Splats as SPZ inside glTF.
//!
//! The axes of SPZ are right, up, back, those of glTF left, up, front. So the data are half a turn about y apart, as the
//! extension demands.

use crate::error::Result;
use crate::splats::{SplatFile, Splats};
use crate::spz::{SpzVersion, spz_of_bytes, spz_to_bytes};

/// Signs of the harmonics of each band after half a turn about y.
///
/// A coefficient changes its sign if its function is odd in x and z together.
const SIGNS: [&[f32]; 3] = [&[1.0, -1.0, -1.0], &[-1.0, -1.0, 1.0, 1.0, 1.0], &[1.0, 1.0, 1.0, -1.0, -1.0, -1.0, -1.0]];

/// Returns splats as SPZ of version 2, which readers of all later versions accept.
///
/// # Errors
/// Fails if a position does not fit.
pub(super) fn packed(splats: &Splats) -> Result<Vec<u8>> {
    spz_to_bytes(&turned(splats.clone()), SpzVersion::V2)
}

/// Returns the splats of an SPZ payload in the axes of glTF.
///
/// # Errors
/// Describes what is damaged.
pub(super) fn unpacked(bytes: &[u8]) -> std::result::Result<SplatFile, String> {
    let file = spz_of_bytes(bytes)?;
    Ok(SplatFile { splats: turned(file.splats), ..file })
}

/// Turns splats by half a turn about y. Normals stay, because SPZ has none.
fn turned(mut splats: Splats) -> Splats {
    splats.means.iter_mut().for_each(|[x, _, z]| (*x, *z) = (-*x, -*z));
    // The half turn from both sides leaves the axes of the ellipsoid, which have no direction, where they belong.
    splats.rotations.iter_mut().for_each(|[_, x, _, z]| (*x, *z) = (-*x, -*z));
    for (values, signs) in splats.sh[1..].iter_mut().zip(SIGNS) {
        let all = signs.iter().flat_map(|sign| [*sign; 3]).cycle();
        values.iter_mut().zip(all).for_each(|(v, sign)| *v *= sign);
    }
    splats
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::splats::tests::waves;

    #[test]
    fn turn_is_its_own_inverse() {
        let splats = waves(20, 3);
        let once = turned(splats.clone());
        assert_ne!(once, splats);
        assert_eq!(turned(once), splats);
    }

    /// Compares with the functions of 3DGS at a direction and at the turned direction.
    #[test]
    fn turned_harmonics_have_the_value_of_the_turned_direction() {
        // Without their factors, which the turn leaves.
        let functions = |[x, y, z]: [f32; 3]| -> [Vec<f32>; 3] {
            let (xx, yy, zz) = (x * x, y * y, z * z);
            [
                vec![y, z, x],
                vec![x * y, y * z, 2.0 * zz - xx - yy, x * z, xx - yy],
                vec![
                    y * (3.0 * xx - yy),
                    x * y * z,
                    y * (4.0 * zz - xx - yy),
                    z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
                    x * (4.0 * zz - xx - yy),
                    z * (xx - yy),
                    x * (xx - 3.0 * yy),
                ],
            ]
        };
        let splats = waves(6, 3);
        let after = turned(splats.clone());
        let [x, y, z] = [0.36, -0.48, 0.8_f32];
        let (there, here) = (functions([-x, y, -z]), functions([x, y, z]));
        for band in 0..3 {
            let value = |values: &[f32], at: &[f32]| -> f32 { values.chunks(3).zip(at).map(|(v, f)| v[0] * f).sum() };
            let wide = 3 * here[band].len();
            for (a, b) in splats.sh[band + 1].chunks(wide).zip(after.sh[band + 1].chunks(wide)) {
                let (before, turned) = (value(a, &here[band]), value(b, &there[band]));
                assert!((before - turned).abs() < 1e-6, "band {}: {before} {turned}", band + 1);
            }
        }
    }
}
