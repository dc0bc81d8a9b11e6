//! Names of columns and attributes: which columns belong together (`vx`, `vy`, `vz` are one
//! velocity), and how attributes get names that a file tells apart.

use std::collections::HashMap;

/// Names that a position may have, the likeliest first. The empty name is that of plain `x`, `y`,
/// `z`.
const POSITION: [&str; 25] = [
    "",
    "points",
    "point",
    "pos",
    "position",
    "positions",
    "p",
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
    "xp",
    "x_p",
    "p_x",
    "x",
    "r",
];

/// One quantity of a table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Quantity {
    /// Without unit and component.
    pub name: String,
    /// Numbers of the columns that hold it: one, or those of x, y and z.
    pub columns: Vec<usize>,
}

/// A name as its program knows it: `%20` is a space.
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

/// Names of attributes in a file, no two alike: each as `spelled` says, with underscores behind it
/// where that is `taken`.
pub fn told_apart<'a>(
    names: impl IntoIterator<Item = &'a str>,
    taken: &[&str],
    spelled: impl Fn(&str) -> String,
) -> Vec<String> {
    let mut given: Vec<String> = Vec::new();
    for name in names {
        let mut name = spelled(name);
        while taken.contains(&&*name) || given.contains(&name) {
            name.push('_');
        }
        given.push(name);
    }
    given
}

/// Finds the position among the columns called `names`, and then all other quantities in their
/// order.
///
/// Columns are one vector where their names differ only in a last `x`, `y`, `z`, or `0`, `1`, `2`
/// after a separator: `Pos.x [m]`, `"Points:0"`, `vel_x`, `vel[0]`, `vx`. None where no position is
/// among them.
pub fn quantities(names: &[String]) -> Option<(Quantity, Vec<Quantity>)> {
    let names: Vec<&str> = names.iter().map(|name| without_unit(name)).collect();
    let mut vectors = HashMap::<_, [Option<usize>; 3]>::new();
    for (column, name) in names.iter().enumerate() {
        if let Some((stem, axis)) = component(name) {
            vectors.entry(stem).or_default()[axis].get_or_insert(column);
        }
    }
    let mut all = Vec::new();
    for (column, name) in names.iter().enumerate() {
        let vector = component(name).and_then(|(stem, _)| match vectors[&stem] {
            [Some(x), Some(y), Some(z)] => Some((stem.0, [x, y, z])),
            _ => None,
        });
        match vector {
            Some((stem, columns)) if columns[0] == column => {
                let name = stem.trim_end_matches(['.', ':', '_', '-', '[', ' ']).to_owned();
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
        // Beside a current position `x`, `X` is that of the reference configuration.
        let all = || all.iter().enumerate().filter(|(_, q)| called(q));
        all().find(|(_, q)| !is_upper(q)).or_else(|| all().next()).map(|(index, _)| index)
    })?;
    let position = all.remove(position);
    for unnamed in all.iter_mut().filter(|q| q.name.is_empty()) {
        unnamed.name = unnamed.columns.iter().map(|&column| names[column]).collect();
    }
    Some((position, all))
}

fn without_unit(name: &str) -> &str {
    let name = name.trim().trim_matches(['"', '\'']);
    let end = name.find(" [").or_else(|| name.find(" (")).unwrap_or(name.len());
    name[..end].trim()
}

/// Splits `vel.x` into the stem `vel.` and the axis 0. The stem comes with the spelling of its
/// first axis: `x`, `X` or `0`.
fn component(name: &str) -> Option<((&str, char), usize)> {
    let name = name.strip_suffix(']').unwrap_or(name);
    let last = name.chars().next_back()?;
    let stem = &name[..name.len() - last.len_utf8()];
    match last {
        'x'..='z' => Some(((stem, 'x'), last as usize - 'x' as usize)),
        'X'..='Z' => Some(((stem, 'X'), last as usize - 'X' as usize)),
        '0'..='2' if stem.ends_with(['.', ':', '_', '-', '[', ' ']) => {
            Some(((stem, '0'), last as usize - '0' as usize))
        }
        _ => None,
    }
}
