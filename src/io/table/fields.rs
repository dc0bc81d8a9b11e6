//! Lines of a table and the fields of a line: separators, quotes, comments, and empty cells.

use memchr::memchr;

use crate::io::number::{Decimal, with_decimal};

/// Maximum number of fields in a line of a table.
pub const MOST_FIELDS: usize = 4096;

/// The notation of a table: the separator of fields and the decimal separator.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Syntax {
    pub separator: Separator,
    pub decimal: Decimal,
}

/// The separator between the fields of a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Separator {
    Byte(u8),
    /// One or more spaces and tabs.
    Blanks,
}

impl Syntax {
    /// Blanks between fields, and a decimal point in numbers. Most simulators write this notation.
    pub const BLANKS: Self = Self { separator: Separator::Blanks, decimal: Decimal::Point };

    /// All supported notations, in order of preference. A comma is tried as a separator before it
    /// is tried as a decimal comma.
    pub const ALL: [Self; 7] = [
        Self { separator: Separator::Byte(b';'), decimal: Decimal::Point },
        Self { separator: Separator::Byte(b';'), decimal: Decimal::Comma },
        Self { separator: Separator::Byte(b','), decimal: Decimal::Point },
        Self { separator: Separator::Byte(b'\t'), decimal: Decimal::Point },
        Self { separator: Separator::Byte(b'\t'), decimal: Decimal::Comma },
        Self::BLANKS,
        Self { separator: Separator::Blanks, decimal: Decimal::Comma },
    ];

    /// The number in a field. NaN for an empty or missing value, `None` for other text.
    pub fn number(self, field: &[u8]) -> Option<f64> {
        if let number @ Some(_) = with_decimal(field, self.decimal) {
            return number;
        }
        let field = unquoted(field);
        if is_missing(field) { Some(f64::NAN) } else { with_decimal(field, self.decimal) }
    }

    /// Whether a field contains a number. A missing value does not count as a number.
    pub fn is_number(self, field: &[u8]) -> bool {
        !is_missing(unquoted(field)) && self.number(field).is_some()
    }
}

impl Separator {
    /// The separator of a line: a semicolon or a comma if the line contains one, else blanks.
    pub fn of(line: &[u8]) -> Self {
        [b';', b','].into_iter().find(|byte| line.contains(byte)).map_or(Self::Blanks, Self::Byte)
    }
}

/// Whether a field is empty or a word for a missing value.
fn is_missing(field: &[u8]) -> bool {
    // "Na" is not among these words, because it is the symbol of sodium.
    const WORDS: [&str; 8] = ["NA", "N/A", "n/a", "null", "NULL", "Null", "none", "None"];
    field.is_empty() || WORDS.iter().any(|word| field == word.as_bytes())
}

/// The content of a field, without the quotes around it.
pub fn unquoted(field: &[u8]) -> &[u8] {
    match field {
        [b'"', inside @ .., b'"'] | [b'\'', inside @ .., b'\''] => inside.trim_ascii(),
        _ => field,
    }
}

/// Whether a line is a comment.
pub fn is_comment(line: &[u8]) -> bool {
    matches!(line.trim_ascii_start(), [b'#' | b'%' | b'!', ..] | [b'/', b'/', ..])
}

/// The lines that are not blank, each with its number (from 1), the byte offset of its start, and
/// its content without surrounding spaces. Surrounding tabs are kept, because they may separate
/// empty cells.
pub fn lines(text: &[u8]) -> impl Iterator<Item = (u64, usize, &[u8])> {
    let mut at = 0;
    let lines = std::iter::from_fn(move || {
        let start = at;
        let rest = text.get(start..).filter(|rest| !rest.is_empty())?;
        at += memchr(b'\n', rest).map_or(rest.len(), |end| end + 1);
        Some((start, trimmed(&text[start..at])))
    });
    let lines = (1..).zip(lines).map(|(line, (start, content))| (line, start, content));
    lines.filter(|(.., content)| content.iter().any(|byte| !byte.is_ascii_whitespace()))
}

/// The fields of each row. Comments are skipped.
pub fn rows_of(
    rows: &[u8],
    syntax: Syntax,
    expected: usize,
) -> impl Iterator<Item = impl Iterator<Item = &[u8]>> {
    lines(rows)
        .filter(|(.., content)| !is_comment(content))
        .map(move |(.., content)| LineFields::new(content, syntax.separator, expected))
}

/// A line without its line end and surrounding spaces.
fn trimmed(line: &[u8]) -> &[u8] {
    let is_cut = |byte: &u8| matches!(byte, b' ' | b'\r' | b'\n');
    let end = line.iter().rposition(|byte| !is_cut(byte)).map_or(0, |last| last + 1);
    let start = line[..end].iter().position(|byte| !is_cut(byte)).unwrap_or(end);
    &line[start..end]
}

/// The trimmed fields of a line, up to a comment.
///
/// Separators within quotes belong to the field. A comment starts with `#` after a blank, or at the
/// start of a field after the last expected field. Elsewhere, `#` may be a value. If the line has
/// too few fields, a separator at its end is followed by an empty field. Otherwise, that separator
/// is ignored.
pub struct LineFields<'a> {
    line: &'a [u8],
    at: usize,
    separator: Separator,
    /// Number of expected fields that have not been returned yet.
    missing: usize,
    /// Whether a separator ended the last field.
    ended_by_separator: bool,
    /// Whether the line contains `#`.
    has_hash: bool,
}

impl<'a> LineFields<'a> {
    pub fn new(line: &'a [u8], separator: Separator, expected: usize) -> Self {
        let line = match separator {
            // A tab at the start or end of the line separates an empty cell, so it is kept.
            Separator::Byte(b'\t') => line,
            _ => line.trim_ascii(),
        };
        let has_hash = memchr(b'#', line).is_some();
        Self { line, at: 0, separator, missing: expected, ended_by_separator: false, has_hash }
    }

    fn is_blank(&self, byte: u8) -> bool {
        byte <= b' ' && byte.is_ascii_whitespace() && self.separator != Separator::Byte(byte)
    }

    fn ends_field(&self, at: usize, start: usize) -> bool {
        let byte = self.line[at];
        match self.separator {
            Separator::Blanks => byte <= b' ' && byte.is_ascii_whitespace(),
            Separator::Byte(separator) => {
                byte == separator
                    || self.has_hash
                        && byte == b'#'
                        && at > start
                        && self.is_blank(self.line[at - 1])
            }
        }
    }

    /// The end of a quoted field. `None` if the field is not quoted.
    fn quoted_end(&self) -> Option<usize> {
        let quote = self.line[self.at];
        let mut at = self.at + 1;
        loop {
            at += memchr(quote, self.line.get(at..)?)? + 1;
            // Two quotes within a quoted field stand for one quote.
            if self.line.get(at) == Some(&quote) {
                at += 1;
                continue;
            }
            let after = self.line[at..].iter().find(|&&byte| !self.is_blank(byte));
            let closes = match self.separator {
                Separator::Byte(separator) => after.is_none_or(|&byte| byte == separator),
                Separator::Blanks => self.line.get(at).is_none_or(u8::is_ascii_whitespace),
            };
            return closes.then_some(at);
        }
    }
}

impl<'a> Iterator for LineFields<'a> {
    type Item = &'a [u8];

    fn next(&mut self) -> Option<&'a [u8]> {
        let line = self.line;
        while self.at < line.len() && self.is_blank(line[self.at]) {
            self.at += 1;
        }
        let Some(&first) = line.get(self.at) else {
            let has_empty = std::mem::take(&mut self.ended_by_separator) && self.missing > 0;
            self.missing = self.missing.saturating_sub(1);
            return has_empty.then_some(&[]);
        };
        if first == b'#'
            && (self.missing == 0 || self.at == 0 || self.is_blank(self.line[self.at - 1]))
        {
            return None;
        }
        let start = self.at;
        let from = match first {
            b'"' | b'\'' => self.quoted_end().unwrap_or(start),
            _ => start,
        };
        let mut end = from;
        while end < line.len() && !self.ends_field(end, from) {
            end += 1;
        }
        self.ended_by_separator = line.get(end).is_some_and(|&byte| byte != b'#');
        self.at = end + usize::from(self.ended_by_separator);
        self.ended_by_separator &= self.separator != Separator::Blanks;
        self.missing = self.missing.saturating_sub(1);
        Some(line[start..end].trim_ascii_end())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fields(line: &str, separator: u8, expected: usize) -> Vec<&str> {
        let separator = match separator {
            b' ' => Separator::Blanks,
            byte => Separator::Byte(byte),
        };
        LineFields::new(line.as_bytes(), separator, expected)
            .map(|field| std::str::from_utf8(field).unwrap())
            .collect()
    }

    #[test]
    fn a_comment_can_begin_only_at_the_start_of_a_field() {
        assert_eq!(fields("1,2,1.#QNAN", b',', 3), ["1", "2", "1.#QNAN"]);
        assert_eq!(fields("1, 2, 3 # a, b", b',', 3), ["1", "2", "3"]);
        assert_eq!(fields("1;2;3;# end", b';', 3), ["1", "2", "3"]);
        assert_eq!(fields("1,#,3", b',', 3), ["1", "#", "3"]);
        assert_eq!(fields("1 2 a#b #c", b' ', 3), ["1", "2", "a#b"]);
    }

    #[test]
    fn quotes_hide_separators_but_an_unclosed_quote_is_a_value() {
        assert_eq!(fields("\"a, \"\"b\"\"\", 2,3", b',', 3), ["\"a, \"\"b\"\"\"", "2", "3"]);
        assert_eq!(fields("1,\",3", b',', 3), ["1", "\"", "3"]);
        assert_eq!(fields("'a b' 2 3", b' ', 3), ["'a b'", "2", "3"]);
        assert_eq!(fields("5' 2 '3", b' ', 3), ["5'", "2", "'3"]);
    }

    #[test]
    fn a_trailing_separator_starts_a_field_only_if_one_is_missing() {
        assert_eq!(fields("1;2;3;", b';', 3), ["1", "2", "3"]);
        assert_eq!(fields("1,2,", b',', 3), ["1", "2", ""]);
        assert_eq!(fields("1,,", b',', 4), ["1", "", ""]);
        assert_eq!(fields("\t1\t\t3", b'\t', 4), ["", "1", "", "3"]);
        assert_eq!(fields("1 2 ", b' ', 3), ["1", "2"]);
    }
}
