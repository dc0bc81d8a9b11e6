//! Long runs of records, encoded on all threads and written in order.

use std::io::{self, Write};
use std::ops::Range;

/// Records a chunk: some hundred KiB of bytes, so that a chunk is still in a core's cache when it is written.
const CHUNK: usize = 16 << 10;

/// Writes records 0 to `count` to `out`, in order: `encode` appends those of a range to a buffer.
///
/// While this thread writes one batch of chunks, the pool encodes the next, so no more is held than two
/// chunks a thread in each. The bytes depend on `encode` alone, not on the number of threads.
///
/// # Errors
/// The first error of `out`; nothing is written after it.
pub fn write_chunks(
    out: &mut dyn Write,
    count: usize,
    encode: impl Fn(Range<usize>, &mut Vec<u8>) + Sync,
) -> io::Result<()> {
    let chunks = count.div_ceil(CHUNK);
    let batch = (2 * rayon::current_num_threads()).min(chunks);
    let mut ready = vec![Vec::new(); batch];
    let mut next = ready.clone();
    let encode = &encode;
    let mut written = 0;
    for first in (0..chunks).step_by(batch.max(1)) {
        written =
            encode_while(&mut next, first..chunks, count, encode, || write_all(out, &ready[..written]))?;
        std::mem::swap(&mut ready, &mut next);
    }
    write_all(out, &ready[..written])
}

/// Encodes as many of `chunks` as there are `buffers`, on the pool, while `meanwhile` runs on this thread.
/// Returns how many.
fn encode_while(
    buffers: &mut [Vec<u8>],
    chunks: Range<usize>,
    count: usize,
    encode: &(impl Fn(Range<usize>, &mut Vec<u8>) + Sync),
    meanwhile: impl FnOnce() -> io::Result<()>,
) -> io::Result<usize> {
    let encoded = chunks.len().min(buffers.len());
    rayon::in_place_scope(|scope| {
        for (chunk, buffer) in chunks.zip(buffers) {
            scope.spawn(move |_| {
                buffer.clear();
                encode(chunk * CHUNK..((chunk + 1) * CHUNK).min(count), buffer);
            });
        }
        meanwhile()
    })?;
    Ok(encoded)
}

fn write_all(out: &mut dyn Write, buffers: &[Vec<u8>]) -> io::Result<()> {
    buffers.iter().try_for_each(|buffer| out.write_all(buffer))
}
