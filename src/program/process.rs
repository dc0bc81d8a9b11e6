//! Setting up the process: freed memory, the limit on file sizes, and threads.

use std::panic::resume_unwind;
use std::sync::mpsc::channel;
use std::thread;

/// Bytes of the stack of commands: the default size on most systems.
const STACK: usize = 8 << 20;

/// Sets up the process, before any other thread is started.
pub fn set_up() {
    keep_freed();
    outlive_large_files();
}

/// Runs `work` on a thread with a large enough stack, whatever the limit of the process (`ulimit
/// -s`). Falls back to this thread if the system starts no other.
pub fn on_own_stack<T: Send + 'static>(work: impl FnOnce() -> T + Clone + Send + 'static) -> T {
    match thread::Builder::new().stack_size(STACK).spawn(work.clone()) {
        Ok(worker) => worker.join().unwrap_or_else(|panic| resume_unwind(panic)),
        Err(_) => work(),
    }
}

/// Starts the global threads, for commands without their own. Falls back to this thread if the
/// system starts none.
pub fn start_threads() {
    let all = rayon::ThreadPoolBuilder::new;
    // The global pool can be built only once, so this first tries to start another pool, and ends
    // it.
    let (ended, ends) = channel();
    let end = move |_| {
        let _ = ended.send(());
    };
    let tried = all().exit_handler(end).build();
    let builder = match tried {
        Ok(pool) => {
            let threads = pool.current_num_threads();
            drop(pool);
            ends.iter().take(threads).for_each(drop);
            all()
        }
        Err(_) => all().num_threads(1).use_current_thread(),
    };
    let _ = builder.build_global();
}

/// Keeps up to 8 MiB of freed memory per thread. Frames, and blocks of a frame that exceeds its
/// memory, free memory that the next one allocates again; returning it to the system in between
/// would cost a page fault per page.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
fn keep_freed() {
    for (parameter, bytes) in [(libc::M_MMAP_THRESHOLD, 1 << 20), (libc::M_TRIM_THRESHOLD, 8 << 20)]
    {
        // SAFETY: takes two numbers, before any other thread is started. Where it refuses, all
        // stays as it was.
        unsafe { libc::mallopt(parameter, bytes) };
    }
}

/// No-op on other allocators.
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
fn keep_freed() {}

/// Makes a write beyond the limit on file sizes (`ulimit -f`) an ordinary error, instead of a
/// signal that ends the process.
#[cfg(unix)]
fn outlive_large_files() {
    // SAFETY: no handler is installed that could run, and no other thread is there yet.
    unsafe { libc::signal(libc::SIGXFSZ, libc::SIG_IGN) };
}

#[cfg(not(unix))]
fn outlive_large_files() {}
