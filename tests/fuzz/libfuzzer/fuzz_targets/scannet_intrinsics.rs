#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| sgs_fuzz::fuzz("scannet_intrinsics", bytes));
