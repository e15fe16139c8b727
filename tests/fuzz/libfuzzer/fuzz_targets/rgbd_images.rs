#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| sgs_fuzz::fuzz("rgbd_images", bytes));
