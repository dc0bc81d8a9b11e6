//! The C interface of meniscus: `include/meniscus.h` is made of what is public here, by cbindgen.
//!
//! Nothing is decided here: what callers say is checked as far as C cannot, and handed to the
//! library. No panic goes beyond a function, and what fails is a code and a message.
// The safety of functions is said in the header's words.
#![allow(clippy::missing_safety_doc)]

mod control;
mod conversion;
mod frame;
mod live;
mod mesh;
mod options;
mod particles;
mod report;
mod sized;
mod status;
mod text;

use std::ffi::c_char;

/// Returns the version of the library, such as "0.3.0". The text lives for ever.
#[unsafe(no_mangle)]
pub extern "C" fn meniscus_version() -> *const c_char {
    concat!(env!("CARGO_PKG_VERSION"), "\0").as_ptr().cast()
}
