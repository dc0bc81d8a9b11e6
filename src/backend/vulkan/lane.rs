//! Lanes: the commands and buffers of a batch, and the loop that keeps two lanes in flight.

use std::collections::VecDeque;
use std::ops::Range;
use std::sync::Arc;

use hashbrown::HashMap;

use crate::vulkan::{
    ALIGNMENT, Batch, Buffer, BufferKind, Device, Queue, Ticket, View, VulkanError,
};

/// Buffers are larger than requested by a fraction of 1 / `HEADROOM`, because the next batch may
/// need slightly larger buffers.
pub(super) const HEADROOM: u64 = 4;

/// The command batches and the buffers for one batch of work. The next batch of work reuses them.
#[derive(Debug)]
pub(super) struct Lane {
    pub(super) upload: Batch,
    pub(super) compute: Batch,
    pub(super) download: Batch,
    buffers: HashMap<Name, Arc<Buffer>>,
}

/// The name of a lane's buffer, and a number that distinguishes fields of the same name.
type Name = (&'static str, usize);

impl Lane {
    pub(super) fn new(device: &Device) -> Result<Self, VulkanError> {
        Ok(Self {
            upload: device.batch(Queue::Transfer)?,
            compute: device.batch(Queue::Compute)?,
            download: device.batch(Queue::Transfer)?,
            buffers: HashMap::new(),
        })
    }

    /// A view of the first `bytes` bytes of this lane's buffer `name`, which grows if it is too
    /// small. The content of the returned buffer is undefined.
    pub(super) fn buffer(
        &mut self,
        device: &Device,
        name: &'static str,
        kind: BufferKind,
        bytes: u64,
    ) -> Result<View, VulkanError> {
        self.numbered((name, 0), device, kind, bytes)
    }

    /// Returns buffers for `count` fields of the same kind, each `bytes` bytes long.
    pub(super) fn fields(
        &mut self,
        device: &Device,
        name: &'static str,
        count: usize,
        bytes: u64,
    ) -> Result<Vec<View>, VulkanError> {
        (0..count)
            .map(|number| self.numbered((name, number), device, BufferKind::Device, bytes))
            .collect()
    }

    fn numbered(
        &mut self,
        name: Name,
        device: &Device,
        kind: BufferKind,
        bytes: u64,
    ) -> Result<View, VulkanError> {
        let bytes = bytes.next_multiple_of(4).max(4);
        if self.buffers.get(&name).is_none_or(|buffer| buffer.bytes() < bytes) {
            self.buffers.remove(&name);
            let with_headroom =
                (bytes + bytes / HEADROOM).min(device.limits().allocation).max(bytes);
            self.buffers.insert(name, device.buffer(kind, with_headroom)?);
        }
        Ok(self.buffers[&name].part(0, bytes))
    }

    /// A view of the first `bytes` bytes of an existing buffer of this lane.
    pub(super) fn existing(&self, name: &'static str, bytes: u64) -> View {
        self.buffers[&(name, 0)].part(0, bytes)
    }

    /// Uploads the staged data.
    pub(super) fn send(&mut self, staged: &View, inputs: &View) -> Result<Ticket, VulkanError> {
        self.upload.stage("upload", 2 * staged.bytes());
        self.upload.copy(staged, inputs);
        self.upload.submit(&[])
    }

    /// Bytes of all buffers of the lane.
    pub(super) fn bytes(&self) -> u64 {
        self.buffers.values().map(|buffer| buffer.bytes()).sum()
    }

    /// Waits until the lane's last batch has finished, and starts a new batch.
    pub(super) fn begin(&mut self) -> Result<(), VulkanError> {
        self.upload.begin()?;
        self.compute.begin()?;
        self.download.begin()
    }
}

/// Assigns consecutive ranges of a buffer.
#[derive(Debug, Default)]
pub(super) struct BufferLayout {
    pub(super) bytes: u64,
}

impl BufferLayout {
    /// Reserves `bytes` bytes, but at least one word, and returns their range.
    pub(super) fn place(&mut self, bytes: u64) -> Range<u64> {
        let begin = self.bytes;
        self.bytes = (begin + bytes.max(4)).next_multiple_of(ALIGNMENT);
        begin..begin + bytes.max(4)
    }
}

pub(super) fn part(view: &View, range: &Range<u64>) -> View {
    view.part(range.start, range.end - range.start)
}

/// Keeps all lanes busy. `start` starts the next batch on an idle lane; `None` means that there are
/// no more batches. `go_on` starts the second part of a batch, if the batch has one. `finish` waits
/// for a batch, and takes its results. `go_on` and `finish` receive the batches in the order in
/// which they were started.
pub(super) fn run_batches<T, E>(
    lanes: &mut [Lane],
    mut start: impl FnMut(&mut Lane) -> Result<Option<T>, E>,
    mut go_on: impl FnMut(&mut Lane, &mut T) -> Result<(), E>,
    mut finish: impl FnMut(&mut Lane, T) -> Result<(), E>,
) -> Result<(), E> {
    let mut idle: Vec<usize> = (0..lanes.len()).collect();
    let (mut started, mut continued) = (VecDeque::new(), VecDeque::new());
    loop {
        if let Some(&number) = idle.last()
            && let Some(batch) = start(&mut lanes[number])?
        {
            idle.pop();
            started.push_back((number, batch));
        } else if let Some((number, mut batch)) = started.pop_front() {
            go_on(&mut lanes[number], &mut batch)?;
            continued.push_back((number, batch));
        } else if let Some((number, batch)) = continued.pop_front() {
            finish(&mut lanes[number], batch)?;
            idle.push(number);
        } else {
            return Ok(());
        }
    }
}
