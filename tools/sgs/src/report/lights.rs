//! Contribution and color of each light of a run.

use glam::DVec3;
use sgs_engine::Device;
use sgs_report::room::{Eye, LightMark};
use sgs_report::{escape, number};
use sgs_run::{LightFile, RunLight, Shading, shaded_scene};
use sgs_scene::{Camera, Scene, Splats, linear_to_srgb};

/// Width of the images that measure the lights, in pixels.
const WIDTH: u32 = 64;
/// Approximate number of views that measure the lights.
const VIEWS: usize = 3;

/// Lights of a run, brightest first.
pub struct LightTable {
    file: LightFile,
    /// Index of each light, and the mean linear RGB that it contributes over the views.
    sums: Vec<(usize, [f64; 3])>,
    total: f64,
}

/// Returns the luminance of linear RGB with the weights of Rec. 709.
pub fn luminance([r, g, b]: [f64; 3]) -> f64 {
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

impl LightTable {
    /// Measures the lights of a run in small images of a few views. Empty if the run has no lights.
    pub fn measure(
        device: &Device,
        scene: &Scene,
        splats: &Splats,
        light: &RunLight,
        views: &[usize],
    ) -> anyhow::Result<LightTable> {
        let Some(file) = light.lights.clone().filter(|_| splats.albedo.is_some() && splats.roughness.is_some()) else {
            return Ok(LightTable { file: LightFile::new(1.0, Vec::new()), sums: Vec::new(), total: 0.0 });
        };
        let all = shaded_scene(device, splats, Some(&file), None, &light.visibility)?;
        let mut shading = Shading::new(device, all)?.without_visibility();
        let every = views.len().div_ceil(VIEWS).max(1);
        let cameras: Vec<Camera> = views.iter().step_by(every).map(|v| small(&scene.views[*v].camera)).collect();
        let (mut sums, mut pixels) = (vec![[0.0; 3]; file.lights.len()], 0);
        for camera in &cameras {
            for (i, sum) in sums.iter_mut().enumerate() {
                shading.set_gains(device, &alone(&file, &[i]))?;
                for pixel in shading.direct(camera)?.data.chunks_exact(3) {
                    sum.iter_mut().zip(pixel).for_each(|(s, v)| *s += f64::from(*v));
                }
            }
            pixels += camera.width * camera.height;
        }
        let mean = |(i, sum): (usize, [f64; 3])| (i, sum.map(|s| s / f64::from(pixels.max(1))));
        let mut sums: Vec<(usize, [f64; 3])> = sums.into_iter().enumerate().map(mean).collect();
        sums.sort_by(|a, b| luminance(b.1).total_cmp(&luminance(a.1)));
        let total = sums.iter().map(|(_, s)| luminance(*s)).sum();
        Ok(LightTable { file, sums, total })
    }

    fn share(&self, sum: [f64; 3]) -> f64 {
        luminance(sum) / self.total.max(1e-30)
    }

    /// Returns the name and the gains of each of the `most` brightest lights.
    ///
    /// The gains switch off all other lights. A last entry combines the remaining lights, if any.
    pub fn brightest(&self, most: usize) -> Vec<(String, Vec<f32>)> {
        let percent = |share: f64| format!("{:.1} %", 100.0 * share);
        let one =
            |(i, s): &(usize, [f64; 3])| (format!("light {i} ({})", percent(self.share(*s))), alone(&self.file, &[*i]));
        let mut out: Vec<_> = self.sums.iter().take(most).map(one).collect();
        if self.sums.len() > most && most > 0 {
            let rest = &self.sums[most..];
            let numbers: Vec<usize> = rest.iter().map(|(i, _)| *i).collect();
            let share = rest.iter().map(|(_, s)| self.share(*s)).sum();
            out.push((format!("{} others ({})", rest.len(), percent(share)), alone(&self.file, &numbers)));
        }
        out
    }

    /// Returns the lights as the drawing of the room expects them.
    pub fn rows(&self) -> Vec<LightMark> {
        let row = |(i, sum): &(usize, [f64; 3])| LightMark {
            name: i.to_string(),
            position: DVec3::from(self.file.lights[*i].position.map(f64::from)),
            share: self.share(*sum),
            color: color(*sum),
        };
        self.sums.iter().map(row).collect()
    }

    /// Returns an HTML table of every light: position, share of the light, color, gain and number of lobes.
    pub fn table(&self) -> String {
        let mut out = String::from(
            "<details><summary>All lights</summary><div class=\"wide\"><table>\n<thead><tr><th>light</th><th>share</th>\
             <th>color</th><th>x</th><th>y</th><th>z</th><th>gain</th><th>lobes</th></tr></thead>\n<tbody>\n",
        );
        for (i, sum) in &self.sums {
            let light = &self.file.lights[*i];
            let [x, y, z] = light.position.map(|v| number(f64::from(v)));
            let share = 100.0 * self.share(*sum);
            out.push_str(&format!(
                "<tr><th>{i}</th><td>{share:.1} %</td><td><span class=\"swatch\" style=\"background:{}\"></span></td><td>{x}</td>\
                 <td>{y}</td><td>{z}</td><td>{}</td><td>{}</td></tr>\n",
                escape(&color(*sum)),
                number(f64::from(light.gain)),
                light.lobes.len()
            ));
        }
        out.push_str("</tbody></table></div></details>\n");
        out
    }
}

/// Returns gains that switch off all lights except `on`.
fn alone(file: &LightFile, on: &[usize]) -> Vec<f32> {
    file.lights.iter().enumerate().map(|(i, l)| if on.contains(&i) { l.gain } else { 0.0 }).collect()
}

/// Returns linear RGB as an HTML color, scaled to full brightness.
pub fn color(sum: [f64; 3]) -> String {
    let most = sum.iter().fold(1e-30, |m: f64, v| m.max(*v));
    let [r, g, b] = sum.map(|v| (linear_to_srgb((v / most) as f32) * 255.0 + 0.5) as u8);
    crate::palette::hex([r, g, b])
}

fn small(camera: &Camera) -> Camera {
    let width = camera.width.min(WIDTH);
    let height = u64::from(camera.height) * u64::from(width) / u64::from(camera.width.max(1));
    camera.scaled(width, (height as u32).max(1))
}

/// Returns a camera as the drawing of the room expects it.
pub fn eye(camera: &Camera) -> Eye {
    Eye { position: camera.position(), forward: camera.forward(), up: -(camera.rotation.transpose() * DVec3::Y) }
}

/// Returns the centers of Gaussians whose opacity exceeds 0.5.
pub fn opaque(splats: &Splats) -> Vec<[f32; 3]> {
    let shows = splats.means.iter().zip(&splats.opacity_logits).filter(|(_, logit)| **logit > 0.0);
    shows.map(|(mean, _)| *mean).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use sgs_run::LightRow;

    #[test]
    fn brightest_lights_come_first_and_the_rest_are_combined() {
        let light = |gain| LightRow { position: [0.0; 3], gain, lobes: Vec::new() };
        let file = LightFile::new(1.0, vec![light(1.0), light(2.0), light(3.0), light(4.0)]);
        let sums = vec![(2, [5.0; 3]), (0, [3.0; 3]), (3, [1.5; 3]), (1, [0.5; 3])];
        let light_table = LightTable { file, sums, total: 10.0 };
        let found = light_table.brightest(2);
        let names: Vec<&str> = found.iter().map(|(n, _)| n.as_str()).collect();
        assert_eq!(names, ["light 2 (50.0 %)", "light 0 (30.0 %)", "2 others (20.0 %)"]);
        assert_eq!((&found[0].1, &found[2].1), (&vec![0.0, 0.0, 3.0, 0.0], &vec![0.0, 2.0, 0.0, 4.0]));
        assert!(light_table.brightest(0).is_empty() && light_table.brightest(4).len() == 4);
        assert_eq!(color([0.5, 0.25, 0.0]), "#ffbc00");
    }
}
