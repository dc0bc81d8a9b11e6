//! Returns memory to the system after each call.

/// Returns freed memory from the C library's allocator to the system, because the process belongs
/// to the caller and should not keep the memory of a frame.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
pub fn give_back() {
    // SAFETY: takes a number, and may be called by any thread at any time.
    unsafe { libc::malloc_trim(0) };
}

/// Other allocators do this themselves.
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
pub fn give_back() {}

/// Returns memory when it is dropped. Must be the last field of a structure.
pub struct GiveBack;

impl Drop for GiveBack {
    fn drop(&mut self) {
        give_back();
    }
}
