//! Tests that parallel encoding writes the pieces of a long file in order.

use std::io::{self, Write};

use meniscus::internals::io::encode::write_pieces;

/// Number of values in a piece. Some pieces are empty.
fn length(piece: usize) -> usize {
    piece * 7919 % 4096 / 16 * 16
}

fn put_numbers(piece: usize, out: &mut Vec<u8>) -> io::Result<()> {
    (0..length(piece)).for_each(|i| out.extend((piece + i).to_le_bytes()));
    Ok(())
}

fn bytes(pieces: usize) -> Vec<u8> {
    (0..pieces).flat_map(|p| (p..p + length(p)).flat_map(usize::to_le_bytes)).collect()
}

fn written(
    pieces: usize,
    encode: impl Fn(usize, &mut Vec<u8>) -> io::Result<()> + Sync,
) -> io::Result<Vec<u8>> {
    let mut out = Vec::new();
    write_pieces(&mut out, pieces, encode).map(|()| out)
}

#[test]
fn pieces_are_written_in_order_on_any_number_of_threads() {
    for pieces in [0, 1, 2, 19, 20, 21, 300] {
        for threads in [1, 2, 5] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let got = pool.install(|| written(pieces, put_numbers)).unwrap();
            assert!(got == bytes(pieces), "{pieces} pieces on {threads} threads");
        }
    }
}

#[test]
fn an_error_of_the_writer_ends_the_write() {
    struct Full(usize);
    impl Write for Full {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            if self.0 == 0 {
                return Err(io::ErrorKind::StorageFull.into());
            }
            let taken = bytes.len().min(self.0);
            self.0 -= taken;
            Ok(taken)
        }
        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }
    let all = bytes(100).len();
    for room in [0, 1, all / 3, all - 1] {
        let fault = write_pieces(&mut Full(room), 100, put_numbers).unwrap_err();
        assert_eq!(fault.kind(), io::ErrorKind::StorageFull, "room for {room} of {all} bytes");
    }
    write_pieces(&mut Full(all), 100, put_numbers).unwrap();
}

#[test]
fn the_first_failing_piece_is_reported_after_all_before_it_are_written() {
    for first in [0, 1, 7, 8, 50, 99] {
        let mut out = Vec::new();
        let fault = write_pieces(&mut out, 100, |piece, out| {
            put_numbers(piece, out)?;
            if piece < first { Ok(()) } else { Err(io::Error::other(format!("piece {piece}"))) }
        });
        assert_eq!(fault.unwrap_err().to_string(), format!("piece {first}"));
        assert!(out == bytes(first), "{first} pieces before the fault");
    }
}
