//! What a frame will take of memory and disk, known once its particles are counted by bin and before
//! anything is stored for them; and how to share a budget that is smaller than that.

use bytesize::ByteSize;
use thiserror::Error;

use crate::brick::{CountingRoom, PageInfo, PageSamples, PageShape};
use crate::grid::{BLOCK, TILE};
use crate::mesh::Tile;
use crate::stage::dual_mc::Normals;
use crate::stitch::NUMBERS_BYTES;
use crate::units::MemoryBudget;

/// Bytes that the program takes before there is any data, and that each thread takes beside what it works in.
const PROGRAM: u64 = 6 << 20;
const THREAD: u64 = 5 << 18;
/// Fields that a thread has at once while it works out that of a block; and as it smooths sums of an attribute, how many
/// more of those than there are components.
const FIELDS: u64 = 4;
const SUMS: u64 = 3;
/// Blocks that each thread meshes before their surfaces go to the others, at the least.
pub const BLOCKS_A_THREAD: usize = 2;
/// Vertices of a block that is full of spray.
const VERTICES_A_BLOCK: u64 = 20_000;
/// Bytes that a thread takes for each of their triangles while they are written: three numbers, and four as text or
/// records.
const WRITTEN: u64 = 24 + 4 * 13;
/// Tiles of a block.
const TILES_A_BLOCK: u64 = (BLOCK / TILE).pow(3) as u64;
/// Bytes a bin takes in tables, however little it holds.
const BIN_BYTES: u64 = 320;
/// Bytes of a binned particle, without attributes.
const RECORD: u64 = 8;
/// Bytes of a particle in a scratch file, at the least.
const SPILLED: u64 = 6;
/// Bytes of places that are kept from the first reading to the second, at the most: frames that have more mostly touch
/// more bins than a place can name.
const MOST_PLACES: u64 = 64 << 20;
/// Bytes of a vertex before it is written: the samples of its edge, its share of a tile, and its normal.
const VERTEX: u64 = 8;
const NORMAL: u64 = 12;
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

/// Bytes of attributes of so many components.
fn attribute_bytes(components: &[usize]) -> u64 {
    (components.iter().sum::<usize>() * size_of::<f32>()) as u64
}

/// Bytes of the surface of a block that is full of spray.
#[must_use]
pub fn most_block_bytes(vertex_bytes: u64) -> u64 {
    VERTICES_A_BLOCK * vertex_bytes + TILES_A_BLOCK * size_of::<Tile>() as u64
}

/// What counting may take under a budget: half of it for tables, and an eighth, or what is worth it, for places.
#[must_use]
pub fn counting_room(budget: MemoryBudget) -> CountingRoom {
    let number = |bytes: u64| usize::try_from(bytes).unwrap_or(usize::MAX);
    let places = (budget.0 / 8).min(MOST_PLACES) / CountingRoom::PLACE;
    CountingRoom { bins: number(budget.0 / 2 / BIN_BYTES), places: number(places) }
}

impl Drawing {
    /// Bytes of a vertex without its attributes.
    fn vertex(self) -> u64 {
        VERTEX + if self.normals == Normals::Gradient { NORMAL } else { 0 }
    }

    /// Bytes that each thread takes, with attributes of so many components carried.
    fn thread(self, components: &[usize]) -> u64 {
        // Dual cells reach one cell up, and normals one cell each way.
        let edge = (BLOCK + 3 + 2 * self.halo) as u64;
        let fields = FIELDS * size_of::<u16>() as u64;
        let sums = |&components: &usize| (components as u64 + SUMS) * size_of::<f64>() as u64;
        let a_cell = components.iter().map(sums).fold(fields, u64::max);
        let surfaces = BLOCKS_A_THREAD as u64 * most_block_bytes(self.vertex() + attribute_bytes(components));
        let meshing = edge.pow(3) * a_cell + surfaces;
        THREAD + meshing.max(NUMBERS_BYTES + 2 * VERTICES_A_BLOCK * WRITTEN)
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
        let attributes = attribute_bytes(components);
        let mut estimate = Self::of_program(drawing, components, in_memory);
        for count in counts {
            let nonzero = count.saturating_mul(shape.cells_a_particle());
            let bricks = count.min(shape.side.bricks_a_bin());
            let field = PageSamples::most_bytes(nonzero, bricks, shape) as u64;
            estimate.add_bin(count as u64, attributes, field, drawing);
        }
        estimate
    }

    /// For pages of which the DIF is in a file, and `in_memory` bytes that are taken all the time.
    #[must_use]
    pub fn of_surface(pages: &[PageInfo], shape: PageShape, drawing: Drawing, in_memory: u64) -> Self {
        let mut estimate = Self::of_program(drawing, &[], in_memory);
        for page in pages {
            estimate.add_bin(page.full_count.into(), 0, page.most_bytes(shape) as u64, drawing);
        }
        Self { particles: 0, spilled: 0, ..estimate }
    }

    fn of_program(drawing: Drawing, components: &[usize], in_memory: u64) -> Self {
        let threads = drawing.thread(components) * rayon::current_num_threads() as u64;
        Self { program: PROGRAM + threads + in_memory, carried: !components.is_empty(), ..Self::default() }
    }

    /// Adds a bin of so many particles, each with so many bytes of attributes, and so many bytes of the DIF.
    fn add_bin(&mut self, count: u64, attributes: u64, field: u64, drawing: Drawing) {
        self.index += BIN_BYTES;
        self.particles += count * (RECORD + attributes);
        self.spilled += count * (SPILLED + attributes);
        self.field += field;
        self.surface += (drawing.vertex() + attributes) * (count * VERTICES_A_PARTICLE).min(VERTICES_A_BIN);
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
