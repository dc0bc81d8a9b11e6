//! Mutates small files. A number determines the mutation.

use crate::scene::Random;

/// Numbers that are likely to reveal errors in the use of counts and sizes.
const NUMBERS: [u64; 14] = [
    0,
    1,
    2,
    3,
    0x7f,
    0x80,
    0xff,
    0x7fff,
    0xffff,
    0x7fff_ffff,
    0x8000_0000,
    0xffff_ffff,
    1 << 63,
    u64::MAX,
];

/// Returns mutation number `number` of one of the seeds. A mutation may insert one of the words.
pub fn mutated(seeds: &[Vec<u8>], words: &[&str], number: u64) -> Vec<u8> {
    let mut random = Random::new(number.wrapping_mul(0x9e37_79b9_7f4a_7c15));
    let mut pick = |below: usize| (random.bits() % below.max(1) as u64) as usize;
    let mut data = seeds[pick(seeds.len())].clone();
    for _ in 0..[1, 1, 1, 2, 3, 6][pick(6)] {
        let at = pick(data.len());
        match pick(10) {
            0..2 if !data.is_empty() => data[at] ^= 1 << pick(8),
            2 if !data.is_empty() => data[at] = pick(256) as u8,
            3..5 => {
                put_number(&mut data, at, NUMBERS[pick(NUMBERS.len())], 1 << pick(4), pick(2) == 0)
            }
            5 => {
                let end = at + pick((data.len() - at).min(64) + 1);
                data.drain(at..end);
            }
            6 => {
                let piece = data[at..at + pick((data.len() - at).min(64) + 1)].to_vec();
                let to = pick(data.len());
                data.splice(to..to, piece);
            }
            7 => {
                let other = &seeds[pick(seeds.len())];
                let from = pick(other.len());
                data.truncate(at);
                data.extend_from_slice(&other[from..]);
            }
            8 => change_digits(&mut data, at, NUMBERS[pick(NUMBERS.len())]),
            _ => {
                if let Some(word) = words.get(pick(words.len())) {
                    let end = if pick(2) == 0 { at } else { (at + word.len()).min(data.len()) };
                    data.splice(at..end, word.bytes());
                }
            }
        }
    }
    data
}

/// Replaces `width` bytes with the bytes of a number.
fn put_number(data: &mut [u8], at: usize, number: u64, width: usize, big_endian: bool) {
    let mut bytes = number.to_le_bytes()[..width].to_vec();
    if big_endian {
        bytes.reverse();
    }
    data[at..].iter_mut().zip(bytes).for_each(|(to, byte)| *to = byte);
}

/// Replaces the next run of decimal digits, from `at` on, with a number.
fn change_digits(data: &mut Vec<u8>, at: usize, number: u64) {
    let Some(first) = data[at..].iter().position(u8::is_ascii_digit).map(|first| at + first) else {
        return;
    };
    let digits = data[first..].iter().take_while(|byte| byte.is_ascii_digit()).count();
    data.splice(first..first + digits, number.to_string().bytes());
}
