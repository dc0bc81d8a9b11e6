//! Where the DIF of a frame goes: into memory, or into a scratch file that is then mapped.

use std::fs::File;
use std::io;
use std::path::Path;

use crate::backend::Stages;
use crate::brick::{Bins, DifField, PageShape, Pages};
use crate::estimate::{Estimate, Plan, Shares};
use crate::io::mnf::{FrameFacts, FrameWriter, frame_from_file};
use crate::stage::indicator::PageRule;

/// Samples of the bins whose pages are made at once, at the most.
const BATCH_SAMPLES: usize = 1 << 22;

/// Where the DIF goes as it is made.
pub(super) enum FieldSink {
    Memory(Pages),
    File { file: File, writer: FrameWriter<File>, full_cells: u64 },
}

impl FieldSink {
    /// In memory, unless a plan says otherwise.
    pub(super) fn new(plan: Plan, estimate: &Estimate, shape: PageShape, folder: &Path) -> io::Result<Self> {
        match plan {
            Plan::OutOfCore(shares) if estimate.field > shares.field => {
                let file = tempfile::tempfile_in(folder)?;
                let writer = FrameWriter::create(file.try_clone()?, shape)?;
                Ok(Self::File { file, writer, full_cells: 0 })
            }
            _ => Ok(Self::Memory(Vec::new())),
        }
    }

    /// Takes the pages of all `bins`.
    pub(super) fn take(&mut self, stages: &dyn Stages, bins: &Bins, rule: &PageRule) -> io::Result<()> {
        let end = bins.keys().len();
        let batch = BATCH_SAMPLES / rule.shape().bin_samples();
        for first in (0..end).step_by(batch) {
            let pages = stages.indicate(bins, first..(first + batch).min(end), rule)?;
            match self {
                Self::Memory(kept) => kept.extend(pages),
                Self::File { writer, full_cells, .. } => {
                    *full_cells += full_count(&pages);
                    writer.push(&pages, |samples| samples.dense(rule.shape()))?;
                }
            }
        }
        Ok(())
    }

    /// Cells that are full.
    pub(super) fn full_cells(&self) -> u64 {
        match self {
            Self::Memory(pages) => full_count(pages),
            Self::File { full_cells, .. } => *full_cells,
        }
    }

    /// The DIF, whose indicator is known by now; of a file as much in memory as a plan allows.
    pub(super) fn finish(self, facts: &FrameFacts, shape: PageShape, plan: Plan) -> io::Result<DifField> {
        match (self, plan) {
            (Self::File { file, writer, .. }, Plan::OutOfCore(Shares { field, .. })) => {
                writer.finish(facts)?;
                let (_, dif) = frame_from_file(&file, field).map_err(io::Error::other)?;
                Ok(dif)
            }
            (Self::File { .. }, Plan::InCore) => unreachable!("a frame in core has no file"),
            (Self::Memory(pages), _) => Ok(facts.indicator.decode(DifField::in_memory(shape, pages))),
        }
    }
}

fn full_count(pages: &Pages) -> u64 {
    pages.iter().map(|(info, _)| u64::from(info.full_count)).sum()
}
