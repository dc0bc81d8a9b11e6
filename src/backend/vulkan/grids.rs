//! The blocks of a batch whose cells have the same width, and the data that is uploaded for them.

use std::ops::Range;

use glam::IVec3;
use hashbrown::HashMap;
use rayon::prelude::*;

use crate::brick::vulkan::{DeviceBlock, DeviceBlocks, DevicePages};
use crate::brick::{DifField, PageShape};
use crate::field::distance::InsideBricks;
use crate::grid::CellBox;
use crate::vulkan::View;

use super::constants::FrameConstants;
use super::lane::{BufferLayout, part};
use super::pipelines::page_bytes;
use super::resident::ResidentPages;

/// The region of a block that has no tiles to mesh.
pub(super) const NO_TILES: CellBox = CellBox { lo: IVec3::ZERO, hi: IVec3::ZERO };

/// The source of the samples of blocks.
#[derive(Clone, Copy)]
pub(super) enum SampleSource<'a> {
    /// Samples of pages that are on the device.
    Resident(&'a ResidentPages, PageShape),
    /// Samples of pages that are uploaded.
    Sent(&'a DifField),
}

impl SampleSource<'_> {
    /// The arrangement of samples in pages.
    pub(super) fn shape(&self) -> PageShape {
        match *self {
            Self::Resident(_, shape) => shape,
            Self::Sent(dif) => dif.shape(),
        }
    }

    /// Whether the page of a bin must be uploaded.
    pub(super) fn sends(&self, bin: IVec3) -> bool {
        match self {
            Self::Resident(..) => false,
            Self::Sent(dif) => dif.has_page(bin),
        }
    }
}

/// Blocks with cells of one width. The samples of the blocks are consecutive in a field.
#[derive(Default)]
pub(super) struct LevelBlocks {
    blocks: Vec<DeviceBlock>,
    /// Total number of words of all blocks.
    pub(super) words: u32,
    tables: Vec<u32>,
    /// The bits that mark the inside bricks.
    marks: Vec<u32>,
    /// The bins whose pages are uploaded.
    sent: Vec<IVec3>,
    /// The index of each of these bins in `sent`.
    numbers: HashMap<IVec3, u32>,
}

/// The byte ranges of a grid's data within the upload.
pub(super) struct Places {
    blocks: Range<u64>,
    tables: Range<u64>,
    marks: Range<u64>,
    pages: Range<u64>,
}

impl LevelBlocks {
    /// The number of blocks.
    pub(super) fn len(&self) -> usize {
        self.blocks.len()
    }

    /// Bytes of one field on all blocks.
    pub(super) fn field_bytes(&self) -> u64 {
        4 * u64::from(self.words)
    }

    /// The number of pages to upload.
    pub(super) fn sent_pages(&self) -> u64 {
        self.sent.len() as u64
    }

    /// Adds a block for the samples of `cells`, whose tiles in `region` will be meshed.
    pub(super) fn push(&mut self, cells: CellBox, region: CellBox) {
        let mut block = DeviceBlock::new(cells, region);
        block.field = self.words;
        self.words += block.words();
        self.blocks.push(block);
    }

    /// Adds a block whose samples are gathered from pages. If `inside` is given, also adds the bits
    /// that mark the block's inside bricks.
    pub(super) fn push_sampled(
        &mut self,
        cells: CellBox,
        region: CellBox,
        from: SampleSource<'_>,
        inside: Option<&InsideBricks>,
    ) {
        self.push(cells, region);
        let Self { blocks, tables, marks, sent, numbers, .. } = self;
        let Some(block) = blocks.last_mut() else { return };
        block.table = tables.len() as u32;
        if let Some(inside) = inside {
            block.marks = marks.len() as u32;
            marks.extend(inside.marks(block.cells()));
        }
        tables.extend(block.bins(from.shape().ghost_layer).map(|bin| {
            let number = match from {
                SampleSource::Resident(resident, _) => resident.numbers.get(&bin).copied(),
                SampleSource::Sent(_) => from.sends(bin).then(|| {
                    *numbers.entry(bin).or_insert_with(|| {
                        sent.push(bin);
                        sent.len() as u32 - 1
                    })
                }),
            };
            number.map_or(0, |number| number + 1)
        }));
    }

    /// Reserves space for all data to upload. A page of samples takes `page_bytes` bytes.
    pub(super) fn place(&self, layout: &mut BufferLayout, page_bytes: u64) -> Places {
        Places {
            blocks: layout.place(size_of_val(&self.blocks[..]) as u64),
            tables: layout.place(size_of_val(&self.tables[..]) as u64),
            marks: layout.place(size_of_val(&self.marks[..]) as u64),
            pages: layout.place(self.sent_pages() * page_bytes),
        }
    }

    /// Writes the data to upload into the staging buffer.
    ///
    /// # Safety
    /// No batch in flight may use the staging buffer.
    pub(super) unsafe fn stage(&self, staged: &View, places: &Places, from: SampleSource<'_>) {
        // SAFETY: the caller guarantees that no batch in flight uses the buffer, and the parts do
        // not overlap.
        unsafe {
            staged.write(places.blocks.start, &self.blocks);
            staged.write(places.tables.start, &self.tables);
            staged.write(places.marks.start, &self.marks);
        }
        let SampleSource::Sent(dif) = from else { return };
        let page_bytes = page_bytes(dif.shape());
        self.sent.par_iter().enumerate().for_each_init(
            || vec![0; dif.shape().bin_samples()],
            |dense, (number, &bin)| {
                dif.write_stored(bin, dense);
                // SAFETY: the caller guarantees that no batch in flight uses the buffer, and the
                // pages do not overlap.
                unsafe { staged.write(places.pages.start + number as u64 * page_bytes, dense) };
            },
        );
    }

    /// The blocks in the form that shaders read.
    pub(super) fn on_device(&self, inputs: &View, places: &Places) -> DeviceBlocks {
        DeviceBlocks::new(part(inputs, &places.blocks), &self.blocks)
    }
}

impl Places {
    /// The bits that mark the inside bricks.
    pub(super) fn marks(&self, inputs: &View) -> View {
        part(inputs, &self.marks)
    }

    /// Returns the pages from which samples are gathered; without `constants`, stored samples are
    /// not converted to the DIF.
    pub(super) fn pages(
        &self,
        inputs: &View,
        from: SampleSource<'_>,
        constants: Option<&FrameConstants>,
    ) -> DevicePages {
        DevicePages {
            tables: part(inputs, &self.tables),
            pages: match from {
                SampleSource::Resident(resident, _) => resident.pages.whole(),
                SampleSource::Sent(_) => part(inputs, &self.pages),
            },
            shape: from.shape(),
            theta: constants.map_or_else(|| inputs.clone(), |constants| constants.theta.clone()),
            decode: constants.map_or(0, |constants| constants.decode),
        }
    }
}
