//! A gate that runs small frames in parallel, and large ones alone.

use std::sync::OnceLock;

use rayon::{ThreadPool, ThreadPoolBuilder};

// These are the types of the standard library, except in a test that checks many interleavings of
// the threads.
use super::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// Lets several frames run in parallel, or one frame alone.
#[derive(Debug)]
pub(super) struct FrameGate {
    lanes: usize,
    threads: usize,
    /// The thread pool for a frame that runs alone.
    full_pool: OnceLock<Option<ThreadPool>>,
    state: Mutex<GateState>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct GateState {
    lanes_in_use: usize,
    waiting_to_run_alone: usize,
}

/// A permit to compute, which is returned on drop.
#[derive(Debug)]
pub(super) struct Permit<'a> {
    gate: &'a FrameGate,
    lanes: usize,
}

impl FrameGate {
    /// Makes a gate for `lanes` lanes. A frame that runs alone uses `threads` threads.
    pub(super) fn new(lanes: usize, threads: usize) -> Self {
        let (full_pool, state, changed) = (OnceLock::new(), Mutex::default(), Condvar::new());
        Self { lanes, threads, full_pool, state, changed }
    }

    /// The threads of a frame that runs alone; `None` if the system cannot start them.
    fn full_pool(&self) -> Option<&ThreadPool> {
        let start = || ThreadPoolBuilder::new().num_threads(self.threads).build().ok();
        self.full_pool.get_or_init(start).as_ref()
    }

    fn state(&self) -> MutexGuard<'_, GateState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits for a free lane. Frames that must run alone have priority, because they could
    /// otherwise wait forever.
    pub(super) fn enter(&self) -> Permit<'_> {
        let mut state = self.state();
        while state.waiting_to_run_alone > 0 || state.lanes_in_use == self.lanes {
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        state.lanes_in_use += 1;
        Permit { gate: self, lanes: 1 }
    }

    /// Waits until no other frame has a permit.
    pub(super) fn enter_alone(&self) -> Permit<'_> {
        let mut state = self.state();
        state.waiting_to_run_alone += 1;
        while state.lanes_in_use > 0 {
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        state.waiting_to_run_alone -= 1;
        state.lanes_in_use = self.lanes;
        Permit { gate: self, lanes: self.lanes }
    }
}

impl Permit<'_> {
    /// Runs `act` with the threads of this lane or, if the frame runs alone, with all threads.
    pub(super) fn run<T: Send>(&self, act: impl FnOnce() -> T + Send) -> T {
        let alone = self.lanes == self.gate.lanes;
        match alone.then(|| self.gate.full_pool()).flatten() {
            Some(pool) => pool.install(act),
            None => act(),
        }
    }
}

impl Drop for Permit<'_> {
    fn drop(&mut self) {
        self.gate.state().lanes_in_use -= self.lanes;
        self.gate.changed.notify_all();
    }
}
