//! `meniscus reconstruct`: one frame of particles to one mesh.

use std::path::{Path, PathBuf};

use bytesize::ByteSize;
use clap::{Args, ValueEnum};
use glam::DVec3;
use meniscus::brick::{BrickSide, Census, InvalidParticles};
use meniscus::error::Error;
use meniscus::frame::{self, Detail, Frame, FrameError, Laps, Normals, Sampling, Surface, Surfacing};
use meniscus::grid::{Domain, Grid};
use meniscus::io::input::open_particles;
use meniscus::io::output::{MeshFormat, MeshOutput, Replace};
use meniscus::io::scene::spacing_beside;
use meniscus::io::{CoordinateWidth, ParticleFile, WriteError};
use meniscus::memory::{default_budget, peak_resident};
use meniscus::particles::{Particles, velocity_attribute};
use meniscus::plateau::Plateau;
use meniscus::stage::indicator::Indicator;
use meniscus::units::{Isovalue, MeanCount, MemoryBudget, Sigma, positive_length};
use serde_json::json;

use crate::Verdict;
use crate::interrupt::remove_on_interrupt;

#[derive(Args)]
pub struct Options {
    /// The particles: .bgeo, .vtk, .ply, .npy, .csv, .xyz or .bi4, gzipped or not.
    input: PathBuf,
    /// The mesh: .ply, .obj, .vtk, .vtp or .stl.
    #[arg(short, long)]
    output: PathBuf,
    /// Distance between neighbouring particles [default: from the file or the scene beside it, else estimated].
    #[arg(long, value_name = "LENGTH", conflicts_with = "radius", allow_negative_numbers = true)]
    spacing: Option<f64>,
    /// Half of the spacing.
    #[arg(long, value_name = "LENGTH", allow_negative_numbers = true)]
    radius: Option<f64>,
    /// Edge of a cell.
    #[arg(long, value_name = "LENGTH", conflicts_with = "cell", allow_negative_numbers = true)]
    cell_size: Option<f64>,
    /// Edge of a cell, times the spacing [default: 1.0].
    #[arg(long, value_name = "RATIO", allow_negative_numbers = true)]
    cell: Option<f64>,
    /// A corner of the grid's cells.
    #[arg(long, value_name = "X,Y,Z", value_parser = numbers::<3>, default_value = "0,0,0", allow_hyphen_values = true)]
    origin: [f64; 3],
    /// A tank with walls; particles outside are not counted [default: unbounded].
    #[arg(long, value_name = "X0,Y0,Z0,X1,Y1,Z1", value_parser = numbers::<6>, allow_hyphen_values = true)]
    domain: Option<[f64; 6]>,
    /// How a cell's share of fluid is told from its particles.
    #[arg(long, value_enum, default_value_t = IndicatorName::Symmetry)]
    indicator: IndicatorName,
    /// Width of the Gaussian.
    #[arg(long, value_name = "CELLS", default_value_t = 1.0, allow_negative_numbers = true)]
    sigma: f64,
    /// Where the surface is, between 0 and 1; auto: half of the field's interior plateau.
    #[arg(long, value_name = "VALUE|auto", value_parser = isovalue, default_value = "auto")]
    iso: IsoOption,
    /// Mean number of particles in a full cell, for counting [default: measured].
    #[arg(long, value_name = "VALUE", allow_negative_numbers = true)]
    mu0: Option<f64>,
    /// Recover details that smoothing loses, such as drops.
    #[arg(long)]
    detail: bool,
    /// Vertex normals, from the field's gradient.
    #[arg(long)]
    normals: bool,
    /// Particle attributes to carry to the vertices, or none [default: velocity, where the format can hold it].
    #[arg(long, value_name = "NAME,...", value_delimiter = ',')]
    attributes: Option<Vec<String>>,
    /// Drop particles that are not finite or too far away, and count them.
    #[arg(long)]
    skip_invalid: bool,
    /// Where the stages run.
    #[arg(long, value_enum, default_value_t = BackendName::Auto)]
    backend: BackendName,
    /// Threads to use [default: all cores].
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    /// Memory to use, as 512MiB or 8GiB [default: three quarters of what is available].
    #[arg(long, value_name = "SIZE")]
    memory: Option<ByteSize>,
    /// Replace an output that exists.
    #[arg(long)]
    overwrite: bool,
    /// Say what would be done and what it would take, and do nothing.
    #[arg(long)]
    dry_run: bool,
    /// Append a JSON record of counts, times and settings to this file.
    #[arg(long, value_name = "FILE")]
    stats: Option<PathBuf>,
    /// Say nothing but errors.
    #[arg(short, long, conflicts_with = "verbose")]
    quiet: bool,
    /// Say more.
    #[arg(short, long)]
    verbose: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum IndicatorName {
    Symmetry,
    Counting,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum BackendName {
    /// The best there is.
    Auto,
    /// All cores of this machine.
    Cpu,
}

#[derive(Clone, Copy)]
enum IsoOption {
    Auto,
    Value(Isovalue),
}

fn isovalue(text: &str) -> Result<IsoOption, String> {
    if text == "auto" {
        return Ok(IsoOption::Auto);
    }
    let value: f64 = text.parse().map_err(|_| "a number between 0 and 1, or auto".to_owned())?;
    Isovalue::new(value).map(IsoOption::Value).map_err(|e| e.to_string())
}

fn numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let values: Result<Vec<f64>, _> = text.split(',').map(|part| part.trim().parse()).collect();
    let values = values.map_err(|e| e.to_string())?;
    values.try_into().map_err(|v: Vec<f64>| format!("{N} numbers with commas between, not {}", v.len()))
}

/// The notes that a run makes for people, on standard error.
struct Notes {
    quiet: bool,
    verbose: bool,
}

impl Notes {
    fn say(&self, text: impl AsRef<str>) {
        if !self.quiet {
            eprintln!("{}", text.as_ref());
        }
    }

    fn detail(&self, text: impl AsRef<str>) {
        if self.verbose {
            eprintln!("{}", text.as_ref());
        }
    }
}

/// Everything that can be refused without looking at the particles.
struct Request {
    sigma: Sigma,
    indicator: Indicator,
    cell: Cell,
}

/// How the edge of a cell is given.
enum Cell {
    Size(f64),
    /// Times a spacing, or the one still to be found.
    Ratio(f64, Option<f64>),
}

impl Options {
    fn validate(&self) -> Result<Request, Error> {
        let sigma = Sigma::new(self.sigma)?;
        let indicator = match (self.indicator, self.mu0) {
            (IndicatorName::Counting, mu0) => {
                Indicator::Counting { mean: mu0.map(MeanCount::new).transpose()? }
            }
            (IndicatorName::Symmetry, None) => Indicator::Symmetry,
            (IndicatorName::Symmetry, Some(_)) => {
                return Err(Error::Request("--mu0 goes with --indicator counting".into()));
            }
        };
        let spacing = match (self.spacing, self.radius) {
            (Some(spacing), _) => Some(positive_length("--spacing", spacing)?),
            (None, Some(radius)) => Some(2.0 * positive_length("--radius", radius)?),
            (None, None) => None,
        };
        let cell = match self.cell_size {
            Some(size) => Cell::Size(positive_length("--cell-size", size)?),
            None => Cell::Ratio(positive_length("--cell", self.cell.unwrap_or(1.0))?, spacing),
        };
        // Walls and origin do not depend on the cell size in what can be wrong with them.
        let unit = Grid::new(DVec3::from(self.origin), 1.0)?;
        if let Some([x0, y0, z0, x1, y1, z1]) = self.domain {
            let (lo, hi) = (DVec3::new(x0, y0, z0), DVec3::new(x1, y1, z1));
            if let Err(error @ meniscus::grid::DomainError::Corners) = Domain::new(&unit, lo, hi) {
                return Err(error.into());
            }
        }
        if self.threads == Some(0) {
            return Err(Error::Request("--threads must be at least 1".into()));
        }
        Ok(Request { sigma, indicator, cell })
    }

    /// What is asked for and the format cannot hold.
    fn validate_format(&self, format: MeshFormat) -> Result<(), Error> {
        let refuse = |what: &str| {
            Err(Error::Request(format!("{}: {format} cannot hold {what}", self.output.display())))
        };
        if self.normals && !format.holds_normals() {
            return refuse("vertex normals");
        }
        if self.attributes.as_ref().is_some_and(|a| a != &["none"]) && !format.holds_attributes() {
            return refuse("vertex attributes");
        }
        Ok(())
    }

    fn replace(&self) -> Replace {
        if self.overwrite { Replace::Allow } else { Replace::Refuse }
    }

    /// The numbers of the attributes to carry.
    fn carried(&self, file: &ParticleFile, format: MeshFormat) -> Result<Vec<usize>, Error> {
        let attributes = file.particles.attributes();
        let velocity = velocity_attribute(attributes);
        let Some(names) = &self.attributes else {
            return Ok(velocity.filter(|_| format.holds_attributes()).into_iter().collect());
        };
        if names == &["none"] {
            return Ok(Vec::new());
        }
        let mut carried = Vec::new();
        for name in names {
            let named = attributes.iter().position(|a| a.name == *name);
            let found = named.or(velocity.filter(|_| name == "velocity")).ok_or_else(|| {
                let known: Vec<_> = attributes.iter().map(|a| a.name.as_str()).collect();
                let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
                Error::Request(format!("{}: no attribute {name:?}; there are: {known}", self.input.display()))
            })?;
            if !carried.contains(&found) {
                carried.push(found);
            }
        }
        Ok(carried)
    }

    fn sampling(
        &self,
        request: &Request,
        file: &ParticleFile,
        format: MeshFormat,
        cell_size: f64,
        budget: MemoryBudget,
    ) -> Result<Sampling, Error> {
        let grid = Grid::new(DVec3::from(self.origin), cell_size)?;
        let domain = self.domain.map(|[x0, y0, z0, x1, y1, z1]| {
            Domain::new(&grid, DVec3::new(x0, y0, z0), DVec3::new(x1, y1, z1))
        });
        Ok(Sampling {
            grid,
            domain: domain.transpose()?,
            indicator: request.indicator,
            invalid: if self.skip_invalid { InvalidParticles::Skip } else { InvalidParticles::Refuse },
            side: BrickSide::default(),
            carried: self.carried(file, format)?,
            budget,
        })
    }
}

/// Runs the command.
pub fn run(options: &Options) -> Result<Verdict, Error> {
    let notes = Notes { quiet: options.quiet, verbose: options.verbose };
    let request = options.validate()?;
    if let Some(threads) = options.threads {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        pool.build_global().map_err(|e| Error::Request(format!("--threads {threads}: {e}")))?;
    }
    let budget = options.memory.map_or_else(default_budget, |size| MemoryBudget(size.as_u64()));
    let stats = options.stats.as_deref().map(open_stats).transpose()?;
    refuse_same_file(&options.input, &options.output)?;
    let output = MeshOutput::prepare(&options.output, options.replace())?;
    remove_on_interrupt(output.temporary());
    let format = output.format();
    options.validate_format(format)?;

    let mut laps = Laps::default();
    let file = open_particles(&options.input)?;
    laps.lap("open");
    let particles = file.particles.len();
    notes.say(format!("{}: {particles} particles, {}", options.input.display(), file.format));
    let cell_size = cell_size(&request.cell, &options.input, &file, &notes)?;
    laps.lap("spacing");
    let sampling = options.sampling(&request, &file, format, cell_size, budget)?;
    let in_file = |fault: FrameError| Error::Frame { path: options.input.clone(), fault };

    if options.dry_run {
        let (census, estimate) = frame::estimate(&file.particles, &sampling).map_err(in_file)?;
        crate::print(&format!(
            "would reconstruct {} particles with cells of {cell_size} into {}\nmemory: about {} ({} particles, {} field, {} mesh at most) of {} allowed",
            census.binned,
            options.output.display(),
            ByteSize(estimate.total()),
            ByteSize(estimate.particles),
            ByteSize(estimate.field),
            ByteSize(estimate.mesh),
            ByteSize(budget.0),
        ))?;
        return Ok(Verdict::Good);
    }

    let frame = Frame::sample(&file.particles, &sampling, &mut laps).map_err(in_file)?;
    // Its pages are of no more use.
    drop(file);
    let census = frame.census();
    report_census(&census, &notes);
    warn_of_faces(&frame, request.indicator, &sampling.grid, &notes);
    let iso = match options.iso {
        IsoOption::Auto => None,
        IsoOption::Value(value) => Some(value),
    };
    let surfacing = Surfacing {
        sigma: request.sigma,
        iso,
        detail: if options.detail { Detail::Recovered } else { Detail::Smoothed },
        normals: if options.normals { Normals::Gradient } else { Normals::None },
    };
    let surface = frame.surface(&surfacing, &mut laps).map_err(in_file)?;
    report_isovalue(&surface, iso, &notes);
    let mean_count = frame.mean_count();
    drop(frame);

    let width = coordinate_width(&surface, cell_size, format, &notes);
    let bytes = output.write(&surface.mesh, width)?;
    remove_on_interrupt(None);
    laps.lap("write");
    let seconds: f64 = laps.seconds().iter().map(|(_, s)| s).sum();
    notes.say(format!(
        "{}: {} vertices, {} triangles, {} in {seconds:.2} s",
        options.output.display(),
        surface.mesh.positions.len(),
        surface.mesh.triangles.len(),
        ByteSize(bytes),
    ));
    for (stage, seconds) in laps.seconds() {
        notes.detail(format!("  {stage:<10} {:>9.1} ms", seconds * 1e3));
    }
    if let Some(mut stats) = stats {
        use std::io::Write;
        let record = json!({
            "input": options.input,
            "output": options.output,
            "particles": particles,
            "binned": census.binned,
            "not_finite": census.not_finite,
            "too_far": census.too_far,
            "outside_domain": census.outside,
            "cell_size": cell_size,
            "origin": options.origin,
            "domain": options.domain,
            "indicator": match options.indicator {
                IndicatorName::Symmetry => "symmetry",
                IndicatorName::Counting => "counting",
            },
            "sigma": options.sigma,
            "isovalue": surface.iso.value(),
            "mu0": mean_count.map(MeanCount::particles),
            "detail": options.detail,
            "vertices": surface.mesh.positions.len(),
            "triangles": surface.mesh.triangles.len(),
            "output_bytes": bytes,
            "seconds": laps.seconds().iter().map(|&(k, v)| (k.to_owned(), json!(v))).collect::<serde_json::Map<_, _>>(),
            "total_seconds": seconds,
            "threads": rayon::current_num_threads(),
            "peak_resident_bytes": peak_resident(),
        });
        let path = options.stats.as_deref().unwrap_or(Path::new("the statistics"));
        writeln!(stats, "{record}").map_err(|e| WriteError::new(path, e))?;
    }
    Ok(Verdict::Good)
}

fn open_stats(path: &Path) -> Result<std::fs::File, Error> {
    let file = std::fs::OpenOptions::new().create(true).append(true).open(path);
    file.map_err(|e| WriteError::new(path, e).into())
}

/// An output that would replace its own input is a slip of the hand.
fn refuse_same_file(input: &Path, output: &Path) -> Result<(), Error> {
    match (input.canonicalize(), output.canonicalize()) {
        (Ok(a), Ok(b)) if a == b => {
            Err(Error::Request(format!("{}: is both the input and the output", output.display())))
        }
        _ => Ok(()),
    }
}

/// The edge of a cell, and a word on where the spacing comes from.
fn cell_size(cell: &Cell, path: &Path, file: &ParticleFile, notes: &Notes) -> Result<f64, Error> {
    let (ratio, spacing) = match *cell {
        Cell::Size(size) => return Ok(size),
        Cell::Ratio(ratio, spacing) => (ratio, spacing),
    };
    let (spacing, source) = if let Some(spacing) = spacing {
        (spacing, "as given".to_owned())
    } else if let Some(spacing) = file.spacing {
        (spacing, "from the file".to_owned())
    } else if let Some((spacing, scene)) = spacing_beside(path) {
        (spacing, format!("from {}", scene.display()))
    } else {
        let particles = file.particles.len();
        let estimate = meniscus::spacing::estimate(&file.particles);
        if particles == 0 {
            let fault = FrameError::NoParticles(Census::default());
            return Err(Error::Frame { path: path.to_owned(), fault });
        }
        let spacing = estimate.ok_or(Error::NoSpacing { path: path.to_owned(), particles })?;
        (spacing, "estimated from the particles".to_owned())
    };
    let size = ratio * spacing;
    notes.say(format!("spacing {spacing:.6} ({source}), cell size {size:.6}"));
    Ok(positive_length("the cell size", size)?)
}

fn report_census(census: &Census, notes: &Notes) {
    for (count, what) in [
        (census.not_finite, "dropped: a coordinate is not finite"),
        (census.too_far, "dropped: beyond the addressable grid"),
        (census.outside, "not counted: outside of the domain"),
    ] {
        if count > 0 {
            notes.say(format!("{count} particles {what}"));
        }
    }
}

/// Particles at random have a mean indicator of 0.44 in cells that hold one, and more in larger ones. Much
/// less means a lattice whose particles lie on the cells' corners, where symmetry sees next to nothing.
fn warn_of_faces(frame: &Frame, indicator: Indicator, grid: &Grid, notes: &Notes) {
    let mean = frame.dif().mean_of_full();
    if indicator == Indicator::Symmetry && mean < 0.2 {
        let shifted = (grid.origin() + grid.cell_size() / 2.0).to_array().map(|x| x.to_string()).join(",");
        notes.say(format!(
            "warning: the particles lie on the corners of cells (mean indicator {mean:.4}), which harms the surface; \
             --origin {shifted} moves the grid off them"
        ));
    }
}

fn report_isovalue(surface: &Surface, given: Option<Isovalue>, notes: &Notes) {
    let fraction = |theta: u16| f64::from(theta) / f64::from(meniscus::units::FULL);
    let iso = surface.iso.value();
    match (surface.plateau, given) {
        (Plateau::Interior { lowest, .. }, Some(given)) if given.threshold() >= lowest => notes.say(format!(
            "warning: isovalue {iso:.4} is above the field's lowest interior value, {:.4}: expect bubbles inside",
            fraction(lowest)
        )),
        (_, Some(_)) => {}
        (Plateau::Interior { median, .. }, None) => {
            notes.say(format!("isovalue {iso:.4}, half of the interior plateau {:.4}", fraction(median)));
        }
        (Plateau::Shallow { greatest }, None) => notes.say(format!(
            "isovalue {iso:.4}, half of the field's greatest value {:.4}: no fluid is deeper than the filters reach",
            fraction(greatest)
        )),
    }
}

/// f64 where f32 would move vertices by more than 1 / 256 of a cell, if the format can.
fn coordinate_width(surface: &Surface, cell_size: f64, format: MeshFormat, notes: &Notes) -> CoordinateWidth {
    let farthest = surface.mesh.positions.iter().flatten().fold(0.0, |far: f64, x| far.max(x.abs()));
    if farthest * f64::from(f32::EPSILON) <= cell_size / 256.0 {
        return CoordinateWidth::F32;
    }
    if format.holds_f64() {
        notes.detail("coordinates are written as f64: f32 is too coarse this far from the origin");
        return CoordinateWidth::F64;
    }
    notes.say(format!(
        "warning: {format} holds coordinates as f32, too coarse this far from the origin; .ply holds f64"
    ));
    CoordinateWidth::F32
}
