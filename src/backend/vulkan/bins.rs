//! Bins to pages.

use std::ops::Range;
use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;

use crate::backend::Pages;
use crate::brick::vulkan::PAGE_WORDS;
use crate::brick::{Bins, BrickSide, PageInfo};
use crate::stage::indicator::Indicator;
use crate::stage::indicator::vulkan::indicate;
use crate::vulkan::{Buffer, Place, View};

use super::lane::{Lane, Layout, fly, part};
use super::{BATCH, DeviceFrame, Fault, PAGE_BYTES, State};

/// Samples of a page.
const SAMPLES: usize = 2 * PAGE_WORDS as usize;

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
    /// Adds the pages of a range of bins to `done`, as far as nothing fails.
    pub(super) fn indicate_batches(
        &self,
        state: &mut State,
        bins: &Bins,
        range: Range<usize>,
        indicator: Indicator,
        side: BrickSide,
        done: &mut Pages,
    ) -> Result<(), Fault> {
        state.make_resident(&self.device, bins.keys());
        let room = state.batch_bytes;
        let resident = state.resident.as_ref().map(|resident| Arc::clone(&resident.pages));
        state.make_lanes(&self.device)?;
        let mut next = range.start;
        fly(
            &mut state.lanes,
            |lane| {
                let batch = bin_batch(bins, next..range.end, room);
                next = batch.end;
                let start = || self.start_bins(lane, bins, batch.clone(), indicator, resident.as_ref());
                (!batch.is_empty()).then(start).transpose()
            },
            |lane, batch| {
                lane.download.wait()?;
                let samples: Vec<u16> = batch.pages.read(0, batch.bins.len() * SAMPLES);
                done.par_extend(samples.par_chunks_exact(SAMPLES).zip(batch.bins).map(|(dense, bin)| {
                    let page = PageInfo::from_dense(bins.keys()[bin].coord(), dense, side);
                    page.expect("a bin holds particles")
                }));
                Ok(())
            },
        )
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

        let uploaded = lane.send(&staged, &inputs)?;
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
