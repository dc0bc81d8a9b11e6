//! Checks strings and arrays from the caller, and buffers that the library fills.

use std::ffi::{CStr, c_char};
use std::mem::MaybeUninit;
use std::path::PathBuf;

use crate::status::{Failure, Outcome};

/// Reads the caller's string, or returns `None` for NULL.
///
/// # Safety
/// `at` must be NULL or point to a NUL-terminated string that lives as long as the call.
pub unsafe fn optional<'a>(at: *const c_char, what: &str) -> Outcome<Option<&'a str>> {
    if at.is_null() {
        return Ok(None);
    }
    // SAFETY: the caller upholds this function's contract.
    let text = unsafe { CStr::from_ptr(at) }.to_str();
    text.map(Some).map_err(|_| Failure::request(format!("{what} is not UTF-8")))
}

/// Reads the caller's path, or returns `None` for NULL.
///
/// # Safety
/// The requirements of [`optional`].
pub unsafe fn optional_path(at: *const c_char, what: &str) -> Outcome<Option<PathBuf>> {
    #[cfg(unix)]
    {
        use std::os::unix::ffi::OsStrExt;
        let _ = what;
        // SAFETY: the caller upholds this function's contract.
        let bytes = (!at.is_null()).then(|| unsafe { CStr::from_ptr(at) }.to_bytes());
        Ok(bytes.map(|bytes| std::ffi::OsStr::from_bytes(bytes).into()))
    }
    #[cfg(not(unix))]
    {
        // SAFETY: the caller upholds this function's contract.
        Ok(unsafe { optional(at, what) }?.map(PathBuf::from))
    }
}

/// Reads the caller's path, which must not be NULL.
///
/// # Safety
/// The requirements of [`optional`].
pub unsafe fn path(at: *const c_char, what: &str) -> Outcome<PathBuf> {
    // SAFETY: the caller upholds this function's contract.
    let path = unsafe { optional_path(at, what) }?;
    path.ok_or_else(|| Failure::request(format!("{what} is NULL")))
}

/// Reads the caller's array of strings. Returns an error if one of the strings is NULL.
///
/// # Safety
/// `at` must be NULL or point to `count` pointers. Each pointer must meet the requirements of
/// [`optional`].
pub unsafe fn pointers<'a>(
    at: *const *const c_char,
    count: usize,
    what: &str,
) -> Outcome<&'a [*const c_char]> {
    // SAFETY: the caller upholds this function's contract.
    let pointers = unsafe { array(at, count, what) }?;
    match pointers.iter().position(|text| text.is_null()) {
        Some(index) => Err(Failure::request(format!("{what}[{index}] is NULL"))),
        None => Ok(pointers),
    }
}

/// Converts the caller's array to a slice. An empty array may be NULL.
///
/// # Safety
/// `at` must be NULL or point to `count` values, which must not change during the call.
pub unsafe fn array<'a, T>(at: *const T, count: usize, what: &str) -> Outcome<&'a [T]> {
    if count == 0 {
        return Ok(&[]);
    }
    check_array_address(at, count, what)?;
    // SAFETY: the address was checked, and the caller guarantees its values.
    Ok(unsafe { std::slice::from_raw_parts(at, count) })
}

/// Returns an error if an array of `count` values cannot be at the address `at`.
fn check_array_address<T>(at: *const T, count: usize, what: &str) -> Outcome {
    if at.is_null() {
        return Err(Failure::request(format!("{what} is NULL, but its count is {count}")));
    }
    if !at.is_aligned() {
        return Err(Failure::request(format!(
            "{what} is not aligned to {} bytes",
            align_of::<T>()
        )));
    }
    let bytes = count.checked_mul(size_of::<T>()).filter(|&bytes| bytes <= isize::MAX as usize);
    if bytes.is_none_or(|bytes| at.addr().checked_add(bytes).is_none()) {
        return Err(Failure::request(format!("{what}: {count} elements exceed the address space")));
    }
    Ok(())
}

/// Converts the caller's buffer to a slice of `needed` values. Returns an error if the buffer has
/// room for fewer values.
///
/// # Safety
/// `at` must be NULL or point to memory for `capacity` values. No other thread may use this memory
/// during the call.
pub unsafe fn buffer<'a, T>(
    at: *mut T,
    capacity: u64,
    needed: u64,
    what: &str,
) -> Outcome<&'a mut [MaybeUninit<T>]> {
    if capacity < needed {
        let what = format!("{what} holds {capacity} numbers, but {needed} are needed");
        return Err(Failure::request(what));
    }
    let Ok(needed) = usize::try_from(needed) else {
        return Err(Failure::request(format!("{what}: {needed} numbers exceed the address space")));
    };
    if needed == 0 {
        return Ok(&mut []);
    }
    check_array_address(at.cast_const(), needed, what)?;
    // SAFETY: the address was checked, and the caller guarantees its memory.
    Ok(unsafe { std::slice::from_raw_parts_mut(at.cast(), needed) })
}

/// Writes a value, unless the address is NULL.
///
/// # Safety
/// `at` must be NULL or point to memory for a value, which need not be aligned.
pub unsafe fn put<T>(at: *mut T, value: T) {
    if !at.is_null() {
        // SAFETY: the caller upholds this function's contract.
        unsafe { at.write_unaligned(value) };
    }
}
