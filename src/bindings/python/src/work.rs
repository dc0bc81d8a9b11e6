//! Long work: without the interpreter's lock, ended by Ctrl-C or by an exception of whoever is told
//! of its progress.
//!
//! Work runs on a thread of its own, and the caller's waits for news: signals and callbacks are
//! Python's only there, and a callback may do whatever its caller may.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use meniscus::{Cancel, Error, Progress};
use pyo3::prelude::*;

use crate::errors::{exception, other};
use crate::memory::give_back;

/// How long Ctrl-C may go unnoticed.
const POLL: Duration = Duration::from_millis(50);

/// News of the work, and none more after the last.
pub enum News<N> {
    Told(N),
    Over,
}

/// Tells the caller's thread of news.
pub type Teller<N> = Sender<News<N>>;

/// Work that can be watched, and ended early.
pub struct Work<N> {
    pub cancel: Cancel,
    pub teller: Teller<N>,
    news: Mutex<Receiver<News<N>>>,
}

impl<N: Send + 'static> Work<N> {
    pub fn new() -> Self {
        let (teller, news) = channel();
        Self { cancel: Cancel::new(), teller, news: Mutex::new(news) }
    }

    /// Runs `act` while its caller `hear`s of news.
    pub fn run<T: Send>(
        self,
        py: Python<'_>,
        mut hear: impl FnMut(N) -> PyResult<()>,
        act: impl FnOnce() -> Result<T, Error> + Send,
    ) -> PyResult<T> {
        let Self { cancel, teller, news } = self;
        let mut raised = None;
        let ended = thread::scope(|scope| {
            let act = move || {
                let ended = catch_unwind(AssertUnwindSafe(act));
                // Whoever waits holds the other end.
                let _ = teller.send(News::Over);
                ended
            };
            let worker = thread::Builder::new().name("meniscus".into()).spawn_scoped(scope, act);
            let worker = worker.map_err(|fault| exception(Error::Threads(fault.to_string())))?;
            loop {
                let next = py.detach(|| {
                    news.lock().unwrap_or_else(PoisonError::into_inner).recv_timeout(POLL)
                });
                let heard = match next {
                    Ok(News::Over) | Err(RecvTimeoutError::Disconnected) => break,
                    Ok(News::Told(news)) if raised.is_none() => hear(news),
                    Ok(News::Told(_)) | Err(RecvTimeoutError::Timeout) => Ok(()),
                };
                if raised.is_none()
                    && let Err(error) = heard.and_then(|()| py.check_signals())
                {
                    cancel.cancel();
                    raised = Some(error);
                }
            }
            let ended = py.detach(|| {
                let ended = worker.join().and_then(|ended| ended);
                give_back();
                ended
            });
            ended.map_err(|panic| {
                let text = panic.downcast_ref::<String>().map(String::as_str);
                let text = text.or(panic.downcast_ref::<&str>().copied()).unwrap_or("a panic");
                other(format!("a bug of the library: {text}"))
            })
        });
        match raised {
            Some(error) => Err(error),
            None => ended?.map_err(exception),
        }
    }
}

/// Runs `act` for a caller who hears of the progress of a frame, if he wants to.
pub fn with_progress<T: Send>(
    py: Python<'_>,
    progress: Option<&Bound<'_, PyAny>>,
    work: Work<Progress>,
    act: impl FnOnce() -> Result<T, Error> + Send,
) -> PyResult<T> {
    let hear = |news: Progress| match progress {
        Some(callback) => callback.call1((news.stage.name(), news.done)).map(drop),
        None => Ok(()),
    };
    work.run(py, hear, act)
}

impl Work<Progress> {
    /// Takes the request's reins.
    pub fn holds(&self, request: meniscus::Reconstruction, told: bool) -> meniscus::Reconstruction {
        let request = request.cancel(self.cancel.clone());
        if !told {
            return request.progress(|_| ());
        }
        let teller = self.teller.clone();
        request.progress(move |progress| {
            // Nobody hears any more of a surface that is written later.
            let _ = teller.send(News::Told(progress));
        })
    }
}
