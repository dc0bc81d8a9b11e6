//! From samples to the field, once: the paper's filters, or distances from clouds.
//!
//! A request says which [`Filters`] there are, and so how far they reach and what they take. A
//! [`Recipe`] also has what only a calibration tells: where the surface is.

use crate::field::blur::{FieldCount, Filter, Smoothing, Weights};
use crate::field::detail::Recovery;
use crate::field::distance::{Bulk, Depths, DistanceFilters, Drops, InsideBricks, Ramp, Width};
use crate::field::indicator::IndicatorKind;
use crate::field::sheets::{SheetFields, Sheets};
use crate::grid::units::{Isovalue, Sigma};
use crate::grid::{BLOCK, CellBox};

/// Treatment of details that smoothing loses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Detail {
    /// Details stay lost.
    Smoothed,
    /// Section 6.2 brings them back: see [`detail`](crate::field::detail).
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
    /// Section 4.2.
    pub smoothing: Smoothing,
    /// Section 6.2, where it is asked for.
    pub recovery: Option<Recovery>,
}

impl PaperFilters {
    /// For the DIF of an indicator and a Gaussian of `sigma`.
    pub fn new(kind: IndicatorKind, sigma: Sigma, detail: Detail) -> Self {
        let recovery = (detail == Detail::Recovered).then(|| Recovery::new(sigma));
        Self { smoothing: Smoothing::new(kind, sigma), recovery }
    }

    fn stages(&self) -> impl Iterator<Item = &dyn Filter> {
        let recovery = self.recovery.as_ref().map(|recovery| recovery as &dyn Filter);
        std::iter::once::<&dyn Filter>(&self.smoothing).chain(recovery)
    }

    /// How far from a cell the DIF decides its field: the halos of all stages together.
    pub fn halo(&self) -> i32 {
        self.stages().map(Filter::halo).sum()
    }

    fn reach(&self) -> i32 {
        self.stages().map(Filter::reach).max().unwrap_or(0)
    }

    /// Fields of a block that are there at once, at the most.
    pub fn fields(&self) -> FieldCount {
        let most = |of: fn(FieldCount) -> u64| {
            self.stages().map(|stage| of(stage.fields())).max().unwrap_or(0)
        };
        FieldCount { host: most(|fields| fields.host), device: most(|fields| fields.device) }
    }
}

impl Filters {
    /// How far from a full cell there can be a surface.
    pub fn reach(&self) -> i32 {
        match self {
            Self::Paper(paper) => paper.reach(),
            Self::Distances(distances) => distances.reach(),
        }
    }

    /// How far from a cell particles decide its field, in cells.
    pub fn halo(&self) -> i32 {
        match self {
            Self::Paper(paper) => paper.halo(),
            Self::Distances(distances) => distances.halo(),
        }
    }

    /// The cells whose samples decide the field on some cells, and which of those count as inside.
    pub fn seen(&self, cells: CellBox) -> CellBox {
        match self {
            Self::Paper(paper) => cells.grown(paper.halo(), paper.halo()),
            Self::Distances(distances) => distances.seen(cells),
        }
    }

    /// The weights of all stages.
    pub fn weights(&self) -> Vec<&Weights> {
        match self {
            Self::Paper(paper) => paper.stages().flat_map(Filter::weights).collect(),
            Self::Distances(distances) => distances.weights().collect(),
        }
    }

    /// The part of some cells in which dual cells can be mixed, as far as the filters say.
    pub fn not_inside(&self, cells: CellBox) -> CellBox {
        match self {
            Self::Distances(distances) if !cells.is_empty() => distances.not_inside(cells),
            _ => cells,
        }
    }

    /// Bytes of a block in the memory of a thread while its field is made, at the most.
    pub fn block_bytes(&self) -> u64 {
        match self {
            Self::Paper(paper) => {
                // Dual cells reach one cell up, and normals one cell each way.
                let edge = (BLOCK + 3 + 2 * paper.halo()) as u64;
                edge.pow(3) * paper.fields().host * size_of::<u16>() as u64
            }
            Self::Distances(distances) => distances.block_bytes(),
        }
    }

    /// Whether every drop and every sheet can have a surface.
    pub fn keeps_details(&self) -> bool {
        match self {
            Self::Paper(paper) => paper.recovery.is_some(),
            Self::Distances(_) => true,
        }
    }
}

/// Everything between samples and their surface.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recipe {
    /// From the samples to the field.
    pub filters: Filters,
    /// Where the surface is.
    pub iso: Isovalue,
}

impl Recipe {
    /// The paper's, for an isovalue.
    pub fn of_paper(filters: PaperFilters, iso: Isovalue) -> Self {
        Self { filters: Filters::Paper(filters), iso }
    }

    /// By distances, which are 0 on the surface.
    pub fn of_distances(distances: DistanceFilters) -> Self {
        Self { filters: Filters::Distances(Box::new(distances)), iso: Isovalue::NO_DISTANCE }
    }

    /// From the samples to the field, wherever fields are kept.
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

/// The surface of the bulk in wide cells, and by how much particles lie outside of the calm one
/// near by.
#[derive(Debug, Clone)]
pub struct WideFields<T> {
    /// Distances.
    pub bulk: T,
    /// The greatest within reach of a drop.
    pub outlying: T,
}

/// The calm surface, with the wide fields that were computed from it.
pub type WithCalm<T> = (T, WideFields<T>);

/// All that distances need of wide cells: it is made once for whatever cells lie between these.
pub fn bulk<F: Fields>(
    distances: &DistanceFilters,
    fields: &mut F,
) -> Result<WideFields<F::Field>, F::Error> {
    let (_, wide) = calm_and_bulk(distances, fields)?;
    Ok(wide)
}

/// Computes the calm surface, and from it the bulk and how far particles lie outside of it.
pub fn calm_and_bulk<F: Fields>(
    distances: &DistanceFilters,
    fields: &mut F,
) -> Result<WithCalm<F::Field>, F::Error> {
    let DistanceFilters { level, bulk, near, least, inside, .. } = distances;
    let clouds = fields.samples(*level, distances.wide_halo())?;
    let filled = fields.filled(&clouds)?;
    let mut share = |width: &Width| fields.blur(filled.clone(), &width.weights);
    let [narrow, middle, wide] = &bulk.widths;
    let shares = [share(narrow)?, share(middle)?, share(wide)?];
    drop(filled);
    let Depths { calm, fine, apart } = fields.depths(bulk, shares)?;
    let outlying = fields.outlying(&calm, clouds, *least)?;
    let apart = fields.blur(apart, &bulk.around)?;
    let outlying = fields.spread(outlying, *near)?;
    let depths = Depths { calm: calm.clone(), fine, apart };
    let bulk = fields.mixed(bulk, inside, depths, &outlying)?;
    Ok((calm, WideFields { bulk, outlying }))
}

/// The field, of what is known of wide cells, and of drops in cells where any can be seen.
pub fn joined<F: Fields>(
    distances: &DistanceFilters,
    fields: &mut F,
    wide: WideFields<F::Field>,
) -> Result<F::Field, F::Error> {
    let DistanceFilters { level, ramp, drops_level, drops, .. } = distances;
    fields.probe(&wide, *level, ramp)?;
    let bulk = fields.refined(wide.bulk, *level)?;
    if !fields.narrowed(&wide.outlying, *level, ramp) {
        return Ok(bulk);
    }
    let near = fields.refined(wide.outlying, *level)?;
    if !fields.narrowed(&near, 0, ramp) {
        return Ok(bulk);
    }
    let shares = thin_shares(distances, fields)?;
    let shares = fields.refined(shares, *drops_level)?;
    fields.joined(bulk, near, shares, (drops, ramp))
}

/// The shares of drops, and of the sheets that they give way to, in the cells that they are made
/// in.
pub fn thin_shares<F: Fields>(
    distances: &DistanceFilters,
    fields: &mut F,
) -> Result<F::Field, F::Error> {
    let DistanceFilters { drops_level, drops, sheets, .. } = distances;
    let clouds = fields.samples(*drops_level, distances.drops_halo())?;
    let sheets = sheets.as_ref().filter(|sheets| fields.may_hold(sheets, &clouds));
    let density = sheets.map(|sheets| fields.blur(clouds.clone(), &sheets.around)).transpose()?;
    let clouds = fields.nearer(clouds, *drops_level, drops.halo());
    let around = fields.blur(clouds.clone(), &drops.around)?;
    let shares = fields.quotient(clouds, around, drops.bits)?;
    let mut shares = fields.blur(shares, &drops.spread)?;
    if let (Some(by), Some(density)) = (sheets, density)
        && let Some(SheetFields { shares: of_sheets, certainty }) = fields.sheets(by, density)?
    {
        let certainty = fields.blur(certainty, &by.average)?;
        shares = fields.blended(shares, SheetFields { shares: of_sheets, certainty })?;
    }
    Ok(shares)
}

/// Where fields are kept, and the filters on them. A clone of a field is the same field.
#[allow(clippy::missing_errors_doc, reason = "whatever Error is")]
pub trait Fields {
    /// Samples of a box of cells.
    type Field: Clone;
    /// The error of a filter that fails.
    type Error;

    /// The samples of the cells that the field is asked for on, and of as many around as `halo`
    /// says: cells 2^`level` times as wide, between whose middles those cells lie.
    fn samples(&mut self, level: u32, halo: i32) -> Result<Self::Field, Self::Error>;

    /// Clouds that are continued into solids: see [`solid`](crate::field::solid).
    fn filled(&mut self, clouds: &Self::Field) -> Result<Self::Field, Self::Error>;

    /// One separable filter (section 4.2); at a wall it sees the edge cells repeated.
    fn blur(&mut self, field: Self::Field, weights: &Weights) -> Result<Self::Field, Self::Error>;

    /// theta_bar (section 6.2).
    fn lost(
        &mut self,
        dif: Self::Field,
        smooth: &Self::Field,
        iso: Isovalue,
    ) -> Result<Self::Field, Self::Error>;

    /// Returns the greater of two fields, cell by cell.
    fn greater(
        &mut self,
        field: Self::Field,
        other: Self::Field,
    ) -> Result<Self::Field, Self::Error>;

    /// Two surfaces of the bulk, by the samples under each of its widths.
    fn depths(
        &mut self,
        bulk: &Bulk,
        shares: [Self::Field; 3],
    ) -> Result<Depths<Self::Field>, Self::Error>;

    /// The one that is drawn, of both and of what they are apart by on average: none where nothing
    /// is near, and at its greatest inside.
    fn mixed(
        &mut self,
        bulk: &Bulk,
        inside: &InsideBricks,
        depths: Depths<Self::Field>,
        near: &Self::Field,
    ) -> Result<Self::Field, Self::Error>;

    /// By how much particles lie outside of the calm surface.
    fn outlying(
        &mut self,
        calm: &Self::Field,
        clouds: Self::Field,
        least: u16,
    ) -> Result<Self::Field, Self::Error>;

    /// The greatest sample within `reach` cells along each axis; at a wall it sees the edge cells
    /// repeated.
    fn spread(&mut self, field: Self::Field, reach: i32) -> Result<Self::Field, Self::Error>;

    /// Looks at what is known of cells 2^`level` times as wide, and may stop where no surface can
    /// come of it.
    fn probe(
        &mut self,
        wide: &WideFields<Self::Field>,
        level: u32,
        ramp: &Ramp,
    ) -> Result<(), Self::Error>;

    /// A field of cells 2^`level` times as wide at the middles of those that it is asked for on.
    fn refined(&mut self, wide: Self::Field, level: u32) -> Result<Self::Field, Self::Error>;

    /// Whether particles stand out in any cell, as far as cells 2^`level` times as wide tell. From
    /// then on samples and fields are those of the cells where they can.
    fn narrowed(&mut self, near: &Self::Field, level: u32, ramp: &Ramp) -> bool;

    /// Shares of clouds in what is around them.
    fn quotient(
        &mut self,
        clouds: Self::Field,
        around: Self::Field,
        bits: u32,
    ) -> Result<Self::Field, Self::Error>;

    /// Whether clouds can hold a sheet, as far as can be told before they are smoothed.
    fn may_hold(&mut self, sheets: &Sheets, clouds: &Self::Field) -> bool;

    /// The part of samples that is within a smaller halo, if the rest is in the way.
    fn nearer(&mut self, field: Self::Field, level: u32, halo: i32) -> Self::Field;

    /// Sheets of the smoothed density; `None` if it holds none, as far as that is known.
    fn sheets(
        &mut self,
        sheets: &Sheets,
        density: Self::Field,
    ) -> Result<Option<SheetFields<Self::Field>>, Self::Error>;

    /// Shares of drops blended with those of sheets.
    fn blended(
        &mut self,
        drops: Self::Field,
        sheets: SheetFields<Self::Field>,
    ) -> Result<Self::Field, Self::Error>;

    /// The field, of the bulk's surface and of drops.
    fn joined(
        &mut self,
        bulk: Self::Field,
        near: Self::Field,
        shares: Self::Field,
        by: (&Drops, &Ramp),
    ) -> Result<Self::Field, Self::Error>;
}

/// The cells of which a field takes samples, and whose walls they repeat at a level.
pub fn walls_at(level: u32, walls: Option<CellBox>) -> Option<CellBox> {
    walls.map(|walls| (0..level).fold(walls, |walls, _| crate::brick::halved_box(walls)))
}
