//! The destination of a frame's DIF: memory, or a scratch file that is later mapped into memory.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::backend::Stages;
use crate::brick::{Bins, DifField, FrameFacts, PageShape, Pages};
use crate::field::indicator::{Indicator, PageRule, SampledDif};
use crate::frame::estimate::{MemoryEstimate, MemoryPlan};
use crate::io::mnf::{FrameWriter, frame_from_file};
use crate::system::control::Meter;

/// Maximum number of samples in the pages that are computed together before they go into a file.
const BATCH_SAMPLES: usize = 1 << 22;

/// The destination of the DIF while it is computed.
pub(super) enum FieldSink {
    Memory {
        pages: Pages,
        /// Bytes of all samples.
        bytes: u64,
    },
    /// The whole DIF, computed at once.
    Whole(DifField),
    File {
        file: File,
        writer: FrameWriter<File>,
        full_cells: u64,
        cache_bytes: u64,
        folder: PathBuf,
    },
}

impl FieldSink {
    /// A sink in memory, or in a file if the plan requires it.
    pub(super) fn new(
        plan: MemoryPlan,
        estimate: &MemoryEstimate,
        shape: PageShape,
        folder: &Path,
    ) -> io::Result<Self> {
        match plan {
            MemoryPlan::OutOfCore(shares) if estimate.field > shares.field => {
                let file = tempfile::tempfile_in(folder)?;
                let writer = FrameWriter::create(file.try_clone()?, shape)?;
                let folder = folder.to_owned();
                Ok(Self::File { file, writer, full_cells: 0, cache_bytes: shares.field, folder })
            }
            _ => Ok(Self::Memory { pages: Vec::new(), bytes: 0 }),
        }
    }

    /// Computes and stores the whole field of a frame whose bins are in memory.
    pub(super) fn take_whole(
        &mut self,
        stages: &dyn Stages,
        bins: &Arc<Bins>,
        rule: &PageRule,
        meter: &Meter<'_>,
    ) -> io::Result<()> {
        match self {
            Self::File { .. } => self.take(stages, bins, rule, meter),
            Self::Memory { .. } | Self::Whole(_) => {
                *self = Self::Whole(stages.field(bins, rule, meter)?);
                Ok(())
            }
        }
    }

    /// Computes and stores the pages of `bins`, which follow the previous pages.
    pub(super) fn take(
        &mut self,
        stages: &dyn Stages,
        bins: &Bins,
        rule: &PageRule,
        meter: &Meter<'_>,
    ) -> io::Result<()> {
        let end = bins.keys().len();
        let batch = match self {
            Self::Memory { .. } | Self::Whole(_) => end.max(1),
            Self::File { .. } => BATCH_SAMPLES / rule.shape().bin_samples(),
        };
        for first in (0..end).step_by(batch) {
            let pages = stages.indicate(bins, first..(first + batch).min(end), rule, meter)?;
            self.push(pages, rule.shape())?;
        }
        Ok(())
    }

    /// Stores `pages`, which must follow the previous pages.
    pub(super) fn push(&mut self, pages: Pages, shape: PageShape) -> io::Result<()> {
        match self {
            Self::Memory { pages: stored, bytes } => {
                *bytes += pages.iter().map(|(_, samples)| samples.bytes() as u64).sum::<u64>();
                stored.extend(pages);
            }
            Self::Whole(_) => unreachable!("no pages follow a whole field"),
            Self::File { writer, full_cells, .. } => {
                *full_cells += full_count(&pages);
                writer.push(&pages, |samples| samples.dense(shape))?;
            }
        }
        Ok(())
    }

    /// Bytes in memory so far.
    pub(super) fn bytes_in_memory(&self) -> u64 {
        match self {
            Self::Memory { bytes, .. } => *bytes,
            Self::Whole(field) => field.sample_bytes(),
            Self::File { .. } => 0,
        }
    }

    /// Number of full cells.
    pub(super) fn full_cells(&self) -> u64 {
        match self {
            Self::Memory { pages, .. } => full_count(pages),
            Self::Whole(field) => field.full_cells(),
            Self::File { full_cells, .. } => *full_cells,
        }
    }

    /// Finishes the DIF, now that its indicator is known. If the DIF is in a file, parts of it are
    /// cached in memory, up to the share of the DIF.
    pub(super) fn finish(
        self,
        facts: FrameFacts,
        indicator: Indicator,
        shape: PageShape,
    ) -> io::Result<SampledDif> {
        match self {
            Self::Whole(field) => Ok(SampledDif::new(facts, indicator, field)),
            Self::Memory { pages, .. } => {
                Ok(SampledDif::new(facts, indicator, DifField::in_memory(shape, pages)))
            }
            Self::File { file, writer, cache_bytes, folder, .. } => {
                // A file cannot store the walls of an octave, which are computed from the finest
                // cells, so the walls are set again below.
                let open = FrameFacts { domain: None, ..facts };
                writer.finish(&open, indicator)?;
                let mut sampled = frame_from_file(&file, cache_bytes).map_err(io::Error::other)?;
                sampled.facts = facts;
                Ok(sampled.with_scratch(&folder))
            }
        }
    }
}

fn full_count(pages: &Pages) -> u64 {
    pages.iter().map(|(info, _)| u64::from(info.full_count)).sum()
}
