//! A program with a Vulkan device of its own: its buffer of positions in, buffers of vertices and indices out.
//!
//! `cargo run --release --example resident -- OUTPUT.ply` meshes a ball of particles on the first device, which may
//! be a driver that computes on the processor, such as lavapipe.

use std::error::Error;

use ash::vk;
use meniscus::brick::InvalidParticles;
use meniscus::brick::vulkan::{Coordinate, DevicePositions};
use meniscus::frame::Surfacing;
use meniscus::frame::resident::{Pipeline, Settings};
use meniscus::grid::Grid;
use meniscus::stage::indicator::IndicatorKind;
use meniscus::vulkan::{Device, DeviceOptions, Foreign, Place, Queue};

/// The vertices and the triangles of a surface.
pub type Surface = (Vec<[f32; 3]>, Vec<[u32; 3]>);

#[allow(dead_code, reason = "a test has the rest")]
fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args().nth(1).ok_or("usage: resident OUTPUT.ply")?;
    let steps = || (-40..40).map(|i| i as f32 + 0.5);
    let lattice = steps().flat_map(|x| steps().flat_map(move |y| steps().map(move |z| [x, y, z])));
    let ball: Vec<[f32; 3]> = lattice.filter(|p| p.iter().map(|c| c * c).sum::<f32>() < 1000.0).collect();
    let (vertices, triangles) = surface_of(&ball, 1.0)?;
    println!("{} particles, {} vertices, {} triangles", ball.len(), vertices.len(), triangles.len());
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

/// Does on a device of its own what a simulation or a renderer does on its.
pub fn surface_of(particles: &[[f32; 3]], cell: f64) -> Result<Surface, Box<dyn Error>> {
    let bytes: &[u8] = bytemuck::cast_slice(particles);
    // SAFETY: every handle is used while those that it was made from are alive, and destroyed once, in order.
    unsafe {
        let entry = ash::Entry::load()?;
        let application = vk::ApplicationInfo::default().api_version(vk::API_VERSION_1_2);
        let instance =
            entry.create_instance(&vk::InstanceCreateInfo::default().application_info(&application), None)?;
        let physical = *instance.enumerate_physical_devices()?.first().ok_or("no Vulkan device")?;
        let families = instance.get_physical_device_queue_family_properties(physical);
        let computes = |f: &vk::QueueFamilyProperties| f.queue_flags.contains(vk::QueueFlags::COMPUTE);
        let family = families.iter().position(computes).ok_or("no queue for compute")? as u32;
        let queues =
            [vk::DeviceQueueCreateInfo::default().queue_family_index(family).queue_priorities(&[1.0])];
        let mut features = vk::PhysicalDeviceVulkan12Features::default().timeline_semaphore(true);
        let device = instance.create_device(
            physical,
            &vk::DeviceCreateInfo::default().queue_create_infos(&queues).push_next(&mut features),
            None,
        )?;

        // The particles, as a simulation on the device would leave them in a storage buffer.
        let info = vk::BufferCreateInfo::default()
            .size(bytes.len() as u64)
            .usage(vk::BufferUsageFlags::STORAGE_BUFFER | vk::BufferUsageFlags::TRANSFER_SRC);
        let buffer = device.create_buffer(&info, None)?;
        let needs = device.get_buffer_memory_requirements(buffer);
        let wanted = vk::MemoryPropertyFlags::HOST_VISIBLE | vk::MemoryPropertyFlags::HOST_COHERENT;
        let kind = instance
            .get_physical_device_memory_properties(physical)
            .memory_types_as_slice()
            .iter()
            .enumerate()
            .position(|(i, kind)| {
                needs.memory_type_bits >> i & 1 == 1 && kind.property_flags.contains(wanted)
            })
            .ok_or("no memory that both sides see")? as u32;
        let info = vk::MemoryAllocateInfo::default().allocation_size(needs.size).memory_type_index(kind);
        let memory = device.allocate_memory(&info, None)?;
        device.bind_buffer_memory(buffer, memory, 0)?;
        let mapped = device.map_memory(memory, 0, vk::WHOLE_SIZE, vk::MemoryMapFlags::empty())?;
        mapped.cast::<u8>().copy_from_nonoverlapping(bytes.as_ptr(), bytes.len());
        device.unmap_memory(memory);

        let foreign = Foreign {
            instance: instance.clone(),
            physical,
            device: device.clone(),
            family,
            queue: device.get_device_queue(family, 0),
        };
        let surface = mesh(foreign, buffer, particles.len(), cell);

        device.destroy_buffer(buffer, None);
        device.free_memory(memory, None);
        device.destroy_device(None);
        instance.destroy_instance(None);
        surface
    }
}

/// # Safety
/// As [`Device::adopt`]; the buffer holds so many positions of three f32.
unsafe fn mesh(
    foreign: Foreign,
    buffer: vk::Buffer,
    count: usize,
    cell: f64,
) -> Result<Surface, Box<dyn Error>> {
    // SAFETY: the caller keeps the device and the buffer until this function is done, and nobody else submits.
    let (device, positions) = unsafe {
        let device = Device::adopt(foreign, &DeviceOptions::default())?;
        let positions = device.foreign_buffer(buffer, 12 * count as u64);
        (device, positions)
    };
    let pipeline = Pipeline::new(&device)?;
    let positions = DevicePositions { view: positions.whole(), count, coordinate: Coordinate::Single };
    let settings = Settings {
        grid: Grid::new([0.0; 3].into(), cell)?,
        domain: None,
        indicator: IndicatorKind::Symmetry.into(),
        invalid: InvalidParticles::Refuse,
        spacing: Some(cell),
        surfacing: Surfacing::PLAIN,
    };
    let surface = pipeline.surface(&[positions], &settings)?;

    // A renderer would bind `surface.positions.raw()` and `surface.indices.raw()`; this program wants to see them.
    let mut batch = device.batch(Queue::Transfer)?;
    batch.begin()?;
    let [vertices, indices] = [&surface.positions, &surface.indices].map(|buffer| {
        let read = device.buffer(Place::Download, buffer.bytes())?.whole();
        batch.copy(&buffer.whole(), &read);
        Ok::<_, meniscus::vulkan::VulkanError>(read)
    });
    let (vertices, indices) = (vertices?, indices?);
    batch.submit(&[])?;
    batch.wait()?;
    Ok((vertices.read(0, surface.vertices as usize), indices.read(0, surface.triangles as usize)))
}
