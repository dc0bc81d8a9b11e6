//! Decompresses LZF, a compression method of h5py. Packed data consists of literals and of
//! references to earlier bytes, which are copied.

use hdf5_reader::error::{Error, Result};

/// The number of this filter in HDF5.
pub const ID: u16 = 32000;

/// Unpacks a chunk. Every three bytes unpack to at most 264 bytes, so the chunk's size bounds the
/// memory.
pub fn unpack(packed: &[u8]) -> Result<Vec<u8>> {
    read(packed).ok_or_else(|| Error::InvalidData("damaged LZF data".to_owned()))
}

fn read(mut packed: &[u8]) -> Option<Vec<u8>> {
    let mut unpacked = Vec::new();
    while let Some((&control, rest)) = packed.split_first() {
        packed = rest;
        let low = usize::from(control & 0x1f);
        let mut length = usize::from(control >> 5);
        if length == 0 {
            let (run, rest) = packed.split_at_checked(low + 1)?;
            unpacked.extend_from_slice(run);
            packed = rest;
            continue;
        }
        let mut byte = || {
            let (&byte, rest) = packed.split_first()?;
            packed = rest;
            Some(usize::from(byte))
        };
        if length == 7 {
            length += byte()?;
        }
        let distance = (low << 8) + byte()? + 1;
        let start = unpacked.len().checked_sub(distance)?;
        // The copy may overlap the bytes that it appends, so bytes are copied one by one.
        for at in start..start + length + 2 {
            unpacked.push(unpacked[at]);
        }
    }
    Some(unpacked)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_lzf_copy_may_overlap_itself() {
        assert_eq!(unpack(&[1, 7, 8, 0x20, 1, 0xe0, 2, 0]).unwrap(), {
            let mut all = vec![7, 8, 7, 8, 7];
            all.extend([7; 11]);
            all
        });
    }

    #[test]
    fn truncated_data_and_invalid_lzf_distances_are_errors() {
        for damaged in [&[3, 1, 2][..], &[0x20], &[0x20, 0], &[0, 5, 0x20, 1], &[0, 5, 0xe0, 3]] {
            assert!(unpack(damaged).is_err(), "{damaged:?}");
        }
    }
}
