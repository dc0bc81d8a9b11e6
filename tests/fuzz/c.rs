//! Fuzzes the C interface: `src/bindings/c/tests/random.c` makes calls in any order, with valid and
//! invalid arguments.

use std::ffi::{CString, c_char};
use std::os::unix::ffi::OsStrExt;

// Link the crate of the C interface, whose functions the C code calls.
use meniscus_c as _;

use crate::targets::{Target, folder};

unsafe extern "C" {
    fn meniscus_calls_of_bytes(folder: *const c_char, bytes: *const u8, size: usize);
}

pub fn target() -> Target {
    let seeds = || {
        let noise = |seed: u32| {
            (0..800_u32)
                .map(|i| (i.wrapping_add(seed).wrapping_mul(2_654_435_761) >> 13) as u8)
                .collect()
        };
        vec![noise(1), noise(77), noise(1234)]
    };
    Target { name: "c", runs: 0, run, seeds, words: &[] }
}

fn run(data: &[u8]) {
    let folder = folder::empty("c");
    let name = CString::new(folder.as_os_str().as_bytes()).unwrap();
    // SAFETY: the name and the bytes outlive the call.
    unsafe { meniscus_calls_of_bytes(name.as_ptr(), data.as_ptr(), data.len()) };
}
