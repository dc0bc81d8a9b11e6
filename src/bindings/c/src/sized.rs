//! Structures with their size as the first field, so that they can grow: a caller that was compiled
//! with an older header passes a smaller one, and one with a newer header a larger one.

use crate::status::{Failure, Outcome};

/// Upper bound of the size of any structure: larger values are invalid.
const LARGEST: usize = 4096;

/// A C structure whose first field is its size in bytes, of type `usize`.
///
/// # Safety
/// All fields are numbers, nullable pointers or nullable callbacks: zeros are valid, and so is any
/// value that a caller may write.
pub unsafe trait Growing: Copy {
    /// The name in C.
    const NAME: &str;
}

/// The size in a structure.
///
/// # Safety
/// `at` is NULL or points to a structure.
unsafe fn announced<T: Growing>(at: *const T, what: &str) -> Outcome<usize> {
    if at.is_null() {
        return Err(Failure::request(format!("{what} is NULL")));
    }
    // SAFETY: a structure begins with its size; it may lie at any address.
    let size = unsafe { at.cast::<usize>().read_unaligned() };
    if !(size_of::<usize>()..=LARGEST).contains(&size) || !size.is_multiple_of(size_of::<usize>()) {
        let (name, own) = (T::NAME, size_of::<T>());
        return Err(Failure::request(format!(
            "{what}: its size is {size}; sizeof({name}) is {own}"
        )));
    }
    Ok(size)
}

/// Copies a structure: fields beyond a smaller one become 0, and fields beyond this type must be 0.
///
/// # Safety
/// `at` is NULL or points to as many bytes as the structure's size field.
pub unsafe fn read<T: Growing>(at: *const T, what: &str) -> Outcome<T> {
    // SAFETY: as for this function.
    let size = unsafe { announced(at, what) }?;
    // SAFETY: of `size` bytes, says the caller.
    let bytes = unsafe { std::slice::from_raw_parts(at.cast::<u8>(), size) };
    let (known, unknown) = bytes.split_at(size.min(size_of::<T>()));
    if unknown.iter().any(|&byte| byte != 0) {
        let what =
            format!("{what}: it is of a newer version, and asks for what this one does not have");
        return Err(Failure::request(what));
    }
    // SAFETY: zeros are valid.
    let mut value: T = unsafe { std::mem::zeroed() };
    // SAFETY: no more bytes than there are on either side, and whatever they are is valid.
    unsafe { std::ptr::copy_nonoverlapping(known.as_ptr(), (&raw mut value).cast(), known.len()) };
    Ok(value)
}

/// Checks that a structure can be filled later.
///
/// # Safety
/// As for [`read`].
pub unsafe fn check<T: Growing>(at: *mut T, what: &str) -> Outcome {
    // SAFETY: as for this function.
    unsafe { announced(at.cast_const(), what) }.map(drop)
}

/// Fills the fields that the caller knows; additional fields of a larger structure become 0.
///
/// # Safety
/// As for [`read`], and no other thread reads or writes the structure.
pub unsafe fn fill<T: Growing>(at: *mut T, value: T, what: &str) -> Outcome {
    let own = size_of::<usize>();
    // SAFETY: as for this function.
    let size = unsafe { announced(at.cast_const(), what) }?;
    let known = size.min(size_of::<T>());
    let (from, to) = ((&raw const value).cast::<u8>(), at.cast::<u8>());
    // SAFETY: no more bytes than there are on either side; the size stays what it was.
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

    // SAFETY: numbers.
    unsafe impl Growing for Two {
        const NAME: &str = "Two";
    }

    fn at(numbers: &mut [u64]) -> *mut Two {
        numbers.as_mut_ptr().cast()
    }

    #[test]
    fn short_structures_are_completed_and_unknown_fields_must_be_zero() {
        // SAFETY: each is as large as it says, or says nonsense and is not looked at.
        unsafe {
            let whole = read(at(&mut [24, 5, 6]), "two").unwrap();
            assert_eq!(whole, Two { size: 24, one: 5, two: 6 });
            assert_eq!(read(at(&mut [16, 5]), "two").unwrap(), Two { size: 16, one: 5, two: 0 });
            assert_eq!(read(at(&mut [8]), "two").unwrap(), Two { size: 8, one: 0, two: 0 });
            assert_eq!(read(at(&mut [40, 5, 6, 0, 0]), "two").unwrap(), Two { size: 40, ..whole });
            assert!(read(at(&mut [40, 5, 6, 0, 1]), "two").unwrap_err().message.contains("newer"));
            for nonsense in [0, 7, 12, 4104, u64::MAX] {
                let message = read(at(&mut [nonsense]), "two").unwrap_err().message;
                assert_eq!(message, format!("two: its size is {nonsense}; sizeof(Two) is 24"));
            }
            assert_eq!(read::<Two>(std::ptr::null(), "two").unwrap_err().message, "two is NULL");
        }
    }

    #[test]
    fn only_the_fields_that_the_caller_knows_are_filled() {
        let value = Two { size: 24, one: 5, two: 6 };
        // SAFETY: each is as large as it says.
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
