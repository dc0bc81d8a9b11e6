//! Binning beyond memory: particles put into runs of bins in a scratch file, sorted run by run.
//!
//! A run is a stretch of the Morton curve with as many particles as memory takes. Its particles are written
//! in pieces, each the Elias-Fano code of packed particles whose free upper bits name their bins in the run,
//! and behind it their attributes in the same order.

use std::io;
use std::ops::Range;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use bytemuck::{cast_slice, cast_slice_mut};
use rayon::prelude::*;

use crate::grid::MortonKey;
use crate::system::scratch::Scratch;

use super::bins::{Bins, RECORD_BITS, Store, tuple_bytes};
use super::elias_fano::EliasFano;
use super::slots::{Record, Slots};

/// Bytes of a piece before it is coded, at the most: small enough to be sorted in a second-level cache.
const PIECE: usize = 1 << 19;
/// Particles of a piece that is not the last, at the least.
const FEWEST: usize = 16;
/// The extra room that coding a piece takes in memory, in pieces.
const CODING: usize = 2;
const RECORD_MASK: Record = (1 << RECORD_BITS) - 1;

/// Particles in the order of runs, not yet sorted within them.
#[derive(Debug)]
pub struct SpilledBins {
    keys: Vec<MortonKey>,
    /// Where each bin's particles begin, and where the last one's end.
    first: Vec<usize>,
    pub(super) components: Vec<usize>,
    runs: Vec<Range<usize>>,
    scratch: Scratch,
    /// The pieces of every run.
    pieces: Vec<Mutex<Vec<Piece>>>,
}

/// Where a piece is.
#[derive(Debug, Clone, Copy)]
struct Piece {
    at: u64,
    particles: usize,
}

/// Bytes that coding leaves of a packed particle, at the least.
const CODED: usize = 6;

impl SpilledBins {
    /// Bytes that a particle with attributes of so many components takes in the scratch file, at the least.
    #[must_use]
    pub fn least_particle_bytes(components: &[usize]) -> u64 {
        (tuple_bytes(components) - size_of::<Record>() + CODED) as u64
    }

    pub(super) fn new(
        keys: Vec<MortonKey>,
        first: Vec<usize>,
        components: Vec<usize>,
        runs: Vec<Range<usize>>,
        folder: &Path,
    ) -> io::Result<Self> {
        let pieces = runs.iter().map(|_| Mutex::default()).collect();
        Ok(Self { keys, first, components, runs, scratch: Scratch::in_folder(folder)?, pieces })
    }

    /// The runs, as ranges of bins.
    #[must_use]
    pub fn runs(&self) -> &[Range<usize>] {
        &self.runs
    }

    /// Numbers of a particle's attributes.
    fn width(&self) -> usize {
        self.components.iter().sum()
    }

    /// The code of so many particles of run number `run`.
    fn code(&self, run: usize, particles: usize) -> EliasFano {
        let last_bin = self.runs[run].len() as Record - 1;
        EliasFano::new(particles, last_bin << RECORD_BITS | RECORD_MASK)
    }

    /// Buffers for one of so many threads, which take `bytes` together.
    pub(super) fn buffers(&self, threads: usize, bytes: usize) -> RunBuffers<'_> {
        let tuple = tuple_bytes(&self.components);
        let full = bytes / tuple / (threads * (self.runs.len() + CODING));
        let full = full.min(PIECE / tuple).max(FEWEST);
        let (records, values) = self
            .runs
            .iter()
            .map(|_| (Vec::with_capacity(full), Vec::with_capacity(full * self.width())))
            .unzip();
        RunBuffers { spilled: self, full, records, values }
    }

    /// Reads run number `run` piece by piece, and puts each particle into its bin's place.
    ///
    /// # Errors
    /// Where the scratch file cannot be read.
    pub fn load(&self, run: usize) -> io::Result<Bins> {
        let bins = self.runs[run].clone();
        let begin = self.first[bins.start];
        let slots = Slots::new(self.first[bins.end] - begin, &self.components);
        let next: Vec<AtomicUsize> =
            self.first[bins.clone()].iter().map(|first| AtomicUsize::new(first - begin)).collect();
        let width = self.width();
        let pieces = self.pieces[run].lock().unwrap_or_else(PoisonError::into_inner);
        pieces.par_iter().try_for_each(|piece| {
            let code = self.code(run, piece.particles);
            let mut words = vec![0_u64; code.words()];
            self.scratch.read_at(piece.at, cast_slice_mut(&mut words))?;
            let mut values = vec![0_f32; width * piece.particles];
            self.scratch.read_at(piece.at + 8 * words.len() as u64, cast_slice_mut(&mut values))?;
            let mut records = Vec::with_capacity(piece.particles);
            records.extend(code.decode(&words));
            let mut values = values.chunks_exact(width.max(1));
            for bin in records.chunk_by(|a, b| a >> RECORD_BITS == b >> RECORD_BITS) {
                let slot = next[(bin[0] >> RECORD_BITS) as usize].fetch_add(bin.len(), Ordering::Relaxed);
                for (slot, record) in (slot..).zip(bin) {
                    let values = values.next().unwrap_or_default();
                    slots.put(slot, record & RECORD_MASK);
                    slots.put_attributes(slot, values.iter().copied());
                }
            }
            Ok::<_, io::Error>(())
        })?;
        let first = self.first[bins.start..=bins.end].iter().map(|first| first - begin).collect();
        Ok(Bins::of_slots(slots, self.keys[bins].to_vec(), first, self.components.clone()))
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
            without: vec![0; self.components.len()],
            store: Store::File { scratch, records_at, attributes_at },
        };
        Ok(SortedStore { bins, written: 0 })
    }
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
        scratch.write_at(records_at + self.written * 8, cast_slice(records))?;
        for ((values, at), &n) in attributes.iter().zip(attributes_at).zip(&self.bins.components) {
            scratch.write_at(at + self.written * 4 * n as u64, cast_slice(values))?;
        }
        self.bins.without.iter_mut().zip(&run.without).for_each(|(all, more)| *all += more);
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
    /// Particles at which a buffer is written.
    full: usize,
    records: Vec<Vec<Record>>,
    /// All components of all attributes of one particle after the other.
    values: Vec<Vec<f32>>,
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
        let records = &mut self.records[run];
        records.push(in_run << RECORD_BITS | record);
        self.values[run].extend(attributes);
        if records.len() == self.full { self.write(run) } else { Ok(()) }
    }

    /// Writes what is left.
    pub(super) fn flush(mut self) -> io::Result<()> {
        (0..self.records.len()).try_for_each(|run| self.write(run))
    }

    fn write(&mut self, run: usize) -> io::Result<()> {
        let Self { spilled, .. } = *self;
        let (records, values) = (&mut self.records[run], &mut self.values[run]);
        if records.is_empty() {
            return Ok(());
        }
        let code = spilled.code(run, records.len());
        let order = code.order(records);
        let words = code.encode(order.iter().map(|&i| records[i as usize]));
        let width = spilled.width();
        let tuple = |&i: &u32| &values[i as usize * width..][..width];
        let sorted: Vec<f32> = order.iter().flat_map(tuple).copied().collect();
        let [words, sorted]: [&[u8]; 2] = [cast_slice(&words), cast_slice(&sorted)];
        let at = spilled.scratch.reserve((words.len() + sorted.len()) as u64);
        spilled.scratch.write_at(at, words)?;
        spilled.scratch.write_at(at + words.len() as u64, sorted)?;
        let mut pieces = spilled.pieces[run].lock().unwrap_or_else(PoisonError::into_inner);
        pieces.push(Piece { at, particles: records.len() });
        records.clear();
        values.clear();
        Ok(())
    }
}
