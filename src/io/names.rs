//! Names of columns and attributes. Finds columns that belong together (`vx`, `vy` and `vz` are one
//! velocity), and makes the names of attributes in a file unique.

use std::collections::{HashMap, HashSet};

use crate::particles::AttributeInfo;
use crate::particles::velocity::{
    OPENFOAM_VELOCITY, VELOCITY_NAMES, VELOCITY_WORDS, velocity_attribute, velocity_rank,
};

/// Names of a position in order of preference. The empty name stands for columns `x`, `y` and `z`.
/// Names after the empty name may also mean a momentum, a pressure or a rotation.
const POSITION: [&str; 25] = [
    "points",
    "point",
    "pos",
    "position",
    "positions",
    "coordinates",
    "coordinate",
    "coords",
    "coord",
    "xyz",
    "location",
    "locations",
    "loc",
    "particle_position",
    "particle_positions",
    "particle_pos",
    "particle_q",
    "particles",
    "",
    "p",
    "xp",
    "x_p",
    "p_x",
    "x",
    "r",
];

/// Names that each stand for the three columns of a position, as in the heading `pos vel rho`.
const POSITION_WORDS: [&str; 10] = [
    "pos",
    "position",
    "positions",
    "coordinate",
    "coordinates",
    "coord",
    "coords",
    "xyz",
    "location",
    "locations",
];
/// Names of other columns that many programs write.
const COLUMN_WORDS: [&str; 34] = [
    "acc",
    "acceleration",
    "dens",
    "density",
    "energy",
    "force",
    "h",
    "hsml",
    "id",
    "idp",
    "ids",
    "index",
    "m",
    "mass",
    "material",
    "mk",
    "p",
    "phase",
    "press",
    "pressure",
    "radius",
    "rho",
    "rhop",
    "speed",
    "temp",
    "temperature",
    "time",
    "type",
    "vol",
    "volume",
    "vorticity",
    "vx",
    "vy",
    "vz",
];

/// Suffixes of names that begin with the axis of a position, such as `x-coordinate`, `xpos` or
/// `x_m`. LAMMPS writes `xu` for positions that are not wrapped into the periodic box.
const AXIS_FIRST: [&str; 7] = ["coordinate", "coord", "position", "pos", "p", "m", "u"];

/// Names of the field that contains the time of a file, in order of preference. VTK writes
/// `TimeValue`, older readers of VTK expect `TIME`, and simulations also use the other names.
pub const TIMES: [&str; 5] = ["TimeValue", "time", "Time", "TIME", "t"];

/// Names of an array that contains the time of a frame or the times of all frames, in order of
/// preference.
pub fn time_arrays() -> impl Iterator<Item = &'static str> {
    TIMES.into_iter().chain(["times"])
}

/// Name of a colour whose components are separate columns.
pub const COLOUR: &str = "color";
/// Names of the columns of a colour. The fourth column is optional.
pub const COLOURS: [[&str; 4]; 3] = [
    ["red", "green", "blue", "alpha"],
    ["diffuse_red", "diffuse_green", "diffuse_blue", "diffuse_alpha"],
    ["r", "g", "b", "a"],
];

/// Characters between the name of a vector and the name of its component.
const JOINTS: [char; 7] = ['.', ':', '_', '-', '[', '(', ' '];

/// One quantity of a table, such as a position or a velocity.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Quantity {
    /// The name without unit and component.
    pub name: String,
    /// Indices of its columns: one column, or the columns of x, y and z, or of a colour.
    pub columns: Vec<usize>,
}

/// Whether the field `name` contains the time of a file, and is preferred to the field `known`.
pub fn is_preferred_time(name: &str, known: Option<&str>) -> bool {
    let rank = |name: &str| TIMES.iter().position(|time| *time == name);
    match (rank(name), known.and_then(rank)) {
        (Some(new), Some(old)) => new < old,
        (new, old) => new.is_some() && old.is_none(),
    }
}

/// Decodes percent codes. For example, `%20` becomes a space.
pub fn percent_decoded(name: &str) -> String {
    let mut bytes = Vec::with_capacity(name.len());
    let mut rest = name.as_bytes();
    while let [first, tail @ ..] = rest {
        let code = percent_code(rest);
        bytes.push(code.unwrap_or(*first));
        rest = if code.is_some() { &rest[3..] } else { tail };
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

fn percent_code(bytes: &[u8]) -> Option<u8> {
    let digits = bytes.strip_prefix(b"%")?.get(..2)?;
    u8::from_str_radix(std::str::from_utf8(digits).ok()?, 16).ok()
}

/// Unique names of attributes in a file. `convert` converts each name to a name that the format
/// supports. Underscores are appended while the name is in `taken` or already used.
pub fn unique_names<'a>(
    names: impl IntoIterator<Item = &'a str>,
    taken: &[&str],
    convert: impl Fn(&str) -> String,
) -> Vec<String> {
    let mut used: Vec<String> = Vec::new();
    for name in names {
        let mut name = convert(name);
        while taken.contains(&&*name) || used.contains(&name) {
            name.push('_');
        }
        used.push(name);
    }
    used
}

/// Finds the position among the columns called `names`, and then all other quantities in order.
///
/// Columns form one vector if their names differ only in a final `x`, `y`, `z`, or in a final `0`,
/// `1`, `2` after a separator, and each axis occurs once. Examples are `Pos.x [m]`, `"Points:0"`,
/// `vel_x`, `vel[0]`, `Velocity [x]` and `vx`. Likewise, `red`, `green`, `blue` and optionally
/// `alpha`, or `r`, `g`, `b` and `a`, form one colour, called `color`. Names such as `x-coordinate`
/// are the position if there is no other position. Returns `None` if there is no position.
pub fn quantities(names: &[String]) -> Option<(Quantity, Vec<Quantity>)> {
    let names: Vec<&str> = names.iter().map(|name| without_unit(name)).collect();
    grouped(&names).or_else(|| grouped(&with_plain_axes(&names)?))
}

fn grouped(names: &[&str]) -> Option<(Quantity, Vec<Quantity>)> {
    let vectors = vectors(names);
    let colours: Vec<Vec<usize>> = COLOURS.iter().filter_map(|c| colour(names, c)).collect();
    let mut all = Vec::new();
    for (column, name) in names.iter().enumerate() {
        let vector =
            component(name).and_then(|(stem, _)| Some((stem.0, complete(&vectors[&stem])?)));
        if let Some(colour) = colours.iter().find(|colour| colour.contains(&column)) {
            if colour[0] == column {
                all.push(Quantity { name: COLOUR.to_owned(), columns: colour.clone() });
            }
            continue;
        }
        match vector {
            Some((stem, columns)) if columns[0] == column => {
                let name = stem.trim_end_matches(JOINTS).to_owned();
                all.push(Quantity { name, columns: columns.into() });
            }
            Some((_, columns)) if columns.contains(&column) => {}
            _ => all.push(Quantity { name: (*name).to_owned(), columns: vec![column] }),
        }
    }
    let is_upper =
        |q: &Quantity| names[q.columns[0]].chars().any(|letter| letter.is_ascii_uppercase());
    let position = POSITION.iter().find_map(|position| {
        let called = |q: &Quantity| q.columns.len() == 3 && q.name.eq_ignore_ascii_case(position);
        // If a file has both `x` and `X`, `x` is the current position, and `X` is the position in
        // the reference configuration.
        let all = || all.iter().enumerate().filter(|(_, q)| called(q));
        all().find(|(_, q)| !is_upper(q)).or_else(|| all().next()).map(|(index, _)| index)
    })?;
    let position = all.remove(position);
    for unnamed in all.iter_mut().filter(|q| q.name.is_empty()) {
        unnamed.name = unnamed.columns.iter().map(|&column| names[column]).collect();
    }
    Some((position, all))
}

/// For each stem and notation, the columns of each axis.
fn vectors<'a>(names: &[&'a str]) -> HashMap<(&'a str, char), [Vec<usize>; 3]> {
    let mut vectors = HashMap::<_, [Vec<usize>; 3]>::new();
    for (column, name) in names.iter().enumerate() {
        if let Some((stem, axis)) = component(name) {
            vectors.entry(stem).or_default()[axis].push(column);
        }
    }
    vectors
}

/// The columns of x, y and z. `None` if an axis does not have exactly one column.
fn complete(columns: &[Vec<usize>; 3]) -> Option<[usize; 3]> {
    match columns.each_ref().map(|columns| &columns[..]) {
        [&[x], &[y], &[z]] => Some([x, y, z]),
        _ => None,
    }
}

/// Finds three single numbers among the attributes that are the components of the velocity, such as
/// `vx`, `vy` and `vz`. Returns the velocity, with a name that no attribute has, and the indices of
/// its components. `None` if an attribute is the whole velocity. A vector `U` is the whole velocity
/// only if there are no such components, because it can be a displacement.
pub fn velocity_of_components(infos: &[AttributeInfo]) -> Option<(AttributeInfo, [usize; 3])> {
    if velocity_attribute(infos).is_some_and(|whole| infos[whole].name != OPENFOAM_VELOCITY) {
        return None;
    }
    let is_free = |name: &&&str| infos.iter().all(|info| info.name != **name);
    let name = VELOCITY_NAMES.iter().find(is_free)?;
    let numbers = infos.iter().map(|info| match info.components {
        1 => bare_name(&info.name),
        _ => "",
    });
    let numbers: Vec<&str> = numbers.collect();
    let vectors = vectors(&numbers);
    let ranked = numbers.iter().filter_map(|number| {
        let (stem, _) = component(number)?;
        let rank = velocity_rank(stem.0.trim_end_matches(JOINTS))?;
        Some((rank, complete(&vectors[&stem])?))
    });
    ranked.min().map(|(_, components)| (AttributeInfo::new(*name, 3), components))
}

/// The names, with `x`, `y` and `z` instead of names such as `x-coordinate`. `None` if the names
/// of the three axes are incomplete or ambiguous.
fn with_plain_axes<'a>(names: &[&'a str]) -> Option<Vec<&'a str>> {
    let found: Vec<_> = names.iter().map(|name| axis_in_name(name)).collect();
    // If there is also `y1`, the names `x1`, `x2` and `x3` are the x coordinates of three points.
    let is_point = names.iter().any(|name| name.eq_ignore_ascii_case("y1"));
    let is_complete = |kind: &str| {
        let times = |axis| found.iter().filter(|found| **found == Some((kind, axis))).count();
        (0..3).all(|axis| times(axis) == 1) && !(kind == "x" && is_point)
    };
    let mut kinds: Vec<_> = found.iter().flatten().map(|(kind, _)| *kind).collect();
    kinds.sort_unstable();
    kinds.dedup();
    let kind = kinds.into_iter().find(|kind| is_complete(kind))?;
    let plain = found.iter().zip(names).map(|(found, name)| match found {
        Some((of, axis)) if *of == kind => ["x", "y", "z"][*axis],
        _ => *name,
    });
    Some(plain.collect())
}

/// The kind and the axis of a name such as `x-coordinate`, `x_pos`, `x1` or `coord0`.
fn axis_in_name(name: &str) -> Option<(&'static str, usize)> {
    let name = name.to_ascii_lowercase();
    let (kind, first) = if name.starts_with('x') { ("x", '1') } else { ("coord", '0') };
    if let Some(digit) = name.strip_prefix(kind).and_then(|digit| digit.parse::<char>().ok())
        && let Some(axis) = (digit as usize).checked_sub(first as usize).filter(|axis| *axis < 3)
    {
        return Some((if kind == "x" { "x" } else { "coord0" }, axis));
    }
    let axis = "xyz".find(name.chars().next()?)?;
    let end = name[1..].trim_start_matches(JOINTS);
    let kind = AXIS_FIRST.into_iter().find(|known| end == *known)?;
    // `xm` may be a mean instead of a position.
    (kind != "m" || name.len() > 2).then_some((kind, axis))
}

/// The columns of a colour's components. `None` if the name of a component is missing or occurs
/// twice. Alpha is optional.
fn colour(names: &[&str], [channels @ .., alpha]: &[&str; 4]) -> Option<Vec<usize>> {
    let called = |channel: &str| {
        let columns = names.iter().enumerate().filter(|(_, n)| n.eq_ignore_ascii_case(channel));
        columns.map(|(column, _)| column).collect::<Vec<_>>()
    };
    let only = |channel: &&str| match called(channel)[..] {
        [only] => Some(only),
        _ => None,
    };
    let mut columns = channels.iter().map(only).collect::<Option<Vec<_>>>()?;
    columns.extend(only(alpha));
    Some(columns)
}

/// The name of a position column that appears twice, as in `x,y,z,x,y,z`.
pub fn repeated_position(names: &[String]) -> Option<&str> {
    let mut distinct = HashSet::new();
    let once: Vec<String> = names.iter().filter(|name| distinct.insert(*name)).cloned().collect();
    if once.len() == names.len() || quantities(names).is_some() {
        return None;
    }
    let (position, _) = quantities(&once)?;
    let is_twice = |name: &&String| names.iter().filter(|other| other == name).count() > 1;
    let found = position.columns.iter().map(|&column| &once[column]).find(is_twice)?;
    names.iter().find(|name| *name == found).map(String::as_str)
}

/// The axis of the position column that has this name: 0 for `x`, `pos_x` or `Position[x]`.
pub fn position_axis(name: &str) -> Option<usize> {
    let axis = component(name).and_then(|((stem, _), axis)| {
        let stem = stem.trim_end_matches(JOINTS);
        POSITION.iter().any(|position| stem.eq_ignore_ascii_case(position)).then_some(axis)
    });
    axis.or_else(|| axis_in_name(name).map(|(_, axis)| axis))
}

fn is_among(names: &[&str], name: &str) -> bool {
    names.iter().any(|known| name.eq_ignore_ascii_case(known))
}

/// Whether a name stands for the three columns of a position, such as `pos`.
pub fn names_position(name: &str) -> bool {
    is_among(&POSITION_WORDS, name)
}

/// Whether a name stands for the three columns of a velocity, such as `vel`.
pub fn names_velocity(name: &str) -> bool {
    is_among(&VELOCITY_WORDS, name)
}

/// Whether a name is a common name of a column or a vector that is not a position.
pub fn names_other_column(name: &str) -> bool {
    is_among(&COLUMN_WORDS, name) || names_velocity(name)
}

/// Whether a name is a component of a well-known vector that is not a position, such as `vel_x`.
pub fn is_other_component(name: &str) -> bool {
    component(name).is_some_and(|((stem, _), _)| {
        let stem = stem.trim_end_matches(JOINTS);
        names_other_column(stem) && !is_among(&POSITION, stem) || is_among(&["a", "f", "u"], stem)
    })
}

/// Whether three names are the components of one vector, such as `qx`, `qy` and `qz`, or `x0`, `y0`
/// and `z0`.
pub fn are_components(names: &[String]) -> bool {
    let last = |name: &String| component(name).map(|((stem, _), axis)| (stem.to_owned(), axis));
    let first = |name: &String| {
        let (axis, rest) = name.split_at_checked(1)?;
        Some((rest.to_owned(), "xyz".find(&axis.to_ascii_lowercase())?))
    };
    let are_of_one = |vector: &dyn Fn(&String) -> Option<(String, usize)>| {
        let found: Option<Vec<_>> = names.iter().map(vector).collect();
        found.is_some_and(|all| {
            (0..).zip(&all).all(|(axis, found)| found.1 == axis && found.0 == all[0].0)
        })
    };
    are_of_one(&last) || are_of_one(&first)
}

/// Whether a word names a position without a component, such as `pos` or `coordinates`.
pub fn is_position_word(word: &str) -> bool {
    word.len() > 1 && POSITION.iter().any(|position| word.eq_ignore_ascii_case(position))
}

/// Whether a position with this name is preferred to columns `x`, `y` and `z`.
pub fn is_preferred_position(name: &str) -> bool {
    let preferred = POSITION.iter().take_while(|position| !position.is_empty());
    preferred.into_iter().any(|position| name.eq_ignore_ascii_case(position))
}

/// The names without units. A unit may follow a name without a blank, as in `vx[m/s]` or
/// `vx/(m/s)`. Names that would become equal keep their units.
pub fn bare_names(names: &[String]) -> Vec<String> {
    let bare: Vec<&str> = names.iter().map(|name| bare_name(name)).collect();
    let mut times = HashMap::new();
    for name in &bare {
        *times.entry(*name).or_insert(0) += 1;
    }
    let kept = names.iter().zip(&bare);
    kept.map(|(name, bare)| if times[bare] > 1 { name.clone() } else { (*bare).to_owned() })
        .collect()
}

/// The name without its unit, even if the unit follows the name without a blank.
pub fn bare_name(name: &str) -> &str {
    // The index of a component, as in `vel[0]` or `stress[xy]`, is not a unit.
    let is_index =
        |text: &str| text.chars().all(|c| c.is_ascii_digit() || "xyzXYZijk,".contains(c));
    let name = without_unit(name);
    let brackets = name.match_indices(['[', '(']).map(|(at, _)| at);
    let unit = brackets.filter(|&at| at > 0).find(|&at| !is_index(inside(&name[at + 1..])));
    let unit = unit.filter(|_| name.ends_with([']', ')']));
    let slash = name.find('/').filter(|&at| at > 0 && at + 1 < name.len());
    let end = slash.into_iter().chain(unit).min();
    end.map_or(name, |at| name[..at].trim_end())
}

/// The name without a unit after a blank.
pub fn without_unit(name: &str) -> &str {
    let name = name.trim().trim_matches(['"', '\'']);
    // The axis of a component, as in `Velocity [x]`, is not a unit.
    let is_axis = |text: &str| matches!(text, "x" | "y" | "z" | "X" | "Y" | "Z");
    let unit = |open: &str| {
        let mut brackets = name.match_indices(open).map(|(at, _)| at);
        brackets.find(|&at| !is_axis(inside(&name[at + open.len()..])))
    };
    let end = unit(" [").or_else(|| unit(" (")).unwrap_or(name.len());
    name[..end].trim()
}

/// The text before the first closing bracket.
fn inside(text: &str) -> &str {
    text.split([']', ')']).next().unwrap_or_default().trim()
}

/// Splits the name of a vector's component, such as `vel.x`, into its stem `vel.`, its notation and
/// its axis (here 0). A character identifies the notation: `f` for names such as `x-velocity`,
/// which Fluent writes, and otherwise the name of the first axis in this notation, such as `x`, `X`
/// or `0`. CFX writes `Velocity u`, and STAR-CCM+ writes `Velocity[i]`.
fn component(name: &str) -> Option<((&str, char), usize)> {
    if let Some((axis, velocity)) = name.split_once(['-', '_', ' '])
        && velocity.eq_ignore_ascii_case("velocity")
        && let Some(axis) = ["x", "y", "z"].iter().position(|a| axis.eq_ignore_ascii_case(a))
    {
        return Some(((velocity, 'f'), axis));
    }
    let is_closed = name.ends_with(']');
    let name = name.strip_suffix([']', ')']).unwrap_or(name);
    let last = name.chars().next_back()?;
    let stem = &name[..name.len() - last.len_utf8()];
    match last {
        'x'..='z' => Some(((stem, 'x'), last as usize - 'x' as usize)),
        'X'..='Z' => Some(((stem, 'X'), last as usize - 'X' as usize)),
        '0'..='2' if stem.ends_with(JOINTS) => Some(((stem, '0'), last as usize - '0' as usize)),
        'i'..='k' if is_closed && stem.ends_with('[') => {
            Some(((stem, 'i'), last as usize - 'i' as usize))
        }
        'u'..='w' if stem.ends_with(JOINTS) && names_velocity(stem.trim_end_matches(JOINTS)) => {
            Some(((stem, 'u'), last as usize - 'u' as usize))
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(names: &[&str]) -> Option<(String, [usize; 3])> {
        let infos: Vec<_> = names.iter().map(|name| AttributeInfo::new(*name, 1)).collect();
        velocity_of_components(&infos).map(|(velocity, components)| (velocity.name, components))
    }

    #[test]
    fn components_of_the_velocity_are_found_in_every_notation() {
        for [x, y, z] in [
            ["vx", "vy", "vz"],
            ["VX", "VY", "VZ"],
            ["v_x", "v_y", "v_z"],
            ["velX", "velY", "velZ"],
            ["velocity_x", "velocity_y", "velocity_z"],
            ["Velocity:0", "Velocity:1", "Velocity:2"],
            ["velocity[i]", "velocity[j]", "velocity[k]"],
            ["x-velocity", "y-velocity", "z-velocity"],
            ["vx [m/s]", "vy [m/s]", "vz [m/s]"],
            ["vx[m/s]", "vy[m/s]", "vz[m/s]"],
            ["Ux", "Uy", "Uz"],
        ] {
            let expected = Some(("velocity".to_owned(), [2, 3, 0]));
            assert_eq!(found(&[z, "rho", x, y]), expected, "{x}");
        }
        let expected = Some(("v".to_owned(), [1, 2, 3]));
        assert_eq!(found(&["velocity", "vx", "vy", "vz"]), expected, "the name is taken");
    }

    #[test]
    fn other_vectors_and_incomplete_velocities_are_not_a_velocity() {
        for names in [["u", "v", "w"], ["ax", "ay", "az"], ["vx", "vy", "vy"], ["vx", "vy", "vZ"]] {
            assert_eq!(found(&names), None, "{names:?}");
        }
        let infos = ["vx", "vy", "vz"].map(|name| AttributeInfo::new(name, 1)).to_vec();
        let with = |whole: &str| [infos.clone(), vec![AttributeInfo::new(whole, 3)]].concat();
        assert_eq!(velocity_of_components(&with("vel")), None);
        assert!(velocity_of_components(&with("U")).is_some());
    }
}
