//! Regions of blocks to surfaces.

use std::rc::Rc;
use std::sync::Arc;

use glam::{DVec3, IVec3};
use hashbrown::HashMap;
use rayon::prelude::*;

use crate::backend::Surfaces;
use crate::brick::vulkan::{DeviceBlock, DeviceBlocks, DevicePages, gather};
use crate::grid::{BLOCK, BLOCK_TILES, CellBox};
use crate::mesh::{BlockMesh, Tile};
use crate::stage::blur::Kernel;
use crate::stage::dual_mc::vulkan::{Falls, Outputs, SIGN_TILES, Slot, Tally, contour, lengths};
use crate::stage::dual_mc::{Crossings, Normals, normal};
use crate::vulkan::{Batch, Buffer, Device, Place, View, VulkanError};

use super::fields::{Padded, PaddedFields};
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
        let mut blocks = Vec::new();
        self.each_batch(state, surfaces, regions, &mut |_, lane, batch, begins| {
            let totals = begins[batch.blocks.len()];
            let tile_bytes = u64::from(totals.tiles) * size_of::<Tile>() as u64;
            let end_bytes = u64::from(totals.vertices) * size_of::<[u16; 2]>() as u64;
            lane.download.stage("collect", 2 * (tile_bytes + end_bytes));
            tiles.append(&self.device, &mut lane.download, &lane.buffers["tiles"].part(0, tile_bytes))?;
            ends.append(&self.device, &mut lane.download, &lane.buffers["ends"].part(0, end_bytes))?;
            lane.download.submit(lane.compute.last())?;
            lane.download.wait()?;
            let sizes = begins.windows(2).map(|begins| begins[1].since(&begins[0]));
            let coords = batch.regions.iter().map(|region| block_of(*region));
            blocks.extend(coords.zip(sizes).filter(|(_, size)| size.tiles > 0));
            Ok(())
        })?;
        Ok(DeviceSurfaces { blocks, tiles: tiles.view(&self.device)?, ends: ends.view(&self.device)? })
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
struct Constants {
    weights: HashMap<Kernel, View>,
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
        Ok(Self {
            weights: surfaces
                .recipe
                .filters
                .kernels()
                .map(|kernel| Ok((kernel.clone(), device.uploaded(kernel.half())?)))
                .collect::<Result<_, VulkanError>>()?,
            theta: device.uploaded(&theta)?,
            decode: theta.len() as u32,
            lengths: device.uploaded(&lengths())?,
        })
    }
}

/// Regions on their way through a lane.
struct BlockBatch {
    regions: Vec<CellBox>,
    blocks: Vec<DeviceBlock>,
    tables: Vec<u32>,
    /// The bins whose pages are to be sent.
    sent: Vec<IVec3>,
    largest: u32,
    words: u32,
    /// Vertices that there is room for.
    room: u64,
}

impl BlockBatch {
    /// As many of the first regions as a batch may take, at least one.
    fn new(work: &Contouring<'_>, regions: &[CellBox]) -> Self {
        let mut batch = Self {
            regions: Vec::new(),
            blocks: Vec::new(),
            tables: Vec::new(),
            sent: Vec::new(),
            largest: 0,
            words: 0,
            room: MOST_VERTICES,
        };
        let limit = work.frame.device.limits().storage_range;
        let (dif, halo) = (&work.surfaces.sampled.dif, work.surfaces.recipe.filters.halo());
        let page_bytes = page_bytes(dif.shape());
        let mut numbers: HashMap<IVec3, u32> = HashMap::new();
        let mut taken = batch.room * work.vertex_bytes() * 2;
        for &region in regions.iter().take(BLOCK_BATCH) {
            let cells = work.surfaces.normals.cells(region).grown(halo, halo);
            let mut block = DeviceBlock::new(cells, region.tiled());
            let bins: Vec<IVec3> = block.bins(dif.shape().rim).collect();
            let unknown = |bin: &&IVec3| dif.has_page(**bin) && !numbers.contains_key(*bin);
            let new = if work.resident.is_some() { 0 } else { bins.iter().filter(unknown).count() as u64 };
            taken += work.block_bytes(&block) + new * 2 * page_bytes + 8 * bins.len() as u64;
            let field_bytes = 4 * (u64::from(batch.words) + u64::from(block.words()));
            let sent_bytes = (batch.sent.len() as u64 + new) * page_bytes;
            if !batch.blocks.is_empty() && (taken > work.bytes || field_bytes.max(sent_bytes) > limit) {
                break;
            }
            block.field = batch.words;
            block.table = batch.tables.len() as u32;
            batch.tables.extend(bins.into_iter().map(|bin| {
                let number = match work.resident {
                    Some(resident) => resident.numbers.get(&bin).copied(),
                    None if dif.has_page(bin) => Some(*numbers.entry(bin).or_insert_with(|| {
                        batch.sent.push(bin);
                        batch.sent.len() as u32 - 1
                    })),
                    None => None,
                };
                number.map_or(0, |number| number + 1)
            }));
            batch.words += block.words();
            batch.largest = batch.largest.max(block.words());
            batch.blocks.push(block);
            batch.regions.push(region);
        }
        batch.room = batch.room.max(batch.blocks.len() as u64 * BLOCK_ROOM);
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

impl Contouring<'_> {
    fn has_normals(&self) -> bool {
        self.surfaces.normals == Normals::Gradient
    }

    /// Bytes of a vertex on the device.
    fn vertex_bytes(&self) -> u64 {
        size_of::<[u16; 2]>() as u64 + if self.has_normals() { size_of::<Falls>() as u64 } else { 0 }
    }

    fn fields(&self) -> u64 {
        self.surfaces.recipe.filters.fields().device
    }

    /// Bytes of a block, on the device and staged.
    fn block_bytes(&self, block: &DeviceBlock) -> u64 {
        let tiles = u64::from(BLOCK_TILES) * (2 * size_of::<Tile>() + size_of::<Slot>()) as u64;
        4 * self.fields() * u64::from(block.words())
            + tiles
            + 8 * u64::from(SIGN_TILES)
            + 2 * BLOCK_ROOM * self.vertex_bytes()
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
        let dif = &self.surfaces.sampled.dif;
        let page_bytes = page_bytes(dif.shape());
        let mut layout = Layout::default();
        let blocks_at = layout.place(size_of_val(&batch.blocks[..]) as u64);
        let tables_at = layout.place(size_of_val(&batch.tables[..]) as u64);
        let pages_at = layout.place(batch.sent.len() as u64 * page_bytes);
        lane.begin()?;
        let staged = lane.buffer(device, "staged", Place::Upload, layout.bytes)?;
        let inputs = lane.buffer(device, "inputs", Place::Device, layout.bytes)?;
        let count = batch.blocks.len() as u64;
        let field_bytes = 4 * u64::from(batch.words);
        let first = lane.buffer(device, "first field", Place::Device, field_bytes)?;
        let names = ["second field", "third field", "fourth field"];
        let others = names[..self.fields() as usize - 1].iter();
        let free = others.map(|name| lane.buffer(device, name, Place::Device, field_bytes));
        let free = free.collect::<Result<_, VulkanError>>()?;
        let outputs = self.outputs(lane, count, batch.room)?;
        let read = lane.buffer(device, "tallies read", Place::Download, outputs.tallies.bytes())?;

        staged.write(blocks_at.start, &batch.blocks);
        staged.write(tables_at.start, &batch.tables);
        batch.sent.par_iter().enumerate().for_each_init(
            || vec![0; dif.shape().bin_samples()],
            |dense, (number, &bin)| {
                dif.write_stored(bin, dense);
                staged.write(pages_at.start + number as u64 * page_bytes, dense);
            },
        );
        let uploaded = lane.send(&staged, &inputs)?;

        let commands = &mut lane.compute;
        let blocks = DeviceBlocks {
            blocks: part(&inputs, &blocks_at),
            count: count as u32,
            largest: batch.largest,
            words: batch.words,
        };
        let pages = DevicePages {
            tables: part(&inputs, &tables_at),
            pages: self.resident.map_or_else(|| part(&inputs, &pages_at), |resident| resident.pages.whole()),
            shape: dif.shape(),
            theta: self.constants.theta.clone(),
            decode: self.constants.decode,
        };
        commands.stage("gather", pages.pages.bytes() + field_bytes);
        let (iso, walls) = (self.surfaces.recipe.iso, self.surfaces.walls());
        gather(commands, &kernels.gather, &blocks, &pages, &first)?;
        let dif = Rc::new(Padded { samples: first, margin: 0 });
        let weights = &self.constants.weights;
        let mut fields = PaddedFields { kernels, weights, walls, commands, blocks: &blocks, free };
        let field = self.surfaces.recipe.apply(&mut fields, dif)?;
        commands.stage("dual marching cubes", field_bytes);
        let normals = self.has_normals();
        contour(commands, &kernels.dual_mc, &blocks, &field.samples, iso, walls, normals, &outputs)?;
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
        let count = batch.blocks.len();
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
        let totals = begins[batch.blocks.len()];
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
