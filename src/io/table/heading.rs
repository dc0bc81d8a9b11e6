//! Reads the head of a table: where its rows start, its notation, and its columns.

use std::collections::HashMap;

use crate::io::ReadFault;
use crate::io::bytes::ByteView;
use crate::io::names::{Quantity, quantities, repeated_position};
use crate::io::number::{Decimal, is_overflow};

use super::excerpt;
use super::fields::{LineFields, Separator, Syntax, is_comment, lines, unquoted};

/// Maximum number of lines before the line of column names. Blank lines and comments do not count.
const HEADER_LINES: usize = 32;
/// Number of bytes that are searched for the head at first. This number is doubled while the
/// searched bytes contain too few lines.
pub const HEAD: usize = 64 << 10;
/// Maximum size, in bytes, of the head.
const LONGEST_HEAD: usize = 16 << 20;
/// Maximum number of fields in a line of a table.
pub const MOST_FIELDS: usize = 4096;
/// Number of rows that are sampled to find out what the first columns contain.
const SAMPLED_ROWS: usize = 256;

/// The contents of the head of a table, which ends before the first row.
#[derive(Debug)]
pub struct Heading {
    /// Byte offset of the first row.
    pub start: usize,
    /// The number of lines above the first row.
    pub lines_above: u64,
    pub syntax: Syntax,
    pub columns: TableColumns,
}

/// The columns of a table, and the quantities that they form.
#[derive(Debug)]
pub struct TableColumns {
    /// Names of all columns.
    pub names: Vec<String>,
    pub position: Quantity,
    pub attributes: Vec<Quantity>,
}

/// A line above the first row that is not a row of numbers.
struct TitleLine {
    line: u64,
    names: Vec<String>,
}

/// The layout of a row in a table without column names.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct UnnamedColumns {
    syntax: Syntax,
    /// The index of the x column. The y and z columns follow it.
    first: usize,
    fields: usize,
}

impl TableColumns {
    /// Returns the columns with these names, or `None` if the names give no unique position.
    /// Attributes with equal names get the numbers of their columns as suffixes: `a_column4` and
    /// `a_column7`.
    pub fn of(names: Vec<String>) -> Option<Self> {
        let (position, mut attributes) = quantities(&names)?;
        let mut times = HashMap::new();
        for attribute in &attributes {
            *times.entry(attribute.name.clone()).or_insert(0) += 1;
        }
        for attribute in attributes.iter_mut().filter(|a| times[&a.name] > 1) {
            attribute.name = format!("{}_column{}", attribute.name, attribute.columns[0] + 1);
        }
        Some(Self { names, position, attributes })
    }

    /// Columns of a table without names. The three columns from `first` on are the position.
    pub fn unnamed(first: usize, fields: usize) -> Self {
        let mut names: Vec<String> = (1..=fields).map(|column| column.to_string()).collect();
        for (name, axis) in names[first..].iter_mut().zip(["x", "y", "z"]) {
            axis.clone_into(name);
        }
        let position = Quantity { name: String::new(), columns: (first..first + 3).collect() };
        Self { names, position, attributes: Vec::new() }
    }

    /// Removes and returns the attributes that have text instead of numbers in the first rows.
    pub fn take_texts(&mut self, rows: &[u8], syntax: Syntax) -> Vec<Quantity> {
        let mut numbers = vec![false; self.names.len()];
        let mut texts = numbers.clone();
        for fields in rows_of(rows, syntax, self.names.len()) {
            for (column, field) in fields.enumerate().take(self.names.len()) {
                numbers[column] |= syntax.is_number(field) || is_overflow(field);
                texts[column] |= syntax.number(field).is_none();
            }
        }
        let is_text = |a: &mut Quantity| a.columns.iter().any(|&c| texts[c] && !numbers[c]);
        self.attributes.extract_if(.., is_text).collect()
    }
}

impl Heading {
    /// Finds the head of the table that starts at byte `start` of `text`. Reads more than [`HEAD`]
    /// bytes only if these contain too few lines.
    pub fn of(text: ByteView, start: usize) -> Result<Self, ReadFault> {
        let mut looked_at = HEAD;
        loop {
            let end = text.len().min(start.saturating_add(looked_at));
            let head = text.read(start..end)?;
            let known = lines(&head).filter(|(.., content)| !is_comment(content));
            let whole = end == text.len();
            if whole || looked_at >= LONGEST_HEAD || known.count() > HEADER_LINES + 2 {
                // The last line may be incomplete, so it is removed.
                let cut = head.iter().rposition(|&byte| byte == b'\n').map_or(0, |end| end + 1);
                let head = if whole { &head[..] } else { &head[..cut] };
                let found = Self::find(head)?;
                if found.start == head.len() && !whole {
                    let what = format!("no row of numbers begins in the first {looked_at} bytes");
                    return Err(ReadFault::Line { line: 1, what });
                }
                return Ok(Self { start: start + found.start, ..found });
            }
            looked_at = looked_at.saturating_mul(2);
        }
    }

    fn find(text: &[u8]) -> Result<Self, ReadFault> {
        let (mut comment, mut named) = (None, None);
        let mut titles: Vec<TitleLine> = Vec::new();
        let mut first = None;
        let mut units = 1;
        let mut left = HEADER_LINES;
        for (line, start, content) in lines(text) {
            if is_comment(content) {
                let content = content.trim_ascii_start();
                let marks = content.iter().take_while(|byte| b"#%!/".contains(byte)).count();
                let content = &content[marks..];
                let names = names_in_brackets(content)
                    .unwrap_or_else(|| names_of(content, separator_of(content)));
                if repeated_position(&names).is_some() || name_plane(&names) {
                    titles.push(TitleLine { line, names });
                } else {
                    comment = TableColumns::of(names).or(comment);
                }
                continue;
            }
            if named.is_some() {
                if units > 0 && is_units(content) {
                    units -= 1;
                    continue;
                }
                first = Some((line, start, content));
                break;
            }
            // A line with a single integer gives the number of rows or steps.
            let row =
                !is_whole(content) && (is_row(content) || is_row_of_words(content, &text[start..]));
            if row && titles.is_empty() {
                first = Some((line, start, content));
                break;
            }
            if row {
                // Below a title without a position, this line may be the first row or another
                // title.
                first = first.or(Some((line, start, content)));
            } else {
                let names = names_of(content, separator_of(content));
                if quantities(&names).is_some() {
                    named = Some((names, content));
                    first = None;
                } else if first.is_none() {
                    titles.push(TitleLine { line, names });
                }
            }
            left -= 1;
            if left == 0 {
                break;
            }
        }
        let Some((line, start, row)) = first else {
            let names = named.and_then(|(names, _)| TableColumns::of(names)).or(comment);
            return match (names, titles.first()) {
                (None, Some(title)) => Err(title.refused()),
                (names, _) => Ok(Self {
                    start: text.len(),
                    lines_above: 0,
                    syntax: Syntax::BLANKS,
                    columns: names.unwrap_or_else(|| TableColumns::unnamed(0, 3)),
                }),
            };
        };
        let rows = &text[start..];
        let at = |syntax: Syntax, columns: TableColumns| {
            let syntax = with_decimals(syntax, rows, &columns);
            Self { start, lines_above: line - 1, syntax, columns }
        };
        if let Some((names, content)) = named {
            let columns = TableColumns::of(names).expect("they name a position");
            let found = Syntax::of_row(row, &columns).map(|syntax| (syntax, columns));
            // Names that are separated by blanks may be aligned with tabs.
            let aligned = || {
                let columns = TableColumns::of(names_of(content, Separator::Blanks))?;
                Some((Syntax::of_row(row, &columns)?, columns))
            };
            let (syntax, columns) = match found.or_else(aligned) {
                Some(found) => found,
                None => {
                    let separator = separator_of(content);
                    let columns = TableColumns::of(names_of(content, separator)).expect("as above");
                    let shown = Separator::of(row);
                    let separator = if row.contains(&b'\t') { separator } else { shown };
                    (Syntax { separator, decimal: Decimal::Point }, columns)
                }
            };
            return Ok(at(syntax, columns));
        }
        if let Some(columns) = comment
            && let Some(syntax) = Syntax::of_row(row, &columns)
        {
            refuse_rows_above(&titles, columns.names.len())?;
            return Ok(at(syntax, columns));
        }
        let found = unnamed(row);
        let fields = found.map_or_else(
            || LineFields::new(row, Separator::of(row), 0).count(),
            |unnamed| unnamed.fields,
        );
        if let Some(title) = titles.iter().rfind(|title| title.names.len() == fields) {
            return Err(title.refused());
        }
        let Some(unnamed) = found else {
            let what = format!("{fields} fields where x, y and z are expected");
            return Err(ReadFault::Line { line, what });
        };
        if unnamed.fields > MOST_FIELDS {
            let what = format!("more than {MOST_FIELDS} fields");
            return Err(ReadFault::Line { line, what });
        }
        refuse_rows_above(&titles, unnamed.fields)?;
        let first = if counts(rows, unnamed) { 1 } else { unnamed.first };
        Ok(at(unnamed.syntax, TableColumns::unnamed(first, unnamed.fields)))
    }
}

/// The columns of rows without column names. `None` if the first line is not a row.
///
/// # Errors
/// [`ReadFault::Unsupported`] if rows start with integers that may be either atomic numbers or x
/// coordinates.
pub fn unnamed_columns(rows: &[u8]) -> Result<Option<(Syntax, TableColumns)>, ReadFault> {
    let Some((_, _, row)) = lines(rows).next() else { return Ok(None) };
    let Some(found) = unnamed(row) else { return Ok(None) };
    let numbers_only = found.first == 0 && found.fields > 3;
    let first = match (numbers_only, has_whole_first(rows, found)) {
        (true, true) if !has_fractions(rows, found) => {
            let what = "rows of integers can be x, y and z, or begin with an atomic number; \
                        name the columns by Properties=";
            return Err(ReadFault::Unsupported(what.to_owned()));
        }
        // The first column has atomic numbers or counts the rows. In other cases, it is x, as in
        // sorted rows.
        (true, true) if are_elements(rows, found) || counts(rows, found) => 1,
        _ => found.first,
    };
    let syntax = with_decimals(found.syntax, rows, &TableColumns::unnamed(first, found.fields));
    Ok(Some((syntax, TableColumns::unnamed(first, found.fields))))
}

/// The names in a line.
pub fn names_of(line: &[u8], separator: Separator) -> Vec<String> {
    let name = |name| String::from_utf8_lossy(unquoted(name)).into_owned();
    LineFields::new(line, separator, 0).take(MOST_FIELDS).map(name).collect()
}

/// The names in a line such as `<x> <y> <velocity> <velocity>`. deal.II writes these lines, and
/// gives all components of a vector the same name.
fn names_in_brackets(line: &[u8]) -> Option<Vec<String>> {
    let inside = line.trim_ascii().strip_prefix(b"<")?.strip_suffix(b">")?;
    let inside = String::from_utf8_lossy(inside);
    let names: Vec<&str> = inside.split("> <").take(MOST_FIELDS).collect();
    let runs = names.chunk_by(|one, next| one == next);
    let components = |run: &[&str]| match run {
        [only] => vec![(*only).to_owned()],
        several => (0..several.len()).map(|index| format!("{}:{index}", several[0])).collect(),
    };
    Some(runs.flat_map(components).collect())
}

/// Whether names include `x` and `y`, but form no position in three dimensions.
fn name_plane(names: &[String]) -> bool {
    let has = |axis: &str| names.iter().any(|name| name.eq_ignore_ascii_case(axis));
    has("x") && has("y") && quantities(names).is_none()
}

/// The separator of a line of names. A tab has priority over blanks, because names may contain
/// blanks.
fn separator_of(line: &[u8]) -> Separator {
    match Separator::of(line) {
        Separator::Blanks if line.contains(&b'\t') => Separator::Byte(b'\t'),
        separator => separator,
    }
}

impl Syntax {
    /// The first notation in which `row` has one field per column, and numbers in the columns of
    /// the position.
    fn of_row(row: &[u8], columns: &TableColumns) -> Option<Self> {
        Self::ALL.into_iter().find(|syntax| {
            let mut fields = 0;
            let fits = LineFields::new(row, syntax.separator, columns.names.len()).all(|field| {
                fields += 1;
                !columns.position.columns.contains(&(fields - 1)) || syntax.number(field).is_some()
            });
            fits && fields == columns.names.len()
        })
    }
}

/// The fields of each row. Comments are skipped.
fn rows_of(
    rows: &[u8],
    syntax: Syntax,
    expected: usize,
) -> impl Iterator<Item = impl Iterator<Item = &[u8]>> {
    lines(rows)
        .filter(|(.., content)| !is_comment(content))
        .map(move |(.., content)| LineFields::new(content, syntax.separator, expected))
}

/// Returns `syntax` with the decimal separator, comma or point, that occurs first in the rows.
fn with_decimals(syntax: Syntax, rows: &[u8], columns: &TableColumns) -> Syntax {
    let comma = Syntax { decimal: Decimal::Comma, ..syntax };
    if syntax.separator == Separator::Byte(b',') {
        return syntax;
    }
    let is_wanted = |column: &usize| {
        let attributes = columns.attributes.iter().flat_map(|attribute| &attribute.columns);
        columns.position.columns.iter().chain(attributes).any(|wanted| wanted == column)
    };
    let wanted: Vec<bool> = (0..columns.names.len()).map(|column| is_wanted(&column)).collect();
    for fields in rows_of(rows, syntax, columns.names.len()) {
        for (field, _) in fields.zip(&wanted).filter(|(_, wanted)| **wanted) {
            match (Syntax { decimal: Decimal::Point, ..syntax }.number(field), comma.number(field))
            {
                (None, Some(_)) => return comma,
                (Some(_), None) => return Syntax { decimal: Decimal::Point, ..syntax },
                _ => {}
            }
        }
    }
    syntax
}

/// The layout of a row without column names. The position consists of three numbers at the start of
/// the row, after a word, or after an integer and a word.
fn unnamed(row: &[u8]) -> Option<UnnamedColumns> {
    let all = Syntax::ALL.map(|syntax| {
        let fields = LineFields::new(row, syntax.separator, 0).take(MOST_FIELDS + 1);
        (syntax, fields.collect::<Vec<_>>())
    });
    let between_blanks = LineFields::new(row, Separator::Blanks, 0).count();
    let found = |first: fn(Syntax, &[&[u8]]) -> Option<usize>| {
        all.iter().find_map(|(syntax, fields)| {
            // Tries tabs as separators only if a cell is empty or contains blanks.
            if syntax.separator == Separator::Byte(b'\t') && fields.len() == between_blanks {
                return None;
            }
            let first = first(*syntax, fields)?;
            let position = fields.get(first..first + 3)?;
            let are_numbers = position.iter().all(|field| syntax.is_number(field));
            are_numbers.then_some(UnnamedColumns { syntax: *syntax, first, fields: fields.len() })
        })
    };
    found(|_, _| Some(0)).or_else(|| {
        found(|_, fields| match fields {
            [word, ..] if is_word(word) => Some(1),
            [number, word, ..] if is_whole(number) && is_word(word) => Some(2),
            _ => None,
        })
    })
}

/// Whether a line starts with three numbers, or contains only numbers.
pub fn is_row(line: &[u8]) -> bool {
    unnamed(line).is_some_and(|row| row.first == 0) || {
        let syntax = Syntax { separator: Separator::of(line), decimal: Decimal::Point };
        LineFields::new(line, syntax.separator, 0).take(3).all(|field| syntax.is_number(field))
    }
}

/// Whether a line starts with words and all later lines have the same layout. A line that starts
/// with words is a title if later lines differ.
fn is_row_of_words(line: &[u8], rows: &[u8]) -> bool {
    unnamed(line).is_some_and(|row| {
        row.first > 0
            && lines(rows).take(HEADER_LINES).all(|(.., other)| unnamed(other) == Some(row))
    })
}

/// Whether a line below the names is a line of units: none of its fields is a number.
fn is_units(line: &[u8]) -> bool {
    Syntax::ALL.iter().all(|syntax| {
        LineFields::new(line, syntax.separator, 0).all(|field| {
            let field = unquoted(field);
            !is_overflow(field) && syntax.number(field).is_none_or(|_| field.is_empty())
        })
    })
}

fn is_word(field: &[u8]) -> bool {
    let field = unquoted(field);
    field.first().is_some_and(u8::is_ascii_alphabetic) && Syntax::BLANKS.number(field).is_none()
}

fn is_whole(field: &[u8]) -> bool {
    !field.is_empty() && field.len() < 20 && field.iter().all(u8::is_ascii_digit)
}

/// Whether the first column of the sampled rows contains only integers.
fn has_whole_first(rows: &[u8], row: UnnamedColumns) -> bool {
    rows_of(rows, row.syntax, row.fields)
        .take(SAMPLED_ROWS)
        .all(|mut fields| fields.next().is_some_and(is_whole))
}

/// Whether the first column of the sampled rows contains only possible atomic numbers.
fn are_elements(rows: &[u8], row: UnnamedColumns) -> bool {
    let number = |field: &[u8]| std::str::from_utf8(field).ok()?.parse::<u64>().ok();
    rows_of(rows, row.syntax, row.fields)
        .take(SAMPLED_ROWS)
        .all(|mut fields| fields.next().and_then(number).is_some_and(|n| (1..=118).contains(&n)))
}

/// Whether each of the three columns after the first contains numbers with fractions.
fn has_fractions(rows: &[u8], row: UnnamedColumns) -> bool {
    let mut fractions = [false; 3];
    for fields in rows_of(rows, row.syntax, row.fields).take(SAMPLED_ROWS) {
        for (field, has) in fields.skip(1).zip(&mut fractions) {
            *has |= row.syntax.is_number(field) && !is_whole(field);
        }
    }
    fractions == [true; 3]
}

/// Whether, in rows without column names, the first column numbers the rows and the position
/// follows it.
fn counts(rows: &[u8], row: UnnamedColumns) -> bool {
    let mut seen = std::collections::HashSet::new();
    let sample = || rows_of(rows, row.syntax, row.fields).take(SAMPLED_ROWS);
    let are_different =
        sample().all(|mut fields| fields.next().is_some_and(|number| seen.insert(number.to_vec())));
    row.first == 0
        && row.fields > 3
        && sample().count() > 2
        && are_different
        && has_whole_first(rows, row)
        && has_fractions(rows, row)
}

/// Returns an error if a line above the first row looks like a row with an invalid field.
fn refuse_rows_above(titles: &[TitleLine], fields: usize) -> Result<(), ReadFault> {
    let is_number =
        |name: &String| is_overflow(name.as_bytes()) || Syntax::BLANKS.is_number(name.as_bytes());
    let row = titles
        .iter()
        .find(|title| title.names.len() == fields && title.names.iter().any(is_number));
    row.map_or(Ok(()), |row| Err(row.refused()))
}

impl TitleLine {
    fn refused(&self) -> ReadFault {
        if let Some(name) = repeated_position(&self.names) {
            let what = format!(
                "several columns are named {name:?}; rename those that are not \
                               the position"
            );
            return ReadFault::Line { line: self.line, what };
        }
        let shown: Vec<_> =
            self.names.iter().take(8).map(|name| excerpt(name.as_bytes())).collect();
        let what = format!(
            "neither three numbers nor the names of columns x, y and z: {}",
            shown.join(", ")
        );
        ReadFault::Line { line: self.line, what }
    }
}
