//! Finds boundary particles among the particles of a fluid, by an attribute that distinguishes
//! boundary and fluid.

use std::cmp::Reverse;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use glam::{BVec3, DVec3, IVec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::occurring::{AttributeOrLabel, Value, values_of};
use super::{Particles, chunks};

/// Names of attributes that distinguish materials, in lower case and without punctuation.
const MATERIAL_NAMES: [&str; 38] = [
    "type",
    "ptype",
    "particletype",
    "parttype",
    "itype",
    "kind",
    "phase",
    "phaseid",
    "mk",
    "mkvalue",
    "material",
    "materialid",
    "mat",
    "matid",
    "group",
    "groupid",
    "label",
    "boundary",
    "isboundary",
    "bound",
    "fluid",
    "isfluid",
    "solid",
    "wall",
    "body",
    "bodyid",
    "objectid",
    "species",
    "element",
    "class",
    "classid",
    "state",
    "tag",
    "tagid",
    "flag",
    "flags",
    "iflag",
    "imove",
];

/// Maximum number of different values of an attribute that distinguishes materials.
const MOST_VALUES: usize = 3;
/// Maximum number of cells along each axis of the grid that finds the inside of the fluid.
const MOST_CELLS: f64 = 32.0;
/// Minimum overlap of a tank and its fluid along each axis, as a fraction of the fluid's extent.
const OVERLAP: f64 = 0.1;
/// Maximum thickness of a floor, in mean distances between its particles.
const FLOOR: f64 = 5.0;
/// Average number of fluid particles in a cell of the grid that finds the inside of the fluid.
const PARTICLES_PER_CELL: f64 = 8.0;
/// Maximum fraction of a boundary's particles that may be inside the fluid.
const MOST_INSIDE: f64 = 0.02;
/// If at least this fraction of a bounding box's inner cells is inside the fluid, the fluid fills
/// the box.
const FILLED: f64 = 0.5;
/// Minimum number of cells along each axis of a grid in which a cell can have neighbours on all
/// sides, and thus be inside the fluid.
const LEAST_CELLS: i32 = 3;
/// Maximum number of boundary particles in the bounding box of a fluid that has fewer than
/// [`LEAST_CELLS`] cells along each axis, as a multiple of the number of fluid particles. This
/// limit rejects a few tracers in a fluid: if the tracers are taken for the fluid, and the fluid
/// for the boundary, the bounding box of the tracers contains many more boundary particles.
const MOST_BOUNDARY_PER_FLUID: f64 = 0.5;

/// Whether the name of an attribute suggests materials.
pub fn is_material_name(name: &str) -> bool {
    let plain: String = name.chars().filter(char::is_ascii_alphanumeric).collect();
    MATERIAL_NAMES.contains(&plain.to_ascii_lowercase().as_str())
}

/// A fluid and the particles around it that look like its boundary.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Mixture {
    /// The attribute that distinguishes the boundary from the fluid.
    pub attribute: String,
    /// The attribute's value on the boundary, and the number of boundary particles.
    pub boundary: (Value, usize),
    /// The attribute's value in the fluid, and the number of fluid particles.
    pub fluid: (Value, usize),
}

/// The minimum and the maximum coordinates of a set of particles.
#[derive(Clone, Copy)]
struct BoundingBox([DVec3; 2]);

impl BoundingBox {
    const NONE: Self = Self([DVec3::INFINITY, DVec3::NEG_INFINITY]);

    fn joined(self, other: Self) -> Self {
        let (Self([lo, hi]), Self([other_lo, other_hi])) = (self, other);
        Self([lo.min(other_lo), hi.max(other_hi)])
    }

    /// The axes along which this box of `count` particles is as thin as a floor.
    fn thin_axes(self, count: usize) -> BVec3 {
        let Self([lo, hi]) = self;
        let extent = hi - lo;
        let floor = FLOOR * libm::cbrt(extent.element_product() / count as f64);
        extent.cmple(DVec3::splat(floor))
    }

    /// Whether this box of `count` particles extends beyond `inner` on all sides, or on all but
    /// one, because a tank may be open. Along an axis on which the boxes hardly overlap, this box
    /// must be as thin as a floor, so that deep water below spray is not taken for a floor.
    fn is_around(self, inner: Self, count: usize) -> bool {
        let (Self([lo, hi]), Self([inner_lo, inner_hi])) = (self, inner);
        let beyond =
            lo.cmplt(inner_lo).bitmask().count_ones() + hi.cmpgt(inner_hi).bitmask().count_ones();
        let overlap = hi.min(inner_hi) - lo.max(inner_lo);
        let overlaps_or_is_thin =
            overlap.cmpge(OVERLAP * (inner_hi - inner_lo)) | self.thin_axes(count);
        let is_body = (inner_hi - inner_lo).cmpgt(DVec3::ZERO).bitmask().count_ones() >= 2;
        beyond >= 5 && overlaps_or_is_thin.all() && is_body
    }
}

/// Finds a boundary around a fluid, using an attribute whose name and values suggest a boundary.
pub fn mixture(particles: &dyn Particles) -> Option<Mixture> {
    let scalars = particles.attributes().iter().enumerate();
    let scalars = scalars.filter(|(_, info)| info.components == 1 && is_material_name(&info.name));
    let labels =
        particles.labels().iter().enumerate().filter(|(_, label)| is_material_name(&label.name));
    let sources = scalars.map(|(index, info)| (AttributeOrLabel::of(index, info), &info.name));
    let mut sources =
        sources.chain(labels.map(|(index, l)| (AttributeOrLabel::Label(index), &l.name)));
    sources.find_map(|(source, name)| mixture_by(particles, source, name))
}

/// Calls `take` with the positions and the sort keys of a few thousand particles at a time, and
/// joins the results.
fn reduce_chunks<T: Send>(
    particles: &dyn Particles,
    source: AttributeOrLabel,
    take: impl Fn(&[[f64; 3]], &[u64]) -> T + Sync,
    joined: impl Fn(T, T) -> T + Send + Sync,
    none: impl Fn() -> T + Sync,
) -> T {
    let found = chunks(particles, |range| {
        let mut positions = vec![[0.0; 3]; range.len()];
        particles.positions(range.start, &mut positions);
        take(&positions, &source.keys(particles, range))
    });
    found.reduce(&none, joined)
}

/// Finds a boundary by the values of one attribute or label. `name` is its name.
fn mixture_by(particles: &dyn Particles, source: AttributeOrLabel, name: &str) -> Option<Mixture> {
    let values =
        values_of(particles, source).filter(|values| (2..=MOST_VALUES).contains(&values.len()))?;
    let finite = |position: &[f64; 3]| DVec3::from(*position).is_finite();
    let index_of = |key: u64| values.iter().position(|(known, ..)| *known == key);
    let extents = reduce_chunks(
        particles,
        source,
        |positions, keys| {
            let mut extents = [BoundingBox::NONE; MOST_VALUES];
            for (position, key) in positions.iter().zip(keys).filter(|(p, _)| finite(p)) {
                if let Some(index) = index_of(*key) {
                    extents[index] =
                        extents[index].joined(BoundingBox([DVec3::from(*position); 2]));
                }
            }
            extents
        },
        |one, other| std::array::from_fn(|i| one[i].joined(other[i])),
        || [BoundingBox::NONE; MOST_VALUES],
    );
    let pairs =
        (0..values.len()).flat_map(|outer| (0..values.len()).map(move |inner| (outer, inner)));
    let around = |&(outer, inner): &(usize, usize)| {
        extents[outer].is_around(extents[inner], values[outer].2)
    };
    let visit = |key: u64, cells: &FluidCells, visit: &(dyn Fn(usize) + Sync)| {
        let take = |positions: &[[f64; 3]], keys: &[u64]| {
            let of_key = positions.iter().zip(keys).filter(|(p, own)| **own == key && finite(p));
            of_key.filter_map(|(p, _)| cells.index(DVec3::from(*p))).for_each(visit);
        };
        reduce_chunks(particles, source, take, |(), ()| (), || ());
    };
    let wet = |key: u64, cells: &FluidCells| -> Vec<bool> {
        let wet: Vec<AtomicBool> = (0..cells.len()).map(|_| AtomicBool::new(false)).collect();
        visit(key, cells, &|cell| wet[cell].store(true, Ordering::Relaxed));
        wet.into_iter().map(AtomicBool::into_inner).collect()
    };
    // The particles of a tank do not fill their bounding box. If the particles with one value fill
    // their bounding box, as water around a body does, they are not a boundary.
    let fills: Vec<bool> = values
        .iter()
        .zip(&extents)
        .map(|((key, _, count), extent)| {
            let cells = FluidCells::of(*extent, *count);
            !extent.thin_axes(*count).any() && cells.are_filled(&wet(*key, &cells))
        })
        .collect();
    let is_boundary = |&(outer, inner): &(usize, usize)| {
        let ((boundary, _, around), (fluid, _, within)) = (&values[outer], &values[inner]);
        let cells = FluidCells::of(extents[inner], *within);
        let wet = wet(*fluid, &cells);
        let (in_fluid_box, inside) = (AtomicU32::new(0), AtomicU32::new(0));
        visit(*boundary, &cells, &|cell| {
            in_fluid_box.fetch_add(1, Ordering::Relaxed);
            if cells.is_inside(&wet, cell) {
                inside.fetch_add(1, Ordering::Relaxed);
            }
        });
        let has_few_inside_fluid = f64::from(inside.into_inner()) <= MOST_INSIDE * *around as f64;
        let is_around = cells.count >= LEAST_CELLS
            || f64::from(in_fluid_box.into_inner()) <= MOST_BOUNDARY_PER_FLUID * *within as f64;
        has_few_inside_fluid && is_around
    };
    let around = pairs.filter(around).filter(|pair| !fills[pair.0]).filter(is_boundary);
    // A tank can also contain solid bodies. They mostly have fewer particles than the fluid, so the
    // inner value with the most particles is taken for the fluid.
    let (outer, inner) = around.min_by_key(|&(_, inner)| Reverse(values[inner].2))?;
    let ((_, boundary, of_boundary), (_, fluid, of_fluid)) = (&values[outer], &values[inner]);
    Some(Mixture {
        attribute: name.to_owned(),
        boundary: (boundary.clone(), *of_boundary),
        fluid: (fluid.clone(), *of_fluid),
    })
}

/// Cells in the bounding box of the fluid.
struct FluidCells {
    lo: DVec3,
    scale: DVec3,
    count: i32,
}

impl FluidCells {
    fn of(BoundingBox([lo, hi]): BoundingBox, particles: usize) -> Self {
        let count =
            libm::cbrt(particles as f64 / PARTICLES_PER_CELL).clamp(1.0, MOST_CELLS).floor();
        Self {
            lo,
            scale: count / (hi - lo).max(DVec3::splat(f64::MIN_POSITIVE)),
            count: count as i32,
        }
    }

    fn len(&self) -> usize {
        self.count.pow(3) as usize
    }

    fn number(&self, cell: IVec3) -> Option<usize> {
        let is_in = cell.cmpge(IVec3::ZERO).all() && cell.cmplt(IVec3::splat(self.count)).all();
        is_in.then(|| ((cell.z * self.count + cell.y) * self.count + cell.x) as usize)
    }

    fn index(&self, position: DVec3) -> Option<usize> {
        let cell = ((position - self.lo) * self.scale).floor();
        // A position on an upper face belongs to the last cell.
        let last = DVec3::splat(f64::from(self.count));
        let cell = DVec3::select(cell.cmpeq(last), last - 1.0, cell);
        let is_in = cell.cmpge(DVec3::ZERO).all() && cell.cmplt(last).all();
        is_in.then(|| self.number(cell.as_ivec3())).flatten()
    }

    /// Whether most cells that have neighbours on all sides are inside the fluid.
    fn are_filled(&self, wet: &[bool]) -> bool {
        let inner = usize::try_from(self.count - 2).unwrap_or(0).pow(3);
        let inside = (0..self.len()).filter(|&cell| self.is_inside(wet, cell)).count();
        self.count >= LEAST_CELLS && inside as f64 >= FILLED * inner as f64
    }

    /// Whether a cell and all cells around it contain fluid.
    fn is_inside(&self, wet: &[bool], cell: usize) -> bool {
        let (cell, count) = (cell as i32, self.count);
        let at = IVec3::new(cell % count, cell / count % count, cell / (count * count));
        let steps = || -1..=1;
        let around = steps()
            .flat_map(|z| steps().flat_map(move |y| steps().map(move |x| IVec3::new(x, y, z))));
        around.into_iter().all(|step| self.number(at + step).is_some_and(|cell| wet[cell]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::particles::Cloud;

    /// Points of a lattice around the origin, each with a value.
    fn lattice(half: i32, number: impl Fn(IVec3) -> Option<f32>) -> (Vec<[f64; 3]>, Vec<f32>) {
        let axis = || -half..=half;
        let points =
            axis().flat_map(|z| axis().flat_map(move |y| axis().map(move |x| IVec3::new(x, y, z))));
        points.filter_map(|p| Some((p.as_dvec3().to_array(), number(p)?))).unzip()
    }

    fn found(name: &str, (positions, numbers): &(Vec<[f64; 3]>, Vec<f32>)) -> Option<Mixture> {
        mixture(&Cloud::new(positions).with(name, numbers))
    }

    #[test]
    fn a_shell_around_a_fluid_is_recognised_as_its_boundary() {
        let tank = lattice(12, |p| {
            let is_wall = p.abs().max_element() > 10;
            (is_wall && p.z < 12 || !is_wall && p.z < 3).then_some(if is_wall { 7.0 } else { 2.0 })
        });
        let Mixture { attribute, boundary, fluid } = found("Mk", &tank).unwrap();
        assert_eq!(
            (attribute.as_str(), boundary.0, fluid.0),
            ("Mk", Value::Number(7.0), Value::Number(2.0))
        );
        assert_eq!(boundary.1 + fluid.1, tank.0.len());
        assert_eq!(found("temperature", &tank), None);
        // Water on a floor.
        let floor = lattice(12, |p| match p.z {
            ..=-11 => Some(5.0),
            -10..=-6 => (p.truncate().abs().max_element() < 9).then_some(1.0),
            _ => None,
        });
        assert_eq!(found("group", &floor).unwrap().boundary.0, Value::Number(5.0));
        // A round tank, whose walls are inside the bounding box of the fluid.
        let round = lattice(12, |p| {
            let r = p.as_dvec3().truncate().length();
            let is_wall = r > 10.5 || p.z < -10;
            (r < 12.0).then(|| f32::from(is_wall))
        });
        assert_eq!(found("phase", &round).unwrap().boundary.0, Value::Number(1.0));
    }

    #[test]
    fn layers_and_mixed_fluids_are_not_taken_for_boundaries() {
        let layers = lattice(10, |p| Some(f32::from(p.z > 0)));
        let mixed =
            lattice(10, |p| Some((p.x * 7 + p.y * 13 + p.z * 29).rem_euclid(3).min(1) as f32));
        let drop = lattice(10, |p| Some(f32::from(p.length_squared() < 30)));
        // Spray above a layer of water that is wider than the spray.
        let spray = lattice(10, |p| match p.z {
            ..=0 => Some(0.0),
            _ => (p.truncate().abs().max_element() < 8 && p.element_sum() % 3 == 0).then_some(1.0),
        });
        let tracers = lattice(8, |p| Some(f32::from((p.x * 7 + p.y * 13 + p.z * 29) % 50 == 0)));
        for one in [layers, mixed, drop, spray, tracers] {
            assert_eq!(found("phase", &one), None);
        }
    }

    #[test]
    fn a_boundary_is_found_although_bodies_float_in_the_fluid() {
        let of = |p: IVec3| match p.abs().max_element() {
            0..=3 => 2.0,
            4..=10 => 3.0,
            _ => 0.0,
        };
        let body = |p: IVec3| (of(p) != 0.0).then(|| of(p));
        assert_eq!(found("type", &lattice(12, body)), None, "water around a body");
        let tank = |p: IVec3| (p.z < 12).then(|| of(p));
        let Mixture { boundary, fluid, .. } = found("type", &lattice(12, tank)).unwrap();
        assert_eq!((boundary.0, fluid.0), (Value::Number(0.0), Value::Number(3.0)));
    }
}
