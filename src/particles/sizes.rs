//! Sizes of particles, from their attributes.
//!
//! The size of a particle is the edge of the cube that it fills, which is its own spacing. A radius
//! is half the size, because a spacing is twice the radius. A volume is the cube of the size, and a
//! mass is the volume times the density. Programs define radii and smoothing lengths differently,
//! so sizes are scaled such that, deep in the fluid, the cubes of the particles fill the space.

use std::ops::Range;

use glam::DVec3;
use hashbrown::HashMap;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::{AttributeInfo, Particles, attribute_called, chunks};

/// Names of attributes that are certainly radii, in lower case and without punctuation.
const RADII: [&str; 5] = ["pscale", "radius", "radii", "particleradius", "particleradii"];
/// The name of an attribute that certainly holds sizes. Files with different spacings get this
/// attribute when they are joined.
pub const SPACING: &str = "spacing";
/// The names of masses, densities and smoothing lengths in GADGET and SWIFT files. If the masses
/// differ, masses and densities certainly give the sizes of the particles; without densities, the
/// smoothing lengths give the sizes.
const USUAL_MASSES: &str = "masses";
const USUAL_DENSITIES: [&str; 2] = ["density", "densities"];
const USUAL_LENGTHS: [&str; 2] = ["smoothinglength", "smoothinglengths"];
/// Names of attributes whose values are read as diameters, volumes, masses or densities, in lower
/// case and without punctuation.
const DIAMETERS: [&str; 8] =
    ["diameter", "diameters", "size", SPACING, "h", "hsml", USUAL_LENGTHS[0], USUAL_LENGTHS[1]];
const VOLUMES: [&str; 5] = ["volume", "volumes", "vol", "particlevolume", "v0"];
const MASSES: [&str; 4] = ["mass", "masses", "particlemass", "m"];
const DENSITIES: [&str; 5] = ["density", "densities", "rho", "rhop", "densityf"];

/// Sizes that differ by less than this factor count as one size.
const SAME_SIZE: f64 = 1.1;
/// Maximum ratio of the largest to the smallest size. Larger particles are treated as having this
/// many times the smallest size.
pub const MOST_TIMES: f64 = 64.0;
/// Fraction of the particles that count as outliers at each end of the range of sizes.
const OUTLIERS: f64 = 1e-4;
/// Minimum ratio of the largest to the smallest mass at which masses count as different. Gas that
/// exchanges mass, for example with stars, has a smaller ratio, but still has one resolution.
const LEAST_MASS_RATIO: f64 = 1.9;
/// Fraction of the particles that is ignored at each end of the range of masses.
const MASS_OUTLIERS: f64 = 0.01;
/// Edge of the cells in which the density is measured, as a multiple of the largest size.
const CELL: f64 = 4.0;
/// Minimum number of cells from which a density is measured. Only cells whose 26 neighbours all
/// contain particles count.
const LEAST_CELLS: usize = 8;
/// Range of plausible densities. A density is the volume of the particles per unit volume. A
/// density outside this range shows that the program defines radii differently.
const PLAUSIBLE_DENSITIES: [f64; 2] = [0.7, 1.4];

/// Meaning of an attribute's values.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Meaning {
    /// Half of the size.
    Radius,
    /// The size.
    Diameter,
    /// The cube of the size.
    Volume,
    /// The cube of the size, times the density.
    Mass,
}

/// Chooses the attribute that holds the particles' sizes.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub enum SizeChoice {
    /// All particles have one size; attributes are ignored.
    Ignored,
    /// All particles must have one size, because the setting with this name requires one size.
    OneFor(&'static str),
    /// An attribute that certainly holds sizes, if there is one.
    #[default]
    Usual,
    /// The attribute with this name.
    Named(String),
}

/// The reason why an attribute cannot provide sizes.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum SizeFault {
    /// The attribute does not exist.
    #[error("no attribute {name:?} to take sizes from; available attributes: {}", listed(known))]
    NoAttribute {
        /// The requested name.
        name: String,
        /// Names of the existing attributes.
        known: Vec<String>,
    },
    /// The attribute has several components.
    #[error(
        "attribute {name:?} has {components} components, but a size is one number; choose another \
         attribute"
    )]
    Components {
        /// The attribute.
        name: String,
        /// Number of components.
        components: usize,
    },
    /// The attribute holds masses, but no attribute holds densities.
    #[error(
        "sizes cannot be computed from the masses in attribute {name:?}, because there is no \
         density attribute; available attributes: {}",
        listed(known)
    )]
    NoDensity {
        /// The attribute.
        name: String,
        /// Names of the existing attributes.
        known: Vec<String>,
    },
    /// No particle has a valid size.
    #[error("no particle has a positive, finite {name:?}; choose another attribute for the sizes")]
    NoSize {
        /// The attribute.
        name: String,
    },
}

fn listed(names: &[String]) -> String {
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

/// Indices of the attributes with the sizes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SizeAttributes {
    /// The attribute with the sizes.
    pub size: usize,
    /// The attribute with the densities, if `size` is a mass.
    pub density: Option<usize>,
    /// The meaning of the attribute's numbers.
    pub meaning: Meaning,
    /// An attribute with masses that must differ; if they do not, the particles have one size.
    pub if_masses_differ: Option<usize>,
}

/// Measured sizes of particles.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub struct Sizes {
    /// The attribute.
    pub attribute: String,
    /// The meaning of the attribute's numbers.
    pub meaning: Meaning,
    /// Factor by which the attribute's sizes are scaled, because the particles fill more or less
    /// space than these sizes imply.
    pub scale: f64,
    /// The smallest size, apart from outliers.
    pub finest: f64,
    /// The largest size; larger particles are treated as having this size.
    pub coarsest: f64,
    /// The median size, which replaces invalid sizes.
    pub usual: f64,
    /// Volume of the particles per unit volume deep in the fluid, if it could be measured.
    pub density: Option<f64>,
    /// Number of particles without a valid size.
    pub invalid: u64,
    /// Number of particles larger than `coarsest`.
    pub larger: u64,
}

/// The sizes of a frame's particles.
#[derive(Debug, Clone, PartialEq)]
pub enum FoundSizes {
    /// All particles have one size.
    One {
        /// The attribute.
        attribute: String,
        /// The size according to the attribute.
        size: f64,
        /// Number of particles without a valid size.
        invalid: u64,
    },
    /// The particles have several sizes.
    Several(Sizes),
}

/// Numbers of particles whose sizes are replaced.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct StraySizes {
    /// Particles without a valid size.
    pub invalid: u64,
    /// Particles larger than [`Sizes::coarsest`].
    pub larger: u64,
}

impl SizeChoice {
    /// The attributes with the sizes; `None` if all particles have one size.
    ///
    /// # Errors
    /// [`SizeFault`] if a requested attribute cannot provide sizes.
    pub fn columns(&self, infos: &[AttributeInfo]) -> Result<Option<SizeAttributes>, SizeFault> {
        match self {
            Self::Ignored => Ok(None),
            Self::Usual | Self::OneFor(_) => Ok(self.usual(infos)),
            Self::Named(name) => SizeAttributes::named(name, infos).map(Some),
        }
    }

    /// The attributes that certainly hold sizes. If a setting requires one size, only radii count.
    fn usual(&self, infos: &[AttributeInfo]) -> Option<SizeAttributes> {
        let known = |names: &[&str]| {
            let is_known =
                |info: &AttributeInfo| info.components == 1 && is_among(&info.name, names);
            infos.iter().position(is_known)
        };
        let plain = |size: usize, meaning| SizeAttributes {
            size,
            density: None,
            meaning,
            if_masses_differ: None,
        };
        let radius = || known(&RADII).map(|size| plain(size, Meaning::Radius));
        let spacing = || known(&[SPACING]).map(|size| plain(size, Meaning::Diameter));
        let masses = || {
            let masses = known(&[USUAL_MASSES])?;
            let lengths = || known(&USUAL_LENGTHS).map(|size| plain(size, Meaning::Diameter));
            let sizes = match known(&USUAL_DENSITIES) {
                None => lengths()?,
                density => SizeAttributes { density, ..plain(masses, Meaning::Mass) },
            };
            Some(SizeAttributes { if_masses_differ: Some(masses), ..sizes })
        };
        match self {
            Self::Usual => radius().or_else(spacing).or_else(masses),
            _ => radius(),
        }
    }
}

fn is_among(name: &str, names: &[&str]) -> bool {
    let plain: String = name.chars().filter(char::is_ascii_alphanumeric).collect();
    names.contains(&plain.to_ascii_lowercase().as_str())
}

impl Meaning {
    /// The meaning of an attribute by its name: a radius, unless the name says otherwise.
    fn of(name: &str) -> Self {
        if is_among(name, &DIAMETERS) {
            Self::Diameter
        } else if is_among(name, &VOLUMES) {
            Self::Volume
        } else if is_among(name, &MASSES) {
            Self::Mass
        } else {
            Self::Radius
        }
    }
}

impl SizeAttributes {
    /// Finds the attribute called `name` and, if it is a mass, the attribute with the densities.
    ///
    /// # Errors
    /// [`SizeFault`] if there is no such attribute, or if it cannot provide sizes.
    pub fn named(name: &str, infos: &[AttributeInfo]) -> Result<Self, SizeFault> {
        let known = || infos.iter().map(|info| info.name.clone()).collect();
        let size = attribute_called(name, infos)
            .ok_or_else(|| SizeFault::NoAttribute { name: name.to_owned(), known: known() })?;
        let AttributeInfo { name, components, .. } = &infos[size];
        if *components != 1 {
            return Err(SizeFault::Components { name: name.clone(), components: *components });
        }
        let meaning = Meaning::of(name);
        let is_density =
            |info: &AttributeInfo| info.components == 1 && is_among(&info.name, &DENSITIES);
        let density = match meaning {
            Meaning::Mass => {
                let density = infos.iter().position(is_density);
                let missing = || SizeFault::NoDensity { name: name.clone(), known: known() };
                Some(density.ok_or_else(missing)?)
            }
            Meaning::Radius | Meaning::Diameter | Meaning::Volume => None,
        };
        Ok(Self { size, density, meaning, if_masses_differ: None })
    }

    /// Whether the attributes give sizes. If `if_masses_differ` names masses, the largest mass,
    /// apart from outliers, must be at least `LEAST_MASS_RATIO` times the smallest.
    pub fn are_sizes(&self, particles: &dyn Particles) -> bool {
        let Some(size) = self.if_masses_differ else { return true };
        let masses = Self { size, density: None, meaning: Meaning::Diameter, ..*self };
        let range = SizeCounts::of(particles, &masses).range(MASS_OUTLIERS);
        range.is_some_and(|(least, most)| most >= LEAST_MASS_RATIO * least)
    }

    /// Whether the attribute holds smoothing lengths, which programs define in different ways.
    pub fn are_smoothing_lengths(&self) -> bool {
        self.if_masses_differ.is_some() && self.meaning != Meaning::Mass
    }

    /// The indices of the attributes.
    pub fn numbers(&self) -> impl Iterator<Item = usize> {
        [Some(self.size), self.density, self.if_masses_differ].into_iter().flatten()
    }

    /// The unscaled sizes of `count` particles, starting at particle `first`. Invalid sizes are
    /// NaN.
    fn read(&self, particles: &dyn Particles, first: usize, count: usize) -> Vec<f64> {
        let column = |number: usize| {
            let mut values = vec![0.0_f32; count];
            particles.attribute(number, first, &mut values);
            values
        };
        let (sizes, density) = (column(self.size), self.density.map(column));
        let density = |at: usize| density.as_ref().map_or(1.0, |density| density[at]);
        (0..count).map(|at| self.meaning.size(sizes[at], density(at)).unwrap_or(f64::NAN)).collect()
    }
}

impl Meaning {
    /// The size from an attribute's value and, for masses, a density; `None` for an invalid size.
    #[must_use]
    pub fn size(self, number: f32, density: f32) -> Option<f64> {
        let number = f64::from(number);
        let size = match self {
            Self::Radius => 2.0 * number,
            Self::Diameter => number,
            Self::Volume => cube_root(number),
            Self::Mass => cube_root(number / f64::from(density)),
        };
        // A size must be representable in f32.
        let size = f64::from(size as f32);
        (size.is_finite() && size > 0.0).then_some(size)
    }
}

/// The cube root of `x`, or NaN if `x` cannot be a volume.
fn cube_root(x: f64) -> f64 {
    if x > 0.0 && x.is_finite() { libm::cbrt(x) } else { f64::NAN }
}

impl Sizes {
    /// The size of a particle from its attribute's value and, for masses, its density.
    #[must_use]
    pub fn of(&self, number: f32, density: f32) -> f64 {
        let size = self.meaning.size(number, density).map(|size| size * self.scale);
        size.unwrap_or(self.usual).min(self.coarsest)
    }

    /// All finite positions with the sizes of their particles, in batches of a few thousand.
    pub fn finite_chunks(
        &self,
        particles: &dyn Particles,
        columns: &SizeAttributes,
    ) -> impl IndexedParallelIterator<Item = Vec<([f64; 3], f64)>> {
        chunks(particles, move |range| {
            let mut positions = vec![[0.0; 3]; range.len()];
            particles.positions(range.start, &mut positions);
            let sizes = columns.read(particles, range.start, range.len()).into_iter();
            let sizes = sizes.map(|size| {
                if size.is_nan() { self.usual } else { size * self.scale }.min(self.coarsest)
            });
            let all = positions.into_iter().zip(sizes);
            all.filter(|(position, _)| DVec3::from(*position).is_finite()).collect()
        })
    }

    /// Finds the attributes that hold these sizes among the attributes of other particles.
    ///
    /// # Errors
    /// [`SizeFault`] if they do not exist.
    pub fn columns(&self, infos: &[AttributeInfo]) -> Result<SizeAttributes, SizeFault> {
        Ok(SizeAttributes {
            meaning: self.meaning,
            ..SizeAttributes::named(&self.attribute, infos)?
        })
    }

    /// Counts the particles of another frame that have no valid size, and the particles that are
    /// larger than `coarsest`.
    pub fn strays(&self, particles: &dyn Particles, columns: &SizeAttributes) -> StraySizes {
        let most = self.coarsest / self.scale * (1.0 + f64::from(f32::EPSILON));
        let of_chunk = |range: Range<usize>| {
            let sizes = columns.read(particles, range.start, range.len());
            let count = |is: &dyn Fn(f64) -> bool| sizes.iter().filter(|&&size| is(size)).count();
            StraySizes {
                invalid: count(&f64::is_nan) as u64,
                larger: count(&|size| size > most) as u64,
            }
        };
        chunks(particles, of_chunk).reduce(StraySizes::default, |a, b| StraySizes {
            invalid: a.invalid + b.invalid,
            larger: a.larger + b.larger,
        })
    }

    /// Measures the density again if it could not be measured before, for example because the cells
    /// were derived from wrong sizes. The new cells are derived from `spacing`, the largest spacing
    /// of the particles according to their neighbours.
    pub fn scale_by_spacing(
        &mut self,
        particles: &dyn Particles,
        columns: &SizeAttributes,
        spacing: f64,
    ) {
        for cell in [CELL, CELL / 2.0] {
            if self.density.is_none() {
                self.scale_by_density(particles, columns, cell * spacing);
            }
        }
    }

    /// If the density could not be measured before, measures it in cells half as large, and reduces
    /// the sizes if the density is too high. The cells are derived from `spacing`, the largest
    /// spacing of the particles. A low density proves nothing in such cells, because they can be
    /// partly empty.
    pub fn reduce_if_too_dense(
        &mut self,
        particles: &dyn Particles,
        columns: &SizeAttributes,
        spacing: f64,
    ) {
        let density = || density_in_fluid(particles, columns, self, CELL / 2.0 * spacing);
        if self.density.is_none()
            && let Some(density) = density().filter(|&density| density >= PLAUSIBLE_DENSITIES[1])
        {
            self.scale_to_fill(density);
        }
    }

    /// Measures the density deep in the fluid, in cells of edge `edge`. If the density is not
    /// plausible, scales the sizes so that it becomes 1.
    fn scale_by_density(&mut self, particles: &dyn Particles, columns: &SizeAttributes, edge: f64) {
        self.density = density_in_fluid(particles, columns, self, edge);
        let [least, most] = PLAUSIBLE_DENSITIES;
        if let Some(density) = self.density.filter(|density| !(least..most).contains(density)) {
            self.scale_to_fill(density);
        }
    }

    /// Scales the sizes so that a measured density becomes 1.
    fn scale_to_fill(&mut self, density: f64) {
        let scale = cube_root(1.0 / density);
        for size in [&mut self.finest, &mut self.coarsest, &mut self.usual, &mut self.scale] {
            *size *= scale;
        }
        self.density = Some(1.0);
    }

    /// Measures the sizes of particles.
    ///
    /// # Errors
    /// [`SizeFault::NoSize`] if no particle has a valid size.
    pub fn found(
        particles: &dyn Particles,
        columns: &SizeAttributes,
    ) -> Result<FoundSizes, SizeFault> {
        let attribute = particles.attributes()[columns.size].name.clone();
        let census = SizeCounts::of(particles, columns);
        let none = || SizeFault::NoSize { name: attribute.clone() };
        let (finest, quantile) = census.range(OUTLIERS).ok_or_else(none)?;
        let usual = census.median();
        // `coarsest` is limited to `MOST_TIMES` times `finest`. Sizes below the median divided by
        // `MOST_TIMES` are ignored, so that a few tiny particles do not limit the size of most
        // particles.
        let finest = finest.max(census.least_from(usual / MOST_TIMES));
        if quantile < SAME_SIZE * finest {
            let (size, invalid) = (census.median(), census.invalid);
            return Ok(FoundSizes::One { attribute, size, invalid });
        }
        let most = MOST_TIMES * finest;
        let coarsest = census.most().min(most);
        let larger = census.count_above(most);
        let mut sizes = Self {
            attribute,
            meaning: columns.meaning,
            scale: 1.0,
            finest,
            coarsest,
            usual,
            density: None,
            invalid: census.invalid,
            larger,
        };
        sizes.scale_by_density(particles, columns, CELL * quantile);
        sizes.reduce_if_too_dense(particles, columns, quantile);
        Ok(FoundSizes::Several(sizes))
    }
}

/// Counts of particles by size, in eight steps per octave (a factor of two).
struct SizeCounts {
    /// For each step, the number of particles, the smallest size and the largest size.
    steps: HashMap<u64, (u64, f64, f64)>,
    invalid: u64,
}

/// Number of low bits of an f64 that do not affect its step: the mantissa without its three highest
/// bits.
const STEP_BITS: u32 = 49;

impl SizeCounts {
    fn of(particles: &dyn Particles, columns: &SizeAttributes) -> Self {
        let of_chunk = |range: Range<usize>| {
            let mut census = Self { steps: HashMap::new(), invalid: 0 };
            let sizes = columns.read(particles, range.start, range.len());
            // Successive particles often have the same size.
            for sizes in sizes.chunk_by(|a, b| a == b) {
                if sizes[0].is_nan() {
                    census.invalid += sizes.len() as u64;
                } else {
                    let (count, size) = (sizes.len() as u64, sizes[0]);
                    census.add(size.to_bits() >> STEP_BITS, (count, size, size));
                }
            }
            census
        };
        let none = || Self { steps: HashMap::new(), invalid: 0 };
        chunks(particles, of_chunk).reduce(none, |mut all, other| {
            all.invalid += other.invalid;
            other.steps.into_iter().for_each(|(step, found)| all.add(step, found));
            all
        })
    }

    fn add(&mut self, step: u64, (count, least, most): (u64, f64, f64)) {
        let found = self.steps.entry(step).or_insert((0, f64::MAX, 0.0));
        *found = (found.0 + count, found.1.min(least), found.2.max(most));
    }

    fn sorted(&self) -> Vec<(u64, f64, f64)> {
        let mut steps: Vec<_> = self.steps.iter().map(|(step, found)| (*step, *found)).collect();
        steps.sort_unstable_by_key(|(step, _)| *step);
        steps.into_iter().map(|(_, found)| found).collect()
    }

    /// The first step at which the running total of particles reaches `count`.
    fn step_at(
        steps: impl Iterator<Item = (u64, f64, f64)>,
        count: u64,
    ) -> Option<(u64, f64, f64)> {
        let mut before = 0;
        let mut steps = steps;
        steps.find(|(found, ..)| {
            before += found;
            before >= count
        })
    }

    /// The smallest and the largest size, apart from the fraction `outliers` at each end.
    fn range(&self, outliers: f64) -> Option<(f64, f64)> {
        let steps = self.sorted();
        let all: u64 = steps.iter().map(|(count, ..)| count).sum();
        let outliers = ((all as f64 * outliers) as u64).max(1);
        let least = Self::step_at(steps.iter().copied(), outliers)?.1;
        let most = Self::step_at(steps.iter().rev().copied(), outliers)?.2;
        Some((least, most))
    }

    fn most(&self) -> f64 {
        self.steps.values().map(|&(_, _, most)| most).fold(0.0, f64::max)
    }

    /// The median size.
    fn median(&self) -> f64 {
        let steps = self.sorted();
        let all: u64 = steps.iter().map(|(count, ..)| count).sum();
        Self::step_at(steps.into_iter(), all.div_ceil(2)).map_or(0.0, |(_, least, _)| least)
    }

    /// The smallest size in the steps whose sizes are all at least `size`.
    fn least_from(&self, size: f64) -> f64 {
        let least = self.steps.values().map(|&(_, least, _)| least);
        least.filter(|&least| least >= size).fold(f64::MAX, f64::min)
    }

    /// Number of particles in the steps whose sizes all exceed `size`.
    fn count_above(&self, size: f64) -> u64 {
        self.steps.values().filter(|&&(_, least, _)| least > size).map(|&(count, ..)| count).sum()
    }
}

/// The volume of the particles per unit volume deep in the fluid: the median over the cells of edge
/// `edge` that are surrounded by cells with particles. Returns `None` if there are too few such
/// cells.
fn density_in_fluid(
    particles: &dyn Particles,
    columns: &SizeAttributes,
    sizes: &Sizes,
    edge: f64,
) -> Option<f64> {
    /// Number of fixed-point steps in the volume of the largest particle. Fixed-point sums do not
    /// depend on the order of the particles.
    const STEPS: f64 = (1_u64 << 40) as f64;
    let largest = sizes.coarsest;
    let of_chunk = |chunk: Vec<([f64; 3], f64)>| {
        let mut cells: HashMap<[i64; 3], u128> = HashMap::new();
        for (position, size) in chunk {
            let cell = position.map(|x| (x / edge).floor());
            if !cell.iter().all(|x| x.abs() < 1e15) {
                continue;
            }
            let size = size / largest;
            *cells.entry(cell.map(|x| x as i64)).or_default() +=
                (size * size * size * STEPS).round() as u128;
        }
        cells
    };
    let chunks = sizes.finite_chunks(particles, columns);
    let cells = chunks.map(of_chunk).reduce(HashMap::new, |mut all, other| {
        for (cell, volume) in other {
            *all.entry(cell).or_default() += volume;
        }
        all
    });
    let is_inside = |cell: &[i64; 3]| {
        (0..27).all(|i| {
            let near = [0, 1, 2].map(|axis| cell[axis] + i / 3_i64.pow(axis as u32) % 3 - 1);
            cells.contains_key(&near)
        })
    };
    let mut inside: Vec<u128> =
        cells.iter().filter(|(cell, _)| is_inside(cell)).map(|(_, &volume)| volume).collect();
    if inside.len() < LEAST_CELLS {
        return None;
    }
    let middle = inside.len() / 2;
    let volume = *inside.select_nth_unstable(middle).1 as f64 / STEPS;
    Some(volume * (largest / edge).powi(3))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::particles::Cloud;

    fn infos(names: &[&str]) -> Vec<AttributeInfo> {
        names.iter().map(|name| AttributeInfo::new(*name, 1)).collect()
    }

    #[test]
    fn certain_sizes_are_recognised_but_other_attributes_must_be_named() {
        let usual = |names: &[&str]| {
            SizeChoice::Usual.columns(&infos(names)).unwrap().map(|columns| columns.size)
        };
        assert_eq!(usual(&["age", "pscale"]), Some(1));
        assert_eq!(usual(&["Radius"]), Some(0));
        assert_eq!(usual(&["h", "mass", "density", "volume"]), None);
        assert_eq!(usual(&["Density", "Masses", "spacing"]), Some(2));
        assert_eq!(usual(&["Density", "Masses"]), Some(1));
        assert_eq!(usual(&["rho", "Masses"]), None);
        assert_eq!(usual(&["Masses", "SmoothingLengths", "Densities"]), Some(0));
        assert_eq!(usual(&["SmoothingLengths"]), None);
        let initial = infos(&["Masses", "SmoothingLengths"]);
        let lengths = SizeChoice::Usual.columns(&initial).unwrap().unwrap();
        assert_eq!((lengths.size, lengths.if_masses_differ), (1, Some(0)));
        let one = SizeChoice::OneFor("method");
        assert_eq!(one.columns(&infos(&["Density", "Masses", "spacing"])).unwrap(), None);
        assert!(one.columns(&infos(&["radius"])).unwrap().is_some());
        let named = |name: &str, names: &[&str]| SizeAttributes::named(name, &infos(names));
        let mass = named("Masses", &["Masses", "Densities"]).unwrap();
        assert_eq!((mass.meaning, mass.density), (Meaning::Mass, Some(1)));
        assert!(matches!(named("mass", &["mass", "h"]), Err(SizeFault::NoDensity { .. })));
        assert!(matches!(named("radius", &["h"]), Err(SizeFault::NoAttribute { .. })));
        assert_eq!(named("volume", &["volume"]).unwrap().meaning, Meaning::Volume);
    }

    #[test]
    fn invalid_volumes_have_no_cube_root() {
        assert!((cube_root(27.0) - 3.0).abs() < 1e-14);
        assert!([0.0, -1.0, f64::NAN, f64::INFINITY].iter().all(|&x| cube_root(x).is_nan()));
    }

    /// Two cubes of particles side by side, with spacings 1 and 2.
    fn two_cubes() -> (Vec<[f64; 3]>, Vec<f32>) {
        let cube = |first: f64, spacing: f64, count: i32| {
            let at = move |i: i32| (f64::from(i) + 0.5) * spacing;
            (0..count.pow(3)).map(move |i| {
                [first + at(i % count), at(i / count % count), at(i / (count * count))]
            })
        };
        let positions: Vec<_> = cube(0.0, 1.0, 40).chain(cube(40.0, 2.0, 20)).collect();
        let radii = positions.iter().map(|p| if p[0] < 40.0 { 0.5 } else { 1.0 }).collect();
        (positions, radii)
    }

    fn several(particles: &dyn Particles, columns: &SizeAttributes) -> Sizes {
        match Sizes::found(particles, columns) {
            Ok(FoundSizes::Several(sizes)) => sizes,
            other => panic!("several sizes: {other:?}"),
        }
    }

    #[test]
    fn sizes_and_density_are_found_for_any_meaning_of_the_radius() {
        let (positions, radii) = two_cubes();
        for times in [1.0_f32, 1.25, 0.5] {
            let radii: Vec<f32> = radii.iter().map(|radius| radius * times).collect();
            let cloud = Cloud::new(&positions).with("radius", &radii);
            let columns = SizeChoice::Usual.columns(cloud.attributes()).unwrap().unwrap();
            let sizes = several(&cloud, &columns);
            assert!((sizes.finest - 1.0).abs() < 1e-6, "{times}: {sizes:?}");
            assert!((sizes.coarsest - 2.0).abs() < 1e-6, "{times}: {sizes:?}");
            assert!((sizes.density.unwrap() - 1.0).abs() < 1e-6, "{times}: {sizes:?}");
        }
    }

    #[test]
    fn smoothing_lengths_are_sizes_only_if_masses_differ() {
        let (positions, radii) = two_cubes();
        let lengths: Vec<f32> = radii.iter().map(|radius| 2.0 * 2.3 * radius).collect();
        let masses: Vec<f32> = radii.iter().map(|radius| radius.powi(3)).collect();
        let equal = vec![1.0; masses.len()];
        for (masses, differ) in [(masses, true), (equal, false)] {
            let cloud =
                Cloud::new(&positions).with("Masses", &masses).with("SmoothingLength", &lengths);
            let columns = SizeChoice::Usual.columns(cloud.attributes()).unwrap().unwrap();
            assert_eq!(columns.are_sizes(&cloud), differ);
            let mut sizes = several(&cloud, &columns);
            sizes.scale_by_spacing(&cloud, &columns, 2.0);
            assert!((sizes.finest - 1.0).abs() < 0.05, "{sizes:?}");
        }
    }

    #[test]
    fn too_large_sizes_are_reduced_in_a_body_of_a_few_cells() {
        let near = |i: usize, spacing: f64| (i as f64 + 0.5) * spacing;
        let cube = |first: f64, spacing: f64, count: usize| {
            let at = move |i: usize, a: u32| near(i / count.pow(a) % count, spacing);
            (0..count.pow(3)).map(move |i| [first + at(i, 0), at(i, 1), at(i, 2)])
        };
        let positions: Vec<_> = cube(0.0, 1.0, 16).chain(cube(16.0, 2.0, 8)).collect();
        for times in [1.0, 1.2, 1.3, 1.4, 1.5, 1.6, 2.0, 3.0] {
            let size = |spacing: f32| spacing * times;
            let lengths: Vec<f32> =
                (0..positions.len()).map(|i| size(if i < 4096 { 1.0 } else { 2.0 })).collect();
            let cloud = Cloud::new(&positions).with("h", &lengths);
            let columns = SizeAttributes::named("h", cloud.attributes()).unwrap();
            let mut sizes = several(&cloud, &columns);
            sizes.reduce_if_too_dense(&cloud, &columns, 2.0);
            let (finest, coarsest) = (sizes.finest, sizes.coarsest);
            assert!((0.9..1.12).contains(&finest), "{times}: {finest}");
            assert!((coarsest / finest - 2.0).abs() < 1e-6, "{times}: {coarsest}");
        }
    }

    #[test]
    fn one_tiny_particle_does_not_limit_the_sizes_of_the_others() {
        let positions: Vec<_> = (0..1000).map(|i| [f64::from(i), 0.0, 0.0]).collect();
        let mut radii: Vec<f32> = (0..1000).map(|i| if i < 900 { 0.5 } else { 1.0 }).collect();
        radii[0] = 1e-20;
        let cloud = Cloud::new(&positions).with("radius", &radii);
        let columns = SizeChoice::Usual.columns(cloud.attributes()).unwrap().unwrap();
        let sizes = several(&cloud, &columns);
        assert_eq!((sizes.finest, sizes.usual), (1.0, 1.0));
        assert_eq!((sizes.coarsest, sizes.larger), (2.0, 0));
    }

    #[test]
    fn invalid_sizes_are_counted_and_a_single_size_is_ignored() {
        let (positions, mut radii) = two_cubes();
        (radii[0], radii[1], radii[2], radii[3]) = (0.0, f32::NAN, -1.0, 1e9);
        let cloud = Cloud::new(&positions).with("radius", &radii);
        let columns = SizeChoice::Usual.columns(cloud.attributes()).unwrap().unwrap();
        let sizes = several(&cloud, &columns);
        assert_eq!((sizes.invalid, sizes.larger, sizes.coarsest), (3, 1, 64.0));
        let mut same = vec![0.5_f32; positions.len()];
        same[7] = -1.0;
        let of_one = Cloud::new(&positions).with("radius", &same);
        let one = FoundSizes::One { attribute: "radius".to_owned(), size: 1.0, invalid: 1 };
        assert_eq!(Sizes::found(&of_one, &columns), Ok(one));
        // Apply the measured sizes to another frame.
        let half = Sizes { coarsest: 0.99, ..sizes };
        assert_eq!(half.strays(&of_one, &columns), StraySizes { invalid: 1, larger: 71_999 });
        let whole = Sizes { coarsest: 1.0, ..half };
        assert_eq!(whole.strays(&of_one, &columns), StraySizes { invalid: 1, larger: 0 });
        let none = vec![f32::NAN; positions.len()];
        let cloud = Cloud::new(&positions).with("radius", &none);
        assert!(matches!(Sizes::found(&cloud, &columns), Err(SizeFault::NoSize { .. })));
    }
}
