//! Memory and its limit, files, time, progress and cancellation, and the bits of words.

pub(crate) mod bits;
pub mod cancel;
pub mod control;
pub(crate) mod held;
pub mod memory;
pub mod past_cache;
pub mod reopened;
pub mod scratch;
pub mod timings;
