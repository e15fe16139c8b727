//! Reference of `adam`: one Adam step for one scalar.

/// Maximum magnitude of gradients, which are clamped as in the kernel. In the kernel the square must fit in 32 bits.
pub const LARGEST: f64 = 1e15;

/// Constants of a step.
#[derive(Clone, Copy, Debug)]
pub struct Rates {
    /// Learning rate.
    pub lr: f64,
    /// Bias correction of the first moment, 1 / (1 - 0.9^t).
    pub correction1: f64,
    /// Bias correction of the second moment, 1 / (1 - 0.999^t).
    pub correction2: f64,
}

impl Rates {
    /// Returns the constants of step `t`, counted from 1.
    pub fn at(lr: f64, t: u32) -> Self {
        let correction = |beta: f64| 1.0 / (1.0 - beta.powi(t as i32));
        Rates { lr, correction1: correction(0.9), correction2: correction(0.999) }
    }
}

/// Returns the parameter and the moments after one step. Kingma and Ba 2015, algorithm 1, epsilon 1e-15. A gradient
/// that is not finite changes nothing.
pub fn adam(parameter: f64, moments: [f64; 2], gradient: f64, rates: Rates) -> (f64, [f64; 2]) {
    adam_with(parameter, moments, gradient, rates, 1e-15)
}

/// Returns the result of [`adam`] with a given epsilon.
pub fn adam_with(parameter: f64, [m, v]: [f64; 2], gradient: f64, rates: Rates, epsilon: f64) -> (f64, [f64; 2]) {
    if !gradient.is_finite() {
        return (parameter, [m, v]);
    }
    let g = gradient.clamp(-LARGEST, LARGEST);
    let (m, v) = (0.9 * m + 0.1 * g, 0.999 * v + 0.001 * g * g);
    let (unbiased_m, unbiased_v) = (m * rates.correction1, v * rates.correction2);
    (parameter - rates.lr * unbiased_m / (unbiased_v.sqrt() + epsilon), [m, v])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_step_equals_the_learning_rate_for_any_gradient() {
        for g in [1e-9, -3.0, 1e12, -1e30] {
            let (p, _) = adam(1.0, [0.0; 2], g, Rates::at(0.01, 1));
            assert!((p - (1.0 - 0.01 * g.signum())).abs() < 1e-6, "{g}: {p}");
        }
    }

    #[test]
    fn quadratic_is_minimized() {
        let (mut x, mut moments) = (3.0, [0.0; 2]);
        for t in 1..=2000 {
            (x, moments) = adam(x, moments, 2.0 * (x - 1.0), Rates::at(0.01, t));
        }
        assert!((x - 1.0).abs() < 1e-3, "{x}");
    }

    #[test]
    fn non_finite_gradients_change_nothing() {
        assert_eq!(adam(2.0, [1.0, 3.0], f64::NAN, Rates::at(0.1, 5)), (2.0, [1.0, 3.0]));
        assert_eq!(adam(2.0, [1.0, 3.0], f64::INFINITY, Rates::at(0.1, 5)), (2.0, [1.0, 3.0]));
    }
}
