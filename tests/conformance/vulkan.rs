//! The list on the Vulkan device; on the CPU again where there is none and none is demanded.

use crate::common;
use meniscus::frame::Sampling;

#[path = "oracle.rs"]
mod oracle;
#[path = "sampled.rs"]
mod sampled;
#[path = "surfaces.rs"]
mod surfaces;

fn sampling() -> Sampling {
    let mut sampling = common::sampling();
    if let Some(vulkan) = common::device::shared() {
        sampling.resources.backend = vulkan;
    }
    sampling
}
