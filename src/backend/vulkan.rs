//! The stages on a Vulkan device.
//!
//! Work goes in batches: bins to pages, regions of blocks to surfaces. Two are in flight, so that the host
//! prepares one and reads another while the device computes. The DIF stays on the device between the two
//! where it fits. What the device has no memory for is tried again in smaller batches, and on the processor at
//! last; so is everything once the device is lost. Bytes are the same wherever they are computed.

use std::collections::VecDeque;
use std::io;
use std::ops::Range;
use std::sync::{Arc, Mutex, PoisonError};

use bytemuck::{Pod, Zeroable};
use glam::IVec3;
use hashbrown::HashMap;
use rayon::prelude::*;

use crate::brick::vulkan::{DeviceBlock, DeviceBlocks, DevicePages, GATHER, PAGE_WORDS, gather};
use crate::brick::{Bins, BrickSide, PageInfo};
use crate::grid::{BIN, BLOCK, CellBox};
use crate::mesh::{BlockMesh, Tile};
use crate::stage::blur::vulkan::{BLUR, blur};
use crate::stage::detail::vulkan::{GREATER, LOST, lost, raise};
use crate::stage::dual_mc::vulkan::{
    BASES, BLOCK_TILES, EMIT, Kernels as DualMc, Outputs, SIGN_TILES, SIGNS, Slot, TILES, Tally, contour,
    lengths,
};
use crate::stage::dual_mc::{Falls, Normals, normal};
use crate::stage::indicator::Indicator;
use crate::stage::indicator::vulkan::{INDICATE, indicate};
use crate::units::MemoryBudget;
use crate::vulkan::{Batch, Buffer, Device, Kernel, Place, Queue, Ticket, View, VulkanError};

use super::{Backend, Cpu, Pages, Stages, Surfaces};

/// Batches in flight.
const LANES: usize = 2;
/// Blocks of a batch at the most, and bins.
const BATCH: usize = 1024;
/// Bytes of a batch at the most, and at which the processor takes over.
const LARGEST_BATCH: u64 = 128 << 20;
const SMALLEST_BATCH: u64 = 1 << 20;
/// Vertices of a block on average that a batch has room for; a batch that has more is emitted again.
const BLOCK_ROOM: u64 = 6144;
/// Vertices that a block can have.
const MOST_VERTICES: u64 = 3 * (BLOCK * BLOCK * BLOCK) as u64;
/// Bytes of a page on the device.
const PAGE_BYTES: u64 = 4 * PAGE_WORDS as u64;
/// Offsets in buffers that are shared are multiples of what any device asks for.
const ALIGNMENT: u64 = 256;
/// What a driver that computes on the processor takes for its compiler.
const SOFTWARE_DRIVER: u64 = 96 << 20;

/// A Vulkan device with all kernels ready.
#[derive(Debug)]
pub struct Vulkan {
    device: Device,
    kernels: Arc<Kernels>,
    shares_host_memory: bool,
}

#[derive(Debug)]
struct Kernels {
    indicate: Arc<Kernel>,
    gather: Arc<Kernel>,
    blur: Arc<Kernel>,
    lost: Arc<Kernel>,
    greater: Arc<Kernel>,
    dual_mc: DualMc,
}

/// Bytes that a frame may take.
#[derive(Debug, Clone, Copy)]
struct Shares {
    /// A batch, on the device and what is staged for it on the host.
    batch: u64,
    /// The DIF, where it stays on the device.
    resident: u64,
    /// All that is in the host's memory.
    host: u64,
}

impl Vulkan {
    /// Compiles the kernels for a device.
    ///
    /// # Errors
    /// [`VulkanError`] where the driver refuses one.
    pub fn new(device: Device) -> Result<Self, VulkanError> {
        let kernel = |program| device.kernel(program).map(Arc::new);
        let kernels = Kernels {
            indicate: kernel(&INDICATE)?,
            gather: kernel(&GATHER)?,
            blur: kernel(&BLUR)?,
            lost: kernel(&LOST)?,
            greater: kernel(&GREATER)?,
            dual_mc: DualMc {
                signs: kernel(&SIGNS)?,
                tiles: kernel(&TILES)?,
                bases: kernel(&BASES)?,
                emit: kernel(&EMIT)?,
            },
        };
        let shares_host_memory = device.shares_host_memory();
        Ok(Self { device, kernels: Arc::new(kernels), shares_host_memory })
    }

    /// The device.
    #[must_use]
    pub fn device(&self) -> &Device {
        &self.device
    }

    fn shares(&self, budget: MemoryBudget) -> Shares {
        let own = self.device.memory().unwrap_or(u64::MAX);
        if self.shares_host_memory {
            let total = own.min(budget.0 / 4);
            let batch = (total / 2 / LANES as u64).min(LARGEST_BATCH);
            Shares { batch, resident: total / 2, host: total + SOFTWARE_DRIVER }
        } else {
            let batch = (own / 4 / LANES as u64).min(budget.0 / 8).min(LARGEST_BATCH);
            Shares { batch, resident: own / 2, host: LANES as u64 * batch }
        }
    }
}

impl Backend for Vulkan {
    fn name(&self) -> String {
        format!("Vulkan, {}", self.device.name())
    }

    fn host_bytes(&self, budget: MemoryBudget) -> u64 {
        self.shares(budget).host
    }

    fn start(&self, budget: MemoryBudget) -> Box<dyn Stages> {
        let shares = self.shares(budget);
        let state = State {
            lanes: Vec::new(),
            batch_bytes: shares.batch,
            resident_bytes: shares.resident,
            resident: None,
            on_cpu: false,
            warnings: Vec::new(),
        };
        let (device, kernels) = (self.device.clone(), Arc::clone(&self.kernels));
        Box::new(DeviceFrame { device, kernels, state: Mutex::new(state) })
    }
}

/// One frame on the device.
#[derive(Debug)]
struct DeviceFrame {
    device: Device,
    kernels: Arc<Kernels>,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    lanes: Vec<Lane>,
    batch_bytes: u64,
    resident_bytes: u64,
    resident: Option<Resident>,
    /// Once the device is lost or too small.
    on_cpu: bool,
    warnings: Vec<String>,
}

/// The pages of the frame's bins in one buffer.
#[derive(Debug)]
struct Resident {
    pages: Arc<Buffer>,
    numbers: HashMap<IVec3, u32>,
}

impl Stages for DeviceFrame {
    fn indicate(
        &self,
        bins: &Bins,
        range: Range<usize>,
        indicator: Indicator,
        side: BrickSide,
    ) -> io::Result<Pages> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let mut pages = Pages::with_capacity(range.len());
        while !state.on_cpu && pages.len() < range.len() {
            let left = range.start + pages.len()..range.end;
            match self.indicate_batches(&mut state, bins, left, indicator, side, &mut pages) {
                Ok(()) => {}
                Err(Fault::Scratch(error)) => return Err(error),
                Err(Fault::Device(error)) => state.recover(&error),
            }
        }
        if pages.len() < range.len() {
            // Without the pages of these bins the others are of no use.
            state.resident = None;
            pages.extend(Cpu.indicate(bins, range.start + pages.len()..range.end, indicator, side)?);
        }
        Ok(pages)
    }

    fn contour(&self, surfaces: &Surfaces<'_>, regions: &[CellBox]) -> Vec<Option<BlockMesh>> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let mut meshes = Vec::with_capacity(regions.len());
        while !state.on_cpu && meshes.len() < regions.len() {
            let left = &regions[meshes.len()..];
            if let Err(error) = self.contour_batches(&mut state, surfaces, left, &mut meshes) {
                state.recover(&error);
            }
        }
        let left = &regions[meshes.len()..];
        if !left.is_empty() {
            meshes.extend(Cpu.contour(surfaces, left));
        }
        meshes
    }

    fn warnings(&self) -> Vec<String> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner).warnings.clone()
    }
}

enum Fault {
    Device(VulkanError),
    Scratch(io::Error),
}

impl From<VulkanError> for Fault {
    fn from(error: VulkanError) -> Self {
        Self::Device(error)
    }
}

impl State {
    /// After a failure: smaller batches where memory is exhausted, the processor where that does not help.
    fn recover(&mut self, error: &VulkanError) {
        self.lanes.clear();
        let exhausted = matches!(error, VulkanError::OutOfMemory { .. });
        if exhausted && self.resident.take().is_some() {
            self.resident_bytes = 0;
            self.warn(format!("{error}; the field is sent anew for every batch"));
        } else if exhausted && self.batch_bytes / 2 >= SMALLEST_BATCH {
            self.batch_bytes /= 2;
            self.warn(format!("{error}; going on in batches of {}", bytesize::ByteSize(self.batch_bytes)));
        } else {
            self.resident = None;
            self.on_cpu = true;
            self.warn(format!("{error}; going on on the CPU"));
        }
    }

    fn warn(&mut self, warning: String) {
        self.warnings.push(warning);
    }

    fn lanes(&mut self, device: &Device) -> Result<&mut [Lane], VulkanError> {
        while self.lanes.len() < LANES {
            self.lanes.push(Lane::new(device)?);
        }
        Ok(&mut self.lanes)
    }

    /// Makes room for the pages of all `bins`, unless they are too many; pages of other bins are forgotten.
    fn make_resident(&mut self, device: &Device, bins: &Bins) {
        let count = bins.keys().len();
        let bytes = count as u64 * PAGE_BYTES;
        let known = self.resident.as_ref().is_some_and(|resident| {
            resident.numbers.len() == count && resident.numbers.contains_key(&bins.keys()[0].coord())
        });
        if known {
            return;
        }
        self.resident = None;
        if bytes <= self.resident_bytes.min(device.limits().storage_range) {
            let numbers = bins.keys().iter().map(|key| key.coord()).zip(0..).collect();
            match device.buffer(Place::Device, bytes) {
                Ok(pages) => self.resident = Some(Resident { pages, numbers }),
                Err(error) => self.warn(format!("{error}; the field is sent anew for every batch")),
            }
        }
        // Only once: runs of bins that follow one another do not fit together.
        self.resident_bytes = 0;
    }
}

/// What a batch works with, used again by the next.
#[derive(Debug)]
struct Lane {
    upload: Batch,
    compute: Batch,
    download: Batch,
    buffers: HashMap<&'static str, Arc<Buffer>>,
}

impl Lane {
    fn new(device: &Device) -> Result<Self, VulkanError> {
        Ok(Self {
            upload: device.batch(Queue::Transfer)?,
            compute: device.batch(Queue::Compute)?,
            download: device.batch(Queue::Transfer)?,
            buffers: HashMap::new(),
        })
    }

    /// A part of a buffer that is this lane's, `bytes` long. What was in it is lost.
    fn buffer(
        &mut self,
        device: &Device,
        name: &'static str,
        place: Place,
        bytes: u64,
    ) -> Result<View, VulkanError> {
        let bytes = bytes.next_multiple_of(4).max(4);
        if self.buffers.get(name).is_none_or(|buffer| buffer.bytes() < bytes) {
            self.buffers.remove(name);
            self.buffers.insert(name, device.buffer(place, bytes)?);
        }
        Ok(self.buffers[name].part(0, bytes))
    }

    /// Starts over: the lane's last batch is done.
    fn begin(&mut self) -> Result<(), VulkanError> {
        self.upload.begin()?;
        self.compute.begin()?;
        self.download.begin()
    }
}

/// Places one after the other in a buffer.
#[derive(Debug, Default)]
struct Layout {
    bytes: u64,
}

impl Layout {
    fn place(&mut self, bytes: u64) -> Range<u64> {
        let begin = self.bytes;
        self.bytes = (begin + bytes.max(4)).next_multiple_of(ALIGNMENT);
        begin..begin + bytes.max(4)
    }
}

fn part(view: &View, range: &Range<u64>) -> View {
    view.part(range.start, range.end - range.start)
}

/// A bin's particles among those of a batch, as `indicate.wgsl` has it.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct BinEntry {
    first: u32,
    count: u32,
}

/// Bins on their way through a lane.
struct BinBatch {
    bins: Range<usize>,
    pages: View,
}

impl DeviceFrame {
    fn indicate_batches(
        &self,
        state: &mut State,
        bins: &Bins,
        range: Range<usize>,
        indicator: Indicator,
        side: BrickSide,
        done: &mut Pages,
    ) -> Result<(), Fault> {
        state.make_resident(&self.device, bins);
        let room = state.batch_bytes;
        let State { resident, .. } = &*state;
        let resident = resident.as_ref().map(|resident| Arc::clone(&resident.pages));
        state.lanes(&self.device)?;
        let mut next = range.start;
        let mut idle: Vec<usize> = (0..LANES).collect();
        let mut flying: VecDeque<(usize, BinBatch)> = VecDeque::new();
        while next < range.end || !flying.is_empty() {
            if next < range.end
                && let Some(number) = idle.pop()
            {
                let batch = bin_batch(bins, next..range.end, room);
                next = batch.end;
                let lane = &mut state.lanes[number];
                let resident = resident.as_ref();
                flying.push_back((number, self.start_bins(lane, bins, batch, indicator, resident)?));
            } else if let Some((number, batch)) = flying.pop_front() {
                state.lanes[number].download.wait()?;
                let samples: Vec<u16> = batch.pages.read(0, batch.bins.len() * 2 * PAGE_WORDS as usize);
                let pages = samples.par_chunks_exact(2 * PAGE_WORDS as usize).zip(batch.bins);
                let pages = pages.map(|(dense, bin)| {
                    let page = PageInfo::from_dense(bins.keys()[bin].coord(), dense, side);
                    page.expect("a bin holds particles")
                });
                done.par_extend(pages);
                idle.push(number);
            }
        }
        Ok(())
    }

    fn start_bins(
        &self,
        lane: &mut Lane,
        bins: &Bins,
        range: Range<usize>,
        indicator: Indicator,
        resident: Option<&Arc<Buffer>>,
    ) -> Result<BinBatch, Fault> {
        let count = range.len() as u64;
        let mut entries = Vec::with_capacity(range.len());
        let mut first = 0;
        for bin in range.clone() {
            let count = bins.count(bin) as u32;
            entries.push(BinEntry { first, count });
            first += count;
        }
        let mut layout = Layout::default();
        let entries_at = layout.place(size_of_val(&entries[..]) as u64);
        let records_at = layout.place(8 * u64::from(first));
        lane.begin()?;
        let device = &self.device;
        let staged = lane.buffer(device, "staged", Place::Upload, layout.bytes)?;
        let inputs = lane.buffer(device, "inputs", Place::Device, layout.bytes)?;
        let read = lane.buffer(device, "pages read", Place::Download, count * PAGE_BYTES)?;
        let pages = match resident {
            Some(resident) => resident.part(range.start as u64 * PAGE_BYTES, count * PAGE_BYTES),
            None => lane.buffer(device, "pages", Place::Device, count * PAGE_BYTES)?,
        };
        staged.write(entries_at.start, &entries);
        range.clone().into_par_iter().zip(&entries).try_for_each(|(bin, entry)| {
            let contents = bins.contents(bin).map_err(Fault::Scratch)?;
            staged.write(records_at.start + 8 * u64::from(entry.first), contents.packed());
            Ok::<_, Fault>(())
        })?;

        let uploaded = upload(lane, &staged, &inputs)?;
        lane.compute.stage("indicate", inputs.bytes() + pages.bytes());
        let [entries, records] = [part(&inputs, &entries_at), part(&inputs, &records_at)];
        let views = [&entries, &records, &pages];
        indicate(&mut lane.compute, &self.kernels.indicate, count as u32, indicator, views)?;
        let computed = lane.compute.submit(&[uploaded])?;
        lane.download.stage("download", 2 * pages.bytes());
        lane.download.copy(&pages, &read);
        lane.download.submit(&[computed])?;
        Ok(BinBatch { bins: range, pages: read })
    }

    fn contour_batches(
        &self,
        state: &mut State,
        surfaces: &Surfaces<'_>,
        regions: &[CellBox],
        done: &mut Vec<Option<BlockMesh>>,
    ) -> Result<(), VulkanError> {
        state.lanes(&self.device)?;
        let constants = Constants::new(&self.device, surfaces)?;
        let State { lanes, resident, batch_bytes, .. } = state;
        let work = Contouring { frame: self, surfaces, constants, resident: resident.as_ref() };
        let mut next = 0;
        let mut idle: Vec<usize> = (0..LANES).collect();
        let mut flying: VecDeque<(usize, BlockBatch)> = VecDeque::new();
        while next < regions.len() || !flying.is_empty() {
            if next < regions.len()
                && let Some(number) = idle.pop()
            {
                let batch = BlockBatch::new(&work, &regions[next..], *batch_bytes);
                next += batch.regions.len();
                work.start(&mut lanes[number], &batch)?;
                flying.push_back((number, batch));
            } else if let Some((number, batch)) = flying.pop_front() {
                done.extend(work.finish(&mut lanes[number], batch)?);
                idle.push(number);
            }
        }
        Ok(())
    }
}

/// As many bins as a batch has room for, at least one.
fn bin_batch(bins: &Bins, range: Range<usize>, room: u64) -> Range<usize> {
    let mut bytes = 0;
    let mut end = range.start;
    while end < range.end && end - range.start < BATCH {
        bytes += 2 * (8 * bins.count(end) as u64 + PAGE_BYTES);
        if end > range.start && bytes > room {
            break;
        }
        end += 1;
    }
    range.start..end
}

fn upload(lane: &mut Lane, staged: &View, inputs: &View) -> Result<Ticket, VulkanError> {
    lane.upload.stage("upload", 2 * staged.bytes());
    lane.upload.copy(staged, inputs);
    lane.upload.submit(&[])
}

/// What all batches of blocks need.
struct Constants {
    filters: Vec<View>,
    detail: View,
    theta: View,
    decode: u32,
    lengths: View,
}

impl Constants {
    fn new(device: &Device, surfaces: &Surfaces<'_>) -> Result<Self, VulkanError> {
        let upload = |values: &[u32]| {
            let buffer = device.buffer(Place::Upload, size_of_val(values) as u64)?;
            buffer.write(0, values);
            Ok::<_, VulkanError>(buffer.whole())
        };
        let recipe = surfaces.recipe;
        let theta: Vec<u32> =
            surfaces.dif.decode_table().unwrap_or_default().iter().map(|&theta| theta.into()).collect();
        Ok(Self {
            filters: recipe.smoothing.filters().iter().map(|k| upload(k.half())).collect::<Result<_, _>>()?,
            detail: upload(recipe.detail.as_ref().map_or(&[], |kernel| kernel.half()))?,
            theta: upload(&theta)?,
            decode: theta.len() as u32,
            lengths: upload(&lengths())?,
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
    /// As many of the first regions as fit into `bytes`, at least one.
    fn new(work: &Contouring<'_>, regions: &[CellBox], bytes: u64) -> Self {
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
        let halo = work.surfaces.recipe.halo();
        let mut numbers: HashMap<IVec3, u32> = HashMap::new();
        let mut taken = batch.room * work.vertex_bytes() * 2;
        for &region in regions.iter().take(BATCH) {
            let cells = work.surfaces.field(region).grown(halo, halo);
            let mut block = DeviceBlock::new(cells, region.tiled());
            let bins: Vec<IVec3> = block.bins().collect();
            let dif = work.surfaces.dif;
            let unknown = |bin: &&IVec3| dif.has_page(**bin) && !numbers.contains_key(*bin);
            let new = if work.resident.is_some() { 0 } else { bins.iter().filter(unknown).count() as u64 };
            taken += work.block_bytes(&block) + new * 2 * PAGE_BYTES + 8 * bins.len() as u64;
            let field_bytes = 4 * (u64::from(batch.words) + u64::from(block.words()));
            let page_bytes = (batch.sent.len() as u64 + new) * PAGE_BYTES;
            if !batch.blocks.is_empty() && (taken > bytes || field_bytes.max(page_bytes) > limit) {
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
        if self.surfaces.recipe.detail.is_some() { 3 } else { 2 }
    }

    /// Bytes of a block, on the device and staged.
    fn block_bytes(&self, block: &DeviceBlock) -> u64 {
        let tiles = u64::from(BLOCK_TILES) * (2 * size_of::<Tile>() + size_of::<Slot>()) as u64;
        4 * self.fields() * u64::from(block.words())
            + tiles
            + 8 * u64::from(SIGN_TILES)
            + 2 * BLOCK_ROOM * self.vertex_bytes()
    }

    /// Sends a batch and has it computed.
    fn start(&self, lane: &mut Lane, batch: &BlockBatch) -> Result<(), VulkanError> {
        let device = &self.frame.device;
        let kernels = &self.frame.kernels;
        let mut layout = Layout::default();
        let blocks_at = layout.place(size_of_val(&batch.blocks[..]) as u64);
        let tables_at = layout.place(size_of_val(&batch.tables[..]) as u64);
        let pages_at = layout.place(batch.sent.len() as u64 * PAGE_BYTES);
        lane.begin()?;
        let staged = lane.buffer(device, "staged", Place::Upload, layout.bytes)?;
        let inputs = lane.buffer(device, "inputs", Place::Device, layout.bytes)?;
        let count = batch.blocks.len() as u64;
        let field_bytes = 4 * u64::from(batch.words);
        let first = lane.buffer(device, "first field", Place::Device, field_bytes)?;
        let second = lane.buffer(device, "second field", Place::Device, field_bytes)?;
        let third = match self.fields() {
            3 => lane.buffer(device, "third field", Place::Device, field_bytes)?,
            _ => first.clone(),
        };
        let outputs = self.outputs(lane, count, batch.room)?;
        let read = lane.buffer(device, "tallies read", Place::Download, outputs.tallies.bytes())?;

        staged.write(blocks_at.start, &batch.blocks);
        staged.write(tables_at.start, &batch.tables);
        batch.sent.par_iter().enumerate().for_each_init(
            || vec![0; BIN.pow(3) as usize],
            |dense, (number, &bin)| {
                self.surfaces.dif.write_stored(bin, dense);
                staged.write(pages_at.start + number as u64 * PAGE_BYTES, dense);
            },
        );
        let uploaded = upload(lane, &staged, &inputs)?;

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
            theta: self.constants.theta.clone(),
            decode: self.constants.decode,
        };
        commands.stage("gather", pages.pages.bytes() + field_bytes);
        gather(commands, &kernels.gather, &blocks, &pages, &first)?;
        let field = self.record_field(commands, &blocks, [first, second, third])?;
        commands.stage("dual marching cubes", field_bytes);
        let (iso, walls) = (self.surfaces.recipe.iso, self.surfaces.walls());
        let normals = self.has_normals();
        contour(commands, &kernels.dual_mc, &blocks, &field, iso, walls, normals, &outputs)?;
        commands.copy(&outputs.tallies, &read);
        commands.submit(&[uploaded])?;
        Ok(())
    }

    /// The recipe, on the device; returns the field that holds the result.
    fn record_field(
        &self,
        commands: &mut Batch,
        blocks: &DeviceBlocks,
        [dif, mut smooth, mut spare]: [View; 3],
    ) -> Result<View, VulkanError> {
        let kernels = &self.frame.kernels;
        let recipe = self.surfaces.recipe;
        let walls = self.surfaces.walls();
        let mut margin = 0;
        let mut from = dif.clone();
        let field_bytes = 4 * u64::from(blocks.words);
        commands.stage("blur", 6 * field_bytes * recipe.smoothing.filters().len() as u64);
        for filter in recipe.smoothing.filters().iter().zip(&self.constants.filters) {
            blur(commands, &kernels.blur, blocks, filter, walls, margin, [&from, &spare, &smooth])?;
            margin += filter.0.reach();
            from = smooth.clone();
            std::mem::swap(&mut smooth, &mut spare);
        }
        let Some(kernel) = &recipe.detail else { return Ok(from) };
        // `from` is the smoothed DIF, and one of the other two.
        let (smooth, spare) = (from, smooth);
        commands.stage("detail", 12 * field_bytes);
        lost(commands, &kernels.lost, blocks, recipe.iso, [&dif, &smooth, &spare])?;
        let filter = (kernel, &self.constants.detail);
        blur(commands, &kernels.blur, blocks, filter, walls, margin, [&spare, &spare, &dif])?;
        raise(commands, &kernels.greater, blocks, &smooth, &dif)?;
        Ok(dif)
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

    /// Waits for a batch, and reads it.
    fn finish(&self, lane: &mut Lane, mut batch: BlockBatch) -> Result<Vec<Option<BlockMesh>>, VulkanError> {
        let device = &self.frame.device;
        let count = batch.blocks.len();
        let begins: Vec<Tally> = loop {
            lane.compute.wait()?;
            let begins: Vec<Tally> = lane.buffers["tallies read"].read(0, count + 1);
            let vertices = u64::from(begins[count].vertices);
            if vertices <= batch.room {
                break begins;
            }
            batch.room = vertices;
            self.start(lane, &batch)?;
        };
        let totals = begins[count];
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
        lane.download.submit(&[])?;
        lane.download.wait()?;
        let blocks = batch.regions.par_iter().zip(begins.par_windows(2));
        Ok(blocks
            .map(|(region, begins)| {
                let [begin, end] = [begins[0], begins[1]];
                let count = (end.tiles - begin.tiles) as usize;
                if count == 0 {
                    return None;
                }
                let vertices = (end.vertices - begin.vertices) as usize;
                let first = u64::from(begin.vertices);
                let mut mesh = BlockMesh {
                    block: region.lo.div_euclid(IVec3::splat(BLOCK)),
                    tiles: tiles.read(u64::from(begin.tiles) * size_of::<Tile>() as u64, count),
                    ends: ends.read(first * size_of::<[u16; 2]>() as u64, vertices),
                    triangle_count: (end.triangles - begin.triangles) as usize,
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
        let (iso, walls) = (self.surfaces.recipe.iso, self.surfaces.walls());
        mesh.edges()
            .zip(&mesh.ends)
            .zip(falls)
            .map(|((edge, &ends), &falls)| normal(edge, ends, falls, iso, walls))
            .collect()
    }
}
