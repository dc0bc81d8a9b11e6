//! Buffers and their memory.

use std::fmt;
use std::sync::atomic::Ordering;
use std::sync::{Arc, PoisonError};

use ash::vk;
use bytemuck::Pod;
use gpu_allocator::MemoryLocation;
use gpu_allocator::vulkan::{Allocation, AllocationCreateDesc, AllocationScheme};

use super::device::SharedDevice;
use super::{Device, Faults, VulkanError};

#[cfg(unix)]
type Descriptor = std::os::fd::OwnedFd;
/// This type has no values, because imports are supported only on Unix.
#[cfg(not(unix))]
#[derive(Debug)]
enum Descriptor {}

#[cfg(unix)]
fn raw_descriptor(descriptor: &Descriptor) -> i32 {
    use std::os::fd::AsRawFd;
    descriptor.as_raw_fd()
}

#[cfg(not(unix))]
fn raw_descriptor(descriptor: &Descriptor) -> i32 {
    match *descriptor {}
}

/// The handle type of exported memory.
const HANDLE: vk::ExternalMemoryHandleTypeFlags = vk::ExternalMemoryHandleTypeFlags::OPAQUE_FD;

/// The memory type of a buffer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BufferKind {
    /// The fastest memory for shaders, which the host cannot access.
    Device,
    /// Memory that the host writes and the device reads.
    Upload,
    /// Memory that the device writes and the host reads.
    Download,
}

/// Memory for shaders and copies.
pub struct Buffer {
    pub(super) device: Arc<SharedDevice>,
    raw: vk::Buffer,
    memory: BufferMemory,
    bytes: u64,
}

/// The memory that a buffer is bound to.
enum BufferMemory {
    /// No memory yet.
    None,
    /// A part of a memory block that several buffers share.
    Part(Allocation),
    /// A dedicated allocation, which can be exported.
    Own(vk::DeviceMemory),
    /// The memory of a buffer that the caller owns.
    External,
}

/// A part of a buffer.
#[derive(Debug, Clone)]
pub struct View {
    pub(super) buffer: Arc<Buffer>,
    /// The offset in the buffer, in bytes.
    pub(super) offset: u64,
    pub(super) bytes: u64,
}

impl Device {
    /// Makes a buffer of `bytes` bytes, rounded up to whole words of 4 bytes, and at least one
    /// word.
    ///
    /// # Errors
    /// [`VulkanError::OutOfMemory`] if the device has too little memory, or if its limits or the
    /// memory limit do not allow the buffer.
    pub fn buffer(&self, kind: BufferKind, bytes: u64) -> Result<Arc<Buffer>, VulkanError> {
        let location = match kind {
            BufferKind::Device => MemoryLocation::GpuOnly,
            // Staging buffers for uploads and downloads are in the host's memory. The allocator's
            // location for uploads is not used, because it is a part of the device's memory that is
            // small and slow to write.
            BufferKind::Upload | BufferKind::Download => MemoryLocation::GpuToCpu,
        };
        let shared = &self.shared;
        let mut buffer = self.unbound(bytes, vk::ExternalMemoryHandleTypeFlags::empty())?;
        let exhausted = VulkanError::OutOfMemory { bytes: buffer.bytes };
        // SAFETY: the buffer belongs to this device, and is new.
        let requirements = unsafe { shared.raw.get_buffer_memory_requirements(buffer.raw) };
        let allocation = shared
            .allocator
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .allocate(&AllocationCreateDesc {
                name: "buffer",
                requirements,
                location,
                linear: true,
                allocation_scheme: AllocationScheme::GpuAllocatorManaged,
            })
            .map_err(
                |_| if shared.check_alive().is_err() { VulkanError::Lost } else { exhausted },
            )?;
        // SAFETY: the allocation lives as long as the buffer.
        unsafe {
            let (memory, offset) = (allocation.memory(), allocation.offset());
            buffer.memory = BufferMemory::Part(allocation);
            shared
                .raw
                .bind_buffer_memory(buffer.raw, memory, offset)
                .map_err(shared.call_error("vkBindBufferMemory"))?;
        }
        Ok(Arc::new(buffer))
    }

    /// Makes a buffer on the device whose memory can be [exported](Buffer::export) to other
    /// interfaces and processes.
    ///
    /// # Errors
    /// The same errors as for [`buffer`](Self::buffer).
    ///
    /// # Panics
    /// If [exports](super::DeviceOptions::exports) were not requested.
    pub fn exported_buffer(&self, bytes: u64) -> Result<Arc<Buffer>, VulkanError> {
        self.shared_buffer(bytes, None)
    }

    /// Imports the memory of a buffer of the same size that another device with the same
    /// [UUID](Self::uuid), perhaps in another process, has [exported](Buffer::export). Writes of
    /// one device are visible to the other device once the other device has waited for them to
    /// finish.
    ///
    /// # Errors
    /// The same errors as for [`buffer`](Self::buffer).
    ///
    /// # Panics
    /// If [exports](super::DeviceOptions::exports) were not requested.
    #[cfg(unix)]
    pub fn imported_buffer(
        &self,
        memory: std::os::fd::OwnedFd,
        bytes: u64,
    ) -> Result<Arc<Buffer>, VulkanError> {
        self.shared_buffer(bytes, Some(memory))
    }

    fn shared_buffer(
        &self,
        bytes: u64,
        import: Option<Descriptor>,
    ) -> Result<Arc<Buffer>, VulkanError> {
        let shared = &self.shared;
        assert!(shared.exports.is_some(), "the device was opened without exports");
        let mut buffer = self.unbound(bytes, HANDLE)?;
        // SAFETY: the buffer belongs to this device, and is new; all pointers outlive the calls.
        unsafe {
            let requirements = shared.raw.get_buffer_memory_requirements(buffer.raw);
            let kinds = shared.memory_types.memory_types_as_slice().iter().enumerate();
            let fitting = kinds.filter(|(i, _)| requirements.memory_type_bits >> i & 1 != 0);
            let local = |kind: &vk::MemoryType| {
                kind.property_flags.contains(vk::MemoryPropertyFlags::DEVICE_LOCAL)
            };
            // Takes the first suitable memory type that is local to the device; if none is local,
            // the first suitable type. The exporter makes the same choice.
            let (kind, _) = fitting
                .min_by_key(|(_, kind)| !local(kind))
                .ok_or(VulkanError::OutOfMemory { bytes: buffer.bytes })?;
            let mut dedicated = vk::MemoryDedicatedAllocateInfo::default().buffer(buffer.raw);
            let mut flags = vk::MemoryAllocateFlagsInfo::default()
                .flags(vk::MemoryAllocateFlags::DEVICE_ADDRESS);
            let mut export = vk::ExportMemoryAllocateInfo::default().handle_types(HANDLE);
            let mut imported = vk::ImportMemoryFdInfoKHR::default().handle_type(HANDLE);
            let mut info = vk::MemoryAllocateInfo::default()
                .allocation_size(requirements.size)
                .memory_type_index(kind as u32)
                .push_next(&mut dedicated);
            match &import {
                Some(memory) => {
                    imported = imported.fd(raw_descriptor(memory));
                    info = info.push_next(&mut imported);
                }
                None => info = info.push_next(&mut export),
            }
            if shared.addresses {
                info = info.push_next(&mut flags);
            }
            let memory = shared
                .raw
                .allocate_memory(&info, None)
                .map_err(shared.call_error("vkAllocateMemory"))?;
            // The driver owns the descriptor now.
            std::mem::forget(import);
            buffer.memory = BufferMemory::Own(memory);
            shared
                .raw
                .bind_buffer_memory(buffer.raw, memory, 0)
                .map_err(shared.call_error("vkBindBufferMemory"))?;
        }
        Ok(Arc::new(buffer))
    }

    /// Makes a buffer that is not bound to memory yet, if the memory limit allows the buffer.
    /// Dropping the buffer frees everything that was allocated for it.
    fn unbound(
        &self,
        bytes: u64,
        handles: vk::ExternalMemoryHandleTypeFlags,
    ) -> Result<Buffer, VulkanError> {
        let shared = &self.shared;
        shared.check_alive()?;
        let bytes = bytes.next_multiple_of(4).max(4);
        let limit = shared.memory.unwrap_or(u64::MAX);
        let before = shared.allocated.fetch_add(bytes, Ordering::Relaxed);
        shared.counters.allocations.fetch_add(1, Ordering::Relaxed);
        // From here on, dropping `buffer` frees everything if a later step fails.
        let mut buffer = Buffer {
            device: Arc::clone(shared),
            raw: vk::Buffer::null(),
            memory: BufferMemory::None,
            bytes,
        };
        if before.saturating_add(bytes) > limit
            || bytes > shared.limits.allocation
            || Faults::must_fail(&shared.faults.allocation)
        {
            return Err(VulkanError::OutOfMemory { bytes });
        }
        let families = shared.families();
        let usage = vk::BufferUsageFlags::STORAGE_BUFFER
            | vk::BufferUsageFlags::TRANSFER_SRC
            | vk::BufferUsageFlags::TRANSFER_DST
            | vk::BufferUsageFlags::INDIRECT_BUFFER
            | vk::BufferUsageFlags::VERTEX_BUFFER
            | vk::BufferUsageFlags::INDEX_BUFFER
            | shared.usage;
        let mut external = vk::ExternalMemoryBufferCreateInfo::default().handle_types(handles);
        let mut info = vk::BufferCreateInfo::default().size(bytes).usage(usage);
        if families.len() > 1 {
            info = info.sharing_mode(vk::SharingMode::CONCURRENT).queue_family_indices(&families);
        }
        if !handles.is_empty() {
            info = info.push_next(&mut external);
        }
        // SAFETY: the device is alive; memory is bound before anything uses the buffer.
        buffer.raw = unsafe { shared.raw.create_buffer(&info, None) }
            .map_err(shared.call_error("vkCreateBuffer"))?;
        Ok(buffer)
    }

    /// Makes a buffer with copies of `values`. The host can write to this buffer again.
    ///
    /// # Errors
    /// The same errors as for [`buffer`](Self::buffer).
    pub fn uploaded<T: Pod>(&self, values: &[T]) -> Result<View, VulkanError> {
        let buffer = self.buffer(BufferKind::Upload, size_of_val(values) as u64)?;
        // SAFETY: nothing else uses the buffer yet.
        unsafe { buffer.write(0, values) };
        Ok(buffer.whole())
    }

    /// Wraps a buffer that the caller has created on the same device. The caller must destroy this
    /// buffer.
    ///
    /// # Safety
    /// The buffer must be bound to memory, hold `bytes` bytes, be usable as a storage buffer and as
    /// the source of copies, belong to the queue's family or be shared concurrently, and outlive
    /// the returned object. During a call into this crate that uses the buffer, nothing else may
    /// write to it. Earlier writes must have finished, or must have been submitted to the same
    /// queue with a dependency on compute shaders and transfers.
    #[must_use]
    pub unsafe fn external_buffer(&self, raw: vk::Buffer, bytes: u64) -> Arc<Buffer> {
        Arc::new(Buffer {
            device: Arc::clone(&self.shared),
            raw,
            memory: BufferMemory::External,
            bytes,
        })
    }
}

impl Buffer {
    /// Returns the size of the buffer in bytes.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// The Vulkan handle, which is valid as long as this object exists.
    #[must_use]
    pub fn raw(&self) -> vk::Buffer {
        self.raw
    }

    /// A new file descriptor with which another interface or process can import the memory of an
    /// [exported buffer](Device::exported_buffer). The descriptor is opaque, stands for a dedicated
    /// allocation, and belongs to the caller.
    ///
    /// # Errors
    /// If the driver cannot export the memory.
    ///
    /// # Panics
    /// If the buffer was not created for export.
    #[cfg(unix)]
    pub fn export(&self) -> Result<std::os::fd::OwnedFd, VulkanError> {
        use std::os::fd::FromRawFd;
        let (BufferMemory::Own(memory), Some(exports)) = (&self.memory, &self.device.exports)
        else {
            panic!("the buffer was not created for export");
        };
        let info = vk::MemoryGetFdInfoKHR::default().memory(*memory).handle_type(HANDLE);
        // SAFETY: the memory belongs to this device, which can export it, and the descriptor is
        // new.
        unsafe {
            let descriptor =
                exports.get_memory_fd(&info).map_err(self.device.call_error("vkGetMemoryFdKHR"))?;
            Ok(std::os::fd::OwnedFd::from_raw_fd(descriptor))
        }
    }

    /// The whole buffer.
    #[must_use]
    pub fn whole(self: &Arc<Self>) -> View {
        self.part(0, self.bytes)
    }

    /// A view of the `bytes` bytes from `offset` on.
    ///
    /// # Panics
    /// If the buffer is too small.
    #[must_use]
    pub fn part(self: &Arc<Self>, offset: u64, bytes: u64) -> View {
        check_range(offset, bytes, self.bytes);
        View { buffer: Arc::clone(self), offset, bytes }
    }

    /// Writes into an upload buffer.
    ///
    /// # Safety
    /// No batch that has been submitted but not yet waited for may read or write this range. No
    /// other thread may access the range. This function does not synchronize with the device.
    ///
    /// # Panics
    /// If the buffer is too small, or if it is not visible to the host.
    pub unsafe fn write<T: Pod>(&self, offset: u64, values: &[T]) {
        let bytes: &[u8] = bytemuck::cast_slice(values);
        let to = self.mapped(offset, bytes.len());
        self.device.counters.sent.fetch_add(bytes.len() as u64, Ordering::Relaxed);
        // SAFETY: `mapped` checked the range, and by the caller's guarantee nothing else accesses
        // it.
        unsafe { std::ptr::copy_nonoverlapping(bytes.as_ptr(), to, bytes.len()) };
    }

    /// Reads from a download buffer.
    ///
    /// # Safety
    /// No batch that has been submitted but not yet waited for may write to this range. No other
    /// thread may write to the range.
    ///
    /// # Panics
    /// If the buffer has fewer than `count` values, or is not visible to the host.
    #[must_use]
    pub unsafe fn read<T: Pod>(&self, offset: u64, count: usize) -> Vec<T> {
        // SAFETY: the caller guarantees that nothing writes to this range, and the values are
        // copied before this function returns.
        unsafe { self.values(offset, count) }.to_vec()
    }

    /// Returns the values that [`read`](Self::read) would copy, without copying them.
    ///
    /// # Safety
    /// The conditions of [`read`](Self::read) must hold for as long as the values are used.
    pub(crate) unsafe fn values<T: Pod>(&self, offset: u64, count: usize) -> &[T] {
        let from = self.mapped(offset, size_of::<T>() * count);
        self.device.counters.received.fetch_add((size_of::<T>() * count) as u64, Ordering::Relaxed);
        assert!(from.cast::<T>().is_aligned(), "offset {offset} is not aligned");
        // SAFETY: `mapped` checked the range, any bits are a valid value, and by the caller's
        // guarantee nothing writes there.
        unsafe { std::slice::from_raw_parts(from.cast(), count) }
    }

    fn mapped(&self, offset: u64, len: usize) -> *mut u8 {
        check_range(offset, len as u64, self.bytes);
        let mapped = match &self.memory {
            BufferMemory::Part(allocation) => allocation.mapped_ptr(),
            _ => None,
        };
        let base = mapped
            .expect("only buffers for uploads and downloads are visible to the host")
            .as_ptr()
            .cast::<u8>();
        // SAFETY: the mapping is as long as the buffer.
        unsafe { base.add(offset as usize) }
    }
}

impl View {
    /// Returns the size of the view in bytes.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// The Vulkan handle of the view's buffer, which is valid as long as this object exists.
    #[must_use]
    pub fn raw(&self) -> vk::Buffer {
        self.buffer.raw
    }

    /// The offset of the view in its buffer, in bytes.
    #[must_use]
    pub fn offset(&self) -> u64 {
        self.offset
    }

    /// The view's address on the device, if buffers [have
    /// addresses](super::DeviceOptions::addresses) and the caller does not own this buffer.
    #[must_use]
    pub fn address(&self) -> Option<vk::DeviceAddress> {
        let Buffer { device, raw, memory, .. } = &*self.buffer;
        let info = vk::BufferDeviceAddressInfo::default().buffer(*raw);
        let known = device.addresses && !matches!(memory, BufferMemory::External);
        // SAFETY: the buffer belongs to the device, and was created with an address.
        known.then(|| unsafe { device.raw.get_buffer_device_address(&info) } + self.offset)
    }

    /// The part of the view with the `bytes` bytes from `offset` on.
    ///
    /// # Panics
    /// If the view is too small.
    #[must_use]
    pub fn part(&self, offset: u64, bytes: u64) -> Self {
        check_range(offset, bytes, self.bytes);
        self.buffer.part(self.offset + offset, bytes)
    }

    /// Like [`part`](Self::part), but the start moves back to a multiple of `alignment` bytes in
    /// the buffer. Also returns the number of words that are added at the start.
    ///
    /// # Panics
    /// If the view is too small, or if the part begins within a word.
    #[must_use]
    pub fn aligned(&self, offset: u64, bytes: u64, alignment: u64) -> (Self, u32) {
        let part = self.part(offset, bytes);
        let added = part.offset % alignment;
        assert!(added.is_multiple_of(4), "offset {} is not a multiple of 4", part.offset);
        (self.buffer.part(part.offset - added, bytes + added), (added / 4) as u32)
    }

    /// Writes into this view, as [`Buffer::write`] does.
    ///
    /// # Safety
    /// The same conditions as for [`Buffer::write`].
    pub unsafe fn write<T: Pod>(&self, offset: u64, values: &[T]) {
        // SAFETY: the caller guarantees the conditions of `Buffer::write`.
        unsafe { self.buffer.write(self.offset + offset, values) };
    }

    /// Returns values in this view, as [`Buffer::values`] does.
    ///
    /// # Safety
    /// The same conditions as for [`Buffer::values`].
    pub(crate) unsafe fn values<T: Pod>(&self, offset: u64, count: usize) -> &[T] {
        // SAFETY: the caller guarantees the conditions of `Buffer::values`.
        unsafe { self.buffer.values(self.offset + offset, count) }
    }

    /// Reads from this view, as [`Buffer::read`] does.
    ///
    /// # Safety
    /// The same conditions as for [`Buffer::read`].
    #[must_use]
    pub unsafe fn read<T: Pod>(&self, offset: u64, count: usize) -> Vec<T> {
        // SAFETY: the caller guarantees the conditions of `Buffer::read`.
        unsafe { self.buffer.read(self.offset + offset, count) }
    }
}

impl Drop for Buffer {
    fn drop(&mut self) {
        if matches!(self.memory, BufferMemory::External) {
            return;
        }
        self.device.allocated.fetch_sub(self.bytes, Ordering::Relaxed);
        // SAFETY: batches in flight hold their buffers, so nothing uses this one.
        unsafe { self.device.raw.destroy_buffer(self.raw, None) };
        match std::mem::replace(&mut self.memory, BufferMemory::None) {
            BufferMemory::Part(allocation) => {
                let mut allocator =
                    self.device.allocator.lock().unwrap_or_else(PoisonError::into_inner);
                allocator.free(allocation).expect("the buffer's memory is from this allocator");
            }
            // SAFETY: the memory was bound only to this buffer.
            BufferMemory::Own(memory) => unsafe { self.device.raw.free_memory(memory, None) },
            BufferMemory::None | BufferMemory::External => {}
        }
    }
}

/// Panics if a range does not lie within a buffer or view of `size` bytes.
#[track_caller]
fn check_range(offset: u64, bytes: u64, size: u64) {
    let end = offset.checked_add(bytes);
    assert!(
        end.is_some_and(|end| end <= size),
        "{bytes} bytes at offset {offset} exceed a buffer of {size} bytes"
    );
}

impl fmt::Debug for Buffer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Buffer").field("bytes", &self.bytes).finish_non_exhaustive()
    }
}
