//! The DIF of a frame, with everything about the particles that a surface needs.

use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use crate::brick::{DifField, FrameFacts};

use super::{Amount, Indicator, WideCells};

/// A frame with its DIF, as a packed frame stores it.
#[derive(Debug)]
pub struct SampledDif {
    /// Facts of the frame.
    pub facts: FrameFacts,
    /// The indicator that computed the DIF, with mu0 for counting.
    pub indicator: Indicator,
    /// The samples.
    pub dif: Arc<DifField>,
    /// Clouds in cells that are 2, 4, ... times as wide as the grid's, up to wide cells and
    /// `more_levels` beyond. They are computed on first access.
    wide: OnceLock<Vec<Arc<DifField>>>,
    /// The number of levels beyond the frame's wide cells.
    more_levels: u32,
    /// The folder for levels that are not in memory.
    scratch: Option<PathBuf>,
}

impl SampledDif {
    /// Makes the DIF from the stored samples of an indicator.
    pub fn new(facts: FrameFacts, indicator: Indicator, stored: DifField) -> Self {
        Self {
            facts,
            indicator,
            dif: Arc::new(indicator.decode(stored)),
            wide: OnceLock::new(),
            more_levels: 0,
            scratch: None,
        }
    }

    /// Sets a folder for scratch files, which are used if the samples are not in memory.
    pub fn with_scratch(self, folder: &Path) -> Self {
        Self { scratch: Some(folder.to_owned()), ..self }
    }

    /// Adds levels beyond the frame's [wide cells](Self::wide_cells).
    pub fn with_more_levels(self, more_levels: u32) -> Self {
        Self { more_levels, ..self }
    }

    /// Whether the samples are clouds.
    pub fn is_clouds(&self) -> bool {
        self.indicator == Indicator::Cloud
    }

    /// The wide cells on which the calm surface of clouds is computed.
    pub fn wide_cells(&self) -> WideCells {
        WideCells::of_spacing(self.facts.spacing_cells_or_one())
    }

    /// The samples of cells 2^`level` times as wide. Level 0 contains the samples themselves.
    /// Clouds also have the levels up to the frame's [wide cells](Self::wide_cells) and the [levels
    /// beyond](Self::with_more_levels).
    ///
    /// # Panics
    /// If there is no such level.
    pub fn wide(&self, level: u32) -> &DifField {
        let Some(below) = (level as usize).checked_sub(1) else { return &self.dif };
        &self.levels()[below]
    }

    /// Computes the samples of all levels, unless they are computed already. Without this call,
    /// several threads could compute the same levels at the same time.
    pub fn make_levels(&self) {
        self.levels();
    }

    fn levels(&self) -> &[Arc<DifField>] {
        self.wide.get().unwrap_or_else(|| {
            let levels = self.halved();
            // Two threads may compute the levels at the same time. A lock would prevent this, but
            // could cause a deadlock. While the thread that holds the lock waits for parallel work,
            // it may run another task, and this task may wait for the same lock.
            self.wide.get_or_init(|| levels)
        })
    }

    fn halved(&self) -> Vec<Arc<DifField>> {
        let spacing = self.facts.spacing_cells_or_one();
        let amount =
            |level: u32| f64::from(Amount::of_spacing(spacing / f64::from(1 << level)).steps());
        let (mut finer, mut mirror) = (Arc::clone(&self.dif), self.facts.mirror(0));
        let levels = 0..self.wide_cells().level + self.more_levels;
        let halved = levels.map(|level| {
            // From the level of wide cells upwards, halving averages samples, so samples deep in
            // the fluid keep their value.
            let is_wide = level >= self.wide_cells().level;
            let factor = if is_wide { 0.125 } else { amount(level + 1) / amount(level) };
            finer = Arc::new(finer.halved(mirror, factor, self.scratch.as_deref()));
            mirror = mirror.map(|mirror| mirror.in_wider_cells(1));
            Arc::clone(&finer)
        });
        halved.collect()
    }
}
