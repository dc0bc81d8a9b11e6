//! What a frame will take of memory and disk, known once its particles are counted by bin and before
//! anything is stored for them; and how to share a budget that is smaller than that.

use bytesize::ByteSize;
use thiserror::Error;

use crate::brick::{CountingRoom, PageInfo, PageSamples, PageShape};
use crate::grid::{BLOCK, BLOCK_TILES};
use crate::mesh::Tile;
use crate::mesh::spool::vertex_bytes;
use crate::stage::dual_mc::Normals;
use crate::stitch::NUMBERS_BYTES;
use crate::units::MemoryBudget;

/// Bytes that the program takes before there is any data, and that each thread takes beside what it works in.
const PROGRAM: u64 = 6 << 20;
const THREAD: u64 = 5 << 18;
/// As many sums more than an attribute has components are there at once while a thread smooths them.
const SUMS: u64 = 3;
/// Blocks that each thread meshes before their surfaces go to the others, at the least.
pub const BLOCKS_A_THREAD: usize = 2;
/// Vertices of a block with much surface.
const VERTICES_A_BLOCK: u64 = 6_000;
/// The same where drops keep theirs: spray is all surface.
const VERTICES_OF_SPRAY: u64 = 20_000;
/// Triangles of a closed surface, nearly.
const TRIANGLES_A_VERTEX: u64 = 2;
/// Bytes that a thread takes for each triangle of a block while it is written: three numbers, and four blocks' records.
const WRITTEN: u64 = 24 + 4 * 13;
/// Bytes a bin takes in tables, however little it holds.
const BIN_BYTES: u64 = 320;
/// Bytes of a binned particle, without attributes.
const RECORD: u64 = 8;
/// Bytes of a particle in a scratch file, at the least.
const SPILLED: u64 = 6;
/// Bytes of places that are kept from the first reading to the second, at the most: frames that have more mostly touch
/// more bins than a place can name.
const MOST_PLACES: u64 = 64 << 20;
/// Bytes of a vertex's share of a tile.
const TILE_SHARE: u64 = 4;
/// Vertices around a particle that is alone.
const VERTICES_A_PARTICLE: u64 = 60;
/// Vertices in a bin full of wrinkled surface: a plane through it has 16^2 times one to two.
const VERTICES_A_BIN: u64 = 2000;

/// The smallest budget that is worth a try.
pub const SMALLEST_BUDGET: MemoryBudget = MemoryBudget(16 << 20);

/// Bytes, by what they are for.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Estimate {
    /// The program, its threads, its backend, and an input that had to be unpacked or decoded.
    pub program: u64,
    /// Tables of bins.
    pub index: u64,
    /// What is kept of the first reading until particles are sorted.
    pub places: u64,
    /// Sorted particles, with their attributes.
    pub particles: u64,
    /// The same particles in a scratch file, not yet sorted: what they take there at the least.
    pub spilled: u64,
    /// The DIF, at the most.
    pub field: u64,
    /// The surface before it is written, at the most.
    pub surface: u64,
    /// Whether particles are needed until the surface is done, for their attributes.
    pub carried: bool,
}

/// What a surface takes while it is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Drawing {
    /// Whether vertices get normals.
    pub normals: Normals,
    /// Whether details are recovered or spared.
    pub details: bool,
    /// How far from a cell the DIF decides its field.
    pub halo: i32,
}

/// How a frame is brought under its budget.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Plan {
    /// Everything fits; nothing touches the disk.
    InCore,
    /// What exceeds its share goes to scratch files.
    OutOfCore(Shares),
}

/// Bytes that may be resident at once.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shares {
    /// Of particles being sorted.
    pub particles: u64,
    /// Of the DIF.
    pub field: u64,
    /// Of the surface.
    pub surface: u64,
}

/// A frame that cannot be brought under its budget.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[error(
    "with a cell size of {cell_size} the tables of bins alone need more than the {} of memory that may be \
     used; a cell size of {fitting_cell_size} fits; or allow more with --memory",
    ByteSize(*budget)
)]
pub struct OverBudget {
    /// What was asked for.
    pub cell_size: f64,
    /// Bytes that may be used.
    pub budget: u64,
    /// The smallest doubling of the cell size that fits.
    pub fitting_cell_size: f64,
}

/// Bytes of the surface of a block that is full of spray, given those of a vertex without its tile.
#[must_use]
pub fn spray_bytes(vertex_bytes: u64) -> u64 {
    block_bytes(VERTICES_OF_SPRAY, vertex_bytes)
}

fn block_bytes(vertices: u64, vertex_bytes: u64) -> u64 {
    vertices * vertex_bytes + u64::from(BLOCK_TILES) * size_of::<Tile>() as u64
}

/// What counting may take under a budget: half of it for tables, and an eighth, or what is worth it, for places.
#[must_use]
pub fn counting_room(budget: MemoryBudget) -> CountingRoom {
    let number = |bytes: u64| usize::try_from(bytes).unwrap_or(usize::MAX);
    let places = (budget.0 / 8).min(MOST_PLACES) / CountingRoom::PLACE;
    CountingRoom { bins: number(budget.0 / 2 / BIN_BYTES), places: number(places) }
}

impl Drawing {
    fn vertex_bytes(self, components: &[usize]) -> u64 {
        vertex_bytes(self.normals == Normals::Gradient, components)
    }

    fn vertices_a_block(self) -> u64 {
        if self.details { VERTICES_OF_SPRAY } else { VERTICES_A_BLOCK }
    }

    /// Bytes that each thread takes.
    fn thread_bytes(self, components: &[usize]) -> u64 {
        // Dual cells reach one cell up, and normals one cell each way.
        let edge = (BLOCK + 3 + 2 * self.halo) as u64;
        let fields = if self.details { 4 } else { 2 } * size_of::<u16>() as u64;
        let sums = |&components: &usize| (components as u64 + SUMS) * size_of::<f64>() as u64;
        let a_cell = components.iter().map(sums).fold(fields, u64::max);
        let meshing = edge.pow(3) * a_cell
            + BLOCKS_A_THREAD as u64 * block_bytes(self.vertices_a_block(), self.vertex_bytes(components));
        let writing = NUMBERS_BYTES + self.vertices_a_block() * TRIANGLES_A_VERTEX * WRITTEN;
        THREAD + meshing.max(writing)
    }
}

impl Estimate {
    /// For particles counted by bin, with attributes of so many components carried, and an input and a backend of which
    /// `in_memory` bytes are taken all the time.
    #[must_use]
    pub fn of(
        counts: impl Iterator<Item = usize>,
        shape: PageShape,
        components: &[usize],
        drawing: Drawing,
        in_memory: u64,
    ) -> Self {
        let mut estimate = Self::of_program(drawing, components, in_memory);
        for count in counts {
            let nonzero = count.saturating_mul(shape.cells_a_particle());
            let bricks = count.min(shape.side.bricks_a_bin());
            let field = PageSamples::most_bytes(nonzero, bricks, shape) as u64;
            estimate.add_bin(count as u64, components, field, drawing);
        }
        estimate
    }

    /// For pages of which the DIF is in a file, and `in_memory` bytes that are taken all the time.
    #[must_use]
    pub fn of_surface(pages: &[PageInfo], shape: PageShape, drawing: Drawing, in_memory: u64) -> Self {
        let mut estimate = Self::of_program(drawing, &[], in_memory);
        for page in pages {
            estimate.add_bin(page.full_count.into(), &[], page.most_bytes(shape) as u64, drawing);
        }
        Self { particles: 0, spilled: 0, ..estimate }
    }

    fn of_program(drawing: Drawing, components: &[usize], in_memory: u64) -> Self {
        let threads = drawing.thread_bytes(components) * rayon::current_num_threads() as u64;
        Self { program: PROGRAM + threads + in_memory, carried: !components.is_empty(), ..Self::default() }
    }

    /// Adds a bin of so many particles, with attributes of so many components, and so many bytes of the DIF.
    fn add_bin(&mut self, count: u64, components: &[usize], field: u64, drawing: Drawing) {
        let attributes = (components.iter().sum::<usize>() * size_of::<f32>()) as u64;
        self.index += BIN_BYTES;
        self.particles += count * (RECORD + attributes);
        self.spilled += count * (SPILLED + attributes);
        self.field += field;
        let vertices = (count * VERTICES_A_PARTICLE).min(VERTICES_A_BIN);
        self.surface += (drawing.vertex_bytes(components) + TILE_SHARE) * vertices;
    }

    /// The peak with everything in memory.
    #[must_use]
    pub fn in_core(&self) -> u64 {
        let meshing = self.field + self.particles.max(self.surface + self.beside_the_surface());
        self.program + self.index + meshing.max(self.places + self.particles)
    }

    /// Particles that carry attributes are needed until the surface is done.
    fn beside_the_surface(&self) -> u64 {
        if self.carried { self.particles } else { 0 }
    }

    /// Disk that scratch files take under a plan, at the most.
    #[must_use]
    pub fn scratch(&self, plan: Plan) -> u64 {
        let Plan::OutOfCore(shares) = plan else { return 0 };
        let beyond = |bytes: u64, share: u64| if bytes > share { bytes } else { 0 };
        self.particles * if self.carried { 2 } else { 1 }
            + beyond(self.field, shares.field)
            + beyond(self.surface, shares.surface)
    }

    /// Disk that scratch files take under a plan, at the least.
    #[must_use]
    pub fn least_scratch(&self, plan: Plan) -> u64 {
        match plan {
            Plan::InCore => 0,
            Plan::OutOfCore(_) => self.spilled + self.beside_the_surface(),
        }
    }

    /// How to keep to `budget`.
    #[must_use]
    pub fn plan(&self, budget: MemoryBudget) -> Plan {
        if self.in_core() <= budget.0 {
            return Plan::InCore;
        }
        let left = budget.0.saturating_sub(self.program + self.index).max(budget.0 / 8);
        Plan::OutOfCore(Shares { particles: left / 2, field: left / 4, surface: left / 4 })
    }

    /// Bytes of the surface that may be in memory under `budget`; what exceeds them goes to a scratch file. The
    /// estimate of a surface is no promise: a low isovalue or a wide filter can make it larger.
    #[must_use]
    pub fn surface_share(&self, budget: MemoryBudget) -> u64 {
        match self.plan(budget) {
            Plan::OutOfCore(shares) => shares.surface,
            Plan::InCore => {
                let others = self.program + self.index + self.field + self.beside_the_surface();
                budget.0.saturating_sub(others)
            }
        }
    }

    /// The peak under a plan.
    #[must_use]
    pub fn peak(&self, plan: Plan) -> u64 {
        match plan {
            Plan::InCore => self.in_core(),
            Plan::OutOfCore(Shares { particles, field, surface }) => {
                self.program + self.index + particles.max(surface) + field
            }
        }
    }
}
