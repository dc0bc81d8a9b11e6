//! Fields that stay on the device: the operations on them, and the downloads to the host.

use std::ops::Range;
use std::sync::Arc;

use bytemuck::Pod;
use glam::IVec3;

use crate::brick::vulkan::{DeviceBlocks, DeviceFullCells, gather, halve};
use crate::brick::{
    Bins, DifField, Factor, HALVED, PageInfo, PageSamples, PageShape, PageSource, RemotePages,
    halved_from,
};
use crate::field::distance::vulkan::{full_bricks, full_bricks_of};
use crate::field::indicator::{PageRule, indicate};
use crate::grid::{CellBox, Mirror, MortonKey};
use crate::vulkan::{BufferKind, View, VulkanError};

use super::frame::{DeviceFrame, DeviceState};
use super::grids::{LevelBlocks, NO_TILES, SampleSource};
use super::lane::{BufferLayout, Lane, run_batches};
use super::pipelines::page_bytes;
use super::resident::ResidentPages;

/// Maximum number of blocks in a batch.
const BLOCK_BATCH: usize = 4096;

/// A field whose pages are on a device.
#[derive(Debug)]
struct DeviceField {
    frame: Arc<DeviceFrame>,
    /// The number of times that the width of the field's cells was doubled.
    level: usize,
    infos: Vec<PageInfo>,
    shape: PageShape,
}

/// The pages of bins, recomputed on the CPU.
#[derive(Debug)]
struct RebuiltPages {
    bins: Arc<Bins>,
    rule: PageRule,
}

impl PageSource for RebuiltPages {
    fn samples(&self, page: usize) -> Vec<u16> {
        let pages = indicate(&self.bins, page..page + 1, &self.rule);
        let pages = pages.expect("particles in memory can be read");
        pages[0].1.dense(self.rule.shape()).into_owned()
    }
}

/// Pages that cannot be recomputed.
#[derive(Debug)]
struct UnrecoverablePages(PageShape);

impl PageSource for UnrecoverablePages {
    /// Returns zeros. The zeros are not used, because the frame returns the error of the device.
    fn samples(&self, _: usize) -> Vec<u16> {
        vec![0; self.0.bin_samples()]
    }
}

/// Makes the field of a frame's bins. If a download fails, the CPU recomputes the pages from
/// `bins`.
pub(super) fn of_bins(
    frame: &Arc<DeviceFrame>,
    infos: Vec<PageInfo>,
    bins: &Arc<Bins>,
    rule: &PageRule,
) -> DifField {
    let rebuilt = RebuiltPages { bins: Arc::clone(bins), rule: *rule };
    field(frame, infos, rule.shape(), Box::new(rebuilt))
}

/// Makes the field of particles that exist only on the device.
pub(super) fn of_resident(
    frame: &Arc<DeviceFrame>,
    infos: Vec<PageInfo>,
    shape: PageShape,
) -> DifField {
    field(frame, infos, shape, Box::new(UnrecoverablePages(shape)))
}

fn field(
    frame: &Arc<DeviceFrame>,
    infos: Vec<PageInfo>,
    shape: PageShape,
    fallback: Box<dyn PageSource>,
) -> DifField {
    let pages = DeviceField { frame: Arc::clone(frame), level: 0, infos: infos.clone(), shape };
    DifField::from_remote(shape, infos, Box::new(pages), fallback)
}

impl DeviceField {
    /// Runs an operation on the field's pages; returns `None` if the pages are no longer on the
    /// device, if a download failed before, or if the operation fails or returns `None`.
    fn with_pages<T>(
        &self,
        operation: impl FnOnce(&mut DeviceState, &ResidentPages) -> Result<Option<T>, VulkanError>,
    ) -> Option<T> {
        let resident =
            self.frame.resident(self.level).filter(|_| self.frame.reader.failed().is_none())?;
        let mut state = self.frame.state();
        let result = operation(&mut state, &resident);
        result.map_err(|error| self.frame.recover(&mut state, &error)).ok().flatten()
    }
}

impl RemotePages for DeviceField {
    fn count(&self) -> usize {
        self.infos.len()
    }

    fn samples(&self, pages: Range<usize>) -> Option<Vec<PageSamples>> {
        let resident = self.frame.resident(self.level)?;
        self.frame.reader.read(&self.frame.device, &resident, &self.infos[pages], self.shape)
    }

    fn halved(
        &self,
        bins: &[IVec3],
        mirror: Option<Mirror>,
        factor: Factor,
    ) -> Option<(Vec<PageInfo>, Box<dyn RemotePages>)> {
        let infos = self.with_pages(|state, resident| {
            let stride = page_bytes(HALVED);
            let Some(pages) =
                self.frame.page_buffer(state, bins.len() as u64 * stride, state.wide_bytes)
            else {
                return Ok(None);
            };
            let boxes: Vec<CellBox> = bins.iter().map(|&bin| halved_from(bin, mirror)).collect();
            let from = SampleSource::Resident(resident, self.shape);
            let pipeline = &self.frame.pipelines.halve;
            let found: Vec<DeviceFullCells> =
                self.frame.run_on_boxes(state, from, &boxes, |lane, range, blocks, cells| {
                    let count = range.len();
                    let pages = pages.part(range.start as u64 * stride, count as u64 * stride);
                    lane.compute.stage("halve", cells.bytes() + pages.bytes());
                    halve(&mut lane.compute, pipeline, blocks, (mirror, factor), [cells, &pages])?;
                    self.frame.find_full_cells(lane, &pages, count, HALVED)
                })?;
            let infos = bins.iter().zip(found).map(|(&bin, found)| found.info(MortonKey::of(bin)));
            let infos: Vec<PageInfo> = infos.flatten().collect();
            state.wide_bytes -= pages.bytes().min(state.wide_bytes);
            let numbers = bins.iter().copied().zip(0..).collect();
            self.frame.add_resident(self.level + 1, ResidentPages { pages, numbers });
            Ok(Some(infos))
        })?;
        let frame = Arc::clone(&self.frame);
        let wide = Self { frame, level: self.level + 1, infos: infos.clone(), shape: HALVED };
        Some((infos, Box::new(wide)))
    }

    fn full_bricks(&self, width: u32, least: u32) -> Option<Vec<u64>> {
        let boxes = self.infos.iter().map(|info| full_bricks_of(info.key.coord(), width));
        let boxes: Vec<CellBox> = boxes.collect::<Option<_>>()?;
        self.with_pages(|state, resident| {
            let from = SampleSource::Resident(resident, self.shape);
            let (device, pipelines) = (&self.frame.device, &self.frame.pipelines.distance);
            let full: Vec<[u32; 2]> =
                self.frame.run_on_boxes(state, from, &boxes, |lane, range, blocks, cells| {
                    let bytes = (range.len() * size_of::<[u32; 2]>()) as u64;
                    let bricks = lane.buffer(device, "full bricks", BufferKind::Device, bytes)?;
                    let read =
                        lane.buffer(device, "full bricks read", BufferKind::Download, bytes)?;
                    lane.compute.stage("inside", cells.bytes());
                    full_bricks(
                        &mut lane.compute,
                        pipelines,
                        blocks,
                        (width, least),
                        [cells, &bricks],
                    )?;
                    lane.compute.copy(&bricks, &read);
                    Ok(read)
                })?;
            Ok(Some(
                full.iter().map(|&[low, high]| u64::from(low) | u64::from(high) << 32).collect(),
            ))
        })
    }
}

impl DeviceFrame {
    /// Gathers `boxes` of cells from a field, in batches. Calls `run` for each batch, and collects
    /// the values from the buffers that `run` returns.
    fn run_on_boxes<T: Pod>(
        &self,
        state: &mut DeviceState,
        from: SampleSource<'_>,
        boxes: &[CellBox],
        run: impl Fn(&mut Lane, Range<usize>, &DeviceBlocks, &View) -> Result<View, VulkanError>,
    ) -> Result<Vec<T>, VulkanError> {
        self.make_lanes(state)?;
        let most = state.batch_bytes.min(self.device.limits().storage_range);
        let (mut next, mut all) = (0, Vec::with_capacity(boxes.len()));
        run_batches(
            &mut state.lanes,
            |lane| {
                let begin = next;
                let mut grid = LevelBlocks::default();
                while next < boxes.len()
                    && grid.len() < BLOCK_BATCH
                    && grid.field_bytes() < most / 2
                {
                    grid.push_sampled(boxes[next], NO_TILES, from, None);
                    next += 1;
                }
                if grid.len() == 0 {
                    return Ok(None);
                }
                let mut layout = BufferLayout::default();
                let places = grid.place(&mut layout, page_bytes(from.shape()));
                lane.begin()?;
                let staged =
                    lane.buffer(&self.device, "staged", BufferKind::Upload, layout.bytes)?;
                let inputs =
                    lane.buffer(&self.device, "inputs", BufferKind::Device, layout.bytes)?;
                let cells =
                    lane.buffer(&self.device, "cells", BufferKind::Device, grid.field_bytes())?;
                // SAFETY: `begin` waited for the lane's earlier work, and only this lane uses the
                // staging buffer.
                unsafe { grid.stage(&staged, &places, from) };
                let uploaded = lane.send(&staged, &inputs)?;
                let (blocks, pages) =
                    (grid.on_device(&inputs, &places), places.pages(&inputs, from, None));
                lane.compute.stage("gather", pages.pages.bytes() + cells.bytes());
                gather(&mut lane.compute, &self.pipelines.gather, &blocks, &pages, &cells)?;
                let read = run(lane, begin..next, &blocks, &cells)?;
                lane.compute.submit(&[uploaded])?;
                Ok(Some((next - begin, read)))
            },
            |_, _| Ok(()),
            |lane, (count, read)| {
                lane.compute.wait()?;
                // SAFETY: the batch that writes the buffer has finished, and the lane has not begun
                // another batch.
                all.extend(unsafe { read.read::<T>(0, count) });
                Ok(())
            },
        )?;
        Ok(all)
    }
}
