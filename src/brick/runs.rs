//! The second reading of particles that do not fit into memory: counted particles go into runs of
//! bins, and runs are sorted one by one.

use std::io;
use std::ops::Range;
use std::path::Path;

use rayon::prelude::*;

use crate::particles::{Particles, RereadError};

use super::bin::{BinPlan, RangePlan, Tuples, components};
use super::bin_table::{LatestNumbers, NOWHERE};
use super::bins::{FREE_BITS, tuple_bytes};
use super::place::CHUNK;
use super::spill::{SpilledBins, in_bin_of_run};

/// Maximum number of bins in a run. The free bits of a spilled particle hold the number of its bin
/// in the run.
const RUN_BINS: usize = 1 << RUN_BITS;
const RUN_BITS: u32 = FREE_BITS;

/// Approximate maximum number of runs in a frame. The number of a run and the number of a bin
/// within the run share 32 bits, which suffice for twice this number of runs.
const MOST_RUNS: usize = 1 << (u32::BITS - RUN_BITS - 1);

impl BinPlan {
    /// Divides the bins into runs. Each run, with the attributes in `carried`, can be sorted in
    /// `bytes` of memory. A bin that is too large for this limit is a run of its own.
    pub fn runs(
        &self,
        particles: &dyn Particles,
        carried: &[usize],
        bytes: u64,
    ) -> Vec<Range<usize>> {
        let tuple = tuple_bytes(&components(particles, carried)) as u64;
        let particles = usize::try_from(bytes / tuple).unwrap_or(usize::MAX);
        let particles = particles.max(self.census().binned / MOST_RUNS);
        let mut runs: Vec<Range<usize>> = Vec::new();
        for bin in 0..self.keys.len() {
            match runs.last_mut() {
                Some(run)
                    if run.len() < RUN_BINS
                        && self.first[bin + 1] - self.first[run.start] <= particles =>
                {
                    run.end = bin + 1;
                }
                _ => runs.push(bin..bin + 1),
            }
        }
        runs
    }

    /// Reads the same `particles` a second time, and writes each particle to its run, with the
    /// attributes whose indices are in `carried`. Buffers take `buffer_bytes` in total. Runs take
    /// up to `memory_bytes` of memory; data beyond this limit goes to a scratch file in `folder`.
    ///
    /// # Errors
    /// If the scratch file cannot be created or written. The inner error is
    /// [`RereadError::Changed`] if particles moved since they were counted.
    pub fn spill(
        self,
        particles: &dyn Particles,
        carried: &[usize],
        runs: Vec<Range<usize>>,
        folder: &Path,
        buffer_bytes: usize,
        memory_bytes: u64,
    ) -> io::Result<Result<SpilledBins, RereadError>> {
        let Self { placer, keys, first, mut ranges, .. } = self;
        ranges.iter_mut().for_each(|range| range.places = Vec::new());
        let mut at_of_bin = vec![0; keys.len()];
        for (run, number) in runs.iter().zip(0_u32..) {
            at_of_bin[run.clone()]
                .iter_mut()
                .zip(number << RUN_BITS..)
                .for_each(|(to, at)| *to = at);
        }
        let components = components(particles, carried);
        let spilled = SpilledBins::new(keys, first, components, runs, folder, memory_bytes)?;
        let threads = rayon::current_num_threads().min(ranges.len()).max(1);
        let as_counted =
            ranges.into_par_iter().map(|RangePlan { range, mut table, ranks, .. }| {
                let mut buffers = spilled.buffers(threads, buffer_bytes);
                let mut latest = LatestNumbers::of(particles.len());
                let counts = table.counts().iter().zip(ranks);
                let expected = |(&left, bin)| ExpectedBin {
                    at: *at_of_bin.get(bin as usize).unwrap_or(&0),
                    left,
                };
                let mut expected: Vec<ExpectedBin> = counts.map(expected).collect();
                let mut unexpected = false;
                let (mut placed, mut found) =
                    (Vec::with_capacity(CHUNK), Vec::with_capacity(CHUNK));
                placer.for_each_chunk(particles, range, |chunk_first, _, addresses| {
                    let attributes = Tuples::read(
                        particles,
                        carried,
                        &spilled.components,
                        chunk_first,
                        addresses.len(),
                    );
                    table.place_all(addresses, &mut latest, &mut placed);
                    found.clear();
                    found.extend(placed.iter().map(|&(rank, _)| {
                        let bin = expected.get_mut(rank as usize).filter(|bin| bin.left > 0);
                        unexpected |= bin.is_none() && rank != NOWHERE;
                        bin.map(|bin| {
                            bin.left -= 1;
                            bin.at
                        })
                    }));
                    let assigned = found.iter().zip(&placed).enumerate().filter_map(
                        |(i, (&at, &(_, record)))| {
                            let (run, in_run) =
                                ((at? >> RUN_BITS) as usize, at? as usize % RUN_BINS);
                            Some((i, run, in_bin_of_run(in_run, record)))
                        },
                    );
                    buffers.push_all(assigned, &attributes)?;
                    Ok::<_, io::Error>(())
                })?;
                buffers.flush()?;
                Ok(!unexpected && expected.iter().all(|bin| bin.left == 0))
            });
        let as_counted =
            as_counted.try_reduce(|| true, |one, other| Ok::<_, io::Error>(one & other))?;
        Ok(if as_counted { Ok(spilled) } else { Err(RereadError::Changed) })
    }
}

/// A bin of a range's table during the second reading.
struct ExpectedBin {
    /// The number of its run and, in the lower [`RUN_BITS`] bits, its number within the run.
    at: u32,
    /// Number of expected particles that are still missing.
    left: u32,
}
