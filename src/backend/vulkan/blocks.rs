//! Regions of blocks to surfaces.

use std::collections::VecDeque;
use std::rc::Rc;
use std::sync::Arc;

use glam::{DVec3, IVec3};
use hashbrown::HashSet;
use rayon::prelude::*;

use crate::backend::{Surfaces, parent};
use crate::brick::vulkan::{DeviceBlock, DeviceBlocks};
use crate::grid::{BLOCK, BLOCK_TILES, CellBox};
use crate::mesh::{BlockMesh, Tile};
use crate::recipe::{Filters, WideFields, bulk, joined};
use crate::stage::distance::vulkan::{Look, Seen, look};
use crate::stage::distance::{Distances, wide_cells};
use crate::stage::dual_mc::vulkan::{Falls, Outputs, SIGN_TILES, Slot, Tally, contour};
use crate::stage::dual_mc::{Crossings, Normals, dual_cells, normal};
use crate::vulkan::{Batch, Buffer, Device, Place, Ticket, View, VulkanError};

use super::fields::{FrameConstants, Padded, PaddedBlocks, PaddedFields};
use super::grids::{Grid, Samples};
use super::lane::{Lane, Layout, fly, part};
use super::{BLOCK_BATCH, DeviceFrame, Resident, State, page_bytes};

/// Fields of wide cells that are there at once: clouds, two surfaces and what they are apart by, and another with one more on its way.
const WIDE_FIELDS: usize = 6;
/// Fields of drops: clouds, and what is around them with one more on its way.
const DROPS_FIELDS: usize = 3;
/// Fields of the parts in which particles stand out: by how much, and shares.
const PART_FIELDS: usize = 2;
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
            let totals = begins[batch.drawn.len()];
            let tile_bytes = u64::from(totals.tiles) * size_of::<Tile>() as u64;
            let end_bytes = u64::from(totals.vertices) * size_of::<[u16; 2]>() as u64;
            lane.download.stage("collect", 2 * (tile_bytes + end_bytes));
            let [new_tiles, new_ends] = [lane.known("tiles", tile_bytes), lane.known("ends", end_bytes)];
            tiles.append(&self.device, &mut lane.download, &new_tiles)?;
            ends.append(&self.device, &mut lane.download, &new_ends)?;
            written = Some(lane.download.submit(lane.compute.last())?);
            lane.download.wait()?;
            let sizes = begins.windows(2).map(|begins| begins[1].since(&begins[0]));
            let coords = batch.drawn().map(block_of);
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
        self.make_lanes(state)?;
        let constants = self.constants(surfaces, &mut state.lanes[0].compute)?;
        let State { lanes, resident, batch_bytes, .. } = state;
        let work =
            Contouring { frame: self, surfaces, constants, resident: resident.as_ref(), bytes: *batch_bytes };
        let mut next = 0;
        fly(
            lanes,
            |lane| work.start_next(lane, regions, &mut next),
            |lane, batch| work.go_on(lane, batch),
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

/// Regions on their way through a lane.
struct BlockBatch {
    regions: Vec<CellBox>,
    /// Vertices that there is room for.
    room: u64,
    /// What is known of wide cells, where distances are made of them.
    wide: Option<Wide>,
    /// Of the regions those that are drawn: all that can show a surface, as far as is known.
    drawn: Vec<usize>,
    /// The parts of some of them in which particles stand out, by their place among those.
    parts: Vec<(usize, CellBox)>,
}

/// The bulk of a batch in wide cells.
struct Wide {
    blocks: DeviceBlocks,
    /// For each region the number of its block.
    of_regions: Vec<u32>,
    looks: Vec<Look>,
    fields: WideFields<View>,
}

impl BlockBatch {
    /// As many of the first regions as a batch may take, at least one: if particles stand out everywhere.
    fn new(work: &Contouring<'_>, regions: &[CellBox]) -> Self {
        let limit = work.frame.device.limits().storage_range;
        let sources = work.sources();
        let mut known: Vec<(u64, HashSet<IVec3>)> = sources.iter().map(|_| Default::default()).collect();
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
                let Some(from) = source.sampled.then(|| work.samples(source.level)) else { continue };
                let page_bytes = page_bytes(from.dif.shape());
                let before = pages.len() as u64;
                for bin in block.bins(from.dif.shape().rim) {
                    taken += size_of::<u32>() as u64 * 2;
                    if from.resident.is_none() && from.dif.has_page(bin) {
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
            drawn: (0..count).collect(),
            parts: Vec::new(),
        }
    }

    /// The regions that are drawn.
    fn drawn(&self) -> impl Iterator<Item = CellBox> + Clone + '_ {
        self.drawn.iter().map(|&number| self.regions[number])
    }
}

/// The numbers of blocks among those that are drawn of wide cells.
const WIDE: usize = 0;
const CELLS: usize = 1;
const PARTS: usize = 2;
const DROPS: usize = 3;

/// The field on some blocks, and when what it is made of is there.
struct Fielded {
    blocks: DeviceBlocks,
    field: View,
    uploaded: Ticket,
}

/// Cells in which a batch has fields.
struct Source {
    /// 2^`level` times as wide as those of the grid.
    level: u32,
    /// How far beyond those that the field is asked for on.
    halo: i32,
    /// Whether samples are asked for in them.
    sampled: bool,
    /// Fields in them that are there at once, the samples among them.
    fields: u64,
}

impl Source {
    /// The cells in which there are fields, for a field on `cells`.
    fn cells(&self, cells: CellBox) -> CellBox {
        wide_cells(self.level, cells).grown(self.halo, self.halo)
    }
}

/// Blocks to surfaces.
struct Contouring<'a> {
    frame: &'a DeviceFrame,
    surfaces: &'a Surfaces<'a>,
    constants: FrameConstants,
    resident: Option<&'a Resident>,
    /// What a batch may take.
    bytes: u64,
}

impl<'a> Contouring<'a> {
    fn has_normals(&self) -> bool {
        self.surfaces.normals == Normals::Gradient
    }

    /// Bytes of a vertex on the device.
    fn vertex_bytes(&self) -> u64 {
        size_of::<[u16; 2]>() as u64 + if self.has_normals() { size_of::<Falls>() as u64 } else { 0 }
    }

    /// What cells of a level are cut out of.
    fn samples(&self, level: u32) -> Samples<'a> {
        let resident = self.resident.filter(|_| level == 0);
        Samples { dif: self.surfaces.sampled.wide(level), resident }
    }

    /// All cells in which a region has fields.
    fn sources(&self) -> Vec<Source> {
        match &self.surfaces.recipe.filters {
            Filters::Paper(paper) => {
                vec![Source { level: 0, halo: paper.halo(), sampled: true, fields: paper.fields().device }]
            }
            Filters::Distances(distances) => {
                let wide = (distances.level, distances.wide_halo());
                let drops = (distances.drops_level, distances.drops_halo());
                vec![
                    Source { level: wide.0, halo: wide.1, sampled: true, fields: WIDE_FIELDS as u64 },
                    Source { level: drops.0, halo: drops.1, sampled: true, fields: DROPS_FIELDS as u64 },
                    Source { level: 0, halo: 0, sampled: false, fields: 1 + PART_FIELDS as u64 },
                ]
            }
        }
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
        let mut batch = BlockBatch::new(self, left);
        *next += batch.regions.len();
        match &self.surfaces.recipe.filters {
            Filters::Paper(_) => self.draw(lane, &batch)?,
            Filters::Distances(distances) => {
                batch.wide = Some(self.make_wide(lane, &batch.regions, distances)?)
            }
        }
        Ok(Some(batch))
    }

    /// Draws what wide cells tell of, where they are made before.
    fn go_on(&self, lane: &mut Lane, batch: &mut BlockBatch) -> Result<(), VulkanError> {
        let (Some(wide), Filters::Distances(distances)) = (&batch.wide, &self.surfaces.recipe.filters) else {
            return Ok(());
        };
        lane.compute.wait()?;
        let count = wide.looks.len();
        let seen: Vec<Seen> = lane.known("seen read", (size_of::<Seen>() * count) as u64).read(0, count);
        batch.drawn.clear();
        for (number, ((&region, look), seen)) in batch.regions.iter().zip(&wide.looks).zip(&seen).enumerate()
        {
            // A wide cell tells of those of its neighbours, too.
            let further = i32::from(distances.level > 0);
            let CellBox { lo, hi } = look.outlying(seen).grown(further, further);
            let cells = self.surfaces.normals.cells(region);
            let part = CellBox { lo: lo << distances.level, hi: hi << distances.level }.intersection(&cells);
            let stands_out = seen.stands_out() && !part.is_empty();
            let at_walls = self.surfaces.walls().is_some_and(|walls| !walls.covers(&dual_cells(region)));
            // Cells are weighted means of wide ones. All inside is no surface only away from walls.
            if (stands_out || seen.above > 0) && (at_walls || seen.below > 0) {
                if stands_out {
                    batch.parts.push((batch.drawn.len(), part));
                }
                batch.drawn.push(number);
            }
        }
        self.draw(lane, batch)
    }

    /// Has the bulk made in wide cells, in which neighbouring regions share what they can, and looked at.
    fn make_wide(
        &self,
        lane: &mut Lane,
        regions: &[CellBox],
        distances: &Distances,
    ) -> Result<Wide, VulkanError> {
        let (device, kernels) = (&self.frame.device, &self.frame.kernels.distance);
        let (from, halo) = (self.samples(distances.level), distances.wide_halo());
        let wide = |region| distances.wide_cells(self.surfaces.normals.cells(region));
        let mut grid = Grid::default();
        let (mut of_regions, mut looks) = (Vec::new(), Vec::new());
        for near in regions.chunk_by(|a, b| parent(a) == parent(b)) {
            let all = near.iter().fold(CellBox::EMPTY, |all, &region| all.union(&wide(region)));
            let volume = |cells: CellBox| cells.grown(halo, halo).volume();
            let together = volume(all) <= near.iter().map(|&region| volume(wide(region))).sum();
            for (i, &region) in near.iter().enumerate() {
                if i == 0 || !together {
                    let cells = if together { all } else { wide(region) };
                    grid.push_sampled(
                        cells.grown(halo, halo),
                        CellBox::cube(IVec3::ZERO, 0),
                        from,
                        Some(&distances.inside),
                    );
                }
                let block = grid.len() as u32 - 1;
                of_regions.push(block);
                looks.push(Look::new(wide(region), block));
            }
        }
        let mut layout = Layout::default();
        let places = grid.place(&mut layout, page_bytes(from.dif.shape()));
        let looks_at = layout.place(size_of_val(&looks[..]) as u64);
        lane.begin()?;
        let staged = lane.buffer(device, "staged", Place::Upload, layout.bytes)?;
        let inputs = lane.buffer(device, "wide inputs", Place::Device, layout.bytes)?;
        let free = lane.fields(device, "wide", WIDE_FIELDS, grid.field_bytes())?;
        let seen_bytes = (size_of::<Seen>() * looks.len()) as u64;
        let seen = lane.buffer(device, "seen", Place::Device, seen_bytes)?;
        let read = lane.buffer(device, "seen read", Place::Download, seen_bytes)?;
        grid.stage(&staged, &places, from.dif);
        staged.write(looks_at.start, &looks);
        let uploaded = lane.send(&staged, &inputs)?;

        let blocks = grid.on_device(&inputs, &places);
        let marks = Some(places.marks(&inputs));
        let within = Vec::new();
        let grid = PaddedBlocks { blocks: blocks.clone(), level: distances.level, marks, within, free };
        let mut fields = self.fields(&mut lane.compute, vec![grid]);
        fields.gather(0, &places.pages(&inputs, from, &self.constants))?;
        let made = bulk(distances, &mut fields)?;
        let fields = WideFields { bulk: made.bulk.samples.clone(), outlying: made.outlying.samples.clone() };
        let views = [&part(&inputs, &looks_at), &fields.bulk, &fields.outlying, &seen];
        let commands = &mut lane.compute;
        commands.stage("distances", fields.bulk.bytes() + fields.outlying.bytes());
        let by = (self.surfaces.recipe.iso, &distances.gate);
        look(commands, kernels, &blocks, looks.len() as u32, by, views)?;
        commands.copy(&seen, &read);
        commands.submit(&[uploaded])?;
        Ok(Wide { blocks, of_regions, looks, fields })
    }

    fn fields<'b>(&'b self, commands: &'b mut Batch, grids: Vec<PaddedBlocks>) -> PaddedFields<'b> {
        let (kernels, constants, walls) = (&*self.frame.kernels, &self.constants, self.surfaces.walls());
        let gathered = VecDeque::new();
        PaddedFields { kernels, constants, walls, commands, grids, gathered, cells: 0, parts: None }
    }

    /// Has the surfaces through the regions that are drawn computed.
    fn draw(&self, lane: &mut Lane, batch: &BlockBatch) -> Result<(), VulkanError> {
        lane.begin()?;
        if batch.drawn.is_empty() {
            return Ok(());
        }
        let outputs = self.outputs(lane, batch.drawn.len() as u64, batch.room)?;
        let read =
            lane.buffer(&self.frame.device, "tallies read", Place::Download, outputs.tallies.bytes())?;
        let Fielded { blocks, field, uploaded } = match (&self.surfaces.recipe.filters, &batch.wide) {
            (Filters::Distances(distances), Some(wide)) => self.join_wide(lane, batch, distances, wide)?,
            _ => self.filter(lane, batch)?,
        };
        let (iso, walls) = (self.surfaces.recipe.iso, self.surfaces.walls());
        let (commands, kernels) = (&mut lane.compute, &self.frame.kernels.dual_mc);
        commands.stage("dual marching cubes", field.bytes());
        contour(commands, kernels, &blocks, &field, iso, walls, self.has_normals(), &outputs)?;
        commands.copy(&outputs.tallies, &read);
        commands.submit(&[uploaded])?;
        Ok(())
    }

    /// The field on the regions that are drawn, by the paper's filters.
    fn filter(&self, lane: &mut Lane, batch: &BlockBatch) -> Result<Fielded, VulkanError> {
        let device = &self.frame.device;
        let [source] = &self.sources()[..] else {
            unreachable!("the paper's filters are of one width of cells")
        };
        let from = self.samples(source.level);
        let mut grid = Grid::default();
        for region in batch.drawn() {
            grid.push_sampled(source.cells(self.surfaces.normals.cells(region)), region.tiled(), from, None);
        }
        let mut layout = Layout::default();
        let places = grid.place(&mut layout, page_bytes(from.dif.shape()));
        let staged = lane.buffer(device, "staged", Place::Upload, layout.bytes)?;
        let inputs = lane.buffer(device, "inputs", Place::Device, layout.bytes)?;
        let free = lane.fields(device, "cells", source.fields as usize, grid.field_bytes())?;
        grid.stage(&staged, &places, from.dif);
        let uploaded = lane.send(&staged, &inputs)?;

        let blocks = grid.on_device(&inputs, &places);
        let cells = PaddedBlocks { blocks: blocks.clone(), level: 0, marks: None, within: Vec::new(), free };
        let mut fields = self.fields(&mut lane.compute, vec![cells]);
        fields.gather(0, &places.pages(&inputs, from, &self.constants))?;
        let field = self.surfaces.recipe.apply(&mut fields)?.samples.clone();
        Ok(Fielded { blocks, field, uploaded })
    }

    /// The field on the regions that are drawn, of the bulk in wide cells, and of drops in their parts.
    fn join_wide(
        &self,
        lane: &mut Lane,
        batch: &BlockBatch,
        distances: &Distances,
        wide: &Wide,
    ) -> Result<Fielded, VulkanError> {
        let device = &self.frame.device;
        let (level, halo) = (distances.drops_level, distances.drops_halo());
        let from = self.samples(level);
        let [mut cells, mut parts, mut drops] = <[Grid; 3]>::default();
        for region in batch.drawn() {
            cells.push(self.surfaces.normals.cells(region), region.tiled());
        }
        for &(_, part) in &batch.parts {
            parts.push(part, CellBox::cube(IVec3::ZERO, 0));
            let around = wide_cells(level, part).grown(halo, halo);
            drops.push_sampled(around, CellBox::cube(IVec3::ZERO, 0), from, None);
        }
        let of_wide = |number: usize| wide.of_regions[batch.drawn[number]];
        let numbers: [Vec<u32>; 4] = [
            (0..batch.drawn.len()).map(of_wide).collect(),
            batch.parts.iter().map(|&(number, _)| of_wide(number)).collect(),
            batch.parts.iter().map(|&(number, _)| number as u32).collect(),
            (0..batch.parts.len() as u32).collect(),
        ];
        let mut layout = Layout::default();
        let places =
            [&cells, &parts, &drops].map(|grid| grid.place(&mut layout, page_bytes(from.dif.shape())));
        let numbers_at = numbers.each_ref().map(|numbers| layout.place(size_of_val(&numbers[..]) as u64));
        let staged = lane.buffer(device, "staged", Place::Upload, layout.bytes)?;
        let inputs = lane.buffer(device, "inputs", Place::Device, layout.bytes)?;
        let mut free = Vec::new();
        for (name, count, grid) in
            [("cells", 1, &cells), ("parts", PART_FIELDS, &parts), ("drops", DROPS_FIELDS, &drops)]
        {
            free.push(lane.fields(device, name, count, grid.field_bytes())?);
        }
        for (grid, places) in [&cells, &parts, &drops].into_iter().zip(&places) {
            grid.stage(&staged, places, from.dif);
        }
        for (numbers, at) in numbers.iter().zip(&numbers_at) {
            staged.write(at.start, numbers);
        }
        let uploaded = lane.send(&staged, &inputs)?;

        let [wide_of_cells, wide_of_parts, homes, of_drops] =
            numbers_at.each_ref().map(|at| part(&inputs, at));
        let blocks = cells.on_device(&inputs, &places[0]);
        let within = [
            Vec::new(),
            vec![(WIDE, wide_of_cells)],
            vec![(WIDE, wide_of_parts), (CELLS, homes), (DROPS, of_drops)],
            Vec::new(),
        ];
        let all = [wide.blocks.clone(), blocks.clone()].into_iter().chain(
            [(&parts, &places[1]), (&drops, &places[2])]
                .map(|(grid, places)| grid.on_device(&inputs, places)),
        );
        let free = std::iter::once(Vec::new()).chain(free);
        let grids = all.zip(within).zip(free).zip([distances.level, 0, 0, level]);
        let padded =
            |(((blocks, within), free), level)| PaddedBlocks { blocks, level, marks: None, within, free };
        let mut fields = self.fields(&mut lane.compute, grids.map(padded).collect());
        fields.cells = CELLS;
        if !batch.parts.is_empty() {
            fields.parts = Some(PARTS);
            fields.gather(DROPS, &places[2].pages(&inputs, from, &self.constants))?;
        }
        let known = |samples: &View| Rc::new(Padded { samples: samples.clone(), margin: 0, of: WIDE });
        let made = WideFields { bulk: known(&wide.fields.bulk), outlying: known(&wide.fields.outlying) };
        let field = joined(distances, &mut fields, made)?.samples.clone();
        Ok(Fielded { blocks, field, uploaded })
    }

    fn outputs(&self, lane: &mut Lane, count: u64, room: u64) -> Result<Outputs, VulkanError> {
        let device = &self.frame.device;
        let tiles = count * u64::from(BLOCK_TILES);
        let falls = if self.has_normals() { room * size_of::<Falls>() as u64 } else { 4 };
        Ok(Outputs {
            signs: lane.buffer(device, "signs", Place::Device, count * 8 * u64::from(SIGN_TILES))?,
            lengths: self.constants.tables.lengths.clone(),
            slots: lane.buffer(device, "slots", Place::Device, tiles * size_of::<Slot>() as u64)?,
            tallies: lane.buffer(
                device,
                "tallies",
                Place::Device,
                (count + 1) * size_of::<Tally>() as u64,
            )?,
            groups: lane.buffer(device, "groups", Place::Device, 12)?,
            tiles: lane.buffer(device, "tiles", Place::Device, tiles * size_of::<Tile>() as u64)?,
            ends: lane.buffer(device, "ends", Place::Device, room * size_of::<[u16; 2]>() as u64)?,
            falls: lane.buffer(device, "falls", Place::Device, falls)?,
            room: room as u32,
        })
    }

    /// Waits for a batch, and has `take` take it. A batch with more vertices than it had room for is drawn again, in parts if they
    /// are more than its share.
    fn finish(&self, lane: &mut Lane, mut batch: BlockBatch, take: &mut Take<'_>) -> Result<(), VulkanError> {
        let count = batch.drawn.len();
        if count == 0 {
            return take(self, lane, &batch, &[Tally::default()]);
        }
        lane.compute.wait()?;
        let begins: Vec<Tally> =
            lane.known("tallies read", ((count + 1) * size_of::<Tally>()) as u64).read(0, count + 1);
        let vertices = u64::from(begins[count].vertices);
        if vertices <= batch.room {
            return take(self, lane, &batch, &begins);
        }
        if 2 * vertices * self.vertex_bytes() <= self.bytes {
            batch.room = vertices;
            self.draw(lane, &batch)?;
            return self.finish(lane, batch, take);
        }
        let (first, second) = batch.regions.split_at(batch.regions.len() / 2);
        for half in [first, second] {
            let mut next = 0;
            while let Some(mut part) = self.start_next(lane, half, &mut next)? {
                self.go_on(lane, &mut part)?;
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
        let totals = begins[batch.drawn.len()];
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
            let from = lane.known(name, bytes);
            lane.download.copy(&from, to);
        }
        lane.download.submit(lane.compute.last())?;
        lane.download.wait()?;
        let mut meshes = vec![None; batch.regions.len()];
        let drawn = batch.drawn.par_iter().zip(begins.par_windows(2));
        let made: Vec<_> = drawn
            .map(|(&number, begins)| {
                let (begin, size) = (begins[0], begins[1].since(&begins[0]));
                if size.tiles == 0 {
                    return None;
                }
                let vertices = size.vertices as usize;
                let first = u64::from(begin.vertices);
                let mut mesh = BlockMesh {
                    block: block_of(batch.regions[number]),
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
            .collect();
        batch.drawn.iter().zip(made).for_each(|(&number, mesh)| meshes[number] = mesh);
        Ok(meshes)
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
