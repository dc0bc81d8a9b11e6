//! The source of a frame's spacing, and warnings about the spacing.

use std::fmt;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize, Serializer};

use crate::field::spacing::{Evidence, Neighbours, SpacingEstimate, evidence, survey};
use crate::grid::units::{shown, significant};
use crate::particles::Particles;
use crate::particles::mixture::Mixture;
use crate::particles::sizes::{FoundSizes, Sizes, StraySizes};

/// Serializes a path as it is displayed, because not every path is Unicode.
fn as_text<S: Serializer>(path: &Path, to: S) -> Result<S::Ok, S::Error> {
    to.collect_str(&path.display())
}

/// Source of a spacing.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum SpacingSource {
    /// The caller.
    Given,
    /// The particles' file.
    File,
    /// A scene file next to the particles' file.
    Scene(#[serde(serialize_with = "as_text")] PathBuf),
    /// The smallest size of the particles, from the named attribute.
    Sizes(String),
    /// An estimate from the particles.
    Estimated,
    /// The state file of a simulation.
    State,
    /// A packed frame.
    Packed,
}

impl fmt::Display for SpacingSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Given => f.write_str("as given"),
            Self::File => f.write_str("from the file"),
            Self::Scene(path) => write!(f, "from {}", path.display()),
            Self::Sizes(attribute) => write!(f, "the smallest size, from attribute {attribute}"),
            Self::Estimated => f.write_str("estimated from the particles"),
            Self::State => f.write_str("from the state file"),
            Self::Packed => f.write_str("from the packed frame"),
        }
    }
}

/// A reason why a spacing may be wrong.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum SpacingWarning {
    /// The particles have two spacings.
    TwoResolutions {
        /// The spacing of most particles, and the spacing of the others.
        spacings: [f64; 2],
        /// The spacing that is used for all particles.
        used: f64,
    },
    /// The given spacing contradicts the particles.
    Contradicted {
        /// The spacing that was given.
        given: f64,
        /// The source of the given spacing.
        source: SpacingSource,
        /// The estimated spacing of the particles.
        found: f64,
        /// The likely mistake.
        mistake: Option<SpacingMistake>,
        /// Whether the particles may be spray or filaments. In these, particles are farther apart
        /// than the spacing, so a small given spacing can be right.
        spray: bool,
    },
    /// The fluid is too thin for a reliable estimate.
    Thin {
        /// The spacing that is used, from the nearest neighbours.
        used: f64,
        /// The spacing from the density, if it can be measured.
        counted: Option<f64>,
        /// The median distance to the nearest neighbour.
        nearest: f64,
    },
    /// The particles are at random positions, like spray and unlike fluid.
    Random {
        /// The spacing that is used: the mean distance between particles.
        used: f64,
    },
    /// Some particles surround the others, as a boundary surrounds a fluid.
    Mixed(Mixture),
    /// Some particles have no valid size, or are far larger than the smallest particles.
    Sizes {
        /// The attribute.
        attribute: String,
        /// Number of particles without a valid size.
        invalid: u64,
        /// The size that is used for particles without a valid size.
        usual: f64,
        /// Number of particles whose size exceeds `coarsest`.
        larger: u64,
        /// The largest size that is used.
        coarsest: f64,
    },
    /// All sizes are larger, or all are smaller, than the distances between particles, and the
    /// fluid is too shallow to correct the sizes.
    SizesContradicted {
        /// The attribute.
        attribute: String,
        /// The smallest and the largest size.
        sizes: [f64; 2],
        /// The estimated spacing of the particles, in their finest region if the sizes are too
        /// large, and otherwise in their coarsest region.
        found: f64,
        /// Whether the particles may be spray, whose particles are farther apart than their sizes.
        spray: bool,
    },
    /// The particles of this frame have several sizes, but the calibration frame has only one size.
    MoreSizes {
        /// The attribute.
        attribute: String,
        /// The smallest and the largest size of this frame.
        sizes: [f64; 2],
        /// The size that is used for all particles.
        used: f64,
    },
    /// The single-precision coordinates are too coarse for the spacing.
    SinglePrecision {
        /// The step of the coordinates.
        step: f64,
        /// The spacing that is used.
        spacing: f64,
    },
}

/// A mistake that could explain a wrong spacing.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum SpacingMistake {
    /// The radius of the particles, which is half the spacing, was given as the spacing.
    Radius,
    /// Twice the spacing was given, because the support radius was given as the spacing, or the
    /// spacing was given as the radius.
    Double,
    /// The spacing is in another unit than the positions. The unit of the positions is this many
    /// times the unit of the spacing: 1000 if the spacing is in mm and the positions are in m.
    Unit(f64),
}

/// Minimum ratio of a given spacing to the true spacing that gives no warning.
const TOO_SMALL: f64 = 0.78;
/// Maximum ratio of a given spacing to the true spacing that gives no warning. From [`TOO_SMALL`]
/// to this ratio, the surface is good, and the error of the estimate may explain the difference.
const TOO_LARGE: f64 = 1.36;
/// If the estimate is uncertain, both limits are wider by this factor.
const UNSURE: f64 = 1.1;
/// Minimum number of coordinate steps in a spacing; with fewer steps, rounding moves
/// neighbours too far.
const STEPS: f64 = 4.0;

impl SpacingMistake {
    fn of(ratio: f64) -> Option<Self> {
        let near = |factor: f64, by: f64| (1.0 / by..by).contains(&(ratio / factor));
        if near(0.5, 1.17) {
            return Some(Self::Radius);
        }
        if near(2.0, 1.17) {
            return Some(Self::Double);
        }
        let units = [10.0, 100.0, 1000.0, 0.1, 0.01, 0.001];
        units.into_iter().find(|&unit| near(unit, 1.25)).map(Self::Unit)
    }
}

/// Whether the neighbours of particles do not confirm a given spacing, so that all evidence should
/// be gathered.
pub(super) fn is_suspicious(neighbours: &Neighbours, given: f64) -> bool {
    let measured =
        neighbours.measured().map(|(measured, _)| measured).or_else(|| neighbours.suggested());
    !measured.is_some_and(|measured| (TOO_SMALL..TOO_LARGE).contains(&(given / measured)))
}

impl SpacingWarning {
    /// The warnings about a spacing that is known from another frame. If the neighbours of
    /// `particles` do not confirm the spacing, the particles are usually read three times.
    pub(crate) fn of_known(
        given: f64,
        source: &SpacingSource,
        particles: &dyn Particles,
    ) -> Vec<Self> {
        let Some(surveyed) = survey(particles, given) else { return Vec::new() };
        if !is_suspicious(&surveyed.neighbours, given) {
            return Vec::new();
        }
        let evidence = evidence(particles);
        evidence.map_or(Vec::new(), |evidence| {
            Self::of_given(given, source, &surveyed.neighbours, &evidence)
        })
    }

    /// The warnings about a given spacing, from the neighbours at the scale of this spacing and
    /// from the evidence of all particles.
    pub(super) fn of_given(
        given: f64,
        source: &SpacingSource,
        at_scale: &Neighbours,
        evidence: &Evidence,
    ) -> Vec<Self> {
        let mut warnings = Vec::new();
        match evidence.estimate() {
            Ok(SpacingEstimate { two: Some(spacings), .. }) => {
                if !spacings.iter().any(|found| (TOO_SMALL..TOO_LARGE).contains(&(given / found))) {
                    warnings.push(Self::contradicted(given, source, spacings[0], false));
                }
                warnings.push(Self::TwoResolutions { spacings, used: given });
            }
            Ok(SpacingEstimate { spacing, thin, .. }) => {
                let tolerance = if thin { UNSURE } else { 1.0 };
                let too_small =
                    given < TOO_SMALL / tolerance * spacing && !at_scale.has_solid(given);
                if too_small || given > TOO_LARGE * tolerance * spacing {
                    warnings.push(Self::contradicted(
                        given,
                        source,
                        spacing,
                        evidence.neighbours.may_be_spray(),
                    ));
                }
            }
            Err(_) => {}
        }
        warnings.extend(Self::of_step(evidence, given));
        warnings
    }

    /// The warning about the spacing of a packed frame, from the spacing `found` that its samples
    /// suggest. Samples overestimate the spacing of thin fluid, so there is no warning if `found`
    /// is less than 1.75 times the given spacing.
    pub(super) fn of_packed(given: f64, found: f64) -> Option<Self> {
        const THIN: f64 = 1.75;
        let doubtful = !(1.0 / TOO_LARGE..THIN).contains(&(found / given));
        doubtful.then(|| Self::contradicted(given, &SpacingSource::Packed, found, true))
    }

    fn contradicted(given: f64, source: &SpacingSource, found: f64, spray: bool) -> Self {
        Self::Contradicted {
            given,
            source: source.clone(),
            found,
            mistake: SpacingMistake::of(given / found),
            spray: spray && given < found,
        }
    }

    /// The warning about sizes, if some are invalid or too large.
    pub(super) fn of_sizes(sizes: &FoundSizes) -> Option<Self> {
        match sizes {
            FoundSizes::Several(sizes) => {
                let &Sizes { invalid, larger, .. } = sizes;
                Self::of_strays(sizes, StraySizes { invalid, larger })
            }
            &FoundSizes::One { ref attribute, size, invalid } => {
                Self::replaced(attribute, [size; 2], StraySizes { invalid, larger: 0 })
            }
        }
    }

    /// The warning about sizes that the density could not confirm, if the neighbours of particles
    /// contradict the sizes.
    pub(super) fn of_unmeasured_sizes(sizes: &Sizes, evidence: &Evidence) -> Option<Self> {
        let [least, most] = evidence.estimate().ok()?.extremes();
        let contradicted = |found: f64, spray: bool| Self::SizesContradicted {
            attribute: sizes.attribute.clone(),
            sizes: [sizes.finest, sizes.coarsest],
            found,
            spray,
        };
        if sizes.finest > TOO_LARGE * UNSURE * least {
            Some(contradicted(least, false))
        } else if sizes.coarsest < TOO_SMALL / UNSURE * most {
            Some(contradicted(most, evidence.neighbours.may_be_spray()))
        } else {
            None
        }
    }

    /// The warning about particles whose sizes are replaced, if there are any.
    pub(super) fn of_strays(sizes: &Sizes, strays: StraySizes) -> Option<Self> {
        Self::replaced(&sizes.attribute, [sizes.usual, sizes.coarsest], strays)
    }

    fn replaced(
        attribute: &str,
        [usual, coarsest]: [f64; 2],
        StraySizes { invalid, larger }: StraySizes,
    ) -> Option<Self> {
        (invalid + larger > 0).then(|| Self::Sizes {
            attribute: attribute.into(),
            invalid,
            usual,
            larger,
            coarsest,
        })
    }

    /// The warnings about an estimate.
    pub(super) fn of_estimate(estimate: &SpacingEstimate, evidence: &Evidence) -> Vec<Self> {
        let &SpacingEstimate { spacing: used, two, thin } = estimate;
        let mut warnings = Vec::new();
        warnings.extend(two.map(|spacings| Self::TwoResolutions { spacings, used }));
        if thin {
            let nearest = evidence.neighbours.nearest.map_or(used, |nearest| nearest[0]);
            let counted = evidence.counted.map(|counted| counted.mean);
            warnings.push(Self::Thin { used, counted, nearest });
        } else if two.is_none() && evidence.neighbours.is_random() {
            warnings.push(Self::Random { used });
        }
        warnings.extend(Self::of_step(evidence, used));
        warnings
    }

    /// Whether coordinates with this step are too coarse for a spacing.
    pub(super) fn is_coarse(step: f64, spacing: f64) -> bool {
        STEPS * step > spacing
    }

    fn of_step(evidence: &Evidence, spacing: f64) -> Option<Self> {
        let step = evidence.place.step.filter(|&step| Self::is_coarse(step, spacing))?;
        Some(Self::SinglePrecision { step, spacing })
    }
}

impl fmt::Display for SpacingWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let about = |length: f64| significant(length, 3);
        match self {
            Self::TwoResolutions { spacings: [one, other], used } => write!(
                f,
                "the particles have two spacings, {} and {}; meniscus uses {} for all of them",
                shown(*one),
                shown(*other),
                shown(*used)
            ),
            Self::Contradicted { given, source, found, mistake, spray } => {
                let how = if given < found { "small" } else { "large" };
                let (given, found) = (shown(*given), about(*found));
                write!(
                    f,
                    "spacing {given} ({source}) looks too {how}: the particles are about \
                     {found} apart"
                )?;
                match mistake {
                    Some(SpacingMistake::Radius) => write!(f, "; {given} may be their radius")?,
                    Some(SpacingMistake::Double) => {
                        write!(f, "; {given} may be their support radius, or twice the spacing")?;
                    }
                    Some(SpacingMistake::Unit(factor)) => {
                        let times = factor.max(1.0 / factor);
                        write!(
                            f,
                            "; the spacing and the positions may have different units (a factor \
                             of {times})"
                        )?;
                    }
                    None => {}
                }
                if *spray {
                    write!(
                        f,
                        "; for spray and for filaments of single particles, the given spacing can \
                         be right"
                    )?;
                }
                Ok(())
            }
            Self::Mixed(Mixture { attribute, boundary, fluid }) => write!(
                f,
                "the {} particles with {attribute}={} surround the {} particles with \
                 {attribute}={} and may be boundary particles; meniscus meshes both groups as one \
                 fluid",
                boundary.1, boundary.0, fluid.1, fluid.0
            ),
            Self::Thin { used, counted, nearest } => {
                let used = about(*used);
                match counted {
                    Some(counted) => write!(
                        f,
                        "the fluid is thin, so its spacing is uncertain: nearest neighbours \
                         suggest {used}, and the density suggests {}; meniscus uses {used}",
                        about(*counted)
                    ),
                    None => write!(
                        f,
                        "few particles have neighbours on all sides, so the spacing is uncertain: \
                         nearest neighbours are {} apart; meniscus uses a spacing of {used}",
                        about(*nearest)
                    ),
                }
            }
            Self::Random { used } => write!(
                f,
                "the particles are at random positions, as in spray, so the spacing {} is \
                 estimated from their density alone; the true spacing may be smaller",
                about(*used)
            ),
            Self::Sizes { attribute, invalid, usual, larger, coarsest } => {
                if *invalid > 0 {
                    let (have, get) = match invalid {
                        1 => ("particle has", "gets"),
                        _ => ("particles have", "get"),
                    };
                    write!(
                        f,
                        "{invalid} {have} no positive, finite {attribute} and {get} the median \
                         size {}",
                        about(*usual)
                    )?;
                }
                if *larger > 0 {
                    let and = if *invalid > 0 { "; " } else { "" };
                    let (exceed, get) = match larger {
                        1 => ("particle exceeds", "gets"),
                        _ => ("particles exceed", "get"),
                    };
                    write!(
                        f,
                        "{and}{larger} {exceed} 64 times the smallest size and {get} size \
                         {coarsest}",
                        coarsest = about(*coarsest)
                    )?;
                }
                Ok(())
            }
            Self::SizesContradicted { attribute, sizes: [least, most], found, spray } => {
                let how = if found < least { "large" } else { "small" };
                write!(
                    f,
                    "the sizes from {} to {} (attribute {attribute}) look too {how}: the particles \
                     are about {} apart",
                    about(*least),
                    about(*most),
                    about(*found)
                )?;
                if *spray {
                    write!(f, "; in spray, whose particles are far apart, the sizes can be right")?;
                }
                Ok(())
            }
            Self::MoreSizes { attribute, sizes: [least, most], used } => write!(
                f,
                "in this frame, the attribute {attribute} gives the particles sizes from {} to {}, \
                 but in the calibration frame, all particles have one size; meniscus uses size {} \
                 for all particles of this frame",
                about(*least),
                about(*most),
                about(*used)
            ),
            Self::SinglePrecision { step, spacing } => write!(
                f,
                "the particles are so far from the origin that single precision rounds their \
                 coordinates to multiples of {}, which is more than a quarter of the spacing {}",
                about(*step),
                shown(*spacing)
            ),
        }
    }
}
