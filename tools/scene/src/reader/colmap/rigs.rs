//! Rigs and frames of COLMAP 3.12 and later.
//!
//! A rig holds the poses of its sensors; a frame places a rig in the world and lists the images that the sensors took.
//! The pose of an image is the sensor's pose in the rig after the frame's pose. COLMAP also writes it with the image and
//! ignores that copy when it reads, so frames that were edited or aligned count.

use std::collections::HashMap;

use glam::{DQuat, DVec3};

use super::text::{Words, lines, read_text};
use super::{ImageRow, Location, binary};
use crate::error::{Result, SceneError};

/// Kind of a camera among the sensors.
const CAMERA: i32 = 0;

/// Rotation and translation into a sensor or rig.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Pose {
    /// Quaternion `(w, x, y, z)`.
    rotation: [f64; 4],
    translation: [f64; 3],
}

impl Pose {
    const IDENTITY: Pose = Pose { rotation: [1.0, 0.0, 0.0, 0.0], translation: [0.0; 3] };

    /// Returns the pose after `first`; `None` if a quaternion has no direction.
    fn after(&self, first: &Pose) -> Option<Pose> {
        let unit = |[w, x, y, z]: [f64; 4]| {
            let length = (w * w + x * x + y * y + z * z).sqrt();
            (length > 0.0 && length.is_finite())
                .then(|| DQuat::from_xyzw(x / length, y / length, z / length, w / length))
        };
        let (outer, inner) = (unit(self.rotation)?, unit(first.rotation)?);
        let turned = outer * inner;
        let moved = outer * DVec3::from_array(first.translation) + DVec3::from_array(self.translation);
        Some(Pose { rotation: [turned.w, turned.x, turned.y, turned.z], translation: moved.to_array() })
    }
}

/// Rig: poses of its sensors by kind and id; `None` for a pose that is not known.
type Rig = HashMap<(i32, u32), Option<Pose>>;

/// Frame: the pose of a rig and the images of its cameras.
#[derive(Debug)]
struct FrameRow {
    id: u32,
    rig: u32,
    pose: Pose,
    /// Camera and image.
    images: Vec<(u32, u64)>,
}

/// Places images by the frames of a model, if it has any.
pub(super) fn place(location: &Location, images: &mut [ImageRow]) -> Result<()> {
    let (rigs_path, frames_path) = (location.file("rigs"), location.file("frames"));
    if !rigs_path.is_file() || !frames_path.is_file() {
        return Ok(());
    }
    let (rigs, frames) = if location.binary {
        (rigs_of_binary(location)?, frames_of_binary(location)?)
    } else {
        (rigs_of_text(location)?, frames_of_text(location)?)
    };
    let mut poses = HashMap::new();
    for frame in frames {
        let fail = |problem: String| SceneError::cameras(&frames_path, format!("frame {}", frame.id), problem);
        let Some(rig) = rigs.get(&frame.rig) else {
            return Err(fail(format!("the frame has the rig {}, which {} lacks", frame.rig, rigs_path.display())));
        };
        for (camera, image) in frame.images {
            // Cameras without a known pose keep the pose of the image.
            let Some(Some(sensor)) = rig.get(&(CAMERA, camera)) else { continue };
            let pose = sensor.after(&frame.pose);
            let pose = pose.ok_or_else(|| fail("a rotation is no quaternion; export the model again".into()))?;
            poses.insert(image, pose);
        }
    }
    for image in images {
        if let Some(pose) = poses.get(&u64::from(image.id)) {
            (image.rotation, image.translation) = (pose.rotation, pose.translation);
        }
    }
    Ok(())
}

fn rigs_of_binary(location: &Location) -> Result<HashMap<u32, Rig>> {
    binary::with_file(&location.file("rigs"), |bytes| {
        let mut rigs = HashMap::new();
        for _ in 0..bytes.count(8)? {
            let (id, sensors) = (bytes.u32()?, bytes.u32()?);
            let mut rig = Rig::new();
            for index in 0..sensors {
                let sensor = (i32::from_le_bytes(bytes.word()?), bytes.u32()?);
                let pose = match index {
                    0 => Some(Pose::IDENTITY),
                    _ if bytes.word::<1>()? == [0] => None,
                    _ => Some(Pose { rotation: bytes.f64()?, translation: bytes.f64()? }),
                };
                rig.insert(sensor, pose);
            }
            rigs.insert(id, rig);
        }
        Ok(rigs)
    })
}

fn frames_of_binary(location: &Location) -> Result<Vec<FrameRow>> {
    binary::with_file(&location.file("frames"), |bytes| {
        let mut frames = Vec::new();
        for _ in 0..bytes.count(68)? {
            let (id, rig) = (bytes.u32()?, bytes.u32()?);
            let pose = Pose { rotation: bytes.f64()?, translation: bytes.f64()? };
            let mut images = Vec::new();
            for _ in 0..bytes.u32()? {
                let (kind, sensor, data) = (i32::from_le_bytes(bytes.word()?), bytes.u32()?, bytes.u64()?);
                if kind == CAMERA {
                    images.push((sensor, data));
                }
            }
            frames.push(FrameRow { id, rig, pose, images });
        }
        Ok(frames)
    })
}

/// Reads the kind and id of a sensor.
fn sensor(words: &mut Words) -> Result<(i32, u32)> {
    let kind = match words.word("the kind of a sensor")? {
        "CAMERA" => CAMERA,
        "IMU" => 1,
        _ => -1,
    };
    Ok((kind, words.number("id of a sensor")?))
}

fn pose(words: &mut Words) -> Result<Pose> {
    Ok(Pose { rotation: words.numbers("part of a quaternion")?, translation: words.numbers("part of a translation")? })
}

fn rigs_of_text(location: &Location) -> Result<HashMap<u32, Rig>> {
    let path = location.file("rigs");
    let text = read_text(&path)?;
    let mut rigs = HashMap::new();
    for (line, content) in lines(&text) {
        let mut words = Words::new(&path, line, content);
        let (id, sensors) = (words.number("rig number")?, words.number::<u32>("number of sensors")?);
        let mut rig = Rig::new();
        for index in 0..sensors {
            let sensor = sensor(&mut words)?;
            let known = index == 0 || words.number::<u8>("mark of a known pose, 0 or 1")? != 0;
            let pose = match (index, known) {
                (0, _) => Some(Pose::IDENTITY),
                (_, false) => None,
                (_, true) => Some(pose(&mut words)?),
            };
            rig.insert(sensor, pose);
        }
        rigs.insert(id, rig);
    }
    Ok(rigs)
}

fn frames_of_text(location: &Location) -> Result<Vec<FrameRow>> {
    let path = location.file("frames");
    let text = read_text(&path)?;
    let mut frames = Vec::new();
    for (line, content) in lines(&text) {
        let mut words = Words::new(&path, line, content);
        let (id, rig) = (words.number("frame number")?, words.number("rig number")?);
        let pose = pose(&mut words)?;
        let mut images = Vec::new();
        for _ in 0..words.number::<u32>("number of images")? {
            let (kind, sensor) = sensor(&mut words)?;
            let data = words.number("image number")?;
            if kind == CAMERA {
                images.push((sensor, data));
            }
        }
        frames.push(FrameRow { id, rig, pose, images });
    }
    Ok(frames)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    /// A stereo rig: the second camera is 0.5 to the right of the first, turned by a quarter about the vertical axis.
    const RIGS: &str = "# rigs\n1 3 CAMERA 7 CAMERA 8 1 0.7071067811865476 0 0.7071067811865476 0 -0.5 0 0 IMU 3 0\n";
    const FRAMES: &str = "4 1 0.7071067811865476 0.7071067811865476 0 0 1 2 3 3 CAMERA 7 10 CAMERA 8 11 IMU 3 12\n";

    fn binary() -> [(&'static str, Vec<u8>); 2] {
        let half = 0.5_f64.sqrt();
        let f64s = |values: [f64; 7]| values.map(f64::to_le_bytes).concat();
        let u32s = |values: &[u32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        let one = 1_u64.to_le_bytes().to_vec();
        let second = f64s([half, 0.0, half, 0.0, -0.5, 0.0, 0.0]);
        let rigs = [&one[..], &u32s(&[1, 3, 0, 7, 0, 8]), &[1], &second, &u32s(&[1, 3]), &[0]].concat();
        let data = |kind: u32, sensor: u32, id: u64| [u32s(&[kind, sensor]), id.to_le_bytes().to_vec()].concat();
        let pose = f64s([half, half, 0.0, 0.0, 1.0, 2.0, 3.0]);
        let all = [data(0, 7, 10), data(0, 8, 11), data(1, 3, 12)].concat();
        let frames = [&one[..], &u32s(&[4, 1]), &pose, &u32s(&[3]), &all].concat();
        [("rigs.bin", rigs), ("frames.bin", frames)]
    }

    fn images() -> Vec<ImageRow> {
        let row = |id| ImageRow {
            id,
            rotation: [1.0, 0.0, 0.0, 0.0],
            translation: [9.0; 3],
            camera: 7,
            name: id.to_string(),
            place: String::new(),
        };
        [10, 11, 12].map(row).into()
    }

    fn put(folder: &Path, files: &[(&str, Vec<u8>)]) -> Location {
        files.iter().for_each(|(name, bytes)| std::fs::write(folder.join(name), bytes).unwrap());
        Location { folder: folder.to_owned(), binary: files[0].0.ends_with("bin") }
    }

    #[test]
    fn frames_place_the_images_of_a_rig() {
        let text = [("rigs.txt", RIGS.as_bytes().to_vec()), ("frames.txt", FRAMES.as_bytes().to_vec())];
        for files in [binary(), text] {
            let directory = tempfile::tempdir().unwrap();
            let location = put(directory.path(), &files);
            let mut rows = images();
            place(&location, &mut rows).unwrap();
            let close = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12);
            let half = 0.5_f64.sqrt();
            assert!(close(&rows[0].rotation, &[half, half, 0.0, 0.0]) && close(&rows[0].translation, &[1.0, 2.0, 3.0]));
            // A quarter about y after a quarter about x; (1, 2, 3) is turned to (3, 2, -1) and shifted.
            assert!(close(&rows[1].rotation, &[0.5, 0.5, 0.5, -0.5]), "{:?}", rows[1]);
            assert!(close(&rows[1].translation, &[2.5, 2.0, -1.0]), "{:?}", rows[1]);
            assert_eq!(rows[2], images()[2], "image 12 belongs to another sensor");
            std::fs::remove_file(directory.path().join(files[0].0)).unwrap();
            place(&location, &mut rows).unwrap();
        }
    }

    #[test]
    fn damaged_files_cause_errors_and_never_panics() {
        let directory = tempfile::tempdir().unwrap();
        let location = put(directory.path(), &binary());
        let at = |name: &str| directory.path().join(name);
        for (name, content) in binary() {
            for length in 0..content.len() {
                std::fs::write(at(name), &content[..length]).unwrap();
                let error = place(&location, &mut images()).unwrap_err().to_string();
                assert!(error.contains(name), "{error}");
            }
            for i in 0..content.len() {
                let mut damaged = content.clone();
                damaged[i] ^= 0xff;
                std::fs::write(at(name), &damaged).unwrap();
                let _ = place(&location, &mut images());
            }
            std::fs::write(at(name), &content).unwrap();
        }
        let fail = |name: &str, content: &str| {
            let text = [("rigs.txt", RIGS.as_bytes().to_vec()), ("frames.txt", FRAMES.as_bytes().to_vec())];
            let location = put(directory.path(), &text);
            std::fs::write(at(name), content).unwrap();
            place(&location, &mut images()).unwrap_err().to_string()
        };
        assert!(
            fail("rigs.txt", "1 2 CAMERA 7").contains("rigs.txt, line 1: the line ends before the kind of a sensor")
        );
        assert!(fail("rigs.txt", "2 1 CAMERA 7").contains("frame 4: the frame has the rig 1, which"));
        assert!(fail("frames.txt", "4 1 0 0 0 0 1 2 3 1 CAMERA 7 10").contains("frame 4: a rotation is no quaternion"));
        assert!(fail("frames.txt", "4 1 1 0 0").contains("frames.txt, line 1"));
    }
}
