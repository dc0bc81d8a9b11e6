//! Returns freed memory to the system after each call.

/// Returns freed memory from the C library's allocator to the system. Otherwise the caller's
/// process would keep the memory of a frame.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
pub fn return_memory() {
    // SAFETY: `malloc_trim` takes a number, and any thread may call it at any time.
    unsafe { libc::malloc_trim(0) };
}

/// No-op with other allocators, which return freed memory themselves.
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
pub fn return_memory() {}

/// Returns freed memory to the system when it is dropped. As the last field of a structure, it is
/// dropped after the other fields.
pub struct ReturnMemory;

impl Drop for ReturnMemory {
    fn drop(&mut self) {
        return_memory();
    }
}
