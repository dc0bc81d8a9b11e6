//! One frame, in core: particles to DIF, DIF to surface.

use std::time::Instant;

use rayon::prelude::*;
use thiserror::Error;

use crate::brick::{BinError, BinPlan, Bins, Block, BrickSide, Census, DifField, InvalidParticles};
use crate::estimate::{Estimate, OverBudget};
use crate::grid::{CellBox, Domain, Grid};
use crate::mesh::{BlockMesh, Mesh};
use crate::particles::{AttributeInfo, Particles, velocity_attribute};
use crate::plateau::Plateau;
use crate::recipe::Recipe;
use crate::stage::attribute::{FixedPoint, vertex_values};
use crate::stage::blur::{Kernel, Smoothing};
use crate::stage::dual_mc::{contour, normals};
use crate::stage::indicator::{Indicator, build_field};
use crate::stitch::{TooManyVertices, stitch};
use crate::units::{Isovalue, MeanCount, MemoryBudget, Sigma, UnitError};

/// A frame that cannot be reconstructed.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum FrameError {
    /// There is nothing to build a surface from.
    #[error("no particles to reconstruct: {}", explain(.0))]
    NoParticles(Census),
    /// A particle that the grid cannot hold.
    #[error(transparent)]
    Bin(#[from] BinError),
    /// It would not fit in memory.
    #[error(transparent)]
    OverBudget(#[from] OverBudget),
    /// mu0 could not be measured.
    #[error("cannot measure mu0 on this frame: {0}")]
    MeanCount(#[source] UnitError),
    /// The field exceeds the isovalue nowhere.
    #[error("the surface is empty: the field is nowhere above the isovalue {:.4}; use a lower --iso, a smaller --sigma, or --detail", iso.value())]
    NoSurface {
        /// What was asked for, or measured.
        iso: Isovalue,
    },
    /// Too large for one indexed mesh.
    #[error(transparent)]
    TooManyVertices(#[from] TooManyVertices),
}

fn explain(census: &Census) -> String {
    match *census {
        Census { not_finite: 0, too_far: 0, outside: 0, .. } => "there are none".into(),
        Census { not_finite, too_far, outside, .. } => {
            format!("{not_finite} not finite, {too_far} beyond the grid, {outside} outside of the domain")
        }
    }
}

/// How a frame is sampled.
#[derive(Debug, Clone)]
pub struct Sampling {
    /// Cells.
    pub grid: Grid,
    /// Walls, if the fluid is in a tank.
    pub domain: Option<Domain>,
    /// The DIF.
    pub indicator: Indicator,
    /// What to do with particles that are not finite or too far away.
    pub invalid: InvalidParticles,
    /// How the DIF is stored.
    pub side: BrickSide,
    /// The numbers of the attributes to carry to the vertices.
    pub carried: Vec<usize>,
    /// What the frame may take.
    pub budget: MemoryBudget,
}

/// How a surface is drawn through a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Surfacing {
    /// The Gaussian's width.
    pub sigma: Sigma,
    /// The isovalue; half of the frame's plateau where it is `None`.
    pub iso: Option<Isovalue>,
    /// Section 6.2, or not.
    pub detail: Detail,
    /// Normals on the vertices, or not.
    pub normals: Normals,
}

/// Whether details that smoothing loses are recovered (section 6.2).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Detail {
    Smoothed,
    Recovered,
}

/// Whether vertices get normals.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Normals {
    None,
    Gradient,
}

/// Seconds since the last lap, by name, in order.
#[derive(Debug, Clone)]
pub struct Laps {
    last: Instant,
    seconds: Vec<(&'static str, f64)>,
}

impl Default for Laps {
    fn default() -> Self {
        Self { last: Instant::now(), seconds: Vec::new() }
    }
}

impl Laps {
    /// Ends a lap.
    pub fn lap(&mut self, stage: &'static str) {
        let now = Instant::now();
        self.seconds.push((stage, (now - self.last).as_secs_f64()));
        self.last = now;
    }

    /// All laps so far.
    #[must_use]
    pub fn seconds(&self) -> &[(&'static str, f64)] {
        &self.seconds
    }
}

/// The attributes on the mesh: velocity under the name that other programs read, others under their own.
fn carried_infos(attributes: &[AttributeInfo], carried: &[usize]) -> Vec<AttributeInfo> {
    let velocity = velocity_attribute(attributes);
    let name = |&index: &usize| {
        let info = attributes[index].clone();
        if velocity == Some(index) { AttributeInfo { name: "velocity".into(), ..info } } else { info }
    };
    carried.iter().map(name).collect()
}

/// What reconstructing `particles` would take, without doing it.
///
/// # Errors
/// [`FrameError`] for particles that cannot be placed, none at all, or more than the budget can hold.
pub fn estimate(
    particles: &(impl Particles + ?Sized),
    sampling: &Sampling,
) -> Result<(Census, Estimate), FrameError> {
    let (plan, estimate) = plan(particles, sampling)?;
    Ok((plan.census(), estimate))
}

/// Counts the particles, and refuses what cannot be done with them.
fn plan<'a>(
    particles: &(impl Particles + ?Sized),
    sampling: &'a Sampling,
) -> Result<(BinPlan<'a>, Estimate), FrameError> {
    let Sampling { grid, domain, .. } = sampling;
    let plan = BinPlan::count(particles, grid, domain.as_ref(), sampling.invalid)?;
    if plan.census().binned == 0 {
        return Err(FrameError::NoParticles(plan.census()));
    }
    let attributes = particles.attributes();
    let components = sampling.carried.iter().map(|&index| attributes[index].components).sum();
    let estimate = Estimate::of(plan.counts(), sampling.side, components);
    estimate.check(sampling.budget, plan.counts(), grid)?;
    Ok((plan, estimate))
}

/// The DIF of a frame, and what else its surface needs.
#[derive(Debug)]
pub struct Frame {
    grid: Grid,
    domain: Option<Domain>,
    indicator: Indicator,
    dif: DifField,
    census: Census,
    /// Kept only where attributes are carried.
    carried: Option<(Bins, Vec<(AttributeInfo, FixedPoint)>)>,
}

/// A surface, and what was found on the way.
#[derive(Debug)]
pub struct Surface {
    /// Closed, oriented, a 2-manifold.
    pub mesh: Mesh,
    /// Given or measured.
    pub iso: Isovalue,
    /// The field's interior, measured whether or not the isovalue was given.
    pub plateau: Plateau,
}

impl Frame {
    /// Computes the DIF of `particles`, which are read twice.
    ///
    /// # Errors
    /// [`FrameError`] for particles that cannot be placed, none at all, or more than the budget can hold.
    pub fn sample(
        particles: &(impl Particles + ?Sized),
        sampling: &Sampling,
        laps: &mut Laps,
    ) -> Result<Self, FrameError> {
        let Sampling { grid, domain, .. } = sampling;
        let (plan, _) = plan(particles, sampling)?;
        let census = plan.census();
        let bins = plan.fill(particles, &sampling.carried);
        laps.lap("bin");

        let (dif, mean) =
            build_field(&bins, sampling.indicator, sampling.side).map_err(FrameError::MeanCount)?;
        let indicator = match sampling.indicator {
            Indicator::Symmetry => Indicator::Symmetry,
            Indicator::Counting { .. } => Indicator::Counting { mean },
        };
        let infos = carried_infos(particles.attributes(), &sampling.carried);
        let carried = (!infos.is_empty()).then(|| {
            let fixed = (0..infos.len()).map(|i| FixedPoint::of(&bins, i)).collect::<Vec<_>>();
            (bins, infos.into_iter().zip(fixed).collect())
        });
        laps.lap("indicate");
        Ok(Self { grid: *grid, domain: *domain, indicator, dif, census, carried })
    }

    /// The sparse DIF.
    #[must_use]
    pub fn dif(&self) -> &DifField {
        &self.dif
    }

    /// What became of the particles.
    #[must_use]
    pub fn census(&self) -> Census {
        self.census
    }

    /// `mu0`, where the indicator counts.
    #[must_use]
    pub fn mean_count(&self) -> Option<MeanCount> {
        match self.indicator {
            Indicator::Symmetry => None,
            Indicator::Counting { mean } => mean,
        }
    }

    /// From the DIF to the surface: the smoothing's kernels, and the isovalue, measured where it is not given.
    #[must_use]
    pub fn recipe(&self, surfacing: &Surfacing) -> (Recipe, Plateau) {
        let smoothing = Smoothing::new(self.indicator, surfacing.sigma);
        let plateau = Plateau::of(&self.dif, &smoothing, self.domain.as_ref());
        let iso = surfacing.iso.unwrap_or(plateau.isovalue());
        let detail = match surfacing.detail {
            Detail::Smoothed => None,
            Detail::Recovered => Some(Kernel::gaussian(surfacing.sigma.half())),
        };
        (Recipe { smoothing, detail, iso }, plateau)
    }

    /// The final field on `cells`.
    #[must_use]
    pub fn field(&self, recipe: &Recipe, cells: CellBox) -> Block {
        let domain = self.domain.as_ref();
        recipe.field(&recipe.gather(&self.dif, cells, domain), domain)
    }

    /// The surface of the frame.
    ///
    /// # Errors
    /// [`FrameError::NoSurface`] and [`FrameError::TooManyVertices`].
    pub fn surface(&self, surfacing: &Surfacing, laps: &mut Laps) -> Result<Surface, FrameError> {
        let (recipe, plateau) = self.recipe(surfacing);
        let iso = recipe.iso;
        laps.lap("plateau");
        let blocks: Vec<BlockMesh> = self
            .regions(&recipe)
            .into_par_iter()
            .filter_map(|region| self.block_mesh(&recipe, region, surfacing.normals))
            .collect();
        laps.lap("mesh");

        let carried = self.carried.as_ref().map_or(&[][..], |(_, carried)| carried);
        let attributes: Vec<_> = carried.iter().map(|(info, _)| info.clone()).collect();
        let mesh = stitch(&blocks, &self.grid, self.domain.as_ref(), iso, &attributes)?;
        laps.lap("stitch");
        if mesh.triangles.is_empty() {
            return Err(FrameError::NoSurface { iso });
        }
        Ok(Surface { mesh, iso, plateau })
    }

    /// The parts of blocks in which dual cells can be mixed, in Morton order.
    fn regions(&self, recipe: &Recipe) -> Vec<CellBox> {
        // A dual cell reaches one cell up from its lowest corner.
        let regions = self.dif.regions(recipe.reach() + 1, recipe.reach());
        let within = self.domain.map(|domain| domain.cells().grown(1, 0));
        regions
            .into_iter()
            .map(|(_, cells)| within.map_or(cells, |within| cells.intersection(&within)))
            .filter(|cells| !cells.is_empty())
            .collect()
    }

    /// The surface through one region of a block; `None` where there is none.
    fn block_mesh(&self, recipe: &Recipe, region: CellBox, with_normals: Normals) -> Option<BlockMesh> {
        let domain = self.domain.as_ref();
        let walls = domain.map(Domain::cells);
        let dual = region.tiled().grown(0, 1);
        let cells = match with_normals {
            Normals::None => dual,
            Normals::Gradient => dual.grown(1, 1),
        };
        let dif = recipe.gather(&self.dif, cells, domain);
        let inside_walls = walls.is_none_or(|walls| walls.covers(&dual));
        if !recipe.iso.may_cut(dif.samples(), inside_walls) {
            return None;
        }
        let field = recipe.field(&dif, domain);
        let mut mesh = contour(&field, region, recipe.iso, walls);
        if mesh.tiles.is_empty() {
            return None;
        }
        if with_normals == Normals::Gradient {
            mesh.normals = normals(&field, &mesh, recipe.iso, walls);
        }
        if let Some((bins, infos)) = &self.carried {
            mesh.attributes = infos
                .iter()
                .enumerate()
                .map(|(i, (info, fixed))| {
                    let attribute = (i, info.components, *fixed);
                    vertex_values(bins, attribute, &recipe.smoothing, &mesh, recipe.iso, walls)
                })
                .collect();
        }
        Some(mesh)
    }
}
