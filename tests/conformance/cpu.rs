//! The list on the CPU.

use crate::common;
use meniscus::frame::Sampling;

#[path = "oracle.rs"]
mod oracle;
#[path = "sampled.rs"]
mod sampled;
#[path = "surfaces.rs"]
mod surfaces;

fn sampling() -> Sampling {
    common::sampling()
}
