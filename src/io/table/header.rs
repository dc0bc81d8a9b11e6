//! Finds the names of columns in the lines above the rows of a table.
//!
//! | notation | example |
//! |---|---|
//! | separators | `x, y, z` |
//! | units after blanks | `x (m) y (m) z (m)` |
//! | names with blanks, two or more blanks between names | `Particle index  Position [x]` |
//! | numbers of columns | `1:x 2:y 3:z`, `#1 x #2 y #3 z` |
//! | numbers of columns after names | `x[1] y[2] z[3]`, `id (1), position (2-4)` |
//! | numbers of components | `id v[3] x[3]` |
//! | vectors | `id vel pos` |
//! | angle brackets | `<x> <y> <z>` |
//! | one comment per column | `# [0] x`, `# column 1: x` |
//!
//! In a comment, a label may precede the names, as in `# columns: x y z`.

use std::borrow::Cow;
use std::collections::{HashSet, VecDeque};

use crate::io::ReadFault;
use crate::io::names::{
    are_components, bare_name, bare_names, is_other_component, is_position_word,
    names_other_column, names_position, names_velocity, position_axis, quantities,
};

use super::excerpt;
use super::fields::{LineFields, MOST_FIELDS, Separator, unquoted};
use super::heading::TableColumns;

/// Maximum number of comments that are searched for names. Earlier comments are ignored.
const MOST_COMMENTS: usize = 1024;
/// Maximum length, in bytes, of a comment that the reader checks for a contradiction with the
/// columns of the position. Longer comments count as free of contradictions.
const LONGEST_COMMENT: usize = 64 << 10;
/// Maximum length of a line in which a name can stand for several columns.
const LONGEST_NAMES: usize = 4 << 10;
/// Maximum number of labels that are skipped in a line.
const MOST_LABELS: usize = 4;

/// A function that splits a line into names. It returns no names if the line has another notation.
type Notation = fn(&str) -> Vec<String>;

/// All notations, in order of preference.
const NOTATIONS: [Notation; 7] = [
    in_angle_brackets,
    numbered,
    separated,
    between_blanks,
    with_units,
    separated_by_wide_gaps,
    numbered_after,
];

/// Last words of labels that precede the names of columns, as in `# columns: x y z`.
const LABELS: [&str; 8] =
    ["columns", "column", "fields", "names", "variables", "header", "format", "data"];

/// Words of sentences, which are not names of columns. Words that are also names, such as `at` and
/// `by`, are left out.
const PROSE: [&str; 12] =
    ["along", "and", "are", "as", "for", "from", "in", "is", "of", "the", "to", "with"];

/// The names in a line.
pub fn names_of(line: &[u8], separator: Separator) -> Vec<String> {
    let name = |name| String::from_utf8_lossy(unquoted(name)).into_owned();
    LineFields::new(line, separator, 0).take(MOST_FIELDS).map(name).collect()
}

/// The names in a line, in the notation that most programs write.
pub fn plain_names(line: &str) -> Vec<String> {
    let names = in_angle_brackets(line);
    if names.is_empty() { separated(line) } else { names }
}

/// The separator of a line of names. A tab has priority over blanks, because names may contain
/// blanks.
pub fn separator_of(line: &[u8]) -> Separator {
    match Separator::of(line) {
        Separator::Blanks if line.contains(&b'\t') => Separator::Byte(b'\t'),
        separator => separator,
    }
}

/// Each possible division of a line into columns that include a position.
pub fn named_columns(line: &str) -> impl Iterator<Item = TableColumns> {
    names_in(line).filter_map(TableColumns::of)
}

/// Each possible division of a comment into columns that include a position. Labels are skipped,
/// and sentences are ignored.
pub fn columns_in_comment(comment: &str) -> impl Iterator<Item = TableColumns> {
    columns_in(without_labels(comment))
}

/// Each possible division of one of the texts into columns that include a position. Divisions with
/// names of vectors come last, because these names may have other meanings.
fn columns_in(texts: Vec<&str>) -> impl Iterator<Item = TableColumns> {
    let vectors = texts.iter().flat_map(|text| vectors_in(text));
    let vectors: Vec<_> = vectors.filter_map(|(names, known)| known.then_some(names)).collect();
    let lists = texts.into_iter().flat_map(names_in).chain(vectors);
    lists.filter(|names| are_names(names)).filter_map(TableColumns::of)
}

/// Whether names include `x` and `y`, but form no position in three dimensions.
pub fn name_plane(names: &[String]) -> bool {
    let bare = bare_names(names);
    let has = |axis: &str| bare.iter().any(|name| name.eq_ignore_ascii_case(axis));
    has("x") && has("y") && quantities(names).is_none() && quantities(&bare).is_none()
}

/// The names in a line, in each notation.
fn names_in(line: &str) -> impl Iterator<Item = Vec<String>> {
    let lists = NOTATIONS.into_iter().map(move |notation| notation(line));
    lists.filter(|names| !names.is_empty())
}

/// The line, and the part of the line after each label. In the result, parts after well-known
/// labels come before the line, and other parts come after it.
fn without_labels(line: &str) -> Vec<&str> {
    let mut texts = vec![line];
    for (at, mark) in labels(line).take(MOST_LABELS) {
        let (label, names) = (&line[..at], &line[at + mark.len()..]);
        let last = label.split_whitespace().next_back().unwrap_or_default();
        match LABELS.iter().any(|known| last.eq_ignore_ascii_case(known)) {
            true => texts.insert(0, names),
            false => texts.push(names),
        }
    }
    texts
}

/// The ends of labels: equals signs, and colons before a blank.
fn labels(line: &str) -> impl Iterator<Item = (usize, &str)> {
    line.match_indices([':', '=']).filter(move |(at, mark)| {
        *mark == "=" || line[at + 1..].starts_with(|next: char| next.is_ascii_whitespace())
    })
}

/// The names in a line such as `<x> <y> <velocity> <velocity>`. deal.II writes these lines, and
/// gives all components of a vector the same name.
fn in_angle_brackets(line: &str) -> Vec<String> {
    let inside = line.trim().strip_prefix('<').and_then(|line| line.strip_suffix('>'));
    let Some(inside) = inside else { return Vec::new() };
    let names: Vec<&str> = inside.split("> <").take(MOST_FIELDS).collect();
    names.chunk_by(|one, next| one == next).flat_map(|run| components(run[0], run.len())).collect()
}

/// The names of the components of a vector.
fn components(name: &str, count: usize) -> Vec<String> {
    match count {
        1 => vec![name.to_owned()],
        _ => (0..count).map(|index| format!("{name}:{index}")).collect(),
    }
}

/// The names in a line such as `1:id 2:x` or `[0] id [1] x`. Text before the first number is
/// ignored.
fn numbered(line: &str) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    let mut next = None;
    for word in line.split(is_separator).filter(|word| !word.is_empty()) {
        match column_number(word) {
            Some((number, name)) if next.map_or(number <= 1, |next| number == next) => {
                if names.len() == MOST_FIELDS {
                    break;
                }
                names.push(name.to_owned());
                next = Some(number + 1);
            }
            _ => {
                if let Some(name) = names.last_mut() {
                    name.push_str(if name.is_empty() { "" } else { " " });
                    name.push_str(word);
                }
            }
        }
    }
    names
}

/// The names in a line such as `x[1] y[2]`, `x:1 y:2` or `id (1), position (2-4)`. A number or a
/// range of columns follows each name.
fn numbered_after(line: &str) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    let mut next = None;
    let mut name = Vec::new();
    if line.len() > LONGEST_NAMES {
        return names;
    }
    for word in line.split(is_separator).filter(|word| !word.is_empty()) {
        let (text, range) = word.rfind(['[', '(', '{', ':', '=']).map_or((word, ""), |at| {
            (&word[..at], word[at + 1..].trim_end_matches([']', ')', '}']))
        });
        let (first, last) = range.split_once('-').unwrap_or((range, range));
        let (Ok(first), Ok(last)) = (first.parse::<usize>(), last.parse()) else {
            name.push(word);
            continue;
        };
        let follows = next.map_or(first <= 1, |next| first == next);
        if !follows || !(first..MOST_FIELDS).contains(&last) {
            return Vec::new();
        }
        next = Some(last + 1);
        name.extend(Some(text).filter(|text| !text.is_empty()));
        let text = name.join(" ");
        name.clear();
        names.extend(std::iter::repeat_n(text, last + 1 - first));
    }
    if !name.is_empty() {
        return Vec::new();
    }
    names.chunk_by(|one, next| one == next).flat_map(|run| components(&run[0], run.len())).collect()
}

/// Lists of the names in a line such as `rho vel pos` or `rho, v[3], x[3]`, in which a name stands
/// for all components of a vector. The flag of a list is true if all of its names are well known.
/// In the second list, short names also stand for vectors, as in `rho v x`. A list with short names
/// is returned only if all of its names are well known. Returns no list if the line names no
/// vector.
fn vectors_in(line: &str) -> Vec<(Vec<String>, bool)> {
    if line.len() > LONGEST_NAMES {
        return Vec::new();
    }
    let listed = line.contains([',', ';']);
    let names = if listed { separated(line) } else { with_units(line) };
    let short = ShortVectors::among(names.iter().map(|name| bare_name(name)));
    let lists = [ShortVectors::default(), short].into_iter();
    let lists = lists.filter_map(|short| Some((short, vectors_of(line, &names, short)?)));
    let is_certain = |short, are_known| are_known || short == ShortVectors::default();
    lists.filter_map(|(short, list)| is_certain(short, list.1).then_some(list)).collect()
}

/// Replaces each name of a vector by the names of its components. Also returns whether all names
/// are well known. `None` if no name is a vector.
fn vectors_of(line: &str, names: &[String], short: ShortVectors) -> Option<(Vec<String>, bool)> {
    let listed = line.contains([',', ';']);
    // Two words without commas or brackets, such as `Material positions`, may be a title.
    let are_vectors = || names.iter().all(|name| names_vector(name) || short.has(name));
    if !listed && names.len() < 3 && !line.contains(['[', '(']) && !are_vectors() {
        return None;
    }
    let is_named = |known: &str| names.iter().any(|name| name.eq_ignore_ascii_case(known));
    // In a line with `u v w`, `v` is a component and not a vector.
    let has_components = !short.has("u") && is_named("u") || is_named("w");
    let (mut all, mut are_known) = (Vec::new(), true);
    for name in names {
        let bare = bare_name(name);
        let counted = bare.split_once(['[', '(']).and_then(|(name, count)| {
            let count = count.strip_suffix([']', ')'])?.parse().ok()?;
            (1..MOST_FIELDS).contains(&count).then_some((name.trim_end(), count))
        });
        let is_vector = short.has(bare)
            || names_vector(bare) && !(has_components && bare.eq_ignore_ascii_case("v"));
        let (bare, count) = counted.unwrap_or((bare, if is_vector { 3 } else { 1 }));
        let is_known = || {
            is_vector
                || names_other_column(bare)
                || position_axis(bare).is_some()
                || bare.eq_ignore_ascii_case("u")
        };
        are_known &= counted.is_some() || listed && !has_prose(bare) || is_known();
        all.extend(components(bare, count));
        if all.len() > MOST_FIELDS {
            return None;
        }
    }
    (all.len() > names.len()).then_some((all, are_known))
}

/// Whether a name stands for the three columns of a position or a velocity.
fn names_vector(name: &str) -> bool {
    names_position(name) || names_velocity(name)
}

/// Names of a single letter that may stand for the three columns of a vector, as in `v x`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct ShortVectors {
    position: Option<&'static str>,
    velocity: Option<&'static str>,
}

impl ShortVectors {
    /// The short names among `names`. A vector has no short name if a longer name stands for the
    /// same vector, or if the letter is a component among others, as in `x y z` or `u v w`.
    fn among<'a>(names: impl Iterator<Item = &'a str> + Clone) -> Self {
        let is_named = |known: &str| names.clone().any(|name| name.eq_ignore_ascii_case(known));
        let find = |known: &[&'static str]| known.iter().copied().find(|name| is_named(name));
        let has_axes = is_named("y") || is_named("z");
        let position =
            find(&["x", "r", "p"]).filter(|_| !has_axes && !names.clone().any(names_position));
        let velocity =
            find(&["u"]).filter(|_| !is_named("w") && !names.clone().any(names_velocity));
        Self { position, velocity }
    }

    fn has(self, name: &str) -> bool {
        [self.position, self.velocity].iter().flatten().any(|own| name.eq_ignore_ascii_case(own))
    }

    fn is_position(self, name: &str) -> bool {
        self.position.is_some_and(|own| name.eq_ignore_ascii_case(own))
    }
}

/// Whether a text contains a number or a word of a sentence.
fn has_prose(text: &str) -> bool {
    text.split_whitespace().any(|word| is_number(word) || is_word_of(&PROSE, word))
}

fn separated(line: &str) -> Vec<String> {
    names_of(line.as_bytes(), separator_of(line.as_bytes()))
}

/// The names in a line with spaces or tabs between names.
fn between_blanks(line: &str) -> Vec<String> {
    names_of(line.as_bytes(), Separator::Blanks)
}

/// The names in a line such as `x [m] rho (kg / m^3)`.
fn with_units(line: &str) -> Vec<String> {
    if line.contains([',', ';']) {
        return Vec::new();
    }
    let mut names: Vec<String> = Vec::new();
    let mut open = 0;
    for word in line.split_whitespace() {
        let is_unit = open > 0 || word.starts_with(['[', '(']);
        if is_unit && let Some(name) = names.last_mut() {
            name.push(' ');
            name.push_str(word);
        } else if names.len() < MOST_FIELDS {
            names.push(word.to_owned());
        } else {
            break;
        }
        open += word.matches(['[', '(']).count();
        open = open.saturating_sub(word.matches([']', ')']).count());
    }
    names
}

/// The names in a line with a tab or at least two blanks between names. OpenSPH writes these lines.
fn separated_by_wide_gaps(line: &str) -> Vec<String> {
    if line.contains([',', ';']) {
        return Vec::new();
    }
    let parts = line.split('\t').flat_map(|part| part.split("  ")).map(str::trim);
    parts.filter(|name| !name.is_empty()).take(MOST_FIELDS).map(str::to_owned).collect()
}

fn is_separator(character: char) -> bool {
    character.is_ascii_whitespace() || matches!(character, ',' | ';')
}

/// Splits a text such as `1:x`, `[1] x` or `1` into the number of a column and the name after it.
fn column_number(text: &str) -> Option<(u64, &str)> {
    /// Characters after the number of a column.
    const MARKS: [char; 8] = [']', ')', ':', '.', '=', '-', '>', ' '];
    let text = text.trim_start_matches(['[', '(', '#']);
    let end = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
    let (digits, rest) = text.split_at(end);
    let name = rest.trim_start_matches(MARKS);
    let is_fraction = name.starts_with(|c: char| c.is_ascii_digit());
    let is_marked = rest.is_empty() || name.len() < rest.len();
    let number = digits.parse().ok().filter(|number| *number < MOST_FIELDS as u64)?;
    (is_marked && !is_fraction).then_some((number, name.trim_end()))
}

/// The number and the name of a column in a comment such as `[0] x`, `1: x` or `column 2: y`.
fn column_in_comment(comment: &str) -> Option<(u64, &str)> {
    let text = comment.trim();
    let word = text.find(|c: char| !c.is_ascii_alphabetic()).unwrap_or(text.len());
    let is_label = ["column", "col", "field"].iter().any(|w| text[..word].eq_ignore_ascii_case(w));
    let text = if is_label { text[word..].trim_start_matches(['.', ' ']) } else { text };
    column_number(text).filter(|(_, name)| !name.is_empty())
}

fn is_word_of(words: &[&str], word: &str) -> bool {
    words.iter().any(|known| word.eq_ignore_ascii_case(known))
}

/// Whether all texts in a comment can be names of columns. A unit, a number, a word of a sentence,
/// or a title such as `positions` is not a name.
fn are_names(texts: &[String]) -> bool {
    texts.iter().all(|text| {
        text.contains(char::is_alphabetic)
            && !text.starts_with(['[', '('])
            && !text.ends_with([',', ';'])
            && !is_word_of(&PROSE, text)
            && !is_word_of(&["position", "positions", "coordinates"], text)
    })
}

/// The text of a comment, without the comment marks.
pub fn comment_text(comment: &[u8]) -> Cow<'_, str> {
    let comment = comment.trim_ascii_start();
    let marks = comment.iter().take_while(|byte| b"#%!/".contains(byte)).count();
    String::from_utf8_lossy(&comment[marks..])
}

/// The comments above the first row, and the other lines above it that are not rows.
#[derive(Debug, Default)]
pub struct Comments<'a> {
    lines: VecDeque<Comment<'a>>,
    /// The number of the last line with words that is neither a comment nor a row.
    last_title: u64,
}

#[derive(Debug)]
struct Comment<'a> {
    line: u64,
    /// The content without comment marks.
    text: Cow<'a, str>,
    /// Whether the line is not marked as a comment.
    is_title: bool,
}

impl<'a> Comments<'a> {
    /// Adds a comment, given its text without comment marks.
    pub fn push(&mut self, line: u64, text: Cow<'a, str>) {
        self.add(Comment { line, text, is_title: false });
    }

    fn add(&mut self, comment: Comment<'a>) {
        if self.lines.len() == MOST_COMMENTS {
            self.lines.pop_front();
        }
        self.lines.push_back(comment);
    }

    /// Adds a line that is neither a comment nor a row.
    pub fn push_title(&mut self, line: u64, text: Cow<'a, str>) {
        if has_words(&text) {
            self.last_title = line;
        }
        self.add(Comment { line, text, is_title: true });
    }

    /// Removes the comments below a line.
    pub fn truncate(&mut self, line: u64) {
        self.lines.retain(|comment| comment.line < line);
    }

    /// Each possible division of the comments into columns that include a position. The last
    /// comment comes first.
    pub fn columns<'b>(&'b self) -> impl Iterator<Item = TableColumns> {
        let texts = |comment: &'b Comment| match comment.is_title {
            true => vec![&*comment.text],
            false => without_labels(&comment.text),
        };
        let single = self.lines.iter().rev().flat_map(move |comment| columns_in(texts(comment)));
        single.chain(self.lists().into_iter().filter_map(TableColumns::of))
    }

    /// The names in consecutive comments with consecutive column numbers. The names are either the
    /// complete texts, or their first words.
    fn lists(&self) -> Vec<Vec<String>> {
        let mut lists: Vec<Vec<&str>> = Vec::new();
        let mut next = None;
        for comment in &self.lines {
            let column = column_in_comment(&comment.text);
            match (column, lists.last_mut()) {
                (Some((number, name)), Some(list)) if next == Some(number) => list.push(name),
                (Some((0 | 1, name)), _) => lists.push(vec![name]),
                _ => {
                    next = None;
                    continue;
                }
            }
            next = column.map(|(number, _)| number + 1);
        }
        lists.iter().flat_map(|list| whole_and_first_words(list)).collect()
    }

    /// The error for lines directly above the rows that seem to name the columns of the position,
    /// but do not fit rows with this number of `fields`. Without these lines, the position starts
    /// at the column `first`.
    ///
    /// A table without names is read as x, y and z, followed by unnamed columns. This is wrong if a
    /// line that the reader does not understand names the columns in another order. Sentences about
    /// x, y and z are harmless if x is the first column that they mention.
    pub fn unclear(&self, fields: usize, first: Option<usize>) -> Option<ReadFault> {
        let block: Vec<&Comment> =
            self.lines.iter().filter(|comment| comment.line >= self.last_title).collect();
        let last = block.iter().rfind(|comment| has_words(&comment.text));
        let last = last.filter(|comment| is_unclear(&comment.text, fields, first));
        let numbered = || is_unclear_list(&block, fields, first).then(|| block.last()).flatten();
        let found = last.or_else(numbered).map(|found| (found.line, Cow::Borrowed(&*found.text)));
        let (line, text) = found.or_else(|| {
            let (line, names) = self.single_names()?;
            is_unclear(&names, fields, first).then_some((line, Cow::Owned(names)))
        })?;
        let what = format!(
            "this line seems to name the columns, but it does not show which of the {fields} \
             columns below it are x, y and z: {}; write one name per column in the first line, \
             such as `x y z vx vy vz`, or delete this line",
            excerpt(text.trim().as_bytes())
        );
        Some(ReadFault::Line { line, what })
    }

    /// The words of the last lines that have a single word each, and the number of the first of
    /// these lines. `None` if there are fewer than two such lines.
    fn single_names(&self) -> Option<(u64, String)> {
        let lines = self.lines.iter().rev().filter(|comment| has_words(&comment.text));
        let mut lines: Vec<_> =
            lines.take_while(|comment| comment.text.split_whitespace().count() == 1).collect();
        lines.reverse();
        let names: Vec<&str> = lines.iter().map(|comment| comment.text.trim()).collect();
        Some((lines.first()?.line, names.join(" "))).filter(|_| lines.len() > 1)
    }
}

/// The texts, and their first words.
fn whole_and_first_words(texts: &[&str]) -> [Vec<String>; 2] {
    let first = |text: &&str| text.split_whitespace().next().unwrap_or_default().to_owned();
    [texts.iter().map(|text| (*text).to_owned()).collect(), texts.iter().map(first).collect()]
}

/// The order of x, y and z among the columns that a comment mentions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Mention {
    /// x, y and z are consecutive columns. The number is the index of the x column.
    InOrder(usize),
    /// x, y and z are in this order, with other columns between them.
    Apart,
    /// An unknown or a different order.
    Unordered,
}

impl Mention {
    fn of(columns: &[usize]) -> Self {
        match *columns {
            [x, y, z] if y == x + 1 && z == y + 1 => Self::InOrder(x),
            [x, y, z] if x < y && y < z => Self::Apart,
            _ => Self::Unordered,
        }
    }

    /// Whether it is correct to read the position from the column `first` on. In rows with three
    /// `fields`, only the order matters.
    fn agrees(self, fields: usize, first: Option<usize>) -> bool {
        match self {
            Self::InOrder(start) => start == 0 || Some(start) == first || fields == 3,
            Self::Apart => fields == 3,
            Self::Unordered => false,
        }
    }
}

/// Whether a comment contradicts a position that starts at the column `first`.
fn is_unclear(comment: &str, fields: usize, first: Option<usize>) -> bool {
    if comment.len() > LONGEST_COMMENT {
        return false;
    }
    let label = labels(comment).next().map(|(at, mark)| &comment[at + mark.len()..]);
    let texts = || [comment].into_iter().chain(label);
    let mut lists = texts().flat_map(|text| mentions_in_names(text, fields, first)).peekable();
    if lists.peek().is_some() {
        return !lists.any(|mention| mention.agrees(fields, first));
    }
    // Rows with three fields contain only the position, so its columns need no names.
    if fields == 3 {
        return false;
    }
    let mut sentences = texts().filter_map(mention_in_sentence).peekable();
    if sentences.peek().is_some() {
        return !sentences.any(|mention| mention.agrees(fields, first));
    }
    let is_fitting = |names: &[String]| {
        let mention = TableColumns::of(names.to_vec()).map(|c| Mention::of(&c.position.columns));
        names.len() == fields && mention.is_some_and(|mention| !mention.agrees(fields, first))
    };
    texts().any(|text| {
        vectors_in(text).iter().any(|(names, _)| is_fitting(names))
            || lists_other_columns_first(text, fields, first)
            || names_x_column_differently(text, fields, first)
    })
}

/// Whether a text is a list of names that gives x the name of another quantity. The names must not
/// include a position. Either the column of x has the name of another quantity, or at least three
/// names of other quantities precede the components of an unknown vector.
fn names_x_column_differently(text: &str, fields: usize, first: Option<usize>) -> bool {
    names_in(text).filter(|names| are_names(names)).any(|names| {
        let names = bare_names(&names);
        let unique: HashSet<&String> = names.iter().collect();
        if unique.len() < names.len() {
            // Names of columns do not repeat, but units do, such as `m m m m/s m/s m/s`.
            return false;
        }
        let is_other = |name: &String| names_other_column(name) || is_other_component(name);
        let x = first.and_then(|first| match names.len() {
            count if count == fields => names.get(first),
            count if count + first == fields => names.first(),
            _ => None,
        });
        let others = names.iter().take_while(|name| is_other(name)).count();
        // A sentence rarely names three quantities, so a text that does is a list of columns.
        let is_list = || {
            names.windows(3).any(are_components)
                || names.iter().filter(|name| is_other(name)).count() >= 3
        };
        x.is_some_and(is_other) && is_list()
            || others >= 3 && names.get(others..others + 3).is_some_and(are_components)
    })
}

/// Whether a text consists only of known names, and starts with other columns than the position. An
/// identifier before the position is allowed if the position starts at the column `first`.
///
/// The names must account for all `fields`, or for all fields from the column `first` on, in these
/// cases:
///
/// - No name is a position.
/// - There are only two names, which can be a title, such as `Material positions`.
/// - A single letter stands for a vector, as in `m r`.
///
/// The last two cases do not apply if all names are vectors. The name of a vector counts as three
/// columns or as one.
fn lists_other_columns_first(text: &str, fields: usize, first: Option<usize>) -> bool {
    let words = words_of(text);
    let are_axes = words.iter().filter(|word| axis_of(word).is_some()).count() > 1;
    // Units may follow names, as in `velocity in m/s`.
    let names: Vec<&str> =
        words.into_iter().filter(|word| !is_word_of(&["and", "in", "the"], word)).collect();
    let short = ShortVectors::among(names.iter().copied());
    [ShortVectors::default(), short].into_iter().any(|short| {
        let is_position = |name: &str| {
            names_position(name)
                || short.is_position(name)
                || are_axes && position_axis(name).is_some()
        };
        let is_known =
            |name: &&str| is_position(name) || names_other_column(name) || short.has(name);
        if names.len() < 2 || !names.iter().all(is_known) {
            return false;
        }
        let is_vector = |name: &&str| names_vector(name) || short.has(name);
        let columns = names.iter().map(|name| if is_vector(name) { 3 } else { 1 }).sum();
        let is_whole =
            |count: usize| count == fields || first.is_some_and(|first| first + count == fields);
        let place = names.iter().position(|name| is_position(name));
        let are_vectors = names.iter().all(is_vector);
        let is_list =
            place.is_some() && (are_vectors || names.len() > 2 && short == ShortVectors::default());
        (is_list || is_whole(columns) || is_whole(names.len()))
            && place.is_none_or(|place| place > 0 && Some(place) != first)
    })
}

/// The order of x, y and z, in each notation in which a text is a list of names.
fn mentions_in_names(
    text: &str,
    fields: usize,
    first: Option<usize>,
) -> impl Iterator<Item = Mention> {
    names_in(text).filter(|names| are_names(names)).filter_map(move |names| {
        let count = names.len();
        if count == fields && name_plane(&names) {
            return Some(Mention::Unordered);
        }
        let mention = Mention::of(&TableColumns::of(names)?.position.columns);
        // In some files, the row number has no name. In others, the last columns have no names, or
        // names with blanks. All other columns must have names.
        let names_first =
            first.is_some_and(|first| first + count < fields) || first == Some(0) && count > fields;
        let is_complete = fields == 3 || first.is_some_and(|first| first + count == fields);
        Some(if is_complete || names_first { mention } else { Mention::Unordered })
    })
}

/// Whether comments with column numbers contradict a position that starts at the column `first`.
fn is_unclear_list(comments: &[&Comment], fields: usize, first: Option<usize>) -> bool {
    let columns = comments.iter().filter_map(|comment| column_in_comment(&comment.text));
    let (numbers, names): (Vec<u64>, Vec<&str>) = columns.unzip();
    let mention = |columns: TableColumns| match numbers.first() {
        Some(0 | 1) => Mention::of(&columns.position.columns),
        _ => Mention::Unordered,
    };
    let lists = whole_and_first_words(&names).into_iter().filter_map(TableColumns::of);
    let mut mentions = lists.map(mention).peekable();
    mentions.peek().is_some() && !mentions.any(|mention| mention.agrees(fields, first))
}

/// The order of the words for x, y and z in a text. `None` if the text does not contain them, if
/// numbers or words of a sentence separate them, as in `x 0 1, y 0 1, z 0 1`, or if the text is
/// about values or axes instead of columns.
fn mention_in_sentence(text: &str) -> Option<Mention> {
    let words = words_of(text);
    let axes = words.iter().enumerate().filter(|(_, word)| axis_of(word).is_some());
    let (first, last) = (axes.clone().next()?.0, axes.clone().next_back()?.0);
    let is_named = |axis| axes.clone().any(|(_, word)| axis_of(word) == Some(axis));
    // Units may follow axes, as in `x in m`.
    let is_prose = |word: &str| is_word_of(&PROSE, word) && !word.eq_ignore_ascii_case("in");
    let is_other = |word: &&str| is_number(word) || is_prose(word);
    let is_about_values = || {
        let after = text.rsplit(words[last]).next().unwrap_or_default();
        after.contains(|c: char| c.is_ascii_digit())
            || words.iter().any(|word| word.to_ascii_lowercase().contains("axis"))
    };
    if !(0..3).all(is_named) || words[first..last].iter().any(is_other) || is_about_values() {
        return None;
    }
    // In a sentence, columns are listed after words such as `of` or `in`, unless an earlier `and`
    // indicates that the list of columns begins before these words.
    let before = &words[..first];
    let start = match before.iter().rposition(|word| is_word_of(&PROSE, word)) {
        Some(at) if !before.iter().any(|word| word.eq_ignore_ascii_case("and")) => at + 1,
        _ => 0,
    };
    let is_of_column =
        |word: &&&str| axis_of(word).is_some() || !(is_number(word) || is_position_word(word));
    let names: Vec<&&str> = words[start..].iter().filter(is_of_column).collect();
    let place = |axis| {
        let mut places = (0..names.len()).filter(|&place| axis_of(names[place]) == Some(axis));
        places.next().filter(|_| places.next().is_none())
    };
    let columns: Vec<usize> = (0..3).filter_map(place).collect();
    Some(Mention::of(&columns))
}

/// The axis of a position that a word names, such as `x`, `pos_x`, `x_m` or `x-coordinate`.
fn axis_of(word: &str) -> Option<usize> {
    position_axis(word).or_else(|| match word.split_once(['_', '-'])? {
        (axis, rest) if axis.len() == 1 && !rest.contains(['_', '-']) => position_axis(axis),
        _ => None,
    })
}

fn is_number(word: &str) -> bool {
    word.starts_with(|c: char| c.is_ascii_digit())
}

/// For each opening bracket of a text, the text in the brackets and the text after them. The first
/// item contains the text before the first bracket.
fn bracketed(text: &str) -> impl Iterator<Item = (&str, &str)> {
    let parts = text.split(['[', '(']).enumerate();
    parts.map(|(number, part)| match part.split_once([']', ')']) {
        Some(both) if number > 0 => both,
        _ => ("", part),
    })
}

/// Whether a comment contains words outside brackets, in contrast to a line of units or dashes.
fn has_words(comment: &str) -> bool {
    bracketed(comment).any(|(_, after)| after.contains(char::is_alphabetic))
}

/// The words and numbers of a text, without column numbers and units. The text in brackets is a
/// unit if it does not name an axis.
fn words_of(text: &str) -> Vec<&str> {
    let mut words = Vec::new();
    for (inside, after) in bracketed(text) {
        if words_between(inside).any(|word| axis_of(word).is_some()) {
            words.extend(words_between(inside));
        }
        words.extend(words_between(after));
    }
    words
}

fn words_between(text: &str) -> impl Iterator<Item = &str> {
    let words = text.split(|c: char| is_separator(c) || matches!(c, '=' | '|' | '<' | '>'));
    words.filter_map(|word| {
        let name = column_number(word).map(|(_, name)| name).filter(|name| !name.is_empty());
        let word = name.unwrap_or(word).trim_matches(|c: char| !c.is_alphanumeric());
        (!word.is_empty()).then_some(word)
    })
}
