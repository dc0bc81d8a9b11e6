//! Finds the position in rows without column names.

use std::collections::HashSet;
use std::ops::Range;

use crate::io::number::Decimal;

use super::fields::{
    LineFields, MOST_FIELDS, Separator, Syntax, is_comment, lines, rows_of, unquoted,
};

/// Number of rows that are sampled to find out what the first columns contain.
const SAMPLED_ROWS: usize = 256;
/// Maximum number of columns that are sampled.
const SAMPLED_COLUMNS: usize = 16;
/// Minimum number of rows in a large sample. In a large sample, coordinates rarely have a pattern
/// by accident.
const MANY_ROWS: usize = 16;
/// Number of lines that must have the same layout so that a line that starts with words is a row,
/// not a title.
const ROWS_OF_WORDS: usize = 32;
/// Number of columns that a position and a vector, such as a velocity, have together.
const POSITION_AND_VECTOR: usize = 6;

/// The layout of a row in a table without column names.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct UnnamedColumns {
    pub syntax: Syntax,
    /// The index of the first column of the position, or of the row number before it.
    pub first: usize,
    pub fields: usize,
}

impl UnnamedColumns {
    /// The layout of a row. `None` if it does not contain three numbers at its start, after a word,
    /// or after an integer and a word.
    pub fn of(row: &[u8]) -> Option<Self> {
        let all = Syntax::ALL.map(|syntax| {
            let fields = LineFields::new(row, syntax.separator, 0).take(MOST_FIELDS + 1);
            (syntax, fields.collect::<Vec<_>>())
        });
        let between_blanks = LineFields::new(row, Separator::Blanks, 0).count();
        let found = |first: fn(Syntax, &[&[u8]]) -> Option<usize>| {
            all.iter().find_map(|(syntax, fields)| {
                // Try tabs as separators only if a cell is empty or contains blanks.
                if syntax.separator == Separator::Byte(b'\t') && fields.len() == between_blanks {
                    return None;
                }
                let first = first(*syntax, fields)?;
                let position = fields.get(first..first + 3)?;
                let are_numbers = position.iter().all(|field| syntax.is_number(field));
                are_numbers.then_some(Self { syntax: *syntax, first, fields: fields.len() })
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

    /// Whether the rows seem to have decimal commas, although the comma also separates the fields,
    /// as in `0,517342, 0,723111, 0,534120`. Then all fields are integers, and a blank follows only
    /// every second comma, or a fraction starts with a zero.
    pub fn has_decimal_commas(self, rows: &[u8]) -> bool {
        if self.syntax.separator != Separator::Byte(b',') || !self.fields.is_multiple_of(2) {
            return false;
        }
        let mut evidence = false;
        for (.., row) in lines(rows).filter(|(.., row)| !is_comment(row)).take(SAMPLED_ROWS) {
            let fields: Vec<&[u8]> = row.split(|&byte| byte == b',').collect();
            let is_pair = |pair: &[&[u8]]| {
                let number = pair[0].trim_ascii();
                is_whole(number.strip_prefix(b"-").unwrap_or(number)) && is_whole(pair[1])
            };
            if fields.len() != self.fields || !fields.chunks_exact(2).all(is_pair) {
                return false;
            }
            let has_blank = |field: &&[u8]| field.first().is_some_and(u8::is_ascii_whitespace);
            let are_apart = fields.iter().skip(2).step_by(2).all(has_blank);
            let starts_with_zero = |field: &&[u8]| field.len() > 1 && field.starts_with(b"0");
            evidence |= are_apart || fields.iter().skip(1).step_by(2).any(starts_with_zero);
        }
        evidence
    }

    /// The index of the x column in a table whose first rows are `rows`.
    ///
    /// # Errors
    /// A description of the columns that may contain identifiers or types instead of coordinates.
    pub fn x_column(self, rows: &[u8]) -> Result<usize, String> {
        // Three columns can only be the position.
        if self.fields < self.first + 4 {
            return Ok(self.first);
        }
        let sample = Sample::of(rows, self);
        match sample.leading_columns() {
            LeadingColumns::Position => Ok(self.first),
            LeadingColumns::RowNumber => Ok(self.first + 1),
            LeadingColumns::Unclear(columns) => Err(sample.describe(&columns, self)),
        }
    }

    /// The first number of the first row, if it may be the number of rows below it instead of x.
    ///
    /// The number must be an integer without a sign. Either no other x coordinate is such an
    /// integer, or the number is far from all other x coordinates.
    pub fn announced(self, rows: &[u8]) -> Option<u64> {
        let first = rows_of(rows, self.syntax, self.fields).next()?.next()?;
        let count = std::str::from_utf8(first).ok().filter(|_| is_whole(first))?.parse().ok()?;
        let sample = Sample::of(rows, self);
        let x = sample.columns.first().filter(|_| self.first == 0)?;
        let others = x.values[1..].iter();
        let least = others.clone().copied().fold(f64::INFINITY, f64::min);
        let most = others.copied().fold(f64::NEG_INFINITY, f64::max);
        let span = most - least;
        let is_far = !(least - span..=most + span).contains(&(count as f64));
        (x.unsigned == 1 || is_far).then_some(count)
    }

    /// The index of the x column in a frame of an XYZ file whose rows are `rows`. `None` if the
    /// rows start with integers that may be either atomic numbers or x coordinates.
    pub fn x_column_of_xyz(self, rows: &[u8]) -> Option<usize> {
        let sample = Sample::of(rows, self);
        if self.first > 0 || self.fields < 4 || !sample.columns[0].is_unsigned() {
            return Some(self.first);
        }
        // The first column is skipped if it has atomic numbers or counts the rows. Otherwise, it is
        // x: for example, the first rows of a table that is sorted by x can all have x = 0.
        let is_skipped = sample.starts_with_elements() || sample.starts_with_row_numbers();
        (1..4).all(|column| sample.columns[column].has_reals()).then_some(usize::from(is_skipped))
    }
}

/// Whether a line starts with three numbers, or contains only numbers.
pub fn is_row(line: &[u8]) -> bool {
    UnnamedColumns::of(line).is_some_and(|row| row.first == 0) || {
        let syntax = Syntax { separator: Separator::of(line), decimal: Decimal::Point };
        LineFields::new(line, syntax.separator, 0).take(3).all(|field| syntax.is_number(field))
    }
}

/// Whether a line starts with words and all later lines have the same layout. A line that starts
/// with words is a title if later lines differ.
pub fn is_row_of_words(line: &[u8], rows: &[u8]) -> bool {
    UnnamedColumns::of(line).is_some_and(|row| {
        row.first > 0
            && lines(rows)
                .take(ROWS_OF_WORDS)
                .all(|(.., other)| UnnamedColumns::of(other) == Some(row))
    })
}

fn is_word(field: &[u8]) -> bool {
    let field = unquoted(field);
    field.first().is_some_and(u8::is_ascii_alphabetic) && Syntax::BLANKS.number(field).is_none()
}

/// Whether a field is an integer without a sign.
pub fn is_whole(field: &[u8]) -> bool {
    !field.is_empty() && field.len() < 20 && field.iter().all(u8::is_ascii_digit)
}

/// The meaning of the columns at the start of a row.
#[derive(Debug, PartialEq, Eq)]
enum LeadingColumns {
    Position,
    /// A row number or an identifier, followed by the position.
    RowNumber,
    /// Columns, by their indices in the sample, that may be identifiers, types or flags.
    Unclear(Vec<usize>),
}

/// The numeric values in the first rows of the table. The columns start with
/// [`UnnamedColumns::first`].
#[derive(Debug)]
struct Sample {
    columns: Vec<SampledColumn>,
    rows: usize,
}

/// The fields of a column in the sampled rows.
#[derive(Debug, Default)]
struct SampledColumn {
    /// The numbers. NaN for a field without a number.
    values: Vec<f64>,
    /// For each field, a number that is the same for equal fields. Different integers without a
    /// sign have different numbers, even if they round to the same f64.
    keys: Vec<u64>,
    /// Number of fields that are numbers.
    numbers: usize,
    /// Number of fields that are integers, with or without a sign.
    integers: usize,
    /// Number of fields that are integers without a sign.
    unsigned: usize,
}

impl SampledColumn {
    fn push(&mut self, field: &[u8], syntax: Syntax) {
        let field = unquoted(field);
        let comma = Syntax { decimal: Decimal::Comma, ..syntax };
        let number = syntax.number(field).or_else(|| comma.number(field));
        let value = number.unwrap_or(f64::NAN);
        let digits = field.strip_prefix(b"-").or(field.strip_prefix(b"+")).unwrap_or(field);
        let exact = std::str::from_utf8(field).ok().filter(|_| is_whole(field));
        let exact = exact.and_then(|digits| digits.parse().ok());
        self.values.push(value);
        self.keys.push(exact.unwrap_or(value.to_bits()));
        self.numbers += usize::from(syntax.is_number(field) || comma.is_number(field));
        self.integers += usize::from(is_whole(digits));
        self.unsigned += usize::from(is_whole(field));
    }

    /// Whether all fields are integers without a sign.
    fn is_unsigned(&self) -> bool {
        self.unsigned == self.values.len()
    }

    /// Whether all fields are written as integers.
    fn is_integer(&self) -> bool {
        self.integers == self.values.len()
    }

    /// Whether all numbers are whole, even if they are written like `1.0` or `1e0`.
    fn is_whole(&self) -> bool {
        self.values.iter().all(|value| value.fract() == 0.0)
    }

    /// Whether at least one field is a number other than an integer without a sign, for example
    /// `-1` or `0.5`.
    fn has_reals(&self) -> bool {
        self.numbers > self.unsigned
    }

    fn has_fractions(&self) -> bool {
        self.values.iter().any(|value| value.is_finite() && value.fract() != 0.0)
    }

    fn distinct(&self) -> usize {
        self.keys.iter().collect::<HashSet<_>>().len()
    }

    fn varies(&self) -> bool {
        self.distinct() > 1
    }

    /// Whether each number is larger than the previous number.
    fn grows(&self) -> bool {
        self.values.is_sorted_by(|a, b| a < b)
    }

    /// Whether each number is the previous number plus one.
    fn counts_up(&self) -> bool {
        self.values.windows(2).all(|pair| pair[1] == pair[0] + 1.0)
    }
}

impl Sample {
    fn of(rows: &[u8], row: UnnamedColumns) -> Self {
        let width = (row.fields - row.first).min(SAMPLED_COLUMNS);
        let mut columns: Vec<_> = (0..width).map(|_| SampledColumn::default()).collect();
        let mut count = 0;
        for fields in rows_of(rows, row.syntax, row.fields).take(SAMPLED_ROWS) {
            let mut fields = fields.skip(row.first).peekable();
            if fields.peek().is_some_and(|field| field.is_empty()) {
                continue;
            }
            for column in &mut columns {
                column.push(fields.next().unwrap_or_default(), row.syntax);
            }
            count += 1;
        }
        Self { columns, rows: count }
    }

    /// Distinguishes identifiers, types and flags from coordinates.
    ///
    /// Each rule needs evidence that a column is not a coordinate. Whole numbers alone are not
    /// evidence, because x can be whole in a lattice, and constant in a plane. The evidence is as
    /// follows.
    ///
    /// - An identifier has a different whole number in each row. Coordinates of particles repeat,
    ///   because particles with the same x differ in y or z.
    /// - Positions differ between rows. Combinations of types and flags repeat.
    /// - In the same file, a program writes all coordinates in the same way. If y and z have
    ///   fractions, x has fractions too, except in a plane.
    /// - Particles with the same x fill a plane. This is rare, except in the first rows of a
    ///   lattice that is sorted by x.
    ///
    /// A single identifier before three columns of real numbers is skipped. In all other cases,
    /// the number of columns before the position is unknown. Two constant columns are x and y if
    /// the next column grows from row to row, as z does in a lattice.
    fn leading_columns(&self) -> LeadingColumns {
        if self.starts_with_row_numbers() {
            // The second column can be a type with a sign.
            let [x, y, z] = [1, 2, 3].map(|column| self.columns[column].is_integer());
            return if x && !(y && z) {
                LeadingColumns::Unclear(vec![0, 1])
            } else {
                LeadingColumns::RowNumber
            };
        }
        let whole = (0..self.columns.len()).take_while(|&column| !self.is_real(0, column)).count();
        let are_followed = (whole..whole + 3).all(|column| self.is_real(0, column));
        let is_line = || {
            let are_constant = self.columns[..whole].iter().all(|c| c.distinct() == 1);
            whole == 2 && are_constant && self.columns[2].grows()
        };
        if whole >= 2 && are_followed && !self.starts_with_lattice(whole.min(3)) && !is_line() {
            return LeadingColumns::Unclear((0..whole).collect());
        }
        let identifier = (0..3).find(|&column| self.is_identifier_instead_of_coordinate(column));
        let is_type = whole == 1 && self.starts_with_type() || self.starts_with_constant();
        let unclear = identifier.or(is_type.then_some(0));
        unclear.map_or(LeadingColumns::Position, |column| LeadingColumns::Unclear(vec![column]))
    }

    /// Whether the first column numbers the rows or identifies particles, and real numbers follow
    /// it.
    fn starts_with_row_numbers(&self) -> bool {
        let [first, rest @ ..] = &self.columns[..] else { return false };
        let are_real = match first.is_unsigned() {
            true => rest.iter().take(3).all(SampledColumn::has_reals),
            // In a lattice, particles on a line along x have constant y and z. Require columns that
            // vary, so that the x of these particles is not taken for a row number.
            false => (1..4).all(|column| self.is_real(0, column) && self.columns[column].varies()),
        };
        rest.len() >= 3 && self.rows > 2 && are_real && self.is_identifier(0)
    }

    /// Whether the first column contains only possible atomic numbers.
    fn starts_with_elements(&self) -> bool {
        self.columns[0].values.iter().all(|value| (1.0..=118.0).contains(value))
    }

    /// Whether a column has a different whole number in each row. Real numbers that are whole by
    /// accident do not count.
    fn is_identifier(&self, column: usize) -> bool {
        let column = &self.columns[column];
        self.rows > 1
            && column.is_whole()
            && (column.is_integer() || self.rows >= MANY_ROWS)
            && column.distinct() == self.rows
    }

    /// Whether a column contains real numbers, in contrast to the column `other`. If `other` has
    /// integers, `1.0` is a real number. Otherwise, only fractions distinguish the columns.
    fn is_real(&self, other: usize, column: usize) -> bool {
        self.columns.get(column).is_some_and(|column| match self.columns[other].is_integer() {
            true => column.numbers > column.integers,
            false => column.has_fractions(),
        })
    }

    /// The number of different tuples in the columns `range`.
    fn distinct(&self, range: Range<usize>) -> usize {
        let columns = &self.columns[range];
        let tuple = |row: usize| columns.iter().map(|column| column.keys[row]).collect::<Vec<_>>();
        (0..self.rows).map(tuple).collect::<HashSet<_>>().len()
    }

    /// Whether a number of different values is small compared to the number of rows.
    fn is_small(&self, distinct: usize) -> bool {
        4 * distinct < 3 * self.rows
    }

    /// Whether the first `count` columns, which have whole numbers, can be coordinates of a
    /// lattice.
    fn starts_with_lattice(&self, count: usize) -> bool {
        let columns = &self.columns[..count];
        // In a lattice with many more points along each axis than there are sampled rows, these
        // rows may have no coordinate in common. Therefore, if three columns have whole numbers, a
        // column of different numbers is an identifier only if another column repeats its numbers.
        let has_repeating = || columns.iter().any(|column| self.is_small(column.distinct()));
        let has_identifier = (0..2).any(|column| self.is_identifier(column));
        !self.is_small(self.distinct(0..count))
            && !(has_identifier && (count == 2 || has_repeating()))
    }

    /// Whether `column`, one of the first three columns, contains identifiers instead of
    /// coordinates.
    fn is_identifier_instead_of_coordinate(&self, column: usize) -> bool {
        if self.rows < 3 || !self.is_identifier(column) {
            return false;
        }
        let are_many = self.rows >= MANY_ROWS;
        let is_unlike = (0..3).any(|other| {
            other != column && self.is_real(column, other) && self.columns[other].varies()
        });
        match (column, is_unlike) {
            (0, true) => are_many || self.columns[0].counts_up(),
            // A lattice of whole numbers rarely begins with a line of this many particles.
            (0, false) => are_many && self.columns[0].counts_up(),
            (_, is_unlike) => are_many && is_unlike,
        }
    }

    /// Whether the first column has a few different integers, and no number in the next three
    /// columns is whole.
    fn starts_with_type(&self) -> bool {
        let first = &self.columns[0];
        let has_no_whole =
            |column: &SampledColumn| column.values.iter().all(|value| value.fract() != 0.0);
        self.rows >= MANY_ROWS
            && first.is_integer()
            && first.distinct() > 1
            && self.is_small(first.distinct())
            && self.columns[1..4].iter().all(has_no_whole)
    }

    /// Whether a column is sorted and has many equal numbers, like the coordinate of a lattice that
    /// changes most slowly.
    fn is_slowest_lattice_axis(&self, column: usize) -> bool {
        let column = &self.columns[column];
        let falls = || column.values.is_sorted_by(|one, next| one >= next);
        (column.values.is_sorted() || falls()) && self.is_small(column.distinct())
    }

    /// Whether the first column has the same number in all rows, and may be a type or a mass before
    /// the position.
    ///
    /// The column is not x if particles would then coincide. Otherwise, it is x if the rows are the
    /// first plane of a sorted lattice, if they also have the same number in one of the next three
    /// columns, or if they have six numbers, which are usually a position and a velocity.
    fn starts_with_constant(&self) -> bool {
        let is_numeric = |column: &&SampledColumn| column.numbers == self.rows;
        let numeric = self.columns.iter().take_while(is_numeric).count();
        if self.rows < MANY_ROWS || numeric < 4 || self.columns[0].varies() {
            return false;
        }
        let would_coincide =
            self.is_small(self.distinct(0..3)) && !self.is_small(self.distinct(1..4));
        let is_plane = || {
            numeric == POSITION_AND_VECTOR
                || (1..3).any(|column| self.is_slowest_lattice_axis(column))
                || !self.columns[3].varies()
        };
        would_coincide || !is_plane()
    }

    /// A message about unclear columns, with an example of a header.
    fn describe(&self, unclear: &[usize], row: UnnamedColumns) -> String {
        let numbers: Vec<_> = unclear.iter().map(|c| (row.first + c + 1).to_string()).collect();
        let shown = match numbers.split_last() {
            Some((last, others)) if !others.is_empty() => {
                format!("columns {} and {last} look like identifiers or types", others.join(", "))
            }
            _ if unclear.iter().all(|&column| !self.columns[column].varies()) => {
                let column = numbers.concat();
                format!("column {column} has the same number in all rows, like a type or a mass")
            }
            _ => format!("column {} looks like an identifier or a type", numbers.concat()),
        };
        let mut example = vec!["name"; row.first];
        let mut types = ["type", "object"].into_iter();
        for column in 0..unclear.last().map_or(0, |last| last + 1) {
            let name = match unclear.contains(&column) {
                true if self.is_identifier(column) && !example.contains(&"id") => "id",
                true if self.columns[column].has_fractions() => "mass",
                true => types.next().unwrap_or("flag"),
                false => "mass",
            };
            example.push(name);
        }
        example.extend(["x", "y", "z"]);
        if example.len() < row.fields {
            example.push("...");
        }
        format!(
            "{shown}, so it is unclear which columns are the position; write the names of all {} \
             columns in the first line, such as `{}`",
            row.fields,
            example.join(" ")
        )
    }
}
