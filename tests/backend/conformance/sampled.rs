//! Tests of estimates for a large frame, which are computed from a sample of its blocks.

use glam::{DVec3, IVec3};
use meniscus::internals::backend::field;
use meniscus::internals::field::calibration::{MeasuredCalibration, Plateau};
use meniscus::internals::field::indicator::IndicatorKind;
use meniscus::internals::frame::{Engine, Sampling};
use meniscus::internals::grid::{BIN, CellBox, Grid};
use meniscus::internals::system::timings::Timings;

use super::TestBackend;
use crate::common::scene::splash;
use crate::common::{dif, recipe, surfacing};

/// Number of cells per spacing.
const CELLS: f64 = 1.6;

/// Water with waves, a sphere above it, a sheet and spray: about 400 bins, half of which contain
/// few particles.
fn frame(backend: &TestBackend, indicator: IndicatorKind) -> (Engine, IVec3) {
    let particles = splash(200_000, 8);
    let grid = Grid::new(DVec3::ZERO, 1.0 / CELLS).unwrap();
    let sampling =
        Sampling { method: indicator.into(), grid, spacing: Some(1.0), ..backend.sampling() };
    let frame = Engine::sample(&particles, &sampling, &mut Timings::default()).unwrap();
    let depth = (200_000.0_f64 * 0.96 / 16.0).cbrt();
    let pool = DVec3::new(4.0 * depth, 0.9 * depth, 4.0 * depth) * CELLS;
    (frame, pool.as_ivec3())
}

pub fn the_plateau_of_sampled_blocks_equals_that_of_the_whole_pool(backend: &TestBackend) {
    for indicator in [IndicatorKind::Symmetry, IndicatorKind::Counting] {
        let (frame, pool) = frame(backend, indicator);
        let blocks = dif(&frame).dif.regions(0, 0).len();
        assert!(blocks > 64, "all {blocks} blocks are in the sample");
        let (recipe, MeasuredCalibration { plateau, .. }) = recipe(&frame, &surfacing());
        let inside = CellBox { lo: IVec3::splat(BIN / 2), hi: pool - BIN / 2 };
        let mut deep = Vec::new();
        for cells in inside.cubes(BIN) {
            let cells = CellBox::cube(cells, BIN).intersection(&inside);
            deep.extend_from_slice(field(&recipe, dif(&frame), cells).samples());
        }
        let (_, median, _) = {
            let middle = deep.len() / 2;
            deep.select_nth_unstable(middle)
        };
        let Plateau::Interior { median: sampled, .. } = plateau else {
            panic!("{indicator:?}: {plateau:?}")
        };
        let off = f64::from(sampled) / f64::from(*median) - 1.0;
        assert!(off.abs() < 0.01, "{indicator:?}: {sampled} is off from {median} by {off}");
    }
}
