//! Threads that stop between pieces of work.

use std::sync::{Arc, Weak};

use rayon::{ThreadPool, ThreadPoolBuilder};

/// Threads of a request. They exist only while work runs; later work starts new threads.
///
/// The threads are not kept, because a caller may keep hundreds of surfaces. A caller may also
/// fork, and the parent's threads do not exist in the child process.
#[derive(Debug, Clone)]
pub(crate) struct Threads {
    pool: Weak<ThreadPool>,
    count: usize,
    /// The process that started the threads.
    process: u32,
}

impl Threads {
    /// Starts `count` threads.
    ///
    /// # Errors
    /// The system's message, if threads cannot be started.
    pub(crate) fn start(count: usize) -> Result<Arc<ThreadPool>, String> {
        let pool = ThreadPoolBuilder::new().num_threads(count).build();
        pool.map(Arc::new).map_err(|fault| fault.to_string())
    }

    /// Returns the running threads, or starts new ones.
    ///
    /// # Errors
    /// The system's message, if threads cannot be started.
    pub(crate) fn started(&self) -> Result<Arc<ThreadPool>, String> {
        let running = self.pool.upgrade().filter(|_| self.process == std::process::id());
        running.map_or_else(|| Self::start(self.count), Ok)
    }
}

impl From<&Arc<ThreadPool>> for Threads {
    fn from(pool: &Arc<ThreadPool>) -> Self {
        Self {
            pool: Arc::downgrade(pool),
            count: pool.current_num_threads(),
            process: std::process::id(),
        }
    }
}
