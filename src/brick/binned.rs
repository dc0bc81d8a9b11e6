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
    /// Run by run, those that memory has no room for in a scratch file.
    Spilled(SpilledBins),
}

impl BinnedParticles {
    /// Shows all bins to `take`, run by run; it returns how many bytes it has kept in memory so far.
    ///
    /// # Errors
    /// Where `take` fails, or a scratch file cannot be read or written.
    pub fn visit(self, mut take: impl FnMut(&Bins) -> io::Result<u64>) -> io::Result<()> {
        match self {
            Self::InMemory(bins) => take(&bins).map(|_| ()),
            Self::Spilled(spilled) => spilled.visit(take),
        }
    }

    /// Shows all bins to `take`, and returns them: what was in a scratch file, in one of its own in `folder`.
    ///
    /// # Errors
    /// Those of [`visit`](Self::visit), and where a scratch file cannot be written.
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
