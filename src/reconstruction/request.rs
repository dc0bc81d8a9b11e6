//! The settings for sampling particles, as far as they are known without the particles.

use std::path::Path;
use std::sync::{Mutex, PoisonError};

use glam::DVec3;

use crate::brick::{BinPlan, Census, CountingRoom, InvalidParticles};
use crate::error::{Conflict, Error, SettingConflict};
use crate::field::indicator::IndicatorKind;
use crate::field::spacing::{
    ALL, CubeSample, Cubes, EvenSample, Evidence, NoEstimate, Plane, SampleSurvey, SpacingDraft,
    SpacingEstimate, evidence, for_each_chunk, survey,
};
use crate::field::walls::{BeyondWall, Ends, adapted, bounds_on_grid, common, spacings_at_sides};
use crate::frame::{FrameError, Method, Resources, Sampling, Surfacing};
use crate::grid::units::positive_length;
use crate::grid::{CELL_LIMIT, Domain, DomainError, Grid, Periodic, Walls};
use crate::io::UpAxis;
use crate::io::scene::{spacing_from_scene, tank_from_scene};
use crate::particles::mixture::mixture;
use crate::particles::sizes::{FoundSizes, SizeAttributes, SizeChoice, SizeFault, Sizes};
use crate::particles::{Bounds, Particles, bounds};
use crate::settings::Setting;

use super::cells::{CellSize, Cells, FoundWalls, Slab, SpacingHints};
use super::lattice::on_sound_grid;
use super::orientation::usual_up;
use super::spacing::{SpacingSource, SpacingWarning, is_suspicious};

/// The settings for sampling, which apply to any particles.
#[derive(Debug, Clone)]
pub struct SamplingRequest {
    /// The method that makes the field.
    pub method: Method,
    /// Treatment of particles whose positions are not finite, too far from the grid's origin, or
    /// too far outside the periodic box.
    pub invalid: InvalidParticles,
    /// The grid's origin, which is a corner of a cell; with `None`, the grid can move to suit a
    /// lattice.
    pub origin: Option<DVec3>,
    /// The lowest and highest corner of a tank; particles outside the tank are not counted. Open
    /// sides are at -inf and inf.
    pub walls: Option<[DVec3; 2]>,
    /// Whether to find walls if none are given.
    pub search: WallSearch,
    /// The axis that points up, if known: 0, 1 or 2.
    pub up: Option<usize>,
    /// The faces of a periodic box along each axis, `None` for open axes; and the parameters of the
    /// surface, which determine how far images extend beyond the faces.
    pub periodic: Option<([Option<[f64; 2]>; 3], Surfacing)>,
    /// The spacing of the particles, if the caller knows it.
    pub spacing: Option<f64>,
    /// The choice of the attribute that contains the sizes of the particles.
    pub size: SizeChoice,
    /// Edge of a cell; the [usual size](CellSize::usual) if `None`.
    pub cell: Option<CellSize>,
}

/// Whether to find the walls of a tank.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum WallSearch {
    #[default]
    /// Do not find walls.
    Never,
    /// Find walls, and report them to the caller.
    Hint,
    /// Find walls, and end the fluid at them.
    Walls,
}

impl Default for SamplingRequest {
    fn default() -> Self {
        Self {
            method: IndicatorKind::default().into(),
            invalid: InvalidParticles::Refuse,
            origin: None,
            walls: None,
            search: WallSearch::Never,
            up: None,
            periodic: None,
            spacing: None,
            size: SizeChoice::Ignored,
            cell: None,
        }
    }
}

/// The sampling of a frame, and the choices that led to it.
#[derive(Debug)]
pub struct ChosenSampling {
    /// The sampling, with its grid at the best position.
    pub sampling: Sampling,
    /// The cells, with the spacing and its warnings.
    pub cells: Cells,
    /// Whether the grid was moved to suit a lattice.
    pub moved: bool,
    /// The number of particles in each bin, if the particles were counted in the same reading.
    pub plan: Option<BinPlan>,
}

impl ChosenSampling {
    /// Name of the stage to which the time of this choice is attributed.
    pub fn stage(&self) -> &'static str {
        if self.plan.is_some() { "count" } else { "spacing" }
    }
}

/// If there are more particles than this, walls are found only on request, because finding them
/// needs another reading.
const MOST_PARTICLES_FOR_HINT: usize = 1 << 24;
/// Lower walls lie between two cells of the grid, and also between two cells that are up to this
/// number of times as wide. This includes the wide cells of all cells that are not extremely fine.
const ALIGNED_CELLS: f64 = 64.0;

/// A callback that receives the positions of all particles, in pieces and in any order.
type PositionVisitor<'a> = &'a (dyn Fn(&[[f64; 3]]) + Sync);

/// The spacing for which `cell_size` is half a spacing, the usual size for clouds.
fn usual_spacing(cell_size: f64) -> f64 {
    2.0 * cell_size
}

/// Corrects sizes that the density of the fluid did not confirm, if the fluid is implausibly dense
/// for these sizes, or if the neighbours of particles contradict the sizes. Returns a warning if
/// the neighbours contradict the sizes and the sizes cannot be corrected.
fn corrected_by_neighbours(
    particles: &dyn Particles,
    columns: &SizeAttributes,
    sizes: &mut Sizes,
) -> Option<SpacingWarning> {
    if sizes.density.is_some() {
        return None;
    }
    let evidence = evidence(particles)?;
    let [_, widest] = evidence.estimate().ok()?.extremes();
    sizes.reduce_if_too_dense(particles, columns, widest);
    let warning = SpacingWarning::of_unmeasured_sizes(sizes, &evidence)?;
    sizes.scale_by_spacing(particles, columns, widest);
    sizes.density.is_none().then_some(warning)
}

/// Returns an error if reading the particles was cancelled.
fn check_cancelled(particles: &dyn Particles) -> Result<(), Error> {
    if particles.goes_on() { Ok(()) } else { Err(Error::Cancelled) }
}

impl SamplingRequest {
    /// Edge of a cell.
    pub fn cell_size(&self) -> CellSize {
        self.cell.unwrap_or(CellSize::usual(self.method))
    }

    /// Rejects an origin, walls or a periodic box that are invalid for every cell size.
    pub fn validate(&self) -> Result<(), Error> {
        let unit = self.grid(1.0)?;
        if let Some([lo, hi]) = self.walls
            && let Err(error @ DomainError::Corners) = Domain::new(&unit, lo, hi)
        {
            return Err(error.into());
        }
        if let Some((faces, _)) = self.periodic {
            Periodic::check(faces)?;
            self.walls.map_or(Ok(()), |walls| Periodic::check_walls(faces, walls))?;
        }
        Ok(())
    }

    /// The requested grid, with this cell size.
    pub fn grid(&self, cell_size: f64) -> Result<Grid, Error> {
        let origin = self.origin.unwrap_or_else(|| self.origin_at_walls(cell_size));
        Ok(Grid::new(origin, cell_size)?)
    }

    /// The origin that is next to 0 among those for which the lower walls lie between two cells,
    /// also between cells that are up to `ALIGNED_CELLS` times as wide. Along an axis with only an
    /// upper wall, this wall lies between two cells. Along open axes, the origin is 0.
    fn origin_at_walls(&self, cell_size: f64) -> DVec3 {
        let step = ALIGNED_CELLS * cell_size;
        let along = |[lo, hi]: [f64; 2]| {
            let wall = if lo.is_finite() { lo } else { hi };
            let offset = wall - (wall / step).round() * step;
            if offset.is_finite() { offset } else { 0.0 }
        };
        self.walls.map_or(DVec3::ZERO, |[lo, hi]| {
            DVec3::from([0, 1, 2].map(|axis: usize| along([lo[axis], hi[axis]])))
        })
    }

    pub(super) fn domain(&self, grid: &Grid) -> Result<Option<Domain>, DomainError> {
        self.walls.map(|[lo, hi]| Domain::new(grid, lo, hi)).transpose()
    }

    /// The request with the slab's faces as walls. The caller's walls and periodic faces take
    /// precedence.
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

    /// The request with the found `walls`, if the request asks to find walls.
    #[must_use]
    pub fn in_walls(&self, walls: Option<&Walls>) -> Self {
        let walls = walls.filter(|walls| self.search == WallSearch::Walls && !walls.is_open());
        Self { walls: walls.map(Walls::corners).or(self.walls), ..self.clone() }
    }

    /// The request with walls that were found on other frames, if the request asks to find walls.
    /// Walls that particles of this frame have crossed are moved or removed, and are also returned.
    #[must_use]
    pub fn in_walls_around(
        &self,
        found: Option<&FoundWalls>,
        particles: &dyn Particles,
        spacing: Option<f64>,
        grid: &Grid,
    ) -> (Self, Vec<BeyondWall>) {
        let found =
            found.filter(|found| self.search == WallSearch::Walls && !found.walls.is_open());
        let bounds = found.and_then(|_| bounds_on_grid(particles, grid));
        let (Some(FoundWalls { walls, spacings, .. }), Some(bounds)) = (found, bounds) else {
            return (self.in_walls(found.map(|found| &found.walls)), Vec::new());
        };
        let of_all = || [[spacing.unwrap_or_else(|| grid.cell_size()); 2]; 3];
        let (adapted, crossed) = adapted(walls, &bounds, spacings.unwrap_or_else(of_all));
        (self.in_walls(Some(&adapted)), crossed)
    }

    /// Measures where a frame's particles end. `known` is their bounding box, if it is known.
    /// Returns `None` if the spacing is unknown.
    fn ends(
        &self,
        particles: &dyn Particles,
        known: Option<Bounds>,
        cells: &Cells,
    ) -> Result<Option<Ends>, Error> {
        let Some(spacing) = cells.spacing() else { return Ok(None) };
        let flat = cells.slab.map(|slab| slab.axis);
        let lengths = (spacing, cells.sizes.as_ref());
        Ok(Ends::of(particles, known, lengths, flat, &self.grid_of(cells)?))
    }

    /// The walls that `frames` indicate, together with the walls that the caller set or, if there
    /// are none, those of a scene file next to `path`.
    pub fn walls_of(&self, frames: &[Ends], path: Option<&Path>) -> FoundWalls {
        let given = self.walls.map(|corners| Walls::from_corners(corners.map(|at| at.to_array())));
        let scene = path.and_then(tank_from_scene);
        let usual = path.filter(|path| usual_up(path) == UpAxis::Z).map(|_| 2);
        let known = given.as_ref().or(scene.as_ref().map(|(walls, _)| walls));
        let (mut walls, by_scene) = common(frames, known, self.up.or(usual));
        if let Some((faces, _)) = self.periodic {
            (0..3).filter(|&axis| faces[axis].is_some()).for_each(|axis| walls.0[axis] = [None; 2]);
        }
        let scene = scene.map(|(_, path)| path).filter(|_| by_scene);
        FoundWalls { walls, scene, spacings: spacings_at_sides(frames) }
    }

    /// Whether the caller set neither walls nor periodic faces along an axis.
    fn is_open(&self, axis: usize) -> bool {
        self.walls.is_none_or(|[lo, hi]| !lo[axis].is_finite() && !hi[axis].is_finite())
            && self.periodic.as_ref().is_none_or(|(faces, _)| faces[axis].is_none())
    }

    /// The spacing from the caller, the file, or a scene file next to it.
    fn given(&self, from: SpacingHints<'_>) -> Option<(f64, SpacingSource)> {
        let scene = || {
            let (spacing, path) = spacing_from_scene(from.path?)?;
            Some((spacing, SpacingSource::Scene(path)))
        };
        let of_caller = self.spacing.map(|spacing| (spacing, SpacingSource::Given));
        of_caller.or(from.spacing.map(|spacing| (spacing, SpacingSource::File))).or_else(scene)
    }

    /// Chooses the cells for particles. If the cell size is given as a length, the spacing may stay
    /// unknown, except for kernel methods. If the spacing is unknown, the filters are as wide as
    /// for particles one cell apart.
    pub fn cells(&self, particles: &dyn Particles, from: SpacingHints<'_>) -> Result<Cells, Error> {
        let read = |_, visit: PositionVisitor<'_>| {
            for_each_chunk(particles, visit);
            Some(())
        };
        Ok(self.cells_while(particles, from, read)?.0)
    }

    /// Chooses the cells from the particles' sizes if an attribute gives several sizes, and
    /// otherwise like [`cells_by`](Self::cells_by). Also warns if some of the particles look like a
    /// boundary, and finds walls if requested.
    fn cells_while<T>(
        &self,
        particles: &dyn Particles,
        from: SpacingHints<'_>,
        mut read: impl FnMut(f64, PositionVisitor<'_>) -> Option<T>,
    ) -> Result<(Cells, Option<T>), Error> {
        let searches_walls = self.searches_walls(particles.len());
        let mut known = None;
        let read_with_bounds = |size: f64, visit: PositionVisitor<'_>| {
            if !searches_walls {
                return read(size, visit);
            }
            let all = Mutex::new(Bounds::NONE);
            let done = read(size, &|positions| {
                visit(positions);
                let own = Bounds::of(positions);
                let mut all = all.lock().unwrap_or_else(PoisonError::into_inner);
                *all = all.joined(own);
            })?;
            known = all.into_inner().ok().filter(|bounds| bounds.finite > 0);
            Some(done)
        };
        let (sizes, wrong) = self.sizes(particles)?.unzip();
        let invalid = sizes.as_ref().and_then(SpacingWarning::of_sizes);
        let (mut cells, done) = match sizes {
            Some(FoundSizes::Several(sizes)) => (self.cells_for_sizes(particles, sizes)?, None),
            Some(FoundSizes::One { .. }) | None => {
                self.cells_by(particles, from, read_with_bounds)?
            }
        };
        cells.warnings.extend(wrong.flatten().into_iter().chain(invalid));
        check_cancelled(particles)?;
        if !cells.warnings.iter().any(|warning| matches!(warning, SpacingWarning::Mixed(_))) {
            cells.warnings.extend(mixture(particles).map(SpacingWarning::Mixed));
        }
        if searches_walls {
            let ends = self.ends(particles, known, &cells)?;
            // The caller's walls take precedence over those of a scene file.
            let scene = from.path.filter(|_| self.walls.is_none());
            let found = ends.map(|ends| self.walls_of(&[ends], scene));
            cells.walls =
                found.filter(|found| self.search == WallSearch::Walls || !found.walls.is_open());
        }
        Ok((cells, done))
    }

    fn searches_walls(&self, particles: usize) -> bool {
        match self.search {
            WallSearch::Never => false,
            WallSearch::Hint => particles <= MOST_PARTICLES_FOR_HINT,
            WallSearch::Walls => true,
        }
    }

    /// The number of times that particles are usually read to choose cells and count particles:
    /// once for the spacing, once for the count, and once for walls. If there are at most [`ALL`]
    /// particles, walls need two readings.
    pub fn readings(&self, particles: usize) -> usize {
        let for_walls = if particles > ALL { 1 } else { 2 };
        if self.searches_walls(particles) { 2 + for_walls } else { 2 }
    }

    /// The sizes of the particles, if an attribute holds them, and a warning if the sizes look
    /// wrong.
    fn sizes(
        &self,
        particles: &dyn Particles,
    ) -> Result<Option<(FoundSizes, Option<SpacingWarning>)>, Error> {
        let is_usual = matches!(self.size, SizeChoice::Usual | SizeChoice::OneFor(_));
        let columns = self.size.columns(particles.attributes())?;
        // If the user did not name an attribute, masses and smoothing lengths count as sizes only
        // if the masses differ. Different densities are not enough, because densities differ in any
        // gas.
        let Some(columns) = columns.filter(|columns| columns.are_sizes(particles)) else {
            return Ok(None);
        };
        let mut found = match Sizes::found(particles, &columns) {
            // The user did not name this attribute, so it is no error if no particle has a valid
            // size.
            Err(SizeFault::NoSize { .. }) if is_usual => return Ok(None),
            found => found?,
        };
        let FoundSizes::Several(sizes) = &mut found else { return Ok(Some((found, None))) };
        if let SizeChoice::OneFor(needs_one) = self.size {
            let with = Conflict::SeveralSizes { attribute: sizes.attribute.clone() };
            return Err(SettingConflict { setting: Setting::named(needs_one), with }.into());
        }
        let warning = corrected_by_neighbours(particles, &columns, sizes);
        // Programs define smoothing lengths differently. Unless the user named them, use them as
        // sizes only if the measured density confirms their scale.
        let is_sure = !is_usual || !columns.are_smoothing_lengths() || sizes.density.is_some();
        Ok(is_sure.then_some((found, warning)))
    }

    /// The warning about the sizes of `particles`, in a frame whose spacing and sizes come from
    /// another frame.
    ///
    /// # Errors
    /// [`Error::Sizes`] if the frame has no such attribute.
    pub fn warning_of_sizes(
        &self,
        (spacing, sizes): (Option<f64>, Option<&Sizes>),
        particles: &dyn Particles,
    ) -> Result<Option<SpacingWarning>, Error> {
        if particles.is_empty() {
            return Ok(None);
        }
        if let Some(sizes) = sizes {
            let columns = sizes.columns(particles.attributes())?;
            return Ok(SpacingWarning::of_strays(sizes, sizes.strays(particles, &columns)));
        }
        let found = self.sizes(particles)?.map(|(found, _)| found);
        Ok(match (found, spacing) {
            (Some(FoundSizes::Several(found)), Some(used)) => Some(SpacingWarning::MoreSizes {
                attribute: found.attribute,
                sizes: [found.finest, found.coarsest],
                used,
            }),
            (found, _) => found.as_ref().and_then(SpacingWarning::of_sizes),
        })
    }

    /// The cells that follow from the smallest size in `sizes`.
    fn cells_for_sizes(&self, particles: &dyn Particles, sizes: Sizes) -> Result<Cells, Error> {
        let middle = bounds(particles).map(|bounds| (bounds.lo + bounds.hi) / 2.0);
        let source = SpacingSource::Sizes(sizes.attribute.clone());
        let cells = self.cells_of(sizes.finest, source, middle, None)?;
        Ok(Cells { sizes: Some(sizes), ..cells })
    }

    /// Chooses the cells for particles. If there are more than [`ALL`] particles, this function
    /// reads them through the caller's `read`, which can do other work in the same reading. `read`
    /// receives the expected cell size, and a function to which it must pass the positions of all
    /// particles. `read` returns `None` on failure. The value that `read` returned last is returned
    /// with the cells.
    fn cells_by<T>(
        &self,
        particles: &dyn Particles,
        from: SpacingHints<'_>,
        mut read: impl FnMut(f64, PositionVisitor<'_>) -> Option<T>,
    ) -> Result<(Cells, Option<T>), Error> {
        let is_many = particles.len() > ALL;
        let size = |spacing: f64| match self.cell_size() {
            CellSize::Length(size) => size,
            CellSize::Spacings(ratio) => ratio * spacing,
        };
        let even = EvenSample::of(particles.len());
        if let Some((spacing, source)) = self.given(from) {
            // A spacing from a scene file must be checked, because the file may belong to other
            // particles, and does not state a second spacing.
            let is_scene = matches!(source, SpacingSource::Scene(_));
            let in_cubes = CubeSample::new(Cubes::for_spacing(spacing), particles.len());
            let visit = |positions: &[[f64; 3]]| {
                in_cubes.add(positions);
                if is_scene {
                    even.add(positions);
                }
            };
            let done = if is_many { read(size(spacing), &visit) } else { None };
            let surveyed = match done {
                Some(_) => SampleSurvey::of(in_cubes.sample(), spacing),
                None => survey(particles, spacing),
            };
            check_cancelled(particles)?;
            let taken = (is_scene && done.is_some()).then(|| even.taken());
            let draft = taken.filter(|taken| taken.larger().is_none()).and_then(SpacingDraft::of);
            let evidence = draft
                .zip(surveyed.clone())
                .map(|(draft, surveyed)| draft.with(surveyed.neighbours));
            let cells = self.cells_for_given(particles, spacing, source, surveyed, evidence)?;
            return Ok((cells, done));
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
            let in_cubes = CubeSample::new(Cubes::for_spacing(usual), particles.len());
            let visit = |positions: &[[f64; 3]]| {
                even.add(positions);
                in_cubes.add(positions);
            };
            done = read(size(usual), &visit);
            if done.is_none() {
                return Ok((self.cells(particles, from)?, None));
            }
            sample = Some(in_cubes.sample());
        } else {
            for_each_chunk(particles, |positions| even.add(positions));
        }
        check_cancelled(particles)?;
        let taken = even.taken();
        let draft = if taken.larger().is_none() { SpacingDraft::of(taken) } else { None };
        let Some(draft) = draft else {
            return Ok((self.cells_by_evidence(particles, from, evidence(particles))?, done));
        };
        if let (None, Some(known)) = (usual, draft.counted()) {
            let in_cubes = draft.in_cubes();
            done = read(size(known), &|positions| in_cubes.add(positions));
            sample = done.is_some().then(|| in_cubes.sample());
        }
        check_cancelled(particles)?;
        let suits = usual.is_none_or(|usual| draft.suits(usual));
        let evidence = match sample.filter(|sample| suits && !sample.positions.is_empty()) {
            Some(sample) => Some(draft.with_sample(sample)),
            None => draft.completed(particles),
        };
        Ok((self.cells_by_evidence(particles, from, evidence)?, done))
    }

    /// The cells for particles with a known spacing: the size of the cells, the origin if the
    /// origin must be far from 0, and the slab.
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
        // A slab that is thinner than a cell may contain no cell centre, so there is no slab unless
        // cells are smaller than its thickness, which is one spacing.
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
            warnings: Vec::new(),
        })
    }

    /// The origin to use for particles around `middle`, if `middle` is outside the middle half of
    /// the requested grid.
    fn origin_for(&self, middle: Option<DVec3>, size: f64) -> Option<[f64; 3]> {
        let middle = middle.filter(|_| self.origin.is_none())?;
        let reach = f64::from(CELL_LIMIT) / 2.0 * size;
        // Particles outside the walls are left out, so the middle between two opposite walls is
        // used instead of the middle of all particles.
        let middle = self.walls.map_or(middle, |[lo, hi]| {
            let walled = (lo + hi) / 2.0;
            DVec3::from(
                [0, 1, 2].map(|a| if walled[a].is_finite() { walled[a] } else { middle[a] }),
            )
        });
        // The origin moves by whole steps, and only along axes on which the middle is farther than
        // `reach` from 0.
        let step = self.walls.map_or(size, |_| ALIGNED_CELLS * size);
        let moved = middle
            .to_array()
            .map(|c| if c.abs() > reach { (c / step).round() * step } else { 0.0 });
        let origin = (self.origin_at_walls(size) + DVec3::from(moved)).to_array();
        (moved != [0.0; 3] && origin.iter().all(|c| c.is_finite())).then_some(origin)
    }

    /// The cells for a given spacing, with warnings if the neighbours at the scale of this spacing
    /// contradict it.
    fn cells_for_given(
        &self,
        particles: &dyn Particles,
        spacing: f64,
        source: SpacingSource,
        surveyed: Option<SampleSurvey>,
        known_evidence: Option<Evidence>,
    ) -> Result<Cells, Error> {
        let is_confirmed = surveyed.as_ref().is_some_and(|surveyed| {
            let SampleSurvey { place, neighbours } = surveyed;
            let coarse = place.step.is_some_and(|step| SpacingWarning::is_coarse(step, spacing));
            place.plane.is_none() && !coarse && !is_suspicious(neighbours, spacing)
        });
        // A spacing from a scene file must be checked, because the file may belong to other
        // particles.
        let is_scene = matches!(source, SpacingSource::Scene(_));
        let evidence = match known_evidence {
            None if !is_confirmed || is_scene => evidence(particles),
            known => known,
        };
        let place = evidence
            .as_ref()
            .map(|evidence| evidence.place)
            .or(surveyed.as_ref().map(|surveyed| surveyed.place));
        let (middle, plane) =
            (place.map(|place| place.middle), place.and_then(|place| place.plane));
        let mut cells = self.cells_of(spacing, source.clone(), middle, plane)?;
        if let Some(evidence) = &evidence {
            let at_scale =
                surveyed.as_ref().map_or(&evidence.neighbours, |surveyed| &surveyed.neighbours);
            cells.warnings = SpacingWarning::of_given(spacing, &source, at_scale, evidence);
        }
        Ok(cells)
    }

    /// The cells for particles whose spacing is estimated.
    fn cells_by_evidence(
        &self,
        particles: &dyn Particles,
        from: SpacingHints<'_>,
        evidence: Option<Evidence>,
    ) -> Result<Cells, Error> {
        let path = || from.path.map(Path::to_owned);
        check_cancelled(particles)?;
        if particles.is_empty() {
            return Err(Error::Frame {
                path: path(),
                fault: FrameError::NoParticles(Census::default()),
            });
        }
        let place = evidence.as_ref().map(|evidence| evidence.place);
        let middle = place.map(|place| place.middle);
        let estimate = evidence.as_ref().map_or(Err(NoEstimate::NotFinite), Evidence::estimate);
        if let CellSize::Length(size) = self.cell_size()
            && let Method::Indicator { kind, mean } = self.method
        {
            let grid = self.grid(size)?;
            let misfit = |estimate: &SpacingEstimate| {
                let spacing = Some(estimate.spacing);
                Surfacing::PLAIN.check_cell_size(kind, mean, spacing, &grid).err()
            };
            let is_fluid = evidence.as_ref().is_some_and(|evidence| {
                !evidence.neighbours.may_be_spray() && !evidence.neighbours.is_random()
            });
            let is_sure = |estimate: &&SpacingEstimate| is_fluid && !estimate.thin;
            if let Some(fault) = estimate.as_ref().ok().filter(is_sure).and_then(misfit) {
                return Err(Error::Frame { path: path(), fault: fault.into() });
            }
            // Particles of spray are farther apart than the spacing, so cells that look too fine
            // for an estimate from spray can be right.
            if !estimate.as_ref().is_ok_and(|estimate| misfit(estimate).is_none()) {
                let origin = self.origin_for(middle, size);
                return Ok(Cells {
                    size,
                    spacing: None,
                    origin,
                    slab: None,
                    walls: None,
                    sizes: None,
                    warnings: Vec::new(),
                });
            }
        }
        let estimate = estimate.map_err(|why| Error::NoSpacing {
            path: path(),
            particles: particles.len(),
            why,
            // Positions that are rounded to a coarse grid do not suggest a spacing.
            suggested: match why {
                NoEstimate::SinglePrecision { .. } => None,
                _ => evidence.as_ref().and_then(|evidence| evidence.neighbours.suggested()),
            },
        })?;
        let plane = place.and_then(|place| place.plane);
        let mut cells = self.cells_of(estimate.spacing, SpacingSource::Estimated, middle, plane)?;
        cells.warnings = evidence
            .map_or(Vec::new(), |evidence| SpacingWarning::of_estimate(&estimate, &evidence));
        Ok(cells)
    }

    /// Chooses how to sample particles. The attributes with the indices in `carried` go to the
    /// vertices.
    pub fn sampling(
        &self,
        particles: &dyn Particles,
        from: SpacingHints<'_>,
        carried: Vec<usize>,
        resources: Resources,
    ) -> Result<ChosenSampling, Error> {
        let cells = self.cells(particles, from)?;
        self.sampling_in(cells, particles, carried, resources)
    }

    /// Works like [`sampling`](Self::sampling), and counts the particles at the same time if
    /// possible.
    pub fn sampling_and_plan(
        &self,
        particles: &dyn Particles,
        from: SpacingHints<'_>,
        carried: Vec<usize>,
        resources: Resources,
    ) -> Result<ChosenSampling, Error> {
        // The count is returned with the grid on which it was made. Ignore a failure here, because
        // the same failure occurs again later and is reported there.
        let count = |cell_size: f64, visit: PositionVisitor<'_>| {
            let grid = self.grid(cell_size).ok()?;
            let domain = self.domain(&grid).ok()?;
            let room = CountingRoom::within(resources.budget.0);
            let plan =
                BinPlan::count_while(particles, &grid, domain.as_ref(), self.invalid, room, visit);
            Some((grid, plan.ok()?))
        };
        let can_count_early = self.periodic.is_none() && self.search != WallSearch::Walls;
        let (cells, counted) = if can_count_early {
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
        particles: &dyn Particles,
        carried: Vec<usize>,
        resources: Resources,
    ) -> Result<ChosenSampling, Error> {
        let grid = self.grid_of(&cells)?;
        let request = self.in_walls(cells.found()).in_slab(cells.slab);
        let sampling =
            request.sampling_on(grid, self.method, cells.lengths(), carried, resources)?;
        let sampling = sampling.sized(cells.sizes.as_ref(), particles)?;
        if self.origin.is_some() {
            return Ok(ChosenSampling { sampling, cells, moved: false, plan: None });
        }
        let sampling = on_sound_grid(particles, sampling);
        let moved = sampling.grid != grid;
        Ok(ChosenSampling { sampling, cells, moved, plan: None })
    }

    /// The grid of the chosen cells.
    pub fn grid_of(&self, cells: &Cells) -> Result<Grid, Error> {
        match cells.origin {
            Some(origin) => Ok(Grid::new(origin.into(), cells.size)?),
            None => self.in_walls(cells.found()).in_slab(cells.slab).grid(cells.size),
        }
    }

    /// The sampling on a known grid, for the spacing and the sizes of the particles.
    ///
    /// # Errors
    /// [`Error::Domain`] and [`Error::Periodic`] if the walls or the periodic box are invalid on
    /// this grid; [`Error::Frame`] for cells that are too fine to compute how far images must
    /// extend beyond the faces of a periodic box.
    pub fn sampling_on(
        &self,
        grid: Grid,
        method: Method,
        (spacing, sizes): (Option<f64>, Option<&Sizes>),
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
            // This check comes first, because the reach of the filters is only known for valid
            // cells.
            sampling.check_fit(surfacing)?;
            let coarsest = sizes.map(|sizes| sizes.coarsest);
            let reach = surfacing.reach(method, spacing, coarsest, &grid);
            sampling.periodic = Some(Periodic::new(&grid, *faces, reach)?);
        }
        Ok(sampling)
    }
}
