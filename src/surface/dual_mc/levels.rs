//! Marching cubes where cells of two levels touch.
//!
//! On the lattice of the narrower level, a wide cell counts as 2^3 cells with the same sample. The
//! dual cells at the corners of narrow cells join the narrow cells to the wide ones (Schaefer and
//! Warren 2004). No gap remains, because all edges between the same two cells count as one edge,
//! with one vertex. An edge that joins cells of two levels ends at the middle of the wide cell.

use glam::{DVec3, IVec3};

use crate::brick::Block;
use crate::grid::units::Isovalue;
use crate::grid::{BLOCK, BlockLevel, CellBox, TILE, corner_offset, local_morton};
use crate::surface::mesh::{BlockMesh, Tile, bits, cell_of_bit};

use super::cases::{JoinedCorners, TABLE, Triangles};
use super::{Crossings, Normals, dual_cells, normal};

/// A field on the cells of one level, and the walls in cells of that level.
#[derive(Debug)]
pub struct LevelField {
    /// The samples.
    pub field: Block,
    /// The cells inside the walls, if there are walls.
    pub walls: Option<CellBox>,
}

impl LevelField {
    fn is_within_walls(&self, cell: IVec3) -> bool {
        self.walls.is_none_or(|walls| walls.contains(cell))
    }

    /// The decrease of the field along each axis, from the cell below `cell` to the cell above it.
    fn falling(&self, cell: IVec3) -> DVec3 {
        let sample = |cell: IVec3| f64::from(self.field.at(cell));
        DVec3::from([0, 1, 2].map(|axis| {
            let step = IVec3::AXES[axis];
            sample(cell - step) - sample(cell + step)
        }))
    }
}

/// The fields from which a block of cells of several levels is meshed.
#[derive(Debug)]
pub struct LevelFields {
    /// The field on the cells of the block's own level.
    pub own: LevelField,
    /// The field on the wide cells, which are of the next level. Its values are in spacings of that
    /// level.
    pub wide: Option<LevelField>,
    /// Converts a sample of the next level to the spacing of the block's level.
    pub narrowed: fn(u16) -> u16,
}

/// The sample of a cell, as the dual cells of a block use it.
#[derive(Debug, Clone, Copy)]
struct CellSample {
    sample: u16,
    is_within_walls: bool,
}

/// A block, its level, and the fields of its cells.
struct MixedBlock<'a> {
    fields: &'a LevelFields,
    block: IVec3,
    level: BlockLevel,
}

/// Two boxes that contain the corners of a region's dual cells: the first for cells of the block's
/// own level, and the second for wider cells, in units of those cells.
#[must_use]
pub fn cells_by_level(block: IVec3, level: BlockLevel, region: CellBox) -> [CellBox; 2] {
    let cells = dual_cells(region);
    let own = CellBox::cube(block, BLOCK);
    let mut boxes = [CellBox::EMPTY; 2];
    for beyond in 0..8 {
        // Along each axis, the part is the whole block or, if `beyond` has this axis's bit, the
        // first layer of the upper neighbour.
        let offset = corner_offset(beyond);
        let part = CellBox { lo: own.lo + BLOCK * offset, hi: own.hi + offset };
        let part = part.intersection(&cells);
        if part.is_empty() || level.narrower >> beyond & 1 == 1 {
            continue;
        }
        let is_wider = level.wider >> beyond & 1 == 1;
        boxes[usize::from(is_wider)] = boxes[usize::from(is_wider)].union(&part);
    }
    let [own, wide] = boxes;
    [own, wide.in_wider_cells(1)]
}

impl MixedBlock<'_> {
    fn is_wider(&self, cell: IVec3) -> bool {
        self.level.is_wider(self.block, cell)
    }

    fn of(&self, cell: IVec3) -> CellSample {
        match &self.fields.wide {
            Some(wide) if self.is_wider(cell) => CellSample {
                sample: (self.fields.narrowed)(wide.field.at(cell >> 1)),
                is_within_walls: wide.is_within_walls(cell >> 1),
            },
            _ => {
                let LevelField { field, .. } = &self.fields.own;
                // The vertices next to narrower cells belong to other blocks, so the sample does
                // not matter.
                let known = field.cells().contains(cell);
                CellSample {
                    sample: if known { field.at(cell) } else { 0 },
                    is_within_walls: self.fields.own.is_within_walls(cell),
                }
            }
        }
    }

    /// For each of `cells`, 1 if it is inside the surface, and 0 otherwise.
    fn inside(&self, cells: CellBox, iso: Isovalue) -> Block<u8> {
        let mut inside = Block::zero(cells);
        // Most cells have the block's own level, so whole rows of them are compared first.
        let LevelField { field, walls } = &self.fields.own;
        let block = CellBox::cube(self.block, BLOCK);
        let own = if self.is_wider(block.lo) { CellBox::EMPTY } else { cells.intersection(&block) };
        let own = own.intersection(&field.cells());
        let own = walls.map_or(own, |walls| own.intersection(&walls));
        if !own.is_empty() {
            let width = own.size().x as usize;
            for ([y, z], row) in field.rows(own) {
                let first = inside.index(IVec3::new(own.lo.x, y, z));
                let to = &mut inside.samples_mut()[first..first + width];
                to.iter_mut()
                    .zip(row)
                    .for_each(|(to, &sample)| *to = u8::from(sample > iso.threshold()));
            }
        }
        for z in cells.lo.z..cells.hi.z {
            for y in cells.lo.y..cells.hi.y {
                let is_own = |x| own.contains(IVec3::new(x, y, z));
                for x in (cells.lo.x..cells.hi.x).filter(|&x| !is_own(x)) {
                    let cell = IVec3::new(x, y, z);
                    let CellSample { sample, is_within_walls } = self.of(cell);
                    let at = inside.index(cell);
                    inside.samples_mut()[at] =
                        u8::from(is_within_walls && sample > iso.threshold());
                }
            }
        }
        inside
    }

    fn falling(&self, cell: IVec3) -> DVec3 {
        match &self.fields.wide {
            Some(wide) if self.is_wider(cell) => wide.falling(cell >> 1),
            _ => self.fields.own.falling(cell),
        }
    }

    /// The outward normal of a vertex.
    fn normal(&self, cell: IVec3, axis: usize, fraction: f64) -> [f32; 3] {
        let step = IVec3::AXES[axis];
        let ends = [cell, cell + step];
        let [lower, upper] = ends.map(|cell| self.of(cell));
        let along = DVec3::AXES[axis].as_vec3().to_array();
        match (lower.is_within_walls, upper.is_within_walls) {
            (false, true) => along.map(|x| -x),
            (true, false) => along,
            _ => {
                let falls_up = lower.sample > upper.sample;
                normal((cell, axis), fraction, falls_up, ends.map(|cell| self.falling(cell)), None)
            }
        }
    }
}

/// The triangles of a dual cell. `case` has a bit for each corner that is inside, and `wider` for
/// each corner in a wider cell.
pub fn joined_triangles(cell: IVec3, case: usize, wider: u8) -> Triangles {
    if wider == 0 {
        return TABLE[case].clone();
    }
    // Along each axis, a cell with an even coordinate and the next cell are in the same wide cell.
    let axes = (0..3).fold(0, |axes, axis| axes | u8::from(cell[axis] & 1 == 0) << axis);
    JoinedCorners { wide: wider, axes }.triangles(case as u8)
}

/// The surface at `iso` in the tiles of `region`, for a block that has, together with its upper
/// neighbours, cells of several levels. `region` must be part of that block. Returns `None` if
/// there is no surface.
///
/// # Panics
/// If the fields do not cover the cells that [`cells_by_level`] returns, and one more cell on each
/// side for normals.
#[must_use]
pub fn mixed_block_mesh(
    fields: &LevelFields,
    (block, level): (IVec3, BlockLevel),
    region: CellBox,
    iso: Isovalue,
    normals: Normals,
) -> Option<BlockMesh> {
    let mixed = MixedBlock { fields, block, level };
    let mut mesh = BlockMesh { block, level, ..BlockMesh::default() };
    let region = region.tiled();
    let cells = dual_cells(region);
    let inside = mixed.inside(cells, iso);
    let tile_edge = IVec3::splat(TILE);
    let mut tiles: Vec<IVec3> = region.cubes(TILE).collect();
    let index = |tile: IVec3| local_morton(tile - block * (BLOCK / TILE)) as u32;
    tiles.sort_unstable_by_key(|&tile| index(tile));
    for place in tiles {
        let near = CellBox::cube(place, TILE).grown(0, 1);
        let count: usize =
            inside.rows(near).flat_map(|(_, row)| row).map(|&cell| usize::from(cell)).sum();
        if count == 0 || count == near.volume() {
            continue;
        }
        let mut tile = Tile { index: index(place), first_vertex: 0, corners: [0; 8] };
        for (k, corner) in (0_i32..).zip(&mut tile.corners) {
            let offset = corner_offset(k);
            for bit in 0..64 {
                let cell = place * tile_edge + cell_of_bit(bit) + offset;
                *corner |= u64::from(inside.at(cell)) << bit;
            }
        }
        let crossed = level.crossed(&tile);
        let dual = level.mixed(&tile);
        if dual == 0 && crossed == [0; 3] {
            continue;
        }
        tile.first_vertex = mesh.ends.len() as u32;
        for (cell, axis) in level.edges(&tile) {
            let cell = place * tile_edge + cell;
            let [lower, upper] = [cell, cell + IVec3::AXES[axis]].map(|cell| mixed.of(cell));
            // A ghost point beyond a wall has the value of its mirror image inside the wall.
            let ends = match (lower.is_within_walls, upper.is_within_walls) {
                (true, false) => [lower.sample; 2],
                (false, true) => [upper.sample; 2],
                _ => [lower.sample, upper.sample],
            };
            mesh.ends.push(ends);
            if normals == Normals::Gradient {
                let fraction = Crossings::from(iso).fraction(ends);
                mesh.normals.push(mixed.normal(cell, axis, fraction));
            }
        }
        let wider = level.of_tile(&tile).wider;
        mesh.triangle_count += bits(dual)
            .map(|bit| {
                let cell = place * tile_edge + cell_of_bit(bit);
                joined_triangles(cell, tile.case(bit), at_corners(&wider, bit)).len()
            })
            .sum::<usize>();
        mesh.tiles.push(tile);
    }
    (!mesh.tiles.is_empty()).then_some(mesh)
}

/// Collects the bits of one dual cell: bit k of the result is bit number `bit` of `corners[k]`.
#[must_use]
pub fn at_corners(corners: &[u64; 8], bit: u32) -> u8 {
    (0..8).fold(0, |all, k| all | ((corners[k] >> bit & 1) as u8) << k)
}
