//! Checks of single-buffer limits of a device, before training allocates anything.

use crate::error::{Result, TrainError};
use sgs_engine::DeviceInfo;

/// Means of reducing the size of a buffer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Remedy {
    /// Fewer or smaller views. Holds the number of views, and the scale that they were read at.
    Views { views: usize, scale: f64 },
    /// Smaller views or fewer Gaussians.
    Step,
}

/// Size of one buffer that training needs.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Single {
    /// Name of the contents, in the plural, for the error message.
    pub what: &'static str,
    pub bytes: u64,
    /// Whether kernels bind the whole buffer.
    pub bound: bool,
    pub remedy: Remedy,
}

impl Single {
    /// Makes the entry of a buffer that kernels bind whole.
    pub fn bound(what: &'static str, bytes: u64, remedy: Remedy) -> Single {
        Single { what, bytes, bound: true, remedy }
    }

    /// Makes the entry of a buffer of which kernels bind ranges.
    pub fn buffer(what: &'static str, bytes: u64, remedy: Remedy) -> Single {
        Single { what, bytes, bound: false, remedy }
    }
}

/// Rejects the first buffer that is larger than the device allows.
///
/// # Errors
/// [`TrainError::Limit`] with the size, the limit and what to do.
pub(crate) fn check(info: &DeviceInfo, buffers: &[Single]) -> Result<()> {
    buffers.iter().try_for_each(|b| {
        let limit = if b.bound { info.largest_binding() } else { info.largest_buffer() };
        check_single(&info.name, limit, b)
    })
}

fn check_single(device: &str, limit: u64, b: &Single) -> Result<()> {
    if b.bytes <= limit {
        return Ok(());
    }
    let (mut need, mut allowed) = (size(b.bytes), size(limit));
    if need == allowed {
        (need, allowed) = (format!("{} bytes", b.bytes), format!("{limit} bytes"));
    }
    Err(TrainError::Limit(format!(
        "The {} need {need} in one buffer, but {device} allows {allowed}; {}.",
        b.what,
        advice(b, limit)
    )))
}

fn advice(b: &Single, limit: u64) -> String {
    let share = limit as f64 / b.bytes as f64;
    match b.remedy {
        Remedy::Views { views, scale } => {
            let views = (views as f64 * share) as usize;
            let smaller = [0.75, 0.5, 0.375, 0.25, 0.125].into_iter().find(|s| s * s <= share).map(|s| s * scale);
            match (smaller, views) {
                (Some(scale), 0) => format!("use --scale {scale}"),
                (Some(scale), views) => format!("use --scale {scale} or --views {views}"),
                (None, 0) => "use smaller views".to_owned(),
                (None, views) => format!("use --views {views}"),
            }
        }
        Remedy::Step => "use a smaller --scale or fewer points".to_owned(),
    }
}

fn size(bytes: u64) -> String {
    match bytes {
        0..0x400 => format!("{bytes} bytes"),
        0x400..0x10_0000 => format!("{:.1} KiB", bytes as f64 / 1024.0),
        0x10_0000..0x4000_0000 => format!("{:.1} MiB", bytes as f64 / f64::from(1 << 20)),
        _ => format!("{:.1} GiB", bytes as f64 / f64::from(1 << 30)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GIB: u64 = 1 << 30;

    fn refusal(bytes: u64, limit: u64, remedy: Remedy) -> String {
        let b = Single { what: "photographs", bytes, bound: true, remedy };
        check_single("NAME", limit, &b).err().map(|e| e.to_string()).unwrap_or_default()
    }

    #[test]
    fn limit_errors_state_both_sizes_and_a_remedy() {
        let views = |scale| Remedy::Views { views: 600, scale };
        assert_eq!(
            refusal(GIB * 52 / 10, 4 * GIB, views(1.0)),
            "The photographs need 5.2 GiB in one buffer, but NAME allows 4.0 GiB; use --scale 0.75 or --views 461."
        );
        assert_eq!(
            refusal(10 * GIB, 4 * GIB, views(0.5)),
            "The photographs need 10.0 GiB in one buffer, but NAME allows 4.0 GiB; use --scale 0.25 or --views 240."
        );
        assert_eq!(
            refusal(4 * GIB, 4 * GIB - 1, Remedy::Step),
            "The photographs need 4294967296 bytes in one buffer, but NAME allows 4294967295 bytes; use a smaller --scale \
             or fewer points."
        );
        assert_eq!(refusal(4 * GIB, 4 * GIB, views(1.0)), "");
        assert!(refusal(GIB, 1000, views(1.0)).ends_with("; use smaller views."));
        assert!(refusal(GIB, 3 << 20, Remedy::Step).contains("allows 3.0 MiB; use a smaller --scale"));
    }
}
