//! See `mod.rs` of this folder for the formulas.

use glam::{DVec3, IVec3};
use multiversion::multiversion;

use crate::brick::Block;
use crate::grid::{BLOCK, CellBox, TILE, local_morton};
use crate::surface::mesh::{BlockMesh, Tile, TileMask, bits, cell_of_bit};

use super::cases::TABLE;
use super::{Crossings, Level, Normals};

/// The surface in the tiles of `region`, which must be part of one block. There is one vertex on
/// each crossed dual edge.
///
/// Cells outside `walls` are ghost points, and must have the sample of the nearest cell within the
/// walls. The result contains every tile with a dual cell of mixed signs, even if all vertices of
/// its triangles belong to neighbouring tiles.
///
/// # Panics
/// If `field` does not cover the region's tiles and one cell beyond their upper faces.
pub fn contour<L: Level>(
    field: &Block<L::Sample>,
    region: CellBox,
    level: L,
    walls: Option<CellBox>,
) -> BlockMesh {
    let region = region.tiled();
    let block = region.lo.div_euclid(IVec3::splat(BLOCK));
    let signs = Signs::of(field, region, level, walls);
    let (samples, strides) = (field.samples(), field.strides());
    let mixed = signs.mixed_tiles();
    let mut tiles = Vec::with_capacity(mixed.iter().map(|tiles| tiles.count_ones() as usize).sum());
    let (mut vertices, mut triangle_count) = (0, 0);
    for index in (0..)
        .step_by(64)
        .zip(mixed)
        .flat_map(|(first, mixed)| bits(mixed).map(move |bit| first + bit))
    {
        let mut tile = Tile { index, first_vertex: vertices, corners: [0; 8] };
        tile.corners = signs.corners(tile.corner(block));
        vertices += (0..3).map(|axis| tile.crossed(axis).count_ones()).sum::<u32>();
        triangle_count += bits(tile.mixed()).map(|bit| TABLE[tile.case(bit)].len()).sum::<usize>();
        tiles.push(tile);
    }
    let mut ends = Vec::with_capacity(vertices as usize);
    for tile in &tiles {
        let first = field.index(tile.corner(block));
        for (axis, step) in strides.into_iter().enumerate() {
            ends.extend(bits(tile.crossed(axis)).map(|bit| {
                // A ghost point beyond a wall has the value of its mirror image.
                let cell = cell_of_bit(bit).as_usizevec3();
                let lower = first + cell.x + cell.y * strides[1] + cell.z * strides[2];
                level.ends(samples[lower], samples[lower + step])
            }));
        }
    }
    BlockMesh { block, tiles, ends, triangle_count, ..BlockMesh::default() }
}

/// The surface that [`contour`] returns for `region`, with normals if requested; `None` if there is
/// no surface.
///
/// # Panics
/// If `field` does not cover the cells that [`Normals::cells`] returns.
pub fn block_mesh<L: Level + Into<Crossings>>(
    field: &Block<L::Sample>,
    region: CellBox,
    level: L,
    with: Normals,
    walls: Option<CellBox>,
) -> Option<BlockMesh>
where
    L::Sample: Into<f64>,
{
    let mut mesh = contour(field, region, level, walls);
    if with == Normals::Gradient {
        mesh.normals = normals(field, &mesh, level.into(), walls);
    }
    (!mesh.tiles.is_empty()).then_some(mesh)
}

/// The outward unit normals of all vertices. A normal is the negative gradient of the field,
/// computed by central differences at both ends of the vertex's edge and interpolated. On a wall,
/// it is the normal of the wall.
fn normals<T: Copy + Default + Into<f64>>(
    field: &Block<T>,
    mesh: &BlockMesh,
    crossings: Crossings,
    walls: Option<CellBox>,
) -> Vec<[f32; 3]> {
    let strides = field.strides();
    let sample = |index: usize| -> f64 { field.samples()[index].into() };
    let falling =
        |index: usize| DVec3::from(strides.map(|s| sample(index - s) - sample(index + s)));
    let mut normals = Vec::with_capacity(mesh.ends.len());
    normals.extend(mesh.edges().zip(&mesh.ends).map(|((cell, axis), &ends)| {
        let at = field.index(cell);
        let at = [at, at + strides[axis]];
        let falls_up = sample(at[0]) > sample(at[1]);
        normal((cell, axis), crossings.fraction(ends), falls_up, at.map(falling), walls)
    }));
    normals
}

/// Computes the normal of a vertex from its edge, its position on the edge, whether the field falls
/// along the edge, and the decrease of the field along each axis at both ends of the edge.
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
    // If the gradient is zero, the normal points along the edge.
    let fallback = if falls_up { along } else { -along };
    normal.try_normalize().unwrap_or(fallback).as_vec3().to_array()
}

/// Number of cells, along each axis, at the corners of a tile's dual cells.
const ROWS: usize = TILE as usize + 1;

/// Number of tiles along a block's edge.
const TILES: i32 = BLOCK / TILE;

/// The signs of a region's cells and of one layer beyond its upper faces. There is one word for
/// each row of cells along x; from word to word, y varies fastest.
struct Signs {
    region: CellBox,
    rows: Vec<u64>,
}

impl Signs {
    fn of<L: Level>(
        field: &Block<L::Sample>,
        region: CellBox,
        level: L,
        walls: Option<CellBox>,
    ) -> Self {
        let cells = region.grown(0, 1);
        let size = cells.size().as_usizevec3();
        let mut signs = Self { region, rows: vec![0; size.y * size.z] };
        let inside_walls = walls.map_or(cells, |walls| cells.intersection(&walls));
        if !inside_walls.is_empty() {
            let shift = inside_walls.lo.x - cells.lo.x;
            field.rows(inside_walls).for_each(|([y, z], row)| {
                let index = signs.index(y, z);
                signs.rows[index] = row_signs(row, level) << shift;
            });
        }
        signs
    }

    /// The index in `rows` of the row at (y, z).
    fn index(&self, y: i32, z: i32) -> usize {
        let CellBox { lo, hi } = self.region;
        ((y - lo.y) + (hi.y + 1 - lo.y) * (z - lo.z)) as usize
    }

    /// The rows that the dual cells of the tiles at (y, z) use: for each layer in z, the words of
    /// its rows.
    fn rows(&self, y: i32, z: i32) -> [&[u64]; ROWS] {
        std::array::from_fn(|up| &self.rows[self.index(y, z + up as i32)..][..ROWS])
    }

    /// A bit for each tile of the block, in Morton order: whether the tile has dual cells of mixed
    /// signs.
    fn mixed_tiles(&self) -> [u64; TILES.pow(3) as usize / 64] {
        let CellBox { lo, hi } = self.region;
        let block = lo.div_euclid(IVec3::splat(BLOCK));
        let tiles = 0x1111_1111 >> (BLOCK - (hi.x - lo.x));
        let mut mixed = [0; TILES.pow(3) as usize / 64];
        for z in (lo.z..hi.z).step_by(TILE as usize) {
            for y in (lo.y..hi.y).step_by(TILE as usize) {
                let rows = self.rows(y, z);
                let (any, all) =
                    rows.into_iter().flatten().fold((0, !0), |(a, b), row| (a | row, b & row));
                let (any, all) =
                    (1..ROWS).fold((any, all), |(a, b), x| (a | any >> x, b & all >> x));
                for x in bits(any & !all & tiles) {
                    let index =
                        local_morton(IVec3::new(lo.x + x as i32, y, z) / TILE - block * TILES);
                    mixed[index / 64] |= 1 << (index % 64);
                }
            }
        }
        mixed
    }

    /// The signs of the grid cells at the eight corners of each dual cell in the tile that starts
    /// at `corner`, as one mask per corner. Bit i of a corner's index is set if the corner is on
    /// the upper side along axis i.
    fn corners(&self, corner: IVec3) -> [TileMask; 8] {
        let rows = self.rows(corner.y, corner.z);
        let x = corner.x - self.region.lo.x;
        // The signs of four cells from each row of a layer.
        let layer = |up_x: i32, z: usize| {
            (0..ROWS)
                .fold(0, |layer, y| layer | (rows[z][y] >> (x + up_x) & 0xf) << (TILE as usize * y))
        };
        let layers: [[u64; ROWS]; 2] = [0, 1].map(|up_x| std::array::from_fn(|z| layer(up_x, z)));
        std::array::from_fn(|k| {
            let [up_x, up_y, up_z] = [k & 1, k >> 1 & 1, k >> 2];
            (0..4).fold(0, |word, z| {
                word | (layers[up_x][z + up_z] >> (4 * up_y) & 0xffff) << (16 * z)
            })
        })
    }
}

/// A word in which bit i is set if sample i is inside.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn row_signs<L: Level>(row: &[L::Sample], level: L) -> u64 {
    let (words, rest) = row.as_chunks::<16>();
    let rest = (0..)
        .zip(rest)
        .fold(0, |signs, (i, &sample)| signs | u64::from(level.is_inside(sample)) << i);
    words.iter().rev().fold(rest, |all, word| {
        let bit = |i: usize| if level.is_inside(word[i]) { 1_u16 << i } else { 0 };
        all << 16 | u64::from(std::array::from_fn::<u16, 16, _>(bit).iter().fold(0, |a, b| a | b))
    })
}
