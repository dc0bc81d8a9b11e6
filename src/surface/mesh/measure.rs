//! Area, volume, components, genus and the shapes of the triangles.
//!
//! The volume is the sum of the signed volumes of the tetrahedra between each triangle and a vertex
//! of its own component (the divergence theorem), so distances from the origin and between
//! components do not reduce the precision. Compensated summation (Neumaier 1974) reduces rounding
//! errors. The genus follows from Euler's `V - E + F = 2 (components - genus)`. Sums over chunks of
//! fixed length are added in order, so the results do not depend on the number of threads.

use std::collections::BTreeMap;
use std::ops::Range;

use glam::DVec3;
use rayon::prelude::*;
use serde::Serialize;

use super::Mesh;
use super::check::is_sound;
use super::check::topology;

/// A component is flat if six times its volume is at most this number times a^(3/2), where a is
/// twice its area.
const FLAT: f64 = 1e-9;

/// Number of triangles per partial sum.
const CHUNK: usize = 1 << 14;

/// Number of classes, each 5 degrees wide, in the histogram of smallest angles. The smallest angle
/// of a triangle is at most 60 degrees.
pub const ANGLE_CLASSES: usize = 12;

/// The result of [`measure`]. Triangles with a missing or repeated vertex are ignored.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Measures {
    /// The corners of the box around all vertices that triangles use; `None` for an empty mesh.
    pub bounds: Option<[[f64; 3]; 2]>,
    /// The area of all triangles, in squared units of length.
    pub area: f64,
    /// The enclosed volume, in the cube of the unit of length, negative if triangles face inwards.
    /// `None` unless the mesh is closed and oriented.
    pub volume: Option<f64>,
    /// Number of components. Different components share no vertex.
    pub components: usize,
    /// Number of components that enclose almost no volume, such as two triangles back to back.
    pub flat_components: usize,
    /// The Euler characteristic: vertices - edges + triangles, where only vertices that triangles
    /// use are counted.
    pub euler_characteristic: i64,
    /// Total number of handles of all components. `None` unless the mesh is closed, oriented and
    /// 2-manifold.
    pub genus: Option<i64>,
    /// The shapes of the triangles.
    pub quality: Quality,
}

/// How close to equilateral the triangles are.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Quality {
    /// Number of triangles by their smallest angle: from 0 to 5 degrees, from 5 to 10, and so on.
    pub least_angles: [usize; ANGLE_CLASSES],
    /// The smallest angle of any triangle, in degrees; `None` for an empty mesh.
    pub worst_angle: Option<f64>,
    /// The number of the triangle with the smallest angle.
    pub worst_triangle: Option<usize>,
    /// Mean of the triangles' smallest angles, in degrees; `None` for an empty mesh.
    pub mean_angle: Option<f64>,
    /// The worst aspect ratio: longest edge over shortest height, scaled so that it is 1 for an
    /// equilateral triangle. Triangles without area are ignored; `None` if no triangle has an area.
    pub worst_aspect: Option<f64>,
    /// Number of triangles without area.
    pub flat: usize,
}

/// Computes all measures of `mesh`.
#[must_use]
pub fn measure(mesh: &Mesh) -> Measures {
    let topology = topology(mesh);
    let vertices = mesh.positions.len() - topology.unreferenced_vertices.count;
    let sums = Sums::of(mesh);
    let pieces = pieces(mesh);
    let components = pieces.len();
    let sextuple_volume: Total = pieces.iter().map(|piece| piece.sextuple_volume.value()).collect();
    let euler = vertices as i64 - topology.edges as i64 + topology.sound_triangles as i64;
    Measures {
        bounds: bounds(mesh).map(|corners| corners.map(|corner| corner.to_array())),
        area: sums.doubled_area.value() / 2.0,
        volume: (topology.is_closed() && topology.is_oriented())
            .then(|| sextuple_volume.value() / 6.0),
        components,
        flat_components: pieces.iter().filter(|piece| piece.is_flat()).count(),
        euler_characteristic: euler,
        genus: topology.is_closed_oriented_manifold().then_some(components as i64 - euler / 2),
        quality: sums.quality(topology.sound_triangles),
    }
}

fn sound(mesh: &Mesh) -> impl Iterator<Item = [u32; 3]> {
    mesh.triangles.iter().copied().filter(|&triangle| is_sound(triangle, mesh.positions.len()))
}

/// The corners of the box around all vertices that sound triangles use.
fn bounds(mesh: &Mesh) -> Option<[DVec3; 2]> {
    let used = sound(mesh).flatten().map(|vertex| DVec3::from(mesh.positions[vertex as usize]));
    used.map(|p| [p, p]).reduce(|[low, high], [p, _]| [low.min(p), high.max(p)])
}

/// A sum that compensates rounding errors (Neumaier 1974).
#[derive(Debug, Clone, Copy, Default)]
struct Total {
    sum: f64,
    compensation: f64,
}

impl Total {
    fn add(&mut self, term: f64) {
        let sum = self.sum + term;
        let (greater, lesser) =
            if self.sum.abs() >= term.abs() { (self.sum, term) } else { (term, self.sum) };
        self.compensation += (greater - sum) + lesser;
        self.sum = sum;
    }

    fn value(self) -> f64 {
        // An infinite sum has no valid compensation.
        if self.compensation.is_finite() { self.sum + self.compensation } else { self.sum }
    }
}

impl FromIterator<f64> for Total {
    fn from_iter<I: IntoIterator<Item = f64>>(terms: I) -> Self {
        let mut total = Self::default();
        terms.into_iter().for_each(|term| total.add(term));
        total
    }
}

/// Sums over the triangles of a component, which shares no vertex with other components.
#[derive(Default)]
struct ComponentSums {
    doubled_area: Total,
    sextuple_volume: Total,
}

impl ComponentSums {
    /// Whether the enclosed volume is within rounding errors of zero.
    fn is_flat(&self) -> bool {
        self.sextuple_volume.value().abs() <= FLAT * libm::pow(self.doubled_area.value(), 1.5)
    }
}

/// Finds the components by joining the vertices of every triangle.
fn pieces(mesh: &Mesh) -> Vec<ComponentSums> {
    // Each vertex points at a lower-numbered vertex of its component; the lowest vertex points at
    // itself. Vertices beyond u32 have no entry, because no triangle uses them.
    let mut parents: Vec<u32> = (0..=u32::MAX).take(mesh.positions.len()).collect();
    for [a, b, c] in sound(mesh) {
        let [a, b, c] = [a, b, c].map(|vertex| root(&mut parents, vertex));
        let least = a.min(b).min(c);
        for vertex in [a, b, c] {
            parents[vertex as usize] = least;
        }
    }
    let mut pieces: BTreeMap<u32, ComponentSums> = BTreeMap::new();
    for triangle in sound(mesh) {
        let least = root(&mut parents, triangle[0]);
        let [a, b, c] = triangle.map(|vertex| DVec3::from(mesh.positions[vertex as usize]));
        // Positions are relative to a vertex of the component, so that a small component far from
        // other components keeps its precision.
        let from = DVec3::from(mesh.positions[least as usize]);
        let piece = pieces.entry(least).or_default();
        piece.doubled_area.add((b - a).cross(c - a).length());
        piece.sextuple_volume.add((a - from).dot((b - from).cross(c - from)));
    }
    pieces.into_values().collect()
}

fn root(parents: &mut [u32], mut vertex: u32) -> u32 {
    while parents[vertex as usize] != vertex {
        parents[vertex as usize] = parents[parents[vertex as usize] as usize];
        vertex = parents[vertex as usize];
    }
    vertex
}

/// Partial sums over triangles.
#[derive(Default)]
struct Sums {
    doubled_area: Total,
    angles: f64,
    least_angles: [usize; ANGLE_CLASSES],
    worst: Option<(f64, usize)>,
    aspect: Option<f64>,
    flat: usize,
}

impl Sums {
    fn of(mesh: &Mesh) -> Self {
        let chunks: Vec<Self> = (0..mesh.triangles.len().div_ceil(CHUNK))
            .into_par_iter()
            .map(|chunk| {
                let range = chunk * CHUNK..((chunk + 1) * CHUNK).min(mesh.triangles.len());
                Self::of_range(mesh, range)
            })
            .collect();
        chunks.into_iter().fold(Self::default(), Self::add)
    }

    fn of_range(mesh: &Mesh, range: Range<usize>) -> Self {
        let mut sums = Self::default();
        for number in range {
            let triangle = mesh.triangles[number];
            if is_sound(triangle, mesh.positions.len()) {
                sums.note(number, triangle.map(|v| DVec3::from(mesh.positions[v as usize])));
            }
        }
        sums
    }

    fn note(&mut self, number: usize, [a, b, c]: [DVec3; 3]) {
        let doubled = (b - a).cross(c - a).length();
        self.doubled_area.add(doubled);
        let angle = least_angle([a, b, c], doubled);
        self.angles += angle;
        self.least_angles[((angle / 5.0) as usize).min(ANGLE_CLASSES - 1)] += 1;
        self.worst = worse(self.worst, Some((angle, number)));
        if doubled > 0.0 {
            let longest = (b - a)
                .length_squared()
                .max((c - b).length_squared())
                .max((a - c).length_squared());
            let aspect = longest / doubled * (3.0_f64.sqrt() / 2.0);
            self.aspect = Some(self.aspect.map_or(aspect, |worst| worst.max(aspect)));
        } else {
            self.flat += 1;
        }
    }

    fn add(self, later: Self) -> Self {
        Self {
            doubled_area: [self.doubled_area.value(), later.doubled_area.value()]
                .into_iter()
                .collect(),
            angles: self.angles + later.angles,
            least_angles: std::array::from_fn(|class| {
                self.least_angles[class] + later.least_angles[class]
            }),
            worst: worse(self.worst, later.worst),
            aspect: self.aspect.into_iter().chain(later.aspect).reduce(f64::max),
            flat: self.flat + later.flat,
        }
    }

    fn quality(&self, triangles: usize) -> Quality {
        Quality {
            least_angles: self.least_angles,
            worst_angle: self.worst.map(|(angle, _)| angle),
            worst_triangle: self.worst.map(|(_, number)| number),
            mean_angle: (triangles > 0).then(|| self.angles / triangles as f64),
            worst_aspect: self.aspect,
            flat: self.flat,
        }
    }
}

/// The triangle with the smaller angle, or the earlier triangle if the angles are equal.
fn worse(earlier: Option<(f64, usize)>, later: Option<(f64, usize)>) -> Option<(f64, usize)> {
    earlier.into_iter().chain(later).reduce(|one, other| if other.0 < one.0 { other } else { one })
}

/// The smallest angle of a triangle, in degrees, from its corners and twice its area. This angle is
/// opposite the shortest edge.
fn least_angle([a, b, c]: [DVec3; 3], doubled: f64) -> f64 {
    let across = [(b, c, a), (c, a, b), (a, b, c)];
    let cosine_scaled = across.map(|(from, to, apex)| (from - apex).dot(to - apex));
    // atan2 decreases in its second argument, so the smallest angle has the greatest second
    // argument.
    libm::atan2(doubled, cosine_scaled.into_iter().fold(f64::NEG_INFINITY, f64::max)).to_degrees()
}
