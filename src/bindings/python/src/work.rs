//! Runs long calls of the library without the interpreter's lock. Ctrl-C or an exception in the
//! progress callback cancels a call.
//!
//! The call runs on a separate thread, while the caller's thread waits for its messages. The
//! caller's thread also checks for signals, because Python handles signals only on its main thread,
//! and runs the callbacks, because callbacks may use any Python API.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use meniscus::{Cancel, Error, Progress};
use pyo3::prelude::*;
use rayon::ThreadPoolBuilder;

use crate::errors::{exception, other};
use crate::memory::return_memory;

/// Runs `act` on temporary threads, one per core.
///
/// Do not use Rayon's global thread pool instead. If the caller forks, the pool's threads do not
/// exist in the child process, so a call in the child process would wait for them forever.
pub fn on_all_cores<T: Send>(act: impl FnOnce() -> T + Send) -> Result<T, Error> {
    on_threads(0, act)
}

/// Runs `act` on `count` temporary threads. 0 means one per core.
pub fn on_threads<T: Send>(count: usize, act: impl FnOnce() -> T + Send) -> Result<T, Error> {
    let threads = ThreadPoolBuilder::new().num_threads(count).build();
    Ok(threads.map_err(|fault| Error::Threads(fault.to_string()))?.install(act))
}

/// Interval at which the caller's thread checks for Ctrl-C while it waits.
const POLL: Duration = Duration::from_millis(50);

/// A message from the working thread to the caller's thread.
pub enum Message<N> {
    Event(N),
    Done,
}

/// Sends messages to the caller's thread.
pub type MessageSender<N> = Sender<Message<N>>;

/// A call of the library with progress messages and a cancel handle.
pub struct Work<N> {
    pub cancel: Cancel,
    pub sender: MessageSender<N>,
    receiver: Mutex<Receiver<Message<N>>>,
}

impl<N: Send + 'static> Work<N> {
    pub fn new() -> Self {
        let (sender, receiver) = channel();
        Self { cancel: Cancel::new(), sender, receiver: Mutex::new(receiver) }
    }

    /// Runs `act` on a separate thread, and calls `on_event` with its events on the caller's
    /// thread.
    pub fn run<T: Send>(
        self,
        py: Python<'_>,
        mut on_event: impl FnMut(N) -> PyResult<()>,
        act: impl FnOnce() -> Result<T, Error> + Send,
    ) -> PyResult<T> {
        let Self { cancel, sender, receiver } = self;
        let mut raised = None;
        let ended = thread::scope(|scope| {
            let act = move || {
                let ended = catch_unwind(AssertUnwindSafe(act));
                // Sending cannot fail, because the receiver exists until the caller has received
                // `Done`.
                let _ = sender.send(Message::Done);
                ended
            };
            let worker = thread::Builder::new().name("meniscus".into()).spawn_scoped(scope, act);
            let worker = worker.map_err(|fault| exception(Error::Threads(fault.to_string())))?;
            loop {
                let next = py.detach(|| {
                    receiver.lock().unwrap_or_else(PoisonError::into_inner).recv_timeout(POLL)
                });
                let handled = match next {
                    Ok(Message::Done) | Err(RecvTimeoutError::Disconnected) => break,
                    Ok(Message::Event(event)) if raised.is_none() => on_event(event),
                    Ok(Message::Event(_)) | Err(RecvTimeoutError::Timeout) => Ok(()),
                };
                if raised.is_none()
                    && let Err(error) = handled.and_then(|()| py.check_signals())
                {
                    cancel.cancel();
                    raised = Some(error);
                }
            }
            let ended = py.detach(|| {
                let ended = worker.join().and_then(|ended| ended);
                return_memory();
                ended
            });
            ended.map_err(|panic| {
                let text = panic.downcast_ref::<String>().map(String::as_str);
                let text = text.or(panic.downcast_ref::<&str>().copied()).unwrap_or("a panic");
                other(format!("a bug in meniscus, please report it: {text}"))
            })
        });
        match raised {
            Some(error) => Err(error),
            None => ended?.map_err(exception),
        }
    }
}

/// Runs `act`, and passes the progress of its frame to a Python callback, if there is one.
pub fn with_progress<T: Send>(
    py: Python<'_>,
    progress: Option<&Bound<'_, PyAny>>,
    work: Work<Progress>,
    act: impl FnOnce() -> Result<T, Error> + Send,
) -> PyResult<T> {
    let on_progress = |report: Progress| match progress {
        Some(callback) => callback.call1((report.stage.name(), report.done)).map(drop),
        None => Ok(()),
    };
    work.run(py, on_progress, act)
}

impl Work<Progress> {
    /// Adds this work's cancel handle to a request. If `reports` is set, the request also sends its
    /// progress to this work.
    pub fn attach_to(
        &self,
        request: meniscus::Reconstruction,
        reports: bool,
    ) -> meniscus::Reconstruction {
        let request = request.cancel(self.cancel.clone());
        if !reports {
            return request.progress(|_| ());
        }
        let sender = self.sender.clone();
        request.progress(move |progress| {
            // Ignore failures to send. If the caller later writes the surface, the library reports
            // progress again, and the receiver no longer exists.
            let _ = sender.send(Message::Event(progress));
        })
    }
}
