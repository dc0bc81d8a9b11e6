//! What is near a point of a chunk: a grid of lists of numbers.

use glam::{IVec3, Vec3};
use hashbrown::HashMap;

/// Edge of a grid cell, in cells of the field: about as wide as a triangle.
const PITCH: f32 = 1.0;

/// Positions are within so many grid cells of a chunk's corner.
const FAR: f32 = 1024.0;

/// Points or triangles by the grid cells that they come near.
pub struct Near {
    lo: IVec3,
    size: IVec3,
    /// Where each grid cell's list ends.
    ends: Vec<u32>,
    listed: Vec<u32>,
    /// What was added later.
    further: HashMap<u32, Vec<u32>>,
}

impl Near {
    /// Lists triangles by the grid cells within `reach` of them. Only those within the box of `positions` are found.
    pub fn triangles(positions: &[Vec3], triangles: &[[u32; 3]], reach: f32) -> Self {
        let mut near = Self::empty(positions);
        let mut spans: Vec<(u32, u32)> = Vec::with_capacity(4 * triangles.len());
        for (number, triangle) in triangles.iter().enumerate() {
            let corners = triangle.map(|vertex| positions[vertex as usize]);
            near.touched(corners, reach, |cell| spans.push((cell, number as u32)));
        }
        near.fill(&spans);
        near
    }

    /// Lists points by the grid cells that they are in.
    pub fn points(positions: &[Vec3]) -> Self {
        let mut near = Self::empty(positions);
        let cell = |&point: &Vec3| near.cell_of(point).expect("points are in their own box");
        let spans: Vec<(u32, u32)> = positions.iter().map(cell).zip(0..).collect();
        near.fill(&spans);
        near
    }

    fn empty(positions: &[Vec3]) -> Self {
        let lo = positions.iter().copied().reduce(Vec3::min).unwrap_or_default();
        let hi = positions.iter().copied().reduce(Vec3::max).unwrap_or_default();
        let lo = grid_cell(lo);
        let size = grid_cell(hi) - lo + 1;
        let ends = vec![0; size.as_usizevec3().element_product()];
        Self { lo, size, ends, listed: Vec::new(), further: HashMap::new() }
    }

    fn fill(&mut self, spans: &[(u32, u32)]) {
        for &(cell, _) in spans {
            self.ends[cell as usize] += 1;
        }
        // Counts become starts, and starts become ends as the lists fill up.
        let mut total = 0;
        for end in &mut self.ends {
            total += std::mem::replace(end, total);
        }
        self.listed = vec![0; spans.len()];
        for &(cell, number) in spans {
            let end = &mut self.ends[cell as usize];
            self.listed[*end as usize] = number;
            *end += 1;
        }
    }

    /// Lists one more triangle, or one that was listed as it is now.
    pub fn add(&mut self, number: u32, corners: [Vec3; 3], reach: f32) {
        let mut further = std::mem::take(&mut self.further);
        self.touched(corners, reach, |cell| further.entry(cell).or_default().push(number));
        self.further = further;
    }

    /// Calls `visit` with the grid cells that may come within `reach` of a triangle.
    fn touched(&self, [a, b, c]: [Vec3; 3], reach: f32, mut visit: impl FnMut(u32)) {
        let lo = (grid_cell(a.min(b).min(c) - reach) - self.lo).max(IVec3::ZERO);
        let hi = (grid_cell(a.max(b).max(c) + reach) - self.lo).min(self.size - 1);
        let normal = (b - a).cross(c - a).normalize_or_zero();
        let slab = reach + PITCH * 0.5 * normal.abs().element_sum();
        for z in lo.z..=hi.z {
            for y in lo.y..=hi.y {
                for x in lo.x..=hi.x {
                    let centre = ((IVec3::new(x, y, z) + self.lo).as_vec3() + 0.5) * PITCH;
                    if normal.dot(centre - a).abs() <= slab {
                        visit((x + self.size.x * (y + self.size.y * z)) as u32);
                    }
                }
            }
        }
    }

    #[inline]
    fn cell_of(&self, point: Vec3) -> Option<u32> {
        let cell = grid_cell(point) - self.lo;
        let inside = cell.cmpge(IVec3::ZERO).all() && cell.cmplt(self.size).all();
        inside.then(|| (cell.x + self.size.x * (cell.y + self.size.y * cell.z)) as u32)
    }

    /// A cell's list, and what was added to it later.
    #[inline]
    fn lists(&self, cell: u32) -> [&[u32]; 2] {
        let end = self.ends[cell as usize];
        let start = cell.checked_sub(1).map_or(0, |before| self.ends[before as usize]);
        let further = if self.further.is_empty() { None } else { self.further.get(&cell) };
        [&self.listed[start as usize..end as usize], further.map_or(&[], |list| list)]
    }

    /// What is listed where `point` is.
    #[inline]
    pub fn at(&self, point: Vec3) -> [&[u32]; 2] {
        self.cell_of(point).map_or([&[], &[]], |cell| self.lists(cell))
    }

    /// What is listed within the box from `lo` to `hi`, some of it perhaps repeatedly.
    pub fn within(&self, lo: Vec3, hi: Vec3) -> Vec<u32> {
        let lo = (grid_cell(lo) - self.lo).max(IVec3::ZERO);
        let hi = (grid_cell(hi) - self.lo).min(self.size - 1);
        let mut found = Vec::new();
        for z in lo.z..=hi.z {
            for y in lo.y..=hi.y {
                for x in lo.x..=hi.x {
                    let lists = self.lists((x + self.size.x * (y + self.size.y * z)) as u32);
                    lists.into_iter().for_each(|list| found.extend_from_slice(list));
                }
            }
        }
        found
    }
}

#[inline]
fn grid_cell(point: Vec3) -> IVec3 {
    // Rounds down, as long as points are not that far below; floor is a call where processors may be old.
    let shifted = point / PITCH + FAR;
    shifted.as_ivec3() - FAR as i32
}

/// The squared distance from a point to a triangle, and the barycentric coordinates of the nearest point
/// (Ericson, Real-Time Collision Detection, 5.1.5).
#[inline]
pub fn closest(p: Vec3, [a, b, c]: [Vec3; 3]) -> (f32, [f32; 3]) {
    let found = |weights: [f32; 3]| {
        let nearest = a * weights[0] + b * weights[1] + c * weights[2];
        (p.distance_squared(nearest), weights)
    };
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return found([1.0, 0.0, 0.0]);
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return found([0.0, 1.0, 0.0]);
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        let v = d1 / (d1 - d3);
        return found([1.0 - v, v, 0.0]);
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return found([0.0, 0.0, 1.0]);
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        let w = d2 / (d2 - d6);
        return found([1.0 - w, 0.0, w]);
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        let w = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return found([0.0, 1.0 - w, w]);
    }
    let sum = va + vb + vc;
    found([va / sum, vb / sum, vc / sum])
}
