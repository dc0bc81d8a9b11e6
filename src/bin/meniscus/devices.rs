//! `meniscus devices`: what Vulkan devices there are.

use clap::Args;
use meniscus::error::Error;
use meniscus::vulkan::{DeviceInfo, Instance};
use serde_json::json;

use crate::Verdict;

#[derive(Args)]
pub struct Options {
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(options: &Options) -> Result<Verdict, Error> {
    let devices = Instance::connect(false)?.devices()?;
    if options.json {
        crate::print_json(&devices.iter().map(record).collect::<Vec<_>>())?;
    } else if devices.is_empty() {
        crate::print("no Vulkan device: the loader knows none")?;
    }
    for device in devices.iter().filter(|_| !options.json) {
        let usable = device.lacks.map_or(String::new(), |lacks| format!("; cannot be used: {lacks}"));
        let usable = if device.is_conformant() { usable } else { format!("; not conformant{usable}") };
        crate::print(&format!(
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
    json!({
        "index": device.index,
        "name": device.name,
        "kind": device.kind.to_string(),
        "vulkan": version(device),
        "driver": device.driver,
        "conformance": device.conformance.map(|part| part.to_string()).join("."),
        "memory_bytes": device.memory,
        "free_bytes": device.free,
        "usable": device.lacks.is_none(),
        "lacks": device.lacks,
    })
}
