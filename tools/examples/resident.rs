//! Shows how a program with its own Vulkan device uses the library without copies to the host: it
//! passes its buffer of positions, and receives vertices and indices in its own buffers. All waits
//! happen on the device: the library waits for the positions, and drawing waits for the surface.
//!
//! `cargo run --release --example resident -- OUTPUT.ply [NUMBER]` meshes a ball of particles on
//! the first device, or on the device with this number in `meniscus devices`. The device may be a
//! driver that computes on the CPU, such as lavapipe.

use std::error::Error;

use ash::vk;
use meniscus::devices::{
    Coordinate, Device, DeviceOptions, DevicePositions, DeviceRequest, Exchange, ExternalDevice,
    InvalidParticles, Pipeline, SemaphorePoint, Surfacing,
};
use meniscus::error::FrameError;
use meniscus::{Grid, IndicatorKind};

/// The vertices and the triangles of a surface.
pub type Surface = (Vec<[f32; 3]>, Vec<[u32; 3]>);

#[allow(dead_code, reason = "a test uses only the other functions")]
fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().ok_or("usage: resident OUTPUT.ply [DEVICE]")?;
    let number = arguments.next().map_or(Ok(0), |number| number.parse())?;
    let steps = || (-40..40).map(|i| i as f32 + 0.5);
    let lattice = steps().flat_map(|x| steps().flat_map(move |y| steps().map(move |z| [x, y, z])));
    let ball: Vec<[f32; 3]> =
        lattice.filter(|p| p.iter().map(|c| c * c).sum::<f32>() < 1000.0).collect();
    let (vertices, triangles) = surface_of(number, &ball, 1.0)?;
    println!(
        "{} particles, {} vertices, {} triangles",
        ball.len(),
        vertices.len(),
        triangles.len()
    );
    let mut ply = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
         element face {}\nproperty list uchar uint vertex_indices\nend_header\n",
        vertices.len(),
        triangles.len()
    );
    vertices.iter().for_each(|[x, y, z]| ply += &format!("{x} {y} {z}\n"));
    triangles.iter().for_each(|[a, b, c]| ply += &format!("3 {a} {b} {c}\n"));
    Ok(std::fs::write(path, ply)?)
}

/// A buffer of the program, in memory that the host can access.
struct Own {
    raw: vk::Buffer,
    memory: vk::DeviceMemory,
    bytes: u64,
    /// The address of the buffer's memory on the host.
    mapped: *mut u8,
}

/// The program's device and queue.
struct Program {
    instance: ash::Instance,
    physical: vk::PhysicalDevice,
    device: ash::Device,
    family: u32,
    queue: vk::Queue,
}

impl Program {
    /// # Safety
    /// The caller must destroy the buffer before the device.
    unsafe fn buffer(&self, bytes: u64) -> Result<Own, Box<dyn Error>> {
        let usage = vk::BufferUsageFlags::STORAGE_BUFFER
            | vk::BufferUsageFlags::TRANSFER_SRC
            | vk::BufferUsageFlags::TRANSFER_DST;
        let wanted = vk::MemoryPropertyFlags::HOST_VISIBLE | vk::MemoryPropertyFlags::HOST_COHERENT;
        // SAFETY: all handles belong to this device.
        unsafe {
            let info = vk::BufferCreateInfo::default().size(bytes).usage(usage);
            let raw = self.device.create_buffer(&info, None)?;
            let needs = self.device.get_buffer_memory_requirements(raw);
            let known = self.instance.get_physical_device_memory_properties(self.physical);
            let mut kinds = known.memory_types_as_slice().iter().zip(0..);
            let fits = |(kind, i): &(&vk::MemoryType, u32)| {
                needs.memory_type_bits >> i & 1 == 1 && kind.property_flags.contains(wanted)
            };
            let (_, kind) = kinds.find(fits).ok_or("no memory that the host can access")?;
            let info = vk::MemoryAllocateInfo::default()
                .allocation_size(needs.size)
                .memory_type_index(kind);
            let memory = self.device.allocate_memory(&info, None)?;
            self.device.bind_buffer_memory(raw, memory, 0)?;
            let mapped =
                self.device.map_memory(memory, 0, vk::WHOLE_SIZE, vk::MemoryMapFlags::empty())?;
            Ok(Own { raw, memory, bytes, mapped: mapped.cast() })
        }
    }

    /// # Safety
    /// Nothing may use the buffer during or after the call.
    unsafe fn destroy(&self, buffer: &Own) {
        // SAFETY: all handles belong to this device.
        unsafe {
            self.device.destroy_buffer(buffer.raw, None);
            self.device.free_memory(buffer.memory, None);
        }
    }

    /// Submits a copy from one buffer to another of the same size. The copy waits for one value of
    /// a timeline semaphore, and signals another.
    ///
    /// # Safety
    /// All objects must exist until the copy has finished.
    unsafe fn copy(
        &self,
        pool: vk::CommandPool,
        [from, to]: [&Own; 2],
        timeline: vk::Semaphore,
        [wait, signal]: [u64; 2],
    ) -> Result<(), vk::Result> {
        // SAFETY: all handles belong to this device.
        unsafe {
            let info =
                vk::CommandBufferAllocateInfo::default().command_pool(pool).command_buffer_count(1);
            let commands = self.device.allocate_command_buffers(&info)?;
            self.device
                .begin_command_buffer(commands[0], &vk::CommandBufferBeginInfo::default())?;
            let region = [vk::BufferCopy::default().size(from.bytes)];
            self.device.cmd_copy_buffer(commands[0], from.raw, to.raw, &region);
            self.device.end_command_buffer(commands[0])?;
            let (semaphores, waits, signals) = ([timeline], [wait], [signal]);
            let mut values = vk::TimelineSemaphoreSubmitInfo::default()
                .wait_semaphore_values(&waits)
                .signal_semaphore_values(&signals);
            let info = vk::SubmitInfo::default()
                .wait_semaphores(&semaphores)
                .wait_dst_stage_mask(&[vk::PipelineStageFlags::TRANSFER])
                .command_buffers(&commands)
                .signal_semaphores(&semaphores)
                .push_next(&mut values);
            self.device.queue_submit(self.queue, &[info], vk::Fence::null())
        }
    }
}

/// Simulates, meshes and draws on a new device, for the physical device with this number in the
/// loader's list.
pub fn surface_of(
    number: usize,
    particles: &[[f32; 3]],
    cell: f64,
) -> Result<Surface, Box<dyn Error>> {
    // SAFETY: each handle is destroyed once, before the handles from which it was created.
    unsafe {
        let entry = ash::Entry::load()?;
        let application = vk::ApplicationInfo::default().api_version(vk::API_VERSION_1_2);
        let instance = entry.create_instance(
            &vk::InstanceCreateInfo::default().application_info(&application),
            None,
        )?;
        let devices = instance.enumerate_physical_devices()?;
        let physical = *devices.get(number).ok_or("no such Vulkan device")?;
        let families = instance.get_physical_device_queue_family_properties(physical);
        let computes =
            |f: &vk::QueueFamilyProperties| f.queue_flags.contains(vk::QueueFlags::COMPUTE);
        let family = families.iter().position(computes).ok_or("no queue for compute")? as u32;
        let queues = [vk::DeviceQueueCreateInfo::default()
            .queue_family_index(family)
            .queue_priorities(&[1.0])];
        let mut features = vk::PhysicalDeviceVulkan12Features::default().timeline_semaphore(true);
        let info =
            vk::DeviceCreateInfo::default().queue_create_infos(&queues).push_next(&mut features);
        let device = instance.create_device(physical, &info, None)?;
        let queue = device.get_device_queue(family, 0);
        let program = Program { instance, physical, device, family, queue };

        let surface = simulate_and_draw(&program, particles, cell);

        program.device.device_wait_idle()?;
        program.device.destroy_device(None);
        program.instance.destroy_instance(None);
        surface
    }
}

/// Values of the program's timeline semaphore: the stages of a frame.
const SIMULATED: u64 = 1;
const MESHED: u64 = 2;
const READ: u64 = 3;

/// # Safety
/// Nothing else may use the device.
unsafe fn simulate_and_draw(
    program: &Program,
    particles: &[[f32; 3]],
    cell: f64,
) -> Result<Surface, Box<dyn Error>> {
    let Program { instance, physical, device, family, queue } = program;
    let bytes: &[u8] = bytemuck::cast_slice(particles);
    // SAFETY: all handles belong to this device, and are destroyed after the device has used them.
    unsafe {
        let info = vk::CommandPoolCreateInfo::default().queue_family_index(*family);
        let pool = device.create_command_pool(&info, None)?;
        let mut kind =
            vk::SemaphoreTypeCreateInfo::default().semaphore_type(vk::SemaphoreType::TIMELINE);
        let timeline = device
            .create_semaphore(&vk::SemaphoreCreateInfo::default().push_next(&mut kind), None)?;

        // The simulation writes its particles to a storage buffer, and the host does not wait for
        // the end of the simulation.
        let simulated = program.buffer(bytes.len() as u64)?;
        let positions = program.buffer(bytes.len() as u64)?;
        simulated.mapped.copy_from_nonoverlapping(bytes.as_ptr(), bytes.len());
        program.copy(pool, [&simulated, &positions], timeline, [0, SIMULATED])?;

        let (instance, device) = (instance.clone(), device.clone());
        let foreign = ExternalDevice {
            instance,
            physical: *physical,
            device,
            family: *family,
            queue: *queue,
        };
        let library = Device::adopt(foreign, &DeviceOptions::default())?;
        let pipeline = Pipeline::new(&library)?;
        let view = library.external_buffer(positions.raw, positions.bytes).whole();
        let input =
            [DevicePositions { view, count: particles.len(), coordinate: Coordinate::Single }];
        let settings = DeviceRequest {
            grid: Grid::new([0.0; 3].into(), cell)?,
            domain: None,
            indicator: IndicatorKind::Symmetry,
            mean: None,
            invalid: InvalidParticles::Refuse,
            spacing: Some(cell),
            surfacing: Surfacing::PLAIN,
            calibration: None,
        };
        let moment = |value| SemaphorePoint { semaphore: timeline, value };
        // The renderer creates the buffers for the surface, and replaces them with larger ones if
        // the surface needs more space.
        let mut rows = [1_u64, 1];
        let (outputs, [vertices, triangles]) = loop {
            let own = [program.buffer(12 * rows[0])?, program.buffer(12 * rows[1])?];
            let into =
                own.each_ref().map(|own| library.external_buffer(own.raw, own.bytes).whole());
            let exchange = Exchange {
                wait: &[moment(SIMULATED)],
                signal: &[moment(MESHED)],
                into: Some(into.each_ref()),
            };
            match pipeline.surface_between(&input, &settings, &exchange) {
                Err(FrameError::NoSpace { vertices, triangles }) => {
                    own.iter().for_each(|own| program.destroy(own));
                    rows = [vertices.into(), triangles.into()];
                }
                surface => {
                    let surface = surface?;
                    let found = [surface.vertices, surface.triangles];
                    let read = [program.buffer(own[0].bytes)?, program.buffer(own[1].bytes)?];
                    // The device, not the host, waits for the surface before it draws.
                    program.copy(pool, [&own[0], &read[0]], timeline, [MESHED, READ])?;
                    program.copy(pool, [&own[1], &read[1]], timeline, [READ, READ + 1])?;
                    break ([own, read], found);
                }
            }
        };
        let device = &program.device;
        let (timelines, values) = ([timeline], [READ + 1]);
        let done = vk::SemaphoreWaitInfo::default().semaphores(&timelines).values(&values);
        device.wait_semaphores(&done, u64::MAX)?;
        let [_, [read_vertices, read_triangles]] = &outputs;
        let surface = (
            std::slice::from_raw_parts(read_vertices.mapped.cast(), vertices as usize).to_vec(),
            std::slice::from_raw_parts(read_triangles.mapped.cast(), triangles as usize).to_vec(),
        );
        drop((pipeline, input, library));
        let buffers = outputs.iter().flatten().chain([&simulated, &positions]);
        buffers.for_each(|buffer| program.destroy(buffer));
        device.destroy_semaphore(timeline, None);
        device.destroy_command_pool(pool, None);
        Ok(surface)
    }
}
