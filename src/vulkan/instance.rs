//! The loader, its devices, and the messages of the validation layer.

use std::ffi::{CStr, c_void};
use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};

use ash::{ext, khr, vk};

use crate::system::memory::default_stack;

use super::{MOST_BUFFERS, MOST_SHARED, MOST_THREADS, VulkanError};

/// The smallest stack limit, in bytes, that meniscus accepts. The threads of lavapipe overflow a
/// stack of 16 KiB.
const LEAST_STACK: u64 = 256 << 10;

const VALIDATION: &CStr = c"VK_LAYER_KHRONOS_validation";

/// A connection to the Vulkan loader.
pub struct Instance {
    entry: ash::Entry,
    pub(super) raw: ash::Instance,
    messenger: Option<(ext::debug_utils::Instance, vk::DebugUtilsMessengerEXT)>,
    sees_shaders: bool,
    log: ValidationLog,
}

/// The messages of the validation layer so far.
#[derive(Debug, Clone, Default)]
pub struct ValidationLog(Arc<Mutex<Vec<String>>>);

impl ValidationLog {
    /// All warnings and errors, in order.
    pub fn messages(&self) -> Vec<String> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// The device to use.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum DeviceChoice {
    /// The first device of the best [kind](DeviceKind), among devices whose drivers pass the
    /// conformance tests if there are any. Devices that cannot be used are ignored.
    #[default]
    Best,
    /// The device with this number in [`Instance::devices`], this [`uuid`](DeviceInfo::uuid) in
    /// hexadecimal digits, or this text in its name, ignoring case.
    Named(String),
}

/// The kind of a device.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[allow(missing_docs)]
pub enum DeviceKind {
    Discrete,
    Integrated,
    Virtual,
    Other,
    /// A driver that computes on the CPU, such as lavapipe.
    Cpu,
}

impl fmt::Display for DeviceKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Discrete => "discrete GPU",
            Self::Integrated => "integrated GPU",
            Self::Virtual => "virtual GPU",
            Self::Other => "other",
            Self::Cpu => "CPU",
        })
    }
}

/// A description of a device before it is opened.
#[derive(Debug, Clone)]
pub struct DeviceInfo {
    /// The index of the device in the loader's list.
    pub index: usize,
    /// The name that the driver gives the device.
    pub name: String,
    /// The UUID that identifies the device in every interface and process on the machine.
    pub uuid: [u8; 16],
    /// The kind of the device.
    pub kind: DeviceKind,
    /// The supported version of Vulkan: major, minor, patch.
    pub api: [u32; 3],
    /// The name and version of the driver.
    pub driver: String,
    /// The version of the conformance tests that the driver passes: major, minor, subminor, patch.
    /// All numbers are 0 if the driver passes none of the tests.
    pub conformance: [u8; 4],
    /// Bytes of the largest heap of the device's own memory.
    pub memory: u64,
    /// Unused bytes of the largest heap, if the driver reports them; otherwise, all bytes of this
    /// heap.
    pub free: u64,
    /// The queue families of the device.
    pub families: Vec<vk::QueueFamilyProperties>,
    /// The memory heaps of the device, and the types of memory in them.
    pub heaps: vk::PhysicalDeviceMemoryProperties,
    /// The limits on shaders and buffers.
    pub limits: vk::PhysicalDeviceLimits,
    /// The requirement that the device does not meet, if it cannot be used.
    pub lacks: Option<&'static str>,
    pub(super) physical: vk::PhysicalDevice,
}

impl DeviceInfo {
    /// Returns the UUID of the device in hexadecimal digits.
    #[must_use]
    pub fn uuid_digits(&self) -> String {
        self.uuid.iter().map(|byte| format!("{byte:02x}")).collect()
    }

    /// Whether the device's driver passes the conformance tests of any version. Drivers that
    /// translate Vulkan to another graphics interface may not pass these tests.
    #[must_use]
    pub fn is_conformant(&self) -> bool {
        self.conformance != [0; 4]
    }
}

impl Instance {
    /// Connects to the loader. If `validation` is set, also enables the Khronos validation layer
    /// and its synchronisation checks.
    ///
    /// # Errors
    /// [`VulkanError::NoLoader`] and [`VulkanError::NoValidation`] if the loader or the layer is
    /// not installed. [`VulkanError::SmallStack`] if threads of drivers would crash.
    pub fn connect(validation: bool) -> Result<Arc<Self>, VulkanError> {
        if let Some(limit) = default_stack().filter(|&limit| limit < LEAST_STACK) {
            return Err(VulkanError::SmallStack { limit, least: LEAST_STACK });
        }
        // SAFETY: the loaded library is the system's Vulkan loader.
        let entry =
            unsafe { ash::Entry::load() }.map_err(|e| VulkanError::NoLoader(e.to_string()))?;
        // SAFETY: this call needs no instance.
        let layers = unsafe { entry.enumerate_instance_layer_properties() }.unwrap_or_default();
        if validation && !layers.iter().any(|layer| layer.layer_name_as_c_str() == Ok(VALIDATION)) {
            return Err(VulkanError::NoValidation);
        }
        let application = vk::ApplicationInfo::default()
            .application_name(c"meniscus")
            .engine_name(c"meniscus")
            .api_version(vk::API_VERSION_1_2);
        let layers = [VALIDATION.as_ptr()];
        // SAFETY: this call needs no instance.
        let known =
            unsafe { entry.enumerate_instance_extension_properties(None) }.unwrap_or_default();
        // Without this extension, devices that do not fully support Vulkan, such as those of
        // MoltenVK, are hidden.
        let portability = names(&known, khr::portability_enumeration::NAME);
        let mut extensions: Vec<_> = portability.iter().map(|name| name.as_ptr()).collect();
        // Validation layers of 2024 and later have settings, and check the memory accesses of
        // shaders only if a setting enables this check. SAFETY: this call needs no instance.
        let layer_extensions =
            unsafe { entry.enumerate_instance_extension_properties(Some(VALIDATION)) };
        let has_settings =
            names(&layer_extensions.unwrap_or_default(), ext::layer_settings::NAME).is_some();
        if validation {
            let checked_by = if has_settings {
                ext::layer_settings::NAME
            } else {
                ext::validation_features::NAME
            };
            extensions.extend([ext::debug_utils::NAME.as_ptr(), checked_by.as_ptr()]);
        }
        let checks = [vk::ValidationFeatureEnableEXT::SYNCHRONIZATION_VALIDATION];
        let mut features =
            vk::ValidationFeaturesEXT::default().enabled_validation_features(&checks);
        let on = vk::TRUE.to_ne_bytes();
        let settings = [c"validate_sync", c"syncval_shader_accesses_heuristic"].map(|name| {
            let setting = vk::LayerSettingEXT::default().layer_name(VALIDATION).setting_name(name);
            vk::LayerSettingEXT {
                value_count: 1,
                ..setting.ty(vk::LayerSettingTypeEXT::BOOL32).values(&on)
            }
        });
        let mut settings = vk::LayerSettingsCreateInfoEXT::default().settings(&settings);
        let log = ValidationLog::default();
        let mut messages = messenger_info(&log);
        let mut info = vk::InstanceCreateInfo::default()
            .application_info(&application)
            .enabled_extension_names(&extensions);
        if portability.is_some() {
            info = info.flags(vk::InstanceCreateFlags::ENUMERATE_PORTABILITY_KHR);
        }
        if validation {
            info = info.enabled_layer_names(&layers).push_next(&mut messages);
            info = if has_settings {
                info.push_next(&mut settings)
            } else {
                info.push_next(&mut features)
            };
        }
        // SAFETY: all pointers in the structure outlive the call.
        let raw = unsafe { entry.create_instance(&info, None) }
            .map_err(|e| VulkanError::NoLoader(format!("cannot create a Vulkan instance: {e}")))?;
        // From here on, dropping `instance` frees everything if a later step fails.
        let mut instance =
            Self { entry, raw, messenger: None, sees_shaders: validation && has_settings, log };
        if validation {
            let debug = ext::debug_utils::Instance::new(&instance.entry, &instance.raw);
            // SAFETY: the messenger's log lives as long as this instance.
            let made =
                unsafe { debug.create_debug_utils_messenger(&messenger_info(&instance.log), None) };
            let made = made.map_err(VulkanError::of("vkCreateDebugUtilsMessengerEXT"))?;
            instance.messenger = Some((debug, made));
        }
        Ok(Arc::new(instance))
    }

    /// Returns the log of the validation layer, which outlives the instance.
    #[must_use]
    pub fn log(&self) -> ValidationLog {
        self.log.clone()
    }

    /// Whether a validation layer checks the memory accesses of shaders. Only layers of 2024 and
    /// later can do this.
    #[must_use]
    pub fn sees_shaders(&self) -> bool {
        self.sees_shaders
    }

    /// All devices, in the loader's order.
    ///
    /// # Errors
    /// If the loader cannot list the devices.
    pub fn devices(&self) -> Result<Vec<DeviceInfo>, VulkanError> {
        // SAFETY: the instance is alive.
        let devices = unsafe { self.raw.enumerate_physical_devices() }
            .map_err(VulkanError::of("vkEnumeratePhysicalDevices"))?;
        Ok(devices.into_iter().enumerate().map(|(i, physical)| self.info(i, physical)).collect())
    }

    /// Finds the device that `choice` describes.
    ///
    /// # Errors
    /// [`VulkanError`] if there is no such device, or if the device cannot be used.
    pub fn choose(&self, choice: &DeviceChoice) -> Result<DeviceInfo, VulkanError> {
        let devices = self.devices()?;
        let found = match choice {
            DeviceChoice::Best => {
                let usable = devices.iter().filter(|device| device.lacks.is_none());
                usable
                    .min_by_key(|device| (!device.is_conformant(), device.kind))
                    .or(devices.first())
            }
            DeviceChoice::Named(wanted) => {
                let numbered = wanted.parse().ok().and_then(|index: usize| devices.get(index));
                let wanted = wanted.to_lowercase();
                // A number that is not an index may be a part of a name.
                let named =
                    || devices.iter().find(|device| device.name.to_lowercase().contains(&wanted));
                let digits = wanted.replace('-', "");
                let known = devices.iter().find(|device| device.uuid_digits() == digits);
                known.or(numbered).or_else(named)
            }
        };
        let Some(found) = found else {
            return Err(match choice {
                DeviceChoice::Named(wanted) if !devices.is_empty() => {
                    let known: Vec<_> =
                        devices.iter().map(|d| format!("[{}] {}", d.index, d.name)).collect();
                    VulkanError::NotFound { wanted: wanted.clone(), known: known.join(", ") }
                }
                _ => VulkanError::NoDevice,
            });
        };
        match found.lacks {
            Some(lacks) => Err(VulkanError::Unsuitable { device: found.name.clone(), lacks }),
            None => Ok(found.clone()),
        }
    }

    fn info(&self, index: usize, physical: vk::PhysicalDevice) -> DeviceInfo {
        let mut driver = vk::PhysicalDeviceDriverProperties::default();
        let mut id = vk::PhysicalDeviceIDProperties::default();
        let mut properties =
            vk::PhysicalDeviceProperties2::default().push_next(&mut driver).push_next(&mut id);
        // SAFETY: the device belongs to this instance.
        let (base, families) = unsafe {
            self.raw.get_physical_device_properties2(physical, &mut properties);
            (properties.properties, self.raw.get_physical_device_queue_family_properties(physical))
        };
        let (heaps, memory, free) = self.heaps(physical);
        let vk::ConformanceVersion { major, minor, subminor, patch } = driver.conformance_version;
        let text = |text: Result<&CStr, _>| text.unwrap_or(c"").to_string_lossy().into_owned();
        let version = base.api_version;
        DeviceInfo {
            index,
            name: text(base.device_name_as_c_str()),
            uuid: id.device_uuid,
            kind: match base.device_type {
                vk::PhysicalDeviceType::DISCRETE_GPU => DeviceKind::Discrete,
                vk::PhysicalDeviceType::INTEGRATED_GPU => DeviceKind::Integrated,
                vk::PhysicalDeviceType::VIRTUAL_GPU => DeviceKind::Virtual,
                vk::PhysicalDeviceType::CPU => DeviceKind::Cpu,
                _ => DeviceKind::Other,
            },
            api: [
                vk::api_version_major(version),
                vk::api_version_minor(version),
                vk::api_version_patch(version),
            ],
            driver: format!(
                "{} {}",
                text(driver.driver_name_as_c_str()),
                text(driver.driver_info_as_c_str())
            ),
            conformance: [major, minor, subminor, patch],
            memory,
            free,
            families,
            heaps,
            limits: base.limits,
            lacks: lacks(&self.raw, physical, &base),
            physical,
        }
    }

    /// Whether the buffers of a device can have addresses.
    pub(super) fn has_addresses(&self, physical: vk::PhysicalDevice) -> bool {
        let mut vulkan12 = vk::PhysicalDeviceVulkan12Features::default();
        let mut features = vk::PhysicalDeviceFeatures2::default().push_next(&mut vulkan12);
        // SAFETY: the device belongs to this instance, and offers Vulkan 1.2.
        unsafe { self.raw.get_physical_device_features2(physical, &mut features) };
        vulkan12.buffer_device_address == vk::TRUE
    }

    /// Returns a device's heaps, the size of its largest local heap in bytes, and the number of
    /// unused bytes in that heap.
    fn heaps(
        &self,
        physical: vk::PhysicalDevice,
    ) -> (vk::PhysicalDeviceMemoryProperties, u64, u64) {
        // SAFETY: the device belongs to this instance.
        let known =
            unsafe { self.raw.enumerate_device_extension_properties(physical) }.unwrap_or_default();
        let reports_budget = names(&known, ext::memory_budget::NAME).is_some();
        let mut budgets = vk::PhysicalDeviceMemoryBudgetPropertiesEXT::default();
        let mut memory = vk::PhysicalDeviceMemoryProperties2::default();
        if reports_budget {
            memory = memory.push_next(&mut budgets);
        }
        // SAFETY: the device belongs to this instance, and offers the extension whose data is
        // requested.
        unsafe { self.raw.get_physical_device_memory_properties2(physical, &mut memory) };
        let memory = memory.memory_properties;
        let heaps = memory.memory_heaps_as_slice().iter().enumerate();
        let local =
            heaps.filter(|(_, heap)| heap.flags.contains(vk::MemoryHeapFlags::DEVICE_LOCAL));
        let Some((i, heap)) = local.max_by_key(|(_, heap)| heap.size) else {
            return (memory, 0, 0);
        };
        let free = budgets.heap_budget[i].saturating_sub(budgets.heap_usage[i]);
        (memory, heap.size, if reports_budget { free.min(heap.size) } else { heap.size })
    }
}

/// Returns `name` if it is the name of one of the `extensions`.
pub(super) fn names(
    extensions: &[vk::ExtensionProperties],
    name: &'static CStr,
) -> Option<&'static CStr> {
    extensions.iter().any(|known| known.extension_name_as_c_str() == Ok(name)).then_some(name)
}

/// Returns the first requirement that a device does not meet; `None` if it meets all requirements.
pub(super) fn lacks(
    instance: &ash::Instance,
    physical: vk::PhysicalDevice,
    properties: &vk::PhysicalDeviceProperties,
) -> Option<&'static str> {
    if properties.api_version < vk::API_VERSION_1_2 {
        return Some("it does not support Vulkan 1.2");
    }
    let mut vulkan12 = vk::PhysicalDeviceVulkan12Features::default();
    let mut features = vk::PhysicalDeviceFeatures2::default().push_next(&mut vulkan12);
    // SAFETY: the device belongs to this instance, and offers Vulkan 1.2.
    let families = unsafe {
        instance.get_physical_device_features2(physical, &mut features);
        instance.get_physical_device_queue_family_properties(physical)
    };
    let computes = |f: &vk::QueueFamilyProperties| f.queue_flags.contains(vk::QueueFlags::COMPUTE);
    let limits = &properties.limits;
    match () {
        () if vulkan12.timeline_semaphore == vk::FALSE => {
            Some("it does not support timeline semaphores")
        }
        () if vulkan12.host_query_reset == vk::FALSE => {
            Some("it does not support host query reset")
        }
        () if !families.iter().any(computes) => Some("it has no compute queue"),
        () if limits
            .max_compute_work_group_invocations
            .min(limits.max_compute_work_group_size[0])
            < MOST_THREADS =>
        {
            Some("its work groups are too small")
        }
        () if limits.max_compute_shared_memory_size < MOST_SHARED => {
            Some("its shared memory is too small")
        }
        () if limits.max_per_stage_descriptor_storage_buffers < MOST_BUFFERS => {
            Some("it supports too few storage buffers per shader")
        }
        () if limits.max_storage_buffer_range < 1 << 27 => {
            Some("its storage buffers are too small")
        }
        () => None,
    }
}

impl Drop for Instance {
    fn drop(&mut self) {
        // SAFETY: every device holds a reference to its instance, so all devices are already
        // destroyed when the instance is dropped.
        unsafe {
            if let Some((debug, messenger)) = &self.messenger {
                debug.destroy_debug_utils_messenger(*messenger, None);
            }
            self.raw.destroy_instance(None);
        }
    }
}

impl fmt::Debug for Instance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Instance").finish_non_exhaustive()
    }
}

fn messenger_info(log: &ValidationLog) -> vk::DebugUtilsMessengerCreateInfoEXT<'static> {
    vk::DebugUtilsMessengerCreateInfoEXT::default()
        .message_severity(
            vk::DebugUtilsMessageSeverityFlagsEXT::ERROR
                | vk::DebugUtilsMessageSeverityFlagsEXT::WARNING,
        )
        .message_type(
            // Messages of the loader (GENERAL), for example about drivers that cannot be opened,
            // are not errors of this program.
            vk::DebugUtilsMessageTypeFlagsEXT::VALIDATION
                | vk::DebugUtilsMessageTypeFlagsEXT::PERFORMANCE,
        )
        .pfn_user_callback(Some(log_message))
        .user_data(Arc::as_ptr(&log.0).cast_mut().cast())
}

/// Appends a message to the log that `log` points to.
unsafe extern "system" fn log_message(
    _: vk::DebugUtilsMessageSeverityFlagsEXT,
    _: vk::DebugUtilsMessageTypeFlagsEXT,
    data: *const vk::DebugUtilsMessengerCallbackDataEXT<'_>,
    log: *mut c_void,
) -> vk::Bool32 {
    // SAFETY: the layer passes a valid message, and the log lives as long as its instance.
    let (message, log) = unsafe {
        (CStr::from_ptr((*data).p_message), &*log.cast::<Mutex<Vec<String>>>().cast_const())
    };
    log.lock().unwrap_or_else(PoisonError::into_inner).push(message.to_string_lossy().into_owned());
    vk::FALSE
}
