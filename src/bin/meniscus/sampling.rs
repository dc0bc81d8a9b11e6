//! Options that say how particles are sampled: cells, walls, indicator; and where the spacing comes from.

use std::path::Path;

use clap::{Args, ValueEnum};
use glam::DVec3;
use meniscus::brick::{Census, InvalidParticles};
use meniscus::error::Error;
use meniscus::field::indicator::{IndicatorKind, IndicatorRequest};
use meniscus::field::spacing::{self, Spacings};
use meniscus::frame::{FieldRequest, FrameError, Resources, Sampling, Surfacing};
use meniscus::grid::units::{MeanCount, positive_length, shown};
use meniscus::grid::{Domain, DomainError, Grid};
use meniscus::io::ParticleFile;
use meniscus::io::scene::spacing_beside;
use meniscus::particles::Particles;
use meniscus::simulation::frozen::on_sound_grid;

use crate::run::Notes;

#[derive(Args)]
pub struct SamplingOptions {
    /// Distance between neighbouring particles [default: from the file or the scene beside it, else estimated].
    #[arg(long, value_name = "LENGTH", conflicts_with = "radius", allow_negative_numbers = true)]
    spacing: Option<f64>,
    /// Half of the spacing.
    #[arg(long, value_name = "LENGTH", allow_negative_numbers = true)]
    radius: Option<f64>,
    /// Edge of a cell.
    #[arg(long, value_name = "LENGTH", conflicts_with = "cell", allow_negative_numbers = true)]
    cell_size: Option<f64>,
    /// Edge of a cell, times the spacing [default: 0.5, for --indicator counting and symmetry 0.6667].
    #[arg(long, value_name = "RATIO", allow_negative_numbers = true)]
    cell: Option<f64>,
    /// A corner of the grid's cells [default: 0,0,0].
    #[arg(long, value_name = "X,Y,Z", value_parser = numbers::<3>, allow_hyphen_values = true)]
    origin: Option<[f64; 3]>,
    /// A tank with walls; particles outside are not counted [default: unbounded].
    #[arg(long, value_name = "X0,Y0,Z0,X1,Y1,Z1", value_parser = numbers::<6>, allow_hyphen_values = true)]
    domain: Option<[f64; 6]>,
    /// How a cell's share of fluid is told from its particles [default: cloud].
    #[arg(long, value_enum)]
    indicator: Option<IndicatorName>,
    /// Mean number of particles in a full cell, for counting [default: measured].
    #[arg(long, value_name = "VALUE", allow_negative_numbers = true)]
    mu0: Option<f64>,
    /// Drop particles that are not finite or too far away, and count them.
    #[arg(long)]
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

/// What the options ask for, as far as it can be known without the particles.
pub struct SamplingRequest {
    pub field: FieldRequest,
    invalid: InvalidParticles,
    /// The grid's origin, where it is given.
    origin: Option<DVec3>,
    walls: Option<[DVec3; 2]>,
    spacing: Option<f64>,
    cell: Cell,
}

/// How the edge of a cell is given.
#[derive(Clone, Copy)]
enum Cell {
    Size(f64),
    /// Times the spacing.
    Ratio(f64),
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
        let default_cell = if kind == IndicatorKind::Cloud { CELL } else { PAPER_CELL };
        let cell = match self.cell_size {
            Some(size) => Cell::Size(positive_length("--cell-size", size)?),
            None => Cell::Ratio(positive_length("--cell", self.cell.unwrap_or(default_cell))?),
        };
        let origin = self.origin.map(DVec3::from);
        let walls =
            self.domain.map(|[x0, y0, z0, x1, y1, z1]| [DVec3::new(x0, y0, z0), DVec3::new(x1, y1, z1)]);
        // Whether origin and corners are any good does not depend on the cells' size.
        let unit = Grid::new(origin.unwrap_or_default(), 1.0)?;
        if let Some([lo, hi]) = walls
            && let Err(error @ DomainError::Corners) = Domain::new(&unit, lo, hi)
        {
            return Err(error.into());
        }
        let invalid = if self.skip_invalid { InvalidParticles::Skip } else { InvalidParticles::Refuse };
        Ok(SamplingRequest { field, invalid, origin, walls, spacing, cell })
    }
}

/// The edge of a cell, and what it was taken from.
pub struct Cells {
    pub size: f64,
    pub spacing: Option<f64>,
    /// Where the spacing comes from, where it matters.
    pub source: Option<String>,
    /// Why it may be wrong.
    pub doubt: Option<String>,
}

impl Cells {
    fn describe(&self) -> String {
        let size = format!("cell size {}", shown(self.size));
        match (self.spacing, &self.source) {
            (Some(spacing), Some(source)) => format!("spacing {} ({source}), {size}", shown(spacing)),
            _ => format!("spacing not known, taken to be the cell size; {size}"),
        }
    }
}

/// By how much the spacing of a scene may differ from what its particles look like.
const DOUBTFUL: f64 = 2.0;

/// Why a spacing may not be that of the particles: a scene that lies beside them need not be theirs, and they may be of two.
fn doubt_of(spacing: f64, scene: Option<&Path>, found: Spacings) -> Option<String> {
    let Spacings { mean, two } = found;
    if let Some([one, other]) = two {
        return Some(format!(
            "the particles are of two resolutions, {} and {} apart, and all are taken to be {} apart; --spacing says another",
            shown(one),
            shown(other),
            shown(spacing)
        ));
    }
    let scene = scene.filter(|_| !(1.0 / DOUBTFUL..=DOUBTFUL).contains(&(spacing / mean)))?;
    Some(format!(
        "{} says that particles are {} apart, by their density they are {}: --spacing says which",
        scene.display(),
        shown(spacing),
        shown(mean)
    ))
}

/// Edge of a cell in spacings. In those of two thirds single drops are angular and hold more or less by where they lie; these take
/// hardly longer, for the surface is made in the same wide cells. Renders of single drops want half as much.
pub const CELL: f64 = 0.5;
/// The same for the paper's indicators, of which symmetry does not bear half of one.
const PAPER_CELL: f64 = 2.0 / 3.0;

impl SamplingRequest {
    /// How to sample the particles of `file`, whose attributes numbered in `carried` go to the vertices. A grid that nobody asked to
    /// be where it is may be moved to suit a lattice, as for the first frame of a simulation.
    pub fn sampling(
        &self,
        path: &Path,
        file: &ParticleFile,
        carried: Vec<usize>,
        resources: Resources,
        notes: &Notes,
    ) -> Result<Sampling, Error> {
        let cells = self.cells(path, file)?;
        let indicator = self.field.indicator();
        let by = indicator.map_or(String::new(), |asked| format!(", indicator {}", asked.kind.name()));
        notes.say(format!("{}{by}", cells.describe()));
        cells.doubt.iter().for_each(|doubt| notes.say(format!("warning: {doubt}")));
        let grid = self.grid(cells.size)?;
        let sampling = self.sampling_on(grid, self.field, cells.spacing, carried, resources)?;
        if self.origin.is_some() {
            return Ok(sampling);
        }
        let sound = on_sound_grid(&file.particles, sampling);
        if sound.grid != grid {
            let origin = sound.grid.origin().to_array().map(shown).join(",");
            notes.say(format!("all particles stand on a lattice: the grid's origin is {origin}"));
        }
        Ok(sound)
    }

    /// The same on a grid that is known.
    pub fn sampling_on(
        &self,
        grid: Grid,
        field: FieldRequest,
        spacing: Option<f64>,
        carried: Vec<usize>,
        resources: Resources,
    ) -> Result<Sampling, Error> {
        Ok(Sampling {
            grid,
            domain: self.walls.map(|[lo, hi]| Domain::new(&grid, lo, hi)).transpose()?,
            field,
            invalid: self.invalid,
            side: field.brick_side(),
            carried,
            spacing,
            resources,
        })
    }

    /// The grid that was asked for, with cells of some size.
    pub fn grid(&self, cell_size: f64) -> Result<Grid, Error> {
        Ok(Grid::new(self.origin.unwrap_or_default(), cell_size)?)
    }

    /// The edge of a cell, the spacing, and where that comes from. Only where cells have a size of their own and no kernels are
    /// drawn can it be unknown: the filters are then as wide as for particles a cell apart.
    pub fn cells(&self, path: &Path, file: &ParticleFile) -> Result<Cells, Error> {
        let mut doubt = None;
        let (spacing, source) = if let Some(spacing) = self.spacing {
            (spacing, "as given".to_owned())
        } else if let Some(spacing) = file.spacing {
            (spacing, "from the file".to_owned())
        } else if let Some((spacing, scene)) = spacing_beside(path) {
            doubt =
                spacing::spacings(&file.particles).and_then(|found| doubt_of(spacing, Some(&scene), found));
            (spacing, format!("from {}", scene.display()))
        } else if file.particles.is_empty() {
            let fault = FrameError::NoParticles(Census::default());
            return Err(Error::Frame { path: path.to_owned(), fault });
        } else {
            let found = spacing::spacings(&file.particles);
            let estimate = found.map(|found| found.mean);
            doubt = found.and_then(|found| doubt_of(found.mean, None, found));
            let estimate = match (self.cell, self.field) {
                (Cell::Size(size), FieldRequest::Indicator(asked)) => {
                    // Nobody asks for cells that are refused: then it was spray that was estimated.
                    let grid = self.grid(size)?;
                    let fits = |&spacing: &f64| {
                        Surfacing::PLAIN.refuse_too_fine(asked, Some(spacing), &grid).is_ok()
                    };
                    let Some(spacing) = estimate.filter(fits) else {
                        return Ok(Cells { size, spacing: None, source: None, doubt: None });
                    };
                    Some(spacing)
                }
                _ => estimate,
            };
            let none = || Error::NoSpacing { path: path.to_owned(), particles: file.particles.len() };
            (estimate.ok_or_else(none)?, "estimated from the particles".to_owned())
        };
        let size = match self.cell {
            Cell::Size(size) => size,
            Cell::Ratio(ratio) => positive_length("the cell size", ratio * spacing)?,
        };
        Ok(Cells { size, spacing: Some(spacing), source: Some(source), doubt })
    }
}
