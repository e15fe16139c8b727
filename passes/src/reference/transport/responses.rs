//! Reference of the sum of responses and of the emission of Gaussians.

use super::V3;

/// Returns the irradiance of each receiver: the sum over the emitters of color times response.
pub fn response_sum(responses: &[Vec<V3>], colors: &[V3], receivers: usize) -> Vec<V3> {
    let mut all = vec![[0.0; 3]; receivers];
    for (response, color) in responses.iter().zip(colors).filter(|(_, color)| **color != [0.0; 3]) {
        for (sum, r) in all.iter_mut().zip(response) {
            *sum = std::array::from_fn(|c| sum[c] + color[c] * r[c]);
        }
    }
    all
}

/// Returns what each Gaussian emits. Numbers begin at 1; Gaussians of other numbers emit nothing.
pub fn gaussian_emission(numbers: &[u32], radiance: &[V3]) -> Vec<V3> {
    let of = |number: &u32| number.checked_sub(1).and_then(|i| radiance.get(i as usize)).copied();
    numbers.iter().map(|number| of(number).unwrap_or([0.0; 3])).collect()
}

/// Returns the radiosity of direct light: reflectance / pi times irradiance.
pub fn response_source(unit: &[f64], reflectance: &[V3]) -> Vec<V3> {
    unit.iter().zip(reflectance).map(|(e, r)| r.map(|r| r * e / std::f64::consts::PI)).collect()
}

/// Returns the radiosity of each receiver as a radiance: reflectance / pi times direct and bounced irradiance.
///
/// `unit` holds the direct irradiance by each emitter of color 1.
pub fn response_radiosity(unit: &[Vec<f64>], colors: &[V3], irradiance: &[V3], reflectance: &[V3]) -> Vec<V3> {
    let on = || unit.iter().zip(colors).filter(|(_, color)| **color != [0.0; 3]);
    let of = |(i, (e, rho)): (usize, (&V3, &V3))| {
        let all = |c: usize| e[c] + on().map(|(unit, color)| color[c] * unit[i]).sum::<f64>();
        std::array::from_fn(|c| rho[c] / std::f64::consts::PI * all(c))
    };
    irradiance.iter().zip(reflectance).enumerate().map(of).collect()
}
