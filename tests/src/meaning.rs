//! Semantic priors of the tiny room: every wall is a class and a region.

use crate::rooms::Room;
use half::f16;
use sgs_passes::reference::rng::Pcg;
use sgs_passes::scene::EMBEDDING;
use sgs_scene::{write_ids, write_npy_f16, write_npy_f32};
use std::path::Path;

/// Names of the classes.
pub const WALLS: [&str; 6] = ["right", "left", "floor", "ceiling", "back", "front"];

/// Semantic priors to write.
#[derive(Clone, Copy, Debug)]
pub struct Meaning {
    /// Distance of neighboring samples of the maps, in pixels.
    pub stride: u32,
    /// Fraction of samples with a wrong class.
    pub wrong: f64,
    /// Whether to write masks of the walls; their ids differ from the classes.
    pub masks: bool,
    /// Whether to write ground truth.
    pub truth: bool,
}

impl Default for Meaning {
    fn default() -> Self {
        Meaning { stride: 4, wrong: 0.0, masks: false, truth: true }
    }
}

impl Meaning {
    /// Adds the priors to a scene directory that `room` has written.
    pub fn write(&self, room: &Room, root: &Path) {
        let mut rng = Pcg::new(5);
        // Text embeddings share a common direction, like the embeddings of a language model.
        let common: Vec<f64> = (0..EMBEDDING).map(|_| rng.normal()).collect();
        let texts: Vec<Vec<f64>> =
            WALLS.iter().map(|_| common.iter().map(|c| c + 0.8 * rng.normal()).collect()).collect();
        for folder in ["priors/semantic", "priors/masks", "gt/semantic"] {
            std::fs::create_dir_all(root.join(folder)).unwrap();
        }
        let flat: Vec<f32> = texts.iter().flatten().map(|&x| x as f32).collect();
        write_npy_f32(&root.join("priors/semantic/text_embeddings.npy"), &[WALLS.len(), EMBEDDING], &flat).unwrap();
        let labels = serde_json::json!({"labels": WALLS}).to_string();
        std::fs::write(root.join("priors/semantic/labels.json"), labels).unwrap();
        let (train, _) = room.split();
        for camera in room.cameras() {
            let [w, h] = [camera.width, camera.height];
            let walls = room.walls(&camera);
            let name = &camera.name;
            if self.truth {
                let ids: Vec<u16> = walls.iter().map(|&c| c as u16).collect();
                write_ids(&root.join(format!("gt/semantic/{name}.png")), w, h, &ids).unwrap();
            }
            if !train.contains(name) {
                continue;
            }
            let [across, down] = [w.div_ceil(self.stride), h.div_ceil(self.stride)];
            let mut features = Vec::new();
            for y in 0..down {
                for x in 0..across {
                    let at = |i: u32, n: u32, size: u32| (i * (size - 1) + (n - 1) / 2) / (n - 1).max(1);
                    let mut class = walls[(at(y, down, h) * w + at(x, across, w)) as usize];
                    if f64::from(rng.next_u32()) < self.wrong * 2.0_f64.powi(32) {
                        class = (class + 1 + rng.next_u32() as usize % (WALLS.len() - 1)) % WALLS.len();
                    }
                    features.extend(texts[class].iter().map(|t| f16::from_f64(0.2 * (t + 0.3 * rng.normal()))));
                }
            }
            let shape = [down as usize, across as usize, EMBEDDING];
            write_npy_f16(&root.join(format!("priors/semantic/{name}.npy")), &shape, &features).unwrap();
            if self.masks {
                let ids: Vec<u16> = walls.iter().map(|&c| 100 + 7 * c as u16).collect();
                write_ids(&root.join(format!("priors/masks/{name}.png")), w, h, &ids).unwrap();
            }
        }
    }
}
