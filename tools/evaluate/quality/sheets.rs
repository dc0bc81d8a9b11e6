//! Compares methods on stretched thin sheets, shells and filaments, and on spray: the number of
//! pieces and holes of the surface, and its volume.

use std::ops::Range;

use glam::{DVec3, IVec3};
use meniscus::internals::surface::mesh::Mesh;
use petgraph::unionfind::UnionFind;

use super::bodies::lattice;
use super::components::{Component, Count, components, handles};
use super::lines::{Board, Line, Lost, Points, Scene, cell_name};
use crate::sample::cuboid;
use crate::scene::Random;
use crate::tables::{figure, mean};
use crate::{Options, Outcome};

const CELLS: [f64; 2] = [0.5, 0.25];
/// The number of layers of the sheets, and the factors by which they are stretched.
const SHEETS: [(i32, &[f64]); 3] =
    [(1, &[1.0, 1.3, 1.6, 1.9]), (2, &[1.0, 1.3, 1.6, 1.9]), (3, &[1.3, 1.6])];
/// Number of particles along the edges of a sheet.
const WIDTH: i32 = 40;
const JITTER: f64 = 0.2;
/// Radius of a spherical shell, in spacings.
const RADIUS: f64 = 12.0;
/// Distance between the particles of a shell, in spacings.
const APART: f64 = 1.4;
/// Jitter of the particles of a shell, in spacings.
const SHELL_JITTER: f64 = 0.1;
/// The stretches of the crowns that stand on water. A crown is a tube of particles, as in a splash.
const CROWNS: [f64; 3] = [1.0, 1.3, 1.6];
/// The radius of a crown, in spacings.
const CROWN_RADIUS: f64 = 12.0;
/// The height of a crown, in spacings.
const CROWN_HEIGHT: f64 = 10.0;
/// Half the width, and the depth, of the water below a crown, in spacings.
const WATER: IVec3 = IVec3::new(20, 7, 20);
/// Number of filaments.
const FILAMENTS: usize = 24;
/// Number of particles of each filament.
const LINKS: usize = 20;
/// The factors by which filaments are stretched.
const STRETCHES: [f64; 3] = [1.4, 1.8, 2.1];
const FILAMENT_JITTER: f64 = 0.1;
/// Edge length, in spacings, of the box that contains the centres of the filaments.
const BOX: f64 = 60.0;
/// Minimum distance, in spacings, between particles of different filaments.
const CLEARANCE: f64 = 7.0;
/// Mean distances, in spacings, between the drops in a spray.
const SPRAY: [f64; 2] = [3.0, 4.0];
/// Number of drops in a spray.
const DROPS: usize = 1200;
/// Maximum distance, in spacings, between neighbours in a cluster.
const LINKAGE: f64 = 1.9;
/// The numbers of layers of the sheets that are stretched frame by frame.
const STRETCHED_LAYERS: [i32; 2] = [1, 2];
/// Number of frames in which the sheets of [`STRETCHED_LAYERS`] are stretched.
const FRAMES: usize = 30;
/// The stretch of the sheets of [`STRETCHED_LAYERS`] in the last frame.
const LAST_STRETCH: f64 = 2.4;

/// The cell sizes and the seeds of the random samples for the rows of a table.
struct Samples<'a> {
    cells: &'a [f64],
    seeds: Range<usize>,
}

pub fn run(options: &Options, board: &Board) -> Outcome<()> {
    let samples =
        Samples { cells: options.choose(&CELLS[..], &CELLS[..1]), seeds: 0..options.choose(3, 2) };
    sheet_table(board, &samples)?;
    crown_table(board, &samples)?;
    filament_table(board, &samples)?;
    spray_table(board, &samples)?;
    let (layers, frames) =
        options.choose((&STRETCHED_LAYERS[..], FRAMES), (&STRETCHED_LAYERS[..1], FRAMES / 2));
    stretching_table(board, &samples, layers, frames)
}

/// Describes a table row that says how torn the surfaces of scenes of one kind are.
fn tear_line(
    row: &str,
    cell: f64,
    scenes: Vec<Points>,
    tear: impl Fn(&Mesh) -> Tear + Send + Sync + 'static,
) -> Line {
    Line {
        rows: vec![format!("{row}, {}", cell_name(Some(cell)))],
        cell: Some(cell),
        lost: Lost::Scene,
        scenes: scenes.into_iter().map(Scene::from).collect(),
        read: Box::new(move |meshes| Ok(vec![text(meshes.iter().map(&tear).collect())])),
    }
}

fn stretch_text(layers: i32, stretch: f64) -> String {
    format!("{} stretched {stretch:.1} times", layers_text(layers))
}

/// Prints the table of sheets with a constant stretch, and of shells.
fn sheet_table(board: &Board, Samples { cells, seeds }: &Samples) -> Outcome<()> {
    let kinds = SHEETS
        .iter()
        .flat_map(|&(layers, stretches)| stretches.iter().map(move |&by| (layers, by)));
    let sheets = in_cells(kinds, cells).map(|((layers, stretch), cell)| {
        let scenes = seeds.clone().map(|seed| sheet(layers, stretch, seed)).collect();
        let volume = f64::from(WIDTH * WIDTH * layers);
        let tear = move |mesh: &Mesh| Tear::of_sheet(mesh, volume);
        tear_line(&stretch_text(layers, stretch), cell, scenes, tear)
    });
    let shells = cells.iter().map(|&cell| {
        let scenes: Vec<Points> = seeds.clone().map(shell).collect();
        let volume = scenes[0].len() as f64;
        let row = format!("shell of radius {RADIUS}, particles {APART} apart");
        tear_line(&row, cell, scenes, move |mesh| Tear::of_shell(mesh, volume))
    });
    board.table(
        &format!(
            "rotated sheets whose layers are 1 / stretch^2 apart, jittered by {JITTER}: pieces / \
             holes / volume relative to the particles', mean of {}",
            seeds.len()
        ),
        sheets.chain(shells).collect(),
    )
}

/// Prints the table of crowns that stand on water.
fn crown_table(board: &Board, Samples { cells, seeds }: &Samples) -> Outcome<()> {
    let kinds = [1, 2].into_iter().flat_map(|layers| CROWNS.map(|stretch| (layers, stretch)));
    let crowns = in_cells(kinds, cells).map(|((layers, stretch), cell)| {
        let scenes: Vec<Points> = seeds.clone().map(|seed| crown(layers, stretch, seed)).collect();
        let volume = scenes[0].len() as f64;
        let tear = move |mesh: &Mesh| Tear::of_sheet(mesh, volume);
        tear_line(&stretch_text(layers, stretch), cell, scenes, tear)
    });
    board.table(
        &format!(
            "crowns of radius {CROWN_RADIUS} that stand on water, jittered by {JITTER}: pieces / \
             holes / volume relative to the particles', mean of {}",
            seeds.len()
        ),
        crowns.collect(),
    )
}

fn filament_table(board: &Board, Samples { cells, seeds }: &Samples) -> Outcome<()> {
    let lines = in_cells(STRETCHES, cells).map(|(stretch, cell)| Line {
        rows: vec![format!("stretched {stretch} times, {}", cell_name(Some(cell)))],
        cell: Some(cell),
        lost: Lost::Scene,
        scenes: seeds.clone().map(|seed| filaments(stretch, seed).into()).collect(),
        read: Box::new(|meshes| {
            let counts = meshes.iter().map(|mesh| Count::of(&components(mesh).0));
            let pieces = mean(counts.clone().map(|count| count.components as f64));
            let volume = mean(counts.map(|count| count.volume));
            let [filaments, particles] = [FILAMENTS, FILAMENTS * LINKS].map(|count| count as f64);
            Ok(vec![format!("{:.2} / {:.2}", pieces / filaments, volume / particles)])
        }),
    });
    board.table(
        &format!(
            "filaments of {LINKS} particles, jittered by {FILAMENT_JITTER}: pieces per filament / \
             volume relative to the particles', mean of {} times {FILAMENTS}",
            seeds.len()
        ),
        lines.collect(),
    )
}

fn spray_table(board: &Board, Samples { cells, seeds }: &Samples) -> Outcome<()> {
    let lines = in_cells(SPRAY, cells).map(|(apart, cell)| {
        let scenes: Vec<Points> = seeds.clone().map(|seed| spray(apart, seed)).collect();
        let clusters: usize = scenes.iter().map(|scene| clusters(scene)).sum();
        Line {
            rows: vec![format!("{apart} apart on average, {}", cell_name(Some(cell)))],
            cell: Some(cell),
            lost: Lost::Scene,
            scenes: scenes.into_iter().map(Scene::from).collect(),
            read: Box::new(move |meshes| {
                let pieces: usize =
                    meshes.iter().map(|mesh| Count::of(&components(mesh).0).components).sum();
                Ok(vec![figure(pieces as f64 / clusters as f64)])
            }),
        }
    });
    board.table(
        &format!(
            "spray at random positions: pieces per cluster of particles that are at most \
             {LINKAGE} apart"
        ),
        lines.collect(),
    )
}

fn stretching_table(
    board: &Board,
    samples: &Samples,
    layers: &[i32],
    frames: usize,
) -> Outcome<()> {
    let lines = in_cells(layers.iter().copied(), samples.cells).map(|(layers, cell)| {
        let row =
            |what: &str| format!("{}, {}: {what}", layers_text(layers), cell_name(Some(cell)));
        let volume = f64::from(WIDTH * WIDTH * layers);
        Line {
            rows: [
                "stretch at the first hole",
                "frames in which holes close again",
                "largest change of volume before the first hole",
            ]
            .map(row)
            .into(),
            cell: Some(cell),
            lost: Lost::Scene,
            scenes: (0..frames)
                .map(|n| sheet(layers, stretch_in_frame(n, frames), 0).into())
                .collect(),
            read: Box::new(move |meshes| {
                let tears: Vec<Tear> =
                    meshes.iter().map(|mesh| Tear::of_sheet(mesh, volume)).collect();
                Ok(opening(&tears).into())
            }),
        }
    });
    board.table(
        &format!("sheets that stretch from 1 to {LAST_STRETCH} times in {frames} frames"),
        lines.collect(),
    )
}

/// All pairs of a kind and a cell size.
fn in_cells<T: Copy>(
    kinds: impl IntoIterator<Item = T>,
    cells: &[f64],
) -> impl Iterator<Item = (T, f64)> {
    kinds.into_iter().flat_map(|kind| cells.iter().map(move |&cell| (kind, cell)))
}

fn layers_text(layers: i32) -> String {
    format!("{layers} layer{}", if layers == 1 { "" } else { "s" })
}

/// The stretch of a sheet in a frame, from 1 to [`LAST_STRETCH`].
fn stretch_in_frame(frame: usize, frames: usize) -> f64 {
    1.0 + (LAST_STRETCH - 1.0) * frame as f64 / (frames - 1) as f64
}

/// The particles of a stretched sheet. The same seed gives the same jitter at every stretch.
fn sheet(layers: i32, stretch: f64, seed: usize) -> Points {
    let lattice = lattice(seed, JITTER);
    let size = IVec3::new(WIDTH, layers, WIDTH);
    let scale = DVec3::new(stretch, stretch.powi(-2), stretch);
    let mut random = Random::new(lattice.seed);
    let ordered = cuboid(IVec3::ZERO, size, 0.0, &mut Random::new(0));
    ordered
        .into_iter()
        .map(|p| {
            let place = scale * (DVec3::from(p) - size.as_dvec3() / 2.0);
            (lattice.shift + lattice.turn * (place + off(JITTER, &mut random))).into()
        })
        .collect()
}

/// The particles of water, and of a stretched crown that stands on it.
fn crown(layers: i32, stretch: f64, seed: usize) -> Points {
    let lattice = lattice(seed, JITTER);
    let mut random = Random::new(lattice.seed);
    let (lo, hi) = (-WATER, IVec3::new(WATER.x, 0, WATER.z));
    let water = cuboid(lo, hi, 0.0, &mut Random::new(0)).into_iter().map(DVec3::from);
    let around = (std::f64::consts::TAU * CROWN_RADIUS / stretch).round();
    let rows = (CROWN_HEIGHT / stretch) as i32;
    let at = |layer: i32, row: i32, n: i32| {
        let radius =
            CROWN_RADIUS + (f64::from(layer) - f64::from(layers - 1) / 2.0) * stretch.powi(-2);
        let (sin, cos) = (std::f64::consts::TAU * f64::from(n) / around).sin_cos();
        DVec3::new(radius * cos, (f64::from(row) + 0.5) * stretch, radius * sin)
    };
    let crown = (0..layers).flat_map(|layer| {
        (0..rows).flat_map(move |row| (0..around as i32).map(move |n| at(layer, row, n)))
    });
    water
        .chain(crown)
        .map(|place| (lattice.shift + lattice.turn * (place + off(JITTER, &mut random))).into())
        .collect()
}

/// A random offset with coordinates from -`jitter` to `jitter`.
fn off(jitter: f64, random: &mut Random) -> DVec3 {
    DVec3::from([(); 3].map(|()| jitter * (2.0 * random.unit() - 1.0)))
}

/// Evenly distributed points on the unit sphere: a spiral with equal steps in height, turned by the
/// golden angle at each step.
fn spiral(count: usize) -> impl Iterator<Item = DVec3> {
    let turn = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    (0..count).map(move |n| {
        let height = 1.0 - (2 * n + 1) as f64 / count as f64;
        let (sin, cos) = (turn * n as f64).sin_cos();
        let radius = (1.0 - height * height).sqrt();
        DVec3::new(radius * cos, height, radius * sin)
    })
}

fn shell(seed: usize) -> Points {
    let lattice = lattice(seed, SHELL_JITTER);
    let mut random = Random::new(lattice.seed);
    let count = (4.0 * std::f64::consts::PI * (RADIUS / APART).powi(2)).round() as usize;
    spiral(count)
        .map(|way| {
            let place = RADIUS * way + off(SHELL_JITTER, &mut random);
            (lattice.shift + lattice.turn * place).into()
        })
        .collect()
}

/// The particles of filaments in random directions, at random positions far apart.
fn filaments(stretch: f64, seed: usize) -> Points {
    let mut random = Random::new(seed as u64);
    let mut particles: Points = Vec::new();
    while particles.len() < FILAMENTS * LINKS {
        let height = 2.0 * random.unit() - 1.0;
        let (sin, cos) = (std::f64::consts::TAU * random.unit()).sin_cos();
        let radius = (1.0 - height * height).sqrt();
        let step = stretch * DVec3::new(radius * cos, height, radius * sin);
        let middle = DVec3::from([(); 3].map(|()| BOX * random.unit()));
        let filament: Vec<DVec3> = (0..LINKS)
            .map(|n| {
                middle
                    + (n as f64 - (LINKS - 1) as f64 / 2.0) * step
                    + off(FILAMENT_JITTER, &mut random)
            })
            .collect();
        let is_far =
            |p: &DVec3| particles.iter().all(|&other| p.distance(DVec3::from(other)) > CLEARANCE);
        if filament.iter().all(is_far) {
            particles.extend(filament.into_iter().map(<[f64; 3]>::from));
        }
    }
    particles
}

/// Random particles in a box, on average one in each cube of edge `apart`.
fn spray(apart: f64, seed: usize) -> Points {
    let mut random = Random::new(seed as u64);
    let edge = apart * (DROPS as f64).cbrt();
    (0..DROPS).map(|_| [(); 3].map(|()| edge * random.unit())).collect()
}

/// The number of clusters: sets of particles that are connected by distances of at most
/// [`LINKAGE`].
fn clusters(particles: &[[f64; 3]]) -> usize {
    let mut joined = UnionFind::<usize>::new(particles.len());
    let pairs = (0..particles.len()).flat_map(|a| (0..a).map(move |b| (a, b)));
    let are_near = |&(a, b): &(usize, usize)| {
        DVec3::from(particles[a]).distance(DVec3::from(particles[b])) <= LINKAGE
    };
    particles.len() - pairs.filter(are_near).filter(|&(a, b)| joined.union(a, b)).count()
}

/// How intact the surface of a sheet is.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Tear {
    pieces: usize,
    holes: i64,
    /// The volume of the surface, divided by the volume of the particles.
    volume: f64,
}

impl Tear {
    fn of_sheet(mesh: &Mesh, volume: f64) -> Self {
        let count = Count::of(&components(mesh).0);
        Self { pieces: count.components, holes: handles(mesh), volume: count.volume / volume }
    }

    /// Measures a shell. An intact shell has an inner and an outer surface. The first hole joins
    /// the two surfaces, and only further holes are handles.
    fn of_shell(mesh: &Mesh, volume: f64) -> Self {
        let is_inner = |component: &Component| {
            component.volume < 0.0 && (component.hi - component.lo).min_element() > RADIUS
        };
        let first = !components(mesh).0.iter().any(is_inner);
        let tear = Self::of_sheet(mesh, volume);
        Self { holes: tear.holes + i64::from(first), ..tear }
    }

    fn is_open(&self) -> bool {
        self.pieces != 1 || self.holes > 0
    }
}

fn text(tears: Vec<Tear>) -> String {
    let count =
        |value: f64| if value.fract() == 0.0 { value.to_string() } else { format!("{value:.1}") };
    let pieces = mean(tears.iter().map(|tear| tear.pieces as f64));
    let holes = mean(tears.iter().map(|tear| tear.holes as f64));
    let volume = mean(tears.iter().map(|tear| tear.volume));
    format!("{} / {} / {volume:.2}", count(pieces), count(holes))
}

/// Describes how a sheet that is stretched frame by frame tears. Returns three texts: the stretch
/// at which it opens; the number of later frames in which holes close; and the largest relative
/// change of volume between two frames before it opens.
fn opening(tears: &[Tear]) -> [String; 3] {
    let opens = tears.iter().position(Tear::is_open);
    let (whole, open) = tears.split_at(opens.unwrap_or(tears.len()));
    let closes = |pair: &&[Tear]| pair[1].holes < pair[0].holes && pair[1].pieces <= pair[0].pieces;
    let change = |pair: &[Tear]| (pair[1].volume / pair[0].volume - 1.0).abs();
    [
        opens.map_or("never".into(), |frame| {
            format!("{:.2} (frame {frame})", stretch_in_frame(frame, tears.len()))
        }),
        open.windows(2).filter(closes).count().to_string(),
        figure(whole.windows(2).map(change).fold(0.0, f64::max)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::meshes::{moved, sphere, torus, union};

    #[test]
    fn particles_are_as_far_apart_as_the_stretch() {
        let sheet = sheet(2, 1.5, 1);
        assert_eq!(sheet.len(), 3200);
        let [one, other] = [sheet[0], sheet[79]].map(DVec3::from);
        let diagonal = DVec3::new(1.5 * 39.0, 1.0 / 2.25, 0.0).length();
        assert!((one.distance(other) - diagonal).abs() < 4.0 * JITTER, "{one} {other}");

        let crown = crown(1, 1.5, 0);
        assert_eq!(crown.len(), 40 * 40 * 7 + 50 * 6);
        let shell = shell(0);
        let nearest = |(n, &p): (usize, &[f64; 3])| {
            let others = shell.iter().enumerate().filter(|&(other, _)| other != n);
            let distances = others.map(|(_, &other)| DVec3::from(p).distance(DVec3::from(other)));
            distances.fold(f64::INFINITY, f64::min)
        };
        let apart = mean(shell.iter().enumerate().map(nearest));
        assert!((apart / APART - 1.0).abs() < 0.15, "{apart}");
    }

    #[test]
    fn each_filament_is_one_cluster() {
        let filaments = filaments(1.4, 0);
        assert_eq!((filaments.len(), clusters(&filaments)), (FILAMENTS * LINKS, FILAMENTS));
        assert_eq!(clusters(&[[0.0; 3], [1.5, 0.0, 0.0], [3.0, 0.0, 0.0], [9.0; 3]]), 2);
    }

    #[test]
    fn the_first_hole_of_a_shell_joins_its_inner_surface_to_the_outer_one() {
        let mut inner = sphere(10.0, 2);
        inner.triangles.iter_mut().for_each(|triangle| triangle.swap(0, 1));
        let whole = Tear::of_shell(&union(&sphere(13.0, 2), &inner), 1.0);
        assert_eq!((whole.pieces, whole.holes), (1, 0));
        let open = Tear::of_shell(&sphere(13.0, 2), 1.0);
        assert_eq!((open.pieces, open.holes), (1, 1));
        let ring = union(&torus(24, 12), &moved(&sphere(1.0, 2), [9.0, 0.0, 0.0]));
        let ring = Tear::of_sheet(&ring, 1.0);
        assert_eq!((ring.pieces, ring.holes), (2, 1));
    }

    #[test]
    fn a_sheet_opens_once_and_its_holes_close_again() {
        let tear = |(pieces, holes, volume)| Tear { pieces, holes, volume };
        let tears = [(1, 0, 1.0), (1, 0, 1.1), (1, 3, 1.2), (1, 2, 1.2), (1, 4, 1.2), (3, 2, 1.2)];
        let found = opening(&tears.map(tear));
        assert_eq!(found, ["1.56 (frame 2)".into(), "1".into(), "0.100".to_owned()]);
        assert_eq!(opening(&[tear((1, 0, 1.0))])[0], "never");
        assert_eq!(text(tears[1..3].iter().copied().map(tear).collect()), "1 / 1.5 / 1.15");
    }
}
