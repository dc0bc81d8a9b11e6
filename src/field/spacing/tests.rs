use hashbrown::HashSet;

use super::*;

/// A pseudo-random number from 0 to 1.
fn unit(seed: u64) -> f64 {
    (sample::position_hash([seed as f64 + 0.5; 3]) % (1 << 20)) as f64 / f64::from(1 << 20)
}

/// A box of particles one unit apart, each moved by up to `jitter` along each axis.
fn layers(counts: [usize; 3], jitter: f64) -> Vec<[f64; 3]> {
    let [x, y, z] = counts;
    (0..x * y * z)
        .map(|i| {
            let place = [i % x, i / x % y, i / (x * y)];
            [0, 1, 2]
                .map(|axis| place[axis] as f64 + jitter * (2.0 * unit((3 * i + axis) as u64) - 1.0))
        })
        .collect()
}

/// Copies of the particles, rotated so that no axis of their lattice is parallel to a coordinate
/// axis.
fn turned(particles: Vec<[f64; 3]>) -> Vec<[f64; 3]> {
    let turn = glam::DQuat::from_euler(glam::EulerRot::XYZ, 0.3, 0.7, 1.1);
    particles.into_iter().map(|p| (turn * DVec3::from(p) + 3.1).into()).collect()
}

/// Bars with `gap` empty layers between them, or sheets if `size` is the same along x and y.
fn bars(size: [usize; 3], gap: usize, jitter: f64) -> Vec<[f64; 3]> {
    let of = |at: [usize; 2]| {
        let mut bar = layers(size, jitter);
        let step = [size[1] + gap, size[2] + gap];
        bar.iter_mut().for_each(|p| {
            p[1] += (at[0] * step[0]) as f64;
            p[2] += (at[1] * step[1]) as f64;
        });
        bar
    };
    let rows = if size[0] == size[1] { 1 } else { 5 };
    turned((0..5 * rows).flat_map(|i| of([i / 5, i % 5])).collect())
}

fn estimated(particles: &[[f64; 3]]) -> SpacingEstimate {
    evidence(&particles).unwrap().estimate().unwrap()
}

fn part_of(particles: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let share = EvenSample::of(particles.len());
    particles.chunks(1000).for_each(|positions| share.add(positions));
    share.taken().positions
}

#[test]
fn a_sample_has_distinct_and_finite_positions() {
    let places = layers([30; 3], 1.0 / 3.0);
    for (copies, invalid) in [(1, 0), (1, 5), (2, 0), (3, 700)] {
        let share = EvenSample::of(places.len());
        let invalid = vec![[0.0, f64::NAN, f64::INFINITY]; invalid];
        let mut input = places.repeat(copies);
        input.splice(100..100, invalid);
        input.chunks(1000).for_each(|positions| share.add(positions));
        let mut taken = share.taken();
        let sorted = |positions: &mut Vec<[f64; 3]>| {
            positions.sort_unstable_by_key(|position| position.map(f64::to_bits));
            positions.clone()
        };
        assert_eq!(sorted(&mut taken.positions), sorted(&mut places.clone()));
        assert_eq!((taken.places, taken.bounds.finite), (places.len(), copies * places.len()));
        let all = bounds(&places).unwrap();
        assert_eq!((taken.bounds.lo, taken.bounds.hi), (all.lo, all.hi));
    }
}

#[test]
fn estimates_do_not_depend_on_the_order_of_many_particles() {
    let mut particles = layers([120; 3], 1.0 / 3.0);
    let first = evidence(&particles).unwrap();
    let spacing = first.estimate().unwrap().spacing;
    assert!((spacing - 1.0).abs() < 0.01, "{spacing}");
    assert!(part_of(&particles).len() < particles.len(), "the sample contains all particles");
    particles.reverse();
    particles.push([f64::NAN; 3]);
    assert_eq!(evidence(&particles), Some(first));
}

#[test]
fn a_sample_of_a_lattice_covers_its_columns_for_any_spacing() {
    for spacing in [1.0, 1.0 / 64.0, 0.02] {
        let side = 110;
        let of =
            |i: usize| [i % side, i / side % side, i / (side * side)].map(|c| c as f64 * spacing);
        let particles: Vec<[f64; 3]> = (0..side * side * side).map(of).collect();
        let part = part_of(&particles);
        for axis in 0..3 {
            let column = |p: &[f64; 3]| [p[(axis + 1) % 3], p[(axis + 2) % 3]].map(f64::to_bits);
            let columns: HashSet<[u64; 2]> = part.iter().map(column).collect();
            assert!(
                100 * columns.len() > 99 * side * side,
                "{} columns along {axis}",
                columns.len()
            );
        }
        let estimated = estimated(&particles).spacing;
        assert!((estimated / spacing - 1.0).abs() < 0.005, "{estimated} of {spacing}");
    }
}

#[test]
fn neighbours_measure_a_layer_that_is_too_thin_to_count_in_a_sample() {
    let particles = layers([500, 500, 10], 1.0 / 3.0);
    let part = part_of(&particles);
    let bounds = bounds(&part).unwrap();
    assert_eq!(density::spacings(&part, &bounds, ENOUGH_SHARE), None);
    let spacing = estimated(&particles).spacing;
    assert!((spacing - 1.0).abs() < 0.05, "{spacing}");
}

#[test]
fn deep_fluid_is_measured_by_counting_and_never_called_thin() {
    for side in [16, 30] {
        for jitter in [0.0, 0.1, 0.3, 0.5] {
            let found = estimated(&layers([side; 3], jitter));
            assert!(
                (found.spacing - 1.0).abs() < 0.02 && !found.thin,
                "{side} {jitter}: {found:?}"
            );
        }
    }
}

#[test]
fn a_deep_lattice_with_different_distances_along_its_axes_is_counted() {
    for scale in [[1.4, 1.0, 0.7], [1.6, 1.0, 0.625], [2.0, 1.0, 0.5], [1.0, 1.0, 2.0]] {
        for (side, jitter) in [(40, 0.0), (40, 0.1), (100, 0.0)] {
            let lattice = layers([side; 3], jitter);
            let stretched = |p: [f64; 3]| [0, 1, 2].map(|axis| p[axis] * scale[axis]);
            let found = estimated(&turned(lattice.into_iter().map(stretched).collect()));
            let spacing = scale.iter().product::<f64>().cbrt();
            assert!(
                (found.spacing / spacing - 1.0).abs() < 0.03 && !found.thin,
                "{scale:?}, {side}, {jitter}: {found:?}"
            );
        }
    }
}

#[test]
fn a_cloud_of_clumps_is_not_taken_for_deep_fluid() {
    for size in [3, 10, 40] {
        let clump = |i: u64| {
            let middle = [0, 1, 2].map(|axis| 120.0 * unit(7 * i + axis));
            let of = move |k: u64| {
                let apart =
                    |axis: usize| 1.3 * unit(9_000_000 + 131 * (i * size + k) + axis as u64);
                [0, 1, 2].map(|axis| middle[axis] + (size as f64).cbrt() * apart(axis))
            };
            (0..size).map(of)
        };
        let found = estimated(&(0..3000).flat_map(clump).collect::<Vec<_>>());
        assert!(found.thin && found.spacing < 1.6, "{size}: {found:?}");
    }
}

#[test]
fn a_hundred_particles_suffice_for_an_estimate() {
    for jitter in [0.0, 0.2, 0.4] {
        let found = estimated(&turned(layers([5, 5, 4], jitter)));
        assert!((found.spacing - 1.0).abs() < 0.12 && !found.thin, "{jitter}: {found:?}");
    }
}

#[test]
fn bars_and_sheets_with_gaps_are_measured_by_neighbours() {
    for width in 1..=5 {
        for gap in [1, 3, 5] {
            for jitter in [0.1, 0.3] {
                for size in [[40, width, width], [40, 40, width]] {
                    let found = estimated(&bars(size, gap, jitter));
                    let error = (found.spacing - 1.0).abs();
                    assert!(
                        error < 0.12 || found.thin && error < 0.25,
                        "{size:?} {gap} {jitter}: {found:?}"
                    );
                }
            }
        }
    }
}

#[test]
fn a_shell_is_measured_by_its_surface_density() {
    let shell: Vec<[f64; 3]> = (0..20_000)
        .map(|i| {
            let (z, turn) = (2.0 * unit(2 * i) - 1.0, std::f64::consts::TAU * unit(2 * i + 1));
            let round = (1.0 - z * z).sqrt();
            let radius = (20_000.0 / 4.0 / std::f64::consts::PI).sqrt();
            [radius * round * turn.cos(), radius * round * turn.sin(), radius * z]
        })
        .collect();
    let found = estimated(&shell);
    assert!((found.spacing - 1.0).abs() < 0.05 && found.thin, "{found:?}");
}

#[test]
fn spray_around_a_fluid_does_not_hide_its_spacing() {
    let mut particles = turned(layers([30; 3], 0.3));
    particles.extend((0..90_000).map(|i| [0, 1, 2].map(|axis| 500.0 * unit(7 * i + axis) - 200.0)));
    let found = estimated(&particles);
    assert!((found.spacing - 1.0).abs() < 0.05, "{found:?}");
}

#[test]
fn random_positions_are_distinguished_from_a_fluid() {
    for seed in 0..6 {
        let count = 20_000 + 2000 * seed;
        let length = (count as f64).cbrt();
        let coordinate = |i: u64| length * unit(i + 1_000_000 * seed);
        let random: Vec<[f64; 3]> =
            (0..count).map(|i| [0, 1, 2].map(|axis| coordinate(3 * i + axis))).collect();
        assert!(evidence(&random).unwrap().neighbours.is_random(), "{seed}");
    }
    // These particles are seeded eight per cell, as in FLIP.
    let seeded: Vec<[f64; 3]> = (0..27_000)
        .map(|i| {
            let cell = [i / 8 % 15, i / 120 % 15, i / 1800];
            [0, 1, 2].map(|axis| 2.0 * (cell[axis] as f64 + unit((3 * i + axis) as u64)))
        })
        .collect();
    for fluid in [seeded, layers([30; 3], 0.5)] {
        assert!(!evidence(&fluid).unwrap().neighbours.is_random());
    }
}

#[test]
fn duplicates_and_clumps_are_excluded() {
    let once = layers([24; 3], 0.3);
    let alone = estimated(&once);
    let twice = [once.clone(), once.clone()].concat();
    let parked = [once.clone(), vec![[90.0; 3]; 15_000]].concat();
    let parked_inside = [vec![once[100]; 9_000], once.clone()].concat();
    for (particles, places) in
        [(twice, once.len()), (parked, once.len() + 1), (parked_inside, once.len())]
    {
        let all = evidence(&particles).unwrap();
        // The sample may miss a clump at one position. `places` is then the number of all
        // particles.
        assert!([places, particles.len()].contains(&all.places), "{} places", all.places);
        let found = all.estimate().unwrap();
        assert!((found.spacing / alone.spacing - 1.0).abs() < 0.02, "{found:?}, not {alone:?}");
    }
    let places = |particles: &[[f64; 3]]| evidence(&particles).unwrap().estimate();
    assert_eq!(places(&[[1.0; 3]; 500]), Err(NoEstimate::Coincident { places: 1 }));
    assert_eq!(places(&[[1.0; 3], [2.0; 3]]), Err(NoEstimate::TooFew));
}

#[test]
fn coordinates_whose_squares_overflow_are_too_large_for_an_estimate() {
    let [near, far] = [1.0, 1e300].map(|scale| {
        let particles = layers([9; 3], 0.3);
        particles.into_iter().map(|p| p.map(|c| c * scale)).collect::<Vec<_>>()
    });
    assert!(evidence(&near).unwrap().estimate().is_ok());
    assert_eq!(evidence(&far).unwrap().estimate(), Err(NoEstimate::TooLarge));
}

#[test]
fn duplicates_and_clumps_are_excluded_from_a_sample_of_many() {
    let once = layers([90; 3], 0.3);
    let alone = estimated(&once);
    let twice = [once.clone(), once.clone()].concat();
    let parked = |at: f64| [once.clone(), vec![[at; 3]; 900_000]].concat();
    for particles in [twice, parked(0.0), parked(90.0), parked(1e7)] {
        let all = evidence(&particles).unwrap();
        assert!(
            (all.places as f64 / once.len() as f64 - 1.0).abs() < 0.02,
            "{} places",
            all.places
        );
        let found = all.estimate().unwrap();
        assert!((found.spacing / alone.spacing - 1.0).abs() < 0.02 && !found.thin, "{found:?}");
    }
    let places: Vec<[f64; 3]> = (0..600_000).map(|i| [f64::from(i % 6); 3]).collect();
    assert_eq!(evidence(&places).unwrap().estimate(), Err(NoEstimate::Coincident { places: 6 }));
}

#[test]
fn a_plane_of_particles_is_detected_only_if_all_lie_in_it() {
    let mut particles: Vec<[f64; 3]> =
        layers([800, 800, 1], 0.2).into_iter().map(|[x, y, _]| [x, y, 0.25]).collect();
    let found = evidence(&particles).unwrap();
    assert_eq!(found.place.plane, Some(Plane { axis: 2, at: 0.25 }));
    assert!((found.estimate().unwrap().spacing - 1.0).abs() < 0.03);
    particles[100_000][2] = 3.0;
    assert_eq!(evidence(&particles).unwrap().place.plane, None);
}

#[test]
fn many_particles_in_sheets_and_filaments_are_searched_at_their_scale() {
    let sheet = turned(layers([800, 800, 1], 0.2));
    let filaments = turned(bars([40_000, 1, 1], 6, 0.1));
    for particles in [sheet, filaments] {
        assert!(particles.len() > ALL);
        let found = estimated(&particles);
        assert!((found.spacing - 1.0).abs() < 0.12, "{found:?}");
        // Try drafts with a scale that is much too large or much too small.
        let share = EvenSample::of(particles.len());
        particles.chunks(1000).for_each(|positions| share.add(positions));
        let mut draft = SpacingDraft::of(share.taken()).unwrap();
        for factor in [100.0, 0.01] {
            draft.scale = factor;
            let again = SpacingDraft { place: draft.place, counted: draft.counted, ..draft };
            let found = again.completed(&particles).unwrap().estimate().unwrap();
            assert!((found.spacing - 1.0).abs() < 0.12, "{factor}: {found:?}");
        }
    }
}

#[test]
fn a_plane_across_any_axis_is_found_and_its_spacing_measured_in_it() {
    for axis in 0..3 {
        let mut particles = layers([50, 40, 1], 0.2);
        particles.iter_mut().for_each(|p| {
            p[2] = 0.25;
            p.rotate_right((axis + 1) % 3);
        });
        let found = evidence(&particles).unwrap();
        assert_eq!(found.place.plane, Some(Plane { axis, at: 0.25 }));
        let estimate = found.estimate().unwrap();
        assert!((estimate.spacing - 1.0).abs() < 0.03 && !estimate.thin, "{estimate:?}");
    }
    let mut stray = layers([12; 3], 0.2);
    stray.push([1e9, -1e9, 5.0]);
    assert_eq!(evidence(&stray).unwrap().place.plane, None, "one particle is far from the others");
    let tilted = turned(layers([50, 40, 1], 0.0));
    assert_eq!(evidence(&tilted).unwrap().place.plane, None);
    let wide: Vec<[f64; 3]> =
        layers([200, 200, 1], 0.2).into_iter().map(|[x, y, _]| [x, y, 2.9]).collect();
    assert!((estimated(&wide).spacing - 1.0).abs() < 0.03);
    let line = layers([50, 1, 1], 0.0);
    assert_eq!(evidence(&line).unwrap().place.plane, None);
}

#[test]
fn single_precision_is_detected_with_its_step() {
    let at = |from: f64| -> Vec<[f64; 3]> {
        let single = |c: f64| f64::from((0.05 * c + from) as f32);
        layers([20; 3], 0.3).into_iter().map(|p| p.map(single)).collect()
    };
    let far = evidence(&at(300_000.0)).unwrap();
    assert_eq!(far.place.step, Some(0.03125));
    assert!(far.estimate().is_ok());
    let farther = evidence(&at(3e6)).unwrap();
    assert_eq!(farther.estimate(), Err(NoEstimate::SinglePrecision { step: 0.25 }));
    // All of these coordinates are exact in single precision.
    let dyadic: Vec<[f64; 3]> =
        layers([20; 3], 0.0).into_iter().map(|p| p.map(|c| 0.5 * c + 3e6)).collect();
    let dyadic = evidence(&dyadic).unwrap();
    assert_eq!(dyadic.place.step, None);
    assert!((dyadic.estimate().unwrap().spacing / 0.5 - 1.0).abs() < 0.01);
    let double: Vec<[f64; 3]> =
        layers([20; 3], 0.3).into_iter().map(|p| p.map(|c| 0.05 * c + 3e6)).collect();
    let double = evidence(&double).unwrap();
    assert_eq!(double.place.step, None);
    assert!((double.estimate().unwrap().spacing / 0.05 - 1.0).abs() < 0.02);
}

#[test]
fn cube_samples_contain_all_particles_of_their_cubes_in_any_order() {
    let particles = layers([60; 3], 0.3);
    let sample_of = |chunk: usize, reverse: bool| {
        let in_cubes = CubeSample::new(Cubes::for_spacing(1.0), particles.len());
        let mut chunks: Vec<_> = particles.chunks(chunk).collect();
        if reverse {
            chunks.reverse();
        }
        chunks.iter().for_each(|positions| in_cubes.add(positions));
        let mut sample = in_cubes.sample();
        sample.positions.sort_unstable_by(|a, b| a.partial_cmp(b).unwrap());
        sample
    };
    let sample = sample_of(100, false);
    assert!((1000..=1 << 15).contains(&sample.positions.len()), "{}", sample.positions.len());
    assert_eq!(sample_of(7777, true).positions, sample.positions);
    let cube = |p: &[f64; 3]| p.map(|c| (c / 6.37 + 0.5).floor() as i64);
    let cubes: HashSet<[i64; 3]> = sample.positions.iter().map(cube).collect();
    let all = particles.iter().filter(|p| cubes.contains(&cube(p))).count();
    assert_eq!(all, sample.positions.len());
}

#[test]
fn samples_of_duplicates_do_not_depend_on_threads() {
    let once = layers([60; 3], 0.3);
    let twice = [once.clone(), once].concat();
    let taken = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let (in_cubes, share) =
                (CubeSample::few(Cubes::for_spacing(1.0), twice.len() / 8), EvenSample::of(1));
            twice.par_chunks(300).for_each(|positions| {
                in_cubes.add(positions);
                share.add(positions);
            });
            let sample = in_cubes.sample();
            (sample.positions, sample.coincident, share.taken().positions)
        })
    };
    let one = taken(1);
    assert_eq!((one.1, one.2.len()), (one.0.len(), twice.len() / 2));
    for _ in 0..4 {
        assert!(taken(8) == one);
    }
}

/// Particles whose reading is cancelled. `read` counts the positions that were read; once it
/// reaches `after`, all further positions are NaN.
struct Interrupted<'a> {
    particles: &'a [[f64; 3]],
    after: usize,
    read: std::sync::atomic::AtomicUsize,
}

impl Particles for Interrupted<'_> {
    fn len(&self) -> usize {
        self.particles.len()
    }

    fn positions(&self, first: usize, out: &mut [[f64; 3]]) {
        out.copy_from_slice(&self.particles[first..first + out.len()]);
        if !self.goes_on() {
            out.fill([f64::NAN; 3]);
        }
        self.read.fetch_add(out.len(), std::sync::atomic::Ordering::Relaxed);
    }

    fn goes_on(&self) -> bool {
        self.read.load(std::sync::atomic::Ordering::Relaxed) < self.after
    }
}

#[test]
fn a_cancel_ends_the_estimate_with_the_current_reading() {
    let many = layers([90; 3], 0.2);
    assert!(many.len() > ALL);
    let few = &many[..ALL / 2];
    for (particles, share) in [(few, 0.5), (&many, 0.0), (&many, 0.5), (&many, 1.5)] {
        let after = (particles.len() as f64 * share) as usize;
        let cancelled = Interrupted { particles, after, read: 0.into() };
        assert_eq!(evidence(&cancelled), None);
        let readings = cancelled.read.into_inner() / particles.len();
        assert_eq!(readings, share as usize + 1, "{} particles, {share} readings", particles.len());
        let cancelled = Interrupted { particles, after, read: 0.into() };
        assert_eq!(survey(&cancelled, 1.0).is_none(), share < 1.0);
    }
}
