//! Particles outside the surface: sparse spray that smoothing removes, or spray for which the cells
//! are too coarse.
//!
//! A tile that the surface does not pass through is completely inside or outside. Along a row of
//! tiles, inside and outside alternate only at tiles that the surface passes through, so one pass
//! along x finds all tiles that are outside and contain particles.

use std::io;

use glam::IVec3;
use rayon::prelude::*;

use crate::brick::{Bins, unpack};
use crate::field::calibration::Fullness;
use crate::grid::stretch::Stretch;
use crate::grid::{BIN, BLOCK, CellBox, Grid, TILE, corner_offset, local_from_morton};
use crate::surface::mesh::source::MeshSource;
use crate::surface::mesh::{TileMask, bits, cell_of_bit};
use crate::surface::stitch::StitchedSurface;

use super::coincident::{CoincidentCounts, CoincidentParticles};

/// Number of tiles per bin along an axis. It equals the number of cells per tile along an axis.
/// Therefore, a mask for the cells of a tile also fits the tiles of a bin.
const SIDE: i32 = BIN / TILE;
const _: () = assert!(SIDE == TILE);

/// The tiles with the lowest x in a bin.
const FIRST: TileMask = 0x1111_1111_1111_1111;

/// The tiles that contain particles, by bin, and the number of particles in each bin.
#[derive(Debug, Default)]
pub struct OccupiedTiles {
    bins: Vec<(IVec3, u32, TileMask)>,
    /// The cells whose particles count; particles in other cells are images.
    own: Option<CellBox>,
    full: Fullness,
    coincident: CoincidentCounts,
}

/// A bin that contains particles, as stored in a file.
#[derive(Debug, Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub struct OccupiedBin {
    bin: [i32; 3],
    particles: u32,
    tiles: TileMask,
}

impl FromIterator<OccupiedBin> for OccupiedTiles {
    fn from_iter<T: IntoIterator<Item = OccupiedBin>>(bins: T) -> Self {
        let bin = |OccupiedBin { bin, particles, tiles }| (bin.into(), particles, tiles);
        Self { bins: bins.into_iter().map(bin).collect(), ..Self::default() }
    }
}

impl OccupiedTiles {
    /// Memory, in bytes, per bin while lost particles are counted.
    pub const BIN_BYTES: u64 = (size_of::<(IVec3, u32, TileMask)>() + size_of::<BinInRow>()) as u64;

    /// An empty list of tiles. If `own` cells are given, particles in other cells are images, which
    /// do not count.
    pub(super) fn among(own: Option<CellBox>) -> Self {
        Self { own, ..Self::default() }
    }

    /// Whether there are no particles.
    pub fn is_empty(&self) -> bool {
        self.bins.is_empty()
    }

    /// The bins in a stretch of blocks.
    pub fn within(&self, stretch: Stretch) -> impl Iterator<Item = OccupiedBin> + '_ {
        let bins = self.bins.iter().filter(move |(bin, ..)| stretch.contains_bin(*bin));
        bins.map(|&(bin, particles, tiles)| OccupiedBin { bin: bin.to_array(), particles, tiles })
    }

    /// Adds the tiles of other bins.
    pub fn join(&mut self, other: Self) {
        self.bins.extend(other.bins);
    }

    /// Adds the tiles of `bins` that contain particles.
    pub(super) fn add(&mut self, bins: &Bins) -> io::Result<()> {
        let of_bin = |bin: usize| {
            let contents = bins.contents(bin)?;
            let coord = bins.keys()[bin].coord();
            let cells = contents
                .packed()
                .iter()
                .map(|&record| IVec3::from(unpack(record).0.map(|at| at as i32)));
            let (mut tiles, mut full) =
                (0, Fullness { particles: bins.count(bin) as u64, cells: 0 });
            match self.own.filter(|own| !own.covers(&CellBox::cube(coord, BIN))) {
                None => cells.clone().for_each(|cell| tiles |= bit_of(cell / TILE)),
                Some(own) => {
                    let own = cells.clone().filter(|&cell| own.contains(coord * BIN + cell));
                    full.particles =
                        own.inspect(|&cell| tiles |= bit_of(cell / TILE)).count() as u64;
                }
            }
            if let Some(own) = self.own {
                let of_cell = |cell: IVec3| (cell.x + BIN * (cell.y + BIN * cell.z)) as usize;
                let mut occupied_cells = [0_u64; BIN.pow(3) as usize / 64];
                cells.filter(|&cell| own.contains(coord * BIN + cell)).map(of_cell).for_each(
                    |cell| {
                        occupied_cells[cell / 64] |= 1 << (cell % 64);
                    },
                );
                full.cells = occupied_cells.iter().map(|word| u64::from(word.count_ones())).sum();
            }
            let coincident = match self.own.filter(|own| !own.covers(&CellBox::cube(coord, BIN))) {
                None => CoincidentCounts::among(coord, contents.packed()),
                Some(own) => {
                    let is_own = |&&record: &&u64| {
                        own.contains(
                            coord * BIN + IVec3::from(unpack(record).0.map(|at| at as i32)),
                        )
                    };
                    let records: Vec<u64> =
                        contents.packed().iter().filter(is_own).copied().collect();
                    CoincidentCounts::among(coord, &records)
                }
            };
            Ok((coord, full, tiles, coincident))
        };
        let added: Vec<_> =
            (0..bins.keys().len()).into_par_iter().map(of_bin).collect::<io::Result<_>>()?;
        for (coord, full, tiles, coincident) in
            added.into_iter().filter(|(_, _, tiles, _)| *tiles != 0)
        {
            self.coincident.add(&coincident);
            self.full.particles += full.particles;
            self.full.cells += full.cells;
            self.bins.push((coord, u32::try_from(full.particles).unwrap_or(u32::MAX), tiles));
        }
        Ok(())
    }

    /// The number of particles, and the number of cells that contain them. Without images, the
    /// number of cells is `all_cells`.
    pub(super) fn fullness(&self, all_cells: u64) -> Fullness {
        Fullness {
            cells: if self.own.is_some() { self.full.cells } else { all_cells },
            ..self.full
        }
    }

    /// A report on coincident particles, if there are any. `grid` converts their bins to positions.
    pub fn coincident(&self, grid: &Grid) -> Option<CoincidentParticles> {
        self.coincident
            .report(grid, self.bins.iter().map(|&(bin, particles, _)| (bin, u64::from(particles))))
    }

    /// A lower bound of the density in the tiles that contain particles, relative to the density of
    /// particles `spacing_cells` apart. If tiles are smaller than a spacing, a tile with a single
    /// particle would seem dense, so bins are used instead of tiles.
    pub fn relative_density(&self, spacing_cells: f64) -> f64 {
        let (mean, edge) = if spacing_cells > f64::from(TILE) {
            (self.particles() / self.bins.len().max(1) as f64, BIN)
        } else {
            (self.mean(), TILE)
        };
        mean * (spacing_cells / f64::from(edge)).powi(3)
    }

    fn particles(&self) -> f64 {
        self.bins.iter().map(|&(_, particles, _)| f64::from(particles)).sum()
    }

    /// The mean number of particles in the tiles that contain particles.
    fn mean(&self) -> f64 {
        let tiles: f64 = self.bins.iter().map(|(.., tiles)| f64::from(tiles.count_ones())).sum();
        self.particles() / tiles.max(1.0)
    }

    /// A lower bound of the number of particles outside the surface. A tile is lost if it is
    /// outside, and if the surface passes neither through it nor through an adjacent tile with
    /// lower coordinates. If all tiles of a bin that contain particles are lost, all particles of
    /// the bin count. Otherwise, each lost tile counts as one particle.
    pub fn lost(&self, surface: &StitchedSurface) -> io::Result<u64> {
        let bins = match surface.widest_level() {
            0 => BinInRow::sorted(self, surface)?,
            widest => BinInRow::in_wider_tiles(self, surface, widest)?,
        };
        let passed = |place: IVec3| {
            let bin = BinInRow::key(place.div_euclid(IVec3::splat(SIDE)));
            let found = bins.binary_search_by_key(&bin, |row| BinInRow::key(row.bin));
            found.is_ok_and(|at| bins[at].passed & bit_of(place) != 0)
        };
        let of_row = |row: &[BinInRow]| {
            let mut inside = 0;
            let of_bin = |bin: &BinInRow| {
                let mut outside = 0;
                for x in 0..SIDE {
                    let passed = bin.passed >> x & FIRST;
                    outside |= (FIRST & !passed & !inside) << x;
                    inside = inside & !passed | bin.inside_behind >> x & passed;
                }
                let is_away_from_surface = |&bit: &u32| {
                    let place = bin.bin * SIDE + cell_of_bit(bit);
                    (1..8).all(|i| !passed(place - corner_offset(i)))
                };
                let lost = bits(bin.occupied & outside).filter(is_away_from_surface).count();
                if lost == bin.occupied.count_ones() as usize {
                    u64::from(bin.particles)
                } else {
                    lost as u64
                }
            };
            row.iter().map(of_bin).sum::<u64>()
        };
        Ok(bins.par_chunk_by(|a, b| (a.bin.z, a.bin.y) == (b.bin.z, b.bin.y)).map(of_row).sum())
    }
}

/// A bin in a row of bins along x: its number of particles, the tiles that contain particles, and
/// the tiles that the surface passes through.
#[derive(Debug, Default, Clone, Copy)]
struct BinInRow {
    bin: IVec3,
    particles: u32,
    occupied: TileMask,
    /// Tiles that the surface passes through.
    passed: TileMask,
    /// The tiles of `passed` that are followed, along x, by the inside of the surface.
    inside_behind: TileMask,
}

impl BinInRow {
    fn key(bin: IVec3) -> [i32; 3] {
        [bin.z, bin.y, bin.x]
    }

    /// All bins that contain particles or meet the surface, row by row.
    fn sorted(occupied: &OccupiedTiles, surface: &StitchedSurface) -> io::Result<Vec<Self>> {
        let from_occupied =
            |&(bin, particles, occupied)| Self { bin, particles, occupied, ..Self::default() };
        let mut all: Vec<Self> = occupied.bins.iter().map(from_occupied).collect();
        for piece in 0..surface.pieces() {
            let first = surface.block(piece) * (BLOCK / TILE);
            for tile in &*surface.tiles(piece)? {
                let place = first + local_from_morton(tile.index as usize);
                let passed = bit_of(place);
                let behind = tile.corners[1] >> (TILE - 1) & 1;
                let bin = place.div_euclid(IVec3::splat(SIDE));
                // Tiles are in Morton order, so the tiles of a bin are consecutive.
                if all.len() == occupied.bins.len()
                    || all.last().is_some_and(|last| last.bin != bin)
                {
                    all.push(Self { bin, ..Self::default() });
                }
                let Some(last) = all.last_mut() else { continue };
                last.passed |= passed;
                last.inside_behind |= passed * behind;
            }
        }
        Ok(Self::merged(all))
    }

    /// Like [`sorted`](Self::sorted), for a surface with cells of several levels. Tiles and bins
    /// consist of cells of the widest level.
    fn in_wider_tiles(
        occupied: &OccupiedTiles,
        surface: &StitchedSurface,
        widest: u8,
    ) -> io::Result<Vec<Self>> {
        let widest = i32::from(widest);
        let bin_of = |place: IVec3| place.div_euclid(IVec3::splat(SIDE));
        let from_occupied = |&(bin, particles, tiles): &(IVec3, u32, TileMask)| {
            let places = bits(tiles).map(|bit| (bin * SIDE + cell_of_bit(bit)) >> widest);
            let occupied = places.fold(0, |all, place| all | bit_of(place));
            Self { bin: bin >> widest, particles, occupied, ..Self::default() }
        };
        let mut all: Vec<Self> = occupied.bins.iter().map(from_occupied).collect();
        // Each entry is a tile that the surface passes through: the wide tile that contains it, its
        // end along x, and whether the inside of the fluid follows behind this end. The part of a
        // wide tile behind its last entry is completely on one side of the surface.
        let mut passed: Vec<([i32; 3], i32, bool)> = Vec::new();
        for piece in 0..surface.pieces() {
            let (block, level) = (surface.block(piece), surface.level(piece));
            let own = i32::from(level.level);
            for tile in &*surface.tiles(piece)? {
                let place = tile.corner(block) / TILE;
                // `behind` is the side of the cell behind the tile. If this cell is narrower, the
                // surface between the tile and this cell belongs to the narrower tile, so `behind`
                // is the side of the tile's last cell instead.
                let narrower = level.of_tile(tile).narrower[1] >> (TILE - 1) & 1 == 1;
                let corner = usize::from(!narrower);
                let behind = tile.corners[corner] >> (TILE - 1) & 1 == 1;
                let wide = (place >> (widest - own)).to_array();
                passed.push((wide, (place.x + 1) << own, behind));
            }
        }
        passed.par_sort_unstable();
        let last_of_each = passed.chunk_by(|a, b| a.0 == b.0).filter_map(<[_]>::last);
        all.extend(last_of_each.map(|&(place, _, behind)| {
            let place = IVec3::from(place);
            let passed = bit_of(place);
            let inside_behind = if behind { passed } else { 0 };
            Self { bin: bin_of(place), passed, inside_behind, ..Self::default() }
        }));
        Ok(Self::merged(all))
    }

    /// Sorts bins by rows, and merges those with the same coordinates.
    fn merged(mut all: Vec<Self>) -> Vec<Self> {
        all.par_sort_unstable_by_key(|row| Self::key(row.bin));
        all.dedup_by(|other, one| {
            let same = other.bin == one.bin;
            if same {
                one.particles = one.particles.saturating_add(other.particles);
                one.occupied |= other.occupied;
                one.passed |= other.passed;
                one.inside_behind |= other.inside_behind;
            }
            same
        });
        all
    }
}

/// The bit of a tile in its bin.
fn bit_of(place: IVec3) -> TileMask {
    let [x, y, z] = (place & (SIDE - 1)).to_array();
    1 << (x + SIDE * (y + SIDE * z))
}
