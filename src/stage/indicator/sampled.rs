//! The DIF of a frame, with all that a surface through it has to know of the particles.

use std::sync::{Arc, OnceLock};

use crate::brick::{DifField, FrameFacts};

use super::{Amount, Indicator, IndicatorKind, WideCells};

/// A frame whose DIF is known: what a packed frame holds.
#[derive(Debug)]
pub struct SampledDif {
    /// Facts of the frame.
    pub facts: FrameFacts,
    /// The indicator that made it, with its mu0 where it counts.
    pub indicator: Indicator,
    /// The samples.
    pub dif: Arc<DifField>,
    /// Clouds in wide cells, from when they are first asked for.
    wide: OnceLock<Arc<DifField>>,
}

impl SampledDif {
    /// Makes the DIF of what was stored by an indicator.
    #[must_use]
    pub fn new(facts: FrameFacts, indicator: Indicator, stored: DifField) -> Self {
        Self { facts, indicator, dif: Arc::new(indicator.decode(stored)), wide: OnceLock::new() }
    }

    /// Whether the samples are clouds.
    #[must_use]
    pub fn is_clouds(&self) -> bool {
        self.indicator.kind() == IndicatorKind::Cloud
    }

    /// The wide cells in which the calm surface is made of clouds.
    #[must_use]
    pub fn wide_cells(&self) -> WideCells {
        WideCells::of_spacing(self.facts.spacing_cells_or_one())
    }

    /// The samples of cells 2^`level` times as wide: the samples themselves at level 0, clouds in the frame's
    /// [wide cells](Self::wide_cells) at theirs.
    #[must_use]
    pub fn wide(&self, level: u32) -> &DifField {
        if level == 0 {
            return &self.dif;
        }
        debug_assert_eq!(level, self.wide_cells().level, "there is one level beside 0");
        self.wide.get_or_init(|| {
            let spacing = self.facts.spacing_cells_or_one();
            let mut walls = self.facts.walls();
            (0..level).fold(Arc::clone(&self.dif), |finer, level| {
                let amount =
                    |level: u32| f64::from(Amount::of_spacing(spacing / f64::from(1 << level)).steps());
                let wider = Arc::new(finer.halved(walls, amount(level + 1) / amount(level)));
                walls = walls.map(crate::brick::halved_box);
                wider
            })
        })
    }
}
