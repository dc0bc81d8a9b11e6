//! How much of what is freed the C library's allocator keeps.

/// Keeps up to 8 MiB a thread for whoever allocates next. A frame, and a block of one that exceeds its memory, frees what
/// the next allocates again: given back to the system in between, it would return a page at a time, a fault each.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
pub fn keep_freed() {
    for (parameter, bytes) in [(libc::M_MMAP_THRESHOLD, 1 << 20), (libc::M_TRIM_THRESHOLD, 8 << 20)] {
        // SAFETY: takes two numbers, before any other thread is started. Where it refuses, all stays as it was.
        unsafe { libc::mallopt(parameter, bytes) };
    }
}

/// Others keep what they keep.
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
pub fn keep_freed() {}
