//! The clouds of a frame, with everything about the particles that a surface needs.

use crate::brick::FrameFacts;
use crate::field::calibration::{Calibration, MeasuredCalibration, Plateau};
use crate::field::distance::UNITS;

use super::{Octaves, SizedClouds};

/// A frame of particles of several sizes with its clouds, as a packed frame stores them.
#[derive(Debug)]
pub struct SampledOctaves {
    /// Facts of the frame, on the grid of the finest octave. The spacing is the smallest size.
    pub facts: FrameFacts,
    /// The clouds.
    pub clouds: SizedClouds,
    /// The largest size.
    pub coarsest: f64,
    /// The particles' volume per unit volume deep in the fluid, if it is known.
    pub density: Option<f64>,
}

impl SampledOctaves {
    /// The octaves of a frame with particles up to the size `coarsest`; `None` if the spacing,
    /// which is the smallest size, is not known.
    #[must_use]
    pub fn octaves(facts: &FrameFacts, coarsest: f64) -> Option<Octaves> {
        Some(Octaves::new(facts.spacing?, coarsest, facts.grid.cell_size()))
    }

    /// The calibration of this frame, from its density.
    #[must_use]
    pub fn calibrated(&self) -> MeasuredCalibration {
        let spacing_cells = self.facts.spacing_cells_or_one();
        // In cells of 16 spacings or more, the nominal plateau exceeds `u16`, and the cast
        // saturates.
        let nominal = Plateau::nominal(spacing_cells) * self.density.unwrap_or(1.0);
        let value = nominal.round().max(1.0) as u16;
        let plateau = match self.density {
            Some(_) => Plateau::Interior { median: value, lowest: value },
            None => Plateau::Shallow { expected: value },
        };
        MeasuredCalibration {
            calibration: Calibration::Clouds { plateau: value },
            plateau,
            step_cells: spacing_cells / UNITS,
        }
    }
}
