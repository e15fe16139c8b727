//! Images on a real device: formats, upload and download, refusals.

use sgs_engine::{Error, ImageFormat};
use sgs_tests::Gpu;

#[test]
fn texels_round_trip_in_every_format() {
    let gpu = Gpu::new();
    for format in ImageFormat::ALL {
        let image = gpu.device().image("texels", [13, 7], format).unwrap();
        let texels: Vec<u8> = (0..image.packed_bytes()).map(|i| (i * 37 % 251) as u8).collect();
        gpu.device().upload_image(&image, &texels).unwrap();
        assert_eq!(gpu.device().download_image(&image).unwrap(), texels, "{format}");
        assert_eq!(image.storage(), gpu.device().supports_storage_image(format), "{format}");
    }
    assert!(gpu.device().supports_storage_image(ImageFormat::R32Float), "every device has this one");
}

#[test]
fn images_are_counted_and_released() {
    let gpu = Gpu::new();
    let before = (gpu.device().memory_use().0, gpu.device().activity().images);
    for side in [16, 1024] {
        let image = gpu.device().image("counted", [side, side], ImageFormat::Rgba8Unorm).unwrap();
        assert!(gpu.device().memory_use().0 >= before.0 + u64::from(side * side * 4));
        assert_eq!(gpu.device().activity().images, before.1 + 1);
        drop(image);
        assert_eq!((gpu.device().memory_use().0, gpu.device().activity().images), before);
    }
}

#[test]
fn impossible_images_are_refused_by_name() {
    let gpu = Gpu::new();
    let error = gpu.device().image("empty", [0, 4], ImageFormat::R32Float).unwrap_err();
    assert!(error.to_string().starts_with("Image \"empty\" would be 0 x 4 texels"), "{error}");
    assert!(matches!(gpu.device().image("wide", [u32::MAX, 1], ImageFormat::R32Float), Err(Error::ImageSize { .. })));
    let image = gpu.device().image("small", [2, 2], ImageFormat::R32Float).unwrap();
    let error = gpu.device().upload_image(&image, &[0; 15]).unwrap_err();
    assert_eq!(error.to_string(), "Image \"small\" receives 15 bytes, but its texels take 16.");
}
