//! Tests of the calibration for all cell sizes: clumps do not affect it, and cells that are too
//! small for 16-bit samples give an error.

use std::collections::HashMap;

use glam::{DVec3, IVec3};
use meniscus::internals::baselines::KernelMethod;
use meniscus::internals::field::blur::{Filter, Smoothing};
use meniscus::internals::field::calibration::{
    COARSEST_STEP, Calibration, FINEST_OF_SYMMETRY, Plateau, Remedy, TooFine,
};
use meniscus::internals::field::indicator::IndicatorKind;
use meniscus::internals::frame::{
    self, Detail, Engine, FrameError, Sampling, Shortfall, Surfacing,
};
use meniscus::internals::grid::units::{Isovalue, MeanCount, Sigma};
use meniscus::internals::grid::{CellBox, Domain, Grid};
use meniscus::internals::surface::mesh::measure::measure;
use meniscus::internals::surface::mesh::source::MeshSource;
use meniscus::internals::surface::stitch::StitchedSurface;
use meniscus::internals::system::timings::Timings;
use rayon::prelude::*;

use crate::common::dense::{Dense, Method};
use crate::common::distances::Distances;
use crate::common::scene::Random;
use crate::common::{INDICATORS, dif, fill, recipe, sampling, surfacing};

const CLOUD: IndicatorKind = IndicatorKind::Cloud;
const COUNTING: IndicatorKind = IndicatorKind::Counting;

/// The arrangement of particles in a box.
#[derive(Debug, Clone, Copy)]
enum Disorder {
    /// On a lattice, moved by up to this share of a spacing.
    Jittered(f64),
    Random,
    /// At a random position in each cell of a lattice, as in FLIP. A quarter of the particles are
    /// then moved next to another particle.
    Clumped,
}

/// A cube of particles with edge `edge` and one corner at the origin, with `density` particles per
/// unit of volume.
fn cube(edge: f64, density: f64, disorder: Disorder, seed: u64) -> Vec<[f64; 3]> {
    let mut random = Random::new(seed);
    let step = density.cbrt().recip();
    let side = (edge / step) as usize;
    let mut particles: Vec<[f64; 3]> = (0..side.pow(3))
        .map(|i| {
            let place = [i % side, i / side % side, i / (side * side)];
            place.map(|c| {
                let (place, unit) = (c as f64 + 0.5, random.unit() - 0.5);
                match disorder {
                    Disorder::Jittered(jitter) => (place + 2.0 * jitter * unit) * step,
                    Disorder::Random => (unit + 0.5) * side as f64 * step,
                    Disorder::Clumped => (place + unit) * step,
                }
            })
        })
        .collect();
    if let Disorder::Clumped = disorder {
        for i in (0..particles.len()).step_by(4) {
            let other = particles[random.bits() as usize % particles.len()];
            particles[i] = other.map(|x| x + 0.3 * step * (random.unit() - 0.5));
        }
    }
    particles
}

/// Settings with cells of edge 1, for particles with this spacing.
fn sampling_at(spacing: f64, method: impl Into<frame::Method>) -> Sampling {
    let method = method.into();
    let side = method.brick_side();
    Sampling { method, spacing: Some(spacing), side, ..sampling() }
}

/// Runs the check of the cell size that precedes sampling.
fn check_before_sampling(
    surfacing: &Surfacing,
    spacing: f64,
    kind: IndicatorKind,
    mean: Option<MeanCount>,
) -> Result<(), TooFine> {
    surfacing.check_cell_size(kind, mean, Some(spacing), &sampling().grid)
}

fn scaled(particles: &[[f64; 3]], by: f64) -> Vec<[f64; 3]> {
    // Move particles off the faces of cells, because rounding would decide there which cell
    // contains a particle.
    particles.iter().map(|p| p.map(|x| x * by + 0.137)).collect()
}

fn sample(particles: &[[f64; 3]], sampling: &Sampling) -> Engine {
    Engine::sample(&particles, sampling, &mut Timings::default()).unwrap()
}

fn draw(frame: &Engine, surfacing: &Surfacing) -> StitchedSurface {
    frame.surface(surfacing, &mut Timings::default()).unwrap()
}

/// The median of a field over the cells of a cube that are at least `depth` cells away from the
/// cube's faces.
fn deep_median(field: &Dense<f64>, edge: f64, depth: i32) -> f64 {
    let deep = CellBox { lo: IVec3::splat(depth), hi: IVec3::splat(edge as i32 - depth) };
    let mut deep: Vec<f64> =
        field.iter().filter(|(cell, _)| deep.contains(*cell)).map(|(_, x)| x).collect();
    let middle = deep.len() / 2;
    *deep.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Compares the calibration of a cube of particles with a dense oracle in f64. Returns the relative
/// deviation and the plateau. Compares the density for clouds, and otherwise the isovalue, which is
/// a fixed share of the plateau.
fn deviation_from_oracle(particles: &[[f64; 3]], frame: &Engine, edge: f64) -> (f64, Plateau) {
    let (indicator, facts) = (dif(frame).indicator, frame.facts());
    let (recipe, measured) = recipe(frame, &surfacing());
    let ratio = if indicator.kind() == CLOUD {
        let (spacing, smooth) = (facts.spacing.unwrap(), surfacing().smooth.spacings());
        let (density, level) =
            Distances { spacing, smooth, plateau: 1, walls: None }.density(particles);
        let edge = edge / f64::from(1 << level);
        let depth = (2.2 * smooth * spacing / f64::from(1 << level)).ceil() as i32 + 1;
        measured.density(spacing) / deep_median(&density, edge, depth)
    } else {
        let sigma = surfacing().width(facts.spacing, facts.grid.cell_size());
        let method = Method {
            indicator,
            sigma: sigma.cells(),
            detail: Detail::Smoothed,
            iso: 1.0,
            walls: None,
        };
        let depth = Smoothing::new(indicator.kind(), sigma).reach() + 1;
        recipe.iso.value() / 0.47 / deep_median(&method.real(particles), edge, depth)
    };
    (ratio - 1.0, measured.plateau)
}

#[test]
fn the_plateau_matches_a_dense_oracle_for_all_cell_sizes() {
    const CELLS: [f64; 6] = [1.0, 2.0 / 3.0, 0.5, 0.4, 1.0 / 3.0, 0.25];
    let disorders = [
        Disorder::Jittered(0.0),
        Disorder::Jittered(0.3),
        Disorder::Jittered(0.5),
        Disorder::Random,
        Disorder::Clumped,
    ];
    let mut cases = Vec::new();
    for (i, density) in [0.5_f64, 1.0, 2.0, 4.0, 8.0].into_iter().enumerate() {
        for (j, disorder) in disorders.into_iter().enumerate() {
            // Combine every density with every disorder, and test each combination in two of the
            // six cell sizes.
            for cell in [CELLS[(i + j) % 6], CELLS[(i + j + 3) % 6]] {
                // Limit the density for clouds, which can measure at most four times the expected
                // number of particles.
                cases.extend(
                    [(density, COUNTING), (density.min(3.5), CLOUD)]
                        .map(|(density, indicator)| (density, disorder, cell, indicator)),
                );
            }
        }
    }
    let off = cases.into_par_iter().filter_map(|(density, disorder, cell, indicator)| {
        // The counts of a regular lattice form a moire pattern with the cells. Only a large cube
        // has enough periods of this pattern for a stable median.
        let beats =
            density < 1.0 && matches!((disorder, indicator), (Disorder::Jittered(0.0), COUNTING));
        let edge = if beats {
            60.0
        } else if density > 2.0 {
            16.0
        } else {
            22.0
        };
        let mut particles = scaled(&cube(edge, density, disorder, 7), 1.0 / cell);
        let clump = particles[particles.len() / 2];
        particles.extend([clump; 10]);
        let frame = sample(&particles, &sampling_at(1.0 / cell, indicator));
        let (off, plateau) = deviation_from_oracle(&particles, &frame, edge / cell);
        let what = format!(
            "{indicator:?} {density} {disorder:?} in cells of {cell}: off by {off}, {plateau:?}"
        );
        let within = if indicator == CLOUD { 0.03 } else { 0.02 };
        let found = matches!(plateau, Plateau::Interior { .. }) && off.abs() < within;
        (!found).then_some(what)
    });
    let off: Vec<String> = off.collect();
    assert!(off.is_empty(), "{off:#?}");
}

/// The vertices of a surface, by the cells that contain them.
fn places(surface: &StitchedSurface) -> HashMap<IVec3, Vec<DVec3>> {
    let mut places: HashMap<IVec3, Vec<DVec3>> = HashMap::new();
    for piece in 0..surface.pieces() {
        for (_, place) in surface.places(piece).unwrap() {
            places.entry(place.floor().as_ivec3()).or_default().push(place);
        }
    }
    places
}

/// The sorted distances of the vertices of `one` from the nearest vertices of `other`, for vertices
/// whose distance from `place` exceeds `away`. A distance is infinite if `other` has no vertex in
/// the same cell or in a cell next to it.
fn displacements(
    one: &StitchedSurface,
    other: &StitchedSurface,
    (place, away): (DVec3, f64),
) -> Vec<f64> {
    let others = places(other);
    let next = |p: DVec3| {
        let cells = (0..27).map(|i| p.floor().as_ivec3() + IVec3::new(i % 3, i / 3 % 3, i / 9) - 1);
        let places = cells.filter_map(|cell| others.get(&cell)).flatten();
        places.map(|q| q.distance(p)).fold(f64::INFINITY, f64::min)
    };
    let far = places(one).into_values().flatten().filter(|p| p.distance(place) > away);
    let mut moved: Vec<f64> = far.map(next).collect();
    moved.sort_by(f64::total_cmp);
    moved
}

/// Bodies of particles, from deep to thin, each with a position for a clump. Lengths are in
/// spacings.
fn bodies() -> [(&'static str, Vec<[f64; 3]>, DVec3); 6] {
    let ball = |radius: f64| fill(12.0, 1.0, 0.3, 5, move |p| p.length() < radius);
    let mut random = Random::new(9);
    let spray = (0..300).map(|_| [(); 3].map(|()| 60.0 * random.unit())).collect();
    let sheet = |p: DVec3| p.y.abs() < 0.6 && p.y > 0.0;
    [
        ("pool", cube(20.0, 1.0, Disorder::Jittered(0.3), 3), DVec3::splat(10.0)),
        ("ball", ball(8.5), DVec3::ZERO),
        ("small ball", ball(5.0), DVec3::ZERO),
        ("sheet", fill(12.0, 1.0, 0.2, 5, sheet), DVec3::new(0.5, 0.5, 0.5)),
        ("spray", spray, DVec3::splat(30.0)),
        (
            "handful",
            vec![[0.5; 3], [1.4, 0.5, 0.6], [0.6, 1.5, 0.4], [8.0, 0.1, 0.2]],
            DVec3::new(0.5, 0.5, 0.5),
        ),
    ]
}

#[test]
fn duplicates_and_clumps_do_not_move_the_surface_elsewhere() {
    let recovered = Surfacing { detail: Detail::Recovered, ..surfacing() };
    for (name, body, place) in bodies() {
        for (cell, indicator) in
            [(1.0 / 1.5, CLOUD), (1.0 / 3.0, CLOUD), (1.0 / 1.5, COUNTING), (0.4, COUNTING)]
        {
            let spacing = 1.0 / cell;
            let particles = scaled(&body, spacing);
            // Recovered details change the surface even for the same isovalue, so this test also
            // compares the isovalue, in particles per cell.
            let isovalue = |frame: &Engine| match recipe(frame, &surfacing()).1.calibration {
                Calibration::Indicator { mean, iso } => iso.value() * mean.unwrap().particles(),
                Calibration::Clouds { plateau } => f64::from(plateau),
            };
            let of_clean = sample(&particles, &sampling_at(spacing, indicator));
            let clean = draw(&of_clean, &recovered);
            let beside = [20.0, 0.0, 0.0];
            for (clump, count) in [(place.to_array(), 1), (place.to_array(), 10), (beside, 30)] {
                let [at] = scaled(&[clump], spacing)[..] else { unreachable!() };
                let with: Vec<_> =
                    particles.iter().copied().chain(std::iter::repeat_n(at, count)).collect();
                let of_with = sample(&with, &sampling_at(spacing, indicator));
                let ratio = isovalue(&of_with) / isovalue(&of_clean);
                assert!(
                    (ratio - 1.0).abs() < 0.03,
                    "{name}, {indicator:?}, cells of {cell}, {count} more: {ratio}"
                );
                let with = draw(&of_with, &recovered);
                let there = (DVec3::from(at), 4.0 * spacing);
                for moved in
                    [displacements(&clean, &with, there), displacements(&with, &clean, there)]
                {
                    // A few vertices may move far: vertices on a dual edge that is nearly tangent
                    // to the surface, and vertices that appear or disappear when one sample changes
                    // its sign.
                    let [most, all] =
                        [moved[moved.len() * 9 / 10], moved[moved.len() - 1]].map(|d| d / spacing);
                    let what = format!(
                        "{name}, {indicator:?}, cells of {cell}, {count} more: {most} spacings, {all}"
                    );
                    // In the small ball, the clump affects the whole surface, because the widest
                    // Gaussian of clouds reaches the surface from the centre.
                    let within = match indicator {
                        CLOUD if name == "small ball" => 0.1,
                        CLOUD => 0.01,
                        _ => 0.05,
                    };
                    assert!(most < within && all.is_finite(), "{what}");
                }
            }
        }
    }
}

#[test]
fn without_an_interior_the_plateau_is_derived_from_the_spacing() {
    // Use strong jitter, because without it, symmetry and counts depend on the lattice's position.
    let pool = cube(24.0, 1.0, Disorder::Jittered(0.5), 1);
    for cell in [1.5, 1.0, 2.0 / 3.0, 0.5, 1.0 / 3.0] {
        for indicator in INDICATORS {
            let spacing = 1.0 / cell;
            if check_before_sampling(&surfacing(), spacing, indicator, None).is_err() {
                assert!(indicator == IndicatorKind::Symmetry && cell <= FINEST_OF_SYMMETRY);
                continue;
            }
            let of_pool = sample(&scaled(&pool, spacing), &sampling_at(spacing, indicator));
            let deep = recipe(&of_pool, &surfacing()).1.plateau;
            let Plateau::Interior { median, .. } = deep else {
                panic!("the pool in cells of {cell}: {deep:?}")
            };
            // Use the mu0 of the pool, because thinner bodies would have a different mu0.
            let sampling = sampling_at(spacing, of_pool.method());
            for (name, body, _) in &bodies()[2..] {
                let frame = sample(&scaled(body, spacing), &sampling);
                let plateau = recipe(&frame, &surfacing()).1.plateau;
                let Plateau::Shallow { expected } = plateau else {
                    panic!("{name} in cells of {cell}: {plateau:?}")
                };
                let ratio = f64::from(expected) / f64::from(median);
                let within = if matches!(indicator, IndicatorKind::Cloud) { 0.02 } else { 0.1 };
                assert!((ratio - 1.0).abs() < within, "{indicator:?} {name} in {cell}: {ratio}");
            }
        }
    }
}

#[test]
fn the_expected_plateau_of_a_shallow_layer_accounts_for_its_disorder() {
    for disorder in [Disorder::Jittered(0.3), Disorder::Jittered(0.5), Disorder::Clumped] {
        let particles = scaled(&cube(48.0, 1.0, disorder, 6), 1.5);
        let deep = sample(&particles, &sampling_at(1.5, COUNTING));
        let Plateau::Interior { median, .. } = recipe(&deep, &surfacing()).1.plateau else {
            panic!()
        };
        let layer: Vec<_> = particles.into_iter().filter(|p| p[1] < 4.0 * 1.5).collect();
        let layer = sample(&layer, &sampling_at(1.5, deep.method()));
        let Plateau::Shallow { expected } = recipe(&layer, &surfacing()).1.plateau else {
            panic!()
        };
        let ratio = f64::from(expected) / f64::from(median);
        assert!((ratio - 1.0).abs() < 0.05, "{disorder:?}: {ratio}");
    }
}

#[test]
fn a_large_amount_of_mist_has_no_interior() {
    let mut random = Random::new(4);
    let mist: Vec<[f64; 3]> = (0..8000).map(|_| [(); 3].map(|()| 40.0 * random.unit())).collect();
    for indicator in [CLOUD, COUNTING] {
        let frame = sample(&scaled(&mist, 1.5), &sampling_at(1.5, indicator));
        let plateau = recipe(&frame, &surfacing()).1.plateau;
        assert!(matches!(plateau, Plateau::Shallow { .. }), "{indicator:?}: {plateau:?}");
    }
}

#[test]
fn the_volume_of_a_pool_depends_little_on_cell_size_and_walls() {
    let pool = cube(14.0, 1.0, Disorder::Clumped, 2);
    for indicator in [CLOUD, COUNTING] {
        for walls in [false, true] {
            let volume = |cell: f64| {
                let spacing = 1.0 / cell;
                let particles = scaled(&pool, spacing);
                let mut sampling = sampling_at(spacing, indicator);
                if walls {
                    // The pool ends at walls on all sides except the top.
                    let [lo, hi] = [DVec3::ZERO, DVec3::new(14.0, 30.0, 14.0) * spacing];
                    sampling.domain = Some(Domain::new(&sampling.grid, lo, hi).unwrap());
                }
                let surface = draw(&sample(&particles, &sampling), &surfacing());
                surface.volume().unwrap() / spacing.powi(3)
            };
            let coarse = volume(2.0 / 3.0);
            for cell in [0.5, 0.4, 1.0 / 3.0, 0.25] {
                let ratio = volume(cell) / coarse;
                assert!(
                    (ratio - 1.0).abs() < 0.03,
                    "{indicator:?}, cells of {cell}, walls {walls}: {ratio}"
                );
            }
        }
    }
}

#[test]
fn the_volume_of_a_surface_matches_the_volume_of_its_mesh() {
    let ball = fill(16.0, 1.0, 0.3, 1, |p| p.length() < 15.0);
    let close = |surface: &StitchedSurface, within: f64, what: &str| {
        let mesh = measure(&surface.to_mesh().unwrap()).volume.unwrap();
        let ratio = surface.volume().unwrap() / mesh;
        assert!((ratio - 1.0).abs() < within, "{what}: {ratio}");
    };
    for indicator in INDICATORS {
        close(&draw(&sample(&ball, &sampling_at(1.0, indicator)), &surfacing()), 0.01, "a ball");
        // Walls on cell faces cut off everything except a cube.
        let mut tank = sampling_at(1.0, indicator);
        tank.domain = Domain::new(&tank.grid, DVec3::splat(-8.0), DVec3::splat(8.0)).ok();
        close(&draw(&sample(&ball, &tank), &surfacing()), 0.01, "a full tank");
        // The tolerance is large, because flat triangles cut off a large part of drops and sheets.
        let splashes = sample(
            &crate::common::splashes(3),
            &Sampling { method: indicator.into(), ..sampling() },
        );
        let within = if indicator == CLOUD { 0.2 } else { 0.06 };
        close(&draw(&splashes, &surfacing()), within, "drops");
    }
    let sampling =
        Sampling { method: KernelMethod::ZhuBridson.into(), spacing: Some(1.0), ..sampling() };
    close(&draw(&sample(&ball, &sampling), &surfacing()), 0.01, "kernels");
}

#[test]
fn a_surface_with_less_than_half_of_the_particle_volume_is_reported() {
    let pool = scaled(&cube(14.0, 1.0, Disorder::Jittered(0.3), 2), 1.5);
    for indicator in INDICATORS {
        let whole = draw(&sample(&pool, &sampling_at(1.5, indicator)), &surfacing());
        assert_eq!(
            Shortfall::of(&whole, None, pool.len(), None, 1.5).unwrap(),
            None,
            "{indicator:?}"
        );
    }
    let frame = sample(&pool, &sampling_at(1.5, COUNTING));
    let high = Isovalue::new(0.28).unwrap();
    let lost = draw(&frame, &Surfacing { iso: Some(high), ..surfacing() });
    let shortfall = Shortfall::of(&lost, None, pool.len(), None, 1.5).unwrap().unwrap();
    let volume =
        measure(&lost.to_mesh().unwrap()).volume.unwrap() / (pool.len() as f64 * 1.5_f64.powi(3));
    assert!(
        shortfall.share < 0.5 && (shortfall.share / volume - 1.0).abs() < 0.06,
        "{shortfall:?} of {volume}"
    );
}

#[test]
fn one_step_of_the_isovalue_moves_the_surface_by_the_reported_distance() {
    let edge = 24.0;
    let pool = cube(edge, 1.0, Disorder::Jittered(0.0), 1);
    for (cell, indicator) in [(0.25, COUNTING), (0.2, COUNTING)] {
        let spacing = 1.0 / cell;
        let frame = sample(&scaled(&pool, spacing), &sampling_at(spacing, indicator));
        let (recipe, measured) = recipe(&frame, &surfacing());
        let reported = measured.step_cells;
        assert!(reported < COARSEST_STEP);
        // Measure the vertices on the cube's upper face, away from its edges.
        let steps = 8;
        let face = |threshold: u16| {
            let iso = Isovalue::new((f64::from(threshold) + 0.5) / 65535.0).unwrap();
            let surface =
                draw(&frame, &Surfacing { iso: Some(iso), ..surfacing() }).to_mesh().unwrap();
            let [low, high] = [5.0, edge - 5.0].map(|x| x * spacing);
            let inner = |x: f64| (low..high).contains(&x);
            let on_face = |[x, y, z]: [f64; 3]| (inner(x) && inner(z) && y > high).then_some(y);
            let heights: Vec<f64> = surface.positions.into_iter().filter_map(on_face).collect();
            heights.iter().sum::<f64>() / heights.len() as f64
        };
        let threshold = recipe.iso.threshold();
        let found = (face(threshold - steps) - face(threshold + steps)) / f64::from(2 * steps);
        let ratio = found / reported;
        assert!(
            (0.85..1.15).contains(&ratio),
            "{indicator:?}, cells of {cell}: {found} cells, reported {reported}"
        );
    }
}

/// Checks a cell size for a pool. The check must give the same result before and after sampling.
fn check_cell_size(indicator: IndicatorKind, cell: f64) -> Result<(), TooFine> {
    let spacing = 1.0 / cell;
    let sampling = sampling_at(spacing, indicator);
    let before = check_before_sampling(&surfacing(), spacing, indicator, None);
    let pool = scaled(&cube(12.0, 1.0, Disorder::Jittered(0.3), 1), spacing);
    match sample(&pool, &sampling).surface(&surfacing(), &mut Timings::default()) {
        Ok(_) => assert_eq!(before, Ok(()), "{indicator:?} in {cell}"),
        Err(FrameError::TooFine(after)) => {
            assert!(before.is_err(), "{indicator:?} in {cell}: {after}")
        }
        Err(other) => panic!("{other}"),
    }
    before
}

#[test]
fn cells_too_fine_for_16_bits_are_refused_with_a_size_that_fits() {
    {
        let indicator = COUNTING;
        assert_eq!(check_cell_size(indicator, 0.2), Ok(()));
        let found = check_cell_size(indicator, 0.11).unwrap_err();
        assert!(
            matches!(found, TooFine::Steps { step_cells, .. } if step_cells > COARSEST_STEP),
            "{found}"
        );
        for sigma in [None, Some(10.0)].map(|cells| cells.map(|cells| Sigma::new(cells).unwrap())) {
            let surfacing = Surfacing { sigma, ..surfacing() };
            for cell in [0.11, 0.02, 1.0 / 128.0, 1e-5] {
                let refused =
                    |cell: f64| check_before_sampling(&surfacing, 1.0 / cell, indicator, None);
                let Err(TooFine::Steps { remedy: Remedy::Cells(fitting), .. }) = refused(cell)
                else {
                    panic!("{indicator:?}, cells of {cell}: {:?}", refused(cell))
                };
                // The suggested cell size is allowed, and a slightly smaller one is not.
                assert_eq!(
                    refused(cell * fitting),
                    Ok(()),
                    "{indicator:?}, {fitting} times {cell}"
                );
                assert!(
                    refused(cell * fitting * 0.97).is_err(),
                    "{indicator:?}, {fitting} times {cell}"
                );
            }
        }
    }
}

#[test]
fn cells_needlessly_fine_for_clouds_are_refused_with_a_size_that_fits() {
    for cell in [0.2, 0.1] {
        assert_eq!(check_cell_size(CLOUD, cell), Ok(()));
    }
    assert!(matches!(check_cell_size(CLOUD, 0.09), Err(TooFine::Finest { .. })));
    for (cell_size, spacing) in [(0.01, 1.0), (1e-9, 3.0), (0.7, 7.1)] {
        let refused = |cell_size: f64| {
            let grid = Grid::new(DVec3::ZERO, cell_size).unwrap();
            surfacing().check_cell_size(CLOUD, None, Some(spacing), &grid)
        };
        let message = refused(cell_size).unwrap_err().to_string();
        let (_, fitting) = message.split_once("use a cell size of ").unwrap();
        let fitting: f64 = fitting.split_once(" or more").unwrap().0.parse().unwrap();
        assert_eq!(refused(fitting), Ok(()), "{message}");
        assert!(refused(fitting * 0.97).is_err(), "{message}");
    }
    // Without a spacing, every cell size is allowed.
    assert_eq!(surfacing().check_cell_size(CLOUD, None, None, &sampling().grid), Ok(()));
}

#[test]
fn symmetry_is_refused_in_cells_that_are_mostly_empty() {
    assert_eq!(check_cell_size(IndicatorKind::Symmetry, 2.0 / 3.0), Ok(()));
    assert!(check_cell_size(IndicatorKind::Symmetry, FINEST_OF_SYMMETRY).is_err());
    let found = check_cell_size(IndicatorKind::Symmetry, 0.4).unwrap_err();
    assert_eq!(found, TooFine::Symmetry { cell_size: 1.0, spacing: 2.5 });
}

#[test]
fn a_high_mu0_is_refused_as_too_fine() {
    let mean = MeanCount::new(60.0).ok();
    let refused = check_before_sampling(&surfacing(), 3.0, COUNTING, mean).unwrap_err();
    assert!(matches!(refused, TooFine::Steps { plateau, .. } if plateau < 50.0), "{refused}");
}
