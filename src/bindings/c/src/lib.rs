//! The C interface of meniscus. cbindgen generates `include/meniscus.h` from its public items.
//!
//! The interface checks the caller's arguments as far as C allows, and passes them to the library.
//! An error becomes a status code and a message, and no panic crosses the interface.
// The docs of functions state their safety requirements without a heading, because cbindgen copies
// the docs into the header.
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

/// Returns the version of the library, such as "0.3.0". The string is static.
#[unsafe(no_mangle)]
pub extern "C" fn meniscus_version() -> *const c_char {
    concat!(env!("CARGO_PKG_VERSION"), "\0").as_ptr().cast()
}
