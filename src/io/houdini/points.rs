//! Columns with the point attributes of a geometry. The values of a column are in the bytes of the
//! file or, if they cannot be read in place, in a buffer to which they were copied.

use std::borrow::Cow;
use std::collections::BTreeSet;
use std::rc::Rc;

use crate::io::ReadFault;
use crate::io::bytes::{ByteView, PrivateBytes, UnpackBuffer, Unpacking, unpacked_limit};
use crate::io::columns::{Column, Endian, Scalar};
use crate::particles::Label;

use super::json::{JsonNumber, JsonNumbers, Storage};
use super::schema::{
    HoudiniAttribute, MOST_TEXTS, NumberLocation, NumberRun, PointPages, PointValues, ValueLayout,
};

/// Number of points of a page, or of numbers in another layout, that are unpacked at once.
const ROWS: u64 = 1 << 13;

/// The bytes that contain numbers: the document, and the numbers copied from JSON lists.
#[derive(Clone, Copy)]
pub struct NumberBytes<'a> {
    pub document: ByteView<'a>,
    pub endian: Endian,
    pub gathered: &'a PrivateBytes,
}

impl<'a> NumberBytes<'a> {
    /// The bytes of a location, and their byte order.
    pub fn of(&self, place: NumberLocation) -> (ByteView<'a>, Endian) {
        match place {
            NumberLocation::Document => (self.document, self.endian),
            NumberLocation::Gathered => (self.gathered.view(), Endian::Little),
        }
    }

    /// Returns the location and the columns of an attribute whose numbers can be used in place.
    /// Returns `None` for numbers that must be unpacked first, such as half floats or constant
    /// pages.
    pub fn columns(&self, values: &PointValues) -> Option<(NumberLocation, Vec<Column>)> {
        let column = |run: NumberRun, components: u64| {
            let Storage::Scalar(scalar) = run.numbers.storage else { return None };
            let stride = components as usize * scalar.size();
            let endian = self.of(run.place).1;
            Some(Column { offset: run.numbers.at, stride, scalar, endian })
        };
        let tuples = |run: NumberRun| {
            let first = column(run, values.components)?;
            Some((run.place, components(first, values)))
        };
        match &values.data {
            ValueLayout::Tuples(run) => tuples(*run),
            ValueLayout::Pages(PointPages { run, groups, .. }) => match &groups[..] {
                [only] if !only.has_constants() => tuples(*run),
                _ => None,
            },
            ValueLayout::Arrays(runs) => {
                let place = runs.first()?.place;
                let alike = runs.iter().all(|run| run.place == place);
                let columns = runs.iter().map(|&run| column(run, 1)).collect::<Option<_>>()?;
                alike.then_some((place, columns))
            }
        }
    }

    /// The bytes of a range of numbers. Half floats are converted to f32.
    fn stored(&self, run: NumberRun) -> Result<Cow<'a, [u8]>, ReadFault> {
        let NumberRun { place, numbers } = run;
        let (bytes, endian) = self.of(place);
        let end = numbers.at + numbers.storage.bytes(numbers.count) as usize;
        if let Storage::Scalar(_) = numbers.storage {
            return bytes.read(numbers.at..end);
        }
        let mut wide = Vec::with_capacity(numbers.count as usize * size_of::<f32>());
        numbers.each(bytes, endian, |number| {
            let JsonNumber::Real(real) = number else { return Ok(()) };
            wide.extend_from_slice(&match endian {
                Endian::Little => (real as f32).to_le_bytes(),
                Endian::Big => (real as f32).to_be_bytes(),
            });
            Ok(())
        })?;
        Ok(Cow::Owned(wide))
    }

    /// Calls `take` with the bytes of the numbers in `run`, in batches.
    fn each(&self, run: NumberRun, take: &mut TakeStored) -> Result<(), ReadFault> {
        let NumberRun { place, numbers } = run;
        for first in (0..numbers.count).step_by(ROWS as usize) {
            let part = numbers.part(first, ROWS.min(numbers.count - first));
            take(&self.stored(NumberRun { place, numbers: part })?)?;
        }
        let end = numbers.at + numbers.storage.bytes(numbers.count) as usize;
        self.of(place).0.release(numbers.at..end);
        Ok(())
    }

    /// Calls `take` with the bytes of the tuples in all pages, in batches.
    fn each_of_pages(
        &self,
        pages: &PointPages,
        points: u64,
        take: &mut TakeStored,
    ) -> Result<(), ReadFault> {
        let NumberRun { place, numbers } = pages.run;
        let width = numbers.storage.scalar().size();
        let stride =
            width * pages.groups.iter().map(|group| group.components as usize).sum::<usize>();
        let mut tuples = Vec::new();
        // Index of the first number of the current page.
        let mut at = 0;
        for page in 0..points.div_ceil(pages.size) {
            let rows = pages.size.min(points - page * pages.size);
            for first in (0..rows).step_by(ROWS as usize) {
                let count = ROWS.min(rows - first);
                tuples.clear();
                tuples.resize(count as usize * stride, 0);
                let (mut group_at, mut within) = (at, 0);
                for group in &pages.groups {
                    let components = group.components;
                    let own = components as usize * width;
                    let is_constant = group.is_constant(page);
                    let (from, read) = if is_constant { (0, 1) } else { (first, count) };
                    let part = numbers.part(group_at + from * components, read * components);
                    let stored = self.stored(NumberRun { place, numbers: part })?;
                    let mut values = stored.chunks_exact(own).cycle();
                    for tuple in tuples.chunks_exact_mut(stride) {
                        tuple[within..within + own]
                            .copy_from_slice(values.next().unwrap_or_default());
                    }
                    within += own;
                    group_at += if is_constant { components } else { rows * components };
                }
                take(&tuples)?;
            }
            let stored = pages
                .groups
                .iter()
                .map(|group| group.components * if group.is_constant(page) { 1 } else { rows });
            at += stored.sum::<u64>();
        }
        let end = numbers.at + numbers.storage.bytes(numbers.count) as usize;
        self.of(place).0.release(numbers.at..end);
        Ok(())
    }
}

/// A function that consumes the bytes of numbers.
type TakeStored<'a> = dyn FnMut(&[u8]) -> Result<(), ReadFault> + 'a;

/// The columns of all components of an attribute. `first` is the column of component 0.
fn components(first: Column, values: &PointValues) -> Vec<Column> {
    (0..values.components as usize).map(|index| first.component(index)).collect()
}

/// A label, the column of its numbers, and for each number the index of its text in the label.
type LabelColumn = (Label, (Column, Vec<u32>));

/// Unpacks the columns of attributes, one attribute after another.
pub struct UnpackedColumns<'a> {
    source: NumberBytes<'a>,
    unpacked: UnpackBuffer<'a>,
    points: u64,
    /// Maximum number of bytes that may still be added.
    remaining_bytes: u64,
}

impl<'a> UnpackedColumns<'a> {
    /// Starts without attributes. Each added attribute must have values for `points` points.
    pub fn new(source: NumberBytes<'a>, points: u64, unpacking: Unpacking<'a>) -> Self {
        let remaining_bytes = unpacked_limit(source.document.len() as u64);
        Self { source, unpacked: UnpackBuffer::new(unpacking), points, remaining_bytes }
    }

    /// Returns the bytes of all columns.
    pub fn finish(self) -> Result<PrivateBytes, ReadFault> {
        self.unpacked.finish()
    }

    /// Unpacks an attribute.
    ///
    /// # Errors
    /// [`ReadFault::Compression`] if the columns need more bytes than a file of this size may
    /// unpack to, read errors, and errors of the scratch file.
    pub fn push(&mut self, attribute: &HoudiniAttribute) -> Result<Vec<Column>, ReadFault> {
        let HoudiniAttribute { name, values, .. } = attribute;
        let run = match &values.data {
            ValueLayout::Tuples(run) => run,
            ValueLayout::Pages(pages) => &pages.run,
            ValueLayout::Arrays(runs) => {
                // A geometry without points may have no arrays.
                let none = self.start(name, Scalar::F64, Endian::Little, 1)?;
                let mut columns = vec![none; values.components as usize];
                for (column, run) in columns.iter_mut().zip(runs) {
                    let endian = self.source.of(run.place).1;
                    *column = self.start(name, run.numbers.storage.scalar(), endian, 1)?;
                    self.source.each(*run, &mut |stored| self.unpacked.push(stored))?;
                }
                return Ok(columns);
            }
        };
        let endian = self.source.of(run.place).1;
        let scalar = run.numbers.storage.scalar();
        let first = self.start(name, scalar, endian, values.components as usize)?;
        let mut take = |stored: &[u8]| self.unpacked.push(stored);
        match &values.data {
            ValueLayout::Pages(pages) => {
                self.source.each_of_pages(pages, self.points, &mut take)?
            }
            _ => self.source.each(*run, &mut take)?,
        }
        Ok(components(first, values))
    }

    /// Unpacks a text attribute. Returns its label, its column, and for each number in the column
    /// the index of its text in the label.
    ///
    /// The file uses -1 for an empty text, so each number in the column is the number in the file
    /// plus one.
    ///
    /// Returns `None` if there are too many texts for a label, or several texts per point.
    ///
    /// # Errors
    /// [`ReadFault::Malformed`] for a number that has no text ([`ReadFault::Unsupported`] if the
    /// number comes from a JSON list), and the errors of [`push`](Self::push).
    pub fn push_texts(
        &mut self,
        attribute: &HoudiniAttribute,
    ) -> Result<Option<LabelColumn>, ReadFault> {
        let HoudiniAttribute { name, values, texts } = attribute;
        let texts = texts.as_ref().filter(|texts| texts.len() <= MOST_TEXTS);
        let Some(texts) = texts.filter(|_| values.components == 1) else { return Ok(None) };
        let column = self.start(name, Scalar::U32, Endian::Little, 1)?;
        let (run, pages) = match &values.data {
            ValueLayout::Tuples(run) => (*run, None),
            ValueLayout::Pages(pages) => (pages.run, Some(pages)),
            ValueLayout::Arrays(runs) => match &runs[..] {
                [only] => (*only, None),
                _ => return Ok(None),
            },
        };
        let endian = self.source.of(run.place).1;
        let scalar = run.numbers.storage.scalar();
        let mut numbers = Vec::new();
        let mut take = |stored: &[u8]| {
            numbers.clear();
            let count = (stored.len() / scalar.size()) as u64;
            let part = JsonNumbers { at: 0, storage: Storage::Scalar(scalar), count };
            part.each(stored.into(), endian, |number| {
                let JsonNumber::Integer(number @ -1..) = number else {
                    let what = format!("attribute {name}: {number} is not a valid string index");
                    return Err(run.fault(what));
                };
                if number >= texts.len() as i64 {
                    let what = format!(
                        "attribute {name} refers to string {number}, but there are {} strings, \
                         numbered from 0",
                        texts.len()
                    );
                    return Err(run.fault(what));
                }
                numbers.extend_from_slice(&((number + 1) as u32).to_le_bytes());
                Ok(())
            })?;
            self.unpacked.push(&numbers)
        };
        match pages {
            Some(pages) => self.source.each_of_pages(pages, self.points, &mut take)?,
            None => self.source.each(run, &mut take)?,
        }
        let none: Rc<str> = "".into();
        let unique: BTreeSet<&str> = texts.iter().chain([&none]).map(|text| &**text).collect();
        let unique: Vec<&str> = unique.into_iter().collect();
        let place = |text: &Rc<str>| unique.partition_point(|other| *other < &**text) as u32;
        let places = [&none].into_iter().chain(texts).map(place).collect();
        let texts = unique.into_iter().map(str::to_owned).collect();
        Ok(Some((Label { name: (**name).to_owned(), texts }, (column, places))))
    }

    /// Reserves bytes for an attribute, and returns the column of its first component.
    fn start(
        &mut self,
        name: &str,
        scalar: Scalar,
        endian: Endian,
        components: usize,
    ) -> Result<Column, ReadFault> {
        let stride = components * scalar.size();
        let needed =
            self.points.checked_mul(stride as u64).filter(|bytes| *bytes <= self.remaining_bytes);
        self.remaining_bytes -= needed.ok_or_else(|| {
            let what = format!(
                "attribute {name} of {} points is too large for a file of {} bytes",
                self.points,
                self.source.document.len()
            );
            ReadFault::Compression(what)
        })?;
        Ok(Column { offset: self.unpacked.len() as usize, stride, scalar, endian })
    }
}
