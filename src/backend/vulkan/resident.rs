//! The pages of a field on a device, and their downloads.

use std::sync::{Arc, Mutex, PoisonError};

use glam::IVec3;
use hashbrown::HashMap;

use crate::brick::{PageInfo, PageSamples, PageShape};
use crate::vulkan::{Batch, Buffer, BufferKind, Device, Queue, VulkanError};

use super::pipelines::page_bytes;

/// The pages of a field's bins in one buffer.
#[derive(Debug)]
pub(super) struct ResidentPages {
    pub(super) pages: Arc<Buffer>,
    pub(super) numbers: HashMap<IVec3, u32>,
}

/// Reads pages for one caller at a time, independently of the lanes.
#[derive(Debug, Default)]
pub(super) struct PageReader {
    batch: Mutex<Option<(Batch, Arc<Buffer>)>>,
    /// The error that ended the downloads.
    failed: Mutex<Option<VulkanError>>,
}

impl PageReader {
    /// Returns the error that ended the downloads, if there was one.
    pub(super) fn failed(&self) -> Option<VulkanError> {
        self.failed.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Reads the samples of a field's pages `infos`; returns `None` if a download fails or has
    /// failed before.
    pub(super) fn read(
        &self,
        device: &Device,
        resident: &ResidentPages,
        infos: &[PageInfo],
        shape: PageShape,
    ) -> Option<Vec<PageSamples>> {
        if self.failed().is_some() {
            return None;
        }
        let read = self.try_read(device, resident, infos, shape);
        let failed =
            |error| *self.failed.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
        read.map_err(failed).ok()
    }

    fn try_read(
        &self,
        device: &Device,
        resident: &ResidentPages,
        infos: &[PageInfo],
        shape: PageShape,
    ) -> Result<Vec<PageSamples>, VulkanError> {
        let page_bytes = page_bytes(shape);
        let bytes = infos.len() as u64 * page_bytes;
        let mut known = self.batch.lock().unwrap_or_else(PoisonError::into_inner);
        if known.as_ref().is_none_or(|(_, buffer)| buffer.bytes() < bytes) {
            *known = None;
        }
        let (batch, buffer) = match &mut *known {
            Some(known) => known,
            none => none.insert((
                device.batch(Queue::Compute)?,
                device.buffer(BufferKind::Download, bytes)?,
            )),
        };
        let number = |info: &PageInfo| resident.numbers[&info.key.coord()];
        batch.begin()?;
        batch.stage("download", 2 * bytes);
        let mut to = 0;
        // One command copies all pages that are consecutive in the buffer.
        for run in infos.chunk_by(|a, b| number(a) + 1 == number(b)) {
            let bytes = run.len() as u64 * page_bytes;
            let from = resident.pages.part(u64::from(number(&run[0])) * page_bytes, bytes);
            batch.copy(&from, &buffer.part(to, bytes));
            to += bytes;
        }
        // The copy is submitted to the queue on which the pages were made, so it runs after the
        // pages are complete.
        batch.submit(&[])?;
        batch.wait()?;
        let stride = page_bytes as usize / size_of::<u16>();
        // SAFETY: the only batch that writes the buffer has finished, and cannot begin again while
        // this lock is held.
        let samples: &[u16] = unsafe { buffer.values(0, infos.len() * stride) };
        let pages = samples.chunks_exact(stride).zip(infos).map(|(samples, info)| {
            let dense = &samples[..shape.bin_samples()];
            let (known, samples) = PageInfo::from_dense(info.key.coord(), dense, shape)
                .expect("a page has a full cell");
            debug_assert_eq!(known, *info);
            samples
        });
        Ok(pages.collect())
    }
}
