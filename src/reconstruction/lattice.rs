//! Moves grids to suit particles on a lattice. Such particles are common in the first frame of a
//! simulation.

use glam::DVec3;

use crate::field::indicator::IndicatorKind;
use crate::frame::Sampling;
use crate::grid::{Domain, Grid};
use crate::particles::Particles;
use crate::particles::lattice::lattice_origin;

/// Moves the grid of a frame whose particles are on a lattice, so that the indicator samples the
/// lattice like disordered fluid. The grid does not move if the indicator does not depend on the
/// grid's position: see [`lattice_origin`].
pub fn on_sound_grid(particles: &dyn Particles, sampling: Sampling) -> Sampling {
    origin_for_lattice(particles, &sampling)
        .and_then(|origin| moved(&sampling, origin))
        .unwrap_or(sampling)
}

/// The origin that suits a lattice of particles; `None` without a lattice, or if the indicator does
/// not depend on the origin.
pub fn origin_for_lattice(particles: &dyn Particles, sampling: &Sampling) -> Option<DVec3> {
    match sampling.method.indicator()? {
        IndicatorKind::Cloud => None,
        IndicatorKind::Symmetry | IndicatorKind::Counting => {
            lattice_origin(particles, sampling.grid.origin(), sampling.grid.cell_size())
        }
    }
}

/// Moves the grid of a sampling to another origin; `None` if the walls or the periodic box are
/// invalid on the moved grid.
pub fn moved(sampling: &Sampling, origin: DVec3) -> Option<Sampling> {
    let grid = Grid::new(origin, sampling.grid.cell_size()).ok()?;
    let domain = match &sampling.domain {
        None => None,
        Some(domain) => {
            let [lo, hi] = domain.walls();
            Some(Domain::new(&grid, lo, hi).ok()?)
        }
    };
    let periodic = match &sampling.periodic {
        None => None,
        Some(periodic) => Some(periodic.on(&grid).ok()?),
    };
    Some(Sampling { grid, domain, periodic, ..sampling.clone() })
}
