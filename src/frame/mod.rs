//! One frame, within its memory budget: particles to DIF, DIF to surface.

mod blocks;
mod counted;
mod error;
mod resources;
mod rival;
mod shortfall;
mod sink;

pub use counted::Counted;
pub use error::FrameError;
pub use resources::Resources;
pub use rival::KernelFrame;
pub use shortfall::Shortfall;

pub use crate::stage::detail::Detail;
pub use crate::stage::dual_mc::Normals;

use std::io::{self, Write};
use std::path::Path;

use rayon::prelude::*;

use crate::backend::{Stages, Surfaces, Work};
use crate::brick::{Bins, Block, BrickSide, DifField, InvalidParticles, SortedStore, SpilledBins};
use crate::estimate::{Drawing, Estimate, Plan};
use crate::grid::{CellBox, Domain, Grid};
use crate::io::mnf::{FrameFacts, write_frame};
use crate::laps::Laps;
use crate::mesh::BlockMesh;
use crate::mesh::spool::Spool;
use crate::particles::{AttributeInfo, Particles, velocity_attribute};
use crate::plateau::{self, Plateau, SampledDif, TooFine, step_cells};
use crate::recipe::Recipe;
use crate::simplify::{Reduction, Simplified};
use crate::stage::attribute::vertex_values;
use crate::stage::blur::Smoothing;
use crate::stage::dual_mc::Crossings;
use crate::stage::indicator::{Indicator, PageRule};
use crate::stitch::Stitched;
use crate::units::{Isovalue, MeanCount, MemoryBudget, Sigma};

use blocks::mesh_blocks;
use sink::FieldSink;

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
    /// The particles' spacing, where it is known: a packed frame keeps it.
    pub spacing: Option<f64>,
    /// What the frame may take.
    pub resources: Resources,
}

/// How a surface is drawn through a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Surfacing {
    /// The Gaussian's width; that of the frame's spacing where it is `None`.
    pub sigma: Option<Sigma>,
    /// The isovalue; a share of the frame's plateau where it is `None`.
    pub iso: Option<Isovalue>,
    /// Section 6.2, or not.
    pub detail: Detail,
    /// Normals on the vertices, or not.
    pub normals: Normals,
}

impl Surfacing {
    /// As smooth as the frame's spacing says, and nothing else.
    pub const PLAIN: Self = Self { sigma: None, iso: None, detail: Detail::Smoothed, normals: Normals::None };

    /// Refuses cells that are too fine for it, as far as the particles' spacing tells before there is a DIF.
    ///
    /// # Errors
    /// [`TooFine`].
    pub fn refuse_too_fine(
        &self,
        indicator: Indicator,
        spacing: Option<f64>,
        grid: &Grid,
    ) -> Result<(), TooFine> {
        let Some(known) = spacing else { return Ok(()) };
        let sigma = |cell_size| width(self.sigma, indicator, spacing, cell_size);
        plateau::refuse_too_fine_for(indicator, known, grid.cell_size(), sigma)
    }

    /// What drawing it through the DIF of particles so far apart takes.
    fn drawing(&self, indicator: Indicator, spacing: Option<f64>, grid: &Grid) -> Drawing {
        let sigma = width(self.sigma, indicator, spacing, grid.cell_size());
        let details = self.detail != Detail::Smoothed;
        Drawing { normals: self.normals, details, halo: plateau::halo(indicator, sigma, self.detail) }
    }
}

/// The Gaussian's width, asked for or not.
fn width(asked: Option<Sigma>, indicator: Indicator, spacing: Option<f64>, cell_size: f64) -> Sigma {
    let cells = |spacing: f64| indicator.spacings_smoothed() * spacing / cell_size;
    asked.unwrap_or_else(|| Sigma::at_least_a_cell(spacing.map(cells)))
}

/// The attributes on the mesh: velocity under the name that other programs read, others under their own.
#[must_use]
pub fn carried_infos(attributes: &[AttributeInfo], carried: &[usize]) -> Vec<AttributeInfo> {
    let taken = attributes.iter().any(|info| info.name == "velocity");
    let velocity = velocity_attribute(attributes).filter(|_| !taken);
    let name = |&index: &usize| {
        let info = attributes[index].clone();
        if velocity == Some(index) { AttributeInfo { name: "velocity".into(), ..info } } else { info }
    };
    carried.iter().map(name).collect()
}

/// The DIF of a frame, and what else its surface needs.
#[derive(Debug)]
pub struct Frame {
    facts: FrameFacts,
    dif: DifField,
    /// Kept only where attributes are carried.
    carried: Option<(Bins, Vec<AttributeInfo>)>,
    /// Bytes of the surface that may be in memory.
    surface_share: u64,
    resources: Resources,
    stages: Box<dyn Stages>,
}

/// A surface, and what was found on the way.
#[derive(Debug)]
pub struct Surface {
    /// Closed, oriented, a 2-manifold.
    pub mesh: Stitched,
    /// Given or measured.
    pub iso: Isovalue,
    /// The field's interior, measured whether or not the isovalue was given.
    pub plateau: Plateau,
    /// How far one step of the field moves a flat surface, in cells.
    pub step_cells: f64,
}

impl Frame {
    /// Computes the DIF of `particles`, which are read once or twice.
    ///
    /// # Errors
    /// [`FrameError`] for particles that cannot be placed, none at all, more than the budget or the disk can
    /// hold, and scratch files that fail.
    pub fn sample(
        particles: &(impl Particles + ?Sized),
        sampling: &Sampling,
        laps: &mut Laps,
    ) -> Result<Self, FrameError> {
        let counted = Counted::of(particles, sampling)?;
        laps.lap("count");
        Self::sample_counted(counted, sampling.resources.budget, laps)
    }

    /// The same for particles that have been counted, under a budget of its own.
    ///
    /// # Errors
    /// [`FrameError`] for more than the disk can hold, and scratch files that fail.
    pub fn sample_counted<P: Particles + ?Sized>(
        counted: Counted<'_, P>,
        budget: MemoryBudget,
        laps: &mut Laps,
    ) -> Result<Self, FrameError> {
        let estimate = counted.estimate();
        let Counted { particles, sampling, plan: bin_plan, .. } = counted;
        let sampling =
            &Sampling { resources: Resources { budget, ..sampling.resources.clone() }, ..sampling.clone() };
        let Sampling { grid, domain, indicator, side, carried, resources, .. } = sampling;
        let census = bin_plan.census();
        let plan = estimate.plan(resources.budget);
        resources.check_room(estimate.least_scratch(plan))?;
        let in_scratch = resources.scratch_error();
        let shape = indicator.shape(*side);
        let mut sink = FieldSink::new(plan, &estimate, shape, &resources.scratch).map_err(&in_scratch)?;

        let stages = resources.backend.start(resources.budget);
        let binned = match plan {
            Plan::InCore => Binned::InMemory(bin_plan.fill(particles, carried)),
            Plan::OutOfCore(shares) => {
                let runs = bin_plan.runs(particles, carried, shares.particles);
                // The field is not there yet, so its share is free for buffers.
                let buffer_bytes = shares.field as usize;
                let spilled = bin_plan.spill(particles, carried, runs, &resources.scratch, buffer_bytes);
                Binned::Spilled(spilled.map_err(&in_scratch)?)
            }
        };
        laps.lap("bin");
        let measured = |indicator: Indicator, full_cells: u64| {
            indicator.measured(census.binned, full_cells).map_err(FrameError::MeanCount)
        };
        let mut indicator = *indicator;
        if indicator.waits_for_mean() {
            indicator = measured(indicator, binned.full_cells().map_err(&in_scratch)?)?;
        }
        let rule = PageRule { indicator, side: *side, walls: domain.as_ref().map(Domain::cells) };
        let take = |bins: &Bins| sink.take(&*stages, bins, &rule);
        let carried_bins =
            binned.visit(take, !carried.is_empty(), &resources.scratch).map_err(&in_scratch)?;
        let carried = carried_bins.map(|bins| (bins, carried_infos(particles.attributes(), carried)));

        let indicator = measured(indicator, sink.full_cells())?;
        let facts = FrameFacts { grid: *grid, domain: *domain, indicator, census, spacing: sampling.spacing };
        let dif = sink.finish(&facts, shape, plan).map_err(&in_scratch)?;
        laps.lap("indicate");
        let surface_share = estimate.surface_share(resources.budget);
        Ok(Self { facts, dif, carried, surface_share, resources: resources.clone(), stages })
    }

    /// Joins a DIF that was read from a frame file to what the file says of it, for surfaces that take as much as such a one.
    #[must_use]
    pub fn from_parts(facts: FrameFacts, dif: DifField, surfacing: &Surfacing, resources: Resources) -> Self {
        let drawing = surfacing.drawing(facts.indicator, facts.spacing, &facts.grid);
        let estimate = Estimate::of_surface(dif.infos(), dif.shape(), drawing, resources.host_bytes());
        let surface_share = estimate.surface_share(resources.budget);
        let stages = resources.backend.start(resources.budget);
        Self { facts, dif, carried: None, surface_share, resources, stages }
    }

    /// Writes the frame as a .mnf file.
    ///
    /// # Errors
    /// Those of `out`.
    pub fn pack(&self, out: &mut dyn Write) -> io::Result<()> {
        write_frame(out, &self.facts, &self.dif).map(drop)
    }

    /// Bytes of its surface that may be in memory.
    #[must_use]
    pub fn surface_share(&self) -> u64 {
        self.surface_share
    }

    /// The memory, folders and backend that the frame may use.
    #[must_use]
    pub fn resources(&self) -> &Resources {
        &self.resources
    }

    /// What the stages run on.
    #[must_use]
    pub fn backend(&self) -> String {
        self.resources.backend.name()
    }

    /// What went wrong with the backend so far, and was made good.
    #[must_use]
    pub fn warnings(&self) -> Vec<String> {
        self.stages.warnings()
    }

    /// How much of the work so far a device did.
    #[must_use]
    pub fn on_device(&self) -> Work {
        self.stages.on_device()
    }

    /// What the frame was made with.
    #[must_use]
    pub fn facts(&self) -> &FrameFacts {
        &self.facts
    }

    /// The sparse DIF.
    #[must_use]
    pub fn dif(&self) -> &DifField {
        &self.dif
    }

    /// `mu0`, where the indicator counts.
    #[must_use]
    pub fn mean_count(&self) -> Option<MeanCount> {
        self.facts.indicator.mean()
    }

    /// The Gaussian's width, asked for or not.
    #[must_use]
    pub fn sigma(&self, asked: Option<Sigma>) -> Sigma {
        let FrameFacts { grid, spacing, indicator, .. } = &self.facts;
        width(asked, *indicator, *spacing, grid.cell_size())
    }

    /// From the DIF to the surface: the smoothing's kernels, and the isovalue, measured where it is not given.
    ///
    /// # Errors
    /// [`TooFine`] where the field does not tell finely enough where the surface is.
    pub fn recipe(&self, surfacing: &Surfacing) -> Result<(Recipe, Plateau), TooFine> {
        let &Surfacing { iso, detail, .. } = surfacing;
        let FrameFacts { indicator, domain, grid, spacing, .. } = &self.facts;
        let sampled = SampledDif {
            dif: &self.dif,
            indicator: *indicator,
            domain: domain.as_ref(),
            spacing: spacing.map(|spacing| spacing / grid.cell_size()),
        };
        plateau::recipe(&sampled, grid, self.sigma(surfacing.sigma), detail, iso)
    }

    /// The final field on `cells`.
    #[must_use]
    pub fn field(&self, recipe: &Recipe, cells: CellBox) -> Block {
        let domain = self.facts.domain.as_ref();
        recipe.field(recipe.gather(&self.dif, cells, domain), domain)
    }

    /// The surface of the frame.
    ///
    /// # Errors
    /// [`FrameError::TooFine`], [`FrameError::NoSurface`], and [`FrameError::Scratch`] where scratch files fail.
    pub fn surface(&self, surfacing: &Surfacing, laps: &mut Laps) -> Result<Surface, FrameError> {
        let (recipe, plateau) = self.recipe(surfacing)?;
        laps.lap("plateau");
        let mesh = self.surface_by(&recipe, surfacing.normals, laps)?;
        let step_cells = step_cells(f64::from(plateau.value()), recipe.smoothing.width(self.facts.indicator));
        Ok(Surface { mesh, iso: recipe.iso, plateau, step_cells })
    }

    /// The surface by a recipe that is known, with nothing measured.
    ///
    /// # Errors
    /// [`FrameError::NoSurface`], and [`FrameError::Scratch`] where scratch files fail.
    pub fn surface_by(
        &self,
        recipe: &Recipe,
        normals: Normals,
        laps: &mut Laps,
    ) -> Result<Stitched, FrameError> {
        let iso = recipe.iso;
        let attributes = self.carried.as_ref().map_or(Vec::new(), |(_, infos)| infos.clone());
        let components = attributes.iter().map(|info| info.components).collect();
        let mut spool = Spool::in_memory(normals == Normals::Gradient, components);
        self.mesh_blocks(recipe, normals, &mut spool).map_err(self.resources.scratch_error())?;
        laps.lap("mesh");
        if spool.is_empty() {
            return Err(FrameError::NoSurface { iso });
        }
        Ok(Stitched::new(spool, self.facts.grid, self.facts.domain, iso, attributes))
    }

    /// The surface with what a reduction leaves of it.
    ///
    /// # Errors
    /// [`FrameError::NothingLeft`], and [`FrameError::Scratch`] where scratch files fail.
    pub fn simplify(
        &self,
        surface: Stitched,
        reduction: &Reduction,
        laps: &mut Laps,
    ) -> Result<Simplified, FrameError> {
        self.resources.simplify(surface, reduction, self.surface_share, laps)
    }

    /// Meshes all blocks in Morton order into `spool`.
    fn mesh_blocks(&self, recipe: &Recipe, normals: Normals, spool: &mut Spool) -> io::Result<()> {
        let domain = self.facts.domain.as_ref();
        let surfaces = Surfaces { dif: &self.dif, recipe, domain, normals };
        mesh_blocks(spool, &surfaces.regions(), self.surface_share, &self.resources.scratch, |regions| {
            let mut blocks: Vec<BlockMesh> =
                self.stages.contour(&surfaces, regions).into_iter().flatten().collect();
            blocks.par_iter_mut().try_for_each(|block| self.carry(recipe, block))?;
            Ok(blocks)
        })
    }

    /// Carries the particles' attributes to the vertices.
    fn carry(&self, recipe: &Recipe, mesh: &mut BlockMesh) -> io::Result<()> {
        let Some((bins, infos)) = &self.carried else { return Ok(()) };
        let walls = self.facts.domain.as_ref().map(Domain::cells);
        carry(bins, infos, &recipe.smoothing, recipe.iso.into(), walls, mesh)
    }
}

/// Carries the attributes of binned particles to the vertices.
fn carry(
    bins: &Bins,
    infos: &[AttributeInfo],
    smoothing: &Smoothing,
    crossings: Crossings,
    walls: Option<CellBox>,
    mesh: &mut BlockMesh,
) -> io::Result<()> {
    for attribute in infos.iter().map(|info| info.components).enumerate() {
        let values = vertex_values(bins, attribute, smoothing, mesh, crossings, walls)?;
        mesh.attributes.push(values);
    }
    Ok(())
}

/// Particles in order of their bins.
enum Binned {
    InMemory(Bins),
    /// Run by run in a scratch file.
    Spilled(SpilledBins),
}

impl Binned {
    /// About how many cells hold particles, as some bins tell.
    fn full_cells(&self) -> io::Result<u64> {
        let of_bins = |bins: &Bins, sampled: &[(usize, f64)], first: usize| {
            let full_cells = |&(bin, weight): &(usize, f64)| {
                Ok::<_, io::Error>(weight * bins.full_cells(bin - first)? as f64)
            };
            sampled.par_iter().map(full_cells).collect::<io::Result<Vec<f64>>>()
        };
        let full_cells: Vec<f64> = match self {
            Self::InMemory(bins) => of_bins(bins, &bins.sampled(), 0)?,
            Self::Spilled(spilled) => {
                let sampled = spilled.sampled();
                let (mut full_cells, mut rest) = (Vec::new(), &sampled[..]);
                for (run, bins) in spilled.runs().iter().enumerate() {
                    let (of_run, later) = rest.split_at(rest.partition_point(|&(bin, _)| bin < bins.end));
                    rest = later;
                    if !of_run.is_empty() {
                        full_cells.extend(of_bins(&spilled.load(run)?, of_run, bins.start)?);
                    }
                }
                full_cells
            }
        };
        Ok(full_cells.iter().sum::<f64>().round() as u64)
    }

    /// Shows all bins to `take`, and returns them if they are to be kept: what was in a scratch file, in one of its own.
    fn visit(
        self,
        mut take: impl FnMut(&Bins) -> io::Result<()>,
        keep: bool,
        scratch: &Path,
    ) -> io::Result<Option<Bins>> {
        let spilled = match self {
            Self::InMemory(bins) => {
                take(&bins)?;
                return Ok(keep.then_some(bins));
            }
            Self::Spilled(spilled) => spilled,
        };
        let mut sorted = keep.then(|| spilled.sorted_store(scratch)).transpose()?;
        for run in 0..spilled.runs().len() {
            let bins = spilled.load(run)?;
            take(&bins)?;
            if let Some(sorted) = &mut sorted {
                sorted.push(&bins)?;
            }
        }
        Ok(sorted.map(SortedStore::finish))
    }
}
