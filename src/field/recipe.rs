//! The computation of the field from samples, defined once for all backends. The field is computed
//! with the paper's filters, or as distances from clouds.
//!
//! A request determines the [`Filters`]. Their reach, and the memory that they need, are therefore
//! known before the calibration. A [`Recipe`] consists of the filters and the isovalue. For the
//! paper's filters, the isovalue comes from the calibration.

use crate::field::blur::{FieldCount, Filter, Smoothing, Weights};
use crate::field::detail::Recovery;
use crate::field::distance::{Bulk, Depths, DistanceFilters, Drops, InsideBricks, StandsOut};
use crate::field::indicator::IndicatorKind;
use crate::field::sheets::{Loose, SheetFields, Sheets, WEIGHT_BITS};
use crate::grid::units::{Isovalue, Sigma};
use crate::grid::{BLOCK, CellBox};

/// Treatment of details that smoothing loses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Detail {
    /// Details stay lost.
    Smoothed,
    /// Details are recovered as in section 6.2 of the paper: see [`detail`](crate::field::detail).
    Recovered,
}

/// All filters between the samples and the field.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Filters {
    /// The paper's filters, for its indicators.
    Paper(PaperFilters),
    /// Distances from clouds.
    Distances(Box<DistanceFilters>),
}

/// The paper's filters.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PaperFilters {
    /// The smoothing of section 4.2.
    pub smoothing: Smoothing,
    /// The detail recovery of section 6.2, if requested.
    pub recovery: Option<Recovery>,
}

impl PaperFilters {
    /// Makes the filters for the DIF of an indicator and a Gaussian of `sigma`.
    pub fn new(kind: IndicatorKind, sigma: Sigma, detail: Detail) -> Self {
        let recovery = (detail == Detail::Recovered).then(|| Recovery::new(sigma));
        Self { smoothing: Smoothing::new(kind, sigma), recovery }
    }

    fn stages(&self) -> impl Iterator<Item = &dyn Filter> {
        let recovery = self.recovery.as_ref().map(|recovery| recovery as &dyn Filter);
        std::iter::once::<&dyn Filter>(&self.smoothing).chain(recovery)
    }

    /// The distance, in cells, within which the DIF affects the field of a cell: the sum of the
    /// halos of all stages.
    pub fn halo(&self) -> i32 {
        self.stages().map(Filter::halo).sum()
    }

    fn reach(&self) -> i32 {
        self.stages().map(Filter::reach).max().unwrap_or(0)
    }

    /// The maximum number of fields of a block that exist at once.
    pub fn fields(&self) -> FieldCount {
        let most = |of: fn(FieldCount) -> u64| {
            self.stages().map(|stage| of(stage.fields())).max().unwrap_or(0)
        };
        FieldCount { host: most(|fields| fields.host), device: most(|fields| fields.device) }
    }
}

impl Filters {
    /// The maximum distance, in cells, from a surface to the nearest full cell.
    pub fn reach(&self) -> i32 {
        match self {
            Self::Paper(paper) => paper.reach(),
            Self::Distances(distances) => distances.reach(),
        }
    }

    /// The distance, in cells, within which particles affect the field of a cell.
    pub fn halo(&self) -> i32 {
        match self {
            Self::Paper(paper) => paper.halo(),
            Self::Distances(distances) => distances.halo(),
        }
    }

    /// The cells whose samples affect the field on `cells`, including the samples that decide which
    /// cells are inside.
    pub fn input_cells(&self, cells: CellBox) -> CellBox {
        match self {
            Self::Paper(paper) => cells.grown(paper.halo(), paper.halo()),
            Self::Distances(distances) => distances.input_cells(cells),
        }
    }

    /// The weights of all stages.
    pub fn weights(&self) -> Vec<&Weights> {
        match self {
            Self::Paper(paper) => paper.stages().flat_map(Filter::weights).collect(),
            Self::Distances(distances) => distances.weights().collect(),
        }
    }

    /// The part of `cells` that can contain the surface, according to the filters.
    pub fn not_inside(&self, cells: CellBox) -> CellBox {
        match self {
            Self::Distances(distances) if !cells.is_empty() => distances.not_inside(cells),
            _ => cells,
        }
    }

    /// The maximum memory, in bytes, that a thread needs to compute the field of a block.
    pub fn block_bytes(&self) -> u64 {
        match self {
            Self::Paper(paper) => {
                // Dual cells need one more cell at the upper end, and normals need one more at both
                // ends.
                let edge = (BLOCK + 3 + 2 * paper.halo()) as u64;
                edge.pow(3) * paper.fields().host * size_of::<u16>() as u64
            }
            Self::Distances(distances) => distances.block_bytes(),
        }
    }

    /// Whether the filters keep details, so that every drop and every sheet can have a surface.
    pub fn keeps_details(&self) -> bool {
        match self {
            Self::Paper(paper) => paper.recovery.is_some(),
            Self::Distances(_) => true,
        }
    }
}

/// All parameters that determine the surface from the samples.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recipe {
    /// The filters between the samples and the field.
    pub filters: Filters,
    /// The isovalue.
    pub iso: Isovalue,
}

impl Recipe {
    /// Makes the recipe for the paper's filters and an isovalue.
    pub fn of_paper(filters: PaperFilters, iso: Isovalue) -> Self {
        Self { filters: Filters::Paper(filters), iso }
    }

    /// Makes the recipe for distances, which are 0 on the surface.
    pub fn of_distances(distances: DistanceFilters) -> Self {
        Self { filters: Filters::Distances(Box::new(distances)), iso: Isovalue::ZERO_DISTANCE }
    }

    /// Computes the field from the samples, on any backend.
    pub fn apply<F: Fields>(&self, fields: &mut F) -> Result<F::Field, F::Error> {
        match &self.filters {
            Filters::Paper(paper) => paper.apply(fields, self.iso),
            Filters::Distances(distances) => {
                let bulk = bulk(distances, fields)?;
                joined(distances, fields, bulk)
            }
        }
    }
}

impl PaperFilters {
    fn apply<F: Fields>(&self, fields: &mut F, iso: Isovalue) -> Result<F::Field, F::Error> {
        let dif = fields.samples(0, self.halo())?;
        let smooth = |fields: &mut F, dif: F::Field| {
            let mut filters = self.smoothing.weights().iter();
            filters.try_fold(dif, |field, weights| fields.blur(field, weights))
        };
        let Some(recovery) = &self.recovery else { return smooth(fields, dif) };
        let smooth = smooth(fields, dif.clone())?;
        let lost = fields.lost(dif, &smooth, iso)?;
        let fine = fields.blur(lost, &recovery.fine)?;
        fields.greater(fine, smooth)
    }
}

/// The shares of drops, blended with the shares of sheets, and the certainty of the sheets.
#[derive(Debug, Clone)]
pub struct ThinShares<T> {
    /// The shares, in 32768ths. The share of a drop is the number that step 4 in
    /// [`distance`](crate::field::distance) calls N.
    pub shares: T,
    /// The certainty of the sheets, if there are any.
    pub certainty: Option<T>,
}

/// The surface of the bulk on wide cells, and the distance by which nearby particles lie outside
/// the calm surface.
#[derive(Debug, Clone)]
pub struct WideFields<T> {
    /// The surface of the bulk, as distances.
    pub bulk: T,
    /// For each cell, the greatest distance outside the calm surface among the particles whose
    /// drops can reach the cell.
    pub outlying: T,
}

/// The calm and the fine surface, with the wide fields that were computed from them.
pub type WithSurfaces<T> = ([T; 2], WideFields<T>);

/// Computes the wide fields that distances need, once for all requested cells.
pub fn bulk<F: Fields>(
    distances: &DistanceFilters,
    fields: &mut F,
) -> Result<WideFields<F::Field>, F::Error> {
    let (_, wide) = surfaces_and_bulk(distances, fields)?;
    Ok(wide)
}

/// Computes the calm and the fine surface and, from them, the surface of the bulk and the distance
/// by which particles lie outside the calm surface.
pub fn surfaces_and_bulk<F: Fields>(
    distances: &DistanceFilters,
    fields: &mut F,
) -> Result<WithSurfaces<F::Field>, F::Error> {
    let DistanceFilters { level, bulk, near, least, stands_out, inside, .. } = distances;
    let clouds = fields.samples(*level, distances.wide_halo())?;
    let filled = fields.filled(&clouds, bulk.scale)?;
    let Depths { calm, fine, apart } = fields.depths(bulk, filled)?;
    let outlying = fields.outlying([&calm, &fine], clouds, (*least, stands_out))?;
    let apart = fields.blur(apart, &bulk.around)?;
    let outlying = fields.spread(outlying, *near)?;
    let depths = Depths { calm: calm.clone(), fine: fine.clone(), apart };
    let bulk = fields.mixed(bulk, inside, depths, &outlying)?;
    Ok(([calm, fine], WideFields { bulk, outlying }))
}

/// The field, computed from the wide fields and, where drops are possible, from drops on cells of
/// [`drops_level`](DistanceFilters::drops_level).
pub fn joined<F: Fields>(
    distances: &DistanceFilters,
    fields: &mut F,
    wide: WideFields<F::Field>,
) -> Result<F::Field, F::Error> {
    let DistanceFilters { level, stands_out, drops, .. } = distances;
    let begin = stands_out.begin();
    fields.probe(&wide, *level, begin)?;
    let bulk = fields.refined(wide.bulk, 0)?;
    if !fields.narrowed(&wide.outlying, *level, begin) {
        return Ok(bulk);
    }
    let near = fields.refined(wide.outlying, 0)?;
    if !fields.narrowed(&near, 0, begin) {
        return Ok(bulk);
    }
    let ThinShares { shares, certainty } = thin_shares(distances, fields)?;
    let shares = fields.refined(shares, 0)?;
    let certainty = certainty.map(|certainty| fields.refined(certainty, 0)).transpose()?;
    fields.joined(bulk, near, ThinShares { shares, certainty }, (drops, stands_out))
}

/// Computes the shares of drops, blended with the shares of sheets, on cells of
/// [`drops_level`](DistanceFilters::drops_level).
pub fn thin_shares<F: Fields>(
    distances: &DistanceFilters,
    fields: &mut F,
) -> Result<ThinShares<F::Field>, F::Error> {
    let sheets = sheets(distances, fields)?;
    with_drops(distances, fields, sheets)
}

/// Computes the shares of drops, and blends them with the shares of `sheets`, if there are any.
pub fn with_drops<F: Fields>(
    distances: &DistanceFilters,
    fields: &mut F,
    sheets: Option<SheetFields<F::Field>>,
) -> Result<ThinShares<F::Field>, F::Error> {
    let DistanceFilters { drops_level, drops, .. } = distances;
    let clouds = fields.samples(*drops_level, drops.halo())?;
    let shares = fields.quotient(clouds, &drops.around, drops.bits)?;
    let shares = fields.blur(shares, &drops.spread)?;
    let Some(SheetFields { shares: of_sheets, certainty }) = sheets else {
        return Ok(ThinShares { shares, certainty: None });
    };
    let shares = fields.blended(shares, of_sheets, &certainty)?;
    Ok(ThinShares { shares, certainty: Some(certainty) })
}

/// Computes sheets on cells of [`drops_level`](DistanceFilters::drops_level), from the density on
/// wide cells; `None` if there are no sheets.
pub fn sheets<F: Fields>(
    distances: &DistanceFilters,
    fields: &mut F,
) -> Result<Option<SheetFields<F::Field>>, F::Error> {
    let DistanceFilters { level, bulk, drops_level, sheets, .. } = distances;
    let Some(by) = sheets else { return Ok(None) };
    let clouds = fields.samples(*level, distances.sheets_halo())?;
    if !fields.may_hold(by, &clouds) {
        return Ok(None);
    }
    // Only thick fluid continues into solids, because a thin film on a solid is a sheet.
    let filled = fields.filled(&clouds, bulk.scale)?;
    drop(clouds);
    let smooth = fields.blur(filled.clone(), &by.bulk)?;
    let Loose { clouds, weights } = fields.loose(filled, smooth, bulk.scale)?;
    let mut density = fields.blur(clouds, &by.around)?;
    if let Some(weights) = weights {
        let weights = fields.blur(weights, &by.around_weights)?;
        density = fields.divided(density, weights, WEIGHT_BITS)?;
    }
    let Some(SheetFields { shares, certainty }) = fields.sheets(by, density, *drops_level)? else {
        return Ok(None);
    };
    let certainty = fields.blur(certainty, &by.average)?;
    Ok(Some(SheetFields { shares, certainty }))
}

/// A backend's fields, and the filters that the backend runs on them. A clone of a field refers to
/// the same samples.
#[allow(clippy::missing_errors_doc, reason = "the implementor defines the error")]
pub trait Fields {
    /// Samples of a box of cells.
    type Field: Clone;
    /// The error of a filter that fails.
    type Error;

    /// The samples around the requested cells, in cells 2^`level` times as wide, with a halo of
    /// `halo` of these wider cells. At levels above 0, the requested cells lie between the middles
    /// of the outermost wider cells even if `halo` is 0.
    fn samples(&mut self, level: u32, halo: i32) -> Result<Self::Field, Self::Error>;

    /// Clouds, continued into solids: see [`solid`](crate::field::solid). `scale` is the factor in
    /// [`Bulk`].
    fn filled(&mut self, clouds: &Self::Field, scale: u32) -> Result<Self::Field, Self::Error>;

    /// Applies one separable filter (section 4.2). Fields are mirrored at walls.
    fn blur(&mut self, field: Self::Field, weights: &Weights) -> Result<Self::Field, Self::Error>;

    /// theta_bar (section 6.2).
    fn lost(
        &mut self,
        dif: Self::Field,
        smooth: &Self::Field,
        iso: Isovalue,
    ) -> Result<Self::Field, Self::Error>;

    /// The greater of two fields, cell by cell.
    fn greater(
        &mut self,
        field: Self::Field,
        other: Self::Field,
    ) -> Result<Self::Field, Self::Error>;

    /// Smooths `clouds` with each of the three widths, and computes the calm and the fine surface
    /// of the bulk and the difference between them.
    fn depths(
        &mut self,
        bulk: &Bulk,
        clouds: Self::Field,
    ) -> Result<Depths<Self::Field>, Self::Error>;

    /// The final surface of the bulk, from the calm and the fine surface and their mean difference.
    /// The samples are 0 where no particle is near, and maximal in inside bricks.
    fn mixed(
        &mut self,
        bulk: &Bulk,
        inside: &InsideBricks,
        depths: Depths<Self::Field>,
        near: &Self::Field,
    ) -> Result<Self::Field, Self::Error>;

    /// The distance by which each cell with a particle lies outside the calm surface, from the calm
    /// and the fine surface: see [`StandsOut::of_particle`]. A cell contains a particle if its
    /// sample in `clouds` is at least the number in `by`.
    fn outlying(
        &mut self,
        surfaces: [&Self::Field; 2],
        clouds: Self::Field,
        by: (u16, &StandsOut),
    ) -> Result<Self::Field, Self::Error>;

    /// The greatest sample within `reach` cells along each axis.
    fn spread(&mut self, field: Self::Field, reach: i32) -> Result<Self::Field, Self::Error>;

    /// Examines the wide fields, whose cells are 2^`level` times as wide as the requested cells.
    /// May return an error to stop the work if these fields rule out a surface.
    fn probe(
        &mut self,
        wide: &WideFields<Self::Field>,
        level: u32,
        begin: u16,
    ) -> Result<(), Self::Error>;

    /// Interpolates a field of wider cells at the middles of the cells that are 2^`level` times as
    /// wide as the requested cells and surround them.
    fn refined(&mut self, wide: Self::Field, level: u32) -> Result<Self::Field, Self::Error>;

    /// Whether particles can stand out in any requested cell, according to `near`, whose cells are
    /// 2^`level` times as wide. If so, further samples and fields are restricted to the cells where
    /// particles can stand out.
    fn narrowed(&mut self, near: &Self::Field, level: u32, begin: u16) -> bool;

    /// The density of clouds, divided by the same density after smoothing by `around`.
    fn quotient(
        &mut self,
        clouds: Self::Field,
        around: &Weights,
        bits: u32,
    ) -> Result<Self::Field, Self::Error>;

    /// Checks, before smoothing, whether `clouds` can contain a sheet.
    fn may_hold(&mut self, sheets: &Sheets, clouds: &Self::Field) -> bool;

    /// Clouds, reduced in the bulk, as in step 1 of [`sheets`](crate::field::sheets). `smooth` are
    /// the clouds after smoothing by the filter that shows the bulk; `scale` converts them to
    /// fractions of the plateau.
    fn loose(
        &mut self,
        clouds: Self::Field,
        smooth: Self::Field,
        scale: u32,
    ) -> Result<Loose<Self::Field>, Self::Error>;

    /// Divides `field` by the field `by`, cell by cell. The quotients are in units of 1 / 2^`bits`.
    fn divided(
        &mut self,
        field: Self::Field,
        by: Self::Field,
        bits: u32,
    ) -> Result<Self::Field, Self::Error>;

    /// Computes sheets on cells 2^`level` times as wide around the requested cells, from the
    /// smoothed density on wider cells. Returns `None` if there are certainly no sheets.
    fn sheets(
        &mut self,
        sheets: &Sheets,
        density: Self::Field,
        level: u32,
    ) -> Result<Option<SheetFields<Self::Field>>, Self::Error>;

    /// The shares of drops, blended with the shares of sheets according to the sheets' certainty.
    fn blended(
        &mut self,
        drops: Self::Field,
        sheets: Self::Field,
        certainty: &Self::Field,
    ) -> Result<Self::Field, Self::Error>;

    /// The final field: the surface of the bulk, joined with drops and sheets.
    fn joined(
        &mut self,
        bulk: Self::Field,
        near: Self::Field,
        thin: ThinShares<Self::Field>,
        by: (&Drops, &StandsOut),
    ) -> Result<Self::Field, Self::Error>;
}
