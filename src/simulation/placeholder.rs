//! Placeholders for a number in a name, in the notations of several programs: `{}` and `{:04}`,
//! `%04d` of C, `####` and `@@@@` of compositors, `$F4` of Houdini, `<frame>` of renderers.

use std::ops::Range;

/// A placeholder for a number.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Placeholder {
    /// An integer, padded with zeros to a width if there is one.
    Number(Option<usize>),
    /// A time.
    Time,
    /// The number of a piece of a frame.
    Piece,
    /// An unsupported notation. Holds the supported notation to use instead.
    Unknown(String),
}

/// The placeholders in a name, with their positions in bytes.
pub(super) fn find_placeholders(name: &str) -> Vec<(Range<usize>, Placeholder)> {
    let mut found: Vec<(Range<usize>, Placeholder)> = Vec::new();
    while let Some(next) = find_first(name, found.last().map_or(0, |(at, _)| at.end)) {
        found.push(next);
    }
    found
}

/// The first placeholder at or after `from`.
fn find_first(name: &str, from: usize) -> Option<(Range<usize>, Placeholder)> {
    let at = |(start, sign): (usize, char)| {
        let rest = &name[start..];
        let before = name[..start].chars().next_back();
        let (length, placeholder) = match sign {
            '{' => braces(rest),
            '%' => printf(rest),
            '#' | '@' => marks(rest, sign, before),
            '$' => houdini(rest),
            '<' => brackets(rest),
            _ => None,
        }?;
        Some((start..start + length, placeholder))
    };
    name.char_indices().skip_while(|(start, _)| *start < from).find_map(at)
}

type Found = Option<(usize, Placeholder)>;

/// Reads a width, which must be from 1 to 20 digits.
fn width(text: &str) -> Option<usize> {
    text.parse().ok().filter(|width| (1..=20).contains(width))
}

fn unknown(width: Option<usize>) -> Placeholder {
    Placeholder::Unknown(match width {
        Some(width) if width > 1 => format!("{{:0{width}}}"),
        _ => "{}".to_owned(),
    })
}

/// `{}`, `{:04}`, `{:04d}`, `{frame:04d}`, `{time}` or `{piece}`.
fn braces(text: &str) -> Found {
    let (inside, _) = text[1..].split_once('}')?;
    let (name, format) = inside.split_once(':').unwrap_or((inside, ""));
    let digits = format.trim_end_matches('d');
    let placeholder = match (name, digits.strip_prefix('0').and_then(width)) {
        _ if inside == "piece" => Placeholder::Piece,
        _ if inside == "time" => Placeholder::Time,
        ("" | "frame", None) if digits.is_empty() => Placeholder::Number(None),
        ("" | "frame", Some(width)) => Placeholder::Number(Some(width)),
        _ => unknown(width(digits)),
    };
    Some((inside.len() + 2, placeholder))
}

/// `%d` or `%04d`. `my%20data.npy` has no placeholder.
fn printf(text: &str) -> Found {
    let digits = text[1..].len() - text[1..].trim_start_matches(|c: char| c.is_ascii_digit()).len();
    let (digits, rest) = text[1..].split_at(digits);
    let mut rest = rest.chars();
    let ends = rest.next().is_some_and(|c| matches!(c, 'd' | 'i' | 'u'))
        && !rest.next().is_some_and(char::is_alphabetic);
    let placeholder = match (digits, digits.strip_prefix('0').map(width)) {
        ("", _) => Placeholder::Number(None),
        (_, Some(Some(width))) => Placeholder::Number(Some(width)),
        _ => unknown(width(digits)),
    };
    ends.then_some((digits.len() + 2, placeholder))
}

/// `####` or `@@@@`, with one character per digit, and at most 20. A single `#` stands for any
/// number of digits, and must not be next to letters or digits.
fn marks(text: &str, sign: char, before: Option<char>) -> Found {
    if before == Some(sign) {
        // This sign is inside a run of equal signs, which was rejected because it is too long.
        return None;
    }
    let count = text.len() - text.trim_start_matches(sign).len();
    let is_boundary = |c: Option<char>| !c.is_some_and(char::is_alphanumeric);
    match count {
        1 if sign == '#' && is_boundary(before) && is_boundary(text[1..].chars().next()) => {
            text.len().gt(&1).then_some((1, Placeholder::Number(None)))
        }
        2..=20 => Some((count, Placeholder::Number(Some(count)))),
        _ => None,
    }
}

/// `$F`, `$F4`, `${F}` or `${F4}`. Other variables, such as `$T` and `$SF`, are not frame numbers.
fn houdini(text: &str) -> Found {
    let (inside, length) = match text[1..].strip_prefix('{') {
        Some(rest) => (rest.split_once('}')?.0, 3),
        None => {
            let rest = &text[1..];
            let end = rest.find(|c: char| !c.is_ascii_alphanumeric()).unwrap_or(rest.len());
            (&rest[..end], 1)
        }
    };
    let name = inside.trim_end_matches(|c: char| c.is_ascii_digit());
    let digits = &inside[name.len()..];
    let placeholder = match name {
        "F" if digits.is_empty() => Placeholder::Number(None),
        "F" => {
            width(digits).map_or_else(|| unknown(None), |width| Placeholder::Number(Some(width)))
        }
        "FF" | "SF" | "T" | "N" | "SIMFRAME" => unknown(width(digits)),
        _ => return None,
    };
    Some((length + inside.len(), placeholder))
}

/// `<frame>`, `<frame04>` or `<F4>`. Other names, such as `<UDIM>`, are not frame numbers.
fn brackets(text: &str) -> Found {
    let (inside, _) = text[1..].split_once('>')?;
    let name = inside.trim_end_matches(|c: char| c.is_ascii_digit());
    let is_word = !name.is_empty() && name.chars().all(|c| c.is_ascii_alphabetic());
    let digits = &inside[name.len()..];
    let placeholder = match name.to_ascii_lowercase().as_str() {
        "frame" | "f" if digits.is_empty() => Placeholder::Number(None),
        "frame" | "f" => {
            width(digits).map_or_else(|| unknown(None), |width| Placeholder::Number(Some(width)))
        }
        _ => unknown(width(digits)),
    };
    is_word.then_some((inside.len() + 2, placeholder))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn placeholders_are_found_in_the_notations_of_other_programs() {
        let number = |name: &str| {
            find_placeholders(name).pop().map(|(at, placeholder)| (at.start, placeholder))
        };
        for (name, width) in [
            ("f_{}.npy", None),
            ("f_{:04}.npy", Some(4)),
            ("f_{:04d}.npy", Some(4)),
            ("f_{frame}.npy", None),
            ("f_{frame:03}.npy", Some(3)),
            ("f_%d.npy", None),
            ("f_%04d.npy", Some(4)),
            ("f_####.npy", Some(4)),
            ("f_#.npy", None),
            ("f_@@@.npy", Some(3)),
            ("f_$F.npy", None),
            ("f_$F4.npy", Some(4)),
            ("f_${F4}.npy", Some(4)),
            ("f_<frame>.npy", None),
            ("f_<F4>.npy", Some(4)),
        ] {
            assert_eq!(number(name), Some((2, Placeholder::Number(width))), "{name}");
        }
        assert_eq!(number("f_{time}.npy"), Some((2, Placeholder::Time)));
        for (name, better) in [
            ("f_{n}.npy", "{}"),
            ("f_{:4}.npy", "{:04}"),
            ("f_%4d.npy", "{:04}"),
            ("f_<UDIM>.npy", "{}"),
            ("f_$FF.npy", "{}"),
        ] {
            assert_eq!(number(name), Some((2, Placeholder::Unknown(better.into()))), "{name}");
        }
        for name in
            ["my%20data.npy", "100%done.ply", "C#.ply", "sim.h5part#12", "a@b.xyz", "a$b", "$"]
        {
            assert_eq!(number(name), None, "{name}");
        }
        for sign in ["#", "@"] {
            assert_eq!(number(&sign.repeat(21)), None);
        }
    }
}
