//! Sets up the process: how much freed memory the allocator keeps, what happens if a file exceeds
//! the limit on file sizes, and which threads run the commands.

use std::panic::resume_unwind;
use std::thread;

use rayon::ThreadPoolBuilder;

/// Stack size, in bytes, of each thread that runs a command. 8 MiB is the default of most systems.
const STACK: usize = 8 << 20;

/// Sets up the process, before any other thread is started.
pub fn set_up() {
    keep_freed_memory();
    ignore_sigxfsz();
}

/// Runs `work` on a thread with a stack of `STACK` bytes, independent of the stack limit of the
/// process (`ulimit -s`). Falls back to the current thread if the system cannot start another one.
pub fn on_own_stack<T: Send + 'static>(work: impl FnOnce() -> T + Clone + Send + 'static) -> T {
    match thread::Builder::new().stack_size(STACK).spawn(work.clone()) {
        Ok(worker) => worker.join().unwrap_or_else(|panic| resume_unwind(panic)),
        Err(_) => work(),
    }
}

/// Runs `work` in a new thread pool with one thread per core, for commands that create no thread
/// pool themselves. Falls back to the current thread if the system cannot start threads.
pub fn on_all_cores<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    let threads = || ThreadPoolBuilder::new().stack_size(STACK);
    let on_this_thread = |_| threads().num_threads(1).use_current_thread().build();
    match threads().build().or_else(on_this_thread) {
        Ok(pool) => pool.install(work),
        Err(_) => work(),
    }
}

/// Lets the allocator keep up to 8 MiB of freed memory per thread, instead of returning it to the
/// system. The next frame or block can then reuse the memory without page faults.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
fn keep_freed_memory() {
    for (parameter, bytes) in [(libc::M_MMAP_THRESHOLD, 1 << 20), (libc::M_TRIM_THRESHOLD, 8 << 20)]
    {
        // SAFETY: `mallopt` takes two numbers, and no other thread has started yet. If `mallopt`
        // rejects the numbers, nothing changes.
        unsafe { libc::mallopt(parameter, bytes) };
    }
}

/// No-op on other allocators.
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
fn keep_freed_memory() {}

/// Makes a write beyond the limit on file sizes (`ulimit -f`) an ordinary error, instead of a
/// signal that ends the process.
#[cfg(unix)]
fn ignore_sigxfsz() {
    // SAFETY: SIG_IGN installs no handler that could run, and no other thread has started yet.
    unsafe { libc::signal(libc::SIGXFSZ, libc::SIG_IGN) };
}

#[cfg(not(unix))]
fn ignore_sigxfsz() {}
