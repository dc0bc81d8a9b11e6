//! The paper from the DIF to the field, once: smooth, and bring back the details or keep them.
//!
//! A request says which [`Filters`] there are, and so how far they reach and what they take. A [`Recipe`] also has
//! the thresholds that only a DIF whose mu0 is known has.

use crate::stage::adaptive::Adaptive;
use crate::stage::blur::{FieldCount, Filter, Kernel, Smoothing};
use crate::stage::detail::Recovery;
use crate::stage::indicator::{Indicator, IndicatorKind};
use crate::units::{Isovalue, Sigma};

/// Treatment of details that smoothing loses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Detail {
    /// They stay lost.
    Smoothed,
    /// Section 6.2 brings them back: see [`detail`](crate::stage::detail).
    Recovered,
    /// An adaptive blur keeps them: see [`adaptive`](crate::stage::adaptive).
    Adaptive,
}

/// All filters between the DIF and the field.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Filters {
    /// Section 4.2.
    pub smoothing: Smoothing,
    detail: DetailFilter,
}

/// The filter that goes with each [`Detail`].
#[derive(Debug, Clone, PartialEq, Eq)]
enum DetailFilter {
    None,
    Recovery(Recovery),
    Adaptive(Adaptive),
}

impl Filters {
    /// For the DIF of an indicator and a Gaussian of `sigma`.
    #[must_use]
    pub fn new(kind: IndicatorKind, sigma: Sigma, detail: Detail) -> Self {
        let detail = match detail {
            Detail::Smoothed => DetailFilter::None,
            Detail::Recovered => DetailFilter::Recovery(Recovery::new(sigma)),
            Detail::Adaptive => DetailFilter::Adaptive(Adaptive::new(sigma)),
        };
        Self { smoothing: Smoothing::new(kind, sigma), detail }
    }

    /// How details are treated.
    #[must_use]
    pub fn detail(&self) -> Detail {
        match self.detail {
            DetailFilter::None => Detail::Smoothed,
            DetailFilter::Recovery(_) => Detail::Recovered,
            DetailFilter::Adaptive(_) => Detail::Adaptive,
        }
    }

    fn stages(&self) -> impl Iterator<Item = &dyn Filter> {
        let detail: Option<&dyn Filter> = match &self.detail {
            DetailFilter::None => None,
            DetailFilter::Recovery(recovery) => Some(recovery),
            DetailFilter::Adaptive(adaptive) => Some(adaptive),
        };
        std::iter::once::<&dyn Filter>(&self.smoothing).chain(detail)
    }

    /// How far from a cell the DIF decides its field: the halos of all stages together.
    #[must_use]
    pub fn halo(&self) -> i32 {
        self.stages().map(Filter::halo).sum()
    }

    /// How far from a full cell the field can be other than 0.
    #[must_use]
    pub fn reach(&self) -> i32 {
        self.stages().map(Filter::reach).max().unwrap_or(0)
    }

    /// The weights of all stages.
    pub fn kernels(&self) -> impl Iterator<Item = &Kernel> {
        self.stages().flat_map(Filter::kernels)
    }

    /// Fields of a block that are there at once, at the most.
    #[must_use]
    pub fn fields(&self) -> FieldCount {
        let most =
            |of: fn(FieldCount) -> u64| self.stages().map(|stage| of(stage.fields())).max().unwrap_or(0);
        FieldCount { host: most(|fields| fields.host), device: most(|fields| fields.device) }
    }

    /// Whether every drop and every sheet can have a surface.
    #[must_use]
    pub fn keeps_details(&self) -> bool {
        self.stages().any(Filter::keeps_details)
    }
}

/// Everything between a DIF and its isosurface.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recipe {
    /// From the DIF to the field.
    pub filters: Filters,
    /// Where the surface is.
    pub iso: Isovalue,
    /// The least theta of cells that count as full in an adaptive blur.
    least: u16,
}

impl Recipe {
    /// Draws a surface through a field of an indicator whose mu0 is known.
    #[must_use]
    pub fn new(filters: Filters, indicator: Indicator, iso: Isovalue) -> Self {
        Self { filters, iso, least: indicator.least() }
    }

    /// The paper, from the DIF to the field, wherever fields are kept.
    ///
    /// # Errors
    /// Those of `fields`.
    pub fn apply<F: Fields>(&self, fields: &mut F, dif: F::Field) -> Result<F::Field, F::Error> {
        let smooth = |fields: &mut F, dif: F::Field| {
            let mut filters = self.filters.smoothing.kernels().iter();
            filters.try_fold(dif, |field, kernel| fields.blur(field, kernel))
        };
        match &self.filters.detail {
            DetailFilter::None => smooth(fields, dif),
            DetailFilter::Recovery(recovery) => {
                let smooth = smooth(fields, dif.clone())?;
                let lost = fields.lost(dif, &smooth, self.iso)?;
                let fine = fields.blur(lost, &recovery.fine)?;
                fields.greater(fine, smooth)
            }
            DetailFilter::Adaptive(adaptive) => {
                let smooth = smooth(fields, dif.clone())?;
                let occupancy = fields.occupancy(dif, self.least)?;
                let fine = fields.blur(occupancy, &adaptive.fine)?;
                let near = fields.spread(&smooth, adaptive.near)?;
                fields.blend(fine, smooth, near, self.iso)
            }
        }
    }
}

/// Where fields are kept, and the filters on them. A clone of a field is the same field.
#[allow(clippy::missing_errors_doc, reason = "whatever Error is")]
pub trait Fields {
    /// Samples of a box of cells.
    type Field: Clone;
    /// What can go wrong.
    type Error;

    /// One separable filter (section 4.2); at a wall it sees the edge cells repeated.
    fn blur(&mut self, field: Self::Field, kernel: &Kernel) -> Result<Self::Field, Self::Error>;

    /// theta_bar (section 6.2).
    fn lost(
        &mut self,
        dif: Self::Field,
        smooth: &Self::Field,
        iso: Isovalue,
    ) -> Result<Self::Field, Self::Error>;

    /// Of two fields the greater, cell by cell.
    fn greater(&mut self, field: Self::Field, other: Self::Field) -> Result<Self::Field, Self::Error>;

    /// 1 in every full cell, whose theta is not less than `least`.
    fn occupancy(&mut self, dif: Self::Field, least: u16) -> Result<Self::Field, Self::Error>;

    /// The greatest sample within `reach` cells along each axis; at a wall it sees the edge cells repeated.
    fn spread(&mut self, field: &Self::Field, reach: i32) -> Result<Self::Field, Self::Error>;

    /// The field of an adaptive blur, from the blurred occupancy, the smoothed DIF and the greatest of that near by.
    fn blend(
        &mut self,
        fine: Self::Field,
        smooth: Self::Field,
        near: Self::Field,
        iso: Isovalue,
    ) -> Result<Self::Field, Self::Error>;
}
