//! Batches of regions whose surfaces are computed: their memory, and their inputs.

use std::collections::VecDeque;
use std::sync::Arc;

use glam::IVec3;
use hashbrown::HashSet;

use crate::backend::Surfaces;
use crate::brick::vulkan::{DeviceBlock, DeviceBlocks};
use crate::field::distance::vulkan::RegionProbe;
use crate::field::distance::wide_cells;
use crate::field::recipe::{Filters, WideFields};
use crate::grid::{BLOCK, BLOCK_TILES, CellBox};
use crate::surface::dual_mc::Normals;
use crate::surface::dual_mc::vulkan::{Falls, SIGN_TILES, TileSlot};
use crate::surface::mesh::Tile;
use crate::vulkan::{Batch, Ticket, View};

use super::constants::FrameConstants;
use super::fields::{PaddedBlocks, PaddedFields};
use super::frame::DeviceFrame;
use super::grids::SampleSource;
use super::pipelines::page_bytes;
use super::resident::ResidentPages;

/// Maximum number of blocks in a batch.
const BLOCK_BATCH: usize = 1024;
/// Average number of vertices per block for which a batch has memory; a batch with more vertices is
/// meshed again.
const BLOCK_ROOM: u64 = 6144;
/// Maximum number of vertices in a block.
const MOST_VERTICES: u64 = 3 * (BLOCK * BLOCK * BLOCK) as u64;

/// Number of fields on wide cells that exist at once: the clouds, which become the distances of
/// particles outside the calm surface; two surfaces and their difference; the spread distances; and
/// a temporary.
pub(super) const WIDE_FIELDS: usize = 6;
/// Number of fields on wide cells that sheets need: the clouds, their smoothed density, and a
/// temporary.
pub(super) const SHEETS_FIELDS: usize = 3;
/// Number of fields for drops: the shares of sheets and their certainty, clouds, the smoothed
/// clouds, and a temporary.
pub(super) const DROPS_FIELDS: usize = 5;
/// Number of fields on the parts of blocks in which particles stand out from the surface: the
/// distance by which particles lie outside the surface, the shares of drops, and the certainty of
/// sheets.
pub(super) const PART_FIELDS: usize = 3;

/// The regions of a batch in a lane.
pub(super) struct BlockBatch {
    pub(super) regions: Vec<CellBox>,
    /// The number of vertices for which there is memory.
    pub(super) room: u64,
    /// The bulk of the batch on wide cells, if the field is computed from distances.
    pub(super) wide: Option<WideBulk>,
    /// Indices of the regions to mesh: all regions that can have a surface.
    pub(super) meshed: Vec<usize>,
    /// The parts of these regions in which particles stand out, each with the index of its region
    /// in `meshed`.
    pub(super) parts: Vec<(usize, CellBox)>,
}

impl BlockBatch {
    /// Makes a batch from the first regions of `regions`: at least one region, and further regions
    /// while the batch fits into memory even if particles stand out everywhere.
    pub(super) fn new(work: &Contouring<'_>, regions: &[CellBox]) -> Self {
        let limit = work.frame.device.limits().storage_range;
        let sources = work.sources();
        let mut known: Vec<(u64, HashSet<IVec3>)> =
            sources.iter().map(|_| Default::default()).collect();
        let mut taken = MOST_VERTICES * work.vertex_bytes() * 2;
        let mut count = 0;
        for &region in regions.iter().take(BLOCK_BATCH) {
            let cells = work.surfaces.normals.cells(region);
            let mut longest = 0;
            taken += work.region_bytes();
            for (source, (words, pages)) in sources.iter().zip(&mut known) {
                let block = DeviceBlock::new(source.cells(cells), region);
                *words += u64::from(block.words());
                taken += 4 * source.fields * u64::from(block.words());
                longest = longest.max(4 * *words);
                let Some(from) = source.sampled.then(|| work.samples(source.level)) else {
                    continue;
                };
                let page_bytes = page_bytes(from.shape());
                let before = pages.len() as u64;
                for bin in block.bins(from.shape().ghost_layer) {
                    taken += size_of::<u32>() as u64 * 2;
                    if from.sends(bin) {
                        pages.insert(bin);
                    }
                }
                taken += 2 * (pages.len() as u64 - before) * page_bytes;
                longest = longest.max(pages.len() as u64 * page_bytes);
            }
            if count > 0 && (taken > work.bytes || longest > limit) {
                break;
            }
            count += 1;
        }
        Self {
            regions: regions[..count].to_vec(),
            room: MOST_VERTICES.max(count as u64 * BLOCK_ROOM),
            wide: None,
            meshed: (0..count).collect(),
            parts: Vec::new(),
        }
    }

    /// The regions to mesh.
    pub(super) fn meshed(&self) -> impl Iterator<Item = CellBox> + Clone + '_ {
        self.meshed.iter().map(|&number| self.regions[number])
    }
}

/// The field on the blocks of a batch, with a ticket for the upload of its inputs.
pub(super) struct BatchField {
    pub(super) blocks: DeviceBlocks,
    pub(super) field: View,
    pub(super) uploaded: Ticket,
}

/// Cells of one width on which a batch has fields.
pub(super) struct FieldLevel {
    /// The cells are 2^`level` times as wide as the grid's cells.
    pub(super) level: u32,
    /// The halo around the requested cells, in cells of this level.
    halo: i32,
    /// Whether samples are needed on these cells.
    sampled: bool,
    /// The number of fields that exist at once, including the samples.
    pub(super) fields: u64,
}

impl FieldLevel {
    /// The cells of this level on which fields are needed for a field on `cells`.
    pub(super) fn cells(&self, cells: CellBox) -> CellBox {
        wide_cells(self.level, cells).grown(self.halo, self.halo)
    }
}

/// The bulk of a batch on wide cells.
pub(super) struct WideBulk {
    pub(super) blocks: DeviceBlocks,
    /// For each region, the number of its block.
    pub(super) of_regions: Vec<u32>,
    pub(super) probes: Vec<RegionProbe>,
    pub(super) fields: WideFields<View>,
}

/// The stage from blocks to surfaces.
pub(super) struct Contouring<'a> {
    pub(super) frame: &'a DeviceFrame,
    pub(super) surfaces: &'a Surfaces<'a>,
    pub(super) constants: FrameConstants,
    /// Fields on the device from which samples are gathered, by level.
    pub(super) residents: Vec<Arc<ResidentPages>>,
    /// Maximum bytes of a batch.
    pub(super) bytes: u64,
}

impl<'a> Contouring<'a> {
    pub(super) fn has_normals(&self) -> bool {
        self.surfaces.normals == Normals::Gradient
    }

    /// Bytes of a vertex on the device.
    pub(super) fn vertex_bytes(&self) -> u64 {
        size_of::<[u16; 2]>() as u64
            + if self.has_normals() { size_of::<Falls>() as u64 } else { 0 }
    }

    /// Returns the source of the samples for cells of a level.
    pub(super) fn samples(&self, level: u32) -> SampleSource<'_> {
        let dif = self.surfaces.sampled.wide(level);
        let resident = self.residents.get(level as usize);
        resident.map_or(SampleSource::Sent(dif), |resident| {
            SampleSource::Resident(resident, dif.shape())
        })
    }

    /// All widths of cells on which a region has fields.
    pub(super) fn sources(&self) -> Vec<FieldLevel> {
        match &self.surfaces.recipe.filters {
            Filters::Paper(paper) => {
                vec![FieldLevel {
                    level: 0,
                    halo: paper.halo(),
                    sampled: true,
                    fields: paper.fields().device,
                }]
            }
            Filters::Distances(distances) => {
                let wide = (distances.level, distances.wide_halo());
                let drops = (distances.drops_level, distances.drops_halo());
                let sheets = FieldLevel {
                    level: distances.level,
                    halo: distances.sheets_halo(),
                    sampled: true,
                    fields: SHEETS_FIELDS as u64,
                };
                let mut levels = vec![
                    FieldLevel {
                        level: wide.0,
                        halo: wide.1,
                        sampled: true,
                        fields: WIDE_FIELDS as u64,
                    },
                    FieldLevel {
                        level: drops.0,
                        halo: drops.1,
                        sampled: true,
                        fields: DROPS_FIELDS as u64,
                    },
                    FieldLevel {
                        level: 0,
                        halo: 0,
                        sampled: false,
                        fields: 1 + PART_FIELDS as u64,
                    },
                ];
                levels.extend(distances.sheets.is_some().then_some(sheets));
                levels
            }
        }
    }

    /// Bytes that a region takes in addition to its fields, on the device and in the staging
    /// buffer.
    pub(super) fn region_bytes(&self) -> u64 {
        let tiles = u64::from(BLOCK_TILES) * (2 * size_of::<Tile>() + size_of::<TileSlot>()) as u64;
        tiles + 8 * u64::from(SIGN_TILES) + 2 * BLOCK_ROOM * self.vertex_bytes()
    }

    pub(super) fn fields<'b>(
        &'b self,
        commands: &'b mut Batch,
        grids: Vec<PaddedBlocks>,
    ) -> PaddedFields<'b> {
        let (pipelines, constants, mirror) =
            (&*self.frame.pipelines, &self.constants, self.surfaces.mirror());
        let gathered = VecDeque::new();
        PaddedFields {
            pipelines,
            constants,
            mirror,
            commands,
            grids,
            gathered,
            cells: 0,
            parts: None,
            drops: 0,
        }
    }
}
