//! Particles in order of their bins, wherever they are kept.

use std::io;
use std::path::Path;

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
}
