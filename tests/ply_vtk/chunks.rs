//! How long runs of records stay in order.

use std::io::{self, Write};

use meniscus::io::encode::write_chunks;

fn put_number(range: std::ops::Range<usize>, out: &mut Vec<u8>) {
    range.for_each(|i| out.extend_from_slice(&(i as u32).to_le_bytes()));
}

#[test]
fn chunks_are_written_in_order_on_any_number_of_threads() {
    for count in [0, 1, 16 << 10, (16 << 10) + 1, 300_000] {
        let wanted: Vec<u8> = (0..count as u32).flat_map(u32::to_le_bytes).collect();
        for threads in [1, 2, 5] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let got = pool.install(|| {
                let mut out = Vec::new();
                write_chunks(&mut out, count, put_number).unwrap();
                out
            });
            assert!(got == wanted, "{count} records on {threads} threads");
        }
    }
}

#[test]
fn a_writer_that_fails_ends_the_writing_with_its_error() {
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
    for room in [0, 1, 65_536, 1_000_000, 1_199_999] {
        let fault = write_chunks(&mut Full(room), 300_000, put_number).unwrap_err();
        assert_eq!(fault.kind(), io::ErrorKind::StorageFull, "room for {room} bytes");
    }
    write_chunks(&mut Full(1_200_000), 300_000, put_number).unwrap();
}
