//! Regions of blocks to surfaces.

use std::collections::VecDeque;
use std::rc::Rc;
use std::sync::Arc;

use glam::{DVec3, IVec3};
use hashbrown::HashMap;
use rayon::prelude::*;

use crate::backend::Surfaces;
use crate::brick::DifField;
use crate::brick::vulkan::{DeviceBlock, DeviceBlocks, DevicePages, gather};
use crate::grid::{BLOCK, BLOCK_TILES, CellBox};
use crate::mesh::{BlockMesh, Tile};
use crate::recipe::{Filters, Source};
use crate::stage::blur::Kernel;
use crate::stage::distance::vulkan::tables;
use crate::stage::dual_mc::vulkan::{Falls, Outputs, SIGN_TILES, Slot, Tally, contour, lengths};
use crate::stage::dual_mc::{Crossings, Normals, normal};
use crate::vulkan::{Batch, Buffer, Device, Place, Ticket, View, VulkanError};

use super::fields::{Padded, PaddedBlocks, PaddedFields};
use super::lane::{Lane, Layout, fly, part};
use super::{BLOCK_BATCH, DeviceFrame, Resident, State, page_bytes};

/// Vertices of a block on average that a batch has room for; a batch that has more is emitted again.
const BLOCK_ROOM: u64 = 6144;
/// Vertices that a block can have.
const MOST_VERTICES: u64 = 3 * (BLOCK * BLOCK * BLOCK) as u64;

impl DeviceFrame {
    /// Adds the surfaces through some regions to `done`, as far as nothing fails.
    pub(super) fn contour_batches(
        &self,
        state: &mut State,
        surfaces: &Surfaces<'_>,
        regions: &[CellBox],
        done: &mut Vec<Option<BlockMesh>>,
    ) -> Result<(), VulkanError> {
        self.each_batch(state, surfaces, regions, &mut |work, lane, batch, begins| {
            done.extend(work.read(lane, batch, begins)?);
            Ok(())
        })
    }

    /// The surfaces through some regions, which stay on the device.
    pub(super) fn collect_batches(
        &self,
        state: &mut State,
        surfaces: &Surfaces<'_>,
        regions: &[CellBox],
    ) -> Result<DeviceSurfaces, VulkanError> {
        let (mut tiles, mut ends) = (Growing::default(), Growing::default());
        let (mut blocks, mut written) = (Vec::new(), None);
        self.each_batch(state, surfaces, regions, &mut |_, lane, batch, begins| {
            let totals = begins[batch.regions.len()];
            let tile_bytes = u64::from(totals.tiles) * size_of::<Tile>() as u64;
            let end_bytes = u64::from(totals.vertices) * size_of::<[u16; 2]>() as u64;
            lane.download.stage("collect", 2 * (tile_bytes + end_bytes));
            tiles.append(&self.device, &mut lane.download, &lane.buffers["tiles"].part(0, tile_bytes))?;
            ends.append(&self.device, &mut lane.download, &lane.buffers["ends"].part(0, end_bytes))?;
            written = Some(lane.download.submit(lane.compute.last())?);
            lane.download.wait()?;
            let sizes = begins.windows(2).map(|begins| begins[1].since(&begins[0]));
            let coords = batch.regions.iter().map(|region| block_of(*region));
            blocks.extend(coords.zip(sizes).filter(|(_, size)| size.tiles > 0));
            Ok(())
        })?;
        Ok(DeviceSurfaces {
            blocks,
            tiles: tiles.view(&self.device)?,
            ends: ends.view(&self.device)?,
            written,
        })
    }

    /// Has the surfaces through some regions computed, and `take` take them batch by batch, in order.
    fn each_batch(
        &self,
        state: &mut State,
        surfaces: &Surfaces<'_>,
        regions: &[CellBox],
        take: &mut Take<'_>,
    ) -> Result<(), VulkanError> {
        state.make_lanes(&self.device)?;
        let constants = Constants::new(&self.device, surfaces)?;
        let State { lanes, resident, batch_bytes, .. } = state;
        let work =
            Contouring { frame: self, surfaces, constants, resident: resident.as_ref(), bytes: *batch_bytes };
        let mut next = 0;
        fly(
            lanes,
            |lane| work.start_next(lane, regions, &mut next),
            |lane, batch| work.finish(lane, batch, take),
        )
    }
}

/// What becomes of a batch, given where each of its blocks begins in it, and where the last one ends.
type Take<'a> = dyn FnMut(&Contouring<'_>, &mut Lane, &BlockBatch, &[Tally]) -> Result<(), VulkanError> + 'a;

/// The surfaces of a frame's blocks, on the device.
#[derive(Debug)]
pub struct DeviceSurfaces {
    /// The blocks that the surface passes through, in Morton order, counted in blocks, and what each has.
    pub blocks: Vec<(IVec3, Tally)>,
    /// A [`Tile`] each.
    pub tiles: View,
    /// For every vertex the field at the lower and the upper end of its edge.
    pub ends: View,
    /// When both are there: whoever reads them waits for it on the device.
    pub(super) written: Option<Ticket>,
}

impl DeviceSurfaces {
    /// What commands that read the surfaces have to wait for.
    #[must_use]
    pub fn written(&self) -> &[Ticket] {
        self.written.as_slice()
    }
}

/// A buffer that grows.
#[derive(Default)]
struct Growing {
    buffer: Option<Arc<Buffer>>,
    used: u64,
}

impl Growing {
    /// Records the copy of `from` to the end.
    fn append(&mut self, device: &Device, commands: &mut Batch, from: &View) -> Result<(), VulkanError> {
        let end = self.used + from.bytes();
        if self.buffer.as_ref().is_none_or(|buffer| buffer.bytes() < end) {
            let doubled = device.buffer(Place::Device, end.max(2 * self.used));
            let larger = doubled.or_else(|_| device.buffer(Place::Device, end))?;
            if let Some(buffer) = self.buffer.replace(Arc::clone(&larger)) {
                commands.copy(&buffer.part(0, self.used), &larger.whole());
            }
        }
        if let Some(buffer) = &self.buffer {
            commands.copy(from, &buffer.part(self.used, from.bytes()));
        }
        self.used = end;
        Ok(())
    }

    /// What is in it.
    fn view(self, device: &Device) -> Result<View, VulkanError> {
        let buffer = self.buffer.map_or_else(|| device.buffer(Place::Device, 4), Ok)?;
        Ok(buffer.part(0, self.used.max(4)))
    }
}

fn block_of(region: CellBox) -> IVec3 {
    region.lo.div_euclid(IVec3::splat(BLOCK))
}

/// What all batches of blocks need.
pub(super) struct Constants {
    pub(super) weights: HashMap<Kernel, View>,
    /// The committed tables of distances.
    pub(super) depths: View,
    pub(super) away: View,
    theta: View,
    decode: u32,
    lengths: View,
}

impl Constants {
    fn new(device: &Device, surfaces: &Surfaces<'_>) -> Result<Self, VulkanError> {
        let theta: Vec<u32> = surfaces
            .sampled
            .dif
            .decode_table()
            .unwrap_or_default()
            .iter()
            .map(|&theta| theta.into())
            .collect();
        let [depths, away] = tables();
        Ok(Self {
            weights: surfaces
                .recipe
                .filters
                .kernels()
                .into_iter()
                .map(|kernel| Ok((kernel.clone(), device.uploaded(kernel.half())?)))
                .collect::<Result<_, VulkanError>>()?,
            depths: device.uploaded(&depths)?,
            away: device.uploaded(&away)?,
            theta: device.uploaded(&theta)?,
            decode: theta.len() as u32,
            lengths: device.uploaded(&lengths())?,
        })
    }
}

/// Regions on their way through a lane.
struct BlockBatch {
    regions: Vec<CellBox>,
    /// Of each source of the recipe.
    grids: Vec<Gathering>,
    /// Vertices that there is room for.
    room: u64,
}

/// Blocks of a width of cells, which are cut out of samples where any are asked for in them.
struct Gathering {
    source: Source,
    /// Whether it is the recipe's first, which may skip what is inside.
    of_bulk: bool,
    blocks: Vec<DeviceBlock>,
    tables: Vec<u32>,
    /// Bits of the bricks that are inside.
    marks: Vec<u32>,
    /// The bins whose pages are to be sent, and their numbers.
    sent: Vec<IVec3>,
    numbers: HashMap<IVec3, u32>,
    largest: u32,
    words: u32,
}

impl Gathering {
    fn new((number, source): (usize, Source)) -> Self {
        Self {
            source,
            of_bulk: number == 0,
            blocks: Vec::new(),
            tables: Vec::new(),
            marks: Vec::new(),
            sent: Vec::new(),
            numbers: HashMap::new(),
            largest: 0,
            words: 0,
        }
    }

    /// The block for a region, and the bins that it touches.
    fn block(&self, work: &Contouring<'_>, region: CellBox) -> (DeviceBlock, Vec<IVec3>) {
        let cells = self.source.cells(work.surfaces.normals.cells(region));
        let block = DeviceBlock::new(cells, region.tiled());
        let rim = work.samples(self.source).shape().rim;
        let bins = if self.source.sampled { block.bins(rim).collect() } else { Vec::new() };
        (block, bins)
    }

    /// Pages that such bins add to those that are sent.
    fn new_pages(&self, work: &Contouring<'_>, bins: &[IVec3]) -> u64 {
        if work.resident(self.source).is_some() {
            return 0;
        }
        let samples = work.samples(self.source);
        let unknown = |bin: &&IVec3| samples.has_page(**bin) && !self.numbers.contains_key(*bin);
        bins.iter().filter(unknown).count() as u64
    }

    fn push(&mut self, work: &Contouring<'_>, mut block: DeviceBlock, bins: Vec<IVec3>) {
        let samples = work.samples(self.source);
        block.field = self.words;
        block.table = self.tables.len() as u32;
        if let Filters::Distances(distances) = &work.surfaces.recipe.filters
            && self.of_bulk
        {
            block.marks = self.marks.len() as u32;
            self.marks.extend(distances.inside.marks(block.cells()));
        }
        for bin in bins {
            let number = match work.resident(self.source) {
                Some(resident) => resident.numbers.get(&bin).copied(),
                None if samples.has_page(bin) => Some(*self.numbers.entry(bin).or_insert_with(|| {
                    self.sent.push(bin);
                    self.sent.len() as u32 - 1
                })),
                None => None,
            };
            self.tables.push(number.map_or(0, |number| number + 1));
        }
        self.words += block.words();
        self.largest = self.largest.max(block.words());
        self.blocks.push(block);
    }
}

impl BlockBatch {
    /// As many of the first regions as a batch may take, at least one.
    fn new(work: &Contouring<'_>, regions: &[CellBox]) -> Self {
        let sources = work.surfaces.recipe.filters.sources();
        let grids = sources.into_iter().enumerate().map(Gathering::new).collect();
        let mut batch = Self { regions: Vec::new(), grids, room: MOST_VERTICES };
        let limit = work.frame.device.limits().storage_range;
        let mut taken = batch.room * work.vertex_bytes() * 2;
        for &region in regions.iter().take(BLOCK_BATCH) {
            let blocks: Vec<_> = batch.grids.iter().map(|grid| grid.block(work, region)).collect();
            let mut longest = 0;
            taken += work.region_bytes();
            for (grid, (block, bins)) in batch.grids.iter().zip(&blocks) {
                let page_bytes = page_bytes(work.samples(grid.source).shape());
                let new = grid.new_pages(work, bins);
                taken += 4 * grid.source.fields * u64::from(block.words());
                taken += new * 2 * page_bytes + 8 * bins.len() as u64;
                let field_bytes = 4 * (u64::from(grid.words) + u64::from(block.words()));
                longest = longest.max(field_bytes).max((grid.sent.len() as u64 + new) * page_bytes);
            }
            if !batch.regions.is_empty() && (taken > work.bytes || longest > limit) {
                break;
            }
            for (grid, (block, bins)) in batch.grids.iter_mut().zip(blocks) {
                grid.push(work, block, bins);
            }
            batch.regions.push(region);
        }
        batch.room = batch.room.max(batch.regions.len() as u64 * BLOCK_ROOM);
        batch
    }
}

/// Blocks to surfaces.
struct Contouring<'a> {
    frame: &'a DeviceFrame,
    surfaces: &'a Surfaces<'a>,
    constants: Constants,
    resident: Option<&'a Resident>,
    /// What a batch may take.
    bytes: u64,
}

/// Names of a grid's buffers.
const FIELD_NAMES: [[&str; 6]; 3] = [
    ["field 1", "field 2", "field 3", "field 4", "field 5", "field 6"],
    ["field 7", "field 8", "field 9", "field 10", "field 11", "field 12"],
    ["field 13", "field 14", "field 15", "field 16", "field 17", "field 18"],
];

impl<'a> Contouring<'a> {
    fn has_normals(&self) -> bool {
        self.surfaces.normals == Normals::Gradient
    }

    /// Bytes of a vertex on the device.
    fn vertex_bytes(&self) -> u64 {
        size_of::<[u16; 2]>() as u64 + if self.has_normals() { size_of::<Falls>() as u64 } else { 0 }
    }

    /// Where a source is cut out of.
    fn samples(&self, source: Source) -> &'a DifField {
        self.surfaces.sampled.wide(source.level)
    }

    /// The pages of a source, where they are on the device already.
    fn resident(&self, source: Source) -> Option<&'a Resident> {
        self.resident.filter(|_| source.level == 0)
    }

    /// Bytes of a region besides its fields, on the device and staged.
    fn region_bytes(&self) -> u64 {
        let tiles = u64::from(BLOCK_TILES) * (2 * size_of::<Tile>() + size_of::<Slot>()) as u64;
        tiles + 8 * u64::from(SIGN_TILES) + 2 * BLOCK_ROOM * self.vertex_bytes()
    }

    /// Starts the next batch of `regions`, if there is one.
    fn start_next(
        &self,
        lane: &mut Lane,
        regions: &[CellBox],
        next: &mut usize,
    ) -> Result<Option<BlockBatch>, VulkanError> {
        let left = &regions[*next..];
        if left.is_empty() {
            return Ok(None);
        }
        let batch = BlockBatch::new(self, left);
        *next += batch.regions.len();
        self.start(lane, &batch)?;
        Ok(Some(batch))
    }

    /// Sends a batch and has it computed.
    fn start(&self, lane: &mut Lane, batch: &BlockBatch) -> Result<(), VulkanError> {
        let device = &self.frame.device;
        let kernels = &self.frame.kernels;
        let mut layout = Layout::default();
        let places = batch.grids.iter().map(|grid| {
            let page_bytes = page_bytes(self.samples(grid.source).shape());
            let blocks = layout.place(size_of_val(&grid.blocks[..]) as u64);
            let tables = layout.place(size_of_val(&grid.tables[..]) as u64);
            let marks = layout.place(size_of_val(&grid.marks[..]) as u64);
            (blocks, tables, marks, layout.place(grid.sent.len() as u64 * page_bytes))
        });
        let places: Vec<_> = places.collect();
        lane.begin()?;
        let staged = lane.buffer(device, "staged", Place::Upload, layout.bytes)?;
        let inputs = lane.buffer(device, "inputs", Place::Device, layout.bytes)?;
        let mut buffers = Vec::new();
        for (grid, names) in batch.grids.iter().zip(&FIELD_NAMES) {
            let names = &names[..grid.source.fields as usize];
            let bytes = 4 * u64::from(grid.words);
            let of_grid = names.iter().map(|name| lane.buffer(device, name, Place::Device, bytes));
            buffers.push(of_grid.collect::<Result<Vec<_>, VulkanError>>()?);
        }
        let outputs = self.outputs(lane, batch.regions.len() as u64, batch.room)?;
        let read = lane.buffer(device, "tallies read", Place::Download, outputs.tallies.bytes())?;

        for (grid, (blocks_at, tables_at, marks_at, pages_at)) in batch.grids.iter().zip(&places) {
            let samples = self.samples(grid.source);
            let page_bytes = page_bytes(samples.shape());
            staged.write(blocks_at.start, &grid.blocks);
            staged.write(tables_at.start, &grid.tables);
            staged.write(marks_at.start, &grid.marks);
            grid.sent.par_iter().enumerate().for_each_init(
                || vec![0; samples.shape().bin_samples()],
                |dense, (number, &bin)| {
                    samples.write_stored(bin, dense);
                    staged.write(pages_at.start + number as u64 * page_bytes, dense);
                },
            );
        }
        let uploaded = lane.send(&staged, &inputs)?;

        let commands = &mut lane.compute;
        let (iso, walls) = (self.surfaces.recipe.iso, self.surfaces.walls());
        let (mut grids, mut gathered) = (Vec::new(), VecDeque::new());
        for ((of, grid), ((blocks_at, tables_at, marks_at, pages_at), mut free)) in
            batch.grids.iter().enumerate().zip(places.iter().zip(buffers))
        {
            let blocks = DeviceBlocks {
                blocks: part(&inputs, blocks_at),
                count: grid.blocks.len() as u32,
                largest: grid.largest,
                words: grid.words,
            };
            let resident = self.resident(grid.source);
            let pages = DevicePages {
                tables: part(&inputs, tables_at),
                pages: resident.map_or_else(|| part(&inputs, pages_at), |resident| resident.pages.whole()),
                shape: self.samples(grid.source).shape(),
                theta: self.constants.theta.clone(),
                decode: self.constants.decode,
            };
            let Source { level, halo, sampled, .. } = grid.source;
            if sampled {
                let samples = free.pop().expect("samples are a field");
                commands.stage("gather", pages.pages.bytes() + samples.bytes());
                gather(commands, &kernels.gather, &blocks, &pages, &samples)?;
                gathered.push_back(Rc::new(Padded { samples, margin: 0, of }));
            }
            let marks = part(&inputs, marks_at);
            grids.push(PaddedBlocks { blocks, level, halo, marks, free });
        }
        let constants = &self.constants;
        let mut fields = PaddedFields { kernels, constants, walls, commands, grids, gathered };
        let field = self.surfaces.recipe.apply(&mut fields)?;
        let blocks = &fields.grids[field.of].blocks;
        fields.commands.stage("dual marching cubes", field.samples.bytes());
        let (normals, samples) = (self.has_normals(), &field.samples);
        contour(fields.commands, &kernels.dual_mc, blocks, samples, iso, walls, normals, &outputs)?;
        let commands = fields.commands;
        commands.copy(&outputs.tallies, &read);
        commands.submit(&[uploaded])?;
        Ok(())
    }

    fn outputs(&self, lane: &mut Lane, count: u64, room: u64) -> Result<Outputs, VulkanError> {
        let device = &self.frame.device;
        let tiles = count * u64::from(BLOCK_TILES);
        let falls = if self.has_normals() { room * size_of::<Falls>() as u64 } else { 4 };
        Ok(Outputs {
            signs: lane.buffer(device, "signs", Place::Device, count * 8 * u64::from(SIGN_TILES))?,
            lengths: self.constants.lengths.clone(),
            slots: lane.buffer(device, "slots", Place::Device, tiles * size_of::<Slot>() as u64)?,
            tallies: lane.buffer(
                device,
                "tallies",
                Place::Device,
                (count + 1) * size_of::<Tally>() as u64,
            )?,
            tiles: lane.buffer(device, "tiles", Place::Device, tiles * size_of::<Tile>() as u64)?,
            ends: lane.buffer(device, "ends", Place::Device, room * size_of::<[u16; 2]>() as u64)?,
            falls: lane.buffer(device, "falls", Place::Device, falls)?,
            room: room as u32,
        })
    }

    /// Waits for a batch, and has `take` take it. A batch with more vertices than it had room for is emitted again, in parts if they are more than its share.
    fn finish(&self, lane: &mut Lane, mut batch: BlockBatch, take: &mut Take<'_>) -> Result<(), VulkanError> {
        let count = batch.regions.len();
        lane.compute.wait()?;
        let begins: Vec<Tally> = lane.buffers["tallies read"].read(0, count + 1);
        let vertices = u64::from(begins[count].vertices);
        if vertices <= batch.room {
            return take(self, lane, &batch, &begins);
        }
        if 2 * vertices * self.vertex_bytes() <= self.bytes {
            batch.room = vertices;
            self.start(lane, &batch)?;
            return self.finish(lane, batch, take);
        }
        let (first, second) = batch.regions.split_at(count / 2);
        for half in [first, second] {
            let mut next = 0;
            while let Some(part) = self.start_next(lane, half, &mut next)? {
                self.finish(lane, part, take)?;
            }
        }
        Ok(())
    }

    /// Reads a batch.
    fn read(
        &self,
        lane: &mut Lane,
        batch: &BlockBatch,
        begins: &[Tally],
    ) -> Result<Vec<Option<BlockMesh>>, VulkanError> {
        let device = &self.frame.device;
        let totals = begins[batch.regions.len()];
        let tile_bytes = u64::from(totals.tiles) * size_of::<Tile>() as u64;
        let end_bytes = u64::from(totals.vertices) * size_of::<[u16; 2]>() as u64;
        let fall_bytes =
            if self.has_normals() { u64::from(totals.vertices) * size_of::<Falls>() as u64 } else { 0 };
        let tiles = lane.buffer(device, "tiles read", Place::Download, tile_bytes)?;
        let ends = lane.buffer(device, "ends read", Place::Download, end_bytes)?;
        let falls = lane.buffer(device, "falls read", Place::Download, fall_bytes)?;
        lane.download.stage("download", 2 * (tile_bytes + end_bytes + fall_bytes));
        for (name, bytes, to) in
            [("tiles", tile_bytes, &tiles), ("ends", end_bytes, &ends), ("falls", fall_bytes, &falls)]
        {
            lane.download.copy(&lane.buffers[name].part(0, bytes), to);
        }
        lane.download.submit(lane.compute.last())?;
        lane.download.wait()?;
        let blocks = batch.regions.par_iter().zip(begins.par_windows(2));
        Ok(blocks
            .map(|(region, begins)| {
                let (begin, size) = (begins[0], begins[1].since(&begins[0]));
                if size.tiles == 0 {
                    return None;
                }
                let vertices = size.vertices as usize;
                let first = u64::from(begin.vertices);
                let mut mesh = BlockMesh {
                    block: block_of(*region),
                    tiles: tiles.read(u64::from(begin.tiles) * size_of::<Tile>() as u64, size.tiles as usize),
                    ends: ends.read(first * size_of::<[u16; 2]>() as u64, vertices),
                    triangle_count: size.triangles as usize,
                    ..BlockMesh::default()
                };
                if self.has_normals() {
                    let falls: Vec<i32> = falls.read(first * size_of::<Falls>() as u64, 6 * vertices);
                    mesh.normals = self.normals(&mesh, &falls);
                }
                Some(mesh)
            })
            .collect())
    }

    fn normals(&self, mesh: &BlockMesh, falls: &[i32]) -> Vec<[f32; 3]> {
        let falls: &[Falls] = bytemuck::cast_slice(falls);
        let (crossings, walls) = (Crossings::from(self.surfaces.recipe.iso), self.surfaces.walls());
        mesh.edges()
            .zip(&mesh.ends)
            .zip(falls)
            .map(|((edge, &ends), falls)| {
                let falls = falls.map(|axes| DVec3::from(axes.map(f64::from)));
                normal(edge, crossings.fraction(ends), ends[0] > ends[1], falls, walls)
            })
            .collect()
    }
}
