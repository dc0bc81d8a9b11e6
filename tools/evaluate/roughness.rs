//! How smooth surfaces of jittered particles are, and what of thin sheets and drops is left.

use glam::{DQuat, DVec3, IVec3};
use meniscus::frame::{FrameError, Normals};
use meniscus::laps::Laps;
use meniscus::mesh::Mesh;
use meniscus::mesh::measure::measure;

use crate::meshes::sphere;
use crate::methods::{Method, grid};
use crate::sample::{Lattice, cuboid, fill, place};
use crate::scene::Random;
use crate::shapes::Solid;
use crate::tables::{Table, figure, mean, signed};
use crate::{Options, Outcome};

const CELLS: [f64; 3] = [0.5, 1.0, 1.5];
const JITTER: f64 = 0.3;
/// Edge of pools and sheets, in spacings; what is within `MARGIN` of their ends is not looked at.
const WIDTH: i32 = 48;
const MARGIN: f64 = 12.0;
/// Drops of each kind along either axis of the pool, and the steps between them.
const DROPS: i32 = 7;
const STEP: i32 = 10;

pub fn run(options: &Options) -> Outcome<()> {
    let mut surfaces =
        Table::new(&["cell / spacing", "method", "pool: bias", "pool: RMS", "ball: bias", "ball: RMS"]);
    let mut sheets = Table::new(&["cell / spacing", "method", "1 layer", "2 layers", "3 layers"]);
    let mut drops = Table::new(&["cell / spacing", "method", "1 particle", "2 particles", "8 particles"]);
    let ball = Solid::new("ball", sphere(1.0, 5), options.choose(30_000, 5_000))?;
    for &cell in options.choose(&CELLS[..], &CELLS[1..2]) {
        let detailed = Method::ALL.iter().filter_map(|method| method.detailed());
        for method in &Method::ALL.iter().copied().chain(detailed).collect::<Vec<_>>() {
            let about = || [cell.to_string(), method.name()].into_iter();
            let of_pool = pool(method, cell)?;
            let of_ball = around(method, &ball, cell)?;
            surfaces.row(about().chain([of_pool, of_ball].into_iter().flat_map(Deviation::text)));
            let layers: Outcome<Vec<_>> = (1..=3).map(|layers| sheet(method, cell, layers)).collect();
            sheets.row(about().chain(layers?));
            let kinds = [IVec3::ONE, IVec3::new(2, 1, 1), IVec3::splat(2)];
            let kept: Outcome<Vec<_>> =
                kinds.into_iter().map(|size| drops_kept(method, cell, size)).collect();
            drops.row(about().chain(kept?));
        }
    }
    surfaces.print(
        "deviation from the true surface, in spacings, of a level pool and a ball, jittered by 0.3: \
         its mean, and its RMS about the mean",
    );
    sheets.print(
        "sheets of jittered particles above a pool: pieces, holes in them, mean thickness in spacings",
    );
    drops.print(&format!("drops kept of {} above a pool", DROPS * DROPS));
    Ok(())
}

/// Signed distances of vertices from where they ought to be.
pub struct Deviation {
    pub bias: f64,
    pub rms: f64,
}

impl Deviation {
    fn of(distances: &[f64]) -> Self {
        let bias = mean(distances.iter().copied());
        let rms = mean(distances.iter().map(|distance| (distance - bias).powi(2))).sqrt();
        Self { bias, rms }
    }

    fn text(self) -> [String; 2] {
        [signed(self.bias), figure(self.rms)]
    }
}

/// No mesh where there is no surface.
fn mesh(method: &Method, particles: &[[f64; 3]], cell: f64) -> Outcome<Mesh> {
    match method.surface(particles, grid(cell)?, 1.0, Normals::None, &mut Laps::default()) {
        Err(FrameError::NoSurface { .. }) => Ok(Mesh::default()),
        surface => Ok(surface?.to_mesh()?),
    }
}

/// Seeds that differ, and a place in a cell.
fn shifted(particles: Vec<[f64; 3]>, cell: f64, number: usize) -> Vec<[f64; 3]> {
    let shift = cell * place(number);
    particles.into_iter().map(|p| (DVec3::from(p) + shift).into()).collect()
}

/// The surface of a pool whose layers are level, at several heights of the pool in a cell.
pub fn pool(method: &Method, cell: f64) -> Outcome<Deviation> {
    let mut deviations = Vec::new();
    for number in 0..4 {
        let mut random = Random::new(number as u64);
        let box_ = cuboid(IVec3::new(0, -12, 0), IVec3::new(WIDTH, 0, WIDTH), JITTER, &mut random);
        let mesh = mesh(method, &shifted(box_, cell, number), cell)?;
        let top = cell * place(number).y;
        let on_top = mesh.positions.iter().filter(|p| is_central(p) && p[1] > top - 6.0);
        deviations.push(Deviation::of(&on_top.map(|p| p[1] - top).collect::<Vec<_>>()));
    }
    Ok(Deviation {
        bias: mean(deviations.iter().map(|d| d.bias)),
        rms: mean(deviations.iter().map(|d| d.rms)),
    })
}

fn is_central(p: &[f64; 3]) -> bool {
    let within = MARGIN..f64::from(WIDTH) - MARGIN;
    within.contains(&p[0]) && within.contains(&p[2])
}

fn around(method: &Method, ball: &Solid, cell: f64) -> Outcome<Deviation> {
    let lattice = Lattice { shift: place(0), turn: DQuat::IDENTITY, jitter: JITTER, inset: 0.0, seed: 1 };
    let mesh = mesh(method, &fill(ball, &lattice), cell)?;
    let outside = mesh.positions.iter().map(|&p| -ball.depth(p.into()));
    // What is deep inside is a bubble, and no roughness.
    Ok(Deviation::of(&outside.filter(|distance| distance.abs() < 4.0).collect::<Vec<_>>()))
}

/// The pieces, holes and thickness of a sheet above a pool, which is there for its plateau.
fn sheet(method: &Method, cell: f64, layers: i32) -> Outcome<String> {
    let mut random = Random::new(1);
    let mut particles = cuboid(IVec3::new(0, -28, 0), IVec3::new(WIDTH, -16, WIDTH), JITTER, &mut random);
    particles.extend(cuboid(IVec3::ZERO, IVec3::new(WIDTH, layers, WIDTH), JITTER, &mut random));
    let sheet = above(&mesh(method, &shifted(particles, cell, 1), cell)?, -8.0);
    if sheet.triangles.is_empty() {
        return Ok("none".into());
    }
    let measures = measure(&sheet);
    let holes = measures.genus.ok_or("a sheet is not closed")?;
    let thickness = measures.volume.unwrap_or(0.0) / f64::from(WIDTH * WIDTH);
    Ok(format!("{} pieces, {holes} holes, {thickness:.2}", measures.components))
}

/// How many drops of `size` particles are left above a pool.
fn drops_kept(method: &Method, cell: f64, size: IVec3) -> Outcome<String> {
    let mut random = Random::new(2);
    let width = DROPS * STEP;
    let mut particles = cuboid(IVec3::new(0, -12, 0), IVec3::new(width, 0, width), JITTER, &mut random);
    for number in 0..DROPS * DROPS {
        let corner = IVec3::new(number % DROPS, 1, number / DROPS) * STEP;
        let drop = cuboid(corner, corner + size, JITTER, &mut random);
        particles.extend(shifted(drop, 1.0, number as usize));
    }
    let drops = above(&mesh(method, &particles, cell)?, f64::from(STEP) / 2.0);
    Ok(measure(&drops).components.to_string())
}

/// The triangles above a height.
fn above(mesh: &Mesh, height: f64) -> Mesh {
    let above = |triangle: &&[u32; 3]| triangle.iter().all(|&v| mesh.positions[v as usize][1] > height);
    let triangles = mesh.triangles.iter().filter(above).copied().collect();
    Mesh { positions: mesh.positions.clone(), triangles, ..Mesh::default() }
}
