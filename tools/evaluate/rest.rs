//! Measures how stable the surface of a pool at rest is, while the pool rises by a cell. As in a
//! simulation, all frames use the grid, mu0 and isovalue of the first frame.

use glam::{DVec3, IVec3};
use meniscus::internals::field::calibration::FINEST_OF_SYMMETRY;
use meniscus::internals::field::indicator::IndicatorKind;
use meniscus::internals::frame::{Engine, Method, Sampling};
use meniscus::internals::simulation::shared_calibration::{FrameMeasurements, Origin, measure};
use meniscus::internals::surface::mesh::Mesh;
use meniscus::internals::system::timings::Timings;

use crate::methods::{CLOUD, COUNTING, grid, sampling, surfacing};
use crate::roughness::{WIDTH, is_central};
use crate::sample::cuboid;
use crate::scene::Random;
use crate::tables::{Table, figure};
use crate::{Options, Outcome};

const CELLS: [f64; 3] = [0.5, 2.0 / 3.0, 1.0];
/// Displacements of particles from their lattice, in spacings.
const JITTERS: [f64; 5] = [0.0, 0.1, 0.2, 0.3, 0.5];
/// Number of steps in which the pool rises by a cell.
const STEPS: u32 = 8;

pub fn run(options: &Options) -> Outcome<()> {
    let jitters = JITTERS.map(|jitter| format!("jittered by {jitter}"));
    let head: Vec<&str> = ["indicator", "cell / spacing"]
        .into_iter()
        .chain(jitters.iter().map(String::as_str))
        .collect();
    let mut table = Table::new(&head);
    for indicator in [CLOUD, COUNTING, IndicatorKind::Symmetry] {
        for &cell in options.choose(&CELLS[..], &CELLS[2..]) {
            if indicator == IndicatorKind::Symmetry && cell <= FINEST_OF_SYMMETRY {
                continue;
            }
            let moves = JITTERS.into_iter().map(|jitter| greatest_move(indicator, cell, jitter));
            let moves: Outcome<Vec<f64>> = moves.collect();
            let about = [indicator.name().to_owned(), figure(cell)];
            table.row(about.into_iter().chain(moves?.into_iter().map(figure)));
        }
    }
    table.print(&format!(
        "a level pool rises by one cell in {STEPS} steps: the largest movement of the surface \
         relative to the pool in one step, in cells"
    ));
    Ok(())
}

fn greatest_move(indicator: IndicatorKind, cell: f64, jitter: f64) -> Outcome<f64> {
    let pool =
        cuboid(IVec3::new(0, -12, 0), IVec3::new(WIDTH, 0, WIDTH), jitter, &mut Random::new(5));
    let rise = |step: u32| cell * f64::from(step) / f64::from(STEPS);
    let raised = |step: u32| -> Vec<[f64; 3]> {
        pool.iter().map(|&[x, y, z]| [x, y + rise(step), z]).collect()
    };

    let settings = surfacing(None, None);
    let free = sampling(grid(cell)?, 1.0, indicator);
    let FrameMeasurements { grid, calibration, .. } =
        measure(&raised(0), &free, Origin::Free, &settings)?;
    let mean = calibration.and_then(|known| known.mean());
    let frozen = Sampling { grid, method: Method::Indicator { kind: indicator, mean }, ..free };

    let height = |step: u32| -> Outcome<f64> {
        let timings = &mut Timings::default();
        let frame = Engine::sample(&raised(step), &frozen, timings)?;
        let mesh = frame
            .calibrate(&settings, calibration.as_ref(), timings)?
            .surface(timings)?
            .to_mesh()?;
        Ok(level(&mesh) - rise(step))
    };
    let heights: Vec<f64> = (0..=STEPS).map(height).collect::<Outcome<_>>()?;
    Ok(heights.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max) / cell)
}

/// The mean height of the central part of a pool's surface.
fn level(mesh: &Mesh) -> f64 {
    let (mut area, mut sum) = (0.0, 0.0);
    for triangle in &mesh.triangles {
        let corners = triangle.map(|vertex| mesh.positions[vertex as usize]);
        if corners.iter().all(is_central) {
            let [a, b, c] = corners.map(DVec3::from);
            let projected = (b - a).cross(c - a).y;
            area += projected;
            sum += projected * (a.y + b.y + c.y) / 3.0;
        }
    }
    sum / area
}
