//! Compares methods on particles of several sizes: pools of different sizes next to each other,
//! sizes mixed at random, lone drops, and fine particles in and on coarse water.

use glam::{DVec2, DVec3};
use meniscus::internals::surface::mesh::Mesh;

use super::bodies::JITTER;
use super::components::{Count, components};
use super::heights::{Columns, Top};
use super::level::deviation;
use super::lines::{Board, Line, Lost, Scene};
use crate::sample::unit_cube_point;
use crate::scene::Random;
use crate::tables::{figure, mean, signed};
use crate::{Options, Outcome};

/// Edge length of a pool of one size.
const WIDTH: f64 = 64.0;
/// Depth of a pool of one size.
const DEPTH: f64 = 24.0;
/// Heights are measured only where the edges of the water are at least this far away.
const MARGIN: f64 = 12.0;
/// The sizes of single particles that become drops.
const DROPS: [f64; 4] = [1.0, 2.0, 4.0, 8.0];
/// The distance between neighbouring drops, in sizes of the larger drop.
const APART: f64 = 20.0;
/// The radius of the ball of fine particles.
const RADIUS: f64 = 10.0;
/// The thickness of the layer of fine particles.
const LAYER: f64 = 4.0;
/// The size of the particles of the water under the ball or the layer.
const COARSE: f64 = 4.0;

/// Particles with their sizes.
#[derive(Default)]
struct Water {
    points: Vec<[f64; 3]>,
    sizes: Vec<f64>,
}

impl Water {
    /// Adds jittered particles of one size on a lattice in a box, where `holds` returns true.
    fn fill(
        &mut self,
        [lo, hi]: [DVec3; 2],
        size: f64,
        random: &mut Random,
        holds: impl Fn(DVec3) -> bool,
    ) {
        let counts = ((hi - lo) / size).round().as_uvec3();
        for z in 0..counts.z {
            for y in 0..counts.y {
                for x in 0..counts.x {
                    let middle = DVec3::new(x.into(), y.into(), z.into()) + 0.5;
                    let jitter = [(); 3].map(|()| JITTER * (2.0 * random.unit() - 1.0));
                    let at = lo + size * (middle + DVec3::from(jitter));
                    if holds(lo + size * middle) {
                        self.points.push(at.into());
                        self.sizes.push(size);
                    }
                }
            }
        }
    }

    fn volume(&self) -> f64 {
        self.sizes.iter().map(|size| size.powi(3)).sum()
    }

    /// The scene, moved to the position within a cell that `seed` determines.
    fn scene(self, seed: usize) -> Scene {
        let moved = |p: [f64; 3]| (DVec3::from(p) + unit_cube_point(seed)).into();
        let points = self.points.into_iter().map(moved).collect();
        Scene { points, sizes: Some(self.sizes) }
    }
}

fn random(seed: usize) -> Random {
    Random::new(40 + seed as u64)
}

/// Pools of different sizes in a row along x. Their top is at y = 0.
fn pools(sizes: &[f64], seed: usize) -> Water {
    let (mut water, mut random) = (Water::default(), random(seed));
    for (i, &size) in sizes.iter().enumerate() {
        let lo = DVec3::new(WIDTH * i as f64, -DEPTH, 0.0);
        water.fill([lo, lo + DVec3::new(WIDTH, DEPTH, WIDTH)], size, &mut random, |_| true);
    }
    water
}

/// A pool of cubes with either one particle of size 2 or eight of size 1.
fn mixed(seed: usize) -> Water {
    let (mut water, mut random) = (Water::default(), random(seed));
    let counts = (DVec3::new(WIDTH, DEPTH, WIDTH) / 2.0).as_uvec3();
    for i in 0..counts.element_product() {
        let cube = [i % counts.x, i / counts.x % counts.y, i / (counts.x * counts.y)];
        let lo = 2.0 * DVec3::from(cube.map(f64::from)) - DVec3::new(0.0, DEPTH, 0.0);
        let size = if random.unit() < 0.5 { 1.0 } else { 2.0 };
        water.fill([lo, lo + 2.0], size, &mut random, |_| true);
    }
    water
}

/// Lone particles in a row along x.
fn drops(seed: usize) -> Water {
    let mut random = random(seed);
    let mut water = Water::default();
    for size in DROPS {
        let off = DVec3::from([(); 3].map(|()| size * random.unit()));
        water.points.push((drop_place(size) + off).into());
        water.sizes.push(size);
    }
    water
}

fn drop_place(size: f64) -> DVec3 {
    APART * 2.0 * size * DVec3::X
}

/// A ball of fine particles that is half immersed in coarse water.
fn ball(seed: usize) -> Water {
    let (mut water, mut random) = (Water::default(), random(seed));
    let centre = DVec3::new(WIDTH / 2.0, 0.0, WIDTH / 2.0);
    let inside = |at: DVec3| at.distance(centre) < RADIUS;
    let pool = [DVec3::new(0.0, -DEPTH, 0.0), DVec3::new(WIDTH, 0.0, WIDTH)];
    water.fill(pool, COARSE, &mut random, |at| !inside(at));
    water.fill([centre - RADIUS, centre + RADIUS], 1.0, &mut random, inside);
    water
}

/// A layer of fine particles on coarse water.
fn layer(seed: usize) -> Water {
    let (mut water, mut random) = (Water::default(), random(seed));
    let pool = [DVec3::new(0.0, -DEPTH, 0.0), DVec3::new(WIDTH, -LAYER, WIDTH)];
    water.fill(pool, COARSE, &mut random, |_| true);
    let layer = [DVec3::new(0.0, -LAYER, 0.0), DVec3::new(WIDTH, 0.0, WIDTH)];
    water.fill(layer, 1.0, &mut random, |_| true);
    water
}

/// The mean error of the height between two values of x, and the RMS deviation from this mean, both
/// in units of `size`.
fn level(meshes: &[Mesh], [from, to]: [f64; 2], size: f64) -> String {
    let of = meshes.iter().enumerate().map(|(seed, mesh)| {
        let moved = unit_cube_point(seed);
        let lo = DVec2::new(from + moved.x, MARGIN + moved.z);
        let hi = DVec2::new(to + moved.x, WIDTH - MARGIN + moved.z);
        let tops: Vec<Top> = Columns::over(lo, hi).tops(mesh).into_iter().flatten().collect();
        deviation(&tops, moved.y)
    });
    let of: Vec<[f64; 3]> = of.collect();
    let [bias, rms] = [0, 1].map(|n| mean(of.iter().map(|figures| figures[n])) / size);
    format!("{}, {}", signed(bias), figure(rms))
}

/// The numbers of pieces and bubbles of all meshes, and the mean ratio of a mesh's volume to the
/// volume of its particles.
fn whole(meshes: &[Mesh], volumes: &[f64]) -> [String; 2] {
    let counts: Vec<Count> = meshes.iter().map(|mesh| Count::of(&components(mesh).0)).collect();
    let pieces: usize = counts.iter().map(|count| count.components).sum();
    let bubbles: usize = counts.iter().map(|count| count.bubbles).sum();
    let volume = mean(counts.iter().zip(volumes).map(|(count, volume)| count.volume / volume));
    [format!("{pieces}, {bubbles}"), figure(volume)]
}

pub fn run(options: &Options, board: &Board) -> Outcome<()> {
    let seeds = options.choose(0..3_usize, 0..1);
    let scenes = |water: &dyn Fn(usize) -> Water| -> (Vec<Scene>, Vec<f64>) {
        seeds
            .clone()
            .map(|seed| {
                let water = water(seed);
                let volume = water.volume();
                (water.scene(seed), volume)
            })
            .unzip()
    };
    let line = |rows: Vec<String>, water: &dyn Fn(usize) -> Water, read: ReadWater| {
        let (scenes, volumes) = scenes(water);
        Line {
            rows,
            cell: None,
            scenes,
            lost: Lost::Row,
            read: Box::new(move |meshes| Ok(read(meshes, &volumes))),
        }
    };
    let mut lines = Vec::new();
    for sizes in [&[1.0, 2.0][..], &[1.0, 2.0, 4.0]] {
        let names: Vec<String> = sizes.iter().map(|size| size.to_string()).collect();
        let pool = format!("pools of {}", names.join(", "));
        let seams = sizes.windows(2).map(|two| format!("seam {} to {}", two[0], two[1]));
        let parts = sizes.iter().map(|size| format!("size {size}")).chain(seams);
        let rows = parts.map(|part| format!("{pool}, {part}: bias, RMS"));
        let more = ["pieces, bubbles", "volume"].map(|what| format!("{pool}: {what}"));
        let read = move |meshes: &[Mesh], volumes: &[f64]| {
            let part = |(i, &size): (usize, &f64)| {
                let (first, margin) = (WIDTH * i as f64, MARGIN.max(2.0 * size));
                level(meshes, [first + margin, first + WIDTH - margin], size)
            };
            let seam = |(i, &size): (usize, &f64)| {
                let seam = WIDTH * i as f64;
                level(meshes, [seam - 2.0 * size, seam + 2.0 * size], size)
            };
            let parts = sizes.iter().enumerate().map(part);
            let seams = sizes.iter().enumerate().skip(1).map(seam);
            parts.chain(seams).chain(whole(meshes, volumes)).collect()
        };
        lines.push(line(rows.chain(more).collect(), &|seed| pools(sizes, seed), Box::new(read)));
    }
    let in_middle = |what: &str, size: f64| -> (Vec<String>, ReadWater) {
        let rows = ["bias, RMS", "pieces, bubbles", "volume"].map(|row| format!("{what}: {row}"));
        let read = move |meshes: &[Mesh], volumes: &[f64]| {
            let middle = level(meshes, [MARGIN, WIDTH - MARGIN], size);
            [middle].into_iter().chain(whole(meshes, volumes)).collect()
        };
        (rows.into(), Box::new(read))
    };
    let (rows, read) = in_middle("sizes 1 and 2 mixed at random", 2.0);
    lines.push(line(rows, &mixed, read));
    let (rows, read) = in_middle("a layer of size 1 on water of size 4", 1.0);
    lines.push(line(rows, &layer, read));
    let rows = ["pieces, bubbles", "volume"]
        .map(|row| format!("a ball of size 1 in water of size 4: {row}"));
    lines.push(line(rows.into(), &ball, Box::new(|meshes, volumes| whole(meshes, volumes).into())));
    let names: Vec<String> = DROPS.iter().map(|size| size.to_string()).collect();
    let rows = vec![format!("lone drops of {}: mean volume of each, 0 if lost", names.join(", "))];
    lines.push(line(rows, &drops, Box::new(|meshes, _| vec![of_drops(meshes)])));
    board.table(
        "particles of several sizes, jittered by 0.3 sizes: mean of 3, total numbers of pieces and \
         bubbles; bias and RMS are in particle sizes, at seams in the coarser size; volume is \
         relative to the particles'",
        lines,
    )
}

/// Measures the meshes of all seeds, given the volumes of their particles.
type ReadWater = Box<dyn Fn(&[Mesh], &[f64]) -> Vec<String> + Send + Sync>;

/// For each size, the mean volume of the drops, divided by the volume of a particle.
fn of_drops(meshes: &[Mesh]) -> String {
    let of = |size: f64| {
        let near = |at: DVec3| (at - drop_place(size)).abs().max_element() < APART * size / 2.0;
        mean(meshes.iter().map(|mesh| {
            let (found, _) = components(mesh);
            let drop = found.iter().filter(|component| near(component.centre()));
            Count::of(drop).volume / size.powi(3)
        }))
    };
    DROPS.map(|size| format!("{:.2}", of(size))).join(", ")
}
