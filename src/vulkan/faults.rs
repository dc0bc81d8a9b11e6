//! Planned failures, for tests of the recovery from failures.

use std::sync::atomic::{AtomicU64, Ordering};

/// For each kind of call, the number of the call that fails, counted from 1; 0 if none fails.
#[derive(Debug, Default)]
pub struct Faults {
    /// The allocation that fails for lack of memory.
    pub allocation: AtomicU64,
    /// The submission at which the device is lost.
    pub submission: AtomicU64,
    /// The submission that does not mark its work as finished, although no call reports an error.
    pub completion: AtomicU64,
    /// The barrier to omit, so that earlier results may be invisible to later commands.
    pub barrier: AtomicU64,
}

impl Faults {
    /// Decrements `countdown`; returns whether this call must fail.
    pub(super) fn must_fail(countdown: &AtomicU64) -> bool {
        let count = |left: u64| (left > 0).then(|| left - 1);
        countdown.fetch_update(Ordering::Relaxed, Ordering::Relaxed, count) == Ok(1)
    }
}
