//! An open device: its queues, its memory and its pipeline cache.

use std::collections::HashMap;
use std::fmt;
use std::fs;
use std::io::Write;
use std::mem::ManuallyDrop;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use ash::{khr, vk};
use gpu_allocator::AllocationSizes;
use gpu_allocator::vulkan::{Allocator, AllocatorCreateDesc};

use super::families;
use super::instance::{lacks, names};
use super::{DeviceChoice, Faults, Instance, VulkanError};

/// Size, in bytes, of the memory blocks that are allocated from the driver; larger buffers have
/// dedicated blocks.
pub const PIECE: u64 = 16 << 20;

/// Options for opening or adopting a device: its memory limit, its cache and its features.
#[derive(Debug, Clone, Default)]
pub struct DeviceOptions {
    /// Maximum bytes of all buffers together; `None` for no limit.
    pub memory: Option<u64>,
    /// The folder in which compiled pipelines are kept between runs.
    pub pipeline_cache: Option<PathBuf>,
    /// Maximum bytes of a storage buffer for shaders; `None` for no maximum. The device's own limit
    /// applies as well.
    pub storage_range: Option<u64>,
    /// The queues to use.
    pub queues: Queues,
    /// Whether the device shares the host's memory. `None` means true for integrated GPUs and for
    /// drivers that compute on the CPU, and false for other devices.
    pub shares_host_memory: Option<bool>,
    /// Whether buffers have [addresses](super::View::address). The device needs
    /// `bufferDeviceAddress`, and an adopted device must have it enabled.
    pub addresses: bool,
    /// Whether buffers can be created for [other interfaces and
    /// processes](Device::exported_buffer). The device needs `VK_KHR_external_memory_fd`, and an
    /// adopted device must have it enabled.
    pub exports: bool,
    /// Additional usages of the buffers, such as building acceleration structures. The features and
    /// extensions that these usages need must be enabled on the device.
    pub usage: vk::BufferUsageFlags,
    /// SPIR-V binaries that replace the binaries of shaders, by the name of the shader. They must
    /// be compiled from the same sources.
    pub binaries: HashMap<&'static str, Vec<u8>>,
}

/// The queues that are used on a device.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Queues {
    /// One queue for shaders, and another for copies if the device has a queue family only for
    /// copies.
    #[default]
    All,
    /// One queue for shaders and copies.
    One,
    /// One queue that is used as if it were two queues, one for shaders and one for copies.
    OneAsTwo,
}

/// The limits of a device on shaders and buffers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Maximum bytes of a storage buffer in a shader.
    pub storage_range: u64,
    /// Maximum bytes of one allocation.
    pub allocation: u64,
    /// Maximum number of work groups along an axis of a dispatch.
    pub groups: u32,
    /// Required alignment, in bytes, of the offsets of storage buffers.
    pub alignment: u64,
}

/// A queue of the device, by its use. One queue may have both uses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Queue {
    /// The queue for shaders.
    Compute,
    /// The queue for copies, which run in parallel with shaders if the device supports it.
    Transfer,
}

/// The duration of a stage on the device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Timing {
    /// The name of the stage.
    pub stage: &'static str,
    /// Time in seconds between the timestamps around the stage, summed over all batches.
    pub seconds: f64,
    /// Minimum number of bytes that the stage read and wrote.
    pub bytes: u64,
}

/// Counts of a device's work.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counters {
    /// Number of submitted batches.
    pub submissions: u64,
    /// Number of buffers that were created.
    pub allocations: u64,
    /// Bytes that the host wrote for the device.
    pub sent: u64,
    /// Bytes that the host read from the device.
    pub received: u64,
}

#[derive(Debug, Default)]
pub(super) struct AtomicCounters {
    pub(super) submissions: AtomicU64,
    pub(super) allocations: AtomicU64,
    pub(super) sent: AtomicU64,
    pub(super) received: AtomicU64,
}

/// A device that the caller has opened, and keeps open.
pub struct ExternalDevice {
    /// The loader's functions for the instance.
    pub instance: ash::Instance,
    /// The physical device.
    pub physical: vk::PhysicalDevice,
    /// The logical device, created from `physical` with timeline semaphores enabled.
    pub device: ash::Device,
    /// The family of `queue`.
    pub family: u32,
    /// A queue that supports compute.
    pub queue: vk::Queue,
}

/// An open device. Clones share the device.
#[derive(Debug, Clone)]
pub struct Device {
    pub(super) shared: Arc<SharedDevice>,
}

pub(super) struct SharedDevice {
    pub(super) raw: ash::Device,
    /// `None` if the caller owns the device and destroys it.
    instance: Option<Arc<Instance>>,
    name: String,
    shares_host_memory: bool,
    pub(super) allocator: ManuallyDrop<Mutex<Allocator>>,
    pub(super) pipeline_cache: vk::PipelineCache,
    cache_file: Option<PathBuf>,
    queues: Vec<QueueState>,
    pub(super) limits: Limits,
    /// Nanoseconds per timestamp step.
    pub(super) timestamp_period: f64,
    pub(super) memory: Option<u64>,
    pub(super) allocated: AtomicU64,
    pub(super) faults: Faults,
    lost: AtomicBool,
    timings: Mutex<Vec<Timing>>,
    pub(super) counters: AtomicCounters,
    pub(super) addresses: bool,
    /// The functions for exports, if they are enabled.
    pub(super) exports: Option<khr::external_memory_fd::Device>,
    /// The memory types, for dedicated allocations.
    pub(super) memory_types: vk::PhysicalDeviceMemoryProperties,
    pub(super) usage: vk::BufferUsageFlags,
    pub(super) uuid: [u8; 16],
    pub(super) binaries: HashMap<&'static str, Vec<u8>>,
}

pub(super) struct QueueState {
    /// The queue, which two states share if one queue is used as two.
    pub(super) raw: Arc<Mutex<vk::Queue>>,
    pub(super) family: u32,
    pub(super) timestamps: bool,
    /// Whether the host resets queries, because a queue that supports only copies cannot reset
    /// them.
    pub(super) host_reset: bool,
    pub(super) timeline: vk::Semaphore,
    /// The value that the last submission signals.
    pub(super) last: AtomicU64,
}

impl QueueState {
    /// Waits until all work on the queue has finished. Returns at once if the device is lost.
    pub(super) fn idle(&self, device: &ash::Device) -> Result<(), vk::Result> {
        let queue = self.raw.lock().unwrap_or_else(PoisonError::into_inner);
        // SAFETY: the queue belongs to the device, and is locked, so nothing else uses it.
        match unsafe { device.queue_wait_idle(*queue) } {
            Err(vk::Result::ERROR_DEVICE_LOST) => Ok(()),
            waited => waited,
        }
    }
}

impl Device {
    /// Opens a device.
    ///
    /// # Errors
    /// [`VulkanError`] if no device matches `choice`, or if the device cannot be opened.
    pub fn open(
        instance: &Arc<Instance>,
        choice: &DeviceChoice,
        options: &DeviceOptions,
    ) -> Result<Self, VulkanError> {
        let info = instance.choose(choice)?;
        // SAFETY: the device belongs to the instance.
        let families =
            unsafe { instance.raw.get_physical_device_queue_family_properties(info.physical) };
        let (family, transfer) = families::choose_families(&families);
        let family = family.expect("`choose` rejects devices without compute");
        let transfer = transfer.filter(|_| options.queues == Queues::All);
        let used: Vec<u32> = std::iter::once(family).chain(transfer).collect();
        let queue_infos: Vec<_> = used
            .iter()
            .map(|&f| {
                vk::DeviceQueueCreateInfo::default().queue_family_index(f).queue_priorities(&[1.0])
            })
            .collect();
        let mut features = vk::PhysicalDeviceVulkan12Features::default()
            .timeline_semaphore(true)
            .host_query_reset(true)
            .buffer_device_address(options.addresses);
        // SAFETY: the device belongs to the instance.
        let known = unsafe { instance.raw.enumerate_device_extension_properties(info.physical) };
        let known = known.unwrap_or_default();
        // Vulkan requires the portability subset extension to be enabled if a device offers it.
        let subset = names(&known, khr::portability_subset::NAME);
        let exports = names(&known, khr::external_memory_fd::NAME).filter(|_| options.exports);
        let unfit = |lacks| VulkanError::Unsuitable { device: info.name.clone(), lacks };
        if options.exports && exports.is_none() {
            return Err(unfit("its memory cannot be exported"));
        }
        if options.addresses && !instance.has_addresses(info.physical) {
            return Err(unfit("its buffers cannot have addresses"));
        }
        let extensions: Vec<_> = subset.iter().chain(&exports).map(|name| name.as_ptr()).collect();
        let create = vk::DeviceCreateInfo::default()
            .queue_create_infos(&queue_infos)
            .enabled_extension_names(&extensions)
            .push_next(&mut features);
        // SAFETY: all pointers in the structure outlive the call.
        let raw = unsafe { instance.raw.create_device(info.physical, &create, None) }
            .map_err(VulkanError::of("vkCreateDevice"))?;
        // SAFETY: the device was created with a queue of each of these families.
        let mut queues: Vec<_> =
            used.iter().map(|&f| (f, unsafe { raw.get_device_queue(f, 0) })).collect();
        if options.queues == Queues::OneAsTwo {
            queues.push(queues[0]);
        }
        let owner = Some(Arc::clone(instance));
        Self::from_handles(&instance.raw, owner, info.physical, raw, queues, options)
    }

    /// Uses a device that the caller has opened.
    ///
    /// # Errors
    /// [`VulkanError::Unsuitable`] for a device that lacks a required feature; other errors if
    /// there is no memory for the objects that are created here.
    ///
    /// # Safety
    /// - All handles must belong together, be created for Vulkan 1.2 or later with
    ///   `timelineSemaphore` enabled, and live as long as the returned object and everything
    ///   created with it.
    /// - A queue may be adopted only once at a time. During a call into this crate, nothing else
    ///   may submit to the queue, and no earlier submission may wait for later actions of the
    ///   calling thread.
    /// - Buffers created here belong to the queue's family: other families need a transfer of
    ///   ownership, and every reader on the device needs a dependency on compute shaders and
    ///   transfers. A buffer must not be dropped before the caller's own commands on it have
    ///   finished.
    pub unsafe fn adopt(
        foreign: ExternalDevice,
        options: &DeviceOptions,
    ) -> Result<Self, VulkanError> {
        let ExternalDevice { instance, physical, device, family, queue } = foreign;
        // SAFETY: the device belongs to the instance.
        let (properties, families) = unsafe {
            (
                instance.get_physical_device_properties(physical),
                instance.get_physical_device_queue_family_properties(physical),
            )
        };
        let computes =
            |f: &vk::QueueFamilyProperties| f.queue_flags.contains(vk::QueueFlags::COMPUTE);
        let lacks_compute = (!families.get(family as usize).is_some_and(computes))
            .then_some("its queue does not support compute");
        if let Some(lacks) = lacks(&instance, physical, &properties).or(lacks_compute) {
            let device =
                properties.device_name_as_c_str().unwrap_or(c"").to_string_lossy().into_owned();
            return Err(VulkanError::Unsuitable { device, lacks });
        }
        Self::from_handles(&instance, None, physical, device, vec![(family, queue)], options)
    }

    fn from_handles(
        instance: &ash::Instance,
        owner: Option<Arc<Instance>>,
        physical: vk::PhysicalDevice,
        raw: ash::Device,
        queues: Vec<(u32, vk::Queue)>,
        options: &DeviceOptions,
    ) -> Result<Self, VulkanError> {
        let mut maintenance = vk::PhysicalDeviceMaintenance3Properties::default();
        let mut id = vk::PhysicalDeviceIDProperties::default();
        let mut all =
            vk::PhysicalDeviceProperties2::default().push_next(&mut maintenance).push_next(&mut id);
        // SAFETY: the device belongs to the instance.
        let (families, properties, memory_types) = unsafe {
            instance.get_physical_device_properties2(physical, &mut all);
            (
                instance.get_physical_device_queue_family_properties(physical),
                all.properties,
                instance.get_physical_device_memory_properties(physical),
            )
        };
        let allocator = Allocator::new(&AllocatorCreateDesc {
            instance: instance.clone(),
            device: raw.clone(),
            physical_device: physical,
            debug_settings: gpu_allocator::AllocatorDebugSettings::default(),
            buffer_device_address: options.addresses,
            allocation_sizes: AllocationSizes::new(PIECE, PIECE),
        });
        let allocator = match allocator {
            Ok(allocator) => allocator,
            Err(_) => {
                if owner.is_some() {
                    // SAFETY: nothing was created with the device.
                    unsafe { raw.destroy_device(None) };
                }
                return Err(VulkanError::OutOfMemory { bytes: 0 });
            }
        };
        let cache_file = options.pipeline_cache.as_deref().map(|folder| {
            let id: String =
                properties.pipeline_cache_uuid.iter().map(|b| format!("{b:02x}")).collect();
            folder.join(format!("pipelines-{id}"))
        });
        // From here on, dropping `shared` frees everything if a later step fails.
        let exports = options.exports.then(|| khr::external_memory_fd::Device::new(instance, &raw));
        let mut shared = SharedDevice {
            raw,
            instance: owner,
            name: properties.device_name_as_c_str().unwrap_or(c"").to_string_lossy().into_owned(),
            shares_host_memory: options.shares_host_memory.unwrap_or(matches!(
                properties.device_type,
                vk::PhysicalDeviceType::CPU | vk::PhysicalDeviceType::INTEGRATED_GPU
            )),
            allocator: ManuallyDrop::new(Mutex::new(allocator)),
            pipeline_cache: vk::PipelineCache::null(),
            cache_file,
            queues: Vec::new(),
            limits: Limits::of(&properties.limits, maintenance.max_memory_allocation_size, options),
            timestamp_period: f64::from(properties.limits.timestamp_period),
            memory: options.memory,
            allocated: AtomicU64::new(0),
            faults: Faults::default(),
            lost: AtomicBool::new(false),
            timings: Mutex::default(),
            counters: AtomicCounters::default(),
            addresses: options.addresses,
            exports,
            memory_types,
            usage: options.usage
                | match options.addresses {
                    true => vk::BufferUsageFlags::SHADER_DEVICE_ADDRESS,
                    false => vk::BufferUsageFlags::empty(),
                },
            uuid: id.device_uuid,
            binaries: options.binaries.clone(),
        };
        shared.pipeline_cache = shared.load_cache()?;
        for (family, queue) in queues {
            shared.add_queue(family, queue, &families[family as usize])?;
        }
        Ok(Self { shared: Arc::new(shared) })
    }

    /// Returns the name that the driver gives the device.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.shared.name
    }

    /// Returns the UUID that identifies the device in every interface and process on the machine.
    #[must_use]
    pub fn uuid(&self) -> [u8; 16] {
        self.shared.uuid
    }

    /// Returns the limits on shaders and buffers.
    #[must_use]
    pub fn limits(&self) -> Limits {
        self.shared.limits
    }

    /// Whether the device shares the host's memory.
    #[must_use]
    pub fn shares_host_memory(&self) -> bool {
        self.shared.shares_host_memory
    }

    /// Bytes of all existing buffers.
    #[must_use]
    pub fn allocated(&self) -> u64 {
        self.shared.allocated.load(Ordering::Relaxed)
    }

    /// Maximum bytes of all buffers together.
    #[must_use]
    pub fn memory(&self) -> Option<u64> {
        self.shared.memory
    }

    /// The planned failures, for tests.
    #[must_use]
    pub fn faults(&self) -> &Faults {
        &self.shared.faults
    }

    /// Returns the counters since the last call, or since the device was opened, and sets them to
    /// zero.
    #[must_use]
    pub fn take_counters(&self) -> Counters {
        let AtomicCounters { submissions, allocations, sent, received } = &self.shared.counters;
        let [submissions, allocations, sent, received] = [submissions, allocations, sent, received]
            .map(|count| count.swap(0, Ordering::Relaxed));
        Counters { submissions, allocations, sent, received }
    }

    /// Returns the counters since the last call of [`take_counters`](Self::take_counters), or since
    /// the device was opened.
    #[must_use]
    pub fn counters(&self) -> Counters {
        let AtomicCounters { submissions, allocations, sent, received } = &self.shared.counters;
        let [submissions, allocations, sent, received] =
            [submissions, allocations, sent, received].map(|count| count.load(Ordering::Relaxed));
        Counters { submissions, allocations, sent, received }
    }

    /// The times of all stages since the last call, in the order in which the stages first ran.
    #[must_use]
    pub fn take_timings(&self) -> Vec<Timing> {
        std::mem::take(&mut *self.shared.timings.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Limits {
    fn of(device: &vk::PhysicalDeviceLimits, allocation: u64, options: &DeviceOptions) -> Self {
        let storage_range = u64::from(device.max_storage_buffer_range);
        Self {
            storage_range: storage_range.min(options.storage_range.unwrap_or(u64::MAX)) & !3,
            allocation,
            groups: device.max_compute_work_group_count.into_iter().min().unwrap_or(0),
            alignment: device.min_storage_buffer_offset_alignment.max(4),
        }
    }
}

impl SharedDevice {
    /// The pipeline cache of earlier runs, or an empty one.
    fn load_cache(&self) -> Result<vk::PipelineCache, VulkanError> {
        let known = self.cache_file.as_deref().and_then(read_cache).unwrap_or_default();
        let info = vk::PipelineCacheCreateInfo::default().initial_data(&known);
        let empty = vk::PipelineCacheCreateInfo::default();
        // SAFETY: the device is alive, and all pointers outlive the calls.
        let cache = unsafe {
            let cache = self.raw.create_pipeline_cache(&info, None);
            cache.or_else(|_| self.raw.create_pipeline_cache(&empty, None))
        };
        cache.map_err(self.call_error("vkCreatePipelineCache"))
    }

    fn add_queue(
        &mut self,
        family: u32,
        queue: vk::Queue,
        properties: &vk::QueueFamilyProperties,
    ) -> Result<(), VulkanError> {
        let mut kind = vk::SemaphoreTypeCreateInfo::default()
            .semaphore_type(vk::SemaphoreType::TIMELINE)
            .initial_value(0);
        let info = vk::SemaphoreCreateInfo::default().push_next(&mut kind);
        // SAFETY: the device is alive, and all pointers outlive the call.
        let timeline = unsafe { self.raw.create_semaphore(&info, None) }
            .map_err(self.call_error("vkCreateSemaphore"))?;
        let known = self.queues.iter().map(|known| &known.raw);
        let same =
            known.clone().find(|raw| *raw.lock().unwrap_or_else(PoisonError::into_inner) == queue);
        let raw = same.map_or_else(|| Arc::new(Mutex::new(queue)), Arc::clone);
        self.queues.push(QueueState {
            raw,
            family,
            timestamps: properties.timestamp_valid_bits > 0,
            host_reset: !properties.queue_flags.contains(vk::QueueFlags::COMPUTE),
            timeline,
            last: AtomicU64::new(0),
        });
        Ok(())
    }

    pub(super) fn queue(&self, queue: Queue) -> &QueueState {
        match queue {
            Queue::Compute => &self.queues[0],
            Queue::Transfer => self.queues.last().expect("there is a queue for compute"),
        }
    }

    /// The families of all queues, each once.
    pub(super) fn families(&self) -> Vec<u32> {
        let mut families: Vec<u32> = self.queues.iter().map(|queue| queue.family).collect();
        families.dedup();
        families
    }

    /// Converts the result of a failed call to an error, and records that the device is lost if the
    /// result reports this.
    pub(super) fn call_error(&self, call: &'static str) -> impl Fn(vk::Result) -> VulkanError + '_ {
        move |result| {
            let error = VulkanError::of(call)(result);
            // Once the device is lost, every later error is also reported as `Lost`.
            if error == VulkanError::Lost || self.lost.load(Ordering::Relaxed) {
                self.lose()
            } else {
                error
            }
        }
    }

    /// Records that the device is lost.
    pub(super) fn lose(&self) -> VulkanError {
        self.lost.store(true, Ordering::Relaxed);
        VulkanError::Lost
    }

    /// Returns an error if the device is lost.
    pub(super) fn check_alive(&self) -> Result<(), VulkanError> {
        if self.lost.load(Ordering::Relaxed) { Err(VulkanError::Lost) } else { Ok(()) }
    }

    pub(super) fn record(&self, stage: &'static str, bytes: u64, seconds: f64) {
        let mut timings = self.timings.lock().unwrap_or_else(PoisonError::into_inner);
        match timings.iter_mut().find(|timing| timing.stage == stage) {
            Some(timing) => {
                timing.seconds += seconds;
                timing.bytes += bytes;
            }
            None => timings.push(Timing { stage, seconds, bytes }),
        }
    }

    fn save_cache(&self) -> Option<()> {
        let file = self
            .cache_file
            .as_deref()
            .filter(|_| self.pipeline_cache != vk::PipelineCache::null())?;
        // SAFETY: the cache belongs to this device.
        let data = unsafe { self.raw.get_pipeline_cache_data(self.pipeline_cache) }.ok()?;
        if read_cache(file).as_deref() != Some(&data) {
            let folder = file.parent()?;
            fs::create_dir_all(folder).ok()?;
            let mut new = tempfile::NamedTempFile::new_in(folder).ok()?;
            new.write_all(&crc32fast::hash(&data).to_le_bytes()).ok()?;
            new.write_all(&data).ok()?;
            new.persist(file).ok()?;
        }
        Some(())
    }
}

/// The pipeline cache of earlier runs; `None` if the file is missing or damaged. The checksum is
/// needed because drivers do not check the data.
fn read_cache(file: &Path) -> Option<Vec<u8>> {
    let bytes = fs::read(file).ok()?;
    let (checksum, data) = bytes.split_first_chunk()?;
    (u32::from_le_bytes(*checksum) == crc32fast::hash(data)).then(|| data.to_vec())
}

impl Drop for SharedDevice {
    fn drop(&mut self) {
        // If the cache cannot be saved, the next run compiles the shaders again.
        let _ = self.save_cache();
        // SAFETY: buffers, shaders and batches hold references to this object, so all of them are
        // already destroyed when it is dropped. The allocator is dropped before its device.
        unsafe {
            ManuallyDrop::drop(&mut self.allocator);
            for queue in &self.queues {
                self.raw.destroy_semaphore(queue.timeline, None);
            }
            self.raw.destroy_pipeline_cache(self.pipeline_cache, None);
            if self.instance.is_some() {
                self.raw.destroy_device(None);
            }
        }
    }
}

impl fmt::Debug for SharedDevice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Device").field("name", &self.name).finish_non_exhaustive()
    }
}

impl fmt::Debug for ExternalDevice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ExternalDevice").field("family", &self.family).finish_non_exhaustive()
    }
}
