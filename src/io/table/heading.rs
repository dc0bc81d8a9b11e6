//! Reads the head of a table: where its rows start, its notation, and its columns.

use std::collections::HashMap;

use crate::io::ReadFault;
use crate::io::bytes::ByteView;
use crate::io::error::ADD_Z;
use crate::io::names::{Quantity, bare_names, quantities, repeated_position};
use crate::io::number::{Decimal, is_overflow};

use super::excerpt;
use super::fields::{
    LineFields, MOST_FIELDS, Separator, Syntax, is_comment, lines, rows_of, unquoted,
};
use super::header::{
    Comments, columns_in_comment, comment_text, name_plane, named_columns, names_of, plain_names,
    separator_of,
};
use super::unnamed::{UnnamedColumns, is_row, is_row_of_words, is_whole};

/// Maximum number of lines before the line of column names. Blank lines and comments do not count.
const HEADER_LINES: usize = 32;
/// Number of bytes that are searched for the head at first. This number is doubled while the
/// searched bytes contain too few lines.
pub const HEAD: usize = 64 << 10;
/// Maximum size, in bytes, of the head.
const LONGEST_HEAD: usize = 16 << 20;

/// The contents of the head of a table, which ends before the first row.
#[derive(Debug)]
pub struct Heading {
    /// Byte offset of the first row.
    pub start: usize,
    /// The number of lines above the first row.
    pub lines_above: u64,
    pub syntax: Syntax,
    pub columns: TableColumns,
    /// The number at the start of the first row, if it may be the number of the rows that follow.
    pub announced: Option<u64>,
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

/// A line that may be the first row.
#[derive(Clone, Copy)]
struct FirstRow<'a> {
    line: u64,
    start: usize,
    content: &'a [u8],
}

/// The lines above the first row that help to find its columns.
#[derive(Default)]
struct LinesAbove<'a> {
    comments: Comments<'a>,
    titles: Vec<TitleLine>,
    /// The line of column names, unless it is a comment.
    names: Option<&'a [u8]>,
    first: Option<FirstRow<'a>>,
}

impl TableColumns {
    /// Returns the columns with these names, or `None` if the names do not determine a unique
    /// position. Attributes with equal names get the numbers of their columns as suffixes:
    /// `a_column4` and `a_column7`.
    pub fn of(mut names: Vec<String>) -> Option<Self> {
        let mut found = quantities(&names);
        if found.is_none() {
            // A unit may follow a name without a blank, as in `x[m]`.
            names = bare_names(&names);
            found = quantities(&names);
        }
        let (position, mut attributes) = found?;
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
        let mut searched_bytes = HEAD;
        loop {
            let end = text.len().min(start.saturating_add(searched_bytes));
            let head = text.read(start..end)?;
            let known = lines(&head).filter(|(.., content)| !is_comment(content));
            let whole = end == text.len();
            if whole || searched_bytes >= LONGEST_HEAD || known.count() > HEADER_LINES + 2 {
                // The last line may be incomplete, so it is removed.
                let cut = head.iter().rposition(|&byte| byte == b'\n').map_or(0, |end| end + 1);
                let head = if whole { &head[..] } else { &head[..cut] };
                let found = Self::find(head)?;
                if found.start == head.len() && !whole {
                    let what =
                        format!("no row of numbers begins in the first {searched_bytes} bytes");
                    return Err(ReadFault::Line { line: 1, what });
                }
                return Ok(Self { start: start + found.start, ..found });
            }
            searched_bytes = searched_bytes.saturating_mul(2);
        }
    }

    fn find(text: &[u8]) -> Result<Self, ReadFault> {
        let mut above = LinesAbove::of(text);
        match above.first {
            None => above.without_rows(text.len()),
            Some(first) => {
                above.comments.truncate(first.line);
                let rows = &text[first.start..];
                let (syntax, columns, announced) = above.columns_of(first, rows)?;
                let syntax = with_decimals(syntax, rows, &columns);
                let (start, lines_above) = (first.start, first.line - 1);
                Ok(Self { start, lines_above, syntax, columns, announced })
            }
        }
    }
}

impl<'a> LinesAbove<'a> {
    /// Reads lines until the first row is certain.
    fn of(text: &'a [u8]) -> Self {
        let mut above = Self::default();
        let mut units = 1;
        let mut remaining_lines = HEADER_LINES;
        for (line, start, content) in lines(text) {
            if is_comment(content) {
                above.add_comment(line, content);
                continue;
            }
            let here = FirstRow { line, start, content };
            if above.names.is_some() {
                if units > 0 && is_units(content) {
                    units -= 1;
                    continue;
                }
                above.first = Some(here);
                break;
            }
            // A line with a single integer is not a row: it is the number of rows or steps.
            let row =
                !is_whole(content) && (is_row(content) || is_row_of_words(content, &text[start..]));
            if row && above.titles.is_empty() {
                above.first = Some(here);
                break;
            }
            if row {
                // Below a title without a position, this line may be the first row or another
                // title.
                above.first = above.first.or(Some(here));
            } else {
                above.add_title(line, content);
            }
            remaining_lines -= 1;
            if remaining_lines == 0 {
                break;
            }
        }
        above
    }

    fn add_comment(&mut self, line: u64, content: &'a [u8]) {
        let text = comment_text(content);
        let names = plain_names(&text);
        if repeated_position(&names).is_some() || name_plane(&names) {
            self.titles.push(TitleLine { line, names });
        }
        self.comments.push(line, text);
    }

    /// Adds a line that is neither a comment nor a row. It may contain the names of columns.
    fn add_title(&mut self, line: u64, content: &'a [u8]) {
        if named_columns(&String::from_utf8_lossy(content)).next().is_some() {
            self.names = Some(content);
            self.first = None;
        } else if self.first.is_none() {
            let names = names_of(content, separator_of(content));
            self.titles.push(TitleLine { line, names });
            self.comments.push_title(line, String::from_utf8_lossy(content));
        }
    }

    /// The head of a text of `length` bytes that contains no rows.
    fn without_rows(&self, length: usize) -> Result<Heading, ReadFault> {
        let named = self.names.map(String::from_utf8_lossy);
        let named = named.and_then(|names| named_columns(&names).next());
        let columns = match (named.or_else(|| self.comments.columns().next()), self.titles.first())
        {
            (None, Some(title)) => return Err(title.fault()),
            (columns, _) => columns.unwrap_or_else(|| TableColumns::unnamed(0, 3)),
        };
        let (syntax, announced) = (Syntax::BLANKS, None);
        Ok(Heading { start: length, lines_above: 0, syntax, columns, announced })
    }

    /// The notation and the columns of a table with these `rows`, and the number at the start of
    /// the first row, if it may be the number of rows below it.
    fn columns_of(
        &self,
        first: FirstRow,
        rows: &[u8],
    ) -> Result<(Syntax, TableColumns, Option<u64>), ReadFault> {
        let row = first.content;
        if let Some(names) = self.names {
            let (syntax, columns) = columns_below(names, row);
            return Ok((syntax, columns, None));
        }
        if let Some((syntax, columns)) = fitting(self.comments.columns(), row) {
            refuse_rows_above(&self.titles, columns.names.len())?;
            return Ok((syntax, columns, None));
        }
        let found = UnnamedColumns::of(row);
        let fields = found.map_or_else(
            || LineFields::new(row, Separator::of(row), 0).count(),
            |unnamed| unnamed.fields,
        );
        if let Some(title) = self.titles.iter().rfind(|title| title.names.len() == fields) {
            return Err(title.fault());
        }
        let fault = |what| ReadFault::Line { line: first.line, what };
        let Some(unnamed) = found else {
            let what = format!("expected x, y and z, but the line has {fields} fields");
            return Err(fault(if fields == 2 { format!("{what}; {ADD_Z}") } else { what }));
        };
        if fields > MOST_FIELDS {
            return Err(fault(format!("the line has more than {MOST_FIELDS} fields")));
        }
        refuse_rows_above(&self.titles, fields)?;
        if unnamed.has_decimal_commas(rows) {
            let what = "commas seem to be both decimal commas and separators; write decimal \
                        points, or separate the columns with semicolons";
            return Err(fault(what.to_owned()));
        }
        let x = unnamed.x_column(rows);
        if let Some(unclear) = self.comments.unclear(fields, x.as_ref().ok().copied()) {
            return Err(unclear);
        }
        let x = x.map_err(fault)?;
        let announced = unnamed.announced(rows).filter(|_| x == 0);
        Ok((unnamed.syntax, TableColumns::unnamed(x, fields), announced))
    }
}

/// The first item of `columns` that fits a row, and the notation of the row.
fn fitting(
    mut columns: impl Iterator<Item = TableColumns>,
    row: &[u8],
) -> Option<(Syntax, TableColumns)> {
    columns.find_map(|columns| Some((Syntax::of_row(row, &columns)?, columns)))
}

/// The notation and the columns of a row below a line of names. A name in this line may stand for
/// all components of a vector.
fn columns_below(names: &[u8], row: &[u8]) -> (Syntax, TableColumns) {
    let text = String::from_utf8_lossy(names);
    fitting(named_columns(&text).chain(columns_in_comment(&text)), row).unwrap_or_else(|| {
        let columns = named_columns(&text).next().expect("the line names a position");
        let shown = Separator::of(row);
        let separator = if row.contains(&b'\t') { separator_of(names) } else { shown };
        (Syntax { separator, decimal: Decimal::Point }, columns)
    })
}

/// The columns of rows without column names. `None` if the first line is not a row.
///
/// # Errors
/// [`ReadFault::Unsupported`] if rows start with integers that may be either atomic numbers or x
/// coordinates.
pub fn unnamed_columns(rows: &[u8]) -> Result<Option<(Syntax, TableColumns)>, ReadFault> {
    let Some((_, _, row)) = lines(rows).next() else { return Ok(None) };
    let Some(found) = UnnamedColumns::of(row) else { return Ok(None) };
    let first = found.x_column_of_xyz(rows).ok_or_else(|| {
        let what = "it is unclear whether these integers are x, y and z or begin with an atomic \
                    number; name the columns with Properties=";
        ReadFault::Unsupported(what.to_owned())
    })?;
    let syntax = with_decimals(found.syntax, rows, &TableColumns::unnamed(first, found.fields));
    Ok(Some((syntax, TableColumns::unnamed(first, found.fields))))
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

/// Whether a line below the names is a line of units: none of its fields is a number.
fn is_units(line: &[u8]) -> bool {
    Syntax::ALL.iter().all(|syntax| {
        LineFields::new(line, syntax.separator, 0).all(|field| {
            let field = unquoted(field);
            !is_overflow(field) && syntax.number(field).is_none_or(|_| field.is_empty())
        })
    })
}

/// Returns an error if a line above the first row looks like a row with an invalid field.
fn refuse_rows_above(titles: &[TitleLine], fields: usize) -> Result<(), ReadFault> {
    let is_number =
        |name: &String| is_overflow(name.as_bytes()) || Syntax::BLANKS.is_number(name.as_bytes());
    let row = titles
        .iter()
        .find(|title| title.names.len() == fields && title.names.iter().any(is_number));
    row.map_or(Ok(()), |row| Err(row.fault()))
}

impl TitleLine {
    fn fault(&self) -> ReadFault {
        if let Some(name) = repeated_position(&self.names) {
            let what = format!(
                "several columns are named {name:?}; rename those that are not \
                               the position"
            );
            return ReadFault::Line { line: self.line, what };
        }
        let shown: Vec<_> =
            self.names.iter().take(8).map(|name| excerpt(name.as_bytes())).collect();
        let mut what = format!(
            "expected three numbers, or the names of columns x, y and z, found {}",
            shown.join(", ")
        );
        if name_plane(&self.names) {
            what += &format!("; {ADD_Z}");
        }
        ReadFault::Line { line: self.line, what }
    }
}
