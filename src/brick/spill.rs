//! Binning beyond memory: particles dropped into runs of bins in a scratch file, sorted run by run.
//!
//! A run is a stretch of the Morton curve with as many particles as memory takes. In the file each particle
//! is a tuple: the packed particle, whose free upper bits name its bin in the run, and its attributes.

use std::io;
use std::ops::Range;
use std::path::Path;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};

use rayon::prelude::*;

use crate::grid::MortonKey;
use crate::scratch::Scratch;

use super::bins::{Bins, RECORD_BITS, Record, Slots, Store};

/// Particles that one thread reads at once.
const PIECE: usize = 1 << 15;

/// Particles in the order of runs, not yet sorted within them.
#[derive(Debug)]
pub struct SpilledBins {
    keys: Vec<MortonKey>,
    /// Where each bin's particles begin, and where the last one's end.
    first: Vec<usize>,
    pub(super) components: Vec<usize>,
    runs: Vec<Range<usize>>,
    scratch: Scratch,
    /// The next free byte of every run.
    next: Vec<AtomicU64>,
}

impl SpilledBins {
    pub(super) fn new(
        keys: Vec<MortonKey>,
        first: Vec<usize>,
        components: Vec<usize>,
        runs: Vec<Range<usize>>,
        folder: &Path,
    ) -> io::Result<Self> {
        let scratch = Scratch::in_folder(folder)?;
        let mut spilled = Self { keys, first, components, runs, scratch, next: Vec::new() };
        let begin = |run: &Range<usize>| {
            AtomicU64::new(spilled.first[run.start] as u64 * spilled.tuple_bytes() as u64)
        };
        spilled.next = spilled.runs.iter().map(begin).collect();
        Ok(spilled)
    }

    /// The runs, as ranges of bins.
    #[must_use]
    pub fn runs(&self) -> &[Range<usize>] {
        &self.runs
    }

    /// Bytes of a particle in the file.
    pub(super) fn tuple_bytes(&self) -> usize {
        tuple_bytes(&self.components)
    }

    /// Buffers for one thread, `tuples` particles for each run.
    pub(super) fn buffers(&self, tuples: usize) -> RunBuffers<'_> {
        let full = tuples * self.tuple_bytes();
        RunBuffers { spilled: self, full, buffers: vec![Vec::new(); self.runs.len()] }
    }

    /// Reads run number `run` piece by piece, and drops each particle into its bin's place.
    ///
    /// # Errors
    /// Where the scratch file cannot be read.
    pub fn load(&self, run: usize) -> io::Result<Bins> {
        let bins = self.runs[run].clone();
        let begin = self.first[bins.start];
        let count = self.first[bins.end] - begin;
        let tuple_bytes = self.tuple_bytes();
        let slots = Slots::new(count, &self.components);
        let next: Vec<AtomicUsize> =
            self.first[bins.clone()].iter().map(|first| AtomicUsize::new(first - begin)).collect();
        let pieces: Vec<usize> = (0..count).step_by(PIECE).collect();
        pieces.into_par_iter().try_for_each(|piece| {
            let mut bytes = vec![0; PIECE.min(count - piece) * tuple_bytes];
            self.scratch.read_at(((begin + piece) * tuple_bytes) as u64, &mut bytes)?;
            for tuple in bytes.chunks_exact(tuple_bytes) {
                let (record, values) = tuple.split_at(size_of::<Record>());
                let record = Record::from_ne_bytes(record.try_into().expect("a record's bytes"));
                let slot = next[(record >> RECORD_BITS) as usize].fetch_add(1, Ordering::Relaxed);
                let (values, _) = values.as_chunks::<4>();
                slots.put(
                    slot,
                    record & ((1 << RECORD_BITS) - 1),
                    values.iter().map(|x| f32::from_ne_bytes(*x)),
                );
            }
            Ok::<_, io::Error>(())
        })?;
        Ok(Bins {
            keys: self.keys[bins.clone()].to_vec(),
            first: self.first[bins.start..=bins.end].iter().map(|first| first - begin).collect(),
            components: self.components.clone(),
            store: slots.into_store(),
        })
    }

    /// A place for all runs once they are sorted, to be read bin by bin; this file is then done with.
    ///
    /// # Errors
    /// Where the scratch file cannot be created.
    pub fn sorted_store(&self, folder: &Path) -> io::Result<SortedStore> {
        let scratch = Scratch::in_folder(folder)?;
        let particles = *self.first.last().expect("there is always an end") as u64;
        let records_at = scratch.reserve(particles * size_of::<Record>() as u64);
        let attributes_at =
            self.components.iter().map(|&n| scratch.reserve(particles * size_of::<f32>() as u64 * n as u64));
        let attributes_at = attributes_at.collect();
        let bins = Bins {
            keys: self.keys.clone(),
            first: self.first.clone(),
            components: self.components.clone(),
            store: Store::File { scratch, records_at, attributes_at },
        };
        Ok(SortedStore { bins, written: 0 })
    }
}

/// Bytes of a particle with attributes of so many components.
pub(super) fn tuple_bytes(components: &[usize]) -> usize {
    size_of::<Record>() + size_of::<f32>() * components.iter().sum::<usize>()
}

/// Sorted bins on their way into a scratch file.
#[derive(Debug)]
pub struct SortedStore {
    bins: Bins,
    /// Particles so far.
    written: u64,
}

impl SortedStore {
    /// Writes the next run.
    ///
    /// # Errors
    /// Where the scratch file cannot be written.
    pub fn push(&mut self, run: &Bins) -> io::Result<()> {
        let (Store::Memory { records, attributes }, Store::File { scratch, records_at, attributes_at }) =
            (&run.store, &self.bins.store)
        else {
            unreachable!("a run is in memory, and the store is a file");
        };
        scratch.write_at(records_at + self.written * 8, bytemuck::cast_slice(records))?;
        for ((values, at), &n) in attributes.iter().zip(attributes_at).zip(&self.bins.components) {
            scratch.write_at(at + self.written * 4 * n as u64, bytemuck::cast_slice(values))?;
        }
        self.written += records.len() as u64;
        Ok(())
    }

    /// All bins, to be read one by one.
    #[must_use]
    pub fn finish(self) -> Bins {
        self.bins
    }
}

/// One thread's particles on their way into runs.
#[derive(Debug)]
pub(super) struct RunBuffers<'a> {
    spilled: &'a SpilledBins,
    /// Bytes at which a buffer is written.
    full: usize,
    buffers: Vec<Vec<u8>>,
}

impl RunBuffers<'_> {
    /// Adds a particle of bin number `bin`, which lies in run number `run`.
    pub(super) fn push(
        &mut self,
        run: usize,
        bin: usize,
        record: Record,
        attributes: impl Iterator<Item = f32>,
    ) -> io::Result<()> {
        let in_run = (bin - self.spilled.runs[run].start) as Record;
        let buffer = &mut self.buffers[run];
        buffer.extend_from_slice(&(in_run << RECORD_BITS | record).to_ne_bytes());
        attributes.for_each(|value| buffer.extend_from_slice(&value.to_ne_bytes()));
        if buffer.len() >= self.full { self.write(run) } else { Ok(()) }
    }

    /// Writes what is left.
    pub(super) fn flush(mut self) -> io::Result<()> {
        (0..self.buffers.len()).try_for_each(|run| self.write(run))
    }

    fn write(&mut self, run: usize) -> io::Result<()> {
        let buffer = &mut self.buffers[run];
        let at = self.spilled.next[run].fetch_add(buffer.len() as u64, Ordering::Relaxed);
        self.spilled.scratch.write_at(at, buffer)?;
        buffer.clear();
        Ok(())
    }
}
