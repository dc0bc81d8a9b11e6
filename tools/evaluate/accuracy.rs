//! Measures the distances between surfaces and the true surfaces (the paper's figure 13). The true
//! surfaces are the meshes that were filled with particles. Also measures how the distances depend
//! on the position of the particles' lattice relative to the grid.

use glam::{DQuat, DVec3};
use meniscus::internals::frame::{FrameError, Normals};
use meniscus::internals::surface::mesh::Mesh;
use meniscus::internals::surface::mesh::compare::compare;
use meniscus::internals::surface::mesh::measure::measure;
use meniscus::internals::system::timings::Timings;
use rayon::prelude::*;

use crate::methods::{Method, grid};
use crate::sample::{Lattice, fill, unit_cube_point};
use crate::shapes::{Solid, solids};
use crate::tables::{Table, figure, mean, mean_and_worst, percent, signed, worst};
use crate::{Options, Outcome};

/// The cell sizes to measure, in spacings.
pub const CELLS: [f64; 5] = [0.5, 2.0 / 3.0, 1.0, 1.5, 2.0];
fn cells(options: &Options) -> &'static [f64] {
    options.choose(&CELLS, &CELLS[2..3])
}

/// Displacements of particles from their lattice, in spacings.
pub const SAMPLINGS: [(&str, f64); 2] = [("regular", 0.0), ("jittered", 0.3)];

const HEAD: [&str; 9] = [
    "cell / spacing",
    "method",
    "Hausdorff",
    "mean",
    "RMS",
    "bias",
    "volume",
    "Hausdorff, cells",
    "mean, cells",
];

/// The errors of a surface, compared with the true one. Distances are in spacings.
#[derive(Debug, Clone, Copy)]
pub struct Errors {
    pub hausdorff: f64,
    /// The mean distance, averaged over both directions: from the surface to the true one, and
    /// back. `rms` is averaged in the same way.
    pub mean: f64,
    pub rms: f64,
    /// The mean signed distance, positive if the surface is outside the true one.
    pub bias: f64,
    /// The error of the volume, relative to the true volume.
    pub volume: f64,
}

impl Errors {
    pub fn of(solid: &Solid, mesh: &Mesh) -> Outcome<Self> {
        let found = compare(&solid.mesh, mesh)?;
        let volume = measure(mesh).volume.ok_or("a surface is not closed")?;
        let (to_truth, from_truth) = (&found.from_mesh, &found.from_reference);
        Ok(Self {
            hausdorff: found.hausdorff,
            mean: (to_truth.mean + from_truth.mean) / 2.0,
            rms: ((to_truth.rms.powi(2) + from_truth.rms.powi(2)) / 2.0).sqrt(),
            bias: found.bias,
            volume: volume / solid.volume - 1.0,
        })
    }
}

/// Lattices without rotation, at several positions within a cell.
pub fn shifted_lattices(options: &Options, cell: f64, jitter: f64) -> Vec<Lattice> {
    let at = |n: usize| Lattice {
        shift: cell * unit_cube_point(n),
        turn: DQuat::IDENTITY,
        jitter,
        inset: options.inset,
        seed: n as u64,
    };
    (0..options.choose(8, 1)).map(at).collect()
}

/// Rotated lattices, at several positions within a cell.
pub fn rotated_lattices(options: &Options, cell: f64, jitter: f64) -> Vec<Lattice> {
    let axes =
        [(DVec3::new(1.0, 2.0, 3.0), 0.4), (DVec3::X, 0.785), (DVec3::new(3.0, -1.0, 2.0), 1.1)];
    let rotations = axes.map(|(axis, angle)| DQuat::from_axis_angle(axis.normalize(), angle));
    let shifted = shifted_lattices(options, cell, jitter);
    rotations.iter().zip(shifted).map(|(&turn, lattice)| Lattice { turn, ..lattice }).collect()
}

/// The errors of a method on each lattice. Returns `None` if the method finds no surface for one of
/// the lattices, because the cells are too small, or because the isovalue is too high for a narrow
/// filter.
pub fn errors(
    solid: &Solid,
    method: &Method,
    cell: f64,
    lattices: &[Lattice],
) -> Outcome<Option<Vec<Errors>>> {
    let of = |lattice: &Lattice| {
        let particles = fill(solid, lattice);
        let surface = method.surface(
            &particles[..],
            grid(cell)?,
            1.0,
            Normals::None,
            &mut Timings::default(),
        );
        match surface {
            Err(FrameError::NoSurface { .. } | FrameError::TooFine(_)) => Ok(None),
            surface => Errors::of(solid, &surface?.to_mesh()?).map(Some),
        }
    };
    lattices.par_iter().map(of).collect()
}

/// The entries of a table row: means and worst values of the errors, or "none".
fn row(errors: Option<&[Errors]>, cell: f64) -> Vec<String> {
    let Some(errors) = errors else { return vec!["none".into()] };
    let of = |f: fn(&Errors) -> f64| errors.iter().map(f).collect::<Vec<_>>();
    let (bias, volume) = (of(|e| e.bias), of(|e| e.volume));
    vec![
        mean_and_worst(&of(|e| e.hausdorff)),
        mean_and_worst(&of(|e| e.mean)),
        mean_and_worst(&of(|e| e.rms)),
        format!("{} ({})", signed(mean(bias.iter().copied())), signed(worst(bias))),
        format!("{} ({})", percent(mean(volume.iter().copied())), percent(worst(volume))),
        figure(mean(of(|e| e.hausdorff)) / cell),
        figure(mean(of(|e| e.mean)) / cell),
    ]
}

pub fn run(options: &Options) -> Outcome<()> {
    let methods = Method::WITH_OTHER_ISOVALUES;
    // Errors over all solids, indexed by sampling, cell size and method.
    let mut all =
        vec![vec![vec![Some(Vec::new()); methods.len()]; cells(options).len()]; SAMPLINGS.len()];
    for solid in &solids(options)? {
        for (s, (sampling, jitter)) in SAMPLINGS.into_iter().enumerate() {
            let mut tables = [(); 2].map(|()| Table::new(&HEAD));
            for (c, cell) in cells(options).iter().copied().enumerate() {
                for (m, method) in methods.iter().enumerate() {
                    let lattices = [
                        shifted_lattices(options, cell, jitter),
                        rotated_lattices(options, cell, jitter),
                    ];
                    for (table, lattices) in tables.iter_mut().zip(lattices) {
                        let found = errors(solid, method, cell, &lattices)?;
                        let about = [figure(cell), method.name()];
                        table.row(about.into_iter().chain(row(found.as_deref(), cell)));
                        let sum = all[s][c][m].take();
                        all[s][c][m] = sum.zip(found).map(|(sum, found)| [sum, found].concat());
                    }
                }
            }
            let what = format!(
                "{} of {} particles, {sampling}: distances in spacings, mean (worst)",
                solid.name, solid.volume
            );
            let [by_position, by_rotation] = tables;
            by_position.print(&format!("{what} over positions of the lattice in a cell"));
            by_rotation.print(&format!("{what} over rotations of the lattice"));
        }
    }
    summary(options, methods, &all);
    Ok(())
}

type Figure = fn(&Errors) -> f64;

/// Prints the methods with the smallest errors over all solids, positions and rotations.
fn summary(options: &Options, methods: &[Method], all: &[Vec<Vec<Option<Vec<Errors>>>>]) {
    let figures: [(&str, Figure); 2] =
        [("mean distance", |e| e.mean), ("Hausdorff distance", |e| e.hausdorff)];
    for (what, of) in figures {
        let names: Vec<String> = methods.iter().map(Method::name).collect();
        let head: Vec<&str> =
            ["sampling", "cell / spacing"].into_iter().chain(names.iter().map(|n| &**n)).collect();
        let mut table = Table::new(&head);
        for ((sampling, _), by_cell) in SAMPLINGS.iter().zip(all) {
            for (cell, by_method) in cells(options).iter().zip(by_cell) {
                let of_all = |errors: &Vec<Errors>| mean(errors.iter().map(of));
                let means: Vec<_> =
                    by_method.iter().map(|errors| errors.as_ref().map(of_all)).collect();
                let least = means.iter().flatten().copied().fold(f64::INFINITY, f64::min);
                let text = |mean: &Option<f64>| match *mean {
                    None => "none".into(),
                    Some(mean) if mean == least => format!("**{mean:.3}**"),
                    Some(mean) => figure(mean),
                };
                table.row(
                    [(*sampling).to_owned(), figure(*cell)]
                        .into_iter()
                        .chain(means.iter().map(text)),
                );
            }
        }
        table.print(&format!(
            "{what} in spacings, mean over all bodies, positions and rotations, the least in bold"
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::meshes::sphere;

    #[test]
    fn errors_of_an_enlarged_ball_match_the_enlargement() {
        let ball = Solid::new("ball", sphere(1.0, 5), 10_000).unwrap();
        let radius = ball.depth(ball.centre);
        let mut larger = ball.mesh.clone();
        for position in &mut larger.positions {
            let off = DVec3::from(*position) - ball.centre;
            *position = (ball.centre + off * (1.0 + 0.25 / radius)).into();
        }
        let errors = Errors::of(&ball, &larger).unwrap();
        for (found, expected) in [
            (errors.hausdorff, 0.25),
            (errors.mean, 0.25),
            (errors.rms, 0.25),
            (errors.bias, 0.25),
            (errors.volume, (1.0 + 0.25 / radius).powi(3) - 1.0),
        ] {
            assert!((found / expected - 1.0).abs() < 0.01, "{found} instead of {expected}");
        }
    }
}
