//! Failures on demand, so that what happens after them can be tested.

use std::sync::atomic::{AtomicU64, Ordering};

/// The calls that are to fail, counted from 1; 0 for none.
#[derive(Debug, Default)]
pub struct Faults {
    /// The allocation that finds no memory.
    pub allocation: AtomicU64,
    /// The submission at which the device is lost, for good.
    pub submission: AtomicU64,
    /// The submission whose work is never done, though nothing says so.
    pub completion: AtomicU64,
    /// The barrier that is left out, so that what follows need not see what came before.
    pub barrier: AtomicU64,
}

impl Faults {
    /// Counts one call down, and says whether it is the one to fail.
    pub(super) fn strikes(countdown: &AtomicU64) -> bool {
        let count = |left: u64| (left > 0).then(|| left - 1);
        countdown.fetch_update(Ordering::Relaxed, Ordering::Relaxed, count) == Ok(1)
    }
}
