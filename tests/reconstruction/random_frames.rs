//! Tests random particles, options and walls. The surface must be closed, oriented and manifold,
//! and must lie within the walls and near the particles. The surface must be the same for all
//! numbers of threads, particle orders, budgets, brick sizes and devices, and after packing. If a
//! frame gives an error instead, the error must always be the same.
//!
//! `MENISCUS_FRAMES=100000` tries 100000 frames, `MENISCUS_FRAMES_FROM=1000` starts with number
//! 1000, and `MENISCUS_FRAME=77` repeats number 77.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use glam::DVec3;
use meniscus::files::Replace;
use meniscus::internals::brick::BrickSide;
use meniscus::internals::frame::{Engine, FrameError, Sampling};
use meniscus::internals::particles::AttributeInfo;
use meniscus::internals::system::timings::Timings;
use meniscus::mesh::{Mesh, MeshSource, PieceOutline};
use meniscus::{
    Cause, Error, IndicatorKind, KernelMethod, MemoryBudget, Particles, PeriodicMesh,
    Reconstruction, Settings, Surface,
};

use crate::common::scene::Random;
use crate::common::{device, shuffle, watertight};

/// Default number of frames to try.
const FRAMES: u64 = 400;
/// More than 1 / `MIN_SURFACE_SHARE_DIVISOR` of the frames must have a surface.
const MIN_SURFACE_SHARE_DIVISOR: u64 = 2;

/// Particles with a velocity, and with an attribute that is NaN for some particles.
struct Water {
    positions: Vec<[f64; 3]>,
    /// Numbers that determine the particles' attributes. Each number moves with its particle when
    /// the particles are shuffled, so that a particle's attributes do not depend on the order.
    numbers: Vec<u32>,
    attributes: Vec<AttributeInfo>,
}

impl Water {
    fn new(positions: Vec<[f64; 3]>) -> Self {
        let info = |name: &str, components| AttributeInfo::new(name, components);
        let numbers = (0..positions.len() as u32).collect();
        Self { positions, numbers, attributes: vec![info("velocity", 3), info("heat", 1)] }
    }

    /// The same particles in a random order.
    fn shuffled(&self, random: &mut Random) -> Self {
        let mut order: Vec<usize> = (0..self.positions.len()).collect();
        shuffle(&mut order, random);
        let positions = order.iter().map(|&i| self.positions[i]).collect();
        let numbers = order.iter().map(|&i| self.numbers[i]).collect();
        Self { positions, numbers, attributes: self.attributes.clone() }
    }
}

impl Particles for Water {
    fn len(&self) -> usize {
        self.positions.len()
    }

    fn positions(&self, first: usize, out: &mut [[f64; 3]]) {
        out.copy_from_slice(&self.positions[first..first + out.len()]);
    }

    fn attributes(&self) -> &[AttributeInfo] {
        &self.attributes
    }

    fn attribute(&self, index: usize, first: usize, out: &mut [f32]) {
        let components = self.attributes[index].components;
        for (i, value) in out.iter_mut().enumerate() {
            let number = self.numbers[first + i / components];
            *value = match index {
                1 if number % 17 == 3 => f32::NAN,
                _ => (number % 11) as f32 - 4.0 + (i % components) as f32,
            };
        }
    }
}

/// A frame with its request.
struct Frame {
    seed: u64,
    spacing: f64,
    /// The centre of the particles.
    centre: DVec3,
    water: Water,
    walls: Option<[DVec3; 2]>,
    faces: [Option<[f64; 2]>; 3],
    kernels: bool,
    indicator: IndicatorKind,
}

fn pick<T: Copy>(random: &mut Random, from: &[T]) -> T {
    from[(random.bits() % from.len() as u64) as usize]
}

fn one_in(random: &mut Random, many: u64) -> bool {
    random.bits().is_multiple_of(many)
}

fn between(random: &mut Random, lowest: f64, highest: f64) -> f64 {
    lowest + (highest - lowest) * random.unit()
}

fn anywhere(random: &mut Random, half: f64) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|_| between(random, -half, half)))
}

/// Particles with spacing 1 around the origin.
fn some_particles(random: &mut Random) -> Vec<DVec3> {
    let lattice = |random: &mut Random,
                   half: i32,
                   jitter: f64,
                   inside: &dyn Fn(DVec3) -> bool|
     -> Vec<DVec3> {
        let steps = || -half..=half;
        let cells = steps().flat_map(|x| {
            steps()
                .flat_map(move |y| steps().map(move |z| DVec3::new(x.into(), y.into(), z.into())))
        });
        cells.filter(|&p| inside(p)).map(|p| p + anywhere(random, jitter)).collect()
    };
    let jitter = pick(random, &[0.0, 0.0, 0.1, 0.3, 0.5]);
    match random.bits() % 9 {
        0 => (0..1 + random.bits() % 60).map(|_| anywhere(random, 6.0)).collect(),
        1 => {
            let radius = between(random, 1.0, 4.5);
            lattice(random, 4, jitter, &|p| p.length() < radius)
        }
        2 => lattice(random, 5, jitter, &|p| p.y.abs() < 2.0),
        3 => {
            let apart = anywhere(random, 200.0);
            let ball = lattice(random, 2, jitter, &|_| true);
            ball.iter().map(|&p| p + apart).chain(ball.iter().map(|&p| p - apart)).collect()
        }
        4 => lattice(random, 6, jitter, &|p| p.y == 0.0),
        5 => vec![anywhere(random, 3.0); 1 + (random.bits() % 300) as usize],
        6 => (0..1 + random.bits() % 40)
            .map(|i| DVec3::new(i as f64 * 1.3 - 20.0, (i as f64).sin(), 0.0))
            .collect(),
        // Particles exactly on faces and corners of cells and walls.
        7 => (0..1 + random.bits() % 200)
            .map(|_| (anywhere(random, 5.0) * 2.0).round() / 2.0)
            .collect(),
        _ => {
            let hole = anywhere(random, 2.0);
            lattice(random, 4, jitter, &|p| p.distance(hole) > 2.3)
        }
    }
}

impl Frame {
    fn new(seed: u64) -> Self {
        let mut random = Random::new(seed.wrapping_mul(0x9e37_79b9).wrapping_add(7));
        let random = &mut random;
        let spacing = pick(random, &[1.0, 1.0, 1.0, 0.05, 1e-4, 37.5, 1e6]);
        let centre =
            pick(random, &[DVec3::ZERO, DVec3::splat(0.37), DVec3::new(-900.0, 3.0, 12_345.0)])
                * spacing;
        let mut positions: Vec<[f64; 3]> =
            some_particles(random).iter().map(|&p| (p * spacing + centre).to_array()).collect();
        if one_in(random, 20) {
            let at = (random.bits() % positions.len() as u64) as usize;
            positions[at][1] = pick(random, &[f64::NAN, f64::INFINITY, 1e300, f64::MIN_POSITIVE]);
        }
        let walls = one_in(random, 3).then(|| {
            let mut half =
                || DVec3::from_array(std::array::from_fn(|_| between(random, 0.5, 6.0))) * spacing;
            let [lo, hi] = [half(), half()];
            // In some frames, exchange the corners, which must give an error.
            if seed.is_multiple_of(50) {
                [centre + hi, centre - lo]
            } else {
                [centre - lo, centre + hi]
            }
        });
        let mut faces = [None; 3];
        if one_in(random, if walls.is_some() { 30 } else { 6 }) {
            for (axis, faces) in faces.iter_mut().enumerate() {
                let half = between(random, 6.0, 20.0) * spacing;
                *faces = one_in(random, 2).then(|| [centre[axis] - half, centre[axis] + half]);
            }
        }
        let kernels = one_in(random, 10);
        let (cloud, counting) = (IndicatorKind::Cloud, IndicatorKind::Counting);
        let indicator = pick(random, &[cloud, cloud, counting, IndicatorKind::Symmetry]);
        Self {
            seed,
            spacing,
            centre,
            water: Water::new(positions),
            walls,
            faces,
            kernels,
            indicator,
        }
    }

    /// A request with random settings for sampling the particles.
    fn sampling(&self) -> Reconstruction {
        let mut random = Random::new(self.seed.wrapping_add(1));
        let random = &mut random;
        let mut request = Reconstruction::new().threads(1).scratch(std::env::temp_dir());
        // Set the spacing in most requests, because most frames are too unusual for an estimate of
        // the spacing.
        if !one_in(random, 20) {
            request = request.spacing(self.spacing * pick(random, &[1.0, 1.0, 1.0, 0.8, 1.3]));
        }
        request = match random.bits() % 6 {
            0 => request.cell_size(self.spacing * between(random, 0.4, 1.5)),
            1 => request.cell(between(random, 0.3, 2.0)),
            2 => request.cell(1.0),
            _ => request,
        };
        if one_in(random, 6) {
            request =
                request.origin((anywhere(random, 0.5) * self.spacing + self.centre).to_array());
        }
        if let Some([lo, hi]) = self.walls {
            request = request.domain(lo.to_array(), hi.to_array());
        }
        if self.faces.iter().any(Option::is_some) {
            request = request.periodic(self.faces);
        }
        if self.walls.is_some() || one_in(random, 2) {
            request = request.skip_invalid(true);
        }
        if self.kernels {
            let iso = between(random, 0.2, 0.8);
            return request.method(pick(
                random,
                &[
                    KernelMethod::Mueller { iso },
                    KernelMethod::ZhuBridson,
                    KernelMethod::YuTurk { iso },
                ],
            ));
        }
        request = request.indicator(self.indicator);
        if self.indicator == IndicatorKind::Counting && one_in(random, 4) {
            request = request.mu0(between(random, 0.5, 20.0));
        }
        if one_in(random, 3) { request.attributes(["velocity", "heat"]) } else { request }
    }

    /// Adds random settings for the surface, which also apply to a packed frame.
    fn with_surface_settings(&self, mut request: Reconstruction) -> Reconstruction {
        let mut random = Random::new(self.seed.wrapping_add(2));
        let random = &mut random;
        if one_in(random, 4) {
            request = request.normals(true);
        }
        if one_in(random, 4) {
            request = request.simplify(pick(random, &[0.05, 0.25, 1.0]));
        }
        if one_in(random, 8) {
            request = request.smallest_drop(1 + (random.bits() % 4) as u32);
        }
        if one_in(random, 8) {
            request = request.smallest_component(between(random, 0.0, 30.0));
        }
        if one_in(random, 4) && self.faces.iter().any(Option::is_some) {
            request = request.periodic_mesh(PeriodicMesh::Overlap);
        }
        // One frame in ten may have conflicting settings, and must then fail with an error.
        let any = one_in(random, 10);
        let (clouds, kernels) = (self.indicator == IndicatorKind::Cloud, self.kernels);
        match random.bits() % 8 {
            0 if any || clouds && !kernels => request.smooth(between(random, 0.8, 4.0)),
            1 if any || !clouds && !kernels => request.sigma(between(random, 0.2, 3.0)),
            2 if any || !clouds && !kernels => request.iso(between(random, 0.02, 0.6)),
            3 if any || !clouds && !kernels => request.detail(true),
            _ => request,
        }
    }

    /// Describes a defect of a mesh. Returns `None` for a mesh without defects.
    fn defect(&self, surface: &Surface, mesh: &Mesh) -> Option<String> {
        if mesh.triangles.is_empty() {
            return None;
        }
        let facts = &surface.report().facts;
        let mut wrong = watertight::defect(mesh);
        let six_volumes: f64 = mesh
            .triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|v| DVec3::from(mesh.positions[v as usize]) - self.centre);
                a.dot(b.cross(c))
            })
            .sum();
        // Because of rounding, the volume may be slightly negative.
        if six_volumes.is_nan() || six_volumes < -1e-6 * self.spacing.powi(3) {
            wrong = wrong.or(Some(format!("six times its volume is {six_volumes}")));
        }
        let unit = |n: &[f32; 3]| (DVec3::from(n.map(f64::from)).length() - 1.0).abs() < 1e-3;
        if mesh.normals.as_ref().is_some_and(|normals| {
            normals.len() != mesh.positions.len() || !normals.iter().all(unit)
        }) {
            wrong = wrong.or(Some("its normals are not unit vectors".into()));
        }
        for attribute in &mesh.attributes {
            let (least, most) =
                if attribute.name == "velocity" { (-4.0, 8.0) } else { (-4.0, 6.0) };
            let fits = |&x: &f32| x.is_nan() || (least - 0.01..=most + 0.01).contains(&x);
            if attribute.values.len() != attribute.components * mesh.positions.len()
                || !attribute.values.iter().all(fits)
            {
                wrong = wrong.or(Some(format!("{} has wrong or missing values", attribute.name)));
            }
        }
        let cell = facts.grid.cell_size();
        let within = |[lo, hi]: [DVec3; 2], what: &str| {
            let slack = 1e-9 * (lo.abs().max(hi.abs()).max_element() + cell);
            let outside = mesh.positions.iter().find(|&&p| {
                let p = DVec3::from(p);
                p.cmplt(lo - slack).any() || p.cmpgt(hi + slack).any()
            });
            outside.map(|p| format!("vertex {p:?} is outside {what}"))
        };
        if let Some(walls) = self.walls {
            wrong = wrong.or_else(|| within(walls, "the walls"));
        }
        let finite = self.water.positions.iter().map(|&p| DVec3::from(p)).filter(|p| p.is_finite());
        let bounds = finite
            .fold([DVec3::INFINITY, DVec3::NEG_INFINITY], |[lo, hi], p| [lo.min(p), hi.max(p)]);
        let reach = 12.0 * facts.spacing.unwrap_or(self.spacing) + 40.0 * cell;
        if self.faces.iter().all(Option::is_none) {
            wrong = wrong.or_else(|| {
                within([bounds[0] - reach, bounds[1] + reach], "the reach of the particles")
            });
        }
        wrong
    }
}

/// Describes a piece whose outline is wrong, if any.
fn outline_defect(mesh: &dyn MeshSource) -> Option<String> {
    let pieces: Vec<_> = (0..mesh.pieces()).map(|piece| mesh.vertices(piece).unwrap()).collect();
    let positions: Vec<_> = pieces.iter().flat_map(|piece| piece.positions.to_vec()).collect();
    (0..mesh.pieces()).find_map(|piece| {
        let triangles = mesh.triangles(piece).unwrap();
        let outline = mesh.piece_outline(piece).expect("pieces of a surface have outlines");
        let PieceOutline { bounds, vertices, triangles: count } = outline;
        let [lo, hi] = bounds.map(DVec3::from);
        let is_within = |&vertex: &u64| {
            let position = DVec3::from(positions[vertex as usize]);
            position.cmpge(lo).all() && position.cmple(hi).all()
        };
        let is_right = [vertices, count]
            == [pieces[piece].positions.len(), triangles.len()].map(|n| n as u64)
            && triangles.iter().flatten().all(is_within);
        (!is_right).then(|| format!("the outline of piece {piece} is wrong: {bounds:?}"))
    })
}

/// Returns the mesh or the error message of a frame. All reconstructions of a frame must have the
/// same outcome.
fn outcome(surface: Result<Surface, Error>) -> Result<Mesh, String> {
    surface.map(|surface| surface.to_mesh().unwrap()).map_err(|error| error.to_string())
}

/// Checks that two results are equal. Meshes must be equal to the bit, including NaN.
fn assert_same(found: &Result<Mesh, String>, expected: &Result<Mesh, String>, what: &str) {
    let bits = |mesh: &Mesh| -> Vec<Vec<u32>> {
        let of = |values: &[f32]| values.iter().map(|x| x.to_bits()).collect();
        mesh.attributes
            .iter()
            .map(|a| of(&a.values))
            .chain(mesh.normals.iter().map(|n| of(n.as_flattened())))
            .collect()
    };
    match (found, expected) {
        (Ok(found), Ok(expected)) => {
            assert!(
                found.positions == expected.positions && found.triangles == expected.triangles,
                "{what}: the mesh differs"
            );
            assert!(bits(found) == bits(expected), "{what}: normals or attributes differ");
        }
        (found, expected) => {
            let kind = |outcome: &Result<Mesh, String>| {
                outcome.as_ref().map(|_| "a mesh".to_owned()).map_err(Clone::clone)
            };
            assert_eq!(kind(found), kind(expected), "{what}");
        }
    }
}

/// Reconstructs a frame in all ways, and compares the results. Returns whether the frame has a
/// surface.
fn try_frame(seed: u64) -> bool {
    let frame = Frame::new(seed);
    let request = frame.with_surface_settings(frame.sampling());
    let surface = request.run(&frame.water);
    if let Err(error) = &surface {
        let message = error.to_string();
        assert!(
            matches!(error.cause(), Cause::Request | Cause::Input),
            "{message}: {:?}",
            error.cause()
        );
        assert!(!message.is_empty() && !message.contains('\n'), "{message:?}");
    }
    let mesh = surface.as_ref().ok().map(|surface| surface.to_mesh().unwrap());
    if let (Ok(surface), Some(mesh)) = (&surface, &mesh)
        && let Some(defect) = frame.defect(surface, mesh)
    {
        panic!("frame {seed}: {defect}; {:?}", request.settings());
    }
    // The pieces of a reduced mesh have no outlines.
    let Settings { simplify, smallest_component, smallest_drop, .. } = request.settings();
    let is_reduced = simplify.is_some() || smallest_component.is_some() || smallest_drop.is_some();
    if let Ok(surface) = &surface
        && !is_reduced
        && let Some(defect) = outline_defect(surface.mesh())
    {
        panic!("frame {seed}: {defect}; {:?}", request.settings());
    }
    let expected = outcome(surface);
    let mut random = Random::new(seed.wrapping_add(3));
    let random = &mut random;

    let threads = 2 + (random.bits() % 3) as usize;
    let other = frame.water.shuffled(random);
    let found = outcome(request.clone().threads(threads).run(&other));
    // Do not compare two errors: an error names the first bad particle, which depends on the order.
    if expected.is_ok() || found.is_ok() {
        assert_same(
            &found,
            &expected,
            &format!("frame {seed}, {threads} threads and another order"),
        );
    }
    if expected.is_ok() && one_in(random, 4) {
        let budget = MemoryBudget(pick(random, &[16, 24, 48]) << 20);
        let found = outcome(request.clone().memory(budget).run(&frame.water));
        if found.is_ok() {
            assert_same(&found, &expected, &format!("frame {seed} in {budget:?}"));
        }
    }
    if expected.is_ok() && !frame.kernels && one_in(random, 4) {
        assert_same(&packed(&frame), &expected, &format!("frame {seed}, packed"));
    }
    if !frame.kernels && one_in(random, 8) {
        check_brick_sizes(&frame);
    }
    if expected.is_ok()
        && !frame.kernels
        && one_in(random, 16)
        && let Ok(backend) = device::shared()
    {
        let found = outcome(request.backend(backend).run(&frame.water));
        assert_same(&found, &expected, &format!("frame {seed} on a device"));
    }
    mesh.is_some_and(|mesh| !mesh.triangles.is_empty())
}

/// Packs a frame, and returns the mesh of the packed frame.
fn packed(frame: &Frame) -> Result<Mesh, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mnf");
    let request = frame.with_surface_settings(frame.sampling());
    // Packed frames have no attributes, so take the attributes from the sampled frame.
    let sampled = request.sample(&frame.water).map_err(|error| error.to_string())?;
    sampled.pack(request.packed_output(&path, Replace::Refuse).unwrap()).unwrap();
    let mut mesh =
        outcome(frame.with_surface_settings(Reconstruction::new().threads(1)).run_file(&path))?;
    mesh.attributes = outcome(sampled.surface())?.attributes;
    Ok(mesh)
}

/// Checks that all brick sizes give the same mesh.
fn check_brick_sizes(frame: &Frame) {
    let Ok(surface) = frame.sampling().run(&frame.water) else { return };
    let facts = surface.report().facts;
    if facts.periodic.is_some()
        || facts.census.not_finite + facts.census.too_far + facts.census.outside > 0
    {
        return;
    }
    let sampling = |side| Sampling {
        grid: facts.grid,
        domain: facts.domain,
        spacing: facts.spacing,
        method: surface.report().indicator.unwrap().kind().into(),
        side,
        ..crate::common::sampling()
    };
    let mesh = |side| {
        let timings = &mut Timings::default();
        let sampled = Engine::sample(&frame.water, &sampling(side), timings)?;
        Ok::<_, FrameError>(
            sampled.surface(&crate::common::surfacing(), timings)?.to_mesh().unwrap(),
        )
    };
    let meshes = [BrickSide::Four, BrickSide::Eight, BrickSide::Sixteen];
    let [four, eight, sixteen] = meshes.map(|side| mesh(side).map_err(|fault| fault.to_string()));
    assert_same(&four, &eight, &format!("frame {} in bricks of 4 cells", frame.seed));
    assert_same(&sixteen, &eight, &format!("frame {} in bricks of 16 cells", frame.seed));
}

#[test]
fn random_frames_are_watertight_or_refused_and_always_reproducible() {
    let number =
        |name: &str| std::env::var(name).ok().map(|text| text.parse::<u64>().expect("a number"));
    if let Some(seed) = number("MENISCUS_FRAME") {
        try_frame(seed);
        return;
    }
    let first = number("MENISCUS_FRAMES_FROM").unwrap_or(0);
    let frames = number("MENISCUS_FRAMES").unwrap_or(FRAMES);
    let (begun, next, with_surface) = (Instant::now(), AtomicU64::new(first), AtomicU64::new(0));
    let worker = || {
        loop {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            if seed >= first + frames {
                return;
            }
            with_surface.fetch_add(u64::from(try_frame(seed)), Ordering::Relaxed);
        }
    };
    std::thread::scope(|scope| {
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        (0..threads).for_each(|_| drop(scope.spawn(worker)));
    });
    let with_surface = with_surface.into_inner();
    println!(
        "{with_surface} of {frames} frames have a surface; {:.0} s",
        begun.elapsed().as_secs_f64()
    );
    assert!(
        with_surface > frames / MIN_SURFACE_SHARE_DIVISOR,
        "only {with_surface} of {frames} have a surface"
    );
}

#[test]
fn the_watertight_check_rejects_every_kind_of_defect() {
    let ball: Vec<[f64; 3]> = crate::common::fill(4.0, 1.0, 0.2, 1, |p| p.length() < 3.0);
    let whole = Reconstruction::new().spacing(1.0).run(&ball).unwrap().to_mesh().unwrap();
    assert_eq!(watertight::defect(&whole), None);
    let defect_after = |change: fn(&mut Mesh)| {
        let mut mesh = whole.clone();
        change(&mut mesh);
        watertight::defect(&mesh).expect("a defect")
    };
    assert!(
        defect_after(|mesh| mesh.triangles.truncate(mesh.triangles.len() - 1))
            .contains("on one side only")
    );
    assert!(defect_after(|mesh| mesh.triangles[0].swap(0, 1)).contains("directed edge"));
    assert!(defect_after(|mesh| mesh.positions.push([0.0; 3])).contains("no triangle uses"));
    assert!(defect_after(|mesh| mesh.positions[3][1] = f64::NAN).contains("not finite"));
    assert!(defect_after(|mesh| mesh.triangles[5] = [7, 7, 8]).contains("same vertex twice"));
    // Make two balls that share exactly one vertex.
    let joined = defect_after(|mesh| {
        let last = mesh.positions.len() as u32 - 1;
        let other = |t: &[u32; 3]| t.map(|v| if v == 0 { 0 } else { v + last });
        let other: Vec<_> = mesh.triangles.iter().map(other).collect();
        mesh.triangles.extend(other);
        mesh.positions.extend_from_within(1..);
    });
    assert!(joined.contains("separate fans"), "{joined}");
}
