//! Source of a frame's spacing, and doubts about it.

use std::fmt;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize, Serializer};

use crate::field::spacing::{Estimate, Evidence, Neighbours, evidence, look_at};
use crate::grid::units::{shown, significant};
use crate::particles::Particles;
use crate::particles::mixture::Mixture;
use crate::particles::sizes::Sizes;

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
    /// A scene file beside it.
    Scene(#[serde(serialize_with = "as_text")] PathBuf),
    /// The smallest size of the particles, by an attribute.
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
pub enum Doubt {
    /// The particles have two spacings.
    TwoResolutions {
        /// The spacing of most particles, and that of the others.
        spacings: [f64; 2],
        /// The spacing that is used for all.
        taken: f64,
    },
    /// The given spacing contradicts the particles.
    Contradicted {
        /// The spacing that was given.
        said: f64,
        /// The source of the given spacing.
        source: SpacingSource,
        /// The estimated spacing of the particles.
        found: f64,
        /// The likely mistake.
        mistake: Option<Mistake>,
        /// Whether the particles may be spray or threads, which are farther apart than the spacing.
        spray: bool,
    },
    /// The fluid is too thin for a reliable estimate.
    Thin {
        /// The spacing that is used, from the nearest neighbours.
        taken: f64,
        /// The spacing from the density, if it can be measured.
        counted: Option<f64>,
        /// The median distance to the nearest neighbour.
        nearest: f64,
    },
    /// The particles are at random positions, like spray and unlike fluid.
    Random {
        /// The spacing that is used: their mean distance.
        taken: f64,
    },
    /// Some particles surround the others, as a boundary surrounds a fluid.
    Mixed(Mixture),
    /// Some particles have no valid size, or are far larger than the smallest.
    Sizes {
        /// The attribute.
        attribute: String,
        /// Number of particles without a valid size.
        invalid: u64,
        /// The size that is used for them.
        usual: f64,
        /// Number of particles larger than the largest size that is used.
        larger: u64,
        /// The largest size that is used.
        coarsest: f64,
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
pub enum Mistake {
    /// The radius of the particles was given: half the spacing.
    Radius,
    /// Twice the spacing was given: a support radius, or the spacing taken for a radius.
    Double,
    /// The length is in another unit, which is this multiple of the positions' unit.
    Unit(f64),
}

/// Minimum ratio of a given to the true spacing without a warning.
const TOO_SMALL: f64 = 0.78;
/// Maximum ratio. In between the surface is good, and estimates can be wrong by as much.
const TOO_LARGE: f64 = 1.36;
/// Additional factor for an uncertain estimate.
const UNSURE: f64 = 1.1;
/// Minimum number of coordinate steps in a spacing; with fewer, neighbours are misplaced.
const STEPS: f64 = 4.0;

impl Mistake {
    fn of(said_over_found: f64) -> Option<Self> {
        let near = |factor: f64, by: f64| (1.0 / by..by).contains(&(said_over_found / factor));
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

/// Whether the neighbours of particles do not bear out a spacing that was given: then all that the
/// particles say is worth a look.
pub(super) fn is_suspicious(neighbours: &Neighbours, said: f64) -> bool {
    let measured =
        neighbours.measured().map(|(measured, _)| measured).or_else(|| neighbours.suggested());
    !measured.is_some_and(|measured| (TOO_SMALL..TOO_LARGE).contains(&(said / measured)))
}

impl Doubt {
    /// The doubts about a spacing that other particles have, which are read up to three times where
    /// there are any.
    pub(crate) fn of_known(
        said: f64,
        source: &SpacingSource,
        particles: &(impl Particles + ?Sized),
    ) -> Vec<Self> {
        let Some(look) = look_at(particles, said) else { return Vec::new() };
        if !is_suspicious(&look.neighbours, said) {
            return Vec::new();
        }
        let evidence = evidence(particles);
        evidence.map_or(Vec::new(), |all| Self::of_given(said, source, &look.neighbours, &all))
    }

    /// The doubts about a spacing that was given, by neighbours looked for at its scale and by all
    /// that the particles say.
    pub(super) fn of_given(
        said: f64,
        source: &SpacingSource,
        at_scale: &Neighbours,
        evidence: &Evidence,
    ) -> Vec<Self> {
        let mut doubts = Vec::new();
        match evidence.estimate() {
            Ok(Estimate { two: Some(spacings), .. }) => {
                if !spacings.iter().any(|found| (TOO_SMALL..TOO_LARGE).contains(&(said / found))) {
                    doubts.push(Self::contradicted(said, source, spacings[0], false));
                }
                doubts.push(Self::TwoResolutions { spacings, taken: said });
            }
            Ok(Estimate { spacing, thin, .. }) => {
                let unsure = if thin { UNSURE } else { 1.0 };
                let too_small = said < TOO_SMALL / unsure * spacing && !at_scale.has_solid(said);
                if too_small || said > TOO_LARGE * unsure * spacing {
                    doubts.push(Self::contradicted(
                        said,
                        source,
                        spacing,
                        evidence.neighbours.may_be_spray(),
                    ));
                }
            }
            Err(_) => {}
        }
        doubts.extend(Self::of_step(evidence, said));
        doubts
    }

    /// The doubt about the spacing of a packed frame, by what its samples show: of thin fluid that
    /// is too large.
    pub(super) fn of_packed(said: f64, found: f64) -> Option<Self> {
        const THIN: f64 = 1.75;
        let doubtful = !(1.0 / TOO_LARGE..THIN).contains(&(found / said));
        doubtful.then(|| Self::contradicted(said, &SpacingSource::Packed, found, true))
    }

    fn contradicted(said: f64, source: &SpacingSource, found: f64, spray: bool) -> Self {
        Self::Contradicted {
            said,
            source: source.clone(),
            found,
            mistake: Mistake::of(said / found),
            spray: spray && said < found,
        }
    }

    /// The doubt about sizes, if some are not valid.
    pub(super) fn of_sizes(sizes: &Sizes) -> Option<Self> {
        let &Sizes { invalid, usual, larger, coarsest, .. } = sizes;
        let attribute = sizes.attribute.clone();
        (invalid + larger > 0).then_some(Self::Sizes {
            attribute,
            invalid,
            usual,
            larger,
            coarsest,
        })
    }

    /// The doubts about an estimate.
    pub(super) fn of_estimate(estimate: &Estimate, evidence: &Evidence) -> Vec<Self> {
        let &Estimate { spacing: taken, two, thin } = estimate;
        let mut doubts = Vec::new();
        doubts.extend(two.map(|spacings| Self::TwoResolutions { spacings, taken }));
        if thin {
            let nearest = evidence.neighbours.nearest.map_or(taken, |nearest| nearest[0]);
            let counted = evidence.counted.map(|counted| counted.mean);
            doubts.push(Self::Thin { taken, counted, nearest });
        } else if two.is_none() && evidence.neighbours.is_random() {
            doubts.push(Self::Random { taken });
        }
        doubts.extend(Self::of_step(evidence, taken));
        doubts
    }

    /// Whether coordinates that move in such steps are too coarse for a spacing.
    pub(super) fn is_coarse(step: f64, spacing: f64) -> bool {
        STEPS * step > spacing
    }

    fn of_step(evidence: &Evidence, spacing: f64) -> Option<Self> {
        let step = evidence.place.step.filter(|&step| Self::is_coarse(step, spacing))?;
        Some(Self::SinglePrecision { step, spacing })
    }
}

impl fmt::Display for Doubt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let about = |length: f64| significant(length, 3);
        match self {
            Self::TwoResolutions { spacings: [one, other], taken } => write!(
                f,
                "the particles have two spacings, {} and {}; {} is used for all",
                shown(*one),
                shown(*other),
                shown(*taken)
            ),
            Self::Contradicted { said, source, found, mistake, spray } => {
                let how = if said < found { "small" } else { "large" };
                let (said, found) = (shown(*said), about(*found));
                write!(
                    f,
                    "spacing {said} ({source}) looks too {how}: the particles are about {found} apart"
                )?;
                match mistake {
                    Some(Mistake::Radius) => write!(f, "; {said} may be their radius")?,
                    Some(Mistake::Double) => {
                        write!(f, "; {said} may be their support radius, or twice the spacing")?;
                    }
                    Some(Mistake::Unit(factor)) if *factor < 1.0 => {
                        write!(
                            f,
                            "; it may be in a unit {} times larger than the positions'",
                            1.0 / factor
                        )?;
                    }
                    Some(Mistake::Unit(factor)) => {
                        write!(
                            f,
                            "; it may be in a unit {factor} times smaller than the positions'"
                        )?;
                    }
                    None => {}
                }
                if *spray {
                    write!(f, "; it can be right for spray, or threads of single particles")?;
                }
                Ok(())
            }
            Self::Mixed(Mixture { attribute, boundary, fluid }) => write!(
                f,
                "the {} particles with {attribute}={} surround the {} with {attribute}={}, as a \
                 boundary surrounds a fluid; all are meshed together",
                boundary.1, boundary.0, fluid.1, fluid.0
            ),
            Self::Thin { taken, counted, nearest } => {
                let taken = about(*taken);
                match counted {
                    Some(counted) => write!(
                        f,
                        "the fluid is thin, so its spacing is uncertain: {taken} by nearest \
                         neighbours, {} by density; {taken} is used",
                        about(*counted)
                    ),
                    None => write!(
                        f,
                        "few particles are surrounded by others, so their spacing is uncertain: \
                         {taken} is used; nearest neighbours are {} apart",
                        about(*nearest)
                    ),
                }
            }
            Self::Random { taken } => write!(
                f,
                "the particles are at random positions, like spray: their mean distance {} is \
                 used as the spacing, and may be larger than that of the fluid",
                about(*taken)
            ),
            Self::Sizes { attribute, invalid, usual, larger, coarsest } => {
                if *invalid > 0 {
                    write!(
                        f,
                        "{invalid} particles have no positive, finite {attribute}: they count as \
                         size {}",
                        about(*usual)
                    )?;
                }
                if *larger > 0 {
                    let and = if *invalid > 0 { "; " } else { "" };
                    write!(
                        f,
                        "{and}{larger} particles are larger than 64 times the smallest: they \
                         count as size {}",
                        about(*coarsest)
                    )?;
                }
                Ok(())
            }
            Self::SinglePrecision { step, spacing } => write!(
                f,
                "single-precision coordinates so far from the origin have steps of {}, more \
                 than a quarter of the spacing {}",
                about(*step),
                shown(*spacing)
            ),
        }
    }
}
