//! Options that say how particles are sampled: cells, walls, indicator; and where the spacing comes from.

use std::path::Path;

use clap::{Args, ValueEnum};
use glam::DVec3;
use meniscus::brick::InvalidParticles;
use meniscus::error::Error;
use meniscus::field::indicator::{IndicatorKind, IndicatorRequest};
use meniscus::frame::{Resources, Sampling};
use meniscus::grid::units::{MeanCount, positive_length, shown};
use meniscus::io::ParticleFile;
use meniscus::reconstruction::{CellSize, Cells, ChosenSampling, Doubt, Origin, SamplingRequest};

use crate::run::Notes;

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
    /// For --indicator counting and symmetry 0.6667 is usual.
    #[arg(long, value_name = "RATIO", allow_negative_numbers = true, help_heading = "Surface")]
    cell: Option<f64>,
    /// A corner of the grid's cells [default: 0,0,0].
    #[arg(long, value_name = "X,Y,Z", value_parser = numbers::<3>, allow_hyphen_values = true, help_heading = "Surface", hide_short_help = true)]
    origin: Option<[f64; 3]>,
    /// A tank with walls [default: unbounded].
    ///
    /// Particles outside are not counted.
    #[arg(long, value_name = "X0,Y0,Z0,X1,Y1,Z1", value_parser = numbers::<6>, allow_hyphen_values = true, help_heading = "Input")]
    domain: Option<[f64; 6]>,
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
    /// Drop particles that are not finite or too far away, and count them.
    #[arg(long, help_heading = "Input", hide_short_help = true)]
    skip_invalid: bool,
}

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

impl SamplingOptions {
    /// The first option that was given: none has a meaning for a frame that is sampled already.
    pub fn given(&self) -> Option<&'static str> {
        [
            ("--spacing", self.spacing.is_some()),
            ("--radius", self.radius.is_some()),
            ("--cell-size", self.cell_size.is_some()),
            ("--cell", self.cell.is_some()),
            ("--origin", self.origin.is_some()),
            ("--domain", self.domain.is_some()),
            ("--indicator", self.indicator.is_some()),
            ("--mu0", self.mu0.is_some()),
            ("--skip-invalid", self.skip_invalid),
        ]
        .into_iter()
        .find_map(|(name, given)| given.then_some(name))
    }

    /// What was asked for, by the options' names.
    pub fn settings(&self) -> serde_json::Map<String, serde_json::Value> {
        let indicator = match self.indicator {
            Some(IndicatorName::Symmetry) => "symmetry",
            Some(IndicatorName::Counting) => "counting",
            None | Some(IndicatorName::Cloud) => "cloud",
        };
        let settings = serde_json::json!({
            "spacing": self.spacing.or(self.radius.map(|radius| 2.0 * radius)),
            "cell-size": self.cell_size,
            "cell": self.cell,
            "origin": self.origin,
            "domain": self.domain,
            "indicator": indicator,
            "mu0": self.mu0,
            "skip-invalid": self.skip_invalid,
        });
        match settings {
            serde_json::Value::Object(map) => map,
            _ => unreachable!("an object was made"),
        }
    }

    /// Whether the grid is to stay where it was asked for.
    pub fn origin_given(&self) -> bool {
        self.origin.is_some()
    }

    /// Whether there is one.
    pub fn indicator_given(&self) -> bool {
        self.indicator.is_some()
    }

    /// Whether there is one.
    pub fn mu0_given(&self) -> bool {
        self.mu0.is_some()
    }

    /// Refuses what is wrong whatever the particles are.
    pub fn validate(&self) -> Result<SamplingRequest, Error> {
        let kind = match self.indicator {
            None | Some(IndicatorName::Cloud) => IndicatorKind::Cloud,
            Some(IndicatorName::Counting) => IndicatorKind::Counting,
            Some(IndicatorName::Symmetry) => IndicatorKind::Symmetry,
        };
        if self.mu0.is_some() && !kind.counts() {
            return Err(Error::Request(format!("--mu0 has no meaning for --indicator {}", kind.name())));
        }
        let field = IndicatorRequest { kind, mean: self.mu0.map(MeanCount::new).transpose()? }.into();
        let spacing = match (self.spacing, self.radius) {
            (Some(spacing), _) => Some(positive_length("--spacing", spacing)?),
            (None, Some(radius)) => Some(2.0 * positive_length("--radius", radius)?),
            (None, None) => None,
        };
        let size = self.cell_size.map(|size| positive_length("--cell-size", size).map(CellSize::Length));
        let ratio = self.cell.map(|ratio| positive_length("--cell", ratio).map(CellSize::Spacings));
        let cell = size.or(ratio).transpose()?;
        let origin = self.origin.map(DVec3::from);
        let walls =
            self.domain.map(|[x0, y0, z0, x1, y1, z1]| [DVec3::new(x0, y0, z0), DVec3::new(x1, y1, z1)]);
        let invalid = if self.skip_invalid { InvalidParticles::Skip } else { InvalidParticles::Refuse };
        let request = SamplingRequest { field, invalid, origin, walls, spacing, cell };
        request.validate()?;
        Ok(request)
    }
}

/// Where the particles of a file come from.
pub fn origin<'a>(path: &'a Path, file: &ParticleFile) -> Origin<'a> {
    Origin { path: Some(path), spacing: file.spacing }
}

/// Warns of a spacing that may be wrong.
pub fn say_doubt(cells: &Cells, notes: &Notes) {
    let Some(doubt) = &cells.doubt else { return };
    notes.say(match doubt {
        Doubt::TwoResolutions { .. } => format!("warning: {doubt}; --spacing says another"),
        Doubt::OtherScene { .. } => format!("warning: {doubt}: --spacing says which"),
    });
}

/// How to sample the particles of `file`, whose attributes numbered in `carried` go to the vertices, with what was chosen said.
pub fn sampling(
    request: &SamplingRequest,
    (path, file): (&Path, &ParticleFile),
    carried: Vec<usize>,
    resources: Resources,
    notes: &Notes,
) -> Result<Sampling, Error> {
    let chosen = request.sampling(&file.particles, origin(path, file), carried, resources)?;
    let ChosenSampling { sampling, cells, moved } = chosen;
    let indicator = request.field.indicator();
    let by = indicator.map_or(String::new(), |asked| format!(", indicator {}", asked.kind.name()));
    notes.say(format!("{cells}{by}"));
    say_doubt(&cells, notes);
    if moved {
        let corner = sampling.grid.origin().to_array().map(shown).join(",");
        notes.say(format!("all particles stand on a lattice: the grid's origin is {corner}"));
    }
    Ok(sampling)
}
