//! How particles are to be sampled, as far as it can be known without them.

use std::path::Path;

use glam::DVec3;

use crate::brick::{BinPlan, Census, CountingRoom, InvalidParticles};
use crate::error::Error;
use crate::field::indicator::IndicatorKind;
use crate::field::spacing::{
    ALL, Cubes, Draft, Estimate, Evidence, InCubes, Look, Plane, Share, Untold, evidence, look_at,
    show_all,
};
use crate::field::walls::{Ends, Past, bounds_held, common, holding};
use crate::frame::{FrameError, Method, Resources, Sampling, Surfacing};
use crate::grid::units::positive_length;
use crate::grid::{CELL_LIMIT, Domain, DomainError, Grid, Periodic, Walls};
use crate::io::UpAxis;
use crate::io::scene::{spacing_beside, tank_beside};
use crate::particles::mixture::mixture;
use crate::particles::sizes::{SizeChoice, SizeFault, Sizes};
use crate::particles::{Particles, bounds};

use super::cells::{CellSize, Cells, FoundWalls, Slab, Source};
use super::lattice::on_sound_grid;
use super::orientation::usual_up;
use super::spacing::{Doubt, SpacingSource, is_suspicious};

/// How particles are to be sampled, whatever they are.
#[derive(Debug, Clone)]
pub struct SamplingRequest {
    /// The way to make a field of them.
    pub method: Method,
    /// Treatment of particles that are not finite or too far away.
    pub invalid: InvalidParticles,
    /// A corner of the grid's cells; where it is not given, the grid may be moved to suit a
    /// lattice.
    pub origin: Option<DVec3>,
    /// The lowest and the highest corner of a tank; particles outside are not counted.
    /// Open sides are at -inf and inf.
    pub walls: Option<[DVec3; 2]>,
    /// Whether walls are looked for where none are given.
    pub search: Search,
    /// The axis that points up, where that is known: 0, 1 or 2.
    pub up: Option<usize>,
    /// The faces of a periodic box along each axis, where it is not open, and the surface that
    /// images beyond them have to do for.
    pub periodic: Option<([Option<[f64; 2]>; 3], Surfacing)>,
    /// The particles' spacing, where the caller knows it.
    pub spacing: Option<f64>,
    /// The attribute with the particles' sizes, where they have several.
    pub size: SizeChoice,
    /// Edge of a cell; the [usual one](CellSize::usual) where it is not given.
    pub cell: Option<CellSize>,
}

/// Whether the walls of a tank are looked for.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Search {
    /// No.
    #[default]
    Never,
    /// To report them to the caller.
    Hint,
    /// To put the fluid in them.
    Walls,
}

impl Default for SamplingRequest {
    fn default() -> Self {
        Self {
            method: IndicatorKind::default().into(),
            invalid: InvalidParticles::Refuse,
            origin: None,
            walls: None,
            search: Search::Never,
            up: None,
            periodic: None,
            spacing: None,
            size: SizeChoice::Ignored,
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
    pub fn stage(&self) -> &'static str {
        if self.plan.is_some() { "count" } else { "spacing" }
    }
}

/// The particles of a frame, at the most, that is looked at for walls that were not asked for: it
/// takes two readings.
const MOST_HINTED: usize = 1 << 24;

/// Something that looks at the positions of all particles, some at once, in no order.
type LookAtAll<'a> = &'a (dyn Fn(&[[f64; 3]]) + Sync);

/// The spacing to which cells of a size that does not depend on it are the most usual ones.
fn usual_spacing(cell_size: f64) -> f64 {
    2.0 * cell_size
}

impl SamplingRequest {
    /// Edge of a cell.
    pub fn cell_size(&self) -> CellSize {
        self.cell.unwrap_or(CellSize::usual(self.method))
    }

    /// Refuses an origin, walls or a periodic box that are wrong whatever the cells' size is.
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
    pub fn grid(&self, cell_size: f64) -> Result<Grid, Error> {
        Ok(Grid::new(self.origin.unwrap_or_default(), cell_size)?)
    }

    pub(super) fn domain(&self, grid: &Grid) -> Result<Option<Domain>, DomainError> {
        self.walls.map(|[lo, hi]| Domain::new(grid, lo, hi)).transpose()
    }

    /// The request for a slab's particles: walls are its faces. Walls and periodic faces of the
    /// caller's own come first.
    pub fn in_slab(&self, slab: Option<Slab>) -> Self {
        let mut request = self.clone();
        if let Some(Slab { axis, faces: [lo, hi] }) =
            slab.filter(|slab| slab.axis < 3 && self.is_open(slab.axis))
        {
            let walls = request.walls.get_or_insert([DVec3::NEG_INFINITY, DVec3::INFINITY]);
            (walls[0][axis], walls[1][axis]) = (lo, hi);
        }
        request
    }

    /// The request for a frame that was found to be in `walls`, if it asks for them.
    #[must_use]
    pub fn in_walls(&self, walls: Option<&Walls>) -> Self {
        let walls = walls.filter(|walls| self.search == Search::Walls && !walls.is_open());
        Self { walls: walls.map(Walls::corners).or(self.walls), ..self.clone() }
    }

    /// The request for a frame in walls that were found on others, if it asks for them. Walls that
    /// particles pass are moved or left out: says which.
    #[must_use]
    pub fn in_walls_around(
        &self,
        walls: Option<&Walls>,
        particles: &(impl Particles + ?Sized),
        spacing: Option<f64>,
        grid: &Grid,
    ) -> (Self, Vec<Past>) {
        let walls = walls.filter(|walls| self.search == Search::Walls && !walls.is_open());
        let bounds = walls.and_then(|_| bounds_held(particles, grid));
        match (walls, bounds) {
            (Some(walls), Some(bounds)) => {
                let (holding, past) =
                    holding(walls, &bounds, spacing.unwrap_or_else(|| grid.cell_size()));
                (self.in_walls(Some(&holding)), past)
            }
            _ => (self.in_walls(walls), Vec::new()),
        }
    }

    /// The ends of a frame's particles, where they are to be looked at and their spacing is known.
    pub fn ends(
        &self,
        particles: &(impl Particles + ?Sized),
        cells: &Cells,
    ) -> Result<Option<Ends>, Error> {
        let Some(spacing) = cells.spacing() else { return Ok(None) };
        let flat = cells.slab.map(|slab| slab.axis);
        Ok(Ends::of(particles, spacing, flat, &self.grid_of(cells)?))
    }

    /// The walls that some frames and the scene beside their files show.
    pub fn walls_of(&self, frames: &[Ends], path: Option<&Path>) -> FoundWalls {
        let scene = path.and_then(tank_beside);
        let usual = path.filter(|path| usual_up(path) == UpAxis::Z).map(|_| 2);
        let known = scene.as_ref().map(|(walls, _)| walls);
        let (mut walls, by_scene) = common(frames, known, self.up.or(usual));
        if let Some((faces, _)) = self.periodic {
            (0..3).filter(|&axis| faces[axis].is_some()).for_each(|axis| walls.0[axis] = [None; 2]);
        }
        FoundWalls { walls, scene: scene.map(|(_, path)| path).filter(|_| by_scene) }
    }

    /// Whether the caller asked for nothing where the fluid ends along an axis.
    fn is_open(&self, axis: usize) -> bool {
        self.walls.is_none_or(|[lo, hi]| !lo[axis].is_finite() && !hi[axis].is_finite())
            && self.periodic.as_ref().is_none_or(|(faces, _)| faces[axis].is_none())
    }

    /// The spacing that the caller, the file or a scene beside it gives.
    fn given(&self, from: Source<'_>) -> Option<(f64, SpacingSource)> {
        let scene = || {
            let (spacing, path) = spacing_beside(from.path?)?;
            Some((spacing, SpacingSource::Scene(path)))
        };
        let of_caller = self.spacing.map(|spacing| (spacing, SpacingSource::Given));
        of_caller.or(from.spacing.map(|spacing| (spacing, SpacingSource::File))).or_else(scene)
    }

    /// Chooses the cells for particles. Only where cells have a size of their own and no kernels
    /// are drawn can the spacing be unknown: the filters are then as wide as for particles a cell
    /// apart.
    pub fn cells(
        &self,
        particles: &(impl Particles + ?Sized),
        from: Source<'_>,
    ) -> Result<Cells, Error> {
        let read = |_, look: LookAtAll<'_>| {
            show_all(particles, look);
            Some(())
        };
        Ok(self.cells_while(particles, from, read)?.0)
    }

    /// Chooses the cells for particles like [`cells_by`](Self::cells_by), with a doubt where a
    /// boundary is among them.
    fn cells_while<T>(
        &self,
        particles: &(impl Particles + ?Sized),
        from: Source<'_>,
        read: impl FnMut(f64, LookAtAll<'_>) -> Option<T>,
    ) -> Result<(Cells, Option<T>), Error> {
        let (mut cells, done) = match self.sizes(particles)? {
            Some(sizes) => (self.cells_for_sizes(particles, sizes)?, None),
            None => self.cells_by(particles, from, read)?,
        };
        if !cells.doubts.iter().any(|doubt| matches!(doubt, Doubt::Mixed(_))) {
            cells.doubts.extend(mixture(particles).map(Doubt::Mixed));
        }
        let is_sought = match self.search {
            Search::Never => false,
            Search::Hint => particles.len() <= MOST_HINTED,
            Search::Walls => true,
        };
        if is_sought {
            let ends = self.ends(particles, &cells)?;
            let found = ends.map(|ends| self.walls_of(&[ends], from.path));
            cells.walls =
                found.filter(|found| self.search == Search::Walls || !found.walls.is_open());
        }
        Ok((cells, done))
    }

    /// The sizes of the particles, if they have several.
    fn sizes(&self, particles: &(impl Particles + ?Sized)) -> Result<Option<Sizes>, Error> {
        let found = self.size.columns(particles.attributes()).and_then(|columns| match columns {
            Some(columns) => Sizes::found(particles, &columns),
            None => Ok(None),
        });
        match found {
            // Nobody asked for that attribute.
            Err(SizeFault::NoSize { .. }) if self.size == SizeChoice::Usual => Ok(None),
            found => Ok(found?),
        }
    }

    /// The cells by the smallest size.
    fn cells_for_sizes(
        &self,
        particles: &(impl Particles + ?Sized),
        sizes: Sizes,
    ) -> Result<Cells, Error> {
        let middle = bounds(particles).map(|bounds| (bounds.lo + bounds.hi) / 2.0);
        let source = SpacingSource::Sizes(sizes.attribute.clone());
        let cells = self.cells_of(sizes.finest, source, middle, None)?;
        let doubts = Doubt::of_sizes(&sizes).into_iter().collect();
        Ok(Cells { sizes: Some(sizes), doubts, ..cells })
    }

    /// Chooses the cells for particles, and uses the caller's `read` if a separate reading of all
    /// particles would take long. `read` gets the cell size, as far as it is
    /// known, and a function that it calls with the positions of all particles. It returns `None`
    /// if it failed. The last value that it returned is returned with the cells.
    fn cells_by<T>(
        &self,
        particles: &(impl Particles + ?Sized),
        from: Source<'_>,
        mut read: impl FnMut(f64, LookAtAll<'_>) -> Option<T>,
    ) -> Result<(Cells, Option<T>), Error> {
        let is_many = particles.len() > ALL;
        let size = |spacing: f64| match self.cell_size() {
            CellSize::Length(size) => size,
            CellSize::Spacings(ratio) => ratio * spacing,
        };
        let share = Share::of(particles.len());
        if let Some((spacing, source)) = self.given(from) {
            // A scene need not be that of the particles, and says nothing of a second resolution.
            let is_scene = matches!(source, SpacingSource::Scene(_));
            let in_cubes = InCubes::new(Cubes::for_spacing(spacing), particles.len());
            let look = |positions: &[[f64; 3]]| {
                in_cubes.look(positions);
                if is_scene {
                    share.look(positions);
                }
            };
            let done = if is_many { read(size(spacing), &look) } else { None };
            let look = match done {
                Some(_) => Look::of(in_cubes.sample(), spacing),
                None => look_at(particles, spacing),
            };
            let taken = (is_scene && done.is_some()).then(|| share.taken());
            let draft = taken.filter(|taken| taken.larger().is_none()).and_then(Draft::of);
            let evidence = draft.zip(look.clone()).map(|(draft, look)| draft.with(look.neighbours));
            return Ok((self.cells_for_given(particles, spacing, source, look, evidence)?, done));
        }
        if !is_many {
            return Ok((self.cells_by_evidence(particles, from, evidence(particles))?, None));
        }
        let (mut done, mut sample) = (None, None);
        let usual = match self.cell_size() {
            CellSize::Length(size) => Some(usual_spacing(size)),
            CellSize::Spacings(_) => None,
        };
        if let Some(usual) = usual {
            let in_cubes = InCubes::new(Cubes::for_spacing(usual), particles.len());
            let look = |positions: &[[f64; 3]]| {
                share.look(positions);
                in_cubes.look(positions);
            };
            done = read(size(usual), &look);
            if done.is_none() {
                return Ok((self.cells(particles, from)?, None));
            }
            sample = Some(in_cubes.sample());
        } else {
            show_all(particles, |positions| share.look(positions));
        }
        let taken = share.taken();
        let draft = if taken.larger().is_none() { Draft::of(taken) } else { None };
        let Some(draft) = draft else {
            return Ok((self.cells_by_evidence(particles, from, evidence(particles))?, done));
        };
        if let (None, Some(known)) = (usual, draft.counted()) {
            let in_cubes = draft.in_cubes();
            done = read(size(known), &|positions| in_cubes.look(positions));
            sample = done.is_some().then(|| in_cubes.sample());
        }
        let suits = usual.is_none_or(|usual| draft.suits(usual));
        let evidence = match sample.filter(|sample| suits && !sample.positions.is_empty()) {
            Some(sample) => draft.with_sample(sample),
            None => draft.completed(particles),
        };
        Ok((self.cells_by_evidence(particles, from, Some(evidence))?, done))
    }

    /// The size of cells, a corner of theirs if it has to be far from the origin, and a slab, for
    /// particles whose spacing is known.
    fn cells_of(
        &self,
        spacing: f64,
        source: SpacingSource,
        middle: Option<DVec3>,
        plane: Option<Plane>,
    ) -> Result<Cells, Error> {
        let size = match self.cell_size() {
            CellSize::Length(size) => size,
            CellSize::Spacings(ratio) => positive_length("cell-size", ratio * spacing)?,
        };
        // A slab holds no cell's centre for sure where cells are wider than it.
        let is_fine = size < 0.99 * spacing;
        let slab = plane.filter(|plane| is_fine && self.is_open(plane.axis));
        let slab = slab.map(|plane| Slab::around(plane, spacing));
        Ok(Cells {
            size,
            spacing: Some((spacing, source)),
            origin: self.origin_for(middle, size),
            slab,
            walls: None,
            sizes: None,
            doubts: Vec::new(),
        })
    }

    /// A corner for cells of particles around `middle`, where the grid around the origin would not
    /// reach them with half of its cells.
    fn origin_for(&self, middle: Option<DVec3>, size: f64) -> Option<[f64; 3]> {
        let middle = middle.filter(|_| self.origin.is_none())?;
        let reach = f64::from(CELL_LIMIT) / 2.0 * size;
        // Of particles outside of walls none counts.
        let middle = self.walls.map_or(middle, |[lo, hi]| {
            let walled = (lo + hi) / 2.0;
            DVec3::from(
                [0, 1, 2].map(|a| if walled[a].is_finite() { walled[a] } else { middle[a] }),
            )
        });
        // Along the axes that need it, in whole cells.
        let origin = middle
            .to_array()
            .map(|c| if c.abs() > reach { (c / size).round() * size } else { 0.0 });
        (origin != [0.0; 3] && origin.iter().all(|c| c.is_finite())).then_some(origin)
    }

    /// The cells for a spacing that was given, with doubts about it where a look at its scale does
    /// not bear it out.
    fn cells_for_given(
        &self,
        particles: &(impl Particles + ?Sized),
        spacing: f64,
        source: SpacingSource,
        look: Option<Look>,
        evidence_at_hand: Option<Evidence>,
    ) -> Result<Cells, Error> {
        let all_is_well = look.as_ref().is_some_and(|look| {
            let coarse = look.place.step.is_some_and(|step| Doubt::is_coarse(step, spacing));
            look.place.plane.is_none() && !coarse && !is_suspicious(&look.neighbours, spacing)
        });
        // A scene need not be that of the particles, and says nothing of a second resolution.
        let is_scene = matches!(source, SpacingSource::Scene(_));
        let evidence = match evidence_at_hand {
            None if !all_is_well || is_scene => evidence(particles),
            at_hand => at_hand,
        };
        let place = evidence
            .as_ref()
            .map(|evidence| evidence.place)
            .or(look.as_ref().map(|look| look.place));
        let (middle, plane) =
            (place.map(|place| place.middle), place.and_then(|place| place.plane));
        let mut cells = self.cells_of(spacing, source.clone(), middle, plane)?;
        if let Some(evidence) = &evidence {
            let at_scale = look.as_ref().map_or(&evidence.neighbours, |look| &look.neighbours);
            cells.doubts = Doubt::of_given(spacing, &source, at_scale, evidence);
        }
        Ok(cells)
    }

    /// The cells by what the particles say.
    fn cells_by_evidence(
        &self,
        particles: &(impl Particles + ?Sized),
        from: Source<'_>,
        evidence: Option<Evidence>,
    ) -> Result<Cells, Error> {
        let path = || from.path.map(Path::to_owned);
        if particles.is_empty() {
            return Err(Error::Frame {
                path: path(),
                fault: FrameError::NoParticles(Census::default()),
            });
        }
        let place = evidence.as_ref().map(|evidence| evidence.place);
        let middle = place.map(|place| place.middle);
        let estimate = evidence.as_ref().map_or(Err(Untold::TooFew), Evidence::estimate);
        if let CellSize::Length(size) = self.cell_size()
            && let Method::Indicator { kind, mean } = self.method
        {
            // Nobody asks for cells that are refused: then it was spray that was estimated.
            let grid = self.grid(size)?;
            let fits = |estimate: &Estimate| {
                let spacing = Some(estimate.spacing);
                Surfacing::PLAIN.refuse_too_fine(kind, mean, spacing, &grid).is_ok()
            };
            if !estimate.as_ref().is_ok_and(fits) {
                let origin = self.origin_for(middle, size);
                return Ok(Cells {
                    size,
                    spacing: None,
                    origin,
                    slab: None,
                    walls: None,
                    sizes: None,
                    doubts: Vec::new(),
                });
            }
        }
        let estimate = estimate.map_err(|why| Error::NoSpacing {
            path: path(),
            particles: particles.len(),
            why,
            // Places on a coarse grid suggest nothing.
            suggested: match why {
                Untold::SinglePrecision { .. } => None,
                _ => evidence.as_ref().and_then(|evidence| evidence.neighbours.suggested()),
            },
        })?;
        let plane = place.and_then(|place| place.plane);
        let mut cells = self.cells_of(estimate.spacing, SpacingSource::Estimated, middle, plane)?;
        cells.doubts =
            evidence.map_or(Vec::new(), |evidence| Doubt::of_estimate(&estimate, &evidence));
        Ok(cells)
    }

    /// Chooses how to sample particles, whose attributes numbered in `carried` go to the vertices.
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

    /// Works like [`sampling`](Self::sampling), and counts the particles for it where that can be
    /// done on the way.
    pub fn sampling_and_plan(
        &self,
        particles: &(impl Particles + ?Sized),
        from: Source<'_>,
        carried: Vec<usize>,
        resources: Resources,
    ) -> Result<ChosenSampling, Error> {
        // Of the count comes the grid that it was made on. Whatever fails will fail again where it
        // is reported.
        let count = |cell_size: f64, look: LookAtAll<'_>| {
            let grid = self.grid(cell_size).ok()?;
            let domain = self.domain(&grid).ok()?;
            let room = CountingRoom::within(resources.budget.0);
            let plan =
                BinPlan::count_while(particles, &grid, domain.as_ref(), self.invalid, room, look);
            Some((grid, plan.ok()?))
        };
        let is_settled = self.periodic.is_none() && self.search != Search::Walls;
        let (cells, counted) = if is_settled {
            self.cells_while(particles, from, count)?
        } else {
            (self.cells(particles, from)?, None)
        };
        let chosen = self.sampling_in(cells, particles, carried, resources)?;
        let unmoved = !chosen.moved && chosen.cells.slab.is_none();
        let same = |(grid, _): &(Grid, BinPlan)| unmoved && chosen.sampling.grid == *grid;
        Ok(ChosenSampling { plan: counted.filter(same).map(|(_, plan)| plan), ..chosen })
    }

    fn sampling_in(
        &self,
        cells: Cells,
        particles: &(impl Particles + ?Sized),
        carried: Vec<usize>,
        resources: Resources,
    ) -> Result<ChosenSampling, Error> {
        let grid = self.grid_of(&cells)?;
        let request = self.in_walls(cells.found()).in_slab(cells.slab);
        let sampling =
            request.sampling_on(grid, self.method, cells.spacing(), carried, resources)?;
        let sampling = sampling.sized(cells.sizes.as_ref(), particles)?;
        if self.origin.is_some() {
            return Ok(ChosenSampling { sampling, cells, moved: false, plan: None });
        }
        let sampling = on_sound_grid(particles, sampling);
        let moved = sampling.grid != grid;
        Ok(ChosenSampling { sampling, cells, moved, plan: None })
    }

    /// The grid of cells that were chosen.
    pub fn grid_of(&self, cells: &Cells) -> Result<Grid, Error> {
        match cells.origin {
            Some(origin) => Ok(Grid::new(origin.into(), cells.size)?),
            None => self.grid(cells.size),
        }
    }

    /// Samples on a grid that is known, by a method whose mu0 may be known.
    ///
    /// # Errors
    /// [`Error::Domain`] and [`Error::Periodic`]; [`Error::Frame`] for cells that are too fine to
    /// compute the reach of a periodic box's images.
    pub fn sampling_on(
        &self,
        grid: Grid,
        method: Method,
        spacing: Option<f64>,
        carried: Vec<usize>,
        resources: Resources,
    ) -> Result<Sampling, Error> {
        let mut sampling = Sampling {
            grid,
            domain: self.domain(&grid)?,
            periodic: None,
            method,
            invalid: self.invalid,
            side: method.brick_side(),
            carried,
            kinds: Vec::new(),
            spacing,
            sizes: None,
            resources,
        };
        if let Some((faces, surfacing)) = &self.periodic {
            // The reach of filters is only known for valid cells.
            sampling.refuse_unfit(surfacing)?;
            let reach = surfacing.reach(method, spacing, &grid);
            sampling.periodic = Some(Periodic::new(&grid, *faces, reach)?);
        }
        Ok(sampling)
    }
}
