//! Binning for particles that do not fit into memory: particles go into runs of bins, first in
//! memory and then in a scratch file, and are sorted run by run.
//!
//! A run is a stretch of the Morton curve, and all particles of a run are sorted at once. The
//! particles of a run are stored in pieces. A piece is the Elias-Fano code of packed particles,
//! followed by the particles' attributes in the same order. The free upper bits of a packed
//! particle hold the number of its bin in the run. Coded particles take less memory than sorted
//! ones.

use std::borrow::Cow;
use std::io;
use std::ops::Range;
use std::path::Path;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use bytemuck::{cast_slice, cast_slice_mut};
use rayon::prelude::*;

use crate::grid::MortonKey;
use crate::system::scratch::Scratch;

use super::bin::Tuples;
use super::bins::{Bins, ParticleStore, RECORD_BITS, tuple_bytes};
use super::elias_fano::EliasFano;
use super::slabs::Slabs;
use super::slots::{Record, Slots};

/// Maximum size of a piece before compression, in bytes. A piece of this size can be sorted in a
/// processor's level-2 cache.
const PIECE: usize = 1 << 19;
/// Minimum number of particles in a piece, except in the last piece that a buffer writes.
const FEWEST: usize = 16;
/// The additional memory for compressing a piece, as a multiple of the size of a piece.
const CODING: usize = 2;
const RECORD_MASK: Record = (1 << RECORD_BITS) - 1;

/// Particles grouped by run, and not yet sorted within the runs.
#[derive(Debug)]
pub struct SpilledBins {
    keys: Vec<MortonKey>,
    /// The index of each bin's first particle; the last entry is the number of particles.
    first: Vec<usize>,
    pub(super) components: Vec<usize>,
    runs: Vec<Range<usize>>,
    scratch: Scratch,
    run_particles: Vec<Mutex<RunParticles>>,
    memory: SpillBudget,
}

/// The particles of a run.
#[derive(Debug)]
struct RunParticles {
    /// The pieces of the run. Pieces in memory are in the order of their positions in `memory`.
    pieces: Vec<RunPiece>,
    memory: Slabs,
}

impl RunParticles {
    fn take(&mut self) -> Self {
        Self { pieces: std::mem::take(&mut self.pieces), memory: self.memory.take() }
    }
}

/// The memory that pieces may take.
#[derive(Debug)]
struct SpillBudget {
    /// Maximum bytes of the pieces in memory and of the data that a visitor keeps from the runs
    /// that it has received, added together.
    most: u64,
    /// Bytes that pieces take.
    taken: AtomicU64,
}

impl SpillBudget {
    /// Reserves `bytes` if the limit allows it; returns whether the bytes were reserved.
    fn reserve(&self, bytes: u64) -> bool {
        let fitting = |taken: u64| Some(taken + bytes).filter(|&taken| taken <= self.most);
        self.taken.fetch_update(Ordering::Relaxed, Ordering::Relaxed, fitting).is_ok()
    }

    fn release(&self, bytes: u64) {
        self.taken.fetch_sub(bytes, Ordering::Relaxed);
    }

    fn taken(&self) -> u64 {
        self.taken.load(Ordering::Relaxed)
    }
}

/// Particles of a run that are stored together.
#[derive(Debug)]
struct RunPiece {
    particles: usize,
    at: PieceLocation,
}

/// The position of the words of a piece. The words are the code of its packed particles, followed
/// by the components of all attributes, particle by particle.
#[derive(Debug)]
enum PieceLocation {
    /// The index of the first word in the memory of the piece's run.
    Memory(usize),
    /// The byte offset in the scratch file.
    File(u64),
}

/// Estimated minimum bytes of a coded particle, for large pieces of runs with thousands of bins.
const CODED: usize = 6;

impl SpilledBins {
    /// Estimated lower bound of the bytes that a particle takes before it is sorted. `components`
    /// has the number of components of each attribute.
    pub fn least_particle_bytes(components: &[usize]) -> u64 {
        (tuple_bytes(components) - size_of::<Record>() + CODED) as u64
    }

    pub(super) fn new(
        keys: Vec<MortonKey>,
        first: Vec<usize>,
        components: Vec<usize>,
        runs: Vec<Range<usize>>,
        folder: &Path,
        memory_bytes: u64,
    ) -> io::Result<Self> {
        let slab = Slabs::slab_bytes(memory_bytes / runs.len().max(1) as u64);
        let empty = || RunParticles { pieces: Vec::new(), memory: Slabs::new(slab) };
        let run_particles = runs.iter().map(|_| empty().into()).collect();
        let memory = SpillBudget { most: memory_bytes, taken: AtomicU64::new(0) };
        Ok(Self {
            keys,
            first,
            components,
            runs,
            scratch: Scratch::in_folder(folder)?,
            run_particles,
            memory,
        })
    }

    fn run_particles(&self, run: usize) -> MutexGuard<'_, RunParticles> {
        self.run_particles[run].lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The runs, as ranges of bins.
    pub fn runs(&self) -> &[Range<usize>] {
        &self.runs
    }

    /// Total number of components of a particle's attributes.
    fn width(&self) -> usize {
        self.components.iter().sum()
    }

    /// The code for `particles` particles of run number `run`.
    fn code(&self, run: usize, particles: usize) -> EliasFano {
        let last_bin = self.runs[run].len() as Record - 1;
        EliasFano::new(particles, last_bin << RECORD_BITS | RECORD_MASK)
    }

    /// Number of words of a piece with `particles` particles of run number `run`.
    fn words(&self, run: usize, particles: usize) -> usize {
        let values = size_of::<f32>() * self.width() * particles;
        self.code(run, particles).words() + values.div_ceil(size_of::<u64>())
    }

    /// Creates the buffers of one thread. The buffers of all `threads` take about `bytes` in total.
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

    /// Passes all bins to `take`, one run per call. `take` returns the number of bytes that it has
    /// kept in memory so far. Pieces of the remaining runs move to the scratch file to make room
    /// for these bytes.
    ///
    /// # Errors
    /// If `take` fails, or if the scratch file cannot be read or written.
    pub fn visit(self, take: impl FnMut(&Bins) -> io::Result<u64>) -> io::Result<()> {
        self.drain(take)
    }

    fn drain(&self, mut take: impl FnMut(&Bins) -> io::Result<u64>) -> io::Result<()> {
        for run in 0..self.runs.len() {
            let kept = take(&self.sorted(run)?)?;
            // For the next run, `take` will probably keep the average memory per run so far. Twice
            // the average is reserved, because the next run can be larger.
            let reserved = kept.saturating_add(2 * kept / (run as u64 + 1));
            self.limit_memory(self.memory.most.saturating_sub(reserved))?;
        }
        Ok(())
    }

    /// Moves pieces to the scratch file until the pieces in memory take at most `bytes`, beginning
    /// with the pieces that are needed last.
    fn limit_memory(&self, bytes: u64) -> io::Result<()> {
        for run in (0..self.runs.len()).rev() {
            let RunParticles { pieces, memory } = &mut *self.run_particles(run);
            for piece in pieces.iter_mut().rev() {
                if self.memory.taken() <= bytes {
                    return Ok(());
                }
                if let PieceLocation::Memory(at) = piece.at {
                    let words = memory.get(at..at + self.words(run, piece.particles));
                    let in_file = self.scratch.append(cast_slice(&words))?;
                    piece.at = PieceLocation::File(in_file);
                    self.memory.release(memory.truncate(at));
                }
            }
        }
        Ok(())
    }

    /// Adds a piece with `particles` particles to run number `run`: in memory if there is room, and
    /// otherwise in the scratch file.
    fn add_piece(&self, run: usize, particles: usize, words: &[u64]) -> io::Result<()> {
        if !self.add_in_memory(run, particles, words) {
            let at = PieceLocation::File(self.scratch.append(cast_slice(words))?);
            self.run_particles(run).pieces.push(RunPiece { particles, at });
        }
        Ok(())
    }

    /// Keeps a piece in memory if possible; returns whether the budget and the system had memory
    /// for the piece.
    fn add_in_memory(&self, run: usize, particles: usize, words: &[u64]) -> bool {
        let RunParticles { pieces, memory } = &mut *self.run_particles(run);
        let more = memory.bytes_for(words.len());
        if !self.memory.reserve(more) {
            return false;
        }
        let added = memory.push(words);
        match added {
            Ok(at) => pieces.push(RunPiece { particles, at: PieceLocation::Memory(at) }),
            Err(_) => self.memory.release(more),
        }
        added.is_ok()
    }

    /// Returns the words of a piece of run number `run`. `memory` holds those pieces of the run
    /// that are in memory.
    fn read<'a>(
        &self,
        run: usize,
        piece: &RunPiece,
        memory: &'a Slabs,
    ) -> io::Result<Cow<'a, [u64]>> {
        let len = self.words(run, piece.particles);
        match piece.at {
            PieceLocation::Memory(at) => Ok(memory.get(at..at + len)),
            PieceLocation::File(at) => {
                let mut words = vec![0; len];
                self.scratch.read_at(at, cast_slice_mut(&mut words))?;
                Ok(words.into())
            }
        }
    }

    /// Takes run number `run` piece by piece, and puts each particle into a slot of its bin.
    fn sorted(&self, run: usize) -> io::Result<Bins> {
        let bins = self.runs[run].clone();
        let begin = self.first[bins.start];
        let slots = Slots::new(self.first[bins.end] - begin, &self.components);
        let next: Vec<AtomicUsize> =
            self.first[bins.clone()].iter().map(|first| AtomicUsize::new(first - begin)).collect();
        let width = self.width();
        let RunParticles { pieces, memory } = self.run_particles(run).take();
        let buffers = || (Vec::new(), Vec::new());
        pieces.par_iter().try_for_each_init(buffers, |(records, bin_slots), piece| {
            let code = self.code(run, piece.particles);
            records.clear();
            let words = self.read(run, piece, &memory)?;
            let (words, values) = words.split_at(code.words());
            records.extend(code.decode(words));
            let mut values = cast_slice(values).chunks_exact(width.max(1));
            let bin_of = |record: Record| (record >> RECORD_BITS) as usize;
            let bins = || records.chunk_by(|&a, &b| bin_of(a) == bin_of(b));
            // All slots are assigned before any is filled, because an atomic increment waits for
            // earlier writes.
            bin_slots.clear();
            bin_slots.extend(
                bins().map(|bin| next[bin_of(bin[0])].fetch_add(bin.len(), Ordering::Relaxed)),
            );
            for (bin, &slot) in bins().zip(&*bin_slots) {
                for (slot, record) in (slot..).zip(bin) {
                    let values = values.next().unwrap_or_default();
                    slots.put(slot, record & RECORD_MASK);
                    slots.put_attributes(slot, values.iter().copied());
                }
            }
            Ok::<_, io::Error>(())
        })?;
        self.memory.release(memory.bytes());
        drop(memory);
        let first = self.first[bins.start..=bins.end].iter().map(|first| first - begin).collect();
        Ok(Bins::of_slots(slots, self.keys[bins].to_vec(), first, self.components.clone()))
    }

    /// Creates a store for all sorted runs. The store can be read bin by bin. Once the store is
    /// filled, the file of the spilled particles is no longer needed.
    ///
    /// # Errors
    /// If the scratch file cannot be created.
    pub fn sorted_store(&self, folder: &Path) -> io::Result<SortedStore> {
        let scratch = Scratch::in_folder(folder)?;
        let particles = *self.first.last().expect("`first` always has a last entry") as u64;
        let records_at = scratch.reserve(particles * size_of::<Record>() as u64);
        let attributes_at = self
            .components
            .iter()
            .map(|&n| scratch.reserve(particles * size_of::<f32>() as u64 * n as u64));
        let attributes_at = attributes_at.collect();
        let bins = Bins {
            keys: self.keys.clone(),
            first: self.first.clone(),
            components: self.components.clone(),
            without: vec![0; self.components.len()],
            store: ParticleStore::File { scratch, records_at, attributes_at },
        };
        Ok(SortedStore { bins, written: 0 })
    }
}

/// Sorted bins that are written to a scratch file.
#[derive(Debug)]
pub struct SortedStore {
    bins: Bins,
    /// Number of particles written so far.
    written: u64,
}

impl SortedStore {
    /// Writes the next run.
    ///
    /// # Errors
    /// If the scratch file cannot be written.
    pub fn push(&mut self, run: &Bins) -> io::Result<()> {
        let (
            ParticleStore::Memory { records, attributes },
            ParticleStore::File { scratch, records_at, attributes_at },
        ) = (&run.store, &self.bins.store)
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

    /// Returns all bins, which can now be read one by one.
    pub fn finish(self) -> Bins {
        self.bins
    }
}

/// Adds the number of a particle's bin within the run to the free bits of the particle's record.
#[inline(always)]
pub(super) fn in_bin_of_run(bin: usize, record: Record) -> Record {
    (bin as Record) << RECORD_BITS | record
}

/// The buffers of one thread, one for each run.
#[derive(Debug)]
pub(super) struct RunBuffers<'a> {
    spilled: &'a SpilledBins,
    /// Number of particles at which a buffer is written.
    full: usize,
    records: Vec<Vec<Record>>,
    /// For each run, the components of all attributes, particle by particle.
    values: Vec<Vec<f32>>,
}

impl RunBuffers<'_> {
    /// Adds particles. Each is given by its index in `attributes`, its run, and its record.
    pub(super) fn push_all(
        &mut self,
        particles: impl Iterator<Item = (usize, usize, Record)>,
        attributes: &Tuples<'_>,
    ) -> io::Result<()> {
        let carries = !self.spilled.components.is_empty();
        for (i, run, record) in particles {
            if carries {
                self.values[run].extend(attributes.tuple(i));
            }
            let records = &mut self.records[run];
            records.push(record);
            if records.len() == self.full {
                self.write(run)?;
            }
        }
        Ok(())
    }

    /// Writes the remaining particles.
    pub(super) fn flush(mut self) -> io::Result<()> {
        (0..self.records.len()).try_for_each(|run| self.write(run))
    }

    #[cold]
    fn write(&mut self, run: usize) -> io::Result<()> {
        let Self { spilled, .. } = *self;
        let (records, values) = (&mut self.records[run], &mut self.values[run]);
        if records.is_empty() {
            return Ok(());
        }
        let code = spilled.code(run, records.len());
        let order = code.order(records);
        let mut words = code.encode(order.iter().map(|&i| records[i as usize]));
        words.resize(spilled.words(run, records.len()), 0);
        let width = spilled.width();
        let attribute_words: &mut [f32] = cast_slice_mut(&mut words[code.words()..]);
        for (tuple, &i) in attribute_words.chunks_exact_mut(width.max(1)).zip(&order) {
            tuple.copy_from_slice(&values[i as usize * width..][..width]);
        }
        spilled.add_piece(run, records.len(), &words)?;
        records.clear();
        values.clear();
        Ok(())
    }
}

/// Binned particles, in memory or spilled.
#[derive(Debug)]
pub enum BinnedParticles {
    /// All particles in memory.
    InMemory(Bins),
    /// Particles grouped by run. Some or all of them may be in a scratch file.
    Spilled(SpilledBins),
}

impl BinnedParticles {
    /// Passes all bins to `take`, one run per call. `take` returns the number of bytes that it has
    /// kept in memory so far.
    ///
    /// # Errors
    /// If `take` fails, or if a scratch file cannot be read or written.
    pub fn visit(self, mut take: impl FnMut(&Bins) -> io::Result<u64>) -> io::Result<()> {
        match self {
            Self::InMemory(bins) => take(&bins).map(|_| ()),
            Self::Spilled(spilled) => spilled.visit(take),
        }
    }

    /// Passes all bins to `take` as [`visit`](Self::visit) does, and returns the bins. Spilled
    /// particles are written, sorted by bin, to a new scratch file in `folder`.
    ///
    /// # Errors
    /// If [`visit`](Self::visit) fails, or if the new scratch file cannot be created or written.
    pub fn visit_and_keep(
        self,
        folder: &Path,
        mut take: impl FnMut(&Bins) -> io::Result<u64>,
    ) -> io::Result<Bins> {
        let spilled = match self {
            Self::InMemory(bins) => return take(&bins).map(|_| bins),
            Self::Spilled(spilled) => spilled,
        };
        let mut sorted = spilled.sorted_store(folder)?;
        spilled.visit(|bins| {
            sorted.push(bins)?;
            take(bins)
        })?;
        Ok(sorted.finish())
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::super::bin::{BinPlan, CountingRoom, InvalidParticles};
    use super::*;
    use crate::grid::Grid;

    const PARTICLES: usize = 40_000;

    /// The particles of each bin, sorted.
    type Sorted = Vec<(MortonKey, Vec<Record>)>;

    /// Returns all bins that a visitor receives if it keeps `kept` bytes of each run. Also returns
    /// the bytes of the pieces in memory and in the scratch file, first after binning, then after
    /// sorting each run.
    fn visited(memory_bytes: u64, kept: u64) -> (Sorted, Vec<[u64; 2]>) {
        let grid = Grid::new(DVec3::ZERO, 1.0).unwrap();
        let coordinate = |i: usize, a: usize| ((i * [7919, 6761, 5879][a]) % 40_009) as f64 / 320.0;
        let particles: Vec<[f64; 3]> =
            (0..PARTICLES).map(|i| std::array::from_fn(|a| coordinate(i, a))).collect();
        let room = CountingRoom::BINS;
        let plan = BinPlan::count(&particles, &grid, None, InvalidParticles::Refuse, room).unwrap();
        let runs = plan.runs(&particles, &[], 5000 * 8);
        assert!(runs.len() > 6, "{} runs are too few for this test", runs.len());
        let folder = tempfile::tempdir().unwrap();
        let spilled = plan.spill(&particles, &[], runs, folder.path(), 1 << 16, memory_bytes);
        let spilled = spilled.unwrap().unwrap();
        let stored_bytes = |spilled: &SpilledBins| [spilled.memory.taken(), spilled.scratch.len()];
        let (mut bins, mut bytes) = (Vec::new(), vec![stored_bytes(&spilled)]);
        let spilled = &spilled;
        spilled
            .drain(|run| {
                bytes.push(stored_bytes(spilled));
                for bin in 0..run.keys().len() {
                    let mut records = run.contents(bin)?.packed().to_vec();
                    records.sort_unstable();
                    bins.push((run.keys()[bin], records));
                }
                Ok(bytes.len() as u64 * kept)
            })
            .unwrap();
        (bins, bytes)
    }

    #[test]
    fn runs_are_the_same_in_memory_and_in_a_file_or_split_between_them() {
        let (expected, in_file) = visited(0, 0);
        assert_eq!(expected.iter().map(|(_, records)| records.len()).sum::<usize>(), PARTICLES);
        assert!(in_file.iter().all(|&[memory, file]| memory == 0 && file > 6 * PARTICLES as u64));
        let all = in_file[0][1];
        let (bins, in_memory) = visited(u64::MAX, 0);
        assert!(bins == expected && in_memory.iter().all(|&[_, file]| file == 0));
        assert!(in_memory[0][0] >= all, "{in_memory:?}");
        assert!(
            in_memory.is_sorted_by(|a, b| a[0] > b[0]),
            "visited runs did not release their memory: {in_memory:?}"
        );
        let (bins, in_both) = visited(all / 2, 0);
        assert!(bins == expected);
        let [memory, file] = in_both[0];
        assert!((all / 4..=all / 2).contains(&memory) && memory + file >= all, "{in_both:?}");
    }

    #[test]
    fn memory_kept_by_a_visitor_moves_runs_to_the_file() {
        let (expected, _) = visited(0, 0);
        // After the last run, the kept memory takes the whole budget.
        let (_, in_memory) = visited(u64::MAX, 0);
        let (room, kept) = (in_memory[0][0], in_memory[0][0] / in_memory.len() as u64);
        let (bins, bytes) = visited(room, kept);
        assert!(bins == expected);
        for (runs, &[memory, _]) in bytes.iter().enumerate().skip(1) {
            assert!(memory + runs as u64 * kept <= room, "{runs} runs: {bytes:?}");
        }
        assert!(bytes.last().unwrap()[1] > 0, "no run moved to the file: {bytes:?}");
    }
}
