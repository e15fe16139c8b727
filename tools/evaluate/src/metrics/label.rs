//! Accuracy of classes.

use sgs_scene::{Image, RegionMap};

use super::MetricError;

/// Returns the share of pixels with the true class. Counts pixels that the mask includes and that have a class; class 0
/// is none.
///
/// `labels` are row-major. A label that is no class counts as wrong, as where nothing was rendered.
pub fn label_accuracy(
    labels: &[u32],
    size: [u32; 2],
    truth: &RegionMap,
    mask: Option<&Image>,
) -> Result<f64, MetricError> {
    let measure = "label_accuracy";
    let pixels = size[0] as usize * size[1] as usize;
    let whole = labels.len() == pixels && truth.ids.len() == pixels && [truth.width, truth.height] == size;
    if !whole {
        let (a, b) = ((size[0], size[1], 1), (truth.width, truth.height, 1));
        return Err(MetricError::Size { measure, a, b });
    }
    if let Some(m) = mask
        && ([m.width, m.height, m.channels] != [size[0], size[1], 1] || m.data.len() != pixels)
    {
        let (a, b) = ((size[0], size[1], 1), (m.width, m.height, m.channels));
        return Err(MetricError::Size { measure, a, b });
    }
    let (mut right, mut count) = (0_u64, 0_u64);
    for (i, (&label, &id)) in labels.iter().zip(&truth.ids).enumerate() {
        if id != 0 && mask.is_none_or(|m| m.data[i] > 0.5) {
            count += 1;
            right += u64::from(label == u32::from(id));
        }
    }
    if count == 0 { Err(MetricError::Empty { measure }) } else { Ok(right as f64 / count as f64) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_pixels_with_a_class_count() {
        let truth = RegionMap { width: 3, height: 2, ids: vec![1, 2, 0, 3, 3, 1] };
        let labels = [1, 1, 7, 3, u32::MAX, 1];
        assert_eq!(label_accuracy(&labels, [3, 2], &truth, None), Ok(0.6));
        let mask = Image::from_data(3, 2, 1, vec![1.0, 0.0, 1.0, 1.0, 0.0, 1.0]).unwrap();
        assert_eq!(label_accuracy(&labels, [3, 2], &truth, Some(&mask)), Ok(1.0));
        let none = RegionMap { ids: vec![0; 6], ..truth.clone() };
        assert!(matches!(label_accuracy(&labels, [3, 2], &none, None), Err(MetricError::Empty { .. })));
        assert!(matches!(label_accuracy(&labels, [2, 3], &truth, None), Err(MetricError::Size { .. })));
        assert!(matches!(label_accuracy(&labels[..5], [3, 2], &truth, None), Err(MetricError::Size { .. })));
        let wide = Image::new(3, 2, 3);
        assert!(matches!(label_accuracy(&labels, [3, 2], &truth, Some(&wide)), Err(MetricError::Size { .. })));
    }
}
