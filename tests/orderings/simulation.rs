//! Tests of the gate of parallel frames. The module `gate` is the library's file. The items before
//! it replace the items that the library's file imports from its parent module.

mod sync {
    pub use loom::sync::{Condvar, Mutex, MutexGuard};
    pub use std::sync::PoisonError;
}

#[path = "../../src/simulation/gate.rs"]
mod gate;

use gate::FrameGate;
use loom::sync::Arc;
use loom::sync::atomic::{AtomicUsize, Ordering};
use loom::thread;

/// Checks that at most `lanes` frames are inside the gate at once, that no other frame is inside
/// together with a frame that must be alone, and that every frame passes.
fn try_gate(lanes: usize, alone: &'static [bool]) {
    let mut model = loom::model::Builder::new();
    // Without a limit on preemptions, the test would not end. With this limit, it tries most
    // orders.
    model.preemption_bound = Some(3);
    model.check(move || {
        let gate = Arc::new(FrameGate::new(lanes, 1));
        let inside = Arc::new(AtomicUsize::new(0));
        let enter = |alone: bool| {
            let (gate, inside) = (Arc::clone(&gate), Arc::clone(&inside));
            thread::spawn(move || {
                let permit = if alone { gate.enter_alone() } else { gate.enter() };
                let others = inside.fetch_add(1, Ordering::SeqCst);
                assert!(others < if alone { 1 } else { lanes }, "{others} other frames are inside");
                inside.fetch_sub(1, Ordering::SeqCst);
                drop(permit);
            })
        };
        let threads: Vec<_> = alone.iter().map(|&alone| enter(alone)).collect();
        threads.into_iter().for_each(|thread| thread.join().unwrap());
    });
}

#[test]
fn parallel_frames_and_exclusive_frames_all_pass_the_gate() {
    try_gate(2, &[false, false, true]);
}

#[test]
fn exclusive_frames_pass_the_gate_one_by_one() {
    try_gate(2, &[true, true, false]);
    try_gate(1, &[true, false]);
}

#[test]
fn a_full_gate_admits_the_next_frame_after_one_leaves() {
    try_gate(1, &[false, false, false]);
}
