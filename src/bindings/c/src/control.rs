//! The caller's hold on work: a callback that is told how far it is, and early ends.

use std::cell::Cell;
use std::ffi::{CString, c_char, c_void};
use std::sync::Arc;

use meniscus::{Cancel, Progress, Reconstruction, Stage};
use parking_lot::ReentrantMutex;

use crate::status::{ask, c_text};

/// A step on the way from particles to a mesh file.
#[repr(i32)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MeniscusStage {
    /// A stage that is newer than this header.
    Other = 0,
    /// The input is read.
    Reading = 1,
    /// Particles are counted in the cells, to know what memory the frame takes.
    Counting = 2,
    /// A large frame waits until others are done.
    Waiting = 3,
    /// Particles are sampled on the grid.
    Sampling = 4,
    /// The field is meshed.
    Meshing = 5,
    /// The mesh is simplified.
    Simplifying = 6,
    /// The mesh is written.
    Writing = 7,
}

impl From<Stage> for MeniscusStage {
    fn from(stage: Stage) -> Self {
        match stage {
            Stage::Reading => Self::Reading,
            Stage::Counting => Self::Counting,
            Stage::Waiting => Self::Waiting,
            Stage::Sampling => Self::Sampling,
            Stage::Meshing => Self::Meshing,
            Stage::Simplifying => Self::Simplifying,
            Stage::Writing => Self::Writing,
            _ => Self::Other,
        }
    }
}

/// Progress of a frame. The library fills it, and a later version may put more behind.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct MeniscusProgress {
    /// Bytes of this structure as the library knows it.
    pub size: usize,
    /// The stage in one word, such as "meshing"; valid during the callback.
    pub name: *const c_char,
    /// The share of this stage that is done, from 0 to 1.
    pub done: f64,
    /// The stage, one of MeniscusStage.
    pub stage: i32,
}

/// A function that is told of progress. It returns 0 for the work to go on, and anything else to
/// end it early: the call then returns MENISCUS_STATUS_CANCELLED.
///
/// It is called from threads of the library, but never from two at once in the same call, and never
/// after the call has returned. It must not throw, nor leave by longjmp.
pub type MeniscusProgressCallback =
    Option<unsafe extern "C" fn(user: *mut c_void, progress: *const MeniscusProgress) -> i32>;

/// A handle to end work early from any thread. Work that was begun with it, or is begun later, ends
/// with MENISCUS_STATUS_CANCELLED: a handle is not used again once it was cancelled. It may be
/// freed while such work runs.
#[derive(Debug, Default)]
pub struct MeniscusCancel {
    pub cancel: Cancel,
}

/// Makes a handle, to be freed by meniscus_cancel_free.
#[unsafe(no_mangle)]
pub extern "C" fn meniscus_cancel_new() -> *mut MeniscusCancel {
    ask(std::ptr::null_mut(), || Box::into_raw(Box::default()))
}

/// Asks all work with this handle to end soon. May be called from any thread, at any time; NULL is
/// ignored.
///
/// `cancel` is NULL, or a handle that is not freed yet.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_cancel(cancel: *const MeniscusCancel) {
    // SAFETY: as for this function.
    if let Some(handle) = unsafe { cancel.as_ref() } {
        ask((), || handle.cancel.cancel());
    }
}

/// Frees a handle; NULL is ignored.
///
/// `cancel` is NULL, or a handle that is not freed yet.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_cancel_free(cancel: *mut MeniscusCancel) {
    // SAFETY: as for this function.
    unsafe { free(cancel) };
}

/// Frees what a handle points to; NULL is ignored.
///
/// # Safety
/// `handle` is NULL, or came from a `Box` that is not freed yet.
pub unsafe fn free<T>(handle: *mut T) {
    if !handle.is_null() {
        // SAFETY: as for this function.
        ask((), || drop(unsafe { Box::from_raw(handle) }));
    }
}

/// A callback, and what it is called with.
#[derive(Clone, Copy)]
pub struct Listener {
    pub callback: unsafe extern "C" fn(*mut c_void, *const MeniscusProgress) -> i32,
    pub user: *mut c_void,
}

/// A callback that hears only while a call lasts: surfaces hold whoever was told of their progress,
/// and may outlive what the callback needs. A callback may call the library, which may call it
/// again: hence a lock that its own thread can take twice.
struct Ear(ReentrantMutex<Cell<Option<Listener>>>);

// SAFETY: what `user` points to is used by one thread at a time, and its owner has agreed to any.
unsafe impl Send for Ear {}
// SAFETY: as above.
unsafe impl Sync for Ear {}

/// The control of a request: whom to tell, and how to end it early.
pub struct Control {
    cancel: Cancel,
    /// Whether the handle is the caller's, or this one's own.
    is_given: bool,
    listener: Option<Listener>,
    ear: Arc<Ear>,
}

// SAFETY: as for an ear.
unsafe impl Send for Control {}
// SAFETY: as above.
unsafe impl Sync for Control {}

/// Lets the callback hear, as long as it lives.
pub struct Listening<'a>(&'a Control);

impl Control {
    /// Takes a callback, if there is one, and a handle to end by, if there is one.
    pub fn new(listener: Option<Listener>, cancel: Option<Cancel>) -> Self {
        let is_given = cancel.is_some();
        Self { cancel: cancel.unwrap_or_default(), is_given, listener, ear: Ear::deaf() }
    }

    /// Makes the same for other work, that a callback's end of this does not end.
    pub fn anew(&self) -> Self {
        let cancel = if self.is_given { self.cancel.clone() } else { Cancel::new() };
        Self { cancel, ear: Ear::deaf(), ..*self }
    }

    /// The handle by which the work ends early.
    pub fn cancel(&self) -> &Cancel {
        &self.cancel
    }

    /// Makes a request tell the callback of its progress, and end by the handle.
    pub fn of(&self, request: Reconstruction) -> Reconstruction {
        let request = request.cancel(self.cancel.clone());
        if self.listener.is_none() {
            return request;
        }
        let (ear, cancel) = (Arc::clone(&self.ear), self.cancel.clone());
        request.progress(move |progress| ear.hear(progress, &cancel))
    }

    /// Lets the callback hear.
    pub fn listen(&self) -> Listening<'_> {
        self.ear.0.lock().set(self.listener);
        Listening(self)
    }
}

impl Drop for Listening<'_> {
    fn drop(&mut self) {
        self.0.ear.0.lock().set(None);
    }
}

impl Ear {
    fn deaf() -> Arc<Self> {
        Arc::new(Self(ReentrantMutex::new(Cell::new(None))))
    }

    fn hear(&self, Progress { stage, done, .. }: Progress, cancel: &Cancel) {
        let listener = self.0.lock();
        let Some(Listener { callback, user }) = listener.get() else { return };
        let name: CString = c_text(stage.name());
        let size = size_of::<MeniscusProgress>();
        let progress = MeniscusProgress {
            size,
            name: name.as_ptr(),
            done,
            stage: MeniscusStage::from(stage) as i32,
        };
        // SAFETY: a callback and what it was given with, while the call lasts that it was given to.
        if unsafe { callback(user, &raw const progress) } != 0 {
            cancel.cancel();
        }
    }
}
