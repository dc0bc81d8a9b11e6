//! Surfaces that contain much less volume than their particles, because of a wrong isovalue or
//! strong smoothing.

use std::fmt;
use std::io;

use crate::grid::CellBox;
use crate::grid::units::shown;
use crate::particles::particle_count;
use crate::surface::stitch::StitchedSurface;

use super::coincident::CoincidentParticles;

/// The ratio of the surface's volume to its particles' volume below which there is a shortfall. It
/// is less than 1, because smoothing makes each drop and sheet smaller.
const EXPECTED: f64 = 0.5;

/// A surface that contains less of its particles' volume than expected.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shortfall {
    /// The volume of the surface divided by the volume of its particles.
    pub share: f64,
    /// The number of particles. Coincident particles count once.
    pub particles: usize,
    /// The spacing of the particles: each fills a cube of this edge.
    pub spacing: f64,
}

impl Shortfall {
    /// Compares the volume of a surface, within the cells of `around` if they are given, with the
    /// volume of `particles` particles at `spacing`. Coincident particles count once. Returns
    /// `None` if the surface's volume is as large as expected.
    ///
    /// # Errors
    /// If the surface is in a scratch file that cannot be read.
    pub fn of(
        surface: &StitchedSurface,
        around: Option<CellBox>,
        particles: usize,
        coincident: Option<&CoincidentParticles>,
        spacing: f64,
    ) -> io::Result<Option<Self>> {
        let particles = particles - coincident.map_or(0, |found| found.particles as usize);
        let share = surface.volume_within(around)? / (particles as f64 * spacing.powi(3));
        Ok((share < EXPECTED).then_some(Self { share, particles, spacing }))
    }
}

impl fmt::Display for Shortfall {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { share, particles, spacing } = self;
        let percent = 100.0 * share;
        write!(
            f,
            "the surface encloses only {percent:.1} % of the volume of {} with spacing {}",
            particle_count(*particles),
            shown(*spacing)
        )
    }
}
