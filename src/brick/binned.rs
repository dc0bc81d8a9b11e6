//! Particles in order of their bins, wherever they are kept.

use std::io;
use std::path::Path;

use rayon::prelude::*;

use super::bins::Bins;
use super::spill::SpilledBins;

/// Particles in order of their bins.
#[derive(Debug)]
pub enum BinnedParticles {
    /// All of them.
    InMemory(Bins),
    /// Run by run in a scratch file.
    Spilled(SpilledBins),
}

impl BinnedParticles {
    /// Shows all bins to `take`, run by run.
    ///
    /// # Errors
    /// Those of `take`, and where a scratch file cannot be read.
    pub fn visit(&self, mut take: impl FnMut(&Bins) -> io::Result<()>) -> io::Result<()> {
        match self {
            Self::InMemory(bins) => take(bins),
            Self::Spilled(spilled) => (0..spilled.runs().len()).try_for_each(|run| take(&spilled.load(run)?)),
        }
    }

    /// Shows all bins to `take`, and returns them: what was in a scratch file, in one of its own in `folder`.
    ///
    /// # Errors
    /// Those of [`visit`](Self::visit), and where a scratch file cannot be written.
    pub fn visit_and_keep(
        self,
        folder: &Path,
        mut take: impl FnMut(&Bins) -> io::Result<()>,
    ) -> io::Result<Bins> {
        let spilled = match self {
            Self::InMemory(bins) => return take(&bins).map(|()| bins),
            Self::Spilled(spilled) => spilled,
        };
        let mut sorted = spilled.sorted_store(folder)?;
        for run in 0..spilled.runs().len() {
            let bins = spilled.load(run)?;
            take(&bins)?;
            sorted.push(&bins)?;
        }
        Ok(sorted.finish())
    }

    /// About how many cells hold particles, by a stratified sample of the bins.
    ///
    /// # Errors
    /// Where a scratch file cannot be read.
    pub fn full_cells(&self) -> io::Result<u64> {
        let of_bins = |bins: &Bins, sampled: &[(usize, f64)], first: usize| {
            let full_cells = |&(bin, weight): &(usize, f64)| {
                Ok::<_, io::Error>(weight * bins.full_cells(bin - first)? as f64)
            };
            sampled.par_iter().map(full_cells).collect::<io::Result<Vec<f64>>>()
        };
        let full_cells: Vec<f64> = match self {
            Self::InMemory(bins) => of_bins(bins, &bins.sampled(), 0)?,
            Self::Spilled(spilled) => {
                let sampled = spilled.sampled();
                let (mut full_cells, mut rest) = (Vec::new(), &sampled[..]);
                for (run, bins) in spilled.runs().iter().enumerate() {
                    let (of_run, later) = rest.split_at(rest.partition_point(|&(bin, _)| bin < bins.end));
                    rest = later;
                    if !of_run.is_empty() {
                        full_cells.extend(of_bins(&spilled.load(run)?, of_run, bins.start)?);
                    }
                }
                full_cells
            }
        };
        Ok(full_cells.iter().sum::<f64>().round() as u64)
    }
}
