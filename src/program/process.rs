//! Setting up the process: memory that is freed, files beyond a limit, and threads.

use std::panic::resume_unwind;
use std::sync::mpsc::channel;
use std::thread;

/// Bytes of the stack that commands run on: as much as most systems give to a process.
const STACK: usize = 8 << 20;

/// Sets up the process, before any other thread is started.
pub fn set_up() {
    keep_freed();
    outlive_large_files();
}

/// Does `work` on a thread whose stack is large enough, whatever the limit on that of the process
/// (`ulimit -s`); on this one, where the system starts no other.
pub fn on_own_stack<T: Send + 'static>(work: impl FnOnce() -> T + Clone + Send + 'static) -> T {
    match thread::Builder::new().stack_size(STACK).spawn(work.clone()) {
        Ok(worker) => worker.join().unwrap_or_else(|panic| resume_unwind(panic)),
        Err(_) => work(),
    }
}

/// Starts the threads of commands that have none of their own. Where the system starts none, this
/// one does their work.
pub fn start_threads() {
    let all = rayon::ThreadPoolBuilder::new;
    // The global ones can be tried once only: others are tried first, and have ended before.
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

/// Keeps up to 8 MiB a thread for whoever allocates next. A frame, and a block of one that exceeds
/// its memory, frees what the next allocates again: given back to the system in between, it would
/// return a page at a time, a fault each.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
fn keep_freed() {
    for (parameter, bytes) in [(libc::M_MMAP_THRESHOLD, 1 << 20), (libc::M_TRIM_THRESHOLD, 8 << 20)]
    {
        // SAFETY: takes two numbers, before any other thread is started. Where it refuses, all
        // stays as it was.
        unsafe { libc::mallopt(parameter, bytes) };
    }
}

/// Others keep what they keep.
#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
fn keep_freed() {}

/// Has a write beyond the limit on the size of files (`ulimit -f`) fail, which is an error like any
/// other, instead of ending the process.
#[cfg(unix)]
fn outlive_large_files() {
    // SAFETY: no handler is installed that could run, and no other thread is there yet.
    unsafe { libc::signal(libc::SIGXFSZ, libc::SIG_IGN) };
}

#[cfg(not(unix))]
fn outlive_large_files() {}
