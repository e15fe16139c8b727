//! Uploads in chunks: same bytes, several chunks in flight, few waits.

use sgs_engine::{Device, DeviceBuffer, Location, Piece, STAGING_BYTES};
use sgs_tests::Gpu;

/// Word around the uploaded ranges.
const AROUND: u8 = 0xA5;

/// Returns bytes in which neighbors and chunks differ.
fn pattern(bytes: usize, seed: u32) -> Vec<u8> {
    (0..bytes as u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8 ^ seed as u8).collect()
}

fn filled(device: &Device, bytes: u64) -> DeviceBuffer {
    let buffer = device.buffer("target", bytes, Location::Device).unwrap();
    device.fill(&buffer, u32::from_ne_bytes([AROUND; 4])).unwrap();
    buffer
}

/// Asserts that a buffer has the pieces, and around them what was there before.
fn assert_written(device: &Device, buffer: &DeviceBuffer, pieces: &[(u64, &[u8])], context: &str) {
    let mut expected = vec![AROUND; buffer.bytes() as usize];
    for (offset, data) in pieces {
        expected[*offset as usize..][..data.len()].copy_from_slice(data);
    }
    let found = device.download(buffer, 0, buffer.bytes()).unwrap();
    let wrong = found.iter().zip(&expected).position(|(a, b)| a != b);
    assert_eq!(wrong, None, "{context}");
}

#[test]
fn uploads_write_exactly_their_ranges() {
    let gpu = Gpu::fresh();
    let device = gpu.device();
    let kib = 1 << 10;
    for bytes in [0, 1, 3, 4, 64 * kib - 1, 64 * kib, 130 * kib + 2, 1024 * kib + 5, 4096 * kib, 9000 * kib + 7] {
        for offset in [0, 4, 13] {
            let data = pattern(bytes, offset as u32);
            let buffer = filled(device, bytes as u64 + 64);
            device.upload(&buffer, offset, &data).unwrap();
            assert_written(device, &buffer, &[(offset, &data)], &format!("{bytes} bytes at {offset}"));
        }
    }
}

#[test]
fn pieces_of_several_buffers_share_chunks() {
    let gpu = Gpu::fresh();
    let device = gpu.device();
    let [a, b] = [filled(device, 3 << 20), filled(device, 5000)];
    let parts = [pattern(1_500_001, 1), pattern(0, 2), pattern(70_003, 3), pattern(4999, 4), pattern(2, 5)];
    let places = [(&a, 3), (&a, 9), (&a, 2_000_001), (&b, 1), (&a, 1_600_000)];
    let pieces: Vec<Piece<'_>> = places.iter().zip(&parts).map(|((to, at), data)| (*to, *at, &data[..])).collect();
    device.upload_all(&pieces).unwrap();
    let of = |wanted: &DeviceBuffer| -> Vec<(u64, &[u8])> {
        let own = pieces.iter().filter(|(to, ..)| to.name() == wanted.name() && to.bytes() == wanted.bytes());
        own.map(|(_, at, data)| (*at, *data)).collect()
    };
    assert_written(device, &a, &of(&a), "first buffer");
    assert_written(device, &b, &of(&b), "second buffer");
    let error = device.upload_all(&[(&b, 0, &parts[3]), (&b, 5000, &[1])]).unwrap_err().to_string();
    assert!(error.contains("target"), "{error}");
}

/// Tests that the host fills chunks while the device copies others. Each chunk was waited for before there was a ring.
#[test]
fn chunks_overlap_and_wait_only_for_their_staging_memory() {
    let gpu = Gpu::fresh();
    let device = gpu.device();
    let chunks = 24;
    let data = pattern(chunks * STAGING_BYTES as usize / 4, 7);
    let buffer = filled(device, data.len() as u64);
    let before = device.activity();
    device.upload(&buffer, 0, &data).unwrap();
    let after = device.activity();
    assert_written(device, &buffer, &[(0, &data)], "24 chunks");
    assert_eq!(after.uploads - before.uploads, 1);
    assert_eq!(after.upload_chunks - before.upload_chunks, chunks as u64);
    assert_eq!(after.most_chunks_in_flight, 4);
    // The first four chunks wait for nothing, later ones only if their staging memory is in use, and the end once.
    let waits = after.upload_waits - before.upload_waits;
    assert!((1..=chunks as u64 - 4 + 1).contains(&waits), "{waits} waits");
    assert_eq!(after.buffers, before.buffers, "staging memory is left");
    // Small uploads are one chunk and one wait, and take no more staging memory than data.
    let (_, peak) = device.memory_during(|| device.upload(&buffer, 8, &data[..1000]).unwrap());
    assert_eq!(peak, 1000);
    let small = device.activity();
    assert_eq!((small.upload_chunks - after.upload_chunks, small.upload_waits - after.upload_waits), (1, 1));
    let (_, peak) = device.memory_during(|| device.upload(&buffer, 0, &data).unwrap());
    assert_eq!(peak, STAGING_BYTES);
}
