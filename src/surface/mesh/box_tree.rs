//! Triangles in a tree of boxes, for searches.
//!
//! The triangles are divided recursively into two groups, by the coordinate in which they differ
//! most. The size of a triangle counts as a coordinate, because a large triangle makes the boxes of
//! all its nodes large. A leaf has 8 consecutive triangles and a node up to 8 consecutive children,
//! so no node stores where its children are. A node's data are arrays of 8 numbers, which vector
//! instructions process together.

use glam::{DVec3, Vec3};
use multiversion::multiversion;
use rayon::prelude::*;

/// Number of triangles in a leaf, and of children of a node.
const WIDTH: usize = 8;
/// The margin of a disc, as a fraction of its size. The squared distance from a disc is reduced by
/// the same fraction. Both margins are needed because rounding to f32 changes a disc's size and the
/// length of its normal.
const DISC_MARGIN: f64 = 1e-5;
/// Maximum number of nodes in a [`Vicinity`].
const MOST_IN_VICINITY: usize = 128;
/// Groups of more triangles than this are divided in parallel.
const PARALLEL: usize = 1 << 12;

/// A number for each child of a node, or for each triangle of a leaf.
type Lanes = [f64; WIDTH];

/// The bounds of a node's children, or of 8 leaves: boxes and discs, which are rounded outwards.
///
/// A disc bounds a smooth surface more tightly than a box does. It contains the points whose
/// distance from its centre is at most `thickness` along its normal, and at most `radius`
/// perpendicular to the normal. Children with many triangles have infinite discs. The boxes of
/// missing children contain nothing.
#[derive(Debug, Clone)]
struct Node {
    lo: [[f32; WIDTH]; 3],
    hi: [[f32; WIDTH]; 3],
    centre: [[f32; WIDTH]; 3],
    normal: [[f32; WIDTH]; 3],
    thickness: [f32; WIDTH],
    radius: [f32; WIDTH],
}

/// The coordinates of the three corners of each triangle of a leaf. The last triangle fills the
/// places of missing triangles.
type Leaf = [[Lanes; 3]; 3];

/// A tree of boxes that contain triangles.
#[derive(Debug)]
pub struct BoxTree {
    /// The number of each triangle, in the order of the leaves.
    order: Vec<u32>,
    leaves: Vec<Leaf>,
    /// The nodes of each level. The first level has the bounds of the leaves, and the last level
    /// has a single node.
    levels: Vec<Vec<Node>>,
}

impl BoxTree {
    /// Builds the tree of the triangles with the numbers `0..count`. `corners` returns a
    /// triangle's corners.
    ///
    /// # Panics
    /// If there are no triangles.
    pub fn new(count: usize, corners: impl Fn(usize) -> [DVec3; 3] + Sync) -> Self {
        assert!(count > 0, "a tree needs a triangle");
        let order = sorted(count, &corners);
        let leaf = |numbers: &[u32]| {
            let mut leaf = [[[0.0; WIDTH]; 3]; 3];
            let last = numbers[numbers.len() - 1];
            let padded = numbers.iter().chain(std::iter::repeat(&last));
            for (lane, &number) in padded.take(WIDTH).enumerate() {
                for (to, at) in leaf.iter_mut().zip(corners(number as usize)) {
                    to.iter_mut().zip(at.to_array()).for_each(|(to, at)| to[lane] = at);
                }
            }
            leaf
        };
        let leaves: Vec<Leaf> = order.par_chunks(WIDTH).map(leaf).collect();
        let mut levels: Vec<Vec<Node>> = Vec::new();
        loop {
            let bounds: Vec<Bounds> = match levels.as_slice() {
                [] => leaves.par_chunks(1).map(Bounds::of_leaves).collect(),
                [_] => leaves.par_chunks(WIDTH).map(Bounds::of_leaves).collect(),
                [.., nodes] => nodes.par_iter().map(Bounds::of_node).collect(),
            };
            let nodes: Vec<Node> = bounds.par_chunks(WIDTH).map(Node::of).collect();
            let is_top = nodes.len() == 1;
            levels.push(nodes);
            if is_top {
                return Self { order, leaves, levels };
            }
        }
    }

    /// The corners of the box around all triangles.
    pub fn bounds(&self) -> [DVec3; 2] {
        let Bounds { lo, hi, .. } = Bounds::of_node(&self.levels[self.top()][0]);
        [lo, hi]
    }

    /// The triangle nearest to `point`, and its squared distance, if the squared distance is less
    /// than `bound`.
    pub fn nearest(&self, point: DVec3, bound: f64) -> Option<(f64, usize)> {
        let mut best = (bound, usize::MAX);
        self.search(self.top(), 0, point.to_array(), &mut best);
        self.found(best)
    }

    /// The level that has a single node.
    fn top(&self) -> usize {
        self.levels.len() - 1
    }

    /// Replaces the index in `order` that a search found by the number of the triangle. `None` if
    /// the search found no triangle.
    fn found(&self, (squared, place): (f64, usize)) -> Option<(f64, usize)> {
        (place < usize::MAX).then(|| (squared, self.order[place] as usize))
    }

    /// Replaces `best` by the nearest triangle in the children of a node if that triangle is
    /// nearer.
    fn search(&self, level: usize, node: usize, point: [f64; 3], best: &mut (f64, usize)) {
        let squared = squared_distances(&self.levels[level][node], point);
        let mut nearest_first = [(0.0, 0); WIDTH];
        let mut count = 0;
        for (lane, &squared) in squared.iter().enumerate() {
            if squared < best.0 {
                let mut at = count;
                while at > 0 && nearest_first[at - 1].0 > squared {
                    nearest_first[at] = nearest_first[at - 1];
                    at -= 1;
                }
                nearest_first[at] = (squared, lane);
                count += 1;
            }
        }
        for &(squared, lane) in &nearest_first[..count] {
            if squared >= best.0 {
                return;
            }
            let child = node * WIDTH + lane;
            if level > 0 {
                self.search(level - 1, child, point, best);
                continue;
            }
            let squared = squared_triangle_distances(&self.leaves[child], point);
            for (lane, &squared) in squared.iter().enumerate() {
                if squared < best.0 {
                    *best = (squared, child * WIDTH + lane);
                }
            }
        }
    }

    /// The part of the tree within the distance `most` of the box from `lo` to `hi`. If there are
    /// many searches near this box, they are faster in this part than in the whole tree.
    pub fn vicinity(&self, lo: DVec3, hi: DVec3, most: f64) -> Vicinity<'_> {
        let within = [lo.to_array(), hi.to_array()];
        let squared_most = most * most;
        let mut level = self.top();
        let mut nodes = vec![0];
        let mut bounds = vec![Node::of(&[Bounds::of_node(&self.levels[level][0])])];
        while level > 0 {
            let (mut children, mut of_children) = (Vec::new(), Vec::new());
            for &node in &nodes {
                let parent = &self.levels[level][node as usize];
                let squared = squared_box_distances(parent, within);
                for lane in (0..WIDTH).filter(|&lane| squared[lane] <= squared_most) {
                    let to = children.len() % WIDTH;
                    if to == 0 {
                        of_children.push(Node::default());
                    }
                    of_children[children.len() / WIDTH].copy(to, parent, lane);
                    children.push(node * WIDTH as u32 + lane as u32);
                }
            }
            if children.len() > MOST_IN_VICINITY {
                break;
            }
            (nodes, bounds, level) = (children, of_children, level - 1);
        }
        Vicinity { tree: self, level, nodes, bounds }
    }

    /// Whether the box of any leaf meets the box from `lo` to `hi`.
    pub fn meets(&self, lo: DVec3, hi: DVec3) -> bool {
        self.any_leaf_in(self.top(), 0, [lo, hi].map(|at| at.to_array()), &mut |_| true)
    }

    /// Calls `visit` with the numbers of all triangles whose leaves meet the box from `lo` to
    /// `hi`.
    pub fn visit(&self, lo: DVec3, hi: DVec3, mut visit: impl FnMut(usize)) {
        self.any_leaf_in(self.top(), 0, [lo, hi].map(|at| at.to_array()), &mut |leaf| {
            let from = leaf * WIDTH;
            let end = self.order.len().min(from + WIDTH);
            self.order[from..end].iter().for_each(|&number| visit(number as usize));
            false
        });
    }

    /// Whether `accepts` returns true for a leaf of the node that meets the box `within`.
    fn any_leaf_in(
        &self,
        level: usize,
        node: usize,
        within: [[f64; 3]; 2],
        accepts: &mut impl FnMut(usize) -> bool,
    ) -> bool {
        let squared = squared_box_distances(&self.levels[level][node], within);
        (0..WIDTH).filter(|&lane| squared[lane] == 0.0).any(|lane| {
            let child = node * WIDTH + lane;
            if level > 0 {
                self.any_leaf_in(level - 1, child, within, accepts)
            } else {
                accepts(child)
            }
        })
    }
}

/// A part of a tree: nodes of one level.
#[derive(Debug)]
pub struct Vicinity<'a> {
    tree: &'a BoxTree,
    level: usize,
    nodes: Vec<u32>,
    /// The bounds of the nodes.
    bounds: Vec<Node>,
}

impl Vicinity<'_> {
    /// The nearest triangle in this part of the tree, as [`BoxTree::nearest`] returns it.
    pub fn nearest(&self, point: DVec3, bound: f64) -> Option<(f64, usize)> {
        let mut best = (bound, usize::MAX);
        let point = point.to_array();
        let mut squared = [f64::INFINITY; MOST_IN_VICINITY];
        let mut first = (f64::INFINITY, 0);
        for (number, bounds) in self.bounds.iter().enumerate() {
            for (lane, of_lane) in squared_distances(bounds, point).into_iter().enumerate() {
                squared[number * WIDTH + lane] = of_lane;
                if of_lane < first.0 {
                    first = (of_lane, number * WIDTH + lane);
                }
            }
        }
        // Search the nearest node first, because the triangle found in it shows that most other
        // nodes are too far away.
        let mut search = |number: usize, squared: f64| {
            if squared < best.0 {
                self.tree.search(self.level, self.nodes[number] as usize, point, &mut best);
            }
        };
        search(first.1, first.0);
        squared[first.1] = f64::INFINITY;
        squared.iter().take(self.nodes.len()).enumerate().for_each(|(n, &s)| search(n, s));
        self.tree.found(best)
    }
}

/// A box that contains nothing.
const EMPTY_BOX: [DVec3; 2] = [DVec3::INFINITY, DVec3::NEG_INFINITY];

impl Default for Node {
    /// A node without children.
    fn default() -> Self {
        Self {
            lo: [[f32::INFINITY; WIDTH]; 3],
            hi: [[f32::NEG_INFINITY; WIDTH]; 3],
            centre: [[0.0; WIDTH]; 3],
            normal: [[0.0; WIDTH]; 3],
            thickness: [f32::INFINITY; WIDTH],
            radius: [f32::INFINITY; WIDTH],
        }
    }
}

impl Node {
    /// The node of up to 8 children.
    fn of(children: &[Bounds]) -> Self {
        let mut node = Self::default();
        for (lane, child) in children.iter().enumerate() {
            for axis in 0..3 {
                node.lo[axis][lane] = rounded_down(child.lo[axis]);
                node.hi[axis][lane] = -rounded_down(-child.hi[axis]);
                node.centre[axis][lane] = child.centre[axis];
                node.normal[axis][lane] = child.normal[axis];
            }
            node.thickness[lane] = -rounded_down(-child.thickness);
            node.radius[lane] = -rounded_down(-child.radius);
        }
        node
    }

    /// Copies the bounds of a child of another node.
    fn copy(&mut self, to: usize, other: &Self, from: usize) {
        for axis in 0..3 {
            self.lo[axis][to] = other.lo[axis][from];
            self.hi[axis][to] = other.hi[axis][from];
            self.centre[axis][to] = other.centre[axis][from];
            self.normal[axis][to] = other.normal[axis][from];
        }
        self.thickness[to] = other.thickness[from];
        self.radius[to] = other.radius[from];
    }
}

/// The bounds of some triangles: a box and a disc, as in a [`Node`].
struct Bounds {
    lo: DVec3,
    hi: DVec3,
    centre: Vec3,
    normal: Vec3,
    thickness: f64,
    radius: f64,
}

impl Bounds {
    /// The bounds of the triangles of some leaves.
    fn of_leaves(leaves: &[Leaf]) -> Self {
        let triangles = || {
            leaves.iter().flat_map(|leaf| {
                let corner = |corner: usize, lane: usize| at_lane(&leaf[corner], lane);
                (0..WIDTH).map(move |lane| [0, 1, 2].map(|of| DVec3::from(corner(of, lane))))
            })
        };
        let corners = || triangles().flatten();
        let [lo, hi] = corners().fold(EMPTY_BOX, |[lo, hi], at| [lo.min(at), hi.max(at)]);
        let normal: DVec3 = triangles().map(|[a, b, c]| (b - a).cross(c - a)).sum();
        let normal = normal.normalize_or_zero().as_vec3();
        let centre = (lo / 2.0 + hi / 2.0).as_vec3();
        let (mut thickness, mut squared_radius) = (0.0_f64, 0.0_f64);
        for corner in corners() {
            let from_centre = corner - centre.as_dvec3();
            let height = from_centre.dot(normal.as_dvec3());
            thickness = thickness.max(height.abs());
            squared_radius = squared_radius.max(from_centre.length_squared() - height * height);
        }
        let radius = squared_radius.sqrt();
        let margin = (thickness + radius) * DISC_MARGIN;
        Self { lo, hi, centre, normal, thickness: thickness + margin, radius: radius + margin }
    }

    /// The bounds of a node's children, with an infinite disc.
    fn of_node(node: &Node) -> Self {
        let least = |at: &[f32; WIDTH]| f64::from(at.iter().copied().fold(f32::INFINITY, f32::min));
        let negative = |at: &[f32; WIDTH]| -least(&at.map(|x| -x));
        let (lo, hi) = (node.lo.each_ref().map(least), node.hi.each_ref().map(negative));
        let (centre, normal) = (Vec3::ZERO, Vec3::ZERO);
        let infinite = f64::INFINITY;
        Self { lo: lo.into(), hi: hi.into(), centre, normal, thickness: infinite, radius: infinite }
    }
}

/// The largest f32 that is at most `x`.
fn rounded_down(x: f64) -> f32 {
    let nearest = x as f32;
    if f64::from(nearest) > x { nearest.next_down() } else { nearest }
}

/// The centre of a triangle's box and half of the box's size, both divided by the size of the whole
/// mesh, and the triangle's number.
type Item = ([f32; 4], u32);

/// The numbers of the triangles `0..count`, in the order of the leaves.
fn sorted(count: usize, corners: &(impl Fn(usize) -> [DVec3; 3] + Sync)) -> Vec<u32> {
    // Coordinates are halved, because the size could overflow otherwise.
    let bounds = |number: usize| {
        let [a, b, c] = corners(number).map(|corner| corner / 2.0);
        [a.min(b).min(c), a.max(b).max(c)]
    };
    let join = |a: [DVec3; 2], b: [DVec3; 2]| [a[0].min(b[0]), a[1].max(b[1])];
    let [lo, hi] = (0..count).into_par_iter().map(bounds).reduce(|| EMPTY_BOX, join);
    let size = (hi - lo).max_element();
    let item = |number: usize| {
        let [from, to] = bounds(number);
        let [x, y, z] = ((from / 2.0 + to / 2.0) / size).as_vec3().to_array();
        let half = ((to - from).max_element() / 2.0 / size) as f32;
        ([x, y, z, half], number as u32)
    };
    let mut items: Vec<Item> = (0..count).into_par_iter().map(item).collect();
    divide(&mut items);
    items.into_par_iter().map(|(_, number)| number).collect()
}

/// Sorts triangles so that consecutive triangles are near each other and of similar size.
fn divide(items: &mut [Item]) {
    if items.len() <= WIDTH {
        return;
    }
    let (mut least, mut greatest) = ([f32::INFINITY; 4], [f32::NEG_INFINITY; 4]);
    for (at, _) in &*items {
        for axis in 0..4 {
            least[axis] = least[axis].min(at[axis]);
            greatest[axis] = greatest[axis].max(at[axis]);
        }
    }
    let extent = |axis: usize| greatest[axis] - least[axis];
    let axis = (1..4).fold(0, |best, axis| if extent(axis) > extent(best) { axis } else { best });
    // The size of the first group is a power of two, so that each leaf and each node either lies
    // within one group, or contains both groups.
    let count = items.len().next_power_of_two() / 2;
    items.select_nth_unstable_by(count, |a, b| a.0[axis].total_cmp(&b.0[axis]));
    let (first, second) = items.split_at_mut(count);
    if first.len() > PARALLEL {
        rayon::join(|| divide(first), || divide(second));
    } else {
        divide(first);
        divide(second);
    }
}

/// The squared distances of the box `from` to `to` from the boxes of a node; infinite for missing
/// children.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn squared_box_distances(node: &Node, [from, to]: [[f64; 3]; 2]) -> Lanes {
    let mut squared = [0.0; WIDTH];
    for axis in 0..3 {
        let boxes = node.lo[axis].iter().zip(&node.hi[axis]);
        for (squared, (&lo, &hi)) in squared.iter_mut().zip(boxes) {
            let (below, above) = (f64::from(lo) - to[axis], from[axis] - f64::from(hi));
            let outside = or_zero(greater(below, above));
            *squared += outside * outside;
        }
    }
    squared
}

/// Lower bounds on the squared distances of a point from the triangles of a node's children.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn squared_distances(node: &Node, point: [f64; 3]) -> Lanes {
    let mut squared = [0.0; WIDTH];
    for (lane, squared) in squared.iter_mut().enumerate() {
        let below = minus(at_lane(&node.lo, lane), point);
        let above = minus(point, at_lane(&node.hi, lane));
        let outside = [
            or_zero(greater(below[0], above[0])),
            or_zero(greater(below[1], above[1])),
            or_zero(greater(below[2], above[2])),
        ];
        // The distance from a box has no margin for rounding. With a margin, a search would visit
        // all triangles that meet at the nearest point, and these can be many.
        let from_box = dot(outside, outside);
        let from_centre = minus(point, at_lane(&node.centre, lane));
        let height = dot(from_centre, at_lane(&node.normal, lane));
        let along = or_zero(height.abs() - f64::from(node.thickness[lane]));
        let squared_across = dot(from_centre, from_centre) - height * height;
        let across = or_zero(squared_across.sqrt() - f64::from(node.radius[lane]));
        // For a disc that is too large for f32, the differences are NaN or negative, and `or_zero`
        // returns 0.
        let from_disc = (along * along + across * across) * (1.0 - DISC_MARGIN);
        *squared = greater(from_disc, from_box);
    }
    squared
}

/// The squared distances of a point from the triangles of a leaf.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn squared_triangle_distances(leaf: &Leaf, point: [f64; 3]) -> Lanes {
    let mut squared = [0.0; WIDTH];
    for (lane, squared) in squared.iter_mut().enumerate() {
        let corners = [at_lane(&leaf[0], lane), at_lane(&leaf[1], lane), at_lane(&leaf[2], lane)];
        *squared = squared_distance(point, corners);
    }
    squared
}

#[inline(always)]
fn at_lane<T: Copy + Into<f64>>(at: &[[T; WIDTH]; 3], lane: usize) -> [f64; 3] {
    [at[0][lane].into(), at[1][lane].into(), at[2][lane].into()]
}

/// The squared distance of a point from a triangle. This is the least of the squared distances from
/// the edges and, if the point's projection onto the plane is in the triangle, from this
/// projection.
#[inline(always)]
pub fn squared_distance(point: [f64; 3], [a, b, c]: [[f64; 3]; 3]) -> f64 {
    let (ab, bc, ca) = (minus(b, a), minus(c, b), minus(a, c));
    let (ap, bp, cp) = (minus(point, a), minus(point, b), minus(point, c));
    let edges = least(
        least(squared_edge_distance(ab, ap), squared_edge_distance(bc, bp)),
        squared_edge_distance(ca, cp),
    );
    // Barycentric coordinates, times the squared length of the normal. They describe a point of the
    // triangle even if rounding makes the normal of a narrow triangle useless.
    let normal = cross(ca, ab);
    let of_a = or_zero(dot(cross(bc, bp), normal));
    let of_b = or_zero(dot(cross(ca, cp), normal));
    let of_c = or_zero(dot(cross(ab, ap), normal));
    let all = of_a + of_b + of_c;
    let (of_b, of_c) = (of_b / all, of_c / all);
    let away = minus(minus(ap, times(ab, of_b)), times(ca, -of_c));
    // `all` is 0 for a triangle without area, whose quotients are NaN.
    least(dot(away, away), edges)
}

/// The part of a triangle on which a point lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// A corner: the first, second or third.
    Corner(usize),
    /// The edge from this corner to the next, without its ends.
    Edge(usize),
    /// The triangle without its edges.
    Face,
}

/// The point of a triangle nearest to `point`: its squared distance, its position and its place.
pub fn nearest_place(point: DVec3, [a, b, c]: [DVec3; 3]) -> (f64, DVec3, Place) {
    let mut nearest = (f64::INFINITY, a, Place::Face);
    let mut note = |at: DVec3, place: Place| {
        let squared = point.distance_squared(at);
        if squared < nearest.0 {
            nearest = (squared, at, place);
        }
    };
    for (number, [from, to]) in [[a, b], [b, c], [c, a]].into_iter().enumerate() {
        let share = (point - from).dot(to - from) / (to - from).length_squared();
        match share {
            share if share >= 1.0 => note(to, Place::Corner((number + 1) % 3)),
            share if share > 0.0 => note(from + (to - from) * share, Place::Edge(number)),
            _ => note(from, Place::Corner(number)),
        }
    }
    let normal = (b - a).cross(c - a);
    let [of_a, of_b, of_c] =
        [[b, c], [c, a], [a, b]].map(|[from, to]| (to - from).cross(point - from).dot(normal));
    if of_a > 0.0 && of_b > 0.0 && of_c > 0.0 {
        let all = of_a + of_b + of_c;
        note(a + (b - a) * (of_b / all) + (c - a) * (of_c / all), Place::Face);
    }
    nearest
}

/// The squared distance of a point from an edge. `edge` is the vector from the edge's start to its
/// end, and `from` the vector from its start to the point.
#[inline(always)]
fn squared_edge_distance(edge: [f64; 3], from: [f64; 3]) -> f64 {
    let share = dot(from, edge) / dot(edge, edge);
    let away = minus(from, times(edge, least(or_zero(share), 1.0)));
    dot(away, away)
}

/// `a` if it is less than `b`, otherwise `b`, even if `a` is NaN.
#[inline(always)]
fn least(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

/// `a` if it is greater than `b`, otherwise `b`, even if `a` is NaN.
#[inline(always)]
fn greater(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// `x` if it is positive, otherwise 0, even if `x` is NaN.
#[inline(always)]
fn or_zero(x: f64) -> f64 {
    if x > 0.0 { x } else { 0.0 }
}

#[inline(always)]
fn times(a: [f64; 3], by: f64) -> [f64; 3] {
    [a[0] * by, a[1] * by, a[2] * by]
}

#[inline(always)]
fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sequence of pseudorandom numbers from -1 to 1.
    fn random_numbers() -> impl FnMut() -> f64 {
        let mut state = 1_u64;
        move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
        }
    }

    /// Triangles of many sizes. Some are a line or a point.
    fn triangles(count: usize) -> Vec<[DVec3; 3]> {
        let mut random = random_numbers();
        let mut at = |scale: f64| DVec3::new(random(), random(), random()) * scale;
        let triangle = |number: usize| {
            let size = 10_f64.powi(-(number as i32 % 5));
            let (a, ab, ac) = (at(10.0), at(size), at(size));
            match number % 7 {
                0 => [a, a + ab, a + 0.3 * ab],
                1 => [a, a, a],
                2 => [a, a + ab, a + ab * (1.0 + 1e-12)],
                _ => [a, a + ab, a + ac],
            }
        };
        (0..count).map(triangle).collect()
    }

    fn of_each(triangles: &[[DVec3; 3]], point: DVec3) -> impl Iterator<Item = f64> {
        triangles.iter().map(move |corners| {
            squared_distance(point.to_array(), corners.map(|corner| corner.to_array()))
        })
    }

    #[test]
    fn a_search_finds_the_triangle_that_comparing_all_triangles_finds() {
        for count in [1, 7, 8, 9, 64, 65, 3000] {
            let triangles = triangles(count);
            let tree = BoxTree::new(count, |number| triangles[number]);
            let mut random = random_numbers();
            for _ in 0..300 {
                let point = DVec3::new(random(), random(), random()) * 12.0;
                let least = of_each(&triangles, point).fold(f64::INFINITY, f64::min);
                let (squared, number) = tree.nearest(point, f64::INFINITY).unwrap();
                // The search can miss a triangle that is nearer only by a rounding error.
                let as_far = |squared: f64| (squared - least).abs() <= 1e-15 * least;
                assert!(as_far(squared), "{count}: {squared}, {least}");
                assert_eq!(of_each(&triangles, point).nth(number), Some(squared), "{count}");
                assert!(tree.nearest(point, least).is_none());
                // Searches in a part of the tree find all triangles that are near enough.
                let most = 3.0 * (1.0 + random());
                let [lo, hi] = [point - 0.5, point + 0.25];
                let found = tree.vicinity(lo, hi, most).nearest(point, most * most);
                assert_eq!(found.is_some(), least < most * most, "{count}");
                assert!(found.is_none_or(|(squared, _)| as_far(squared)), "{count}");
            }
        }
    }

    #[test]
    fn a_visit_finds_all_triangles_whose_boxes_meet_a_box() {
        let triangles = triangles(2000);
        let tree = BoxTree::new(triangles.len(), |number| triangles[number]);
        let mut random = random_numbers();
        for _ in 0..100 {
            let lo = DVec3::new(random(), random(), random()) * 11.0;
            let hi = lo + DVec3::new(random() + 1.0, random() + 1.0, 30.0);
            let mut found = vec![false; triangles.len()];
            tree.visit(lo, hi, |number| found[number] = true);
            assert_eq!(tree.meets(lo, hi), found.contains(&true));
            for (&[a, b, c], found) in triangles.iter().zip(found) {
                let meets = a.min(b).min(c).cmple(hi) & a.max(b).max(c).cmpge(lo);
                assert!(found || !meets.all(), "{a} {b} {c}, {lo} {hi}");
            }
        }
        assert!(!tree.meets(DVec3::splat(20.0), DVec3::splat(30.0)));
    }

    #[test]
    fn the_nearest_place_of_a_triangle_is_a_corner_an_edge_or_the_face() {
        let triangle = [DVec3::ZERO, DVec3::X * 2.0, DVec3::Y * 2.0];
        let cases = [
            ([0.5, 0.5, 3.0], [0.5, 0.5, 0.0], Place::Face),
            ([1.0, -2.0, 1.0], [1.0, 0.0, 0.0], Place::Edge(0)),
            ([2.0, 2.0, -1.0], [1.0, 1.0, 0.0], Place::Edge(1)),
            ([-1.0, 0.5, 0.0], [0.0, 0.5, 0.0], Place::Edge(2)),
            ([-1.0, -1.0, 2.0], [0.0, 0.0, 0.0], Place::Corner(0)),
            ([3.0, 0.1, 0.0], [2.0, 0.0, 0.0], Place::Corner(1)),
            ([0.0, 5.0, 1.0], [0.0, 2.0, 0.0], Place::Corner(2)),
        ];
        for (point, at, place) in cases {
            let (point, at) = (DVec3::from(point), DVec3::from(at));
            let squared = point.distance_squared(at);
            assert_eq!(nearest_place(point, triangle), (squared, at, place));
            assert_eq!(of_each(&[triangle], point).next(), Some(squared));
        }
        // `nearest_place` and `of_each` agree for any triangle.
        let mut random = random_numbers();
        for triangle in triangles(700) {
            let point = triangle[0] + DVec3::new(random(), random(), random());
            let (squared, at, _) = nearest_place(point, triangle);
            let other = of_each(&[triangle], point).next().unwrap();
            assert!((squared - other).abs() < 1e-12, "{triangle:?}: {squared}, {other}");
            assert!((point.distance_squared(at) - squared).abs() < 1e-12);
        }
    }

    #[test]
    fn triangles_with_coordinates_beyond_f32_are_found() {
        let far =
            |x: f64| [DVec3::splat(x), DVec3::splat(x) + DVec3::X, DVec3::splat(x) + DVec3::Y];
        let triangles = [far(1e60), far(-1e50), far(3.0)];
        let tree = BoxTree::new(3, |number| triangles[number]);
        for (number, x) in [(0, 1e60), (1, -1e50), (2, 0.0)] {
            assert_eq!(tree.nearest(DVec3::splat(x), f64::INFINITY).unwrap().1, number);
        }
    }
}
