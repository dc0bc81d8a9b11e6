//! Numbers that carry a meaning, checked once where they are made.
//!
//! Symbols follow the paper: isovalue `c`, standard deviation `sigma`, particle mean `mu0`.

use thiserror::Error;

/// The value that stands for an indicator of exactly 1 in every integer field.
pub const FULL: u16 = u16::MAX;

/// A number outside its valid range, with the name of its setting.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum UnitError {
    /// An isovalue outside the values of the field.
    #[error("iso must be more than 0 and less than 1, got {0}")]
    Isovalue(f64),
    /// The width of the Gaussian.
    #[error("sigma must be more than 0 and at most {max} cells, got {0}", max = Sigma::MAX)]
    Sigma(f64),
    /// The mean number of particles in a full cell.
    #[error("mu0 must be more than 0 and at most {max}, got {0}", max = MeanCount::MAX)]
    MeanCount(f64),
    /// The smoothing width.
    #[error("smooth must be from {least} to {most} spacings, got {0}", least = Smooth::LEAST, most = Smooth::MOST)]
    Smooth(f64),
    /// The distance up to which particles of sheets are joined.
    #[error("sheets must be 0, or from {least} to {most} spacings, got {0}", least = SheetStretch::LEAST, most = SheetStretch::MOST)]
    SheetStretch(f64),
    /// The distance between the fluid and solids.
    #[error("solid-offset must be from {least} to {most} spacings, got {0}", least = SolidOffset::LEAST, most = SolidOffset::MOST)]
    SolidOffset(f64),
    /// The tolerance of simplification.
    #[error("simplify must be more than 0 and at most {max} cells, got {0}", max = Tolerance::MAX)]
    Tolerance(f64),
    /// The volume of the smallest component that is kept.
    #[error("smallest-component must be positive and finite, got {0}")]
    Volume(f64),
    /// A coordinate that must be finite.
    #[error("{name} must be three finite numbers, got {value}")]
    NotFinite {
        /// The name of the setting.
        name: &'static str,
        /// The one that is not.
        value: f64,
    },
    /// A length that must be positive.
    #[error("{name} must be positive and finite, got {value}")]
    Length {
        /// The name of the setting.
        name: &'static str,
        /// The value that was given.
        value: f64,
    },
}

impl UnitError {
    /// The name of the setting, with which the message begins.
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
/// [`UnitError::Length`] where it is not positive and finite.
pub fn positive_length(name: &'static str, value: f64) -> Result<f64, UnitError> {
    (value.is_finite() && value > 0.0).then_some(value).ok_or(UnitError::Length { name, value })
}

/// A number as people read it, such as a length: in six significant digits.
pub fn shown(number: f64) -> String {
    significant(number, 6)
}

/// A number with `digits` significant digits and no trailing zeros: as a decimal if that is short,
/// else with a power of ten. The integer part is never rounded.
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

/// The isovalue `c`, held as an integer plus one half on the scale of the field.
///
/// A sample is inside the fluid when it is greater than [`threshold`](Self::threshold). No sample
/// can be equal to `threshold + 1/2`, so no vertex ever falls on a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Isovalue(u16);

impl Isovalue {
    /// The isovalue nearest to `c`, 0 < `c` < 1.
    ///
    /// # Errors
    /// [`UnitError::Isovalue`] outside of that range.
    pub fn new(c: f64) -> Result<Self, UnitError> {
        if !(c > 0.0 && c < 1.0) {
            return Err(UnitError::Isovalue(c));
        }
        Ok(Self(((c * f64::from(FULL)) as u16).min(FULL - 1)))
    }

    /// The share of its interior plateau at which a smoothed field crosses the true surface, in
    /// hundredths: what leaves no bias on surfaces of known bodies, on average over both
    /// indicators, cells of 0.5 to 1.5 spacings, and where the particles' lattice lies on the grid
    /// (`tools/evaluate isovalue`).
    pub const PLATEAU_PERCENT: u16 = 47;

    /// The isovalue for a plateau.
    #[must_use]
    pub fn of_plateau(plateau: u16) -> Self {
        Self((u32::from(plateau) * u32::from(Self::PLATEAU_PERCENT) / 100) as u16)
    }

    /// Where distances are 0: see [`distance`](crate::field::distance).
    pub const NO_DISTANCE: Self = Self(u16::MAX / 2);

    /// The greatest field value that is outside.
    #[must_use]
    pub fn threshold(self) -> u16 {
        self.0
    }

    /// `c` as a fraction of 1.
    #[must_use]
    pub fn value(self) -> f64 {
        (f64::from(self.0) + 0.5) / f64::from(FULL)
    }
}

/// The standard deviation of the Gaussian, in cells.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct Sigma(f64);

impl Sigma {
    /// Wider filters erase everything that a particle fluid holds.
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

    /// A standard deviation in cells, but at least one cell. A width that follows from the
    /// particles' spacing removes the traces of their lattice, and of its place on the grid, in
    /// cells of any size.
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

/// How calm the water is: the width under which particles make one surface, in their spacings.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct Smooth(f64);

impl Smooth {
    /// The least width: of less, single particles show all over.
    pub const LEAST: f64 = 0.8;
    /// The greatest width: of more, nothing is left but bulk.
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

/// How far apart neighbouring particles of a sheet or a thread may lie before it tears, in
/// spacings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SheetStretch(Option<f64>);

impl SheetStretch {
    /// The least distance: at less, drops around single particles touch.
    pub const LEAST: f64 = 1.0;
    /// The greatest distance: at more, particles of spray are taken for a sheet's.
    pub const MOST: f64 = 3.0;

    /// The default: sheets hold that are stretched to twice the spacing.
    pub const DEFAULT: Self = Self(Some(2.15));

    /// The distance in spacings; of 0 there are no sheets.
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

    /// The distance in spacings; `None` where there are no sheets.
    #[must_use]
    pub fn spacings(self) -> Option<f64> {
        self.0
    }
}

/// How far before a solid the fluid ends, in spacings: less than 0, it reaches into the solid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SolidOffset(f64);

impl SolidOffset {
    /// The farthest that the fluid reaches into a solid: the field is continued no deeper.
    pub const LEAST: f64 = -0.5;
    /// The widest gap.
    pub const MOST: f64 = 2.0;

    /// The default: in a picture no gap shows between the fluid and a solid. It is more than what
    /// cells round at curved solids and their edges.
    pub const DEFAULT: Self = Self(-0.1);

    /// The offset of so many spacings.
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

/// How far a simplified surface may lie from the one that it replaces, in cells, either way.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct Tolerance(f64);

impl Tolerance {
    /// Chunks are simplified one by one, and must be much wider.
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

/// `mu0`: the mean number of particles in the full cells of the frame that it is measured on (eq.
/// 4; in the paper frame 0). Not an integer.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct MeanCount(f64);

impl MeanCount {
    /// Counts are held in 16 bits.
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
    /// [`UnitError::MeanCount`] where there is no full cell, or more than [`Self::MAX`] particles
    /// in each.
    pub fn measured(particles: u64, full_cells: u64) -> Result<Self, UnitError> {
        Self::new(particles as f64 / full_cells as f64)
    }

    /// The mean in particles per cell.
    #[must_use]
    pub fn particles(self) -> f64 {
        self.0
    }
}

/// The bytes that a run may have resident at once.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct MemoryBudget(pub u64);
