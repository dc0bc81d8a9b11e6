//! Resources of the machine: memory and its limit, scratch files, time, cancellation, and bits of
//! words.

pub(crate) mod bits;
pub mod cancel;
pub mod control;
pub(crate) mod held;
pub mod memory;
pub mod past_cache;
pub mod reopened;
pub mod scratch;
pub mod timings;
