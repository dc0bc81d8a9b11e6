//! Merges parts: lists the blocks of all parts in order, and then stitches them like a single
//! run.

use crate::brick::FrameFacts;
use crate::error::{Error, PartsError};
use crate::frame::{FrameError, OccupiedTiles, Sampling, Shortfall, simplified};
use crate::grid::units::Isovalue;
use crate::reconstruction::checked::{CheckedRequest, StartedRequest};
use crate::reconstruction::extract::{ExtractedSurface, Findings};
use crate::reconstruction::report::Report;
use crate::reconstruction::surface::Surface;
use crate::reconstruction::warning::particle_warnings;
use crate::surface::dual_mc::Normals;
use crate::surface::mesh::spool::Spool;
use crate::surface::stitch::StitchedSurface;
use crate::system::control::Stage;
use crate::system::timings::Timings;

use super::file::PartFile;
use super::make::{components, mark};
use super::plan_file::SharedPlan;
use super::{Parts, PartsRequest, part_in};

/// Contents of the files of all parts.
struct MergedParts {
    spool: Spool,
    occupied: OccupiedTiles,
    without_value: Vec<u64>,
    bins: u64,
}

impl Parts {
    /// Merges the parts into the same surface as a single run, with the same report except for the
    /// times, and simplifies the surface if requested. The meshes stay in the parts' files, which
    /// must exist until the surface is written.
    ///
    /// # Errors
    /// [`Error::Parts`] if there is no plan for this request, or if parts are missing, damaged or
    /// from another plan; [`Error::Frame`] if there is no surface, or scratch files fail.
    pub fn merge(&self) -> Result<Surface, Error> {
        let request = self.begin()?;
        let (plan, fingerprint) = self.planned(&request)?;
        let PartsRequest { checked, folder, indicator } = request;
        let StartedRequest { checked, threads } = checked.on_threads()?;
        let mut timings = Timings::default();
        let control = &checked.resources.control;
        let extracted = threads.install(|| {
            let join = || joined(&plan, fingerprint, &checked, &folder);
            let joined = control.during(Stage::Reading, join)?;
            timings.done("verify");
            let sampling = plan.sampling(&checked, Vec::new())?;
            let facts = plan.facts(&sampling);
            let indicator = Some(plan.indicator(indicator)?);
            let backend = checked.resources.backend.name();
            let report = Report::of_facts(facts, indicator, &checked.surfacing, backend);
            extracted(&plan, &checked, &sampling, joined, report, &mut timings)
                .map_err(|error| error.of_file(&self.input))
        });
        let mut extracted = extracted?;
        extracted.report.timings = timings;
        let up = checked.settings.usual_up(&self.input);
        Ok(Surface::new(extracted, &checked, &threads, up))
    }
}

/// Opens the files of all parts, and checks them completely.
fn joined(
    plan: &SharedPlan,
    fingerprint: u32,
    checked: &CheckedRequest,
    folder: &std::path::Path,
) -> Result<MergedParts, Error> {
    let components = components(plan);
    let (mut files, mut missing) = (Vec::new(), Vec::new());
    for part in 0..plan.count() {
        checked.check_cancelled()?;
        let mark = mark(plan, fingerprint, part, checked);
        match PartFile::open(&part_in(folder, part), mark, &components)? {
            Some(file) => files.push(file),
            None => missing.push(part),
        }
    }
    if !missing.is_empty() {
        return Err(
            PartsError::Missing { folder: folder.to_owned(), missing, of: plan.count() }.into()
        );
    }
    let (mut occupied, mut bins) = (OccupiedTiles::default(), 0);
    let mut without_value = vec![0; components.len()];
    let meshes = files.into_iter().map(|file| {
        occupied.join(file.occupied);
        bins += file.bins;
        without_value.iter_mut().zip(file.lacking).for_each(|(all, more)| *all += more);
        file.meshes
    });
    let meshes = meshes.collect();
    let normals = checked.surfacing.normals == Normals::Gradient;
    let spool = Spool::in_files(normals, components, meshes, &checked.resources.scratch);
    Ok(MergedParts { spool, occupied, without_value, bins })
}

/// Makes the surface from the meshes, with the same steps as a single run.
fn extracted(
    plan: &SharedPlan,
    checked: &CheckedRequest,
    sampling: &Sampling,
    joined: MergedParts,
    mut report: Report,
    timings: &mut Timings,
) -> Result<ExtractedSurface, Error> {
    let FrameFacts { grid, census, spacing, .. } = report.facts;
    let walls = report.facts.mesh_walls(checked.surfacing.periodic_mesh);
    let MergedParts { spool, occupied, without_value, bins } = joined;
    let iso = plan.calibration.and_then(|known| known.iso());
    if spool.is_empty() {
        let at_solids = checked.surfacing.at_solids;
        let of_distances = FrameError::NoDistanceSurface { at_solids };
        return Err(iso.map_or(of_distances, |iso| FrameError::NoSurface { iso }).into());
    }
    let share =
        sampling.merging_share(&checked.surfacing, &components(plan), spool.len() as u64, bins);
    let crossings = iso.unwrap_or(Isovalue::ZERO_DISTANCE);
    let surface = StitchedSurface::new(spool, grid, walls, crossings, plan.attributes.clone());
    let resources = &checked.resources;
    let in_scratch =
        |fault| Error::from(FrameError::Scratch { folder: resources.scratch.clone(), fault });

    let crowding = report.facts.spacing_cells().map(|spacing| occupied.relative_density(spacing));
    let without_value =
        plan.attributes.iter().zip(without_value).filter(|&(_, without)| without > 0);
    let without_value = without_value.map(|(info, without)| (info.name.as_str(), without as usize));
    report.warnings = particle_warnings(
        &report.facts,
        crowding,
        plan.coincident,
        without_value,
        plan.mean_symmetry,
    );
    let lost = occupied.lost(&surface).map_err(in_scratch)?;
    drop(occupied);
    let own = report.facts.own_cells();
    // With several sizes of particles, the spacing does not determine a particle's volume.
    let one_size = spacing.filter(|_| plan.cells.sizes.is_none());
    let shortfall = one_size
        .map(|spacing| {
            Shortfall::of(&surface, own, census.binned, plan.coincident.as_ref(), spacing)
        })
        .transpose();
    let found = Findings {
        calibration: plan.calibration,
        measured: plan.calibrated(),
        lost,
        shortfall: shortfall.map_err(in_scratch)?.flatten(),
    };
    checked.add_findings(&mut report, &surface, found);
    report.add_cells(Some(plan.cells.clone()), plan.moved);
    timings.done("merge");

    let facts = report.facts;
    let simplify =
        |surface| simplified(surface, &checked.reduction, &facts, share, resources, timings);
    Ok(checked.reduce(surface, report, simplify)?)
}
