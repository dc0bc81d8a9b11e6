//! The allocator of these tests, which refuses large blocks and measures the allocations of a call.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::atomic::{AtomicBool, AtomicIsize, Ordering};

/// Size, in bytes, of the largest block that tests may allocate. A request for a larger block means
/// that a reader trusts a size in a file's header.
const LARGEST_BLOCK: usize = 64 << 20;

thread_local! {
    /// Size, in bytes, of the largest block that this thread has requested since
    /// [`largest_allocation`] began.
    static LARGEST: Cell<usize> = const { Cell::new(0) };
    static UNLIMITED: Cell<bool> = const { Cell::new(false) };
}

/// Whether [`peak_of_process`] is measuring.
static COUNTING: AtomicBool = AtomicBool::new(false);
/// The number of bytes that all threads have allocated and not freed since the measurement began.
static ALLOCATED: AtomicIsize = AtomicIsize::new(0);
/// The peak of [`ALLOCATED`].
static PEAK: AtomicIsize = AtomicIsize::new(0);

struct Meter;

// SAFETY: every call goes to the system allocator or returns null, which means out of memory.
unsafe impl GlobalAlloc for Meter {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        LARGEST.set(LARGEST.get().max(layout.size()));
        if layout.size() > LARGEST_BLOCK && !UNLIMITED.get() {
            return std::ptr::null_mut();
        }
        if COUNTING.load(Ordering::Relaxed) {
            let allocated = ALLOCATED.fetch_add(layout.size() as isize, Ordering::Relaxed)
                + layout.size() as isize;
            PEAK.fetch_max(allocated, Ordering::Relaxed);
        }
        // SAFETY: the caller's guarantees also hold for the system allocator.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        if COUNTING.load(Ordering::Relaxed) {
            ALLOCATED.fetch_sub(layout.size() as isize, Ordering::Relaxed);
        }
        // SAFETY: the caller's guarantees also hold for the system allocator.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static METER: Meter = Meter;

/// Returns the result of `call`, and the size, in bytes, of the largest block that this thread
/// requests during the call.
///
/// During the call, blocks of this thread may be larger than [`LARGEST_BLOCK`], so the caller must
/// check the size.
pub fn largest_allocation<T>(call: impl FnOnce() -> T) -> (T, usize) {
    LARGEST.set(0);
    let result = unlimited(call);
    (result, LARGEST.get())
}

/// Runs `call` without the limit on the blocks of this thread, for tests that create large inputs.
pub fn unlimited<T>(call: impl FnOnce() -> T) -> T {
    UNLIMITED.set(true);
    let result = call();
    UNLIMITED.set(false);
    result
}

/// The maximum number of bytes that all threads together hold during `call`.
///
/// Other tests in the process would be counted too, so the caller must run in its own process.
pub fn peak_of_process(call: impl FnOnce()) -> usize {
    ALLOCATED.store(0, Ordering::Relaxed);
    PEAK.store(0, Ordering::Relaxed);
    COUNTING.store(true, Ordering::Relaxed);
    call();
    COUNTING.store(false, Ordering::Relaxed);
    PEAK.load(Ordering::Relaxed) as usize
}
