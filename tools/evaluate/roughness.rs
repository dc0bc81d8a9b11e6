//! Measures how smooth the surfaces of jittered particles are, and how many thin sheets and drops
//! remain.

use glam::{DQuat, DVec3, IVec3};
use meniscus::internals::frame::{Detail, FrameError, Normals};
use meniscus::internals::surface::mesh::Mesh;
use meniscus::internals::surface::mesh::measure::measure;
use meniscus::internals::system::timings::Timings;

use crate::meshes::sphere;
use crate::methods::{Iso, Method, grid};
use crate::sample::{Lattice, cuboid, fill, unit_cube_point};
use crate::scene::Random;
use crate::shapes::Solid;
use crate::tables::{Table, figure, mean, signed};
use crate::{Options, Outcome};

const CELLS: [f64; 3] = [2.0 / 3.0, 1.0, 1.5];
const JITTER: f64 = 0.3;
/// Edge length of pools and sheets, in spacings.
pub const WIDTH: i32 = 48;
/// Measurements ignore the parts of pools and sheets within this distance of the edges.
const MARGIN: f64 = 12.0;
/// Vertices deeper than this, in spacings, belong to bubbles and not to the surface.
const NEAR: f64 = 2.0;
/// Number of drops of each size along each axis of the pool.
const DROPS: i32 = 7;
/// Distance between drops, in spacings.
const STEP: i32 = 10;

pub fn run(options: &Options) -> Outcome<()> {
    let mut surfaces = Table::new(&[
        "cell / spacing",
        "method",
        "pool: bias",
        "pool: RMS",
        "pool: within",
        "ball: bias",
        "ball: RMS",
        "ball: within",
    ]);
    let mut sheets = Table::new(&["cell / spacing", "method", "1 layer", "2 layers", "3 layers"]);
    let mut drops =
        Table::new(&["cell / spacing", "method", "1 particle", "2 particles", "8 particles"]);
    let ball = Solid::new("ball", sphere(1.0, 5), options.choose(30_000, 5_000))?;
    for &cell in options.choose(&CELLS[..], &CELLS[1..2]) {
        let narrower = [Method::symmetry(0.8, Iso::Auto), Method::counting(0.8, Iso::Auto)];
        let lower = [Method::symmetry(1.0, Iso::At(0.1)), Method::counting(1.0, Iso::At(0.1))];
        let detailed = Method::detailed(Detail::Recovered);
        let methods = Method::ALL.iter().copied().chain(narrower).chain(lower).chain(detailed);
        for method in &methods.collect::<Vec<_>>() {
            let about = || [figure(cell), method.name()].into_iter();
            let of_pool = pool_deviation(method, cell)?;
            let of_ball = ball_deviation(method, &ball, cell)?;
            surfaces.row(about().chain([of_pool, of_ball].into_iter().flat_map(Deviation::text)));
            let layers: Outcome<Vec<_>> =
                (1..=3).map(|layers| sheet(method, cell, layers)).collect();
            sheets.row(about().chain(layers?));
            let kinds = [IVec3::ONE, IVec3::new(2, 1, 1), IVec3::splat(2)];
            let kept: Outcome<Vec<_>> =
                kinds.into_iter().map(|size| drops_kept(method, cell, size)).collect();
            drops.row(about().chain(kept?));
        }
    }
    surfaces.print(
        "deviation from the true surface, in spacings, of a level pool and a ball, jittered by \
         0.3: the mean (bias), and the RMS around the mean; within: the number of additional \
         components and handles of four pools, and of the ball",
    );
    sheets.print(
        "sheets of jittered particles above a pool: components, holes, mean thickness in spacings",
    );
    drops.print(&format!(
        "number of components of {} drops above a pool: with fewer components, drops are lost; \
         with more, drops are torn",
        DROPS * DROPS
    ));
    Ok(())
}

/// The errors of a surface.
pub struct Deviation {
    pub bias: f64,
    pub rms: f64,
    /// Number of additional components (bubbles and small pieces) plus number of handles.
    within: i64,
}

impl Deviation {
    /// Computes the errors from the vertices' signed distances to the true surface. Deep vertices
    /// belong to bubbles, and do not count as roughness.
    fn of(mesh: &Mesh, distances: impl Iterator<Item = f64>) -> Self {
        let near: Vec<f64> = distances.filter(|&distance| distance > -NEAR).collect();
        let bias = mean(near.iter().copied());
        let rms = mean(near.iter().map(|distance| (distance - bias).powi(2))).sqrt();
        let measures = measure(mesh);
        Self { bias, rms, within: measures.components as i64 - 1 + measures.genus.unwrap_or(0) }
    }

    fn text(self) -> [String; 3] {
        [signed(self.bias), figure(self.rms), self.within.to_string()]
    }
}

/// The mesh of particles; an empty mesh if the method finds no surface.
fn mesh(method: &Method, particles: &[[f64; 3]], cell: f64) -> Outcome<Mesh> {
    match method.surface(particles, grid(cell)?, 1.0, Normals::None, &mut Timings::default()) {
        Err(FrameError::NoSurface { .. } | FrameError::TooFine(_)) => Ok(Mesh::default()),
        surface => Ok(surface?.to_mesh()?),
    }
}

/// Moves particles to position `number` within a cell.
fn shifted(particles: Vec<[f64; 3]>, cell: f64, number: usize) -> Vec<[f64; 3]> {
    let shift = cell * unit_cube_point(number);
    particles.into_iter().map(|p| (DVec3::from(p) + shift).into()).collect()
}

/// The errors of the surface of a level pool: the mean over several heights of the pool within a
/// cell.
pub fn pool_deviation(method: &Method, cell: f64) -> Outcome<Deviation> {
    let at_height = |number: usize| -> Outcome<Deviation> {
        let mut random = Random::new(number as u64);
        let pool = cuboid(IVec3::new(0, -12, 0), IVec3::new(WIDTH, 0, WIDTH), JITTER, &mut random);
        let mesh = mesh(method, &shifted(pool, cell, number), cell)?;
        let top = cell * unit_cube_point(number).y;
        let central = mesh.positions.iter().filter(|p| is_central(p));
        Ok(Deviation::of(&mesh, central.map(|p| p[1] - top)))
    };
    let all = (0..4).map(at_height).collect::<Outcome<Vec<_>>>()?;
    Ok(Deviation {
        bias: mean(all.iter().map(|d| d.bias)),
        rms: mean(all.iter().map(|d| d.rms)),
        within: all.iter().map(|d| d.within).sum(),
    })
}

/// Whether a vertex is on top of a pool, away from its edges.
pub fn is_central(p: &[f64; 3]) -> bool {
    let within = MARGIN..f64::from(WIDTH) - MARGIN;
    within.contains(&p[0]) && within.contains(&p[2]) && p[1] > -NEAR
}

fn ball_deviation(method: &Method, ball: &Solid, cell: f64) -> Outcome<Deviation> {
    let lattice = Lattice {
        shift: unit_cube_point(0),
        turn: DQuat::IDENTITY,
        jitter: JITTER,
        inset: 0.0,
        seed: 1,
    };
    let mesh = mesh(method, &fill(ball, &lattice), cell)?;
    Ok(Deviation::of(&mesh, mesh.positions.iter().map(|&p| -ball.depth(p.into()))))
}

/// Describes the components, holes and thickness of a sheet above a pool. The pool provides the
/// plateau for the isovalue.
fn sheet(method: &Method, cell: f64, layers: i32) -> Outcome<String> {
    let mut random = Random::new(1);
    let mut particles =
        cuboid(IVec3::new(0, -28, 0), IVec3::new(WIDTH, -16, WIDTH), JITTER, &mut random);
    particles.extend(cuboid(IVec3::ZERO, IVec3::new(WIDTH, layers, WIDTH), JITTER, &mut random));
    let sheet = above(&mesh(method, &shifted(particles, cell, 1), cell)?, -8.0);
    if sheet.triangles.is_empty() {
        return Ok("none".into());
    }
    let measures = measure(&sheet);
    let holes = measures.genus.ok_or("a sheet is not closed")?;
    let thickness = measures.volume.unwrap_or(0.0) / f64::from(WIDTH * WIDTH);
    Ok(format!("{} components, {holes} holes, {thickness:.2}", measures.components))
}

/// The number of components above a pool with drops of `size` particles.
fn drops_kept(method: &Method, cell: f64, size: IVec3) -> Outcome<String> {
    let mut random = Random::new(2);
    let width = DROPS * STEP;
    let pool = cuboid(IVec3::new(0, -12, 0), IVec3::new(width, 0, width), JITTER, &mut random);
    let mut particles = shifted(pool, cell, 1);
    for number in 0..DROPS * DROPS {
        let corner = IVec3::new(number % DROPS, 1, number / DROPS) * STEP;
        let drop = cuboid(corner, corner + size, JITTER, &mut random);
        particles.extend(shifted(drop, 1.0, number as usize));
    }
    let drops = above(&mesh(method, &particles, cell)?, f64::from(STEP) / 2.0);
    Ok(measure(&drops).components.to_string())
}

/// The part of a mesh above a height.
fn above(mesh: &Mesh, height: f64) -> Mesh {
    let above =
        |triangle: &&[u32; 3]| triangle.iter().all(|&v| mesh.positions[v as usize][1] > height);
    let triangles = mesh.triangles.iter().filter(above).copied().collect();
    Mesh { positions: mesh.positions.clone(), triangles, ..Mesh::default() }
}
