//! Structures whose first field is their size, so that later versions can add fields. A caller that
//! was compiled with an older header passes a smaller structure; a caller that was compiled with a
//! newer header passes a larger one.

use crate::status::{Failure, Outcome};

/// The largest size, in bytes, that a caller may state for a structure.
const LARGEST: usize = 4096;

/// A C structure whose first field is its size in bytes, of type `usize`.
///
/// # Safety
/// All fields are numbers, nullable pointers or nullable callbacks. Therefore zeros are valid, and
/// all bytes that a caller may write are valid.
pub unsafe trait SizedStruct: Copy {
    /// The structure's name in C, for messages.
    const NAME: &str;
}

/// Reads the size in the first field of a structure.
///
/// # Safety
/// `at` must be NULL or point to a structure.
unsafe fn read_size<T: SizedStruct>(at: *const T, what: &str) -> Outcome<usize> {
    if at.is_null() {
        return Err(Failure::request(format!("{what} is NULL")));
    }
    // SAFETY: a structure begins with its size, and this read needs no alignment.
    let size = unsafe { at.cast::<usize>().read_unaligned() };
    if !(size_of::<usize>()..=LARGEST).contains(&size) || !size.is_multiple_of(size_of::<usize>()) {
        let (name, own) = (T::NAME, size_of::<T>());
        return Err(Failure::request(format!(
            "{what}.size is {size}; set it to sizeof({name}), {own}"
        )));
    }
    Ok(size)
}

/// Copies the caller's structure. If it is smaller than `T`, the missing fields become 0. If it is
/// larger, the additional fields must be 0.
///
/// # Safety
/// `at` must be NULL or point to a structure that has the number of bytes stated in its size field.
pub unsafe fn read<T: SizedStruct>(at: *const T, what: &str) -> Outcome<T> {
    // SAFETY: the caller upholds this function's contract.
    let size = unsafe { read_size(at, what) }?;
    // SAFETY: the caller guarantees that the structure has `size` bytes.
    let bytes = unsafe { std::slice::from_raw_parts(at.cast::<u8>(), size) };
    let (known, unknown) = bytes.split_at(size.min(size_of::<T>()));
    if unknown.iter().any(|&byte| byte != 0) {
        return Err(Failure::request(format!(
            "{what}: a field that this version of meniscus does not support must be 0"
        )));
    }
    // SAFETY: zeros are valid for all fields of a `SizedStruct`.
    let mut value: T = unsafe { std::mem::zeroed() };
    // SAFETY: `known` is at most as long as `value`, and the fields of a `SizedStruct` may have any
    // bytes.
    unsafe { std::ptr::copy_nonoverlapping(known.as_ptr(), (&raw mut value).cast(), known.len()) };
    Ok(value)
}

/// Checks the size in the caller's structure, so that a later [`fill`] cannot fail.
///
/// # Safety
/// The requirements of [`read`].
pub unsafe fn check<T: SizedStruct>(at: *mut T, what: &str) -> Outcome {
    // SAFETY: the caller upholds this function's contract.
    unsafe { read_size(at.cast_const(), what) }.map(drop)
}

/// Fills the caller's structure. If it is smaller than `T`, only the fields that it has are filled.
/// If it is larger, the additional fields become 0.
///
/// # Safety
/// The requirements of [`read`]. Also, no other thread may read or write the structure.
pub unsafe fn fill<T: SizedStruct>(at: *mut T, value: T, what: &str) -> Outcome {
    let own = size_of::<usize>();
    // SAFETY: the caller upholds this function's contract.
    let size = unsafe { read_size(at.cast_const(), what) }?;
    let known = size.min(size_of::<T>());
    let (from, to) = ((&raw const value).cast::<u8>(), at.cast::<u8>());
    // SAFETY: `known` is at most the size of each structure. The copy skips the caller's size
    // field.
    unsafe {
        std::ptr::copy_nonoverlapping(from.add(own), to.add(own), known - own);
        to.add(known).write_bytes(0, size - known);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[repr(C)]
    #[derive(Debug, Clone, Copy, PartialEq)]
    struct Two {
        size: usize,
        one: u64,
        two: u64,
    }

    // SAFETY: all fields are numbers.
    unsafe impl SizedStruct for Two {
        const NAME: &str = "Two";
    }

    fn at(numbers: &mut [u64]) -> *mut Two {
        numbers.as_mut_ptr().cast()
    }

    #[test]
    fn short_structures_are_completed_and_unknown_fields_must_be_zero() {
        // SAFETY: each array is as large as its size field says, or its size field is invalid and
        // only this field is read.
        unsafe {
            let whole = read(at(&mut [24, 5, 6]), "two").unwrap();
            assert_eq!(whole, Two { size: 24, one: 5, two: 6 });
            assert_eq!(read(at(&mut [16, 5]), "two").unwrap(), Two { size: 16, one: 5, two: 0 });
            assert_eq!(read(at(&mut [8]), "two").unwrap(), Two { size: 8, one: 0, two: 0 });
            assert_eq!(read(at(&mut [40, 5, 6, 0, 0]), "two").unwrap(), Two { size: 40, ..whole });
            let unknown = read(at(&mut [40, 5, 6, 0, 1]), "two").unwrap_err().message;
            assert!(unknown.contains("must be 0"), "{unknown}");
            for invalid in [0, 7, 12, 4104, u64::MAX] {
                let message = read(at(&mut [invalid]), "two").unwrap_err().message;
                assert_eq!(message, format!("two.size is {invalid}; set it to sizeof(Two), 24"));
            }
            assert_eq!(read::<Two>(std::ptr::null(), "two").unwrap_err().message, "two is NULL");
        }
    }

    #[test]
    fn only_fields_within_the_callers_size_are_filled() {
        let value = Two { size: 24, one: 5, two: 6 };
        // SAFETY: each array is as large as its size field says, or the size is invalid.
        unsafe {
            let mut smaller = [16, 1, 1, 1];
            fill(at(&mut smaller), value, "two").unwrap();
            assert_eq!(smaller, [16, 5, 1, 1]);
            let mut larger = [32, 1, 1, 1];
            fill(at(&mut larger), value, "two").unwrap();
            assert_eq!(larger, [32, 5, 6, 0]);
            assert!(
                fill(at(&mut [9]), value, "two").is_err()
                    && check::<Two>(at(&mut [9]), "two").is_err()
            );
        }
    }
}
