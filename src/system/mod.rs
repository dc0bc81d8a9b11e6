//! What the pipeline takes of the machine: memory and its budget, scratch files, time.

pub mod memory;
pub mod scratch;
pub mod timings;
