//! Batches: commands that run in order on one queue, while the host continues.

use std::fmt;
use std::sync::Arc;
use std::sync::PoisonError;
use std::sync::atomic::Ordering;

use ash::vk;
use bytemuck::Pod;

use super::device::{QueueState, SharedDevice};
use super::{
    Buffer, BufferKind, ComputePipeline, Device, Faults, MOST_BUFFERS, Queue, View, VulkanError,
};

/// Maximum number of dispatches in a batch.
const DISPATCHES: u32 = 128;
/// Maximum number of timed stages in a batch.
const STAGES: u32 = 32;

/// A point in the work of a queue: the end of a submitted batch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ticket {
    queue: Queue,
    value: u64,
}

/// A semaphore of the caller and, for a timeline semaphore, the value to wait for or to signal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SemaphorePoint {
    /// The semaphore, which must have been created on the same device.
    pub semaphore: vk::Semaphore,
    /// The value of a timeline semaphore; ignored for a binary semaphore.
    pub value: u64,
}

/// Commands that are recorded, submitted and waited for together. A batch can be reused.
///
/// Every command sees the results of all earlier commands. The batch holds the resources of its
/// commands until the commands have finished.
pub struct Batch {
    device: Arc<SharedDevice>,
    queue: Queue,
    pool: vk::CommandPool,
    commands: vk::CommandBuffer,
    sets: vk::DescriptorPool,
    /// Null if the queue does not support timestamps.
    queries: vk::QueryPool,
    /// At the end of a submission, the device writes the submission's number here. The host checks
    /// this number, to detect a lost device whose calls still report success.
    stamp: Arc<Buffer>,
    buffers: Vec<Arc<Buffer>>,
    pipelines: Vec<Arc<ComputePipeline>>,
    /// The stages, each with the minimum number of bytes that it reads and writes.
    stages: Vec<(&'static str, u64)>,
    /// The last submission.
    last: Option<Ticket>,
    /// Whether the last submission may still be running.
    pending: bool,
}

impl Device {
    /// Creates an empty batch for a queue.
    ///
    /// # Errors
    /// [`VulkanError`] if there is no memory for the batch.
    pub fn batch(&self, queue: Queue) -> Result<Batch, VulkanError> {
        let shared = &self.shared;
        let QueueState { family, timestamps, .. } = *shared.queue(queue);
        // From here on, dropping `batch` frees everything if a later step fails.
        let mut batch = Batch {
            device: Arc::clone(shared),
            queue,
            pool: vk::CommandPool::null(),
            commands: vk::CommandBuffer::null(),
            sets: vk::DescriptorPool::null(),
            queries: vk::QueryPool::null(),
            stamp: self.buffer(BufferKind::Download, 4)?,
            buffers: Vec::new(),
            pipelines: Vec::new(),
            stages: Vec::new(),
            last: None,
            pending: false,
        };
        // SAFETY: the device is alive, and all pointers outlive the calls.
        unsafe {
            batch.pool = shared
                .raw
                .create_command_pool(
                    &vk::CommandPoolCreateInfo::default().queue_family_index(family),
                    None,
                )
                .map_err(shared.call_error("vkCreateCommandPool"))?;
            let info = vk::CommandBufferAllocateInfo::default()
                .command_pool(batch.pool)
                .command_buffer_count(1);
            batch.commands = shared
                .raw
                .allocate_command_buffers(&info)
                .map_err(shared.call_error("vkAllocateCommandBuffers"))?[0];
            let sizes = [vk::DescriptorPoolSize {
                ty: vk::DescriptorType::STORAGE_BUFFER,
                descriptor_count: MOST_BUFFERS * DISPATCHES,
            }];
            let info =
                vk::DescriptorPoolCreateInfo::default().max_sets(DISPATCHES).pool_sizes(&sizes);
            batch.sets = shared
                .raw
                .create_descriptor_pool(&info, None)
                .map_err(shared.call_error("vkCreateDescriptorPool"))?;
            if timestamps {
                let info = vk::QueryPoolCreateInfo::default()
                    .query_type(vk::QueryType::TIMESTAMP)
                    .query_count(STAGES + 1);
                batch.queries = shared
                    .raw
                    .create_query_pool(&info, None)
                    .map_err(shared.call_error("vkCreateQueryPool"))?;
            }
        }
        Ok(batch)
    }
}

impl Batch {
    /// Waits until the last submission has finished, and starts a new recording.
    ///
    /// # Errors
    /// [`VulkanError::Lost`] if the device is lost, and other errors if the driver fails.
    pub fn begin(&mut self) -> Result<(), VulkanError> {
        self.wait()?;
        let raw = &self.device.raw;
        // SAFETY: no resource of this batch is in use.
        unsafe {
            raw.reset_command_pool(self.pool, vk::CommandPoolResetFlags::empty())
                .map_err(self.device.call_error("vkResetCommandPool"))?;
            raw.reset_descriptor_pool(self.sets, vk::DescriptorPoolResetFlags::empty())
                .map_err(self.device.call_error("vkResetDescriptorPool"))?;
            let info = vk::CommandBufferBeginInfo::default()
                .flags(vk::CommandBufferUsageFlags::ONE_TIME_SUBMIT);
            raw.begin_command_buffer(self.commands, &info)
                .map_err(self.device.call_error("vkBeginCommandBuffer"))?;
            if self.queries != vk::QueryPool::null() {
                if self.device.queue(self.queue).host_reset {
                    raw.reset_query_pool(self.queries, 0, STAGES + 1);
                } else {
                    raw.cmd_reset_query_pool(self.commands, self.queries, 0, STAGES + 1);
                }
            }
        }
        Ok(())
    }

    /// Begins a stage, which ends at the next stage or at the end of the batch.
    /// [`Device::take_timings`] reports the stage's duration under `name`. The commands of the
    /// stage read and write at least `bytes` bytes.
    pub fn stage(&mut self, name: &'static str, bytes: u64) {
        self.timestamp();
        self.stages.push((name, bytes));
    }

    fn timestamp(&self) {
        if self.queries != vk::QueryPool::null() {
            let number = self.stages.len() as u32;
            assert!(number <= STAGES, "a batch can time at most {STAGES} stages");
            let after = vk::PipelineStageFlags::BOTTOM_OF_PIPE;
            // SAFETY: the commands are being recorded, and the query was reset.
            unsafe {
                self.device.raw.cmd_write_timestamp(self.commands, after, self.queries, number)
            };
        }
    }

    /// Runs a shader with `groups` work groups along each axis. `buffers` are in the order of the
    /// shader's bindings.
    ///
    /// # Errors
    /// [`VulkanError::OutOfMemory`] if a buffer is larger than the maximum storage range.
    ///
    /// # Panics
    /// If the arguments do not match the shader.
    pub fn dispatch(
        &mut self,
        pipeline: &Arc<ComputePipeline>,
        buffers: &[View],
        push: &impl Pod,
        groups: [u32; 3],
    ) -> Result<(), VulkanError> {
        let most = self.device.limits.groups;
        assert!(groups.iter().all(|&n| n <= most), "too many groups of {pipeline:?}: {groups:?}");
        if !groups.contains(&0) {
            self.bind(pipeline, buffers, bytemuck::bytes_of(push))?;
            let [x, y, z] = groups;
            // SAFETY: the commands are being recorded, and a shader is bound.
            unsafe { self.device.raw.cmd_dispatch(self.commands, x, y, z) };
        }
        Ok(())
    }

    /// Runs a shader like [`dispatch`](Self::dispatch), but the device reads the numbers of work
    /// groups along each axis from the three words of `groups`. The numbers must not exceed the
    /// device's limits.
    ///
    /// # Panics
    /// If the arguments do not match the shader, or if `groups` has fewer than three words.
    pub fn dispatch_as(
        &mut self,
        pipeline: &Arc<ComputePipeline>,
        buffers: &[View],
        push: &impl Pod,
        groups: &View,
    ) -> Result<(), VulkanError> {
        assert!(self.owns(groups), "the group counts of {pipeline:?} belong to another device");
        assert!(groups.bytes >= 12, "the group counts of {pipeline:?} need three words");
        self.bind(pipeline, buffers, bytemuck::bytes_of(push))?;
        // SAFETY: the commands are being recorded, and a shader is bound.
        unsafe {
            let raw = &self.device.raw;
            raw.cmd_dispatch_indirect(self.commands, groups.buffer.raw(), groups.offset);
        }
        self.buffers.push(Arc::clone(&groups.buffer));
        Ok(())
    }

    /// Records a barrier after the previous commands, and binds a shader and its buffers.
    fn bind(
        &mut self,
        pipeline: &Arc<ComputePipeline>,
        buffers: &[View],
        push: &[u8],
    ) -> Result<(), VulkanError> {
        let shader = pipeline.shader;
        assert_eq!(buffers.len(), shader.buffers.len(), "number of buffers of {pipeline:?}");
        assert_eq!(
            push.len(),
            shader.push_bytes as usize,
            "bytes of push constants of {pipeline:?}"
        );
        let limits = self.device.limits;
        assert!(
            Arc::ptr_eq(&pipeline.device, &self.device),
            "{pipeline:?} belongs to another device"
        );
        assert!(
            buffers.iter().all(|view| self.owns(view)),
            "a buffer of {pipeline:?} belongs to another device"
        );
        assert!(
            buffers.iter().all(|view| view.offset.is_multiple_of(limits.alignment)),
            "the offset of a buffer of {pipeline:?} is not aligned"
        );
        if let Some(view) = buffers.iter().find(|view| view.bytes > limits.storage_range) {
            return Err(VulkanError::OutOfMemory { bytes: view.bytes });
        }
        self.barrier();
        let set = [self.descriptor_set(pipeline, buffers)?];
        let raw = &self.device.raw;
        // SAFETY: the handles belong to this device, the commands are being recorded, and the batch
        // holds the buffers and the shader until the commands have finished.
        unsafe {
            let compute = vk::PipelineBindPoint::COMPUTE;
            raw.cmd_bind_pipeline(self.commands, compute, pipeline.pipeline);
            raw.cmd_bind_descriptor_sets(self.commands, compute, pipeline.layout, 0, &set, &[]);
            if !push.is_empty() {
                let stages = vk::ShaderStageFlags::COMPUTE;
                raw.cmd_push_constants(self.commands, pipeline.layout, stages, 0, push);
            }
        }
        self.buffers.extend(buffers.iter().map(|view| Arc::clone(&view.buffer)));
        self.pipelines.push(Arc::clone(pipeline));
        Ok(())
    }

    /// Returns a new descriptor set that binds `buffers` to a shader.
    fn descriptor_set(
        &self,
        pipeline: &ComputePipeline,
        buffers: &[View],
    ) -> Result<vk::DescriptorSet, VulkanError> {
        let raw = &self.device.raw;
        let layouts = [pipeline.sets];
        let info = vk::DescriptorSetAllocateInfo::default()
            .descriptor_pool(self.sets)
            .set_layouts(&layouts);
        // SAFETY: the pool and the layout belong to this device.
        let set = unsafe { raw.allocate_descriptor_sets(&info) }
            .map_err(self.device.call_error("vkAllocateDescriptorSets"))?[0];
        let info = |view: &View| {
            [vk::DescriptorBufferInfo {
                buffer: view.buffer.raw(),
                offset: view.offset,
                range: view.bytes,
            }]
        };
        let infos: Vec<_> = buffers.iter().map(info).collect();
        let writes: Vec<_> = (0..)
            .zip(&infos)
            .map(|(binding, info)| {
                vk::WriteDescriptorSet::default()
                    .dst_set(set)
                    .dst_binding(binding)
                    .descriptor_type(vk::DescriptorType::STORAGE_BUFFER)
                    .buffer_info(info)
            })
            .collect();
        // SAFETY: the set is new, and the buffers belong to this device.
        unsafe { raw.update_descriptor_sets(&writes, &[]) };
        Ok(set)
    }

    /// Copies all of `from` to the start of `to`.
    ///
    /// # Panics
    /// If `from` is larger than `to`, or if a buffer belongs to another device.
    pub fn copy(&mut self, from: &View, to: &View) {
        assert!(from.bytes <= to.bytes, "cannot copy {} bytes into {}", from.bytes, to.bytes);
        assert!(self.owns(from) && self.owns(to), "a buffer belongs to another device");
        if from.bytes == 0 {
            return;
        }
        self.barrier();
        let region =
            [vk::BufferCopy { src_offset: from.offset, dst_offset: to.offset, size: from.bytes }];
        // SAFETY: the commands are being recorded, and the batch holds both buffers until the
        // commands have finished.
        unsafe {
            self.device.raw.cmd_copy_buffer(
                self.commands,
                from.buffer.raw(),
                to.buffer.raw(),
                &region,
            );
        }
        self.buffers.extend([Arc::clone(&from.buffer), Arc::clone(&to.buffer)]);
    }

    /// Fills a part of a buffer with zeros.
    ///
    /// # Panics
    /// If the buffer belongs to another device.
    pub fn clear(&mut self, view: &View) {
        assert!(self.owns(view), "the buffer belongs to another device");
        if view.bytes == 0 {
            return;
        }
        self.barrier();
        // SAFETY: the commands are being recorded, and the batch holds the buffer until the
        // commands have finished.
        unsafe {
            let raw = &self.device.raw;
            raw.cmd_fill_buffer(self.commands, view.buffer.raw(), view.offset, view.bytes, 0);
        }
        self.buffers.push(Arc::clone(&view.buffer));
    }

    fn owns(&self, view: &View) -> bool {
        Arc::ptr_eq(&view.buffer.device, &self.device)
    }

    /// Makes the results of earlier commands visible to later commands.
    fn barrier(&self) {
        let stages = match self.queue {
            Queue::Compute => {
                let indirect = vk::PipelineStageFlags::DRAW_INDIRECT;
                vk::PipelineStageFlags::COMPUTE_SHADER | vk::PipelineStageFlags::TRANSFER | indirect
            }
            Queue::Transfer => vk::PipelineStageFlags::TRANSFER,
        };
        let transfer = vk::AccessFlags::TRANSFER_READ | vk::AccessFlags::TRANSFER_WRITE;
        let access = match self.queue {
            Queue::Compute => {
                let indirect = vk::AccessFlags::INDIRECT_COMMAND_READ;
                vk::AccessFlags::SHADER_READ | vk::AccessFlags::SHADER_WRITE | transfer | indirect
            }
            Queue::Transfer => transfer,
        };
        if !Faults::must_fail(&self.device.faults.barrier) {
            self.memory_barrier(stages, access, stages, access);
        }
    }

    fn memory_barrier(
        &self,
        from: vk::PipelineStageFlags,
        written: vk::AccessFlags,
        to: vk::PipelineStageFlags,
        read: vk::AccessFlags,
    ) {
        let barrier = [vk::MemoryBarrier::default().src_access_mask(written).dst_access_mask(read)];
        // SAFETY: the commands are being recorded.
        unsafe {
            let none = vk::DependencyFlags::empty();
            self.device.raw.cmd_pipeline_barrier(self.commands, from, to, none, &barrier, &[], &[]);
        }
    }

    /// Submits the commands to the queue, to run after the batches with the tickets `after`.
    ///
    /// # Errors
    /// [`VulkanError::Lost`] if the device is lost, and other errors if the driver fails.
    pub fn submit(&mut self, after: &[Ticket]) -> Result<Ticket, VulkanError> {
        // SAFETY: there are no semaphores.
        unsafe { self.submit_between(after, &[], &[]) }
    }

    /// Submits the commands like [`submit`](Self::submit), but the queue first waits for the
    /// semaphores in `wait`, and signals the semaphores in `signal` at the end. Later submissions
    /// to the same queue also wait for the semaphores in `wait`.
    ///
    /// # Errors
    /// [`VulkanError::Lost`] if the device is lost, and other errors if the driver fails. After an
    /// error, no semaphore is signalled.
    ///
    /// # Safety
    /// The semaphores must belong to the device, and must live until the submission has finished.
    /// The work that signals the semaphores in `wait` must already have been submitted.
    pub unsafe fn submit_between(
        &mut self,
        after: &[Ticket],
        wait: &[SemaphorePoint],
        signal: &[SemaphorePoint],
    ) -> Result<Ticket, VulkanError> {
        self.timestamp();
        if Faults::must_fail(&self.device.faults.submission) {
            self.device.lose();
        }
        self.device.check_alive()?;
        let raw = &self.device.raw;
        let state = self.device.queue(self.queue);
        // SAFETY: all handles belong to this device. The queue is locked, so the timeline's values
        // increase in the order of submission.
        unsafe {
            let queue = state.raw.lock().unwrap_or_else(PoisonError::into_inner);
            let value = state.last.load(Ordering::Relaxed) + 1;
            if !Faults::must_fail(&self.device.faults.completion) {
                self.barrier();
                raw.cmd_fill_buffer(self.commands, self.stamp.raw(), 0, 4, value as u32);
            }
            self.memory_barrier(
                vk::PipelineStageFlags::ALL_COMMANDS,
                vk::AccessFlags::MEMORY_WRITE,
                vk::PipelineStageFlags::HOST,
                vk::AccessFlags::HOST_READ,
            );
            raw.end_command_buffer(self.commands)
                .map_err(self.device.call_error("vkEndCommandBuffer"))?;
            let point = |ticket: &Ticket| SemaphorePoint {
                semaphore: self.device.queue(ticket.queue).timeline,
                value: ticket.value,
            };
            let own = SemaphorePoint { semaphore: state.timeline, value };
            let (waits, wait_values) = parts(after.iter().map(point).chain(wait.iter().copied()));
            let (signals, signal_values) =
                parts(std::iter::once(own).chain(signal.iter().copied()));
            let wait_stages = vec![vk::PipelineStageFlags::ALL_COMMANDS; waits.len()];
            let commands = [self.commands];
            let mut timeline = vk::TimelineSemaphoreSubmitInfo::default()
                .wait_semaphore_values(&wait_values)
                .signal_semaphore_values(&signal_values);
            let info = vk::SubmitInfo::default()
                .wait_semaphores(&waits)
                .wait_dst_stage_mask(&wait_stages)
                .command_buffers(&commands)
                .signal_semaphores(&signals)
                .push_next(&mut timeline);
            raw.queue_submit(*queue, &[info], vk::Fence::null())
                .map_err(self.device.call_error("vkQueueSubmit"))?;
            state.last.store(value, Ordering::Relaxed);
            self.device.counters.submissions.fetch_add(1, Ordering::Relaxed);
            let ticket = Ticket { queue: self.queue, value };
            (self.last, self.pending) = (Some(ticket), true);
            Ok(ticket)
        }
    }

    /// Waits until the last submission has finished, if there is one.
    ///
    /// # Errors
    /// [`VulkanError::Lost`] if the device is lost, and other errors if the driver fails.
    pub fn wait(&mut self) -> Result<(), VulkanError> {
        if let Some(ticket) = self.last.filter(|_| self.pending) {
            let timelines = [self.device.queue(ticket.queue).timeline];
            let values = [ticket.value];
            let info = vk::SemaphoreWaitInfo::default().semaphores(&timelines).values(&values);
            // SAFETY: the semaphore belongs to this device.
            unsafe { self.device.raw.wait_semaphores(&info, u64::MAX) }
                .map_err(self.device.call_error("vkWaitSemaphores"))?;
            self.pending = false;
            // SAFETY: the batch has finished, and no other batch writes its stamp.
            if unsafe { self.stamp.read::<u32>(0, 1) } != [ticket.value as u32] {
                return Err(self.device.lose());
            }
            self.record_times()?;
        }
        self.stages.clear();
        self.buffers.clear();
        self.pipelines.clear();
        Ok(())
    }

    /// Makes a new buffer on the device, and records a copy of `values` into it.
    pub fn store<T: Pod>(&mut self, values: &[T]) -> Result<View, VulkanError> {
        let device = Device { shared: Arc::clone(&self.device) };
        let staged = device.uploaded(values)?;
        let stored = device.buffer(BufferKind::Device, staged.bytes())?.whole();
        self.copy(&staged, &stored);
        Ok(stored)
    }

    /// The ticket of the last submission, if there is one, for batches that continue its work.
    pub fn last(&self) -> &[Ticket] {
        self.last.as_slice()
    }

    fn record_times(&self) -> Result<(), VulkanError> {
        if self.queries == vk::QueryPool::null() || self.stages.is_empty() {
            return Ok(());
        }
        let mut stamps = vec![0_u64; self.stages.len() + 1];
        // SAFETY: the batch has finished, so all its timestamps are available.
        unsafe {
            self.device.raw.get_query_pool_results(
                self.queries,
                0,
                &mut stamps,
                vk::QueryResultFlags::TYPE_64 | vk::QueryResultFlags::WAIT,
            )
        }
        .map_err(self.device.call_error("vkGetQueryPoolResults"))?;
        for (&(stage, bytes), stamps) in self.stages.iter().zip(stamps.windows(2)) {
            let steps = stamps[1].saturating_sub(stamps[0]);
            self.device.record(stage, bytes, steps as f64 * self.device.timestamp_period * 1e-9);
        }
        Ok(())
    }
}

/// Splits points into their semaphores and their values.
fn parts(points: impl Iterator<Item = SemaphorePoint>) -> (Vec<vk::Semaphore>, Vec<u64>) {
    points.map(|SemaphorePoint { semaphore, value }| (semaphore, value)).unzip()
}

impl Drop for Batch {
    fn drop(&mut self) {
        let _ = self.wait();
        // SAFETY: no resource of this batch is in use: it has finished, or its device is lost.
        unsafe {
            if self.pending && self.device.queue(self.queue).idle(&self.device.raw).is_err() {
                // The commands may still be running, so their resources are leaked.
                self.buffers.drain(..).for_each(std::mem::forget);
                self.pipelines.drain(..).for_each(std::mem::forget);
                std::mem::forget(Arc::clone(&self.stamp));
                return;
            }
            self.device.raw.destroy_query_pool(self.queries, None);
            self.device.raw.destroy_descriptor_pool(self.sets, None);
            self.device.raw.destroy_command_pool(self.pool, None);
        }
    }
}

impl fmt::Debug for Batch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Batch")
            .field("queue", &self.queue)
            .field("pending", &self.pending)
            .finish_non_exhaustive()
    }
}
