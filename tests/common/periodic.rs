//! A fluid in a periodic box, its explicit copies, and parts of meshes in that box.

use std::collections::BTreeSet;

use glam::{DVec3, IVec3};
use meniscus::internals::surface::mesh::Mesh;

use super::scene::Random;

/// The two faces of the box along each axis; `None` for an open axis.
pub type Faces = [Option<[f64; 2]>; 3];

/// Water with spacing 1 in a box that has a corner at the origin and edges of whole numbers of
/// spacings.
///
/// The water consists of a pool whose waves cross the side faces, a ball across the corner at the
/// origin, a ball across an edge, and spray. All coordinates are within the box, and are multiples
/// of 2^-10.
pub fn fluid(seed: u64, edges: DVec3) -> Vec<[f64; 3]> {
    let mut random = Random::new(seed);
    let near = |p: DVec3, centre: DVec3| {
        let d = (p - centre).abs() % edges;
        d.min(edges - d).length()
    };
    let waves = |p: DVec3| {
        let turns = std::f64::consts::TAU * p / edges;
        edges.y * 0.3 + 1.5 * (turns.x.sin() + (2.0 * turns.z).cos())
    };
    let is_wet = |p: DVec3| {
        let above = p.y - waves(p);
        (-8.0..0.0).contains(&above)
            || near(p, DVec3::ZERO) < 4.0
            || near(p, DVec3::new(0.0, edges.y * 0.65, edges.z * 0.5)) < 3.0
    };
    let mut particles = Vec::new();
    let size = edges.as_ivec3();
    for cell in (0..size.z)
        .flat_map(|z| (0..size.y).flat_map(move |y| (0..size.x).map(move |x| IVec3::new(x, y, z))))
    {
        let jitter = DVec3::new(random.unit(), random.unit(), random.unit());
        let p = cell.as_dvec3() + jitter;
        if is_wet(p) || random.unit() < 0.002 {
            particles.push(((p * 1024.0).floor() / 1024.0).to_array());
        }
    }
    particles
}

/// The particles as a simulator may write them before it wraps them: along the periodic axes, all
/// particles within 0.5 of a face lie outside the opposite face. Also returns their number.
///
/// The lower faces must be at 0, so that wrapping the particles of a [`fluid`] is exact.
pub fn unwrapped(particles: &[[f64; 3]], faces: Faces) -> (Vec<[f64; 3]>, usize) {
    let mut count = 0;
    let outside = particles.iter().map(|&position| {
        let mut outside = position;
        for (x, faces) in outside.iter_mut().zip(faces) {
            let Some([_, edge]) = faces else { continue };
            if *x > 0.0 && *x <= 0.5 {
                *x += edge;
            } else if *x >= edge - 0.5 {
                *x -= edge;
            }
        }
        count += usize::from(outside != position);
        outside
    });
    (outside.collect(), count)
}

/// The fluid and its copies along the periodic axes.
pub fn repeated(particles: &[[f64; 3]], faces: Faces) -> Vec<[f64; 3]> {
    let shifts = faces.map(|faces| match faces {
        Some([lo, hi]) => vec![0.0, lo - hi, hi - lo],
        None => vec![0.0],
    });
    let mut all = Vec::new();
    for &x in &shifts[0] {
        for &y in &shifts[1] {
            for &z in &shifts[2] {
                all.extend(particles.iter().map(|p| [p[0] + x, p[1] + y, p[2] + z]));
            }
        }
    }
    all
}

/// The bits of a vertex's position, normal and attributes.
type Vertex = Vec<u64>;

/// The triangles that are at least `margin` away from the faces of the box. Each triangle consists
/// of the data of its vertices, rotated so that the smallest vertex comes first.
pub fn triangles_within(mesh: &Mesh, faces: Faces, margin: f64) -> BTreeSet<[Vertex; 3]> {
    let within = |p: &[f64; 3]| {
        let between =
            |a: usize| faces[a].is_none_or(|[lo, hi]| p[a] >= lo + margin && p[a] <= hi - margin);
        (0..3).all(between)
    };
    let vertex = |v: u32| {
        let v = v as usize;
        let normal =
            mesh.normals.iter().flat_map(|normals| normals[v].map(|x| u64::from(x.to_bits())));
        let attributes = mesh.attributes.iter().flat_map(|attribute| {
            attribute.values[attribute.components * v..][..attribute.components]
                .iter()
                .map(|x| u64::from(x.to_bits()))
        });
        mesh.positions[v]
            .iter()
            .map(|x| x.to_bits())
            .chain(normal)
            .chain(attributes)
            .collect::<Vertex>()
    };
    let inside =
        mesh.triangles.iter().filter(|t| t.iter().all(|&v| within(&mesh.positions[v as usize])));
    let from_least = |t: &[u32; 3]| {
        let mut all = t.map(vertex);
        let least = (0..3).min_by(|&a, &b| all[a].cmp(&all[b])).unwrap_or(0);
        all.rotate_left(least);
        all
    };
    inside.map(from_least).collect()
}
