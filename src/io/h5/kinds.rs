//! Choosing among the types of particles that a file holds.

use crate::io::ReadFault;

/// The type of particles that is meant: by its name, or `usual`, or the only one.
pub(super) fn chosen_type(
    known: &[String],
    named: Option<&str>,
    usual: Option<&str>,
) -> Result<String, ReadFault> {
    let list = known.join(", ");
    let is_there = |name: &&str| known.iter().any(|known| known == name);
    match (named, known) {
        (Some(name), _) if is_there(&name) => Ok(name.to_owned()),
        (Some(name), _) => {
            Err(ReadFault::Unsupported(format!("no particles of the type {name}; there are: {list}")))
        }
        (None, []) => Err(ReadFault::Unsupported("no particles at all".to_owned())),
        (None, [only]) => Ok(only.clone()),
        (None, _) => usual
            .filter(is_there)
            .map(str::to_owned)
            .ok_or_else(|| ReadFault::Unsupported(format!("particles of several types: {list}; name one"))),
    }
}
