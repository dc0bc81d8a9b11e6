//! Binning on a device: the counting sort of [`BinPlan`](crate::brick::BinPlan), with a hash table
//! of bins.
//!
//! Positions are read once, in chunks. For every particle, shaders compute the bin and the position
//! in the bin with integers that emulate the host's f64 arithmetic, find or insert the bin in the
//! table, and count the particle there. The host sorts the bins. Then a shader moves every particle
//! to its bin's slots.

use std::ops::Range;
use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use thiserror::Error;

use crate::brick::cubes::bin_coord;
use crate::brick::{BinError, Census, InvalidParticles};
use crate::grid::{Domain, Grid, MortonKey};
use crate::shaders::{ENTER, EnterPush, PLACE, PlacePush, SETTLE, SORT, SettlePush, SortPush};
use crate::vulkan::{
    ALIGNMENT, Batch, Buffer, BufferKind, ComputePipeline, Device, Limits, PIECE, Queue, View,
    VulkanError,
};

use super::{DeviceGrid, flat_groups};

/// Number of particles per chunk. The buffer that [`Binning::keep`] creates for a chunk of this
/// size almost fills one allocation.
const CHUNK: usize = (PIECE / (RECORD_BYTES + HOME_BYTES) / ALIGNMENT * ALIGNMENT) as usize;
/// Number of chunks in a batch. Each chunk takes at most three dispatches and two stages.
const BATCH_CHUNKS: usize = 16;
/// Number of particles per slot of the first table of bins. If the table is too small, the next one
/// is [`GROWTH`] times larger.
const SLOT_PARTICLES: usize = 256;
const GROWTH: u64 = 8;
/// Maximum number of slots that are probed for a bin. If none of them is free, the table is too
/// small.
pub const PROBES: u32 = 128;
/// The value of a slot's `owner` once the slot's key is stored.
pub const SETTLED: u32 = u32::MAX;
/// The value of both words of the key of a particle without a bin.
pub const NO_BIN: u32 = u32::MAX;
/// The sort handles one run of bins at a time. This value marks a slot whose bin belongs to another
/// run than the current one. A slot of the current run holds the position of its bin's next
/// particle instead.
pub const ELSEWHERE: u32 = u32::MAX;
/// Bytes of a packed particle.
const RECORD_BYTES: u64 = 8;
/// Size, in bytes, of the number of a slot, which is stored for each particle.
const HOME_BYTES: u64 = 4;
/// Maximum number of particles in a bin. One work group can sum this number of particles before the
/// driver's timeout. The maximum is 4096 particles per cell, far more than is useful.
const MOST_IN_BIN: u32 = 1 << 24;

/// The shaders of binning.
#[derive(Debug)]
pub struct BinPipelines {
    place: Arc<ComputePipeline>,
    enter: Arc<ComputePipeline>,
    settle: Arc<ComputePipeline>,
    sort: Arc<ComputePipeline>,
}

impl BinPipelines {
    /// Compiles the shaders.
    ///
    /// # Errors
    /// If the driver rejects a shader.
    pub fn new(device: &Device) -> Result<Self, VulkanError> {
        let [place, enter, settle, sort] = device.pipelines([&PLACE, &ENTER, &SETTLE, &SORT])?;
        Ok(Self { place, enter, settle, sort })
    }
}

/// The number format of a coordinate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Coordinate {
    /// A coordinate stored as an f32.
    Single,
    /// A coordinate stored as an f64, low word first.
    Double,
}

impl Coordinate {
    /// The size of a coordinate in bytes.
    #[must_use]
    pub fn bytes(self) -> u64 {
        match self {
            Self::Single => 4,
            Self::Double => 8,
        }
    }
}

/// Positions on the device: x, y and z of one particle after another. Shaders read them. If a
/// particle is invalid, the host downloads its position for the error message.
#[derive(Debug, Clone)]
pub struct DevicePositions {
    /// The buffer; its offset must be a multiple of 4 bytes.
    pub view: View,
    /// Number of particles.
    pub count: usize,
    /// The number format of each coordinate.
    pub coordinate: Coordinate,
}

/// Consecutive bins, and the packed particles of all of them.
pub type BinRun = (Range<usize>, Arc<Buffer>);

/// Particles on the device, in bin order.
#[derive(Debug)]
pub struct DeviceBins {
    /// The bins with particles, in Morton order.
    pub keys: Vec<MortonKey>,
    /// The index of each bin's first particle; the last entry is the number of particles.
    pub first: Vec<usize>,
    /// Numbers of binned and skipped particles.
    pub census: Census,
    /// Runs of bins with the packed particles of each run, 8 bytes per particle. There is a single
    /// run if one buffer can hold all particles.
    pub runs: Vec<BinRun>,
}

impl DeviceBins {
    /// Divides a run of bins into parts of at most `bins` bins and `particles` particles. A bin
    /// with more particles is a part of its own.
    pub fn parts(
        &self,
        run: Range<usize>,
        bins: usize,
        particles: usize,
    ) -> impl Iterator<Item = Range<usize>> + '_ {
        let mut begin = run.start;
        std::iter::from_fn(move || {
            let fits = |end: &usize| self.first[*end] - self.first[begin] <= particles;
            let last = (begin + 1..=run.end.min(begin + bins)).take_while(fits).last();
            let part = begin..last.unwrap_or(begin + 1);
            (begin < run.end).then(|| {
                begin = part.end;
                part
            })
        })
    }
}

/// An error of binning on the device.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum DeviceBinError {
    /// The particles cannot be binned, on a device or on the host.
    #[error(transparent)]
    Bin(#[from] BinError),
    /// The device failed, or has too little memory.
    #[error(transparent)]
    Vulkan(#[from] VulkanError),
}

/// The census of a chunk, laid out as in `place.wgsl`.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct ChunkCensus {
    not_finite: u32,
    too_far: u32,
    outside: u32,
    invalid: u32,
    overflow: u32,
}

/// A slot of the table of bins, laid out as in `bin_table.wgsl`.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct BinSlot {
    owner: u32,
    count: u32,
    key: [u32; 2],
}

/// Particles of one dispatch.
struct DeviceChunk {
    /// The index of the first particle.
    index: usize,
    count: u32,
    positions: View,
    /// Number of words of `positions` before the first coordinate.
    first: u32,
    /// Number of words of a coordinate.
    width: u32,
}

impl DeviceChunk {
    fn groups(&self, pipeline: &ComputePipeline) -> [u32; 3] {
        [pipeline.groups(self.count), 1, 1]
    }

    /// Returns the bytes of the chunk's positions.
    fn bytes(&self) -> u64 {
        12 * u64::from(self.count * self.width)
    }
}

fn chunks(positions: &[DevicePositions], limits: Limits) -> Vec<DeviceChunk> {
    let mut chunks = Vec::new();
    let mut before = 0;
    for DevicePositions { view, count, coordinate } in positions {
        let particle = 3 * coordinate.bytes();
        let per_view = (limits.storage_range - limits.alignment) / particle;
        let most = CHUNK.min(per_view as usize);
        for first in (0..*count).step_by(most) {
            let len = most.min(count - first);
            let part =
                view.aligned(first as u64 * particle, len as u64 * particle, limits.alignment);
            let (positions, words) = part;
            let width = (coordinate.bytes() / 4) as u32;
            chunks.push(DeviceChunk {
                index: before + first,
                count: len as u32,
                positions,
                first: words,
                width,
            });
        }
        before += count;
    }
    chunks
}

/// Sorts particles into the same bins as [`BinPlan`](crate::brick::BinPlan), unless they touch more
/// than `limit` bins. The order inside a bin is arbitrary.
///
/// # Errors
/// [`DeviceBinError::Bin`] if binning on the host would fail with the same error.
/// [`VulkanError::OutOfMemory`] if there are 2^32 particles or more, if a bin has more than 2^24
/// particles or more than a buffer can hold, or if the device has no memory for 20 bytes per
/// particle; 8 of these bytes stay allocated.
///
/// # Panics
/// If a view is smaller than its positions.
pub fn bin(
    device: &Device,
    pipelines: &BinPipelines,
    positions: &[DevicePositions],
    grid: &Grid,
    domain: Option<&Domain>,
    invalid: InvalidParticles,
    limit: usize,
) -> Result<DeviceBins, DeviceBinError> {
    let total: usize = positions.iter().map(|p| p.count).sum();
    if u32::try_from(total).is_err() {
        return Err(VulkanError::OutOfMemory { bytes: total as u64 * RECORD_BYTES }.into());
    }
    // The grid is in device memory, because each particle's thread reads it.
    let mut batch = device.batch(Queue::Compute)?;
    batch.begin()?;
    let device_grid = batch.store(&[DeviceGrid::new(grid, domain)])?;
    batch.submit(&[])?;
    batch.wait()?;
    let chunks = chunks(positions, device.limits());
    let binning = Binning { device, pipelines, grid: device_grid, chunks, limit };
    let CountedBins { kept, table, census } = binning.count(total)?;
    let (census, first_invalid) = binning.sum(&census, total);
    if let (InvalidParticles::Refuse, Some(index)) = (invalid, first_invalid) {
        let position = binning.position(positions, index)?;
        return Err(if position.iter().all(|x| x.is_finite()) {
            BinError::TooFar { index, position, cell_size: grid.cell_size() }.into()
        } else {
            BinError::NotFinite { index, position }.into()
        });
    }
    let key = |slot: &BinSlot| bin_coord(u64::from(slot.key[0]) | u64::from(slot.key[1]) << 32);
    let used = (0_u32..).zip(&table).filter(|(_, slot)| slot.count > 0);
    let mut bins: Vec<_> =
        used.map(|(i, slot)| (MortonKey::of(key(slot)), i, slot.count)).collect();
    bins.sort_unstable();
    if bins.len() > limit {
        return Err(BinError::TooManyBins { limit }.into());
    }
    if let Some(&(.., count)) = bins.iter().find(|&&(.., count)| count > MOST_IN_BIN) {
        return Err(VulkanError::OutOfMemory { bytes: u64::from(count) * RECORD_BYTES }.into());
    }
    let mut first = vec![0];
    first.extend(bins.iter().scan(0, |end, &(_, _, count)| {
        *end += count as usize;
        Some(*end)
    }));
    let slots_of_bins: Vec<u32> = bins.iter().map(|&(_, slot, _)| slot).collect();
    let runs = binning.sort(&kept, table.len(), &slots_of_bins, &first)?;
    Ok(DeviceBins { keys: bins.into_iter().map(|(key, _, _)| key).collect(), first, census, runs })
}

/// The result of the first pass: the packed particles, and the table of bins with their counts.
struct CountedBins {
    /// The packed particles of each chunk, with the slots of their bins.
    kept: Vec<PackedChunk>,
    table: Vec<BinSlot>,
    /// The census of each chunk.
    census: Vec<ChunkCensus>,
}

/// The packed particles of a chunk, with the slots of their bins; kept for sorting.
struct PackedChunk {
    packed: View,
    /// For each particle, the slot of its bin.
    homes: View,
}

struct Binning<'a> {
    device: &'a Device,
    pipelines: &'a BinPipelines,
    grid: View,
    chunks: Vec<DeviceChunk>,
    limit: usize,
}

impl Binning<'_> {
    /// The first pass: places and counts the particles.
    fn count(&self, total: usize) -> Result<CountedBins, DeviceBinError> {
        let mut batch = self.device.batch(Queue::Compute)?;
        let largest = self.chunks.iter().map(|chunk| chunk.count).max().unwrap_or(0);
        let keys = self.device.buffer(BufferKind::Device, 8 * u64::from(largest))?;
        let census_bytes = (self.chunks.len().max(1) * size_of::<ChunkCensus>()) as u64;
        let census = self.device.buffer(BufferKind::Device, census_bytes)?;
        let census_read = self.device.buffer(BufferKind::Download, census_bytes)?;
        let kept: Vec<PackedChunk> =
            self.chunks.iter().map(|chunk| self.keep(chunk)).collect::<Result<_, VulkanError>>()?;
        let mut len = (total / SLOT_PARTICLES).max(1 << 10).next_power_of_two() as u64;
        loop {
            let bytes = len * size_of::<BinSlot>() as u64;
            if bytes > self.device.limits().storage_range {
                return Err(VulkanError::OutOfMemory { bytes }.into());
            }
            let slots = self.device.buffer(BufferKind::Device, bytes)?;
            let slots_read = self.device.buffer(BufferKind::Download, bytes)?;
            batch.begin()?;
            batch.clear(&census.whole());
            batch.clear(&slots.whole());
            for (i, chunk) in self.chunks.iter().enumerate() {
                if i > 0 && i % BATCH_CHUNKS == 0 {
                    batch.submit(&[])?;
                    batch.begin()?;
                }
                let buffers = [&keys, &slots, &census];
                self.count_chunk(&mut batch, i as u32, (chunk, &kept[i]), len as u32, buffers)?;
            }
            batch.copy(&census.whole(), &census_read.whole());
            batch.copy(&slots.whole(), &slots_read.whole());
            batch.submit(&[])?;
            batch.wait()?;
            // SAFETY: the only batch that writes these buffers is done.
            let (census, table): (Vec<ChunkCensus>, Vec<BinSlot>) = unsafe {
                (census_read.read(0, self.chunks.len().max(1)), slots_read.read(0, len as usize))
            };
            if census[0].overflow == 0 {
                return Ok(CountedBins { kept, table, census });
            }
            if table.iter().filter(|slot| slot.count > 0).count() > self.limit {
                return Err(BinError::TooManyBins { limit: self.limit }.into());
            }
            len *= GROWTH;
        }
    }

    /// Allocates the buffers that hold a chunk's particles until they are sorted.
    fn keep(&self, chunk: &DeviceChunk) -> Result<PackedChunk, VulkanError> {
        let packed = RECORD_BYTES * u64::from(chunk.count);
        let begin = packed.next_multiple_of(ALIGNMENT);
        let homes = HOME_BYTES * u64::from(chunk.count);
        let buffer = self.device.buffer(BufferKind::Device, begin + homes)?;
        Ok(PackedChunk { packed: buffer.part(0, packed), homes: buffer.part(begin, homes) })
    }

    fn count_chunk(
        &self,
        batch: &mut Batch,
        number: u32,
        (chunk, kept): (&DeviceChunk, &PackedChunk),
        slots_len: u32,
        buffers: [&Arc<Buffer>; 3],
    ) -> Result<(), VulkanError> {
        let &DeviceChunk { count, first, width, .. } = chunk;
        let [keys, slots, census] = buffers.map(Buffer::whole);
        let pipelines = self.pipelines;
        batch.stage("place", chunk.bytes() + 16 * u64::from(count));
        let PackedChunk { packed, homes } = kept;
        let buffers = [&self.grid, &chunk.positions, &keys, packed, &census].map(Clone::clone);
        let push = PlacePush { first, count, width, chunk: number };
        batch.dispatch(&pipelines.place, &buffers, &push, chunk.groups(&pipelines.place))?;
        batch.stage("count bins", 12 * u64::from(count));
        let buffers = [keys, slots, census, homes.clone()];
        let push = EnterPush { count, mask: slots_len - 1 };
        batch.dispatch(&pipelines.enter, &buffers, &push, chunk.groups(&pipelines.enter))?;
        let push = SettlePush { slots: slots_len };
        batch.dispatch(
            &pipelines.settle,
            &buffers[..2],
            &push,
            flat_groups(slots_len, &pipelines.settle),
        )
    }

    /// The census of all chunks, and the index of the first invalid particle.
    fn sum(&self, chunks: &[ChunkCensus], total: usize) -> (Census, Option<usize>) {
        let mut census = Census { binned: total, ..Census::default() };
        let mut first_invalid = None;
        for (chunk, counts) in self.chunks.iter().zip(chunks) {
            let [not_finite, too_far, outside] =
                [counts.not_finite, counts.too_far, counts.outside].map(|n| n as usize);
            census.not_finite += not_finite;
            census.too_far += too_far;
            census.outside += outside;
            census.binned -= not_finite + too_far + outside;
            if counts.invalid > 0 {
                first_invalid.get_or_insert(chunk.index + (chunk.count - counts.invalid) as usize);
            }
        }
        (census, first_invalid)
    }

    /// The position of particle number `index`.
    fn position(
        &self,
        positions: &[DevicePositions],
        mut index: usize,
    ) -> Result<[f64; 3], VulkanError> {
        let mut positions = positions.iter();
        let found = positions.find(|p| {
            index < p.count || {
                index -= p.count;
                false
            }
        });
        let DevicePositions { view, coordinate, .. } = found.expect("the particle was counted");
        let bytes = 3 * coordinate.bytes();
        let read = self.device.buffer(BufferKind::Download, bytes)?;
        let mut batch = self.device.batch(Queue::Compute)?;
        batch.begin()?;
        batch.copy(&view.part(index as u64 * bytes, bytes), &read.whole());
        batch.submit(&[])?;
        batch.wait()?;
        // SAFETY: the only batch that writes this buffer is done.
        let values: Vec<f64> = unsafe {
            match coordinate {
                Coordinate::Single => read.read::<f32>(0, 3).into_iter().map(f64::from).collect(),
                Coordinate::Double => read.read(0, 3),
            }
        };
        Ok([values[0], values[1], values[2]])
    }

    /// Moves all particles to their bins, run by run.
    fn sort(
        &self,
        kept: &[PackedChunk],
        slots: usize,
        slots_of_bins: &[u32],
        first: &[usize],
    ) -> Result<Vec<BinRun>, VulkanError> {
        let mut batch = self.device.batch(Queue::Compute)?;
        let upload = self.device.buffer(BufferKind::Upload, 4 * slots as u64)?;
        let places = self.device.buffer(BufferKind::Device, 4 * slots as u64)?;
        let mut runs = Vec::new();
        let limits = self.device.limits();
        for run in runs_of(first, limits.storage_range.min(limits.allocation) / RECORD_BYTES) {
            let particles = first[run.end] - first[run.start];
            let records =
                self.device.buffer(BufferKind::Device, particles as u64 * RECORD_BYTES)?;
            let mut values = vec![ELSEWHERE; slots];
            for bin in run.clone() {
                values[slots_of_bins[bin] as usize] = (first[bin] - first[run.start]) as u32;
            }
            // SAFETY: the previous run has finished, and nothing else uses the buffer.
            unsafe { upload.write(0, &values) };
            batch.begin()?;
            batch.copy(&upload.whole(), &places.whole());
            for (i, (chunk, PackedChunk { packed, homes })) in
                self.chunks.iter().zip(kept).enumerate()
            {
                if i > 0 && i % BATCH_CHUNKS == 0 {
                    batch.submit(&[])?;
                    batch.begin()?;
                }
                let buffers = [packed, homes, &places.whole(), &records.whole()].map(Clone::clone);
                let push = SortPush { count: chunk.count };
                batch.stage("sort", (2 * RECORD_BYTES + 4) * u64::from(chunk.count));
                batch.dispatch(
                    &self.pipelines.sort,
                    &buffers,
                    &push,
                    chunk.groups(&self.pipelines.sort),
                )?;
            }
            batch.submit(&[])?;
            batch.wait()?;
            runs.push((run, records));
        }
        Ok(runs)
    }
}

/// Divides the bins into runs of at most `particles` particles; a bin with more particles is a run
/// of its own.
fn runs_of(first: &[usize], particles: u64) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    for bin in 0..first.len() - 1 {
        match runs.last_mut() {
            Some(run) if (first[bin + 1] - first[run.start]) as u64 <= particles => {
                run.end = bin + 1
            }
            _ => runs.push(bin..bin + 1),
        }
    }
    runs
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chunk_of_kept_records_fills_one_allocation() {
        let bytes = CHUNK as u64 * (RECORD_BYTES + HOME_BYTES);
        assert!((PIECE - PIECE / 1000..=PIECE).contains(&bytes), "{bytes} of {PIECE}");
        assert!((CHUNK as u64 * RECORD_BYTES).is_multiple_of(ALIGNMENT));
    }

    #[test]
    fn runs_are_limited_in_bins_and_particles_without_splitting_bins() {
        let counts = [3, 1, 9, 2, 2, 2, 2, 0, 1];
        let mut first = vec![0];
        counts.iter().for_each(|count| first.push(first[first.len() - 1] + count));
        let bins =
            DeviceBins { keys: Vec::new(), first, census: Census::default(), runs: Vec::new() };
        let parts: Vec<_> = bins.parts(1..9, 3, 5).collect();
        assert_eq!(parts, [1..2, 2..3, 3..5, 5..8, 8..9]);
        assert_eq!(bins.parts(0..9, 100, 100).map(|part| part.len()).collect::<Vec<_>>(), [9]);
        assert_eq!(bins.parts(4..4, 3, 5).count(), 0);
    }
}
