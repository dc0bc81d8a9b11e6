//! Results of calls: functions return a status code, and each thread stores the message of its last
//! failure.

use std::any::Any;
use std::cell::RefCell;
use std::ffi::{CString, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::ptr::null;

use meniscus::{Cause, Error};

/// Status code of a call. The numbers are the exit codes of the program `meniscus`.
#[repr(i32)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MeniscusStatus {
    /// Success.
    Ok = 0,
    /// Some frames of a conversion failed or are missing, or one of several simulations failed;
    /// finished frames are kept.
    Incomplete = 1,
    /// An invalid argument or option, or conflicting options; nothing was done.
    Request = 2,
    /// Invalid particles, or an input file that cannot be read.
    Input = 3,
    /// An output file or a scratch file cannot be written.
    Output = 4,
    /// The requested Vulkan device cannot be used.
    Device = 5,
    /// A bug in the library: please report it. Do not use the handles of this call except to free
    /// them.
    Internal = 70,
    /// A callback or another thread cancelled the work.
    Cancelled = 130,
}

/// An error of a call: its status code and its message.
#[derive(Debug)]
pub struct Failure {
    pub status: MeniscusStatus,
    pub message: String,
}

/// The result of a call, before it is converted to a status code.
pub type Outcome<T = ()> = Result<T, Failure>;

impl Failure {
    /// An error for an invalid argument.
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
    static LAST_ERROR: RefCell<CString> = RefCell::default();
}

/// Converts text to a C string, and removes NUL bytes.
pub fn c_text(text: impl Into<Vec<u8>>) -> CString {
    let mut bytes = text.into();
    bytes.retain(|&byte| byte != 0);
    CString::new(bytes).unwrap_or_default()
}

fn store_last_error(message: String) {
    // While a thread is ending, its `LAST_ERROR` may no longer exist; the message is then lost.
    let _ = LAST_ERROR.try_with(|last| *last.borrow_mut() = c_text(message));
}

fn panicked(payload: &(dyn Any + Send)) -> Failure {
    let text = payload.downcast_ref::<&str>().map(|text| (*text).to_owned());
    let text = text.or_else(|| payload.downcast_ref::<String>().cloned());
    let text = text.as_deref().unwrap_or("a panic");
    let message = format!("a bug in meniscus, please report it: {text}");
    Failure { status: MeniscusStatus::Internal, message }
}

/// Drops the payload of a panic. If dropping it panics, that panic is ignored.
fn drop_payload(payload: Box<dyn Any + Send>) {
    if let Err(another) = catch_unwind(AssertUnwindSafe(|| drop(payload))) {
        std::mem::forget(another);
    }
}

/// Runs `work` for a call. Errors and panics become a status code and a message.
pub fn call(work: impl FnOnce() -> Outcome) -> MeniscusStatus {
    let outcome = catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|payload| {
        let failure = panicked(&*payload);
        drop_payload(payload);
        Err(failure)
    });
    match outcome {
        Ok(()) => MeniscusStatus::Ok,
        Err(Failure { status, message }) => {
            store_last_error(message);
            status
        }
    }
}

/// Runs `work`, which must not fail. If `work` panics, which is a bug, this function stores a
/// message and returns `otherwise`.
pub fn catch_panic<T>(otherwise: T, work: impl FnOnce() -> T) -> T {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|payload| {
        store_last_error(panicked(&*payload).message);
        drop_payload(payload);
        otherwise
    })
}

/// Returns the message of this thread's last failed call, which says what is wrong and where. The
/// message is empty if no call on this thread has failed.
///
/// A call fails if it returns any status except MENISCUS_STATUS_OK. The string belongs to the
/// library, and is valid until the next call on this thread fails, or the thread ends.
#[unsafe(no_mangle)]
pub extern "C" fn meniscus_last_error() -> *const c_char {
    LAST_ERROR
        .try_with(|last| last.try_borrow().map_or(null(), |text| text.as_ptr()))
        .unwrap_or(c"".as_ptr())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::ffi::CStr;

    fn last() -> String {
        // SAFETY: the message is valid until this thread calls the library again.
        unsafe { CStr::from_ptr(meniscus_last_error()) }.to_str().unwrap().to_owned()
    }

    #[test]
    fn a_panic_becomes_a_status_code_and_a_message() {
        assert_eq!(call(|| panic!("number {}", 7)), MeniscusStatus::Internal);
        assert_eq!(last(), "a bug in meniscus, please report it: number 7");
        assert_eq!(call(|| std::panic::panic_any(7)), MeniscusStatus::Internal);
        assert_eq!(last(), "a bug in meniscus, please report it: a panic");
        assert_eq!(catch_panic(5, || panic!("query")), 5);
        assert_eq!(last(), "a bug in meniscus, please report it: query");
    }

    #[test]
    fn the_last_message_is_per_thread_and_survives_successful_calls() {
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
