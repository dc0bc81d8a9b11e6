//! The stage from bins to pages.

use std::io;
use std::ops::Range;
use std::sync::Arc;

use rayon::prelude::*;

use crate::brick::vulkan::{DeviceBins, DeviceFullCells, full_cells};
use crate::brick::{Bins, PageInfo, PageShape, Pages};
use crate::field::indicator::PageRule;
use crate::field::indicator::vulkan::{BinEntry, indicate};
use crate::grid::MortonKey;
use crate::system::control::Meter;
use crate::vulkan::{BufferKind, View, VulkanError};

use super::frame::{DeviceFrame, DeviceState};
use super::lane::{BufferLayout, Lane, part, run_batches};
use super::pipelines::page_bytes;
use super::resident::ResidentPages;

/// Maximum number of bins in a batch.
const BIN_BATCH: usize = 4096;
/// Maximum number of particles in a batch of several bins. Batches are limited because drivers
/// reset a device that computes for about two seconds without a pause.
const PARTICLE_BATCH: usize = 4 << 20;

/// An error of the device or of the host.
pub(super) enum DeviceFrameError {
    Device(VulkanError),
    /// A scratch file with particles or surfaces failed, or the work was cancelled.
    Host(io::Error),
}

impl From<VulkanError> for DeviceFrameError {
    fn from(error: VulkanError) -> Self {
        Self::Device(error)
    }
}

/// A batch of bins in a lane, with the buffers of its pages.
struct BinBatch {
    bins: Range<usize>,
    pages: View,
    read: View,
}

/// The data that is read back for finished pages.
#[derive(Clone, Copy, PartialEq)]
enum ReadBack {
    /// The pages themselves.
    Pages,
    /// Only the masks of full cells, because the pages stay on the device.
    FullCells,
}

/// The settings for batches of bins.
struct BatchSettings<'a> {
    rule: &'a PageRule,
    /// The buffer in which the pages of all bins stay on the device, if they stay there.
    resident: Option<Arc<ResidentPages>>,
    read: ReadBack,
}

impl DeviceFrame {
    /// Makes the pages of a range of bins, and adds them to `done`, until a failure.
    pub(super) fn indicate_batches(
        &self,
        state: &mut DeviceState,
        bins: &Bins,
        range: Range<usize>,
        rule: &PageRule,
        meter: &Meter<'_>,
        done: &mut Pages,
    ) -> Result<(), DeviceFrameError> {
        let shape = rule.shape();
        self.make_resident(state, bins.keys(), shape);
        let settings = BatchSettings { rule, resident: self.resident(0), read: ReadBack::Pages };
        self.make_bins(state, bins, range, &settings, |lane, batch| {
            meter.add(batch.bins.len());
            done.extend(read_pages(lane, batch, bins.keys(), shape)?);
            meter.go_on().map_err(|cancelled| DeviceFrameError::Host(cancelled.into()))
        })
    }

    /// Makes the pages of all bins, keeps the pages on the device, and returns their descriptions;
    /// `None` if the CPU has taken over, if the device shares the host's memory, if the pages do
    /// not fit, or if a bin is too large for a batch.
    pub(super) fn indicate_on_device(
        &self,
        state: &mut DeviceState,
        bins: &Bins,
        rule: &PageRule,
        meter: &Meter<'_>,
    ) -> Result<Option<Vec<PageInfo>>, DeviceFrameError> {
        let (keys, shape) = (bins.keys(), rule.shape());
        let room = state.batch_bytes.min(self.device.limits().storage_range);
        if state.on_cpu
            || self.device.shares_host_memory()
            || (0..keys.len()).any(|bin| bin_bytes(bins.count(bin), shape) > room)
        {
            return Ok(None);
        }
        self.make_resident(state, keys, shape);
        let Some(resident) = self.resident(0) else { return Ok(None) };
        let settings = BatchSettings { rule, resident: Some(resident), read: ReadBack::FullCells };
        let mut infos = Vec::with_capacity(keys.len());
        self.make_bins(state, bins, 0..keys.len(), &settings, |lane, batch| {
            meter.add(batch.bins.len());
            infos.extend(read_infos(lane, &batch, keys)?);
            meter.go_on().map_err(|cancelled| DeviceFrameError::Host(cancelled.into()))
        })?;
        state.done.pages += infos.len();
        Ok(Some(infos))
    }

    /// Makes the pages of a range of bins, and passes them to `finish` batch by batch.
    fn make_bins(
        &self,
        state: &mut DeviceState,
        bins: &Bins,
        range: Range<usize>,
        settings: &BatchSettings<'_>,
        finish: impl FnMut(&mut Lane, BinBatch) -> Result<(), DeviceFrameError>,
    ) -> Result<(), DeviceFrameError> {
        let room = state.batch_bytes;
        self.make_lanes(state)?;
        let mut next = range.start;
        run_batches(
            &mut state.lanes,
            |lane| {
                let batch = bin_batch(bins, next..range.end, settings.rule.shape(), room);
                next = batch.end;
                let start = || self.start_bins(lane, bins, batch.clone(), settings);
                (!batch.is_empty()).then(start).transpose()
            },
            |_, _| Ok(()),
            finish,
        )
    }

    fn start_bins(
        &self,
        lane: &mut Lane,
        bins: &Bins,
        range: Range<usize>,
        settings: &BatchSettings<'_>,
    ) -> Result<BinBatch, DeviceFrameError> {
        let mut entries = Vec::with_capacity(range.len());
        let mut first = 0;
        for bin in range.clone() {
            let count = bins.count(bin) as u32;
            entries.push(BinEntry { first, count, coord: bins.keys()[bin].coord().to_array() });
            first += count;
        }
        let mut layout = BufferLayout::default();
        let entries_at = layout.place(size_of_val(&entries[..]) as u64);
        let records_at = layout.place(8 * u64::from(first));
        lane.begin()?;
        let device = &self.device;
        let staged = lane.buffer(device, "staged", BufferKind::Upload, layout.bytes)?;
        let inputs = lane.buffer(device, "inputs", BufferKind::Device, layout.bytes)?;
        // SAFETY: `begin` waited for the lane's earlier work, and only this lane uses the staging
        // buffer.
        unsafe { staged.write(entries_at.start, &entries) };
        range.clone().into_par_iter().zip(&entries).try_for_each(|(bin, entry)| {
            let contents = bins.contents(bin).map_err(DeviceFrameError::Host)?;
            // SAFETY: only this lane, whose earlier work has finished, uses the staging buffer. The
            // records of the bins do not overlap.
            unsafe {
                staged.write(records_at.start + 8 * u64::from(entry.first), contents.packed())
            };
            Ok::<_, DeviceFrameError>(())
        })?;

        lane.send(&staged, &inputs)?;
        let [entries, records] = [part(&inputs, &entries_at), part(&inputs, &records_at)];
        Ok(self.compute_bins(lane, range, &entries, &records, settings)?)
    }

    /// Records and submits the computation of the pages of `bins`. If only the masks of full cells
    /// are read back, also records their download.
    fn compute_bins(
        &self,
        lane: &mut Lane,
        bins: Range<usize>,
        entries: &View,
        records: &View,
        settings: &BatchSettings<'_>,
    ) -> Result<BinBatch, VulkanError> {
        let BatchSettings { rule, resident, read } = settings;
        let (device, pipelines, shape) = (&self.device, &self.pipelines, rule.shape());
        let page_bytes = page_bytes(shape);
        let bytes = bins.len() as u64 * page_bytes;
        let pages = match resident {
            Some(resident) => resident.pages.part(bins.start as u64 * page_bytes, bytes),
            None => lane.buffer(device, "pages", BufferKind::Device, bytes)?,
        };
        lane.compute.stage("indicate", records.bytes() + bytes);
        let (views, count) = ([entries, records, &pages], bins.len() as u32);
        indicate(&mut lane.compute, &pipelines.indicate, count, rule, views)?;
        let read = match read {
            ReadBack::Pages => lane.buffer(device, "pages read", BufferKind::Download, bytes)?,
            ReadBack::FullCells => self.find_full_cells(lane, &pages, bins.len(), shape)?,
        };
        lane.compute.submit(lane.upload.last())?;
        Ok(BinBatch { bins, pages, read })
    }

    /// Records the search for the full cells of `pages`, and the download of the found cells.
    pub(super) fn find_full_cells(
        &self,
        lane: &mut Lane,
        pages: &View,
        count: usize,
        shape: PageShape,
    ) -> Result<View, VulkanError> {
        let bytes = (count * size_of::<DeviceFullCells>()) as u64;
        let found = lane.buffer(&self.device, "full cells", BufferKind::Device, bytes)?;
        let read = lane.buffer(&self.device, "full cells read", BufferKind::Download, bytes)?;
        lane.compute.stage("full cells", pages.bytes());
        full_cells(
            &mut lane.compute,
            &self.pipelines.full_cells,
            count as u32,
            shape,
            [pages, &found],
        )?;
        lane.compute.copy(&found, &read);
        Ok(read)
    }

    /// Makes the pages of particles that are already binned on the device. If the pages stay on the
    /// device, returns only their descriptions.
    pub(super) fn indicate_resident(
        &self,
        state: &mut DeviceState,
        bins: &DeviceBins,
        rule: &PageRule,
    ) -> Result<PlacedPages, VulkanError> {
        let shape = rule.shape();
        self.make_resident(state, &bins.keys, shape);
        self.make_lanes(state)?;
        let resident = self.resident(0);
        let stays = resident.is_some() && !self.device.shares_host_memory();
        let read = if stays { ReadBack::FullCells } else { ReadBack::Pages };
        let settings = BatchSettings { rule, resident, read };
        let most = BIN_BATCH.min((state.batch_bytes / (2 * page_bytes(shape))) as usize).max(1);
        let mut batches = bins.runs.iter().flat_map(|(run, records)| {
            bins.parts(run.clone(), most, PARTICLE_BATCH)
                .map(move |part| (part, run.start, records))
        });
        let (mut pages, mut infos) = (Pages::new(), Vec::new());
        run_batches(
            &mut state.lanes,
            |lane| {
                let Some((range, run, records)) = batches.next() else { return Ok(None) };
                let base = bins.first[run];
                let entry = |bin: usize| BinEntry {
                    first: (bins.first[bin] - base) as u32,
                    count: (bins.first[bin + 1] - bins.first[bin]) as u32,
                    coord: bins.keys[bin].coord().to_array(),
                };
                let entries: Vec<BinEntry> = range.clone().map(entry).collect();
                lane.begin()?;
                let bytes = size_of_val(&entries[..]) as u64;
                let staged = lane.buffer(&self.device, "staged", BufferKind::Upload, bytes)?;
                let inputs = lane.buffer(&self.device, "inputs", BufferKind::Device, bytes)?;
                // SAFETY: `begin` waited for the lane's earlier work, and only this lane uses the
                // staging buffer.
                unsafe { staged.write(0, &entries) };
                lane.send(&staged, &inputs)?;
                let records = records.whole();
                self.compute_bins(lane, range, &inputs, &records, &settings).map(Some)
            },
            |_, _| Ok(()),
            |lane, batch| {
                match read {
                    ReadBack::Pages => pages.extend(read_pages(lane, batch, &bins.keys, shape)?),
                    ReadBack::FullCells => infos.extend(read_infos(lane, &batch, &bins.keys)?),
                }
                Ok::<_, VulkanError>(())
            },
        )?;
        Ok(if read == ReadBack::Pages {
            PlacedPages::Host(pages)
        } else {
            PlacedPages::Device(infos)
        })
    }
}

/// Pages on the host or on the device.
pub(super) enum PlacedPages {
    /// On the host.
    Host(Pages),
    /// On the device.
    Device(Vec<PageInfo>),
}

/// Waits for a batch, and reads the descriptions of its pages.
fn read_infos(
    lane: &mut Lane,
    batch: &BinBatch,
    keys: &[MortonKey],
) -> Result<Vec<PageInfo>, VulkanError> {
    lane.compute.wait()?;
    // SAFETY: the batch that writes the buffer has finished, and the lane has not begun another
    // batch.
    let found: Vec<DeviceFullCells> = unsafe { batch.read.read(0, batch.bins.len()) };
    let keys = &keys[batch.bins.clone()];
    Ok(found
        .iter()
        .zip(keys)
        .map(|(found, &key)| found.info(key).expect("a bin holds particles"))
        .collect())
}

/// Waits for a batch, and downloads its pages.
fn read_pages(
    lane: &mut Lane,
    batch: BinBatch,
    keys: &[MortonKey],
    shape: PageShape,
) -> Result<Pages, VulkanError> {
    // The download is submitted only now, because an earlier submission could have delayed the
    // upload of the next batch, which uses the same queue.
    lane.download.stage("download", 2 * batch.pages.bytes());
    lane.download.copy(&batch.pages, &batch.read);
    lane.download.submit(lane.compute.last())?;
    lane.download.wait()?;
    let stride = page_bytes(shape) as usize / size_of::<u16>();
    // SAFETY: the batch that writes the buffer has finished, and the lane begins no other batch
    // before the samples are copied.
    let samples: &[u16] = unsafe { batch.read.values(0, batch.bins.len() * stride) };
    let page = |(samples, bin): (&[u16], usize)| {
        let dense = &samples[..shape.bin_samples()];
        PageInfo::from_dense(keys[bin].coord(), dense, shape).expect("a bin holds particles")
    };
    Ok(samples.par_chunks_exact(stride).zip(batch.bins).map(page).collect())
}

/// Bytes of a bin with `count` particles, on the device and in the staging buffer.
pub(super) fn bin_bytes(count: usize, shape: PageShape) -> u64 {
    2 * (8 * count as u64 + page_bytes(shape))
}

/// Returns the first bins of `range` that fit into a batch: at least one bin, if there are any.
fn bin_batch(bins: &Bins, range: Range<usize>, shape: PageShape, room: u64) -> Range<usize> {
    let mut bytes = 0;
    let mut end = range.start;
    let mut particles = 0;
    while end < range.end && end - range.start < BIN_BATCH {
        bytes += bin_bytes(bins.count(end), shape);
        particles += bins.count(end);
        if end > range.start && (bytes > room || particles > PARTICLE_BATCH) {
            break;
        }
        end += 1;
    }
    range.start..end
}
