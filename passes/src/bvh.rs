//! Compressed wide BVH for rays, built on the host (obvhs: PLOC with reinsertion; Ylitie et al. 2017).

use obvhs::aabb::Aabb;
use obvhs::cwbvh::builder::build_cwbvh;
use obvhs::{Boundable, BvhBuildParams};

/// Maximum depth of a tree that kernels can traverse.
pub(crate) const STACK: usize = 32;

/// Box of a primitive.
pub(crate) struct Boxed(pub Aabb);

impl Boundable for Boxed {
    fn aabb(&self) -> Aabb {
        self.0
    }
}

/// Tree over boxes.
pub(crate) struct Bvh {
    /// Nodes of 20 words, eight children each.
    pub nodes: Vec<u32>,
    /// Boxes in the order of the leaves.
    pub order: Vec<u32>,
}

impl Bvh {
    /// Builds the tree. Without boxes, it is one node without children.
    ///
    /// # Errors
    /// The depth of the tree, if kernels cannot traverse it.
    pub fn new(boxes: &[Boxed]) -> Result<Bvh, usize> {
        if boxes.is_empty() {
            return Ok(Bvh { nodes: vec![0; 20], order: Vec::new() });
        }
        let tree = build_cwbvh(boxes, BvhBuildParams::medium_build(), &mut Default::default());
        let mut depth = 0;
        let mut open = vec![(0_usize, 1_usize)];
        while let Some((node, level)) = open.pop() {
            depth = depth.max(level);
            let node = &tree.nodes[node];
            open.extend((0..8).filter(|c| !node.is_leaf(*c)).map(|c| (node.child_node_index(c) as usize, level + 1)));
        }
        if depth > STACK {
            return Err(depth);
        }
        Ok(Bvh { nodes: bytemuck::cast_slice(&tree.nodes).to_vec(), order: tree.primitive_indices })
    }
}
