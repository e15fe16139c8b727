//! Ray intersection with the whole scene: triangles and lights.

use glam::Vec3;

use crate::scene::Scene;
use crate::scene::surfaces::SurfaceHit;

/// Nearest intersection of a ray.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Hit {
    /// Triangle.
    Surface(SurfaceHit),
    /// Light: its index, the distance, and true if the ray hit the emitting side.
    Light(usize, f32, bool),
}

/// Light chosen for a point: its index and the probability of the choice.
pub(crate) type Choice = (usize, f32);

impl Scene {
    /// Returns the nearest intersection of a ray.
    pub(crate) fn hit(&self, origin: Vec3, direction: Vec3) -> Option<Hit> {
        let mut limit = f32::INFINITY;
        let mut found = None;
        for (index, light) in self.lights.iter().enumerate() {
            if let Some((t, front)) = light.intersect(origin, direction, limit) {
                limit = t;
                found = Some(Hit::Light(index, t, front));
            }
        }
        match self.surfaces.closest(origin, direction, limit) {
            Some(hit) => Some(Hit::Surface(hit)),
            None => found,
        }
    }

    /// Returns true if no occluder lies between a point and a point of a light.
    pub(crate) fn sees(&self, origin: Vec3, direction: Vec3, distance: f32, light: usize) -> bool {
        let limit = distance * (1.0 - 1e-4) - 1e-4;
        let others = self.lights.iter().enumerate();
        !others
            .filter(|(index, _)| *index != light)
            .any(|(_, other)| other.intersect(origin, direction, limit).is_some())
            && !self.surfaces.occluded(origin, direction, limit)
    }

    /// Chooses a light in proportion to its estimated contribution.
    pub(crate) fn choose_light(&self, from: Vec3, normal: Vec3, random: f32) -> Option<Choice> {
        let mut weights = [0.0f32; MAX_WEIGHED];
        let total = self.weigh(from, normal, &mut weights);
        if total <= 0.0 {
            return None;
        }
        let mut rest = random * total;
        let mut last = None;
        for (index, weight) in weights.iter().take(self.lights.len()).enumerate() {
            if *weight > 0.0 {
                last = Some((index, weight / total));
                if rest < *weight {
                    break;
                }
                rest -= weight;
            }
        }
        last
    }

    /// Returns the probability that [`Scene::choose_light`] chooses a light.
    pub(crate) fn choice_probability(&self, from: Vec3, normal: Vec3, light: usize) -> f32 {
        let mut weights = [0.0f32; MAX_WEIGHED];
        let total = self.weigh(from, normal, &mut weights);
        match weights.get(light) {
            Some(weight) if total > 0.0 => weight / total,
            _ => 0.0,
        }
    }

    fn weigh(&self, from: Vec3, normal: Vec3, weights: &mut [f32; MAX_WEIGHED]) -> f32 {
        self.lights
            .iter()
            .zip(weights.iter_mut())
            .map(|(light, weight)| {
                *weight = light.importance(from, normal, &self.sky);
                *weight
            })
            .sum()
    }
}

/// Largest number of weighted lights; rooms have far fewer. A bound keeps the weights on the stack.
const MAX_WEIGHED: usize = 16;
