//! Outcomes of calls: a code that every function returns, and a message that the calling thread
//! keeps.

use std::any::Any;
use std::cell::RefCell;
use std::ffi::{CString, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::ptr::null;

use meniscus::{Cause, Error};

/// Outcome of a call: whose fault it is if it failed. The numbers are those that the program
/// `meniscus` exits with.
#[repr(i32)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MeniscusStatus {
    /// Done.
    Ok = 0,
    /// Some frames of a conversion failed or are missing; the others are done.
    Incomplete = 1,
    /// An argument or an option is wrong, or options exclude each other; nothing was done.
    Request = 2,
    /// The particles, or a file that was to be read, are bad.
    Input = 3,
    /// A file cannot be written, or scratch files fail.
    Output = 4,
    /// The Vulkan device that was asked for cannot be used.
    Device = 5,
    /// A bug of the library: please report it. The handles that the call was given are fit for
    /// nothing but to be freed.
    Internal = 70,
    /// A callback or another thread asked for an early end.
    Cancelled = 130,
}

/// A call that failed.
#[derive(Debug)]
pub struct Failure {
    pub status: MeniscusStatus,
    pub message: String,
}

/// The result of the work of a call.
pub type Outcome<T = ()> = Result<T, Failure>;

impl Failure {
    /// A call with an argument that is wrong.
    pub fn request(message: impl Into<String>) -> Self {
        Self { status: MeniscusStatus::Request, message: message.into() }
    }
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        let status = match error.cause() {
            Cause::Request => MeniscusStatus::Request,
            Cause::Input => MeniscusStatus::Input,
            Cause::Output => MeniscusStatus::Output,
            Cause::Device => MeniscusStatus::Device,
            Cause::Cancelled => MeniscusStatus::Cancelled,
            _ => MeniscusStatus::Internal,
        };
        Self { status, message: error.to_string() }
    }
}

thread_local! {
    static LAST: RefCell<CString> = RefCell::default();
}

/// Text for C: up to a NUL, if it has one.
pub fn c_text(text: impl Into<Vec<u8>>) -> CString {
    let mut bytes = text.into();
    bytes.retain(|&byte| byte != 0);
    CString::new(bytes).unwrap_or_default()
}

fn keep(message: String) {
    // A thread that ends has none any more.
    let _ = LAST.try_with(|last| *last.borrow_mut() = c_text(message));
}

fn panicked(payload: &(dyn Any + Send)) -> Failure {
    let text = payload.downcast_ref::<&str>().map(|text| (*text).to_owned());
    let text = text.or_else(|| payload.downcast_ref::<String>().cloned());
    let message = format!("a bug of meniscus: {}", text.as_deref().unwrap_or("a panic"));
    Failure { status: MeniscusStatus::Internal, message }
}

/// Drops what a panic carries, which could panic again: that is forgotten.
fn dropped(payload: Box<dyn Any + Send>) {
    if let Err(another) = catch_unwind(AssertUnwindSafe(|| drop(payload))) {
        std::mem::forget(another);
    }
}

/// Does the work of a call: what fails is a code and a message, and a panic goes no farther.
pub fn call(work: impl FnOnce() -> Outcome) -> MeniscusStatus {
    let outcome = catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|payload| {
        let failure = panicked(&*payload);
        dropped(payload);
        Err(failure)
    });
    match outcome {
        Ok(()) => MeniscusStatus::Ok,
        Err(Failure { status, message }) => {
            keep(message);
            status
        }
    }
}

/// Asks something that cannot fail; a panic, which would be a bug, is told of as any message, and
/// `otherwise` is the answer.
pub fn ask<T>(otherwise: T, work: impl FnOnce() -> T) -> T {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|payload| {
        keep(panicked(&*payload).message);
        dropped(payload);
        otherwise
    })
}

/// Returns the message of the last call of this thread that did not return MENISCUS_STATUS_OK: what
/// is wrong, and where. Empty where there was none.
///
/// Each thread has its own, so that threads do not see each other's. The text is the library's: it
/// is valid until the next call on this thread fails, or the thread ends.
#[unsafe(no_mangle)]
pub extern "C" fn meniscus_last_error() -> *const c_char {
    LAST.try_with(|last| last.try_borrow().map_or(null(), |text| text.as_ptr()))
        .unwrap_or(c"".as_ptr())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::ffi::CStr;

    fn last() -> String {
        // SAFETY: the text of this thread, which makes no other call meanwhile.
        unsafe { CStr::from_ptr(meniscus_last_error()) }.to_str().unwrap().to_owned()
    }

    #[test]
    fn a_panic_is_a_code_and_a_message() {
        assert_eq!(call(|| panic!("number {}", 7)), MeniscusStatus::Internal);
        assert_eq!(last(), "a bug of meniscus: number 7");
        assert_eq!(call(|| std::panic::panic_any(7)), MeniscusStatus::Internal);
        assert_eq!(last(), "a bug of meniscus: a panic");
        assert_eq!(ask(5, || panic!("asked")), 5);
        assert_eq!(last(), "a bug of meniscus: asked");
    }

    #[test]
    fn a_message_is_its_threads_own_and_outlives_what_succeeds() {
        assert_eq!(call(|| Err(Failure::request("one"))), MeniscusStatus::Request);
        std::thread::spawn(|| {
            assert_eq!(last(), "");
            assert_eq!(call(|| Err(Failure::request("two\0halves"))), MeniscusStatus::Request);
            assert_eq!(last(), "twohalves");
        })
        .join()
        .unwrap();
        assert_eq!(call(|| Ok(())), MeniscusStatus::Ok);
        assert_eq!(last(), "one");
    }
}
