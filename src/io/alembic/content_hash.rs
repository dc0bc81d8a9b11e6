//! MurmurHash3 (x64, 128 bits, seed 0) by Austin Appleby, which is in the public domain.
//!
//! Alembic stores this hash in front of each array. Readers use it to recognise equal arrays, even
//! in different files.

use std::io::{self, Write};

const C: [u64; 2] = [0x87c3_7b91_1142_53d5, 0x4cf5_ad43_2745_937f];
const BLOCK: usize = 16;

/// The hash of an array's bytes.
pub type Digest = [u8; 16];

/// Hashes the bytes that are written to it.
#[derive(Default)]
pub struct ContentHasher {
    state: [u64; 2],
    bytes: u64,
    /// The bytes after the last complete block.
    rest: [u8; BLOCK],
}

impl ContentHasher {
    /// The hash of `bytes`.
    pub fn of(bytes: &[u8]) -> Digest {
        let mut hasher = Self::default();
        hasher.update(bytes);
        hasher.finish()
    }

    /// Appends bytes to the hashed data.
    pub fn update(&mut self, mut bytes: &[u8]) {
        let buffered = self.rest_length();
        self.bytes += bytes.len() as u64;
        if buffered > 0 {
            let (completing, after) = bytes.split_at(bytes.len().min(BLOCK - buffered));
            self.rest[buffered..][..completing.len()].copy_from_slice(completing);
            if buffered + completing.len() < BLOCK {
                return;
            }
            self.block(self.rest);
            bytes = after;
        }
        let (blocks, rest) = bytes.as_chunks();
        blocks.iter().for_each(|&block| self.block(block));
        self.rest[..rest.len()].copy_from_slice(rest);
    }

    fn rest_length(&self) -> usize {
        (self.bytes % BLOCK as u64) as usize
    }

    fn block(&mut self, block: [u8; BLOCK]) {
        let [a, b] = mixed(block);
        let [x, y] = &mut self.state;
        *x = (*x ^ a).rotate_left(27).wrapping_add(*y).wrapping_mul(5).wrapping_add(0x52dc_e729);
        *y = (*y ^ b).rotate_left(31).wrapping_add(*x).wrapping_mul(5).wrapping_add(0x3849_5ab5);
    }

    /// The hash of all bytes that were added.
    pub fn finish(mut self) -> Digest {
        let rest = self.rest_length();
        self.rest[rest..].fill(0);
        let [a, b] = mixed(self.rest);
        let [mut x, mut y] = self.state;
        (x, y) = (x ^ a ^ self.bytes, y ^ b ^ self.bytes);
        x = x.wrapping_add(y);
        y = y.wrapping_add(x);
        (x, y) = (avalanche(x), avalanche(y));
        x = x.wrapping_add(y);
        y = y.wrapping_add(x);
        let mut digest = Digest::default();
        digest[..8].copy_from_slice(&x.to_le_bytes());
        digest[8..].copy_from_slice(&y.to_le_bytes());
        digest
    }
}

impl Write for ContentHasher {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.update(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// The two halves of a block, each mixed with both constants. A block of zeros stays zero, so an
/// empty rest does not change the hash in [`finish`](ContentHasher::finish).
fn mixed(block: [u8; BLOCK]) -> [u64; 2] {
    let [a, b] = bytemuck::cast::<_, [[u8; 8]; 2]>(block).map(u64::from_le_bytes);
    [
        a.wrapping_mul(C[0]).rotate_left(31).wrapping_mul(C[1]),
        b.wrapping_mul(C[1]).rotate_left(33).wrapping_mul(C[0]),
    ]
}

fn avalanche(mut half: u64) -> u64 {
    for factor in [0xff51_afd7_ed55_8ccd, 0xc4ce_b9fe_1a85_ec53_u64] {
        half = (half ^ half >> 33).wrapping_mul(factor);
    }
    half ^ half >> 33
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spelled(digest: Digest) -> String {
        let halves = bytemuck::cast::<_, [[u8; 8]; 2]>(digest).map(u64::from_le_bytes);
        format!("{:016x}{:016x}", halves[0], halves[1])
    }

    #[test]
    fn known_texts_have_the_reference_hashes() {
        for (text, digest) in [
            ("", "00000000000000000000000000000000"),
            ("hello", "cbd8a7b341bd9b025b1e906a48ae1d19"),
            ("hello, world", "342fac623a5ebc8e4cdcbc079642414d"),
            ("19 Jan 2038 at 3:14:07 AM", "b89e5988b737affc664fc2950231b2cb"),
            ("The quick brown fox jumps over the lazy dog.", "cd99481f9ee902c9695da1a38987b6e7"),
        ] {
            assert_eq!(spelled(ContentHasher::of(text.as_bytes())), digest, "{text}");
        }
    }

    #[test]
    fn hashing_in_pieces_of_any_size_gives_the_same_hash() {
        let bytes: Vec<u8> = (0..=255).collect();
        for length in [0, 1, 15, 16, 17, 100, 256] {
            for piece in 1..40 {
                let mut hasher = ContentHasher::default();
                bytes[..length].chunks(piece).for_each(|piece| hasher.update(piece));
                assert_eq!(
                    hasher.finish(),
                    ContentHasher::of(&bytes[..length]),
                    "{length} {piece}"
                );
            }
        }
    }
}
