//! Estimates of a frame's memory and disk space, and plans for budgets that are smaller than the
//! estimate.
//!
//! An estimate is made when the particles are counted by bin, before anything is stored for them.
//! Each stage has functions that return its memory; this module adds up their results.

use bytesize::ByteSize;
use glam::IVec3;
use thiserror::Error;

use crate::brick::{Bins, FrameFacts, HALVED, PageInfo, PageSamples, PageShape, SpilledBins};
use crate::field::sizes::BlockLevels;
use crate::grid::units::{MemoryBudget, shown};
use crate::grid::{BIN, BLOCK, MortonKey};
use crate::io::mnf::PackableFrame;
use crate::surface::attribute;
use crate::surface::dual_mc::block_vertices;
use crate::surface::mesh::spool::{TILE_BYTES_PER_VERTEX, blocks_bytes, vertex_bytes};
use crate::surface::stitch::writing_bytes;

use super::expected::{self, ExpectedVertices};
use super::{Method, Surfacing};

/// Memory, in bytes, of the program without data.
const PROGRAM: u64 = 8 << 20;
/// Memory, in bytes, that each thread needs in addition to its buffers.
const THREAD: u64 = 3 << 18;
/// Minimum number of blocks that each thread meshes before the surfaces of these blocks are passed
/// on.
pub const BLOCKS_PER_THREAD: usize = 2;
/// Maximum memory, in bytes, of the blocks that get wide attributes (attributes with many
/// components) at the same time, unless a single block needs more.
pub const CARRIED_BYTES: u64 = 8 << 20;

/// The minimum budget.
pub const SMALLEST_BUDGET: MemoryBudget = MemoryBudget(16 << 20);

/// Estimated bytes by purpose, and the expected number of vertices.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct MemoryEstimate {
    /// The program, its threads and its backend.
    pub program: u64,
    /// Buffers of the threads while the field is sampled; they are freed afterwards.
    pub sampling: u64,
    /// Buffers of the threads while the surface is made.
    pub meshing: u64,
    /// An unpacked or decoded input, until its field is sampled.
    pub input: u64,
    /// Tables of bins.
    pub index: u64,
    /// Positions of particles, kept from the first reading until particles are sorted.
    pub counted_positions: u64,
    /// Sorted particles, with their attributes.
    pub particles: u64,
    /// Minimum size of the particles in the coded form in which they are stored until they are
    /// sorted.
    pub spilled: u64,
    /// Maximum size of the DIF.
    pub field: u64,
    /// Size of the DIF in wider cells, which is computed after sampling and is included in `field`.
    pub wide: u64,
    /// Expected size of the surface before it is written.
    pub surface: u64,
    /// Expected number of vertices of the surface.
    pub vertices: u64,
    /// Expected number of vertices if all cells were as narrow as the finest, like the voxels of a
    /// level set.
    pub in_finest_cells: u64,
    /// Whether particles are kept for their attributes until the surface is done.
    pub carried: bool,
}

/// The quantities that determine the memory of the surface stages.
#[derive(Debug, Clone, PartialEq)]
pub struct Extraction {
    /// Memory, in bytes, of a block while its field is computed.
    pub block_bytes: u64,
    /// The distance, in cells, within which particles affect the attributes of a cell.
    pub carried_halo: i32,
    /// Whether the filters keep details, so that every drop and every sheet can have a surface.
    pub keeps_details: bool,
    /// The particles' spacing in cells, if it is known.
    pub spacing_cells: Option<f64>,
    /// The number of levels of cells, which follows from the sizes of the particles.
    pub levels: usize,
    /// The number of wider copies of the DIF, each with cells twice as wide as the previous.
    pub wide_levels: u32,
    /// Whether vertices get normals.
    pub normals: bool,
    /// Number of components of each vertex attribute.
    pub components: Vec<usize>,
}

/// A strategy to keep a frame within its memory budget.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MemoryPlan {
    /// Everything fits in memory; nothing is written to the disk.
    InCore,
    /// Data that exceeds its share goes to scratch files.
    OutOfCore(MemoryShares),
}

/// Maximum bytes that may be in memory at once, by purpose.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MemoryShares {
    /// Bytes of particles that are being sorted.
    pub particles: u64,
    /// Bytes of coded particles that are not sorted yet, and of the DIF of the sorted particles.
    pub coded: u64,
    /// Bytes of the DIF.
    pub field: u64,
    /// Bytes of the surface.
    pub surface: u64,
}

/// An error: the frame does not fit into its memory budget.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[error(
    "with a cell size of {}, even the tables for sorting the particles exceed the memory limit of \
     {}; use a cell size of at least {}",
    shown(*cell_size), ByteSize(*budget), shown(*fitting_cell_size)
)]
pub struct OverBudget {
    /// The requested cell size.
    pub cell_size: f64,
    /// The budget, in bytes.
    pub budget: u64,
    /// The cell size, doubled until the tables of bins fit.
    pub fitting_cell_size: f64,
}

impl Extraction {
    /// Bytes of a vertex, without the bytes of its tile.
    fn vertex_bytes(&self) -> u64 {
        vertex_bytes(self.normals, &self.components)
    }

    /// The expected surface in the bins for which `meshed` is true. `bins` lists the number of
    /// particles in each bin.
    fn surface(
        &self,
        bins: impl Iterator<Item = (MortonKey, usize)> + Clone,
        meshed: impl Fn(IVec3) -> bool,
    ) -> ExpectedVertices {
        if let (Some(spacing_cells), 2..) = (self.spacing_cells, self.levels) {
            return expected::surface_of_octaves(bins, self.levels, spacing_cells, meshed);
        }
        // If the spacing is unknown, the bin with the most particles is assumed to be full.
        let most = || bins.clone().map(|(_, count)| count).max().unwrap_or(0) as f64;
        let full = self.spacing_cells.map_or_else(most, expected::full_bin);
        let alone = expected::vertices_alone(self.spacing_cells.unwrap_or(1.0));
        expected::surface(bins, full, alone, meshed)
    }

    /// Size, in bytes, of the threads' buffers while a surface is meshed and written.
    fn meshing_bytes(&self, surface: &ExpectedVertices) -> u64 {
        let threads = rayon::current_num_threads() as u64;
        let vertices_of =
            |blocks: u64| surface.vertices_of(blocks, block_vertices(self.keeps_details));
        let cells = |halo: i32| ((BLOCK + 3 + 2 * halo) as u64).pow(3);
        let carried = self.components.iter().map(|&components| attribute::cell_bytes(components));
        let carrying = cells(self.carried_halo) * carried.max().unwrap_or(0);
        let blocks = threads * BLOCKS_PER_THREAD as u64;
        let meshed = |blocks, vertex_bytes| blocks_bytes(blocks, vertices_of(blocks), vertex_bytes);
        let whole = meshed(blocks, self.vertex_bytes());
        let in_groups = meshed(blocks, vertex_bytes(self.normals, &[]))
            + 2 * meshed(1, self.vertex_bytes()).max(CARRIED_BYTES);
        let are_wide = attribute::are_wide(self.components.iter().copied());
        let meshing = threads * carrying.max(self.block_bytes)
            + if are_wide { in_groups.min(whole) } else { whole };
        meshing.max(writing_bytes(threads, vertices_of(threads)))
    }
}

/// Maximum size, in bytes, of the pages of the DIF in wider cells: cells that are 2, 4, ... times
/// as wide. `bins` lists the number of nonzero samples in each bin.
fn wide_bytes(bins: impl Iterator<Item = (MortonKey, usize)>, levels: u32) -> u64 {
    let page = |nonzero: usize| {
        PageSamples::most_bytes(nonzero.min(BIN.pow(3) as usize), 1, HALVED) as u64
    };
    // For each level, the page whose samples are being summed. The bins of a page are consecutive.
    let mut open: Vec<(IVec3, usize)> = vec![(IVec3::MAX, 0); levels as usize];
    let mut bytes = 0;
    for (key, nonzero) in bins {
        for (level, (coord, sum)) in (1..).zip(&mut open) {
            let wide = key.coord() >> level;
            if wide != *coord {
                bytes += page(std::mem::take(sum));
                *coord = wide;
            }
            *sum = sum.saturating_add(nonzero);
        }
    }
    bytes + open.into_iter().map(|(_, sum)| page(sum)).sum::<u64>()
}

impl MemoryEstimate {
    /// An estimate for particles that are counted by bin. `bins` is in Morton order, `shape` is the
    /// shape of the DIF's pages, if there is a DIF, and `input` is the size of the input in bytes.
    /// Only bins for which `meshed` is true get a surface.
    pub fn of(
        bins: impl Iterator<Item = (MortonKey, usize)> + Clone,
        shape: Option<PageShape>,
        extraction: &Extraction,
        input: u64,
        meshed: impl Fn(IVec3) -> bool,
    ) -> Self {
        let mut estimate = Self { input, ..Self::without_particles(extraction) };
        let nonzero =
            |count: usize, shape: PageShape| count.saturating_mul(shape.cells_per_particle());
        let page = |count: usize, shape: PageShape| {
            let bricks = count.min(shape.side.bricks_per_bin());
            PageSamples::most_bytes(nonzero(count, shape), bricks, shape) as u64
        };
        if let Some(shape) = shape {
            let by_bin = bins.clone().map(|(key, count)| (key, nonzero(count, shape)));
            estimate.add_wide(wide_bytes(by_bin, extraction.wide_levels));
        }
        for (_, count) in bins.clone() {
            estimate.particles += count as u64 * Bins::particle_bytes(&extraction.components);
            estimate.spilled +=
                count as u64 * SpilledBins::least_particle_bytes(&extraction.components);
            estimate.add_bin(shape.map_or(0, |shape| page(count, shape)));
        }
        estimate.add_levels(bins.clone().count(), extraction);
        estimate.and_surface(&extraction.surface(bins, meshed), extraction)
    }

    /// An estimate for a packed frame, whose samples are in a file.
    pub fn of_packed(packed: PackableFrame<'_>, surfacing: &Surfacing) -> Self {
        let FrameFacts { spacing, grid, .. } = packed.facts();
        let method = Method::from(packed.indicator());
        let coarsest = packed.coarsest();
        let extraction = surfacing.extraction(method, *spacing, coarsest, grid, Vec::new());
        let mut estimate = Self::without_particles(&extraction);
        let full_cells = |page: &PageInfo| (page.key, page.full_count as usize);
        for (octave, field) in packed.fields() {
            let shape = field.shape();
            let nonzero =
                |(key, full): (MortonKey, usize)| (key, full * shape.cells_per_particle());
            let pages = field.infos().iter();
            let coarser = (extraction.levels as u32 - 1).saturating_sub(octave);
            estimate.add_wide(wide_bytes(
                pages.clone().map(full_cells).map(nonzero),
                extraction.wide_levels + coarser,
            ));
            pages.clone().for_each(|page| estimate.add_bin(page.most_bytes(shape) as u64));
            estimate.add_levels(pages.len(), &extraction);
        }
        // Each octave is meshed only in its own cells, so there is one level.
        let in_octave = Extraction { levels: 1, ..extraction.clone() };
        let mut surface = ExpectedVertices::default();
        for (octave, field) in packed.volumes() {
            let pages = field.infos().iter().map(full_cells);
            surface.add(in_octave.surface(pages, |_| true), octave);
        }
        estimate.and_surface(&surface, &extraction)
    }

    /// An estimate that includes no particles.
    pub fn without_particles(extraction: &Extraction) -> Self {
        Self {
            program: PROGRAM + THREAD * rayon::current_num_threads() as u64,
            meshing: extraction.meshing_bytes(&ExpectedVertices::MOST),
            carried: !extraction.components.is_empty(),
            ..Self::default()
        }
    }

    /// Adds the constant memory of the backend.
    pub fn and_backend(self, bytes: u64) -> Self {
        Self { program: self.program + bytes, ..self }
    }

    /// Sets the memory of the surface from the expected vertices.
    fn and_surface(self, expected: &ExpectedVertices, extraction: &Extraction) -> Self {
        let surface = (extraction.vertex_bytes() + TILE_BYTES_PER_VERTEX) * expected.vertices;
        let meshing = extraction.meshing_bytes(expected);
        let &ExpectedVertices { vertices, in_finest_cells, .. } = expected;
        Self { surface, vertices, in_finest_cells, meshing, ..self }
    }

    /// Adds a bin that contains `field` bytes of the DIF.
    fn add_bin(&mut self, field: u64) {
        self.index += Bins::TABLE_BYTES;
        self.field += field;
    }

    /// Adds the tables of blocks that are divided into narrower blocks because of particles in
    /// `bins` bins.
    fn add_levels(&mut self, bins: usize, extraction: &Extraction) {
        if extraction.levels > 1 {
            self.index += bins as u64 * BlockLevels::BIN_BYTES;
        }
    }

    /// Adds the size, in bytes, of the DIF in wider cells.
    fn add_wide(&mut self, bytes: u64) {
        self.wide += bytes;
        self.field += bytes;
    }

    /// Peak memory, in bytes, if everything is kept in memory.
    pub fn in_core(&self) -> u64 {
        let sampling = self.sampling
            + self.input
            + self.particles
            + self.counted_positions.max(self.field - self.wide);
        let meshing = self.meshing + self.field + self.surface + self.kept_particle_bytes();
        self.program + self.index + sampling.max(meshing)
    }

    /// Bytes of the particles that are kept for their attributes until the surface is done.
    fn kept_particle_bytes(&self) -> u64 {
        if self.carried { self.particles } else { 0 }
    }

    /// Whether the surface exceeds its share of memory under a plan and therefore goes to a file.
    pub fn has_surface_in_files(&self, plan: MemoryPlan) -> bool {
        matches!(plan, MemoryPlan::OutOfCore(shares) if self.surface > shares.surface)
    }

    /// Maximum disk space, in bytes, of scratch files under a plan.
    pub fn scratch(&self, plan: MemoryPlan) -> u64 {
        let MemoryPlan::OutOfCore(shares) = plan else { return 0 };
        let beyond = |bytes: u64, share: u64| if bytes > share { bytes } else { 0 };
        self.particles * if self.carried { 2 } else { 1 }
            + beyond(self.field, shares.field)
            + beyond(self.surface, shares.surface)
    }

    /// Minimum disk space, in bytes, of scratch files under a plan.
    pub fn least_scratch(&self, plan: MemoryPlan) -> u64 {
        match plan {
            MemoryPlan::InCore => 0,
            MemoryPlan::OutOfCore(shares) => {
                self.spilled.saturating_sub(shares.coded) + self.kept_particle_bytes()
            }
        }
    }

    /// The strategy for `budget`.
    pub fn plan(&self, budget: MemoryBudget) -> MemoryPlan {
        if self.in_core() <= budget.0 {
            return MemoryPlan::InCore;
        }
        let threads = self.sampling.max(self.meshing);
        let left = budget
            .0
            .saturating_sub(self.program + threads + self.input + self.index)
            .max(budget.0 / 8);
        // The DIF stays completely in memory if it takes at most three quarters of `left`. It has
        // priority over the surface, which is used only once.
        let field = if self.field <= left / 4 * 3 { self.field.max(left / 4) } else { left / 4 };
        // The shares leave some of `left` for stacks and for the allocator's reserve, both while
        // coded particles exist and, later, while the surface exists.
        let surface = ((left - field) / 2).min(left / 4);
        MemoryPlan::OutOfCore(MemoryShares {
            particles: left / 8,
            coded: left / 4 * 3,
            field,
            surface,
        })
    }

    /// Maximum bytes of the surface in memory under `budget`; a larger surface goes to a scratch
    /// file. The estimate of a surface is not reliable: a low isovalue or a wide filter can make
    /// the surface larger.
    pub fn surface_share(&self, budget: MemoryBudget) -> u64 {
        match self.plan(budget) {
            MemoryPlan::OutOfCore(shares) => shares.surface,
            MemoryPlan::InCore => {
                let others = self.program
                    + self.meshing
                    + self.index
                    + self.field
                    + self.kept_particle_bytes();
                budget.0.saturating_sub(others)
            }
        }
    }

    /// The peak memory, in bytes, under a plan.
    pub fn peak(&self, plan: MemoryPlan) -> u64 {
        match plan {
            MemoryPlan::InCore => self.in_core(),
            MemoryPlan::OutOfCore(MemoryShares { particles, coded, field, surface }) => {
                let sampling =
                    self.sampling + self.input + particles + coded.min(self.particles).max(field);
                self.program
                    + self.index
                    + sampling.max(self.meshing + field + surface.min(self.surface))
            }
        }
    }
}
