//! Memory that is given back to the system after each call.

/// Gives back what the C library's allocator keeps of what was freed: the process is another's, who
/// does not expect to hold the memory of a frame for good.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
pub fn give_back() {
    // SAFETY: takes a number, and may be called by any thread at any time.
    unsafe { libc::malloc_trim(0) };
}

/// Others give back by themselves.
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
pub fn give_back() {}

/// Gives back what was freed before it, as the last of its fellows.
pub struct GiveBack;

impl Drop for GiveBack {
    fn drop(&mut self) {
        give_back();
    }
}
