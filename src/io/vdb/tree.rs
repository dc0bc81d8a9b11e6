//! The tree of a grid. A node below the root has up to 32^3 children, each child has up to 16^3
//! leaves, and a leaf has 8^3 voxels.
//!
//! In place of a missing child, a node has a tile, which says whether its voxels are inside or
//! outside. The surface never runs between a tile and its neighbour, so both are on the same side
//! of the surface.

use glam::IVec3;
use rayon::prelude::*;

use crate::surface::level_set::{LEAF, VOXELS, place_in_leaf};
use crate::system::bits::ones;

use super::values::{Kind, put_inactive_record};

/// Binary logarithms of the number of children along an edge of an inner node, lowest level first.
const LOG2: [u32; 2] = [4, 5];

/// A leaf of the tree without its values.
#[derive(Debug)]
pub struct TreeLeaf {
    /// The coordinates of the first voxel.
    pub corner: IVec3,
    /// A bit for each voxel, set if the voxel is active.
    pub active: [u64; VOXELS / 64],
    /// A bit for each voxel, set if the voxel is inside the surface.
    pub inside: [u64; VOXELS / 64],
}

impl TreeLeaf {
    /// The coordinates of the active voxels, in order.
    pub fn active_voxels(&self) -> impl Iterator<Item = IVec3> {
        let of_word = |(word, &bits): (usize, &u64)| ones(bits).map(move |bit| word * 64 + bit);
        let active = self.active.iter().enumerate().flat_map(of_word);
        active.map(|i| self.corner + place_in_leaf(i))
    }

    /// The number of active voxels.
    pub fn active_count(&self) -> usize {
        self.active.iter().map(|word| word.count_ones() as usize).sum()
    }

    /// The least and the greatest coordinates of the active voxels along each axis.
    pub fn bounds(&self) -> Option<[IVec3; 2]> {
        // `yz` has a bit for each y and z of an active voxel, and `z` has a bit for each z.
        let yz = self.active.into_iter().fold(0, |all, word| all | word);
        let z = yz.to_le_bytes().into_iter().fold(0, |all, byte| all | byte);
        let low_x = self.active.iter().position(|&word| word != 0)?;
        let high_x = self.active.iter().rposition(|&word| word != 0)?;
        let low = [low_x as u32, yz.trailing_zeros() / 8, z.trailing_zeros()];
        let high = [high_x as u32, yz.ilog2() / 8, z.ilog2()];
        Some([low, high].map(|place| self.corner + IVec3::from(place.map(|k| k as i32))))
    }

    /// The number of inactive voxels inside the surface, and the number of all inactive voxels.
    pub fn sides(&self) -> [usize; 2] {
        let inactive = self.active.map(|word| !word);
        let inside = self.inside.iter().zip(&inactive).map(|(inside, word)| inside & word);
        [
            inside.map(|word| word.count_ones() as usize).sum(),
            inactive.iter().map(|word| word.count_ones() as usize).sum(),
        ]
    }
}

/// The bytes of a leaf or of a node above the leaves, and whether the first and the last voxel of
/// the node are inside the surface.
struct InnerNode {
    corner: IVec3,
    bytes: Vec<u8>,
    inside: [bool; 2],
}

/// The bytes of the tree without the values of its leaves. `leaves` must be sorted by [`sort_key`].
pub fn topology<'a>(
    leaves: impl IndexedParallelIterator<Item = &'a TreeLeaf>,
    kind: Kind,
    background: f32,
    zip: bool,
) -> Vec<u8> {
    let leaf = |leaf: &TreeLeaf| InnerNode {
        corner: leaf.corner,
        bytes: leaf.active.iter().flat_map(|word| word.to_le_bytes()).collect(),
        inside: [leaf.inside[0] & 1 == 1, leaf.inside[VOXELS / 64 - 1] >> 63 == 1],
    };
    let leaves: Vec<_> = leaves.map(leaf).collect();
    let lower = parent_nodes(leaves, LEAF, LOG2[0], kind, zip);
    let upper = parent_nodes(lower, LEAF << LOG2[0], LOG2[1], kind, zip);
    let tiles = root_tiles(&upper);

    let mut out = 1i32.to_le_bytes().to_vec();
    out.extend(kind.background(background));
    out.extend((tiles.len() as u32).to_le_bytes());
    out.extend((upper.len() as u32).to_le_bytes());
    for corner in tiles {
        out.extend(corner.to_array().map(i32::to_le_bytes).as_flattened());
        out.extend(kind.background(-background));
        out.push(0);
    }
    for node in upper {
        out.extend(node.corner.to_array().map(i32::to_le_bytes).as_flattened());
        out.extend(node.bytes);
    }
    out
}

/// The key by which leaves are sorted in the tree: the coordinates of the upper node, of the lower
/// node, and of the leaf. Among siblings, z varies fastest.
pub fn sort_key(corner: IVec3) -> [[i32; 3]; 3] {
    [LEAF << (LOG2[0] + LOG2[1]), LEAF << LOG2[0], LEAF]
        .map(|edge| corner.div_euclid(IVec3::splat(edge)).to_array())
}

/// Builds the nodes above `children`, which must be in tree order and `edge` voxels wide.
fn parent_nodes(
    children: Vec<InnerNode>,
    edge: i32,
    log2: u32,
    kind: Kind,
    zip: bool,
) -> Vec<InnerNode> {
    let parent = |child: &InnerNode| child.corner.div_euclid(IVec3::splat(edge << log2));
    let groups: Vec<&[InnerNode]> = children.chunk_by(|a, b| parent(a) == parent(b)).collect();
    groups
        .into_par_iter()
        .map(|children| {
            node(parent(&children[0]) * (edge << log2), children, edge, log2, kind, zip)
        })
        .collect()
}

fn node(
    corner: IVec3,
    children: &[InnerNode],
    edge: i32,
    log2: u32,
    kind: Kind,
    zip: bool,
) -> InnerNode {
    let side = 1usize << log2;
    let slots = side.pow(3);
    let number = |child: &InnerNode| {
        let at = (child.corner - corner) / edge;
        (((at.x as usize) << log2 | at.y as usize) << log2) | at.z as usize
    };
    let mut child_at = vec![None; slots];
    children.iter().for_each(|child| child_at[number(child)] = Some(child));

    let mut child_mask = vec![0u64; slots / 64];
    let mut outside = vec![0u64; slots / 64];
    // For each slot, whether its last voxel is inside the surface.
    let mut last = vec![false; slots];
    let (mut tiles, mut tiles_inside) = (0, 0);
    for slot in 0..slots {
        if let Some(child) = child_at[slot] {
            child_mask[slot / 64] |= 1 << (slot % 64);
            last[slot] = child.inside[1];
            continue;
        }
        let before =
            [(slot % side, 1), (slot / side % side, side), (slot / side.pow(2), side.pow(2))]
                .into_iter()
                .find(|&(along, _)| along > 0);
        last[slot] = before.map_or(children[0].inside[0], |(_, step)| last[slot - step]);
        tiles += 1;
        tiles_inside += usize::from(last[slot]);
        outside[slot / 64] |= u64::from(!last[slot]) << (slot % 64);
    }
    let mut bytes = Vec::new();
    bytes.extend(child_mask.iter().flat_map(|word| word.to_le_bytes()));
    // No tile is active, so the mask of active tiles is empty.
    bytes.resize(bytes.len() + slots / 8, 0);
    put_inactive_record(&mut bytes, kind, [tiles_inside, tiles], &outside);
    kind.put_no_values(&mut bytes, zip);
    children.iter().for_each(|child| bytes.extend(&child.bytes));
    let first = child_at[0].map_or(last[0], |child| child.inside[0]);
    InnerNode { corner, bytes, inside: [first, last[slots - 1]] }
}

/// The corners of the root's tiles, which fill the inside between consecutive nodes of a column
/// along z.
fn root_tiles(nodes: &[InnerNode]) -> Vec<IVec3> {
    let edge = LEAF << (LOG2[0] + LOG2[1]);
    let between = nodes.windows(2).flat_map(|pair| {
        let [low, high] = [pair[0].corner, pair[1].corner];
        let is_column = low.truncate() == high.truncate() && pair[0].inside[1];
        let count = if is_column { (high.z - low.z) / edge - 1 } else { 0 };
        (1..=count).map(move |i| low + IVec3::Z * (i * edge))
    });
    between.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bounds_of_a_leaf_are_those_of_its_active_voxels() {
        let mut state = 1u64;
        let mut random = || {
            state = state.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(1);
            (state >> 33) as usize
        };
        assert_eq!(TreeLeaf { corner: IVec3::ONE, active: [0; 8], inside: [!0; 8] }.bounds(), None);
        for count in (1..6).flat_map(|count| [count; 50]) {
            let mut leaf =
                TreeLeaf { corner: IVec3::new(-8, 16, 0), active: [0; 8], inside: [0; 8] };
            for _ in 0..count {
                leaf.active[random() % 8] |= 1 << (random() % 64);
            }
            let corners = leaf.active_voxels().map(|voxel| [voxel; 2]);
            let expected = corners.reduce(|[a, b], [c, d]| [a.min(c), b.max(d)]);
            assert_eq!(leaf.bounds(), expected, "{:?}", leaf.active);
        }
    }

    #[test]
    fn a_root_has_tiles_between_nodes_of_a_column_that_face_inwards() {
        const EDGE: i32 = 4096;
        // The last voxel of the lower leaf and the first voxel of the upper leaf are inside.
        let leaf = |z: i32, inside: u64| {
            let corner = IVec3::new(-EDGE, 0, z);
            TreeLeaf { corner, active: [1 << 20; 8], inside: [inside; 8] }
        };
        let leaves = [leaf(-3 * EDGE - 8, !0), leaf(2 * EDGE, !0), leaf(3 * EDGE, 0)];
        let kind = Kind::Distance { half: false };
        let tree = topology(leaves.par_iter(), kind, 3.0, false);
        let word = |at: usize| i32::from_le_bytes(tree[at..][..4].try_into().unwrap());
        let [buffers, tiles, children] = [word(0), word(8), word(12)];
        assert_eq!([buffers, tiles, children], [1, 5, 3]);
        for (i, z) in (-3..2).enumerate() {
            let at = 16 + 17 * i;
            assert_eq!([0, 4, 8].map(|k| word(at + k)), [-EDGE, 0, z * EDGE]);
            assert_eq!(tree[at + 12..at + 17], [&(-3f32).to_le_bytes()[..], &[0]].concat());
        }
        assert_eq!([0, 4, 8].map(|k| word(16 + 17 * 5 + k)), [-EDGE, 0, -4 * EDGE]);
    }
}
