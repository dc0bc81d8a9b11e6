//! The expected number of vertices of a surface and of its blocks, from the numbers of particles in
//! bins.
//!
//! Dual marching cubes makes a vertex on each grid edge that crosses the surface: one for each
//! change between outside and inside along all lines of the grid. Bins show where the fluid along a
//! line begins and ends, so the number of vertices at the face between two bins is the number of
//! cells in the face times the difference in fullness. A layer that is thinner than a bin begins
//! and ends within the bin. The estimate therefore uses the square root of the filled fraction of a
//! bin, which gives more vertices for such layers. For drops that are much smaller than a bin, the
//! estimate adds vertices in proportion to the number of particles.
//!
//! The constants are fitted to frames of FLIP and SPH and to clouds of random particles, in cells
//! of 1 to 1/4 spacings. For frames with at least 10^5 particles, the number of vertices is between
//! 15 % below and 8 % above the expected number; thin layers of a few thousand particles can have
//! more.

use glam::IVec3;
use hashbrown::{HashMap, HashSet};

use crate::grid::{BIN, MortonKey, block_of_bin};

/// Number of vertices at a face between a full and an empty bin. It is greater than the number of
/// cells in the face, because a wrinkled surface has more vertices than a plane.
const FACE: f64 = 1.05 * (BIN * BIN) as f64;

/// A particle is assumed to have its own surface if this volume around it, in cubed spacings,
/// contains no other particle.
const EMPTY_VOLUME: i32 = 8;

/// The expected vertices of a surface.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct ExpectedVertices {
    pub(super) vertices: u64,
    /// The number of vertices if all cells were as narrow as the finest.
    pub(super) in_finest_cells: u64,
    /// The mean, over all vertices, of the number of vertices in the vertex's block. Blocks with
    /// many vertices therefore count more than in a mean over blocks.
    pub(super) in_its_block: u64,
}

impl ExpectedVertices {
    /// The maximum, for frames about which nothing is known.
    pub(super) const MOST: Self =
        Self { vertices: u64::MAX, in_finest_cells: u64::MAX, in_its_block: u64::MAX };

    /// Adds the surface of `octave`, whose vertices are counted in the cells of that octave.
    pub(super) fn add(&mut self, of_octave: Self, octave: u32) {
        self.vertices += of_octave.vertices;
        self.in_finest_cells += of_octave.vertices << (2 * octave);
        self.in_its_block = self.in_its_block.max(of_octave.in_its_block);
    }

    /// An upper bound of the number of vertices in `blocks` blocks together, if no block has more
    /// than `most` vertices.
    pub(super) fn vertices_of(&self, blocks: u64, most: u64) -> u64 {
        // One block can be full of spray, so `most` vertices are added for it. The expected numbers
        // are doubled, because few frames have more than twice the expected number of vertices.
        let like_most = self.in_its_block.saturating_mul(2 * blocks).saturating_add(most);
        (blocks * most).min(like_most).min(self.vertices.saturating_mul(2))
    }
}

/// The filled fraction of each bin that contains particles.
type Shares = HashMap<IVec3, f32>;

/// An upper estimate of the number of vertices around a single particle. The surface of a single
/// particle is a ball with a radius of 0.55 spacings, which has 6 to 7 times s^2 vertices, where s
/// is the spacing in cells.
pub(super) fn vertices_alone(spacing_cells: f64) -> f64 {
    8.0 * spacing_cells * spacing_cells + 6.0
}

/// The number of particles in a full bin.
pub(super) fn full_bin(spacing_cells: f64) -> f64 {
    (f64::from(BIN) / spacing_cells).powi(3)
}

/// If a bin has at least this fraction of the particles of a full bin, it is assumed to contain
/// particles of the finest octave. A bin that is full of particles of twice the size has an eighth
/// of the particles.
const FINEST: f64 = 0.3;

/// The expected surface of particles whose sizes span several octaves, in the bins for which
/// `meshed` is true. A bin belongs to an octave if it is too full to contain only coarser
/// particles. The vertices of its surface are counted in cells of that octave. `spacing_cells` is
/// the smallest size, in cells.
pub(super) fn surface_of_octaves(
    bins: impl Iterator<Item = (MortonKey, usize)>,
    octaves: usize,
    spacing_cells: f64,
    meshed: impl Fn(IVec3) -> bool,
) -> ExpectedVertices {
    let (full, alone) = (full_bin(spacing_cells), vertices_alone(spacing_cells));
    let mut of_octave: Vec<(MortonKey, usize, bool)> =
        bins.map(|(key, count)| (key, count, meshed(key.coord()))).collect();
    let mut all = ExpectedVertices::default();
    for octave in 1..=octaves {
        let is_of_octave = |count: usize| octave == octaves || count as f64 >= FINEST * full;
        let own: HashSet<IVec3> = of_octave
            .iter()
            .filter(|&&(_, count, meshed)| meshed && is_of_octave(count))
            .map(|(key, ..)| key.coord())
            .collect();
        let bins = of_octave.iter().map(|&(key, count, _)| (key, count));
        all.add(surface(bins, full, alone, |bin| own.contains(&bin)), octave as u32 - 1);
        // In Morton order, the bins of a wider bin are consecutive.
        let wider = |&(key, ..): &(MortonKey, usize, bool)| key.coord() >> 1;
        let groups = of_octave.chunk_by(|a, b| wider(a) == wider(b));
        let joined = |group: &[(MortonKey, usize, bool)]| {
            let count = group.iter().map(|&(_, count, _)| count).sum();
            let remains = group.iter().any(|&(_, count, meshed)| meshed && !is_of_octave(count));
            (MortonKey::of(wider(&group[0])), count, remains)
        };
        of_octave = groups.map(joined).collect();
    }
    all
}

/// The expected number of vertices in the bins for which `meshed` is true. `bins` lists the number
/// of particles in each bin, in Morton order. `full` is the number of particles in a full bin, and
/// `alone` is the number of vertices around a single particle.
pub(super) fn surface(
    bins: impl Iterator<Item = (MortonKey, usize)> + Clone,
    full: f64,
    alone: f64,
    meshed: impl Fn(IVec3) -> bool,
) -> ExpectedVertices {
    let share = |count: usize| (count as f64 / full).min(1.0) as f32;
    let shares: Shares = bins.clone().map(|(key, count)| (key.coord(), share(count))).collect();
    let of_bin = |(key, count): (MortonKey, usize)| {
        let bin = key.coord();
        if !meshed(bin) {
            return 0.0;
        }
        let own = shares[&bin];
        let (mut change, mut fullest) = (0.0, own);
        for axis in [IVec3::X, IVec3::Y, IVec3::Z] {
            for beside in [bin - axis, bin + axis].map(|bin| shares.get(&bin).copied()) {
                // A face between two bins is visited once from each bin, so each visit counts half.
                let half = if beside.is_some() { 0.5 } else { 1.0 };
                let beside = beside.unwrap_or(0.0);
                change += half * f64::from((own.sqrt() - beside.sqrt()).abs());
                fullest = fullest.max(beside);
            }
        }
        FACE * change + count as f64 * alone * f64::from(1.0 - fullest).powi(EMPTY_VOLUME)
    };
    let (mut vertices, mut squares) = (0.0, 0.0);
    // The block whose vertices are being summed. The bins of a block are consecutive.
    let (mut block, mut of_block) = (IVec3::MAX, 0.0);
    for bin in bins {
        let next = block_of_bin(bin.0.coord());
        if next != block {
            squares += of_block * of_block;
            (block, of_block) = (next, 0.0);
        }
        let of_bin = of_bin(bin);
        of_block += of_bin;
        vertices += of_bin;
    }
    squares += of_block * of_block;
    let in_its_block = if vertices > 0.0 { squares / vertices } else { 0.0 };
    let (vertices, in_its_block) = (vertices as u64, in_its_block as u64);
    ExpectedVertices { vertices, in_finest_cells: vertices, in_its_block }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::CellBox;

    /// The expected surface of `bins`, each with its number of particles. Cells are one spacing
    /// wide, so a full bin has 4096 particles.
    fn surface_of(bins: &[(IVec3, usize)]) -> ExpectedVertices {
        let bins = bins.iter().map(|&(bin, count)| (MortonKey::of(bin), count));
        surface(bins, 4096.0, vertices_alone(1.0), |_| true)
    }

    fn vertices_of(bins: &[(IVec3, usize)]) -> u64 {
        surface_of(bins).vertices
    }

    #[test]
    fn a_full_cube_has_vertices_only_on_its_faces() {
        let cube: Vec<_> = (CellBox { lo: IVec3::ZERO, hi: IVec3::splat(3) })
            .cubes(1)
            .map(|bin| (bin, 4096))
            .collect();
        assert_eq!(vertices_of(&cube), (6.0 * 9.0 * FACE) as u64);
    }

    #[test]
    fn surfaces_inside_a_bin_and_at_its_face_have_equal_vertex_counts() {
        let column = |counts: [usize; 3]| -> Vec<_> {
            (0..).map(|z| IVec3::new(0, 0, z)).zip(counts).filter(|&(_, count)| count > 0).collect()
        };
        let ends = |counts| vertices_of(&column(counts)) as f64;
        // Each full bin has four side faces, and a bin that is a quarter full counts as half of a
        // full bin.
        assert!((ends([4096, 4096, 0]) - 10.0 * FACE).abs() < 2.0);
        assert!((ends([4096, 4096, 1024]) - 12.0 * FACE).abs() < 2.0);
    }

    #[test]
    fn isolated_particles_have_their_own_surfaces_unless_a_full_bin_is_near() {
        let lone = vertices_of(&[(IVec3::ZERO, 4)]);
        let alone = 4.0 * vertices_alone(1.0);
        assert!(lone as f64 > 0.9 * alone, "{lone} of {alone}");
        let full = (IVec3::X, 4096);
        let beside = vertices_of(&[(IVec3::ZERO, 4), full]) as f64 - vertices_of(&[full]) as f64;
        assert!(beside < 5.0 * (4.0_f64 / 4096.0).sqrt() * FACE, "{beside}");
    }

    #[test]
    fn unmeshed_bins_have_no_vertices_but_count_as_neighbours() {
        let bins = [IVec3::ZERO, IVec3::X].map(|bin| (MortonKey::of(bin), 4096));
        let first = surface(bins.into_iter(), 4096.0, 14.0, |bin| bin == IVec3::ZERO);
        assert_eq!(first.vertices, (5.0 * FACE) as u64);
    }

    #[test]
    fn coarse_fluid_has_the_vertices_of_its_own_cells_beside_fine_fluid() {
        // A cube of coarse fluid around fine fluid. A bin of coarse fluid has an eighth as many
        // particles as a bin of fine fluid.
        let of = |lo: i32, hi: i32, count: usize| {
            (CellBox { lo: IVec3::splat(lo), hi: IVec3::splat(hi) })
                .cubes(1)
                .map(move |b| (b, count))
        };
        let mut bins: Vec<_> = of(0, 12, 512).chain(of(4, 6, 4096)).collect();
        bins.sort_by_key(|&(bin, count)| (MortonKey::of(bin), std::cmp::Reverse(count)));
        bins.dedup_by_key(|&mut (bin, _)| bin);
        let keyed = bins.iter().map(|&(bin, count)| (MortonKey::of(bin), count));
        let expected = surface_of_octaves(keyed, 2, 1.0, |_| true).vertices as f64;
        // In wide cells, the cube has six faces of 6 x 6 bins. The fine fluid is completely inside
        // the cube, and adds vertices only because its bins are fuller than the bins around it.
        let faces = 6.0 * 36.0 * FACE;
        assert!((faces..1.15 * faces).contains(&expected), "{expected} of {faces}");
        // In the finest cells, the coarse fluid alone would have four times as many vertices.
        assert!(vertices_of(&bins) as f64 > 2.0 * expected);
    }

    #[test]
    fn the_expected_block_size_is_weighted_by_vertices() {
        // Eight bins of one block are full, so a single drop elsewhere hardly changes the mean
        // block size.
        let full =
            (CellBox { lo: IVec3::ZERO, hi: IVec3::splat(2) }).cubes(1).map(|bin| (bin, 4096));
        let bins: Vec<_> = full.chain([(IVec3::splat(9), 1)]).collect();
        let expected = surface_of(&bins);
        let block = 24.0 * FACE;
        assert!((expected.in_its_block as f64 / block - 1.0).abs() < 0.01, "{expected:?}");
        assert!(expected.vertices as f64 > block + 10.0, "{expected:?}");
        // Two such blocks have the same mean and twice the vertices.
        let beside: Vec<_> =
            bins.iter().map(|&(bin, count)| (bin + IVec3::new(40, 0, 0), count)).collect();
        let both = surface_of(&[bins, beside].concat());
        assert_eq!(both.in_its_block, expected.in_its_block);
    }

    #[test]
    fn vertices_of_blocks_are_limited_per_block_and_by_the_whole_surface() {
        let expected =
            ExpectedVertices { in_its_block: 1_000, vertices: 50_000, in_finest_cells: 50_000 };
        assert_eq!(expected.vertices_of(1, 20_000), 20_000);
        assert_eq!(expected.vertices_of(8, 20_000), 20_000 + 16_000);
        assert_eq!(expected.vertices_of(1_000, 20_000), 100_000);
        assert_eq!(expected.vertices_of(8, 900), 7_200);
        assert_eq!(ExpectedVertices::MOST.vertices_of(8, 20_000), 160_000);
    }
}
