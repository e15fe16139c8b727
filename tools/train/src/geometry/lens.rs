//! First lens of a scene whose depths a sensor measured.
//!
//! The color camera of a hand-held sensor is often not calibrated to its depth camera: focal lengths differ by a tenth. Gradients
//! of rendered images do not reach that far, because Gaussians soon repeat each photograph with the given lens. The
//! depths are geometry without rendering: a point of a surface has the same color in all views that see it, if the lens
//! is right. The search minimizes the variance of these colors.

use crate::error::Result;
use rayon::prelude::*;
use sgs_scene::{Camera, Image, MaskedMap, Scene};

/// Largest number of views that are compared, spread evenly. It bounds memory and time for long recordings.
const MOST_VIEWS: usize = 48;
/// Points of each view.
const POINTS: usize = 600;
/// Largest relative difference of depths where a view sees a point.
const VISIBLE: f64 = 0.03;
/// Widths of the photographs of each search, coarse to fine.
const WIDTHS: [u32; 3] = [40, 80, 160];
/// Largest logarithm of the factor on focal lengths, and its steps on either side.
const REACH: f64 = 0.25;
const STEPS: i32 = 12;
/// A lens is used if it leaves at most this share of the given lens's variance.
const GAIN: f64 = 0.95;
/// Gray value that is added before logarithms: the step of eight bits, below which a photograph holds nothing.
const DARK: f64 = 1.0 / 255.0;
/// Rounds that separate the exposures of views from the colors of points.
const ROUNDS: usize = 4;
/// Views of a point at least, so that its colors have a variance.
const VIEWS: usize = 2;
/// The lens differs if it explains more than this part of the variance. The exact lens of a
/// rendered room leaves 0.001 unexplained, the given lens of a Kinect 0.1.
const EXPLAINED: f64 = 0.005;
/// Smallest number of sights for which the exposure of a view counts.
const SIGHTS: f64 = 30.0;
/// Exposures differ if the standard deviation of their logarithms is above this.
pub(super) const EXPOSURES: f64 = 0.02;

/// Numbers of a lens that may be wrong.
///
/// They are the logarithm of the factor on focal lengths, the shift of the principal point in given focal lengths, and radial distortion.
pub(super) type Lens = [f64; 4];
/// Largest distortion, as in training.
const DISTORTION: f64 = 0.1;
/// A lens with no number above this is the given one: half a pixel of the finest photographs.
const SAME: f64 = 0.5 / 160.0;

/// Logarithms of a photograph's gray values, so that an exposure is an offset.
struct Gray {
    width: usize,
    height: usize,
    /// Pixels of the photograph along an edge of a cell.
    factor: usize,
    data: Vec<f64>,
}

impl Gray {
    /// Returns the photograph with about `width` columns. Each cell is the mean of its pixels.
    fn of(image: &Image, width: u32) -> Gray {
        let factor = (image.width / width).max(1) as usize;
        let (columns, rows) = (image.width as usize / factor, image.height as usize / factor);
        let gray = |x: usize, y: usize| {
            let at = 3 * (y * image.width as usize + x);
            image.data[at..at + 3].iter().map(|v| f64::from(*v)).sum::<f64>() / 3.0
        };
        let cell = |i: usize| {
            let (x, y) = (i % columns * factor, i / columns * factor);
            let all = (0..factor * factor).map(|k| gray(x + k % factor, y + k / factor));
            (all.sum::<f64>() / (factor * factor) as f64 + DARK).ln()
        };
        Gray { width: columns, height: rows, factor, data: (0..columns * rows).map(cell).collect() }
    }

    /// Returns the value at a position in pixels of the photograph; none outside and beside invalid pixels.
    fn at(&self, x: f64, y: f64) -> Option<f64> {
        let (x, y) = (x / self.factor as f64 - 0.5, y / self.factor as f64 - 0.5);
        let (column, row) = (x.floor(), y.floor());
        let inside = column >= 0.0 && row >= 0.0 && column + 1.0 < self.width as f64 && row + 1.0 < self.height as f64;
        if !inside {
            return None;
        }
        let (fx, fy) = (x - column, y - row);
        let at = row as usize * self.width + column as usize;
        let [a, b] = [at, at + self.width].map(|at| (1.0 - fx) * self.data[at] + fx * self.data[at + 1]);
        Some((1.0 - fy) * a + fy * b).filter(|value| value.is_finite())
    }
}

/// View that sees a point, and the direction to it: x/z and y/z.
struct Sight {
    view: usize,
    slope: [f64; 2],
}

/// What the depths of a sensor show about the photographs.
#[derive(Debug, PartialEq)]
pub(crate) struct SensorFindings {
    /// Lens with which views agree clearly better than with the given one.
    pub lens: Option<Lens>,
    /// Part of the variance of all colors that the lens explains.
    pub explained: f64,
    /// Standard deviation of the logarithms of exposures.
    pub exposures: f64,
}

impl SensorFindings {
    /// Tells whether the lens differs from the given one, or exposures from each other.
    pub fn differs(&self) -> bool {
        self.lens_differs() || self.exposures > EXPOSURES
    }

    /// Tells whether the found lens explains more than noise does.
    pub fn lens_differs(&self) -> bool {
        self.lens.is_some() && self.explained > EXPLAINED
    }
}

/// Finds lens and exposures with which views agree best about points.
///
/// The points are those of the sensor in the training views. The flags say whether to search intrinsics, and whether to search
/// distortion. Returns `None` without a sensor, or if the points say nothing.
pub(super) fn from_depth(scene: &Scene, [intrinsics, distortion]: [bool; 2]) -> Result<Option<SensorFindings>> {
    let train = &scene.split.train;
    let step = train.len().div_ceil(MOST_VIEWS).max(1);
    let read = |&i: &usize| -> Result<Option<(&Camera, MaskedMap, Image)>> {
        let Some(mut depth) = scene.sensor_depth(i)? else { return Ok(None) };
        let mut image = scene.load_image(i)?;
        if let Some(mask) = scene.load_mask(i)? {
            depth.valid.data.iter_mut().zip(&mask.data).for_each(|(known, m)| *known *= m);
            // Not a number, so that no cell with an invalid pixel has a value.
            let invalid = image.data.chunks_exact_mut(3).zip(&mask.data).filter(|(_, m)| **m <= 0.5);
            invalid.for_each(|(color, _)| color.fill(f32::NAN));
        }
        Ok(Some((&scene.views[i].camera, depth, image)))
    };
    let chosen: Vec<usize> = train.iter().copied().step_by(step).collect();
    let views: Vec<Option<_>> = chosen.par_iter().map(read).collect::<Result<_>>()?;
    let views: Vec<_> = views.into_iter().flatten().collect();
    let mut points: Vec<Vec<Sight>> = Vec::new();
    for (camera, depth, _) in &views {
        let known: Vec<usize> = (0..depth.valid.data.len()).filter(|at| depth.valid.data[*at] > 0.0).collect();
        for &at in known.iter().step_by((known.len() / POINTS).max(1)) {
            let pixel = [at % camera.width as usize, at / camera.width as usize].map(|n| n as f64 + 0.5);
            let point = camera.unproject(pixel.into(), f64::from(depth.image.data[at]));
            let sight = |(view, (camera, depth, _)): (usize, &(&Camera, MaskedMap, Image))| {
                let p = camera.rotation * point + camera.translation;
                let pixel = camera.project(point)?;
                let inside = (0.0..f64::from(camera.width)).contains(&pixel.x)
                    && (0.0..f64::from(camera.height)).contains(&pixel.y);
                let at = inside.then(|| pixel.y as usize * camera.width as usize + pixel.x as usize)?;
                let measured = f64::from(depth.image.data[at]);
                let seen = depth.valid.data[at] > 0.0 && (p.z - measured).abs() < VISIBLE * measured;
                seen.then_some(Sight { view, slope: [p.x / p.z, p.y / p.z] })
            };
            let sights: Vec<Sight> = views.iter().enumerate().filter_map(sight).collect();
            if sights.len() >= VIEWS {
                points.push(sights);
            }
        }
    }
    let (cameras, images): (Vec<&Camera>, Vec<Image>) = views.into_iter().map(|(c, _, image)| (c, image)).unzip();
    Ok(search(&points, &cameras, &images, [intrinsics, intrinsics, intrinsics, distortion]))
}

/// Searches the free numbers of the lens on ever finer photographs.
fn search(
    points: &[Vec<Sight>],
    cameras: &[&Camera],
    photographs: &[Image],
    free: [bool; 4],
) -> Option<SensorFindings> {
    let mut best = [0.0; 4];
    let (mut given, mut found) = (Agreement::default(), Agreement::default());
    for width in WIDTHS {
        let images: Vec<Gray> = photographs.iter().map(|image| Gray::of(image, width)).collect();
        let agreement = |lens: &Lens| agreement(points, cameras, &images, lens);
        let cost = |lens: &Lens| agreement(lens).variance;
        if width == WIDTHS[0] && free[0] {
            let grid = (-STEPS..=STEPS).map(|i| [REACH * f64::from(i) / f64::from(STEPS), 0.0, 0.0, 0.0]);
            let costs = grid.map(|lens| (cost(&lens), lens));
            best = costs.min_by(|a, b| a.0.total_cmp(&b.0)).map_or(best, |(_, lens)| lens);
        }
        best = descend(&cost, best, free, 0.8 / f64::from(width));
        (given, found) = (agreement(&[0.0; 4]), agreement(&best));
    }
    let better = found.variance < GAIN * given.variance && best.iter().any(|n| n.abs() > SAME);
    let exposures = if better { found.exposures } else { given.exposures };
    tracing::debug!(
        "lens from depth: {best:?}, disagreement {:.4} instead of {:.4}, exposures {exposures:.4}",
        found.variance,
        given.variance
    );
    given.variance.is_finite().then_some(SensorFindings {
        lens: better.then_some(best),
        explained: given.variance - found.variance,
        exposures,
    })
}

/// Moves one number at a time while that lowers the cost, in ever smaller steps.
fn descend(cost: &dyn Fn(&Lens) -> f64, mut best: Lens, free: [bool; 4], mut step: f64) -> Lens {
    let mut least = cost(&best);
    for _ in 0..6 {
        let mut moved = true;
        while moved {
            moved = false;
            for (i, sign) in (0..4).filter(|i| free[*i]).flat_map(|i| [(i, 1.0), (i, -1.0)]) {
                let mut lens = best;
                lens[i] += sign * step;
                let found =
                    if lens[0].abs() <= REACH && lens[3].abs() <= DISTORTION { cost(&lens) } else { f64::INFINITY };
                if found < least {
                    (best, least, moved) = (lens, found, true);
                }
            }
        }
        step *= 0.5;
    }
    best
}

/// How well views agree about the colors of points.
struct Agreement {
    /// Mean variance of a point's colors, relative to that of all colors. Infinite if the points say nothing.
    ///
    /// Exposures of views are estimated with the colors, and do not count.
    variance: f64,
    /// Standard deviation of the logarithms of exposures.
    exposures: f64,
}

impl Default for Agreement {
    fn default() -> Agreement {
        Agreement { variance: f64::INFINITY, exposures: 0.0 }
    }
}

/// Compares the colors of points between views through a lens.
fn agreement(points: &[Vec<Sight>], cameras: &[&Camera], images: &[Gray], lens: &Lens) -> Agreement {
    let factor = lens[0].exp();
    let look = |Sight { view, slope }: &Sight| {
        let c = cameras[*view];
        let offset = [c.fx * factor * slope[0], c.fy * factor * slope[1]];
        let corner = 0.25 * (f64::from(c.width).powi(2) + f64::from(c.height).powi(2));
        let grown = 1.0 + lens[3] * (offset[0] * offset[0] + offset[1] * offset[1]) / corner;
        images[*view]
            .at(grown * offset[0] + c.fx * lens[1] + c.cx, grown * offset[1] + c.fy * lens[2] + c.cy)
            .map(|value| (*view, value))
    };
    let seen = points.iter().map(|sights| sights.iter().filter_map(look).collect::<Vec<_>>());
    let seen: Vec<Vec<(usize, f64)>> = seen.filter(|values| values.len() >= VIEWS).collect();
    let all = seen.iter().map(Vec::len).sum::<usize>() as f64;
    // Few points say nothing.
    if all < 100.0 {
        return Agreement::default();
    }
    let mut exposures = vec![0.0; cameras.len()];
    let mut left = Vec::new();
    let (mut within, mut total) = (0.0, 0.0);
    for _ in 0..ROUNDS {
        left = vec![(0.0, 0.0); cameras.len()];
        let (mut sum, mut square) = (0.0, 0.0);
        within = 0.0;
        for values in &seen {
            let color = values.iter().map(|(view, value)| value - exposures[*view]).sum::<f64>() / values.len() as f64;
            for (view, value) in values {
                let value = value - exposures[*view];
                within += (value - color).powi(2);
                sum += value;
                square += value * value;
                left[*view].0 += value - color;
                left[*view].1 += 1.0;
            }
        }
        total = square - sum * sum / all;
        exposures.iter_mut().zip(&left).for_each(|(exposure, (sum, count))| *exposure += sum / f64::max(*count, 1.0));
    }
    let variance = total / all;
    // Neither do points of one color.
    if variance < 1e-6 {
        return Agreement::default();
    }
    let counted =
        || exposures.iter().zip(&left).map(|(e, (_, count))| (e, count)).filter(|(_, count)| **count >= SIGHTS);
    let count = counted().map(|(_, count)| count).sum::<f64>().max(1.0);
    let mean = counted().map(|(e, count)| e * count).sum::<f64>() / count;
    let square = counted().map(|(e, count)| (e - mean).powi(2) * count).sum::<f64>() / count;
    Agreement { variance: within / (all - seen.len() as f64) / variance, exposures: square.sqrt() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat3, DVec3};

    /// Color at a point of the wall z = 3.
    fn wall(x: f64, y: f64) -> f64 {
        0.5 + 0.2 * (2.1 * x + 0.4 * y).sin() + 0.2 * (1.7 * y - 0.9 * x).cos() + 0.1 * (5.0 * x * y).sin()
    }

    /// Returns points of the wall, cameras, and their photographs through a lens.
    ///
    /// `change`: growth of the exposure with a camera's x.
    fn captured(lens: &Lens, change: f64) -> (Vec<Vec<Sight>>, Vec<Camera>, Vec<Image>) {
        let cameras: Vec<Camera> = (0..6)
            .map(|i| {
                let angle = 0.1 * f64::from(i) - 0.25;
                let rotation = DMat3::from_rotation_y(angle) * DMat3::from_rotation_x(0.5 * angle);
                let center = DVec3::new(0.3 * f64::from(i) - 0.7, 0.2 * f64::from(i % 3), 0.1 * f64::from(i % 2));
                Camera {
                    name: i.to_string(),
                    width: 160,
                    height: 120,
                    fx: 150.0,
                    fy: 152.0,
                    cx: 81.0,
                    cy: 59.0,
                    rotation,
                    translation: -(rotation * center),
                    near: 0.01,
                }
            })
            .collect();
        let photograph = |c: &Camera| {
            let mut image = Image::new(c.width, c.height, 3);
            let seen = Camera {
                fx: c.fx * lens[0].exp(),
                fy: c.fy * lens[0].exp(),
                cx: c.cx + c.fx * lens[1],
                cy: c.cy + c.fy * lens[2],
                ..c.clone()
            };
            for y in 0..c.height {
                for x in 0..c.width {
                    // The pixel's offset without distortion, by iteration.
                    let away = [f64::from(x) + 0.5 - seen.cx, f64::from(y) + 0.5 - seen.cy];
                    let mut straight = away;
                    for _ in 0..30 {
                        let q = (straight[0].powi(2) + straight[1].powi(2)) / (80.0_f64.powi(2) + 60.0_f64.powi(2));
                        straight = away.map(|a| a / (1.0 + lens[3] * q));
                    }
                    let pixel = [seen.cx + straight[0], seen.cy + straight[1]];
                    let ray = seen.unproject(pixel.into(), 1.0) - c.position();
                    let p = c.position() + ray * (3.0 - c.position().z) / ray.z;
                    let value = wall(p.x, p.y) * (0.8 + change * c.position().x);
                    image.pixel_mut(x, y).fill(value as f32);
                }
            }
            image
        };
        let images = cameras.iter().map(photograph).collect();
        let sights = |i: i32| {
            let point = DVec3::new(f64::from(i % 40) * 0.1 - 2.0, f64::from(i / 40) * 0.1 - 1.5, 3.0);
            let sight = |(view, c): (usize, &Camera)| {
                let p = c.rotation * point + c.translation;
                Sight { view, slope: [p.x / p.z, p.y / p.z] }
            };
            cameras.iter().enumerate().map(sight).collect()
        };
        ((0..1200).map(sights).collect(), cameras, images)
    }

    #[test]
    fn lens_of_photographs_is_found() {
        // The first is about that of a Kinect's color camera.
        for lens in [
            [-0.108, 0.012, -0.02, 0.0],
            [0.15, -0.01, 0.0, 0.0],
            [0.0, 0.0, 0.0, 0.03],
            [-0.05, 0.0, 0.01, -0.025],
            [0.0; 4],
        ] {
            let (points, cameras, images) = captured(&lens, 0.1);
            let exposures: Vec<f64> = cameras.iter().map(|c| (0.8 + 0.1 * c.position().x).ln()).collect();
            let mean = exposures.iter().sum::<f64>() / 6.0;
            let spread = (exposures.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / 6.0).sqrt();
            let cameras: Vec<&Camera> = cameras.iter().collect();
            let found = search(&points, &cameras, &images, [true, true, true, lens[3] != 0.0]);
            let found = found.unwrap();
            // Those of `captured`.
            assert!((found.exposures - spread).abs() < 5e-3 && found.differs(), "{} {spread}", found.exposures);
            if lens == [0.0; 4] {
                assert_eq!(found.lens, None);
                continue;
            }
            // The wall is smooth, so that only other focal lengths change its colors by much.
            assert!(found.lens_differs() || lens[0].abs() < 0.1, "{found:?}");
            let found = found.lens.unwrap();
            println!("{lens:?} {found:?}");
            assert!(lens.iter().zip(found).all(|(a, b)| (a - b).abs() < 4e-3), "{lens:?} {found:?}");
        }
    }

    #[test]
    fn photographs_without_colors_keep_the_lens() {
        let (points, cameras, images) = captured(&[0.1, 0.0, 0.0, 0.0], 0.1);
        let cameras: Vec<&Camera> = cameras.iter().collect();
        let gray: Vec<Image> = images.iter().map(|image| Image::new(image.width, image.height, 3)).collect();
        assert_eq!(search(&points, &cameras, &gray, [true; 4]), None);
        assert_eq!(search(&[], &cameras, &images, [true; 4]), None);
    }

    #[test]
    fn equal_photographs_do_not_differ() {
        let (points, cameras, images) = captured(&[0.0; 4], 0.0);
        let cameras: Vec<&Camera> = cameras.iter().collect();
        let found = search(&points, &cameras, &images, [true; 4]).unwrap();
        assert!(found.exposures < 2e-3 && !found.differs(), "{found:?}");
        // The exposure of a view with few sights does not count. Neither do invalid pixels.
        let mut images = images;
        images[2].data.iter_mut().for_each(|v| *v *= 0.5);
        for x in 0..160 {
            (0..60).for_each(|y| images[4].pixel_mut(x, y).fill(f32::NAN));
        }
        let mut left = 20;
        let few = |sights: &Vec<Sight>| {
            let keep = |s: &&Sight| {
                s.view != 2 || {
                    left -= 1;
                    left >= 0
                }
            };
            sights.iter().filter(keep).map(|s| Sight { view: s.view, slope: s.slope }).collect()
        };
        let sparse: Vec<Vec<Sight>> = points.iter().map(few).collect();
        let found = search(&sparse, &cameras, &images, [true; 4]).unwrap();
        assert!(found.exposures < 2e-3 && !found.differs(), "{found:?}");
        let all = search(&points, &cameras, &images, [true; 4]).unwrap();
        assert!(all.exposures > 0.1 && all.differs(), "{all:?}");
    }
}
