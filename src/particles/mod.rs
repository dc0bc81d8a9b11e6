//! The interface through which the pipeline reads ranges of particles, repeatedly and from several
//! threads.

pub mod alike;
mod cloud;
pub mod condition;
pub mod kind;
pub mod lattice;
mod metered;
pub mod mixture;
pub mod occurring;
pub mod selection;
pub mod sieve;
pub mod sizes;
pub mod velocity;

use std::fmt;
use std::io;
use std::ops::Range;

use glam::DVec3;
use multiversion::multiversion;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use thiserror::Error;

pub use cloud::{AttributeValue, Cloud};
pub use kind::{AttributeKind, colour_attribute};
pub use metered::MeteredParticles;
pub use velocity::velocity_attribute;

/// Describes an attribute, which is a value that every particle has.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct AttributeInfo {
    /// The name of the attribute in the file.
    pub name: String,
    /// Number of components per particle.
    pub components: usize,
    /// The kind of its values.
    #[serde(default, skip_serializing_if = "AttributeKind::is_number")]
    pub kind: AttributeKind,
}

/// A text attribute with few distinct values.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Label {
    /// The name of the label in the file.
    pub name: String,
    /// The distinct texts.
    pub texts: Vec<String>,
}

impl AttributeInfo {
    /// Describes an attribute of floating-point numbers. It is a colour if it has a colour's name
    /// and three or four components, and plain numbers otherwise.
    #[must_use]
    pub fn new(name: impl Into<String>, components: usize) -> Self {
        let name = name.into();
        let kind = AttributeKind::of_floats(&name, components);
        Self { name, components, kind }
    }

    /// The type of the attribute, as text for a message.
    pub(crate) fn type_text(&self) -> String {
        let &Self { components, kind, .. } = self;
        match (kind, components) {
            (AttributeKind::Colour | AttributeKind::ByteColour, _) => {
                format!("a colour of {components} components")
            }
            (AttributeKind::Number, 1) => "one floating-point number".into(),
            (AttributeKind::Number, _) => format!("{components} floating-point numbers"),
            (_, 1) => "one integer".into(),
            (_, _) => format!("{components} integers"),
        }
    }

    /// Whether this is the velocity of a mesh's vertices, which is always called `velocity`.
    #[must_use]
    pub fn is_velocity(&self) -> bool {
        self.name == "velocity" && self.components == 3
    }

    /// Whether this is a direction, which rotates with the mesh. Attributes with three components
    /// are directions, except colours, texture coordinates and integers.
    pub(crate) fn is_direction(&self) -> bool {
        self.components == 3
            && !self.kind.is_colour()
            && !self.kind.is_whole()
            && !kind::is_colour_name(&self.name)
            && !matches!(&*self.name, "uv" | "uvw")
    }
}

/// A number of particles, as text for a message.
pub(crate) fn particle_count(particles: usize) -> String {
    format!("{particles} {}", if particles == 1 { "particle" } else { "particles" })
}

/// The reason why particles cannot be read again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum RereadError {
    /// The particles' file changed while it was read.
    #[error("the file changed while it was being read; try again when it is complete")]
    Changed,
    /// The operating system reported an error in reading the particles' file.
    #[error("{0}")]
    Io(io::ErrorKind),
}

/// Particles in memory or in a file.
///
/// Particles keep the order of their file, and error messages refer to them by index. Values are
/// returned as stored, and can be NaN or infinite. Slices, vectors and arrays of `[f32; 3]` or
/// `[f64; 3]` are particles without attributes; a [`Cloud`] adds attributes.
pub trait Particles: Sync {
    /// Number of particles.
    fn len(&self) -> usize;

    /// Whether there are no particles.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Fills `out` with the positions of consecutive particles, starting at index `first`.
    ///
    /// # Panics
    /// If `first + out.len()` exceeds [`len`](Self::len).
    fn positions(&self, first: usize, out: &mut [[f64; 3]]);

    /// Checks that the particles did not change while they were read.
    ///
    /// # Errors
    /// [`RereadError`] if their file changed. The caller must then discard everything that was
    /// read.
    fn check(&self) -> Result<(), RereadError> {
        Ok(())
    }

    /// Whether the particles can still be read. After a cancel, this is false, and all positions
    /// and floating-point values read as NaN.
    fn goes_on(&self) -> bool {
        true
    }

    /// Memory, in bytes, that the particles occupy.
    fn resident_bytes(&self) -> u64 {
        0
    }

    /// Hints that a range will not be read soon, so that a mapped scratch file can release its
    /// pages.
    fn release(&self, range: Range<usize>) {
        let _ = range;
    }

    /// The attributes that [`attribute`](Self::attribute) reads; positions are not among them.
    fn attributes(&self) -> &[AttributeInfo] {
        &[]
    }

    /// Fills `out` with attribute number `index` of consecutive particles, starting at particle
    /// `first`. The components of each particle are adjacent.
    ///
    /// # Panics
    /// If the range extends beyond the last particle, or if there is no such attribute.
    fn attribute(&self, index: usize, first: usize, out: &mut [f32]) {
        let _ = (first, out);
        panic!("there is no attribute number {index}");
    }

    /// The labels that [`label`](Self::label) reads.
    fn labels(&self) -> &[Label] {
        &[]
    }

    /// Fills `out` with label number `index` of consecutive particles, starting at particle
    /// `first`, as indices into the label's texts.
    ///
    /// # Panics
    /// If the range extends beyond the last particle, or if there is no such label.
    fn label(&self, index: usize, first: usize, out: &mut [u32]) {
        let _ = (first, out);
        panic!("there is no label number {index}");
    }

    /// Fills `out` with one component of an attribute of consecutive particles, starting at
    /// particle `first`. Values that are stored with a higher precision than f32 keep it.
    ///
    /// # Panics
    /// If the range extends beyond the last particle, or if there is no such attribute.
    fn component(&self, (index, component): (usize, usize), first: usize, out: &mut [f64]) {
        let components = self.attributes()[index].components;
        let mut values = vec![0.0; out.len() * components];
        self.attribute(index, first, &mut values);
        for (out, values) in out.iter_mut().zip(values.chunks(components)) {
            *out = values[component].into();
        }
    }

    /// Like [`attribute`](Self::attribute), but exact for integers that f32 cannot represent.
    /// Values above the greatest i64 become the greatest i64.
    ///
    /// # Panics
    /// Like [`attribute`](Self::attribute).
    fn integers(&self, index: usize, first: usize, out: &mut [i64]) {
        let mut values = vec![0.0; out.len()];
        self.attribute(index, first, &mut values);
        out.iter_mut().zip(values).for_each(|(to, value)| *to = value as i64);
    }
}

impl fmt::Debug for dyn Particles + '_ {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} particles", self.len())
    }
}

/// References are particles too, so that any particles can be passed as `&dyn Particles`.
impl<P: Particles + ?Sized> Particles for &P {
    fn len(&self) -> usize {
        (**self).len()
    }

    fn is_empty(&self) -> bool {
        (**self).is_empty()
    }

    fn positions(&self, first: usize, out: &mut [[f64; 3]]) {
        (**self).positions(first, out);
    }

    fn check(&self) -> Result<(), RereadError> {
        (**self).check()
    }

    fn goes_on(&self) -> bool {
        (**self).goes_on()
    }

    fn resident_bytes(&self) -> u64 {
        (**self).resident_bytes()
    }

    fn release(&self, range: Range<usize>) {
        (**self).release(range);
    }

    fn attributes(&self) -> &[AttributeInfo] {
        (**self).attributes()
    }

    fn attribute(&self, index: usize, first: usize, out: &mut [f32]) {
        (**self).attribute(index, first, out);
    }

    fn labels(&self) -> &[Label] {
        (**self).labels()
    }

    fn label(&self, index: usize, first: usize, out: &mut [u32]) {
        (**self).label(index, first, out);
    }

    fn component(&self, of: (usize, usize), first: usize, out: &mut [f64]) {
        (**self).component(of, first, out);
    }

    fn integers(&self, index: usize, first: usize, out: &mut [i64]) {
        (**self).integers(index, first, out);
    }
}

impl Particles for [[f64; 3]] {
    fn len(&self) -> usize {
        self.len()
    }

    fn positions(&self, first: usize, out: &mut [[f64; 3]]) {
        out.copy_from_slice(&self[first..first + out.len()]);
    }
}

impl Particles for [[f32; 3]] {
    fn len(&self) -> usize {
        self.len()
    }

    fn positions(&self, first: usize, out: &mut [[f64; 3]]) {
        let from = &self[first..first + out.len()];
        widen(out.as_flattened_mut(), from.as_flattened());
    }
}

impl<T: Sync> Particles for Vec<T>
where
    [T]: Particles,
{
    fn len(&self) -> usize {
        self.as_slice().len()
    }

    fn positions(&self, first: usize, out: &mut [[f64; 3]]) {
        self.as_slice().positions(first, out);
    }
}

impl<T: Sync, const N: usize> Particles for [T; N]
where
    [T]: Particles,
{
    fn len(&self) -> usize {
        N
    }

    fn positions(&self, first: usize, out: &mut [[f64; 3]]) {
        self.as_slice().positions(first, out);
    }
}

/// Positions interleaved with other numbers, such as in an array of structures: x, y and z are
/// adjacent, and each particle begins a constant number of values after the previous one.
#[derive(Debug, Clone, Copy)]
pub struct StridedPositions<'a, T> {
    numbers: &'a [T],
    stride: usize,
}

impl<'a, T: Copy + Into<f64>> StridedPositions<'a, T> {
    /// Reads x, y and z of the first particle from index `first` of `numbers`. Each further
    /// particle begins `stride` numbers after the previous one. `first` and `stride` count numbers,
    /// not bytes. Returns `None` if `stride` is less than 3.
    ///
    /// ```
    /// use meniscus::{Particles, StridedPositions};
    ///
    /// // Mass, x, y, z and density of two particles.
    /// let numbers = [1.0_f32, 0.1, 0.2, 0.3, 1000.0, 1.0, 0.4, 0.5, 0.6, 1000.0];
    /// let positions = StridedPositions::new(&numbers, 1, 5).expect("a stride of 3 or more");
    /// assert_eq!(positions.len(), 2);
    /// ```
    #[must_use]
    pub fn new(numbers: &'a [T], first: usize, stride: usize) -> Option<Self> {
        (stride >= 3).then(|| Self { numbers: numbers.get(first..).unwrap_or_default(), stride })
    }
}

impl<T: Copy + Into<f64> + Sync> Particles for StridedPositions<'_, T> {
    /// Number of complete positions.
    fn len(&self) -> usize {
        (self.numbers.len() + self.stride - 3) / self.stride
    }

    fn positions(&self, first: usize, out: &mut [[f64; 3]]) {
        for (to, at) in out.iter_mut().zip((first * self.stride..).step_by(self.stride)) {
            *to = std::array::from_fn(|axis| self.numbers[at + axis].into());
        }
    }
}

#[multiversion(targets("x86_64+avx512f", "x86_64+avx2"))]
fn widen(to: &mut [f64], from: &[f32]) {
    to.iter_mut().zip(from).for_each(|(to, &from)| *to = from.into());
}

/// The index of the attribute called `name`. If no attribute has exactly this name, `velocity`
/// matches the velocity under any of its usual names. Next, an attribute whose name differs only in
/// case matches, provided that there is only one. Finally, the name of a colour or of a colour
/// component, such as `red`, matches the first colour.
#[must_use]
pub fn attribute_called(name: &str, attributes: &[AttributeInfo]) -> Option<usize> {
    let named = attributes.iter().position(|info| info.name == name);
    let alike = || {
        let is_alike = |info: &AttributeInfo| info.name.eq_ignore_ascii_case(name);
        let mut alike = (0..attributes.len()).filter(|&index| is_alike(&attributes[index]));
        alike.next().filter(|_| alike.next().is_none())
    };
    let velocity = || velocity_attribute(attributes).filter(|_| name == "velocity");
    let colour =
        || colour_attribute(attributes).filter(|_| kind::is_colour_or_component_name(name));
    named.or_else(velocity).or_else(alike).or_else(colour)
}

/// The attributes of the mesh: the particles' attributes with the indices in `carried`. The
/// velocity is renamed to `velocity` if no attribute has this name yet; other attributes keep their
/// names.
pub fn carried_infos(attributes: &[AttributeInfo], carried: &[usize]) -> Vec<AttributeInfo> {
    let taken = attributes.iter().any(|info| info.name == "velocity");
    let velocity = velocity_attribute(attributes).filter(|_| !taken);
    let name = |&index: &usize| {
        let info = attributes[index].clone();
        if velocity == Some(index) {
            AttributeInfo { name: "velocity".into(), ..info }
        } else {
            info
        }
    };
    carried.iter().map(name).collect()
}

/// Bounding box of particles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    /// Minimum coordinates.
    pub lo: DVec3,
    /// Maximum coordinates.
    pub hi: DVec3,
    /// Number of particles with finite coordinates; other particles are ignored.
    pub finite: usize,
}

impl Bounds {
    /// Bounds of an empty set of particles.
    pub const NONE: Self = Self { lo: DVec3::MAX, hi: DVec3::MIN, finite: 0 };

    /// Finds the bounds of the positions that are finite.
    #[must_use]
    pub fn of(positions: &[[f64; 3]]) -> Self {
        let one_by_one = |positions: &[[f64; 3]]| {
            let finite = positions.iter().map(|&p| DVec3::from(p)).filter(|p| p.is_finite());
            finite.fold(Self::NONE, |b, p| Self {
                lo: b.lo.min(p),
                hi: b.hi.max(p),
                finite: b.finite + 1,
            })
        };
        let (fours, rest) = positions.as_chunks();
        match bounds_of_fours(fours) {
            Some(bounds) => bounds.joined(one_by_one(rest)),
            None => one_by_one(positions),
        }
    }

    /// The bounds of both sets of particles together.
    pub fn joined(self, other: Self) -> Self {
        Self {
            lo: self.lo.min(other.lo),
            hi: self.hi.max(other.hi),
            finite: self.finite + other.finite,
        }
    }
}

/// Finds the bounds of positions in groups of four, which fill whole SIMD vectors. Returns `None`
/// if a position is not finite.
#[multiversion(targets("x86_64+avx512f", "x86_64+avx2"))]
fn bounds_of_fours(fours: &[[[f64; 3]; 4]]) -> Option<Bounds> {
    let (mut lo, mut hi, mut zero) = ([f64::MAX; 12], [f64::MIN; 12], [0.0; 12]);
    for four in fours {
        let four = four.as_flattened();
        for lane in 0..12 {
            let c = four[lane];
            lo[lane] = if c < lo[lane] { c } else { lo[lane] };
            hi[lane] = if c > hi[lane] { c } else { hi[lane] };
            // `zero` becomes NaN if a coordinate is not finite.
            zero[lane] += c * 0.0;
        }
    }
    if zero.iter().any(|&zero| zero != 0.0) {
        return None;
    }
    let points = |lanes: [f64; 12]| [0, 3, 6, 9].map(|at| DVec3::from_slice(&lanes[at..]));
    Some(Bounds {
        lo: points(lo).into_iter().fold(DVec3::MAX, DVec3::min),
        hi: points(hi).into_iter().fold(DVec3::MIN, DVec3::max),
        finite: 4 * fours.len(),
    })
}

/// The bounding box of all finite positions; `None` if no position is finite.
pub fn bounds(particles: &dyn Particles) -> Option<Bounds> {
    let of_chunk = |range: Range<usize>| {
        let mut positions = vec![[0.0; 3]; range.len()];
        particles.positions(range.start, &mut positions);
        Bounds::of(&positions)
    };
    let bounds = chunks(particles, of_chunk).reduce(|| Bounds::NONE, Bounds::joined);
    (bounds.finite > 0).then_some(bounds)
}

/// Number of particles that are processed together.
pub(crate) const CHUNK: usize = 1 << 12;

/// Calls `look` with ranges of a few thousand particles, on all threads. After each range, a mapped
/// file can release its pages.
pub fn chunks<T: Send>(
    particles: &dyn Particles,
    look: impl Fn(Range<usize>) -> T + Send + Sync,
) -> impl IndexedParallelIterator<Item = T> {
    let all = particles.len();
    (0..all.div_ceil(CHUNK)).into_par_iter().map(move |chunk| {
        let range = chunk * CHUNK..all.min((chunk + 1) * CHUNK);
        let found = look(range.clone());
        particles.release(range);
        found
    })
}

/// All finite positions, in batches of a few thousand.
pub fn finite_chunks(
    particles: &dyn Particles,
) -> impl IndexedParallelIterator<Item = Vec<[f64; 3]>> {
    chunks(particles, |range| {
        let mut positions = vec![[0.0; 3]; range.len()];
        particles.positions(range.start, &mut positions);
        positions.retain(|position| DVec3::from(*position).is_finite());
        positions
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_ignore_non_finite_positions_at_any_index() {
        let all: Vec<[f64; 3]> =
            (0..11).map(|i: i32| [f64::from(i * 7 % 11), f64::from(-i), 2.5]).collect();
        for len in 0..all.len() {
            for strange in 0..=len {
                let mut positions = all[..len].to_vec();
                let finite = [&all[..strange], &all[len.min(strange + 1)..len]].concat();
                if let Some(position) = positions.get_mut(strange) {
                    position[strange % 3] = [f64::NAN, f64::INFINITY][strange % 2];
                }
                let coordinates =
                    |axis: usize| finite.iter().map(move |position: &[f64; 3]| position[axis]);
                let lo = [0, 1, 2].map(|axis| coordinates(axis).fold(f64::MAX, f64::min));
                let hi = [0, 1, 2].map(|axis| coordinates(axis).fold(f64::MIN, f64::max));
                let expected = Bounds { lo: lo.into(), hi: hi.into(), finite: finite.len() };
                assert_eq!(Bounds::of(&positions), expected, "{strange} of {len}");
            }
        }
    }
}
