//! Compares rules for the isovalue by the error of the surface, for a lattice of particles at many
//! positions relative to the grid.
//!
//! While the lattice moves along the diagonal of a cell, the indicator takes all of its possible
//! values. The symmetry indicator is 1 if particles are at the cells' centres, and 0 if they are at
//! the cells' corners.

use glam::{DQuat, DVec3, IVec3};
use meniscus::internals::backend::field;
use meniscus::internals::field::calibration::MeasuredCalibration;
use meniscus::internals::field::indicator::{IndicatorKind, SampledDif};
use meniscus::internals::field::recipe::Recipe;
use meniscus::internals::frame::{Engine, FrameError};
use meniscus::internals::grid::Grid;
use meniscus::internals::grid::units::{FULL, Isovalue};
use meniscus::internals::particles::lattice::lattice_origin;
use meniscus::internals::system::timings::Timings;
use rayon::prelude::*;

use crate::accuracy::{CELLS, Errors, SAMPLINGS};
use crate::methods::{COUNTING, grid, sampling, surfacing};
use crate::sample::{Lattice, fill, unit_cube_point};
use crate::shapes::{Solid, solids};
use crate::tables::{Table, figure, mean, signed, worst};
use crate::{Options, Outcome};

/// Rules for the isovalue c.
#[derive(Debug, Clone, Copy)]
enum Rule {
    /// This share of the interior's median value.
    Median(f64),
    /// This share of the interior's mean value.
    Mean(f64),
    /// The value above which the cells have the same total volume as the particles.
    Volume,
    /// The default share of the median, on a grid whose origin suits the lattice.
    Moved,
}

const RULES: [Rule; 9] = [
    Rule::Median(0.4),
    Rule::Median(0.45),
    Rule::Median(0.47),
    Rule::Median(0.5),
    Rule::Median(0.55),
    Rule::Median(0.6),
    Rule::Mean(0.5),
    Rule::Volume,
    Rule::Moved,
];

impl Rule {
    fn name(self) -> String {
        match self {
            Self::Median(share) => format!("{share} median"),
            Self::Mean(share) => format!("{share} mean"),
            Self::Volume => "volume".into(),
            Self::Moved => "default, grid moved".into(),
        }
    }
}

/// The plateau of a frame, and the errors of each rule; `None` if a rule gives no surface.
struct Found {
    plateau: f64,
    errors: Vec<Option<Errors>>,
}

pub fn run(options: &Options) -> Outcome<()> {
    let names: Vec<String> = RULES.into_iter().map(Rule::name).collect();
    let solids = solids(options)?;
    let head = |first: &[&'static str]| -> Vec<String> {
        first.iter().map(|&text| text.to_owned()).chain(names.iter().cloned()).collect()
    };
    let table = |first: &[&'static str]| {
        Table::new(&head(first).iter().map(|text| &**text).collect::<Vec<_>>())
    };
    let mut averages = table(&["indicator", "sampling", "cell / spacing", "lattices"]);
    let mut along = table(&["indicator", "cell / spacing", "place", "plateau"]);
    let cells = options.choose(&CELLS[..], &CELLS[2..3]);
    for indicator in [IndicatorKind::Symmetry, COUNTING] {
        for (sampling, jitter) in SAMPLINGS {
            for &cell in cells {
                let measure = |lattices: &[Lattice]| -> Outcome<Vec<Vec<Found>>> {
                    let of = |solid| {
                        lattices.par_iter().map(|l| found(solid, indicator, cell, l)).collect()
                    };
                    solids.iter().map(of).collect()
                };
                let lattice = |shift| Lattice {
                    shift,
                    turn: DQuat::IDENTITY,
                    jitter,
                    inset: options.inset,
                    seed: 3,
                };
                let about = [indicator.name().into(), sampling.into(), figure(cell)];
                let count = options.choose(8, 2);
                if jitter == 0.0 {
                    let diagonal: Vec<Lattice> = (0..count)
                        .map(|n| {
                            lattice(DVec3::splat(cell * (n as f64 + 0.5) / count as f64) - 0.5)
                        })
                        .collect();
                    let found = measure(&diagonal)?;
                    for n in 0..count {
                        let here: Vec<&Found> = found.iter().map(|solid| &solid[n]).collect();
                        let place = (n as f64 + 0.5) / count as f64;
                        let first = [
                            about[0].clone(),
                            about[2].clone(),
                            format!("{place:.2}"),
                            figure(here[0].plateau),
                        ];
                        along.row(first.into_iter().chain(per_rule(&here)));
                    }
                    let all: Vec<&Found> = found.iter().flatten().collect();
                    let first = about.iter().cloned().chain(["on the diagonal".into()]);
                    averages.row(first.chain(per_rule(&all)));
                }
                let anywhere: Vec<Lattice> =
                    (0..count / 2).map(|n| lattice(cell * unit_cube_point(n))).collect();
                let found = measure(&anywhere)?;
                let all: Vec<&Found> = found.iter().flatten().collect();
                averages.row(about.into_iter().chain(["anywhere".into()]).chain(per_rule(&all)));
            }
        }
    }
    let what = "rules for c: mean distance, mean bias, greatest bias, in spacings";
    along.print(&format!(
        "{what}; all bodies, regular lattices at several positions along the diagonal of a cell"
    ));
    averages.print(&format!("{what}; all bodies, averages over positions of the lattice"));
    Ok(())
}

fn per_rule(found: &[&Found]) -> Vec<String> {
    let text = |rule: usize| {
        let errors: Vec<Errors> = found.iter().filter_map(|found| found.errors[rule]).collect();
        if errors.len() < found.len() {
            return "none".into();
        }
        let biases = || errors.iter().map(|e| e.bias);
        format!(
            "{} {} {}",
            figure(mean(errors.iter().map(|e| e.mean))),
            signed(mean(biases())),
            signed(worst(biases()))
        )
    };
    (0..RULES.len()).map(text).collect()
}

fn found(solid: &Solid, indicator: IndicatorKind, cell: f64, lattice: &Lattice) -> Outcome<Found> {
    let particles = fill(solid, lattice);
    let sample = |grid: Grid| {
        Engine::sample(&particles, &sampling(grid, 1.0, indicator), &mut Timings::default())
    };
    let frame = sample(grid(cell)?)?;
    let (settings, sampled) =
        (surfacing(None, None), frame.dif().ok_or("an indicator makes the field")?);
    let Ok(MeasuredCalibration { calibration, plateau, .. }) = settings.calibrate(sampled) else {
        return Ok(Found { plateau: f64::NAN, errors: vec![None; RULES.len()] });
    };
    let median = f64::from(plateau.value()) / f64::from(FULL);
    let values = Values::of(sampled, &settings.recipe(sampled, &calibration), solid);
    let error = |rule: &Rule| match *rule {
        Rule::Median(share) => error_at(solid, &frame, Some(share * median)),
        Rule::Mean(share) => match values.interior_mean {
            Some(mean) => error_at(solid, &frame, Some(share * mean)),
            None => Ok(None),
        },
        Rule::Volume => {
            error_at(solid, &frame, Some(values.above(particles.len() as f64 / cell.powi(3))))
        }
        Rule::Moved => {
            let origin = lattice_origin(&particles, DVec3::ZERO, cell).unwrap_or(DVec3::ZERO);
            error_at(solid, &sample(Grid::new(origin, cell)?)?, None)
        }
    };
    let errors: Outcome<Vec<_>> = RULES.iter().map(error).collect();
    Ok(Found { plateau: median, errors: errors? })
}

fn error_at(solid: &Solid, frame: &Engine, c: Option<f64>) -> Outcome<Option<Errors>> {
    let iso = c.map(|c| Isovalue::new(c.clamp(1e-4, 0.9999))).transpose()?;
    match frame.surface(&surfacing(None, iso), &mut Timings::default()) {
        Err(FrameError::NoSurface { .. } | FrameError::TooFine(_)) => Ok(None),
        surface => Errors::of(solid, &surface?.to_mesh()?).map(Some),
    }
}

/// Statistics of the smoothed field.
struct Values {
    /// The values of all cells, in descending order.
    sorted: Vec<u16>,
    /// The mean over cells so deep in the true shape that their filters contain only fluid. `None`
    /// if the body has no such cells.
    interior_mean: Option<f64>,
}

impl Values {
    fn of(sampled: &SampledDif, recipe: &Recipe, solid: &Solid) -> Self {
        let grid = sampled.facts.grid;
        let reach = recipe.filters.reach();
        let deep = (f64::from(reach) + 0.5) * grid.cell_size() * 3_f64.sqrt();
        let (mut sorted, mut interior) = (Vec::new(), Vec::new());
        for cells in sampled.dif.regions(reach, reach) {
            let field = field(recipe, sampled, cells);
            sorted.extend_from_slice(field.samples());
            // Every fourth row of cells is enough for a mean.
            for ([y, z], row) in field.rows(cells).filter(|([y, z], _)| y % 2 == 0 && z % 2 == 0) {
                let centre = |x| grid.world_from_cells(IVec3::new(x, y, z).as_dvec3() + 0.5);
                let deep =
                    row.iter().zip(cells.lo.x..).filter(|&(_, x)| solid.depth(centre(x)) > deep);
                interior.extend(deep.map(|(&value, _)| f64::from(value) / f64::from(FULL)));
            }
        }
        sorted.sort_unstable_by(|a, b| b.cmp(a));
        Self { sorted, interior_mean: (!interior.is_empty()).then(|| mean(interior)) }
    }

    /// The value that `cells` cells exceed.
    fn above(&self, cells: f64) -> f64 {
        let last = self.sorted.len() - 1;
        f64::from(self.sorted[(cells as usize).min(last)]) / f64::from(FULL)
    }
}
