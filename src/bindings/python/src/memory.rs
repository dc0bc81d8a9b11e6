//! Returns freed memory to the system after each call.

/// Returns freed memory from the C library's allocator to the system. Otherwise the caller's
/// process would keep the memory of a frame.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
pub fn give_back() {
    // SAFETY: `malloc_trim` takes a number, and any thread may call it at any time.
    unsafe { libc::malloc_trim(0) };
}

/// No-op with other allocators, which return freed memory themselves.
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
pub fn give_back() {}

/// Returns freed memory to the system when it is dropped. As the last field of a structure, it is
/// dropped after the other fields.
pub struct GiveBack;

impl Drop for GiveBack {
    fn drop(&mut self) {
        give_back();
    }
}
