//! Selects which parts of an input are read: types of particles, attributes, pieces, and the
//! particles that meet conditions. Removes ghosts.

use crate::particles::condition::Where;
use crate::particles::mixture::is_material_name;
use crate::particles::selection::{SelectionFault, select};
use crate::particles::sizes::{SizeAttributes, SizeChoice};
use crate::particles::{AttributeInfo, Particles, attribute_called, velocity_attribute};

use super::bytes::Unpacking;
use super::input_format::InputFormat;
use super::names::velocity_of_components;
use super::{ParticleFile, ReadFault};

/// Names of the array in which VTK flags points or cells that are copies or hidden. VTK before
/// version 6.3 uses the second name, and stores levels of copies in that array.
pub(super) const GHOSTS: [&str; 2] = ["vtkGhostType", "vtkGhostLevels"];
/// Name of the array in which PySPH flags copies of particles.
pub(super) const TAG: &str = "tag";

/// Selects which particles of an input are read, and which of their attributes.
#[derive(Debug, Clone, Copy, Default)]
pub struct WantedParticles<'a> {
    /// Format of the input, if it differs from the format that the extension implies.
    pub format: Option<InputFormat>,
    /// Attributes to read. Readers that always read all attributes return more than these.
    pub attributes: WantedAttributes<'a>,
    /// Conditions by which particles are selected. If an input has several types of particles, a
    /// condition such as `type=wall` names the type to read. Without such a condition, the type is
    /// PartType0 or fluid. It is gas only if no other type can be a liquid.
    pub conditions: &'a [Where],
    /// Pieces to read, for an input in several files.
    pub pieces: WantedPieces<'a>,
}

/// The pieces to read, for an input in several files. Other pieces are not opened, and count as
/// empty.
#[derive(Debug, Clone, Copy, Default)]
pub enum WantedPieces<'a> {
    /// All pieces.
    #[default]
    All,
    /// Pieces with these numbers, counted from 0, in ascending order.
    Numbered(&'a [usize]),
}

impl WantedPieces<'_> {
    /// Whether piece number `piece` is wanted.
    pub fn includes(&self, piece: usize) -> bool {
        match self {
            Self::All => true,
            Self::Numbered(numbers) => numbers.binary_search(&piece).is_ok(),
        }
    }

    /// Number of wanted pieces if the input has `all` pieces.
    pub fn of(&self, all: usize) -> usize {
        match self {
            Self::All => all,
            Self::Numbered(numbers) => numbers.len(),
        }
    }
}

/// The attributes to read.
#[derive(Debug, Clone, Copy, Default)]
pub enum WantedAttributes<'a> {
    /// All attributes.
    #[default]
    All,
    /// The named attributes, the attributes that conditions test, and the attributes that give
    /// sizes.
    Only {
        /// Names of attributes, which [`attribute_called`] finds. `None` requests the velocity.
        names: Option<&'a [String]>,
        /// Conditions by which particles are selected.
        conditions: &'a [Where],
        /// Selects the attributes that give the sizes of the particles. These attributes are also
        /// read.
        sizes: &'a SizeChoice,
    },
}

impl WantedAttributes<'_> {
    /// Whether to read the text attribute `name`.
    pub fn includes_label(&self, name: &str) -> bool {
        matches!(self, Self::All) || is_material_name(name) || self.test(name)
    }

    /// Whether a condition tests the attribute `name`.
    pub fn test(&self, name: &str) -> bool {
        let Self::Only { conditions, .. } = self else { return false };
        let mut conditions = conditions.iter().flat_map(Where::conditions);
        conditions.any(|condition| condition.name.eq_ignore_ascii_case(name))
    }

    /// For each attribute of an input, whether to read it. If a requested attribute is missing, all
    /// attributes are read, so that the error can list them. Components of the velocity that are
    /// separate attributes are always read.
    pub fn among(&self, infos: &[AttributeInfo]) -> Vec<bool> {
        let Self::Only { .. } = self else { return vec![true; infos.len()] };
        let is_flag = |name: &str| GHOSTS.contains(&name) || name == TAG || is_material_name(name);
        let requested = self.requested_among(infos);
        let velocity = velocity_of_components(infos).map(|(_, components)| components);
        let reads = |(number, info): (usize, &AttributeInfo)| {
            is_flag(&info.name)
                || velocity.is_some_and(|components| components.contains(&number))
                || requested.as_ref().is_none_or(|requested| requested[number])
        };
        infos.iter().enumerate().map(reads).collect()
    }

    /// For each attribute of an input, whether it is requested by name, by a condition, as a size
    /// or as the velocity. `None` if a requested attribute is missing, or for
    /// [`All`](Self::All).
    pub fn requested_among(&self, infos: &[AttributeInfo]) -> Option<Vec<bool>> {
        let Self::Only { names, conditions, sizes } = self else { return None };
        let sizes = sizes.columns(infos).ok()?;
        let sizes = sizes.iter().flat_map(SizeAttributes::numbers);
        let conditions = conditions.iter().flat_map(Where::conditions);
        let selecting = conditions.filter_map(|condition| condition.attribute(infos));
        let transferred: Vec<usize> = match names {
            None => velocity_attribute(infos).into_iter().collect(),
            Some(names) => {
                names.iter().map(|name| attribute_called(name, infos)).collect::<Option<_>>()?
            }
        };
        let mut requested = vec![false; infos.len()];
        let all = transferred.into_iter().chain(selecting).chain(sizes);
        all.for_each(|number| requested[number] = true);
        Some(requested)
    }
}

impl ParticleFile {
    /// Removes the particles that fail a condition.
    pub(super) fn selected(
        mut self,
        conditions: &[Where],
        unpacking: Unpacking,
    ) -> Result<Self, ReadFault> {
        if conditions.is_empty() {
            return Ok(self);
        }
        let infos = self.particles.attributes();
        let mut tested = Vec::new();
        for condition in conditions.iter().flat_map(Where::conditions) {
            // The reader has already chosen the type that a condition on `type` names, unless the
            // file has an attribute `type`.
            match self.particle_types.first() {
                Some(chosen)
                    if condition.is_of_type()
                        && (condition.attribute(infos).is_none()
                            || condition.values == [&**chosen]) =>
                {
                    let name = condition.name.clone();
                    let order = || ReadFault::Selection(SelectionFault::Order { name });
                    if condition.values.len() > 1 || !condition.of_text(chosen).ok_or_else(order)? {
                        return Err(ReadFault::Selection(SelectionFault::Types {
                            condition: condition.to_string(),
                            known: self.particle_types.clone(),
                        }));
                    }
                }
                _ => tested.push(condition),
            }
        }
        let sieve = select(&self.particles, tested, || unpacking.check_cancelled().is_ok());
        let sieve = sieve.map_err(|fault| match fault {
            SelectionFault::Cancelled => {
                unpacking.check_cancelled().expect_err("the selection was cancelled")
            }
            SelectionFault::Unread(fault) => fault.into(),
            SelectionFault::NoAttribute { name, .. }
                if self.texts.iter().any(|text| text.eq_ignore_ascii_case(&name)) =>
            {
                ReadFault::Unsupported(format!(
                    "cannot select particles by {name:?}: text arrays are not supported in this \
                     format; store numbers instead"
                ))
            }
            SelectionFault::NoAttribute { name, mut known } => {
                known.extend(self.unread.iter().map(|info| info.name.clone()));
                ReadFault::Selection(SelectionFault::NoAttribute { name, known })
            }
            fault => ReadFault::Selection(fault),
        })?;
        self.unselected = self.particles.len() - sieve.count();
        if sieve.count() == 0 && self.unselected > 0 {
            self.none_selected = Some(SelectionFault::none(&self.particles, conditions));
        }
        self.particles.select(&sieve);
        Ok(self)
    }

    /// Returns the file, or an error if every particle fails a condition.
    ///
    /// # Errors
    /// [`ReadFault::Selection`] if every particle fails a condition.
    pub fn require_selected(mut self) -> Result<Self, ReadFault> {
        self.none_selected.take().map_or(Ok(self), |fault| Err(ReadFault::Selection(fault)))
    }

    /// Removes the points that VTK flags as copies or as hidden.
    pub(super) fn without_ghosts(self) -> Self {
        GHOSTS.iter().fold(self, |file, flag| file.without(flag))
    }

    /// Removes the particles whose attribute `flag` is nonzero, and then removes that attribute.
    pub(super) fn without(mut self, flag: &str) -> Self {
        let is_it = |info: &AttributeInfo| info.name == flag && info.components == 1;
        if let Some(index) = self.particles.attributes().iter().position(is_it) {
            self.ghosts += self.particles.remove_flagged(index);
        }
        self
    }
}
