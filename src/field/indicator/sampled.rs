//! The DIF of a frame, with all that a surface through it has to know of the particles.

use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use crate::brick::{DifField, FrameFacts};

use super::{Amount, Indicator, WideCells};

/// A frame whose DIF is known: what a packed frame holds.
#[derive(Debug)]
pub struct SampledDif {
    /// Facts of the frame.
    pub facts: FrameFacts,
    /// The indicator that made it, with its mu0 where it counts.
    pub indicator: Indicator,
    /// The samples.
    pub dif: Arc<DifField>,
    /// Clouds in cells 2, 4, ... times as wide up to wide ones, from when they are first asked for.
    wide: OnceLock<Vec<Arc<DifField>>>,
    /// How many levels there are beyond that of the frame's wide cells.
    more_levels: u32,
    /// The folder for those of them that are not in memory.
    scratch: Option<PathBuf>,
}

impl SampledDif {
    /// Makes the DIF of what was stored by an indicator.
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

    /// Takes a folder for scratch files, where the samples are not in memory.
    pub fn with_scratch(self, folder: &Path) -> Self {
        Self { scratch: Some(folder.to_owned()), ..self }
    }

    /// Adds levels to those up to the frame's [wide cells](Self::wide_cells).
    pub fn with_more_levels(self, more_levels: u32) -> Self {
        Self { more_levels, ..self }
    }

    /// Whether the samples are clouds.
    pub fn is_clouds(&self) -> bool {
        self.indicator == Indicator::Cloud
    }

    /// The wide cells in which the calm surface is made of clouds.
    pub fn wide_cells(&self) -> WideCells {
        WideCells::of_spacing(self.facts.spacing_cells_or_one())
    }

    /// The samples of cells 2^`level` times as wide: the samples themselves at level 0, clouds at
    /// others, up to that of the frame's [wide cells](Self::wide_cells), and
    /// [more](Self::with_more_levels).
    ///
    /// # Panics
    /// If the level is greater.
    pub fn wide(&self, level: u32) -> &DifField {
        let Some(below) = (level as usize).checked_sub(1) else { return &self.dif };
        &self.wide.get_or_init(|| self.halved())[below]
    }

    fn halved(&self) -> Vec<Arc<DifField>> {
        let spacing = self.facts.spacing_cells_or_one();
        let amount =
            |level: u32| f64::from(Amount::of_spacing(spacing / f64::from(1 << level)).steps());
        let (mut finer, mut walls) = (Arc::clone(&self.dif), self.facts.walls());
        let levels = 0..self.wide_cells().level + self.more_levels;
        let halved = levels.map(|level| {
            // Beyond wide cells, samples deep in the fluid stay what they are.
            let is_wide = level >= self.wide_cells().level;
            let factor = if is_wide { 0.125 } else { amount(level + 1) / amount(level) };
            finer = Arc::new(finer.halved(walls, factor, self.scratch.as_deref()));
            walls = walls.map(crate::brick::halved_box);
            Arc::clone(&finer)
        });
        halved.collect()
    }
}
