//! The C interface of meniscus. cbindgen generates `include/meniscus.h` from its public items.
//!
//! The interface checks the caller's arguments as far as C allows, and passes them to the library.
//! No panic crosses a function, and errors are a code and a message.
// The safety of functions is documented for the header.
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

/// Returns the version of the library, such as "0.3.0". The text is static.
#[unsafe(no_mangle)]
pub extern "C" fn meniscus_version() -> *const c_char {
    concat!(env!("CARGO_PKG_VERSION"), "\0").as_ptr().cast()
}
