//! The triangles near a block.

use glam::{DVec3, Vec4};

/// Minimum height, in voxels, of a triangle from which distances are measured. Every point of a
/// flatter triangle is within this distance of an edge or a corner of another triangle.
const LEAST_HEIGHT: f64 = 1e-6;

/// A triangle whose corners are numbers of a block's vertices.
#[derive(Debug, Clone, Copy)]
pub struct NearTriangle {
    pub corners: [u32; 3],
    /// The number of the triangle in the mesh.
    pub number: u32,
    /// The unit normal, which points outwards.
    pub normal: DVec3,
}

/// The triangles near a block, with coordinates relative to the block's first voxel. Triangles that
/// are too flat are left out.
#[derive(Debug, Default)]
pub struct NearTriangles {
    pub triangles: Vec<NearTriangle>,
    numbering: Numbering,
    /// The position of each vertex.
    places: Vec<DVec3>,
    /// For each vertex, the sum of the normals of the triangles around it, and the number of these
    /// triangles. NaN if one of the triangles is too flat.
    normals: Vec<Vec4>,
    /// The [`spread`](Self::spread) of each vertex.
    spreads: Vec<f32>,
}

impl NearTriangles {
    /// Removes all triangles, and prepares for `triangles` new ones.
    pub fn clear(&mut self, triangles: usize) {
        self.numbering.clear(triangles);
        self.places.clear();
        self.normals.clear();
        self.triangles.clear();
    }

    /// Adds a triangle of the mesh. Returns the numbers that its vertices have in the block.
    pub fn add(
        &mut self,
        vertices: [u32; 3],
        number: u32,
        place: impl Fn(u32) -> DVec3,
    ) -> [u32; 3] {
        let mut corners = vertices;
        for corner in &mut corners {
            let (vertex, next) = (*corner, self.places.len() as u32);
            *corner = self.numbering.number(vertex, next);
            if *corner == next {
                self.places.push(place(vertex));
                self.normals.push(Vec4::ZERO);
            }
        }
        let [a, b, c] = self.places(corners);
        let normal = (b - a).cross(c - a);
        let area = normal.length();
        let longest = a.distance_squared(b).max(a.distance_squared(c)).max(b.distance_squared(c));
        if area <= LEAST_HEIGHT * longest.sqrt() {
            for corner in corners {
                self.normals[corner as usize] = Vec4::NAN;
            }
        } else {
            let normal = normal * area.recip();
            for corner in corners {
                self.normals[corner as usize] += normal.as_vec3().extend(1.0);
            }
            self.triangles.push(NearTriangle { corners, number, normal });
        }
        corners
    }

    /// Computes the [`spread`](Self::spread) of each vertex, after all triangles were added.
    pub fn find_spreads(&mut self) {
        for normal in &mut self.normals {
            *normal /= normal.w;
        }
        // First, compute the greatest squared distance of a normal from the mean normal.
        self.spreads.clear();
        self.spreads.resize(self.normals.len(), 0.0);
        for triangle in &self.triangles {
            let normal = triangle.normal.as_vec3().extend(1.0);
            for corner in triangle.corners {
                let apart = normal.distance_squared(self.normals[corner as usize]);
                let most = &mut self.spreads[corner as usize];
                // Unlike `f32::max`, this keeps `apart` if it is NaN.
                *most = if apart <= *most { *most } else { apart };
            }
        }
        for spread in &mut self.spreads {
            let squared = *spread;
            *spread =
                if squared < 0.5 { (squared / (1.0 - squared)).sqrt() } else { f32::INFINITY };
        }
    }

    /// The tangent of an angle that limits the directions from a vertex to voxels. If the vertex is
    /// the point of the mesh that is nearest to a voxel outside, the direction from the vertex to
    /// the voxel is within this angle of the normal of a triangle around the vertex. For a voxel
    /// inside the mesh, the opposite direction is within this angle of the normal. The tangent is
    /// infinite if the normals can differ by 90 degrees or more.
    ///
    /// Such a direction is a sum of the normals with positive weights, so it passes through the
    /// convex hull of the normals. No point of the hull is farther from the nearest normal than the
    /// radius r of a ball that contains all normals. Since normals have length 1, the sine of the
    /// angle is at most r.
    pub fn spread(&self, vertex: u32) -> f32 {
        self.spreads[vertex as usize]
    }

    /// The position of a vertex.
    pub fn place(&self, vertex: u32) -> DVec3 {
        self.places[vertex as usize]
    }

    /// The positions of a triangle's corners.
    pub fn places(&self, [a, b, c]: [u32; 3]) -> [DVec3; 3] {
        [self.place(a), self.place(b), self.place(c)]
    }
}

/// A hash table that maps vertices of the mesh to their numbers in the block.
#[derive(Debug, Default)]
struct Numbering {
    /// Pairs of a vertex of the mesh, or [`EMPTY`], and its number in the block.
    slots: Vec<[u32; 2]>,
}

const EMPTY: u32 = u32::MAX;
/// Number of consecutive vertices of the mesh that have consecutive slots. Such vertices are often
/// looked up together.
const RUN: usize = 16;

impl Numbering {
    fn clear(&mut self, triangles: usize) {
        // A closed mesh has about half as many vertices as triangles, so the table has at least
        // about eight slots per vertex.
        self.slots.clear();
        self.slots.resize((triangles * 4).next_power_of_two().max(RUN), [EMPTY; 2]);
    }

    /// Returns the number of a vertex. If it has none yet, assigns it `next`.
    fn number(&mut self, vertex: u32, next: u32) -> u32 {
        let mask = self.slots.len() - 1;
        let group = u64::from(vertex) / RUN as u64;
        let hash = (group.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32) as usize;
        let mut at = (hash * RUN + vertex as usize % RUN) & mask;
        while self.slots[at][0] != vertex {
            if self.slots[at][0] == EMPTY {
                self.slots[at] = [vertex, next];
                break;
            }
            at = (at + 1) & mask;
        }
        self.slots[at][1]
    }
}
