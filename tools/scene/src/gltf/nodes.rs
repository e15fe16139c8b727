//! Transforms of the nodes of a glTF file.

use super::document::{Document, Node};
use crate::placement::Placement;
use glam::{DMat4, DQuat, DVec3};

/// Result whose error is a description of the problem.
type Found<T> = std::result::Result<T, String>;

/// Nodes of a scene with their matrices.
pub(super) struct Nodes {
    /// Every node once, in the coordinates of the scene that was exported.
    pub(super) placed: Vec<(usize, DMat4)>,
    /// Transform from that scene to the file, if a node records one.
    pub(super) transform: Option<Placement>,
}

/// Returns every node of the scene once, with its world matrix. The transform that a node records is undone.
pub(super) fn all(document: &Document) -> Found<Nodes> {
    let mut open: Vec<(usize, DMat4)> = match document.scenes.get(document.scene.unwrap_or(0)) {
        Some(scene) => scene.nodes.iter().map(|n| (*n, DMat4::IDENTITY)).collect(),
        // A document without scenes: start from all nodes that have no parent.
        None => {
            let mut child = vec![false; document.nodes.len()];
            let children = document.nodes.iter().flat_map(|n| &n.children);
            children.filter(|c| **c < document.nodes.len()).for_each(|c| child[*c] = true);
            (0..child.len()).filter(|n| !child[*n]).map(|n| (n, DMat4::IDENTITY)).collect()
        }
    };
    let mut seen = vec![false; document.nodes.len()];
    let mut placed = Vec::new();
    let mut transform = None;
    while let Some((index, above)) = open.pop() {
        let Some(node) = document.nodes.get(index) else { return Err(format!("there is no node {index}")) };
        if std::mem::replace(&mut seen[index], true) {
            return Err(format!("node {index} is reached twice"));
        }
        let mut here = above * local(node);
        if let Some(recorded) = recorded(node).map_err(|e| format!("node {index}: {e}"))? {
            // An unchanged node leaves its children where the scene has them, to the last bit.
            let same = above == DMat4::IDENTITY && here.abs_diff_eq(recorded.matrix(), 1e-9 * recorded.scale.max(1.0));
            here = if same { DMat4::IDENTITY } else { recorded.inverse().matrix() * here };
            transform = Some(recorded);
        }
        open.extend(node.children.iter().map(|c| (*c, here)));
        placed.push((index, here));
    }
    placed.sort_by_key(|(index, _)| *index);
    Ok(Nodes { placed, transform })
}

/// Returns the transform from the scene to the file that a node records.
///
/// It is in `extras.sgs.transform`.
fn recorded(node: &Node) -> Found<Option<Placement>> {
    let Some(value) = node.extras.as_ref().and_then(|extras| extras.get("sgs")?.get("transform")) else {
        return Ok(None);
    };
    let wrong = |e: serde_json::Error| format!("its recorded transform is not as it must be: {e}");
    let placement: Placement = serde_json::from_value(value.clone()).map_err(wrong)?;
    placement.check().map(|()| Some(placement))
}

fn local(node: &Node) -> DMat4 {
    match node.matrix {
        Some(matrix) => DMat4::from_cols_array(&matrix),
        None => DMat4::from_scale_rotation_translation(
            DVec3::from(node.scale.unwrap_or([1.0; 3])),
            DQuat::from_array(node.rotation.unwrap_or([0.0, 0.0, 0.0, 1.0])),
            DVec3::from(node.translation.unwrap_or([0.0; 3])),
        ),
    }
}

/// Decomposes a matrix into uniform scale, rotation and translation.
pub(super) fn placement(matrix: &DMat4) -> Found<Placement> {
    if *matrix == DMat4::IDENTITY {
        return Ok(Placement::NONE);
    }
    if !matrix.is_finite() {
        return Err("its place is not finite".into());
    }
    let length = matrix.x_axis.truncate().length();
    if matrix.determinant() <= 0.0 || length <= 0.0 {
        return Err("it is mirrored or flat, which splats cannot be; apply its transform before exporting".into());
    }
    let (scale, rotation, translation) = matrix.to_scale_rotation_translation();
    let scale = scale.x.max(scale.y).max(scale.z);
    let again = DMat4::from_scale_rotation_translation(DVec3::splat(scale), rotation, translation);
    if !again.abs_diff_eq(*matrix, 1e-5 * scale.max(translation.length())) {
        return Err("it is skewed or scaled unevenly; apply its transform before exporting".into());
    }
    let q = rotation.normalize();
    Ok(Placement { scale, rotation: [q.w, q.x, q.y, q.z], translation: translation.to_array() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn matrices_are_decomposed_or_rejected() {
        assert_eq!(placement(&DMat4::IDENTITY).unwrap(), Placement::NONE);
        let q = DQuat::from_xyzw(0.5, -0.5, 0.5, 0.5);
        let m = DMat4::from_scale_rotation_translation(DVec3::splat(3.0), q, DVec3::new(1.0, 2.0, 3.0));
        let p = placement(&m).unwrap();
        assert!((p.scale - 3.0).abs() < 1e-12 && p.translation == [1.0, 2.0, 3.0]);
        assert!((p.rotation[0] - 0.5).abs() < 1e-12 && (p.rotation[2] + 0.5).abs() < 1e-12);
        let uneven = DMat4::from_scale(DVec3::new(1.0, 1.0, 2.0));
        assert!(placement(&uneven).unwrap_err().contains("unevenly"));
        assert!(placement(&DMat4::from_scale(DVec3::new(-1.0, 1.0, 1.0))).unwrap_err().contains("mirrored"));
        assert!(placement(&DMat4::from_scale(DVec3::splat(f64::NAN))).is_err());
        assert!(placement(&DMat4::ZERO).is_err());
    }
}
