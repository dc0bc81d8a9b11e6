//! News of work on its own thread, heard on the caller's.

use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread;

use crate::error::Error;
use crate::system::cancel::Cancel;

use super::event::Event;

/// Events that may wait to be heard. Beyond that the work waits, so that they take no memory without end.
const WAITING: usize = 1024;

/// Tells the caller of events, from any thread.
#[derive(Debug, Clone)]
pub(super) struct Teller(SyncSender<Event>);

impl Teller {
    pub(super) fn tell(&self, event: Event) {
        // A caller that panicked hears no more.
        let _ = self.0.send(event);
    }
}

/// Does `work` on a thread of its own, and calls `hear` with what that tells, on this one. If `hear` panics, the work is cancelled.
///
/// # Errors
/// Those of `work`, and [`Error::Threads`].
pub(super) fn hearing<T: Send>(
    cancel: &Cancel,
    hear: impl FnMut(Event),
    work: impl FnOnce(&Teller) -> Result<T, Error> + Send,
) -> Result<T, Error> {
    let (sender, told) = sync_channel(WAITING);
    thread::scope(|scope| {
        let work = move || work(&Teller(sender));
        let worker = thread::Builder::new().name("meniscus".into()).spawn_scoped(scope, work);
        let worker = worker.map_err(|fault| Error::Threads(fault.to_string()))?;
        // Ends with the last teller.
        let stop = CancelInPanic(cancel);
        told.into_iter().for_each(hear);
        drop(stop);
        worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    })
}

/// Cancels work that nobody waits for any more.
struct CancelInPanic<'a>(&'a Cancel);

impl Drop for CancelInPanic<'_> {
    fn drop(&mut self) {
        if thread::panicking() {
            self.0.cancel();
        }
    }
}
