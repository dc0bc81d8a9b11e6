//! Progress callbacks and cancellation.

use std::cell::Cell;
use std::ffi::{CString, c_char, c_void};
use std::sync::Arc;

use meniscus::{Cancel, Progress, Reconstruction, Stage};
use parking_lot::ReentrantMutex;

use crate::status::{c_text, catch_panic};

/// A stage of the work from particles to a mesh file.
#[repr(i32)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MeniscusStage {
    /// A stage that is newer than this header.
    Other = 0,
    /// Reads the input.
    Reading = 1,
    /// Counts particles in cells, to estimate the memory that the frame needs.
    Counting = 2,
    /// Waits until other frames have finished, because the frame is large.
    Waiting = 3,
    /// Samples the particles on the grid.
    Sampling = 4,
    /// Meshes the field.
    Meshing = 5,
    /// Simplifies the mesh.
    Simplifying = 6,
    /// Writes the mesh.
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

/// Progress of a frame. The library fills the structure, and later versions may append fields.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct MeniscusProgress {
    /// Size, in bytes, of this structure in the library's version.
    pub size: usize,
    /// The name of the stage, such as "meshing"; valid during the callback.
    pub name: *const c_char,
    /// The finished fraction of this stage, from 0 to 1.
    pub done: f64,
    /// The stage, one of MeniscusStage.
    pub stage: i32,
}

/// A function that receives progress. It returns 0 to continue; any other value cancels the work,
/// and the call returns MENISCUS_STATUS_CANCELLED.
///
/// Within each call of the library, threads of the library call this function one at a time. They
/// never call it after that call has returned. The function must not throw an exception or leave by
/// longjmp.
pub type MeniscusProgressCallback =
    Option<unsafe extern "C" fn(user: *mut c_void, progress: *const MeniscusProgress) -> i32>;

/// A handle with which any thread can cancel work. Cancelled calls return
/// MENISCUS_STATUS_CANCELLED. Later calls with the same handle also return this code, so a
/// cancelled handle cannot be reused. The handle may be freed while calls use it.
#[derive(Debug, Default)]
pub struct MeniscusCancel {
    pub cancel: Cancel,
}

/// Creates a cancel handle, which must be freed by meniscus_cancel_free.
#[unsafe(no_mangle)]
pub extern "C" fn meniscus_cancel_new() -> *mut MeniscusCancel {
    catch_panic(std::ptr::null_mut(), || Box::into_raw(Box::default()))
}

/// Cancels all calls that use this handle. Any thread may call this function at any time; NULL is
/// ignored.
///
/// `cancel` must be NULL or a handle that has not been freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_cancel(cancel: *const MeniscusCancel) {
    // SAFETY: the caller upholds this function's contract.
    if let Some(handle) = unsafe { cancel.as_ref() } {
        catch_panic((), || handle.cancel.cancel());
    }
}

/// Frees a cancel handle; NULL is ignored.
///
/// `cancel` must be NULL or a handle that has not been freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn meniscus_cancel_free(cancel: *mut MeniscusCancel) {
    // SAFETY: the caller upholds this function's contract.
    unsafe { free(cancel) };
}

/// Frees a handle of any type; NULL is ignored.
///
/// # Safety
/// `handle` must be NULL or come from a `Box` that has not been freed.
pub unsafe fn free<T>(handle: *mut T) {
    if !handle.is_null() {
        // SAFETY: the caller upholds this function's contract.
        catch_panic((), || drop(unsafe { Box::from_raw(handle) }));
    }
}

/// A progress callback with its argument `user`.
#[derive(Clone, Copy)]
pub struct Listener {
    pub callback: unsafe extern "C" fn(*mut c_void, *const MeniscusProgress) -> i32,
    pub user: *mut c_void,
}

/// Contains the callback while a call of the library runs, and is empty otherwise. Surfaces keep
/// the slot and may outlive the callback's argument, so the slot must not contain the callback
/// after the call. The lock is reentrant, because a callback may call the library, which may call
/// the callback again.
struct CallbackSlot(ReentrantMutex<Cell<Option<Listener>>>);

// SAFETY: the lock lets only one thread at a time use `*user`, and the documentation of
// `MeniscusProgressCallback` warns the caller that threads of the library call the callback.
unsafe impl Send for CallbackSlot {}
// SAFETY: for the same reason as `Send`.
unsafe impl Sync for CallbackSlot {}

/// The progress callback and the cancel handle of a request.
pub struct Control {
    cancel: Cancel,
    /// Whether the caller has set the cancel handle.
    has_callers_cancel: bool,
    listener: Option<Listener>,
    slot: Arc<CallbackSlot>,
}

// SAFETY: `listener` is only called through the `CallbackSlot`, which is `Send`.
unsafe impl Send for Control {}
// SAFETY: for the same reason as `Send`.
unsafe impl Sync for Control {}

/// Removes the callback from its slot when this object is dropped.
pub struct ActiveCallback<'a>(&'a Control);

impl Control {
    /// Creates a control from an optional callback and an optional cancel handle.
    pub fn new(listener: Option<Listener>, cancel: Option<Cancel>) -> Self {
        let has_callers_cancel = cancel.is_some();
        Self {
            cancel: cancel.unwrap_or_default(),
            has_callers_cancel,
            listener,
            slot: CallbackSlot::empty(),
        }
    }

    /// A copy for another frame. If the caller has set no cancel handle, the copy has a new one, so
    /// a callback that cancels one of the two frames does not cancel the other.
    pub fn for_other_work(&self) -> Self {
        let cancel = if self.has_callers_cancel { self.cancel.clone() } else { Cancel::new() };
        Self { cancel, slot: CallbackSlot::empty(), ..*self }
    }

    /// The cancel handle of the request.
    pub fn cancel(&self) -> &Cancel {
        &self.cancel
    }

    /// Adds the callback and the cancel handle to a request.
    pub fn attach_to(&self, request: Reconstruction) -> Reconstruction {
        let request = request.cancel(self.cancel.clone());
        if self.listener.is_none() {
            return request;
        }
        let (slot, cancel) = (Arc::clone(&self.slot), self.cancel.clone());
        request.progress(move |progress| slot.call(progress, &cancel))
    }

    /// Puts the callback into its slot until the result is dropped.
    pub fn activate(&self) -> ActiveCallback<'_> {
        self.slot.0.lock().set(self.listener);
        ActiveCallback(self)
    }
}

impl Drop for ActiveCallback<'_> {
    fn drop(&mut self) {
        self.0.slot.0.lock().set(None);
    }
}

impl CallbackSlot {
    fn empty() -> Arc<Self> {
        Arc::new(Self(ReentrantMutex::new(Cell::new(None))))
    }

    fn call(&self, Progress { stage, done, .. }: Progress, cancel: &Cancel) {
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
        // SAFETY: the caller has set `user` for this callback, and both are valid during the call.
        if unsafe { callback(user, &raw const progress) } != 0 {
            cancel.cancel();
        }
    }
}
