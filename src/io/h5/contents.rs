//! Summarises the contents of a file, for the error that no positions were found.

use std::collections::BTreeSet;

use hdf5_reader::group::Group;
use hdf5_reader::{Dataset, Datatype};

use crate::io::ReadFault;
use crate::io::fields::{NamedArray, advice_on_plane, arrange, shown};

use super::file::convert_error;
use super::groups::last_name;
use super::table::scalar;

/// Maximum number of groups that are searched.
pub const MOST_GROUPS: usize = 1 << 10;
/// Maximum depth of nested groups that are searched.
pub const DEEPEST: usize = 8;
/// Maximum number of lines of the summary.
const MAX_LINES: usize = 20;
/// Maximum number of members of a compound type that the summary lists.
const MAX_MEMBERS: usize = 12;
/// Maximum number of arrays of a group that are searched for positions in a plane.
const MOST_ARRAYS: usize = 100;
/// Prefix of the names of compound members in which pandas stores several columns each. The names
/// of these columns are stored only in Python's pickle format, which this reader does not support.
const PANDAS: &str = "values_block_";
/// Maximum length of a name in characters.
const MAX_NAME_CHARS: usize = 100;

/// The error for a file in which no positions were found. It lists the contents of `root`.
///
/// # Errors
/// If the contents cannot be read.
pub fn no_position(root: &Group) -> Result<ReadFault, ReadFault> {
    let Summary { lines, more, on_plane } = Summary::of(root)?;
    let mut what = "no positions found. Store float32 or float64 in a data set called position, \
                    pos or x, of shape (N, 3), (3, N) or (frames, N, 3), or in three data sets \
                    called x, y and z, of shape (N,)."
        .to_owned();
    if lines.iter().any(|line| line.contains(PANDAS)) {
        what += " Write a pandas table with data_columns=True, so that its columns have names.";
    }
    if let Some(advice) = on_plane {
        what += &format!(" {}{}.", advice[..1].to_uppercase(), &advice[1..]);
    }
    what += " The file contains";
    match lines.is_empty() {
        true => what += " nothing",
        false => what += &format!(":\n  {}", lines.join("\n  ")),
    }
    if more > 0 {
        what += &format!("\n  and {more} more");
    }
    Ok(ReadFault::Unsupported(what))
}

/// The contents of a file.
struct Summary {
    /// One line for each of the first data sets and empty groups.
    lines: Vec<String>,
    /// The number of further data sets and empty groups.
    more: usize,
    /// Advice for the first group whose positions have only two coordinates.
    on_plane: Option<String>,
}

impl Summary {
    fn of(root: &Group) -> Result<Self, ReadFault> {
        let (mut lines, mut more, mut on_plane) = (Vec::new(), 0, None);
        let mut push = |line: &dyn Fn() -> String| match lines.len() < MAX_LINES {
            true => lines.push(line()),
            false => more += 1,
        };
        let mut seen = BTreeSet::new();
        let mut ahead = vec![(String::new(), root.clone(), 0)];
        while let Some((path, group, depth)) = ahead.pop() {
            if !seen.insert(group.address()) || seen.len() > MOST_GROUPS {
                continue;
            }
            let (mut groups, mut sets) = convert_error(group.members())?;
            groups.sort_by(|a, b| a.name().cmp(b.name()));
            sets.sort_by(|a, b| a.name().cmp(b.name()));
            on_plane = on_plane.or_else(|| advice_on_plane(&arrays(&sets), arrange));
            if depth > 0 && sets.is_empty() && groups.is_empty() {
                push(&|| format!("{} (an empty group)", short(&path)));
            }
            for set in &sets {
                push(&|| {
                    let path = format!("{path}/{}", last_name(set.name()));
                    format!("{} {} {}", short(&path), shown(set.shape()), kind(set.dtype()))
                });
            }
            if depth < DEEPEST {
                ahead.extend(groups.into_iter().rev().map(|group| {
                    (format!("{path}/{}", last_name(group.name())), group, depth + 1)
                }));
            }
        }
        Ok(Self { lines, more, on_plane })
    }
}

/// The first arrays of numbers in these data sets. Columns of tables are arrays.
fn arrays(sets: &[Dataset]) -> Vec<NamedArray> {
    let mut arrays = Vec::new();
    for set in sets.iter().take(MOST_ARRAYS) {
        let mut push = |name: &str, kind: &Datatype| {
            let shape = set.shape().to_vec();
            let name = short(last_name(name));
            arrays.extend(scalar(kind).map(|_| NamedArray { name, shape }));
        };
        match set.dtype() {
            Datatype::Compound { fields, .. } => {
                fields.iter().for_each(|field| push(&field.name, &field.datatype));
            }
            kind => push(set.name(), kind),
        }
    }
    arrays.truncate(MOST_ARRAYS);
    arrays
}

/// Shortens a name to at most [`MAX_NAME_CHARS`] characters, and escapes control characters.
fn short(name: &str) -> String {
    let shown: String = name.chars().take(MAX_NAME_CHARS).flat_map(char::escape_debug).collect();
    if name.chars().nth(MAX_NAME_CHARS).is_some() { format!("{shown}...") } else { shown }
}

/// The name of a data type in NumPy's notation.
fn kind(kind: &Datatype) -> String {
    match kind {
        Datatype::FixedPoint { size, signed, .. } => {
            format!("{}int{}", if *signed { "" } else { "u" }, u32::from(*size) * 8)
        }
        // The HDF5 library does not distinguish float16 from bfloat16, so neither is supported.
        Datatype::FloatingPoint { size: 2, .. } => "float16, which is not supported".to_owned(),
        Datatype::FloatingPoint { size, .. } => format!("float{}", u32::from(*size) * 8),
        Datatype::Compound { fields, .. } => {
            let members = fields.iter().take(MAX_MEMBERS);
            let members = members.map(|field| match scalar(&field.datatype) {
                Some(_) => short(&field.name),
                None => format!("{}: {}", short(&field.name), self::kind(&field.datatype)),
            });
            let members = members.collect::<Vec<_>>().join(", ");
            match fields.len().saturating_sub(MAX_MEMBERS) {
                0 => format!("table of {members}"),
                more => format!("table of {members} and {more} more"),
            }
        }
        Datatype::Array { base, dims } => format!("{} of {}", shown(dims), self::kind(base)),
        Datatype::Enum { .. } => "enumeration".to_owned(),
        Datatype::String { .. } | Datatype::VarLen { .. } => "text or lists".to_owned(),
        _ => "other data".to_owned(),
    }
}
