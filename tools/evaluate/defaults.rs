//! Compares quality and cost for several cell sizes, sigmas and indicators.

use std::time::Instant;

use meniscus::internals::field::calibration::FINEST_OF_SYMMETRY;
use meniscus::internals::frame::Normals;
use meniscus::internals::system::timings::Timings;

use crate::accuracy::{CELLS, Errors, SAMPLINGS, errors, rotated_lattices, shifted_lattices};
use crate::methods::{Iso, Method, grid, volume_ratio};
use crate::roughness::pool_deviation;
use crate::scene::splash;
use crate::shapes::solids;
use crate::tables::{Table, figure, mean, signed, worst};
use crate::{Options, Outcome};

type Dif = fn(f64, Iso) -> Method;

const DIFS: [(&str, Dif); 2] = [("symmetry", Method::symmetry), ("counting", Method::counting)];
/// Number of runs of a frame; the fastest run counts.
const RUNS: usize = 3;

pub fn run(options: &Options) -> Outcome<()> {
    let solids = solids(options)?;
    let frame = splash(options.choose(1_000_000, 20_000), 1);
    let mut table = Table::new(&[
        "cell / spacing",
        "indicator",
        "sigma",
        "mean, regular",
        "mean, jittered",
        "bias",
        "worst bias",
        "Hausdorff",
        "pool: RMS",
        "M triangles",
        "seconds",
    ]);
    for &cell in options.choose(&CELLS[..], &CELLS[2..3]) {
        for (name, of) in DIFS {
            if name == "symmetry" && cell <= FINEST_OF_SYMMETRY {
                continue;
            }
            for sigma in sigmas(cell) {
                let method = of(sigma, Iso::Auto);
                let mut found: [Vec<Errors>; 2] = Default::default();
                for solid in &solids {
                    for (found, (_, jitter)) in found.iter_mut().zip(SAMPLINGS) {
                        let lattices = [
                            shifted_lattices(options, cell, jitter),
                            rotated_lattices(options, cell, jitter),
                        ]
                        .concat();
                        found.extend(errors(solid, &method, cell, &lattices)?.unwrap_or_default());
                    }
                }
                let [regular, jittered] =
                    found.each_ref().map(|found| mean(found.iter().map(|e| e.mean)));
                let all = || found.iter().flatten();
                let (seconds, triangles) = cost(&method, &frame, cell)?;
                table.row([
                    figure(cell),
                    name.to_owned(),
                    figure(sigma),
                    figure(regular),
                    figure(jittered),
                    signed(mean(all().map(|e| e.bias))),
                    signed(worst(all().map(|e| e.bias))),
                    figure(mean(all().map(|e| e.hausdorff))),
                    figure(pool_deviation(&method, cell)?.rms),
                    format!("{:.2}", triangles as f64 / 1e6),
                    figure(seconds),
                ]);
            }
        }
    }
    table.print(&format!(
        "isovalue from the plateau: distances in spacings over all bodies, positions and \
         rotations; seconds and triangles of a splash of {} particles, {} threads",
        frame.len(),
        rayon::current_num_threads()
    ));
    Ok(())
}

/// The values of sigma to compare, in cells: one cell, and one spacing if a spacing is larger than
/// a cell.
fn sigmas(cell: f64) -> Vec<f64> {
    if cell < 1.0 { vec![1.0, 1.0 / cell] } else { vec![1.0] }
}

fn cost(method: &Method, frame: &[[f32; 3]], cell: f64) -> Outcome<(f64, usize)> {
    let mut least = (f64::INFINITY, 0);
    for _ in 0..RUNS {
        let start = Instant::now();
        let surface =
            method.surface(frame, grid(cell)?, 1.0, Normals::None, &mut Timings::default())?;
        let triangles = surface.to_mesh()?.triangles.len();
        least = (start.elapsed().as_secs_f64().min(least.0), triangles);
        volume_ratio(&surface, frame.len(), 1.0)?;
    }
    Ok(least)
}
