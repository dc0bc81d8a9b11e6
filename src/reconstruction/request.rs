//! How particles are to be sampled, as far as it can be known without them.

use std::path::Path;

use glam::DVec3;

use crate::brick::{BinPlan, Census, CountingRoom, InvalidParticles};
use crate::error::Error;
use crate::field::indicator::IndicatorKind;
use crate::field::spacing::{Part, Spacings, spacings};
use crate::frame::{FieldRequest, FrameError, Resources, Sampling, Surfacing};
use crate::grid::units::positive_length;
use crate::grid::{Domain, DomainError, Grid, Periodic};
use crate::io::scene::spacing_beside;
use crate::particles::Particles;

use super::cells::{CellSize, Cells, Doubt, Source, SpacingSource};
use super::lattice::on_sound_grid;

/// How particles are to be sampled, whatever they are.
#[derive(Debug, Clone)]
pub struct SamplingRequest {
    /// The way to make a field of them.
    pub field: FieldRequest,
    /// Treatment of particles that are not finite or too far away.
    pub invalid: InvalidParticles,
    /// A corner of the grid's cells; where it is not given, the grid may be moved to suit a lattice.
    pub origin: Option<DVec3>,
    /// The lowest and the highest corner of a tank; particles outside are not counted.
    /// An axis without walls goes from -inf to inf.
    pub walls: Option<[DVec3; 2]>,
    /// The faces of a periodic box along each axis, where it is not open, and the surface that images beyond them have to do for.
    pub periodic: Option<([Option<[f64; 2]>; 3], Surfacing)>,
    /// The particles' spacing, where the caller knows it.
    pub spacing: Option<f64>,
    /// Edge of a cell; the [usual one](CellSize::usual) where it is not given.
    pub cell: Option<CellSize>,
}

impl Default for SamplingRequest {
    fn default() -> Self {
        Self {
            field: IndicatorKind::default().into(),
            invalid: InvalidParticles::Refuse,
            origin: None,
            walls: None,
            periodic: None,
            spacing: None,
            cell: None,
        }
    }
}

/// How a frame is sampled, and what was chosen for it.
#[derive(Debug)]
pub struct ChosenSampling {
    /// With its grid where it is best.
    pub sampling: Sampling,
    /// Cells and spacing.
    pub cells: Cells,
    /// Whether the grid was moved to suit a lattice.
    pub moved: bool,
    /// The particles' places, where they were counted meanwhile.
    pub plan: Option<BinPlan>,
}

impl ChosenSampling {
    /// Name of the stage that it took.
    #[must_use]
    pub fn stage(&self) -> &'static str {
        if self.plan.is_some() { "count" } else { "spacing" }
    }
}

impl SamplingRequest {
    /// Edge of a cell.
    #[must_use]
    pub fn cell_size(&self) -> CellSize {
        self.cell.unwrap_or(CellSize::usual(self.field))
    }

    /// Refuses an origin, walls or a periodic box that are wrong whatever the cells' size is.
    ///
    /// # Errors
    /// [`Error::Unit`], [`Error::Domain`] and [`Error::Periodic`].
    pub fn validate(&self) -> Result<(), Error> {
        let unit = self.grid(1.0)?;
        if let Some([lo, hi]) = self.walls
            && let Err(error @ DomainError::Corners) = Domain::new(&unit, lo, hi)
        {
            return Err(error.into());
        }
        if let Some((faces, _)) = self.periodic {
            Periodic::check(faces)?;
            self.walls.map_or(Ok(()), |walls| Periodic::refuse_walls(faces, walls))?;
        }
        Ok(())
    }

    /// The grid that was asked for, with cells of some size.
    ///
    /// # Errors
    /// [`Error::Unit`].
    pub fn grid(&self, cell_size: f64) -> Result<Grid, Error> {
        Ok(Grid::new(self.origin.unwrap_or_default(), cell_size)?)
    }

    fn domain(&self, grid: &Grid) -> Result<Option<Domain>, DomainError> {
        self.walls.map(|[lo, hi]| Domain::new(grid, lo, hi)).transpose()
    }

    /// Chooses the cells for particles. Only where cells have a size of their own and no kernels are drawn can the spacing be
    /// unknown: the filters are then as wide as for particles a cell apart.
    ///
    /// # Errors
    /// [`Error::NoSpacing`], and [`FrameError::NoParticles`].
    pub fn cells(&self, particles: &(impl Particles + ?Sized), from: Source<'_>) -> Result<Cells, Error> {
        self.cells_by(particles, from, || spacings(particles))
    }

    fn cells_by(
        &self,
        particles: &(impl Particles + ?Sized),
        from: Source<'_>,
        spacings: impl FnOnce() -> Option<Spacings>,
    ) -> Result<Cells, Error> {
        let path = || from.path.map(Path::to_owned);
        let mut doubt = None;
        let (spacing, source) = if let Some(spacing) = self.spacing {
            (spacing, SpacingSource::Given)
        } else if let Some(spacing) = from.spacing {
            (spacing, SpacingSource::File)
        } else if let Some((spacing, scene)) = from.path.and_then(spacing_beside) {
            doubt = spacings().and_then(|found| Doubt::of(spacing, Some(&scene), found));
            (spacing, SpacingSource::Scene(scene))
        } else if particles.is_empty() {
            return Err(Error::Frame { path: path(), fault: FrameError::NoParticles(Census::default()) });
        } else {
            let found = spacings();
            let estimate = found.map(|found| found.mean);
            doubt = found.and_then(|found| Doubt::of(found.mean, None, found));
            let estimate = match (self.cell_size(), self.field) {
                (CellSize::Length(size), FieldRequest::Indicator(asked)) => {
                    // Nobody asks for cells that are refused: then it was spray that was estimated.
                    let grid = self.grid(size)?;
                    let fits = |&spacing: &f64| {
                        Surfacing::PLAIN.refuse_too_fine(asked, Some(spacing), &grid).is_ok()
                    };
                    let Some(spacing) = estimate.filter(fits) else {
                        return Ok(Cells { size, spacing: None, doubt: None });
                    };
                    Some(spacing)
                }
                _ => estimate,
            };
            let none = || Error::NoSpacing { path: path(), particles: particles.len() };
            (estimate.ok_or_else(none)?, SpacingSource::Estimated)
        };
        let size = match self.cell_size() {
            CellSize::Length(size) => size,
            CellSize::Spacings(ratio) => positive_length("the cell size", ratio * spacing)?,
        };
        Ok(Cells { size, spacing: Some((spacing, source)), doubt })
    }

    /// Chooses how to sample particles, whose attributes numbered in `carried` go to the vertices.
    ///
    /// # Errors
    /// Those of [`cells`](Self::cells), [`Error::Domain`] and [`Error::Periodic`].
    pub fn sampling(
        &self,
        particles: &(impl Particles + ?Sized),
        from: Source<'_>,
        carried: Vec<usize>,
        resources: Resources,
    ) -> Result<ChosenSampling, Error> {
        let cells = self.cells(particles, from)?;
        self.sampling_in(cells, particles, carried, resources)
    }

    /// Works like [`sampling`](Self::sampling), and counts the particles for it where that can be done on the way.
    ///
    /// # Errors
    /// Those of [`sampling`](Self::sampling).
    pub fn sampling_and_plan(
        &self,
        particles: &(impl Particles + ?Sized),
        from: Source<'_>,
        carried: Vec<usize>,
        resources: Resources,
    ) -> Result<ChosenSampling, Error> {
        let Some((plan, part)) = self.counted(particles, from, &resources) else {
            return self.sampling(particles, from, carried, resources);
        };
        let cells = self.cells_by(particles, from, || part.spacings(particles))?;
        let chosen = self.sampling_in(cells, particles, carried, resources)?;
        Ok(ChosenSampling { plan: (!chosen.moved).then_some(plan), ..chosen })
    }

    fn sampling_in(
        &self,
        cells: Cells,
        particles: &(impl Particles + ?Sized),
        carried: Vec<usize>,
        resources: Resources,
    ) -> Result<ChosenSampling, Error> {
        let grid = self.grid(cells.size)?;
        let sampling = self.sampling_on(grid, self.field, cells.spacing(), carried, resources)?;
        if self.origin.is_some() {
            return Ok(ChosenSampling { sampling, cells, moved: false, plan: None });
        }
        let sampling = on_sound_grid(particles, sampling);
        let moved = sampling.grid != grid;
        Ok(ChosenSampling { sampling, cells, moved, plan: None })
    }

    /// Counts particles, and takes what tells their spacing meanwhile, which is to be estimated, on a grid that does not depend on it:
    /// one reading less of many particles. Whatever fails will fail again where it is reported.
    fn counted(
        &self,
        particles: &(impl Particles + ?Sized),
        from: Source<'_>,
        resources: &Resources,
    ) -> Option<(BinPlan, Part)> {
        let (CellSize::Length(size), None, None, None) =
            (self.cell_size(), self.spacing, from.spacing, self.periodic)
        else {
            return None;
        };
        let part = Part::of(particles.len())?;
        let grid = self.grid(size).ok()?;
        let domain = self.domain(&grid).ok()?;
        let room = CountingRoom::within(resources.budget.0);
        let look = |positions: &[[f64; 3]]| part.look(positions);
        let plan = BinPlan::count_while(particles, &grid, domain.as_ref(), self.invalid, room, look).ok()?;
        Some((plan, part))
    }

    /// Samples on a grid that is known, by a field whose mu0 may be known.
    ///
    /// # Errors
    /// [`Error::Domain`] and [`Error::Periodic`]; [`Error::Frame`] for cells that are too fine to tell how far a periodic box's images have
    /// to reach.
    pub fn sampling_on(
        &self,
        grid: Grid,
        field: FieldRequest,
        spacing: Option<f64>,
        carried: Vec<usize>,
        resources: Resources,
    ) -> Result<Sampling, Error> {
        let mut sampling = Sampling {
            grid,
            domain: self.domain(&grid)?,
            periodic: None,
            field,
            invalid: self.invalid,
            side: field.brick_side(),
            carried,
            spacing,
            resources,
        };
        if let Some((faces, surfacing)) = self.periodic {
            // How far filters reach can only be told of cells that they can be made for.
            sampling.refuse_unfit(&surfacing)?;
            let reach = surfacing.reach(field, spacing, &grid);
            sampling.periodic = Some(Periodic::new(&grid, faces, reach)?);
        }
        Ok(sampling)
    }
}
