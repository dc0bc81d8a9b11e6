//! `meniscus devices`: the Vulkan devices of this machine.

use clap::Args;
use meniscus::Error;
use meniscus::devices::{DeviceInfo, Instance};
use serde_json::json;

use super::notes::Verdict;

#[derive(Args)]
pub struct DevicesOptions {
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// Runs `meniscus devices`.
pub fn run(options: &DevicesOptions) -> Result<Verdict, Error> {
    let devices = Instance::connect(false)?.devices()?;
    if options.json {
        super::notes::print_json(&devices.iter().map(record).collect::<Vec<_>>())?;
    } else if devices.is_empty() {
        super::notes::print("no Vulkan device found; install a Vulkan driver to use a GPU")?;
    }
    for device in devices.iter().filter(|_| !options.json) {
        let usable =
            device.lacks.map_or(String::new(), |lacks| format!("; cannot be used: {lacks}"));
        let usable = if device.is_conformant() {
            usable
        } else {
            format!("; has not passed the Vulkan conformance tests{usable}")
        };
        super::notes::print(&format!(
            "{} {}: {}, Vulkan {}, {}, {}{usable}",
            device.index,
            device.name,
            device.kind,
            version(device),
            bytesize::ByteSize(device.memory),
            device.driver,
        ))?;
    }
    Ok(Verdict::Good)
}

fn version(device: &DeviceInfo) -> String {
    device.api.map(|part| part.to_string()).join(".")
}

fn record(device: &DeviceInfo) -> serde_json::Value {
    let families = device.families.iter().map(|family| {
        json!({
            "flags": format!("{:?}", family.queue_flags),
            "queues": family.queue_count,
            "timestamp_bits": family.timestamp_valid_bits,
        })
    });
    let heaps = device.heaps.memory_heaps_as_slice().iter();
    let heaps =
        heaps.map(|heap| json!({ "bytes": heap.size, "flags": format!("{:?}", heap.flags) }));
    let types = device.heaps.memory_types_as_slice().iter();
    let types = types.map(
        |kind| json!({ "heap": kind.heap_index, "flags": format!("{:?}", kind.property_flags) }),
    );
    let limits = &device.limits;
    json!({
        "index": device.index,
        "name": device.name,
        "uuid": device.uuid_digits(),
        "kind": device.kind.to_string(),
        "vulkan": version(device),
        "driver": device.driver,
        "conformance": device.conformance.map(|part| part.to_string()).join("."),
        "memory_bytes": device.memory,
        "free_bytes": device.free,
        "queue_families": families.collect::<Vec<_>>(),
        "memory_heaps": heaps.collect::<Vec<_>>(),
        "memory_types": types.collect::<Vec<_>>(),
        "limits": {
            "storage_buffer_bytes": limits.max_storage_buffer_range,
            "storage_buffer_alignment": limits.min_storage_buffer_offset_alignment,
            "work_group_threads": limits.max_compute_work_group_invocations,
            "work_group_size": limits.max_compute_work_group_size,
            "work_groups": limits.max_compute_work_group_count,
            "shared_memory_bytes": limits.max_compute_shared_memory_size,
            "allocations": limits.max_memory_allocation_count,
            "timestamp_nanoseconds": limits.timestamp_period,
        },
        "usable": device.lacks.is_none(),
        "lacks": device.lacks,
    })
}
