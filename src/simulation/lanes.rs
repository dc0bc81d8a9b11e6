//! Divides threads and memory among lanes. Each lane converts one frame at a time, in parallel with
//! the other lanes.

use crate::grid::units::MemoryBudget;

/// Minimum memory, in bytes, of a lane. If the memory is too small for all lanes, fewer lanes are
/// used.
const LEAST_LANE_MEMORY: u64 = 64 << 20;

/// Threads and memory of each lane.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Division {
    /// Number of parallel frames.
    pub(super) lanes: usize,
    /// Number of threads of each lane.
    pub(super) threads: usize,
    /// Memory of a lane while it opens a frame whose size is not known yet.
    pub(super) opening: MemoryBudget,
    /// Memory of a frame that runs in parallel with others.
    pub(super) share: MemoryBudget,
    /// Memory of a frame that runs alone.
    pub(super) alone: MemoryBudget,
}

impl Division {
    /// Divides threads and memory among lanes for `frames` frames. There are at most `threads + 1`
    /// lanes: one more than threads, because frames differ in size and lanes wait for files. For
    /// each thread, `chunk` bytes are reserved.
    pub(super) fn of(frames: usize, threads: usize, budget: MemoryBudget, chunk: u64) -> Self {
        // Each lane has at least one thread, and each thread needs `chunk` bytes.
        let left = |lanes: usize| budget.0.saturating_sub(chunk * threads.max(lanes) as u64);
        let affordable = |lanes: &usize| left(*lanes) / LEAST_LANE_MEMORY >= *lanes as u64;
        let lanes = (1..=frames.min(threads + 1)).rev().find(affordable).unwrap_or(1);
        let budget = MemoryBudget(left(lanes));
        if lanes == 1 {
            return Self { lanes, threads, opening: budget, share: budget, alone: budget };
        }
        let part = |bytes: u64| MemoryBudget(bytes);
        Self {
            lanes,
            threads: (threads / lanes).max(1),
            // A large frame is meshed alone, with three quarters of the budget. Meanwhile, every
            // lane may have opened its next frame, so the lanes share the last quarter.
            opening: part(budget.0 / 4 / lanes as u64),
            share: part(budget.0 / 4 * 3 / lanes as u64),
            alone: part(budget.0 / 4 * 3),
        }
    }

    /// Memory, in bytes, that the particles of a waiting frame may use.
    pub(super) fn unpacked(&self) -> u64 {
        self.opening.0 / 2
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::super::gate::FrameGate;
    use super::*;

    #[test]
    fn every_division_into_lanes_fits_the_budget() {
        for frames in [1, 2, 100] {
            for (threads, chunk) in [(1, 0), (2, 24 << 20), (64, 0), (64, 24 << 20)] {
                for budget in [16 << 20, 100 << 20, 8 << 30, 1 << 40] {
                    let division = Division::of(frames, threads, MemoryBudget(budget), chunk);
                    let Division { lanes, opening, share, alone, .. } = division;
                    if lanes > 1 {
                        let reserved = (lanes * division.threads) as u64 * chunk;
                        assert!(
                            lanes as u64 * (opening.0 + share.0) + reserved <= budget,
                            "{division:?}"
                        );
                        let reserved = threads as u64 * chunk;
                        assert!(
                            lanes as u64 * opening.0 + alone.0 + reserved <= budget,
                            "{division:?}"
                        );
                    }
                    assert!(lanes <= frames);
                    assert!(division.threads >= 1);
                }
            }
        }
    }

    #[test]
    fn a_frame_that_enters_alone_excludes_others_and_does_not_starve() {
        let gate = FrameGate::new(3, 1);
        let inside = AtomicUsize::new(0);
        std::thread::scope(|scope| {
            for thread in 0..6 {
                let (gate, inside) = (&gate, &inside);
                scope.spawn(move || {
                    for turn in 0..200 {
                        if (thread + turn) % 5 == 0 {
                            let _permit = gate.enter_alone();
                            assert_eq!(inside.fetch_add(1, Ordering::SeqCst), 0);
                            std::thread::yield_now();
                            inside.fetch_sub(1, Ordering::SeqCst);
                        } else {
                            let _permit = gate.enter();
                            assert!(inside.fetch_add(1, Ordering::SeqCst) < 3);
                            std::thread::yield_now();
                            inside.fetch_sub(1, Ordering::SeqCst);
                        }
                    }
                });
            }
        });
    }
}
