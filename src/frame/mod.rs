//! One frame within its memory budget: from particles to a field, and from the field to a surface.
//!
//! [`Engine`] does this for every method and backend: it counts, bins, samples, calibrates and
//! meshes. [`resident`] takes the same steps for particles and meshes that stay on a device.
//!
//! The guide `speed.md` gives measurements of speed and memory.

mod binned;
mod coincident;
mod counted;
mod error;
pub mod estimate;
mod expected;
mod kernels;
mod lost;
mod method;
mod request;
pub mod resident;
mod resources;
mod shortfall;
mod sink;
mod sizes;
mod surface;

pub use coincident::CoincidentParticles;
pub use counted::CountedFrame;
pub use error::FrameError;
pub(crate) use error::no_centre;
pub use lost::{OccupiedBin, OccupiedTiles};
pub use method::Method;
pub use request::{Sampling, SizedParticles, Surfacing};
pub use resources::Resources;
pub use shortfall::Shortfall;
pub use surface::CalibratedFrame;

pub use crate::field::recipe::Detail;
pub use crate::surface::dual_mc::Normals;

use std::sync::Arc;

use crate::backend::{Stages, Work};
use crate::brick::{BinnedParticles, Bins, FrameFacts};
use crate::field::calibration::{Calibration, indicate};
use crate::field::indicator::{Indicator, SampledDif};
use crate::field::sizes::FinerBlocks;
use crate::field::spacing::spacing_by_clouds;
use crate::frame::estimate::MemoryEstimate;
use crate::grid::stretch::Stretch;
use crate::grid::units::MemoryBudget;
use crate::io::mnf::{PackableFrame, PackedFrame};
use crate::particles::kind::settled;
use crate::particles::{AttributeInfo, Particles};
use crate::surface::mesh::source::MeshSource;
use crate::surface::simplify::{Reduction, SimplifiedSurface, TriangleSpace, simplify};
use crate::surface::stitch::StitchedSurface;
use crate::system::control::{Control, Stage};
use crate::system::timings::Timings;

use binned::HostBins;
use kernels::{SampledKernels, kernel_spacing};
use sink::FieldSink;
use sizes::SampledSizes;
use surface::ExtractableField;

/// The field of a frame, with everything else that is needed to extract the surface.
#[derive(Debug)]
pub struct Engine {
    field: SampledField,
    /// The tiles that contain particles; empty for a frame that was sampled earlier, such as a
    /// packed frame.
    occupied: OccupiedTiles,
    /// The sorted particles, and the attributes that are carried to the vertices; `None` if there
    /// are no such attributes.
    carried: Option<(Arc<Bins>, Vec<AttributeInfo>)>,
    /// Maximum bytes of the surface in memory.
    surface_share: u64,
    resources: Resources,
}

/// A field with the data of its method.
#[derive(Debug)]
enum SampledField {
    Dif { sampled: SampledDif, stages: Box<dyn Stages> },
    Kernels(SampledKernels),
    Sizes(SampledSizes),
}

/// The fraction of the sampling stage that progress reports assign to sorting the particles.
const SORTING: f64 = 0.3;

impl Engine {
    /// Samples the field of `particles`, which are read once or twice.
    ///
    /// # Errors
    /// [`FrameError`] if particles cannot be placed, if there are none, if they do not fit into the
    /// budget or on the disk, if their field cannot be computed, or if scratch files fail.
    pub fn sample(
        particles: &dyn Particles,
        sampling: &Sampling,
        timings: &mut Timings,
    ) -> Result<Self, FrameError> {
        let counted = CountedFrame::of(particles, sampling)?;
        timings.done("count");
        Self::sample_counted(counted, sampling.resources.budget, timings)
    }

    /// Samples the field of counted particles under a new budget.
    ///
    /// # Errors
    /// [`FrameError`] if the particles do not fit on the disk, if their field cannot be computed,
    /// or if scratch files fail.
    pub fn sample_counted(
        counted: CountedFrame<'_>,
        budget: MemoryBudget,
        timings: &mut Timings,
    ) -> Result<Self, FrameError> {
        let (estimate, census) = (counted.estimate(), counted.census());
        let CountedFrame { mut particles, sampling, plan: bin_plan, .. } = counted;
        let Sampling {
            grid,
            domain,
            periodic,
            method,
            side,
            carried,
            kinds,
            spacing,
            sizes,
            resources,
            ..
        } = sampling;
        let sorted_attributes = sampling.sorted_attributes();
        let resources = Resources { budget, ..resources.clone() };
        let control = &sampling.resources.control;
        let in_scratch = resources.scratch_error();
        let plan = estimate.plan(budget);
        let facts = FrameFacts {
            grid: *grid,
            domain: *domain,
            periodic: *periodic,
            census,
            spacing: *spacing,
        };
        if let Method::Kernels(_) = method {
            kernel_spacing(*spacing, grid)?;
        }
        resources.check_room(estimate.least_scratch(plan))?;

        let keep = !carried.is_empty();
        let sample = || {
            let meter = control.meter(Stage::Sampling, bin_plan.keys().len()).between(SORTING, 1.0);
            particles.begin(Stage::Sampling, SORTING);
            let binned =
                binned::sorted(bin_plan, &particles, &sorted_attributes, plan, &resources)?;
            resources.go_on()?;
            particles.check()?;
            let mut occupied = OccupiedTiles::among(facts.own_cells());
            let kept = |binned: BinnedParticles, occupied: &mut OccupiedTiles| {
                let bins = binned
                    .visit_and_keep(&resources.scratch, |bins| occupied.add(bins).map(|()| 0));
                bins.and_then(Bins::sorted).map_err(&in_scratch)
            };
            Ok::<_, FrameError>(match (*method, sizes) {
                (Method::Indicator { .. }, Some(sized)) => {
                    let bins = kept(binned, &mut occupied)?;
                    timings.done("bin");
                    let sampled =
                        SampledSizes::sample(&bins, facts, sized, plan, &estimate, &resources)?;
                    timings.done("indicate");
                    (SampledField::Sizes(sampled), occupied, keep.then(|| Arc::new(bins)))
                }
                (Method::Indicator { kind, mean }, None) => {
                    timings.done("bin");
                    let stages = resources.backend.executor().start(budget);
                    let shape = kind.shape(*side);
                    let sink = FieldSink::new(plan, &estimate, shape, &resources.scratch)
                        .map_err(&in_scratch)?;
                    let (stages_of, resources) = (&*stages, &resources);
                    let binned = HostBins {
                        binned,
                        stages: stages_of,
                        sink,
                        occupied,
                        resources,
                        keep,
                        meter,
                    };
                    let made = indicate(binned, &facts, kind, mean, *side)?;
                    let (indicator, (sink, occupied, bins)) = made;
                    let sampled = sink.finish(facts, indicator, shape).map_err(&in_scratch)?;
                    timings.done("indicate");
                    (SampledField::Dif { sampled, stages }, occupied, bins)
                }
                (Method::Kernels(kernels), _) => {
                    let bins = kept(binned, &mut occupied)?;
                    timings.done("bin");
                    let sampled = SampledKernels::sample(&bins, facts, kernels, plan, &resources)?;
                    timings.done("kernels");
                    (SampledField::Kernels(sampled), occupied, keep.then(|| Arc::new(bins)))
                }
            })
        };
        let (field, occupied, bins) = control.during(Stage::Sampling, sample)?;
        let infos = settled(&particles, carried, kinds)?;
        drop(in_scratch);
        Ok(Self {
            field,
            occupied,
            carried: bins.map(|bins| (bins, infos)),
            surface_share: estimate.surface_share(budget),
            resources,
        })
    }

    /// Creates an engine for a frame that was sampled earlier. Its memory is planned for the
    /// parameters in `surfacing`.
    #[must_use]
    pub fn from_packed(packed: PackedFrame, surfacing: &Surfacing, resources: Resources) -> Self {
        let estimate = MemoryEstimate::of_packed(packed.samples(), surfacing);
        let estimate = estimate.and_backend(resources.host_bytes());
        let surface_share = estimate.surface_share(resources.budget);
        let field = match packed {
            PackedFrame::Dif(sampled) => {
                let stages = resources.backend.executor().start(resources.budget);
                SampledField::Dif { sampled, stages }
            }
            PackedFrame::Octaves(sampled) => SampledField::Sizes(SampledSizes::new(sampled, None)),
        };
        Self { field, occupied: OccupiedTiles::default(), carried: None, surface_share, resources }
    }

    /// Returns the name of the backend that the stages run on.
    #[must_use]
    pub fn backend(&self) -> String {
        match self.field {
            SampledField::Dif { .. } => self.resources.backend.name(),
            SampledField::Kernels(_) | SampledField::Sizes(_) => "CPU".into(),
        }
    }

    /// The stages that compute and mesh the DIF; `None` for kernels and for particles of several
    /// sizes.
    fn stages(&self) -> Option<&dyn Stages> {
        match &self.field {
            SampledField::Dif { stages, .. } => Some(&**stages),
            SampledField::Kernels(_) | SampledField::Sizes(_) => None,
        }
    }

    /// Returns the failures of the device so far. The CPU repeated the work that failed.
    #[must_use]
    pub fn warnings(&self) -> Vec<String> {
        self.stages().map_or(Vec::new(), Stages::warnings)
    }

    /// Returns how much of the work a device did.
    #[must_use]
    pub fn on_device(&self) -> Work {
        self.stages().map_or(Work::default(), Stages::on_device)
    }

    /// The attributes for which some particles have no finite value, with the number of these
    /// particles. Values that are not finite do not affect the vertices.
    pub fn lacking_attributes(&self) -> impl Iterator<Item = (&str, usize)> {
        let carried =
            self.carried.iter().flat_map(|(bins, infos)| infos.iter().zip(bins.without()));
        carried
            .filter(|&(info, &without)| without > 0 && !info.kind.is_whole())
            .map(|(info, &without)| (info.name.as_str(), without))
    }

    /// The facts of the frame, for any method.
    #[must_use]
    pub fn facts(&self) -> &FrameFacts {
        match &self.field {
            SampledField::Dif { sampled, .. } => &sampled.facts,
            SampledField::Kernels(sampled) => &sampled.facts,
            SampledField::Sizes(sampled) => &sampled.sampled.facts,
        }
    }

    /// The sparse DIF; `None` for kernels and for particles of several sizes.
    #[must_use]
    pub fn dif(&self) -> Option<&SampledDif> {
        match &self.field {
            SampledField::Dif { sampled, .. } => Some(sampled),
            SampledField::Kernels(_) | SampledField::Sizes(_) => None,
        }
    }

    /// The samples for a packed frame; `None` for kernels.
    #[must_use]
    pub fn packable(&self) -> Option<PackableFrame<'_>> {
        match &self.field {
            SampledField::Dif { sampled, .. } => Some(PackableFrame::Dif(sampled)),
            SampledField::Sizes(sampled) => Some(PackableFrame::Octaves(&sampled.sampled)),
            SampledField::Kernels(_) => None,
        }
    }

    /// The indicator of the field; `None` for kernels.
    #[must_use]
    pub fn indicator(&self) -> Option<Indicator> {
        match &self.field {
            SampledField::Dif { sampled, .. } => Some(sampled.indicator),
            SampledField::Sizes(_) => Some(Indicator::Cloud),
            SampledField::Kernels(_) => None,
        }
    }

    /// Whether the particles have several sizes.
    fn has_sizes(&self) -> bool {
        matches!(self.field, SampledField::Sizes(_))
    }

    /// For each level from 1 up, the blocks near particles of the next finer octave. They determine
    /// the width of cells if particles have several sizes.
    #[must_use]
    pub fn finer_blocks(&self) -> Option<&FinerBlocks> {
        match &self.field {
            SampledField::Sizes(sampled) => Some(sampled.finer_blocks()),
            SampledField::Dif { .. } | SampledField::Kernels(_) => None,
        }
    }

    /// The method that computed the field. For counting, it includes mu0, given or measured.
    #[must_use]
    pub fn method(&self) -> Method {
        match &self.field {
            SampledField::Dif { sampled, .. } => sampled.indicator.into(),
            SampledField::Kernels(sampled) => sampled.method.into(),
            SampledField::Sizes(_) => Indicator::Cloud.into(),
        }
    }

    /// Prepares a surface with the calibration of another frame, or measures the calibration on
    /// this frame if `known` is `None`. Kernels need no calibration.
    ///
    /// # Errors
    /// [`FrameError::TooFine`] if the calibration is measured and the field does not locate the
    /// surface precisely enough, [`FrameError::OtherIndicator`] if `known` belongs to another
    /// indicator, [`FrameError::FewImages`] if the filters need more images in a periodic box than
    /// there are, and [`FrameError::Cancelled`].
    pub fn calibrate(
        &self,
        surfacing: &Surfacing,
        known: Option<&Calibration>,
        timings: &mut Timings,
    ) -> Result<CalibratedFrame<'_>, FrameError> {
        self.calibrate_for(surfacing, known, &self.resources.control, timings)
    }

    /// Prepares a surface like [`calibrate`](Self::calibrate), but reports progress to `control`,
    /// which can also cancel the work. `control` can differ from the control that was used to
    /// sample the frame.
    pub fn calibrate_for<'a>(
        &'a self,
        surfacing: &Surfacing,
        known: Option<&Calibration>,
        control: &'a Control,
        timings: &mut Timings,
    ) -> Result<CalibratedFrame<'a>, FrameError> {
        let &Surfacing { normals, periodic_mesh, .. } = surfacing;
        self.check_image_reach(surfacing)?;
        let (extracted, measured) = match &self.field {
            SampledField::Dif { sampled, stages } => {
                let kind = sampled.indicator.kind();
                let (calibration, measured) = match known {
                    Some(known) if !known.suits(kind) => return Err(FrameError::OtherIndicator),
                    Some(known) => (*known, None),
                    None => {
                        let measured = surfacing.calibrate_for(sampled, control);
                        control.cancel.go_on()?;
                        let measured = measured?;
                        timings.done("plateau");
                        (measured.calibration, Some(measured))
                    }
                };
                let recipe = surfacing.recipe(sampled, &calibration);
                let FrameFacts { spacing, grid, .. } = &sampled.facts;
                let smoothing = surfacing.attribute_smoothing(kind, *spacing, grid);
                (
                    ExtractableField::of_dif(
                        sampled,
                        &**stages,
                        recipe,
                        surfacing.solid.clone(),
                        smoothing,
                        normals,
                        periodic_mesh,
                    ),
                    measured,
                )
            }
            SampledField::Kernels(sampled) => (sampled.extracted(normals, periodic_mesh), None),
            SampledField::Sizes(sampled) => {
                let measured = sampled.sampled.calibrated();
                let calibration = known.copied().unwrap_or(measured.calibration);
                (sampled.extracted(surfacing, &calibration), known.is_none().then_some(measured))
            }
        };
        Ok(CalibratedFrame {
            facts: self.facts(),
            carried: self.carried.as_ref(),
            resources: &self.resources,
            control,
            surface_share: self.surface_share,
            measured,
            normals,
            walls: self.facts().mesh_walls(periodic_mesh),
            extracted,
        })
    }

    /// Checks that images exist as far beyond a periodic face as the filters reach.
    fn check_image_reach(&self, surfacing: &Surfacing) -> Result<(), FrameError> {
        let FrameFacts { periodic: Some(periodic), spacing, grid, .. } = self.facts() else {
            return Ok(());
        };
        let coarsest = match (&self.field, *spacing) {
            (SampledField::Sizes(sampled), Some(spacing)) => Some(spacing * sampled.coarsest()),
            _ => None,
        };
        let needed = surfacing.reach(self.method(), *spacing, coarsest, grid);
        let there = periodic.reach();
        if needed > there { Err(FrameError::FewImages { needed, there }) } else { Ok(()) }
    }

    /// The surface of the frame, with a calibration that is measured on the same frame.
    ///
    /// # Errors
    /// [`FrameError::TooFine`], and the errors of [`CalibratedFrame::surface`].
    pub fn surface(
        &self,
        surfacing: &Surfacing,
        timings: &mut Timings,
    ) -> Result<StitchedSurface, FrameError> {
        self.calibrate(surfacing, None, timings)?.surface(timings)
    }

    /// Compares the volume of a surface of the frame with that of its particles; returns `None` if
    /// the volume is as expected, if the spacing is not known, or if the particles have several
    /// sizes.
    ///
    /// # Errors
    /// [`FrameError::Scratch`] if the surface is in a scratch file that cannot be read.
    pub fn shortfall(&self, surface: &StitchedSurface) -> Result<Option<Shortfall>, FrameError> {
        let facts = self.facts();
        let Some(spacing) = facts.spacing else { return Ok(None) };
        // If particles have several sizes, the spacing does not determine their volume.
        if self.has_sizes() {
            return Ok(None);
        }
        let coincident = self.coincident();
        let (own, particles) = (facts.own_cells(), facts.census.binned);
        Shortfall::of(surface, own, particles, coincident.as_ref(), spacing)
            .map_err(self.resources.scratch_error())
    }

    /// Returns a lower bound of how many times denser the particles are than their spacing implies,
    /// in the tiles that contain particles. Returns `None` if the spacing is not known, and 0 for a
    /// frame that was sampled earlier.
    #[must_use]
    pub fn relative_density(&self) -> Option<f64> {
        Some(self.occupied.relative_density(self.facts().spacing_cells()?))
    }

    /// The coincident particles, if there are any. Always `None` for a frame that was sampled
    /// earlier.
    #[must_use]
    pub fn coincident(&self) -> Option<CoincidentParticles> {
        self.occupied.coincident(&self.facts().grid)
    }

    /// The spacing that the samples of the cloud indicator imply, for a frame that was sampled
    /// earlier; `None` for all other frames.
    #[must_use]
    pub fn spacing_by_samples(&self) -> Option<f64> {
        match &self.field {
            SampledField::Dif { sampled, .. } if self.occupied.is_empty() => {
                spacing_by_clouds(sampled)
            }
            _ => None,
        }
    }

    /// The tiles that contain particles; empty for a frame that was sampled earlier.
    #[must_use]
    pub fn occupied(&self) -> &OccupiedTiles {
        &self.occupied
    }

    /// For each carried attribute, the number of particles without a finite value in the blocks of
    /// `stretch`.
    ///
    /// # Errors
    /// [`FrameError::Scratch`] if particles are in a scratch file that cannot be read.
    pub fn lacking_within(&self, stretch: Stretch) -> Result<Vec<u64>, FrameError> {
        let Some((bins, infos)) = &self.carried else { return Ok(Vec::new()) };
        let mut lacking = vec![0; infos.len()];
        // In almost all frames, every particle has finite values, so no bin needs a search.
        if bins.without().iter().all(|&without| without == 0) {
            return Ok(lacking);
        }
        for (bin, key) in bins.keys().iter().enumerate() {
            if !stretch.contains_bin(key.coord()) {
                continue;
            }
            let contents = bins.contents(bin).map_err(self.resources.scratch_error())?;
            for ((lacking, values), info) in lacking.iter_mut().zip(&contents.attributes).zip(infos)
            {
                // Integers are always finite.
                if info.kind.is_whole() {
                    continue;
                }
                let is_lacking = |tuple: &&[f32]| tuple.iter().any(|x| !x.is_finite());
                *lacking += values.chunks(info.components).filter(is_lacking).count() as u64;
            }
        }
        Ok(lacking)
    }

    /// A lower bound of the number of particles outside the surface, from tiles that are completely
    /// outside. It is 0 for a frame that was sampled earlier.
    ///
    /// # Errors
    /// [`FrameError::Scratch`] if the surface is in a scratch file that cannot be read.
    pub fn lost(&self, surface: &StitchedSurface) -> Result<u64, FrameError> {
        self.occupied.lost(surface).map_err(self.resources.scratch_error())
    }

    /// Simplifies the surface and removes small components, as `reduction` requests. Reports
    /// progress to `control`, which can also cancel the work.
    ///
    /// # Errors
    /// [`FrameError::NothingLeft`], [`FrameError::Scratch`] if scratch files fail, and
    /// [`FrameError::Cancelled`].
    pub fn simplify(
        &self,
        surface: StitchedSurface,
        reduction: &Reduction,
        control: &Control,
        timings: &mut Timings,
    ) -> Result<SimplifiedSurface, FrameError> {
        let resources = Resources { control: control.clone(), ..self.resources.clone() };
        simplified(surface, reduction, self.facts(), self.surface_share, &resources, timings)
    }
}

/// Simplifies a surface and removes small components, as `reduction` requests, with at most `share`
/// bytes of triangles in memory.
///
/// # Errors
/// [`FrameError::NothingLeft`], [`FrameError::Scratch`] if scratch files fail, and
/// [`FrameError::Cancelled`].
pub fn simplified(
    surface: StitchedSurface,
    reduction: &Reduction,
    facts: &FrameFacts,
    share: u64,
    resources: &Resources,
    timings: &mut Timings,
) -> Result<SimplifiedSurface, FrameError> {
    let particle_cells = facts.spacing_cells_or_one().powi(3);
    let room = TriangleSpace { bytes: share, folder: &resources.scratch };
    let simplified = resources.control.during(Stage::Simplifying, || {
        simplify(surface, reduction, particle_cells, room, &resources.control)
            .map_err(resources.scratch_error())
    })?;
    timings.done("simplify");
    if simplified.triangle_count() == 0 {
        return Err(FrameError::NothingLeft(simplified.too_small()));
    }
    Ok(simplified)
}
