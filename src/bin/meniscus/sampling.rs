//! Options that say how particles are sampled: cells, walls, indicator.

use clap::{Args, ValueEnum};
use meniscus::error::UnitError;
use meniscus::{Error, IndicatorKind, Reconstruction};

#[derive(Args)]
pub struct SamplingOptions {
    /// Distance between neighbouring particles.
    ///
    /// By default it is taken from the file or the scene beside it, else estimated.
    #[arg(
        long,
        value_name = "LENGTH",
        conflicts_with = "radius",
        allow_negative_numbers = true,
        help_heading = "Input"
    )]
    spacing: Option<f64>,
    /// Half of the spacing.
    #[arg(
        long,
        value_name = "LENGTH",
        allow_negative_numbers = true,
        help_heading = "Input",
        hide_short_help = true
    )]
    radius: Option<f64>,
    /// Edge of a cell.
    #[arg(
        long,
        value_name = "LENGTH",
        conflicts_with = "cell",
        allow_negative_numbers = true,
        help_heading = "Surface",
        hide_short_help = true
    )]
    cell_size: Option<f64>,
    /// Edge of a cell, in spacings [default: 0.5].
    ///
    /// The default for --indicator counting and symmetry is 0.6667.
    #[arg(long, value_name = "RATIO", allow_negative_numbers = true, help_heading = "Surface")]
    cell: Option<f64>,
    /// A corner of the grid's cells [default: 0,0,0].
    #[arg(long, value_name = "X,Y,Z", value_parser = numbers::<3>, allow_hyphen_values = true, help_heading = "Surface", hide_short_help = true)]
    origin: Option<[f64; 3]>,
    /// The type of particles, of an input that holds several [default: gas, or fluid].
    ///
    /// PartType1 of a SWIFT or GADGET snapshot, an array of PySPH, or a species of openPMD.
    #[arg(long, value_name = "NAME", help_heading = "Input", hide_short_help = true)]
    particle_type: Option<String>,
    /// A tank with walls [default: unbounded].
    ///
    /// Particles outside are not counted. `-` for both ends of an axis leaves it without walls.
    #[arg(long, value_name = "X0,Y0,Z0,X1,Y1,Z1", value_parser = faces, allow_hyphen_values = true, help_heading = "Input")]
    domain: Option<Faces>,
    /// A box beyond whose faces the fluid repeats itself.
    ///
    /// `-` for both ends of an axis leaves it open: 0,-,0,1,-,1 is periodic along x and z. Beyond a face the fluid goes on as it does
    /// behind the opposite one. Particles on an upper face count as on the lower one; others outside are refused.
    #[arg(long, value_name = "X0,Y0,Z0,X1,Y1,Z1", value_parser = faces, allow_hyphen_values = true, help_heading = "Input")]
    periodic: Option<Faces>,
    /// How a cell's share of fluid is told from its particles [default: cloud].
    #[arg(long, value_enum, help_heading = "Surface", hide_short_help = true)]
    indicator: Option<IndicatorName>,
    /// Mean number of particles in a full cell, for counting [default: measured].
    #[arg(
        long,
        value_name = "VALUE",
        allow_negative_numbers = true,
        help_heading = "Surface",
        hide_short_help = true
    )]
    mu0: Option<f64>,
    /// Leave out particles that are not finite or too far away, and count them.
    #[arg(long, help_heading = "Input", hide_short_help = true)]
    skip_invalid: bool,
}

/// Both ends of each axis of a box; `None` where it is open.
type Faces = [Option<[f64; 2]>; 3];

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum IndicatorName {
    Symmetry,
    Counting,
    Cloud,
}

fn numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let values: Result<Vec<f64>, _> = text.split(',').map(|part| part.trim().parse()).collect();
    let values = values.map_err(|e| e.to_string())?;
    values.try_into().map_err(|v: Vec<f64>| format!("{N} numbers with commas between, not {}", v.len()))
}

/// Six ends, of which both of an axis may be `-`.
fn faces(text: &str) -> Result<Faces, String> {
    let end = |part: &str| match part.trim() {
        "-" => Ok(None),
        number => number.parse().map(Some).map_err(|e| format!("{number:?}: {e}")),
    };
    let ends: Vec<Option<f64>> = text.split(',').map(end).collect::<Result<_, String>>()?;
    let [x0, y0, z0, x1, y1, z1] = ends[..] else {
        return Err(format!("6 numbers with commas between, not {}", ends.len()));
    };
    let axis = |(name, ends)| match ends {
        (Some(lo), Some(hi)) => Ok(Some([lo, hi])),
        (None, None) => Ok(None),
        _ => Err(format!("both ends of {name} are numbers, or both are -")),
    };
    Ok([axis(("x", (x0, x1)))?, axis(("y", (y0, y1)))?, axis(("z", (z0, z1)))?])
}

impl SamplingOptions {
    /// Asks for particles to be sampled so.
    pub fn request(&self, mut request: Reconstruction) -> Result<Reconstruction, Error> {
        if let Some(radius) = self.radius {
            if !(radius.is_finite() && radius > 0.0) {
                return Err(UnitError::Length { what: "--radius", value: radius }.into());
            }
            request = request.spacing(2.0 * radius);
        }
        if let Some(spacing) = self.spacing {
            request = request.spacing(spacing);
        }
        if let Some(size) = self.cell_size {
            request = request.cell_size(size);
        }
        if let Some(ratio) = self.cell {
            request = request.cell(ratio);
        }
        if let Some(corner) = self.origin {
            request = request.origin(corner);
        }
        if let Some(faces) = self.domain {
            let walls = faces.map(|walls| walls.unwrap_or([f64::NEG_INFINITY, f64::INFINITY]));
            request = request.domain(walls.map(|[lo, _]| lo), walls.map(|[_, hi]| hi));
        }
        if let Some(faces) = self.periodic {
            request = request.periodic(faces);
        }
        if let Some(indicator) = self.indicator {
            request = request.indicator(match indicator {
                IndicatorName::Cloud => IndicatorKind::Cloud,
                IndicatorName::Counting => IndicatorKind::Counting,
                IndicatorName::Symmetry => IndicatorKind::Symmetry,
            });
        }
        if let Some(name) = &self.particle_type {
            request = request.particle_type(name);
        }
        if let Some(mean) = self.mu0 {
            request = request.mu0(mean);
        }
        Ok(if self.skip_invalid { request.skip_invalid() } else { request })
    }
}
