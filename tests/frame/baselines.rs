//! Tests of kernel methods: they equal their definitions on one dense array, and their meshes have
//! the expected properties.

use std::f64::consts::PI;

use glam::{DMat3, DVec3};
use meniscus::internals::baselines::KernelMethod;
use meniscus::internals::frame::{Engine, FrameError, Normals, Resources, Sampling, Surfacing};
use meniscus::internals::grid::units::MemoryBudget;
use meniscus::internals::grid::{CellBox, Grid};
use meniscus::internals::particles::Particles;
use meniscus::internals::surface::mesh::Mesh;
use meniscus::internals::surface::mesh::check::check;
use meniscus::internals::system::timings::Timings;

use crate::common::attributed::Attributed;
use crate::common::dense::{Dense, mesh as dense_mesh};
use crate::common::scene::Random;
use crate::common::{fill, sampling, shuffle, splashes, tank};

const METHODS: [KernelMethod; 3] = [
    KernelMethod::Mueller { iso: 0.5 },
    KernelMethod::ZhuBridson,
    KernelMethod::YuTurk { iso: 0.4 },
];

fn surface(
    particles: &(impl Particles + ?Sized),
    sampling: &Sampling,
    method: KernelMethod,
) -> Mesh {
    let timings = &mut Timings::default();
    let sampling = Sampling { method: method.into(), ..sampling.clone() };
    let frame = Engine::sample(&particles, &sampling, timings).unwrap();
    let surfacing = Surfacing { normals: Normals::Gradient, ..Surfacing::PLAIN };
    frame.surface(&surfacing, timings).unwrap().to_mesh().unwrap()
}

fn spaced(spacing: f64) -> Sampling {
    Sampling { spacing: Some(spacing), ..sampling() }
}

/// Rounds coordinates to the positions that 13-bit offsets can represent.
fn rounded_to_offsets(particles: Vec<[f64; 3]>) -> Vec<[f64; 3]> {
    particles.into_iter().map(|p| p.map(|x| ((x * 8192.0).floor() + 0.5) / 8192.0)).collect()
}

/// Implements each method as `src/method.md` and the method's authors define it: as a sum over all
/// particles. The result is positive inside the fluid. Cells have edge 1.
struct Oracle {
    particles: Vec<DVec3>,
    /// For each particle, its volume m / rho, computed with m = 1.
    volumes: Vec<f64>,
    centres: Vec<DVec3>,
    shapes: Vec<DMat3>,
    spacing: f64,
    method: KernelMethod,
}

fn w(x: f64) -> f64 {
    (1.0 - x * x).max(0.0).powi(3)
}

impl Oracle {
    fn new(particles: &[[f64; 3]], spacing: f64, method: KernelMethod) -> Self {
        let particles: Vec<DVec3> = particles.iter().map(|&p| p.into()).collect();
        let h = 2.0 * spacing;
        let scale = 315.0 / (64.0 * PI * h.powi(3));
        let density =
            |x: &DVec3| particles.iter().map(|y| scale * w(x.distance(*y) / h)).sum::<f64>();
        let volumes = particles.iter().map(|x| 1.0 / density(x)).collect();
        let (centres, shapes) = particles.iter().map(|&x| anisotropy(x, &particles, h)).unzip();
        Self { volumes, centres, shapes, spacing, method, particles }
    }

    fn at(&self, x: DVec3) -> f64 {
        let h = 2.0 * self.spacing;
        let all = 0..self.particles.len();
        match self.method {
            KernelMethod::Mueller { iso } => {
                let scale = 315.0 / (64.0 * PI * h.powi(3));
                let share =
                    |i: usize| scale * w(x.distance(self.particles[i]) / h) * self.volumes[i];
                all.map(share).sum::<f64>() - iso
            }
            KernelMethod::ZhuBridson => {
                let weights: Vec<f64> =
                    self.particles.iter().map(|p| w(x.distance(*p) / h)).collect();
                let sum: f64 = weights.iter().sum();
                let mean =
                    self.particles.iter().zip(&weights).map(|(p, w)| *p * *w).sum::<DVec3>() / sum;
                let radius = self.spacing / 2.0;
                radius - if sum > 0.0 { x.distance(mean) } else { 4.0 * radius }
            }
            KernelMethod::YuTurk { iso } => {
                let scale = 315.0 / (64.0 * PI);
                let share = |i: usize| {
                    let g = self.shapes[i];
                    scale
                        * g.determinant()
                        * w((g * (x - self.centres[i])).length())
                        * self.volumes[i]
                };
                all.map(share).sum::<f64>() - iso
            }
        }
    }

    fn mesh(&self, walls: Option<CellBox>) -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
        let reach = (6.0 * self.spacing) as i32 + 2;
        let cells = self.particles.iter().map(|p| p.floor().as_ivec3());
        let around =
            cells.fold(CellBox::EMPTY, |all, cell| all.union(&CellBox { lo: cell, hi: cell + 1 }));
        let cells = walls.unwrap_or(around.grown(reach, reach));
        let field = Dense::new(cells, |cell| self.at(cell.as_dvec3() + 0.5));
        dense_mesh(&field, 0.0, walls)
    }
}

/// The smoothed centre and the matrix G of Yu and Turk.
fn anisotropy(x: DVec3, particles: &[DVec3], h: f64) -> (DVec3, DMat3) {
    let r = 2.0 * h;
    let near: Vec<(DVec3, f64)> = particles
        .iter()
        .filter(|y| x.distance(**y) < r)
        .map(|y| (*y, 1.0 - (x.distance(*y) / r).powi(3)))
        .collect();
    let total: f64 = near.iter().map(|(_, w)| w).sum();
    let mean = near.iter().map(|(y, w)| *y * *w).sum::<DVec3>() / total;
    let outer = |d: DVec3| DMat3::from_cols(d * d.x, d * d.y, d * d.z);
    let covariance = near.iter().fold(DMat3::ZERO, |c, (y, w)| c + outer(*y - mean) * (w / total));
    let (values, axes) = jacobi(covariance);
    let widths = if near.len() > 26 {
        let greatest = values.max_element();
        values.map(|s| s.max(greatest / 4.0)) / (0.15 * r * r)
    } else {
        DVec3::splat(0.5)
    };
    let g = axes * DMat3::from_diagonal(1.0 / widths) * axes.transpose() * h.recip();
    ((x + mean) / 2.0, g)
}

/// Eigenvalues and eigenvectors of a symmetric matrix, by Jacobi rotations.
fn jacobi(mut a: DMat3) -> (DVec3, DMat3) {
    let mut axes = DMat3::IDENTITY;
    for (p, q) in [(0, 1), (0, 2), (1, 2)].into_iter().cycle().take(60) {
        let angle = 0.5 * (2.0 * a.col(q)[p]).atan2(a.col(q)[q] - a.col(p)[p]);
        let mut rotation = DMat3::IDENTITY;
        rotation.col_mut(p)[p] = angle.cos();
        rotation.col_mut(q)[q] = angle.cos();
        rotation.col_mut(q)[p] = angle.sin();
        rotation.col_mut(p)[q] = -angle.sin();
        a = rotation.transpose() * a * rotation;
        axes *= rotation;
    }
    (DVec3::new(a.x_axis.x, a.y_axis.y, a.z_axis.z), axes)
}

#[test]
fn kernel_meshes_equal_those_of_a_dense_oracle() {
    for (seed, spacing, walled) in [(3, 0.8, true), (4, 1.7, false)] {
        let particles = rounded_to_offsets(splashes(seed));
        for method in METHODS {
            let mut sampling = spaced(spacing);
            sampling.domain = walled.then(|| tank(&sampling.grid));
            let walls = sampling.domain.map(|domain| domain.cells());
            let inside = |p: &&[f64; 3]| {
                let cell = DVec3::from(**p).floor().as_ivec3();
                walls.is_none_or(|walls| walls.contains(cell))
            };
            let counted: Vec<_> = particles.iter().filter(inside).copied().collect();
            let (positions, triangles) = Oracle::new(&counted, spacing, method).mesh(walls);
            assert!(triangles.len() > 1000, "{method:?}: the scene must have a surface");
            let mesh = surface(&particles[..], &sampling, method);
            assert!(mesh.triangles == triangles, "{method:?}, {spacing}, walls: {walled}");
            assert_eq!(
                mesh.positions.len(),
                positions.len(),
                "{method:?}, {spacing}, walls: {walled}"
            );
            for (a, b) in mesh.positions.iter().zip(&positions) {
                let apart = DVec3::from(*a).distance((*b).into());
                assert!(apart < 1e-7, "{method:?}, {spacing}: {a:?} is {apart} from {b:?}");
            }
        }
    }
}

#[test]
fn kernel_meshes_are_closed_and_independent_of_order_threads_and_budget() {
    let mut particles = splashes(5);
    for method in METHODS {
        let mesh = surface(&particles[..], &spaced(1.2), method);
        assert!(check(&mesh).is_closed_oriented_manifold(), "{method:?}");
        shuffle(&mut particles, &mut Random::new(8));
        let small = Resources::new(MemoryBudget(1 << 20), std::env::temp_dir());
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let again = pool.install(|| {
            surface(&particles[..], &Sampling { resources: small, ..spaced(1.2) }, method)
        });
        assert!(mesh == again, "{method:?}");
    }
}

#[test]
fn a_lone_particle_becomes_a_ball_with_the_radius_of_its_kernel() {
    let spacing = 8.0;
    let half_of = |w: f64| (1.0 - w.cbrt()).sqrt();
    let radii = [2.0 * spacing * half_of(0.5), spacing / 2.0, spacing * half_of(0.4 / 8.0)];
    for (method, radius) in METHODS.into_iter().zip(radii) {
        let mesh =
            surface(&rounded_to_offsets(vec![[0.3, -0.2, 0.1]])[..], &spaced(spacing), method);
        for position in &mesh.positions {
            let distance = DVec3::from(*position).distance(DVec3::new(0.3, -0.2, 0.1));
            assert!(
                (distance - radius).abs() < 0.03 * radius,
                "{method:?}: {distance} instead of {radius}"
            );
        }
    }
}

#[test]
fn anisotropic_kernels_make_a_pool_flatter_than_isotropic_kernels() {
    // Use two cells per spacing, because flattened kernels can be thinner than a spacing.
    let pool = fill(24.0, 0.5, 0.3, 11, |p| p.z < 0.0 && p.z > -14.0);
    let roughness = |method| {
        let mesh = surface(&pool[..], &spaced(2.0), method);
        let on_top = |p: &&[f64; 3]| p[0].abs() < 12.0 && p[1].abs() < 12.0 && p[2] > -6.0;
        let heights: Vec<f64> = mesh.positions.iter().filter(on_top).map(|p| p[2]).collect();
        let mean = heights.iter().sum::<f64>() / heights.len() as f64;
        (heights.iter().map(|z| (z - mean).powi(2)).sum::<f64>() / heights.len() as f64).sqrt()
    };
    let [mueller, _, yu_turk] = METHODS.map(roughness);
    assert!(yu_turk < 0.8 * mueller, "{yu_turk} against {mueller}");
}

#[test]
fn attributes_are_interpolated_and_normals_point_outwards() {
    let ball = fill(6.0, 1.0, 0.2, 2, |p| p.length() < 5.0);
    let ball = Attributed::new(ball).with("v", |_, _| [1.0, -2.0, 0.5]);
    for method in METHODS {
        let mesh = surface(&ball, &Sampling { carried: vec![0], ..spaced(1.0) }, method);
        assert_eq!(mesh.attributes[0].name, "velocity");
        assert_eq!(mesh.attributes[0].values.len(), 3 * mesh.positions.len());
        for value in mesh.attributes[0].values.as_chunks().0 {
            let value: DVec3 = glam::Vec3::from(*value).as_dvec3();
            assert!(value.distance(DVec3::new(1.0, -2.0, 0.5)) < 1e-5, "{method:?}: {value}");
        }
        for (position, normal) in mesh.positions.iter().zip(mesh.normals.as_ref().unwrap()) {
            let normal = glam::Vec3::from(*normal).as_dvec3();
            assert!(
                DVec3::from(*position).normalize().dot(normal) > 0.7,
                "{method:?} at {position:?}"
            );
        }
    }
}

#[test]
fn kernel_methods_refuse_a_missing_spacing_and_too_small_cells() {
    let particles = [[0.0_f64; 3]];
    for (cell, spacing) in [(1.0 / 17.0, Some(1.0)), (1.0, None)] {
        let (grid, method) =
            (Grid::new(DVec3::ZERO, cell).unwrap(), KernelMethod::ZhuBridson.into());
        let sampling = Sampling { grid, method, spacing, ..sampling() };
        let before = sampling.check_fit(&Surfacing::PLAIN).unwrap_err();
        let refused = Engine::sample(&particles, &sampling, &mut Timings::default()).unwrap_err();
        for error in [before, refused] {
            match spacing {
                Some(_) => assert!(matches!(error, FrameError::Kernels(_)), "{error}"),
                None => assert!(matches!(error, FrameError::NoSpacing), "{error}"),
            }
        }
    }
}
