//! Warnings about a surface, or about the request for it.

use std::fmt;
use std::path::PathBuf;

use crate::brick::FrameFacts;
use crate::field::calibration::{MeasuredCalibration, ON_CORNERS, Plateau};
use crate::field::indicator::{IndicatorKind, SampledDif};
use crate::field::walls::{BeyondWall, GapAtWall};
use crate::frame::{CoincidentParticles, Engine, FrameError, Shortfall, no_centre};
use crate::grid::units::{FULL, Isovalue, shown, significant};
use crate::io::UnreadPart;
use crate::io::output::MeshFormat;
use crate::particles::AttributeInfo;
use crate::particles::alike::{AlikeParticles, AlphaChange};
use crate::particles::kind::SettledKind;
use crate::particles::selection::SelectionFault;
use crate::surface::simplify::TooSmall;

use super::{Cells, SpacingWarning};

/// The density above which there is a warning, relative to the density that the spacing implies.
/// Particles at half the spacing have a relative density of 8.
const CROWDED: f64 = 8.0;
/// The width of cells, in spacings, above which there is a warning. In wider cells, a block of 20^3
/// particles gets 1.15 to 3.3 times its volume, or loses most of it.
const WIDEST: f64 = 2.001;

/// Maximum number of lost or coincident particles that gives no warning.
const FEW: u64 = 10;

/// A warning about a surface, or about the request for it.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Warning {
    /// The spacing may be wrong.
    Spacing(SpacingWarning),
    /// Particles are much denser than the spacing allows.
    Crowded {
        /// Lower bound of the particles' density, relative to the density that the spacing implies.
        times: f64,
        /// The spacing.
        spacing: f64,
    },
    /// Cells are wider than two spacings.
    CoarseCells {
        /// Edge of a cell.
        cell_size: f64,
        /// The spacing, or the smallest of several.
        spacing: f64,
    },
    /// Particles have the same position as other particles.
    Coincident {
        /// The number of these particles, and the position with the most particles.
        found: CoincidentParticles,
        /// Number of all particles.
        of: usize,
    },
    /// Some particles lack a value of an attribute.
    MissingValues {
        /// The attribute's name.
        attribute: String,
        /// Number of particles without a value.
        without: usize,
        /// Number of all particles.
        of: usize,
    },
    /// The particles of a frame lack an attribute that the calibration frame has.
    MissingAttribute {
        /// The attribute's name on the mesh.
        attribute: String,
        /// The number of the calibration frame, if frames have numbers.
        calibration_frame: Option<i64>,
    },
    /// The colours of this frame have an alpha component and the colours of other frames do not, or
    /// vice versa.
    Alpha {
        /// The colour.
        attribute: String,
        /// Number of components in this frame.
        own: usize,
        /// Number of components in the other frames, and on the meshes of all frames.
        shared: usize,
    },
    /// The backend failed, and the CPU did its work.
    DeviceFallback(String),
    /// Particles form a lattice on the corners of cells, where the indicator symmetry is almost 0.
    OnCorners {
        /// The mean indicator of full cells.
        mean: f64,
        /// An origin of the grid that avoids this problem.
        origin: [f64; 3],
    },
    /// The given isovalue is above some values of the field deep in the fluid.
    Bubbles {
        /// The isovalue.
        iso: f64,
        /// The lowest value of the field deep in the fluid.
        lowest: f64,
    },
    /// Particles are beyond a wall that was found on other frames.
    BeyondWall(BeyondWall),
    /// The fluid ends just short of a wall of the domain.
    BeforeWall(GapAtWall),
    /// Particles are outside the surface.
    Lost {
        /// Lower bound on the number of missing particles.
        lost: u64,
        /// Number of all particles.
        of: usize,
        /// Whether the indicator is counting or symmetry, whose smoothing can remove the particles.
        /// In this case, smaller cells do not help.
        smoothed: bool,
    },
    /// The surface encloses much less than the particles' volume.
    Shortfall {
        /// The ratio of the two volumes, with the number of particles and the spacing.
        shortfall: Shortfall,
        /// Whether the indicator is cloud.
        clouds: bool,
        /// The number of the calibration frame, if that is another frame.
        calibration_frame: Option<i64>,
    },
    /// Vertices become equal in a format that has no indices.
    Merged {
        /// The number of vertices that become equal.
        vertices: u64,
        /// The format.
        format: MeshFormat,
    },
    /// The format cannot store the attribute's name, or already uses this name.
    Renamed {
        /// The attribute.
        attribute: String,
        /// The name in the file.
        name: String,
        /// The format.
        format: MeshFormat,
    },
    /// The format cannot store the attribute.
    NotStored {
        /// The attribute.
        attribute: String,
        /// Number of components per vertex.
        components: usize,
        /// The format.
        format: MeshFormat,
    },
    /// The format stores coordinates as f32, which is too coarse.
    Coarse {
        /// The format.
        format: MeshFormat,
    },
    /// A solid's triangles face inwards; meniscus treats them as facing outwards.
    InvertedSolid(PathBuf),
    /// A solid is thinner than a cell, and may have holes.
    ThinSolid {
        /// The mesh file of the solid.
        path: PathBuf,
        /// Approximate thickness of the solid.
        thickness: f64,
        /// Edge of a cell.
        cell_size: f64,
    },
    /// A part of the input is not read.
    LeftOut(UnreadPart),
    /// No particle of the frame satisfies the conditions, so its mesh is empty.
    NoneSelected(SelectionFault),
    /// A frame of a simulation has no surface, so its mesh is empty.
    Empty {
        /// The cause.
        why: EmptyReason,
        /// Whether the indicator is cloud.
        clouds: bool,
        /// The number of the calibration frame, if that is another frame.
        calibration_frame: Option<i64>,
    },
}

/// Causes of an empty mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum EmptyReason {
    /// The field is nowhere above the isovalue.
    Field,
    /// The surface encloses no cell centre.
    Distances {
        /// Whether the fluid ends at solids, which may cover all of it.
        at_solids: bool,
    },
    /// All components are smaller than the limits.
    TooSmall(TooSmall),
}

impl EmptyReason {
    /// The cause, if `fault` means that the mesh is empty.
    pub(crate) fn of(fault: &FrameError) -> Option<Self> {
        match *fault {
            FrameError::NoSurface { .. } => Some(Self::Field),
            FrameError::NoKernelSurface => Some(Self::Distances { at_solids: false }),
            FrameError::NoDistanceSurface { at_solids } => Some(Self::Distances { at_solids }),
            FrameError::NothingLeft(all) => Some(Self::TooSmall(all)),
            _ => None,
        }
    }
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Spacing(warning) => warning.fmt(f),
            Self::Crowded { times, spacing } => {
                write!(
                    f,
                    "particles are {times:.1} times denser than spacing {} allows; check the \
                     spacing",
                    shown(*spacing)
                )
            }
            Self::CoarseCells { cell_size, spacing } => write!(
                f,
                "cells are {} spacings wide; the volume of the surface is wrong if cells are wider \
                 than 2 spacings; use smaller cells",
                significant(cell_size / spacing, 3)
            ),
            Self::Coincident { found, of } => {
                let CoincidentParticles { particles, most, at, alone, .. } = found;
                let at = at.map(|c| significant(c, 6)).join(", ");
                write!(
                    f,
                    "{particles} of {of} particles have the same position as an earlier particle"
                )?;
                match (*alone, *most) {
                    (true, most) => {
                        write!(
                            f,
                            "; {most} particles are at ({at}), far from all others, and may be \
                             placeholders"
                        )
                    }
                    (false, most) if most > 2 => {
                        write!(
                            f,
                            "; {most} particles are at ({at}); the input may contain duplicates"
                        )
                    }
                    (false, _) => {
                        write!(f, ", for example at ({at}); the input may contain duplicates")
                    }
                }
            }
            Self::MissingValues { attribute, without, of } if without >= of => write!(
                f,
                "{attribute} is NaN, infinite or too large for a 32-bit float in all {of} \
                 particles; it is 0 at all vertices"
            ),
            Self::MissingValues { attribute, without, of } => {
                let them = if *without == 1 { "it" } else { "them" };
                write!(
                    f,
                    "{attribute} is NaN, infinite or too large for a 32-bit float in {without} of \
                     {of} particles; vertices near {them} take the values of other particles, or 0 \
                     if no other particle is near"
                )
            }
            Self::MissingAttribute { attribute, calibration_frame } => {
                let known = calibration_frame.map_or_else(
                    || "the calibration frame".to_owned(),
                    |frame| format!("frame {frame} (the calibration frame)"),
                );
                let is_velocity = attribute == "velocity";
                let blur = if is_velocity { " and has no motion blur" } else { "" };
                write!(
                    f,
                    "this frame has no attribute {attribute:?}, but {known} has it; the mesh \
                     therefore lacks it{blur}"
                )
            }
            Self::Alpha { attribute, own, shared } => {
                let what =
                    if own > shared { "leaves out its alpha component" } else { "makes it opaque" };
                write!(
                    f,
                    "the colour \"{attribute}\" has {own} components in this frame, but {shared} \
                     in other frames; meniscus {what}"
                )
            }
            Self::DeviceFallback(what) => f.write_str(what),
            Self::OnCorners { origin, .. } => write!(
                f,
                "the particles lie on the corners of cells, where the symmetry indicator is almost \
                 0, so the surface is inaccurate; move the grid's origin to {}",
                origin.map(|x| x.to_string()).join(",")
            ),
            Self::Bubbles { iso, lowest } => write!(
                f,
                "isovalue {} is too high: inside the fluid, the field is as low as {lowest}, so \
                 the mesh can contain false bubbles; use an isovalue below {lowest}",
                significant(*iso, 4),
                lowest = significant(*lowest, 4)
            ),
            Self::BeforeWall(GapAtWall { axis, wall, end }) => write!(
                f,
                "the fluid ends at {axis} = {}, just short of the wall at {axis} = {}, so the \
                 surface there can be ragged, and shallow fluid can be too thick; move the wall to \
                 where the fluid ends, or leave the side open",
                significant(*end, 6),
                significant(*wall, 6)
            ),
            Self::BeyondWall(BeyondWall { axis, wall, reach, moved }) => {
                let [wall, reach] = [wall, reach].map(|at| significant(*at, 6));
                let what = match moved {
                    Some(to) => {
                        format!("meniscus moves the wall to {axis} = {}", significant(*to, 6))
                    }
                    None => "meniscus leaves that side of the tank open".to_owned(),
                };
                write!(
                    f,
                    "particles reach {axis} = {reach}, beyond the wall that was found at {axis} = \
                     {wall}; in this frame, {what}"
                )
            }
            Self::Lost { lost, of, smoothed } => {
                let remedy = if *smoothed {
                    "the indicator cloud, which keeps drops"
                } else {
                    "smaller cells"
                };
                write!(f, "at least {lost} of {of} particles are outside the surface; use {remedy}")
            }
            Self::Shortfall { shortfall, .. } => shortfall.fmt(f),
            Self::Merged { vertices, format } => {
                let get = if *vertices == 1 { "vertex gets" } else { "vertices get" };
                write!(
                    f,
                    "{vertices} {get} the same position as another vertex, because {format} stores \
                     coordinates as 32-bit floats; use .ply, which can store 64-bit floats"
                )
            }
            Self::Renamed { attribute, name, format } => {
                write!(
                    f,
                    "the attribute \"{attribute}\" is stored as \"{name}\", because {format} \
                     cannot store its name or already uses it"
                )
            }
            Self::NotStored { attribute, components, format } => {
                write!(
                    f,
                    "the attribute \"{attribute}\" was left out: {format} cannot store \
                     {components} numbers per vertex; use .ply instead"
                )
            }
            Self::Coarse { format } => {
                write!(
                    f,
                    "{format} stores coordinates as 32-bit floats, which are too coarse for this \
                     surface; use .ply, which can store 64-bit floats"
                )
            }
            Self::InvertedSolid(path) => write!(
                f,
                "{}: the triangles of the solid face inwards; meniscus treats them as facing \
                 outwards",
                path.display()
            ),
            Self::ThinSolid { path, thickness, cell_size } => write!(
                f,
                "{}: including its offset, the solid is about {} thick, which is less than the \
                 cell size of {}, so fluid may leak through it; use smaller cells, a thicker mesh \
                 or a larger solid-offset",
                path.display(),
                significant(*thickness, 2),
                significant(*cell_size, 3)
            ),
            Self::LeftOut(part) => write!(f, "meniscus left out {part}"),
            Self::NoneSelected(fault) => write!(f, "the mesh is empty: {fault}"),
            Self::Empty { why, .. } => match why {
                EmptyReason::Field => {
                    f.write_str("the mesh is empty: the field is nowhere above the isovalue")
                }
                EmptyReason::Distances { at_solids } => {
                    write!(f, "the mesh is empty: {}", no_centre(*at_solids))
                }
                EmptyReason::TooSmall(all) => {
                    write!(f, "the mesh is empty: {} removed all components", all.limits())
                }
            },
        }
    }
}

/// Warnings about a sampled frame.
pub(crate) fn of_frame(engine: &Engine) -> Vec<Warning> {
    let mut warnings: Vec<_> = engine.warnings().into_iter().map(Warning::DeviceFallback).collect();
    let mean = engine.dif().and_then(mean_symmetry);
    let (facts, coincident) = (engine.facts(), engine.coincident());
    let packed = facts.spacing.zip(engine.spacing_by_samples());
    warnings.extend(
        packed
            .and_then(|(given, found)| SpacingWarning::of_packed(given, found))
            .map(Warning::Spacing),
    );
    warnings.extend(particle_warnings(
        facts,
        engine.relative_density(),
        coincident,
        engine.lacking_attributes(),
        mean,
    ));
    warnings
}

/// Puts the warnings about the spacing before the other warnings. If the given spacing is
/// contradicted, the warning about crowded particles is dropped, because it is less specific.
pub(crate) fn with_spacing_warnings(
    cells: Option<&Cells>,
    mut warnings: Vec<Warning>,
) -> Vec<Warning> {
    let spacing_warnings = cells.map_or(&[][..], |cells| &cells.warnings);
    let contradicts = |warning: &SpacingWarning| {
        use SpacingWarning::{Contradicted, SizesContradicted};
        matches!(warning, Contradicted { .. } | SizesContradicted { .. })
    };
    if spacing_warnings.iter().any(contradicts) {
        warnings.retain(|warning| !matches!(warning, Warning::Crowded { .. }));
    }
    let spacing_warnings = spacing_warnings.iter().cloned().map(Warning::Spacing);
    spacing_warnings.chain(warnings).collect()
}

/// The mean indicator of full cells, for symmetry.
pub(crate) fn mean_symmetry(sampled: &SampledDif) -> Option<f64> {
    (sampled.indicator.kind() == IndicatorKind::Symmetry).then(|| sampled.dif.mean_of_full())
}

/// Warnings about particles that are too dense, at the same position or without a value of an
/// attribute, about cells that are too wide, and about a low mean of the indicator symmetry.
pub(crate) fn particle_warnings<'a>(
    facts: &FrameFacts,
    crowding: Option<f64>,
    coincident: Option<CoincidentParticles>,
    lacking: impl Iterator<Item = (&'a str, usize)>,
    mean_symmetry: Option<f64>,
) -> Vec<Warning> {
    let spacing = facts.spacing.unwrap_or_default();
    let crowded = crowding.filter(|&times| times > CROWDED);
    let mut warnings: Vec<_> =
        crowded.map(|times| Warning::Crowded { times, spacing }).into_iter().collect();
    let cell_size = facts.grid.cell_size();
    if facts.spacing.is_some_and(|spacing| cell_size > WIDEST * spacing) {
        warnings.push(Warning::CoarseCells { cell_size, spacing });
    }
    let coincident = coincident.filter(|found| found.particles > FEW);
    warnings.extend(coincident.map(|found| Warning::Coincident { found, of: facts.census.binned }));
    warnings.extend(lacking.map(|(name, without)| Warning::MissingValues {
        attribute: name.to_owned(),
        without,
        of: facts.census.binned,
    }));
    let mean = mean_symmetry.filter(|&mean| mean < ON_CORNERS);
    warnings.extend(mean.map(|mean| Warning::OnCorners {
        mean,
        origin: (facts.grid.origin() + facts.grid.cell_size() / 2.0).to_array(),
    }));
    warnings
}

/// Warnings about the attributes in `known`, which the vertices of the calibration frame have, that
/// are missing from `own`, the attributes of another frame.
pub(crate) fn missing_attributes(
    own: &[AttributeInfo],
    known: &[SettledKind],
    calibration_frame: Option<i64>,
) -> Vec<Warning> {
    let is_missing = |name: &&String| own.iter().all(|info| info.name != **name);
    let missing = known.iter().map(|known| &known.stored.name).filter(is_missing);
    let warning =
        |name: &String| Warning::MissingAttribute { attribute: name.clone(), calibration_frame };
    missing.map(warning).collect()
}

/// Warnings about colours whose alpha was changed.
pub(crate) fn alpha_warnings(particles: &AlikeParticles<'_>) -> impl Iterator<Item = Warning> {
    let warning = |change: &AlphaChange| {
        let AlphaChange { attribute, own, shared } = change.clone();
        Warning::Alpha { attribute, own, shared }
    };
    particles.changed_alpha().iter().map(warning)
}

/// A warning about a given isovalue, from measurements on the frame.
pub(crate) fn isovalue_warning(
    measured: &MeasuredCalibration,
    given: Option<Isovalue>,
) -> Option<Warning> {
    let (Plateau::Interior { lowest, .. }, Some(given)) = (measured.plateau, given) else {
        return None;
    };
    let above = measured.calibration.iso().is_some() && given.threshold() >= lowest;
    above.then(|| Warning::Bubbles {
        iso: given.value(),
        lowest: f64::from(lowest) / f64::from(FULL),
    })
}

/// A warning about particles outside the surface, if there are many.
pub(crate) fn lost_warning(lost: u64, of: usize, smoothed: bool) -> Option<Warning> {
    (lost > FEW).then_some(Warning::Lost { lost, of, smoothed })
}
