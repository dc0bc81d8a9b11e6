//! Solids at which a fluid ends, as signed distances at the centres of cells.
//!
//! A solid is a closed mesh. A place is inside the solid if the winding number there is nonzero.
//! Therefore, parts of the mesh may overlap or touch, and a part that lies inside another part and
//! faces the other way is a cavity. Reversing all triangles gives the same solid. The magnitude of
//! a place's signed distance is the distance to the nearest point on any triangle.
//!
//! A distance depends only on the cell, not on the box of cells in a request. Cells are processed
//! in cubes of 4^3. The distance of a cube's centre limits the searches for the distances of its
//! cells. A cache keeps the distances of recently used cubes.
//!
//! In a periodic box, a solid repeats as the fluid does: it has copies one box width away along
//! each periodic axis.

mod cache;

use std::cmp::Ordering;
use std::sync::Arc;

use glam::{DVec3, IVec3};
use rayon::prelude::*;
use thiserror::Error;

use crate::brick::Block;
use crate::grid::units::SolidOffset;
use crate::grid::{CellBox, Grid, Periodic, TILE};

use super::mesh::Mesh;
use super::mesh::tree::{CompareError, Side, TriangleTree, origin_on};
use cache::{CELLS, CubeDistances, DistanceCache, DistanceLattice};

/// Edge, in cells, of the cubes that are tested as a whole for nearby triangles.
const WIDE: i32 = 4 * TILE;
/// Upper limit, in bytes per triangle, on the memory that building a solid takes. It is reached if
/// no two triangles share a vertex.
const TRIANGLE_BYTES: u64 = 280;

/// A mesh that cannot be a solid.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[non_exhaustive]
pub enum SolidFault {
    /// The mesh has no surface, or an invalid vertex.
    #[error(transparent)]
    Mesh(#[from] CompareError),
    /// The mesh has holes.
    #[error(
        "the solid is not closed: at {edges} edges, a triangle has no neighbour; fill the holes, \
         merge vertices that differ only by rounding, or remove duplicate triangles"
    )]
    Open {
        /// Number of edges at which a triangle has no neighbour.
        edges: usize,
    },
    /// Neighbouring triangles face opposite ways.
    #[error(
        "the inside of the solid is undefined: at {edges} edges, neighbouring triangles face \
         opposite ways; recalculate the normals, or flip the triangles that face inwards"
    )]
    Inconsistent {
        /// Number of edges at which neighbouring triangles face opposite ways.
        edges: usize,
    },
}

/// Closed meshes at which a fluid ends.
#[derive(Debug)]
pub struct Solid {
    meshes: Vec<TriangleTree>,
    offset: SolidOffset,
    triangles: u64,
    turned: Vec<usize>,
    thickness: Vec<f64>,
    cache: DistanceCache,
}

impl Solid {
    /// Combines meshes into a solid. The fluid ends at the distance `offset` from the solid.
    ///
    /// # Errors
    /// [`SolidFault`], with the number of the faulty mesh.
    pub fn new(meshes: Vec<Mesh>, offset: SolidOffset) -> Result<Self, (usize, SolidFault)> {
        let mut solid = Self {
            meshes: Vec::new(),
            offset,
            triangles: 0,
            turned: Vec::new(),
            thickness: Vec::new(),
            cache: DistanceCache::new(0),
        };
        for (number, mesh) in meshes.into_iter().enumerate() {
            if !is_closed(&mesh) {
                return Err((number, fault_of(&mesh)));
            }
            let tree = TriangleTree::new(&mesh, origin_on(&mesh), Side::Mesh)
                .map_err(|fault| (number, fault.into()))?;
            let [volume, area] = volume_and_area(&tree);
            if volume < 0.0 {
                solid.turned.push(number);
            }
            solid.thickness.push(2.0 * volume.abs() / area);
            solid.triangles += mesh.triangles.len() as u64;
            solid.meshes.push(tree);
        }
        Ok(solid)
    }

    /// Keeps computed distances in a cache of at most `bytes` bytes.
    #[must_use]
    pub fn keeping_distances(self, bytes: u64) -> Self {
        Self { cache: DistanceCache::new(bytes), ..self }
    }

    /// The distance between the fluid and the solid, in spacings.
    #[must_use]
    pub fn offset(&self) -> f64 {
        self.offset.spacings()
    }

    /// The numbers of the meshes whose triangles face inwards. They give the same solids as if
    /// their triangles faced outwards.
    #[must_use]
    pub fn turned(&self) -> &[usize] {
        &self.turned
    }

    /// The thickness of each mesh: the thickness of a plate with the same volume and area.
    #[must_use]
    pub fn thickness(&self) -> &[f64] {
        &self.thickness
    }

    /// Maximum memory of the solid, in bytes.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.triangles * TRIANGLE_BYTES + self.cache.most_bytes()
    }

    /// Whether `cells`, which are 2^`level` times as wide as the grid's cells, may contain a part
    /// of the solid's surface or lie inside the solid.
    #[must_use]
    pub fn is_near(
        &self,
        grid: &Grid,
        periodic: Option<&Periodic>,
        level: u32,
        cells: CellBox,
    ) -> bool {
        let (lo, hi) = corners(grid, level, cells);
        self.copies(periodic).any(|copy| copy.meets(lo, hi) || copy.contains((lo + hi) / 2.0))
    }

    /// Signed distances of the centres of `cells`, which are 2^`level` times as wide as the grid's
    /// cells. Distances are in steps of length `step`, and negative inside the solid. Their
    /// magnitudes are clamped to `most` steps.
    #[must_use]
    pub fn distances(
        &self,
        grid: &Grid,
        periodic: Option<&Periodic>,
        level: u32,
        cells: CellBox,
        step: f64,
        most: i16,
    ) -> Block<i16> {
        let lattice =
            DistanceLattice { grid: *grid, periodic: periodic.copied(), level, step, most };
        let number = self.cache.number(&lattice);
        let mut distances = Block::zero(cells);
        for wide in cells.cubes(WIDE) {
            let part = CellBox::cube(wide, WIDE).intersection(&cells);
            let near = self.near_meshes(&lattice, part.tiled());
            if let Some(distance) = near.common_distance(&lattice) {
                distances.fill(part, distance);
                continue;
            }
            for cube in part.cubes(TILE) {
                let in_cube = CellBox::cube(cube, TILE);
                let found =
                    self.cache.get_or_make(number, cube, || near.distances(&lattice, in_cube));
                let part = in_cube.intersection(&part);
                distances.put_part(part, in_cube, &found.each(), |_, distance| distance);
            }
        }
        distances
    }

    /// The meshes and copies that determine the distances of `cells`.
    fn near_meshes(&self, lattice: &DistanceLattice, cells: CellBox) -> NearMeshes<'_> {
        let (lo, hi) = lattice.corners(cells);
        let farthest = lattice.farthest();
        let copies = self.copies(lattice.periodic.as_ref());
        let (near, far): (Vec<_>, Vec<_>) =
            copies.partition(|copy| copy.meets(lo - farthest, hi + farthest));
        let is_inside = far.iter().any(|copy| copy.contains((lo + hi) / 2.0));
        NearMeshes { near, is_inside }
    }

    /// The meshes and, in a periodic box, their copies.
    fn copies<'a>(&'a self, periodic: Option<&Periodic>) -> impl Iterator<Item = PlacedMesh<'a>> {
        let widths = periodic.map_or([None; 3], |periodic| {
            periodic.faces().map(|faces| faces.map(|[lo, hi]| hi - lo))
        });
        let along = move |axis: usize| {
            let sides = if widths[axis].is_some() { -1..=1 } else { 0..=0 };
            sides.map(move |side| f64::from(side) * widths[axis].unwrap_or(0.0))
        };
        let shifts = along(2)
            .flat_map(move |z| along(1).flat_map(move |y| along(0).map(move |x| [x, y, z])));
        shifts.flat_map(|shift| {
            self.meshes.iter().map(move |mesh| PlacedMesh { mesh, shift: shift.into() })
        })
    }
}

/// The lowest and the highest corner of a box of cells that are 2^`level` times as wide as the
/// grid's cells.
fn corners(grid: &Grid, level: u32, cells: CellBox) -> (DVec3, DVec3) {
    let world = |cell: IVec3| grid.world_from_cells(cell.as_dvec3() * width(level));
    (world(cells.lo), world(cells.hi))
}

impl DistanceLattice {
    /// The lowest and the highest corner of a box of cells.
    fn corners(&self, cells: CellBox) -> (DVec3, DVec3) {
        corners(&self.grid, self.level, cells)
    }

    /// The largest distance, in the grid's unit of length.
    fn farthest(&self) -> f64 {
        f64::from(self.most) * self.step
    }
}

/// Width of a cell of level `level`, in grid cells.
fn width(level: u32) -> f64 {
    f64::from(1_u32 << level)
}

/// The meshes that determine the distances of the cells in a box.
struct NearMeshes<'a> {
    /// The meshes with a triangle near the box.
    near: Vec<PlacedMesh<'a>>,
    /// Whether the box is inside a mesh that has no triangle near it.
    is_inside: bool,
}

impl NearMeshes<'_> {
    /// Returns the common distance of all cells if the box is inside a mesh without triangles near
    /// the box, or if no mesh has a triangle near the box.
    fn common_distance(&self, lattice: &DistanceLattice) -> Option<i16> {
        let is_far = self.is_inside || self.near.is_empty();
        is_far.then_some(if self.is_inside { -lattice.most } else { lattice.most })
    }

    /// The distances of the cells in a cube of the box.
    fn distances(&self, lattice: &DistanceLattice, cube: CellBox) -> CubeDistances {
        let mut nearest = [lattice.most; CELLS];
        for mesh in &self.near {
            for (nearest, own) in nearest.iter_mut().zip(mesh.distances(lattice, cube)) {
                *nearest = (*nearest).min(own);
            }
        }
        if nearest.iter().any(|&distance| distance != nearest[0]) {
            CubeDistances::Each(Arc::new(nearest))
        } else {
            CubeDistances::Same(nearest[0])
        }
    }
}

/// A mesh that is displaced by `shift`.
struct PlacedMesh<'a> {
    mesh: &'a TriangleTree,
    shift: DVec3,
}

impl PlacedMesh<'_> {
    /// Like [`TriangleTree::meets`], for the displaced mesh.
    fn meets(&self, lo: DVec3, hi: DVec3) -> bool {
        self.mesh.meets(lo - self.shift, hi - self.shift)
    }

    /// Whether a place is inside the mesh: the winding number around the place is not zero.
    fn contains(&self, place: DVec3) -> bool {
        self.contains_local(place - self.shift)
    }

    /// Like [`contains`](Self::contains), for a place in the mesh's own coordinates, without
    /// `shift`.
    fn contains_local(&self, place: DVec3) -> bool {
        self.mesh.winding_number(place) != 0
    }

    /// The distances of the cells of a cube.
    fn distances(&self, lattice: &DistanceLattice, cube: CellBox) -> [i16; CELLS] {
        let &DistanceLattice { ref grid, level, step, most, .. } = lattice;
        let farthest = lattice.farthest();
        let place = |cell: DVec3| grid.world_from_cells(cell * width(level)) - self.shift;
        let centre = |cell: usize| {
            let cell = cell as i32;
            let in_cube = IVec3::new(cell % TILE, cell / TILE % TILE, cell / (TILE * TILE));
            place((cube.lo + in_cube).as_dvec3() + 0.5)
        };
        let middle = place((cube.lo + cube.hi).as_dvec3() / 2.0);
        let width = grid.cell_size() * width(level);
        let to_corner = f64::from(TILE - 1) * width * 0.5 * 3_f64.sqrt();
        let Some((of_middle, nearest)) = self.mesh.distance_within(middle, farthest + to_corner)
        else {
            return [if self.contains_local(middle) { -most } else { most }; CELLS];
        };
        let reach = (of_middle + to_corner).min(farthest);
        let triangles = self.mesh.vicinity(centre(0), centre(CELLS - 1), reach);
        let mut near = nearest;
        let mut distances = [farthest; CELLS];
        for (cell, distance) in distances.iter_mut().enumerate() {
            let at = centre(cell);
            // The triangle inequality gives this bound, through the cube's centre.
            let bound = (of_middle + at.distance(middle)).min(farthest) * (1.0 + 1e-9);
            if let Some(found) = triangles.distance_within(at, bound, near) {
                (*distance, near) = found;
            }
        }
        // Distances inside the mesh are negative.
        let are_inside = if of_middle > to_corner * (1.0 + 1e-9) {
            // No triangle is between the middle of the cube and the centre of a cell, so all cells
            // are on the same side as the middle.
            [self.contains_local(middle); CELLS]
        } else {
            are_inside(&distances, width, |cell| self.contains_local(centre(cell)))
        };
        std::array::from_fn(|cell| {
            // Rounds to the nearest integer.
            let steps = (distances[cell] / step + 0.5).min(f64::from(most)) as i16;
            if are_inside[cell] { -steps } else { steps }
        })
    }
}

/// Whether each cell of a cube is inside a mesh. `distances` are the cells' distances from the
/// mesh, and `is_inside` returns whether a single cell is inside. Cells are `width` wide. No
/// triangle is between a cell and its neighbour if the distance of either is larger than `width`.
fn are_inside(
    distances: &[f64; CELLS],
    width: f64,
    is_inside: impl Fn(usize) -> bool,
) -> [bool; CELLS] {
    let mut farthest_first: [usize; CELLS] = std::array::from_fn(|cell| cell);
    farthest_first.sort_unstable_by(|&a, &b| distances[b].total_cmp(&distances[a]));
    let mut known = [None; CELLS];
    for cell in farthest_first {
        let beside = [1, TILE as usize, (TILE * TILE) as usize].into_iter().flat_map(|step| {
            let place = cell / step % TILE as usize;
            let before = (place > 0).then(|| cell - step);
            let after = (place + 1 < TILE as usize).then(|| cell + step);
            [before, after].into_iter().flatten()
        });
        let same = beside.filter(|&beside| distances[beside] > width * (1.0 + 1e-9));
        let same = same.filter_map(|beside| known[beside]).next();
        known[cell] = Some(same.unwrap_or_else(|| is_inside(cell)));
    }
    known.map(|inside| inside.unwrap_or_default())
}

/// The volume that a mesh encloses, negative if its triangles face inwards, and the mesh's area.
fn volume_and_area(mesh: &TriangleTree) -> [f64; 2] {
    let (mut sextuple_volume, mut doubled_area) = (0.0, 0.0);
    for [a, b, c] in (0..mesh.triangles().len()).map(|triangle| mesh.corners(triangle)) {
        sextuple_volume += a.dot(b.cross(c));
        doubled_area += (b - a).cross(c - a).length();
    }
    [sextuple_volume / 6.0, doubled_area / 2.0]
}

/// Whether the winding number of a mesh is an integer everywhere, which is the case if every edge
/// occurs equally often in both directions. Vertices with the same position count as one vertex.
///
/// Each edge adds or subtracts a hash of its ends, depending on the edge's direction. The sum
/// for a mesh that is not closed is 0 with a probability of 2^-128.
fn is_closed(mesh: &Mesh) -> bool {
    // Adding 0 turns -0 into 0.
    let of_position = |position: &[f64; 3]| hash(position.map(|x| [(x + 0.0).to_bits(); 2]));
    let hashes: Vec<[u64; 2]> = mesh.positions.par_iter().map(of_position).collect();
    let edge = |[a, b]: [[u64; 2]; 2]| match a.cmp(&b) {
        Ordering::Less => number(hash([a, b])),
        Ordering::Equal => 0,
        Ordering::Greater => number(hash([b, a])).wrapping_neg(),
    };
    let edges = |triangle: &[u32; 3]| {
        let [a, b, c] = triangle.map(|vertex| hashes.get(vertex as usize));
        let (Some(&a), Some(&b), Some(&c)) = (a, b, c) else { return 0 };
        edge([a, b]).wrapping_add(edge([b, c])).wrapping_add(edge([c, a]))
    };
    mesh.triangles.par_iter().map(edges).reduce(|| 0, u128::wrapping_add) == 0
}

/// Two independent hashes of pairs of words: one of the first words, and one of the second words.
fn hash<const N: usize>(words: [[u64; 2]; N]) -> [u64; 2] {
    // The finalizer of MurmurHash3.
    let mixed = |x: u64| {
        let x = (x ^ x >> 33).wrapping_mul(0xff51_afd7_ed55_8ccd);
        let x = (x ^ x >> 33).wrapping_mul(0xc4ce_b9fe_1a85_ec53);
        x ^ x >> 33
    };
    // The fractional parts of the golden ratio and of the square root of 2.
    let seeds = [0x9e37_79b9_7f4a_7c15_u64, 0x6a09_e667_f3bc_c909];
    words.iter().fold(seeds, |state, pair| {
        [0, 1].map(|half| mixed(state[half].wrapping_mul(seeds[half]).wrapping_add(pair[half])))
    })
}

/// The number whose halves are two hashes.
fn number([high, low]: [u64; 2]) -> u128 {
    u128::from(high) << 64 | u128::from(low)
}

/// The fault of a mesh that is not closed, with the number of its bad edges.
fn fault_of(mesh: &Mesh) -> SolidFault {
    // Vertices with the same position count as one vertex.
    let mut order: Vec<u32> = (0..mesh.positions.len() as u32).collect();
    let key = |vertex: u32| mesh.positions[vertex as usize].map(|x| (x + 0.0).to_bits());
    order.par_sort_unstable_by_key(|&vertex| (key(vertex), vertex));
    let mut first_of: Vec<u32> = (0..mesh.positions.len() as u32).collect();
    for together in order.chunk_by(|&a, &b| key(a) == key(b)) {
        together.iter().for_each(|&vertex| first_of[vertex as usize] = together[0]);
    }
    let known = |&&triangle: &&[u32; 3]| triangle.iter().all(|&v| (v as usize) < first_of.len());
    let triangles = mesh.triangles.iter().filter(known);
    let triangles = triangles.map(|triangle| triangle.map(|v| first_of[v as usize]));
    let edges = triangles.flat_map(|[a, b, c]| [[a, b], [b, c], [c, a]]).filter(|[a, b]| a != b);
    let mut edges: Vec<([u32; 2], i8)> =
        edges.map(|[a, b]| if a < b { ([a, b], 1) } else { ([b, a], -1) }).collect();
    edges.par_sort_unstable();
    let (mut open, mut inconsistent) = (0, 0);
    for sides in edges.chunk_by(|a, b| a.0 == b.0) {
        let sum: i32 = sides.iter().map(|(_, direction)| i32::from(*direction)).sum();
        match (sum, sides.len() % 2) {
            (0, _) => {}
            (_, 1) => open += 1,
            _ => inconsistent += 1,
        }
    }
    match (open, inconsistent) {
        (0, edges) => SolidFault::Inconsistent { edges },
        (edges, _) => SolidFault::Open { edges },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A box with two triangles per side, rotated about z by an angle.
    fn turned_box(lo: DVec3, hi: DVec3, angle: f64) -> Mesh {
        let corner = |i: u32| {
            let [x, y, z] = [0, 1, 2].map(|axis| if i >> axis & 1 == 0 { lo } else { hi }[axis]);
            let (sin, cos) = angle.sin_cos();
            [x * cos - y * sin, x * sin + y * cos, z]
        };
        let sides =
            [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        Mesh {
            positions: (0..8).map(corner).collect(),
            triangles: sides.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect(),
            ..Mesh::default()
        }
    }

    fn solid(meshes: Vec<Mesh>) -> Solid {
        Solid::new(meshes, SolidOffset::DEFAULT).unwrap().keeping_distances(1 << 20)
    }

    fn grid() -> Grid {
        Grid::new(DVec3::new(0.1, -0.2, 0.3), 0.25).unwrap()
    }

    fn cells(edge: i32) -> CellBox {
        CellBox { lo: IVec3::splat(-edge), hi: IVec3::splat(edge) }
    }

    #[test]
    fn the_distance_of_a_rotated_box_matches_its_formula() {
        let angle = 0.3_f64;
        // The box is shortest along a different axis in each case.
        let halves = [[0.7, 1.0, 1.5], [1.5, 0.7, 1.0], [1.0, 1.5, 0.7]].map(DVec3::from);
        for (half, level) in halves.into_iter().flat_map(|half| [(half, 0), (half, 1)]) {
            let solid = solid(vec![turned_box(-half, half, angle)]);
            let cells = cells(16 >> level);
            let found = solid.distances(&grid(), None, level, cells, 1e-3, 900);
            for z in cells.lo.z..cells.hi.z {
                for y in cells.lo.y..cells.hi.y {
                    for x in cells.lo.x..cells.hi.x {
                        let cell = IVec3::new(x, y, z);
                        let at = grid().world_from_cells((cell.as_dvec3() + 0.5) * width(level));
                        let (sin, cos) = (-angle).sin_cos();
                        let at = DVec3::new(at.x * cos - at.y * sin, at.x * sin + at.y * cos, at.z);
                        let over = at.abs() - half;
                        let distance = over.max(DVec3::ZERO).length() + over.max_element().min(0.0);
                        let expected = distance.clamp(-0.9, 0.9);
                        let error = f64::from(found.at(cell)) * 1e-3 - expected;
                        assert!(error.abs() < 6e-4, "{cell}: {error}, {expected}");
                    }
                }
            }
        }
    }

    #[test]
    fn solid_distances_do_not_depend_on_the_request_or_the_cache() {
        let boxes = || {
            let turned = turned_box(DVec3::splat(-1.0), DVec3::splat(1.1), 0.4);
            let beside = turned_box(DVec3::new(0.8, -4.0, -4.0), DVec3::splat(4.0), 0.0);
            solid(vec![turned, beside])
        };
        let keeping = boxes();
        let all =
            |solid: &Solid, cells: CellBox| solid.distances(&grid(), None, 0, cells, 1e-4, 8000);
        let whole = all(&keeping, cells(12));
        assert_eq!(all(&keeping, cells(12)), whole);
        let part = CellBox { lo: IVec3::new(-5, 1, -11), hi: IVec3::new(10, 9, 2) };
        for bytes in [0, 1 << 12, 1 << 20] {
            assert_eq!(all(&boxes().keeping_distances(bytes), part), whole.part(part), "{bytes}");
        }
        // The distance from the nearer solid, negative inside either of them.
        let at = |x: f64| {
            let cell = ((DVec3::new(x, 0.0, 0.0) - grid().origin()) / 0.25).floor().as_ivec3();
            f64::from(whole.at(cell)) * 1e-4
        };
        assert!(at(2.5) < 0.0 && at(0.0) < 0.0 && at(-2.0) > 0.0);
    }

    #[test]
    fn overlapping_boxes_are_one_solid_and_an_inverted_box_is_a_cavity() {
        let [outer, inner] =
            [2.0, 1.0].map(|half| turned_box(DVec3::splat(-half), DVec3::splat(half), 0.0));
        let both = |mut a: Mesh, b: &Mesh| {
            let first = a.positions.len() as u32;
            a.positions.extend(&b.positions);
            a.triangles.extend(b.triangles.iter().map(|t| t.map(|v| v + first)));
            a
        };
        let inwards = Mesh {
            triangles: inner.triangles.iter().map(|&[a, b, c]| [a, c, b]).collect(),
            ..inner.clone()
        };
        let middle = |mesh: Mesh| {
            let solid = solid(vec![mesh]);
            let cell = CellBox { lo: IVec3::ZERO, hi: IVec3::ONE };
            solid.distances(&grid(), None, 0, cell, 1e-3, 500).at(IVec3::ZERO)
        };
        assert_eq!(middle(both(outer.clone(), &inner)), -500);
        assert_eq!(middle(both(outer, &inwards)), 500);
        // Without the outer mesh, the inner mesh is a box and not a cavity.
        let turned = solid(vec![inner, inwards.clone()]);
        assert_eq!(turned.turned(), [1]);
        assert_eq!(middle(inwards), -500);
    }

    #[test]
    fn triangles_without_extent_are_not_part_of_a_solid() {
        let half = DVec3::splat(1.0);
        let mut mesh = turned_box(-half, half, 0.0);
        let whole = solid(vec![mesh.clone()]);
        // Three vertices at a place away from the box, and two at one of its corners.
        mesh.positions.extend([[2.5; 3]; 3]);
        mesh.positions.extend([mesh.positions[0]; 2]);
        mesh.triangles.extend([[8, 9, 10], [0, 11, 5]]);
        let found = |solid: &Solid| solid.distances(&grid(), None, 0, cells(12), 1e-3, 2000);
        assert_eq!(found(&solid(vec![mesh])), found(&whole));
    }

    #[test]
    fn open_and_inconsistent_solids_are_refused_with_their_bad_edges() {
        let whole = turned_box(DVec3::ZERO, DVec3::ONE, 0.0);
        let fault = |mesh: &Mesh| {
            Solid::new(vec![whole.clone(), mesh.clone()], SolidOffset::DEFAULT).unwrap_err()
        };
        let mut open = whole.clone();
        open.triangles.truncate(11);
        assert_eq!(fault(&open), (1, SolidFault::Open { edges: 3 }));
        let mut turned = whole.clone();
        turned.triangles[0].reverse();
        assert_eq!(fault(&turned), (1, SolidFault::Inconsistent { edges: 3 }));
        assert!(matches!(fault(&Mesh::default()), (1, SolidFault::Mesh(_))));
        // Every triangle has its own vertices.
        let apart = Mesh {
            positions: whole
                .triangles
                .iter()
                .flatten()
                .map(|&v| whole.positions[v as usize])
                .collect(),
            triangles: (0..12).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect(),
            ..Mesh::default()
        };
        assert!(Solid::new(vec![apart], SolidOffset::DEFAULT).is_ok());
    }
}
