//! See the room's `mod.rs` for the formulas.

use glam::{DVec3, IVec3};

use crate::brick::Block;
use crate::grid::{BLOCK, CellBox, TILE, local_from_morton, local_morton};
use crate::mesh::{BlockMesh, Tile, TileMask, bits};

use super::table::TABLE;
use super::{Crossings, Level};

/// The surface through the tiles of `region`, a part of one block, and the dual edges it crosses.
///
/// Cells outside of `walls` are ghost points, and must repeat the edge cells. Every tile with a dual cell of mixed
/// signs is there, even when all its vertices are owned by its neighbours.
///
/// # Panics
/// If `field` does not cover the region's tiles and one cell beyond their upper faces.
#[must_use]
pub fn contour<L: Level>(
    field: &Block<L::Sample>,
    region: CellBox,
    level: L,
    walls: Option<CellBox>,
) -> BlockMesh {
    let region = region.tiled();
    let block = region.lo.div_euclid(IVec3::splat(BLOCK));
    let signs = Signs::of(field, region, level, walls);
    let mut mesh = BlockMesh { block, ..BlockMesh::default() };
    let mut local: Vec<usize> =
        region.cubes(TILE).map(|tile| local_morton(tile - block * (BLOCK / TILE))).collect();
    local.sort_unstable();
    for index in local {
        let corner = block * BLOCK + local_from_morton(index) * TILE;
        let tile = Tile {
            index: index as u32,
            first_vertex: mesh.ends.len() as u32,
            corners: signs.corners(corner),
        };
        let mixed = tile.mixed();
        if mixed == 0 {
            continue;
        }
        mesh.triangle_count += bits(mixed).map(|bit| TABLE[tile.case(bit)].len()).sum::<usize>();
        let strides = field.strides();
        mesh.ends.extend(tile.edges().map(|(cell, axis)| {
            // Beyond a wall the field repeats the edge cell, so a ghost's end reads like its mirror image.
            let lower = field.index(corner + cell);
            level.ends(field.samples()[lower], field.samples()[lower + strides[axis]])
        }));
        mesh.tiles.push(tile);
    }
    mesh
}

/// Outward unit normals: the field's falling gradient by central differences at both ends of a vertex's
/// edge, interpolated. On a wall it is the wall's.
///
/// # Panics
/// If `field` does not cover one cell all round both ends of every edge.
#[must_use]
pub fn normals<T: Copy + Default + Into<f64>>(
    field: &Block<T>,
    mesh: &BlockMesh,
    crossings: Crossings,
    walls: Option<CellBox>,
) -> Vec<[f32; 3]> {
    let strides = field.strides();
    let sample = |index: usize| -> f64 { field.samples()[index].into() };
    let falling = |index: usize| DVec3::from(strides.map(|s| sample(index - s) - sample(index + s)));
    mesh.edges()
        .zip(&mesh.ends)
        .map(|((cell, axis), &ends)| {
            let at = field.index(cell);
            let at = [at, at + strides[axis]];
            let falls_up = sample(at[0]) > sample(at[1]);
            normal((cell, axis), crossings.fraction(ends), falls_up, at.map(falling), walls)
        })
        .collect()
}

/// The normal of one vertex, given its edge, how far along it lies, whether the field falls along it, and by how much
/// the field falls along each axis around both ends.
#[must_use]
pub fn normal(
    (cell, axis): (IVec3, usize),
    fraction: f64,
    falls_up: bool,
    [lower, upper]: [DVec3; 2],
    walls: Option<CellBox>,
) -> [f32; 3] {
    let along = DVec3::AXES[axis];
    if let Some(walls) = walls {
        if !walls.contains(cell) {
            return (-along).as_vec3().to_array();
        }
        if !walls.contains(cell + IVec3::AXES[axis]) {
            return along.as_vec3().to_array();
        }
    }
    let normal = lower * (1.0 - fraction) + upper * fraction;
    // Where the gradient vanishes, the edge itself tells outside from inside.
    let fallback = if falls_up { along } else { -along };
    normal.try_normalize().unwrap_or(fallback).as_vec3().to_array()
}

/// A sign word for every tile of a region and for those beyond its upper faces, of which only the first
/// layer of cells is known.
struct Signs {
    tiles: CellBox,
    words: Vec<TileMask>,
}

impl Signs {
    fn of<L: Level>(field: &Block<L::Sample>, region: CellBox, level: L, walls: Option<CellBox>) -> Self {
        let tile = IVec3::splat(TILE);
        let tiles = CellBox { lo: region.lo / tile, hi: region.hi / tile + 1 };
        let mut signs = Self { tiles, words: vec![0; tiles.volume()] };
        let needed = region.grown(0, 1);
        let inside_walls = walls.map_or(needed, |walls| needed.intersection(&walls));
        if inside_walls.is_empty() {
            return signs;
        }
        let shift = inside_walls.lo.x - region.lo.x;
        for ([y, z], row) in field.rows(inside_walls) {
            let mut left = row_signs(row, level) << shift;
            let in_tile = 4 * (y & 3) + 16 * (z & 3);
            let mut word = signs.index(IVec3::new(region.lo.x, y, z));
            while left != 0 {
                signs.words[word] |= (left & 0xf) << in_tile;
                left >>= TILE;
                word += 1;
            }
        }
        signs
    }

    /// Where the word of the tile that holds `cell` is.
    fn index(&self, cell: IVec3) -> usize {
        let local = ((cell >> TILE.ilog2()) - self.tiles.lo).as_usizevec3();
        let size = self.tiles.size().as_usizevec3();
        local.x + size.x * (local.y + size.y * local.z)
    }

    /// The signs of the cells of the tile at `corner`, and of their neighbours one cell up along the axes
    /// in a corner's number.
    fn corners(&self, corner: IVec3) -> [TileMask; 8] {
        let first = self.index(corner);
        let size = self.tiles.size().as_usizevec3();
        let tile = |k: usize| self.words[first + (k & 1) + size.x * ((k >> 1 & 1) + size.y * (k >> 2))];
        let s: [TileMask; 8] = std::array::from_fn(tile);
        let x = |k: usize| up_x(s[k], s[k | 1]);
        let y = |k: usize| up_y(s[k], s[k | 2]);
        let xy = |k: usize| up_y(x(k), x(k | 2));
        [s[0], x(0), y(0), xy(0), up_z(s[0], s[4]), up_z(x(0), x(4)), up_z(y(0), y(4)), up_z(xy(0), xy(4))]
    }
}

/// Bit i is set where sample i is inside.
fn row_signs<L: Level>(row: &[L::Sample], level: L) -> u64 {
    row.iter().rev().fold(0, |signs, &sample| signs << 1 | u64::from(level.is_inside(sample)))
}

/// For each cell of a tile the sign one cell further along x, given the next tile's word; and so on.
fn up_x(tile: TileMask, next: TileMask) -> TileMask {
    tile >> 1 & 0x7777_7777_7777_7777 | next << 3 & 0x8888_8888_8888_8888
}

fn up_y(tile: TileMask, next: TileMask) -> TileMask {
    tile >> 4 & 0x0fff_0fff_0fff_0fff | next << 12 & 0xf000_f000_f000_f000
}

fn up_z(tile: TileMask, next: TileMask) -> TileMask {
    tile >> 16 | next << 48
}
