//! Resources of the machine: memory and its budget, scratch files, time, and an early end.

pub mod cancel;
pub mod control;
pub mod memory;
pub mod positioned;
pub mod reopened;
pub mod scratch;
pub mod timings;
