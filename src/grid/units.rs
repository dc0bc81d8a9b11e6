//! Numbers with a unit, checked when they are created.
//!
//! Symbols follow the paper: isovalue `c`, standard deviation `sigma`, particle mean `mu0`.

use thiserror::Error;

/// The integer that represents an indicator of exactly 1 in a field.
pub const FULL: u16 = u16::MAX;

/// A number outside its valid range, with the name of its setting.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum UnitError {
    /// An isovalue that is not between 0 and 1.
    #[error("iso must be more than 0 and less than 1, got {0}")]
    Isovalue(f64),
    /// An invalid width of the Gaussian.
    #[error("sigma must be more than 0 and at most {max} cells, got {0}", max = Sigma::MAX)]
    Sigma(f64),
    /// An invalid mean number of particles in a full cell.
    #[error("mu0 must be more than 0 and at most {max}, got {0}", max = MeanCount::MAX)]
    MeanCount(f64),
    /// An invalid smoothing width.
    #[error("smooth must be from {least} to {most} spacings, got {0}", least = Smooth::LEAST, most = Smooth::MOST)]
    Smooth(f64),
    /// An invalid maximum distance between joined particles of a sheet.
    #[error("sheets must be 0, or from {least} to {most} spacings, got {0}", least = SheetStretch::LEAST, most = SheetStretch::MOST)]
    SheetStretch(f64),
    /// An invalid distance between the fluid and a solid.
    #[error("solid-offset must be from {least} to {most} spacings, got {0}", least = SolidOffset::LEAST, most = SolidOffset::MOST)]
    SolidOffset(f64),
    /// An invalid tolerance of simplification.
    #[error("simplify must be more than 0 and at most {max} cells, got {0}", max = Tolerance::MAX)]
    Tolerance(f64),
    /// An invalid minimum volume of the components that are kept.
    #[error("smallest-component must be positive and finite, got {0}")]
    Volume(f64),
    /// A number that is not finite.
    #[error("{name} must be three finite numbers, got {value}")]
    NotFinite {
        /// The name of the setting.
        name: &'static str,
        /// The invalid value.
        value: f64,
    },
    /// A length that is not positive and finite.
    #[error("{name} must be positive and finite, got {value}")]
    Length {
        /// The name of the setting.
        name: &'static str,
        /// The invalid value.
        value: f64,
    },
}

impl UnitError {
    /// The name of the setting, which starts the message.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Isovalue(_) => "iso",
            Self::Sigma(_) => "sigma",
            Self::MeanCount(_) => "mu0",
            Self::Smooth(_) => "smooth",
            Self::SheetStretch(_) => "sheets",
            Self::SolidOffset(_) => "solid-offset",
            Self::Tolerance(_) => "simplify",
            Self::Volume(_) => "smallest-component",
            Self::NotFinite { name, .. } | Self::Length { name, .. } => name,
        }
    }
}

/// Checks that `value` can be used as a length.
///
/// # Errors
/// [`UnitError::Length`] unless `value` is positive and finite.
pub fn positive_length(name: &'static str, value: f64) -> Result<f64, UnitError> {
    (value.is_finite() && value > 0.0).then_some(value).ok_or(UnitError::Length { name, value })
}

/// Formats a number, such as a length, for a message, with six significant digits.
pub fn shown(number: f64) -> String {
    significant(number, 6)
}

/// Formats a number with `digits` significant digits and no trailing zeros: as a decimal from 1e-4
/// up to 1e9, and otherwise with a power of ten. A decimal keeps all digits of its integer part.
pub fn significant(number: f64, digits: usize) -> String {
    let rounded = format!("{number:.*e}", digits.saturating_sub(1));
    let Some((mantissa, power)) = rounded.split_once('e') else { return rounded };
    let trimmed = |decimals: &str| match decimals.contains('.') {
        true => decimals.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => decimals.to_owned(),
    };
    match power.parse::<i32>() {
        Ok(power @ -4..9) => {
            let decimals = usize::try_from(digits as i32 - 1 - power).unwrap_or(0);
            trimmed(&format!("{number:.decimals$}"))
        }
        _ => format!("{}e{power}", trimmed(mantissa)),
    }
}

/// The isovalue `c`. It is stored as an integer n, which stands for n + 1/2 on the scale of the
/// field.
///
/// A sample is inside the fluid when it is greater than [`threshold`](Self::threshold). No sample
/// can be equal to `threshold + 1/2`, so no vertex ever falls on a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Isovalue(u16);

impl Isovalue {
    /// The representable isovalue nearest to `c`.
    ///
    /// # Errors
    /// [`UnitError::Isovalue`] unless 0 < `c` < 1.
    pub fn new(c: f64) -> Result<Self, UnitError> {
        if !(c > 0.0 && c < 1.0) {
            return Err(UnitError::Isovalue(c));
        }
        Ok(Self(((c * f64::from(FULL)) as u16).min(FULL - 1)))
    }

    /// The isovalue at which the surface of a smoothed field has no bias, as a percentage of the
    /// interior plateau. It was measured on surfaces of known bodies, and is an average over the
    /// indicators counting and symmetry, cells of 0.5 to 1.5 spacings, and offsets between the
    /// particles' lattice and the grid (`tools/evaluate isovalue`).
    pub const PLATEAU_PERCENT: u16 = 47;

    /// The isovalue for a plateau.
    #[must_use]
    pub fn of_plateau(plateau: u16) -> Self {
        Self((u32::from(plateau) * u32::from(Self::PLATEAU_PERCENT) / 100) as u16)
    }

    /// The isovalue of a field of distances. It stands for a distance of 0: see
    /// [`distance`](crate::field::distance).
    pub const ZERO_DISTANCE: Self = Self(u16::MAX / 2);

    /// The greatest field value that is outside the fluid.
    #[must_use]
    pub fn threshold(self) -> u16 {
        self.0
    }

    /// The isovalue `c`, between 0 and 1.
    #[must_use]
    pub fn value(self) -> f64 {
        (f64::from(self.0) + 0.5) / f64::from(FULL)
    }
}

/// The standard deviation of the Gaussian, in cells.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct Sigma(f64);

impl Sigma {
    /// The maximum width: wider filters erase all details of a particle fluid.
    pub const MAX: f64 = 10.0;

    /// A standard deviation in cells.
    ///
    /// # Errors
    /// [`UnitError::Sigma`] unless 0 < `cells` <= [`Self::MAX`].
    pub fn new(cells: f64) -> Result<Self, UnitError> {
        if cells > 0.0 && cells <= Self::MAX {
            Ok(Self(cells))
        } else {
            Err(UnitError::Sigma(cells))
        }
    }

    /// A standard deviation in cells, limited to the range from one cell to [`Self::MAX`]; one cell
    /// for `None`. If `cells` is proportional to the spacing, the Gaussian smooths out the
    /// particles' lattice, and the lattice's offset from the grid, at every cell size.
    #[must_use]
    pub fn at_least_a_cell(cells: Option<f64>) -> Self {
        Self(cells.unwrap_or(1.0).clamp(1.0, Self::MAX))
    }

    /// The standard deviation in cells.
    #[must_use]
    pub fn cells(self) -> f64 {
        self.0
    }

    /// The narrower Gaussian of the detail step (section 6.2).
    #[must_use]
    pub fn half(self) -> Self {
        Self(self.0 / 2.0)
    }
}

/// The smoothing width, in particle spacings: particles within this width merge into one surface.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct Smooth(f64);

impl Smooth {
    /// The minimum width: a smaller width leaves single particles visible everywhere.
    pub const LEAST: f64 = 0.8;
    /// The maximum width: a greater width leaves only the bulk.
    pub const MOST: f64 = 4.0;

    /// The default, a width that suits most fluids.
    pub const DEFAULT: Self = Self(1.6);

    /// A width in spacings.
    ///
    /// # Errors
    /// [`UnitError::Smooth`] unless [`Self::LEAST`] <= `spacings` <= [`Self::MOST`].
    pub fn new(spacings: f64) -> Result<Self, UnitError> {
        let fits = (Self::LEAST..=Self::MOST).contains(&spacings);
        if fits { Ok(Self(spacings)) } else { Err(UnitError::Smooth(spacings)) }
    }

    /// The width in spacings.
    #[must_use]
    pub fn spacings(self) -> f64 {
        self.0
    }
}

/// The maximum distance, in spacings, between neighbouring particles of a sheet or filament that
/// does not tear.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SheetStretch(Option<f64>);

impl SheetStretch {
    /// The minimum distance: at smaller distances, the drops around single particles touch.
    pub const LEAST: f64 = 1.0;
    /// The maximum distance: at greater distances, spray would look like sheets.
    pub const MOST: f64 = 3.0;

    /// The default: sheets stretched to twice the spacing stay whole.
    pub const DEFAULT: Self = Self(Some(2.15));

    /// A distance in spacings; 0 turns sheets off.
    ///
    /// # Errors
    /// [`UnitError::SheetStretch`] unless it is 0, or from [`Self::LEAST`] to [`Self::MOST`].
    pub fn new(spacings: f64) -> Result<Self, UnitError> {
        let fits = (Self::LEAST..=Self::MOST).contains(&spacings);
        match spacings {
            0.0 => Ok(Self(None)),
            _ if fits => Ok(Self(Some(spacings))),
            _ => Err(UnitError::SheetStretch(spacings)),
        }
    }

    /// The distance in spacings; `None` if sheets are off.
    #[must_use]
    pub fn spacings(self) -> Option<f64> {
        self.0
    }
}

/// The distance, in spacings, between the end of the fluid and a solid; if it is negative, the
/// fluid reaches into the solid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SolidOffset(f64);

impl SolidOffset {
    /// The minimum offset: the field does not continue deeper into a solid.
    pub const LEAST: f64 = -0.5;
    /// The maximum offset.
    pub const MOST: f64 = 2.0;

    /// The default, which hides the gap between the fluid and a solid in pictures. In the mesh,
    /// each cell flattens curved faces and edges of a solid, but the resulting gap is smaller than
    /// this offset.
    pub const DEFAULT: Self = Self(-0.1);

    /// An offset in spacings.
    ///
    /// # Errors
    /// [`UnitError::SolidOffset`] unless it is from [`Self::LEAST`] to [`Self::MOST`].
    pub fn new(spacings: f64) -> Result<Self, UnitError> {
        if (Self::LEAST..=Self::MOST).contains(&spacings) {
            Ok(Self(spacings))
        } else {
            Err(UnitError::SolidOffset(spacings))
        }
    }

    /// The offset in spacings.
    #[must_use]
    pub fn spacings(self) -> f64 {
        self.0
    }
}

/// The maximum distance, in cells, between a simplified surface and the original, measured in both
/// directions.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct Tolerance(f64);

impl Tolerance {
    /// The maximum tolerance: chunks are simplified one by one, and must be much wider than the
    /// tolerance.
    pub const MAX: f64 = 4.0;

    /// A tolerance in cells.
    ///
    /// # Errors
    /// [`UnitError::Tolerance`] unless 0 < `cells` <= [`Self::MAX`].
    pub fn new(cells: f64) -> Result<Self, UnitError> {
        if cells > 0.0 && cells <= Self::MAX {
            Ok(Self(cells))
        } else {
            Err(UnitError::Tolerance(cells))
        }
    }

    /// The tolerance in cells.
    pub fn cells(self) -> f64 {
        self.0
    }
}

/// `mu0`: the mean number of particles in the full cells of the calibration frame (eq. 4), which is
/// frame 0 in the paper. It need not be an integer.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct MeanCount(f64);

impl MeanCount {
    /// The maximum: counts are stored in 16 bits.
    pub const MAX: f64 = u16::MAX as f64;

    /// A mean number of particles per cell.
    ///
    /// # Errors
    /// [`UnitError::MeanCount`] unless 0 < `mean` <= [`Self::MAX`].
    pub fn new(mean: f64) -> Result<Self, UnitError> {
        if mean > 0.0 && mean <= Self::MAX {
            Ok(Self(mean))
        } else {
            Err(UnitError::MeanCount(mean))
        }
    }

    /// Eq. 4: `particles` / `full_cells`.
    ///
    /// # Errors
    /// [`UnitError::MeanCount`] if there are no particles or no full cells, or if the mean exceeds
    /// [`Self::MAX`].
    pub fn measured(particles: u64, full_cells: u64) -> Result<Self, UnitError> {
        Self::new(particles as f64 / full_cells as f64)
    }

    /// The mean, in particles per cell.
    #[must_use]
    pub fn particles(self) -> f64 {
        self.0
    }
}

/// The maximum resident memory of a run, in bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct MemoryBudget(pub u64);
